//! `team-leader plan`: where the robots should stand.

use std::io::Write;
use std::path::PathBuf;

use clap::Args;

use super::solve::{Format, read};
use super::{failure, output, usage_error};
use crate::planning::{Plan, PlanProblem, plan};

/// Arguments of `plan`.
#[derive(Debug, Clone, Args)]
pub struct PlanArgs {
    /// Robots, targets, free space as JSON ("-" reads standard input).
    pub input: PathBuf,
    /// Format of the result.
    #[arg(long, value_enum, default_value_t = Format::Json)]
    pub format: Format,
}

/// Runs it; the exit code: 0 fine, 1 no place is allowed, 2 usage error.
pub fn run(args: &PlanArgs) -> u8 {
    let name = args.input.display();
    let problem = match read(&args.input) {
        Ok(text) => PlanProblem::parse(&text).map_err(|e| format!("{name}: {e}")),
        Err(e) => Err(format!("{name}: {e}")),
    };
    let problem = match problem {
        Ok(problem) => problem,
        Err(error) => return usage_error(&error, args.format),
    };
    let Some(best) = plan(&problem) else {
        let why = "no place within reach is free, sees all targets and robots, and determines the targets";
        return failure(&why, args.format);
    };
    output(0, |out| print(&best, args.format, out))
}

fn print(plan: &Plan, format: Format, out: &mut impl Write) -> std::io::Result<()> {
    if format == Format::Json {
        serde_json::to_writer(&mut *out, plan)?;
        return writeln!(out);
    }
    let here = plan.error_here_m.map_or_else(|| "not determined".to_owned(), |e| format!("{e:.4} m"));
    writeln!(out, "expected error of the targets: {here} here, {:.4} m there", plan.error_there_m)?;
    for r in &plan.robots {
        writeln!(out, "robot  {:<16} to {:8.3} {:8.3} m, {:.2} m away", r.id, r.x_m, r.y_m, r.travel_m)?;
    }
    for t in &plan.targets {
        writeln!(out, "target {:<16} expected to {:.4} m", t.id, t.rms_m)?;
    }
    Ok(())
}
