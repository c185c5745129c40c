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
