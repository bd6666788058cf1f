//! Lists of videos: the same bytes as each of the formats.

use plumbline_coordinator::corpus::{self, Choice};

pub(crate) fn target(bytes: &[u8]) {
    for name in ["l.txt", "l.csv", "l.jsonl", "l.parquet"] {
        let path = crate::as_file(name, bytes);
        if let Ok(lines) = corpus::read_list(&path) {
            assert!(lines.iter().all(|line| !line.video.is_empty()), "{name}");
        }
        // The corpus of a parquet file of that many rows is the same code again.
        if name != "l.parquet" {
            let source = path.to_string_lossy().into_owned();
            let listing = corpus::freeze(&[source], &Choice::default(), "/nowhere".as_ref());
            let Ok(listing) = listing else { continue };
            let names = listing.entries.iter().map(|entry| &entry.video);
            assert!(
                names.is_sorted_by(|a, b| a < b),
                "{name}: named once, in order"
            );
        }
    }
}
