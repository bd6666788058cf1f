//! A clip's edges while its frames stream by: the motion models of each, and what dense adjustment will need.
//!
//! Adjacent frames have flows of their own. Between frames further apart the flow is followed from frame to
//! frame on the grid ([`Profile::follow_flow`]): a few look-ups per cell in the place of two searches over
//! the picture. A camera that stands or turns is told from one that travels as well by these; under parallax,
//! where depth is estimated from the longer baselines, the clip is looked at a second time, and they get flows
//! of their own.

use std::collections::VecDeque;
use std::rc::Rc;

use plumbline_vision::consistency::EndPoints;
use plumbline_vision::flow::Flow;
use plumbline_vision::scene::{
    ClipGeometry, CorrespondenceField, EdgeInput, MotionModel, RigidSolver, SceneError,
    TwoViewSolver, sample_grid,
};
use plumbline_vision::slam::flow_operator::{grid_of, sample_chain, sample_flow};

use super::error::{ClipError, at};
use super::geometry::{DenseGraph, DenseWork, weigh};
use super::network_flow::Confidence;
use crate::profile::Profile;

/// Weight of a correspondence whose forward and backward flow disagree utterly: not zero, since the
/// models must not be chosen on the consistent part alone.
const LEAST_WEIGHT: f64 = 1e-3;

/// The flows of a pair of frames.
pub(super) struct PairFlows {
    /// Forward and backward.
    pub(super) ways: [Flow; 2],
    /// How far the network that found them trusts each, where one did.
    pub(super) confidence: Option<[Confidence; 2]>,
}

impl PairFlows {
    /// Flows that no network found.
    pub(super) fn of(ways: [Flow; 2]) -> Self {
        Self {
            ways,
            confidence: None,
        }
    }
}

/// The flows of a pair, which longer edges follow.
pub(super) type Flows = Rc<PairFlows>;

/// The edges of one clip.
pub(super) struct Edges<'a> {
    profile: &'a Profile,
    solver: Option<TwoViewSolver>,
    problem: Option<SceneError>,
    dense: DenseGraph,
    /// Of the latest adjacent pairs, in order, as many as the longest span.
    chain: VecDeque<Flows>,
    followed: usize,
    /// What the first look found, during the second.
    first: Option<(TwoViewSolver, DenseGraph)>,
}

impl<'a> Edges<'a> {
    pub(super) fn new(profile: &'a Profile) -> Self {
        let (solver, problem) = match TwoViewSolver::new(profile.two_view) {
            Ok(solver) => (Some(solver), None),
            Err(problem) => (None, Some(problem)),
        };
        Self {
            profile,
            solver,
            problem,
            dense: DenseGraph::default(),
            chain: VecDeque::new(),
            followed: 0,
            first: None,
        }
    }

    /// Takes the size of the clip's frames: as decoded, as worked on.
    pub(super) fn sized(&mut self, video: (usize, usize), working: (usize, usize)) {
        self.dense.sized(video, working);
    }

    /// Takes the flows of the next adjacent pair, from which those of longer edges are followed.
    pub(super) fn adjacent(&mut self, flows: Flows) {
        let longest = self.profile.edge_spans.last().copied().unwrap_or(1) as usize;
        if self.chain.len() == longest {
            self.chain.pop_front();
        }
        self.chain.push_back(flows);
    }

    /// An edge with flows of its own; each correspondence weighs by how well the two directions agree, and in
    /// the adjustment by how far a network trusts it, where one found it.
    pub(super) fn measured(
        &mut self,
        from: u32,
        to: u32,
        flows: &PairFlows,
    ) -> Result<(), ClipError> {
        let [forward, backward] = &flows.ways;
        let (width, height) = (forward.width, forward.height);
        let consistency = &self.profile.consistency;
        let unit_px = consistency.reference_height_px / height as f64;
        let end_points = EndPoints::new(forward, backward, consistency);
        let end_points = end_points.map_err(at("consistency", to))?;
        let weight_at = |x: usize, y: usize| {
            let error_px = f64::from(end_points.error_px(x, y)?);
            Some((1.0 / (1.0 + error_px * error_px)).max(LEAST_WEIGHT))
        };
        let grid = &self.profile.grid;
        let field = sample_grid(forward, unit_px, grid, weight_at).map_err(at("geometry", to))?;
        self.judge(from, to, field)?;
        let size = grid_of(width, height, grid.step);
        let answers = || {
            let there = sample_flow(forward, backward, grid.step)?;
            let mut answers = [there, sample_flow(backward, forward, grid.step)?];
            for (answer, confidence) in answers.iter_mut().zip(flows.confidence.iter().flatten()) {
                weigh(answer, confidence, size, grid.step);
            }
            Ok(answers)
        };
        let added = self.dense.edge(from, to, size, answers);
        added.map_err(at("geometry", to))
    }

