//! Agents and a leader as services over real Zenoh sessions on loopback.

// Helpers outside test functions fail like the tests do.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::net::TcpListener;
use std::time::Duration;

use protocol::document::Document;
use protocol::host_clock::Clock;
use protocol::id::{LeaderId, RobotId, TeamId};
use protocol::key::{Key, Pattern, RobotTopic};
use protocol::marker::Marker;
use protocol::message::{Observation, Presence, TeamMap};
use protocol::transport::{AskError, AskedMap, AskedMapJson, Options, Subscriber, Transport};
use robot_agent::agent::{Agent, AgentSettings, Frame};
use robot_agent::optics::MountedCamera;
use robot_agent::service as agents;
use team_leader::leader::{Leader, LeaderCoreConfig};
use team_leader::service as leaders;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;
use tokio::time::timeout;

/// Nothing here takes so long unless it never comes.
const LIMIT: Duration = Duration::from_secs(30);

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_leader_hears_agents_that_came_before_it_and_after_it() {
    let endpoint = free_endpoint();
    let early = start_agent("r1", 1, "alpha", &[&endpoint]);
    let leader = start_leader(&endpoint).await;
    let outsider = Transport::open(Options::client([&endpoint])).await.unwrap();
    let mut maps: Subscriber<TeamMap> = outsider.subscribe(Key::map(team())).await.unwrap();
    let late = start_agent("r2", 1, "beta", &[&endpoint]);
    let map = until(&mut maps, |map| online(map) == ["r1", "r2"]).await;
    assert_eq!(map.leader.as_str(), "l1");
    // The clocks are 15 ms apart, and that has been measured.
    let map = until(&mut maps, |map| map.robots.iter().all(|robot| robot.clock_offset_s.is_some())).await;
    for robot in &map.robots {
        let (offset_s, sigma_s) = robot.clock_offset_s.unwrap();
        assert!((offset_s - 0.015).abs() < 4.0 * sigma_s + 0.005, "{offset_s} ± {sigma_s}");
    }
    let asked = outsider.ask(Key::map(team()), &AskedMap, LIMIT).await.unwrap().answer;
    assert_eq!(online(&asked), ["r1", "r2"]);
    let text = outsider.ask(Key::map_json(team()), &AskedMapJson, LIMIT).await.unwrap().answer;
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(json["robots"].as_array().unwrap().len(), 2, "{json}");

    late.stop().await;
    until(&mut maps, |map| online(map) == ["r1"]).await;
    early.stop().await;
    outsider.close().await.unwrap();
    let summary = leader.stop().await;
    assert!(summary.observations > 0 && summary.maps > 0 && summary.refused == 0, "{summary:?}");
    assert!(summary.notices.iter().all(|notice| !notice.contains("two robots")), "{:?}", summary.notices);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_robots_of_one_id_are_told_with_the_hosts_of_both() {
    let endpoint = free_endpoint();
    let leader = start_leader(&endpoint).await;
    let outsider = Transport::open(Options::client([&endpoint])).await.unwrap();
    let every = Pattern::EveryRobot(team(), RobotTopic::Observation);
    let mut observations: Subscriber<Observation> = outsider.subscribe(every).await.unwrap();
    let (one, two) = (start_agent("r1", 1, "alpha", &[&endpoint]), start_agent("r1", 2, "beta", &[&endpoint]));
    // Both have been heard again and again.
    let mut heard = [0, 0];
    while heard.iter().any(|n| *n < 5) {
        let got = timeout(LIMIT, observations.recv()).await.unwrap().unwrap();
        heard[got.message.epoch as usize - 1] += 1;
    }
    one.stop().await;
    two.stop().await;
    outsider.close().await.unwrap();
    let summary = leader.stop().await;
    let told: Vec<_> = summary.notices.iter().filter(|notice| notice.contains("two robots use the id r1")).collect();
    assert_eq!(told.len(), 1, "{:?}", summary.notices);
    assert!(told[0].contains("alpha") && told[0].contains("beta"), "{}", told[0]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_leader_that_nobody_joins_says_so_once_and_answers_that_there_is_no_map() {
    let endpoint = free_endpoint();
    let leader = start_leader_that_waits(&endpoint, Duration::from_millis(300)).await;
    let outsider = Transport::open(Options::client([&endpoint])).await.unwrap();
    let refused = outsider.ask(Key::map(team()), &AskedMap, LIMIT).await.unwrap_err();
    assert!(
        matches!(&refused, AskError::Refused { why, .. } if why.contains("no robot has joined team test")),
        "{refused}"
    );
    tokio::time::sleep(Duration::from_secs(1)).await;
    outsider.close().await.unwrap();
    let summary = leader.stop().await;
    assert_eq!(summary.notices.len(), 1, "{:?}", summary.notices);
    let notice = &summary.notices[0];
    assert!(notice.contains(&endpoint) && notice.contains("team test"), "{notice}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn messages_that_cannot_be_read_are_counted_and_the_leader_goes_on() {
    let endpoint = free_endpoint();
    let leader = start_leader(&endpoint).await;
    let outsider = Transport::open(Options::client([&endpoint])).await.unwrap();
    let junk = outsider.publish_text(Key::robot(team(), robot("r9"), RobotTopic::Observation)).await.unwrap();
    let mut maps: Subscriber<TeamMap> = outsider.subscribe(Key::map(team())).await.unwrap();
    let agent = start_agent("r1", 1, "alpha", &[&endpoint]);
    until(&mut maps, |map| online(map) == ["r1"]).await;
    for _ in 0..3 {
        junk.put("not an envelope".to_owned()).unwrap();
    }
    let stamp = until(&mut maps, |_| true).await.stamp;
    until(&mut maps, |map| map.stamp > stamp).await;
    agent.stop().await;
    outsider.close().await.unwrap();
    assert_eq!(leader.stop().await.refused, 3);
}

#[test]
fn every_configuration_that_is_shipped_is_right() {
    let deploy = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/config");
    let mut seen = 0;
    for folder in walk(&deploy) {
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_none_or(|extension| extension != "toml") {
                continue;
            }
            let document = Document::read(&path).unwrap();
            let table: toml::Table = document.parse().unwrap();
            if table.contains_key("robot") {
                let config = robot_agent::config::Config::from_document(&document).unwrap();
                let is_recorded = path.components().any(|part| part.as_os_str() == "recorded");
                assert!(is_recorded || config.camera.is_file(), "{}: {}", path.display(), config.camera.display());
            } else if table.contains_key("leader") {
                team_leader::config::Config::from_document(&document).unwrap();
            } else if table.contains_key("model") {
                MountedCamera::load(&path).unwrap_or_else(|error| panic!("{error}"));
            } else {
                document.parse::<Marker>().unwrap().validate().unwrap();
            }
            seen += 1;
        }
    }
    assert!(seen >= 12, "{seen} files in {}", deploy.display());
}

fn walk(folder: &std::path::Path) -> Vec<std::path::PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let inner = entries.filter(|path| path.is_dir()).flat_map(|path| walk(&path));
    std::iter::once(folder.to_owned()).chain(inner).collect()
}

pub struct Running<S> {
    task: JoinHandle<S>,
    stop: oneshot::Sender<()>,
}

impl<S> Running<S> {
    pub async fn stop(self) -> S {
        self.stop.send(()).unwrap();
        timeout(LIMIT, self.task).await.unwrap().unwrap()
    }
}

pub fn start_agent(id: &str, epoch: u64, host: &str, endpoints: &[impl AsRef<str>]) -> Running<agents::Summary> {
    let marker = Marker::Cylinder { radius_m: 0.2, height_m: [0.1, 0.5], look: None };
    let mut settings = AgentSettings::new(robot(id), marker);
    settings.panorama_columns = Some(240);
    settings.host = host.to_owned();
    let agent = Agent::new(settings, MountedCamera::reference(0.6), epoch).unwrap();
    let clock = Clock::with_offset_ns(15_000_000);
    let (sender, source) = agents::frame_channel();
    let gray: Vec<u8> = (0..768 * 576).map(|i| if (i / 16 + i / 768 / 16) % 2 == 0 { 60 } else { 180 }).collect();
    let (stop, stopped) = oneshot::channel::<()>();
    let session = Options::client(endpoints.iter().map(AsRef::as_ref));
    let setup =
        agents::Setup { agent, source, clock, team: team(), session, journal: None, start: None, stop_at_end: false };
    let task = tokio::spawn(async move {
        let mut frames = tokio::time::interval(Duration::from_millis(100));
        let camera = async {
            loop {
                frames.tick().await;
                sender.send(Frame { capture: clock.now(), width: 768, height: 576, gray: gray.clone() });
            }
        };
        tokio::select! {
            summary = agents::run(setup, async { stopped.await.unwrap_or(()) }) => summary.unwrap(),
            () = camera => unreachable!(),
        }
    });
    Running { task, stop }
}

async fn start_leader(endpoint: &str) -> Running<leaders::Summary> {
    start_leader_that_waits(endpoint, leaders::NOBODY_AFTER).await
}

async fn start_leader_that_waits(endpoint: &str, nobody_after: Duration) -> Running<leaders::Summary> {
    let id = LeaderId::new("l1").unwrap();
    let setup = leaders::Setup {
        leader: Leader::new(LeaderCoreConfig::new(id)),
        id,
        team: team(),
        clock: Clock::system(),
        session: Options::router([endpoint]),
        replay: None,
        json: true,
        state: None,
        nobody_after,
    };
    let service = leaders::Service::open(setup).await.unwrap();
    let (stop, stopped) = oneshot::channel::<()>();
    let task = tokio::spawn(async move { service.run(async { stopped.await.unwrap_or(()) }).await.unwrap() });
    Running { task, stop }
}

async fn until(maps: &mut Subscriber<TeamMap>, condition: impl Fn(&TeamMap) -> bool) -> TeamMap {
    let found = async {
        loop {
            let map = maps.recv().await.unwrap().message;
            if condition(&map) {
                return map;
            }
        }
    };
    timeout(LIMIT, found).await.unwrap()
}

fn online(map: &TeamMap) -> Vec<&str> {
    map.robots.iter().filter(|robot| robot.presence == Presence::Online).map(|robot| robot.id.as_str()).collect()
}

/// A port that was free a moment ago.
pub fn free_endpoint() -> String {
    format!("tcp/{}", TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap())
}

pub fn team() -> TeamId {
    TeamId::new("test").unwrap()
}

fn robot(id: &str) -> RobotId {
    RobotId::new(id).unwrap()
}
