//! Three leaders, all orders of events.

use super::*;

const TICK_S: f64 = 0.05;

fn name(k: usize) -> LeaderId {
    LeaderId::new(["l1", "l2", "l3"][k]).unwrap()
}

/// Leaders with a network of no delay between those that reach each other.
#[derive(Clone)]
struct Parliament {
    now: Timestamp,
    leaders: Vec<Succession>,
    /// Which island each is on; who is down is on none.
    island: [Option<u8>; 3],
    /// Robots that each sees.
    robots: [u16; 3],
    /// Frozen ones keep their token for a while.
    frozen: [bool; 3],
    fences: Vec<protocol::fence::Fence>,
    /// Most terms that one receiver accepted within one tick.
    accepted_at_once: usize,
}

impl Parliament {
    fn new() -> Self {
        let leaders = (0..3).map(|k| Succession::new(name(k), k as u64, 1, 0, 0.3)).collect();
        Self {
            now: Timestamp::from_secs_f64(1000.0),
            leaders,
            island: [Some(0); 3],
            robots: [3; 3],
            frozen: [false; 3],
            fences: vec![protocol::fence::Fence::default(); 3],
            accepted_at_once: 0,
        }
    }

    fn together(&self, a: usize, b: usize) -> bool {
        self.island[a].is_some() && self.island[a] == self.island[b]
    }

    /// Tokens as they are seen: who is reached and not frozen for long.
    fn tokens(&mut self) {
        for a in 0..3 {
            for b in (0..3).filter(|b| *b != a) {
                let there = self.together(a, b) && !self.frozen[b];
                let known = self.leaders[a].others.get(&name(b)).and_then(|o| o.token);
                if known != Some(there) && (there || known.is_some()) && !self.frozen[a] {
                    self.leaders[a].token(self.now, name(b), there);
                }
            }
        }
    }

    fn run(&mut self, seconds: f64) {
        for _ in 0..(seconds / TICK_S) as usize {
            self.now = self.now.offset_by_secs(TICK_S);
            self.tokens();
            for a in 0..3 {
                if self.island[a].is_none() || self.frozen[a] {
                    continue;
                }
                self.leaders[a].decide(self.now, self.robots[a]);
                if let Some(word) = self.leaders[a].word(self.now, self.robots[a], None) {
                    for b in (0..3).filter(|b| *b != a) {
                        if self.together(a, b) && !self.frozen[b] {
                            self.leaders[b].heard(self.now, &word);
                        }
                    }
                }
            }
            // Everybody's maps reach a receiver on each island.
            for receiver in 0..3 {
                let mut accepted = Vec::new();
                for a in 0..3 {
                    if !self.together(receiver, a) || self.frozen[a] {
                        continue;
                    }
                    if let Some(term) = self.leaders[a].reign()
                        && self.fences[receiver].admits(self.now, name(a), term)
                    {
                        accepted.push(term);
                    }
                }
                accepted.dedup();
                self.accepted_at_once = self.accepted_at_once.max(accepted.len());
            }
        }
    }

    fn rulers(&self) -> Vec<usize> {
        (0..3).filter(|k| self.island[*k].is_some() && !self.frozen[*k] && self.leaders[*k].reign().is_some()).collect()
    }

    fn happen(&mut self, event: Event) {
        match event {
            Event::Kill(k) => self.island[k] = None,
            Event::Start(k) => {
                self.island[k] = Some(0);
                self.frozen[k] = false;
                self.leaders[k] = Succession::new(name(k), 100 + k as u64, 1, 0, 0.3);
            }
            Event::Freeze(k) => self.frozen[k] = true,
            Event::Thaw(k) => {
                if std::mem::take(&mut self.frozen[k]) {
                    self.leaders[k].thawed(self.now);
                }
            }
            Event::CutOff(k) => self.island[k] = self.island[k].map(|_| 1 + k as u8),
            Event::Heal => self.island = self.island.map(|i| i.map(|_| 0)),
            Event::Blind(k) => self.robots[k] = 1,
            Event::See => self.robots = [3; 3],
        }
    }
}

#[derive(Debug, Clone, Copy)]
enum Event {
    Kill(usize),
    Start(usize),
    Freeze(usize),
    Thaw(usize),
    CutOff(usize),
    Heal,
    Blind(usize),
    See,
}

