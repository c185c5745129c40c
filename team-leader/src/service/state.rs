//! What outlives the program: the last map (places, gauge, numbers of targets, term), and the record of alarms.
//!
//! ```text
//! {state_dir}/{team}.map            the last map as an envelope of the wire; written whole, then renamed
//! {state_dir}/{team}.alarms.jsonl   one line an alarm, each once; the older half in {team}.alarms.1.jsonl
//! ```
//! A thread of its own writes, so that a slow or full disk delays nothing; what it cannot write is said once and counted.

use std::fs::{self, File, OpenOptions};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use protocol::codec::{self, Kind};
use protocol::folder;
use protocol::id::TeamId;
use protocol::message::{Alarm, TeamMap};
use protocol::time::Timestamp;
use protocol::whole_file;
use serde::{Deserialize, Serialize};

use crate::leader::Leader;

/// Between two saved maps; a new term is saved at once.
const SAVE_PERIOD: Duration = Duration::from_secs(1);
/// Lines of the record before its older half is thrown away.
const MAX_RECORD_LINES: usize = 10_000;
/// Longest line of the record that is read, bytes.
const MAX_LINE: usize = 1024;
/// Things that may wait for the disk; more are dropped and counted.
const MAX_WAITING: usize = 256;

/// Why state cannot be kept.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// The folder.
    #[error("[leader] state_dir {path}: {source}; give a folder that this program may write to", path = path.display())]
    Folder {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// A folder that can be written to.
#[derive(Debug, Clone)]
pub struct StateDir {
    folder: PathBuf,
    team: TeamId,
}

impl StateDir {
    /// Makes the folder if it is not there, and tries it.
    ///
    /// # Errors
    /// It cannot be made or written to.
    pub fn open(path: &Path, team: TeamId) -> Result<Self, StateError> {
        folder::make_writable(path).map_err(|source| StateError::Folder { path: path.to_owned(), source })?;
        Ok(Self { folder: path.to_owned(), team })
    }

    /// Whether state could be kept in this folder; leaves nothing there.
    ///
    /// # Errors
    /// It cannot be made or written to.
    pub fn check(path: &Path) -> Result<(), StateError> {
        folder::could_be_written(path).map_err(|source| StateError::Folder { path: path.to_owned(), source })
    }

    /// The last saved map; `None` where there is none. One that cannot be read is put aside, and said.
    fn load(&self, notices: &mut Vec<String>) -> Option<TeamMap> {
        let path = self.file("map");
        let read = match fs::metadata(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return None,
            Err(error) => Err(error.to_string()),
            Ok(about) if about.len() > Kind::TeamMap.max_bytes() as u64 => Err(format!("{} bytes", about.len())),
            Ok(_) => fs::read(&path).map_err(|error| error.to_string()),
        };
        match read.and_then(|bytes| codec::decode::<TeamMap>(&bytes).map_err(|error| error.to_string())) {
            Ok(map) => Some(map),
            Err(why) => {
                let aside = self.file("map.bad");
                // What cannot be put aside is overwritten by the next save.
                let _ = fs::rename(&path, &aside);
                notices.push(format!(
                    "{}: cannot be used ({why}) and is put aside as {}; the team begins anew",
                    path.display(),
                    aside.display()
                ));
                None
            }
        }
    }

    fn save(&self, map: &TeamMap) -> Result<(), String> {
        let envelope = codec::encode(map).map_err(|error| error.to_string())?;
        let path = self.file("map");
        whole_file::replace(&path, &envelope, whole_file::ORDINARY)
            .map_err(|error| format!("{}: {error}", path.display()))
    }

    fn append(&self, line: &Line, lines: &mut usize) -> Result<(), String> {
        let path = self.file("alarms.jsonl");
        let text = serde_json::to_string(line).map_err(|error| error.to_string())?;
        let mut write = || {
            if *lines >= MAX_RECORD_LINES {
                fs::rename(&path, self.file("alarms.1.jsonl"))?;
                *lines = 0;
            }
            let mut file = OpenOptions::new().create(true).append(true).open(&path)?;
            file.write_all(format!("{text}\n").as_bytes())?;
            *lines += 1;
            Ok(())
        };
        write().map_err(|error: std::io::Error| format!("{}: {error}", path.display()))
    }

    /// Every line of the record that can be read; a torn last one is left out. Also how many the newer file has.
    fn recorded(&self) -> (Vec<Line>, usize) {
        let mut lines = Vec::new();
        let mut newer = 0;
        for name in ["alarms.1.jsonl", "alarms.jsonl"] {
            newer = 0;
            let Ok(file) = File::open(self.file(name)) else { continue };
            for text in BufReader::new(file).lines().take(2 * MAX_RECORD_LINES).map_while(Result::ok) {
                newer += 1;
                lines.extend((text.len() <= MAX_LINE).then(|| serde_json::from_str(&text).ok()).flatten());
            }
        }
        (lines, newer)
    }

    fn file(&self, ending: &str) -> PathBuf {
        self.folder.join(format!("{}.{ending}", self.team))
    }
}

/// A line of the record.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Line {
    robot: String,
    epoch: u64,
    number: u32,
    /// Robot's clock, seconds since 1970.
    time_s: f64,
    what: String,
}

