//! Alarms outlive the agent: what it raised before a restart, and perhaps nobody heard, is published again.
//!
//! ```text
//! {state_dir}/{robot}.alarms        one line an alarm: its envelope of the wire, hexadecimal; the last 256 to 512
//! ```
//! They keep their session and number, by which leaders tell what they had. A thread of its own writes, so that a slow or full
//! disk costs no frame; what it cannot write is said once.

use std::fs::{self, File, OpenOptions};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use protocol::codec;
use protocol::folder;
use protocol::id::RobotId;
use protocol::message::Alarm;
use protocol::whole_file;

/// Alarms that are kept.
pub const MAX_KEPT: usize = 256;
/// Alarms that are published again after a restart: as many as are kept for late joiners.
pub const MAX_TOLD_AGAIN: usize = 64;
/// Longest line, bytes.
const MAX_LINE: usize = 2048;
/// Alarms that may wait for the disk.
const MAX_WAITING: usize = 256;

/// Why alarms cannot be kept.
#[derive(Debug, thiserror::Error)]
#[error("[robot] state_dir {path}: {source}; give a folder that this program may write to", path = path.display())]
pub struct JournalError {
    /// Which.
    path: PathBuf,
    /// Why.
    source: std::io::Error,
}

/// The journal of one robot.
#[derive(Debug)]
pub struct Journal {
    jobs: SyncSender<Alarm>,
    before: Vec<Alarm>,
    told: bool,
}

impl Journal {
    /// Opens the journal, and makes the folder if it is not there.
    ///
    /// # Errors
    /// It cannot be read or written.
    pub fn open(folder: &Path, robot: RobotId) -> Result<Self, JournalError> {
        let path = folder.join(format!("{robot}.alarms"));
        let failed = |source| JournalError { path: folder.to_owned(), source };
        fs::create_dir_all(folder).map_err(failed)?;
        let mut kept = read(&path).map_err(failed)?;
        kept.drain(..kept.len().saturating_sub(MAX_KEPT));
        // Also throws away a torn last line, to which the next one would be appended.
        rewrite(&path, &kept).map_err(failed)?;
        let before = kept[kept.len().saturating_sub(MAX_TOLD_AGAIN)..].to_vec();
        let (jobs, work) = sync_channel(MAX_WAITING);
        std::thread::Builder::new()
            .name("journal".to_owned())
            .spawn(move || write(&path, kept, &work))
            .map_err(failed)?;
        Ok(Self { jobs, before, told: false })
    }

    /// Whether a journal could be kept in this folder; leaves nothing there.
    ///
    /// # Errors
    /// It cannot be made or written.
    pub fn check(path: &Path) -> Result<(), JournalError> {
        folder::could_be_written(path).map_err(|source| JournalError { path: path.to_owned(), source })
    }

    /// What was raised before this start, oldest first; once.
    pub fn take_before(&mut self) -> Vec<Alarm> {
        std::mem::take(&mut self.before)
    }

    /// Keeps an alarm.
    pub fn keep(&mut self, alarm: &Alarm) {
        if self.jobs.try_send(alarm.clone()).is_err() && !std::mem::replace(&mut self.told, true) {
            tracing::error!("the disk is too slow: an alarm would not outlive a restart");
        }
    }
}

fn write(path: &Path, mut kept: Vec<Alarm>, work: &Receiver<Alarm>) {
    let mut told = false;
    while let Ok(alarm) = work.recv() {
        kept.push(alarm);
        let written = if kept.len() > 2 * MAX_KEPT {
            kept.drain(..kept.len() - MAX_KEPT);
            rewrite(path, &kept)
        } else {
            append(path, &kept[kept.len() - 1..])
        };
        if let Err(error) = &written
            && !told
        {
            tracing::error!("{}: {error}; alarms do not outlive a restart until this works again", path.display());
        }
        told = written.is_err();
    }
}

