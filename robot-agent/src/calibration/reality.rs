//! Calibrations from recordings of others; they need the folder `PALTEAM_DATA` and are ignored otherwise.

use std::path::{Path, PathBuf};

use nalgebra::{Matrix2, Vector2};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use super::axis;
use super::bundle::Fit;
use super::candidate::Kind;
use super::corner_file;
use super::corners::find_board;
use super::floor::{self, Plan};
use super::observation::Observations;
use super::rim::{self, Rim};
use super::selection::{Selection, select};
use super::summary::Summary;
use super::{Board, BoardSize};
use crate::capture::read_gray;
use crate::optics::CameraFile;

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
                    let nearest =
                        reference.iter().map(|r| (Vector2::from(*r) - c).norm()).fold(f64::INFINITY, f64::min);
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
    assert!(boards >= 14 && pictures == 16, "{boards} of {pictures}");
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

/// Mean over random halvings of the views of the squared distance of the two centres in sigmas, a component.
fn halvings(observations: &Observations, fit: &Fit) -> f64 {
    let index = ["centre_px[0]", "centre_px[1]"].map(|name| fit.camera.unknown(name).unwrap());
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut all: Vec<usize> = (0..observations.views.len()).collect();
    let runs = 20;
    let mut total = 0.0;
    for _ in 0..runs {
        all.shuffle(&mut random);
        let halves = [&all[..all.len() / 2], &all[all.len() / 2..]].map(|half| {
            let poses = half.iter().map(|v| fit.poses[*v].clone()).collect();
            Fit::from_poses(&observations.subset(half), &fit.camera, poses).unwrap()
        });
        let centres = halves.each_ref().map(|f| index.map(|i| f.camera.unknown_values()[i])).map(Vector2::from);
        let covariance = halves
            .iter()
            .map(|f| f.covariance().unwrap().matrix)
            .map(|c| Matrix2::from_fn(|i, j| c[(index[i], index[j])]))
            .sum::<Matrix2<f64>>();
        let apart = centres[0] - centres[1];
        total += apart.dot(&(covariance.try_inverse().unwrap() * apart)) / 2.0;
    }
    total / f64::from(runs)
}

fn centre(fit: &Fit) -> Vector2<f64> {
    let value = |name: &str| fit.camera.unknown_values()[fit.camera.unknown(name).unwrap()];
    Vector2::new(value("centre_px[0]"), value("centre_px[1]"))
}

/// What every good calibration of these sets must hold: unseen views within 15 %, and halves that agree.
fn assert_sound(observations: &Observations, selection: &Selection) {
    let best = selection.best();
    let unseen = best.unseen_rms_px.unwrap() / best.fit.weighted_rms_px();
    let nees = halvings(observations, &best.fit);
    println!("unseen / fit = {unseen:.3}, halvings NEES/2 = {nees:.2}");
    assert!(unseen < 1.15, "unseen views: {unseen}");
    assert!((0.5..2.0).contains(&nees), "halvings: NEES/2 = {nees}");
}

#[test]
#[ignore = "needs PALTEAM_DATA"]
fn a_real_mirror_is_calibrated_from_its_corners() {
    let observations = corner_file::read(&data("calib_kaidan_omni/corners_opencv.json")).unwrap();
    let selection = calibrated(&observations, &Kind::PANORAMIC);
    let fit = &selection.best().fit;
    assert!(fit.mean_px() <= 0.28, "{}", fit.mean_px());
    let off = (centre(fit) - Vector2::new(324.47, 247.71)).norm();
    assert!(off < 0.4, "{off} px from the published centre");
    assert_sound(&observations, &selection);
}

/// The mirror's rim where it is seen in OpenCV's pictures; its radius there is 529 px.
fn rim_of_opencv() -> Vector2<f64> {
    let rims: Vec<Rim> = (1..=18)
        .flat_map(|i| {
            let picture = read_gray(&data(&format!("calib_opencv_omnidir/images/{i}.jpg")), None).unwrap();
            rim::find(&picture, 1)
        })
        .filter(|rim| (rim.radius_px - 529.0).abs() < 5.0)
        .collect();
    println!("{rims:?}");
    rim::common_centre(&rims).expect("a rim in one of the pictures").centre_px
}

