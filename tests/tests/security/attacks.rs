//! Who should not get in does not, and who is in cannot harm the others.

use protocol::id::RobotId;
use protocol::key::{Pattern, RobotTopic};
use protocol::message::{Motion, Observation, Stages};
use protocol::time::Timestamp;
use protocol::transport::Role as SessionRole;

use super::*;

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn spoofing_through_another_leader_is_refused() {
    let team = Team::new();
    let (_l1, at_1) = team.leader("l1", &[]).await;
    let (_l2, at_2) = team.leader("l2", &at_1).await;
    let (r1, ann) = (team.raw(Role::Robot, "r1", &at_2).await, team.raw(Role::Operator, "ann", &at_1).await);
    let all = ear(&ann, "pal/blue/**").await;
    let forbidden = ["pal/blue/robot/r2/observation", "pal/blue/map"];
    only_is_heard(&r1, &forbidden, "pal/blue/robot/r1/observation", &all).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn spoofing_through_a_router_with_the_provisioned_file_is_refused() {
    let team = Team::new();
    let (_l1, at_1) = team.leader("l1", &[]).await;
    // The very file that zenohd gets, its paths made absolute and its endpoints the test's own.
    let folder = team.folder(Role::Router, "z1");
    let file = std::fs::read_to_string(folder.join("router.json5")).unwrap();
    let mut config = zenoh::Config::from_json5(&file).unwrap();
    let path = |name: &str| serde_json::json!(folder.join(name)).to_string();
    for (key, name) in [
        ("root_ca_certificate", "authority.pem"),
        ("listen_certificate", "certificate.pem"),
        ("listen_private_key", "key.pem"),
        ("connect_certificate", "certificate.pem"),
        ("connect_private_key", "key.pem"),
    ] {
        config.insert_json5(&format!("transport/link/tls/{key}"), &path(name)).unwrap();
    }
    config.insert_json5("listen/endpoints", r#"["tls/127.0.0.1:0"]"#).unwrap();
    config.insert_json5("connect/endpoints", &serde_json::json!(at_1).to_string()).unwrap();
    let router = zenoh::open(config).await.unwrap();
    let at_router: Vec<String> = router.info().locators().await.iter().map(ToString::to_string).collect();

    let (r1, ann) = (team.raw(Role::Robot, "r1", &at_router).await, team.raw(Role::Operator, "ann", &at_1).await);
    let all = ear(&ann, "pal/blue/**").await;
    only_is_heard(&r1, &["pal/blue/robot/r2/observation"], "pal/blue/robot/r1/observation", &all).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_revoked_robot_is_not_heard_and_its_successor_is() {
    let mut team = Team::new();
    let old = team.folder(Role::Robot, "r1").with_file_name("stolen");
    std::fs::rename(team.folder(Role::Robot, "r1"), &old).unwrap();
    team.pki.revoke(Role::Robot, id("r1"), false).unwrap();
    team.pki.issue(Role::Robot, id("r1"), Issue::First, &[], (preflight::now(), DAY)).unwrap();
    let (_leader, at) = team.leader("l1", &[]).await;
    let (stolen, ann) = (raw_session(old, &at).await, team.raw(Role::Operator, "ann", &at).await);
    let all = ear(&ann, "pal/blue/**").await;
    stolen.put("pal/blue/robot/r1/alarm", "stolen").await.unwrap();
    assert_eq!(answers(&stolen, "pal/blue/replay_start").await, 0);
    let fresh = team.raw(Role::Robot, "r1", &at).await;
    only_is_heard(&fresh, &[], "pal/blue/robot/r1/observation", &all).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn without_a_certificate_of_the_team_nobody_gets_in_and_the_reason_is_said() {
    let (ours, theirs) = (Team::new(), Team::new());
    let (_leader, at) = ours.leader("l1", &[]).await;
    let refused = async |security: Security, at: &[String]| {
        let options = Options { security, connect_limit: Some(Duration::from_secs(1)), ..Options::client(at) };
        Transport::open(options).await.unwrap_err().to_string()
    };
    let stranger = refused(theirs.security(Role::Robot, "r1"), &at).await;
    assert!(stranger.contains("another authority"), "{stranger}");
    let plain: Vec<String> = at.iter().map(|endpoint| endpoint.replacen("tls/", "tcp/", 1)).collect();
    assert!(refused(Security::Loopback, &plain).await.contains("cannot open"), "plain TCP got in");
    let nobody = refused(ours.security(Role::Robot, "r1"), &["tls/127.0.0.1:1".to_owned()]).await;
    assert!(nobody.contains("nobody listens"), "{nobody}");
    // Under another name than the certificate's: what an address that was not provisioned looks like.
    let elsewhere: Vec<String> = at.iter().map(|endpoint| endpoint.replace("127.0.0.1", "127.0.0.2")).collect();
    let unnamed = refused(ours.security(Role::Robot, "r1"), &elsewhere).await;
    assert!(unnamed.contains("nobody listens") || unnamed.contains("not for the host"), "{unnamed}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_robot_cannot_pass_for_a_leader() {
    let team = Team::new();
    let mut options = Options::router(["tls/127.0.0.1:0"]);
    assert_eq!(options.role, SessionRole::Router);
    // It has no roster; it makes one.
    std::fs::copy(team.folder(Role::Leader, "l1").join("team.toml"), team.folder(Role::Robot, "r3").join("team.toml"))
        .unwrap();
    options.security = team.security(Role::Robot, "r3");
    let false_leader = Transport::open(options).await.unwrap();
    let at = false_leader.locators().await;
    let options = Options {
        security: team.security(Role::Robot, "r1"),
        connect_limit: Some(Duration::from_secs(1)),
        ..Options::client(at)
    };
    let error = Transport::open(options).await.unwrap_err().to_string();
    assert!(error.contains("not one of a leader"), "{error}");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn oversized_messages_do_not_pass_the_first_router() {
    let team = Team::new();
    let (leader, at) = team.leader("l1", &[]).await;
    let mut heard =
        leader.subscribe::<Observation>(Pattern::EveryRobot(team_id(), RobotTopic::Observation)).await.unwrap();
    let r1 = team.raw(Role::Robot, "r1", &at).await;
    let good = protocol::codec::encode(&observation(1)).unwrap();
    let receiving = async {
        loop {
            r1.put("pal/blue/robot/r1/observation", vec![0u8; (16 << 10) + 1]).await.unwrap();
            r1.put("pal/blue/robot/r1/health", vec![0u8; 1 << 20]).await.unwrap();
            r1.put("pal/blue/robot/r1/observation", good.clone()).await.unwrap();
            if timeout(AGAIN, heard.recv()).await.is_ok() {
                break;
            }
        }
    };
    timeout(LIMIT, receiving).await.unwrap();
    assert_eq!(heard.refused(), 0, "an oversized message came as far as the decoder");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_flood_is_refused_and_the_others_are_heard() {
    let team = Team::new();
    let (leader, at) = team.leader("l1", &[]).await;
    let mut heard =
        leader.subscribe::<Observation>(Pattern::EveryRobot(team_id(), RobotTopic::Observation)).await.unwrap();
    let (mad, r2) = (team.raw(Role::Robot, "r1", &at).await, team.raw(Role::Robot, "r2", &at).await);
    let payload = protocol::codec::encode(&observation(1)).unwrap();
    let madness = payload.clone();
    let flood = tokio::spawn(async move {
        loop {
            mad.put("pal/blue/robot/r1/observation", madness.clone()).await.unwrap();
            tokio::task::yield_now().await;
        }
    });
    let (r1_id, r2_id) = (RobotId::new("r1").unwrap(), RobotId::new("r2").unwrap());
    let mut tick = tokio::time::interval(AGAIN);
    let (mut of_mad, mut of_r2) = (0, 0);
    let listening = async {
        while leader.meter().flooded() < 2000 || of_r2 < 10 {
            tokio::select! {
                _ = tick.tick() => r2.put("pal/blue/robot/r2/observation", payload.clone()).await.unwrap(),
                got = heard.recv() => match got.unwrap().key.robot_id() {
                    id if id == Some(r1_id) => of_mad += 1,
                    id => of_r2 += u32::from(id == Some(r2_id)),
                },
            }
        }
    };
    let began = std::time::Instant::now();
    timeout(LIMIT, listening).await.unwrap();
    flood.abort();
    let pace = protocol::transport::pace(protocol::codec::Kind::Observation).unwrap();
    let allowed = pace.burst + pace.per_second * (began.elapsed() + LIMIT / 30).as_secs_f64();
    assert!(f64::from(of_mad) <= allowed, "{of_mad} of the flood came through, {allowed:.0} may");
    assert_eq!(heard.dropped(), 0, "the ring overflowed");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn with_passwords_a_robot_speaks_under_its_own_name_and_a_wrong_password_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        path
    };
    let all = file("all", "leader.l1:a\nrobot.r1:b\nrobot.r2:c\noperator.ann:d\n");
    let security = |user: &str, password_file: PathBuf, passwords_file| {
        Security::Password(protocol::security::Passwords {
            team: team_id(),
            user: user.to_owned(),
            password_file,
            passwords_file,
        })
    };
    let mut options = Options::router(["tcp/127.0.0.1:0"]);
    options.security = security("leader.l1", file("l1", "a\n"), Some(all));
    let leader = Transport::open(options).await.unwrap();
    let at = leader.locators().await;
    let mut heard =
        leader.subscribe::<Observation>(Pattern::EveryRobot(team_id(), RobotTopic::Observation)).await.unwrap();
    let client = async |security| {
        let options = Options { security, connect_limit: Some(Duration::from_secs(2)), ..Options::client(&at) };
        Transport::open(options).await
    };
    assert!(client(security("robot.r1", file("wrong", "c"), None)).await.is_err());
    assert!(client(Security::Loopback).await.is_err());
    let r1 = client(security("robot.r1", file("r1", "b\n"), None)).await.unwrap();
    let key = |name: &str| protocol::key::Key::robot(team_id(), RobotId::new(name).unwrap(), RobotTopic::Observation);
    let (own, other) =
        (r1.publish::<Observation>(key("r1")).await.unwrap(), r1.publish::<Observation>(key("r2")).await.unwrap());
    let receiving = async {
        loop {
            other.put(&observation(1)).unwrap();
            own.put(&observation(1)).unwrap();
            if let Ok(Some(got)) = timeout(AGAIN, heard.recv()).await {
                assert_eq!(got.key, key("r1"));
                return;
            }
        }
    };
    timeout(LIMIT, receiving).await.unwrap();
}

fn observation(sequence: u32) -> Observation {
    Observation {
        epoch: 1,
        sequence,
        capture: Timestamp(1_800_000_000_000_000_000),
        motion: Motion::Standing,
        odometry: None,
        stages: Stages::ALL,
        sightings: Vec::new(),
        tracks: Vec::new(),
    }
}
