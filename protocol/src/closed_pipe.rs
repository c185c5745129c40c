//! `… | head`: a reader of the output that has seen enough is no fault.
//!
//! `println!` panics when its pipe is closed. (The signal that would end other programs is ignored in Rust's, and must be: the
//! services write to sockets that others close.)

/// Exit code of a program whose reader has seen enough.
const SEEN_ENOUGH: i32 = 0;

/// From now on a closed standard output ends the program quietly. Call it once, first.
pub fn end_quietly() {
    let report = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let said = panic.payload().downcast_ref::<String>();
        if said.is_some_and(|text| text.starts_with("failed printing to stdout") && text.contains("Broken pipe")) {
            std::process::exit(SEEN_ENOUGH);
        }
        report(panic);
    }));
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead, BufReader};
    use std::process::{Command, Stdio};

    /// Not a test: what the test below starts, this very program again.
    #[test]
    #[ignore = "started by the test below"]
    #[allow(clippy::print_stdout)]
    fn prints_without_end() {
        super::end_quietly();
        for line in 0..1_000_000 {
            println!("line {line}");
        }
        std::process::exit(3);
    }

    #[test]
    fn a_program_whose_reader_goes_ends_quietly_and_well() {
        let mut program = Command::new(std::env::current_exe().unwrap())
            .args(["--ignored", "--exact", "closed_pipe::tests::prints_without_end", "--nocapture"])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // The test runner's own words come first, and it minds a closed pipe.
        let mut output = BufReader::new(program.stdout.take().unwrap()).lines();
        assert!(output.any(|line| line.unwrap().starts_with("line ")));
        drop(output);
        let ended = program.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&ended.stderr);
        assert!(ended.status.code() == Some(0) && said.is_empty(), "{:?}: {said}", ended.status);
    }
}
