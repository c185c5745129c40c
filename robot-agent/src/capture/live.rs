//! A camera: frames as a driver gives them, stamped at mid-exposure, through unplugging and back.
//!
//! ```text
//!           opened              steady picture             too dark or bright for 3 s
//!  away ───────────▶ settling ────────────────▶ locked ───────────────────────────────▶ settling
//!   ▲                    │ error, or no frame for 2 s │
//!   └────────────────────┴────────────────────────────┘   tried again twice a second, said once
//! ```
//! Problem: an exposure that follows the light changes every pixel with it, and the background is wrong until it is learnt
//! anew. So exposure and gain are locked once the picture is steady; what the camera does not let lock is followed by the motion
//! stage (its common gain). The [`Driver`] is a trait: [`super::v4l`] is the real one, tests play a recorded one.

mod decode;
mod exposure;

use std::time::Duration;

use protocol::host_clock::Clock;
use protocol::time::Timestamp;

pub use decode::{Encoding, gray};

use super::{CaptureError, FrameSource};
use crate::agent::Frame;
use crate::optics::Timing;
use crate::service::{Captured, LONGEST_WAIT, LiveSource};
use exposure::Exposure;

/// A camera that gives nothing for so long has failed.
const SILENCE: Duration = Duration::from_secs(2);
/// From one attempt to open a camera that is away to the next.
const RETRY: Duration = Duration::from_millis(500);
/// A stamp this old, or younger than nothing, is the driver's mistake: then the time of arrival counts.
const OLDEST: Duration = Duration::from_secs(2);
/// Offline commands wait so long for a frame.
const PATIENCE: Duration = Duration::from_secs(10);

/// What is wrong with a camera, in words.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct CameraFault(pub String);

/// When the driver looked at its clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stamped {
    /// When the first row began to be exposed.
    StartOfExposure,
    /// When the last row had been read.
    EndOfFrame,
}

/// One buffer of a driver.
#[derive(Debug, Clone, PartialEq)]
pub struct RawFrame {
    /// As the camera sent it.
    pub bytes: Vec<u8>,
    /// Since the driver's stamp.
    pub age: Duration,
    /// What that stamp is of.
    pub stamped: Stamped,
    /// The driver says that the data are damaged.
    pub damaged: bool,
}

/// An open camera that streams.
pub trait Device: Send {
    /// Columns, rows, and what its bytes mean.
    fn format(&self) -> ([u32; 2], Encoding);

    /// The next buffer within a time; `None`: not yet.
    ///
    /// # Errors
    /// The camera is gone, or broken.
    fn next(&mut self, limit: Duration) -> Result<Option<RawFrame>, CameraFault>;

    /// Sets exposure and gain to what they are now (`true`), or lets the camera choose again. What was done, in words; the exposure
    /// where it is known.
    ///
    /// # Errors
    /// The camera has no such control.
    fn lock_exposure(&mut self, lock: bool) -> Result<(String, Option<Duration>), CameraFault>;
}

/// Opens a camera, again and again.
pub trait Driver: Send {
    /// Starts the stream.
    ///
    /// # Errors
    /// No such camera, or one that gives nothing that is understood.
    fn open(&mut self) -> Result<Box<dyn Device>, CameraFault>;

    /// Lets time pass while there is no camera.
    fn wait(&mut self, time: Duration) {
        std::thread::sleep(time);
    }
}

/// A camera as a source of live frames.
pub struct LiveCamera {
    name: String,
    driver: Box<dyn Driver>,
    device: Option<Box<dyn Device>>,
    exposure: Exposure,
    timing: Timing,
    clock: Clock,
    /// Without a frame, and without a camera.
    silent: Duration,
    away: Duration,
}

impl LiveCamera {
    /// Opens the camera; `name` appears in what is said, `timing` is the camera file's.
    ///
    /// # Errors
    /// It cannot be opened now.
    pub fn open(name: String, mut driver: Box<dyn Driver>, timing: Timing) -> Result<Self, CameraFault> {
        let device = driver.open()?;
        Ok(Self {
            name,
            driver,
            device: Some(device),
            exposure: Exposure::default(),
            timing,
            clock: Clock::system(),
            silent: Duration::ZERO,
            away: Duration::ZERO,
        })
    }

