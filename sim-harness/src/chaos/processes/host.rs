//! Hosts: network namespaces on one wire, and processes in them.

use std::io::Write;
use std::process::{Child, Command, Stdio};

use tokio::runtime::Handle;

use super::failed;
use super::wire::{Weather, Wire};
use crate::team::TeamError;

/// How the names of namespaces and of devices begin.
const NAME: &str = "palchaos";
/// Addresses are 10.77.13.1 and up; this process has .254.
const NET: &str = "10.77.13";

/// Namespaces, one a host; they go with this value.
#[derive(Debug)]
pub struct Hosts {
    names: Vec<String>,
    wire: Option<Wire>,
}

impl Hosts {
    /// Makes them; the wire's frames are moved by tasks of `runtime`.
    ///
    /// # Errors
    /// It is not allowed, or `ip` is not there.
    pub fn make(names: &[String], runtime: &Handle) -> Result<Self, TeamError> {
        let mut hosts = Self { names: names.to_vec(), wire: None };
        hosts.remove();
        let own = names.len();
        let devices: Vec<String> = (0..=own).map(|port| format!("{NAME}{port}")).collect();
        hosts.wire = Some(Wire::make(runtime, &devices).map_err(|error| {
            failed(format!("not run: network namespaces and TAP devices need Linux, root and /dev/net/tun: {error}"))
        })?);
        for (port, device) in devices.iter().enumerate() {
            ip(&["link", "set", device, "address", &Wire::address(port)])?;
        }
        ip(&["addr", "add", &format!("{NET}.254/24"), "dev", &devices[own]])?;
        ip(&["link", "set", &devices[own], "up"])?;
        for (host, device) in devices.iter().enumerate().take(own) {
            let space = hosts.space(host);
            ip(&["netns", "add", &space])?;
            ip(&["link", "set", device, "netns", &space, "name", "eth0"])?;
            ip(&["-n", &space, "addr", "add", &format!("{}/24", hosts.address(host)), "dev", "eth0"])?;
            ip(&["-n", &space, "link", "set", "lo", "up"])?;
            ip(&["-n", &space, "link", "set", "eth0", "up"])?;
        }
        Ok(hosts)
    }

    /// A host's address.
    pub fn address(&self, host: usize) -> String {
        format!("{NET}.{}", host + 1)
    }

    /// Starts this program there, as one of the team.
    ///
    /// # Errors
    /// It does not start.
    pub fn start(&self, host: usize, args: &[&str]) -> Result<Process, TeamError> {
        let own = std::env::current_exe().map_err(failed)?;
        // `ip` replaces itself by the program, so signals reach it.
        let words = std::env::var("RUST_LOG").unwrap_or_else(|_| "error,zenoh=off,team_leader=off".to_owned());
        let child = Command::new("ip")
            .env("RUST_LOG", words)
            .args(["netns", "exec", &self.space(host)])
            .arg(own)
            .arg("chaos")
            .args(args)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .spawn();
        Ok(Process { child: child.map_err(failed)? })
    }

    /// Its link: "up" or "down".
    ///
    /// # Errors
    /// The system refuses.
    pub fn link(&self, host: usize, state: &str) -> Result<(), TeamError> {
        ip(&["-n", &self.space(host), "link", "set", "eth0", state])
    }

    /// What happens to everybody's frames from now on.
    pub fn weather(&self, weather: Weather) {
        if let Some(wire) = &self.wire {
            wire.set(weather);
        }
    }

    fn space(&self, host: usize) -> String {
        format!("{NAME}-{}", self.names[host])
    }

    /// Also what an earlier run has left; devices go with their namespace and with the wire.
    fn remove(&self) {
        for host in 0..self.names.len() {
            // What is not there needs no removing.
            let _ = ip(&["netns", "del", &self.space(host)]);
        }
    }
}

impl Drop for Hosts {
    fn drop(&mut self) {
        self.remove();
    }
}

/// A process; it is killed with this value.
#[derive(Debug)]
pub struct Process {
    child: Child,
}

impl Process {
    /// Sends a signal: KILL, STOP, CONT.
    ///
    /// # Errors
    /// There is no such process.
    pub fn signal(&self, signal: &str) -> Result<(), TeamError> {
        called("kill", &[&format!("-{signal}"), &self.child.id().to_string()])
    }

    /// Writes a line to its input.
    ///
    /// # Errors
    /// It has ended.
    pub fn say(&mut self, line: &str) -> Result<(), TeamError> {
        let Some(input) = self.child.stdin.as_mut() else { return Err(failed("a process without input")) };
        writeln!(input, "{line}").and_then(|()| input.flush()).map_err(failed)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended already.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn ip(args: &[&str]) -> Result<(), TeamError> {
    called("ip", args)
}

fn called(program: &str, args: &[&str]) -> Result<(), TeamError> {
    let words = || format!("{program} {}", args.join(" "));
    let output = Command::new(program).args(args).output().map_err(|error| failed(format!("{}: {error}", words())))?;
    if output.status.success() {
        return Ok(());
    }
    Err(failed(format!("{}: {}", words(), String::from_utf8_lossy(&output.stderr).trim())))
}
