//! The output directory: files appear under their name whole, or not at all.
//!
//! A file is written beside its final place, flushed to the disk, then renamed; on any failure the
//! partial file is removed. Names are relative paths with `/` between parts.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Component, Path, PathBuf};

use crate::publish::encode::EncodeError;
use crate::publish::error::PublishError;

/// A directory that a run publishes into.
#[derive(Debug, Clone)]
pub struct OutDir {
    root: PathBuf,
}

impl OutDir {
    /// Opens the directory, making it where it does not exist.
    ///
    /// # Errors
    /// [`PublishError`] when it cannot be made.
    pub fn create(root: impl Into<PathBuf>) -> Result<Self, PublishError> {
        let root = root.into();
        fs::create_dir_all(&root)
            .map_err(|source| PublishError::from_io(&root.to_string_lossy(), source))?;
        Ok(Self { root })
    }

    /// The directory.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// Puts `bytes` under `name`, replacing what stood there in one step.
    ///
    /// # Errors
    /// [`PublishError`] naming the file and the remedy; the old file, if any, is untouched.
    pub fn put_atomic(&self, name: &str, bytes: &[u8]) -> Result<(), PublishError> {
        self.put_atomic_with(name, |out| Ok(out.write_all(bytes)?))
    }

    /// Puts `bytes` as [`put_atomic`](Self::put_atomic) does, without waiting for the disk: for many small files
    /// that every run compares with what they should hold, so that one lost with the power comes back.
    ///
    /// # Errors
    /// [`PublishError`] naming the file and the remedy; the old file, if any, is untouched.
    pub fn put_unsynced(&self, name: &str, bytes: &[u8]) -> Result<(), PublishError> {
        self.put(name, false, |out| Ok(out.write_all(bytes)?))
    }

    /// Puts what `encode` writes under `name`, replacing what stood there in one step.
    ///
    /// # Errors
    /// [`PublishError`] naming the file and the remedy; the old file, if any, is untouched.
    pub fn put_atomic_with(
        &self,
        name: &str,
        encode: impl FnOnce(&mut (dyn Write + Send)) -> Result<(), EncodeError>,
    ) -> Result<(), PublishError> {
        self.put(name, true, encode)
    }

    fn put(
        &self,
        name: &str,
        synced: bool,
        encode: impl FnOnce(&mut (dyn Write + Send)) -> Result<(), EncodeError>,
    ) -> Result<(), PublishError> {
        let target = self.resolve(name)?;
        let io_error = |source| PublishError::from_io(name, source);
        let parent = target.parent().unwrap_or(&self.root);
        fs::create_dir_all(parent).map_err(io_error)?;

        let partial = Partial::beside(&target);
        let file = partial.open().map_err(io_error)?;
        let file = fill(file, name, encode)?;
        if synced {
            file.sync_all().map_err(io_error)?;
        }
        fs::rename(&partial.path, &target).map_err(io_error)?;
        if synced {
            sync_directory(parent).map_err(io_error)?;
        }
        Ok(())
    }

    /// Removes `name` if it is there.
    ///
    /// # Errors
    /// [`PublishError`] when it is there and cannot be removed.
    pub fn remove(&self, name: &str) -> Result<(), PublishError> {
        match fs::remove_file(self.resolve(name)?) {
            Err(source) if source.kind() != io::ErrorKind::NotFound => {
                Err(PublishError::from_io(name, source))
            }
            _ => Ok(()),
        }
    }

    /// Removes partial files that a killed run left in this directory or right below it. Only for
    /// whoever holds the directory's lease: a partial file may be another process' work.
    ///
    /// # Errors
    /// [`PublishError`] when the directory cannot be read or a partial file cannot be removed.
    pub fn sweep_partials(&self) -> Result<(), PublishError> {
        let below = |directory: &Path| -> io::Result<Vec<fs::DirEntry>> {
            fs::read_dir(directory)?.collect()
        };
        let io_error = |source| PublishError::from_io(&self.root.to_string_lossy(), source);
        let mut entries = below(&self.root).map_err(io_error)?;
        for index in 0..entries.len() {
            if entries[index].file_type().is_ok_and(|kind| kind.is_dir()) {
                entries.extend(below(&entries[index].path()).map_err(io_error)?);
            }
        }
        for entry in entries {
            if is_partial(&entry.file_name()) {
                fs::remove_file(entry.path()).map_err(io_error)?;
            }
        }
        Ok(())
    }

    fn resolve(&self, name: &str) -> Result<PathBuf, PublishError> {
        let path = Path::new(name);
        let plain = path.file_name().is_some()
            && path
                .components()
                .all(|part| matches!(part, Component::Normal(_)));
        if !plain {
            return Err(PublishError::Name {
                file: name.to_owned(),
            });
        }
        Ok(self.root.join(path))
    }
}

