//! `robot-agent track`.

use super::Failure;

/// Offline: frames in, one JSON line a frame out.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {}

/// Runs the command.
pub(super) fn execute(_arguments: &Arguments) -> Result<(), Failure> {
    Err(Failure::job("`track` is not built yet"))
}
