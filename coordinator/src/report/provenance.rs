//! Where the figures come from: version, profile, recipe, options; and what they cost.

use std::collections::BTreeSet;

use maud::{Markup, html};
use plumbline_common::row::Row;

use super::page::Section;
use super::{CostSummary, ReportInput, text};
use crate::reduce::outcome::Range;
use crate::reduce::recipe_name;

/// Most characters of profile parameters on the page; corpus.json has them whole.
const PARAMETER_CHARS: usize = 20_000;
/// Most sources and options listed.
const ENTRIES: usize = 40;

pub(super) fn section(input: &ReportInput<'_>) -> Section {
    let corpus = input.corpus;
    let statistics = &corpus.statistics;
    let range = match statistics.range {
        Range::Full => "full range",
        Range::Winsorised => "0.5–99.5% range",
    };
    let parameters = corpus
        .profile
        .as_ref()
        .map(|profile| &profile.parameters)
        .filter(|p| !p.is_null());
    let parameters: String = parameters
        .and_then(|parameters| serde_json::to_string_pretty(parameters).ok())
        .unwrap_or_default()
        .chars()
        .take(PARAMETER_CHARS)
        .collect();
    Section {
        id: "provenance",
        title: "Provenance",
        body: Some(html! {
            dl.provenance {
                @for source in corpus.source.iter().take(ENTRIES) { (entry("Source", html! { (text::name(source)) })) }
                @if corpus.source.len() > ENTRIES { (entry("Source", html! { (text::length(corpus.source.len() - ENTRIES)) " more in corpus.json" })) }
                (entry("Version", html! { (corpus.plumbline_version) }))
                @if let Some(profile) = &corpus.profile {
                    @if let Some(name) = &profile.name { (entry("Profile", html! { (text::name(name)) })) }
                    (entry("Profile digest", html! { code { (text::visible(&profile.digest)) } }))
                }
                @for models in models(input.rows) { (entry("Models", html! { code { (text::plain_name(models, 300)) } })) }
                (entry("Recipe", html! { (recipe_name(statistics.recipe)) }))
                (entry("Keep rule", html! { code { (text::visible(&statistics.keep)) } }))
                (entry("Histogram", html! { (statistics.bins) " bins, " (range) }))
                @if let Some(frames) = corpus.conditioning_frames {
                    (entry("Left out", html! { (frames) " leading frame" @if frames != 1 { "s" } " of each video (conditioning)" }))
                }
                @for (name, value) in input.options.iter().take(ENTRIES) {
                    (entry(&text::plain_name(name, 60), html! { code { (text::plain_name(value, 300)) } }))
                }
                @if let Some(costs) = input.costs { (entry("Compute", cost(&costs))) }
            }
            @if !parameters.is_empty() {
                details { summary { "Profile parameters" } pre { (parameters) } }
            }
        }),
    }
}

/// The model sets that had a part in the rows.
fn models(rows: &[Row]) -> impl Iterator<Item = &str> {
    let named = rows.iter().filter_map(|row| row.measured.models.as_deref());
    let all: BTreeSet<&str> = named.collect();
    all.into_iter().take(ENTRIES)
}

fn entry(label: &str, value: Markup) -> Markup {
    html! { div { dt { (label) } dd { (value) } } }
}

fn cost(costs: &CostSummary) -> Markup {
    #[expect(clippy::cast_precision_loss, reason = "a mean shown with three digits")]
    let each_s = costs.total_s / (costs.videos.max(1) as f64);
    let stages = [
        ("decode", costs.decode_s),
        ("flow", costs.flow_s),
        ("signals", costs.signals_s),
        ("geometry", costs.geometry_s),
    ];
    html! {
        (text::seconds(costs.total_s)) " over " (text::videos(costs.videos)) ", " (text::seconds(each_s)) " each"
        @if costs.total_s > 0.0 {
            " ("
            @for (index, (name, stage_s)) in stages.iter().enumerate() {
                @if index > 0 { ", " }
                (name) " " (text::fixed(Some(100.0 * stage_s / costs.total_s), 0)) "%"
            }
            ")"
        }
        @if costs.retries > 0 { "; " (text::count(costs.retries)) " repeated" }
    }
}
