//! The figures of a process in the OpenMetrics text format, collected when they are asked for.

use std::fmt;

use prometheus_client::collector::Collector;
use prometheus_client::encoding::{DescriptorEncoder, text};
use prometheus_client::metrics::MetricType;
use prometheus_client::registry::Registry;

use super::Board;
use crate::message::Presence;
use crate::meter::{Direction, Row, share_of_wire};
use crate::transport::WireBytes;

type Labels = Vec<(&'static str, String)>;

/// One family of figures.
#[derive(Debug)]
struct Family {
    name: &'static str,
    help: &'static str,
    is_counter: bool,
    samples: Vec<(Labels, f64)>,
}

#[derive(Debug)]
struct Collected(Vec<Family>);

impl Collector for Collected {
    fn encode(&self, mut encoder: DescriptorEncoder) -> Result<(), fmt::Error> {
        for family in &self.0 {
            let kind = if family.is_counter { MetricType::Counter } else { MetricType::Gauge };
            let mut metric = encoder.encode_descriptor(family.name, family.help, None, kind)?;
            for (labels, value) in &family.samples {
                match (labels.is_empty(), family.is_counter) {
                    (true, true) => metric.encode_counter::<Labels, f64, f64>(value, None)?,
                    (true, false) => metric.encode_gauge(value)?,
                    (false, true) => metric.encode_family(labels)?.encode_counter::<Labels, f64, f64>(value, None)?,
                    (false, false) => metric.encode_family(labels)?.encode_gauge(value)?,
                }
            }
        }
        Ok(())
    }
}

impl Board {
    /// All figures as text. Waits for nothing but the session's own counters.
    pub async fn text(&self) -> String {
        let transport = self.lock().transport.clone();
        let wire = match &transport {
            Some(transport) => transport.wire_bytes().await,
            None => None,
        };
        let mut families = Vec::new();
        if let Some(transport) = &transport {
            let meter = transport.meter();
            families.extend(traffic(&meter.rows(), wire));
            let lost = [("dropped", meter.dropped()), ("refused", meter.refused()), ("flooded", meter.flooded())];
            let why = lost.map(|(why, count)| (vec![("why", why.to_owned())], count as f64));
            families.push(counter(
                "pal_messages_lost",
                "Messages that were not used: queue full, unreadable, over the sender's pace",
                why,
            ));
        }
        families.extend(self.robots());
        families.extend(self.of_map());
        families.extend(process());
        families.push(counter("pal_pulse", "Turns of the service's loop", [(Vec::new(), self.pulse() as f64)]));
        families.retain(|family| !family.samples.is_empty());
        let mut registry = Registry::default();
        registry.register_collector(Box::new(Collected(families)));
        let mut out = String::new();
        // Writing to a string cannot fail; what was written so far would show a defect.
        let _ = text::encode(&mut out, &registry);
        out
    }

    fn robots(&self) -> Vec<Family> {
        let state = self.lock();
        let each = |value: &dyn Fn(&crate::message::Health) -> f64| -> Vec<(Labels, f64)> {
            state.healths.values().map(|h| (vec![("robot", h.robot.to_string())], value(h))).collect()
        };
        let mut families = vec![
            gauge("pal_robot_frame_rate_hertz", "Frames a second worked on", each(&|h| f64::from(h.frame_rate_hz))),
            gauge(
                "pal_robot_latency_median_seconds",
                "From capture to publication",
                each(&|h| 1e-3 * f64::from(h.latency_ms[0])),
            ),
            gauge(
                "pal_robot_latency_p99_seconds",
                "From capture to publication",
                each(&|h| 1e-3 * f64::from(h.latency_ms[1])),
            ),
            counter("pal_robot_frames", "Frames that came in", each(&|h| h.frames as f64)),
            counter(
                "pal_robot_frames_dropped",
                "Frames dropped because a newer one was there",
                each(&|h| h.frames_dropped as f64),
            ),
            counter("pal_robot_frames_bad", "Frames that could not be used", each(&|h| h.frames_bad as f64)),
            counter("pal_robot_stages_skipped", "Stages left out for lack of time", each(&|h| h.stages_skipped as f64)),
            counter("pal_robot_messages_dropped", "Messages the robot dropped", each(&|h| h.messages_dropped as f64)),
            counter(
                "pal_robot_messages_refused",
                "Messages the robot could not read",
                each(&|h| h.messages_refused as f64),
            ),
        ];
        let by_kind = state.healths.values().flat_map(|health| {
            health.traffic.iter().map(|traffic| {
                let kind = crate::codec::Kind::from_u8(traffic.kind).map_or("unknown", crate::codec::Kind::name);
                let labels = vec![("robot", health.robot.to_string()), ("kind", kind.to_owned())];
                (labels, traffic.payload_bytes as f64)
            })
        });
        families.push(counter("pal_robot_payload_sent_bytes", "Payload the robot says it sent", by_kind));
        families
    }

    fn of_map(&self) -> Vec<Family> {
        let state = self.lock();
        let Some(map) = &state.map else { return Vec::new() };
        let present = [("online", Presence::Online), ("silent", Presence::Silent), ("offline", Presence::Offline)];
        let count = |presence| map.robots.iter().filter(|robot| robot.presence == presence).count() as f64;
        let clock = |value: fn((f32, f32)) -> f32| -> Vec<(Labels, f64)> {
            let robots = map.robots.iter();
            robots
                .filter_map(|r| Some((vec![("robot", r.id.to_string())], f64::from(value(r.clock_offset_s?)))))
                .collect()
        };
        vec![
            gauge("pal_map_term", "Term of the leader", [(vec![("leader", map.leader.clone())], map.term as f64)]),
            gauge(
                "pal_map_converged",
                "1 while the team is calibrated",
                [(Vec::new(), f64::from(u8::from(map.converged)))],
            ),
            gauge("pal_map_targets", "Moving objects in the map", [(Vec::new(), map.targets as f64)]),
            gauge(
                "pal_map_oldest_contribution_seconds",
                "Age of the oldest contribution",
                [(Vec::new(), map.oldest_contribution_s)],
            ),
            gauge(
                "pal_map_robots",
                "Robots by presence",
                present.map(|(word, presence)| (vec![("presence", word.to_owned())], count(presence))),
            ),
            gauge(
                "pal_map_robots_placed",
                "Robots whose pose is known",
                [(Vec::new(), map.robots.iter().filter(|robot| robot.placed).count() as f64)],
            ),
            gauge("pal_robot_clock_offset_seconds", "Robot's clock minus the leader's", clock(|(offset, _)| offset)),
            gauge("pal_robot_clock_sigma_seconds", "One sigma of it", clock(|(_, sigma)| sigma)),
        ]
    }
}

/// Payload by robot, kind and direction; bytes on the wire by direction as Zenoh counts them, and by kind as they are shared out.
fn traffic(rows: &[Row], wire: Option<WireBytes>) -> Vec<Family> {
    let labels = |row: &Row| -> Labels {
        let direction = if row.direction == Direction::Sent { "sent" } else { "received" };
        let robot = row.robot.map(|robot| robot.to_string()).unwrap_or_default();
        vec![("robot", robot), ("kind", row.kind.name().to_owned()), ("direction", direction.to_owned())]
    };
    let sent = rows.iter().filter(|row| row.direction == Direction::Sent);
    let shared = share_of_wire(sent.copied(), wire.map(|wire| wire.sent));
    let mut families = vec![
        counter(
            "pal_messages",
            "Messages by robot, kind and direction",
            rows.iter().map(|r| (labels(r), r.count.messages as f64)),
        ),
        counter(
            "pal_payload_bytes",
            "Bytes of our messages",
            rows.iter().map(|r| (labels(r), r.count.payload_bytes as f64)),
        ),
        counter(
            "pal_wire_shared_bytes",
            "Bytes sent, with Zenoh's headers as measured shared out by kind and TCP/IP's as modelled",
            shared.into_iter().map(|(row, bytes)| (labels(&row), bytes as f64)),
        ),
    ];
    if let Some(wire) = wire {
        let both = [("sent", wire.sent), ("received", wire.received)];
        let samples = both.map(|(way, bytes)| (vec![("direction", way.to_owned())], bytes as f64));
        families.push(counter(
            "pal_wire_bytes",
            "Bytes on this session's links by Zenoh's count: all but TCP/IP's headers",
            samples,
        ));
    }
    families
}

/// Memory, processor time and open files of this process, under the names that Prometheus' own libraries use.
fn process() -> Vec<Family> {
    let Some(own) = process_figures() else { return Vec::new() };
    vec![
        gauge("process_resident_memory_bytes", "Resident memory", [(Vec::new(), own.resident_bytes as f64)]),
        gauge("process_open_fds", "Open file descriptors", [(Vec::new(), own.open_files as f64)]),
        counter("process_cpu_seconds", "User and system time", [(Vec::new(), own.cpu_s)]),
    ]
}

/// What Linux says of this process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProcessFigures {
    /// Resident memory.
    pub resident_bytes: u64,
    /// User and system time, seconds, to 10 ms.
    pub cpu_s: f64,
    /// Open file descriptors.
    pub open_files: usize,
}

