//! The agent against what DESIGN says of it, on made-up pictures.

use std::time::Duration;

use protocol::id::RobotId;
use protocol::marker::Marker;
use protocol::message::{
    AlarmKind, Announcement, ClockProbe, Command, CommandReply, Health, Motion, Observation, PictureKind, Stages,
};
use protocol::time::Timestamp;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

#[test]
fn an_agent_announces_itself_at_once_and_again_every_ten_seconds() {
    let mut agent = agent();
    let mut announced = Vec::new();
    for tick in 0..=220 {
        let now = at(f64::from(tick) * 0.1);
        let out = handle(&mut agent, now, Input::Deadline);
        announced.extend(announcements(&out).iter().map(|a| (tick, a.robot, a.epoch)));
    }
    let r1 = agent.robot();
    assert_eq!(announced, [(0, r1, 7), (100, r1, 7), (200, r1, 7)]);
}

#[test]
fn each_frame_gives_one_observation_with_its_own_capture_time() {
    let mut agent = agent();
    let scene = scene(1);
    for n in 0..20_u32 {
        let capture = at(f64::from(n) * 0.1);
        let out = handle(&mut agent, capture + Duration::from_millis(30), Input::Frame(frame(&scene, capture, n)));
        let seen = observations(&out);
        assert_eq!(seen.len(), 1);
        assert_eq!((seen[0].sequence, seen[0].capture, seen[0].epoch), (n, capture, 7));
        assert!(seen[0].stages.ran(Stages::MOTION) && seen[0].stages.ran(Stages::PEERS));
        if n == 19 {
            assert_eq!(seen[0].motion, Motion::Standing);
            assert!(seen[0].stages.ran(Stages::TRACKING), "the background is ready after two seconds of standing");
            assert!(seen[0].tracks.is_empty(), "nothing moves in this scene");
        }
    }
}

#[test]
fn health_counts_what_came_in_and_how_late_it_left() {
    let mut agent = agent();
    let scene = scene(2);
    let mut reports = Vec::new();
    for n in 0..41_u32 {
        let capture = at(f64::from(n) * 0.1);
        let out = handle(&mut agent, capture + Duration::from_millis(30), Input::Frame(frame(&scene, capture, n)));
        reports.extend(healths(&out));
    }
    assert_eq!(reports.len(), 2, "one every two seconds");
    let last = &reports[1];
    assert!((last.frame_rate_hz - 10.0).abs() < 0.5, "{last:?}");
    assert!(last.latency_ms.iter().all(|ms| (ms - 30.0).abs() < 0.1), "{last:?}");
    assert_eq!((last.frames, last.frames_bad, last.frames_dropped), (41, 0, 0));
}

#[test]
fn an_image_of_another_size_is_counted_and_said_and_the_agent_goes_on() {
    let mut agent = agent();
    let scene = scene(3);
    let mut notices = Vec::new();
    for n in 0..40_u32 {
        let capture = at(f64::from(n) * 0.1);
        let wrong = Frame { capture, width: 640, height: 480, gray: vec![0; 640 * 480] };
        let out = handle(&mut agent, capture, Input::Frame(wrong));
        assert!(observations(&out).is_empty());
        notices.extend(notices_of(&out));
    }
    assert_eq!(notices.len(), 10, "repetition is limited");
    assert!(notices[0].contains("640×480") && notices[0].contains("[768, 576]"), "{}", notices[0]);
    assert!(notices[9].contains("only counted"), "{}", notices[9]);
    let capture = at(5.0);
    let out = handle(&mut agent, capture, Input::Frame(frame(&scene, capture, 0)));
    assert_eq!(observations(&out).len(), 1);
    assert_eq!(healths(&out)[0].frames_bad, 40);
}

#[test]
fn a_frame_of_the_past_is_skipped_and_a_clock_that_was_set_back_is_followed() {
    let mut agent = agent();
    let scene = scene(4);
    let mut capture_at = |s: f64| handle(&mut agent, at(s), Input::Frame(frame(&scene, at(s), 0)));
    assert_eq!(observations(&capture_at(100.0)).len(), 1);
    assert!(observations(&capture_at(99.9)).is_empty());
    let out = capture_at(50.0);
    assert_eq!(observations(&out).len(), 1, "waiting for the old time could take for ever");
    assert!(notices_of(&out)[0].contains("50.0 s"), "{:?}", notices_of(&out));
}

