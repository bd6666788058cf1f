//! The name of an object, and the only way from such a name to a path.

use std::path::PathBuf;

/// Longest key in bytes, as S3 has it.
pub const MAX_KEY_BYTES: usize = 1024;

/// Longest part of a key that a file can be named after: the limit of the usual file systems.
const MAX_PART_BYTES: usize = 255;

/// An object's name below a store's root, with `/` between parts.
///
/// Invariants: 1 to [`MAX_KEY_BYTES`] bytes of UTF-8 without NUL. Anything else that a bucket can hold
/// is a key (`..`, `a//b`, a trailing `/`): a key is only a name and becomes a path by
/// [`ObjectKey::to_relative_path`] alone, which refuses what would leave its root.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ObjectKey(String);

/// Why a text is no key, or a key no path.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum KeyError {
    /// Empty, too long, or with a NUL.
    #[error("{key:?} is no object key: a key has 1 to {MAX_KEY_BYTES} bytes and no NUL")]
    NoKey {
        /// The text.
        key: String,
    },
    /// Not the name of a file below the root.
    #[error(
        "the object key {key:?} cannot be a file's path: every part between slashes must be a plain name of at most {MAX_PART_BYTES} bytes, not empty, `.`, `..` or a partial file's; rename the object"
    )]
    NoPath {
        /// The key.
        key: String,
    },
}

impl ObjectKey {
    /// Takes a name.
    ///
    /// # Errors
    /// [`KeyError::NoKey`].
    pub fn new(key: impl Into<String>) -> Result<Self, KeyError> {
        let key = key.into();
        if key.is_empty() || key.len() > MAX_KEY_BYTES || key.contains('\0') {
            return Err(KeyError::NoKey { key });
        }
        Ok(Self(key))
    }

    /// A key below `prefix` that is a function of the content: putting the same bytes again changes
    /// nothing, so that a put can be repeated and needs no condition.
    ///
    /// # Errors
    /// [`KeyError::NoKey`], when prefix and extension are too long.
    pub fn of_content(prefix: &str, content: &[u8], extension: &str) -> Result<Self, KeyError> {
        Self::new(format!(
            "{prefix}{}.{extension}",
            blake3::hash(content).to_hex()
        ))
    }

    /// The name.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// The path of the file that holds the object, relative to a directory store's root.
    ///
    /// # Errors
    /// [`KeyError::NoPath`].
    pub fn to_relative_path(&self) -> Result<PathBuf, KeyError> {
        let plain = |part: &str| {
            !matches!(part, "" | "." | "..")
                && part.len() <= MAX_PART_BYTES
                && !part.contains(std::path::is_separator)
                && !is_partial(part)
        };
        if self.0.split('/').all(plain) {
            Ok(self.0.split('/').collect())
        } else {
            Err(KeyError::NoPath {
                key: self.0.clone(),
            })
        }
    }
}

impl std::fmt::Display for ObjectKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

/// How the names of partial files end; they begin with a dot.
pub(super) const PARTIAL_SUFFIX: &str = ".partial";

/// Whether a file of this name is one that is still being written.
pub(super) fn is_partial(name: &str) -> bool {
    name.starts_with('.') && name.ends_with(PARTIAL_SUFFIX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hostile_keys_are_names_but_no_paths() {
        for hostile in [
            "..",
            "../x",
            "a/../b",
            "/etc/passwd",
            "a//b",
            "a/",
            ".",
            "./a",
            ".x.partial",
            &"x".repeat(256),
        ] {
            let key = ObjectKey::new(hostile).unwrap();
            assert!(
                matches!(key.to_relative_path(), Err(KeyError::NoPath { .. })),
                "{hostile}"
            );
        }
        for plain in ["a", "a/b..c/.hidden", "ünï \n/…", r"C:\x"] {
            let key = ObjectKey::new(plain).unwrap();
            assert_eq!(key.to_relative_path().unwrap(), PathBuf::from(plain));
        }
        for no_key in [String::new(), "a\0b".into(), "x".repeat(1025)] {
            assert!(ObjectKey::new(no_key).is_err());
        }
    }

    #[test]
    fn equal_content_has_one_key() {
        let key = |content| ObjectKey::of_content("parts/", content, "parquet").unwrap();
        assert_eq!(key(b"a"), key(b"a"));
        assert_ne!(key(b"a"), key(b"b"));
        assert!(key(b"a").as_str().starts_with("parts/"));
    }
}
