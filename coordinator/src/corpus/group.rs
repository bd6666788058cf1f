//! `--group-by COLUMN|path:N|prefix:SEP`: which group a video belongs to.

use std::str::FromStr;

use plumbline_common::id::VideoId;

use super::CorpusError;

/// Where the group of a video comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum GroupBy {
    /// A column carried through from a list.
    Column(String),
    /// The N-th directory below SOURCE, counted from 1.
    Path(usize),
    /// The file name before the first occurrence of a separator.
    Prefix(String),
}

impl FromStr for GroupBy {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        if let Some(n) = text.strip_prefix("path:") {
            return match n.parse() {
                Ok(n) if n >= 1 => Ok(Self::Path(n)),
                _ => Err(format!(
                    "path:{n}: N is a directory's number below SOURCE, from 1, as in path:1"
                )),
            };
        }
        if let Some(separator) = text.strip_prefix("prefix:") {
            if separator.is_empty() {
                return Err("prefix: needs a separator, as in prefix:__".into());
            }
            return Ok(Self::Prefix(separator.into()));
        }
        if text.is_empty() {
            return Err("names a column, path:N or prefix:SEP".into());
        }
        Ok(Self::Column(text.into()))
    }
}

impl std::fmt::Display for GroupBy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Column(column) => write!(f, "{column}"),
            Self::Path(n) => write!(f, "path:{n}"),
            Self::Prefix(separator) => write!(f, "prefix:{separator}"),
        }
    }
}

impl GroupBy {
    /// The group of one video; `None` where it has none (no such directory, no separator).
    ///
    /// # Errors
    /// [`CorpusError::UnknownColumn`].
    pub fn group(
        &self,
        video: &VideoId,
        carried: &serde_json::Map<String, serde_json::Value>,
    ) -> Result<Option<String>, CorpusError> {
        let mut parts = video.as_str().split('/').rev();
        let file_name = parts.next().unwrap_or_default();
        Ok(match self {
            Self::Column(column) => match carried.get(column) {
                Some(serde_json::Value::Null) => None,
                Some(serde_json::Value::String(text)) => Some(text.clone()),
                Some(other) => Some(other.to_string()),
                None => {
                    let names: Vec<&str> = carried.keys().map(String::as_str).collect();
                    return Err(CorpusError::UnknownColumn {
                        column: column.clone(),
                        known: if names.is_empty() {
                            "no columns besides video (path:N and prefix:SEP group by name)".into()
                        } else {
                            names.join(", ")
                        },
                    });
                }
            },
            Self::Path(n) => parts.rev().nth(n - 1).map(str::to_owned),
            Self::Prefix(separator) => file_name
                .split_once(separator.as_str())
                .map(|(prefix, _)| prefix.to_owned()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn group(rule: &str, video: &str) -> Option<String> {
        let rule: GroupBy = rule.parse().unwrap();
        rule.group(&VideoId::new(video).unwrap(), &serde_json::Map::new())
            .unwrap()
    }

    #[test]
    fn groups_come_from_directories_and_names() {
        assert_eq!(group("path:1", "a/b/c.mp4").as_deref(), Some("a"));
        assert_eq!(group("path:2", "a/b/c.mp4").as_deref(), Some("b"));
        assert_eq!(group("path:3", "a/b/c.mp4"), None);
        assert_eq!(
            group("prefix:__", "a__x/bridge__1__2.mp4").as_deref(),
            Some("bridge")
        );
        assert_eq!(group("prefix:__", "plain.mp4"), None);
    }

    #[test]
    fn nonsense_is_refused_with_an_example() {
        assert!("path:0".parse::<GroupBy>().unwrap_err().contains("path:1"));
        assert!(
            "prefix:"
                .parse::<GroupBy>()
                .unwrap_err()
                .contains("prefix:__")
        );
    }

    #[test]
    fn a_column_must_exist() {
        let carried = serde_json::json!({"task": "pick", "seed": 3});
        let carried = carried.as_object().unwrap();
        let video = VideoId::new("v").unwrap();
        assert_eq!(
            GroupBy::Column("seed".into())
                .group(&video, carried)
                .unwrap()
                .as_deref(),
            Some("3")
        );
        let error = GroupBy::Column("sed".into())
            .group(&video, carried)
            .unwrap_err();
        assert!(error.to_string().contains("task, seed"), "{error}");
    }
}
