//! WebDataset shards: every video of a tar is a video, read by its range of bytes.
//!
//! As the library `webdataset` reads them (`tariterators.py`): regular files in the tar's order; a file's name
//! up to the first dot after its last slash is its sample's key, the rest its field; neighbours of one key are
//! one sample. `__key__` and `__shard__` (the shard below SOURCE) are carried, and of the sample's small fields
//! what a `json` holds, and texts: `txt` as `prompt`, `NAME.txt` as `NAME`.
//!
//! Tars come from outside: of each member no more than its headers is read, and of those no more than
//! [`MAX_HEADER_BYTES`]; names are only names, links are passed over, and a member that would lie outside of the
//! file, or not in one piece, becomes a row that says so.

use std::cell::Cell;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;
use std::rc::Rc;
use std::sync::Mutex;

use plumbline_common::message::Part;
use plumbline_common::store::StoreError;
use serde_json::{Map, Value};
use tar::{Archive, Entry};

use super::tree::{ReadSeek, Tree};
use super::{Placed, Sample};
use crate::corpus::CorpusError;
use crate::corpus::files::{is_video_name, text_of};

/// The column of a sample's key.
const KEY: &str = "__key__";
/// The column of a sample's shard.
pub(super) const SHARD: &str = "__shard__";
/// The column of what a video is to show.
const PROMPT: &str = "prompt";
/// Its other usual name.
const CAPTION: &str = "caption";

/// Longest field that is carried, bytes.
const MAX_FIELD_BYTES: u64 = 64 << 10;

/// Most bytes read from one member to the next: extended headers and a field.
const MAX_HEADER_BYTES: u64 = 1 << 20;

/// Shards read at once: enough to hide the way to a store.
const SHARDS_AT_ONCE: usize = 16;

/// The first bytes of compressed files.
const COMPRESSED: [(&[u8], &str); 4] = [
    (b"\x1f\x8b", "gzip"),
    (b"\x28\xb5\x2f\xfd", "zstd"),
    (b"BZh", "bzip2"),
    (b"\xfd7zXZ", "xz"),
];

/// Reads the shards, several at once, and gives their samples in the order of `shards`.
///
/// # Errors
/// [`CorpusError`] of a store that does not answer, or that gives another version than it listed. What is wrong
/// with a shard becomes a row of the shard's name beside those of the members before.
pub(super) fn read(
    tree: &dyn Tree,
    shards: &[String],
) -> Result<Vec<(String, Vec<Sample>)>, CorpusError> {
    let waiting = Mutex::new(shards.iter().enumerate());
    let next = || waiting.lock().ok()?.next();
    let one = || -> Result<Vec<(usize, Vec<Sample>)>, CorpusError> {
        let mut done = Vec::new();
        while let Some((index, shard)) = next() {
            done.push((index, read_one(tree, shard)?));
        }
        Ok(done)
    };
    let threads = SHARDS_AT_ONCE.min(shards.len());
    let mut done = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads).map(|_| scope.spawn(one)).collect();
        let mut done = Vec::new();
        for thread in threads {
            match thread.join() {
                Ok(of_thread) => done.extend(of_thread?),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        Ok::<_, CorpusError>(done)
    })?;
    done.sort_by_key(|(index, _)| *index);
    let named = shards.iter().cloned().zip(done);
    Ok(named
        .map(|(shard, (_, samples))| (shard, samples))
        .collect())
}

fn read_one(tree: &dyn Tree, shard: &str) -> Result<Vec<Sample>, CorpusError> {
    let placed = tree.place(shard)?;
    let mut samples = Vec::new();
    let problem = match (placed.bytes, &placed.problem) {
        (Some(bytes), _) => {
            let reading = Shard {
                name: shard,
                placed: &placed,
                bytes,
            };
            match tree
                .open(shard)
                .and_then(|file| reading.members(file, &mut samples))
            {
                Ok(()) => None,
                Err(error) => match store_error(error) {
                    Ok(of_store) => return Err(of_store.into()),
                    Err(error) => Some(format!("the tar does not read to its end: {error}")),
                },
            }
        }
        (None, problem) => problem.clone(),
    };
    if let Some(problem) = problem {
        samples.push(Sample {
            name: shard.to_owned(),
            placed: placed.with_problem(problem),
            carried: Map::from_iter([(SHARD.to_owned(), shard.into())]),
        });
    }
    Ok(samples)
}

