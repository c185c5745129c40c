use super::*;

/// The limit of the project: right again within 2 s after the fault ends.
const LIMIT_S: f64 = 2.0;

#[test]
fn leaders_that_are_killed_frozen_split_or_stuck_leave_a_right_map() {
    // Seeds 0, 1, 2 and 6: the kinds come in turn.
    all_right([0, 1, 2, 6]);
}

#[test]
fn a_seed_fixes_everything() {
    let text = || serde_json::to_string(&run(3).unwrap()).unwrap();
    assert_eq!(text(), text());
}

fn all_right(seeds: impl IntoIterator<Item = u64>) {
    let mut wrong = Vec::new();
    for seed in seeds {
        let run = run(seed).unwrap();
        println!("{}", crate::cli::chaos::line(&run));
        let late = run.findings.right_again_s.is_none_or(|after_s| after_s > LIMIT_S);
        if late || run.alarms.1 > 0 || !run.findings.violations.is_empty() {
            wrong.push(run);
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
