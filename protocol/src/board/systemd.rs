//! systemd: says when the service is ready, and feeds its watchdog while the service's loop turns. Without systemd it does nothing.

use std::convert::Infallible;
use std::time::Duration;

use sd_notify::NotifyState;

use super::Board;

/// Says that the service is ready.
pub fn ready(status: &str) {
    tell(&[NotifyState::Ready, NotifyState::Status(status)]);
}

/// Says that the service stops because it was asked to.
pub fn stopping() {
    tell(&[NotifyState::Stopping]);
}

/// Feeds the watchdog, as often as systemd wants (`WatchdogSec`), while the board's pulse goes on; for ever. A service that is alive
/// but works no more is not fed, and systemd starts it anew.
pub async fn watch(board: Board) -> Infallible {
    let mut limit_us = 0;
    if !sd_notify::watchdog_enabled(false, &mut limit_us) || limit_us == 0 {
        return std::future::pending().await;
    }
    let mut feeder = Feeder::default();
    loop {
        if feeder.is_due(board.pulse()) {
            tell(&[NotifyState::Watchdog]);
        }
        tokio::time::sleep(Duration::from_micros(limit_us) / 3).await;
    }
}

#[derive(Debug, Default)]
struct Feeder {
    seen: Option<u64>,
}

impl Feeder {
    /// Whether the pulse has gone on since the last look.
    fn is_due(&mut self, pulse: u64) -> bool {
        self.seen.replace(pulse) != Some(pulse)
    }
}

fn tell(state: &[NotifyState]) {
    if let Err(error) = sd_notify::notify(false, state) {
        tracing::warn!("systemd cannot be told: {error}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_service_that_works_no_more_is_not_fed() {
        let (board, mut feeder) = (Board::default(), Feeder::default());
        assert!(feeder.is_due(board.pulse()), "a service that has just begun");
        board.beat();
        assert!(feeder.is_due(board.pulse()));
        assert!(!feeder.is_due(board.pulse()), "nothing has turned since");
        board.beat();
        assert!(feeder.is_due(board.pulse()));
    }
}
