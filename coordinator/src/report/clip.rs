//! The error series of a clip as charts: small on a card, large beside the report.

use plumbline_common::row::Measurement;

use super::chart::{FrameLine, FramePanel, Ink, Mark, Size, frames};
use super::text;

/// Faults marked in a chart, the most severe first; the page lists them all.
const MARKS: usize = 12;
/// Fewest frames of a series worth drawing.
const FEWEST: usize = 2;

/// Both errors over one axis, for a card.
pub(super) fn small(measured: &Measurement) -> Option<String> {
    let series = &measured.series;
    let lines = vec![
        line(measured, "", 0, &series.reproj_px),
        line(measured, "", 2, &series.aepe_px),
    ];
    let mut marks = faults(measured, MARKS);
    marks.extend(peak(measured));
    let panel = FramePanel {
        title: String::new(),
        lines,
        marks,
    };
    chart(measured, vec![panel], Size::Small)
}

/// Everything measured per frame that a person reads, in panels, for a file of its own.
pub(super) fn large(measured: &Measurement) -> Option<String> {
    let series = &measured.series;
    let panel = |title: &str, lines: Vec<FrameLine>, marks| FramePanel {
        title: title.to_owned(),
        lines,
        marks,
    };
    let mut panels = vec![
        panel(
            "geometry residual e_t, px",
            vec![line(measured, "", 0, &series.reproj_px)],
            peak(measured)
                .into_iter()
                .chain(faults(measured, MARKS))
                .collect(),
        ),
        panel(
            "end-point error, px",
            vec![line(measured, "", 2, &series.aepe_px)],
            faults(measured, MARKS),
        ),
        panel(
            "motion, px per frame",
            vec![line(measured, "", 3, &series.motion_px)],
            Vec::new(),
        ),
    ];
    panels.retain(|panel| panel.lines.iter().any(|line| !line.values.is_empty()));
    chart(measured, panels, Size::Large)
}

fn line(
    measured: &Measurement,
    name: &'static str,
    series: usize,
    values: &[Option<f64>],
) -> FrameLine {
    FrameLine {
        name,
        ink: Ink::Series(series),
        first: measured.series.first_frame,
        values: values.to_vec(),
    }
}

/// The paper's t*.
fn peak(measured: &Measurement) -> Option<Mark> {
    let frame = measured.paper_peak_frame?;
    let faint = measured.peak_reliable == Some(false);
    let name = if faint { "t* (faint) =" } else { "t* =" };
    Some((frame, name.to_owned(), Ink::Text))
}

fn faults(measured: &Measurement, most: usize) -> Vec<Mark> {
    let (frames, kinds) = (
        measured.fault_frames.iter().flatten(),
        measured.fault_kinds.iter().flatten(),
    );
    let faults = frames.zip(kinds).take(most);
    faults
        .map(|(frame, kind)| (*frame, kind.replace('_', " "), Ink::Mark))
        .collect()
}

fn chart(measured: &Measurement, panels: Vec<FramePanel>, size: Size) -> Option<String> {
    let lines = panels.iter().flat_map(|panel| &panel.lines);
    let length = lines.map(|line| line.values.len()).max()?;
    if length < FEWEST {
        return None;
    }
    let first = measured.series.first_frame;
    let last = first.saturating_add(u32::try_from(length - 1).ok()?);
    frames(&panels, last, size, &in_words(measured, last))
}

/// What the chart shows, said.
pub(super) fn in_words(measured: &Measurement, last: u32) -> String {
    let series = &measured.series;
    let highest = |values: &[Option<f64>]| {
        let placed = (series.first_frame..)
            .zip(values)
            .filter_map(|(frame, value)| Some((frame, (*value)?)));
        // The first of equals.
        placed
            .filter(|(_, value)| value.is_finite())
            .reduce(|best, next| if next.1 > best.1 { next } else { best })
    };
    let mut words = format!("Errors over frames {} to {last}.", series.first_frame);
    for (name, values) in [
        ("Geometry residual", &series.reproj_px),
        ("End-point error", &series.aepe_px),
    ] {
        if let Some((frame, value)) = highest(values) {
            words.push_str(&format!(
                " {name}: highest {} px at frame {frame}.",
                text::magnitude(Some(value))
            ));
        }
    }
    if let Some(frame) = measured.paper_peak_frame {
        words.push_str(&format!(" Largest jump t* at frame {frame}."));
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_common::row::Status;

    #[test]
    fn a_clip_is_said_in_words_and_marked() {
        let mut measured = Measurement::without_score(Status::Scored, "");
        assert_eq!(large(&measured), None);
        measured.series.first_frame = 2;
        measured.series.reproj_px = vec![Some(0.5), None, Some(2.0)];
        measured.series.aepe_px = vec![Some(1.0); 3];
        measured.paper_peak_frame = Some(4);
        measured.peak_reliable = Some(false);
        measured.fault_frames = Some(vec![3]);
        measured.fault_kinds = Some(vec!["bad_frame".to_owned()]);
        assert_eq!(
            in_words(&measured, 4),
            "Errors over frames 2 to 4. Geometry residual: highest 2.00 px at frame 4. End-point error: highest 1.00 px at frame 2. Largest jump t* at frame 4."
        );
        let chart = large(&measured).unwrap();
        assert!(chart.contains("t* (faint) = 4") && chart.contains("bad frame 3"));
        assert!(small(&measured).is_some());
    }
}
