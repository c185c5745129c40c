//! The subcommands of the program, one a file: arguments and what they do.

pub mod bandwidth;
pub mod demo;
pub mod record;
pub mod replay;
pub mod run;
pub mod seeds;
pub mod table;
pub mod zoo;
