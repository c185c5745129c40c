//! `robot-agent calibrate model`.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressIterator, ProgressStyle};
use robot_agent::calibration::candidate::{self, Candidate, Kind};
use robot_agent::calibration::observation::Observations;
use robot_agent::calibration::selection::select_with;
use robot_agent::calibration::summary::Summary;
use robot_agent::calibration::{Board, BoardSize, corner_file, corners, report};
use robot_agent::capture::read_gray;
use robot_agent::optics::{MountedCamera, camera_toml};
use serde_json::json;

use super::super::{Failure, Format};

/// The whole camera model from views of a board (or of known points) in unknown poses.
///
/// Corners come from a file, or are found in pictures. Each model that is tried is judged on views that its fit has not
/// seen; the simplest that is as good as the best is written.
#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Corners or points: this tool's JSON, or OpenCV's XML of its omnidirectional calibration.
    #[arg(long, value_name = "FILE", required_unless_present = "pictures", conflicts_with = "pictures")]
    corners: Option<PathBuf>,
    /// Folder of pictures of the board.
    #[arg(long, value_name = "DIR", requires = "board", requires = "square_mm")]
    pictures: Option<PathBuf>,
    /// The board's inner corners, as 11x7.
    #[arg(long, value_name = "COLSxROWS", value_parser = board_size)]
    board: Option<BoardSize>,
    /// Side of the board's squares, millimetres.
    #[arg(long, value_name = "MM")]
    square_mm: Option<f64>,
    /// Where to keep the corners that were found in the pictures (JSON).
    #[arg(long, value_name = "FILE", requires = "pictures")]
    save_corners: Option<PathBuf>,
    /// The model; auto tries all panoramic ones.
    #[arg(long, value_enum, default_value_t)]
    model: Model,
    /// A camera file to start from, with that file's model (for a PAL or a mirror whose design is known).
    #[arg(long, value_name = "FILE", conflicts_with_all = ["model", "centre_px"])]
    start: Option<PathBuf>,
    /// Where the picture's centre is expected, as 383.5,287.5; the middle of the picture.
    #[arg(long, value_name = "U,V", value_parser = super::pair)]
    centre_px: Option<[f64; 2]>,
    /// Where to write the camera file.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Where to write a page with plots and the numbers as JSON.
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// How to print the result.
    #[arg(long, value_enum, default_value_t)]
    format: Format,
}

#[derive(Debug, Clone, Copy, Default, ValueEnum)]
enum Model {
    /// All panoramic models.
    #[default]
    Auto,
    /// Mei's unified sphere.
    UnifiedSphere,
    /// Polynomials: Scaramuzza's, and of the angle.
    Polynomial,
    /// Kannala and Brandt's fisheye.
    Fisheye,
    /// An ordinary lens.
    Pinhole,
}

impl Model {
    fn kinds(self) -> &'static [Kind] {
        match self {
            Self::Auto => &Kind::PANORAMIC,
            Self::UnifiedSphere => &[Kind::UnifiedSphere],
            Self::Polynomial => &[Kind::RadiusPolynomial, Kind::Polynomial],
            Self::Fisheye => &[Kind::KannalaBrandt],
            Self::Pinhole => &[Kind::Pinhole],
        }
    }
}

