//! `sim-harness shadows`: the weights with which agents tell bodies from shadows, learnt from rendered rooms.

use std::path::PathBuf;

use clap::Args;
use indicatif::ProgressBar;

use super::seeds::{Seeds, parse};
use super::told::tell;
use crate::{parallel, shadows};

/// Arguments of `shadows`.
#[derive(Debug, Clone, Args)]
pub struct ShadowsArgs {
    /// Seeds of the rooms, as 0..19 or 1,3,7
    #[arg(long, value_name = "SEEDS", default_value = "700000..700009", value_parser = parse)]
    seeds: Seeds,
    /// Threads
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=64))]
    threads: u32,
    /// Writes the weights there: `robot-agent/src/tracking/figures/bodily.net`, from which the agent is built
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Does it; gives the exit code.
#[allow(clippy::print_stderr)]
pub fn run(args: &ShadowsArgs) -> u8 {
    match work(args) {
        Ok(text) => tell("shadows", &text, 0),
        Err(error) => {
            eprintln!("sim-harness shadows: {error}");
            1
        }
    }
}

fn work(args: &ShadowsArgs) -> Result<String, String> {
    let jobs: Vec<_> =
        args.seeds.0.iter().flat_map(|seed| shadows::scenarios(*seed).into_iter().map(|s| (s, *seed))).collect();
    let bar = ProgressBar::new(jobs.len() as u64);
    let rooms = parallel::map(args.threads as usize, jobs, |(scenario, seed)| {
        let room = shadows::gather(scenario, seed);
        bar.inc(1);
        room
    });
    bar.finish_and_clear();
    let rooms = rooms.into_iter().collect::<Result<Vec<_>, _>>().map_err(|e| e.to_string())?;
    let (net, text) = shadows::learn(&rooms);
    if let Some(path) = &args.out {
        let bytes: Vec<u8> = net.iter().flat_map(|weight| weight.to_le_bytes()).collect();
        std::fs::write(path, bytes).map_err(|e| format!("{}: {e}", path.display()))?;
    }
    Ok(text)
}