/// This process; `None` where there is no `/proc`.
pub fn process_figures() -> Option<ProcessFigures> {
    figures_of("self")
}

/// A process by its number, or `self`.
pub fn figures_of(process: &str) -> Option<ProcessFigures> {
    /// Linux counts in these everywhere (USER_HZ).
    const TICKS_PER_S: f64 = 100.0;
    const PAGE_BYTES: u64 = 4096;
    let stat = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    // The second field is the name in parentheses and may hold anything.
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = |at: usize| fields.get(at)?.parse::<f64>().ok();
    let pages: u64 = fields.get(21)?.parse().ok()?;
    Some(ProcessFigures {
        resident_bytes: pages * PAGE_BYTES,
        cpu_s: (ticks(11)? + ticks(12)?) / TICKS_PER_S,
        open_files: std::fs::read_dir(format!("/proc/{process}/fd")).map_or(0, Iterator::count),
    })
}

fn counter(name: &'static str, help: &'static str, samples: impl IntoIterator<Item = (Labels, f64)>) -> Family {
    Family { name, help, is_counter: true, samples: samples.into_iter().collect() }
}

fn gauge(name: &'static str, help: &'static str, samples: impl IntoIterator<Item = (Labels, f64)>) -> Family {
    Family { name, help, is_counter: false, samples: samples.into_iter().collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::samples;

    #[tokio::test]
    async fn the_figures_of_robots_and_map_stand_in_the_text() {
        let board = Board::default();
        board.beat();
        board.health(&samples::health());
        board.map(&samples::map());
        let text = board.text().await;
        for part in [
            "# TYPE pal_robot_frames counter",
            "pal_robot_frame_rate_hertz{robot=\"r1\"}",
            "pal_robot_payload_sent_bytes_total{robot=\"r1\",kind=\"observation\"}",
            "pal_map_robots{presence=\"online\"}",
            "pal_pulse_total 1",
            "process_resident_memory_bytes ",
            "# EOF",
        ] {
            assert!(text.contains(part), "{part} is missing in:\n{text}");
        }
    }

    #[test]
    fn linux_knows_this_process() {
        let own = process_figures().unwrap();
        assert!(own.resident_bytes > 1 << 20 && own.open_files >= 3, "{own:?}");
    }
}
