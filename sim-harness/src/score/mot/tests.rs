use super::*;

fn frames(list: &[(u64, u64, f64, f64)]) -> Frames {
    let mut frames = Frames::new();
    for &(frame, id, x, y) in list {
        frames.entry(frame).or_default().push(TrackBox { id, xywh: [x, y, 10.0, 20.0] });
    }
    frames
}

#[test]
fn truth_against_itself_is_perfect() {
    let truth = frames(&[(1, 1, 0.0, 0.0), (1, 2, 50.0, 0.0), (2, 1, 3.0, 0.0), (2, 2, 47.0, 0.0)]);
    let s = score(&truth, &truth, 0.5);
    assert_eq!((s.misses, s.false_positives, s.switches), (0, 0, 0));
    assert_eq!([s.mota, s.idf1, s.box_f, s.motp_iou], [1.0; 4]);
}

#[test]
fn two_who_exchange_their_numbers_cost_two_switches_and_half_of_idf1() {
    let truth = frames(&[(1, 1, 0.0, 0.0), (1, 2, 50.0, 0.0), (2, 1, 0.0, 0.0), (2, 2, 50.0, 0.0)]);
    let tracks = frames(&[(1, 7, 0.0, 0.0), (1, 8, 50.0, 0.0), (2, 8, 0.0, 0.0), (2, 7, 50.0, 0.0)]);
    let s = score(&truth, &tracks, 0.5);
    assert_eq!((s.misses, s.false_positives, s.switches, s.idtp), (0, 0, 2, 2));
    assert_eq!((s.mota, s.idf1, s.box_f), (0.5, 0.5, 1.0));
}

#[test]
fn a_pair_stays_matched_while_it_overlaps_though_another_box_overlaps_more() {
    let truth = frames(&[(1, 1, 0.0, 0.0), (2, 1, 0.0, 0.0)]);
    let tracks = frames(&[(1, 7, 0.0, 0.0), (2, 7, 3.0, 0.0), (2, 8, 0.0, 0.0)]);
    let s = score(&truth, &tracks, 0.5);
    assert_eq!((s.switches, s.false_positives), (0, 1));
}

/// Reads a file with that text.
fn read_text(text: &str) -> Result<Frames, BoxesError> {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), text).unwrap();
    read(file.path(), 1.0)
}

#[test]
fn an_id_twice_in_a_frame_is_refused_with_line_frame_and_id() {
    let error = read_text("1,7,0,0,10,20\n2,7,0,0,10,20\n2,7,50,0,10,20\n").unwrap_err().to_string();
    assert!(error.contains("line 3") && error.contains("id 7") && error.contains("frame 2"), "{error}");
    let object = r#"{"track":3,"state":"visible","box":[0,0,9,9]}"#;
    let error = read_text(&format!("{{\"frame\":4,\"objects\":[{object},{object}]}}\n")).unwrap_err().to_string();
    assert!(error.contains("line 1") && error.contains("id 3") && error.contains("frame 5"), "{error}");
    // A box of the truth that does not count has no say.
    assert_eq!(read_text("1,7,0,0,10,20,0\n1,7,0,0,10,20,1\n").unwrap()[&1].len(), 1);
}

#[test]
fn frames_of_mot_text_count_from_1() {
    let error = read_text("0,7,0,0,10,20\n").unwrap_err().to_string();
    assert!(error.contains("line 1") && error.contains("frame 0") && error.contains("from 1 on"), "{error}");
}

/// 60 frames of five people and noisy tracks from a seed; expected values are py-motmetrics 1.4.0's on the same boxes.
#[test]
fn scores_agree_with_py_motmetrics() {
    let golden: serde_json::Value = serde_json::from_str(include_str!("golden.json")).unwrap();
    let boxes = |key: &str| {
        let mut frames = Frames::new();
        for row in golden[key].as_array().unwrap() {
            let v: Vec<f64> = row.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
            let found = TrackBox { id: v[1] as u64, xywh: [v[2], v[3], v[4], v[5]] };
            frames.entry(v[0] as u64).or_default().push(found);
        }
        frames
    };
    let (truth, tracks) = (boxes("truth"), boxes("tracks"));
    for want in golden["scores"].as_array().unwrap() {
        let s = score(&truth, &tracks, want["iou"].as_f64().unwrap());
        let count = |key: &str| want[key].as_u64().unwrap() as usize;
        assert_eq!(s.switches, count("num_switches"), "{want}");
        assert_eq!(s.misses, count("num_misses"), "{want}");
        assert_eq!(s.false_positives, count("num_false_positives"), "{want}");
        for (ours, key) in [(s.mota, "mota"), (s.idf1, "idf1"), (s.idp, "idp"), (s.idr, "idr")] {
            assert!((ours - want[key].as_f64().unwrap()).abs() < 1e-9, "{key}: {ours} in {want}");
        }
    }
}
