//! The agent's network task: joins, publishes, answers, and says once whether a leader is there.

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use protocol::board::Board;
use protocol::host_clock::Clock;
use protocol::id::{LeaderId, RobotId, TeamId};
use protocol::key::{Key, Topic};
use protocol::message::recent::MAX_RECENT;
use protocol::message::{Alarm, Announcement, ClockProbe, Health, Observation, Recent};
use protocol::time::Timestamp;
use protocol::transport::{AskedReplayStart, Options, Sign, Transport, TransportError};

use super::journal::Journal;
use super::link::Link;
use super::mailbox::Mailbox;
use super::queue::Outputs;
use super::waiting::{Question, Waiting, answer_picture};
use super::{Start, Summary};
use crate::agent::{Agent, Input, Output};

/// Alarms kept for the next session; the oldest go first.
const MAX_ALARMS_KEPT: usize = 64;
/// Observations kept for a leader that comes late: at most [`MAX_RECENT`], and those before the newest by no more, seconds. Older
/// ones say nothing about now.
const RECENT_S: f64 = 1.0;
/// Without a link for so long, with the leaders' endpoints tried again and again, the session is opened anew. Zenoh's clients do not
/// come back (1.10.2) where a link is closed while they finish opening it.
const LINK_PATIENCE: Duration = Duration::from_secs(3);
/// Between two looks at the link.
const LINK_PERIOD: Duration = Duration::from_millis(500);
/// Without a leader for so long after joining, the agent says that it waits.
const LEADER_PATIENCE: Duration = Duration::from_secs(2);
/// Most notices that are kept for the summary; all are logged.
const MAX_NOTICES: usize = 256;
/// Between two questions for the common start.
const START_PERIOD: Duration = Duration::from_millis(300);
/// The common start is asked for so often, and the quickest answer counts: it says most about the clocks.
const START_ANSWERS: usize = 5;

/// The agent's side of the network.
pub struct Network {
    robot: RobotId,
    team: TeamId,
    clock: Clock,
    session: Option<Options>,
    transport: Option<Transport>,
    start: Option<Start>,
    mailbox: Arc<Mailbox>,
    dropped: Arc<AtomicU64>,
    /// The last alarms, published again in every session: receivers take each once, by its number.
    kept: VecDeque<Alarm>,
    journal: Option<Journal>,
    /// The last observations, oldest first.
    recent: VecDeque<Observation>,
    announcement: Option<Announcement>,
    leaders: BTreeSet<LeaderId>,
    notices: Vec<String>,
    board: Board,
}

impl Network {
    /// Not joined yet.
    pub fn new(
        agent: &Agent,
        team: TeamId,
        clock: Clock,
        session: Options,
        start: Option<Start>,
        mailbox: Arc<Mailbox>,
        dropped: Arc<AtomicU64>,
    ) -> Self {
        Self {
            robot: agent.robot(),
            team,
            clock,
            board: session.board.clone(),
            session: Some(session),
            transport: None,
            start,
            mailbox,
            dropped,
            kept: VecDeque::new(),
            journal: None,
            recent: VecDeque::new(),
            announcement: None,
            leaders: BTreeSet::new(),
            notices: Vec::new(),
        }
    }

    /// Keeps alarms over a restart, and publishes first what was raised before this one.
    pub fn keep_alarms(&mut self, mut journal: Journal) {
        self.kept.extend(journal.take_before());
        self.journal = Some(journal);
    }

    /// Joins and works until the agent's outputs end, which they do when its mailbox is closed.
    pub async fn work(&mut self, mut outputs: Outputs) -> Result<(), TransportError> {
        let Some(session) = self.session.take() else { return Ok(()) };
        let Some(mut transport) = self.join(Transport::open(session), &mut outputs).await? else { return Ok(()) };
        loop {
            let mut link = Link::declare(&transport, self.team, self.robot).await?;
            tracing::info!("robot {} has joined team {}", self.robot, self.team);
            if let Some(announcement) = &self.announcement {
                log_unsent(link.announcement.put(announcement));
            }
            for alarm in &self.kept {
                log_unsent(link.alarm.put(alarm));
            }
            let asking_start = start_from_leader(transport.clone(), self.team, self.clock, self.start.clone());
            tokio::select! {
                () = self.serve(&mut link, &mut outputs) => return Ok(()),
                () = is_lost(&transport) => {}
                () = asking_start => return Ok(()),
            }
            self.tell("no leader is found any more; the agent works on and opens its session anew".to_owned());
            self.leaders.clear();
            self.transport = None;
            match self.join(transport.reopen(), &mut outputs).await? {
                Some(reopened) => transport = reopened,
                None => return Ok(()),
            }
        }
    }