#[test]
fn a_robot_that_turns_says_so_and_publishes_no_tracks() {
    let mut agent = agent();
    let scene = scene(5);
    let mut alarms = Vec::new();
    let mut last = None;
    for n in 0..40_u32 {
        let capture = at(f64::from(n) * 0.1);
        // 3° a frame from the 30th on.
        let turned = 3.0 * f64::from(n.saturating_sub(29));
        let picture = if turned > 0.0 { turn(&scene, turned) } else { scene.clone() };
        let out = handle(&mut agent, capture, Input::Frame(frame(&picture, capture, n)));
        alarms.extend(alarms_of(&out));
        last = observations(&out).pop();
    }
    let last = last.unwrap();
    assert!(matches!(last.motion, Motion::Turning | Motion::Moving), "{:?}", last.motion);
    assert!(last.tracks.is_empty() && !last.stages.ran(Stages::TRACKING));
    assert!(last.stages.ran(Stages::PEERS), "peers go on while the robot moves");
    assert!(alarms.iter().any(|alarm| alarm.kind == AlarmKind::SelfMotion), "{alarms:?}");
    let numbers: Vec<u32> = alarms.iter().map(|alarm| alarm.number).collect();
    assert_eq!(numbers, (0..alarms.len() as u32).collect::<Vec<_>>(), "alarms are numbered without gaps");
}

/// Stages that ran in each of 30 frames, and how many were left out, of an agent that has 10 ms a frame and whose steps take so many
/// each by the caller's clock.
fn run_with_10_ms(a_step_ms: u64) -> (Vec<Stages>, u64) {
    let mut agent = agent_with(|settings| settings.budget_s = Some(0.010));
    let scene = scene(6);
    let (mut ran, mut skipped) = (Vec::new(), 0);
    for n in 0..30_u32 {
        let capture = at(f64::from(n) * 0.1);
        let mut out = Vec::new();
        assert!(agent.begin_frame(capture, frame(&scene, capture, n), &mut out));
        let mut now = capture;
        while agent.step(now, &mut out) == Progress::More {
            now = now + Duration::from_millis(a_step_ms);
        }
        ran.extend(observations(&out).iter().map(|o| o.stages));
        skipped = healths(&out).last().map_or(skipped, |h| h.stages_skipped);
    }
    (ran, skipped)
}

#[test]
fn without_time_stages_are_left_out_but_none_of_them_always() {
    // Three stages fit.
    let (ran, skipped) = run_with_10_ms(4);
    let last = &ran[20..];
    assert!(last.iter().any(|stages| stages.ran(Stages::PEERS)), "peers starve");
    assert!(last.iter().any(|stages| stages.ran(Stages::EXTRACTION)), "regions starve");
    assert!(last.iter().all(|stages| stages.ran(Stages::MOTION)) && skipped > 0);
}

#[test]
fn however_little_time_there_is_people_are_followed_in_every_other_frame() {
    // The first stage takes all of the time.
    let (ran, _) = run_with_10_ms(20);
    let followed = ran[20..].iter().filter(|stages| stages.ran(Stages::TRACKING)).count();
    assert_eq!(followed, 5, "{ran:?}");
}

#[test]
fn frames_that_are_not_wanted_are_no_failure_of_the_camera() {
    let mut agent = agent();
    let scene = scene(7);
    handle(&mut agent, at(0.0), Input::Command(Token(3), Command::SetFrameRate(0.2)));
    let mut alarms = Vec::new();
    for n in 0..120_u32 {
        let capture = at(f64::from(n) * 0.1);
        alarms.extend(alarms_of(&handle(&mut agent, capture, Input::Frame(frame(&scene, capture, n)))));
    }
    assert!(!alarms.iter().any(|alarm| matches!(alarm.kind, AlarmKind::SensorFailure(_))), "{alarms:?}");
    let mut slow = agent_with(|settings| settings.frame_rate_hz = 0.2);
    handle(&mut slow, at(0.0), Input::Frame(frame(&scene, at(0.0), 0)));
    assert!(alarms_of(&handle(&mut slow, at(5.5), Input::Deadline)).is_empty(), "its next picture is due");
    assert_eq!(alarms_of(&handle(&mut slow, at(15.5), Input::Deadline)).len(), 1);
}

