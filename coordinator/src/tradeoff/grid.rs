//! The points that are measured: rungs of the ladder, and what lies between them by the main knobs.
//!
//! A point is a profile and the name that people know it by: a rung's own, a file's, or the knobs of the
//! grid (`h192-f1-e1`: height 192 px, finest scale 1, edges up to a span of 1 frame).

use clap::ValueEnum;
use plumbline_worker::profile::{Profile, Rung};

/// Which points are measured beside those that were named.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Grid {
    /// None.
    None,
    /// draft, standard and accurate.
    Rungs,
    /// Those, and six settings of height, finest scale and edges between them.
    Knobs,
}

/// A point of the speed/accuracy plane.
#[derive(Debug, Clone, PartialEq)]
pub struct GridPoint {
    /// What people call it.
    pub name: String,
    /// How it measures.
    pub profile: Profile,
}

/// What a point of the grid changes of a rung.
struct Knobs {
    rung: Rung,
    working_height_px: u32,
    finest_scale: u32,
    longest_span: u32,
}

/// What the motion-balanced measures follow is how finely the flow is searched (rows over 2^scale), not the
/// height of the picture: so the grid goes up in that, from half of what `standard` has to twice.
const KNOBS: [Knobs; 6] = [
    Knobs::new(Rung::Draft, 128, 2, 1),
    Knobs::new(Rung::Draft, 128, 1, 1),
    Knobs::new(Rung::Draft, 192, 0, 1),
    Knobs::new(Rung::Standard, 256, 1, 1),
    Knobs::new(Rung::Standard, 256, 0, 2),
    Knobs::new(Rung::Accurate, 512, 1, 1),
];

/// Cells of the geometric grid per picture height, at every rung.
const GRID_ROWS: u32 = 32;

impl Knobs {
    const fn new(rung: Rung, working_height_px: u32, finest_scale: u32, longest_span: u32) -> Self {
        Self {
            rung,
            working_height_px,
            finest_scale,
            longest_span,
        }
    }

    fn point(&self, of_rung: &dyn Fn(Rung) -> Profile) -> GridPoint {
        let mut profile = of_rung(self.rung);
        profile.working_height_px = self.working_height_px;
        profile.grid.step = (self.working_height_px / GRID_ROWS) as usize;
        profile.flow.finest_scale = self.finest_scale;
        profile.edge_spans = (1..=self.longest_span).collect();
        GridPoint {
            name: format!(
                "h{}-f{}-e{}",
                self.working_height_px, self.finest_scale, self.longest_span
            ),
            profile,
        }
    }
}

/// The points of a grid; `of_rung` gives a rung's profile with what the user has set for all of them.
pub fn points(grid: Grid, of_rung: &dyn Fn(Rung) -> Profile) -> Vec<GridPoint> {
    let rungs = Rung::CLASSICAL.into_iter().map(|rung| GridPoint {
        name: rung.as_str().to_owned(),
        profile: of_rung(rung),
    });
    match grid {
        Grid::None => Vec::new(),
        Grid::Rungs => rungs.collect(),
        Grid::Knobs => rungs
            .chain(KNOBS.iter().map(|knobs| knobs.point(of_rung)))
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_distinct_and_the_rungs_are_themselves() {
        let points = points(Grid::Knobs, &Profile::new);
        for (i, a) in points.iter().enumerate() {
            for b in &points[..i] {
                assert_ne!(a.name, b.name);
                assert_ne!(a.profile, b.profile, "{} and {}", a.name, b.name);
            }
        }
        assert_eq!(points[1].profile, Profile::new(Rung::Standard));
        for point in &points {
            // The same points of the picture at every height.
            assert_eq!(
                point.profile.grid.step * GRID_ROWS as usize,
                point.profile.working_height_px as usize
            );
        }
    }
}
