//! `sim-harness bench`: how long the agent's whole frame takes, stage by stage.

use std::path::PathBuf;

use clap::Args;

use super::record::Format;
use super::told::tell;
use crate::bench::{self, BenchError, Frames, Report, STAGES};

/// Arguments of `bench`.
#[derive(Debug, Clone, Args)]
pub struct BenchArgs {
    /// Raw 8-bit gray pictures one after another; FILE.json beside it has sizes, rate and the ring's geometry
    file: PathBuf,
    /// Threads of one agent's frame. One is all there is: a frame is too short to be worth waking another
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1))]
    threads: u32,
    /// Only the first N frames
    #[arg(long, value_name = "N")]
    frames: Option<usize>,
    /// Frames that are worked before timing begins
    #[arg(long, value_name = "N", default_value_t = 40)]
    warm: usize,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Does it; gives the exit code.
#[allow(clippy::print_stderr)]
pub fn run(args: &BenchArgs) -> u8 {
    let report =
        Frames::read(&args.file, args.frames).map_err(BenchError::from).and_then(|f| bench::run(&f, args.warm));
    match report {
        Ok(report) => {
            let told = match args.format {
                Format::Json => serde_json::to_string(&report).unwrap_or_default(),
                Format::Text => text(&report),
            };
            tell("bench", &told, 0)
        }
        Err(error) => {
            eprintln!("sim-harness bench: {error}");
            if matches!(error, BenchError::Agent(_)) { 1 } else { 2 }
        }
    }
}

fn text(r: &Report) -> String {
    let mut text = format!(
        "{} × {} → {} × {}, {} frames, one thread, {} kernels\n\n  stage       median      floor\n",
        r.camera_px[0], r.camera_px[1], r.panorama_px[0], r.panorama_px[1], r.frames, r.kernels
    );
    for ((stage, us), floor) in STAGES.iter().zip(r.us_median.to_array()).zip(r.floor_us.to_array()) {
        text += &format!("  {stage:<9} {us:>6.1} µs  {floor:>6.1} µs\n");
    }
    text += &format!(
        "  frame     {:>6.1} µs  {:>6.1} µs   99 % within {:.1} µs\n\nmedian of 30 frames {:.0} µs; {:.1} MB; moving objects {:.2}, tracks {:.2} a frame, {} tracks in all",
        r.total_us_median,
        r.floor_total_us,
        r.total_us_p99,
        r.median_of_30_us,
        r.memory_bytes as f64 / 1e6,
        r.det_mean,
        r.tracks_mean,
        r.track_ids
    );
    text
}