    /// An edge over the last adjacent pairs, followed from frame to frame.
    pub(super) fn followed(&mut self, from: u32, to: u32) -> Result<(), ClipError> {
        let error = at("geometry", to);
        let step = self.profile.grid.step;
        let pairs = (to - from) as usize;
        let chain: Vec<Flows> = self.chain.iter().rev().take(pairs).rev().cloned().collect();
        let there: Vec<&Flow> = chain.iter().map(|flows| &flows.ways[0]).collect();
        let back: Vec<&Flow> = chain.iter().rev().map(|flows| &flows.ways[1]).collect();
        let forward = sample_chain(&there, &back, step).map_err(&error)?;
        let (width, height) = there.first().map_or((0, 0), |f| (f.width, f.height));
        let grid = grid_of(width, height, step);
        self.followed += 1;
        self.judge(from, to, forward.field(grid, step, height))?;
        let answers = || Ok([forward, sample_chain(&back, &there, step)?]);
        self.dense.edge(from, to, grid, answers).map_err(error)
    }

    fn judge(&mut self, from: u32, to: u32, field: CorrespondenceField) -> Result<(), ClipError> {
        let Some(solver) = &mut self.solver else {
            return Ok(());
        };
        let judged = solver.edge(EdgeInput {
            from_frame: from as usize,
            to_frame: to as usize,
            field,
        });
        match judged {
            // Too little in frame to judge this edge; the others may do.
            Ok(()) | Err(SceneError::TooFewCells { .. }) => Ok(()),
            Err(source) => Err(at("geometry", to)(source)),
        }
    }

    /// Whether depth is to be estimated, and some edge has no flow of its own.
    pub(super) fn need_second_look(&mut self) -> bool {
        let depth = |solver: &mut TwoViewSolver| {
            self.profile.force_adjustment || solver.verdict() == MotionModel::Rigid
        };
        self.followed > 0 && self.solver.as_mut().is_some_and(depth)
    }

    /// Begins anew, every edge now with flows of its own.
    pub(super) fn look_again(&mut self) {
        let fresh = Self::new(self.profile);
        let Some(found) = std::mem::replace(&mut self.solver, fresh.solver) else {
            return;
        };
        let dense = self.dense.anew();
        self.first = Some((found, std::mem::replace(&mut self.dense, dense)));
        self.followed = 0;
    }

    /// Keeps the edge of the first look.
    pub(super) fn keep(&mut self, from: u32, to: u32) -> Result<(), ClipError> {
        let Some((found, dense)) = &mut self.first else {
            return Ok(());
        };
        let ends = (from as usize, to as usize);
        let same = found
            .edges()
            .iter()
            .find(|e| (e.from_frame, e.to_frame) == ends);
        if let (Some(edge), Some(solver)) = (same, &mut self.solver) {
            solver.adopt(edge.clone());
        }
        if let Some((grid, answers)) = dense.take(from, to) {
            let kept = self.dense.edge(from, to, grid, || Ok(answers));
            kept.map_err(at("geometry", to))?;
        }
        Ok(())
    }

    /// The clip's geometry.
    pub(super) fn settle(&mut self) -> Result<(ClipGeometry, DenseWork), SceneError> {
        match (self.solver.take(), self.problem.take()) {
            (Some(solver), _) => std::mem::take(&mut self.dense).settle(solver, self.profile),
            (None, problem) => Err(problem.unwrap_or(SceneError::NoEdges)),
        }
    }
}