fn every_event() -> Vec<Event> {
    let mut all = vec![Event::Heal, Event::See];
    for k in 0..3 {
        all.extend([
            Event::Kill(k),
            Event::Start(k),
            Event::Freeze(k),
            Event::Thaw(k),
            Event::CutOff(k),
            Event::Blind(k),
        ]);
    }
    all
}

#[test]
fn the_lowest_name_among_those_that_see_most_robots_is_elected() {
    assert_eq!(elect([("l2", 3), ("l1", 2), ("l3", 3)]), Some("l2"));
    assert_eq!(elect([("l3", 3), ("l1", 3), ("l2", 3)]), Some("l1"));
    assert_eq!(elect([("l1", 0)]), Some("l1"));
    assert_eq!(elect::<&str>([]), None);
}

#[test]
fn whatever_happens_in_whatever_order_one_leader_rules_each_island_soon_after() {
    // All sequences of three events, one second apart: 20³, then calm.
    let mut settled = Parliament::new();
    settled.run(1.0);
    assert_eq!(settled.rulers(), [0]);
    for first in every_event() {
        let mut after_first = settled.clone();
        after_first.happen(first);
        after_first.run(0.7);
        for second in every_event() {
            let mut after_second = after_first.clone();
            after_second.happen(second);
            after_second.run(0.7);
            for third in every_event() {
                let mut parliament = after_second.clone();
                parliament.happen(third);
                parliament.run(3.5);
                let story = [first, second, third];
                let rulers = parliament.rulers();
                for island in 0..4 {
                    let here = |k: &usize| parliament.island[*k] == Some(island);
                    let inhabited = (0..3).any(|k| here(&k) && !parliament.frozen[k]);
                    let ruling = rulers.iter().filter(|k| here(k)).count();
                    assert_eq!(ruling, usize::from(inhabited), "{story:?}: island {island}, rulers {rulers:?}");
                }
                for k in &rulers {
                    let most = (0..3).filter(|j| parliament.together(*k, *j) && !parliament.frozen[*j]);
                    let most = most.map(|j| parliament.robots[j]).max().unwrap();
                    assert_eq!(parliament.robots[*k], most, "{story:?}: {k} rules and sees fewer robots");
                    // And is believed by whoever is there.
                    let term = parliament.leaders[*k].reign();
                    assert_eq!(parliament.fences[*k].term(), term, "{story:?}");
                }
                parliament.accepted_at_once = 0;
                parliament.run(2.0 * TICK_S);
                assert!(parliament.accepted_at_once <= 1, "{story:?}");
            }
        }
    }
}

#[test]
fn a_killed_leader_is_followed_within_half_a_second_and_a_frozen_one_within_its_words() {
    let mut parliament = Parliament::new();
    parliament.run(1.0);
    parliament.happen(Event::Kill(0));
    parliament.run(0.1);
    assert_eq!((parliament.rulers(), parliament.leaders[1].reign()), (vec![1], Some(2)));
    // Frozen, its token stays: its silence tells.
    let mut parliament = Parliament::new();
    parliament.run(1.0);
    let (now, frozen) = (parliament.now, 0);
    for k in 1..3 {
        parliament.leaders[k].token(now, name(frozen), true);
    }
    parliament.island[frozen] = None;
    let silence = parliament.now.offset_by_secs(STALE_S + 2.0 * TICK_S);
    assert_eq!(parliament.leaders[1].decide(silence, 3), Some(Change::Begin(2)));
}

#[test]
fn a_thawed_leader_stands_by_at_once_and_stays_there() {
    let mut parliament = Parliament::new();
    parliament.run(1.0);
    parliament.happen(Event::Freeze(0));
    parliament.run(2.0);
    parliament.frozen[0] = false;
    assert_eq!(parliament.leaders[0].thawed(parliament.now), Some(Change::End));
    parliament.run(3.0);
    assert_eq!(parliament.rulers(), [1], "who rules stays");
    assert_eq!(parliament.leaders[1].reign(), Some(2));
}

