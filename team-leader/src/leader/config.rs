//! What the pure leader needs to know; the service builds it from its configuration file.

use protocol::frames::Pose2;
use protocol::id::{LeaderId, RobotId};

/// Settings of the pure leader. [`LeaderCoreConfig::new`] gives the defaults of the reference team.
#[derive(Debug, Clone, PartialEq)]
pub struct LeaderCoreConfig {
    /// Who this leader is.
    pub leader: LeaderId,
    /// Its session: told to the other leaders, so that two programs of one name are noticed.
    pub epoch: u64,
    /// The first term of a team that has none; receivers drop maps of a lower one.
    pub term: u64,
    /// So long it listens for other leaders before it leads, seconds: 0 where there are none.
    pub listens_s: f64,
    /// Whose given pose fixes the team frame at the first solution. Without one the first standing robot's body frame
    /// becomes the team frame.
    pub anchor: Option<Anchor>,
    /// Robots whose poses are known and stay: fixed cameras, surveyed places.
    pub fixed: Vec<Anchor>,
    /// Clock probes.
    pub clock: ClockConfig,
    /// Mutual calibration.
    pub calibration: CalibrationConfig,
    /// Moving objects.
    pub targets: TargetConfig,
    /// Where robots should stand.
    pub guidance: GuidanceConfig,
    /// A robot alive whose last observation is older is `Silent`, seconds.
    pub silent_after_s: f64,
}

impl LeaderCoreConfig {
    /// Defaults, for a leader of this name.
    pub fn new(leader: LeaderId) -> Self {
        Self {
            leader,
            epoch: 0,
            term: 1,
            listens_s: 0.0,
            anchor: None,
            fixed: Vec::new(),
            clock: ClockConfig::default(),
            calibration: CalibrationConfig::default(),
            targets: TargetConfig::default(),
            guidance: GuidanceConfig::default(),
            silent_after_s: 1.0,
        }
    }
}

/// What the leader says of better places to stand.
#[derive(Debug, Clone, PartialEq)]
pub struct GuidanceConfig {
    /// Whether it says anything.
    pub enabled: bool,
    /// Robots that may be sent elsewhere; empty: all whose pose is not given for good.
    pub robots: Vec<RobotId>,
    /// How far a robot may be sent along either axis, metres.
    pub reach_m: f64,
    /// Between words, seconds.
    pub interval_s: f64,
    /// The error there may be at most this part of the error here, else it is not worth the way.
    pub worth: f64,
    /// x and y from … to in the team frame where robots may be, metres. Without it: among the robots and where targets have been.
    pub area_m: Option<[[f64; 2]; 2]>,
}

impl Default for GuidanceConfig {
    fn default() -> Self {
        Self { enabled: true, robots: Vec::new(), reach_m: 2.0, interval_s: 5.0, worth: 0.85, area_m: None }
    }
}

/// The robot whose pose is given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Anchor {
    /// Which.
    pub robot: RobotId,
    /// Where it stands at the first solution.
    pub team_from_body: Pose2,
}

/// How clocks are compared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClockConfig {
    /// All stamps are of one clock already (recordings, simulations without clock errors): nothing is probed.
    pub trusted: bool,
    /// Between probes of a robot once its offset is known, seconds.
    pub probe_interval_s: f64,
    /// Between the first probes, seconds.
    pub first_probe_interval_s: f64,
    /// How many first probes.
    pub first_probes: u32,
    /// Most that two clocks drift apart, as a fraction (50e-6 = 50 ppm).
    pub max_drift: f64,
    /// A robot whose clock is known only to plus or minus more is not used, seconds. Somebody who walks at 1.5 m/s is
    /// misplaced by 0.3 m in 0.2 s.
    pub max_uncertainty_s: f64,
}

impl Default for ClockConfig {
    fn default() -> Self {
        Self {
            trusted: false,
            probe_interval_s: 2.0,
            first_probe_interval_s: 0.1,
            first_probes: 10,
            max_drift: 50e-6,
            max_uncertainty_s: 0.2,
        }
    }
}

