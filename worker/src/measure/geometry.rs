//! The geometric measure under parallax: dense adjustment of the clip, where two-view models say that it
//! is needed and its own Hessian says that depth is observable.
//!
//! The flows of every edge are sampled to the grid at once, both ways (16 bytes a cell), and thrown away;
//! all frames are keyframes. A static or turning camera costs this sampling and nothing more. Clips of
//! more than [`MOST_CELLS`] depths keep the two-view models, and `reproj_method` says so.

use plumbline_vision::scene::{
    AdjustedEdge, ClipGeometry, MotionModel, RigidSolver, SceneError, TwoViewSolver,
};
use plumbline_vision::slam::camera::{Grid, Pinhole};
use plumbline_vision::slam::flow_operator::{FlowOperatorError, GridAnswer};
use plumbline_vision::slam::intrinsics::Intrinsics;
use plumbline_vision::slam::tracker::{
    EdgeResidual, FlowEdge, FlowGraph, MOST_CELLS, Solution, TrackError, solve,
};

use super::network_flow::Confidence;
use crate::profile::Profile;

/// A clip's correspondences while it streams by.
#[derive(Default)]
pub(super) struct DenseGraph {
    graph: Option<FlowGraph>,
    /// Columns and rows of the pictures: as decoded, as worked on.
    sizes: [(usize, usize); 2],
    too_long: bool,
}

/// What the dense adjustment did, for the costs.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct DenseWork {
    pub(super) steps: usize,
    pub(super) depth_cells: usize,
    pub(super) depth_cells_saved: usize,
}

impl DenseGraph {
    /// Takes the size of the clip's frames.
    pub(super) fn sized(&mut self, video: (usize, usize), working: (usize, usize)) {
        self.sizes = [video, working];
    }

    /// Takes an edge, earlier to later frame, and its way back: where the cells of `grid` are, which is not
    /// asked for where the clip is too long for an adjustment.
    pub(super) fn edge(
        &mut self,
        from: u32,
        to: u32,
        grid: Grid,
        answers: impl FnOnce() -> Result<[GridAnswer; 2], FlowOperatorError>,
    ) -> Result<(), FlowOperatorError> {
        if self.too_long {
            return Ok(());
        }
        let graph = self.graph.get_or_insert_with(|| FlowGraph::new(grid));
        let [source, target] = [from, to].map(|frame| slot(graph, frame as usize));
        if graph.frames.len() * grid.cells() > MOST_CELLS {
            self.too_long = true;
            graph.edges.clear();
            return Ok(());
        }
        let [there, back] = answers()?;
        for (source, target, answer) in [(source, target, there), (target, source, back)] {
            graph.edges.push(FlowEdge {
                source,
                target,
                answer,
            });
        }
        Ok(())
    }

    /// A graph without edges for the same pictures.
    pub(super) fn anew(&self) -> Self {
        Self {
            graph: None,
            sizes: self.sizes,
            too_long: self.too_long,
        }
    }

    /// Takes an edge out; `None` without it.
    pub(super) fn take(&mut self, from: u32, to: u32) -> Option<(Grid, [GridAnswer; 2])> {
        let graph = self.graph.as_mut()?;
        let place = |frame: u32| graph.frames.binary_search(&(frame as usize)).ok();
        let (source, target) = (place(from)?, place(to)?);
        let mut edge = |source, target| {
            let mut edges = graph.edges.iter();
            let place = edges.position(|e| (e.source, e.target) == (source, target))?;
            Some(graph.edges.swap_remove(place).answer)
        };
        Some((graph.grid, [edge(source, target)?, edge(target, source)?]))
    }

