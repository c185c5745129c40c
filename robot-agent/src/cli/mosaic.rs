//! `robot-agent mosaic`.

use std::fmt::Write as _;
use std::io::{self, Write};
use std::path::PathBuf;

use indicatif::ProgressBar;
use robot_agent::capture::{self, CaptureOptions};
use robot_agent::optics::mosaic::Slit;
use robot_agent::optics::{Camera, Mosaic, MosaicParameters, MountedCamera};
use serde_json::json;

use super::{Failure, Format, check_frame_rate};

/// Joins the pictures of a camera on a turning arm to a mosaic of all bearings (the report's 5.3), with the time of each column.
///
/// The camera file's model is "mosaic"; its turn_s says how long a turn takes, so that each picture's capture time says where
/// the arm was: at start_deg with the first picture. Without turn_s the pictures are taken to be one turn at equal steps.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The pictures in order: a folder of images, a .y4m file, or a video that ffmpeg decodes. As many rows as the mosaic.
    input: PathBuf,
    /// The camera file (camera.toml) of the mosaic.
    #[arg(long, value_name = "FILE")]
    camera: PathBuf,
    /// Where to write the mosaic; the ending chooses the format.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Where to write the time of each column: a CSV file `column,picture,capture_ns`.
    #[arg(long, value_name = "FILE")]
    times: Option<PathBuf>,
    /// Frame rate, for a folder that does not say.
    #[arg(long, value_name = "HZ")]
    frame_rate_hz: Option<f64>,
    /// How to print what was done.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

/// Gaps larger than this many columns are holes: the arm was never near.
const LARGEST_GAP_COLUMNS: f64 = 20.0;

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    check_frame_rate(arguments.frame_rate_hz)?;
    let mosaic = arguments.mosaic()?;
    let turn_s = mosaic.design().turn_s;
    let options = CaptureOptions { frame_rate_hz: arguments.frame_rate_hz, ..CaptureOptions::default() };
    let mut source = capture::open(&arguments.input, options).map_err(Failure::job)?;
    for remark in source.remarks() {
        tracing::warn!("{remark}");
    }
    let progress = ProgressBar::new(source.frames().unwrap_or(0));
    // Only the slits are kept: a turn of pictures would fill the memory.
    let mut slits: Vec<(u64, f64, Slit)> = Vec::new();
    let (mut beyond, mut first) = (0u64, None);
    while let Some(frame) = source.next_frame() {
        let frame = frame.map_err(Failure::job)?;
        progress.inc(1);
        let since_s = frame.capture.seconds_since(*first.get_or_insert(frame.capture));
        if turn_s > 0.0 && since_s >= turn_s {
            beyond += 1;
            continue;
        }
        let slit = mosaic
            .slit([frame.width, frame.height], &frame.gray)
            .map_err(|e| Failure::job(format!("{}: picture {}: {e}", arguments.input.display(), slits.len())))?;
        slits.push((frame.capture.0, since_s, slit));
    }
    progress.finish_and_clear();
    let pictures = slits.len();
    let (captures, at_arms): (Vec<u64>, Vec<(f64, Slit)>) = slits
        .into_iter()
        .enumerate()
        .map(|(n, (capture, since_s, slit))| {
            let share = if turn_s > 0.0 { since_s / turn_s } else { (n as f64 + 0.5) / pictures as f64 };
            (capture, (mosaic.arm_at_share_rad(share), slit))
        })
        .unzip();
    let joined = mosaic.join(&at_arms).map_err(|e| Failure::job(format!("{}: {e}", arguments.input.display())))?;
    let [width, height] = mosaic.image_size_px();
    let gap_deg = joined.largest_gap_rad.to_degrees();
    if gap_deg > LARGEST_GAP_COLUMNS * 360.0 / f64::from(width) {
        return Err(Failure::job(format!(
            "{}: {pictures} pictures leave {gap_deg:.1}° of the turn to their neighbours; are there too few, or is turn_s = {turn_s} \
             not the time of the turn?",
            arguments.input.display()
        )));
    }
    let picture = image::GrayImage::from_raw(width, height, joined.gray)
        .ok_or_else(|| Failure::job("the mosaic has another size than its camera file says"))?;
    let out = arguments.out.display();
    picture.save(&arguments.out).map_err(|e| Failure::job(format!("{out}: cannot write the picture: {e}")))?;
    if let Some(path) = &arguments.times {
        let mut table = String::from("column,picture,capture_ns\n");
        for (column, slit) in joined.slit_of_column.iter().enumerate() {
            let _ = writeln!(table, "{column},{slit},{}", captures[*slit]);
        }
        std::fs::write(path, table).map_err(|e| Failure::job(format!("{}: cannot be written: {e}", path.display())))?;
    }
    let mut output = io::stdout().lock();
    match arguments.format {
        Format::Text => writeln!(
            output,
            "{out}: {width}x{height} from {pictures} pictures, each column within {gap_deg:.2}° of its own; {beyond} pictures after \
             the turn left out"
        )?,
        Format::Json => {
            let report = json!({
                "out": out.to_string(), "width_px": width, "height_px": height, "pictures": pictures,
                "left_out": beyond, "largest_gap_deg": gap_deg, "turn_s": turn_s,
                "picture_of_column": joined.slit_of_column,
            });
            writeln!(output, "{report}")?;
        }
    }
    Ok(())
}

impl Arguments {
    fn mosaic(&self) -> Result<Mosaic, Failure> {
        let camera = MountedCamera::load(&self.camera).map_err(Failure::usage)?;
        let model = camera.camera();
        let wrong = |what: String| Failure::usage(format!("{}: {what}", self.camera.display()));
        if model.model() != "mosaic" {
            return Err(wrong(format!("model = {:?}, must be \"mosaic\"", model.model())));
        }
        let parameters: MosaicParameters = model.table().try_into().map_err(|e| wrong(format!("{e}")))?;
        Mosaic::new(parameters, camera.image_size_px()).map_err(|e| wrong(e.to_string()))
    }
}
