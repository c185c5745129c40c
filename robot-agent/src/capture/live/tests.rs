//! A recorded camera: what a driver gave, in order.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use super::*;

const SIZE: [u32; 2] = [64, 48];

/// What the recorded camera does when asked.
#[derive(Clone)]
enum Does {
    Opens(Encoding),
    IsNotThere,
    Gives(RawFrame),
    Nothing,
    Breaks,
}

/// What was asked of it beside frames.
type Asked = Arc<Mutex<Vec<&'static str>>>;

struct Recorded {
    script: Arc<Mutex<VecDeque<Does>>>,
    asked: Asked,
}

struct Open {
    script: Arc<Mutex<VecDeque<Does>>>,
    asked: Asked,
    encoding: Encoding,
}

impl Driver for Recorded {
    fn open(&mut self) -> Result<Box<dyn Device>, CameraFault> {
        match self.script.lock().unwrap().pop_front() {
            Some(Does::Opens(encoding)) => {
                Ok(Box::new(Open { script: self.script.clone(), asked: self.asked.clone(), encoding }))
            }
            _ => Err(CameraFault("No such device".into())),
        }
    }

    fn wait(&mut self, _: Duration) {}
}

impl Device for Open {
    fn format(&self) -> ([u32; 2], Encoding) {
        (SIZE, self.encoding)
    }

    fn next(&mut self, _: Duration) -> Result<Option<RawFrame>, CameraFault> {
        match self.script.lock().unwrap().pop_front() {
            Some(Does::Gives(raw)) => Ok(Some(raw)),
            Some(Does::Breaks) => Err(CameraFault("No such device (os error 19)".into())),
            _ => Ok(None),
        }
    }

    fn lock_exposure(&mut self, lock: bool) -> Result<(String, Option<Duration>), CameraFault> {
        self.asked.lock().unwrap().push(if lock { "lock" } else { "let go" });
        Ok(("done".into(), Some(Duration::from_millis(8))))
    }
}

fn camera(script: Vec<Does>) -> (LiveCamera, Asked) {
    let asked = Asked::default();
    let script = Arc::new(Mutex::new(VecDeque::from(script)));
    let driver = Recorded { script, asked: asked.clone() };
    let timing = Timing { exposure_s: 0.010, readout_s: 0.020, latency_s: 0.001 };
    (LiveCamera::open("/dev/video0".into(), Box::new(driver), timing).unwrap(), asked)
}

fn raw(bytes: Vec<u8>) -> RawFrame {
    RawFrame { bytes, age: Duration::from_millis(30), stamped: Stamped::EndOfFrame, damaged: false }
}

fn flat(level: u8) -> Does {
    Does::Gives(raw(vec![level; 64 * 48]))
}

fn is_frame(captured: &Captured) -> bool {
    matches!(captured, Captured::Frame(_))
}

#[test]
fn frames_are_stamped_in_the_middle_of_the_middle_rows_exposure() {
    let timing = Timing { exposure_s: 0.010, readout_s: 0.020, latency_s: 0.001 };
    let now = Timestamp::from_secs_f64(100.0);
    let at = |raw: RawFrame| mid_exposure(now, &raw, &timing).seconds_since(now);
    // Read 30 ms ago; 15 ms before that the middle row was half exposed.
    assert!((at(raw(vec![])) + 0.046).abs() < 1e-6);
    let start = RawFrame { stamped: Stamped::StartOfExposure, ..raw(vec![]) };
    assert!((at(start) + 0.016).abs() < 1e-6);
    // A driver whose clock is another one.
    assert!((at(RawFrame { age: Duration::from_secs(3000), ..raw(vec![]) }) + 0.016).abs() < 1e-6);
}

#[test]
fn a_camera_that_is_unplugged_is_said_once_and_goes_on_when_it_is_back() {
    let mut script = vec![Does::Opens(Encoding::Grey), flat(100), Does::Breaks];
    script.extend(vec![Does::IsNotThere; 3]);
    script.extend([Does::Opens(Encoding::Grey), flat(100), flat(100)]);
    let (mut camera, _) = camera(script);
    let clock = Clock::system();
    let all: Vec<Captured> = (0..30).map(|_| LiveSource::next(&mut camera, &clock)).collect();
    assert!(is_frame(&all[0]));
    assert!(
        matches!(&all[1], Captured::Bad(why) if why.contains("/dev/video0") && why.contains("os error 19")),
        "{all:?}"
    );
    assert_eq!(all.iter().filter(|c| matches!(c, Captured::Bad(_))).count(), 1);
    assert_eq!(all.iter().filter(|c| is_frame(c)).count(), 3);
    assert!(!all.iter().any(|c| matches!(c, Captured::End)), "a camera never ends");
}