/// How the names of partial files end; they begin with a dot.
const PARTIAL_SUFFIX: &str = ".partial";

fn is_partial(name: &std::ffi::OsStr) -> bool {
    let name = name.to_string_lossy();
    name.starts_with('.') && name.ends_with(PARTIAL_SUFFIX)
}

/// The file while it is being written; whatever is left of it goes when this does.
struct Partial {
    path: PathBuf,
}

impl Partial {
    fn beside(target: &Path) -> Self {
        let mut name = OsString::from(".");
        name.push(target.file_name().unwrap_or_default());
        name.push(format!(".{}{PARTIAL_SUFFIX}", std::process::id()));
        Self {
            path: target.with_file_name(name),
        }
    }

    fn open(&self) -> io::Result<File> {
        // A killed process with this id may have left one; `create_new` then follows no link.
        match fs::remove_file(&self.path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        File::create_new(&self.path)
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        // After the rename there is nothing to remove; after a failure the failure itself is told.
        drop(fs::remove_file(&self.path));
    }
}

/// Writes all of it; gives the file back.
fn fill(
    file: File,
    name: &str,
    encode: impl FnOnce(&mut (dyn Write + Send)) -> Result<(), EncodeError>,
) -> Result<File, PublishError> {
    let io_error = |source| PublishError::from_io(name, source);
    let mut out = BufWriter::new(Watched {
        inner: Behind::new(file),
        failure: None,
    });
    let encoded = encode(&mut out);
    if let Some(failure) = out.get_mut().failure.take() {
        return Err(io_error(failure));
    }
    encoded.map_err(|source| PublishError::Encode {
        file: name.to_owned(),
        source,
    })?;
    out.flush().map_err(io_error)?;
    let out = out
        .into_inner()
        .map_err(|error| io_error(error.into_error()))?;
    Ok(out.inner.file)
}

/// Bytes written between two words to the system.
const BEHIND_BYTES: u64 = 16 << 20;

/// Lets the system write what was written, and forget it: tables are written once and have to reach
/// the disk before they are named; gigabytes of them would push everything else out of memory.
struct Behind {
    file: File,
    written: u64,
    told: u64,
}

impl Behind {
    fn new(file: File) -> Self {
        Self {
            file,
            written: 0,
            told: 0,
        }
    }
}

impl Write for Behind {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let n = self.file.write(bytes)?;
        self.written += n as u64;
        if self.written - self.told >= BEHIND_BYTES {
            // From two such pieces before on: they have reached the disk meanwhile. Nothing depends
            // on it: a file system that knows no advice keeps its pages.
            let from = self.told.saturating_sub(2 * BEHIND_BYTES);
            let len = std::num::NonZeroU64::new(self.written - from);
            let _ = rustix::fs::fadvise(&self.file, from, len, rustix::fs::Advice::DontNeed);
            self.told = self.written;
        }
        Ok(n)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

/// Keeps the first error of the disk: encoders wrap it, or turn it into text.
struct Watched<W> {
    inner: W,
    failure: Option<io::Error>,
}

impl<W> Watched<W> {
    fn note<T>(&mut self, result: io::Result<T>) -> io::Result<T> {
        if let Err(error) = &result
            && error.kind() != io::ErrorKind::Interrupted
            && self.failure.is_none()
        {
            self.failure = Some(match error.raw_os_error() {
                Some(code) => io::Error::from_raw_os_error(code),
                None => io::Error::new(error.kind(), error.to_string()),
            });
        }
        result
    }
}

impl<W: Write> Write for Watched<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let result = self.inner.write(bytes);
        self.note(result)
    }

    fn flush(&mut self) -> io::Result<()> {
        let result = self.inner.flush();
        self.note(result)
    }
}

