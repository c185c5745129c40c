use std::fs;
use std::io::{BufReader, Cursor};

use image::{GrayImage, Luma, Rgb, RgbImage};
use tempfile::TempDir;

use super::*;

fn folder(names: &[&str]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (i, name) in names.iter().enumerate() {
        GrayImage::from_pixel(8, 6, Luma([10 * (i as u8 + 1)])).save(folder.path().join(name)).unwrap();
    }
    folder
}

fn with(folder: TempDir, name: &str, text: &str) -> TempDir {
    fs::write(folder.path().join(name), text).unwrap();
    folder
}

fn open_folder(folder: &TempDir) -> Result<Box<dyn FrameSource>, CaptureError> {
    open(folder.path(), CaptureOptions { image_size_px: Some([8, 6]), ..CaptureOptions::default() })
}

fn refusal(folder: &TempDir) -> String {
    match open_folder(folder) {
        Ok(_) => panic!("the folder was accepted"),
        Err(error) => error.to_string(),
    }
}

#[track_caller]
fn assert_names(error: &str, parts: &[&str]) {
    for part in parts {
        assert!(error.contains(part), "{part:?} is not in: {error}");
    }
}

fn all(source: &mut dyn FrameSource) -> Vec<Result<Frame, String>> {
    std::iter::from_fn(|| source.next_frame()).map(|frame| frame.map_err(|e| e.to_string())).collect()
}

#[test]
fn a_list_gives_each_image_its_capture_time() {
    let folder = with(
        folder(&["a.png", "b.bmp", "c.pgm"]),
        "frames.csv",
        "file,capture_ns\na.png,1700000000000000000\n\n# late\nb.bmp,1700000000103000000\nc.pgm,1700000000200000000\n",
    );
    let mut source = open_folder(&folder).unwrap();
    assert_eq!(source.frames(), Some(3));
    let frames: Vec<Frame> = all(source.as_mut()).into_iter().map(Result::unwrap).collect();
    let times: Vec<u64> = frames.iter().map(|f| f.capture.0).collect();
    assert_eq!(times, [1_700_000_000_000_000_000, 1_700_000_000_103_000_000, 1_700_000_000_200_000_000]);
    assert_eq!(frames.iter().map(|f| f.gray[0]).collect::<Vec<_>>(), [10, 20, 30]);
    assert!(frames.iter().all(|f| (f.width, f.height, f.gray.len()) == (8, 6, 48)));
}

#[test]
fn a_rate_spaces_the_images_in_order_of_their_names() {
    let folder = with(
        folder(&["000002.png", "000010.png", "000001.png"]),
        "sequence.toml",
        "frame_rate_hz = 30\nfirst_capture_ns = 5000000000\n",
    );
    let frames = all(open_folder(&folder).unwrap().as_mut());
    let frames: Vec<Frame> = frames.into_iter().map(Result::unwrap).collect();
    assert_eq!(frames.iter().map(|f| f.gray[0]).collect::<Vec<_>>(), [30, 10, 20]);
    assert_eq!(frames.iter().map(|f| f.capture.0).collect::<Vec<_>>(), [5_000_000_000, 5_033_333_333, 5_066_666_667]);
}

#[test]
fn a_recording_s_folder_stands_for_its_frames() {
    let recording = tempfile::tempdir().unwrap();
    fs::create_dir(recording.path().join("frames")).unwrap();
    GrayImage::new(8, 6).save(recording.path().join("frames/000000.png")).unwrap();
    fs::write(recording.path().join("frames/frames.csv"), "file,capture_ns\n000000.png,7\n").unwrap();
    assert_eq!(all(open_folder(&recording).unwrap().as_mut()).len(), 1);
}

#[test]
fn images_that_the_list_does_not_name_are_remarked() {
    let folder = with(folder(&["a.png", "b.png", "c.png"]), "frames.csv", "\u{feff}file,capture_ns\r\nb.png,5\r\n");
    let mut source = open_folder(&folder).unwrap();
    assert_names(&source.remarks().join(" "), &["frames.csv", "2 images"]);
    assert_eq!(all(source.as_mut()).len(), 1);
}

