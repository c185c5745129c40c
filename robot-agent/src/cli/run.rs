//! `robot-agent run`.

use super::Failure;

/// The service: frames in, observations out over Zenoh, until it is stopped.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {}

/// Runs the command.
pub(super) fn execute(_arguments: &Arguments) -> Result<(), Failure> {
    Err(Failure::job("`run` is not built yet"))
}
