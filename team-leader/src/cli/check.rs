//! `team-leader check`: is the configuration right?

use std::io::Write;
use std::path::PathBuf;

use clap::Args;
use protocol::security::Member;
use protocol::security::preflight::{self, PreflightError, Report};
use protocol::security::roster::Role;

use super::solve::Format;
use crate::config::{Config, Replay};
use crate::service::StateDir;

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
    let certificate = match preflight(&config) {
        Ok(report) => report,
        Err(error) => return super::usage_error(&error, args.format),
    };
    if let Some(Err(error)) = config.state_dir.as_deref().map(StateDir::check) {
        return super::usage_error(&error, args.format);
    }
    super::output(0, |out| report(args, &config, certificate.as_ref(), out))
}

fn report(
    args: &CheckArgs,
    config: &Config,
    certificate: Option<&Report>,
    out: &mut impl Write,
) -> std::io::Result<()> {
    let replay = match config.replay {
        None => "none".to_owned(),
        Some(Replay::At(start)) => format!("begins at {start} of this host's clock"),
        Some(Replay::WhenJoined { robots, delay_s }) => format!("begins {delay_s} s after {robots} robots have joined"),
    };
    if args.format == Format::Json {
        let report = serde_json::json!({
            "ok": true, "leader": config.id, "team": config.team, "listen": config.listen, "connect": config.connect,
            "replay": replay, "security": config.security.in_words(),
            "certificate": certificate.map(|report| &report.name),
            "remarks": certificate.iter().flat_map(|report| &report.remarks).collect::<Vec<_>>(),
        });
        return writeln!(out, "{report}");
    }
    writeln!(out, "{}: fine", args.config.display())?;
    writeln!(out, "  leader   {} of team {}, term {}", config.id, config.team, config.core.term)?;
    let default = if config.listen_is_default { " (the default: this host alone)" } else { "" };
    writeln!(out, "  listens  {}{default}", config.listen.join(", "))?;
    let connects = if config.connect.is_empty() { "to nobody".to_owned() } else { config.connect.join(", ") };
    writeln!(out, "  connects {connects}")?;
    writeln!(out, "  security {}", config.security.in_words())?;
    if let Some(report) = certificate {
        writeln!(out, "  named    {} by its certificate", report.name)?;
    }
    match &config.core.anchor {
        Some(anchor) => {
            let pose = anchor.team_from_body;
            let heading_deg = pose.heading_rad.to_degrees();
            writeln!(out, "  frame    robot {} at ({}, {}) m, {heading_deg}°", anchor.robot, pose.x_m, pose.y_m)?;
        }
        None => writeln!(out, "  frame    the body frame of the first standing robot")?,
    }
    writeln!(out, "  replay   {replay}")
}

/// Looks at the certificates before anything connects, and logs what people should know.
pub(super) fn preflight(config: &Config) -> Result<Option<Report>, PreflightError> {
    let who = Member { team: config.team, role: Role::Leader, name: config.id.as_str() };
    let report = config.security.preflight(who, &config.listen, preflight::now())?;
    for remark in report.iter().flat_map(|report| &report.remarks) {
        tracing::warn!("{remark}");
    }
    if let Some(remark) = preflight::opening_remark(&config.security, &config.listen) {
        tracing::info!("{remark}");
    }
    Ok(report)
}
