//! The golden numbers of `tests/golden`, for the tests of this module.

use serde_json::Value;

pub(super) fn golden(group: &str) -> Value {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/golden/golden.json");
    let all: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    all[group].clone()
}

pub(super) fn number(of: &Value, name: &str) -> f64 {
    of[name].as_f64().unwrap()
}

pub(super) fn numbers(of: &Value, name: &str) -> Vec<f64> {
    of[name].as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}
