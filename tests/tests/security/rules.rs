//! Each rule of `protocol::security::rules`, allowed and denied.

use protocol::key::{Key, Pattern, RobotTopic};
use protocol::marker::Marker;
use protocol::message::{Announcement, CameraSummary};
use zenoh::sample::SampleKind;

use super::*;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_robot_speaks_under_its_own_name_and_no_other() {
    let team = Team::new();
    let (_leader, at) = team.leader("l1", &[]).await;
    let (r1, ann) = (team.raw(Role::Robot, "r1", &at).await, team.raw(Role::Operator, "ann", &at).await);
    let all = ear(&ann, "pal/blue/**").await;
    let forbidden = [
        "pal/blue/robot/r2/observation",
        "pal/blue/robot/r2/alarm",
        "pal/blue/robot/r10/observation",
        "pal/blue/map",
        "pal/blue/map/json",
        "pal/blue/guidance/r1",
        "pal/blue/surroundings/r1",
        "pal/blue/replay_start",
        "pal/blue/anything",
    ];
    only_is_heard(&r1, &forbidden, "pal/blue/robot/r1/observation", &all).await;
    // What publishers' caches say among themselves stands under a chunk of its own.
    let history = ear(&ann, "pal/blue/**/@adv/**").await;
    let cache = |robot: &str| format!("pal/blue/robot/{robot}/alarm/@adv/pub/0/0/_");
    only_is_heard(&r1, &[&cache("r2")], &cache("r1"), &history).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_robot_is_present_and_answers_under_its_own_name_and_no_other() {
    let team = Team::new();
    let (_leader, at) = team.leader("l1", &[]).await;
    let (r1, ann) = (team.raw(Role::Robot, "r1", &at).await, team.raw(Role::Operator, "ann", &at).await);
    let present = ann.liveliness().declare_subscriber("pal/blue/**").history(true).await.unwrap();
    let mut tokens = Vec::new();
    for key in ["pal/blue/robot/r2/alive", "pal/blue/leader/r1/alive", "pal/blue/robot/r1/alive"] {
        tokens.push(r1.liveliness().declare_token(key).await.unwrap());
    }
    let first = timeout(LIMIT, present.recv_async()).await.unwrap().unwrap();
    assert_eq!((first.key_expr().as_str(), first.kind()), ("pal/blue/robot/r1/alive", SampleKind::Put));

    for robot in ["r2", "r1"] {
        answer_all(&r1, &format!("pal/blue/robot/{robot}/command")).await;
    }
    answer_all(&r1, "pal/blue/map").await;
    is_answered(&ann, "pal/blue/robot/r1/command").await;
    for key in ["pal/blue/robot/r2/command", "pal/blue/map"] {
        assert_eq!(answers(&ann, key).await, 0, "{key}");
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_robot_hears_who_its_fellows_are_and_not_what_they_see() {
    let team = Team::new();
    let (_leader, at) = team.leader("l1", &[]).await;
    let (r1, r2) = (team.raw(Role::Robot, "r1", &at).await, team.raw(Role::Robot, "r2", &at).await);
    // However it words its wish.
    let mut ears = Vec::new();
    for key in
        ["pal/blue/robot/*/observation", "pal/blue/robot/r2/observation", "pal/blue/**", "**", "pal/*/robot/*/health"]
    {
        ears.push(ear(&r1, key).await);
    }
    let allowed = ear(&r1, "pal/blue/robot/*/announcement").await;
    let secrets = ["pal/blue/robot/r2/observation", "pal/blue/robot/r2/health", "pal/blue/robot/r2/alarm"];
    only_is_heard(&r2, &secrets, "pal/blue/robot/r2/announcement", &allowed).await;
    for ear in &ears {
        while let Ok(Some(sample)) = ear.try_recv() {
            assert!(!secrets.contains(&sample.key_expr().as_str()), "{}", sample.key_expr());
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_robot_gets_its_own_guidance_and_surroundings_and_no_map() {
    let team = Team::new();
    let (_leader, at) = team.leader("l1", &[]).await;
    // Another leader, seen from this one: it may say everything.
    let (r1, l2) = (team.raw(Role::Robot, "r1", &at).await, team.raw(Role::Leader, "l2", &at).await);
    let mut ears = Vec::new();
    let wanted = [
        "pal/blue/map",
        "pal/blue/map/json",
        "pal/blue/guidance/*",
        "pal/blue/guidance/r2",
        "pal/blue/surroundings/r2",
        "pal/blue/**",
    ];
    for key in wanted {
        ears.push(ear(&r1, key).await);
    }
    let secrets = ["pal/blue/map", "pal/blue/map/json", "pal/blue/guidance/r2", "pal/blue/surroundings/r2"];
    for own in ["pal/blue/guidance/r1", "pal/blue/surroundings/r1"] {
        let allowed = ear(&r1, own).await;
        only_is_heard(&l2, &secrets, own, &allowed).await;
    }
    for ear in &ears {
        while let Ok(Some(sample)) = ear.try_recv() {
            assert!(!secrets.contains(&sample.key_expr().as_str()), "{}", sample.key_expr());
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_robot_asks_when_recordings_begin_and_neither_for_pictures_nor_the_map_and_commands_nobody() {
    let team = Team::new();
    let (_leader, at) = team.leader("l1", &[]).await;
    let (r1, r2) = (team.raw(Role::Robot, "r1", &at).await, team.raw(Role::Robot, "r2", &at).await);
    let (l2, ann) = (team.raw(Role::Leader, "l2", &at).await, team.raw(Role::Operator, "ann", &at).await);
    let of_r2 = ["picture/panorama", "command", "clock"].map(|topic| format!("pal/blue/robot/r2/{topic}"));
    for key in &of_r2 {
        answer_all(&r2, key).await;
    }
    answer_all(&l2, "pal/blue/map").await;
    answer_all(&l2, "pal/blue/replay_start").await;
    is_answered(&r1, "pal/blue/replay_start").await;
    for key in of_r2.iter().map(String::as_str).chain(["pal/blue/map"]) {
        is_answered(&ann, key).await;
        assert_eq!(answers(&r1, key).await, 0, "{key}");
    }
    assert_eq!(answers(&r1, "pal/blue/**").await, 0);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_robot_sees_which_leaders_there_are_and_not_the_presence_of_its_fellows() {
    let team = Team::new();
    let (_leader, at) = team.leader("l1", &[]).await;
    let (r1, r2) = (team.raw(Role::Robot, "r1", &at).await, team.raw(Role::Robot, "r2", &at).await);
    let l2 = team.raw(Role::Leader, "l2", &at).await;
    let fellows = r1.liveliness().declare_subscriber("pal/blue/robot/*/alive").history(true).await.unwrap();
    let all = r1.liveliness().declare_subscriber("pal/blue/**").history(true).await.unwrap();
    let leaders = r1.liveliness().declare_subscriber("pal/blue/leader/*/alive").history(true).await.unwrap();
    let _robot_token = r2.liveliness().declare_token("pal/blue/robot/r2/alive").await.unwrap();
    let _leader_token = l2.liveliness().declare_token("pal/blue/leader/l2/alive").await.unwrap();
    let seen = timeout(LIMIT, leaders.recv_async()).await.unwrap().unwrap();
    assert_eq!(seen.key_expr().as_str(), "pal/blue/leader/l2/alive");
    for robots in [&fellows, &all] {
        while let Ok(Some(sample)) = robots.try_recv() {
            assert_eq!(sample.key_expr().as_str(), "pal/blue/leader/l2/alive");
        }
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_operator_hears_everything_and_says_nothing() {
    let team = Team::new();
    let (_leader, at) = team.leader("l1", &[]).await;
    let (r1, ann) = (team.raw(Role::Robot, "r1", &at).await, team.raw(Role::Operator, "ann", &at).await);
    let l2 = team.raw(Role::Leader, "l2", &at).await;
    let all = ear(&ann, "pal/blue/**").await;
    for (speaker, key) in [(&r1, "pal/blue/robot/r1/health"), (&l2, "pal/blue/map")] {
        only_is_heard(speaker, &[], key, &all).await;
    }
    // Its own words: after them its question, over the same link, is answered; they never come.
    let leader_hears = ear(&l2, "pal/blue/**").await;
    only_is_heard(&r1, &[], "pal/blue/robot/r1/alarm", &leader_hears).await;
    for key in
        ["pal/blue/map", "pal/blue/guidance/r1", "pal/blue/robot/r1/observation", "pal/blue/robot/ann/observation"]
    {
        ann.put(key, "x").await.unwrap();
    }
    answer_all(&ann, "pal/blue/robot/r3/command").await;
    answer_all(&l2, "pal/blue/map").await;
    is_answered(&ann, "pal/blue/map").await;
    assert_eq!(answers(&l2, "pal/blue/robot/r3/command").await, 0);
    only_is_heard(&r1, &[], "pal/blue/robot/r1/alarm", &leader_hears).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn leaders_pass_on_everything_between_them_history_too() {
    let team = Team::new();
    let (l1, at_1) = team.leader("l1", &[]).await;
    let (l2, at_2) = team.leader("l2", &at_1).await;
    let r1 = team.member(Role::Robot, "r1", &at_1).await;
    let key = Key::robot(team_id(), protocol::id::RobotId::new("r1").unwrap(), RobotTopic::Announcement);
    let publisher = r1.publish::<Announcement>(key).await.unwrap();
    publisher.put(&announcement()).unwrap();
    // Late, at the other leader: what r1's cache keeps comes through both.
    let ann = team.member(Role::Operator, "ann", &at_2).await;
    let mut late =
        ann.subscribe::<Announcement>(Pattern::EveryRobot(team_id(), RobotTopic::Announcement)).await.unwrap();
    let received = timeout(LIMIT, late.recv()).await.unwrap().unwrap();
    assert_eq!(received.message, announcement());
    // And a fellow robot hears it as well.
    let r2 = team.member(Role::Robot, "r2", &at_2).await;
    let mut fellow =
        r2.subscribe::<Announcement>(Pattern::EveryRobot(team_id(), RobotTopic::Announcement)).await.unwrap();
    assert_eq!(timeout(LIMIT, fellow.recv()).await.unwrap().unwrap().message, announcement());
    for transport in [ann, r2, r1, l2, l1] {
        transport.close().await.unwrap();
    }
}

fn announcement() -> Announcement {
    Announcement {
        robot: protocol::id::RobotId::new("r1").unwrap(),
        epoch: 7,
        host: "h".to_owned(),
        version: "0.1.0".to_owned(),
        marker: Marker::Cylinder { radius_m: 0.2, height_m: [0.1, 0.5], look: None },
        camera: CameraSummary {
            model: "pal".to_owned(),
            height_m: 0.6,
            height_sigma_m: 0.0,
            tilt_sigma_rad: 0.0,
            elevation_rad: [-0.2, 0.3],
            frame_rate_hz: 10.0,
        },
    }
}
