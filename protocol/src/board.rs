//! What a process shows to its keepers: figures for Prometheus, a pulse for systemd. The service's shell writes it in passing; whoever
//! is asked reads it. Nothing waits for anybody.

pub mod figures;
pub mod metrics;
pub mod systemd;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::id::RobotId;
use crate::message::map::MAX_ROBOTS;
use crate::message::{Health, MapStatus, Presence, TeamMap};
use crate::transport::Transport;

/// Shared by a service and its keepers. Cheap to clone.
#[derive(Debug, Clone, Default)]
pub struct Board {
    pulse: Arc<AtomicU64>,
    state: Arc<Mutex<State>>,
}

#[derive(Debug, Default)]
struct State {
    transport: Option<Transport>,
    healths: BTreeMap<RobotId, Health>,
    map: Option<MapFigures>,
}

/// What is shown of the last map.
#[derive(Debug, Clone, PartialEq)]
pub struct MapFigures {
    /// Who leads.
    pub leader: String,
    /// Its term.
    pub term: u64,
    /// Whether the team is calibrated.
    pub converged: bool,
    /// Moving objects.
    pub targets: usize,
    /// Age of the oldest contribution, seconds.
    pub oldest_contribution_s: f64,
    /// Its robots.
    pub robots: Vec<RobotFigures>,
}

/// What is shown of a robot in the map.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RobotFigures {
    /// Who.
    pub id: RobotId,
    /// Whether it is there.
    pub presence: Presence,
    /// Whether its pose is known.
    pub placed: bool,
    /// Its clock's offset to the leader's with its sigma, seconds.
    pub clock_offset_s: Option<(f32, f32)>,
}

/// Serves the figures where they are wanted and feeds systemd's watchdog, for ever: runs beside a service.
///
/// # Errors
/// The address of the figures is taken or not this host's. Without one it never returns.
pub async fn keep(board: Board, metrics: Option<std::net::SocketAddr>) -> std::io::Result<std::convert::Infallible> {
    match metrics {
        Some(listen) => {
            let listener = metrics::bind(listen).await?;
            tracing::info!("figures on http://{listen}/metrics");
            tokio::select! {
                never = metrics::serve(listener, board.clone()) => Ok(never),
                never = systemd::watch(board) => Ok(never),
            }
        }
        None => Ok(systemd::watch(board).await),
    }
}

impl Board {
    /// The service works: called in its loop, at least every two seconds.
    pub fn beat(&self) {
        self.pulse.fetch_add(1, Ordering::Relaxed);
    }

    /// How often [`Board::beat`] was called.
    pub fn pulse(&self) -> u64 {
        self.pulse.load(Ordering::Relaxed)
    }

    /// The session whose traffic is shown.
    pub fn connected(&self, transport: &Transport) {
        self.lock().transport = Some(transport.clone());
    }

    /// A robot's report: its own on an agent, everybody's on a leader. At most [`MAX_ROBOTS`] are kept.
    pub fn health(&self, health: &Health) {
        let mut state = self.lock();
        if state.healths.len() < MAX_ROBOTS || state.healths.contains_key(&health.robot) {
            state.healths.insert(health.robot, health.clone());
        }
    }

    /// The map that was published.
    pub fn map(&self, map: &TeamMap) {
        let robot = |robot: &crate::message::MapRobot| RobotFigures {
            id: robot.id,
            presence: robot.presence,
            placed: robot.team_from_body.is_some(),
            clock_offset_s: robot.clock_offset_s,
        };
        let figures = MapFigures {
            leader: map.leader.to_string(),
            term: map.term,
            converged: map.status == MapStatus::Converged,
            targets: map.targets.len(),
            oldest_contribution_s: f64::from(map.oldest_contribution_s),
            robots: map.robots.iter().map(robot).collect(),
        };
        self.lock().map = Some(figures);
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // Figures stay meaningful whatever happened to the thread that held them.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