enum Job {
    Map(Box<TeamMap>),
    Alarm(Line),
}

/// Writes what must be kept.
#[derive(Debug)]
pub struct Keeper {
    jobs: SyncSender<Job>,
    saved: Option<(Instant, u64)>,
    dropped: u64,
}

impl Keeper {
    /// Gives the leader what was kept, and keeps from now on. Also says what cannot be used.
    pub fn start(dir: StateDir, now: Timestamp, leader: &mut Leader) -> (Self, Vec<String>) {
        let mut notices = Vec::new();
        if let Some(map) = dir.load(&mut notices) {
            tracing::info!("going on from term {} of {}", map.term, dir.file("map").display());
            let mut outputs = Vec::new();
            leader.resume(now, &map, &mut outputs);
        }
        let (recorded, lines) = dir.recorded();
        for line in recorded {
            if let Ok(robot) = line.robot.parse() {
                leader.alarm_is_known(robot, line.epoch, line.number);
            }
        }
        let (jobs, work) = sync_channel(MAX_WAITING);
        let started = std::thread::Builder::new().name("state".to_owned()).spawn(move || write(&dir, &work, lines));
        if let Err(error) = started {
            notices.push(format!("nothing is kept for a restart: no thread can be started: {error}"));
        }
        (Self { jobs, saved: None, dropped: 0 }, notices)
    }

    /// Saves the map, at most once in [`SAVE_PERIOD`] and a term.
    pub fn keep(&mut self, map: &TeamMap, highest_term: u64) {
        if self.saved.is_some_and(|(at, term)| at.elapsed() < SAVE_PERIOD && term == highest_term) {
            return;
        }
        self.saved = Some((Instant::now(), highest_term));
        let mut map = map.clone();
        map.term = map.term.max(highest_term);
        self.give(Job::Map(Box::new(map)));
    }

    /// Records an alarm.
    pub fn record(&mut self, alarm: &Alarm) {
        self.give(Job::Alarm(Line {
            robot: alarm.robot.to_string(),
            epoch: alarm.epoch,
            number: alarm.number,
            time_s: alarm.at.as_secs_f64(),
            what: alarm.kind.to_string(),
        }));
    }

    fn give(&mut self, job: Job) {
        if self.jobs.try_send(job).is_err() {
            self.dropped += 1;
            if self.dropped == 1 {
                tracing::error!("the disk is too slow: what was to be kept for a restart is dropped");
            }
        }
    }
}

fn write(dir: &StateDir, work: &Receiver<Job>, mut lines: usize) {
    let mut told = false;
    while let Ok(job) = work.recv() {
        let written = match job {
            Job::Map(map) => dir.save(&map),
            Job::Alarm(line) => dir.append(&line, &mut lines),
        };
        match written {
            Err(why) if !told => {
                tracing::error!("{why}; nothing is kept for a restart until this works again");
                told = true;
            }
            Err(_) => {}
            Ok(()) => told = false,
        }
    }
}

#[cfg(test)]
mod tests;
