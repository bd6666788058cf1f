//! Which videos break at which frame: the fault detectors' findings, whatever the anomaly score.

use maud::html;
use plumbline_common::row::{Measurement, Row};

use super::page::Section;
use super::text;

/// Videos listed; scores.* has every one.
const ROWS: usize = 200;
/// Faults told of one video; the most severe come first.
const FAULTS: usize = 6;

pub(super) fn section(rows: &[Row]) -> Section {
    let judged = rows
        .iter()
        .filter(|row| row.measured.fault_frames.is_some())
        .count();
    let faulty: Vec<(&Row, String)> = rows
        .iter()
        .filter_map(|row| Some((row, told(&row.measured, FAULTS)?)))
        .collect();
    Section {
        id: "faults",
        title: "Faults",
        body: (!faulty.is_empty()).then(|| {
            html! {
                p.lead {
                    (text::length(faulty.len())) " of " (text::length(judged))
                    " videos have a frame that breaks, whatever their score. Thresholds were fitted on recorded clips of other cameras: check a few before you rely on them."
                }
                div.scroll.tall tabindex="0" role="region" aria-label="Videos with faults" {
                    table.numbers.dense {
                        thead { tr { th.left scope="col" { "Video" } th.left scope="col" { "Group" } th.left scope="col" { "Faults, the most severe first" } } }
                        tbody {
                            @for (row, faults) in faulty.iter().take(ROWS) {
                                tr {
                                    td.left.long { (text::name(row.video.as_str())) }
                                    td.left.long { @if row.group.is_some() { (text::group(row.group.as_deref())) } @else { (text::MISSING) } }
                                    td.left { (faults) }
                                }
                            }
                        }
                    }
                }
                @if faulty.len() > ROWS {
                    p.more { (text::length(faulty.len() - ROWS)) " more are in scores.*." }
                }
            }
        }),
    }
}

/// "jump at 20, appear at 20"; `None` without a fault.
pub(super) fn told(measured: &Measurement, most: usize) -> Option<String> {
    let (frames, kinds) = (
        measured.fault_frames.as_ref()?,
        measured.fault_kinds.as_ref()?,
    );
    let mut faults: Vec<String> = frames
        .iter()
        .zip(kinds)
        .take(most)
        .map(|(frame, kind)| format!("{} at {frame}", kind.replace('_', " ")))
        .collect();
    if frames.len() > most {
        faults.push(format!("{} more", frames.len() - most));
    }
    (!faults.is_empty()).then(|| faults.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_common::row::Status;

    #[test]
    fn faults_are_told_in_order_and_bounded() {
        let mut measured = Measurement::without_score(Status::Scored, "");
        assert_eq!(told(&measured, 2), None);
        measured.fault_frames = Some(vec![]);
        measured.fault_kinds = Some(vec![]);
        assert_eq!(told(&measured, 2), None);
        measured.fault_frames = Some(vec![20, 3, 9]);
        measured.fault_kinds = Some(["bad_frame", "jump", "vanish"].map(str::to_owned).to_vec());
        assert_eq!(
            told(&measured, 2).unwrap(),
            "bad frame at 20, jump at 3, 1 more"
        );
    }
}
