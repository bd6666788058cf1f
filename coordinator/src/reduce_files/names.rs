//! Names in the order of their bytes, eight bytes at a time.
//!
//! Names of a fleet share long beginnings, which comparing them pair by pair goes through again and
//! again. Here the next eight bytes of each are one integer beside its row: parts of equal integers
//! are sorted by the eight bytes after, and what all names of a part share is passed over once.

use arrow_array::{Array, StringArray};

/// Parts of at most so many names are compared pair by pair.
const FEW: usize = 16;

/// A name's next bytes, and its row.
type Entry = (u64, u32);

/// Rows by name, ascending; equal names lie side by side.
pub(super) fn order(names: &StringArray) -> Vec<u32> {
    let mut entries: Vec<Entry> = (0..names.len() as u32).map(|row| (0, row)).collect();
    sort(&mut entries, names, 0);
    entries.into_iter().map(|(_, row)| row).collect()
}

/// Sorts names that share their first `depth` bytes.
fn sort(part: &mut [Entry], names: &StringArray, mut depth: usize) {
    let name = |entry: &Entry| names.value(entry.1 as usize).as_bytes();
    let longest = part.iter().map(|entry| name(entry).len()).max();
    let longest = longest.unwrap_or_default();
    if part.len() <= FEW {
        part.sort_unstable_by(|a, b| name(a).cmp(name(b)));
        return;
    }
    loop {
        if depth >= longest {
            // They differ in how many zero bytes they end in, if at all.
            part.sort_unstable_by_key(|entry| name(entry).len());
            return;
        }
        for entry in part.iter_mut() {
            entry.0 = word(name(entry), depth);
        }
        depth += size_of::<u64>();
        if part.iter().any(|entry| entry.0 != part[0].0) {
            break;
        }
    }
    part.sort_unstable();
    for equal in part.chunk_by_mut(|a, b| a.0 == b.0) {
        if equal.len() > 1 {
            sort(equal, names, depth);
        }
    }
}

/// Eight bytes of a name, zeros where it has ended: integers of the same order.
fn word(name: &[u8], depth: usize) -> u64 {
    let rest = name.get(depth..).unwrap_or_default();
    let mut word = [0; size_of::<u64>()];
    let n = rest.len().min(word.len());
    word[..n].copy_from_slice(&rest[..n]);
    u64::from_be_bytes(word)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Texts of few letters, the zero byte among them, so that beginnings are shared and ends count.
    fn text() -> impl Strategy<Value = String> {
        let letters = prop::sample::select(vec!['\0', 'a', 'b', '\u{E9}', '\u{1F34E}']);
        let tail = prop::collection::vec(letters, 0..12);
        (0_usize..4, tail)
            .prop_map(|(n, tail)| "task_017/rollout_".repeat(n) + &String::from_iter(tail))
    }

    proptest! {
        /// Against comparing pair by pair.
        #[test]
        fn is_the_order_of_bytes(mut texts in prop::collection::vec(text(), 0..300)) {
            let names = StringArray::from_iter_values(&texts);
            let found: Vec<String> =
                order(&names).into_iter().map(|row| names.value(row as usize).to_owned()).collect();
            texts.sort();
            prop_assert_eq!(found, texts);
        }
    }
}
