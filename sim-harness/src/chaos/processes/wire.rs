//! The wire between the hosts: Ethernet frames from each host's TAP device to the others', lost and delayed on the way.
//!
//! It does what `tc netem` does, but with seeded draws, and also under kernels that have no netem.

use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha12Rng;
use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use tokio::task::JoinSet;
use tun_rs::{AsyncDevice, DeviceBuilder, Layer};

use super::{SEED, failed};
use crate::team::TeamError;

/// Largest frame: Ethernet's, with some room.
const MAX_FRAME_BYTES: usize = 2048;
/// Most frames on their way at a time; more are lost, as in any queue.
const MAX_ON_THE_WAY: usize = 10_000;
/// Hosts' hardware addresses begin with this (locally administered); the port's number follows.
const ADDRESS: [u8; 5] = [0x02, 0x70, 0x61, 0x6c, 0x00];

/// What happens to frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weather {
    /// Share of frames lost, 0 … 1.
    pub loss: f64,
    /// Mean and half width (uniform) of the delay, seconds, of frames from or to the ports from `delayed_from` on. As with
    /// netem, frames may overtake each other.
    pub delay_s: [f64; 2],
    /// The first port whose frames are delayed.
    pub delayed_from: usize,
}

impl Weather {
    /// Nothing is lost, nothing waits.
    pub const FINE: Self = Self { loss: 0.0, delay_s: [0.0; 2], delayed_from: 0 };
}

/// All ports, and the tasks that move frames between them; they end with this value.
#[derive(Debug)]
pub struct Wire {
    weather: Arc<Mutex<Weather>>,
    _tasks: JoinSet<()>,
}

impl Wire {
    /// Makes a TAP device of each name, in order of the ports.
    ///
    /// # Errors
    /// The system refuses.
    pub fn make(runtime: &Handle, devices: &[String]) -> Result<Self, TeamError> {
        let _inside = runtime.enter();
        let make = |name: &String| DeviceBuilder::new().name(name).layer(Layer::L2).enable(false).build_async();
        let ports: Vec<Arc<AsyncDevice>> =
            devices.iter().map(|name| make(name).map(Arc::new)).collect::<Result<_, _>>().map_err(failed)?;
        let weather = Arc::new(Mutex::new(Weather::FINE));
        let on_the_way = Arc::new(Semaphore::new(MAX_ON_THE_WAY));
        let mut tasks = JoinSet::new();
        for port in 0..ports.len() {
            tasks.spawn_on(carry(port, ports.clone(), weather.clone(), on_the_way.clone()), runtime);
        }
        Ok(Self { weather, _tasks: tasks })
    }

    /// The hardware address of a port's host, as `ip link set … address` takes it.
    pub fn address(port: usize) -> String {
        ADDRESS.iter().map(|byte| format!("{byte:02x}:")).collect::<String>() + &format!("{port:02x}")
    }

    /// From now on.
    pub fn set(&self, weather: Weather) {
        *self.weather.lock().unwrap_or_else(PoisonError::into_inner) = weather;
    }
}

/// Takes the frames of one port where they are addressed.
async fn carry(from: usize, ports: Vec<Arc<AsyncDevice>>, weather: Arc<Mutex<Weather>>, on_the_way: Arc<Semaphore>) {
    let mut draws = ChaCha12Rng::seed_from_u64(SEED ^ ((from as u64) << 32));
    let mut frame = vec![0; MAX_FRAME_BYTES];
    let mut late = JoinSet::new();
    // The device ends with its host.
    while let Ok(length) = ports[from].recv(&mut frame).await {
        let now = *weather.lock().unwrap_or_else(PoisonError::into_inner);
        for to in addressees(from, &frame[..length], ports.len()) {
            if draws.random::<f64>() < now.loss {
                continue;
            }
            let delayed = now.delay_s[0] > 0.0 && from.max(to) >= now.delayed_from;
            if !delayed {
                // A host whose link is down takes nothing.
                let _ = ports[to].send(&frame[..length]).await;
                continue;
            }
            let Ok(place) = on_the_way.clone().try_acquire_owned() else { continue };
            let delay_s = (now.delay_s[0] + now.delay_s[1] * (2.0 * draws.random::<f64>() - 1.0)).max(0.0);
            let (port, copy) = (ports[to].clone(), frame[..length].to_vec());
            late.spawn(async move {
                tokio::time::sleep(Duration::from_secs_f64(delay_s)).await;
                let _ = port.send(&copy).await;
                drop(place);
            });
            while late.try_join_next().is_some() {}
        }
    }
}

/// The port whose address the frame bears, or, as it is a broadcast, all others.
fn addressees(from: usize, frame: &[u8], ports: usize) -> impl Iterator<Item = usize> {
    let to = frame.strip_prefix(&ADDRESS).and_then(|rest| rest.first()).map(|port| usize::from(*port));
    (0..ports).filter(move |port| *port != from && to.is_none_or(|to| to == *port))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_goes_where_it_is_addressed_and_a_broadcast_to_all_others() {
        let to_two = [&ADDRESS[..], &[2, 9, 9]].concat();
        assert_eq!(addressees(0, &to_two, 4).collect::<Vec<_>>(), [2]);
        assert_eq!(addressees(2, &to_two, 4).count(), 0);
        assert_eq!(addressees(1, &[0xff; 14], 4).collect::<Vec<_>>(), [0, 2, 3]);
        assert_eq!(addressees(1, &[], 4).count(), 3);
        assert_eq!(Wire::address(11), "02:70:61:6c:00:0b");
    }
}
