//! What a command says on standard output and in its help.

use std::io::{self, Write};

use crate::scenario::Scenario;

/// Standard output cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write to standard output: {0}")]
pub(super) struct Unprinted(io::Error);

/// Prints the result of a command; gives the exit code: `code`, or 1 where standard output cannot be written. A reader that has
/// seen enough (`| head`) is no fault.
#[allow(clippy::print_stderr)]
pub(super) fn tell(command: &str, text: &str, code: u8) -> u8 {
    match print(text) {
        Ok(_) => code,
        Err(error) => {
            eprintln!("sim-harness {command}: {error}");
            1
        }
    }
}

/// Prints a text and a line's end; `false` if nobody reads any more.
pub(super) fn print(text: &str) -> Result<bool, Unprinted> {
    print_to(&mut io::stdout().lock(), text)
}

fn print_to(output: &mut impl Write, text: &str) -> Result<bool, Unprinted> {
    match writeln!(output, "{}", text.trim_end()).and_then(|()| output.flush()) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(false),
        Err(error) => Err(Unprinted(error)),
    }
}

/// Help of an argument that names a scenario.
pub(super) fn scenario_help() -> String {
    format!("A scenario file, or the name of a scenario inside the program: {}", Scenario::BUILTIN.join(", "))
}

/// Says that a scenario is shorter than what is wanted of it.
#[allow(clippy::print_stderr)]
pub(super) fn note_short(command: &str, wanted_s: Option<f64>, scenario: &Scenario) {
    if let Some(note) = short(wanted_s, scenario) {
        eprintln!("sim-harness {command}: {note}");
    }
}

fn short(wanted_s: Option<f64>, scenario: &Scenario) -> Option<String> {
    let wanted_s = wanted_s.filter(|wanted_s| *wanted_s > scenario.duration_s)?;
    Some(format!("--duration {wanted_s}: the scenario {} ends after {} s", scenario.name, scenario.duration_s))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails as it is told.
    struct Broken(io::ErrorKind);

    impl Write for Broken {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(self.0.into())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_full_disk_is_an_error_and_a_reader_that_has_gone_is_none() {
        let mut output = Vec::new();
        assert!(print_to(&mut output, "a\nb\n\n").unwrap());
        assert_eq!(output, b"a\nb\n");
        let error = print_to(&mut Broken(io::ErrorKind::StorageFull), "a").unwrap_err().to_string();
        assert!(error.contains("standard output") && error.contains("storage"), "{error}");
        assert!(!print_to(&mut Broken(io::ErrorKind::BrokenPipe), "a").unwrap());
    }

    #[test]
    fn a_duration_beyond_the_scenarios_end_is_remarked() {
        let tiny = Scenario::builtin("tiny").unwrap().unwrap();
        let note = short(Some(100.0), &tiny).unwrap();
        assert!(note.contains("--duration 100") && note.contains("tiny") && note.contains("5 s"), "{note}");
        assert!(short(Some(5.0), &tiny).is_none() && short(None, &tiny).is_none());
    }
}