#[test]
fn sources_that_cannot_be_used_say_why() {
    assert_names(&refusal(&tempfile::tempdir().unwrap()), &["no images", "png"]);
    assert_names(&refusal(&folder(&["a.png"])), &["frames.csv", "sequence.toml", "capture times"]);
    let list = |text: &str| refusal(&with(folder(&["a.png", "b.png"]), "frames.csv", text));
    assert_names(&list("file,capture_ns\na.png,1\nz.png,2\n"), &["frames.csv:3", "z.png", "no such file"]);
    assert_names(&list("file,capture_ns\na.png,9\nb.png,9\n"), &["frames.csv:3", "b.png", "increase"]);
    assert_names(&list("file,capture_ns\na.png,0.5\n"), &["frames.csv:2", "a.png,0.5", "ns"]);
    assert_names(&list("a.png,1\n"), &[":1", "header", "file,capture_ns"]);
    assert_names(&list("file,capture_ns\n"), &["names no frame"]);
    assert_names(&list(""), &["empty"]);
    let sequence = |text: &str| refusal(&with(folder(&["a.png"]), "sequence.toml", text));
    assert_names(&sequence("frame_rate_hz = -10.0"), &["sequence.toml", "`frame_rate_hz` is -10", "positive"]);
    assert_names(&sequence("frame_rate_hz = nan"), &["sequence.toml", "frame_rate_hz", "positive"]);
    assert_names(&sequence("frame_rate = 10.0"), &["sequence.toml", "frame_rate", "unknown field"]);
    let error = open(Path::new("/no/such/place"), CaptureOptions::default()).err().unwrap().to_string();
    assert_names(&error, &["/no/such/place"]);
    let error = open(Path::new("/dev/video-none"), CaptureOptions::default()).err().unwrap().to_string();
    assert_names(&error, &["/dev/video-none", "cannot open the camera"]);
}

#[test]
fn a_bad_image_is_an_error_in_the_stream_which_goes_on() {
    let folder = with(folder(&["a.png", "b.png", "c.png", "d.png"]), "sequence.toml", "frame_rate_hz = 10");
    let whole = fs::read(folder.path().join("b.png")).unwrap();
    fs::write(folder.path().join("b.png"), &whole[..whole.len() * 2 / 3]).unwrap();
    GrayImage::new(8, 7).save(folder.path().join("c.png")).unwrap();
    let frames = all(open_folder(&folder).unwrap().as_mut());
    assert_eq!(frames.len(), 4);
    assert_names(frames[1].as_ref().unwrap_err(), &["b.png", "cannot decode"]);
    assert_names(frames[2].as_ref().unwrap_err(), &["c.png", "8x7", "8x6"]);
    let last = frames[3].as_ref().unwrap();
    assert_eq!((last.gray[0], last.capture.0), (40, 300_000_000), "times are those of the frame, not of the good ones");
}

#[test]
fn colour_becomes_gray_with_the_stated_weights() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("colour.png");
    RgbImage::from_pixel(2, 1, Rgb([200, 100, 50])).save(&path).unwrap();
    let gray = read_gray(&path, None).unwrap().gray[0];
    assert!((f64::from(gray) - (0.2126 * 200.0 + 0.7152 * 100.0 + 0.0722 * 50.0)).abs() <= 1.0, "{gray}");
}

fn y4m(bytes: &[u8], options: CaptureOptions) -> Result<y4m::Y4m<BufReader<Cursor<Vec<u8>>>>, CaptureError> {
    y4m::Y4m::open(BufReader::new(Cursor::new(bytes.to_vec())), Path::new("walk.y4m"), options)
}

/// Two frames of 3×3 luma with 4:2:0 chroma, 12.5 Hz.
fn two_frames() -> Vec<u8> {
    let mut bytes = b"YUV4MPEG2 W3 H3 F25:2 Ip A1:1 C420jpeg XYSCSS=420JPEG\n".to_vec();
    for k in [10, 20] {
        bytes.extend_from_slice(b"FRAME\n");
        bytes.extend((0..9).map(|i| k + i));
        bytes.extend([128; 8]);
    }
    bytes
}

