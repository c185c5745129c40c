//! Rules of the house that the compiler cannot see: who may know whom.

use std::fs;
use std::path::{Path, PathBuf};

#[test]
fn world_and_renderer_share_no_formula_with_the_agent() {
    // A mistake shared between the simulation and the code under test would pass every end-to-end test.
    let forbidden =
        ["robot_agent", "team_leader", "protocol::frames", "protocol::angle", "marker::predict", "marker::features"];
    for file in sources("sim-harness/src", &["world", "render"]) {
        assert_names_none_of(&file, &forbidden);
    }
}

#[test]
fn agent_and_leader_cores_know_no_clock_network_runtime_or_random_source() {
    let forbidden = ["tokio", "zenoh", "SystemTime", "Instant::now", "rand::", "rand_chacha", "thread::"];
    let agent = sources("robot-agent/src", &["agent", "optics", "panorama", "motion", "tracking", "peers", "picture"]);
    let leader = sources(
        "team-leader/src",
        &[
            "leader",
            "calibration",
            "clock_offset",
            "correspondence",
            "solve",
            "stereo",
            "team_map",
            "timeline",
            "planning",
        ],
    );
    for file in agent.iter().chain(&leader) {
        assert_names_none_of(file, &forbidden);
    }
}

#[test]
fn agent_and_leader_do_not_depend_on_each_other() {
    for (package, other) in [("robot-agent", "team-leader"), ("team-leader", "robot-agent")] {
        let manifest = fs::read_to_string(root().join(package).join("Cargo.toml")).unwrap();
        assert!(!manifest.contains(other), "{package} depends on {other}");
    }
}

#[test]
fn the_top_level_holds_what_the_owner_fixed_and_nothing_else() {
    let allowed = [
        "Cargo.toml",
        "Cargo.lock",
        "CHANGELOG.md",
        "LICENSE-APACHE",
        "LICENSE-MIT",
        "README.md",
        "deploy",
        "protocol",
        "robot-agent",
        "sim-harness",
        "target",
        "team-leader",
        "tests",
        "out",
    ];
    for entry in fs::read_dir(root()).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(name.starts_with('.') || allowed.contains(&name.as_str()), "{name} does not belong at the top level");
    }
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_path_buf()
}

/// All Rust files of the modules `names` below `folder`: `name.rs` and everything in `name/`.
fn sources(folder: &str, names: &[&str]) -> Vec<PathBuf> {
    let folder = root().join(folder);
    let mut found = Vec::new();
    for name in names {
        let file = folder.join(format!("{name}.rs"));
        if file.is_file() {
            found.push(file);
        }
        collect(&folder.join(name), &mut found);
    }
    assert!(!found.is_empty(), "no sources below {}", folder.display());
    found
}

fn collect(folder: &Path, found: &mut Vec<PathBuf>) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for path in entries.map(|entry| entry.unwrap().path()) {
        // Tests draw noise and look at the clock; they are no part of a core.
        if path.file_stem().is_some_and(|stem| stem == "tests" || stem == "reality") {
            continue;
        }
        if path.is_dir() {
            collect(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// Comments and test modules may name what the code may not: tests draw noise.
fn assert_names_none_of(file: &Path, forbidden: &[&str]) {
    let text = fs::read_to_string(file).unwrap();
    let code = text.split("#[cfg(test)]").next().unwrap_or_default();
    for (number, line) in code.lines().enumerate() {
        let line = line.split("//").next().unwrap_or_default();
        for name in forbidden {
            assert!(!line.contains(name), "{}:{}: names {name}: {}", file.display(), number + 1, line.trim());
        }
    }
}
