//! The names of a team and which certificates of each are accepted.
//!
//! A certificate's common name is `{team}.{role}.{name}.{generation}`. A renewed certificate keeps its name, so no rule changes. A
//! lost or stolen one is revoked by its name: the name leaves the roster, no rule allows it anything, and the next certificate
//! of that member has the next generation, so that the old one never comes back.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::document::{Document, DocumentError};
use crate::id::{MemberId, TeamId};

/// Most members of one role.
pub const MAX_MEMBERS: usize = 1024;

/// What a member is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// Publishes under its own name, reads who its fellows are.
    Robot,
    /// Routes, hears everything, publishes the map.
    Leader,
    /// Reads everything, asks, gives commands; publishes nothing.
    Operator,
    /// A zenohd: routes.
    Router,
}

impl Role {
    /// All.
    pub const ALL: [Self; 4] = [Self::Robot, Self::Leader, Self::Operator, Self::Router];
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Robot => "robot",
            Self::Leader => "leader",
            Self::Operator => "operator",
            Self::Router => "router",
        })
    }
}

/// `{team}.{role}.{name}.{generation}`.
pub fn common_name(team: TeamId, role: Role, name: &str, generation: u32) -> String {
    format!("{team}.{role}.{name}.{generation}")
}

/// By what a router knows who is connected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Names {
    /// The common name of its certificate.
    Certificates,
    /// Its user name, `{role}.{name}`.
    Users,
}

/// `team.toml`: who is in the team.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Roster {
    /// The team.
    pub team: TeamId,
    /// Robots by name.
    #[serde(default)]
    pub robot: BTreeMap<MemberId, Entry>,
    /// Leaders by name.
    #[serde(default)]
    pub leader: BTreeMap<MemberId, Entry>,
    /// Operators by name.
    #[serde(default)]
    pub operator: BTreeMap<MemberId, Entry>,
    /// Routers by name.
    #[serde(default)]
    pub router: BTreeMap<MemberId, Entry>,
}

/// The certificates of one member.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// The highest generation ever issued.
    pub issued: u32,
    /// Generations that are accepted. None: revoked.
    pub accepted: BTreeSet<u32>,
}

impl Roster {
    /// A team of nobody.
    pub fn new(team: TeamId) -> Self {
        let none = BTreeMap::new;
        Self { team, robot: none(), leader: none(), operator: none(), router: none() }
    }

    /// Reads `team.toml`.
    ///
    /// # Errors
    /// No such file, not a roster, or more than [`MAX_MEMBERS`] of one role.
    pub fn read(path: &Path) -> Result<Self, DocumentError> {
        let document = Document::read(path)?;
        let roster: Self = document.parse()?;
        for role in Role::ALL {
            let count = roster.of(role).len();
            if count > MAX_MEMBERS {
                return Err(document.invalid(&role.to_string(), count, format!("at most {MAX_MEMBERS} of a kind")));
            }
        }
        Ok(roster)
    }

    /// Who stands in a file of `user:password` lines, a user being `robot.r1`.
    ///
    /// # Errors
    /// No such file, or a line that is none.
    pub fn of_passwords(team: TeamId, path: &Path) -> Result<Self, DocumentError> {
        let unreadable = |source| DocumentError::Unreadable { path: path.to_owned(), source };
        let text = std::fs::read_to_string(path).map_err(unreadable)?;
        let mut roster = Self::new(team);
        for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let malformed = |reason: String| DocumentError::Malformed {
                path: path.to_owned(),
                line: index + 1,
                column: 1,
                reason,
                // Never a password.
                text: line.split(':').next().unwrap_or_default().to_owned(),
            };
            let user = line.split_once(':').map(|(user, _)| user);
            let member = user.and_then(|user| user.split_once('.'));
            let role = member.and_then(|(role, _)| Role::ALL.into_iter().find(|r| r.to_string() == role));
            let (Some((_, name)), Some(role)) = (member, role) else {
                return Err(malformed(
                    "a line is user:password, a user robot.NAME, leader.NAME or operator.NAME".to_owned(),
                ));
            };
            let name = MemberId::new(name).map_err(|error| malformed(error.to_string()))?;
            if roster.of(role).len() < MAX_MEMBERS {
                roster.of_mut(role).insert(name, Entry { issued: 1, accepted: BTreeSet::from([1]) });
            }
        }
        Ok(roster)
    }

    /// The members of a role.
    pub fn of(&self, role: Role) -> &BTreeMap<MemberId, Entry> {
        match role {
            Role::Robot => &self.robot,
            Role::Leader => &self.leader,
            Role::Operator => &self.operator,
            Role::Router => &self.router,
        }
    }

    /// The members of a role, to change.
    pub fn of_mut(&mut self, role: Role) -> &mut BTreeMap<MemberId, Entry> {
        match role {
            Role::Robot => &mut self.robot,
            Role::Leader => &mut self.leader,
            Role::Operator => &mut self.operator,
            Role::Router => &mut self.router,
        }
    }

    /// The role and name of an accepted common name.
    pub fn accepts(&self, common_name: &str) -> bool {
        Role::ALL.into_iter().any(|role| {
            self.of(role).iter().any(|(name, entry)| {
                entry.accepted.iter().any(|g| self::common_name(self.team, role, name.as_str(), *g) == common_name)
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_roster_is_written_and_read_back_and_a_revoked_name_is_not_accepted() {
        let mut roster = Roster::new(TeamId::new("blue").unwrap());
        let r1 = MemberId::new("r1").unwrap();
        roster.robot.insert(r1, Entry { issued: 2, accepted: BTreeSet::from([2]) });
        roster.leader.insert(MemberId::new("l1").unwrap(), Entry { issued: 1, accepted: BTreeSet::new() });
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("team.toml");
        std::fs::write(&path, toml::to_string(&roster).unwrap()).unwrap();
        assert_eq!(Roster::read(&path).unwrap(), roster);
        assert!(roster.accepts("blue.robot.r1.2"));
        for refused in ["blue.robot.r1.1", "blue.robot.r1.3", "blue.leader.l1.1", "red.robot.r1.2", "blue.leader.r1.2"]
        {
            assert!(!roster.accepts(refused), "{refused}");
        }
    }

    #[test]
    fn a_wrong_line_of_the_passwords_is_named_without_its_password() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("passwords");
        std::fs::write(&path, "robot.r1:secret\nr2:geheim\n").unwrap();
        let error = Roster::of_passwords(TeamId::new("blue").unwrap(), &path).unwrap_err().to_string();
        assert!(error.contains("passwords:2") && error.contains("robot.NAME") && !error.contains("geheim"), "{error}");
    }
}