#[test]
#[ignore = "needs PALTEAM_DATA"]
fn the_misaligned_mirror_of_opencv_is_calibrated_from_its_corners() {
    let observations = corner_file::read(&data("calib_opencv_omnidir/corners_opencv.json")).unwrap();
    let selection = calibrated(&observations, &[Kind::UnifiedSphere, Kind::KannalaBrandt]);
    let fit = &selection.best().fit;
    assert!(fit.rms_px() <= 0.42, "{}", fit.rms_px());
    let summary = Summary::new(&observations, &selection);
    println!("{:#?}\n{:?}\n{:#?}", summary.axes(), summary.centre_covariance_px2(), summary.words());
    // OpenCV's own model has OpenCV's own centre: there the same number means the same thing.
    let published = Vector2::new(630.3, 432.6);
    let opencv = selection.judged.iter().find(|j| j.name == "unified sphere, all terms").unwrap();
    assert!((centre(&opencv.fit) - published).norm() < 0.4, "{}", centre(&opencv.fit));
    // Another model may turn the axis against OpenCV's, which moves the centre; turned back, it must image OpenCV's axis
    // where OpenCV does, and have its own not farther away than its own covariance allows: χ² with 2 degrees of freedom, 1 %.
    let pixels = observations.views.iter().flat_map(|v| &v.points).map(|(_, pixel)| *pixel);
    let shared = axis::shared(opencv.fit.camera.camera().as_ref(), fit.camera.camera().as_ref(), pixels).unwrap();
    let information = summary.centre_covariance_px2().unwrap().try_inverse().unwrap();
    for found in [shared.image_px.unwrap(), summary.centre_px()] {
        let apart = found - published;
        println!("axis at {:?}, χ² {:.2}", found.as_slice(), apart.dot(&(information * apart)));
        assert!(apart.dot(&(information * apart)) < 9.21, "{found} {information}");
    }
    // The mirror's rim in the pictures knows nothing of any model. It lies before the apex, so that a camera beside the
    // mirror's axis sees it a little nearer to the middle of the picture; the aligned camera misses it by far.
    let rim = rim_of_opencv();
    let aligned = selection.judged.iter().find(|j| j.name == "fisheye, Kannala-Brandt").unwrap();
    let from_rim = |centre: Vector2<f64>| (centre - rim).norm();
    let (misaligned, aligned) = (from_rim(summary.centre_px()), from_rim(centre(&aligned.fit)));
    assert!(misaligned < 0.25 * aligned, "{misaligned} and {aligned} px from the rim's centre");
    assert!(summary.words().iter().any(|w| w.contains("misaligned")), "{:?}", summary.words());
    assert_sound(&observations, &selection);
}

#[test]
#[ignore = "needs PALTEAM_DATA"]
fn the_xml_of_opencv_is_calibrated_to_opencv_s_own_error() {
    let observations = corner_file::read(&data("calib_opencv_omnidir/omni_calib_data.xml")).unwrap();
    let selection = calibrated(&observations, &[Kind::UnifiedSphere]);
    let fit = &selection.best().fit;
    // OpenCV: rms 0.812 px, centre (630.3, 431.9). Its fit is plain least squares; ours lets points far off count less, so
    // that the rms over all of them is a little larger. As plain least squares ours is OpenCV's.
    let opencv = selection.judged.iter().find(|j| j.name == "unified sphere, all terms").unwrap();
    let plain = Fit::in_rounds(&observations, &opencv.fit.camera, opencv.fit.poses.clone(), 1).unwrap();
    println!("robust {:.4}, plain {:.4} px, centre {:?}", fit.rms_px(), plain.rms_px(), centre(&plain).as_slice());
    assert!((plain.rms_px() - 0.812).abs() < 0.001, "{}", plain.rms_px());
    assert!((centre(&plain) - Vector2::new(630.3, 431.9)).norm() < 0.3, "{}", centre(&plain));
    assert!(fit.rms_px() < 0.83 && (centre(fit) - Vector2::new(630.3, 431.9)).norm() < 1.5, "{}", centre(fit));
}