#[test]
fn frames_that_fail_to_arrive_are_one_alarm() {
    let mut agent = agent();
    let scene = scene(7);
    handle(&mut agent, at(0.0), Input::Frame(frame(&scene, at(0.0), 0)));
    let mut alarms = Vec::new();
    for tick in 1..60 {
        alarms.extend(alarms_of(&handle(&mut agent, at(f64::from(tick) * 0.1), Input::Deadline)));
    }
    assert_eq!(alarms.len(), 1);
    assert!(matches!(&alarms[0].kind, AlarmKind::SensorFailure(why) if why.contains("2.0 s")), "{alarms:?}");
    let mut ended = self::agent();
    handle(&mut ended, at(0.0), Input::Frame(frame(&scene, at(0.0), 0)));
    handle(&mut ended, at(0.1), Input::CaptureEnded);
    handle(&mut ended, at(0.1), Input::Frame(frame(&scene, at(0.1), 1)));
    assert!(alarms_of(&handle(&mut ended, at(9.0), Input::Deadline)).is_empty(), "a recording may end");
}

#[test]
fn commands_do_what_they_say_and_refuse_what_cannot_be() {
    let mut agent = agent();
    let scene = scene(8);
    let mut reply = |command| {
        let out = handle(&mut agent, at(0.5), Input::Command(Token(3), command));
        out.into_iter().find_map(|o| if let Output::CommandReply(Token(3), reply) = o { Some(reply) } else { None })
    };
    for command in [Command::RestartBackground, Command::ResetTracks, Command::SetFrameRate(5.0), Command::Pause] {
        assert_eq!(reply(command), Some(CommandReply::Done));
    }
    for rate in [0.0, -1.0, 121.0, f32::NAN] {
        assert!(matches!(reply(Command::SetFrameRate(rate)), Some(CommandReply::Refused(why)) if why.contains("120")));
    }
    assert!(matches!(
        reply(Command::Status),
        Some(CommandReply::Status { epoch: 7, frames: 0, background_ready: false, paused: true, .. })
    ));
    let mut count = |from: u32| {
        let frames = from..from + 10;
        frames
            .map(|n| {
                let capture = at(f64::from(n) * 0.1);
                observations(&handle(&mut agent, capture, Input::Frame(frame(&scene, capture, n)))).len()
            })
            .sum::<usize>()
    };
    assert_eq!(count(10), 0, "a paused agent publishes nothing");
    handle(&mut agent, at(2.0), Input::Command(Token(4), Command::Resume));
    let mut count = |from: u32| {
        let frames = from..from + 10;
        frames
            .map(|n| {
                let capture = at(f64::from(n) * 0.1);
                observations(&handle(&mut agent, capture, Input::Frame(frame(&scene, capture, n)))).len()
            })
            .sum::<usize>()
    };
    assert_eq!(count(20), 5, "5 of 10 frames a second");
}

#[test]
fn a_clock_probe_is_answered_with_its_arrival() {
    let mut agent = agent();
    let probe = ClockProbe { sent: at(1.0) };
    let out = handle(&mut agent, at(2.0), Input::ClockProbe(Token(1), probe));
    let found = out.iter().find_map(|o| if let Output::ClockReply(Token(1), r) = o { Some(*r) } else { None }).unwrap();
    assert_eq!((found.probe_sent, found.received, found.epoch), (at(1.0), at(2.0), 7));
}

#[test]
fn every_picture_can_be_had_before_and_after_the_first_frames() {
    let mut agent = agent();
    let scene = scene(9);
    for round in 0..2 {
        for kind in PictureKind::ALL {
            let out = handle(&mut agent, at(3.0), Input::Picture(Token(2), kind));
            let encoded = out.iter().find_map(|o| match o {
                Output::Picture(Token(2), Ok(bytes)) => Some(bytes.clone()),
                _ => None,
            });
            let picture = image::load_from_memory(&encoded.unwrap()).unwrap();
            assert!(picture.width() > 16 && picture.height() > 16, "{kind} in round {round}");
        }
        for n in 0..15_u32 {
            let capture = at(f64::from(n) * 0.1);
            handle(&mut agent, capture, Input::Frame(frame(&scene, capture, n)));
        }
    }
}

