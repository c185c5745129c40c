//! The service over real Zenoh sessions on loopback; a router session stands in for the leader.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::atomic::{AtomicUsize, Ordering};

use protocol::id::{LeaderId, RobotId};
use protocol::key::{Key, Pattern, RobotTopic};
use protocol::marker::Marker;
use protocol::message::{
    Announcement, ClockProbe, Command, CommandReply, Health, Observation, PictureKind, ReplayStart,
};
use protocol::time::Timestamp;
use protocol::transport::{AskedPicture, AskedRecent, AskedReplayStart, Subscriber, Transport};
use tokio::sync::oneshot;
use tokio::task::JoinHandle as Task;
use tokio::time::timeout;

use super::*;
use crate::agent::{AgentSettings, Frame};
use crate::capture::{self, CaptureOptions};
use crate::optics::MountedCamera;

/// Nothing here takes so long unless it never comes.
const LIMIT: Duration = Duration::from_secs(20);

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_agent_whose_leader_is_away_works_on_and_joins_when_it_comes_and_comes_back() {
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let taken = Arc::new(AtomicUsize::new(0));
    let running = start(agent("r1", 1), Box::new(Camera::counting(taken.clone())), &endpoint);
    timeout(LIMIT, async {
        while taken.load(Ordering::Relaxed) < 5 {
            tokio::task::yield_now().await;
        }
    })
    .await
    .unwrap();

    for visit in 0..2 {
        let leader = Transport::open(Options::router([&endpoint])).await.unwrap();
        let alive = leader.declare_alive(Key::leader_alive(team(), LeaderId::new("l1").unwrap())).await.unwrap();
        let mut observations: Subscriber<Observation> = leader.subscribe(every(RobotTopic::Observation)).await.unwrap();
        let mut announcements: Subscriber<Announcement> =
            leader.subscribe(every(RobotTopic::Announcement)).await.unwrap();
        let announced = timeout(LIMIT, announcements.recv()).await.unwrap().unwrap();
        assert_eq!((announced.message.robot.as_str(), announced.message.epoch), ("r1", 1), "visit {visit}");
        let first = timeout(LIMIT, observations.recv()).await.unwrap().unwrap();
        assert!(first.message.sequence >= 4, "it worked before the leader came");
        drop(alive);
        leader.close().await.unwrap();
    }
    let summary = running.stop().await;
    let waits = summary.notices.iter().filter(|notice| notice.contains("no leader")).count();
    assert!(waits <= 1, "{:?}", summary.notices);
    let gone: Vec<_> = summary.notices.iter().filter(|notice| notice.contains("l1 has gone")).collect();
    assert!(gone.len() <= 2, "once a leader: {gone:?}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_agent_whose_link_is_closed_while_it_is_opened_comes_back() {
    let (leader, endpoint) = leader().await;
    let mut observations: Subscriber<Observation> = leader.subscribe(every(RobotTopic::Observation)).await.unwrap();
    let port = cut_at_first(endpoint.rsplit(':').next().unwrap().parse().unwrap(), 3);
    let running = start(agent("r1", 1), Box::new(Camera::default()), &format!("tcp/127.0.0.1:{port}"));
    timeout(LIMIT, observations.recv()).await.unwrap().unwrap();
    running.stop().await;
}

/// A port that passes on to another; the first so many connections are closed after the second answer: just when a client of
/// Zenoh has them open.
fn cut_at_first(to: u16, connections: usize) -> u16 {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    std::thread::spawn(move || {
        for (n, client) in listener.incoming().enumerate() {
            let (Ok(mut client), Ok(mut server)) = (client, TcpStream::connect(("127.0.0.1", to))) else { return };
            let (mut from_client, mut to_server) = (client.try_clone().unwrap(), server.try_clone().unwrap());
            std::thread::spawn(move || std::io::copy(&mut from_client, &mut to_server));
            std::thread::spawn(move || {
                if n >= connections {
                    return drop(std::io::copy(&mut server, &mut client));
                }
                for _ in 0..2 {
                    let mut length = [0; 2];
                    server.read_exact(&mut length).unwrap();
                    let mut answer = vec![0; usize::from(u16::from_le_bytes(length))];
                    server.read_exact(&mut answer).unwrap();
                    client.write_all(&[&length[..], &answer].concat()).unwrap();
                }
                let _ = client.shutdown(Shutdown::Both);
                let _ = server.shutdown(Shutdown::Both);
            });
        }
    });
    port
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_agent_whose_leader_never_comes_works_and_stops_when_it_is_asked() {
    let nobody = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let taken = Arc::new(AtomicUsize::new(0));
    let running = start(agent("r1", 1), Box::new(Camera::counting(taken.clone())), &format!("tcp/{nobody}"));
    timeout(LIMIT, async {
        while taken.load(Ordering::Relaxed) < 5 {
            tokio::task::yield_now().await;
        }
    })
    .await
    .unwrap();
    let summary = running.stop().await;
    assert!(summary.traffic.is_empty(), "{:?}", summary.traffic);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn commands_pictures_and_clock_probes_are_answered_by_key() {
    let (leader, endpoint) = leader().await;
    let mut announcements: Subscriber<Announcement> = leader.subscribe(every(RobotTopic::Announcement)).await.unwrap();
    let running = start(agent("r1", 7), Box::new(Camera::default()), &endpoint);
    timeout(LIMIT, announcements.recv()).await.unwrap().unwrap();
    let key = |topic| Key::robot(team(), r("r1"), topic);

    let status = leader.ask(key(RobotTopic::Command), &Command::Status, LIMIT).await.unwrap().answer;
    assert!(matches!(status, CommandReply::Status { epoch: 7, .. }), "{status:?}");
    for command in [Command::RestartBackground, Command::ResetTracks, Command::Pause, Command::Resume] {
        let reply = leader.ask(key(RobotTopic::Command), &command, LIMIT).await.unwrap().answer;
        assert_eq!(reply, CommandReply::Done, "{command:?}");
    }
    for kind in PictureKind::ALL {
        let topic = key(RobotTopic::Picture(kind));
        let picture = leader.ask(topic, &AskedPicture(kind), LIMIT).await.unwrap().answer;
        let decoded = image::load_from_memory(&picture.0).unwrap();
        assert!(decoded.width() > 16, "{kind}");
    }
    let sent = Clock::system().now();
    let answered = leader.ask(key(RobotTopic::Clock), &ClockProbe { sent }, LIMIT).await.unwrap();
    let reply = answered.answer;
    // The agent's clock is 15 ms ahead: its stamps lie between ours, shifted by that.
    assert_eq!((reply.probe_sent, reply.epoch), (sent, 7));
    assert!(reply.received.seconds_since(sent) >= 0.015 && reply.replied >= reply.received);
    assert!(answered.arrived.seconds_since(reply.replied) >= -0.015);
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn who_comes_late_is_told_the_last_second() {
    let (leader, endpoint) = leader().await;
    let mut observations: Subscriber<Observation> = leader.subscribe(every(RobotTopic::Observation)).await.unwrap();
    let running = start(agent("r1", 3), Box::new(Camera::default()), &endpoint);
    let mut live = Vec::new();
    while live.len() < 5 {
        live.push(timeout(LIMIT, observations.recv()).await.unwrap().unwrap().message);
    }
    let key = Key::robot(team(), r("r1"), RobotTopic::Observation);
    let recent = leader.ask(key, &AskedRecent, LIMIT).await.unwrap().answer.observations;
    let newest = recent.last().unwrap();
    assert!(newest.sequence >= live[4].sequence);
    let last_second = |o: &&Observation| newest.capture.seconds_since(o.capture) < 0.95;
    assert!(live.iter().filter(last_second).all(|o| recent.contains(o)), "{recent:?}");
    assert!(recent.iter().all(|o| newest.capture.seconds_since(o.capture) <= 1.0));
    running.stop().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn images_of_another_size_are_counted_and_the_agent_goes_on() {
    let (leader, endpoint) = leader().await;
    let mut healths: Subscriber<Health> = leader.subscribe(every(RobotTopic::Health)).await.unwrap();
    let mut observations: Subscriber<Observation> = leader.subscribe(every(RobotTopic::Observation)).await.unwrap();
    let running = start(agent("r1", 1), Box::new(Camera { wrong_every: 3, ..Camera::default() }), &endpoint);
    let health = loop {
        let health = timeout(LIMIT, healths.recv()).await.unwrap().unwrap().message;
        if health.frames_bad > 2 {
            break health;
        }
    };
    assert!(health.frames > health.frames_bad && !health.traffic.is_empty(), "{health:?}");
    timeout(LIMIT, observations.recv()).await.unwrap().unwrap();
    let summary = running.stop().await;
    assert!(summary.notices.iter().any(|notice| notice.contains("320×240")), "{:?}", summary.notices);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_truncated_image_of_a_recording_is_skipped_named_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let mut list = "file,capture_ns\n".to_owned();
    for n in 0..4_u64 {
        let picture = image::GrayImage::from_fn(768, 576, |x, y| image::Luma([((x / 8 + y / 8 + 1) * 5) as u8]));
        let path = folder.path().join(format!("{n:06}.png"));
        picture.save(&path).unwrap();
        if n == 1 {
            let whole = std::fs::read(&path).unwrap();
            std::fs::write(&path, &whole[..whole.len() / 2]).unwrap();
        }
        list += &format!("{n:06}.png,{}\n", 1_000_000_000 + n * 200_000_000);
    }
    std::fs::write(folder.path().join("frames.csv"), list).unwrap();

    let (leader, endpoint) = leader().await;
    let mut questions = leader.answer::<AskedReplayStart>(Key::replay_start(team())).await.unwrap();
    let mut observations: Subscriber<Observation> = leader.subscribe(every(RobotTopic::Observation)).await.unwrap();
    let begin = Clock::system().now() + Duration::from_secs(1);
    tokio::spawn(async move {
        while let Some(asked) = questions.recv().await {
            let (probe_sent, now) = (asked.question.0.sent, Clock::system().now());
            let answer = ReplayStart { probe_sent, received: asked.arrived, replied: now, start: Some(begin) };
            asked.reply(&answer).unwrap();
        }
    });
    let recording = capture::open(folder.path(), CaptureOptions::default()).unwrap();
    let common = Start::default();
    let replay = Replay::new(recording, common.clone(), None);
    let running = start_with(agent("r1", 1), Box::new(replay), &endpoint, Some(common), true);
    let mut captures = Vec::new();
    for _ in 0..3 {
        captures.push(timeout(LIMIT, observations.recv()).await.unwrap().unwrap().message.capture);
    }
    // Known to half a round trip on loopback, on a clock that is 15 ms ahead.
    for (capture, s) in captures.iter().zip([1.0, 1.4, 1.6]) {
        let error_s = capture.seconds_since(begin) - s - 0.015;
        assert!(error_s.abs() < 0.01, "{error_s}");
    }
    let summary = timeout(LIMIT, running.task).await.unwrap().unwrap();
    let named: Vec<_> = summary.notices.iter().filter(|notice| notice.contains("000001.png")).collect();
    assert_eq!(named.len(), 1, "{:?}", summary.notices);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn two_agents_of_one_id_tell_each_other() {
    let (_leader, endpoint) = leader().await;
    let watcher = Transport::open(Options::client([&endpoint])).await.unwrap();
    let mut announcements: Subscriber<Announcement> = watcher.subscribe(every(RobotTopic::Announcement)).await.unwrap();
    let (first, second) = (
        start(agent("r1", 1), Box::new(Camera::default()), &endpoint),
        start(agent("r1", 2), Box::new(Camera::default()), &endpoint),
    );
    // Both have heard both when each has repeated itself after both were there.
    let mut heard = [0, 0];
    while heard.iter().any(|n| *n < 2) {
        let epoch = timeout(LIMIT, announcements.recv()).await.unwrap().unwrap().message.epoch;
        heard[epoch as usize - 1] += 1;
    }
    for summary in [first.stop().await, second.stop().await] {
        let told: Vec<_> = summary.notices.iter().filter(|notice| notice.contains("robot id r1")).collect();
        assert_eq!(told.len(), 1, "{:?}", summary.notices);
    }
    watcher.close().await.unwrap();
}

struct Running {
    task: Task<Summary>,
    stop: oneshot::Sender<()>,
}

impl Running {
    async fn stop(self) -> Summary {
        self.stop.send(()).unwrap();
        timeout(LIMIT, self.task).await.unwrap().unwrap()
    }
}

fn start(agent: Agent, source: Box<dyn LiveSource>, endpoint: &str) -> Running {
    start_with(agent, source, endpoint, None, false)
}

fn start_with(
    agent: Agent,
    source: Box<dyn LiveSource>,
    endpoint: &str,
    start: Option<Start>,
    stop_at_end: bool,
) -> Running {
    let (stop, stopped) = oneshot::channel();
    let clock = Clock::with_offset_ns(15_000_000);
    let session = Options::client([endpoint]);
    let setup = Setup { agent, source, clock, team: team(), session, journal: None, start, stop_at_end };
    // A dropped sender must not stop the service: only a message does.
    let shutdown = async {
        if stopped.await.is_err() {
            std::future::pending::<()>().await;
        }
    };
    Running { task: tokio::spawn(async { run(setup, shutdown).await.unwrap() }), stop }
}

async fn leader() -> (Transport, String) {
    let leader = Transport::open(Options::router(["tcp/127.0.0.1:0"])).await.unwrap();
    let endpoint = leader.locators().await.remove(0);
    (leader, endpoint)
}

fn agent(id: &str, epoch: u64) -> Agent {
    let marker = Marker::Cylinder { radius_m: 0.2, height_m: [0.1, 0.5], look: None };
    let mut settings = AgentSettings::new(r(id), marker);
    settings.panorama_columns = Some(240);
    Agent::new(settings, MountedCamera::reference(0.6), epoch).unwrap()
}

fn team() -> TeamId {
    TeamId::new("test").unwrap()
}

fn r(id: &str) -> RobotId {
    RobotId::new(id).unwrap()
}

fn every(topic: RobotTopic) -> Pattern {
    Pattern::EveryRobot(team(), topic)
}

/// A camera of 20 frames a second that sees a chessboard.
#[derive(Default)]
struct Camera {
    taken: Arc<AtomicUsize>,
    wrong_every: usize,
    due: Option<Timestamp>,
}

impl Camera {
    fn counting(taken: Arc<AtomicUsize>) -> Self {
        Self { taken, ..Self::default() }
    }
}

impl LiveSource for Camera {
    fn next(&mut self, clock: &Clock) -> Captured {
        let due = self.due.map_or_else(|| clock.now(), |due| due + Duration::from_millis(50));
        self.due = Some(due);
        std::thread::sleep(clock.until(due).min(LONGEST_WAIT));
        let n = self.taken.fetch_add(1, Ordering::Relaxed);
        if self.wrong_every > 0 && n.is_multiple_of(self.wrong_every) {
            return Captured::Frame(Frame { capture: due, width: 320, height: 240, gray: vec![0; 320 * 240] });
        }
        let gray = (0..768 * 576).map(|i: usize| if (i / 16 + i / 768 / 16).is_multiple_of(2) { 60 } else { 180 });
        Captured::Frame(Frame { capture: due, width: 768, height: 576, gray: gray.collect() })
    }
}
