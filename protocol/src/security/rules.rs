//! Access control and size limits for every router of a team, from one place.
//!
//! Zenoh's rules allow a kind of message in one direction on key expressions for a connected name; all else is denied. Two facts
//! shape the table. A key expression is allowed only if a rule's *includes* it, and `**` does not include chunks that begin with
//! `@`, where cached publishers keep their history: so each key has its twin `…/@adv/**`. And a client publishes only when its
//! router has told it that somebody subscribes: so a robot must be *asked* before it can speak.

use serde_json::{Value, json};

use super::roster::{Names, Role, Roster, common_name};
use crate::codec::Kind;
use crate::id::TeamId;
use crate::key::{Key, Pattern, ROOT, RobotTopic};

/// What the one who says something sends.
const SPEAK: [&str; 4] = ["put", "reply", "declare_queryable", "liveliness_token"];
/// What the one who wants to hear something sends.
const LISTEN: [&str; 4] = ["declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query"];
/// Most bytes of words in a reply, an answer for people or a refusal, on keys whose envelopes are smaller.
const WORDS: usize = 1024;
/// Most bytes that publishers' caches say among themselves (heartbeats).
const ADVANCED_BYTES: usize = 256;

/// What one kind of member may do, seen from the router that it is connected to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Rule {
    /// What it is for; unique in a role.
    pub what: &'static str,
    /// From the member (`ingress`) or to it (`egress`).
    pub flow: &'static str,
    /// Zenoh's kinds of messages.
    pub messages: &'static [&'static str],
    /// On these key expressions.
    pub keys: Vec<String>,
}

/// The rules of a member. `name` matters for robots only.
pub fn rules(team: TeamId, role: Role, name: &str) -> Vec<Rule> {
    let all = with_history(format!("{ROOT}/{team}/**"));
    let rule = |what, flow, messages: &'static [&'static str], keys: &[String]| Rule {
        what,
        flow,
        messages,
        keys: keys.to_vec(),
    };
    match role {
        Role::Robot => {
            let own = with_history(format!("{ROOT}/{team}/robot/{name}/**"));
            let readable = readable_by_robot(team, name);
            vec![
                rule("speaks under its own name", "ingress", &SPEAK, &own),
                rule("asks for what it needs", "ingress", &LISTEN, &readable),
                rule("hears what it needs", "egress", &SPEAK, &readable),
                rule("is asked", "egress", &LISTEN, &all),
            ]
        }
        Role::Operator => vec![
            rule("asks for everything", "ingress", &LISTEN, &all),
            rule("hears everything", "egress", &SPEAK, &all),
        ],
        Role::Leader | Role::Router => vec![
            rule("speaks for those behind it", "ingress", &SPEAK, &all),
            rule("asks for those behind it", "ingress", &LISTEN, &all),
            rule("hears everything", "egress", &SPEAK, &all),
            rule("is asked", "egress", &LISTEN, &all),
        ],
    }
}

/// What a robot needs: who its fellows are, which leaders there are, where to go and where to look, when recordings begin. Not
/// the map, and not what its fellows see.
fn readable_by_robot(team: TeamId, name: &str) -> Vec<String> {
    let mut keys = with_history(Pattern::EveryRobot(team, RobotTopic::Announcement).to_string());
    keys.push(Pattern::EveryLeader(team).to_string());
    keys.push(format!("{ROOT}/{team}/guidance/{name}"));
    keys.push(format!("{ROOT}/{team}/surroundings/{name}"));
    keys.push(Key::replay_start(team).to_string());
    keys
}

fn with_history(key: String) -> Vec<String> {
    let history = format!("{key}/@adv/**");
    vec![key, history]
}

/// `access_control` of a router's Zenoh configuration.
pub fn access_control(roster: &Roster, names: Names) -> Value {
    let team = roster.team;
    let (mut table, mut subjects, mut policies) = (Vec::new(), Vec::new(), Vec::new());
    for role in Role::ALL {
        // Robots have a set of rules each; of the others all of a role share one.
        let mut shared_subjects = Vec::new();
        for (name, entry) in roster.of(role) {
            let subject = format!("{role} {name}");
            let known_by: Vec<String> = match names {
                Names::Certificates => {
                    entry.accepted.iter().map(|g| common_name(team, role, name.as_str(), *g)).collect()
                }
                Names::Users => entry.accepted.iter().map(|_| format!("{role}.{name}")).collect(),
            };
            if known_by.is_empty() {
                continue;
            }
            subjects.push(match names {
                Names::Certificates => json!({ "id": subject, "cert_common_names": known_by }),
                Names::Users => json!({ "id": subject, "usernames": known_by }),
            });
            if role == Role::Robot {
                let ids = push_rules(&mut table, &subject, rules(team, role, name.as_str()));
                policies.push(json!({ "rules": ids, "subjects": [subject] }));
            } else {
                shared_subjects.push(subject);
            }
        }
        if !shared_subjects.is_empty() {
            let ids = push_rules(&mut table, &role.to_string(), rules(team, role, ""));
            policies.push(json!({ "rules": ids, "subjects": shared_subjects }));
        }
    }
    json!({
        "enabled": true, "default_permission": "deny", "rules": table, "subjects": subjects, "policies": policies,
    })
}

