//! `sim-harness zoo`: the same room through every camera.

use std::path::PathBuf;

use clap::Args;

use super::record::Format;
use super::run::{exit_code, writable};
use super::told::tell;
use crate::scenario::Scenario;
use crate::team::TeamError;
use crate::zoo;

/// Arguments of `zoo`.
#[derive(Debug, Clone, Args)]
pub struct ZooArgs {
    /// Where pictures, panoramas, camera files and sheet.png go
    #[arg(long, value_name = "DIR", default_value = "zoo")]
    out: PathBuf,
    /// A scenario file, or the name of a scenario inside the program, whose room is shown from the first robot's place
    #[arg(long, default_value = "default")]
    scenario: PathBuf,
    /// Another seed than the scenario's
    #[arg(long)]
    seed: Option<u64>,
    /// How to report
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

/// Does it; gives the exit code.
#[allow(clippy::print_stderr)]
pub fn run(args: &ZooArgs) -> u8 {
    let ready = Scenario::load(&args.scenario).map_err(TeamError::from);
    let scenario = match ready.and_then(|scenario| writable(&args.out).map(|()| scenario)) {
        Ok(scenario) => scenario,
        Err(error) => {
            eprintln!("sim-harness zoo: {error}");
            return exit_code(&error);
        }
    };
    let bar = indicatif::ProgressBar::new(zoo::specimens().len() as u64);
    match zoo::write(&scenario, args.seed.unwrap_or(scenario.seed), &args.out, |n| bar.set_position(n as u64)) {
        Ok(names) => {
            bar.finish_and_clear();
            let sheet = args.out.join("sheet.png");
            let text = match args.format {
                Format::Text => format!("{} cameras in {}: {}", names.len(), sheet.display(), names.join(", ")),
                Format::Json => serde_json::json!({ "cameras": names, "sheet": sheet }).to_string(),
            };
            tell("zoo", &text, 0)
        }
        Err(error) => {
            eprintln!("sim-harness zoo: {error}");
            1
        }
    }
}
