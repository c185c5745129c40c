//! Leaders as processes of their own, killed and frozen while they lead; agents over real Zenoh sessions on loopback.
//!
//! The times are printed (`cargo test -p tests failover -- --nocapture`); the bounds are those of a machine that does other
//! things, too.

// Helpers outside test functions fail like the tests do.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use protocol::id::LeaderId;
use protocol::key::{Key, Pattern};
use protocol::message::{Candidacy, Presence, TeamMap};
use protocol::transport::{AskedMap, Options, Subscriber, Transport};
use tokio::time::timeout;

use crate::services::{free_endpoint, start_agent, team};

/// Nothing here takes so long unless it never comes.
const LIMIT: Duration = Duration::from_secs(40);
/// One question.
const QUESTION_LIMIT: Duration = Duration::from_secs(2);
/// The configuration of a leader in a process of its own.
const CONFIG: &str = "PAL_TEST_LEADER_CONFIG";

/// Not a test: the program of the leaders' processes, which are this very program started again.
#[test]
#[ignore = "started by the tests below"]
fn a_leader_in_a_process_of_its_own() {
    let Some(config) = std::env::var_os(CONFIG) else { return };
    // RUST_LOG=zenoh=debug shows what the sessions do.
    zenoh::init_log_from_env_or("error");
    team_leader::cli::run::run(&team_leader::cli::run::RunArgs { config: config.into() });
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_killed_leader_is_followed_and_a_frozen_one_too_and_neither_is_heard_again() {
    let folder = tempfile::tempdir().unwrap();
    let endpoints = [free_endpoint(), free_endpoint()];
    let mut first = Leading::start(folder.path(), "l1", &endpoints[0], &endpoints[1]);
    let watch = |k: usize| Transport::open(Options::client([endpoints[k].clone()]));
    let by_first = watch(0).await.unwrap();
    until_rules(&by_first, "l1").await;
    let second = Leading::start(folder.path(), "l2", &endpoints[1], &endpoints[0]);
    let by_second = watch(1).await.unwrap();
    let agents = ["r1", "r2"].map(|id| start_agent(id, 1, "alpha", &endpoints));
    let mut maps = by_second.subscribe_map(team()).await.unwrap();
    let before = next_map(&mut maps, |map| online(map) == 2).await;
    assert_eq!(before.leader, name("l1"));
    // It has listened (for a second: before, nobody takes over), and knows the first one's term.
    let mut words = 0;
    until_word(&by_second, |word| {
        words += usize::from(word.leader == name("l2") && !word.rules && word.term == before.term);
        words > 8
    })
    .await;

    let killed = Instant::now();
    first.process.kill().unwrap();
    first.process.wait().unwrap();
    let after = next_map(&mut maps, |map| map.leader == name("l2")).await;
    println!("after kill -9 the first map of the next leader came in {:.2} s", killed.elapsed().as_secs_f64());
    assert_eq!(after.term, before.term + 1);
    assert_eq!(next_map(&mut maps, |map| online(map) == 2).await.leader, name("l2"));
    drop(first);

    // It comes back, and stands by although its name is the lower one.
    let _first = Leading::start(folder.path(), "l1", &endpoints[0], &endpoints[1]);
    until_stands_by(&by_second, "l1").await;
    let by_first = watch(0).await.unwrap();
    let mut maps = by_first.subscribe_map(team()).await.unwrap();
    let mut words: Subscriber<Candidacy> = by_first.subscribe(Pattern::EveryCandidacy(team())).await.unwrap();
    assert_eq!(next_map(&mut maps, |map| online(map) == 2).await.leader, name("l2"));

    let frozen = Instant::now();
    second.signal("STOP");
    let after = next_map(&mut maps, |map| map.leader == name("l1")).await;
    println!("after SIGSTOP the first map of the next leader came in {:.2} s", frozen.elapsed().as_secs_f64());
    assert!(after.term > before.term + 1, "term {}", after.term);
    second.signal("CONT");
    // The thawed one says that it stands by; until then, and after, only the new one's maps are believed.
    let thawed = async {
        loop {
            tokio::select! {
                Some(word) = words.recv() => if word.message.leader == name("l2") && !word.message.rules { break },
                Some(map) = maps.recv() => assert_eq!(map.message.leader, name("l1")),
            }
        }
    };
    timeout(LIMIT, thawed).await.unwrap();
    // Who asks through the thawed one at the moment in which it opens its new session must ask again.
    let asked = async {
        loop {
            if let Ok(got) = by_second.ask_ruler(Key::map(team()), &AskedMap, QUESTION_LIMIT, |map| map.term).await {
                return got.answer;
            }
        }
    };
    assert_eq!(timeout(LIMIT, asked).await.unwrap().leader, name("l1"));
    for agent in agents {
        agent.stop().await;
    }
    by_first.close().await.unwrap();
    by_second.close().await.unwrap();
}

/// A leader's process; it goes with this value.
struct Leading {
    process: Child,
}

impl Leading {
    fn start(folder: &Path, id: &str, listen: &str, connect: &str) -> Self {
        let config: PathBuf = folder.join(format!("{id}.toml"));
        let text = format!(
            "[leader]\nid = \"{id}\"\nteam = \"{}\"\nstate_dir = \"{id}-state\"\n[network]\nlisten = [\"{listen}\"]\n\
             connect = [\"{connect}\"]\n",
            team()
        );
        std::fs::write(&config, text).unwrap();
        let process = Command::new(std::env::current_exe().unwrap())
            .args(["--ignored", "--exact", "failover::a_leader_in_a_process_of_its_own"])
            .env(CONFIG, &config)
            .spawn()
            .unwrap();
        Self { process }
    }

    fn signal(&self, signal: &str) {
        let sent = Command::new("kill").args([format!("-{signal}"), self.process.id().to_string()]).status().unwrap();
        assert!(sent.success());
    }
}

impl Drop for Leading {
    fn drop(&mut self) {
        // It may have been killed already.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

async fn until_rules(transport: &Transport, leader: &str) {
    until_word(transport, |word| word.leader == name(leader) && word.rules).await;
}

async fn until_stands_by(transport: &Transport, leader: &str) {
    until_word(transport, |word| word.leader == name(leader) && !word.rules).await;
}

async fn until_word(transport: &Transport, mut condition: impl FnMut(&Candidacy) -> bool) {
    let mut words: Subscriber<Candidacy> = transport.subscribe(Pattern::EveryCandidacy(team())).await.unwrap();
    timeout(LIMIT, async { while !condition(&words.recv().await.unwrap().message) {} }).await.unwrap();
}

async fn next_map(maps: &mut protocol::transport::Maps, condition: impl Fn(&TeamMap) -> bool) -> TeamMap {
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

fn online(map: &TeamMap) -> usize {
    map.robots.iter().filter(|robot| robot.presence == Presence::Online).count()
}

fn name(leader: &str) -> LeaderId {
    LeaderId::new(leader).unwrap()
}
