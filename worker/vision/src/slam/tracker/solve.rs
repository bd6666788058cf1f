//! From correspondences to a map.

use super::residual::{EdgeResidual, residual, robust_weights};
use super::{FlowEdge, FlowGraph, TrackError, TrackParams, poses};
use crate::slam::bundle::{
    BundleOptions, EdgeObservation, Problem, Report, Scene, Workspace, adjust,
};
use crate::slam::camera::Pinhole;
use crate::slam::se3::Se3;

/// Inverse depth before anything is known; the scale is free.
const INITIAL_INVERSE_DEPTH: f64 = 1.0;

/// Least inverse depth of an inverted relief, as a share of the middle one.
const LEAST_INVERTED: f64 = 0.1;

/// What it took.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Effort {
    /// Adjustments.
    pub adjustments: usize,
    /// Steps of all of them.
    pub steps: usize,
    /// Inverse depths estimated.
    pub depth_cells: usize,
    /// Whether the refinement ended by its tolerance and not by its last round.
    pub converged: bool,
}

impl Effort {
    fn count(&mut self, report: &Report) {
        self.adjustments += 1;
        self.steps += report.iterations;
    }
}

/// A map of a clip.
#[derive(Debug, Clone, PartialEq)]
pub struct Solution {
    /// Poses and inverse depths of the keyframes; the median inverse depth is 1 where depths were
    /// estimated, and the first pose is the identity.
    pub scene: Scene,
    /// `camera_from_world` of every frame, by input frame.
    pub trajectory: Vec<(usize, Se3)>,
    /// What is left on every edge, in the graph's order.
    pub residuals: Vec<EdgeResidual>,
    /// What it took.
    pub effort: Effort,
}

impl Solution {
    /// The map of a camera that stands still: nothing is estimated, all poses are the identity and all
    /// points at infinity.
    #[must_use]
    pub fn standing(graph: &FlowGraph, camera: Pinhole) -> Self {
        let scene = Scene {
            camera,
            grid: graph.grid,
            poses: vec![Se3::IDENTITY; graph.frames.len()],
            inverse_depths: vec![0.0; graph.frames.len() * graph.grid.cells()],
        };
        let followers = graph.followers.iter().map(|follower| follower.frame);
        let mut frames: Vec<usize> = graph.frames.iter().copied().chain(followers).collect();
        frames.sort_unstable();
        let still = |frame| (frame, Se3::IDENTITY);
        Self {
            trajectory: frames.into_iter().map(still).collect(),
            residuals: graph.edges.iter().map(|e| residual(&scene, e)).collect(),
            scene,
            effort: Effort {
                converged: true,
                ..Effort::default()
            },
        }
    }

    /// Mean residual over all cells of all edges, px of a 256-px-high picture.
    #[must_use]
    pub fn mean_residual_px(&self) -> Option<f64> {
        let cells: usize = self.residuals.iter().map(|r| r.cells).sum();
        let sum: f64 = self.residuals.iter().map(|r| r.sum_px).sum();
        (cells > 0).then(|| sum / cells as f64)
    }
}

/// Finds poses and inverse depths. `camera` is in cells.
///
/// # Errors
/// [`TrackError`]; [`BundleError::NotPositiveDefinite`](crate::slam::bundle::BundleError) where the
/// poses are not determined at any damping.
pub fn solve(
    graph: &FlowGraph,
    camera: Pinhole,
    params: &TrackParams,
) -> Result<Solution, TrackError> {
    Map::new(graph, camera, params)?.solved()
}

/// Finds rotations alone: no depth is estimated, all points are at infinity.
///
/// # Errors
/// As [`solve`].
pub fn rotate_only(
    graph: &FlowGraph,
    camera: Pinhole,
    params: &TrackParams,
) -> Result<Solution, TrackError> {
    let mut map = Map::new(graph, camera, params)?;
    map.motion_only = true;
    map.solved()
}

/// A map in the making.
struct Map<'a> {
    graph: &'a FlowGraph,
    params: &'a TrackParams,
    scene: Scene,
    /// Positions of the edges whose later keyframe this is.
    by_later: Vec<Vec<usize>>,
    motion_only: bool,
    workspace: Workspace,
    effort: Effort,
}

