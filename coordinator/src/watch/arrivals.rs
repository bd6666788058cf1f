//! Which videos have arrived whole: those that two looks in a row found the same, in size and time.

use std::collections::{BTreeMap, BTreeSet};

use plumbline_common::id::VideoId;

use crate::corpus::Entry;

/// What is said of a video that changed until the end.
const UNFINISHED: &str = "still being written when the watch ended";

/// The videos seen so far.
#[derive(Debug, Default)]
pub(super) struct Arrivals {
    /// As the last look found those that are not taken.
    waiting: BTreeMap<VideoId, Entry>,
    taken: BTreeMap<VideoId, Entry>,
    /// Taken ones that were found changed since.
    changed: BTreeSet<VideoId>,
}

/// What a look came to.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Look {
    /// Whole now, by name.
    pub(super) ready: Vec<Entry>,
    /// Changed after they were taken, told once.
    pub(super) changed: Vec<VideoId>,
    /// Whether anything new or different was found.
    pub(super) news: bool,
}

impl Arrivals {
    /// Takes what is as it was at the look before; what cannot be read is never taken.
    pub(super) fn look(&mut self, listing: Vec<Entry>) -> Look {
        let mut look = Look::default();
        let mut waiting = BTreeMap::new();
        for entry in listing {
            if let Some(taken) = self.taken.get(&entry.video) {
                let same = (taken.bytes, taken.modified_ns) == (entry.bytes, entry.modified_ns);
                // One that is gone was moved on by whoever reads the rows.
                if !same && entry.bytes.is_some() && self.changed.insert(entry.video.clone()) {
                    look.changed.push(entry.video);
                }
                continue;
            }
            let as_before = self.waiting.get(&entry.video) == Some(&entry);
            look.news |= !as_before;
            if as_before && entry.bytes.is_some() {
                look.ready.push(entry.clone());
                self.taken.insert(entry.video.clone(), entry);
            } else {
                waiting.insert(entry.video.clone(), entry);
            }
        }
        self.waiting = waiting;
        look
    }

    /// Takes one back that changed while it was measured.
    pub(super) fn give_back(&mut self, video: &VideoId) {
        if let Some(entry) = self.taken.remove(video) {
            self.waiting.insert(video.clone(), entry);
        }
    }

    pub(super) fn taken(&self, video: &VideoId) -> Option<&Entry> {
        self.taken.get(video)
    }

    /// Whether one is still to come: seen, readable, and not whole yet.
    pub(super) fn is_waiting(&self) -> bool {
        self.waiting.values().any(|entry| entry.bytes.is_some())
    }

    /// Every video, by name; those that never became whole with that as their problem.
    pub(super) fn into_entries(self) -> Vec<Entry> {
        let mut all = self.taken;
        for (video, mut entry) in self.waiting {
            entry.problem.get_or_insert_with(|| UNFINISHED.to_owned());
            all.insert(video, entry);
        }
        all.into_values().collect()
    }
}

#[cfg(test)]
mod tests {
    use plumbline_common::message::Location;

    use super::*;

    fn entry(name: &str, bytes: Option<u64>, modified_ns: i128) -> Entry {
        Entry {
            video: VideoId::new(name).unwrap(),
            location: Location::File(name.into()),
            bytes,
            modified_ns: bytes.map(|_| modified_ns),
            problem: bytes.is_none().then(|| "gone".to_owned()),
            group: None,
            carried: serde_json::Map::new(),
        }
    }

    fn names(entries: &[Entry]) -> Vec<&str> {
        entries.iter().map(|entry| entry.video.as_str()).collect()
    }

    #[test]
    fn a_file_is_taken_when_it_stands_still() {
        let mut arrivals = Arrivals::default();
        let mut look = |a: (u64, i128), more: &[Entry]| {
            let mut listing = vec![entry("a", Some(a.0), a.1)];
            listing.extend_from_slice(more);
            arrivals.look(listing)
        };
        let absent = entry("b", None, 0);
        let first = look((5, 1), std::slice::from_ref(&absent));
        assert!(first.ready.is_empty() && first.news);
        // It grew, then was written in place.
        assert!(look((9, 1), std::slice::from_ref(&absent)).ready.is_empty());
        assert!(look((9, 2), std::slice::from_ref(&absent)).ready.is_empty());
        let whole = look((9, 2), std::slice::from_ref(&absent));
        assert_eq!((names(&whole.ready), whole.news), (vec!["a"], false));
        // Taken once; a change is told once.
        assert_eq!(look((9, 2), std::slice::from_ref(&absent)), Look::default());
        assert_eq!(look((9, 3), std::slice::from_ref(&absent)).changed.len(), 1);
        assert!(
            look((9, 4), std::slice::from_ref(&absent))
                .changed
                .is_empty()
        );
        assert!(
            !arrivals.is_waiting(),
            "what cannot be read is not waited for"
        );
        let all = arrivals.into_entries();
        assert_eq!(names(&all), ["a", "b"]);
        assert_eq!((all[0].bytes, all[0].modified_ns), (Some(9), Some(2)));
        assert_eq!(all[1].problem.as_deref(), Some("gone"));
    }

    #[test]
    fn nothing_seen_is_lost() {
        let mut arrivals = Arrivals::default();
        let a = entry("a", Some(1), 1);
        arrivals.look(vec![a.clone()]);
        assert_eq!(arrivals.look(vec![a.clone()]).ready.len(), 1);
        arrivals.give_back(&a.video);
        assert!(arrivals.is_waiting() && arrivals.taken(&a.video).is_none());
        // Given back, it is whole again when it stands still; moved away, a taken one stays.
        assert_eq!(arrivals.look(vec![a.clone()]).ready.len(), 1);
        arrivals.look(vec![entry("c", Some(1), 1)]);
        let all = arrivals.into_entries();
        assert_eq!(names(&all), ["a", "c"]);
        assert_eq!(all[1].problem.as_deref(), Some(UNFINISHED));
    }
}
