//! The leader over Zenoh: translates what comes in, stamps and sends what the [`Leader`] says, drains.
//!
//! ```text
//! announcements ┐                                        ┌▶ map, map/json, guidance
//! observations  │    ┌───────────────┐   Output          ├▶ clock probes ─▶ replies come back as inputs
//! alarms        ├───▶│ Leader (pure) │──────────────────▶┤
//! health        │    └───────────────┘                   └▶ notices in the log
//! presence      ┘          ▲ deadline
//! ```
//! Any number of leaders stand by, hearing and computing what the first one does; which one leads is the core's to say. Only
//! that one declares the map's publishers and answers for the team.
//!
//! **A session of its own, again.** Zenoh's routers (1.10.2) may add a link that the other side has just opened to a session that
//! the other side gave up long ago (after a freeze, or a short loss of the link): the link lives, and nothing that needs a
//! declaration passes it any more (zenoh#1886). Both leaders dial each other, so a thawed leader meets it every other time. So
//! who was given up, or hears another leader's token and never its word, closes its session and opens another
//! ([`Output::Renew`](crate::leader::Output::Renew)).
//!
//! One task does all of it, so nothing is locked. Inputs wait in bounded rings and carry the time of their arrival, stamped
//! before they waited. Questions (the map, when recordings begin) are answered from the last state.

mod desk;
mod heartbeat;
mod inbox;
mod probes;
mod replay;
mod state;
mod word;

use std::future::Future;
use std::time::Duration;

use protocol::host_clock::Clock;
use protocol::id::{LeaderId, TeamId};
use protocol::meter::Row;
use protocol::transport::{Options, Transport, TransportError, WireBytes};

use crate::config::Replay;
use crate::leader::{Input, Leader};
use crate::team_map::json::EdgeJson;
use desk::Desk;
use inbox::Inbox;
pub use state::{StateDir, StateError};

/// A leader that nobody has joined for so long says so, by default.
pub const NOBODY_AFTER: Duration = Duration::from_secs(10);
/// How often it is looked whether anybody listens to the map as JSON.
const LISTENERS_PERIOD: Duration = Duration::from_millis(200);
/// Longest sleep between two looks at the leader's deadline: it follows the wall clock, which may be set.
const LONGEST_IDLE: Duration = Duration::from_millis(500);

/// What a service needs.
#[derive(Debug)]
pub struct Setup {
    /// The pure leader.
    pub leader: Leader,
    /// Its name.
    pub id: LeaderId,
    /// Its team.
    pub team: TeamId,
    /// Its clock.
    pub clock: Clock,
    /// How to open the session; `clock` of the options is set from this one's.
    pub session: Options,
    /// When recordings begin, if robots replay some.
    pub replay: Option<Replay>,
    /// Whether the map is also published as JSON while somebody listens.
    pub json: bool,
    /// Where what must outlive the program is kept.
    pub state: Option<StateDir>,
    /// A leader that nobody has joined for so long says so; [`NOBODY_AFTER`] suits people.
    pub nobody_after: Duration,
}

/// What a service did.
#[derive(Debug, Clone)]
pub struct Summary {
    /// Observations heard.
    pub observations: u64,
    /// Maps published.
    pub maps: u64,
    /// What stands still, in the last map.
    pub edges: Vec<EdgeJson>,
    /// From the arrival of an observation to its map on the wire, milliseconds: median, 99th percentile, worst.
    pub map_latency_ms: [f32; 3],
    /// Messages dropped because the leader was too slow.
    pub dropped: u64,
    /// Messages that could not be read.
    pub refused: u64,
    /// Traffic by robot and kind.
    pub traffic: Vec<Row>,
    /// Bytes on the links, where [`Options::measure`] was set.
    pub wire: Option<WireBytes>,
    /// What people were told.
    pub notices: Vec<String>,
}

/// A leader's session, open but not yet at work.
#[derive(Debug)]
pub struct Service {
    transport: Transport,
    locators: Vec<String>,
    nobody_after: Duration,
    inbox: Inbox,
    desk: Desk,
}

impl Service {
    /// Opens the session and declares everything.
    ///
    /// # Errors
    /// A wrong or taken endpoint, a single-threaded runtime, a session that refuses.
    pub async fn open(mut setup: Setup) -> Result<Self, TransportError> {
        setup.session.clock = setup.clock;
        let transport = Transport::open(setup.session.clone()).await?;
        let locators = transport.locators().await;
        let nobody_after = setup.nobody_after;
        let inbox = Inbox::declare(&transport, setup.team).await?;
        let desk = Desk::declare(&transport, setup, locators.clone()).await?;
        Ok(Self { transport, locators, nobody_after, inbox, desk })
    }

    /// Where agents connect to, with the real port where 0 was asked for.
    pub fn locators(&self) -> &[String] {
        &self.locators
    }

    /// Leads until `shutdown` ends, then closes the session.
    ///
    /// # Errors
    /// The session did not close in time.
    pub async fn run(self, shutdown: impl Future<Output = ()>) -> Result<Summary, TransportError> {
        let Self { mut transport, nobody_after, mut inbox, mut desk, .. } = self;
        desk.wake();
        let mut shutdown = std::pin::pin!(shutdown);
        let mut nobody = std::pin::pin!(tokio::time::sleep(nobody_after));
        let mut nobody_waits = true;
        let board = transport.board().clone();
        let mut listeners = tokio::time::interval(LISTENERS_PERIOD);
        listeners.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        loop {
            board.beat();
            let patience = desk.patience();
            tokio::select! {
                () = &mut shutdown => break,
                Some(got) = inbox.observations.recv() => desk.observed(got),
                Some(got) = inbox.announcements.recv() => desk.announced(got),
                Some(got) = inbox.alarms.recv() => desk.alarmed(got),
                Some(got) = inbox.healths.recv() => desk.health(got),
                Some(got) = inbox.edges.recv() => desk.looked_round(got),
                Some(sign) = inbox.robots.recv() => desk.robot_sign(sign),
                Some(sign) = inbox.leaders.recv() => desk.leader_sign(sign),
                Some(told) = desk.probes.recv() => desk.told(told),
                Some(word) = inbox.candidacies.recv() => desk.handle(word.arrived, Input::Candidacy(word.message)),
                Some(map) = inbox.maps.recv() => desk.map_heard(map),
                Some(asked) = inbox::next(&mut inbox.map_asked) => desk.give_map(asked),
                Some(asked) = inbox::next(&mut inbox.json_asked) => desk.give_json(asked),
                Some(asked) = inbox::next(&mut inbox.start_asked) => desk.give_start(asked),
                () = tokio::time::sleep(patience) => desk.handle(desk.now(), Input::Deadline),
                _ = listeners.tick() => desk.look_for_listeners().await,
                () = &mut nobody, if nobody_waits => {
                    nobody_waits = false;
                    desk.say_if_nobody_came();
                }
            }
            if desk.renews() {
                transport = transport.reopen().await?;
                inbox = Inbox::declare(&transport, desk.team()).await?;
                desk.renew(&transport).await?;
            }
            desk.declare_word().await;
            if inbox.answers() != desk.reigns() {
                inbox.answer(&transport, desk.reigns()).await;
                desk.publish_or_not().await;
            }
        }
        let summary = desk.summary(transport.wire_bytes().await);
        drop((inbox, desk));
        transport.close().await?;
        Ok(summary)
    }
}