impl<'a> Map<'a> {
    fn new(
        graph: &'a FlowGraph,
        camera: Pinhole,
        params: &'a TrackParams,
    ) -> Result<Self, TrackError> {
        params.validate()?;
        if graph.frames.len() < 2 || graph.edges.is_empty() {
            return Err(TrackError::NoEdges);
        }
        let mut by_later = vec![Vec::new(); graph.frames.len()];
        for (index, edge) in graph.edges.iter().enumerate() {
            if let Some(edges) = by_later.get_mut(edge.source.max(edge.target)) {
                edges.push(index);
            }
        }
        Ok(Self {
            graph,
            params,
            scene: Scene {
                camera,
                grid: graph.grid,
                poses: Vec::new(),
                inverse_depths: Vec::new(),
            },
            by_later,
            motion_only: false,
            workspace: Workspace::default(),
            effort: Effort::default(),
        })
    }

    fn solved(mut self) -> Result<Solution, TrackError> {
        self.grow()?;
        self.refine()?;
        self.finish()
    }

    fn options(&self, iterations: usize) -> BundleOptions {
        BundleOptions {
            motion_only: self.motion_only,
            ..self.params.options(iterations)
        }
    }

    /// Keyframe by keyframe: each starts where the last motion would take the camera, with the last
    /// keyframe's median inverse depth; the last few are adjusted to their edges.
    fn grow(&mut self) -> Result<(), TrackError> {
        let frames = self.graph.frames.len();
        let warmup = self.params.warmup.min(frames);
        for slot in 0..frames {
            self.append();
            if slot + 1 < warmup {
                continue;
            }
            let iterations = if slot + 1 == warmup {
                self.params.iterations
            } else {
                self.params.local_iterations
            };
            let first_free = match slot + 1 == warmup {
                true => 1,
                false => (slot + 1).saturating_sub(self.params.window).max(1),
            };
            let edges = self.edges_of(first_free, slot + 1);
            let weights = self.weights(&edges, slot + 1 > warmup);
            let report = self.adjust(&edges, &weights, first_free..slot + 1, iterations)?;
            if slot + 1 == warmup {
                self.turn_over(&edges, &weights, warmup, report.cost_after);
            }
        }
        self.normalise_scale();
        Ok(())
    }

    /// A relief seen from a narrow view is nearly the same as the inverted relief seen from a camera that
    /// moves the other way (u = f (ω − t d) keeps its values for d → 2 m − d, t → −t, ω → ω − 2 m t), and
    /// the descent ends in either. The inverted start is tried, too, and the better kept.
    fn turn_over(&mut self, edges: &[usize], weights: &[Vec<f32>], frames: usize, cost: f64) {
        if self.motion_only {
            return;
        }
        let found = self.scene.clone();
        let cells = self.scene.grid.cells();
        for depths in self.scene.inverse_depths.chunks_exact_mut(cells) {
            let middle = middle(depths);
            for d in depths {
                *d = (2.0 * middle - *d).max(LEAST_INVERTED * middle);
            }
        }
        self.scene.poses.fill(Se3::IDENTITY);
        self.motion_only = true;
        let turned = self.adjust(edges, weights, 1..frames, self.params.iterations);
        self.motion_only = false;
        let inverted =
            turned.and_then(|_| self.adjust(edges, weights, 1..frames, self.params.iterations));
        // An inverted start that cannot be adjusted is no better.
        if !inverted.is_ok_and(|report| report.cost_after < cost) {
            self.scene = found;
        }
    }

    /// Appends the next slot.
    fn append(&mut self) {
        let (slots, cells) = (self.scene.poses.len(), self.scene.grid.cells());
        let pose = match self.scene.poses[..] {
            // Not until the first adjustment is there a motion to go on with.
            [.., before, last] if slots > self.params.warmup => {
                let on = last.relative_to(&before).compose(&last);
                on.normalised().unwrap_or(last)
            }
            [.., last] => last,
            [] => Se3::IDENTITY,
        };
        let depth = match (self.motion_only, slots.checked_sub(1)) {
            (true, _) => 0.0,
            (false, None) => INITIAL_INVERSE_DEPTH,
            (false, Some(last)) => middle(self.scene.inverse_depths_of(last)),
        };
        self.scene.poses.push(pose);
        let values = &mut self.scene.inverse_depths;
        values.resize(values.len() + cells, depth);
    }

    /// The map as a whole, in windows of bounded size.
    fn refine(&mut self) -> Result<(), TrackError> {
        let frames = self.graph.frames.len();
        let most = self.params.most_adjusted;
        self.effort.converged = true;
        let mut first_free = 1;
        loop {
            let end = (first_free + most).min(frames);
            self.refine_window(first_free, end)?;
            if end == frames {
                break;
            }
            first_free += most / 2;
        }
        self.normalise_scale();
        Ok(())
    }

