//! The parts of a corpus that stand side by side: its groups, and its sources where there are several.

use plumbline_common::row::Row;

use super::{Judged, Scored};

/// Parts with a colour of their own; the others share the last.
pub(super) const COLOURED: usize = super::chart::SERIES - 1;

/// One way to divide the scored videos.
pub(super) struct Facet<'a> {
    /// `group` or `source`.
    pub(super) label: &'static str,
    /// Parts by size, the largest first, ties by name.
    pub(super) names: Vec<(Option<&'a str>, usize)>,
    of: fn(&'a Row) -> Option<&'a str>,
}

impl<'a> Facet<'a> {
    /// The ways that say something: by group where there are groups, by source where there are several.
    pub(super) fn all(judged: &Judged<'a>, sources: usize) -> Vec<Self> {
        let mut facets = Vec::new();
        if judged.grouped() {
            facets.push(Self {
                label: "group",
                names: judged.groups.clone(),
                of: group,
            });
        }
        if sources > 1 {
            let names = sizes(&judged.worst_first, source);
            if names.len() > 1 && !facets.iter().any(|facet| facet.names == names) {
                facets.push(Self {
                    label: "source",
                    names,
                    of: source,
                });
            }
        }
        facets
    }

    /// The series of a row's part, at most [`COLOURED`].
    pub(super) fn series(&self, row: &'a Row) -> usize {
        let name = (self.of)(row);
        let own = self
            .names
            .iter()
            .take(COLOURED)
            .position(|(part, _)| *part == name);
        own.unwrap_or(COLOURED)
    }
}

/// How many videos each part has, the largest first.
pub(super) fn sizes<'a>(
    scored: &[Scored<'a>],
    of: fn(&'a Row) -> Option<&'a str>,
) -> Vec<(Option<&'a str>, usize)> {
    let mut sizes = std::collections::BTreeMap::new();
    for scored in scored {
        *sizes.entry(of(scored.row)).or_insert(0) += 1;
    }
    let mut sizes: Vec<_> = sizes.into_iter().collect();
    sizes.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(&b.0)));
    sizes
}

pub(super) fn group(row: &Row) -> Option<&str> {
    row.group.as_deref()
}

/// Several sources are named from their common parent on, so that the first directory tells them apart.
fn source(row: &Row) -> Option<&str> {
    row.video.as_str().split_once('/').map(|(first, _)| first)
}
