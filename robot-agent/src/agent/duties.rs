//! What an agent does by the clock: it announces itself, reports its health, and says when frames fail to arrive.

use std::time::Duration;

use protocol::latency::Latencies;
use protocol::message::{AlarmKind, Health};
use protocol::time::Timestamp;

use super::{Agent, Output};

/// Between two announcements. The last one is kept for late joiners anyway; this is for those who lost it.
pub const ANNOUNCEMENT_PERIOD: Duration = Duration::from_secs(10);
/// Between two health reports.
pub const HEALTH_PERIOD: Duration = Duration::from_secs(2);
/// Frames that stay away for longer are an alarm; of a slow camera, for longer than so many of its frames take.
pub const FRAMES_MISSING_AFTER: Duration = Duration::from_secs(2);
const MISSING_FRAMES: f64 = 3.0;

/// Counts and due times.
#[derive(Debug, Default)]
pub struct Duties {
    /// Counters since the start.
    pub health: Counters,
    announcement_due: Timestamp,
    health_due: Timestamp,
    health_since: Option<Timestamp>,
    worked: u32,
    latencies: Latencies,
    last_frame: Option<Timestamp>,
    /// Between two frames of the camera.
    spacing_s: f64,
    frames_missing: bool,
    capture_ended: bool,
}

/// What [`Health`] counts since the start.
#[derive(Debug, Default, Clone, Copy)]
pub struct Counters {
    /// Frames that came in.
    pub frames: u64,
    /// Frames that were not worked on for the greatest rate's sake.
    pub frames_dropped: u64,
    /// Frames that could not be used.
    pub frames_bad: u64,
    /// Stages left out.
    pub stages_skipped: u64,
}

impl Duties {
    /// Of a camera that takes so many pictures a second.
    pub fn new(frame_rate_hz: f64) -> Self {
        Self { spacing_s: if frame_rate_hz > 0.0 { frame_rate_hz.recip() } else { 0.0 }, ..Self::default() }
    }

    fn missing_after(&self) -> Duration {
        Duration::try_from_secs_f64(MISSING_FRAMES * self.spacing_s)
            .map_or(FRAMES_MISSING_AFTER, |d| d.max(FRAMES_MISSING_AFTER))
    }

    /// When something is due.
    pub fn next(&self) -> Timestamp {
        let soonest = self.announcement_due.min(self.health_due);
        match self.last_frame {
            Some(last) if !self.frames_missing => soonest.min(last + self.missing_after()),
            _ => soonest,
        }
    }

    /// A frame has come: the next one is expected, unless the source has ended.
    pub fn frame_came(&mut self, now: Timestamp) {
        self.last_frame = (!self.capture_ended).then_some(now);
        self.frames_missing = false;
    }

    /// No frame is expected any more; some that came may still be worked on.
    pub fn capture_ended(&mut self) {
        self.capture_ended = true;
        self.last_frame = None;
    }

    /// A frame was worked on; seconds from capture to publication.
    pub fn frame_done(&mut self, latency_s: f64) {
        self.worked += 1;
        self.latencies.push(latency_s);
    }

    fn missing(&mut self, now: Timestamp) -> Option<AlarmKind> {
        let last = self.last_frame.filter(|_| !self.frames_missing)?;
        if now < last + self.missing_after() {
            return None;
        }
        self.frames_missing = true;
        Some(AlarmKind::SensorFailure(format!("no frame for {:.1} s", now.seconds_since(last))))
    }
}

impl Agent {
    /// Does what is due.
    pub(super) fn do_duties(&mut self, now: Timestamp, out: &mut Vec<Output>) {
        out.extend(self.problems.drain(..).map(Output::Notice));
        if is_due(now, &mut self.duties.announcement_due, ANNOUNCEMENT_PERIOD) {
            out.push(Output::Announcement(self.announcement()));
        }
        if is_due(now, &mut self.duties.health_due, HEALTH_PERIOD) {
            // The first call only sets the beginning of the first period.
            if self.duties.health_since.is_some() {
                let health = self.report(now);
                out.push(Output::Health(health));
            }
            self.duties.health_since = Some(now);
        }
        if let Some(kind) = self.duties.missing(now) {
            let alarm = self.alarm(now, kind);
            out.push(Output::Alarm(alarm));
        }
    }

    fn report(&mut self, now: Timestamp) -> Health {
        let duties = &mut self.duties;
        let period_s = duties.health_since.map_or(0.0, |since| now.seconds_since(since));
        let worked = std::mem::take(&mut duties.worked);
        let [median_ms, p99_ms, _] = duties.latencies.report();
        Health {
            robot: self.settings.robot,
            epoch: self.epoch,
            at: now,
            frame_rate_hz: if period_s > 0.0 { (f64::from(worked) / period_s) as f32 } else { 0.0 },
            frames: duties.health.frames,
            frames_dropped: duties.health.frames_dropped,
            frames_bad: duties.health.frames_bad,
            stages_skipped: duties.health.stages_skipped,
            messages_dropped: 0,
            messages_refused: 0,
            latency_ms: [median_ms, p99_ms],
            traffic: Vec::new(),
        }
    }
}

/// Whether `due` has come; then it is set one period on. A due time more than a period ahead means that the clock was set
/// back: waiting for it could take years.
fn is_due(now: Timestamp, due: &mut Timestamp, period: Duration) -> bool {
    let clock_was_set_back = *due > now + period;
    if now < *due && !clock_was_set_back {
        return false;
    }
    // On the grid of periods, unless whole periods were missed.
    let next = *due + period;
    *due = if next > now && !clock_was_set_back { next } else { now + period };
    true
}
