//! A configuration file read strictly, and errors a person can act on: file, line, key, value, and what would be right.
//!
//! serde finds unknown keys and wrong types while it reads; ranges, names and files are checked afterwards, when the
//! place in the text is forgotten. [`Document::invalid`] finds it again from the key's path in the spanned tree.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

mod endpoint;
mod instant;

pub use endpoint::{DEFAULT_ENDPOINT, endpoint_problem};
pub use instant::{INSTANT_WANTED, parse_instant};

/// Largest file that is read: a configuration is a few kilobytes, and a mistyped path may name a video.
pub const MAX_DOCUMENT_BYTES: u64 = 1 << 20;

/// Why a file is not a configuration.
#[derive(Debug, thiserror::Error)]
pub enum DocumentError {
    /// It cannot be read at all.
    #[error("{path}: cannot be read: {source}", path = path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// Not TOML, an unknown key, or a value of another type.
    #[error("{path}:{line}:{column}: {reason}\n    {text}", path = path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// Counted from 1.
        column: usize,
        /// What is wrong, and the keys or types that would be right.
        reason: String,
        /// The line as it stands.
        text: String,
    },
    /// Well-formed, but the value cannot be.
    #[error("{}: `{key}` is {value}; {wanted}", Place(path, *line))]
    Invalid {
        /// The file.
        path: PathBuf,
        /// Counted from 1, where the key stands in the file (a missing or defaulted key has no line).
        line: Option<usize>,
        /// Its path, with dots.
        key: String,
        /// What was given.
        value: String,
        /// What would be right.
        wanted: String,
    },
}

/// A file and its text.
#[derive(Debug, Clone)]
pub struct Document {
    path: PathBuf,
    text: String,
}

impl Document {
    /// Reads a file of at most [`MAX_DOCUMENT_BYTES`].
    pub fn read(path: &Path) -> Result<Self, DocumentError> {
        let unreadable = |source| DocumentError::Unreadable { path: path.to_owned(), source };
        let size = std::fs::metadata(path).map_err(unreadable)?.len();
        if size > MAX_DOCUMENT_BYTES {
            let message = format!("{size} bytes; a configuration has at most {MAX_DOCUMENT_BYTES}");
            return Err(unreadable(std::io::Error::new(std::io::ErrorKind::FileTooLarge, message)));
        }
        Ok(Self::from_text(path, std::fs::read_to_string(path).map_err(unreadable)?))
    }

    /// A text as if it stood in `path`.
    pub fn from_text(path: &Path, text: String) -> Self {
        Self { path: path.to_owned(), text }
    }

    /// Where it was read from.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The raw structure; types that deny unknown fields make a mistyped key an error that lists the right ones.
    pub fn parse<T: DeserializeOwned>(&self) -> Result<T, DocumentError> {
        toml::from_str(&self.text).map_err(|error| {
            let at = error.span().map_or(0, |span| span.start);
            let (line, column) = line_and_column(&self.text, at);
            DocumentError::Malformed {
                path: self.path.clone(),
                line,
                column,
                reason: error.message().to_owned(),
                text: self.text.lines().nth(line - 1).unwrap_or_default().trim().to_owned(),
            }
        })
    }

    /// The error of a value that was read but cannot be. `key` is its path with dots, as `network.connect`.
    pub fn invalid(&self, key: &str, value: impl Display, wanted: impl Into<String>) -> DocumentError {
        DocumentError::Invalid {
            path: self.path.clone(),
            line: self.line_of(key),
            key: key.to_owned(),
            value: value.to_string(),
            wanted: wanted.into(),
        }
    }

    /// A path of the file, which counts from the folder the file is in.
    pub fn resolve(&self, relative: &Path) -> PathBuf {
        self.path.parent().unwrap_or(Path::new("")).join(relative)
    }

    fn line_of(&self, key: &str) -> Option<usize> {
        let root = toml::de::DeTable::parse(&self.text).ok()?;
        let mut table = root.get_ref();
        let mut parts = key.split('.').peekable();
        while let Some(part) = parts.next() {
            let (name, value) = table.iter().find(|(name, _)| name.get_ref() == part)?;
            if parts.peek().is_none() {
                return Some(line_and_column(&self.text, name.span().start).0);
            }
            table = value.get_ref().as_table()?;
        }
        None
    }
}

struct Place<'a>(&'a Path, Option<usize>);

impl Display for Place<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.0.display())?;
        self.1.map_or(Ok(()), |line| write!(f, ":{line}"))
    }
}

fn line_and_column(text: &str, at: usize) -> (usize, usize) {
    let before = text.get(..at).unwrap_or(text);
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().map_or(0, |rest| rest.chars().count()) + 1;
    (line, column)
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;

    use super::*;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Raw {
        robot: Robot,
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Robot {
        id: String,
        height_m: f64,
    }

    #[test]
    fn an_unknown_key_is_named_with_its_line_and_the_keys_that_exist() {
        let message = document("[robot]\nid = \"r1\"\nheight_mm = 600\n").parse::<Raw>().unwrap_err().to_string();
        assert!(message.starts_with("agent.toml:3:1: unknown field `height_mm`"), "{message}");
        assert!(message.contains("`height_m`") && message.contains("height_mm = 600"), "{message}");
    }

    #[test]
    fn a_value_of_another_type_is_named_with_its_line() {
        let message = document("[robot]\nid = \"r1\"\nheight_m = \"0.6 m\"\n").parse::<Raw>().unwrap_err().to_string();
        assert!(message.starts_with("agent.toml:3:12: "), "{message}");
        assert!(message.contains("0.6 m"), "{message}");
    }

    #[test]
    fn a_value_that_cannot_be_is_named_with_its_line_its_key_and_what_would_be_right() {
        let document = document("\n[robot]\nid = \"r1\"\nheight_m = 600.0\n");
        let raw: Raw = document.parse().unwrap();
        assert_eq!(raw.robot.id, "r1");
        let error = document.invalid("robot.height_m", raw.robot.height_m, "metres above the floor, 0 to 10");
        assert_eq!(error.to_string(), "agent.toml:4: `robot.height_m` is 600; metres above the floor, 0 to 10");
    }

    #[test]
    fn a_missing_file_is_named() {
        let message = Document::read(Path::new("/nowhere/agent.toml")).unwrap_err().to_string();
        assert!(message.starts_with("/nowhere/agent.toml: cannot be read: "), "{message}");
    }

    #[test]
    fn paths_count_from_the_folder_of_the_file() {
        let document = Document::from_text(Path::new("/etc/pal/agent.toml"), String::new());
        assert_eq!(document.resolve(Path::new("camera.toml")), Path::new("/etc/pal/camera.toml"));
        assert_eq!(document.resolve(Path::new("/srv/frames")), Path::new("/srv/frames"));
    }

    fn document(text: &str) -> Document {
        Document::from_text(Path::new("agent.toml"), text.to_owned())
    }
}
