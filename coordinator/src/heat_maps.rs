//! `score --heatmaps K`: the worst frame of each of the K most anomalous videos, as a picture beside the
//! report. Nothing else of a run depends on them: what cannot be drawn is said and left out.
//!
//! A picture's name holds a digest of all that decides its content, so that one which is there already,
//! from a run that was stopped or made with other rules, is not drawn again.

use std::collections::{BTreeMap, HashMap};

use plumbline_common::id::VideoId;
use plumbline_common::row::{Measurement, Row};
use plumbline_vision::faults::FaultKind;
use plumbline_vision::image::Rgb8;
use plumbline_worker::child::Drawing;
use plumbline_worker::explain::{DrawJob, Marked, Subject};
use plumbline_worker::profile::Profile;

use crate::corpus::Entry;
use crate::explain::HEAT_MAP_DIRECTORY;
use crate::fanout::{Drawn, Fanout, Slots};
use crate::measuring::job;
use crate::picture;
use crate::progress::say;
use crate::publish::OutDir;
use crate::run::RunError;

/// Characters of a video's name in a file's name.
const SLUG_CHARS: usize = 60;
/// Hexadecimal digits of the digest in a file's name.
const DIGEST_DIGITS: usize = 16;

/// File name by video.
pub(crate) type HeatMaps = BTreeMap<VideoId, String>;

/// Draws the heat maps that are not there yet and gives the names of all; those of other runs go.
pub(crate) async fn draw(
    most: usize,
    rows: &[Row],
    entries: &[Entry],
    profile: &Profile,
    slots: &Slots,
    out: &OutDir,
) -> Result<HeatMaps, RunError> {
    let by_video: HashMap<&VideoId, &Entry> =
        entries.iter().map(|entry| (&entry.video, entry)).collect();
    let mut maps = HeatMaps::new();
    let mut jobs = Vec::new();
    for row in worst(rows, most) {
        let Some(subject) = subject(&row.measured) else {
            continue;
        };
        let file = file_name(row, subject);
        let there = out.root().join(&file).is_file();
        if !there {
            let entry = by_video.get(&row.video);
            let job = entry.map(|entry| job(entry, profile)).transpose();
            let Some(job) = job.map_err(RunError::Profile)?.flatten() else {
                continue;
            };
            jobs.push(DrawJob {
                job,
                heat_maps: vec![subject],
                overlay: false,
                marked: Marked::default(),
            });
        }
        maps.insert(row.video.clone(), file);
    }
    let wanted: Vec<&String> = maps.values().collect();
    for name in picture::heat_maps_in(out)? {
        if is_ours(&name) && !wanted.contains(&&name) {
            out.remove(&name)?;
        }
    }
    if !jobs.is_empty() {
        say(&format!("drawing {} heat maps", jobs.len()));
    }
    let mut fanout = Fanout::start(jobs, slots);
    while let Some(drawn) = fanout.next().await {
        let Drawn {
            video,
            pictures,
            drawing,
        } = drawn?;
        match (pictures.into_iter().next(), maps.get(&video)) {
            (Some(drawn), Some(file)) => {
                let rgb = Rgb8 {
                    width: drawn.width as usize,
                    height: drawn.height as usize,
                    data: drawn.rgb,
                };
                out.put_atomic(file, &picture::png(&rgb)?)?;
            }
            _ => {
                let reason = match drawing {
                    Drawing::Missing(reason) => reason,
                    Drawing::Whole | Drawing::Stopped => "there is no map of it".to_owned(),
                };
                say(&format!(
                    "no heat map of {}: {}",
                    video.as_str().escape_debug(),
                    reason.escape_debug()
                ));
                maps.remove(&video);
            }
        }
    }
    Ok(maps)
}

/// Heat maps that are there for these rows.
pub(crate) fn there_already(rows: &[Row], out: &OutDir) -> HeatMaps {
    let there = rows.iter().filter_map(|row| {
        let file = file_name(row, subject(&row.measured)?);
        let is_there = out.root().join(&file).is_file();
        is_there.then(|| (row.video.clone(), file))
    });
    there.collect()
}

