//! Whether the corpus is like the frozen reference that it was scored against.

use maud::{Markup, html};

use super::page::Section;
use super::text;
use crate::publish::CorpusFile;
use crate::reduce::drift::{Drift, PSI_LEVELS, Verdict};

pub(super) fn section(corpus: &CorpusFile) -> Section {
    let body = corpus.statistics.reference.as_ref().map(|reference| {
        html! {
            p.lead {
                "Scores are relative to a frozen reference of " (text::videos(reference.n)) ", not to this corpus; percentiles and rewards too. "
                "Where this corpus has moved away from it, scores may not mean what they meant there."
            }
            div.scroll {
                table.numbers {
                    thead {
                        tr {
                            @for name in ["Signal", "Rows", "Stability index", "by chance up to", "KS distance", "p", "Verdict"] {
                                th scope="col" { (name) }
                            }
                        }
                    }
                    tbody { @for (name, drift) in &reference.drift { (line(name, drift)) } }
                }
            }
            p.more {
                "Population stability index over ten bins: from " (PSI_LEVELS.0) " a moderate, from " (PSI_LEVELS.1)
                " a major shift, unless chance explains it. With few rows the Kolmogorov-Smirnov distance judges alone. Reference "
                code { (text::visible(&reference.digest)) } "."
            }
        }
    });
    Section {
        id: "drift",
        title: "Against the reference",
        body,
    }
}

fn line(name: &str, drift: &Drift) -> Markup {
    let verdict = match drift.verdict {
        Verdict::Stable => "stable",
        Verdict::Moderate => "moderate shift",
        Verdict::Major => "major shift",
        Verdict::TooFew => "too few rows to tell",
    };
    html! {
        tr {
            th scope="row" { (name) }
            td { (text::count(drift.n)) }
            @for value in [drift.psi, drift.psi_by_chance, drift.ks, drift.ks_p] { td { (text::fixed(value, 3)) } }
            td { (verdict) }
        }
    }
}
