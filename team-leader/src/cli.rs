//! Subcommands of the `team-leader` program, one a file.

pub mod check;
pub mod doctor;
pub mod outside;
pub mod plan;
pub mod provision;
pub mod query;
pub mod run;
pub mod solve;

use std::fmt::Display;
use std::io::Write;

use solve::Format;

/// Reports an error of usage or configuration; its exit code, 2.
fn usage_error(error: &dyn Display, format: Format) -> u8 {
    report(error, format);
    2
}

/// Reports that the job failed; its exit code, 1.
fn failure(error: &dyn Display, format: Format) -> u8 {
    report(error, format);
    1
}

fn report(error: &dyn Display, format: Format) {
    if format == Format::Json {
        println!("{}", serde_json::json!({ "ok": false, "error": error.to_string() }));
    }
    // Nobody is left to tell if standard error is closed.
    let _ = writeln!(std::io::stderr(), "error: {error}");
}
