//! The two ends of the ranking: each video with its peak frame, heat map, score and series.

use maud::{Markup, PreEscaped, html};

use super::axis::Axis;
use super::page::{Section, jpeg_address};
use super::{Judged, ReportInput, Scored, Thumbnails, clip, faults, text};

/// Largest picture taken into the page; with 12 videos at each end and two pictures each it stays
/// below 9 MB whatever the caller gives.
const PICTURE_BYTES: usize = 128 << 10;
/// Faults told on a card; the table of faults tells more.
const FAULTS: usize = 3;

pub(super) fn worst(input: &ReportInput<'_>, judged: &Judged<'_>) -> Section {
    let shown = input.ranked.min(judged.worst_first.len().div_ceil(2));
    let videos = judged.worst_first.get(..shown).unwrap_or_default();
    Section {
        id: "worst",
        title: "Least consistent",
        body: Some(if videos.is_empty() {
            html! { p.lead { "No video has a score, so there is no ranking. The reasons stand under “Not scored”." } }
        } else {
            html! {
                p.lead { (the_scores(shown, "highest")) " Picture: the frame with the largest end-point error, beside it where that error lies (black 0, bright 5 px and more). The bar is the 90% interval, its tick stands at 0." }
                (cards(input, judged, videos.iter()))
            }
        }),
    }
}

pub(super) fn best(input: &ReportInput<'_>, judged: &Judged<'_>) -> Section {
    let shown = input.ranked.min(judged.worst_first.len() / 2);
    let start = judged.worst_first.len() - shown;
    let videos = judged.worst_first.get(start..).unwrap_or_default();
    Section {
        id: "best",
        title: "Most consistent",
        body: (!videos.is_empty()).then(|| {
            html! {
                p.lead { (the_scores(shown, "lowest")) " Look at their motion: a video that hardly moves has little to be wrong about." }
                (cards(input, judged, videos.iter().rev()))
            }
        }),
    }
}

fn the_scores(shown: usize, end: &str) -> String {
    match shown {
        1 => format!("The {end} anomaly score."),
        _ => format!("The {} {end} anomaly scores.", text::length(shown)),
    }
}

fn cards<'a>(
    input: &ReportInput<'_>,
    judged: &Judged<'a>,
    videos: impl Iterator<Item = &'a Scored<'a>> + Clone,
) -> Markup {
    let axis = interval_axis(judged);
    html! {
        div.clips {
            @for scored in videos {
                (card(input, scored, axis))
            }
        }
    }
}

/// One scale for all bars of the page, so that they compare.
fn interval_axis(judged: &Judged<'_>) -> Axis {
    let ends = judged.worst_first.iter().flat_map(|scored| {
        let row = scored.row;
        [Some(scored.anomaly), row.anomaly_lo, row.anomaly_hi]
    });
    let (lo, hi) = ends
        .flatten()
        .filter(|value| value.is_finite())
        .fold((0.0_f64, 0.0_f64), |(lo, hi), value| {
            (lo.min(value), hi.max(value))
        });
    Axis::spanning(lo, hi).padded(0.02)
}

