//! LeRobot datasets: one video per episode and camera.
//!
//! Layouts as `src/lerobot/datasets` of LeRobot writes them. v2.0 and v2.1: a file per episode and camera,
//! `meta/episodes.jsonl`. v3.0: files that hold several episodes one after another, with each one's place and
//! times in `meta/episodes/*/*.parquet`; an episode's frames are those whose presentation time is in
//! [from − half a frame, to − half a frame), so that rounded times take no frame of a neighbour.
//!
//! Carried: `episode_index`, `dataset_from_index`, `length`, `task`, `camera`. Depth maps are no pictures and are
//! left out.

use std::fmt::Write;

use plumbline_common::message::Part;
use serde::Deserialize;
use serde_json::{Map, Value};

use super::tree::Tree;
use super::{Placed, Sample, below};
use crate::corpus::CorpusError;
use crate::corpus::list::rows_of;
use crate::publish::trainer_lists::{DATASET_FROM_INDEX, EPISODE_INDEX, LENGTH};

/// The file by which a dataset is known, below its root.
pub(super) const INFO: &str = "meta/info.json";
const EPISODES_V2: &str = "meta/episodes.jsonl";
const EPISODES_V3: &str = "meta/episodes/";

const VIDEO_PATH_V2: &str =
    "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4";
const VIDEO_PATH_V3: &str = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4";

/// Files per directory, where nothing says it.
const CHUNK_FILES: u64 = 1000;

/// The column of a video's camera.
pub(in crate::corpus) const CAMERA: &str = "camera";
/// The column of what an episode is to do.
const TASK: &str = "task";

/// What is read of `meta/info.json`.
#[derive(Debug, Deserialize)]
struct Info {
    codebase_version: String,
    fps: f64,
    #[serde(default)]
    total_episodes: Option<u64>,
    #[serde(default)]
    chunks_size: Option<u64>,
    #[serde(default)]
    video_path: Option<String>,
    features: Map<String, Value>,
}

/// One episode of `meta/episodes`.
struct Episode {
    index: u64,
    row: Map<String, Value>,
}

/// The two layouts.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Layout {
    V2,
    V3,
}

/// A dataset that is read.
struct Dataset<'a> {
    tree: &'a dyn Tree,
    /// Its directory, with a slash at the end or empty.
    root: &'a str,
    info: Info,
    layout: Layout,
}

/// The videos of the dataset whose `meta/info.json` is `info`; `None` where that is another program's.
///
/// # Errors
/// [`CorpusError::List`] naming the file of its metadata that is missing or wrong.
pub(super) fn read(tree: &dyn Tree, info: &str) -> Result<Option<Vec<Sample>>, CorpusError> {
    let content = tree.read(info)?.unwrap_or_default();
    let wrong = |reason: String| CorpusError::List {
        path: tree.address(info),
        reason,
    };
    match serde_json::from_slice::<Value>(&content) {
        Ok(value) if value.get("codebase_version").is_some() => {}
        _ => return Ok(None),
    }
    let parsed: Info = serde_json::from_slice(&content).map_err(|error| {
        wrong(format!(
            "is not LeRobot's info.json ({error}); copy the dataset again"
        ))
    })?;
    let layout = match parsed.codebase_version.trim_start_matches('v') {
        "2.0" | "2.1" => Layout::V2,
        "3.0" => Layout::V3,
        other => {
            return Err(wrong(format!(
                "codebase_version {other} is not read, but 2.0, 2.1 and 3.0 are; convert the dataset with LeRobot"
            )));
        }
    };
    if !(parsed.fps > 0.0 && parsed.fps.is_finite()) {
        return Err(wrong(format!("fps is {}, but must be above 0", parsed.fps)));
    }
    let dataset = Dataset {
        tree,
        root: info.strip_suffix(INFO).unwrap_or_default(),
        info: parsed,
        layout,
    };
    dataset.samples().map(Some)
}

