//! What is simulated: room, furniture, lamps, robots, people, camera, clocks, as one TOML file a person writes.
//!
//! A scenario and a seed fix everything: the places of the robots, the paths of the people, every pixel's noise.
//! All keys have defaults that give the exam of the project (`scenarios/default.toml`); an unknown key or an impossible
//! value is an error that names the key, the value and what would be right.

mod camera;
mod check;
mod others;
mod room;
mod wear;

use std::path::{Path, PathBuf};

use protocol::id::RobotId;
use protocol::marker::Marker;
use serde::{Deserialize, Serialize};

pub use camera::{CameraSpec, TiltSpec};
pub use others::{EyeSpec, OtherCamera, Slopes};
pub use room::{FurnitureKind, FurnitureSpec, LampSpec, RoomSpec, share_at};
pub use wear::{BeaconSpec, WearOf, WearSpec};

/// Why a scenario cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ScenarioError {
    /// The file cannot be read.
    #[error("cannot read the scenario {}: {source}; give a TOML file or one of: {}", file.display(), Scenario::BUILTIN.join(", "))]
    Unreadable {
        /// Which.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Not TOML, or an unknown key, or a value of the wrong type.
    #[error("{name}: {message}")]
    Syntax {
        /// Which file.
        name: String,
        /// The parser's words, with line and column.
        message: String,
    },
    /// A value outside its range.
    #[error("{name}: `{key} = {value}` is not possible; right would be {right}")]
    Value {
        /// Which file.
        name: String,
        /// Dotted key.
        key: String,
        /// As read.
        value: String,
        /// What would be right.
        right: String,
    },
}

/// A whole scenario, checked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// For reports.
    pub name: String,
    /// Length of the run. 0.1 … 3600.
    pub duration_s: f64,
    /// Used where the command line gives none.
    #[serde(default)]
    pub seed: u64,
    /// Size, paint, furniture, lamps.
    #[serde(default)]
    pub room: RoomSpec,
    /// The robots and their ways.
    #[serde(default)]
    pub robots: RobotsSpec,
    /// The people.
    #[serde(default)]
    pub people: PeopleSpec,
    /// Frame times and clocks.
    #[serde(default)]
    pub capture: CaptureSpec,
    /// The PAL camera on every robot, and the robots that have another.
    #[serde(default)]
    pub camera: CameraSpec,
}

/// The robots.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RobotsSpec {
    /// How many, named r1, r2, …: 1 … 16.
    pub count: usize,
    /// Fixed poses [x m, y m, heading °] for the first robots; the seed places the rest.
    pub poses: Vec<[f64; 3]>,
    /// Least distance between two robots, metres.
    pub apart_m: f64,
    /// Largest distance between two robots, metres.
    pub within_m: f64,
    /// Who drives when.
    pub drives: Vec<DriveSpec>,
    /// What robots wear; those not named wear rings.
    pub wear: Vec<WearOf>,
}

impl Default for RobotsSpec {
    fn default() -> Self {
        Self { count: 3, poses: Vec::new(), apart_m: 1.2, within_m: 4.5, drives: Vec::new(), wear: Vec::new() }
    }
}

/// A straight drive forward, then a turn on the spot, smoothly, without odometry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DriveSpec {
    /// Which robot, e.g. "r2".
    pub robot: RobotId,
    /// Beginning.
    pub start_s: f64,
    /// End.
    pub end_s: f64,
    /// Forward. 0 … 6.
    pub distance_m: f64,
    /// At the end of the way, counter-clockwise.
    pub turn_deg: f64,
}

