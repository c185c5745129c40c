//! Boxes of somebody else's detector, in MOT format: `frame,id,left,top,width,height[,confidence,…]`, frames from 1, pixels of the
//! picture that is tested. The identity is not used.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Most boxes of one frame; more are left out and counted.
pub const MAX_BOXES: usize = 128;

/// A file of boxes that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum DetectionsError {
    /// It cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// Which.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Not one line is a box.
    #[error("{}: not one box; lines of frame,id,left,top,width,height were expected. {first}", path.display())]
    NoBox {
        /// Which.
        path: PathBuf,
        /// What is wrong with the first line.
        first: String,
    },
}

/// A detector's boxes by frame.
#[derive(Debug, Clone, Default)]
pub struct Detections {
    frames: BTreeMap<u64, Vec<[f64; 4]>>,
    /// Lines that are no box, or one too many.
    pub skipped: usize,
    /// What was wrong with the first of them.
    pub first_problem: Option<String>,
}

impl Detections {
    /// Reads a file; sides are multiplied by `scale`. Lines that are no box are skipped and counted.
    ///
    /// # Errors
    /// A file that cannot be read or holds not one box.
    pub fn read(path: &Path, scale: f64) -> Result<Self, DetectionsError> {
        let text =
            std::fs::read_to_string(path).map_err(|source| DetectionsError::Read { path: path.to_owned(), source })?;
        let detections = Self::parse(&text, scale);
        if detections.frames.is_empty() {
            let first = detections.first_problem.unwrap_or_else(|| "It is empty.".to_owned());
            return Err(DetectionsError::NoBox { path: path.to_owned(), first });
        }
        Ok(detections)
    }

    fn parse(text: &str, scale: f64) -> Self {
        let mut detections = Self::default();
        for (i, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let result = parse_line(line).and_then(|(frame, xywh)| {
                let boxes = detections.frames.entry(frame).or_default();
                if boxes.len() == MAX_BOXES {
                    return Err(format!("more than {MAX_BOXES} boxes in frame {frame}"));
                }
                boxes.push(xywh.map(|v| v * scale));
                Ok(())
            });
            if let Err(why) = result {
                detections.skipped += 1;
                detections.first_problem.get_or_insert_with(|| format!("line {}: {why}", i + 1));
            }
        }
        detections
    }

    /// Left, top, width and height of a frame's boxes; frames count from 0 as everywhere but in the file.
    pub fn of_frame(&self, index: u64) -> &[[f64; 4]] {
        self.frames.get(&(index + 1)).map_or(&[], Vec::as_slice)
    }

    /// Share of the boxes whose middle lies in a picture of this size.
    pub fn share_inside(&self, width: f64, height: f64) -> f64 {
        let inside =
            |[x, y, w, h]: &&[f64; 4]| (0.0..width).contains(&(x + w / 2.0)) && (0.0..height).contains(&(y + h / 2.0));
        let all = self.frames.values().flatten();
        all.clone().filter(inside).count() as f64 / all.count().max(1) as f64
    }
}

fn parse_line(line: &str) -> Result<(u64, [f64; 4]), String> {
    let numbers: Vec<f64> = line.split(',').map_while(|n| n.trim().parse().ok()).take(6).collect();
    let [frame, _, x, y, w, h] = numbers[..] else {
        return Err(format!("\"{line}\": frame,id,left,top,width,height was expected"));
    };
    if !(frame >= 1.0 && frame.fract() == 0.0 && frame < 1e15) {
        return Err(format!("frame {frame}: a whole number from 1 on was expected"));
    }
    if ![x, y, w, h].iter().all(|v| v.is_finite() && v.abs() < 1e6) || w <= 0.0 || h <= 0.0 {
        return Err(format!("box {x},{y},{w},{h}: finite numbers and positive sides were expected"));
    }
    Ok((frame as u64, [x, y, w, h]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_are_read_and_bad_lines_skipped_counted_and_named() {
        let text = "1,-1,10,20,5,8,0.9\n2,-1,NaN,20,5,8\n2,-1,10,20,-5,8\nhello\n2,3,1,2,3,4,1,-1,-1,-1\n0,1,1,1,1,1\n";
        let detections = Detections::parse(text, 2.0);
        assert_eq!(detections.of_frame(0), [[20.0, 40.0, 10.0, 16.0]]);
        assert_eq!(detections.of_frame(1), [[2.0, 4.0, 6.0, 8.0]]);
        assert!(detections.of_frame(2).is_empty());
        assert_eq!(detections.skipped, 4);
        assert!(detections.first_problem.unwrap().starts_with("line 2: box NaN,20,5,8"));
    }

    #[test]
    fn boxes_for_a_larger_picture_are_noticed() {
        let detections = Detections::parse("1,1,500,10,20,40\n1,2,600,10,20,40\n1,3,10,10,20,40\n", 1.0);
        assert!(detections.share_inside(384.0, 288.0) < 0.4);
        assert_eq!(detections.share_inside(768.0, 576.0), 1.0);
    }
}
