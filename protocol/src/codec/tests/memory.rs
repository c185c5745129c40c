//! An allocator that knows the peak of each thread, for the tests of this crate.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    static LIVE: Cell<usize> = const { Cell::new(0) };
    static PEAK: Cell<usize> = const { Cell::new(0) };
}

struct Counting;

#[global_allocator]
static COUNTING: Counting = Counting;

// SAFETY: every call is passed to the system's allocator unchanged; the counters are plain thread-local cells without
// destructors, so touching them allocates nothing and is possible at any time.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let live = LIVE.get().wrapping_add(layout.size());
        LIVE.set(live);
        // Memory that other threads gave may be freed here, so `live` may wrap below 0; that is no peak.
        if live < usize::MAX / 2 {
            PEAK.set(PEAK.get().max(live));
        }
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        LIVE.set(LIVE.get().wrapping_sub(layout.size()));
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

/// What `work` gives, and the most bytes it held at once on this thread.
pub(super) fn peak_of<T>(work: impl FnOnce() -> T) -> (T, usize) {
    LIVE.set(0);
    PEAK.set(0);
    let result = work();
    (result, PEAK.get())
}

#[test]
fn the_peak_is_what_was_held_at_once() {
    let ((), peak) = peak_of(|| {
        for _ in 0..10 {
            std::hint::black_box(vec![0u8; 1000]);
        }
        let pair = (vec![0u8; 3000], vec![0u8; 500]);
        std::hint::black_box(&pair);
    });
    assert_eq!(peak, 3500);
}
