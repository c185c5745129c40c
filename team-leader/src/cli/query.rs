//! `team-leader query`: asks a running team by key, as any outsider could.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use clap::{Args, Subcommand};
use protocol::id::{NameError, RobotId, TeamId};
use protocol::key::{Key, RobotTopic};
use protocol::message::{Command, CommandReply, PictureKind};
use protocol::transport::{AskError, AskedMapJson, AskedPicture, CLOSE_LIMIT, Options, Transport, TransportError};

use super::outside::Outside;
use super::solve::Format;

/// Time for the answer.
const ANSWER_LIMIT: Duration = Duration::from_secs(5);

/// Arguments of `query`.
#[derive(Debug, Clone, Args)]
pub struct QueryArgs {
    /// How to reach the team.
    #[command(flatten)]
    pub outside: Outside,
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Clone, Subcommand)]
enum What {
    /// The team map, as JSON.
    Map,
    /// A picture of a robot.
    Picture {
        /// The robot.
        robot: String,
        /// panorama, objects, gaze, synopsis, tracks or background.
        kind: String,
        /// Where to write it (JPEG or PNG, as the robot sends it).
        #[arg(long)]
        out: PathBuf,
    },
    /// A command to a robot, answered as JSON.
    Command {
        /// The robot.
        robot: String,
        /// What to do.
        #[command(subcommand)]
        command: Word,
    },
}

#[derive(Debug, Clone, Copy, Subcommand)]
enum Word {
    /// Say how you are.
    Status,
    /// Start the background anew.
    RestartBackground,
    /// Forget all tracks.
    ResetTracks,
    /// Work on at most this many frames a second.
    SetFrameRate {
        /// 1/64 to 120.
        rate_hz: f32,
    },
    /// Stop publishing observations.
    Pause,
    /// Go on.
    Resume,
}

#[derive(Debug, thiserror::Error)]
enum QueryError {
    #[error("{0}")]
    Name(#[from] NameError),
    #[error("{0}")]
    Picture(#[from] protocol::message::picture::UnknownPicture),
    #[error(transparent)]
    Transport(#[from] TransportError),
    #[error(transparent)]
    Ask(#[from] AskError),
    #[error("{}: cannot be written: {source}", path.display())]
    Write { path: PathBuf, source: std::io::Error },
    #[error("refused: {0}")]
    Refused(String),
}

/// Asks; the exit code: 0 answered, 1 not answered, 2 a wrong configuration or name.
pub fn run(args: &QueryArgs) -> u8 {
    let (team, options) = match args.outside.options() {
        Ok(reached) => reached,
        Err(error) => return super::usage_error(&error, Format::Text),
    };
    let runtime = match tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return super::failure(&error, Format::Text),
    };
    let asked = runtime.block_on(ask(team, options, &args.what));
    runtime.shutdown_timeout(CLOSE_LIMIT);
    match asked {
        Ok(text) => super::output(0, |out| writeln!(out, "{text}")),
        Err(error @ (QueryError::Name(_) | QueryError::Picture(_))) => super::usage_error(&error, Format::Text),
        Err(error) => super::failure(&error, Format::Text),
    }
}

async fn ask(team: TeamId, options: Options, what: &What) -> Result<String, QueryError> {
    let transport = Transport::open(options).await?;
    let answered = answer(&transport, team, what).await;
    transport.close().await?;
    answered
}

/// What to print.
async fn answer(transport: &Transport, team: TeamId, what: &What) -> Result<String, QueryError> {
    Ok(match what {
        What::Map => {
            transport.ask_ruler(Key::map_json(team), &AskedMapJson, ANSWER_LIMIT, |map| term_of(map)).await?.answer
        }
        What::Picture { robot, kind, out } => {
            let (robot, kind): (RobotId, PictureKind) = (robot.parse()?, kind.parse()?);
            let key = Key::robot(team, robot, RobotTopic::Picture(kind));
            let picture = transport.ask(key, &AskedPicture(kind), ANSWER_LIMIT).await?.answer;
            write(out, &picture.0)?;
            format!("{}: {} bytes", out.display(), picture.0.len())
        }
        What::Command { robot, command } => {
            let key = Key::robot(team, robot.parse()?, RobotTopic::Command);
            let reply = transport.ask(key, &Command::from(*command), ANSWER_LIMIT).await?.answer;
            in_words(reply)?
        }
    })
}

/// The term in a map as JSON.
fn term_of(map: &str) -> u64 {
    serde_json::from_str::<serde_json::Value>(map).ok().and_then(|map| map["term"].as_u64()).unwrap_or(0)
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), QueryError> {
    std::fs::write(path, bytes).map_err(|source| QueryError::Write { path: path.to_owned(), source })
}

fn in_words(reply: CommandReply) -> Result<String, QueryError> {
    Ok(match reply {
        CommandReply::Done => serde_json::json!({ "reply": "done" }),
        CommandReply::Refused(why) => return Err(QueryError::Refused(why)),
        CommandReply::Status { epoch, frames, background_ready, paused, tracks, peers } => serde_json::json!({
            "reply": "status", "epoch": epoch, "frames": frames, "background_ready": background_ready,
            "paused": paused, "tracks": tracks, "peers": peers,
        }),
    }
    .to_string())
}

impl From<Word> for Command {
    fn from(word: Word) -> Self {
        match word {
            Word::Status => Self::Status,
            Word::RestartBackground => Self::RestartBackground,
            Word::ResetTracks => Self::ResetTracks,
            Word::SetFrameRate { rate_hz } => Self::SetFrameRate(rate_hz),
            Word::Pause => Self::Pause,
            Word::Resume => Self::Resume,
        }
    }
}
