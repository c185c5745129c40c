use protocol::id::RobotId;
use protocol::message::AlarmKind;

use super::*;
use crate::leader::{Input, LeaderCoreConfig, Output};

#[test]
fn a_map_that_cannot_be_read_is_put_aside_and_named() {
    let folder = tempfile::tempdir().unwrap();
    let dir = open(folder.path());
    let mut notices = Vec::new();
    assert!(dir.load(&mut notices).is_none() && notices.is_empty());
    for bytes in [b"".as_slice(), b"rubbish", &[0x50, 0xA1, 1, 9, 255, 255, 255]] {
        fs::write(dir.file("map"), bytes).unwrap();
        assert!(dir.load(&mut notices).is_none());
        assert!(!dir.file("map").exists() && dir.file("map.bad").exists());
    }
    assert_eq!(notices.len(), 3);
    assert!(notices[0].contains("blue.map") && notices[0].contains("put aside"), "{}", notices[0]);
}

#[test]
fn a_folder_that_cannot_be_written_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, b"").unwrap();
    let error = StateDir::open(&file, team()).unwrap_err().to_string();
    assert!(error.contains("state_dir") && error.contains("file"), "{error}");
}

#[test]
fn a_check_finds_a_folder_that_cannot_be_made_and_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    StateDir::check(&folder.path().join("new/deep")).unwrap();
    StateDir::check(folder.path()).unwrap();
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    let file = folder.path().join("file");
    fs::write(&file, b"").unwrap();
    let error = StateDir::check(&file.join("state")).unwrap_err().to_string();
    assert!(error.contains("state_dir") && error.contains("file/state"), "{error}");
}

#[test]
fn an_alarm_on_record_is_not_new_after_a_restart() {
    let folder = tempfile::tempdir().unwrap();
    let heard = |number| {
        let mut leader = Leader::new(LeaderCoreConfig::new("l1".parse().unwrap()));
        let (mut keeper, notices) = Keeper::start(open(folder.path()), Timestamp::from_secs_f64(5.0), &mut leader);
        assert!(notices.is_empty(), "{notices:?}");
        let mut outputs = Vec::new();
        for number in 0..=number {
            leader.handle(Timestamp::from_secs_f64(6.0), Input::Alarm(alarm(number)), &mut outputs);
        }
        let new: Vec<u32> = outputs
            .iter()
            .filter_map(|output| match output {
                Output::Alarm(alarm) => {
                    keeper.record(alarm);
                    Some(alarm.number)
                }
                _ => None,
            })
            .collect();
        // The writer ends when all is written.
        let Keeper { jobs, .. } = keeper;
        drop(jobs);
        new
    };
    assert_eq!(heard(2), [0, 1, 2]);
    let record = folder.path().join("blue.alarms.jsonl");
    let limit = Instant::now() + Duration::from_secs(10);
    while fs::read_to_string(&record).map_or(0, |text| text.lines().count()) < 3 {
        assert!(Instant::now() < limit, "not written");
        std::thread::yield_now();
    }
    // As if the power had failed in the middle of a line.
    OpenOptions::new().append(true).open(&record).unwrap().write_all(b"{\"robot\":\"r1\",\"ep").unwrap();
    assert_eq!(heard(4), [3, 4]);
}

fn open(folder: &Path) -> StateDir {
    StateDir::open(folder, team()).unwrap()
}

fn team() -> TeamId {
    TeamId::new("blue").unwrap()
}

fn alarm(number: u32) -> Alarm {
    let robot = RobotId::new("r1").unwrap();
    Alarm { robot, epoch: 7, number, at: Timestamp::from_secs_f64(1.0), kind: AlarmKind::LightSwitched }
}
