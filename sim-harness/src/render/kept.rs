//! Pictures kept in a file, so that the same scenario with the same seed is rendered once: a record a picture, in the order of time.
//!
//! A file is never believed blindly: the first picture that is asked for is rendered and compared, and where one bit differs (another
//! version of the renderer) all are rendered anew. Whoever finds the file in use by another process renders without it.

use std::fs::{File, OpenOptions};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::Picture;
use crate::scenario::Scenario;

/// A robot's pictures in a file.
#[derive(Debug)]
pub(super) struct Kept {
    file: File,
    state: State,
    /// Where the next record begins, bytes.
    at: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    /// The first picture tells whether the file may be believed.
    Doubted,
    /// Pictures are read.
    Read,
    /// What comes now is new.
    Written,
    /// It is somebody else's, or the disk is full.
    Closed,
}

/// The file of a robot's pictures in a folder: another scenario, seed or robot is another file. The scenario's own name is in the hash alone, for
/// it may hold what no file's name may.
pub(super) fn path(folder: &Path, scenario: &Scenario, seed: u64, robot: usize) -> io::Result<PathBuf> {
    let text = toml::to_string(&Scenario { seed, ..scenario.clone() }).map_err(io::Error::other)?;
    let mut hasher = DefaultHasher::new();
    text.hash(&mut hasher);
    Ok(folder.join(format!("{:016x}-seed-{seed}-robot-{}.frames", hasher.finish(), robot + 1)))
}

impl Kept {
    pub(super) fn open(path: &Path) -> io::Result<Self> {
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path)?;
        let state = if file.try_lock_shared().is_ok() { State::Doubted } else { State::Closed };
        Ok(Self { file, state, at: 0 })
    }

    /// The picture of an instant, from the file where it is there: `size` is pixels a row and rows, `people` how many there are.
    pub(super) fn get(
        &mut self,
        time_s: f64,
        size: [u32; 2],
        people: usize,
        render: impl FnOnce() -> Picture,
    ) -> Picture {
        let known = match self.state {
            State::Doubted | State::Read => self.read(time_s, size, people).ok(),
            State::Written | State::Closed => None,
        };
        let picture = match known {
            Some(known) if self.state == State::Read => return known,
            doubted => {
                let picture = render();
                if doubted.as_ref() == Some(&picture) {
                    self.state = State::Read;
                    return picture;
                }
                picture
            }
        };
        if matches!(self.state, State::Doubted | State::Read) {
            self.begin_writing();
        }
        if self.state == State::Written && self.write(time_s, &picture).is_err() {
            self.state = State::Closed;
        }
        picture
    }

    /// The record at the place we are at, and on to the next.
    fn read(&mut self, time_s: f64, [width, height]: [u32; 2], people: usize) -> io::Result<Picture> {
        let mut number = [0; 8];
        let mut f64_of = |file: &mut File| file.read_exact(&mut number).map(|()| f64::from_le_bytes(number));
        if f64_of(&mut self.file)? != time_s {
            return Err(io::ErrorKind::InvalidData.into());
        }
        let visible_fraction = (0..people).map(|_| f64_of(&mut self.file)).collect::<io::Result<_>>()?;
        let mut gray = vec![0; width as usize * height as usize];
        self.file.read_exact(&mut gray)?;
        self.at += (8 * (1 + people) + gray.len()) as u64;
        Ok(Picture { width, height, gray, visible_fraction })
    }

    fn begin_writing(&mut self) {
        // A first picture that differs has been read.
        let from = if self.state == State::Doubted { 0 } else { self.at };
        let begun = self.file.unlock().and_then(|()| self.file.try_lock().map_err(io::Error::from));
        let begun = begun.and_then(|()| self.file.set_len(from)).and_then(|()| self.file.seek(SeekFrom::Start(from)));
        self.state = if begun.is_ok() { State::Written } else { State::Closed };
    }

    fn write(&mut self, time_s: f64, picture: &Picture) -> io::Result<()> {
        let mut record = time_s.to_le_bytes().to_vec();
        record.extend(picture.visible_fraction.iter().flat_map(|share| share.to_le_bytes()));
        record.extend(&picture.gray);
        self.file.write_all(&record)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(value: u8) -> Picture {
        Picture { width: 3, height: 2, gray: vec![value; 6], visible_fraction: vec![0.25, f64::from(value)] }
    }

    /// Asks for some pictures; which of them were rendered.
    fn ask(path: &Path, times: &[f64], shade: u8) -> Vec<f64> {
        let mut kept = Kept::open(path).unwrap();
        let mut rendered = Vec::new();
        for &time_s in times {
            let expected = picture(time_s as u8 + shade);
            let got = kept.get(time_s, [3, 2], 2, || {
                rendered.push(time_s);
                expected.clone()
            });
            assert_eq!(got, expected, "{time_s}");
        }
        rendered
    }

    #[test]
    fn what_was_rendered_once_is_read_and_what_is_missing_is_added() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r1.frames");
        assert_eq!(ask(&path, &[0.0, 1.0, 2.0], 0), [0.0, 1.0, 2.0]);
        // The first is rendered each time, to see whether the file is of this renderer.
        assert_eq!(ask(&path, &[0.0, 1.0, 2.0, 3.0], 0), [0.0, 3.0]);
        assert_eq!(ask(&path, &[0.0, 1.0, 2.0, 3.0], 0), [0.0]);
        // Other times.
        assert_eq!(ask(&path, &[0.0, 1.5, 2.0], 0), [0.0, 1.5, 2.0]);
        // Another renderer.
        assert_eq!(ask(&path, &[0.0, 1.5, 2.0], 7), [0.0, 1.5, 2.0]);
        assert_eq!(ask(&path, &[0.0, 1.5, 2.0], 7), [0.0]);
    }

    #[test]
    fn whatever_a_scenario_is_called_its_file_is_in_the_folder() {
        let scenario = Scenario::builtin("tiny").unwrap().unwrap();
        let folder = Path::new("folder");
        let at = |name: &str| path(folder, &Scenario { name: name.to_owned(), ..scenario.clone() }, 7, 0).unwrap();
        assert_eq!(at("../a room/of mine").parent(), Some(folder));
        assert_ne!(at("one"), at("other"));
    }

    #[test]
    fn a_record_that_was_cut_off_is_rendered_again() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r1.frames");
        ask(&path, &[0.0, 1.0], 0);
        let file = OpenOptions::new().write(true).open(&path).unwrap();
        file.set_len(file.metadata().unwrap().len() - 2).unwrap();
        assert_eq!(ask(&path, &[0.0, 1.0], 0), [0.0, 1.0]);
        assert_eq!(ask(&path, &[0.0, 1.0], 0), [0.0]);
    }

    #[test]
    fn two_at_once_do_not_write_into_each_others_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("r1.frames");
        let mut first = Kept::open(&path).unwrap();
        first.get(0.0, [3, 2], 2, || picture(0));
        assert_eq!(ask(&path, &[0.0, 1.0], 0), [0.0, 1.0]);
        first.get(1.0, [3, 2], 2, || picture(1));
        drop(first);
        assert_eq!(ask(&path, &[0.0, 1.0], 0), [0.0]);
    }
}
