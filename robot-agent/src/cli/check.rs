//! `robot-agent check`.

use super::Failure;

/// Validates a configuration and says what is wrong, without starting.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {}

/// Runs the command.
pub(super) fn execute(_arguments: &Arguments) -> Result<(), Failure> {
    Err(Failure::job("`check` is not built yet"))
}
