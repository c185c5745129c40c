//! Everything that travels between agents, leaders and operators. One file a message, with its limits and its check;
//! [`crate::codec`] wraps them in a versioned envelope with a byte limit per kind.

pub mod alarm;
pub mod announcement;
pub mod candidacy;
pub mod clock;
pub mod command;
pub mod edges;
pub mod guidance;
pub mod health;
pub mod map;
pub mod observation;
pub mod picture;
pub mod recent;
pub mod replay;
#[cfg(test)]
pub(crate) mod samples;
pub mod surroundings;

pub use alarm::{Alarm, AlarmKind};
pub use announcement::{Announcement, CameraSummary};
pub use candidacy::Candidacy;
pub use clock::{ClockProbe, ClockReply};
pub use command::{Command, CommandReply};
pub use edges::{Edges, UprightEdge};
pub use guidance::Guidance;
pub use health::{Health, KindTraffic};
pub use map::{MapRobot, MapStatus, MapTarget, Presence, TeamMap, Trouble, Trust};
pub use observation::{
    ElevationEnd, Feature, Motion, ObjectClass, Observation, Odometry, PeerSighting, SightedRange, Stages,
    TrackObservation, TrackState,
};
pub use picture::PictureKind;
pub use recent::Recent;
pub use replay::ReplayStart;
pub use surroundings::{Neighbour, Surroundings};
