//! Certificates and access control over real TLS sessions: each rule allowed and denied, spoofing through every router,
//! eavesdropping, oversized messages and floods. Attackers are plain Zenoh sessions with a valid certificate, not our transport.

// Helpers outside test functions fail like the tests do.
#![allow(clippy::unwrap_used, clippy::panic)]

mod attacks;
mod rules;
mod team;

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::Duration;

use protocol::id::{MemberId, TeamId};
use protocol::security::roster::Role;
use protocol::security::{Credentials, Security, preflight};
use protocol::transport::{Options, Transport};
use team_leader::provision::{Issue, Pki};
use tempfile::TempDir;
use tokio::time::timeout;
use zenoh::handlers::FifoChannelHandler;
use zenoh::pubsub::Subscriber;
use zenoh::sample::Sample;

/// Nothing here takes so long unless it never comes.
const LIMIT: Duration = Duration::from_secs(30);
/// After so long something is said again: a subscription may have needed its time to become known.
const AGAIN: Duration = Duration::from_millis(100);
const DAY: Duration = Duration::from_secs(86_400);

/// A provisioned team with leaders that run.
struct Team {
    _folder: TempDir,
    pki: Pki,
}

impl Team {
    /// Robots r1 to r3, leaders l1 and l2, operator ann, router z1.
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let mut pki = Pki::create(&folder.path().join("pki"), team_id(), preflight::now()).unwrap();
        for (role, names) in [
            (Role::Robot, &["r1", "r2", "r3"][..]),
            (Role::Leader, &["l1", "l2"]),
            (Role::Operator, &["ann"]),
            (Role::Router, &["z1"]),
        ] {
            for name in names {
                pki.issue(role, id(name), Issue::First, &[], (preflight::now(), DAY)).unwrap();
            }
        }
        Self { _folder: folder, pki }
    }

    fn folder(&self, role: Role, name: &str) -> PathBuf {
        self.pki.folder_of(role, id(name))
    }

    fn security(&self, role: Role, name: &str) -> Security {
        Security::Tls(Credentials { folder: self.folder(role, name) })
    }

    /// A leader's own router, and where it listens.
    async fn leader(&self, name: &str, others: &[String]) -> (Transport, Vec<String>) {
        let mut options = Options::router(["tls/127.0.0.1:0"]);
        options.connect = others.to_vec();
        options.security = self.security(Role::Leader, name);
        let transport = timeout(LIMIT, Transport::open(options)).await.unwrap().unwrap();
        let locators = transport.locators().await;
        (transport, locators)
    }

    /// A member by our own transport.
    async fn member(&self, role: Role, name: &str, connect: &[String]) -> Transport {
        let options = Options { security: self.security(role, name), ..Options::client(connect) };
        timeout(LIMIT, Transport::open(options)).await.unwrap().unwrap()
    }

    /// A member that does what it likes: a plain Zenoh client with its certificate.
    async fn raw(&self, role: Role, name: &str, connect: &[String]) -> zenoh::Session {
        raw_session(self.folder(role, name), connect).await
    }
}

async fn raw_session(folder: PathBuf, connect: &[String]) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    let tls = serde_json::json!({
        "root_ca_certificate": folder.join("authority.pem"), "enable_mtls": true,
        "connect_certificate": folder.join("certificate.pem"), "connect_private_key": folder.join("key.pem"),
    });
    for (key, value) in [
        ("mode", serde_json::json!("client")),
        ("connect/endpoints", serde_json::json!(connect)),
        ("connect/timeout_ms", serde_json::json!(20_000)),
        ("scouting/multicast/enabled", serde_json::json!(false)),
        ("transport/link/tls", tls),
    ] {
        config.insert_json5(key, &value.to_string()).unwrap();
    }
    zenoh::open(config).await.unwrap()
}

type Ear = Subscriber<FifoChannelHandler<Sample>>;

async fn ear(session: &zenoh::Session, key: &str) -> Ear {
    session.declare_subscriber(key.to_owned()).await.unwrap()
}

/// Says all of it, the allowed last, until the allowed is heard, and then that nothing else ever was. One link keeps the order,
/// so what is not heard before the allowed is not heard at all.
async fn only_is_heard(speaker: &zenoh::Session, forbidden: &[&str], allowed: &str, ear: &Ear) {
    let mut heard = BTreeSet::new();
    let listening = async {
        loop {
            for key in forbidden.iter().chain([&allowed]) {
                speaker.put(*key, "x").await.unwrap();
            }
            while let Ok(sample) = timeout(AGAIN, ear.recv_async()).await {
                heard.insert(sample.unwrap().key_expr().to_string());
            }
            if heard.contains(allowed) {
                break;
            }
        }
    };
    timeout(LIMIT, listening).await.unwrap();
    assert_eq!(heard, BTreeSet::from([allowed.to_owned()]));
}

/// The number of answers to a question.
async fn answers(asker: &zenoh::Session, key: &str) -> usize {
    let replies = asker.get(key).timeout(Duration::from_secs(5)).await.unwrap();
    let mut count = 0;
    while let Ok(reply) = replies.recv_async().await {
        count += usize::from(reply.result().is_ok());
    }
    count
}

/// Asks until there is an answer.
async fn is_answered(asker: &zenoh::Session, key: &str) {
    let asking = async { while answers(asker, key).await == 0 {} };
    timeout(LIMIT, asking).await.unwrap();
}

/// Answers everything on a key, as long as the session lives.
async fn answer_all(session: &zenoh::Session, key: &str) {
    let own = key.to_owned();
    let reply = move |query: zenoh::query::Query| {
        let _ = zenoh::Wait::wait(query.reply(own.clone(), "answer"));
    };
    session.declare_queryable(key.to_owned()).callback(reply).background().await.unwrap();
}

fn team_id() -> TeamId {
    TeamId::new("blue").unwrap()
}

fn id(name: &str) -> MemberId {
    MemberId::new(name).unwrap()
}
