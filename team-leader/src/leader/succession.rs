//! Who leads: one of any number of leaders, all of which hear everything.
//!
//! Problem: the leader dies, freezes, is cut off, or lives but does nothing, and nobody may be asked. In a partition each side
//! needs one leader, afterwards one of them must go, and a leader that comes back must not be believed.
//!
//! Insight: every leader computes all the time, so taking over costs nothing but a decision. The decision is a rule that all can
//! apply to what all can see ([`elect`]): *the lowest live name among those that see most robots*. Terms make changes safe:
//! whoever begins takes the highest term it knows of plus one, and everybody drops lower ones ([`protocol::fence`]).
//!
//! ```text
//!            rule says me, and no live leader rules
//!            (or one that sees fewer robots, for CLAIM_S)
//!   stands by ───────────────────────────────────────▶ rules (term = highest + 1)
//!       ▲                                                │
//!       └─ a higher term rules · the same term, and the ─┘
//!          rule says the other · it was frozen itself
//! ```
//! Who rules stays, also when a lower name comes back: a change is not worth a gap. Live is whose word ([`Candidacy`], five
//! times a second, sent by the loop that does the work) is fresh and whose liveliness token is there.

use std::collections::BTreeMap;

use protocol::fence::MAX_TERM;
use protocol::id::LeaderId;
use protocol::message::Candidacy;
use protocol::time::Timestamp;

/// Between two words of a leader, seconds.
pub const WORD_PERIOD_S: f64 = 0.2;
/// A leader whose last word is older does not work, whatever its token says, seconds.
pub const STALE_S: f64 = 1.2;
/// So long a leader must see more robots than the one that rules before it takes over, seconds.
pub const CLAIM_S: f64 = 1.0;
/// A leader whose token has appeared has so long to say its first word, seconds.
const FIRST_WORD_S: f64 = 0.5;
/// A leader whose token is there always says its word, so one that is not heard for so long speaks to a session that is no
/// more: at first, and at most, seconds.
pub const DEAF_S: [f64; 2] = [3.0, 60.0];
/// Most other leaders that are listened to.
pub const MAX_LEADERS: usize = 16;

/// The rule: of (name, robots seen), the lowest name among those that see most robots.
pub fn elect<Name: Ord>(candidates: impl IntoIterator<Item = (Name, u16)>) -> Option<Name> {
    let best = |a: (Name, u16), b: (Name, u16)| if (b.1, &a.0) > (a.1, &b.0) { b } else { a };
    candidates.into_iter().reduce(best).map(|(name, _)| name)
}

/// The term that follows one. At the end of all terms it is the last one again, of which the lower name is believed.
fn above(term: u64) -> u64 {
    term.saturating_add(1).min(MAX_TERM)
}

/// Beginning or end of a reign.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Change {
    /// Lead from now on, in this term.
    Begin(u64),
    /// Stand by from now on.
    End,
}

/// A leader's name and session: two programs of one name still are two.
type Name = (LeaderId, u64);

/// What one leader knows of all.
#[derive(Debug, Clone)]
pub struct Succession {
    own: Name,
    /// The first term of a team that has none.
    first_term: u64,
    highest: u64,
    reign: Option<u64>,
    others: BTreeMap<LeaderId, Other>,
    /// Before it has listened for so long it does not begin, seconds.
    listens_s: f64,
    listening_since: Option<Timestamp>,
    claims_since: Option<Timestamp>,
    word_due: Timestamp,
    /// What the last word said.
    said: Option<Candidacy>,
}

#[derive(Debug, Clone, Copy)]
struct Other {
    /// Whether its token is there; `None` where no sign of it has come.
    token: Option<bool>,
    since: Timestamp,
    word: Option<(Candidacy, Timestamp)>,
    /// How long it may be there without a word before the own session is to blame, seconds; doubles each time.
    deaf_after_s: f64,
}

impl Succession {
    /// Nobody else is known. `highest` is the highest term that is remembered.
    pub fn new(own: LeaderId, epoch: u64, first_term: u64, highest: u64, listens_s: f64) -> Self {
        Self {
            own: (own, epoch),
            first_term,
            highest,
            reign: None,
            others: BTreeMap::new(),
            listens_s,
            listening_since: None,
            claims_since: None,
            word_due: Timestamp::default(),
            said: None,
        }
    }

    /// The own term, while it rules.
    pub fn reign(&self) -> Option<u64> {
        self.reign
    }

    /// The highest term known.
    pub fn highest(&self) -> u64 {
        self.highest
    }