/// People who walk, stop, meet and part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PeopleSpec {
    /// How many: 0 … 16.
    pub count: usize,
    /// Smallest and largest standing height.
    pub height_m: [f64; 2],
    /// Usual walking speed.
    pub speed_mps: f64,
    /// How long each one stops, once or more.
    pub stop_s: f64,
    /// How many of them wear clothes within 15 grey levels of what is mostly behind them (the last ones).
    pub camouflaged: usize,
    /// Fixed places [x m, y m] where the first people stand all the time.
    pub standing: Vec<[f64; 2]>,
    /// Where each person is when, as [time s, x m, y m] in order of time: straight from one to the next, standing before the
    /// first and after the last. For nobody, or for everybody; then nothing else moves them.
    pub ways: Vec<Vec<[f64; 3]>>,
}

impl Default for PeopleSpec {
    fn default() -> Self {
        Self {
            count: 4,
            height_m: [1.55, 1.9],
            speed_mps: 1.0,
            stop_s: 10.0,
            camouflaged: 1,
            standing: Vec::new(),
            ways: Vec::new(),
        }
    }
}

/// When pictures are taken and what the robots' clocks say.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CaptureSpec {
    /// Frames a second: 0.1 … 100.
    pub rate_hz: f64,
    /// Each frame is early or late by up to this much, milliseconds. The phase of each robot is random.
    pub jitter_ms: f64,
    /// Each robot's clock is off by up to this much, milliseconds, constant.
    pub clock_offset_ms: f64,
}

impl Default for CaptureSpec {
    fn default() -> Self {
        Self { rate_hz: 10.0, jitter_ms: 10.0, clock_offset_ms: 20.0 }
    }
}

