//! How far each video of the corpus is: one byte each, shared by whoever publishes and whoever collects.

use std::sync::atomic::{AtomicU8, AtomicUsize, Ordering};

/// How far a video is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Standing {
    /// Answered for good, or by an earlier run, or not to be asked.
    Answered = 0,
    /// Not published yet.
    Waiting = 1,
    /// Published, and not answered.
    Published = 2,
    /// Answered, by a `failed` row.
    Failed = 3,
}

impl Standing {
    fn of(byte: u8) -> Self {
        match byte {
            1 => Self::Waiting,
            2 => Self::Published,
            3 => Self::Failed,
            _ => Self::Answered,
        }
    }

    fn is_open(self) -> bool {
        matches!(self, Self::Waiting | Self::Published)
    }
}

/// By index in the corpus.
#[derive(Debug)]
pub(super) struct Standings {
    standings: Vec<AtomicU8>,
    publications: Vec<AtomicU8>,
    unanswered: AtomicUsize,
}

impl Standings {
    /// Those of a corpus of `len` videos of which `missing` are to be measured.
    pub(super) fn of(len: usize, missing: &[usize]) -> Self {
        let zeros = || (0..len).map(|_| AtomicU8::new(0)).collect::<Vec<_>>();
        let standings = zeros();
        for standing in missing.iter().filter_map(|&index| standings.get(index)) {
            standing.store(Standing::Waiting as u8, Ordering::Relaxed);
        }
        Self {
            standings,
            publications: zeros(),
            unanswered: AtomicUsize::new(missing.len()),
        }
    }

    pub(super) fn get(&self, index: usize) -> Standing {
        let standing = self.standings.get(index);
        standing.map_or(Standing::Answered, |standing| {
            Standing::of(standing.load(Ordering::SeqCst))
        })
    }

    /// Changes one; gives what it was.
    pub(super) fn put(&self, index: usize, to: Standing) -> Standing {
        let Some(standing) = self.standings.get(index) else {
            return Standing::Answered;
        };
        let before = Standing::of(standing.swap(to as u8, Ordering::SeqCst));
        if before.is_open() && !to.is_open() {
            self.unanswered.fetch_sub(1, Ordering::SeqCst);
        }
        before
    }

    /// From waiting to published; whether it was waiting.
    pub(super) fn claim(&self, index: usize) -> bool {
        let (from, to) = (Standing::Waiting as u8, Standing::Published as u8);
        let claimed = self.standings.get(index).is_some_and(|standing| {
            let exchange = standing.compare_exchange(from, to, Ordering::SeqCst, Ordering::SeqCst);
            exchange.is_ok()
        });
        if claimed {
            self.count_publication(index);
        }
        claimed
    }

    pub(super) fn count_publication(&self, index: usize) {
        if let Some(count) = self.publications.get(index) {
            count.fetch_add(1, Ordering::SeqCst);
        }
    }

    pub(super) fn publications(&self, index: usize) -> u8 {
        let count = self.publications.get(index);
        count.map_or(0, |count| count.load(Ordering::SeqCst))
    }

    /// Videos without an answer.
    pub(super) fn unanswered(&self) -> usize {
        self.unanswered.load(Ordering::SeqCst)
    }

    /// All that are so far, in order.
    pub(super) fn all(&self, standing: Standing) -> Vec<usize> {
        (0..self.standings.len())
            .filter(|&index| self.get(index) == standing)
            .collect()
    }
}
