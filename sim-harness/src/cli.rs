//! The subcommands of the program, one a file: arguments and what they do.

pub mod bandwidth;
pub mod baseline;
pub mod bench;
pub mod chaos;
pub mod demo;
pub mod efficiency;
pub mod guidance;
pub mod motion;
pub mod peers;
pub mod record;
mod recorded_text;
pub mod replay;
pub mod run;
pub mod scale;
pub mod score;
pub mod seeds;
pub mod shadows;
pub mod table;
mod told;
pub mod zoo;
