//! The transport over real Zenoh sessions on loopback, port 0. Every wait is for the event itself, with a bound.

use std::future::Future;
use std::time::Duration;

use super::*;
use crate::codec;
use crate::id::{LeaderId, RobotId, TeamId};
use crate::key::{Key, Pattern, RobotTopic};
use crate::message::samples;
use crate::message::{
    Alarm, Announcement, ClockProbe, ClockReply, Command, CommandReply, Observation, PictureKind, TeamMap,
};
use crate::meter::{Direction, ZENOH_FRAME_BYTES};

/// Longest that any expected event may take on a loaded machine.
const SOON: Duration = Duration::from_secs(20);

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_late_joiner_gets_the_last_announcement_and_the_last_map_and_all_alarms() {
    let (leader, agent) = leader_and_agent().await;
    let announcements = agent.publish::<Announcement>(robot_key("r1", RobotTopic::Announcement)).await.unwrap();
    let alarms = agent.publish::<Alarm>(robot_key("r1", RobotTopic::Alarm)).await.unwrap();
    let maps = leader.publish::<TeamMap>(Key::map(team())).await.unwrap();
    for epoch in [1, 2] {
        announcements.put(&Announcement { epoch, ..samples::announcement() }).unwrap();
        maps.put(&TeamMap { sequence: epoch, ..samples::map() }).unwrap();
    }
    for number in 0..5 {
        alarms.put(&Alarm { number, ..samples::alarm() }).unwrap();
    }

    let late = Transport::open(Options::client(leader.locators().await)).await.unwrap();
    let mut announcements =
        late.subscribe::<Announcement>(Pattern::EveryRobot(team(), RobotTopic::Announcement)).await.unwrap();
    let mut maps = late.subscribe::<TeamMap>(Key::map(team())).await.unwrap();
    let mut alarms = late.subscribe::<Alarm>(Pattern::EveryRobot(team(), RobotTopic::Alarm)).await.unwrap();
    assert_eq!(soon(announcements.recv()).await.unwrap().message.epoch, 2);
    assert_eq!(soon(maps.recv()).await.unwrap().message.sequence, 2);
    for number in 0..5 {
        assert_eq!(soon(alarms.recv()).await.unwrap().message.number, number);
    }
    close([late, agent, leader]).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_early_subscriber_gets_what_a_later_publisher_says() {
    let (leader, agent) = leader_and_agent().await;
    let mut announcements =
        leader.subscribe::<Announcement>(Pattern::EveryRobot(team(), RobotTopic::Announcement)).await.unwrap();
    let publisher = agent.publish::<Announcement>(robot_key("r1", RobotTopic::Announcement)).await.unwrap();
    publisher.put(&samples::announcement()).unwrap();
    let received = soon(announcements.recv()).await.unwrap();
    assert_eq!(received.message, samples::announcement());
    assert_eq!(received.key, robot_key("r1", RobotTopic::Announcement));
    close([agent, leader]).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_subscriber_that_does_not_read_blocks_nobody_and_its_losses_are_counted() {
    let (leader, agent) = leader_and_agent().await;
    let pattern = Pattern::EveryRobot(team(), RobotTopic::Observation);
    let idle = leader.subscribe::<Observation>(pattern).await.unwrap();
    let mut busy = leader.subscribe::<Observation>(pattern).await.unwrap();
    // Of several robots: one alone would be over its pace.
    let mut publishers = Vec::new();
    for robot in ["r1", "r2", "r3", "r4"] {
        publishers.push(agent.publish::<Observation>(robot_key(robot, RobotTopic::Observation)).await.unwrap());
    }
    for publisher in &publishers {
        until(async || publisher.has_listeners().await).await;
    }

    // One at a time: the busy reader must get every message while the idle one's ring runs over.
    let ring = qos(codec::Kind::Observation).ring as u32;
    let surplus = 40;
    for sequence in 0..ring + surplus {
        let publisher = &publishers[sequence as usize % publishers.len()];
        publisher.put(&Observation { sequence, ..samples::observation() }).unwrap();
        assert_eq!(soon(busy.recv()).await.unwrap().message.sequence, sequence);
    }
    until(async || idle.dropped() == u64::from(surplus)).await;
    assert_eq!(busy.dropped(), 0);
    assert_eq!(leader.meter().dropped(), u64::from(surplus));
    // The oldest went: the idle one wakes up to the newest.
    let mut idle = idle;
    assert_eq!(idle.try_recv().unwrap().message.sequence, surplus);
    close([agent, leader]).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn presence_appears_and_vanishes() {
    let (leader, agent) = leader_and_agent().await;
    let key = robot_key("r1", RobotTopic::Alive);
    let mut robots = leader.watch(Pattern::EveryRobot(team(), RobotTopic::Alive)).await.unwrap();
    let token = agent.declare_alive(key).await.unwrap();
    assert_eq!(soon(robots.recv()).await, Some(Sign { key, alive: true }));
    // Who looks later sees it at once.
    let mut later = agent.watch(Pattern::EveryRobot(team(), RobotTopic::Alive)).await.unwrap();
    assert_eq!(soon(later.recv()).await, Some(Sign { key, alive: true }));
    drop(token);
    assert_eq!(soon(robots.recv()).await, Some(Sign { key, alive: false }));
    // Closing the session takes its tokens along.
    let _token = agent.declare_alive(key).await.unwrap();
    assert_eq!(soon(robots.recv()).await, Some(Sign { key, alive: true }));
    agent.close().await.unwrap();
    assert_eq!(soon(robots.recv()).await, Some(Sign { key, alive: false }));
    let leader_key = Key::leader_alive(team(), LeaderId::new("l1").unwrap());
    let mut leaders = leader.watch(Pattern::EveryLeader(team())).await.unwrap();
    let _leader_token = leader.declare_alive(leader_key).await.unwrap();
    assert_eq!(soon(leaders.recv()).await, Some(Sign { key: leader_key, alive: true }));
    close([leader]).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn questions_are_answered_with_typed_answers() {
    let (leader, agent) = leader_and_agent().await;
    let (command_key, clock_key) = (robot_key("r1", RobotTopic::Command), robot_key("r1", RobotTopic::Clock));
    let mut commands = agent.answer::<Command>(command_key).await.unwrap();
    let mut probes = agent.answer::<ClockProbe>(clock_key).await.unwrap();
    tokio::spawn(async move {
        while let Some(asked) = commands.recv().await {
            match asked.question {
                Command::SetFrameRate(5.0) => asked.reply(&CommandReply::Done).unwrap(),
                _ => asked.refuse("not today").unwrap(),
            }
        }
    });
    tokio::spawn(async move {
        while let Some(asked) = probes.recv().await {
            let (probe_sent, received) = (asked.question.sent, asked.arrived);
            asked.reply(&ClockReply { probe_sent, received, replied: received, epoch: 3 }).unwrap();
        }
    });
    let answered = soon(reached(&leader, command_key, &Command::SetFrameRate(5.0))).await.unwrap();
    assert_eq!(answered.answer, CommandReply::Done);
    let refused = leader.ask(command_key, &Command::Pause, SOON).await.unwrap_err();
    assert!(matches!(&refused, AskError::Refused { why, .. } if why == "not today"), "{refused}");

    let sent = leader.options().clock.now();
    let answered = soon(reached(&leader, clock_key, &ClockProbe { sent })).await.unwrap();
    assert_eq!((answered.answer.probe_sent, answered.answer.epoch), (sent, 3));
    assert!(sent <= answered.answer.received && answered.answer.received <= answered.arrived);
    close([agent, leader]).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_question_by_key_alone_is_answered() {
    let (leader, agent) = leader_and_agent().await;
    let command_key = robot_key("r1", RobotTopic::Command);
    let picture_key = robot_key("r1", RobotTopic::Picture(PictureKind::Gaze));
    let mut commands = agent.answer::<Command>(command_key).await.unwrap();
    let mut pictures = agent.answer::<AskedPicture>(picture_key).await.unwrap();
    let mut maps = leader.answer::<AskedMap>(Key::map(team())).await.unwrap();
    let mut json_maps = leader.answer::<AskedMapJson>(Key::map_json(team())).await.unwrap();
    tokio::spawn(async move {
        while let Some(asked) = commands.recv().await {
            let reply = match asked.question {
                Command::SetFrameRate(rate) => CommandReply::Refused(format!("{rate} is too fast")),
                _ => samples::command_reply(),
            };
            asked.reply(&reply).unwrap();
        }
    });
    tokio::spawn(async move {
        while let Some(asked) = pictures.recv().await {
            assert_eq!(asked.question, AskedPicture(PictureKind::Gaze));
            asked.reply(&EncodedPicture(b"\x89PNG".to_vec())).unwrap();
        }
    });
    tokio::spawn(async move {
        while let Some(asked) = maps.recv().await {
            asked.reply(&samples::map()).unwrap();
        }
    });
    tokio::spawn(async move {
        while let Some(asked) = json_maps.recv().await {
            asked.reply(&"{}".to_owned()).unwrap();
        }
    });

    // A stranger: plain Zenoh, nothing but the key.
    let stranger = agent.session.clone();
    let get = async |selector: String| -> Option<(Vec<u8>, String)> {
        let replies = stranger.get(selector).timeout(SOON).await.unwrap();
        let reply = replies.recv_async().await.ok()?;
        let sample = reply.into_result().expect("an answer, not a refusal");
        Some((sample.payload().to_bytes().into_owned(), sample.encoding().to_string()))
    };
    let (status, encoding) = get(command_key.to_string()).await.unwrap();
    let status: serde_json::Value = serde_json::from_slice(&status).unwrap();
    assert_eq!((status["reply"].as_str(), encoding.as_str()), (Some("status"), "application/json"));
    let (refusal, _) = get(format!("{command_key}?do=set_frame_rate;rate_hz=100")).await.unwrap();
    assert_eq!(String::from_utf8(refusal).unwrap(), r#"{"reply":"refused","why":"100 is too fast"}"#);
    assert_eq!(get(picture_key.to_string()).await.unwrap(), (b"\x89PNG".to_vec(), "image/png".to_owned()));
    until(async || get(Key::map(team()).to_string()).await.is_some()).await;
    let (map, _) = get(Key::map(team()).to_string()).await.unwrap();
    assert_eq!(codec::decode::<TeamMap>(&map).unwrap(), samples::map());
    until(async || get(Key::map_json(team()).to_string()).await.is_some()).await;
    close([agent, leader]).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_question_to_nobody_ends_at_once_in_words() {
    let leader = Transport::open(Options::router(["tcp/127.0.0.1:0"])).await.unwrap();
    let key = robot_key("r9", RobotTopic::Command);
    let error = soon(leader.ask(key, &Command::Status, 10 * SOON)).await.unwrap_err();
    assert!(matches!(error, AskError::NobodyThere(_)), "{error}");
    close([leader]).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_cannot_be_read_is_counted_and_the_next_message_comes_through() {
    let (leader, agent) = leader_and_agent().await;
    let mut alarms = leader.subscribe::<Alarm>(Pattern::EveryRobot(team(), RobotTopic::Alarm)).await.unwrap();
    let publisher = agent.publish::<Alarm>(robot_key("r2", RobotTopic::Alarm)).await.unwrap();
    let good = Alarm { robot: RobotId::new("r2").unwrap(), ..samples::alarm() };
    let mut newer = codec::encode(&good).unwrap();
    newer[2] = codec::WIRE_VERSION + 1;
    let key = robot_key("r2", RobotTopic::Alarm).to_string();
    until(async || publisher.has_listeners().await).await;
    // The oversized one does not even pass the router.
    for junk in [b"junk".to_vec(), newer, vec![0; 100_000]] {
        agent.session.put(&key, junk).await.unwrap();
    }
    // Of another robot than the key's.
    publisher.put(&samples::alarm()).unwrap();
    publisher.put(&good).unwrap();
    // The junk has another priority and may be overtaken.
    until(async || {
        publisher.put(&good).unwrap();
        // As often as an honest robot may.
        let received = tokio::time::timeout(Duration::from_millis(50), alarms.recv()).await;
        received.is_ok_and(|received| received.unwrap().message == good) && alarms.refused() == 3
    })
    .await;
    assert_eq!(leader.meter().refused(), 3);
    close([agent, leader]).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_agent_whose_leader_comes_later_waits_and_goes_on() {
    // A port that was free a moment ago.
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let agent = tokio::spawn(Transport::open(Options::client([endpoint.clone()])));
    let leader = Transport::open(Options::router([endpoint])).await.unwrap();
    let agent = soon(agent).await.unwrap().unwrap();
    assert!(agent.is_connected().await);
    close([agent, leader]).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_leader_that_comes_back_learns_all_that_it_missed_without_anybody_repeating_it() {
    let first = Transport::open(Options::router(["tcp/127.0.0.1:0"])).await.unwrap();
    let endpoint = first.locators().await.remove(0);
    let agent = Transport::open(Options::client([endpoint.clone()])).await.unwrap();
    let announcements = agent.publish::<Announcement>(robot_key("r1", RobotTopic::Announcement)).await.unwrap();
    let alarms = agent.publish::<Alarm>(robot_key("r1", RobotTopic::Alarm)).await.unwrap();
    let alive = robot_key("r1", RobotTopic::Alive);
    let _token = agent.declare_alive(alive).await.unwrap();
    let mut commands = agent.answer::<Command>(robot_key("r1", RobotTopic::Command)).await.unwrap();
    announcements.put(&samples::announcement()).unwrap();
    alarms.put(&Alarm { number: 0, ..samples::alarm() }).unwrap();
    first.close().await.unwrap();
    until(async || !agent.is_connected().await).await;
    alarms.put(&Alarm { number: 1, ..samples::alarm() }).unwrap();

    let second = Transport::open(Options::router([endpoint])).await.unwrap();
    let mut seen =
        second.subscribe::<Announcement>(Pattern::EveryRobot(team(), RobotTopic::Announcement)).await.unwrap();
    let mut heard = second.subscribe::<Alarm>(Pattern::EveryRobot(team(), RobotTopic::Alarm)).await.unwrap();
    let mut robots = second.watch(Pattern::EveryRobot(team(), RobotTopic::Alive)).await.unwrap();
    assert_eq!(soon(seen.recv()).await.unwrap().message, samples::announcement());
    for number in 0..2 {
        assert_eq!(soon(heard.recv()).await.unwrap().message.number, number);
    }
    assert_eq!(soon(robots.recv()).await, Some(Sign { key: alive, alive: true }));
    tokio::spawn(async move {
        while let Some(asked) = commands.recv().await {
            asked.reply(&CommandReply::Done).unwrap();
        }
    });
    let answered = soon(reached(&second, robot_key("r1", RobotTopic::Command), &Command::Pause)).await.unwrap();
    assert_eq!(answered.answer, CommandReply::Done);
    close([agent, second]).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn nobody_there_and_a_taken_port_are_said_in_words() {
    let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let mut options = Options::client([format!("tcp/127.0.0.1:{port}")]);
    options.connect_limit = Some(Duration::from_millis(300));
    let error = soon(Transport::open(options)).await.unwrap_err().to_string();
    assert!(error.contains(&port.to_string()) && error.contains("leader"), "{error}");

    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let endpoint = format!("tcp/{}", taken.local_addr().unwrap());
    let error = soon(Transport::open(Options::router([endpoint.clone()]))).await.unwrap_err().to_string();
    assert!(error.contains(&endpoint) && error.contains("port"), "{error}");
}

#[tokio::test]
async fn a_single_threaded_runtime_is_refused_instead_of_a_panic() {
    let error = Transport::open(Options::router(["tcp/127.0.0.1:0"])).await.unwrap_err();
    assert!(matches!(error, TransportError::Runtime));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_meter_counts_payload_and_zenoh_counts_the_wire() {
    let leader = Transport::open(Options { measure: true, ..Options::router(["tcp/127.0.0.1:0"]) }).await.unwrap();
    let agent = Transport::open(Options { measure: true, ..Options::client(leader.locators().await) }).await.unwrap();
    let key = robot_key("r1", RobotTopic::Observation);
    let mut observations = leader.subscribe::<Observation>(key).await.unwrap();
    let publisher = agent.publish::<Observation>(key).await.unwrap();
    until(async || publisher.has_listeners().await).await;
    let before = agent.wire_bytes().await.expect("counted").sent;
    let mut payload = 0;
    for sequence in 0..100 {
        payload += publisher.put(&Observation { sequence, ..samples::observation() }).unwrap() as u64;
        soon(observations.recv()).await.unwrap();
    }
    let wire = agent.wire_bytes().await.expect("counted").sent - before;
    // A few keep-alives beside; on a loaded machine some messages share a frame.
    let framing = 100 * ZENOH_FRAME_BYTES;
    let expected = payload + framing / 2..=payload + 2 * framing;
    assert!(expected.contains(&wire), "{payload} bytes of payload, {wire} on the wire, expected {expected:?}");
    for (transport, direction) in [(&agent, Direction::Sent), (&leader, Direction::Received)] {
        let rows = transport.meter().rows();
        assert_eq!(rows.len(), 1);
        assert_eq!((rows[0].direction, rows[0].count.messages, rows[0].count.payload_bytes), (direction, 100, payload));
    }
    close([agent, leader]).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_client_of_two_leaders_takes_the_other_when_one_goes() {
    let first = Transport::open(Options::router(["tcp/127.0.0.1:0"])).await.unwrap();
    let mut options = Options::router(["tcp/127.0.0.1:0"]);
    options.connect = first.locators().await;
    let second = Transport::open(options).await.unwrap();
    let endpoints = [first.locators().await, second.locators().await].concat();
    let agent = Transport::open(Options::client(endpoints)).await.unwrap();
    let mut observations =
        second.subscribe::<Observation>(Pattern::EveryRobot(team(), RobotTopic::Observation)).await.unwrap();
    let publisher = agent.publish::<Observation>(robot_key("r1", RobotTopic::Observation)).await.unwrap();
    until(async || publisher.has_listeners().await).await;
    publisher.put(&samples::observation()).unwrap();
    soon(observations.recv()).await.unwrap();
    first.close().await.unwrap();
    // Put again until one gets through: those sent while the link was down are lost.
    let mut sequence = 1;
    until(async || {
        sequence += 1;
        publisher.put(&Observation { sequence, ..samples::observation() }).unwrap();
        tokio::time::timeout(Duration::from_millis(50), observations.recv()).await.is_ok()
    })
    .await;
    close([agent, second]).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn after_closing_readers_end_and_writers_say_so() {
    let (leader, agent) = leader_and_agent().await;
    let key = robot_key("r1", RobotTopic::Observation);
    let mut observations = agent.subscribe::<Observation>(key).await.unwrap();
    let mut robots = agent.watch(Pattern::EveryRobot(team(), RobotTopic::Alive)).await.unwrap();
    let publisher = agent.publish::<Observation>(key).await.unwrap();
    agent.close().await.unwrap();
    assert!(soon(observations.recv()).await.is_none());
    assert!(soon(robots.recv()).await.is_none());
    assert!(matches!(publisher.put(&samples::observation()), Err(TransportError::Send { .. })));
    close([leader]).await;
}

fn team() -> TeamId {
    TeamId::new("blue").unwrap()
}

fn robot_key(robot: &str, topic: RobotTopic) -> Key {
    Key::robot(team(), RobotId::new(robot).unwrap(), topic)
}

async fn leader_and_agent() -> (Transport, Transport) {
    let leader = Transport::open(Options::router(["tcp/127.0.0.1:0"])).await.unwrap();
    let agent = Transport::open(Options::client(leader.locators().await)).await.unwrap();
    (leader, agent)
}

/// Asks until somebody is there: a queryable's declaration takes a moment to get round.
async fn reached<Q: Question>(transport: &Transport, key: Key, question: &Q) -> Result<Answered<Q::Answer>, AskError> {
    loop {
        match transport.ask(key, question, SOON).await {
            Err(AskError::NobodyThere(_)) => tokio::task::yield_now().await,
            answered => return answered,
        }
    }
}

async fn soon<T>(event: impl Future<Output = T>) -> T {
    tokio::time::timeout(SOON, event).await.expect("the event came in time")
}

async fn until(mut condition: impl AsyncFnMut() -> bool) {
    soon(async {
        while !condition().await {
            tokio::task::yield_now().await;
        }
    })
    .await;
}

async fn close<const N: usize>(transports: [Transport; N]) {
    for transport in transports {
        transport.close().await.unwrap();
    }
}