fn board_size(text: &str) -> Result<BoardSize, String> {
    let side = |text: &str| text.trim().parse::<usize>().ok();
    match text.split_once(['x', 'X', '×']).and_then(|(cols, rows)| Some((side(cols)?, side(rows)?))) {
        Some((cols, rows)) => Ok(BoardSize { cols, rows }),
        None => Err("must be columns and rows of inner corners, as 11x7".into()),
    }
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> Result<(), Failure> {
    let (observations, mut remarks) = match (&arguments.corners, &arguments.pictures) {
        (Some(file), _) => (corner_file::read(file).map_err(Failure::usage)?, Vec::new()),
        (None, Some(folder)) => arguments.find_corners(folder)?,
        (None, None) => return Err(Failure::usage("either --corners or --pictures is wanted")),
    };
    let candidates = arguments.candidates(observations.image_size_px)?;
    // Drawn only where standard error is a terminal.
    let progress = ProgressBar::new(candidates.len() as u64).with_style(style());
    let mut started = false;
    let selection = select_with(&observations, &candidates, |name| {
        progress.inc(u64::from(started));
        started = true;
        progress.set_message(name.to_owned());
        progress.tick();
    });
    progress.finish_and_clear();
    let selection = selection.map_err(Failure::job)?;
    let summary = Summary::new(&observations, &selection);
    if let Some(path) = &arguments.out {
        super::save(path, &camera_file(&summary))?;
        remarks.push(format!("{}: written", path.display()));
    }
    if let Some(folder) = &arguments.report {
        report::write(&summary, folder).map_err(Failure::job)?;
        remarks.push(format!("{}: report", folder.join("index.html").display()));
    }
    let mut words = summary.words();
    words.append(&mut remarks.clone());
    let mut numbers = summary.json();
    numbers["remarks"] = json!(remarks);
    super::print(arguments.format, &words, &numbers)
}

fn style() -> ProgressStyle {
    ProgressStyle::with_template("{wide_bar} {pos}/{len} models, {elapsed}, fitting: {msg}")
        .unwrap_or_else(|_| ProgressStyle::default_bar())
}

impl Arguments {
    fn candidates(&self, image_size_px: [u32; 2]) -> Result<Vec<Candidate>, Failure> {
        if let Some(path) = &self.start {
            let camera = MountedCamera::load(path).map_err(Failure::usage)?;
            if camera.image_size_px() != image_size_px {
                let ([w, h], [cw, ch]) = (image_size_px, camera.image_size_px());
                let path = path.display();
                return Err(Failure::usage(format!(
                    "{path}: a camera of {cw}x{ch} pixels, the corners are of {w}x{h}"
                )));
            }
            return candidate::of_design(camera.camera()).map_err(Failure::usage);
        }
        let of_kind = |kind: &Kind| kind.candidates(image_size_px, self.centre_px).map_err(Failure::usage);
        Ok(self.model.kinds().iter().map(of_kind).collect::<Result<Vec<_>, _>>()?.concat())
    }

    /// Boards in all pictures of a folder; pictures without one are remarked on.
    fn find_corners(&self, folder: &Path) -> Result<(Observations, Vec<String>), Failure> {
        let (Some(size), Some(square_mm)) = (self.board, self.square_mm) else {
            return Err(Failure::usage("--pictures needs --board and --square-mm"));
        };
        let board = Board::new(size, square_mm * 1e-3).map_err(Failure::usage)?;
        let pictures = pictures(folder)?;
        let mut remarks = Vec::new();
        let mut found = BTreeMap::new();
        let mut image_size_px = None;
        for path in pictures.iter().progress() {
            let picture = read_gray(path, image_size_px).map_err(Failure::job)?;
            image_size_px = Some([picture.width, picture.height]);
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            match corners::find_board(&picture, size) {
                Ok(corners) => {
                    found.insert(name, corners);
                }
                Err(reason) => remarks.push(format!("{}: {reason}", path.display())),
            }
        }
        let Some(image_size_px) = image_size_px.filter(|_| !found.is_empty()) else {
            let first = remarks.first().cloned().unwrap_or_default();
            let pictures = pictures.len();
            return Err(Failure::job(format!("{}: no board in any of {pictures} pictures; {first}", folder.display())));
        };
        remarks.insert(0, format!("{} boards found in {} pictures", found.len(), pictures.len()));
        if let Some(path) = &self.save_corners {
            super::save(path, &corner_file::to_json(&board, image_size_px, &found).map_err(Failure::job)?)?;
        }
        let views = found.into_iter().map(|(name, corners)| board.view(name, &corners));
        let views = views.collect::<Result<Vec<_>, _>>().map_err(Failure::job)?;
        Ok((Observations::new(image_size_px, views).map_err(Failure::job)?, remarks))
    }
}

fn pictures(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let unreadable = |e: std::io::Error| Failure::usage(format!("{}: cannot be read: {e}", folder.display()));
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        if robot_agent::capture::is_picture(&path) {
            paths.push(path);
        }
    }
    paths.sort();
    if paths.is_empty() {
        return Err(Failure::usage(format!("{}: no pictures (png, jpg, jpeg, bmp, pgm)", folder.display())));
    }
    Ok(paths)
}

/// The camera file, with what is known of its numbers as comments.
fn camera_file(summary: &Summary) -> String {
    let fit = &summary.best().fit;
    let mut text = format!("# {} \n", summary.words().first().cloned().unwrap_or_default());
    for (i, unknown) in fit.camera.unknowns().iter().enumerate() {
        if let Some(covariance) = &summary.covariance {
            let _ = writeln!(text, "# {}: one sigma {:.3e}", unknown.name, covariance.sigma(i));
        }
    }
    text.push_str(&camera_toml(fit.camera.camera().as_ref()));
    text
}
