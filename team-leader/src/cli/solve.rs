//! `team-leader solve`: poses and targets from bearings in a file, offline.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use crate::solve::input::Problem;
use crate::solve::output::Solution;
use crate::solve::sequence::Sequence;
use crate::solve::{self, SolveError};
use protocol::estimate::SolveStatus;

/// Longest problem or line of a sequence, bytes.
const MAX_INPUT: u64 = 64 << 20;

/// Arguments of `solve`.
#[derive(Debug, Clone, Args)]
pub struct SolveArgs {
    /// One problem as JSON ("-" reads standard input).
    #[arg(required_unless_present = "sequence", conflicts_with = "sequence")]
    pub input: Option<PathBuf>,
    /// A file with one problem a line, each with `time_s`: runs the whole pipeline over time, one map a line.
    #[arg(long)]
    pub sequence: Option<PathBuf>,
    /// How to solve.
    #[arg(long, value_enum, default_value_t = Method::Joint)]
    pub method: Method,
    /// Say where each target's error comes from: baselines, bearings, clocks, with sensitivities and the Cramér–Rao bound.
    #[arg(long, conflicts_with_all = ["sequence", "method"])]
    pub explain: bool,
    /// Format of the result.
    #[arg(long, value_enum, default_value_t = Format::Json)]
    pub format: Format,
}

/// How to solve.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Method {
    /// Joint maximum likelihood over everything.
    Joint,
    /// The report's corrected formulas alone.
    ClosedForm,
}

/// Format of the result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// For programs.
    Json,
    /// For people.
    Text,
}

/// Why `solve` ends without a result.
#[derive(Debug, thiserror::Error)]
enum Failure {
    #[error("{0}: {1}")]
    Io(String, std::io::Error),
    #[error("{0}: {1}")]
    Input(String, SolveError),
    #[error("{0}: has no line; one problem a line, each with `time_s`, would be right")]
    NoLine(String),
    #[error("cannot write to standard output: {0}")]
    Output(std::io::Error),
    #[error("--method closed-form solves one problem; --sequence runs the whole pipeline")]
    Method,
}

/// Runs it; the exit code: 0 fine, 1 the job failed, 2 usage error. A problem without a solution is a result: its status
/// says so, and the code is 1.
pub fn run(args: &SolveArgs) -> u8 {
    match work(args) {
        Ok(true) => 0,
        Ok(false) => 1,
        Err(Failure::Output(error)) => super::written(0, Err(error)),
        Err(failure) => super::usage_error(&failure, Format::Text),
    }
}

fn work(args: &SolveArgs) -> Result<bool, Failure> {
    let mut out = std::io::stdout().lock();
    if let Some(path) = &args.sequence {
        if args.method == Method::ClosedForm {
            return Err(Failure::Method);
        }
        return run_sequence(path, args.format, &mut out);
    }
    let Some(path) = &args.input else { return Err(Failure::Method) };
    let name = path.display().to_string();
    let text = read(path).map_err(|e| Failure::Io(name.clone(), e))?;
    let problem = Problem::parse(&text).map_err(|e| Failure::Input(name, e))?;
    let solution = match args.method {
        Method::Joint if args.explain => solve::solve_and_explain(problem),
        Method::Joint => solve::solve(problem),
        Method::ClosedForm => solve::closed_form::solve(problem),
    };
    match args.format {
        Format::Json => {
            serde_json::to_writer(&mut out, &solution).map_err(|e| Failure::Output(e.into()))?;
            writeln!(out).map_err(Failure::Output)?;
        }
        Format::Text => print(&solution, &mut out).map_err(Failure::Output)?,
    }
    Ok(solution.status == SolveStatus::Converged)
}

pub(super) fn read(path: &Path) -> std::io::Result<String> {
    let mut text = String::new();
    let read = if path.as_os_str() == "-" {
        std::io::stdin().take(MAX_INPUT + 1).read_to_string(&mut text)?
    } else {
        File::open(path)?.take(MAX_INPUT + 1).read_to_string(&mut text)?
    };
    if read as u64 > MAX_INPUT {
        let why = format!("longer than {} MiB", MAX_INPUT >> 20);
        return Err(std::io::Error::new(std::io::ErrorKind::FileTooLarge, why));
    }
    Ok(text)
}

