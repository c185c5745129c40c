//! Subcommands of the `team-leader` program, one a file.

pub mod solve;