impl Scenario {
    /// Names of the scenarios inside the program.
    pub const BUILTIN: [&'static str; 5] = ["default", "tiny", "moving_start", "mixed", "beacons"];

    /// A scenario inside the program.
    pub fn builtin(name: &str) -> Option<Result<Self, ScenarioError>> {
        let text = match name {
            "default" => include_str!("../scenarios/default.toml"),
            "tiny" => include_str!("../scenarios/tiny.toml"),
            "moving_start" => include_str!("../scenarios/moving_start.toml"),
            "mixed" => include_str!("../scenarios/mixed.toml"),
            "beacons" => include_str!("../scenarios/beacons.toml"),
            _ => return None,
        };
        Some(Self::parse(text, name))
    }

    /// From a file, or by the name of a scenario inside the program.
    pub fn load(path: &Path) -> Result<Self, ScenarioError> {
        match std::fs::read_to_string(path) {
            Ok(text) => Self::parse(&text, &path.display().to_string()),
            Err(source) => path
                .to_str()
                .and_then(Self::builtin)
                .unwrap_or_else(|| Err(ScenarioError::Unreadable { file: path.to_owned(), source })),
        }
    }

    /// From text; `name` appears in errors.
    pub fn parse(text: &str, name: &str) -> Result<Self, ScenarioError> {
        let scenario: Self = toml::from_str(text)
            .map_err(|e| ScenarioError::Syntax { name: name.to_owned(), message: e.to_string() })?;
        scenario.check(name)?;
        Ok(scenario)
    }

    /// Whether every value is possible; `name` appears in the error.
    pub fn check(&self, name: &str) -> Result<(), ScenarioError> {
        check::check(self).map_err(|fault| ScenarioError::Value {
            name: name.to_owned(),
            key: fault.key,
            value: fault.value,
            right: fault.right,
        })
    }

    /// The robots' ids: r1, r2, …
    pub fn robot_ids(&self) -> Vec<RobotId> {
        (1..=self.robots.count).filter_map(|n| RobotId::new(&format!("r{n}")).ok()).collect()
    }

    /// The calibration file of a camera that stands upright: the truth about the simulated camera.
    pub fn camera_toml(&self) -> String {
        self.camera.toml()
    }

    /// The calibration file that a robot's agent gets: the truth, but for a tilt that is not known.
    pub fn camera_toml_of(&self, robot: &RobotId) -> String {
        self.camera.toml_of(robot)
    }

    /// A robot's pictures: those of a camera that turns come when it has turned, without jitter.
    pub fn capture_of(&self, robot: &RobotId) -> CaptureSpec {
        match self.camera.other(robot).and_then(|eye| eye.turn_s()) {
            Some(turn_s) => CaptureSpec { rate_hz: 1.0 / turn_s, jitter_ms: 0.0, ..self.capture.clone() },
            None => self.capture.clone(),
        }
    }

    /// What a robot wears, as it announces it.
    pub fn marker_of(&self, robot: &RobotId) -> Marker {
        self.robots.wear_of(robot).marker(self.robots.beacon_of(robot))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scenario_inside_the_program_is_valid() {
        for name in Scenario::BUILTIN {
            Scenario::builtin(name).unwrap().unwrap();
        }
    }

    #[test]
    fn an_unknown_key_is_named() {
        let error = Scenario::parse("name = \"x\"\nduration_s = 1.0\ncolour = 3\n", "x.toml").unwrap_err();
        let text = error.to_string();
        assert!(text.contains("x.toml") && text.contains("colour") && text.contains("line 3"), "{text}");
    }

    #[test]
    fn an_impossible_value_is_named_with_what_would_be_right() {
        let text = "name = \"x\"\nduration_s = 1.0\n[people]\nheight_m = [155.0, 190.0]\n";
        let text = Scenario::parse(text, "x.toml").unwrap_err().to_string();
        assert!(text.contains("people.height_m") && text.contains("155") && text.contains("metres"), "{text}");
    }

    #[test]
    fn tilts_are_in_the_camera_file_only_where_they_are_known() {
        let tilt = |robot: &str, more: &str| {
            format!("[[camera.tilts]]\nrobot = \"{robot}\"\ntilt_deg = [1.5, -2.0]\n{more}\n")
        };
        let text = format!("name = \"x\"\nduration_s = 1.0\n{}{}", tilt("r1", ""), tilt("r2", "known = false"));
        let scenario = Scenario::parse(&text, "x.toml").unwrap();
        let files: Vec<String> = scenario.robot_ids().iter().map(|id| scenario.camera_toml_of(id)).collect();
        assert!(files[0].ends_with("[mounting]\nheight_m = 0.6\ntilt_deg = [1.5, -2.0]\n"), "{}", files[0]);
        assert!(files[1] == scenario.camera_toml() && files[2] == files[1]);
        assert_eq!(scenario.camera.tilt_deg(&scenario.robot_ids()[1]), [1.5, -2.0]);
        let head = "name = \"x\"\nduration_s = 1.0\n";
        for (wrong, said) in [
            (tilt("r9", ""), "r1, r2, r3"),
            (tilt("r1", "") + &tilt("r1", ""), "once"),
            (tilt("r1", "").replace("1.5", "15.0"), "degrees"),
        ] {
            let error = Scenario::parse(&format!("{head}{wrong}"), "x.toml").unwrap_err().to_string();
            assert!(error.contains("camera.tilts") && error.contains(said), "{error}");
        }
    }

    #[test]
    fn ways_and_light_that_cannot_be_are_named() {
        let head = "name = \"x\"\nduration_s = 1.0\n";
        for (text, key, right) in [
            ("[people]\ncount = 2\ncamouflaged = 0\nways = [[[0, 1, 1]]]\n", "people.ways", "one for each"),
            ("[people]\ncount = 1\ncamouflaged = 0\nways = [[[2, 1, 1], [1, 0, 0]]]\n", "people.ways[0][1]", "later"),
            ("[people]\ncount = 1\ncamouflaged = 0\nways = [[[2, 9, 1]]]\n", "people.ways[0][0]", "metres"),
            ("[room]\nambient_light = [[1, 1], [0, 1]]\n", "room.ambient_light[1]", "later"),
            ("[room]\nlamps = [{ position_m = [0, 0], light = [[0, -1]] }]\n", "room.lamps[0].light[0]", "0 to 10"),
        ] {
            let error = Scenario::parse(&format!("{head}{text}"), "x.toml").unwrap_err().to_string();
            assert!(error.contains(key) && error.contains(right), "{error}");
        }
    }

    #[test]
    fn numbers_that_are_none_and_places_that_cannot_be_are_named() {
        let head = "name = \"x\"\nduration_s = 1.0\n";
        for (text, key, value, right) in [
            ("[camera]\nrefraction_a_mm = nan", "camera.refraction_a_mm", "NaN", "0.1 to 1000 mm"),
            ("[camera]\nrefraction_a_mm = 0.0", "camera.refraction_a_mm", "0", "0.1 to 1000 mm"),
            ("[camera]\nellipsoid_a_mm = nan", "camera.ellipsoid_a_mm", "NaN", "0.1 to 1000 mm"),
            ("[camera]\nhyperboloid_c_mm = inf", "camera.hyperboloid_c_mm", "inf", "0.1 to 1000 mm"),
            ("[camera]\ncentre_px = [nan, 287.5]", "camera.centre_px[0]", "NaN", "0 to 767 pixels"),
            ("[camera]\ncentre_px = [383.5, 1e9]", "camera.centre_px[1]", "1000000000", "0 to 575 pixels"),
            ("[camera]\nelevation_deg = [-15.0, nan]", "camera.elevation_deg[1]", "NaN", "-59 to 80 degrees"),
            ("[people]\nstanding = [[nan, 1.0]]", "people.standing[0][0]", "NaN", "-4 to 4 metres"),
            ("[people]\nstanding = [[0.0, 3.5]]", "people.standing[0][1]", "3.5", "-3 to 3 metres"),
            ("[robots]\nposes = [[9.0, 0.0, 0.0]]", "robots.poses[0][0]", "9", "-4 to 4 metres"),
            ("[robots]\nposes = [[1.0, 0.0, inf]]", "robots.poses[0][2]", "inf", "-360 to 360 degrees"),
            (
                "[robots]\nposes = [[1, 0, 0], [-1, 0, 0], [1.2, 0.3, 90]]",
                "robots.poses[2]",
                "[1.2, 0.3, 90]",
                "0.4 m from robots.poses[0]",
            ),
        ] {
            let error = Scenario::parse(&format!("{head}{text}\n"), "x.toml").unwrap_err().to_string();
            assert!(error.contains(&format!("`{key} = {value}`")) && error.contains(right), "{error}");
        }
    }

    #[test]
    fn cameras_that_are_not_in_the_zoo_or_do_not_see_all_round_are_named() {
        let error = |name: &str| {
            let other =
                format!("[[camera.others]]\nrobot = \"r2\"\ncamera = {{ kind = \"zoo\", specimen = \"{name}\" }}\n");
            Scenario::parse(&format!("name = \"x\"\nduration_s = 1.0\n{other}"), "x.toml").map_err(|e| e.to_string())
        };
        assert!(error("hyperboloidal").is_ok());
        let unknown = error("telescope").unwrap_err();
        assert!(unknown.contains("`telescope`") && unknown.contains("fisheye-equidistant"), "{unknown}");
        for (name, kind) in [("pinhole", "pinhole"), ("mosaic", "rotating")] {
            let one_way = error(name).unwrap_err();
            assert!(one_way.contains("camera.others[0].camera.specimen") && one_way.contains(kind), "{one_way}");
        }
    }

    #[test]
    fn a_drive_of_a_robot_that_does_not_exist_is_refused() {
        let text = "name = \"x\"\nduration_s = 9.0\n[[robots.drives]]\nrobot = \"r7\"\nstart_s = 1.0\nend_s = 5.0\ndistance_m = 1.0\nturn_deg = 0.0\n";
        let text = Scenario::parse(text, "x.toml").unwrap_err().to_string();
        assert!(text.contains("robots.drives") && text.contains("r7"), "{text}");
    }
}
