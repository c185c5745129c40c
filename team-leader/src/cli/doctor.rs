//! `team-leader doctor`: listens to a running team for some seconds and says what is wrong and what would fix it.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::time::Duration;

use clap::Args;
use protocol::id::{RobotId, TeamId};
use protocol::key::{Key, Pattern, RobotTopic, Topic};
use protocol::message::{Announcement, Command, CommandReply, Health, Observation, PictureKind, TeamMap};
use protocol::transport::{AskedMap, AskedPicture, CLOSE_LIMIT, Options, Sign, Transport, TransportError};

use super::outside::Outside;
use super::solve::Format;
use crate::doctor::{Diagnosis, Heard, PictureFigures, Severity, diagnose, picture_figures};

/// Time that a robot has for an answer.
const ANSWER_LIMIT: Duration = Duration::from_secs(2);
/// Most observations kept of a robot.
const MAX_OBSERVATIONS: usize = 1000;

/// Arguments of `doctor`.
#[derive(Debug, Clone, Args)]
pub struct DoctorArgs {
    /// How to reach the team.
    #[command(flatten)]
    pub outside: Outside,
    /// How long to listen, seconds, 1 to 600
    #[arg(long, default_value_t = 4.0)]
    seconds: f64,
    /// Also look at each robot's picture: exposure, focus
    #[arg(long)]
    pictures: bool,
    /// How to report
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// Listens and reports; the exit code: 0 no problem, 1 a problem (or nobody to ask), 2 a wrong configuration.
pub fn run(args: &DoctorArgs) -> u8 {
    if !(1.0..=600.0).contains(&args.seconds) {
        return super::usage_error(&format!("--seconds {}: 1 to 600", args.seconds), args.format);
    }
    let (team, options) = match args.outside.options() {
        Ok(reached) => reached,
        Err(error) => return super::usage_error(&error, args.format),
    };
    let runtime = match tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build() {
        Ok(runtime) => runtime,
        Err(error) => return super::failure(&error, args.format),
    };
    let heard = runtime.block_on(listen(team, options, args));
    runtime.shutdown_timeout(CLOSE_LIMIT);
    match heard {
        Ok(heard) => {
            let diagnosis = diagnose(&heard);
            super::output(u8::from(!diagnosis.is_fine()), |out| report(&diagnosis, args.format, out))
        }
        Err(error) => super::failure(&error, args.format),
    }
}

async fn listen(team: TeamId, options: Options, args: &DoctorArgs) -> Result<Heard, TransportError> {
    let transport = Transport::open(options).await?;
    let every = |topic| Pattern::EveryRobot(team, topic);
    let mut announcements = transport.subscribe::<Announcement>(every(RobotTopic::Announcement)).await?;
    let mut observations = transport.subscribe::<Observation>(every(RobotTopic::Observation)).await?;
    let mut healths = transport.subscribe::<Health>(every(RobotTopic::Health)).await?;
    let mut maps = transport.subscribe::<TeamMap>(Key::map(team)).await?;
    let mut robots = transport.watch(every(RobotTopic::Alive)).await?;
    let mut leaders = transport.watch(Pattern::EveryLeader(team)).await?;
    let mut heard = Heard {
        team,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        listened_s: args.seconds,
        leaders: BTreeSet::new(),
        present: BTreeSet::new(),
        announcements: BTreeMap::new(),
        healths: BTreeMap::new(),
        observations: BTreeMap::new(),
        paused: BTreeSet::new(),
        map: None,
        pictures: BTreeMap::new(),
    };
    let mut end = std::pin::pin!(tokio::time::sleep(Duration::from_secs_f64(args.seconds)));
    loop {
        tokio::select! {
            () = &mut end => break,
            Some(got) = announcements.recv() => {
                let sessions = heard.announcements.entry(got.message.robot).or_default();
                // The same session says so again every few seconds; the wire limits who may announce how often.
                if sessions.iter().all(|known: &Announcement| known.epoch != got.message.epoch) && sessions.len() < 16 {
                    sessions.push(got.message);
                }
            }
            Some(got) = observations.recv() => if let Some(robot) = got.key.robot_id() {
                let seen = heard.observations.entry(robot).or_default();
                if seen.len() < MAX_OBSERVATIONS {
                    seen.push(got.message);
                }
            },
            Some(got) = healths.recv() => drop(heard.healths.insert(got.message.robot, got.message)),
            Some(got) = maps.recv() => heard.map = Some(got.message),
            Some(Sign { key, alive }) = robots.recv() => if let Some(robot) = key.robot_id() {
                if alive { heard.present.insert(robot) } else { heard.present.remove(&robot) };
            },
            Some(Sign { key, alive }) = leaders.recv() => if let Topic::LeaderAlive(leader) = key.topic {
                if alive { heard.leaders.insert(leader) } else { heard.leaders.remove(&leader) };
            },
        }
    }
    if heard.map.is_none() {
        heard.map = transport.ask(Key::map(team), &AskedMap, ANSWER_LIMIT).await.ok().map(|got| got.answer);
    }
    for robot in heard.present.clone() {
        ask_robot(&transport, &mut heard, robot, args.pictures).await;
    }
    transport.close().await?;
    Ok(heard)
}

async fn ask_robot(transport: &Transport, heard: &mut Heard, robot: RobotId, pictures: bool) {
    let key = |topic| Key::robot(heard.team, robot, topic);
    let status = transport.ask(key(RobotTopic::Command), &Command::Status, ANSWER_LIMIT).await;
    let picture = match pictures {
        true => {
            let kind = PictureKind::Panorama;
            transport.ask(key(RobotTopic::Picture(kind)), &AskedPicture(kind), ANSWER_LIMIT).await.ok()
        }
        false => None,
    };
    if status.is_ok_and(|got| matches!(got.answer, CommandReply::Status { paused: true, .. })) {
        heard.paused.insert(robot);
    }
    if let Some(figures) = picture.and_then(|got| figures_of(&got.answer.0)) {
        heard.pictures.insert(robot, figures);
    }
}

fn figures_of(encoded: &[u8]) -> Option<PictureFigures> {
    let picture = image::load_from_memory(encoded).ok()?.into_luma8();
    picture_figures(picture.as_raw(), picture.width() as usize)
}

fn report(diagnosis: &Diagnosis, format: Format, out: &mut impl Write) -> std::io::Result<()> {
    if format == Format::Json {
        let (findings, sees) = (&diagnosis.findings, &diagnosis.sees);
        let report = serde_json::json!({ "ok": diagnosis.is_fine(), "findings": findings, "sees": sees });
        return writeln!(out, "{report}");
    }
    for finding in &diagnosis.findings {
        let word = match finding.severity {
            Severity::Problem => "PROBLEM",
            Severity::Warning => "warning",
            Severity::Fine => "fine   ",
        };
        writeln!(out, "{word}  {}: {}", finding.about, finding.what)?;
        if !finding.cure.is_empty() {
            writeln!(out, "           → {}", finding.cure)?;
        }
    }
    for sight in &diagnosis.sees {
        let peer = sight.peer.map_or("somebody".to_owned(), |peer| peer.to_string());
        let radius = sight.radius_m.map(|m| format!(", marker {m:.3} m in radius")).unwrap_or_default();
        let off = sight.elevation_error_deg.map(|deg| format!(", {deg:+.2}° in elevation")).unwrap_or_default();
        writeln!(out, "sees     {} → {peer}: {} times{radius}{off}", sight.observer, sight.sightings)?;
    }
    Ok(())
}