fn run_sequence(path: &Path, format: Format, out: &mut impl Write) -> Result<bool, Failure> {
    let name = path.display().to_string();
    let file = File::open(path).map_err(|e| Failure::Io(name.clone(), e))?;
    let (mut sequence, mut is_empty) = (Sequence::new(), true);
    for line in BufReader::new(file).lines() {
        let line = line.map_err(|e| Failure::Io(name.clone(), e))?;
        if line.trim().is_empty() {
            sequence.skip_line();
            continue;
        }
        is_empty = false;
        let map = sequence.line(&line);
        for notice in sequence.take_notices() {
            tracing::warn!("{name}: {notice}");
        }
        let map = map.map_err(|e| Failure::Input(name.clone(), e))?;
        match format {
            Format::Json => {
                serde_json::to_writer(&mut *out, &map).map_err(|e| Failure::Output(e.into()))?;
                writeln!(out).map_err(Failure::Output)?;
            }
            Format::Text => {
                let placed = map.robots.iter().filter(|r| r.x_m.is_some()).count();
                writeln!(
                    out,
                    "{:10.3} s  {:<12} {placed} robots placed, {} targets  {}",
                    map.time_s,
                    map.status,
                    map.targets.len(),
                    map.explanation
                )
                .map_err(Failure::Output)?;
            }
        }
    }
    if is_empty { Err(Failure::NoLine(name)) } else { Ok(true) }
}

fn print(solution: &Solution, out: &mut impl Write) -> std::io::Result<()> {
    writeln!(out, "{:?}: {}", solution.status, solution.explanation)?;
    let sigma = |c: &Option<[[f64; 3]; 3]>, k: usize| c.map_or(f64::INFINITY, |c| c[k][k].max(0.0).sqrt());
    for r in &solution.robots {
        writeln!(
            out,
            "robot  {:<16} {:9.4} {:9.4} m {:9.3}°   ± {:.4} {:.4} m {:.3}°",
            r.id,
            r.x_m,
            r.y_m,
            r.heading_deg,
            sigma(&r.covariance, 0),
            sigma(&r.covariance, 1),
            sigma(&r.covariance, 2).to_degrees()
        )?;
    }
    for t in &solution.targets {
        let z = t.z_m.map_or_else(|| "        -".to_owned(), |z| format!("{z:9.4}"));
        writeln!(
            out,
            "target {:<16} {:9.4} {:9.4} {z} m   ± {:.4} {:.4} m   seen by {}",
            t.id,
            t.x_m,
            t.y_m,
            sigma(&t.covariance, 0),
            sigma(&t.covariance, 1),
            t.observers.join(", ")
        )?;
    }
    for (label, lines) in
        [("undetermined", &solution.undetermined), ("would cure it", &solution.cures), ("warning", &solution.warnings)]
    {
        for line in lines {
            writeln!(out, "{label}: {line}")?;
        }
    }
    for e in &solution.explained {
        let at = e.time_s.map_or_else(String::new, |t| format!(" at {t:.2} s"));
        writeln!(out, "{}{at}: {:.4} m RMS, Cramér–Rao bound {:.4} m, of which", e.target, e.rms_m, e.bound_m)?;
        let per = |v: Option<f64>, unit: &str| v.map_or_else(String::new, |v| format!("  {v:.4} m/{unit}"));
        for p in &e.parts {
            writeln!(
                out,
                "  {:5.1} %  {:.4} m  {:<32}{}{}{}{}{}",
                100.0 * p.share,
                p.rms_m,
                p.source,
                p.probability.map_or_else(String::new, |p| format!("  wrong with {:.2} %", 100.0 * p)),
                per(p.m_per_px, "px"),
                per(p.m_per_deg, "°"),
                per(p.m_per_m, "m"),
                per(p.m_per_ms, "ms")
            )?;
        }
    }
    writeln!(
        out,
        "χ² {:.2} for {} degrees of freedom; known least: {}",
        solution.chi2, solution.dof, solution.weakest_direction
    )
}
