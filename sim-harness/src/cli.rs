//! The subcommands of the program, one a file: arguments and what they do.

pub mod record;
