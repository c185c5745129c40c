//! A whole team under certificates: what the programs say to each other is what the rules allow, and no less.

use protocol::host_clock::Clock;
use protocol::id::{LeaderId, RobotId};
use protocol::key::{Key, RobotTopic};
use protocol::marker::Marker;
use protocol::message::{Command, CommandReply, PictureKind, TeamMap};
use protocol::transport::{AskError, AskedMapJson, AskedPicture, Question};
use robot_agent::agent::{Agent, AgentSettings, Frame};
use robot_agent::optics::MountedCamera;
use robot_agent::service as agents;
use team_leader::leader::{Leader, LeaderCoreConfig};
use team_leader::service as leaders;

use super::*;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_team_works_under_certificates_and_an_operator_sees_all_of_it() {
    let team = Team::new();
    let id = LeaderId::new("l1").unwrap();
    let service = leaders::Service::open(leaders::Setup {
        state: None,
        leader: Leader::new(LeaderCoreConfig::new(id)),
        id,
        team: team_id(),
        clock: Clock::system(),
        session: Options { security: team.security(Role::Leader, "l1"), ..Options::router(["tls/127.0.0.1:0"]) },
        replay: None,
        json: true,
        nobody_after: leaders::NOBODY_AFTER,
    })
    .await
    .unwrap();
    let at = service.locators().to_vec();
    let (stop, stopped) = tokio::sync::watch::channel(false);
    let until_stopped = |mut stopped: tokio::sync::watch::Receiver<bool>| async move {
        let _ = stopped.wait_for(|stop| *stop).await;
    };
    let leader = tokio::spawn(service.run(until_stopped(stopped.clone())));
    let mut robots = Vec::new();
    for name in ["r1", "r2"] {
        let marker = Marker::Cylinder { radius_m: 0.2, height_m: [0.1, 0.5], look: None };
        let mut settings = AgentSettings::new(RobotId::new(name).unwrap(), marker);
        settings.panorama_columns = Some(240);
        let (sender, source) = agents::frame_channel();
        let setup = agents::Setup {
            journal: None,
            agent: Agent::new(settings, MountedCamera::reference(0.6), 1).unwrap(),
            source,
            clock: Clock::system(),
            team: team_id(),
            session: Options { security: team.security(Role::Robot, name), ..Options::client(&at) },
            start: None,
            stop_at_end: false,
        };
        robots.push(tokio::spawn(agents::run(setup, until_stopped(stopped.clone()))));
        tokio::spawn(async move {
            let gray: Vec<u8> =
                (0..768 * 576).map(|i| if (i / 16 + i / 768 / 16) % 2 == 0 { 60 } else { 180 }).collect();
            let mut tick = tokio::time::interval(Duration::from_millis(100));
            loop {
                tick.tick().await;
                sender.send(Frame { capture: Clock::system().now(), width: 768, height: 576, gray: gray.clone() });
            }
        });
    }

    let ann = team.member(Role::Operator, "ann", &at).await;
    let mut maps = ann.subscribe::<TeamMap>(Key::map(team_id())).await.unwrap();
    let complete = async {
        loop {
            let map = maps.recv().await.unwrap().message;
            // Both joined (announcements, presence), observed, and their clocks were probed.
            if map.robots.len() == 2 && map.robots.iter().all(|robot| robot.clock_offset_s.is_some()) {
                return;
            }
        }
    };
    timeout(LIMIT, complete).await.unwrap();
    let key = |topic| Key::robot(team_id(), RobotId::new("r2").unwrap(), topic);
    let status = reached(&ann, key(RobotTopic::Command), &Command::Status).await;
    assert!(matches!(status, CommandReply::Status { .. }), "{status:?}");
    let kind = PictureKind::Panorama;
    let picture = reached(&ann, key(RobotTopic::Picture(kind)), &AskedPicture(kind)).await;
    assert!(!picture.0.is_empty());
    let json = reached(&ann, Key::map_json(team_id()), &AskedMapJson).await;
    assert!(json.contains("\"r1\"") && json.contains("\"r2\""), "{json}");
    ann.close().await.unwrap();
    stop.send(true).unwrap();
    for robot in robots {
        let summary = timeout(LIMIT, robot).await.unwrap().unwrap().unwrap();
        assert!(summary.notices.iter().all(|notice| !notice.contains("no leader")), "{:?}", summary.notices);
    }
    assert_eq!(timeout(LIMIT, leader).await.unwrap().unwrap().unwrap().refused, 0);
}

/// The answer, once somebody is there: a queryable's declaration takes a moment to get round.
async fn reached<Q: Question>(who: &Transport, key: Key, question: &Q) -> Q::Answer {
    let asked = async {
        loop {
            match who.ask(key, question, LIMIT).await {
                Err(AskError::NobodyThere(_)) => tokio::task::yield_now().await,
                answered => return answered.unwrap().answer,
            }
        }
    };
    timeout(LIMIT, asked).await.unwrap()
}