    fn refine_window(&mut self, first_free: usize, end: usize) -> Result<(), TrackError> {
        let edges = self.edges_of(first_free, end);
        for _ in 0..self.params.rounds {
            let weights = self.weights(&edges, true);
            let iterations = self.params.iterations;
            let report = self.adjust(&edges, &weights, first_free..end, iterations)?;
            let gain = report.cost_before - report.cost_after;
            if gain <= self.params.tolerance * report.cost_before {
                return Ok(());
            }
        }
        self.effort.converged = false;
        Ok(())
    }

    /// Positions of the edges inside `..end` with a free end.
    fn edges_of(&self, first_free: usize, end: usize) -> Vec<usize> {
        self.by_later[first_free..end].concat()
    }

    /// Each edge's weights, robust or as they are.
    fn weights(&self, edges: &[usize], robust: bool) -> Vec<Vec<f32>> {
        let weights = |&edge: &usize| {
            let edge = &self.graph.edges[edge];
            match robust {
                true => robust_weights(&self.scene, edge, self.params.huber_px),
                false => edge.answer.weight.clone(),
            }
        };
        edges.iter().map(weights).collect()
    }

    fn adjust(
        &mut self,
        edges: &[usize],
        weights: &[Vec<f32>],
        free: std::ops::Range<usize>,
        iterations: usize,
    ) -> Result<Report, TrackError> {
        let observations: Vec<EdgeObservation<'_>> = edges
            .iter()
            .zip(weights)
            .map(|(&edge, weight)| EdgeObservation {
                weight,
                ..self.graph.edges[edge].observation()
            })
            .collect();
        let problem = Problem {
            edges: &observations,
            free,
            depth_damping: None,
            measured: None,
        };
        let options = self.options(iterations);
        let report = adjust(&mut self.scene, &problem, &options, &mut self.workspace)?;
        self.effort.count(&report);
        Ok(report)
    }

    /// The scale is free: the median inverse depth becomes 1.
    fn normalise_scale(&mut self) {
        if self.motion_only {
            return;
        }
        let middle = middle(&self.scene.inverse_depths);
        let depths = self.scene.inverse_depths.iter_mut();
        depths.for_each(|d| *d /= middle);
        let poses = self.scene.poses.iter_mut();
        poses.for_each(|pose| pose.translation *= middle);
    }

    fn finish(mut self) -> Result<Solution, TrackError> {
        let (graph, scene) = (self.graph, &self.scene);
        let residuals = graph.edges.iter().map(|edge| residual(scene, edge));
        let residuals = residuals.collect();
        if !self.motion_only {
            self.effort.depth_cells = scene.inverse_depths.len();
        }
        let trajectory = poses::trajectory(graph, scene, self.params)?;
        Ok(Solution {
            scene: self.scene,
            trajectory,
            residuals,
            effort: self.effort,
        })
    }
}

/// The edges among the first keyframes, as many as are refined together.
pub(in crate::slam) fn first_edges<'a>(
    graph: &'a FlowGraph,
    params: &TrackParams,
) -> impl Iterator<Item = &'a FlowEdge> {
    let end = params.most_adjusted;
    let edges = graph.edges.iter();
    edges.filter(move |edge| edge.source.max(edge.target) < end)
}

/// The median of inverse depths, which are positive; 1 without any. Not the mean: what moves by itself goes
/// to the bounds, a thousand times the rest.
fn middle(depths: &[f64]) -> f64 {
    let mut sorted = depths.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    let middle = sorted.get(sorted.len() / 2).copied();
    middle.unwrap_or(INITIAL_INVERSE_DEPTH)
}

/// Settles the first keyframes near a solution again, the weights being those of the solution, and
/// gives the cost. For what depends on the camera: costs under different cameras compare because
/// nothing else changes.
///
/// # Errors
/// As [`solve`].
pub(in crate::slam) fn resolve(
    graph: &FlowGraph,
    scene: &mut Scene,
    solution: &Solution,
    params: &TrackParams,
) -> Result<f64, TrackError> {
    let edges: Vec<(&FlowEdge, Vec<f32>)> = first_edges(graph, params)
        .map(|edge| (edge, robust_weights(&solution.scene, edge, params.huber_px)))
        .collect();
    let observations: Vec<EdgeObservation<'_>> = edges
        .iter()
        .map(|(edge, weight)| EdgeObservation {
            weight,
            ..edge.observation()
        })
        .collect();
    let problem = Problem {
        edges: &observations,
        free: 1..scene.poses.len().min(params.most_adjusted),
        depth_damping: None,
        measured: None,
    };
    let options = params.options(params.iterations);
    let report = adjust(scene, &problem, &options, &mut Workspace::default())?;
    Ok(report.cost_after)
}
