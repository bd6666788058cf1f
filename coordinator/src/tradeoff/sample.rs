//! Which videos stand for the corpus: a sample that is seeded and stratified.
//!
//! A stratum is a group or, without groups, a directory. Each has a share of the sample proportional to its
//! size (largest remainder), and at least one video while there are places enough. Within a stratum videos
//! are taken in the order of a keyed hash of their names, so that a sample does not depend on the order of
//! the list, and a larger one holds nearly all of a smaller one: what was measured for that is taken over.

use std::collections::BTreeMap;

use crate::corpus::Entry;

/// A video of the sample.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sampled {
    /// The video.
    pub(super) entry: Entry,
    /// How many videos of the corpus it stands for: its stratum's over those drawn of it.
    pub(super) weight: f64,
}

/// Draws `size` of the readable entries (all, where there are no more), by the video's name.
pub(super) fn draw(entries: &[Entry], size: usize, seed: u64) -> Vec<Sampled> {
    let readable = entries
        .iter()
        .filter(|entry| entry.bytes.is_some() && entry.modified_ns.is_some());
    let mut strata: BTreeMap<&str, Vec<&Entry>> = BTreeMap::new();
    for entry in readable {
        strata.entry(stratum(entry)).or_default().push(entry);
    }
    let sizes: Vec<usize> = strata.values().map(Vec::len).collect();
    let mut drawn = Vec::new();
    for (mut members, count) in strata.into_values().zip(allotted(&sizes, size)) {
        let weight = members.len() as f64 / count.max(1) as f64;
        members.sort_by_cached_key(|entry| key(seed, entry.video.as_str()));
        drawn.extend(members.into_iter().take(count).map(|entry| Sampled {
            entry: entry.clone(),
            weight,
        }));
    }
    drawn.sort_by(|a, b| a.entry.video.cmp(&b.entry.video));
    drawn
}

/// What an entry is alike.
fn stratum(entry: &Entry) -> &str {
    let directory = || entry.video.as_str().rsplit_once('/').map_or("", |(d, _)| d);
    entry.group.as_deref().unwrap_or_else(directory)
}

fn key(seed: u64, video: &str) -> [u8; 32] {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&seed.to_le_bytes());
    hasher.update(video.as_bytes());
    *hasher.finalize().as_bytes()
}

/// `size` places over strata of these sizes: one each, largest first, then by largest remainder of the
/// proportional share.
fn allotted(sizes: &[usize], size: usize) -> Vec<usize> {
    let total: usize = sizes.iter().sum();
    let size = size.min(total);
    let mut places = vec![0; sizes.len()];
    let mut by_size: Vec<usize> = (0..sizes.len()).collect();
    by_size.sort_by_key(|&stratum| std::cmp::Reverse(sizes[stratum]));
    for &stratum in by_size.iter().take(size) {
        places[stratum] = usize::from(sizes[stratum] > 0);
    }
    // Each further place goes to the stratum that is furthest below its share.
    let mut left = size - places.iter().sum::<usize>();
    while left > 0 {
        let short = |stratum: usize| {
            let share = (sizes[stratum] * size) as f64 / total as f64;
            share - places[stratum] as f64
        };
        let open = by_size
            .iter()
            .copied()
            .filter(|&stratum| places[stratum] < sizes[stratum]);
        let Some(most) = open.max_by(|&a, &b| short(a).total_cmp(&short(b)).then(b.cmp(&a))) else {
            break;
        };
        places[most] += 1;
        left -= 1;
    }
    places
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::corpus::file_entry;

    fn names(sample: &[Sampled]) -> Vec<&str> {
        sample.iter().map(|s| s.entry.video.as_str()).collect()
    }

    #[test]
    fn the_order_of_the_list_does_not_matter_and_the_seed_does() {
        let mut entries: Vec<Entry> = (0..40)
            .map(|k| file_entry(&format!("{}/{k:02}.mp4", if k < 30 { "a" } else { "b" })))
            .collect();
        let drawn = draw(&entries, 8, 1);
        assert_eq!(drawn.len(), 8);
        let of_b = drawn.iter().filter(|s| s.entry.video.as_str() > "b");
        assert!(of_b.clone().count() == 2 && of_b.into_iter().all(|s| s.weight == 5.0));
        // Every video of the corpus is stood for.
        assert_eq!(drawn.iter().map(|s| s.weight).sum::<f64>(), 40.0);
        entries.reverse();
        assert_eq!(draw(&entries, 8, 1), drawn);
        assert_ne!(names(&draw(&entries, 8, 2)), names(&drawn));
        let more = draw(&entries, 16, 1);
        assert!(
            drawn
                .iter()
                .all(|s| names(&more).contains(&s.entry.video.as_str()))
        );
    }

    #[test]
    fn groups_go_before_directories_and_what_cannot_be_read_is_left_out() {
        let mut entries: Vec<Entry> = (0..6).map(|k| file_entry(&format!("{k}.mp4"))).collect();
        entries[0].group = Some("rare".into());
        entries[1].bytes = None;
        let drawn = draw(&entries, 2, 0);
        assert!(names(&drawn).contains(&"0.mp4"));
        assert_eq!(draw(&entries, 99, 0).len(), 5);
        assert!(draw(&[], 5, 0).is_empty());
    }

    proptest! {
        #[test]
        fn places_are_proportional(sizes in prop::collection::vec(0_usize..50, 0..8), size in 0_usize..120) {
            let places = allotted(&sizes, size);
            let total: usize = sizes.iter().sum();
            prop_assert_eq!(places.iter().sum::<usize>(), size.min(total));
            let least = size >= sizes.len();
            for (&n, &k) in sizes.iter().zip(&places) {
                prop_assert!(k <= n && (k > 0 || n == 0 || !least));
                // Away from the guarantee of one, a share is met to within a place.
                let share = (n * size.min(total)) as f64 / total.max(1) as f64;
                prop_assert!(k as f64 <= share.max(1.0) + 1.0);
            }
        }
    }
}
