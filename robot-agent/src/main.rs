//! Command line of the agent.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    protocol::closed_pipe::end_quietly();
    cli::main()
}