#[test]
fn another_session_under_the_own_name_is_told() {
    let mut agent = agent();
    let mut other = announcements(&handle(&mut agent, at(0.0), Input::Deadline)).remove(0);
    let out = handle(&mut agent, at(0.1), Input::Announcement(Box::new(other.clone())));
    assert!(notices_of(&out).is_empty(), "the own announcement comes back");
    other.epoch = 8;
    other.host = "elsewhere".to_owned();
    let out = handle(&mut agent, at(0.2), Input::Announcement(Box::new(other)));
    assert!(notices_of(&out)[0].contains("elsewhere"), "{:?}", notices_of(&out));
}

#[test]
fn a_camera_without_a_height_is_refused_with_the_key_to_give() {
    let mut mounting = *MountedCamera::reference(0.6).mounting();
    mounting.height_is_given = false;
    let camera = MountedCamera::new(crate::optics::Pal::reference(), mounting);
    let error = Agent::new(AgentSettings::new(r1(), marker()), camera, 1).unwrap_err().to_string();
    assert!(error.contains("[mounting] height_m"), "{error}");
}

#[test]
fn a_camera_below_the_floor_or_above_every_robot_is_refused_before_the_team_does() {
    for height_m in [-1.0, 15.0] {
        let camera = MountedCamera::reference(height_m);
        let error = Agent::new(AgentSettings::new(r1(), marker()), camera, 1).unwrap_err().to_string();
        assert!(error.contains("camera.height_m") && error.contains("at most 10"), "{error}");
    }
}

fn agent() -> Agent {
    agent_with(|_| {})
}

fn agent_with(change: impl FnOnce(&mut AgentSettings)) -> Agent {
    let mut settings = AgentSettings::new(r1(), marker());
    change(&mut settings);
    Agent::new(settings, MountedCamera::reference(0.6), 7).unwrap()
}

fn r1() -> RobotId {
    RobotId::new("r1").unwrap()
}

fn marker() -> Marker {
    let ring = |low: f64, reflectance| protocol::marker::Ring { height_m: [low, low + 0.2], reflectance };
    let look = Some(protocol::marker::Look {
        rings: vec![ring(0.1, 0.85), ring(0.3, 0.1)],
        bar_width_deg: None,
        beacon: None,
    });
    Marker::Cylinder { radius_m: 0.2, height_m: [0.1, 0.5], look }
}

fn at(seconds: f64) -> Timestamp {
    Timestamp::from_secs_f64(1_000_000.0 + seconds)
}

fn handle(agent: &mut Agent, now: Timestamp, input: Input) -> Vec<Output> {
    let mut out = Vec::new();
    agent.handle(now, input, &mut out);
    out
}

/// A picture full of blots a few pixels large.
fn scene(seed: u64) -> Vec<u8> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (bw, bh) = (768 / 6, 576 / 6);
    let blots: Vec<u8> = (0..bw * bh).map(|_| rng.random_range(60..200)).collect();
    (0..768 * 576).map(|i| blots[(i / 768 / 6) * bw + (i % 768) / 6]).collect()
}

/// The scene with sensor noise of its own.
fn frame(scene: &[u8], capture: Timestamp, seed: u32) -> Frame {
    let mut rng = ChaCha8Rng::seed_from_u64(u64::from(seed) + 1000);
    let gray = scene.iter().map(|&g| g.saturating_add_signed(rng.random_range(-2..=2))).collect();
    Frame { capture, width: 768, height: 576, gray }
}

/// The scene turned about the picture's centre.
fn turn(scene: &[u8], degrees: f64) -> Vec<u8> {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let pixel = |i: usize| {
        let (x, y) = ((i % 768) as f64 - 383.5, (i / 768) as f64 - 287.5);
        let (sx, sy) = ((cos * x + sin * y + 383.5).round(), (cos * y - sin * x + 287.5).round());
        let inside = (0.0..768.0).contains(&sx) && (0.0..576.0).contains(&sy);
        if inside { scene[sy as usize * 768 + sx as usize] } else { 0 }
    };
    (0..768 * 576).map(pixel).collect()
}

macro_rules! picker {
    ($name:ident, $variant:ident, $type:ty) => {
        fn $name(out: &[Output]) -> Vec<$type> {
            out.iter().filter_map(|o| if let Output::$variant(x) = o { Some(x.clone()) } else { None }).collect()
        }
    };
}
picker!(announcements, Announcement, Announcement);
picker!(observations, Observation, Observation);
picker!(healths, Health, Health);
picker!(alarms_of, Alarm, Alarm);
picker!(notices_of, Notice, String);