    /// Waits for a session; `None` where the outputs ended before.
    async fn join(
        &mut self,
        opening: impl Future<Output = Result<Transport, TransportError>>,
        outputs: &mut Outputs,
    ) -> Result<Option<Transport>, TransportError> {
        let mut opening = std::pin::pin!(opening);
        let transport = loop {
            tokio::select! {
                opened = &mut opening => break opened?,
                output = outputs.recv() => match output {
                    Some(output) => self.keep(output),
                    None => return Ok(None),
                },
            }
        };
        self.transport = Some(transport.clone());
        Ok(Some(transport))
    }

    async fn serve(&mut self, link: &mut Link, outputs: &mut Outputs) {
        let mut waiting = Waiting::default();
        let mut patience = std::pin::pin!(tokio::time::sleep(LEADER_PATIENCE));
        let mut leader_may_come = true;
        loop {
            tokio::select! {
                output = outputs.recv() => match output {
                    Some(output) => self.send(output, link, &mut waiting),
                    None => return,
                },
                Some(asked) = link.recent_asked.recv() => match Recent::newest(self.recent.iter().cloned()) {
                    Ok(recent) => log_unsent(asked.reply(&recent)),
                    Err(error) => log_unsent(asked.refuse(&error.to_string())),
                },
                Some(question) = link.questions.recv() => self.pass_on(question, &mut waiting),
                Some(got) = link.announcements.recv() => {
                    self.mailbox.put_event(got.arrived, Input::Announcement(Box::new(got.message)));
                }
                Some(got) = link.surroundings.recv() => {
                    self.mailbox.put_event(got.arrived, Input::Surroundings(got.message));
                }
                Some(sign) = link.leaders.recv() => self.leader_sign(sign),
                () = &mut patience, if leader_may_come => {
                    leader_may_come = false;
                    if self.leaders.is_empty() {
                        self.tell(format!("no leader of team {} is there yet; the agent works on and waits", self.team));
                    }
                }
            }
        }
    }

    /// While nobody is connected: who the robot is and what has happened is kept, the present passes.
    fn keep(&mut self, output: Output) {
        match output {
            Output::Announcement(announcement) => self.announcement = Some(announcement),
            Output::Alarm(alarm) => self.note(alarm),
            Output::Notice(text) => self.tell(text),
            Output::Health(health) => {
                self.complete(health);
            }
            Output::Observation(observation) => self.remember(observation),
            _ => {}
        }
    }

    fn send(&mut self, output: Output, link: &Link, waiting: &mut Waiting) {
        match output {
            Output::Announcement(announcement) => {
                log_unsent(link.announcement.put(&announcement));
                self.announcement = Some(announcement);
            }
            Output::Observation(observation) => {
                log_unsent(link.observation.put(&observation));
                self.remember(observation);
            }
            Output::Alarm(alarm) => {
                log_unsent(link.alarm.put(&alarm));
                self.note(alarm);
            }
            Output::Health(health) => log_unsent(link.health.put(&self.complete(health))),
            Output::Edges(edges) => log_unsent(link.edges.put(&edges)),
            Output::ClockReply(token, reply) => log_unsent(waiting.answer_clock(token, reply, self.clock.now())),
            Output::CommandReply(token, reply) => log_unsent(waiting.answer_command(token, &reply)),
            Output::Picture(token, picture) => {
                if let Some(asked) = waiting.take_picture(token) {
                    tokio::task::spawn_blocking(move || log_unsent(answer_picture(asked, picture)));
                }
            }
            Output::Notice(text) => self.tell(text),
        }
    }

    fn remember(&mut self, observation: Observation) {
        let newest = observation.capture;
        self.recent.push_back(observation);
        while self.recent.len() > MAX_RECENT
            || self.recent.front().is_some_and(|old| newest.seconds_since(old.capture) > RECENT_S)
        {
            self.recent.pop_front();
        }
    }

    fn note(&mut self, alarm: Alarm) {
        tracing::info!("alarm {}: {}", alarm.number, alarm.kind);
        if let Some(journal) = &mut self.journal {
            journal.keep(&alarm);
        }
        if self.kept.len() >= MAX_ALARMS_KEPT {
            self.kept.pop_front();
            if self.transport.is_none() {
                self.dropped.fetch_add(1, Ordering::Relaxed);
            }
        }
        self.kept.push_back(alarm);
    }