    fn lose(&mut self, why: &CameraFault) -> Captured {
        self.device = None;
        self.silent = Duration::ZERO;
        self.away = Duration::ZERO;
        Captured::Bad(format!("{}: {why}; it is tried again until it is back", self.name))
    }

    fn find(&mut self) -> Captured {
        self.driver.wait(LONGEST_WAIT);
        self.away += LONGEST_WAIT;
        if self.away < RETRY {
            return Captured::Waiting;
        }
        self.away = Duration::ZERO;
        if let Ok(device) = self.driver.open() {
            tracing::info!("{}: the camera is back", self.name);
            self.exposure = Exposure::default();
            self.device = Some(device);
        }
        Captured::Waiting
    }

    fn frame(&mut self, raw: &RawFrame, now: Timestamp) -> Captured {
        let Some(device) = &mut self.device else { return Captured::Waiting };
        let ([width, height], encoding) = device.format();
        if raw.damaged {
            return Captured::Bad(format!("{}: the driver calls a frame damaged", self.name));
        }
        let gray = match gray(&raw.bytes, encoding, [width, height]) {
            Ok(gray) => gray,
            Err(why) => return Captured::Bad(format!("{}: {why}", self.name)),
        };
        if let Some(lock) = self.exposure.look(&gray) {
            match device.lock_exposure(lock) {
                Ok((done, exposure)) => {
                    tracing::info!("{}: {done}", self.name);
                    if let Some(exposure) = exposure {
                        self.timing.exposure_s = exposure.as_secs_f64();
                    }
                }
                Err(why) => tracing::info!("{}: {why}; a changing exposure is followed by the background", self.name),
            }
        }
        let capture = mid_exposure(now, raw, &self.timing);
        Captured::Frame(Frame { capture, width, height, gray })
    }
}

/// When the middle of the middle row's exposure was. Rows before it were seen up to half of `readout_s` sooner.
pub fn mid_exposure(now: Timestamp, raw: &RawFrame, timing: &Timing) -> Timestamp {
    let age = if raw.age > OLDEST { Duration::ZERO } else { raw.age };
    let half_frame_s = 0.5 * (timing.exposure_s + timing.readout_s);
    let from_stamp_s = match raw.stamped {
        Stamped::StartOfExposure => half_frame_s,
        Stamped::EndOfFrame => -half_frame_s,
    };
    now.offset_by_secs(from_stamp_s - timing.latency_s - age.as_secs_f64())
}

impl LiveSource for LiveCamera {
    fn next(&mut self, clock: &Clock) -> Captured {
        let Some(device) = &mut self.device else { return self.find() };
        match device.next(LONGEST_WAIT) {
            Ok(Some(raw)) => {
                self.silent = Duration::ZERO;
                self.frame(&raw, clock.now())
            }
            Ok(None) => {
                self.silent += LONGEST_WAIT;
                if self.silent < SILENCE {
                    return Captured::Waiting;
                }
                self.lose(&CameraFault(format!("no frame for {} s", SILENCE.as_secs())))
            }
            Err(fault) => self.lose(&fault),
        }
    }
}

impl FrameSource for LiveCamera {
    fn next_frame(&mut self) -> Option<Result<Frame, CaptureError>> {
        let clock = self.clock;
        let path = std::path::PathBuf::from(&self.name);
        let fault = |message| Some(Err(CaptureError::Camera { path: path.clone(), message }));
        // Each look takes at most LONGEST_WAIT.
        for _ in 0..PATIENCE.as_millis() / LONGEST_WAIT.as_millis() {
            match LiveSource::next(self, &clock) {
                Captured::Frame(frame) => return Some(Ok(frame)),
                Captured::Bad(message) => return fault(message),
                Captured::Waiting => {}
                Captured::End => return None,
            }
        }
        fault(format!("no frame within {} s", PATIENCE.as_secs()))
    }

    fn frames(&self) -> Option<u64> {
        None
    }
}

#[cfg(test)]
mod tests;