    /// The clip's geometry: by the cheapest model that is sufficient.
    pub(super) fn settle(
        self,
        mut solver: TwoViewSolver,
        profile: &Profile,
    ) -> Result<(ClipGeometry, DenseWork), SceneError> {
        let verdict = solver.verdict();
        let cells = self
            .graph
            .as_ref()
            .map_or(0, |graph| graph.frames.len() * graph.grid.cells());
        let saved = DenseWork {
            depth_cells_saved: cells,
            ..DenseWork::default()
        };
        if verdict != MotionModel::Rigid && !profile.force_adjustment {
            return Ok((solver.finish()?, saved));
        }
        let graph = match self.graph {
            Some(graph) if !self.too_long => graph,
            _ => return Ok((solver.finish()?, saved)),
        };
        match adjusted(&graph, camera(profile, self.sizes), profile) {
            Ok((solution, fraction)) => {
                let work = DenseWork {
                    steps: solution.effort.steps,
                    depth_cells: solution.effort.depth_cells,
                    depth_cells_saved: 0,
                };
                if fraction < profile.tracking.least_observable {
                    // Depth there is none to know: one homography per pair is what is left of the models.
                    return Ok((solver.finish_under(MotionModel::Homography)?, work));
                }
                let edges = solution.residuals.iter().map(|r| edge_of(&graph, r));
                Ok((solver.finish()?.adjusted(edges.collect()), work))
            }
            Err(error) => {
                tracing::warn!(%error, "no dense adjustment; the two-view residual stands");
                Ok((solver.finish()?, saved))
            }
        }
    }
}

/// Multiplies weights by the confidence at their cells.
pub(super) fn weigh(answer: &mut GridAnswer, confidence: &Confidence, grid: Grid, step: usize) {
    for (n, weight) in answer.weight.iter_mut().enumerate() {
        let cell = n % grid.cells();
        let x = step / 2 + cell % grid.columns * step;
        let y = step / 2 + cell / grid.columns * step;
        *weight *= confidence.data[y * confidence.width + x];
    }
}

/// The slot of a frame; edges come in the order of their later frame, so that new frames are last.
fn slot(graph: &mut FlowGraph, frame: usize) -> usize {
    match graph.frames.binary_search(&frame) {
        Ok(slot) => slot,
        Err(slot) => {
            graph.frames.insert(slot, frame);
            slot
        }
    }
}

fn camera(profile: &Profile, [video, working]: [(usize, usize); 2]) -> Pinhole {
    let prior = || Intrinsics::prior(video.0, video.1);
    let intrinsics = profile.intrinsics.unwrap_or_else(prior);
    intrinsics.on_grid(video, working, profile.grid.step)
}

/// The solved map, and the share of its depths that are observable.
fn adjusted(
    graph: &FlowGraph,
    camera: Pinhole,
    profile: &Profile,
) -> Result<(Solution, f64), TrackError> {
    let solution = solve(graph, camera, &profile.tracking)?;
    let known = solution.observability(graph, &profile.tracking)?;
    Ok((solution, known.fraction()))
}

fn edge_of(graph: &FlowGraph, residual: &EdgeResidual) -> AdjustedEdge {
    AdjustedEdge {
        from_frame: graph.frames[residual.source],
        to_frame: graph.frames[residual.target],
        columns: graph.grid.columns,
        rows: graph.grid.rows,
        sum_px: residual.sum_px,
        cells: residual.cells,
        map_px: residual.map_px.clone(),
    }
}

#[cfg(test)]
mod tests {
    use plumbline_vision::flow::Flow;
    use plumbline_vision::scene::{EdgeInput, Method, SceneKind};
    use plumbline_vision::slam::flow_operator::{grid_of, sample_flow};

    use super::*;
    use crate::profile::Rung;

    const SIDE: usize = 256;

    /// Flow of a relief seen by a camera that moves sideways by `moved` of its unit depth.
    fn flow(moved: f64) -> Flow {
        let camera = Intrinsics::prior(SIDE, SIDE);
        let mut data = Vec::with_capacity(SIDE * SIDE);
        for at in 0..SIDE * SIDE {
            let (x, y) = ((at % SIDE) as f64, (at / SIDE) as f64);
            let inverse_depth = 1.0 + 0.5 * (x / 20.0).sin() * (y / 25.0).cos();
            data.push([(camera.fx * moved * inverse_depth) as f32, 0.0]);
        }
        Flow {
            width: SIDE,
            height: SIDE,
            data,
        }
    }