/// The most anomalous videos, the worst first: the highest ranks.
fn worst(rows: &[Row], most: usize) -> Vec<&Row> {
    let mut ranked: Vec<&Row> = rows.iter().filter(|row| row.rank.is_some()).collect();
    ranked.sort_by(|a, b| b.rank.cmp(&a.rank).then_with(|| a.video.cmp(&b.video)));
    ranked.truncate(most);
    ranked
}

/// The most severe fault that has a map, otherwise the worst end-point error.
fn subject(measured: &Measurement) -> Option<(Subject, u32)> {
    let frames = measured.fault_frames.iter().flatten();
    let kinds = measured.fault_kinds.iter().flatten();
    let fault = frames.zip(kinds).find_map(|(frame, name)| {
        let has_map = |kind: &FaultKind| *kind != FaultKind::Freeze && kind.as_str() == name;
        let kind = FaultKind::ALL.into_iter().find(has_map)?;
        Some((Subject::Fault(kind), *frame))
    });
    fault.or_else(|| Some((Subject::EndPointError, picture::worst_pair(measured)?.0)))
}

/// A name that is safe in every file system and address: letters, digits, `-`, `_` and `.`.
fn file_name(row: &Row, (subject, frame): (Subject, u32)) -> String {
    let plain = |c: char| {
        if c.is_ascii_alphanumeric() || matches!(c, '-' | '_') {
            c
        } else {
            '_'
        }
    };
    let name = row.video.as_str();
    let slug: String = name.chars().map(plain).take(SLUG_CHARS).collect();
    let subject = match subject {
        Subject::Fault(kind) => kind.as_str(),
        Subject::EndPointError => "end_point_error",
        Subject::RigidResidual => "rigid_residual",
    };
    let mut hasher = blake3::Hasher::new();
    let frame = frame.to_string();
    let content = row.measured.digest.as_deref().unwrap_or_default();
    let version = env!("CARGO_PKG_VERSION");
    for part in [name, content, &row.profile_digest, subject, &frame, version] {
        hasher.update(&(part.len() as u64).to_le_bytes());
        hasher.update(part.as_bytes());
    }
    let digest = hasher.finalize().to_hex();
    let digest = digest.get(..DIGEST_DIGITS).unwrap_or_default();
    format!("{HEAT_MAP_DIRECTORY}/{slug}-{digest}.png")
}

/// Whether a name in the directory is one that [`file_name`] gives.
pub(crate) fn is_ours(name: &str) -> bool {
    let digest = name
        .strip_suffix(".png")
        .and_then(|stem| Some(stem.rsplit_once('-')?.1));
    digest.is_some_and(|digest| {
        digest.len() == DIGEST_DIGITS && digest.bytes().all(|c| c.is_ascii_hexdigit())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_common::row::Status;

    #[test]
    fn the_subject_is_the_worst_fault_with_a_map() {
        let mut measured = Measurement::without_score(Status::Scored, "");
        assert_eq!(subject(&measured), None);
        measured.series.first_frame = 2;
        measured.series.aepe_px = vec![Some(1.0), None, Some(3.0), Some(3.0)];
        assert_eq!(subject(&measured), Some((Subject::EndPointError, 4)));
        measured.fault_frames = Some(vec![7, 9]);
        measured.fault_kinds = Some(vec!["freeze".to_owned(), "jump".to_owned()]);
        let jump = Some((Subject::Fault(FaultKind::Jump), 9));
        assert_eq!(subject(&measured), jump);
    }

    #[test]
    fn names_are_told_from_those_of_others() {
        assert!(is_ours("heatmaps/a__b-0123456789abcdef.png"));
        assert!(!is_ours("heatmaps/01-jump-0009.png") && !is_ours("heatmaps/mine.png"));
    }
}