/// The store's own error, where it is one.
fn store_error(error: io::Error) -> Result<StoreError, io::Error> {
    if !error
        .get_ref()
        .is_some_and(|inner| inner.is::<StoreError>())
    {
        return Err(error);
    }
    let kind = error.kind();
    match error
        .into_inner()
        .map(|inner| inner.downcast::<StoreError>())
    {
        Some(Ok(of_store)) => Ok(*of_store),
        Some(Err(other)) => Err(io::Error::other(other)),
        None => Err(kind.into()),
    }
}

/// Tars are made of these, and end with two of zeros.
const BLOCK_BYTES: usize = 512;

/// A shard that is read.
struct Shard<'a> {
    name: &'a str,
    placed: &'a Placed,
    bytes: u64,
}

/// The files of one key, as far as they came.
#[derive(Default)]
struct Open {
    key: String,
    videos: Vec<(String, Placed)>,
    carried: Map<String, Value>,
}

impl Shard<'_> {
    fn members(
        &self,
        mut file: Box<dyn ReadSeek + '_>,
        samples: &mut Vec<Sample>,
    ) -> io::Result<()> {
        let mut head = [0; 8];
        let count = file.read(&mut head)?;
        let head = &head[..count];
        if let Some((_, how)) = COMPRESSED.iter().find(|(magic, _)| head.starts_with(magic)) {
            return Err(io::Error::other(format!(
                "it is compressed ({how}), so that no member can be read without all before it; unpack it to a plain .tar"
            )));
        }
        file.rewind()?;
        let left = Rc::new(Cell::new(MAX_HEADER_BYTES));
        let metered = Metered {
            file,
            left: Rc::clone(&left),
        };
        let mut archive = Archive::new(metered);
        let mut open = Open::default();
        let mut entries = archive.entries_with_seek()?;
        loop {
            left.set(MAX_HEADER_BYTES);
            let Some(member) = entries.next() else { break };
            let member = member.inspect_err(|_| self.close(std::mem::take(&mut open), samples))?;
            self.take(member, &mut open, samples)?;
        }
        self.close(open, samples);
        let is_told = samples.iter().any(|sample| sample.placed.problem.is_some());
        if self.bytes < BLOCK_BYTES as u64 || is_told {
            return Ok(());
        }
        // A cut between two members, or within one that is no video, passes for the end.
        let mut last = [0; BLOCK_BYTES];
        let mut file = archive.into_inner().file;
        file.seek(SeekFrom::Start(self.bytes - BLOCK_BYTES as u64))?;
        file.read_exact(&mut last)?;
        if last.iter().any(|&byte| byte != 0) {
            return Err(io::Error::other(
                "it lacks the zeros that every tar ends with: it is truncated; copy it again",
            ));
        }
        Ok(())
    }

    /// Takes a member into its sample.
    fn take<R: Read>(
        &self,
        mut member: Entry<'_, R>,
        open: &mut Open,
        samples: &mut Vec<Sample>,
    ) -> io::Result<()> {
        let kind = member.header().entry_type();
        if !(kind.is_file() || kind.is_contiguous() || kind.is_gnu_sparse()) {
            return Ok(());
        }
        let path = text_of(&member.path_bytes());
        let Some((key, field)) = key_and_field(&path) else {
            return Ok(());
        };
        if open.key != key {
            self.close(std::mem::take(open), samples);
            key.clone_into(&mut open.key);
        }
        let in_pieces = kind.is_gnu_sparse() || is_pax_sparse(&mut member);
        if is_video_name(Path::new(&path)) {
            let placed = self.member(member.raw_file_position(), member.size(), in_pieces);
            open.videos.push((path, placed));
        } else if member.size() <= MAX_FIELD_BYTES && !in_pieces {
            read_field(&mut member, field, &mut open.carried)?;
        }
        Ok(())
    }

    fn member(&self, offset: u64, bytes: u64, in_pieces: bool) -> Placed {
        if in_pieces {
            return self.placed.clone().with_problem(
                "the member is stored in pieces (sparse); make the tar anew without --sparse"
                    .to_owned(),
            );
        }
        if offset.checked_add(bytes).is_none_or(|end| end > self.bytes) {
            return self.placed.clone().with_problem(
                "the tar ends within this member: it is truncated; copy it again".to_owned(),
            );
        }
        self.placed.clone().part(Part::Bytes { offset, bytes })
    }

    /// The videos of a sample that has come to its end.
    fn close(&self, sample: Open, samples: &mut Vec<Sample>) {
        let mut carried = sample.carried;
        if let (None, Some(caption)) = (carried.get(PROMPT), carried.get(CAPTION)) {
            carried.insert(PROMPT.to_owned(), caption.clone());
        }
        carried.insert(KEY.to_owned(), sample.key.into());
        carried.insert(SHARD.to_owned(), self.name.into());
        for (path, placed) in sample.videos {
            samples.push(Sample {
                name: format!("{}/{}", self.name, path.trim_start_matches("./")),
                placed,
                carried: carried.clone(),
            });
        }
    }
}

