use std::path::Path;

use super::{cmc, mrclam, roh};

/// A folder with these files.
fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in files {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    folder
}

/// The error of a replay, which names all of these.
fn refused<R: std::fmt::Debug>(
    replay: impl Fn(&Path) -> Result<R, super::RecordedError>,
    files: &[(&str, &str)],
    named: &[&str],
) {
    let error = replay(folder(files).path()).unwrap_err().to_string();
    assert!(named.iter().all(|word| error.contains(word)), "{error}");
}

const STANDING: &str = "1248000000.0 0 0\n1248000001.0 0 0\n";

fn mrclam_with(odometry: &str, barcodes: &str, named: &[&str]) {
    let files = [
        ("Barcodes.dat", barcodes),
        ("Robot1_Measurement.dat", "1248000000.5 14 1.0 0.0\n"),
        ("Robot1_Odometry.dat", odometry),
        ("Robot1_Groundtruth.dat", ""),
        ("Robot2_Measurement.dat", ""),
        ("Robot2_Odometry.dat", STANDING),
        ("Robot2_Groundtruth.dat", ""),
    ];
    refused(mrclam::replay, &files, named);
}

#[test]
fn a_time_of_odometry_far_beyond_the_others_is_named_with_its_line() {
    let barcodes = "1 5\n2 14\n";
    mrclam_with(
        "# time\n1248000000.0 0 0\n1e15 0 0\n",
        barcodes,
        &["Robot1_Odometry.dat, line 3", "1000000000000000", "4.1e9"],
    );
    mrclam_with(
        "1248000000.0 0 0\n1248100000.0 0 0\n",
        barcodes,
        &["Robot1_Odometry.dat, line 2", "1248100000", "86400"],
    );
    mrclam_with("-1 0 0\n", barcodes, &["Robot1_Odometry.dat, line 1", "-1", "from 0"]);
    mrclam_with(STANDING, "0 14\n", &["Barcodes.dat, line 1", "\"0\"", "from 1 on"]);
}

const CAMERAS: &str = r#"{"cam1": {"P_3x4": [[0, -1, 0, 0], [0, 0, -1, 2], [1, 0, 0, 5]]}}"#;
const TRUTH: &str = "1 1 -1 -1 -1 -1 -1 3.0 1.0 0.8\n";

#[test]
fn a_frame_far_beyond_the_others_and_one_that_is_no_whole_number_are_named_with_their_line() {
    for (frame, truth, named) in [
        ("1000000000000", TRUTH, ["DET_x_Cam1.txt, line 2", "1000000000000", "0 to 100000"]),
        ("2.5", TRUTH, ["DET_x_Cam1.txt, line 2", "2.5", "0 to 100000"]),
        ("2", "-3 1 -1 -1 -1 -1 -1 3.0 1.0 0.8\n", ["GT_x_WORLD_CENTROID.txt, line 1", "-3", "0 to 100000"]),
    ] {
        let boxes = format!("1,-1,100,100,50,90\n{frame},-1,100,100,50,90\n");
        let files = [("cameras.json", CAMERAS), ("GT_x_WORLD_CENTROID.txt", truth), ("DET_x_Cam1.txt", &boxes)];
        refused(cmc::replay, &files, &named);
    }
}

#[test]
fn boxes_of_nobody_and_of_other_frames_than_the_truths_are_refused() {
    let with = |boxes| [("cameras.json", CAMERAS), ("GT_x_WORLD_CENTROID.txt", TRUTH), ("DET_x_Cam1.txt", boxes)];
    refused(cmc::replay, &with(""), &["no box", "DET_"]);
    refused(cmc::replay, &with("7,-1,100,100,50,90\n"), &["no frame is both", "GT_"]);
}

#[test]
fn fewer_than_four_beacons_are_refused() {
    let bearings = ("(X1.0,Y1.0).csv", "10,20,30,40\n");
    refused(roh::replay, &[("landmark.csv", ""), bearings], &["landmark.csv", "0 beacons", "at least 4"]);
    refused(roh::replay, &[("landmark.csv", "0,0\n"), bearings], &["landmark.csv", "1 beacons", "at least 4"]);
}