impl Dataset<'_> {
    fn wrong(&self, file: &str, reason: impl Into<String>) -> CorpusError {
        CorpusError::List {
            path: self.tree.address(&format!("{}{file}", self.root)),
            reason: reason.into(),
        }
    }

    fn samples(&self) -> Result<Vec<Sample>, CorpusError> {
        let cameras = self.cameras()?;
        let episodes = self.episodes(&cameras)?;
        let mut samples = Vec::with_capacity(episodes.len() * cameras.len());
        let mut first_frame = (self.layout == Layout::V2).then_some(0_u64);
        for (position, episode) in (0..).zip(&episodes) {
            let mut carried = Map::new();
            let length = episode.row.get("length").and_then(Value::as_u64);
            let from = match self.layout {
                // Frames are counted through a dataset that has every episode.
                Layout::V2 => first_frame.filter(|_| episode.index == position),
                Layout::V3 => episode
                    .row
                    .get("dataset_from_index")
                    .and_then(Value::as_u64),
            };
            first_frame = first_frame
                .zip(length)
                .and_then(|(before, length)| before.checked_add(length));
            carried.insert(EPISODE_INDEX.to_owned(), episode.index.into());
            carried.insert(DATASET_FROM_INDEX.to_owned(), from.into());
            carried.insert(LENGTH.to_owned(), length.into());
            carried.insert(TASK.to_owned(), task(&episode.row).into());
            for camera in &cameras {
                let mut carried = carried.clone();
                carried.insert(CAMERA.to_owned(), camera.as_str().into());
                samples.push(Sample {
                    name: format!("{}episode_{:06}/{camera}", self.root, episode.index),
                    placed: self.place(episode, camera)?,
                    carried,
                });
            }
        }
        Ok(samples)
    }

    /// The features that are videos of pictures.
    fn cameras(&self) -> Result<Vec<String>, CorpusError> {
        let is_of = |kind: &str, feature: &Value| {
            feature.get("dtype").and_then(Value::as_str) == Some(kind)
        };
        let features = &self.info.features;
        let cameras: Vec<String> = features
            .iter()
            .filter(|(_, feature)| is_of("video", feature) && !is_depth(feature))
            .map(|(key, _)| key.clone())
            .collect();
        if !cameras.is_empty() {
            return Ok(cameras);
        }
        let has_images = features.values().any(|feature| is_of("image", feature));
        Err(self.wrong(
            INFO,
            if has_images {
                "the dataset keeps its pictures in data/*.parquet and has no videos; convert it to videos with lerobot-edit-dataset"
            } else {
                "no feature has the dtype video, so that there is nothing to score"
            },
        ))
    }

    /// The episodes, by index, with the columns that are looked at.
    fn episodes(&self, cameras: &[String]) -> Result<Vec<Episode>, CorpusError> {
        let (place, files) = match self.layout {
            Layout::V2 => (EPISODES_V2, vec![format!("{}{EPISODES_V2}", self.root)]),
            Layout::V3 => {
                let files = self
                    .tree
                    .files_below(&format!("{}{EPISODES_V3}", self.root))?;
                let parquet = files.into_iter().filter(|file| file.ends_with(".parquet"));
                (EPISODES_V3, parquet.collect())
            }
        };
        let missing = || {
            self.wrong(
                place,
                "is missing; copy the dataset with all of its meta directory",
            )
        };
        if files.is_empty() {
            return Err(missing());
        }
        let wanted = |column: &str| {
            matches!(
                column,
                "episode_index" | "tasks" | "length" | "dataset_from_index"
            ) || column.strip_prefix("videos/").is_some_and(|rest| {
                rest.rsplit_once('/')
                    .is_some_and(|(key, _)| cameras.iter().any(|camera| camera == key))
            })
        };
        let mut episodes = Vec::new();
        for file in files {
            let content = self.tree.read(&file)?.ok_or_else(missing)?;
            let below = file.strip_prefix(self.root).unwrap_or(&file);
            let rows = rows_of(file.as_ref(), content, &wanted)
                .map_err(|reason| self.wrong(below, format!("{reason}; copy the dataset again")))?;
            for row in rows {
                let index = row
                    .get("episode_index")
                    .and_then(Value::as_u64)
                    .ok_or_else(|| {
                        self.wrong(below, "a row has no episode_index; copy the dataset again")
                    })?;
                episodes.push(Episode { index, row });
            }
        }
        episodes.sort_by_key(|episode| episode.index);
        if let Some(twice) = episodes.windows(2).find(|two| two[0].index == two[1].index) {
            let reason = format!(
                "has episode {} twice; copy the dataset again",
                twice[0].index
            );
            return Err(self.wrong(place, reason));
        }
        let (declared, listed) = (self.info.total_episodes, episodes.len() as u64);
        if declared.is_some_and(|declared| declared != listed) {
            let declared = declared.unwrap_or_default();
            return Err(self.wrong(
                place,
                format!("has {listed} episodes, but info.json declares {declared}; copy the dataset again"),
            ));
        }
        Ok(episodes)
    }

    /// Where the video of an episode is; what is wrong with it is said there.
    fn place(&self, episode: &Episode, camera: &str) -> Result<Placed, CorpusError> {
        let cell = |column: &str| episode.row.get(&format!("videos/{camera}/{column}"));
        let whole = |column: &str| cell(column).and_then(Value::as_u64);
        let chunk_files = self.info.chunks_size.unwrap_or(CHUNK_FILES).max(1);
        let fields = |field: &str| match field {
            "video_key" => Some(Field::Text(camera)),
            "episode_index" => Some(Field::Number(episode.index)),
            "episode_chunk" => Some(Field::Number(episode.index / chunk_files)),
            "chunk_index" => whole("chunk_index").map(Field::Number),
            "file_index" => whole("file_index").map(Field::Number),
            _ => None,
        };
        let default = match self.layout {
            Layout::V2 => VIDEO_PATH_V2,
            Layout::V3 => VIDEO_PATH_V3,
        };
        let template = self.info.video_path.as_deref().unwrap_or(default);
        let name = match filled(template, &fields) {
            Ok(name) => name,
            Err(reason) => return self.nowhere(reason),
        };
        let Some(file) = below(self.root, &name) else {
            return self.nowhere(format!("its video {name} lies outside of the dataset"));
        };
        let placed = self.tree.place(&file)?;
        if self.layout == Layout::V2 {
            return Ok(placed);
        }
        let second = |column: &str| cell(column).and_then(Value::as_f64);
        let (Some(from_s), Some(to_s)) = (second("from_timestamp"), second("to_timestamp")) else {
            return Ok(placed.with_problem("meta/episodes does not say its times".to_owned()));
        };
        let half_s = 0.5 / self.info.fps;
        // Saturating, like every cast of floats.
        let ns = |time_s: f64| ((time_s - half_s) * 1e9).round() as i64;
        let (from_ns, to_ns) = (ns(from_s), ns(to_s));
        if from_ns >= to_ns {
            let problem =
                format!("meta/episodes has it from {from_s} s to {to_s} s, which is nothing");
            return Ok(placed.with_problem(problem));
        }
        Ok(placed.part(Part::Interval { from_ns, to_ns }))
    }

    /// An episode whose video nobody can name.
    fn nowhere(&self, problem: String) -> Result<Placed, CorpusError> {
        Ok(self
            .tree
            .place(&format!("{}{INFO}", self.root))?
            .with_problem(problem))
    }
}