/// Makes a rename survive a power failure.
fn sync_directory(directory: &Path) -> io::Result<()> {
    if cfg!(unix) {
        File::open(directory)?.sync_all()?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(root: &Path) -> Vec<String> {
        let mut names: Vec<_> = fs::read_dir(root)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn puts_replaces_and_removes() {
        let root = tempfile::tempdir().unwrap();
        let out = OutDir::create(root.path().join("new/out")).unwrap();
        out.put_atomic("manifests/keep.jsonl", b"one").unwrap();
        out.put_atomic("manifests/keep.jsonl", b"two").unwrap();
        assert_eq!(
            fs::read(out.root().join("manifests/keep.jsonl")).unwrap(),
            b"two"
        );
        assert_eq!(names(&out.root().join("manifests")), ["keep.jsonl"]);
        out.remove("manifests/keep.jsonl").unwrap();
        out.remove("manifests/keep.jsonl").unwrap();
        assert!(names(&out.root().join("manifests")).is_empty());
    }

    #[test]
    fn a_killed_run_leaves_nothing_after_the_sweep() {
        let root = tempfile::tempdir().unwrap();
        let out = OutDir::create(root.path()).unwrap();
        out.put_atomic("manifests/keep.jsonl", b"whole").unwrap();
        fs::write(root.path().join(".scores.csv.7.partial"), b"half").unwrap();
        fs::write(root.path().join("manifests/.drop.jsonl.7.partial"), b"half").unwrap();
        fs::write(root.path().join("mine.partial"), b"not ours").unwrap();
        out.sweep_partials().unwrap();
        assert_eq!(names(root.path()), ["manifests", "mine.partial"]);
        assert_eq!(names(&root.path().join("manifests")), ["keep.jsonl"]);
    }

    #[test]
    fn refuses_names_that_leave_the_directory() {
        let root = tempfile::tempdir().unwrap();
        let out = OutDir::create(root.path()).unwrap();
        for name in ["", "..", "../x", "/etc/x", "a/../../x", "."] {
            assert!(
                matches!(out.put_atomic(name, b""), Err(PublishError::Name { .. })),
                "{name}"
            );
        }
        assert!(names(root.path()).is_empty());
    }

    #[test]
    fn a_directory_in_the_way_leaves_no_partial_file() {
        let root = tempfile::tempdir().unwrap();
        let out = OutDir::create(root.path()).unwrap();
        fs::create_dir_all(root.path().join("scores.csv/inside")).unwrap();
        let error = out.put_atomic("scores.csv", b"x").unwrap_err();
        assert!(matches!(error, PublishError::InTheWay { .. }), "{error:?}");
        assert!(error.to_string().contains("scores.csv"));
        assert_eq!(names(root.path()), ["scores.csv"]);
    }

    #[test]
    fn a_file_where_the_folder_belongs_is_in_the_way() {
        let root = tempfile::tempdir().unwrap();
        let out = OutDir::create(root.path()).unwrap();
        fs::write(root.path().join("manifests"), b"mine").unwrap();
        let error = out.put_atomic("manifests/keep.jsonl", b"x").unwrap_err();
        assert!(matches!(error, PublishError::InTheWay { .. }), "{error:?}");
        assert_eq!(fs::read(root.path().join("manifests")).unwrap(), b"mine");
    }

    #[cfg(unix)]
    #[test]
    fn a_read_only_directory_is_not_writable() {
        use std::os::unix::fs::PermissionsExt;
        let root = tempfile::tempdir().unwrap();
        let out = OutDir::create(root.path()).unwrap();
        fs::set_permissions(root.path(), fs::Permissions::from_mode(0o555)).unwrap();
        if File::create(root.path().join("probe")).is_ok() {
            println!("skipped: permissions do not bind this user");
            return;
        }
        let error = out.put_atomic("scores.csv", b"x").unwrap_err();
        assert!(
            matches!(error, PublishError::NotWritable { .. }),
            "{error:?}"
        );
        assert!(names(root.path()).is_empty());
    }

    #[test]
    fn a_failing_encoder_leaves_the_old_file_and_no_partial_one() {
        let root = tempfile::tempdir().unwrap();
        let out = OutDir::create(root.path()).unwrap();
        out.put_atomic("scores.csv", b"old").unwrap();
        let error = out
            .put_atomic_with("scores.csv", |writer| {
                writer.write_all(b"half")?;
                Err(EncodeError::Io(io::Error::other("no such value")))
            })
            .unwrap_err();
        assert!(matches!(error, PublishError::Encode { .. }), "{error:?}");
        assert_eq!(names(root.path()), ["scores.csv"]);
        assert_eq!(fs::read(root.path().join("scores.csv")).unwrap(), b"old");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_no_space_even_where_the_encoder_swallows_the_cause() {
        let full = || {
            fs::OpenOptions::new()
                .write(true)
                .open("/dev/full")
                .unwrap()
        };
        // Larger than the buffer, so that the write fails inside the encoder...
        let inside = fill(full(), "scores.jsonl", |out| {
            out.write_all(&vec![b'x'; 1 << 20])
                .map_err(|_| EncodeError::Io(io::Error::other("opaque")))
        })
        .unwrap_err();
        // ...and smaller, so that it fails at the last flush.
        let at_flush = fill(full(), "scores.jsonl", |out| Ok(out.write_all(b"x")?)).unwrap_err();
        for error in [inside, at_flush] {
            assert!(matches!(error, PublishError::NoSpace { .. }), "{error:?}");
            let text = error.to_string();
            assert!(text.contains("scores.jsonl") && text.contains("free some space"));
        }
    }
}
