//! A robot's process: the session of a robot that sees a room, and does on request what robots should not.

use std::io::BufRead;

use clap::Args;
use tokio::sync::watch;

use super::{SEED, failed};
use crate::scale::room::Room;
use crate::scale::sender::{self, Conduct};
use crate::team::{self, TeamError};

/// Observations a second.
const RATE_HZ: f64 = 10.0;

/// Arguments of the process.
#[derive(Debug, Clone, Args)]
pub struct RobotArgs {
    /// A robot's process: which robot of the room. Not for people
    #[arg(long, hide = true)]
    pub as_robot: Option<usize>,
    /// The leaders' endpoints
    #[arg(long, hide = true, value_delimiter = ',')]
    pub leaders: Vec<String>,
}

/// Works until its input ends. Lines of input: `step SECONDS` sets the clock, `copies N` sends each observation so often.
///
/// # Errors
/// No session.
pub fn run(robot: usize, leaders: &[String]) -> Result<(), TeamError> {
    let runtime = team::runtime()?;
    let (conduct, watched) = watch::channel(Conduct::default());
    runtime.block_on(async {
        let team = "chaos".parse()?;
        let sender = sender::start(team, Room::new(0, SEED), robot, RATE_HZ, leaders, watched).await?;
        let reading = tokio::task::spawn_blocking(move || {
            for line in std::io::stdin().lock().lines().map_while(Result::ok) {
                conduct.send_modify(|conduct| {
                    if let Err(error) = conduct.obey(&line) {
                        tracing::error!("{error}");
                    }
                });
            }
            conduct.send_modify(|conduct| conduct.stopped = true);
        });
        reading.await.map_err(failed)?;
        sender.await.map_err(failed)?;
        Ok(())
    })
}
