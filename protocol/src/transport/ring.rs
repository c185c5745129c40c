//! A bounded queue between Zenoh's threads and a reader: never blocks the writer, drops the oldest, counts what it drops.
//!
//! Zenoh's own `FifoChannel` stops the whole session when it is full, and its `RingChannel` does not count.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::Notify;

/// Both ends share it. One reader at a time.
#[derive(Debug)]
pub(super) struct Ring<T> {
    state: Mutex<State<T>>,
    changed: Notify,
    capacity: usize,
    dropped: AtomicU64,
}

#[derive(Debug)]
struct State<T> {
    items: VecDeque<T>,
    closed: bool,
}

/// The writer's end; dropping it closes the ring.
#[derive(Debug)]
pub(super) struct Writer<T>(Arc<Ring<T>>);

impl<T> Ring<T> {
    /// Room for `capacity` items, at least one.
    pub(super) fn new(capacity: usize) -> (Writer<T>, Arc<Self>) {
        let state = Mutex::new(State { items: VecDeque::new(), closed: false });
        let ring =
            Arc::new(Self { state, changed: Notify::new(), capacity: capacity.max(1), dropped: AtomicU64::new(0) });
        (Writer(ring.clone()), ring)
    }

    /// The oldest item, when there is one; `None` once the writer is gone and all is read.
    pub(super) async fn recv(&self) -> Option<T> {
        loop {
            {
                let mut state = self.lock();
                if let Some(item) = state.items.pop_front() {
                    return Some(item);
                }
                if state.closed {
                    return None;
                }
            }
            // `notify_one` keeps one permit, so a push between the lock and here is not missed.
            self.changed.notified().await;
        }
    }

    /// The oldest item, if there is one now.
    pub(super) fn try_recv(&self) -> Option<T> {
        self.lock().items.pop_front()
    }

    /// Items that the reader was too slow for.
    pub(super) fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    fn lock(&self) -> MutexGuard<'_, State<T>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<T> Writer<T> {
    /// Appends; `false` where the oldest had to go.
    pub(super) fn push(&self, item: T) -> bool {
        let mut state = self.0.lock();
        let full = state.items.len() >= self.0.capacity;
        if full {
            state.items.pop_front();
            self.0.dropped.fetch_add(1, Ordering::Relaxed);
        }
        state.items.push_back(item);
        drop(state);
        self.0.changed.notify_one();
        !full
    }

    /// Appends in place of a waiting item that `same` finds: for states, of which only the last counts.
    pub(super) fn push_last(&self, item: T, same: impl Fn(&T, &T) -> bool) -> bool {
        {
            let mut state = self.0.lock();
            if let Some(at) = state.items.iter().position(|waiting| same(waiting, &item)) {
                state.items.remove(at);
            }
        }
        self.push(item)
    }
}

impl<T> Drop for Writer<T> {
    fn drop(&mut self) {
        self.0.lock().closed = true;
        self.0.changed.notify_one();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_ring_drops_the_oldest_and_counts_it() {
        let (writer, ring) = Ring::new(3);
        for item in 0..5 {
            assert_eq!(writer.push(item), item < 3);
        }
        assert_eq!(ring.dropped(), 2);
        assert_eq!(
            [ring.try_recv(), ring.try_recv(), ring.try_recv(), ring.try_recv()],
            [Some(2), Some(3), Some(4), None]
        );
    }

    #[test]
    fn of_a_state_only_the_last_waits() {
        let (writer, ring) = Ring::new(2);
        for item in [("a", true), ("b", true), ("a", false)] {
            writer.push_last(item, |x, y| x.0 == y.0);
        }
        assert_eq!([ring.try_recv(), ring.try_recv(), ring.try_recv()], [Some(("b", true)), Some(("a", false)), None]);
        assert_eq!(ring.dropped(), 0);
    }

    #[tokio::test]
    async fn the_reader_gets_the_rest_and_then_the_end() {
        let (writer, ring) = Ring::new(3);
        writer.push(1);
        drop(writer);
        assert_eq!(ring.recv().await, Some(1));
        assert_eq!(ring.recv().await, None);
    }
}