#[test]
#[ignore = "needs PALTEAM_DATA"]
fn corners_found_in_the_pictures_calibrate_as_well() {
    let size = BoardSize { cols: 6, rows: 9 };
    let board = Board::new(size, 0.08).unwrap();
    let views = (1..=18).filter_map(|i| {
        let picture = read_gray(&data(&format!("calib_opencv_omnidir/images/{i}.jpg")), None).unwrap();
        Some(board.view(format!("{i}"), &find_board(&picture, size).ok()?).unwrap())
    });
    let observations = Observations::new([1280, 960], views.collect()).unwrap();
    let selection = calibrated(&observations, &[Kind::UnifiedSphere]);
    assert!(selection.best().fit.rms_px() <= 0.42, "{}", selection.best().fit.rms_px());
    let size = BoardSize { cols: 11, rows: 7 };
    let board = Board::new(size, 0.03).unwrap();
    let views = (1..=17).filter_map(|i| {
        let picture = read_gray(&data(&format!("calib_kaidan_omni/KaidanOmni{i}.jpg")), None).unwrap();
        Some(board.view(format!("{i}"), &find_board(&picture, size).ok()?).unwrap())
    });
    let observations = Observations::new([640, 480], views.collect()).unwrap();
    let selection = calibrated(&observations, &Kind::PANORAMIC);
    assert!(selection.best().fit.mean_px() <= 0.28, "{}", selection.best().fit.mean_px());
    let off = (centre(&selection.best().fit) - Vector2::new(324.47, 247.71)).norm();
    assert!(off < 0.4, "{off} px from the published centre");
}

/// The RoboCup field (middle-size league) of NuBot's robots: 18 × 12 m, lines 12.5 cm wide.
fn field() -> Plan {
    let (x, y) = (9.0, 6.0);
    let box_of = |x0: f64, x1: f64, y: f64| [[x0, -y, x1, -y], [x0, y, x1, y], [x0, -y, x0, y], [x1, -y, x1, y]];
    let mut lines_m = vec![[0.0, -y, 0.0, y]];
    lines_m.extend(box_of(-x, x, y));
    for side in [-1.0, 1.0] {
        lines_m.extend(box_of(side * x, side * 6.75, 3.25));
        lines_m.extend(box_of(side * x, side * 8.25, 1.75));
    }
    Plan { lines_m, circles_m: vec![[0.0, 0.0, 2.0]], line_width_m: 0.125 }
}

/// NuBot's law, distance on the floor = a tan(b ρ), is a camera that looks down from a with an equal angle b a pixel.
#[test]
#[ignore = "needs PALTEAM_DATA"]
fn a_mirror_calibration_that_was_copied_from_another_robot_is_noticed() {
    for (robot, right) in [(1, true), (5, true), (3, false)] {
        let folder = data(&format!("calib_nubot_mirror/{robot}"));
        let xml = std::fs::read_to_string(folder.join("mirror_calib.xml")).unwrap();
        let xml = roxmltree::Document::parse(&xml).unwrap();
        let number = |name: &str| -> f64 {
            let node = xml.descendants().find(|n| n.has_tag_name(name)).unwrap();
            node.text().unwrap().trim().parse().unwrap()
        };
        let text = format!(
            "model = \"fisheye\"\nimage_size_px = [480, 480]\n[fisheye]\nlaw = \"equidistant\"\nfocal_length_px = {}\n\
             centre_px = [{}, {}]\n[mounting]\nheight_m = {}\nrotation_rpy_deg = [180.0, 0.0, 0.0]\n",
            number("para_b").recip(),
            number("center_coloum"),
            number("center_row"),
            number("para_a")
        );
        let camera = CameraFile::parse(&text, "mirror_calib.xml".as_ref()).unwrap().mount().unwrap();
        let whites = std::fs::read_to_string(folder.join("whites.txt")).unwrap();
        let numbers: Vec<f64> = whites.split_whitespace().map(|n| n.parse().unwrap()).collect();
        let points: Vec<[f64; 2]> = numbers.chunks_exact(2).map(|p| [p[0], p[1]]).collect();
        let fit = floor::fit(&camera, &field(), &points, 0.5, 5.0).unwrap();
        println!("robot {robot}: {}", fit.words());
        assert_eq!(fit.fits(), right, "{fit:?}");
        // Others reach 3.7 to 4.2 cm in the median.
        assert!(!right || fit.median_m < 0.042, "{fit:?}");
    }
}