    /// The geometry of six frames, each pair moved by `moved` per frame.
    fn settled(moved: f64, profile: &Profile) -> (ClipGeometry, DenseWork) {
        let mut dense = DenseGraph::default();
        dense.sized((SIDE, SIDE), (SIDE, SIDE));
        let mut solver = TwoViewSolver::new(profile.two_view).unwrap();
        let step = profile.grid.step;
        for to in 1..6u32 {
            for from in to.saturating_sub(2)..to {
                let moved = moved * f64::from(to - from);
                let (there, back) = (flow(moved), flow(-moved));
                let answer = sample_flow(&there, &back, step).unwrap();
                let opposite = sample_flow(&back, &there, step).unwrap();
                let both = || Ok([answer.clone(), opposite]);
                let grid = grid_of(SIDE, SIDE, step);
                dense.edge(from, to, grid, both).unwrap();
                let edge = EdgeInput {
                    from_frame: from as usize,
                    to_frame: to as usize,
                    field: answer.field(grid_of(SIDE, SIDE, step), step, SIDE),
                };
                solver.edge(edge).unwrap();
            }
        }
        dense.settle(solver, profile).unwrap()
    }

    #[test]
    fn parallax_is_adjusted_and_keeps_its_maps() {
        let (geometry, work) = settled(0.02, &Profile::new(Rung::Standard));
        assert_eq!(geometry.scene, SceneKind::Parallax);
        assert_eq!(geometry.method, Method::DenseAdjustment);
        assert_eq!((work.depth_cells, work.depth_cells_saved), (6 * 1024, 0));
        // The relief is the same on every frame's own grid, where a true one would shift by 4 px of a
        // wavelength of 126: that is what is left.
        assert!(geometry.residual_px < 0.5, "{}", geometry.residual_px);
        let frames: Vec<usize> = geometry.series.iter().map(|e| e.frame).collect();
        assert_eq!(frames, [1, 2, 3, 4, 5]);
        let worst = geometry.worst_edge(5).unwrap();
        let of_frame = geometry
            .adjusted
            .iter()
            .filter(|e| e.from_frame.max(e.to_frame) == 5);
        assert!(of_frame.clone().all(|e| e.mean_px() <= worst.mean_px()));
        assert_eq!(of_frame.count(), 4);
        let shown = worst.map_px.iter().flatten().count();
        assert_eq!((worst.map_px.len(), shown), (1024, worst.cells));
    }

    #[test]
    fn a_static_camera_is_not_adjusted_unless_forced() {
        let mut profile = Profile::new(Rung::Standard);
        let (geometry, work) = settled(0.0, &profile);
        assert_eq!(geometry.method, Method::TwoViewGric);
        assert_eq!(work.depth_cells_saved, 6 * 1024);
        assert_eq!((work.depth_cells, work.steps), (0, 0));
        assert_eq!(geometry.worst_edge(3).unwrap().mean_px(), Some(0.0));
        profile.force_adjustment = true;
        let (forced, work) = settled(0.0, &profile);
        // The gate finds by itself that there is no depth to know.
        assert_eq!(forced.method, Method::TwoViewGric);
        assert_eq!(work.depth_cells, 6 * 1024);
        // Nothing moves, so that nothing is left by any model.
        assert!(forced.residual_px < 1e-3, "{}", forced.residual_px);
    }

    /// Cells 4 px apart, the first at 2.
    #[test]
    fn confidence_is_read_at_the_cells() {
        let grid = grid_of(16, 12, 4);
        let mut answer = GridAnswer {
            at: vec![0.0; 2 * grid.cells()],
            weight: vec![0.5; 2 * grid.cells()],
        };
        let confidence = Confidence {
            width: 16,
            height: 12,
            data: (0..16 * 12).map(|n| n as f32).collect(),
        };
        weigh(&mut answer, &confidence, grid, 4);
        let (columns, cells) = (grid.columns, grid.cells());
        let expected =
            |cell: usize| 0.5 * ((2 + cell / columns * 4) * 16 + 2 + cell % columns * 4) as f32;
        for cell in 0..cells {
            assert_eq!(answer.weight[cell], expected(cell));
            assert_eq!(answer.weight[cells + cell], expected(cell));
        }
    }

    #[test]
    fn where_the_gate_finds_no_depth_a_homography_is_left() {
        let mut profile = Profile::new(Rung::Standard);
        // More than all of the cells cannot be observable.
        profile.tracking.least_observable = 1.1;
        let (geometry, work) = settled(0.02, &profile);
        assert_eq!(geometry.scene, SceneKind::Rotation);
        assert_eq!(geometry.method, Method::TwoViewGric);
        assert!(work.steps > 0);
    }
}