#[test]
fn a_camera_that_freezes_is_opened_again() {
    let mut script = vec![Does::Opens(Encoding::Grey), flat(100)];
    script.extend(vec![Does::Nothing; 20]);
    script.extend([Does::Opens(Encoding::Grey), flat(100)]);
    let (mut camera, _) = camera(script);
    let clock = Clock::system();
    let all: Vec<Captured> = (0..30).map(|_| LiveSource::next(&mut camera, &clock)).collect();
    assert!(matches!(&all[20], Captured::Bad(why) if why.contains("no frame for 2 s")), "{:?}", all[20]);
    assert_eq!(all.iter().filter(|c| is_frame(c)).count(), 2);
}

#[test]
fn exposure_is_locked_when_the_picture_is_steady_and_let_go_when_it_is_dark_for_long() {
    let mut script = vec![Does::Opens(Encoding::Grey)];
    script.extend((0..12).map(|i| flat(40 + 8 * i))); // settling
    script.extend(vec![flat(130); 30]);
    let (mut first, asked) = camera(script.clone());
    let clock = Clock::system();
    let stamps: Vec<bool> = (0..42).map(|_| is_frame(&LiveSource::next(&mut first, &clock))).collect();
    assert!(stamps.iter().all(|f| *f));
    assert_eq!(*asked.lock().unwrap(), ["lock"]);
    // The locked exposure of 8 ms is used for stamps from then on.
    assert!((first.timing.exposure_s - 0.008).abs() < 1e-9);
    script.extend(vec![flat(3); 80]);
    let (mut second, asked) = camera(script);
    (0..122).for_each(|_| drop(LiveSource::next(&mut second, &clock)));
    assert_eq!(*asked.lock().unwrap(), ["lock", "let go", "lock"]);
}

#[test]
fn every_encoding_gives_the_same_gray_and_what_is_broken_is_said() {
    let want: Vec<u8> = (0..64 * 48).map(|i| (i / 64 * 4 + i % 64) as u8).collect();
    assert_eq!(gray(&want, Encoding::Grey, SIZE).unwrap(), want);
    let padded: Vec<u8> = want.chunks(64).flat_map(|l| l.iter().copied().chain([7; 16])).collect();
    assert_eq!(gray(&padded, Encoding::Grey, SIZE).unwrap(), want);
    let yuyv: Vec<u8> = want.iter().flat_map(|y| [*y, 128]).collect();
    assert_eq!(gray(&yuyv, Encoding::Yuyv, SIZE).unwrap(), want);
    let mut jpeg = Vec::new();
    let encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 98);
    image::ImageEncoder::write_image(encoder, &want, 64, 48, image::ExtendedColorType::L8).unwrap();
    let decoded = gray(&jpeg, Encoding::Mjpeg, SIZE).unwrap();
    assert!(decoded.iter().zip(&want).all(|(a, b)| a.abs_diff(*b) < 8));
    for (bytes, encoding, said) in [
        (&want[..100], Encoding::Grey, "100 bytes"),
        (&want[..], Encoding::Yuyv, "6144"),
        (&jpeg[..200], Encoding::Mjpeg, "JPEG"),
        (&[][..], Encoding::Mjpeg, "JPEG"),
    ] {
        assert!(gray(bytes, encoding, SIZE).unwrap_err().contains(said));
    }
    assert!(gray(&jpeg, Encoding::Mjpeg, [32, 24]).unwrap_err().contains("64×48"));
}

#[test]
fn a_broken_frame_is_bad_and_the_next_one_is_not() {
    let broken = Does::Gives(RawFrame { damaged: true, ..raw(vec![0; 64 * 48]) });
    let short = Does::Gives(raw(vec![0; 10]));
    let (mut camera, _) = camera(vec![Does::Opens(Encoding::Grey), broken, short, flat(9)]);
    let clock = Clock::system();
    let all: Vec<Captured> = (0..3).map(|_| LiveSource::next(&mut camera, &clock)).collect();
    assert!(matches!((&all[0], &all[1]), (Captured::Bad(_), Captured::Bad(_))) && is_frame(&all[2]), "{all:?}");
}

#[test]
fn an_offline_reader_gets_the_frames_and_the_faults_of_a_camera() {
    let (mut camera, _) = camera(vec![Does::Opens(Encoding::Grey), flat(9), Does::Breaks]);
    assert!(camera.next_frame().unwrap().is_ok());
    assert!(camera.next_frame().unwrap().unwrap_err().to_string().contains("/dev/video0"));
    // Never back: an error after a time, not a hang.
    assert!(camera.next_frame().unwrap().is_err());
}
