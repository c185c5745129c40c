//! Command line.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use sim_harness::cli::{
    bandwidth, baseline, bench, chaos, demo, efficiency, guidance, motion, peers, record, replay, run, scale, score,
    shadows, zoo,
};

/// As the agent's, which it measures.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

#[derive(Debug, Parser)]
#[command(
    name = "sim-harness",
    about = "Whole robot teams in one process, against truth. Without a command: demo",
    version
)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// The first 20 s of the default scenario over Zenoh: scores, traffic, pictures
    Demo(demo::DemoArgs),
    /// Any scenario: scores against truth, traffic
    Run(run::RunArgs),
    /// Images and truth of a scenario, as files
    Record(record::RecordArgs),
    /// Recordings again, without rendering or waiting
    Replay(replay::ReplayArgs),
    /// Bytes by message kind and robot: payload, on the wire, against raw and JPEG video
    Bandwidth(bandwidth::BandwidthArgs),
    /// Mutual calibration and stereo against the Cramér–Rao bound, by Monte Carlo
    Efficiency(efficiency::EfficiencyArgs),
    /// Robots go where the leader says: expected and achieved errors of the targets
    Guidance(guidance::GuidanceArgs),
    /// Fellow robots in rendered pictures of rooms drawn anew: found, measured, named, against truth
    Peers(peers::PeersArgs),
    /// Weights with which the detector tells robots from other things, learnt from fits with truth (`peers --fits`)
    Verdict(peers::VerdictArgs),
    /// Two robots of rooms drawn anew: how well the map knows their distance after a second of standing
    Baseline(baseline::BaselineArgs),
    /// Masks and tracks against truth: F, recall, precision; MOTA, IDF1, identity switches
    Score(score::ScoreArgs),
    /// Many robots with synthetic observations through real sessions: what one leader carries
    Scale(scale::ScaleArgs),
    /// How long the agent's whole frame takes, stage by stage
    Bench(bench::BenchArgs),
    /// One robot's eye on rendered scenes with truth: meetings, the seam, light, turns, ranges
    Motion(motion::MotionArgs),
    /// Weights with which agents tell bodies from shadows, learnt from rendered rooms
    Shadows(shadows::ShadowsArgs),
    /// Faults on purpose: what is lost, and how long until the map is right again
    Chaos(chaos::ChaosArgs),
    /// The same room through every camera, with its panorama
    Zoo(zoo::ZooArgs),
}

fn main() -> ExitCode {
    protocol::closed_pipe::end_quietly();
    tracing_subscriber::fmt()
        .with_env_filter(
            tracing_subscriber::EnvFilter::try_from_default_env()
                .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn,zenoh=error")),
        )
        .with_writer(std::io::stderr)
        .init();
    ExitCode::from(match Cli::parse().command {
        None => demo::run(&demo::DemoArgs::default()),
        Some(Command::Demo(args)) => demo::run(&args),
        Some(Command::Run(args)) => run::run(&args),
        Some(Command::Record(args)) => record::run(&args),
        Some(Command::Replay(args)) => replay::run(&args),
        Some(Command::Bandwidth(args)) => bandwidth::run(&args),
        Some(Command::Efficiency(args)) => efficiency::run(&args),
        Some(Command::Guidance(args)) => guidance::run(&args),
        Some(Command::Peers(args)) => peers::run(&args),
        Some(Command::Verdict(args)) => peers::run_verdict(&args),
        Some(Command::Baseline(args)) => baseline::run(&args),
        Some(Command::Score(args)) => score::run(&args),
        Some(Command::Scale(args)) => scale::run(&args),
        Some(Command::Bench(args)) => bench::run(&args),
        Some(Command::Motion(args)) => motion::run(&args),
        Some(Command::Shadows(args)) => shadows::run(&args),
        Some(Command::Chaos(args)) => chaos::run(&args),
        Some(Command::Zoo(args)) => zoo::run(&args),
    })
}