/// Key and field of a sample's file; `None` for one that is of no sample.
fn key_and_field(path: &str) -> Option<(&str, &str)> {
    let name_at = path.rfind('/').map_or(0, |slash| slash + 1);
    let dot = path.get(name_at..)?.find('.')?;
    let is_of_the_shard = name_at == 0 && path.starts_with("__") && path.ends_with("__");
    if dot == 0 || is_of_the_shard {
        return None;
    }
    Some((path.get(..name_at + dot)?, path.get(name_at + dot + 1..)?))
}

/// Whether a member's extended header says that its content is a map of pieces (POSIX tars of GNU tar).
fn is_pax_sparse<R: Read>(member: &mut Entry<'_, R>) -> bool {
    let Ok(Some(extensions)) = member.pax_extensions() else {
        return false;
    };
    let mut keys = extensions.flatten().map(|extension| extension.key_bytes());
    keys.any(|key| key.starts_with(b"GNU.sparse."))
}

/// Carries a field, if it is text that a column can hold; the fields of `json` by their names.
fn read_field(
    member: &mut impl Read,
    field: &str,
    carried: &mut Map<String, Value>,
) -> io::Result<()> {
    let column = match field.to_ascii_lowercase().as_str() {
        "txt" => PROMPT.to_owned(),
        "json" => String::new(),
        other => match other.strip_suffix(".txt") {
            Some(name) => name.to_owned(),
            None => return Ok(()),
        },
    };
    let mut content = Vec::new();
    member.read_to_end(&mut content)?;
    if column.is_empty() {
        // What is no object is some other field's business.
        if let Ok(Value::Object(fields)) = serde_json::from_slice(&content) {
            carried.extend(fields);
        }
    } else if let Ok(text) = String::from_utf8(content) {
        carried.insert(column, text.trim().into());
    }
    Ok(())
}

/// A reader that gives so many bytes and no more: extended headers state their own length.
struct Metered<R> {
    file: R,
    left: Rc<Cell<u64>>,
}

impl<R: Read> Read for Metered<R> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read(into)?;
        let left = self.left.get().checked_sub(count as u64);
        self.left.set(left.ok_or_else(|| {
            io::Error::other(format!("a header of more than {MAX_HEADER_BYTES} bytes"))
        })?);
        Ok(count)
    }
}

impl<R: Seek> Seek for Metered<R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_those_of_the_library() {
        for (path, expected) in [
            ("0007.mp4", Some(("0007", "mp4"))),
            ("./a.b/0007.left.mp4", Some(("./a.b/0007", "left.mp4"))),
            ("a/.hidden.mp4", None),
            ("noext", None),
            ("dir.d/noext", None),
            ("__index__.json__", None),
            ("a/__b__.txt__", Some(("a/__b__", "txt__"))),
            ("x.", Some(("x", ""))),
            ("", None),
        ] {
            assert_eq!(key_and_field(path), expected, "{path}");
        }
    }
}
