//! Calibrations from recordings of others; they need the folder `PALTEAM_DATA` and are ignored otherwise.
#![expect(clippy::unwrap_used, clippy::expect_used, reason = "a test fails by panicking")]

use std::path::{Path, PathBuf};

use nalgebra::Vector2;

use super::BoardSize;
use super::candidate::Kind;
use super::corner_file;
use super::corners::find_board;
use super::observation::Observations;
use super::selection::{Selection, select};
use crate::capture::read_gray;

fn data(name: &str) -> PathBuf {
    Path::new(&std::env::var("PALTEAM_DATA").expect("PALTEAM_DATA names the folder of recordings")).join(name)
}

/// Boards found, and the median distance to the corners that OpenCV found in the same pictures.
fn found(folder: &str, corners: &str) -> (usize, usize, f64) {
    let text = std::fs::read_to_string(data(corners)).unwrap();
    let file: serde_json::Value = serde_json::from_str(&text).unwrap();
    let number = |key: &str| file["board"][key].as_u64().unwrap() as usize;
    let size = BoardSize { cols: number("cols"), rows: number("rows") };
    let (mut boards, mut distances) = (0, Vec::new());
    let listed = file["corners"].as_object().unwrap();
    for (name, reference) in listed {
        let picture = read_gray(&data(folder).join(name), None).unwrap();
        let reference: Vec<[f64; 2]> = serde_json::from_value(reference.clone()).unwrap();
        match find_board(&picture, size) {
            Ok(corners) => {
                boards += 1;
                let before = distances.len();
                for c in &corners {
                    let nearest = reference.iter().map(|r| (Vector2::from(*r) - c).norm()).fold(f64::INFINITY, f64::min);
                    distances.push(nearest);
                }
                let worst = distances[before..].iter().copied().fold(0.0, f64::max);
                println!("{name}: worst {worst:.2}");
            }
            Err(reason) => println!("{name}: {reason}"),
        }
    }
    distances.sort_by(f64::total_cmp);
    (boards, listed.len(), distances[distances.len() / 2])
}

#[test]
#[ignore = "needs PALTEAM_DATA"]
fn boards_are_found_in_the_pictures_of_a_real_mirror() {
    let (boards, pictures, median_px) = found("calib_kaidan_omni", "calib_kaidan_omni/corners_opencv.json");
    println!("Kaidan: {boards} of {pictures}, median {median_px:.3} px");
    assert!(boards >= 14 && pictures == 17, "{boards} of {pictures}");
    assert!(median_px < 0.3, "{median_px}");
}

#[test]
#[ignore = "needs PALTEAM_DATA"]
fn boards_are_found_in_the_pictures_of_opencv() {
    let (boards, pictures, median_px) =
        found("calib_opencv_omnidir/images", "calib_opencv_omnidir/corners_opencv.json");
    println!("OpenCV: {boards} of {pictures}, median {median_px:.3} px");
    assert!(boards >= 16 && pictures == 18, "{boards} of {pictures}");
    assert!(median_px < 0.3, "{median_px}");
}

fn calibrated(observations: &Observations, kinds: &[Kind]) -> Selection {
    let size = observations.image_size_px;
    let candidates: Vec<_> = kinds.iter().flat_map(|kind| kind.candidates(size, None).unwrap()).collect();
    let selection = select(observations, &candidates).unwrap();
    for j in &selection.judged {
        let c = j.fit.covariance();
        let sigmas: Vec<String> = j
            .fit
            .camera
            .unknowns()
            .iter()
            .zip(j.fit.camera.unknown_values())
            .enumerate()
            .map(|(i, (u, v))| format!("{} {v:.4}±{:.4}", u.name, c.as_ref().map_or(f64::NAN, |c| c.sigma(i))))
            .collect();
        println!(
            "{}: rms {:.3} mean {:.3} unseen {:.3} bic {:.0} outliers {} {:?}\n   {}",
            j.name,
            j.fit.rms_px(),
            j.fit.mean_px(),
            j.unseen_rms_px.unwrap(),
            j.information_criterion,
            j.fit.outliers(),
            c.map(|c| c.source),
            sigmas.join(", ")
        );
    }
    for (name, error) in &selection.failed {
        println!("{name}: {error}");
    }
    println!("chosen: {}; {:?}", selection.best().name, selection.best().fit.undetermined());
    selection
}

#[test]
#[ignore = "needs PALTEAM_DATA"]
fn a_real_mirror_is_calibrated_from_its_corners() {
    let observations = corner_file::read(&data("calib_kaidan_omni/corners_opencv.json")).unwrap();
    calibrated(&observations, &[Kind::UnifiedSphere, Kind::Polynomial, Kind::KannalaBrandt]);
}

#[test]
#[ignore = "needs PALTEAM_DATA"]
fn the_misaligned_mirror_of_opencv_is_calibrated_from_its_corners() {
    let observations = corner_file::read(&data("calib_opencv_omnidir/corners_opencv.json")).unwrap();
    calibrated(&observations, &[Kind::UnifiedSphere, Kind::Polynomial, Kind::KannalaBrandt]);
}

#[test]
#[ignore = "needs PALTEAM_DATA"]
fn the_xml_of_opencv_is_calibrated() {
    let observations = corner_file::read(&data("calib_opencv_omnidir/omni_calib_data.xml")).unwrap();
    calibrated(&observations, &[Kind::UnifiedSphere]);
}
