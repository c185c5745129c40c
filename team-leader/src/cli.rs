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
use std::io::{self, ErrorKind, StdoutLock, Write};

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
        let json = serde_json::json!({ "ok": false, "error": error.to_string() });
        // The job has failed, whatever comes of this.
        output(1, |out| writeln!(out, "{json}"));
    }
    tell(error);
}

/// Writes to standard output what a command has found; the exit code as in [`written`]. All commands write by this.
fn output(code: u8, write: impl FnOnce(&mut StdoutLock<'_>) -> io::Result<()>) -> u8 {
    let mut out = io::stdout().lock();
    let done = write(&mut out).and_then(|()| out.flush());
    written(code, done)
}

/// The exit code of a command whose own is `code`: a full disk is a failed job and is said; a reader who has seen enough
/// (`| head`) is no fault.
fn written(code: u8, done: io::Result<()>) -> u8 {
    match done {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            tell(&format!("cannot write to standard output: {error}"));
            code.max(1)
        }
        _ => code,
    }
}

/// Says to people what is wrong.
fn tell(error: &dyn Display) {
    // Nobody is left to tell if standard error is closed.
    let _ = writeln!(io::stderr(), "error: {error}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_fails_the_command_and_a_reader_who_has_gone_does_not() {
        let failed = |kind: ErrorKind| Err(io::Error::from(kind));
        assert_eq!(written(0, Ok(())), 0);
        assert_eq!(written(0, failed(ErrorKind::StorageFull)), 1);
        assert_eq!(written(2, failed(ErrorKind::StorageFull)), 2);
        assert_eq!(written(0, failed(ErrorKind::BrokenPipe)), 0);
        assert_eq!(written(1, failed(ErrorKind::BrokenPipe)), 1);
    }
}