fn push_rules(table: &mut Vec<Value>, prefix: &str, rules: Vec<Rule>) -> Vec<String> {
    let mut ids = Vec::new();
    for rule in rules {
        let id = format!("{prefix} {}", rule.what);
        table.push(json!({
            "id": id, "permission": "allow", "flows": [rule.flow], "messages": rule.messages, "key_exprs": rule.keys,
        }));
        ids.push(id);
    }
    ids
}

/// `low_pass_filter` of a router's Zenoh configuration: no message is larger than its kind may be. Applies to everybody, with
/// or without access control.
pub fn size_limits() -> Value {
    let robot = |topic: &str| format!("{ROOT}/*/robot/*/{topic}");
    let team = |rest: &str| format!("{ROOT}/*/{rest}");
    let limit = |messages: &[&str], key: String, bytes: usize| {
        json!({
            "id": format!("{} on {key}", messages.join(" and ")), "flows": ["ingress"], "messages": messages,
            "key_exprs": [key], "size_limit": bytes,
        })
    };
    let published = &["put", "reply"][..];
    Value::Array(vec![
        limit(published, robot("announcement"), Kind::Announcement.max_bytes()),
        limit(published, robot("observation"), Kind::Observation.max_bytes()),
        limit(published, robot("alarm"), Kind::Alarm.max_bytes()),
        limit(published, robot("health"), Kind::Health.max_bytes()),
        limit(published, robot("edges"), Kind::Edges.max_bytes()),
        limit(published, robot("picture/*"), Kind::Picture.max_bytes()),
        limit(published, robot("command"), Kind::CommandReply.max_bytes().max(WORDS)),
        limit(published, robot("clock"), Kind::ClockReply.max_bytes().max(WORDS)),
        limit(published, team("map"), Kind::TeamMap.max_bytes()),
        limit(published, team("map/json"), Kind::MapJson.max_bytes()),
        limit(published, team("guidance/*"), Kind::Guidance.max_bytes()),
        limit(published, team("surroundings/*"), Kind::Surroundings.max_bytes()),
        limit(published, team("replay_start"), Kind::ReplayStart.max_bytes().max(WORDS)),
        limit(published, format!("{ROOT}/*/**/@adv/**"), ADVANCED_BYTES),
        limit(&["query"], format!("{ROOT}/**"), Kind::Command.max_bytes()),
    ])
}

/// A whole configuration for a zenohd of the team, to stand in the router's folder beside its certificate. Says in comments what
/// to edit.
pub fn zenohd(roster: &Roster) -> String {
    let access = access_control(roster, Names::Certificates);
    let pretty = |value: &Value| serde_json::to_string_pretty(value).unwrap_or_default();
    format!(
        r#"// zenohd of team {team}, by `team-leader provision`: zenohd --config router.json5, in the folder where this stands
// (the paths count from where it is started). Made anew by every change of the roster: then restart zenohd.
// What to edit: where it listens (the hosts given to `provision router --host`), and the leaders it connects to.
{{
  mode: "router",
  listen: {{ endpoints: ["tls/0.0.0.0:7447"] }},
  connect: {{ endpoints: [], timeout_ms: -1, exit_on_failure: false,
             retry: {{ period_init_ms: 100, period_max_ms: 500, period_increase_factor: 1.5 }} }},
  scouting: {{ multicast: {{ enabled: false }}, gossip: {{ enabled: false }} }},
  timestamping: {{ enabled: false }},
  adminspace: {{ enabled: false }},
  transport: {{
    unicast: {{ open_timeout: 500, accept_timeout: 500, max_sessions: 1000 }},
    link: {{
      tx: {{ lease: 1000 }}, rx: {{ max_message_size: {largest} }},
      tls: {{
        root_ca_certificate: "authority.pem", enable_mtls: true, verify_name_on_connect: true, close_link_on_expiration: true,
        listen_certificate: "certificate.pem", listen_private_key: "key.pem",
        connect_certificate: "certificate.pem", connect_private_key: "key.pem",
      }},
    }},
  }},
  low_pass_filter: {limits},
  access_control: {access},
}}
"#,
        team = roster.team,
        largest = Kind::MapJson.max_bytes() + (64 << 10),
        limits = pretty(&size_limits()),
        access = pretty(&access),
    )
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;
    use crate::id::MemberId;
    use crate::security::roster::Entry;

    #[test]
    fn a_revoked_member_has_no_rule_and_no_name() {
        let team = TeamId::new("blue").unwrap();
        let mut roster = Roster::new(team);
        for (name, accepted) in [("r1", BTreeSet::from([1])), ("r2", BTreeSet::new()), ("r3", BTreeSet::from([1, 2]))] {
            roster.robot.insert(MemberId::new(name).unwrap(), Entry { issued: 2, accepted });
        }
        let text = access_control(&roster, Names::Certificates).to_string();
        assert!(text.contains("blue.robot.r1.1") && text.contains("blue.robot.r3.2") && !text.contains("r2"), "{text}");
        let users = access_control(&roster, Names::Users).to_string();
        assert!(users.contains("\"robot.r1\"") && !users.contains("cert_common_names"), "{users}");
    }

    #[test]
    fn a_robot_is_named_in_its_own_keys_only() {
        for rule in rules(TeamId::new("blue").unwrap(), Role::Robot, "r1") {
            let speaks = rule.flow == "ingress" && rule.messages.contains(&"put");
            for key in &rule.keys {
                assert_eq!(speaks, key.starts_with("pal/blue/robot/r1/"), "{}: {key}", rule.what);
            }
        }
    }
}
