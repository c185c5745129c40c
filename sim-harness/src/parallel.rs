//! Independent jobs on several threads.

use std::panic::resume_unwind;
use std::sync::Mutex;

/// Works all `items` on `threads` threads, each as soon as one is free; what comes out is in the order of the items. A panic of `work`
/// goes on in the caller.
pub fn map<I, T: Send>(
    threads: usize,
    items: impl IntoIterator<Item = I, IntoIter: Send>,
    work: impl Fn(I) -> T + Sync,
) -> Vec<T> {
    let items = Mutex::new(items.into_iter().enumerate());
    // The lock must be free while the item is worked on.
    let next = || items.lock().ok()?.next();
    let worker =
        || -> Vec<(usize, T)> { std::iter::from_fn(next).map(|(number, item)| (number, work(item))).collect() };
    let mut done: Vec<(usize, T)> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads.max(1)).map(|_| scope.spawn(worker)).collect();
        workers.into_iter().flat_map(|w| w.join().unwrap_or_else(|panic| resume_unwind(panic))).collect()
    });
    done.sort_by_key(|(number, _)| *number);
    done.into_iter().map(|(_, result)| result).collect()
}

/// Threads that this machine works at once.
pub fn processors() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use super::*;

    #[test]
    fn jobs_run_at_once_and_their_results_keep_the_order() {
        // Only two at a time pass the barrier.
        let both = Barrier::new(2);
        let squares = map(2, 0..10, |n| {
            both.wait();
            n * n
        });
        assert_eq!(squares, [0, 1, 4, 9, 16, 25, 36, 49, 64, 81]);
        assert!(map(4, 0..0, |n: u8| n).is_empty());
    }
}