fn card(input: &ReportInput<'_>, scored: &Scored<'_>, axis: Axis) -> Markup {
    let row = scored.row;
    let thumbnails = (input.thumbnails)(&row.video);
    let measured = &row.measured;
    let fact = |label: &str, value: String| {
        html! { div { dt { (label) } dd { (value) } } }
    };
    let peak = match (measured.paper_peak_frame, measured.peak_reliable) {
        (Some(frame), Some(false)) => format!("{frame}, faint"),
        (frame, _) => text::optional(frame),
    };
    let faulty = measured
        .fault_frames
        .as_ref()
        .is_some_and(|frames| !frames.is_empty());
    html! {
        article.clip {
            (pictures(thumbnails))
            div.what {
                h3 { a.open href="#table" data-video=(text::plain_name(row.video.as_str(), super::data::TEXT_CHARS)) { (text::heading(row.video.as_str())) } }
                p.where {
                    @if let Some(rank) = row.rank { "rank " (text::count(rank)) }
                    @if row.group.is_some() { " · " (text::group(row.group.as_deref())) }
                }
            }
            div.score {
                strong { (text::signed(Some(scored.anomaly))) }
                (interval(scored, axis))
            }
            dl.facts {
                (fact("z reprojection", text::signed(row.z_reproj_px)))
                (fact("z end-point", text::signed(row.z_aepe_worldscore_px)))
                (fact("z piecewise", text::signed(row.z_piecewise_residual)))
                (fact("z appearance", text::signed(row.z_appearance_ratio)))
                (fact("z acceleration", text::signed(row.z_layer_acceleration_q25)))
                (fact("z shear", text::signed(row.z_interior_shear)))
                (fact("z detail", text::signed(row.z_detail_change_q25)))
                @for (name, score) in [("WorldScore 3D", measured.worldscore_3d), ("WorldScore photo.", measured.worldscore_photometric)] {
                    @if score.is_some() { (fact(name, text::fixed(score, 1))) }
                }
                (fact("motion, px", text::magnitude(measured.motion_px)))
                (fact("paper’s peak", peak))
                @if let Some(rung) = &row.rung { (fact("measured at", text::plain_name(rung, 30))) }
                @if row.flip_probability.is_some() { (fact("flip probability", text::fixed(row.flip_probability, 3))) }
            }
            @if let Some(faults) = faults::told(measured, FAULTS) { p.faults { b { "Faults " } (faults) } }
            @if let Some(file) = input.heat_maps.get(&row.video) {
                p.faults { a href=(file) { "Heat map of the worst frame" } }
            }
            @if let Some(chart) = clip::small(measured) {
                figure.spark {
                    (PreEscaped(chart))
                    figcaption { span.a { "geometry e_t" } span.b { "end-point" } @if faulty { span.marks { "fault" } } span.frames { "px over frames; dark line t*" } }
                }
            }
        }
    }
}

fn pictures(thumbnails: Option<Thumbnails>) -> Markup {
    let usable = |jpeg: &Vec<u8>| !jpeg.is_empty() && jpeg.len() <= PICTURE_BYTES;
    let Some(Thumbnails {
        frame_jpeg,
        heat_jpeg,
    }) = thumbnails
    else {
        return html! {};
    };
    html! {
        @if usable(&frame_jpeg) {
            div.pictures {
                img src=(jpeg_address(&frame_jpeg)) alt="Peak frame" loading="lazy" decoding="async";
                @if usable(&heat_jpeg) {
                    img src=(jpeg_address(&heat_jpeg)) alt="Heat map of the residual" loading="lazy" decoding="async";
                }
            }
        }
    }
}

/// A coordinate in tenths of a unit: finer than the eye, short in the file.
fn tenth(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

/// The 90% interval around the score, with a mark at zero.
fn interval(scored: &Scored<'_>, axis: Axis) -> Markup {
    const WIDTH: f64 = 200.0;
    const HEIGHT: f64 = 16.0;
    let x = |value: f64| tenth(axis.position(value) * WIDTH);
    let row = scored.row;
    let ends = row.anomaly_lo.zip(row.anomaly_hi);
    let label =
        ends.map(|(lo, hi)| format!("{} to {}", text::signed(Some(lo)), text::signed(Some(hi))));
    html! {
        div.interval {
            svg viewBox={ "0 0 " (WIDTH) " " (HEIGHT) } preserveAspectRatio="none" aria-hidden="true" {
                path.base d={ "M0 " (HEIGHT / 2.0) "H" (WIDTH) } {}
                path.zero d={ "M" (x(0.0)) " 2V" (HEIGHT - 2.0) } {}
                @if let Some((lo, hi)) = ends {
                    path.range d={ "M" (x(lo)) " " (HEIGHT / 2.0) "H" (x(hi)) } {}
                }
                path.at d={ "M" (x(scored.anomaly)) " " (HEIGHT / 2.0) "h0" } {}
            }
            span { (label.unwrap_or_else(|| "no interval".to_owned())) }
        }
    }
}
