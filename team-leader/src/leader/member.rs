//! A robot as the leader knows it: session, camera, clock, presence.

use std::collections::VecDeque;

use protocol::id::RobotId;
use protocol::marker::Marker;
use protocol::message::{CameraSummary, Observation, Presence, Recent, Trouble, Trust};
use protocol::time::Timestamp;

use super::config::ClockConfig;
use crate::calibration::systematic::Shared;
use crate::clock_offset::ClockOffset;
use crate::planning::outlook::BlurLine;
use crate::team_map::build::RobotFacts;
use crate::timeline::Timeline;

/// Most observations of a robot that wait until it is known; the oldest go first.
const MAX_WAITING: usize = 32;

/// A robot.
#[derive(Debug, Clone)]
pub struct Member {
    /// Who.
    pub id: RobotId,
    /// Which component it belongs to, of the leader's list.
    pub component: usize,
    /// Whether its liveliness token is there.
    pub alive: bool,
    /// Session, marker and camera as announced.
    pub announced: Option<(u64, Marker, CameraSummary)>,
    /// Its observations in time.
    pub timeline: Timeline,
    /// Its clock.
    pub clock: Option<ClockOffset>,
    /// Probes sent, and the last one.
    pub probes: u32,
    /// See `probes`.
    pub last_probe: Option<Timestamp>,
    /// Session whose clock is known.
    pub clock_epoch: Option<u64>,
    /// When its last observation came, leader's clock.
    pub heard: Option<Timestamp>,
    /// Whether people know of its lag, its bias, its too small sigmas.
    pub told_shared: [bool; 3],
    /// When its last observation was used, leader's clock.
    pub used: Option<Timestamp>,
    /// Why its last observation was not used.
    pub trouble: Option<Trouble>,
    /// How long its observations take, of late, seconds: a jump means that its clock was set.
    pub usual_delay_s: Option<f64>,
    /// Observations in a row that took another time.
    pub unusual_delays: u32,
    /// What it states of its bearings of targets, and frames a second (0 where not known yet).
    pub bearings: (BlurLine, f64),
    /// Observations that came before its announcement or its clock's first answer.
    waiting: VecDeque<Observation>,
}

impl Member {
    /// Nothing is known but the name.
    pub fn new(id: RobotId) -> Self {
        Self {
            id,
            component: 0,
            alive: true,
            announced: None,
            timeline: Timeline::default(),
            clock: None,
            probes: 0,
            last_probe: None,
            clock_epoch: None,
            heard: None,
            told_shared: [false; 3],
            used: None,
            trouble: None,
            usual_delay_s: None,
            unusual_delays: 0,
            bearings: (BlurLine::default(), 0.0),
            waiting: VecDeque::new(),
        }
    }

    /// Keeps an observation until more is known of the robot.
    pub fn wait(&mut self, observation: Observation) {
        if self.waiting.len() >= MAX_WAITING {
            self.waiting.pop_front();
        }
        self.waiting.push_back(observation);
    }

    /// Puts what it saw before in front of what waits, unless something newer was used.
    pub fn remind(&mut self, recent: Recent) {
        let first = self.waiting.front().map(|first| (first.epoch, first.sequence));
        let epoch = first.map(|(epoch, _)| epoch).or(self.announced.as_ref().map(|(epoch, ..)| *epoch));
        if self.used.is_some() || epoch.is_none() {
            return;
        }
        let before = |o: &Observation| Some(o.epoch) == epoch && first.is_none_or(|(_, number)| o.sequence < number);
        for observation in recent.observations.into_iter().filter(before).rev() {
            if self.waiting.len() < MAX_WAITING {
                self.waiting.push_front(observation);
            }
        }
    }

    /// What has waited for what is known now, oldest first.
    pub fn take_waiting(&mut self, clocks_are_trusted: bool) -> VecDeque<Observation> {
        match self.announced.is_some() && (clocks_are_trusted || self.clock.is_some()) {
            true => std::mem::take(&mut self.waiting),
            false => VecDeque::new(),
        }
    }

    /// When the next probe is due.
    pub fn next_probe(&self, config: &ClockConfig) -> Option<Timestamp> {
        if config.trusted || !self.alive {
            return None;
        }
        let quick = self.probes < config.first_probes || self.clock.is_none();
        let interval_s = if quick { config.first_probe_interval_s } else { config.probe_interval_s };
        Some(self.last_probe.map_or(Timestamp::default(), |t| t.offset_by_secs(interval_s)))
    }

    /// Its clock in a session: a new one has a new clock until a probe says otherwise.
    pub fn clock_of(&self, epoch: u64) -> Option<ClockOffset> {
        self.clock.filter(|_| self.clock_epoch == Some(epoch))
    }

    /// Its clock may have been set: ask at once, but not more often than at first.
    pub fn doubt_clock(&mut self, now: Timestamp, config: &ClockConfig) {
        if self.last_probe.is_some_and(|last| now.seconds_since(last) >= config.first_probe_interval_s) {
            self.probes = self.probes.min(config.first_probes.saturating_sub(2));
        }
    }

    /// What the map says of it.
    pub fn facts(&self, now: Timestamp, silent_after_s: f64) -> RobotFacts {
        let heard_lately = self.heard.is_some_and(|t| now.seconds_since(t) <= silent_after_s);
        let presence = match (self.alive, heard_lately) {
            (false, _) => Presence::Offline,
            (true, true) => Presence::Online,
            (true, false) => Presence::Silent,
        };
        RobotFacts {
            id: self.id,
            component: self.component,
            presence,
            clock_offset_s: self.clock.map(|c| (c.offset_s() as f32, c.sigma_s(now) as f32)),
            last_capture: self.timeline.last_capture(),
            shared: Shared::default(),
            trust: Trust::Full,
            verifiable: false,
            trouble: self.trouble,
            observations_lost: self.timeline.lost_or_refused(),
        }
    }

    /// Radius of the body that the others see, where it is round.
    pub fn radius_m(&self) -> Option<f64> {
        match &self.announced.as_ref()?.1 {
            Marker::Cylinder { radius_m, .. } | Marker::Bars { radius_m, .. } => Some(*radius_m),
            Marker::Rectangle { .. } => None,
        }
    }
}