/// Noise and patience of the mutual calibration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CalibrationConfig {
    /// Part of a single sighting's standard deviation that does not average out while both robots stand (optics, edges,
    /// marker).
    pub floor_fraction: f64,
    /// Least of what does not average out: of a bearing, radians.
    pub bearing_floor_rad: f64,
    /// The same of the apparent angular width (which carries the range), radians.
    pub width_floor_rad: f64,
    /// Error of the apparent width that is common to all sightings of the team (blur moves all edges alike), radians.
    pub common_width_rad: f64,
    /// Speed that a moving robot may have, m/s: its process noise.
    pub speed_mps: f64,
    /// Turning rate that a moving robot may have, rad/s.
    pub turn_radps: f64,
    /// How much better (2 × log-likelihood) the best naming must be than any other.
    pub naming_margin: f64,
}

impl Default for CalibrationConfig {
    fn default() -> Self {
        Self {
            floor_fraction: 0.5,
            bearing_floor_rad: 5e-5,
            width_floor_rad: 1e-4,
            common_width_rad: 1e-4,
            speed_mps: 0.5,
            turn_radps: 0.5,
            naming_margin: 14.0,
        }
    }
}

/// What targets are like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TargetConfig {
    /// Power of the white acceleration of a walking person, m²/s³.
    pub acceleration_m2ps3: f64,
    /// The same of people who walk and stand as they usually do, m²/s³: for the estimate of systematic errors, and what guidance expects.
    pub usual_acceleration_m2ps3: f64,
    /// Sway of the seen axis about the true one beyond what robots state of it, metres. Agents of this project state all of it.
    pub axis_sway_m: f64,
    /// Correlation time of errors of tops and of feet, and of bearings in the estimate of systematic errors, seconds.
    pub correlation_s: f64,
    /// Mean height of people, metres, with standard deviation: a weak cue for range, never a measurement of position.
    pub person_height_m: (f64, f64),
    /// A target unseen for longer is dropped, seconds.
    pub forget_after_s: f64,
    /// A target is published while its position's standard deviation (larger axis) is below this, metres.
    pub publish_below_m: f64,
}

impl TargetConfig {
    /// Variance of one frame's bearing of a body `range_m` away, rad²: what the robot states, and the sway of the axis.
    pub fn bearing_var(&self, sigma_rad: f64, range_m: f64) -> f64 {
        sigma_rad.powi(2) + (self.axis_sway_m / range_m).powi(2)
    }

    /// The same as targets' filters take it. They are for Gaussian errors, and what is wrong about the bearings of bodies has heavy tails:
    /// by the plain variance the squared errors came to a fifth more than the filters said.
    pub fn filter_var(&self, sigma_rad: f64, range_m: f64) -> f64 {
        FILTER_VAR * self.bearing_var(sigma_rad, range_m)
    }

    /// How many times faster than the usual 10 Hz frames come that are `interval_s` apart: they tell no more.
    pub fn faster(&self, interval_s: f64) -> f64 {
        (USUAL_INTERVAL_S / interval_s).clamp(1.0, MOST_FASTER)
    }

    /// How many frames `interval_s` apart count as one, since their errors are alike; `most` at most, of a camera faster than the usual
    /// 10 Hz more in proportion: it sees no more of an error that lasts.
    pub fn repeat(&self, interval_s: f64, most: f64) -> f64 {
        (2.0 * self.correlation_s / interval_s).clamp(1.0, most * self.faster(interval_s))
    }
}

/// Variance that filters take, as a multiple of the bearings' own.
pub(crate) const FILTER_VAR: f64 = 1.6;
/// Least time between frames for which the most repeats were found, seconds: 10 Hz with jitter.
const USUAL_INTERVAL_S: f64 = 0.08;
/// A camera counts as so many times faster at most.
const MOST_FASTER: f64 = 10.0;

impl Default for TargetConfig {
    fn default() -> Self {
        Self {
            acceleration_m2ps3: 0.6,
            usual_acceleration_m2ps3: 0.25,
            axis_sway_m: 0.01,
            correlation_s: 0.25,
            person_height_m: (1.72, 0.12),
            forget_after_s: 2.0,
            publish_below_m: 0.5,
        }
    }
}
