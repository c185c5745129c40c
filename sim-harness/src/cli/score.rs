//! `sim-harness score`: masks and tracks against truth by the standard definitions.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::record::Format;
use super::told::tell;
use crate::score::{cdnet, mot};

/// Arguments of `score`.
#[derive(Debug, Clone, Args)]
pub struct ScoreArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Clone, Subcommand)]
enum What {
    /// Masks against a sequence of ChangeDetection.net: F, recall, precision
    Cdnet(CdnetArgs),
    /// Tracks against truth boxes: MOTA, IDF1, identity switches, F of the boxes
    Mot(MotArgs),
}

#[derive(Debug, Clone, Args)]
struct CdnetArgs {
    /// The sequence: groundtruth/gtNNNNNN.png, ROI.bmp, temporalROI.txt
    sequence: PathBuf,
    /// Masks NNNNNN.png, the first frame is 000000 (`robot-agent track --out DIR` writes DIR/mask)
    masks: PathBuf,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

#[derive(Debug, Clone, Args)]
struct MotArgs {
    /// Truth in MOT format: frame,id,left,top,width,height,flag,…; frames from 1
    truth: PathBuf,
    /// Tracks in MOT format, or the lines of `robot-agent track`
    tracks: PathBuf,
    /// Least intersection over union of a pair; several are scored one after the other
    #[arg(long, value_name = "SHARE", num_args = 1.., default_values_t = [0.5])]
    iou: Vec<f64>,
    /// Pixels of the truth for one pixel of the tracks
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    scale: f64,
    /// Only frames up to this one, counted from 1
    #[arg(long, value_name = "N")]
    last_frame: Option<u64>,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Does it; gives the exit code.
#[allow(clippy::print_stderr)]
pub fn run(args: &ScoreArgs) -> u8 {
    let result = match &args.what {
        What::Cdnet(args) => masks(args),
        What::Mot(args) => tracks(args),
    };
    match result {
        Ok(text) => tell("score", &text, 0),
        Err((code, why)) => {
            eprintln!("sim-harness score: {why}");
            code
        }
    }
}

fn masks(args: &CdnetArgs) -> Result<String, (u8, String)> {
    let s = cdnet::score(&args.sequence, &args.masks).map_err(|e| (1, e.to_string()))?;
    Ok(match args.format {
        Format::Json => serde_json::to_string(&s).unwrap_or_default(),
        Format::Text => format!(
            "F {:.4}  recall {:.4}  precision {:.4}  ({} frames; {:.0} % of the false pixels are shadow)",
            s.f_measure,
            s.recall,
            s.precision,
            s.frames,
            100.0 * s.in_shadow as f64 / s.false_positives.max(1) as f64
        ),
    })
}

fn tracks(args: &MotArgs) -> Result<String, (u8, String)> {
    if let Some(iou) = args.iou.iter().find(|iou| !(**iou > 0.0 && **iou <= 1.0)) {
        return Err((2, format!("--iou {iou}: above 0 and at most 1 was expected")));
    }
    if !(args.scale > 0.0 && args.scale.is_finite()) {
        return Err((2, format!("--scale {}: a positive number was expected", args.scale)));
    }
    let read = |path: &PathBuf, scale| mot::read(path, scale).map_err(|e| (1, e.to_string()));
    let (mut truth, mut tracks) = (read(&args.truth, 1.0)?, read(&args.tracks, args.scale)?);
    if let Some(last) = args.last_frame {
        truth.retain(|frame, _| *frame <= last);
        tracks.retain(|frame, _| *frame <= last);
    }
    if truth.is_empty() {
        return Err((1, format!("{}: no box of the truth counts", args.truth.display())));
    }
    let mut text = String::new();
    for iou in &args.iou {
        let s = mot::score(&truth, &tracks, *iou);
        match args.format {
            Format::Json => text += &serde_json::to_string(&s).unwrap_or_default(),
            Format::Text => {
                text += &format!(
                    "IoU {:.2}: MOTA {:.3}  IDF1 {:.3}  switches {}  misses {}  false {}  box F {:.3}  recall {:.3}  precision {:.3}",
                    s.iou,
                    s.mota,
                    s.idf1,
                    s.switches,
                    s.misses,
                    s.false_positives,
                    s.box_f,
                    s.box_recall,
                    s.box_precision
                );
            }
        }
        text.push('\n');
    }
    Ok(text)
}
