//! A Video4Linux camera: GREY, YUYV or MJPEG in the camera file's size, four mapped buffers, the newest controls.
//!
//! The kernel stamps buffers on its monotonic clock, mostly at the end of a frame (USB cameras: at its start); the age of the
//! stamp is taken at once, so that no other clock comes in. Sizes are not converted: a camera that has no mode of the camera
//! file's size is refused, for its bearings would be wrong.

use std::path::PathBuf;
use std::time::Duration;

use moq_v4l::buffer::{Flags, Type};
use moq_v4l::control::{Control, Value};
use moq_v4l::io::mmap::Stream;
use moq_v4l::io::traits::CaptureStream;
use moq_v4l::video::Capture;
use moq_v4l::{Device as VideoDevice, Format, FourCC};
use rustix::time::{ClockId, clock_gettime};

use super::live::{CameraFault, Device, Driver, Encoding, RawFrame, Stamped};

/// Buffers between driver and us.
const BUFFERS: u32 = 4;
/// First frames of some cameras take seconds.
const FIRST_FRAME: Duration = Duration::from_secs(5);
/// Formats in the order of preference: least work, least loss first.
const FORMATS: [(&[u8; 4], Encoding); 3] =
    [(b"GREY", Encoding::Grey), (b"YUYV", Encoding::Yuyv), (b"MJPG", Encoding::Mjpeg)];

// Controls of `linux/v4l2-controls.h`.
const EXPOSURE_AUTO: u32 = 0x009a_0901;
const EXPOSURE_ABSOLUTE: u32 = 0x009a_0902;
const AUTO_GAIN: u32 = 0x0098_0912;
const GAIN: u32 = 0x0098_0913;
const EXPOSURE_MANUAL: i64 = 1;
const EXPOSURE_APERTURE_PRIORITY: i64 = 3;
/// Unit of `EXPOSURE_ABSOLUTE`.
const EXPOSURE_UNIT: Duration = Duration::from_micros(100);

/// Opens one device file.
#[derive(Debug, Clone)]
pub struct V4l {
    /// `/dev/video0`.
    pub path: PathBuf,
    /// The camera file's.
    pub image_size_px: Option<[u32; 2]>,
    /// Asked of the camera; it may give another.
    pub frame_rate_hz: Option<f64>,
}

impl Driver for V4l {
    fn open(&mut self) -> Result<Box<dyn Device>, CameraFault> {
        let fault = |what: &str, error: std::io::Error| CameraFault(format!("{what}: {error}"));
        let device = VideoDevice::with_path(&self.path).map_err(|e| fault("cannot open the camera", e))?;
        let has: Vec<FourCC> = device
            .enum_formats()
            .map_err(|e| fault("not a camera (it names no formats)", e))?
            .iter()
            .map(|f| f.fourcc)
            .collect();
        let usable = FORMATS.into_iter().filter(|(name, _)| has.contains(&FourCC::new(name)));
        let mut seen = Vec::new();
        for (name, encoding) in usable {
            let now = device.format().map_err(|e| fault("it says no format", e))?;
            let [width, height] = self.image_size_px.unwrap_or([now.width, now.height]);
            let got = device.set_format(&Format::new(width, height, FourCC::new(name)));
            let got = got.map_err(|e| fault("its format cannot be set (is another program using it?)", e))?;
            if got.fourcc == FourCC::new(name) && [got.width, got.height] == [width, height] {
                self.set_rate(&device);
                let stream = Stream::with_buffers(&device, Type::VideoCapture, BUFFERS)
                    .map_err(|e| fault("it cannot stream", e))?;
                let line = got.stride.max(got.width) as usize;
                return Ok(Box::new(Camera {
                    device,
                    stream: Some(stream),
                    size_px: [width, height],
                    encoding,
                    bytes: line * got.height as usize,
                    has_begun: false,
                }));
            }
            seen.push(format!("{}x{} {}", got.width, got.height, got.fourcc));
        }
        let wanted = self.image_size_px.map_or_else(|| "any size".to_owned(), |[w, h]| format!("{w}x{h}"));
        if has.is_empty() && seen.is_empty() {
            return Err(CameraFault("it has no picture format at all: is it a camera?".to_owned()));
        }
        let has = has.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
        Err(CameraFault(format!(
            "no mode of {wanted} (the camera file's image_size_px) in GREY, YUYV or MJPEG; it has {has} and offers {}",
            if seen.is_empty() { "none of these".to_owned() } else { seen.join(", ") }
        )))
    }
}

impl V4l {
    /// Asks for the frame rate; a camera that cannot gives its own.
    fn set_rate(&self, device: &VideoDevice) {
        if let Some(rate) = self.frame_rate_hz.filter(|r| *r >= 1.0) {
            let wanted = moq_v4l::video::capture::Parameters::with_fps(rate.round() as u32);
            if let Err(error) = device.set_params(&wanted) {
                tracing::debug!("{}: the frame rate cannot be set: {error}", self.path.display());
            }
        }
    }
}