#[test]
fn sides_of_a_partition_that_took_the_same_term_end_with_one_new_term() {
    let mut parliament = Parliament::new();
    parliament.run(1.0);
    parliament.happen(Event::Kill(0));
    parliament.happen(Event::CutOff(2));
    parliament.run(1.0);
    assert_eq!(parliament.rulers(), [1, 2]);
    assert_eq!((parliament.leaders[1].reign(), parliament.leaders[2].reign()), (Some(2), Some(2)));
    parliament.happen(Event::Heal);
    parliament.run(1.0);
    assert_eq!(parliament.rulers(), [1]);
    assert!(parliament.leaders[1].reign() > Some(2));
    assert!(
        parliament.fences.iter().all(|fence| fence.term() == parliament.leaders[1].reign() || fence.term() == Some(1))
    );
}

#[test]
fn a_lone_leader_begins_after_it_has_listened_and_a_remembered_term_is_topped() {
    let start = Timestamp::from_secs_f64(5.0);
    let mut alone = Succession::new(name(0), 1, 1, 41, 1.0);
    assert_eq!(alone.decide(start, 0), None);
    assert_eq!(alone.decide(start.offset_by_secs(0.9), 0), None);
    assert_eq!(alone.decide(start.offset_by_secs(1.1), 0), Some(Change::Begin(42)));
    let mut configured = Succession::new(name(0), 1, 7, 0, 0.0);
    assert_eq!(configured.decide(start, 0), Some(Change::Begin(7)));
}

#[test]
fn the_highest_term_that_can_be_said_ends_no_leader_and_nobody_takes_over_from_it_with_a_low_one() {
    let start = Timestamp::from_secs_f64(5.0);
    for hostile in [u64::MAX, u64::MAX - 1, MAX_TERM, MAX_TERM - 1] {
        let mut succession = Succession::new(name(0), 1, 1, 0, 0.0);
        let word = Candidacy { leader: name(1), epoch: 1, term: hostile, rules: true, robots: 0, replay_start: None };
        succession.heard(start, &word);
        succession.term_heard(hostile);
        for tenth in 1..60 {
            let now = start.offset_by_secs(0.1 * f64::from(tenth));
            if tenth == 30 {
                // It rules by now and is contradicted.
                succession.heard(now, &word);
            }
            succession.decide(now, 3);
            if let Some(word) = succession.word(now, 3, None) {
                protocol::codec::encode(&word).unwrap();
            }
        }
        assert_eq!(succession.reign(), Some(MAX_TERM), "{hostile}");
    }
}

#[test]
fn strangers_without_end_cost_no_memory() {
    let mut succession = Succession::new(name(0), 1, 1, 0, 0.0);
    let now = Timestamp::from_secs_f64(5.0);
    for n in 0..1000 {
        let leader = LeaderId::new(&format!("x{n}")).unwrap();
        succession.heard(now, &Candidacy { leader, epoch: 1, term: 0, rules: false, robots: 0, replay_start: None });
    }
    assert!(succession.others.len() <= MAX_LEADERS);
}

#[test]
fn a_leader_whose_token_is_there_and_whose_word_is_not_is_taken_for_ones_own_deafness_less_and_less_often() {
    let at = |s: f64| Timestamp::from_secs_f64(5.0 + s);
    let mut succession = Succession::new(name(0), 1, 1, 0, 0.0);
    succession.token(at(0.0), name(1), true);
    let word = Candidacy { leader: name(1), epoch: 1, term: 0, rules: false, robots: 0, replay_start: None };
    succession.heard(at(0.1), &word);
    let told = |succession: &mut Succession, from: u32, to: u32| -> Vec<u32> {
        (from..to).filter(|tenth| succession.is_deaf(at(0.1 * f64::from(*tenth)))).map(|tenth| tenth / 10).collect()
    };
    assert_eq!(told(&mut succession, 0, 3000), [3, 9, 21, 45, 93], "and then no more");
    succession.heard(at(300.0), &word);
    assert_eq!(told(&mut succession, 3001, 3050), [303], "it was heard in between");
    // One that is heard does not make the waiting for another one begin anew.
    let mut three = Succession::new(name(0), 1, 1, 0, 0.0);
    for other in [1, 2] {
        three.token(at(0.0), name(other), true);
    }
    let deaf = (0..6000).filter(|tenth| {
        let now = at(0.1 * f64::from(*tenth));
        three.heard(now, &word);
        three.is_deaf(now)
    });
    assert_eq!(deaf.count(), 5, "of the one that is never heard");
    // Whoever has gone, or gave its token back, is not waited for.
    succession.heard(at(305.0), &word);
    succession.token(at(306.0), name(1), false);
    assert!(told(&mut succession, 3060, 4000).is_empty());
}