fn append(path: &Path, alarms: &[Alarm]) -> std::io::Result<()> {
    let mut file = OpenOptions::new().create(true).append(true).open(path)?;
    file.write_all(lines(alarms).as_bytes())?;
    file.sync_data()
}

fn rewrite(path: &Path, alarms: &[Alarm]) -> std::io::Result<()> {
    whole_file::replace(path, lines(alarms).as_bytes(), whole_file::ORDINARY)
}

fn lines(alarms: &[Alarm]) -> String {
    let line = |alarm: &Alarm| {
        let envelope = codec::encode(alarm).ok()?;
        Some(envelope.iter().map(|byte| format!("{byte:02x}")).chain(["\n".to_owned()]).collect::<String>())
    };
    alarms.iter().filter_map(line).collect()
}

/// Every line that can be read.
fn read(path: &Path) -> std::io::Result<Vec<Alarm>> {
    let file = match File::open(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        opened => opened?,
    };
    let lines = BufReader::new(file).lines().map_while(Result::ok).filter(|line| line.len() <= MAX_LINE);
    Ok(lines.take(4 * MAX_KEPT).filter_map(|line| codec::decode(&bytes(&line)?).ok()).collect())
}

fn bytes(hexadecimal: &str) -> Option<Vec<u8>> {
    let (pairs, rest) = hexadecimal.as_bytes().as_chunks::<2>();
    let digit = |digit: u8| char::from(digit).to_digit(16);
    let bytes = pairs.iter().map(|[high, low]| Some((16 * digit(*high)? + digit(*low)?) as u8)).collect();
    if rest.is_empty() { bytes } else { None }
}

#[cfg(test)]
mod tests {
    use protocol::message::AlarmKind;
    use protocol::time::Timestamp;

    use super::*;

    #[test]
    fn alarms_are_told_again_after_a_restart_with_their_session_and_number() {
        let folder = tempfile::tempdir().unwrap();
        let mut journal = Journal::open(folder.path(), robot()).unwrap();
        assert!(journal.take_before().is_empty());
        for number in 0..5 {
            journal.keep(&alarm(number));
        }
        written(folder.path(), 5);
        // The power fails in the middle of a line.
        append_raw(folder.path(), b"50a10103");
        let mut again = Journal::open(folder.path(), robot()).unwrap();
        assert_eq!(again.take_before(), (0..5).map(alarm).collect::<Vec<_>>());
        again.keep(&alarm(5));
        written(folder.path(), 6);
        assert_eq!(Journal::open(folder.path(), robot()).unwrap().take_before().len(), 6);
    }

    #[test]
    fn the_journal_is_bounded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r1.alarms");
        append(&path, &(0..2000).map(alarm).collect::<Vec<_>>()).unwrap();
        let mut journal = Journal::open(folder.path(), robot()).unwrap();
        assert_eq!(journal.take_before().len(), MAX_TOLD_AGAIN);
        assert!(fs::read_to_string(&path).unwrap().lines().count() <= MAX_KEPT);
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, b"").unwrap();
        let error = Journal::open(&file, robot()).unwrap_err().to_string();
        assert!(error.contains("state_dir") && error.contains("file"), "{error}");
    }

    /// Waits until the journal has so many lines.
    fn written(folder: &Path, lines: usize) {
        let limit = std::time::Instant::now() + std::time::Duration::from_secs(10);
        while fs::read_to_string(folder.join("r1.alarms")).map_or(0, |text| text.lines().count()) < lines {
            assert!(std::time::Instant::now() < limit, "not written");
            std::thread::yield_now();
        }
    }

    fn append_raw(folder: &Path, bytes: &[u8]) {
        let mut file = OpenOptions::new().append(true).open(folder.join("r1.alarms")).unwrap();
        file.write_all(bytes).unwrap();
    }

    fn robot() -> RobotId {
        RobotId::new("r1").unwrap()
    }

    fn alarm(number: u32) -> Alarm {
        Alarm { robot: robot(), epoch: 7, number, at: Timestamp(u64::from(number)), kind: AlarmKind::SelfMotion }
    }
}