/// Whether a video is a depth map, by the marks that LeRobot's versions set.
fn is_depth(feature: &Value) -> bool {
    let places = ["info", "video_info"].map(|place| feature.get(place));
    places.into_iter().flatten().any(|info| {
        ["is_depth_map", "video.is_depth_map"]
            .iter()
            .any(|mark| info.get(mark).and_then(Value::as_bool) == Some(true))
    })
}

/// What an episode is to do; several tasks in one text.
fn task(row: &Map<String, Value>) -> Option<String> {
    match row.get("tasks")? {
        Value::String(task) => Some(task.clone()),
        Value::Array(tasks) => {
            let tasks: Vec<&str> = tasks.iter().filter_map(Value::as_str).collect();
            Some(tasks.join("; "))
        }
        _ => None,
    }
}

/// A field of a path template.
enum Field<'a> {
    Text(&'a str),
    Number(u64),
}

/// A template of Python's `str.format`, of which `{name}` and `{name:0Nd}` are in use.
fn filled<'a>(
    template: &str,
    fields: &dyn Fn(&str) -> Option<Field<'a>>,
) -> Result<String, String> {
    /// Wider than any number.
    const MAX_WIDTH: usize = 20;
    let mut path = String::new();
    let mut rest = template;
    while let Some((before, after)) = rest.split_once('{') {
        path.push_str(before);
        let wrong = || format!("info.json's video_path {template} is not understood");
        let (field, after) = after.split_once('}').ok_or_else(wrong)?;
        let (name, format) = field.split_once(':').unwrap_or((field, ""));
        let width = match format {
            "" | "d" => 0,
            format => {
                let width = format
                    .strip_prefix('0')
                    .and_then(|format| format.strip_suffix('d'));
                let width = width.and_then(|width| width.parse().ok());
                width
                    .filter(|&width| width <= MAX_WIDTH)
                    .ok_or_else(wrong)?
            }
        };
        match fields(name) {
            Some(Field::Text(text)) => path.push_str(text),
            // Writing to a text cannot fail.
            Some(Field::Number(number)) => _ = write!(path, "{number:0width$}"),
            None => return Err(format!("nothing says the {name} of its video")),
        }
        rest = after;
    }
    path.push_str(rest);
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn templates_are_filled_as_python_does() {
        let fields = |name: &str| match name {
            "video_key" => Some(Field::Text("observation.images.top")),
            "episode_index" => Some(Field::Number(1234567)),
            "episode_chunk" => Some(Field::Number(7)),
            _ => None,
        };
        let fill = |template: &str| filled(template, &fields);
        assert_eq!(
            fill(VIDEO_PATH_V2).unwrap(),
            "videos/chunk-007/observation.images.top/episode_1234567.mp4"
        );
        assert_eq!(fill("a/{episode_chunk}").unwrap(), "a/7");
        for (template, said) in [
            (VIDEO_PATH_V3, "chunk_index"),
            ("{episode_index:>9}", "not understood"),
            ("{episode_index:099999999d}", "not understood"),
            ("{episode_index", "not understood"),
        ] {
            assert!(fill(template).unwrap_err().contains(said), "{template}");
        }
    }
}
