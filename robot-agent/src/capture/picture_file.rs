//! One picture file as gray values.

use std::path::Path;

use super::CaptureError;

/// A gray picture without a time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GrayPicture {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Row by row.
    pub gray: Vec<u8>,
}

/// Endings of the files that count as frames of a folder.
const ENDINGS: [&str; 5] = ["png", "jpg", "jpeg", "bmp", "pgm"];

/// Whether the name says that this is a picture.
pub fn is_picture(path: &Path) -> bool {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("");
    ENDINGS.iter().any(|e| e.eq_ignore_ascii_case(ending))
}

/// Reads a picture (PNG, JPEG, BMP, PGM) and, where a size is given, insists on it. Colour becomes gray by Rec. 709
/// (0.2126 R + 0.7152 G + 0.0722 B), 16 bits become 8, transparency is ignored. What the file contains decides about its
/// format, not its ending.
///
/// # Errors
/// The file cannot be read, is truncated or damaged, or has another size.
pub fn read_gray(path: &Path, image_size_px: Option<[u32; 2]>) -> Result<GrayPicture, CaptureError> {
    let bytes = std::fs::read(path).map_err(|source| CaptureError::Read { path: path.into(), source })?;
    let error = |e: image::ImageError| CaptureError::Picture { path: path.into(), message: e.to_string() };
    let picture = image::load_from_memory(&bytes).map_err(error)?.into_luma8();
    let (width, height) = picture.dimensions();
    if let Some(expected) = image_size_px.filter(|expected| *expected != [width, height]) {
        return Err(CaptureError::Size { what: path.display().to_string(), got: [width, height], expected });
    }
    Ok(GrayPicture { width, height, gray: picture.into_raw() })
}
