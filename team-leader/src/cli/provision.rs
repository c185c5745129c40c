//! `team-leader provision`: the team's authority and the certificates of its members.

use std::io::Write;
use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand, ValueEnum};
use protocol::id::{MemberId, TeamId};
use protocol::security::preflight;
use protocol::security::roster::Role;

use super::solve::Format;
use crate::provision::{Issue, Pki, ProvisionError, generations};

/// A day.
const DAY: Duration = Duration::from_secs(86_400);

/// Arguments of `provision`.
#[derive(Debug, Clone, Args)]
pub struct ProvisionArgs {
    /// The folder of the authority. Its `authority.key` must stay secret; the members' folders in it are copied to them.
    #[arg(long, global = true, default_value = "pki")]
    pub pki: PathBuf,
    /// Format of the result.
    #[arg(long, global = true, value_enum, default_value_t = Format::Text)]
    pub format: Format,
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Clone, Subcommand)]
enum What {
    /// Makes the authority of a team, once.
    Authority {
        /// The team's name, as in every configuration.
        #[arg(long)]
        team: TeamId,
    },
    /// A certificate for a robot.
    Robot(Request),
    /// A certificate for a leader.
    Leader(Request),
    /// A certificate for an operator: `query`, `doctor`, tools that only read and ask.
    Operator(Request),
    /// A certificate and a configuration for a zenohd.
    Router(Request),
    /// Takes a member's certificates out of the rules. Then copy team.toml to every leader and restart them one by one,
    /// stand-by leaders first.
    Revoke {
        /// What it is.
        #[arg(value_enum)]
        role: RoleWord,
        /// Its name.
        name: MemberId,
        /// Only those before the newest, after --rotate.
        #[arg(long)]
        older: bool,
    },
    /// Who is in the team.
    List,
}

#[derive(Debug, Clone, Args)]
struct Request {
    /// Its name, as `id` in its configuration.
    name: MemberId,
    /// A name or address under which a leader or router is reached; may be given again. localhost always is.
    #[arg(long)]
    host: Vec<String>,
    /// Days until it expires.
    #[arg(long, default_value_t = 365, value_parser = clap::value_parser!(u32).range(1..=3650))]
    days: u32,
    /// Another certificate of the same name, before the old one expires: no rule changes.
    #[arg(long, conflicts_with = "rotate")]
    renew: bool,
    /// A certificate of a new name; both are accepted until `revoke --older`.
    #[arg(long)]
    rotate: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum RoleWord {
    Robot,
    Leader,
    Operator,
    Router,
}

/// Does it; the exit code: 0 done, 1 a file, 2 a wrong request.
pub fn run(args: &ProvisionArgs) -> u8 {
    match provision(args) {
        Ok((text, json)) => super::output(0, |out| match args.format {
            Format::Text => writeln!(out, "{text}"),
            Format::Json => writeln!(out, "{json}"),
        }),
        Err(error @ (ProvisionError::File { .. } | ProvisionError::Certificate(_))) => {
            super::failure(&error, args.format)
        }
        Err(error) => super::usage_error(&error, args.format),
    }
}

fn provision(args: &ProvisionArgs) -> Result<(String, serde_json::Value), ProvisionError> {
    let pki = &args.pki;
    Ok(match &args.what {
        What::Authority { team } => {
            Pki::create(pki, *team, preflight::now())?;
            let text = format!("{}: the authority of team {team}; keep authority.key secret", pki.display());
            (text, serde_json::json!({ "ok": true, "team": team, "pki": pki }))
        }
        What::Robot(request) => issue(args, Role::Robot, request)?,
        What::Leader(request) => issue(args, Role::Leader, request)?,
        What::Operator(request) => issue(args, Role::Operator, request)?,
        What::Router(request) => issue(args, Role::Router, request)?,
        What::Revoke { role, name, older } => {
            let gone = Pki::open(pki)?.revoke((*role).into(), *name, *older)?;
            let text = format!(
                "{} {name}: {} certificate(s) revoked. Copy {} to every leader (and router.json5 to every zenohd) and restart \
                 them one by one, stand-by leaders first",
                Role::from(*role),
                gone.len(),
                pki.join("team.toml").display()
            );
            (text, serde_json::json!({ "ok": true, "name": name, "revoked": gone }))
        }
        What::List => list(&Pki::open(pki)?),
    })
}

fn issue(args: &ProvisionArgs, role: Role, request: &Request) -> Result<(String, serde_json::Value), ProvisionError> {
    let what = match (request.renew, request.rotate) {
        (true, _) => Issue::Renewed,
        (_, true) => Issue::Rotated,
        _ => Issue::First,
    };
    let mut pki = Pki::open(&args.pki)?;
    let valid = DAY * request.days;
    let folder = pki.issue(role, request.name, what, &request.host, (preflight::now(), valid))?;
    let next = match what {
        Issue::Renewed => "",
        _ => {
            "\nThen copy team.toml to every leader and restart them one by one, stand-by leaders first: they know nobody new before."
        }
    };
    let text = format!(
        "{}: copy this folder to {role} {} and name it in [security] folder{next}",
        folder.display(),
        request.name
    );
    Ok((text, serde_json::json!({ "ok": true, "role": role.to_string(), "name": request.name, "folder": folder })))
}

fn list(pki: &Pki) -> (String, serde_json::Value) {
    let mut lines = vec![format!("team {}", pki.roster().team)];
    let mut rows = Vec::new();
    for role in Role::ALL {
        for (name, entry) in pki.roster().of(role) {
            lines.push(format!("  {role:<8} {name:<16} {}", generations(entry)));
            rows.push(serde_json::json!({
                "role": role.to_string(), "name": name, "issued": entry.issued, "accepted": entry.accepted,
            }));
        }
    }
    (lines.join("\n"), serde_json::json!({ "ok": true, "team": pki.roster().team, "members": rows }))
}

impl From<RoleWord> for Role {
    fn from(word: RoleWord) -> Self {
        match word {
            RoleWord::Robot => Self::Robot,
            RoleWord::Leader => Self::Leader,
            RoleWord::Operator => Self::Operator,
            RoleWord::Router => Self::Router,
        }
    }
}