    /// What only the shell knows.
    fn complete(&self, mut health: Health) -> Health {
        let (frames, events) = self.mailbox.dropped();
        health.frames += frames;
        health.frames_dropped += frames;
        health.messages_dropped += events + self.dropped.load(Ordering::Relaxed);
        if let Some(transport) = &self.transport {
            let meter = transport.meter();
            health.messages_dropped += meter.dropped();
            health.messages_refused += meter.refused();
            health.traffic = meter.sent_by_kind();
        }
        // Every two seconds, from the agent's own thread: it works.
        self.board.beat();
        self.board.health(&health);
        health
    }

    fn pass_on(&self, question: Question, waiting: &mut Waiting) {
        let token = waiting.token();
        let (arrived, input) = question.input(token);
        if self.mailbox.put_event(arrived, input) {
            waiting.keep(token, question);
        } else {
            log_unsent(question.refuse("the agent is too busy; ask again"));
        }
    }

    fn leader_sign(&mut self, sign: Sign) {
        let Topic::LeaderAlive(leader) = sign.key.topic else { return };
        if sign.alive {
            self.leaders.insert(leader);
            tracing::info!("leader {leader} is there");
        } else if self.leaders.remove(&leader) {
            self.tell(format!("leader {leader} has gone; the agent works on and waits for one"));
        }
    }

    fn tell(&mut self, notice: String) {
        tracing::warn!("{notice}");
        if self.notices.len() < MAX_NOTICES {
            self.notices.push(notice);
        }
    }

    /// Leaves the network and says what was done.
    pub async fn close(self) -> Summary {
        let (frames_dropped, events_dropped) = self.mailbox.dropped();
        let mut summary = Summary {
            frames_dropped,
            messages_dropped: events_dropped + self.dropped.load(Ordering::Relaxed),
            notices: self.notices,
            ..Summary::default()
        };
        if let Some(transport) = self.transport {
            let meter = transport.meter().clone();
            summary.messages_dropped += meter.dropped();
            summary.messages_refused = meter.refused();
            summary.traffic = meter.rows();
            summary.wire = transport.wire_bytes().await;
            if let Err(error) = transport.close().await {
                tracing::warn!("{error}");
            }
        }
        summary
    }
}

/// Ends when there has been no link for [`LINK_PATIENCE`].
async fn is_lost(transport: &Transport) {
    let mut looks = tokio::time::interval(LINK_PERIOD);
    let mut linked = tokio::time::Instant::now();
    while linked.elapsed() < LINK_PATIENCE {
        looks.tick().await;
        if transport.is_connected().await {
            linked = tokio::time::Instant::now();
        }
    }
}

/// Asks the leader for the common start until it is known, and fills it in. Never ends: it only accompanies the service.
async fn start_from_leader(transport: Transport, team: TeamId, clock: Clock, wanted: Option<Start>) {
    let Some(wanted) = wanted.filter(|wanted| wanted.get().is_none()) else { return std::future::pending().await };
    let mut best: Option<(f64, Timestamp)> = None;
    let mut answers = 0;
    while answers < START_ANSWERS {
        let question = AskedReplayStart(ClockProbe { sent: clock.now() });
        match transport.ask(Key::replay_start(team), &question, START_PERIOD).await {
            Ok(answered) => {
                let round_trip_s = answered.arrived.seconds_since(answered.answer.probe_sent);
                if let Some(start) = answered.answer.on_own_clock(answered.arrived) {
                    answers += 1;
                    if best.is_none_or(|(least, _)| round_trip_s < least) {
                        best = Some((round_trip_s, start));
                    }
                    continue;
                }
            }
            Err(error) => tracing::debug!("the common start: {error}"),
        }
        tokio::time::sleep(START_PERIOD).await;
    }
    if let Some((round_trip_s, start)) = best {
        let in_s = start.seconds_since(clock.now());
        tracing::info!("the recording begins in {in_s:.2} s (known to {:.1} ms)", 0.5e3 * round_trip_s);
        let _ = wanted.set(start);
    }
    std::future::pending::<()>().await;
}

fn log_unsent<T>(sent: Result<T, TransportError>) {
    if let Err(error) = sent {
        tracing::warn!("{error}");
    }
}
