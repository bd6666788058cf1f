//! Datasets in the layouts that trainers publish, written from small clips when a test asks for them.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use parquet::arrow::ArrowWriter;
use plumbline_vision::image::Rgb8;
use serde_json::{Value, json};
use tar::{Builder, Header};

use crate::clips;

/// The cameras of every LeRobot dataset here.
pub const CAMERAS: [&str; 2] = ["observation.images.top", "observation.images.wrist"];

/// Frames per second of every clip.
const FPS: f64 = 10.0;

/// One episode: its frames as each camera saw them.
pub type Episode = [Vec<Rgb8>; CAMERAS.len()];

/// The `seed`-th episode, of some frames; each has another length.
pub fn episode(seed: u64) -> Episode {
    let frames = clips::FRAMES + seed as usize % 3;
    [seed, seed + 100].map(|seed| {
        let spec = plumbline_sample::corpus::ClipSpec {
            frames,
            ..clips::spec(seed)
        };
        clips::frames(&spec)
    })
}

fn write(path: &Path, content: impl AsRef<[u8]>) {
    std::fs::create_dir_all(path.parent().expect("a directory")).expect("directory");
    std::fs::write(path, content).expect("the file is written");
}

fn info(version: &str, episodes: &[Episode]) -> Value {
    let frames: usize = episodes.iter().map(|episode| episode[0].len()).sum();
    let mut features = json!({
        "action": {"dtype": "float32", "shape": [2], "names": null},
        "timestamp": {"dtype": "float32", "shape": [1], "names": null},
    });
    for camera in CAMERAS {
        features[camera] = json!({
            "dtype": "video",
            "shape": [clips::SIZE_PX.1, clips::SIZE_PX.0, 3],
            "names": ["height", "width", "channels"],
            "info": {"video.fps": FPS, "video.is_depth_map": false, "has_audio": false},
        });
    }
    json!({
        "codebase_version": version,
        "robot_type": "arm",
        "total_episodes": episodes.len(),
        "total_frames": frames,
        "total_tasks": 2,
        "chunks_size": 1000,
        "fps": FPS,
        "splits": {"train": format!("0:{}", episodes.len())},
        "features": features,
    })
}

fn task(index: usize) -> &'static str {
    ["pick the cube", "push the cube"][index % 2]
}

/// A dataset of codebase version 2.1: a file per episode and camera.
pub fn write_lerobot_v21(root: &Path, episodes: &[Episode]) {
    let mut of_dataset = info("v2.1", episodes);
    of_dataset["data_path"] =
        json!("data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet");
    of_dataset["video_path"] =
        json!("videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4");
    write(&root.join("meta/info.json"), of_dataset.to_string());
    let mut lines = String::new();
    for (index, episode) in episodes.iter().enumerate() {
        let length = episode[0].len();
        let line = json!({"episode_index": index, "tasks": [task(index)], "length": length});
        lines.push_str(&format!("{line}\n"));
        for (camera, frames) in CAMERAS.iter().zip(episode) {
            let file = format!("videos/chunk-000/{camera}/episode_{index:06}.mp4");
            clips::write(&root.join(file), frames);
        }
    }
    write(&root.join("meta/episodes.jsonl"), lines);
    let tasks = [0, 1].map(|index| json!({"task_index": index, "task": task(index)}));
    let tasks = tasks.map(|line| format!("{line}\n")).concat();
    write(&root.join("meta/tasks.jsonl"), tasks);
}

/// The file of a dataset of version 3.0 in which an episode lies: all but the last in one.
pub fn file_of(index: usize, episodes: usize) -> u64 {
    u64::from(index + 1 == episodes)
}

/// A dataset of codebase version 3.0: one file per camera holds all episodes but the last one, after one another
/// and with keyframes wherever the encoder puts them.
pub fn write_lerobot_v30(root: &Path, episodes: &[Episode]) {
    let mut of_dataset = info("v3.0", episodes);
    of_dataset["data_path"] = json!("data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet");
    of_dataset["video_path"] =
        json!("videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4");
    write(&root.join("meta/info.json"), of_dataset.to_string());
    let mut rows = Vec::new();
    let mut first_frame = 0;
    // Frames in each of the two files so far.
    let mut before = [0, 0];
    for (index, episode) in episodes.iter().enumerate() {
        let (length, file) = (episode[0].len(), file_of(index, episodes.len()));
        let mut row = json!({
            "episode_index": index,
            "tasks": [task(index)],
            "length": length,
            "dataset_from_index": first_frame,
            "dataset_to_index": first_frame + length,
            "data/chunk_index": 0,
            "data/file_index": 0,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
            "stats/action/mean": [0.5, 0.25],
        });
        let start = &mut before[file as usize];
        for camera in CAMERAS {
            row[format!("videos/{camera}/chunk_index")] = json!(0);
            row[format!("videos/{camera}/file_index")] = json!(file);
            row[format!("videos/{camera}/from_timestamp")] = json!(*start as f64 / FPS);
            row[format!("videos/{camera}/to_timestamp")] = json!((*start + length) as f64 / FPS);
        }
        *start += length;
        first_frame += length;
        rows.push(row);
    }
    write_parquet(
        &root.join("meta/episodes/chunk-000/file-000.parquet"),
        &rows,
    );
    for (place, camera) in CAMERAS.iter().enumerate() {
        for file in 0..2 {
            let within = episodes.iter().enumerate();
            let within = within.filter(|(index, _)| file_of(*index, episodes.len()) == file);
            let frames = within.flat_map(|(_, episode)| episode[place].iter().cloned());
            let frames: Vec<Rgb8> = frames.collect();
            let name = format!("videos/{camera}/chunk-000/file-{file:03}.mp4");
            clips::write(&root.join(name), &frames);
        }
    }
}

/// Writes rows as Parquet.
pub fn write_parquet(path: &Path, rows: &[Value]) {
    use arrow_json::reader::{ReaderBuilder, infer_json_schema_from_iterator};
    let values = rows.iter().map(Ok::<_, arrow_schema::ArrowError>);
    let schema = Arc::new(infer_json_schema_from_iterator(values).expect("rows have a schema"));
    let reader = ReaderBuilder::new(Arc::clone(&schema));
    let mut decoder = reader.build_decoder().expect("the schema is known");
    decoder.serialize(rows).expect("rows fit their schema");
    let batch = decoder.flush().expect("rows fit their schema");
    std::fs::create_dir_all(path.parent().expect("a directory")).expect("directory");
    let file = File::create(path).expect("the table opens");
    let mut writer = ArrowWriter::try_new(file, schema, None).expect("a Parquet writer");
    writer
        .write(&batch.expect("there are rows"))
        .expect("rows are written");
    writer.close().expect("the table is written");
}

/// Writes a shard of files in their order.
pub fn write_shard<'a>(path: &Path, files: impl IntoIterator<Item = (&'a str, Vec<u8>)>) {
    std::fs::create_dir_all(path.parent().expect("a directory")).expect("directory");
    let mut tar = Builder::new(File::create(path).expect("the shard opens"));
    for (name, content) in files {
        let mut header = Header::new_gnu();
        header.set_size(content.len() as u64);
        header.set_mode(0o644);
        tar.append_data(&mut header, name, &content[..])
            .expect("the member is written");
    }
    tar.finish().expect("the shard is written");
}
