//! Files of corners: what other tools found in pictures, or this one.
//!
//! | content | |
//! |---|---|
//! | `{"board":{"cols","rows","square_m"},"image_size":[w,h],"corners":{"a.png":[[u,v],…]}}` | corners row by row, `cols` a row; `square_mm`, or `square` for the same, instead of `square_m` |
//! | `{"image_size":[w,h],"views":[{"name","object_m":[[x,y,z],…],"image_px":[[u,v],…]}]}` | any known points; in the plane z = 0 they are a board |
//! | OpenCV's `<opencv_storage>` with `objectPoints`, `imagePoints`, `imageSize` | as its omnidirectional calibration reads it; lengths are taken for metres |

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::observation::{ObservationError, Observations, View};
use super::{Board, BoardSize};

/// Larger files are taken for a mistake.
const MAX_BYTES: u64 = 64 << 20;

/// Why a file holds no corners.
#[derive(Debug, thiserror::Error)]
pub enum CornerFileError {
    /// It cannot be read.
    #[error("{path}: cannot be read: {source}", path = path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// Neither of the formats.
    #[error("{path}: {reason}", path = path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong and what would be right.
        reason: String,
    },
    /// Points that cannot be.
    #[error("{path}: {source}", path = path.display())]
    Points {
        /// The file.
        path: PathBuf,
        /// Which.
        source: ObservationError,
    },
}

/// The JSON form with a board. Other tools add keys of their own, which say nothing here.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct BoardFile {
    board: BoardEntry,
    image_size: [u32; 2],
    corners: BTreeMap<String, Vec<[f64; 2]>>,
}

#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct BoardEntry {
    cols: usize,
    rows: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    square_m: Option<f64>,
    #[serde(alias = "square", skip_serializing_if = "Option::is_none")]
    square_mm: Option<f64>,
}

/// The JSON form with any points.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct PointFile {
    image_size: [u32; 2],
    views: Vec<PointView>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct PointView {
    name: String,
    object_m: Vec<[f64; 3]>,
    image_px: Vec<[f64; 2]>,
}

/// Reads a file of any of the formats.
///
/// # Errors
/// The file cannot be read, is of no known format, or holds points that calibrate nothing; the message names file, view
/// and value.
pub fn read(path: &Path) -> Result<Observations, CornerFileError> {
    let unreadable = |source| CornerFileError::Unreadable { path: path.into(), source };
    let bytes = std::fs::metadata(path).map_err(unreadable)?.len();
    if bytes > MAX_BYTES {
        let message = format!("{bytes} bytes; a file of corners has at most {MAX_BYTES}");
        return Err(unreadable(std::io::Error::new(std::io::ErrorKind::FileTooLarge, message)));
    }
    parse(&std::fs::read_to_string(path).map_err(unreadable)?, path)
}

/// Parses a text; `path` is for messages.
///
/// # Errors
/// As [`read`].
pub fn parse(text: &str, path: &Path) -> Result<Observations, CornerFileError> {
    let parsed = if text.trim_start().starts_with('<') { from_opencv(text) } else { from_json(text) };
    let (image_size_px, views) = parsed.map_err(|reason| CornerFileError::Malformed { path: path.into(), reason })?;
    Observations::new(image_size_px, views).map_err(|source| CornerFileError::Points { path: path.into(), source })
}

/// The JSON text of corners found on a board.
///
/// # Errors
/// Never for finite corners; serde's error otherwise.
pub fn to_json(
    board: &Board,
    image_size_px: [u32; 2],
    corners: &BTreeMap<String, Vec<Vector2<f64>>>,
) -> Result<String, serde_json::Error> {
    let BoardSize { cols, rows } = board.size;
    let file = BoardFile {
        board: BoardEntry { cols, rows, square_m: Some(board.square_m), square_mm: None },
        image_size: image_size_px,
        corners: corners.iter().map(|(name, list)| (name.clone(), list.iter().map(|c| [c.x, c.y]).collect())).collect(),
    };
    serde_json::to_string(&file)
}

type Content = ([u32; 2], Vec<View>);

fn from_json(text: &str) -> Result<Content, String> {
    let value: serde_json::Value = serde_json::from_str(text)
        .map_err(|e| format!("neither JSON nor OpenCV's XML: {e}; wanted is a file of corners or points"))?;
    if value.get("views").is_some() {
        let file: PointFile = serde_json::from_value(value).map_err(|e| format!("file of points: {e}"))?;
        let views = file.views.into_iter().map(point_view).collect::<Result<_, _>>()?;
        return Ok((file.image_size, views));
    }
    let file: BoardFile = serde_json::from_value(value).map_err(|e| {
        format!("file of corners: {e}; wanted are \"board\", \"image_size\" and \"corners\", or \"views\" of points")
    })?;
    let board = file.board.checked()?;
    let views = file.corners.into_iter().map(|(name, corners)| {
        let corners: Vec<Vector2<f64>> = corners.into_iter().map(Vector2::from).collect();
        board.view(name, &corners).map_err(|e| e.to_string())
    });
    Ok((file.image_size, views.collect::<Result<_, _>>()?))
}

