//! Pictures for people, asked for by key and answered as plain PNG or JPEG.

use std::fmt;
use std::str::FromStr;

/// Which picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum PictureKind {
    /// Panorama with boxes, identities, bearings.
    Panorama,
    /// The object image: moving pixels only.
    Objects,
    /// Virtual gaze windows on each object.
    Gaze,
    /// One picture of the recent past.
    Synopsis,
    /// Track image.
    Tracks,
    /// The background.
    Background,
}

impl PictureKind {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Panorama, Self::Objects, Self::Gaze, Self::Synopsis, Self::Tracks, Self::Background];

    /// Its chunk of the key.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Panorama => "panorama",
            Self::Objects => "objects",
            Self::Gaze => "gaze",
            Self::Synopsis => "synopsis",
            Self::Tracks => "tracks",
            Self::Background => "background",
        }
    }
}

impl fmt::Display for PictureKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

/// A word that is no picture.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("there is no picture {0:?}; there are panorama, objects, gaze, synopsis, tracks and background")]
pub struct UnknownPicture(pub String);

impl FromStr for PictureKind {
    type Err = UnknownPicture;
    fn from_str(text: &str) -> Result<Self, UnknownPicture> {
        let unknown = || UnknownPicture(text.chars().take(32).collect());
        Self::ALL.into_iter().find(|kind| kind.as_str() == text).ok_or_else(unknown)
    }
}
