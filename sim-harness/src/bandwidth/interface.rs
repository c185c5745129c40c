//! What the interface itself counts: a network namespace with nothing in it but a team, and its loopback interface.

use std::fs;
use std::process::Command;

use serde::Serialize;

const LOOPBACK: &str = "lo";

/// Bytes and packets that have passed an interface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Counters {
    bytes: u64,
    packets: u64,
}

/// What passed the interface in a run: all sessions, both directions, with all headers and acknowledgements.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct InterfaceRate {
    /// Its name.
    pub interface: String,
    /// Bytes a second.
    pub bytes_per_s: f64,
    /// Packets a second.
    pub packets_per_s: f64,
    /// Bytes a second for each robot, the leader's to it and those of whoever listens to the map included.
    pub bytes_per_s_a_robot: f64,
}

/// This program once more with these arguments, in a network namespace of its own. Gives its exit code.
///
/// # Errors
/// No `unshare`, or namespaces are refused here: said in words.
pub fn in_namespace(arguments: impl IntoIterator<Item = std::ffi::OsString>) -> Result<u8, String> {
    let own = std::env::current_exe().map_err(|error| format!("this program's file: {error}"))?;
    let status = Command::new("unshare")
        .args(["--map-root-user", "--net"])
        .arg(own)
        .args(arguments)
        .status()
        .map_err(|error| format!("unshare: {error}; interfaces are counted on Linux with util-linux only"))?;
    status.code().and_then(|code| u8::try_from(code).ok()).ok_or_else(|| format!("unshare: {status}"))
}

impl Counters {
    /// Sets the namespace's loopback interface up and reads it.
    ///
    /// # Errors
    /// No `ip`, or this is no namespace of one's own; no counters.
    pub fn begin() -> Result<Self, String> {
        let up = Command::new("ip").args(["link", "set", LOOPBACK, "up"]).status();
        match up {
            Ok(status) if status.success() => Self::read(),
            Ok(status) => Err(format!("ip link set {LOOPBACK} up: {status}")),
            Err(error) => Err(format!("ip: {error}; interfaces are counted with iproute2 only")),
        }
    }

    /// What has passed by now.
    ///
    /// # Errors
    /// No counters.
    pub fn read() -> Result<Self, String> {
        let file = "/proc/self/net/dev";
        let text = fs::read_to_string(file).map_err(|error| format!("{file}: {error}"))?;
        Self::parse(&text).ok_or_else(|| format!("{file}: no line of {LOOPBACK}"))
    }

    /// From `/proc/net/dev`: what was sent, which on a loopback interface is what was received.
    fn parse(text: &str) -> Option<Self> {
        let line = text.lines().find_map(|line| line.trim_start().strip_prefix(LOOPBACK)?.strip_prefix(':'))?;
        let mut numbers = line.split_ascii_whitespace().skip(8).map(|n| n.parse().ok());
        Some(Self { bytes: numbers.next()??, packets: numbers.next()?? })
    }

    /// What has passed since, in so many seconds, for so many robots.
    pub fn rate(&self, now: &Self, seconds: f64, robots: usize) -> InterfaceRate {
        let per_s = |from: u64, to: u64| to.saturating_sub(from) as f64 / seconds.max(1e-9);
        let bytes_per_s = per_s(self.bytes, now.bytes);
        InterfaceRate {
            interface: LOOPBACK.to_owned(),
            bytes_per_s,
            packets_per_s: per_s(self.packets, now.packets),
            bytes_per_s_a_robot: bytes_per_s / robots.max(1) as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_sent_stands_in_the_ninth_and_tenth_column() {
        let text = "Inter-|   Receive  |  Transmit\n face |bytes packets errs drop fifo frame compressed multicast|bytes packets\n\
                    \u{20}eth0: 1 2 0 0 0 0 0 0 3 4 0 0 0 0 0 0\n    lo: 900 9 0 0 0 0 0 0 1500 12 0 0 0 0 0 0\n";
        let counters = Counters::parse(text).unwrap();
        assert_eq!(counters, Counters { bytes: 1500, packets: 12 });
        assert_eq!(Counters::parse("nothing"), None);
        let rate = counters.rate(&Counters { bytes: 4500, packets: 42 }, 10.0, 3);
        assert_eq!((rate.bytes_per_s, rate.packets_per_s, rate.bytes_per_s_a_robot), (300.0, 3.0, 100.0));
    }
}