impl BoardEntry {
    fn checked(&self) -> Result<Board, String> {
        let square_m = match (self.square_m, self.square_mm) {
            (Some(m), None) => m,
            (None, Some(mm)) => mm * 1e-3,
            _ => return Err("board: exactly one of \"square_m\" and \"square_mm\" is wanted".into()),
        };
        Board::new(BoardSize { cols: self.cols, rows: self.rows }, square_m).map_err(|e| e.to_string())
    }
}

fn point_view(view: PointView) -> Result<View, String> {
    let (objects, images) = (view.object_m.len(), view.image_px.len());
    if objects != images {
        return Err(format!("view {:?} has {objects} points in object_m and {images} in image_px", view.name));
    }
    let objects = view.object_m.into_iter().map(Vector3::from);
    Ok(View { name: view.name, points: objects.zip(view.image_px.into_iter().map(Vector2::from)).collect() })
}

fn from_opencv(text: &str) -> Result<Content, String> {
    let document = roxmltree::Document::parse(text).map_err(|e| format!("not well-formed XML: {e}"))?;
    let root = document.root_element();
    let child = |name: &str| {
        root.children().find(|n| n.has_tag_name(name)).ok_or_else(|| format!("OpenCV's XML without <{name}>"))
    };
    let size = numbers(child("imageSize")?)?;
    let &[w, h] = size.as_slice() else { return Err("<imageSize> must have two numbers".into()) };
    let matrices = |name: &str| -> Result<Vec<Vec<f64>>, String> {
        child(name)?
            .children()
            .filter(roxmltree::Node::is_element)
            .map(|matrix| {
                let data = matrix.children().find(|n| n.has_tag_name("data"));
                numbers(data.ok_or_else(|| format!("a matrix in <{name}> has no <data>"))?)
            })
            .collect()
    };
    let (objects, images) = (matrices("objectPoints")?, matrices("imagePoints")?);
    if objects.len() != images.len() {
        return Err(format!("{} views in <objectPoints>, {} in <imagePoints>", objects.len(), images.len()));
    }
    let views = objects.iter().zip(&images).enumerate().map(|(index, (object, image))| {
        let name = format!("{}", index + 1);
        if object.len() % 3 != 0 || image.len() % 2 != 0 || object.len() / 3 != image.len() / 2 {
            let (o, i) = (object.len(), image.len());
            return Err(format!("view {name}: {o} numbers in <objectPoints> are not 3/2 of {i} in <imagePoints>"));
        }
        let objects = object.chunks_exact(3).map(|p| Vector3::new(p[0], p[1], p[2]));
        Ok(View { name, points: objects.zip(image.chunks_exact(2).map(|p| Vector2::new(p[0], p[1]))).collect() })
    });
    Ok(([w as u32, h as u32], views.collect::<Result<_, String>>()?))
}

fn numbers(node: roxmltree::Node) -> Result<Vec<f64>, String> {
    let words = node.text().unwrap_or("").split_ascii_whitespace();
    words.map(|w| w.parse().map_err(|_| format!("<{}>: {w:?} is no number", node.tag_name().name()))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reason(text: &str) -> String {
        parse(text, Path::new("corners.json")).unwrap_err().to_string()
    }

    const GRID: &str = "[[10,10],[20,10],[30,11],[10,20],[20,21],[30,22]]";

    fn file(board: &str, corners: &str) -> String {
        format!(r#"{{"board":{board},"image_size":[64,48],"corners":{{"a.png":{corners}}}}}"#)
    }

    #[test]
    fn corners_become_points_of_the_board_in_metres() {
        let board = r#"{"cols":3,"rows":2,"square":30.0}"#;
        let read = parse(&file(board, GRID), Path::new("c.json")).unwrap();
        assert_eq!(read.image_size_px, [64, 48]);
        assert_eq!(read.views[0].points[5], (Vector3::new(0.06, 0.03, 0.0), Vector2::new(30.0, 22.0)));
    }

    #[test]
    fn a_view_of_another_board_is_named_with_both_counts() {
        let text = reason(&file(r#"{"cols":4,"rows":2,"square_m":0.03}"#, GRID));
        assert!(
            text.contains("corners.json") && text.contains("a.png") && text.contains('6') && text.contains('8'),
            "{text}"
        );
    }

    #[test]
    fn corners_on_a_line_off_the_picture_or_twice_are_named() {
        let board = r#"{"cols":3,"rows":2,"square_m":0.03}"#;
        let line = "[[10,10],[11,11],[12,12],[13,13],[14,14],[15,15]]";
        assert!(reason(&file(board, line)).contains("one line"));
        assert!(reason(&file(board, &GRID.replace("30,22", "80,22"))).contains("64x48"));
        assert!(reason(&file(board, &GRID.replace("30,22", "20,10"))).contains("both at"));
    }

    #[test]
    fn what_is_no_file_of_corners_says_what_would_be() {
        assert!(reason("hello").contains("JSON"));
        assert!(reason("{}").contains("\"views\""));
        assert!(reason("<opencv_storage></opencv_storage>").contains("imageSize"));
        assert!(reason(&file(r#"{"cols":3,"rows":2,"square_m":0.03,"square_mm":3}"#, GRID)).contains("exactly one"));
        assert!(reason(&file(r#"{"cols":1,"rows":6,"square_m":0.03}"#, GRID)).contains("at least 2"));
    }
}
