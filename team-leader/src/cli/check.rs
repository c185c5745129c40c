//! `team-leader check`: is the configuration right?

use std::path::PathBuf;

use clap::Args;

use super::solve::Format;
use crate::config::{Config, Replay};

/// Arguments of `check`.
#[derive(Debug, Clone, Args)]
pub struct CheckArgs {
    /// The leader's configuration file.
    #[arg(long)]
    pub config: PathBuf,
    /// Format of the result.
    #[arg(long, value_enum, default_value_t = Format::Text)]
    pub format: Format,
}

/// Checks it without starting anything; the exit code: 0 fine, 2 wrong.
pub fn run(args: &CheckArgs) -> u8 {
    let config = match Config::read(&args.config) {
        Ok(config) => config,
        Err(error) => return super::usage_error(&error, args.format),
    };
    let replay = match config.replay {
        None => "none".to_owned(),
        Some(Replay::At(start)) => format!("begins at {start} of this host's clock"),
        Some(Replay::WhenJoined { robots, delay_s }) => format!("begins {delay_s} s after {robots} robots have joined"),
    };
    if args.format == Format::Json {
        let report = serde_json::json!({
            "ok": true, "leader": config.id, "team": config.team, "listen": config.listen, "connect": config.connect,
            "replay": replay,
        });
        println!("{report}");
        return 0;
    }
    println!("{}: fine", args.config.display());
    println!("  leader   {} of team {}, term {}", config.id, config.team, config.core.term);
    let default = if config.listen_is_default { " (the default: this host alone)" } else { "" };
    println!("  listens  {}{default}", config.listen.join(", "));
    println!(
        "  connects {}",
        if config.connect.is_empty() { "to nobody".to_owned() } else { config.connect.join(", ") }
    );
    match &config.core.anchor {
        Some(anchor) => {
            let pose = anchor.team_from_body;
            let heading_deg = pose.heading_rad.to_degrees();
            println!("  frame    robot {} at ({}, {}) m, {heading_deg}°", anchor.robot, pose.x_m, pose.y_m);
        }
        None => println!("  frame    the body frame of the first standing robot"),
    }
    println!("  replay   {replay}");
    0
}
