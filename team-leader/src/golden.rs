//! Golden numbers for tests: they come from code that shares nothing with this project.

/// A group of `tests/golden/golden.json`.
pub(crate) fn golden(group: &str) -> serde_json::Value {
    let text = include_str!("../../tests/golden/golden.json");
    let all: serde_json::Value = serde_json::from_str(text).unwrap();
    assert!(all[group].is_object(), "no golden group {group}");
    all[group].clone()
}