#[test]
fn a_y4m_stream_gives_its_luma_at_its_rate() {
    let options = CaptureOptions { first_capture: Some(Timestamp(1_000)), ..CaptureOptions::default() };
    let frames = all(&mut y4m(&two_frames(), options).unwrap());
    let frames: Vec<Frame> = frames.into_iter().map(Result::unwrap).collect();
    assert_eq!(frames.len(), 2);
    assert_eq!(frames[1].gray, (20..29).collect::<Vec<u8>>());
    assert_eq!(frames.iter().map(|f| f.capture.0).collect::<Vec<_>>(), [1_000, 80_001_000]);
}

#[test]
fn damaged_y4m_streams_say_what_and_where() {
    let bytes = two_frames();
    let frames = all(&mut y4m(&bytes[..bytes.len() - 3], CaptureOptions::default()).unwrap());
    assert_eq!(frames.len(), 2);
    assert_names(frames[1].as_ref().unwrap_err(), &["walk.y4m", "frame 1", "truncated", "14 of 17"]);
    let header = |text: &str| y4m(text.as_bytes(), CaptureOptions::default()).err().unwrap().to_string();
    assert_names(&header("RIFF"), &["walk.y4m", "without an end"]);
    assert_names(&header("RIFF W3\n"), &["YUV4MPEG2"]);
    assert_names(&header(""), &["empty"]);
    assert_names(&header("YUV4MPEG2 W3 H3\n"), &["frame rate"]);
    assert_names(&header("YUV4MPEG2 W3 H99999 F1:1\n"), &["3x99999"]);
    assert_names(&header("YUV4MPEG2 W3 H3 F1:0\n"), &["F1:0"]);
    assert_names(&header("YUV4MPEG2 W3 H3 F1:1 C420p10\n"), &["C420p10", "8 bits"]);
    let options = CaptureOptions { image_size_px: Some([4, 3]), ..CaptureOptions::default() };
    let frames = all(&mut y4m(&two_frames(), options).unwrap());
    assert_names(frames[0].as_ref().unwrap_err(), &["walk.y4m, frame 0", "3x3", "4x3"]);
}

#[test]
fn a_video_without_ffmpeg_says_that_ffmpeg_is_missing() {
    let error = ffmpeg::Ffmpeg::open("no-such-ffmpeg", Path::new("walk.mp4"), CaptureOptions::default()).unwrap_err();
    assert_names(&error.to_string(), &["walk.mp4", "no-such-ffmpeg", "install ffmpeg"]);
}

/// A stand-in for `ffmpeg` that does what a shell script says. Another process writes it: a writing handle of ours could
/// be inherited by the child of a test that runs beside this one, and a file open for writing cannot be executed.
#[cfg(unix)]
fn script(folder: &TempDir, text: &str) -> String {
    let path = folder.path().join("ffmpeg").display().to_string();
    let text = format!("#!/bin/sh\ncd '{}'\n{text}\n", folder.path().display());
    let write = "printf '%s' \"$1\" > \"$0\" && chmod 755 \"$0\"";
    assert!(std::process::Command::new("sh").args(["-c", write, &path, &text]).status().unwrap().success());
    path
}

#[cfg(unix)]
#[test]
fn a_video_is_what_ffmpeg_pipes() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("out"), two_frames()).unwrap();
    let program = script(&folder, "cat out");
    let mut source = ffmpeg::Ffmpeg::open(&program, Path::new("walk.mp4"), CaptureOptions::default()).unwrap();
    let frames = all(&mut source);
    assert!(frames.len() == 2 && frames.iter().all(Result::is_ok));
}

#[cfg(unix)]
#[test]
fn what_ffmpeg_complains_about_is_passed_on() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("out"), two_frames()).unwrap();
    let program = script(&folder, "echo 'moov atom not found' >&2\nexit 1");
    let error = ffmpeg::Ffmpeg::open(&program, Path::new("walk.mp4"), CaptureOptions::default()).unwrap_err();
    assert_names(&error.to_string(), &["walk.mp4", "moov atom"]);

    let program = script(&folder, "cat out\necho 'damaged at 3 s' >&2\nexit 1");
    let mut source = ffmpeg::Ffmpeg::open(&program, Path::new("walk.mp4"), CaptureOptions::default()).unwrap();
    let frames = all(&mut source);
    assert_eq!(frames.len(), 3);
    assert_names(frames[2].as_ref().unwrap_err(), &["after 2 frames", "damaged at 3 s"]);
}