    /// Other leaders that live at `now`.
    pub fn live(&self, now: Timestamp) -> impl Iterator<Item = &Candidacy> + '_ {
        self.others.values().filter(|other| other.token != Some(false)).filter_map(move |other| {
            let (word, at) = other.word.as_ref()?;
            (now.seconds_since(*at) <= STALE_S).then_some(word)
        })
    }

    /// A term was heard of: in a map, from a file.
    pub fn term_heard(&mut self, term: u64) {
        self.highest = self.highest.max(term.min(MAX_TERM));
    }

    /// A leader's token came or went.
    pub fn token(&mut self, now: Timestamp, leader: LeaderId, alive: bool) {
        if leader == self.own.0 {
            return;
        }
        let Some(other) = self.other(now, leader) else { return };
        if other.token != Some(alive) {
            other.since = now;
        }
        other.token = Some(alive);
        if !alive {
            other.word = None;
        }
    }

    /// A leader's word. True where another program uses the own name.
    pub fn heard(&mut self, now: Timestamp, word: &Candidacy) -> bool {
        if (word.leader, word.epoch) == self.own {
            return false;
        }
        self.term_heard(word.term);
        if let Some(other) = self.other(now, word.leader) {
            (other.word, other.deaf_after_s) = (Some((*word, now)), DEAF_S[0]);
        }
        word.leader == self.own.0
    }

    /// It was frozen itself: nothing that it knows of the others counts any more.
    pub fn thawed(&mut self, now: Timestamp) -> Option<Change> {
        for other in self.others.values_mut() {
            other.word = None;
            other.since = now;
        }
        self.listening_since = Some(now);
        self.listens_s = self.listens_s.max(FIRST_WORD_S);
        self.claims_since = None;
        self.reign.take().map(|_| Change::End)
    }

    /// Whether a sign of another leader has ever come.
    pub fn knows_others(&self) -> bool {
        !self.others.is_empty()
    }

    /// Whether this leader's own session is to blame that another one is not heard: the other's token is there, and its word is
    /// not. (Who computes nothing gives its token back, and who dies or freezes loses it.) True once for each waiting time,
    /// which doubles for each; where one is never heard again it ends.
    pub fn is_deaf(&mut self, now: Timestamp) -> bool {
        let silent = |other: &Other| {
            let last = other.word.as_ref().map_or(other.since, |(_, at)| other.since.max(*at));
            let waits = other.deaf_after_s <= DEAF_S[1] && now.seconds_since(last) > other.deaf_after_s;
            waits && other.token == Some(true)
        };
        if !self.others.values().any(silent) {
            return false;
        }
        for other in self.others.values_mut() {
            other.deaf_after_s *= if silent(other) { 2.0 } else { 1.0 };
            other.since = now;
        }
        true
    }

    /// What follows at `now` from everything heard; `robots` are those that this leader sees.
    pub fn decide(&mut self, now: Timestamp, robots: u16) -> Option<Change> {
        let since = *self.listening_since.get_or_insert(now);
        let change = match self.reign {
            Some(term) => self.stay(now, term, robots),
            None if now.seconds_since(since) < self.listens_s => None,
            None => self.rise(now, robots),
        };
        match change {
            Some(Change::Begin(term)) => {
                self.reign = Some(term);
                self.highest = term;
                self.claims_since = None;
            }
            Some(Change::End) => self.reign = None,
            None => {}
        }
        change
    }

    /// The word that is due at `now`, if one is: the period has passed, or something has changed.
    pub fn word(&mut self, now: Timestamp, robots: u16, replay_start: Option<Timestamp>) -> Option<Candidacy> {
        let (leader, epoch) = self.own;
        let term = self.reign.unwrap_or(self.highest);
        let word = Candidacy { leader, epoch, term, rules: self.reign.is_some(), robots, replay_start };
        let turned = self.said.is_none_or(|said| (said.rules, said.term) != (word.rules, word.term));
        // A due time far ahead: the clock was set back.
        let ahead_s = self.word_due.seconds_since(now);
        if !turned && ahead_s > 0.0 && ahead_s <= WORD_PERIOD_S {
            return None;
        }
        self.word_due = now.offset_by_secs(WORD_PERIOD_S);
        self.said = Some(word);
        Some(word)
    }

    /// When [`Succession::decide`] and [`Succession::word`] are wanted next.
    pub fn next(&self) -> Timestamp {
        self.word_due
    }

    fn stay(&mut self, now: Timestamp, term: u64, robots: u16) -> Option<Change> {
        let own = self.own;
        let (mut rival_of_my_term, mut spoiled) = (false, false);
        for word in self.live(now).filter(|word| word.rules) {
            let rule_says_me = || elect([(own, robots), ((word.leader, word.epoch), word.robots)]) == Some(own);
            if word.term > term {
                return Some(Change::End);
            }
            if word.term == term && !rule_says_me() {
                spoiled = true;
            }
            rival_of_my_term |= word.term == term;
        }
        if spoiled {
            // The other must not go on in a term that some have heard from this leader: one above makes it take a new one.
            self.highest = self.highest.max(above(term));
            return Some(Change::End);
        }
        // Somewhere a higher term was believed, or this very term of somebody else: who heard it would not hear this leader.
        let next = above(self.highest);
        ((rival_of_my_term || self.highest > term) && next > term).then_some(Change::Begin(next))
    }

    fn rise(&mut self, now: Timestamp, robots: u16) -> Option<Change> {
        let own = self.own;
        let others = self.live(now).map(|word| ((word.leader, word.epoch), word.robots));
        if elect(others.chain([(own, robots)])) != Some(own) {
            self.claims_since = None;
            return None;
        }
        let ruler = self.live(now).filter(|word| word.rules).max_by_key(|word| word.term);
        let may_begin = match ruler {
            Some(ruler) if ruler.robots < robots => {
                let since = *self.claims_since.get_or_insert(now);
                now.seconds_since(since) >= CLAIM_S
            }
            Some(_) => {
                self.claims_since = None;
                false
            }
            None => !self.others.values().any(|other| {
                other.token == Some(true) && other.word.is_none() && now.seconds_since(other.since) < FIRST_WORD_S
            }),
        };
        may_begin.then(|| Change::Begin(above(self.highest).max(self.first_term)))
    }

    /// A leader's entry; the longest gone gives way where there are too many.
    fn other(&mut self, now: Timestamp, leader: LeaderId) -> Option<&mut Other> {
        if self.others.len() >= MAX_LEADERS && !self.others.contains_key(&leader) {
            let gone = self.others.iter().filter(|(_, other)| other.token == Some(false));
            let oldest = gone.min_by_key(|(_, other)| other.since).map(|(name, _)| *name)?;
            self.others.remove(&oldest);
        }
        let unheard = Other { token: None, since: now, word: None, deaf_after_s: DEAF_S[0] };
        Some(self.others.entry(leader).or_insert(unheard))
    }
}

#[cfg(test)]
mod tests;