struct Camera {
    device: VideoDevice,
    /// Empty only while it is dropped.
    stream: Option<Stream<'static>>,
    size_px: [u32; 2],
    encoding: Encoding,
    /// Of an uncompressed frame.
    bytes: usize,
    has_begun: bool,
}

impl Device for Camera {
    fn format(&self) -> ([u32; 2], Encoding) {
        (self.size_px, self.encoding)
    }

    fn next(&mut self, limit: Duration) -> Result<Option<RawFrame>, CameraFault> {
        let Some(stream) = &mut self.stream else { return Ok(None) };
        let limit = if self.has_begun { limit } else { FIRST_FRAME };
        if self.has_begun {
            // The buffer that was read last is queued again only when another is there: one is always the driver's.
            let wait_ms = i32::try_from(limit.as_millis()).unwrap_or(i32::MAX);
            match stream.handle().poll(POLL_IN, wait_ms) {
                Ok(0) => return Ok(None),
                Ok(_) => {}
                Err(e) => return Err(CameraFault(e.to_string())),
            }
        }
        stream.set_timeout(limit);
        let (bytes, meta) = CaptureStream::next(stream).map_err(|e| CameraFault(e.to_string()))?;
        self.has_begun = true;
        let used = match self.encoding {
            Encoding::Mjpeg => (meta.bytesused as usize).min(bytes.len()),
            _ if meta.bytesused == 0 => self.bytes.min(bytes.len()),
            _ => (meta.bytesused as usize).min(self.bytes).min(bytes.len()),
        };
        let stamp = Duration::new(u64::try_from(meta.timestamp.sec).unwrap_or(0), 0)
            + Duration::from_micros(u64::try_from(meta.timestamp.usec).unwrap_or(0));
        let now = clock_gettime(ClockId::Monotonic);
        let now = Duration::new(u64::try_from(now.tv_sec).unwrap_or(0), u32::try_from(now.tv_nsec).unwrap_or(0));
        let is_start = meta.flags & Flags::TSTAMP_SRC_MASK == Flags::TSTAMP_SRC_SOE;
        Ok(Some(RawFrame {
            bytes: bytes[..used].to_vec(),
            age: now.saturating_sub(stamp),
            stamped: if is_start { Stamped::StartOfExposure } else { Stamped::EndOfFrame },
            damaged: meta.flags.contains(Flags::ERROR),
        }))
    }

    fn lock_exposure(&mut self, lock: bool) -> Result<(String, Option<Duration>), CameraFault> {
        let number = |id: u32| match self.device.control(id).map(|c| c.value) {
            Ok(Value::Integer(value)) => Some(value),
            _ => None,
        };
        let set = |id: u32, value: Value| self.device.set_control(Control { id, value });
        let (exposure, gain) = (number(EXPOSURE_ABSOLUTE), number(GAIN));
        let mode = if lock { EXPOSURE_MANUAL } else { EXPOSURE_APERTURE_PRIORITY };
        set(EXPOSURE_AUTO, Value::Integer(mode)).map_err(|e| {
            CameraFault(format!("the camera's exposure cannot be {}: {e}", if lock { "locked" } else { "freed" }))
        })?;
        // Not every camera has a gain of its own; what it has is held with the exposure.
        let gain_held = set(AUTO_GAIN, Value::Boolean(!lock)).is_ok();
        if !lock {
            return Ok(("the locked exposure had become wrong: the camera chooses it again".to_owned(), None));
        }
        if let Some(value) = exposure {
            let _ = set(EXPOSURE_ABSOLUTE, Value::Integer(value));
        }
        if let Some(value) = gain {
            let _ = set(GAIN, Value::Integer(value));
        }
        let time = exposure.and_then(|e| u32::try_from(e).ok()).map(|units| EXPOSURE_UNIT * units);
        let said = time.map_or(String::new(), |t| format!(" at {:.1} ms", t.as_secs_f64() * 1e3));
        let gain = if gain_held { " and gain" } else { "" };
        Ok((format!("exposure{gain} locked{said}"), time))
    }
}

/// `POLLIN` of `poll.h`.
const POLL_IN: i16 = 1;

impl Drop for Camera {
    fn drop(&mut self) {
        const NO_DEVICE: i32 = 19;
        // The library stops the stream when it is dropped and panics where that fails, but for a camera that is gone.
        let state = self.device.query_caps().err().and_then(|e| e.raw_os_error());
        if state.is_some_and(|code| code != NO_DEVICE) {
            std::mem::forget(self.stream.take());
        }
    }
}
