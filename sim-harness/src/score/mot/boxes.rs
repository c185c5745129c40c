//! Boxes with identities, from the files that trackers write.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde_json::Value;

/// Boxes by frame number, counted from 1.
pub type Frames = BTreeMap<u64, Vec<TrackBox>>;

/// A box of somebody in a frame; pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackBox {
    /// Who.
    pub id: u64,
    /// Left, top, width, height.
    pub xywh: [f64; 4],
}

impl TrackBox {
    /// Intersection over union, 0 … 1.
    pub fn overlap(&self, other: &Self) -> f64 {
        let side = |k: usize| {
            let (a, b) = (self.xywh[k], other.xywh[k]);
            ((a + self.xywh[k + 2]).min(b + other.xywh[k + 2]) - a.max(b)).max(0.0)
        };
        let both = side(0) * side(1);
        let area = |b: &Self| b.xywh[2] * b.xywh[3];
        if both > 0.0 { both / (area(self) + area(other) - both) } else { 0.0 }
    }
}

/// A file of boxes that is none.
#[derive(Debug, thiserror::Error)]
pub enum BoxesError {
    /// It cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A line that says something else.
    #[error("{}, line {line}: {why}", path.display())]
    Line {
        /// Which file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// What was expected.
        why: String,
    },
}

/// Reads MOT text (`frame,id,left,top,width,height[,flag,…]`, frames from 1; a truth's flag of 0 leaves a box out) or the JSON lines
/// of `robot-agent track` (frames from 0; hidden tracks have no box). Pixels are multiplied by `scale`. Nobody has two boxes in a
/// frame: measures of identity would count both.
///
/// # Errors
/// A file that cannot be read, or the first line that is wrong.
pub fn read(path: &Path, scale: f64) -> Result<Frames, BoxesError> {
    let text = std::fs::read_to_string(path).map_err(|source| BoxesError::Read { path: path.to_owned(), source })?;
    let mut frames = Frames::new();
    let mut had = BTreeSet::new();
    for (i, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let boxes = if line.trim_start().starts_with('{') { json_line(line) } else { mot_line(line) };
        let fault = |why| BoxesError::Line { path: path.to_owned(), line: i + 1, why };
        for (frame, mut found) in boxes.map_err(fault)? {
            if !had.insert((frame, found.id)) {
                let wanted = "one box of each id in a frame was expected";
                return Err(fault(format!(
                    "id {} for the second time in frame {frame} (counted from 1); {wanted}",
                    found.id
                )));
            }
            found.xywh = found.xywh.map(|v| v * scale);
            frames.entry(frame).or_default().push(found);
        }
    }
    Ok(frames)
}

fn mot_line(line: &str) -> Result<Vec<(u64, TrackBox)>, String> {
    const WANTED: &str = "frame,id,left,top,width,height[,flag,…] was expected";
    let numbers: Vec<f64> = line
        .split(',')
        .map(|n| n.trim().parse().map_err(|_| format!("\"{n}\" is no number; {WANTED}")))
        .collect::<Result<_, _>>()?;
    let [frame, id, x, y, w, h, ref rest @ ..] = numbers[..] else {
        return Err(format!("{} numbers; {WANTED}", numbers.len()));
    };
    let whole = |name: &str, v: f64, least: f64| {
        if v >= least && v.fract() == 0.0 && v < 9e15 {
            Ok(v as u64)
        } else {
            Err(format!("{name} {v}: a whole number from {least} on was expected"))
        }
    };
    let (frame, id) = (whole("frame", frame, 1.0)?, whole("id", id, 0.0)?);
    if !(w > 0.0 && h > 0.0 && [x, y, w, h].iter().all(|v| v.is_finite())) {
        return Err(format!("box {x},{y},{w},{h}: finite numbers and positive sides were expected"));
    }
    // The seventh number of a truth says whether the box counts.
    let counts = rest.first().is_none_or(|flag| *flag != 0.0);
    Ok(if counts { vec![(frame, TrackBox { id, xywh: [x, y, w, h] })] } else { Vec::new() })
}

fn json_line(line: &str) -> Result<Vec<(u64, TrackBox)>, String> {
    let line: Value = serde_json::from_str(line).map_err(|e| e.to_string())?;
    let frame = line["frame"].as_u64().and_then(|frame| frame.checked_add(1));
    let frame = frame.ok_or("\"frame\": a whole number was expected")?;
    let objects = line["objects"].as_array().ok_or("\"objects\": a list was expected")?;
    let seen = objects.iter().filter(|o| o["state"] != "hidden");
    seen.map(|o| {
        let id = o["track"].as_u64().ok_or("\"track\": a whole number was expected")?;
        let sides: Vec<f64> = o["box"].as_array().into_iter().flatten().filter_map(Value::as_f64).collect();
        let xywh = <[f64; 4]>::try_from(sides).map_err(|_| "\"box\": [left, top, width, height] was expected")?;
        Ok((frame, TrackBox { id, xywh }))
    })
    .collect()
}
