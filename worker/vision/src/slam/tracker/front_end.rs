//! Keyframes by motion, each joined to those before it.

use super::{CELL_PX, FlowEdge, FlowGraph, Follower, MOST_CELLS, TrackError, TrackParams};
use crate::slam::camera::Grid;
use crate::slam::flow_operator::{FlowOperator, FlowSource, GridAnswer};

/// With fewer cells in the picture than this share, a frame has moved far whatever the others say.
const LEAST_IN_PICTURE: f64 = 0.5;

/// A clip being taken in, frame by frame.
#[derive(Debug)]
pub struct FrontEnd<S> {
    operator: FlowOperator<S>,
    params: TrackParams,
    graph: FlowGraph,
}

impl<S: FlowSource> FrontEnd<S> {
    /// Nothing taken in yet. `grid` is the operator's.
    #[must_use]
    pub fn new(operator: FlowOperator<S>, grid: Grid, params: TrackParams) -> Self {
        Self {
            operator,
            params,
            graph: FlowGraph::new(grid),
        }
    }

    /// The source of the flows.
    pub fn source_mut(&mut self) -> &mut S {
        self.operator.source_mut()
    }

    /// The first frame that flows will still be asked for: earlier ones can be forgotten. `None` before
    /// the first frame.
    #[must_use]
    pub fn needed_from(&self) -> Option<usize> {
        let kept = self.graph.frames.len().saturating_sub(self.params.span);
        self.graph.frames.get(kept).copied()
    }

    /// Takes the next frame; frames increase. Says whether it became a keyframe.
    ///
    /// # Errors
    /// [`TrackError::Flow`], [`TrackError::TooLong`].
    pub fn push(&mut self, frame: usize) -> Result<bool, TrackError> {
        let slot = self.graph.frames.len();
        if let Some(&last) = self.graph.frames.last() {
            let answer = self.operator.answer(last, frame)?;
            if self.moved_px(&answer) < self.params.keyframe_motion_px {
                self.operator.forget_before(frame);
                self.graph.followers.push(Follower {
                    frame,
                    keyframe: slot - 1,
                    answer,
                });
                return Ok(false);
            }
            let most = MOST_CELLS / self.graph.grid.cells().max(1);
            if slot >= most {
                return Err(TrackError::TooLong { keyframes: most });
            }
            self.join(slot - 1, slot, answer);
            let back = self.operator.answer(frame, last)?;
            self.join(slot, slot - 1, back);
            for earlier in (slot.saturating_sub(self.params.span)..slot - 1).rev() {
                let earlier_frame = self.graph.frames[earlier];
                let there = self.operator.answer(earlier_frame, frame)?;
                self.join(earlier, slot, there);
                let back = self.operator.answer(frame, earlier_frame)?;
                self.join(slot, earlier, back);
            }
        }
        self.graph.frames.push(frame);
        Ok(true)
    }

    /// The graph of all frames taken in. The last frame becomes a keyframe, so that no frame lies
    /// outside the map.
    ///
    /// # Errors
    /// As [`push`](Self::push).
    pub fn finish(mut self) -> Result<FlowGraph, TrackError> {
        if let Some(last) = self.graph.followers.last().map(|follower| follower.frame)
            && self.graph.frames.last().is_some_and(|&frame| frame < last)
        {
            self.graph.followers.pop();
            self.params.keyframe_motion_px = 0.0;
            self.push(last)?;
        }
        Ok(self.graph)
    }

    fn join(&mut self, source: usize, target: usize, answer: GridAnswer) {
        self.graph.edges.push(FlowEdge {
            source,
            target,
            answer,
        });
    }

    /// Mean displacement of the cells that stay in the picture, px; infinite where few do.
    fn moved_px(&self, answer: &GridAnswer) -> f64 {
        let (columns, cells) = (self.graph.grid.columns, self.graph.grid.cells());
        let (mut sum, mut count) = (0.0, 0usize);
        for cell in (0..cells).filter(|&cell| answer.weight[cell] > 0.0) {
            let du = f64::from(answer.at[cell]) - (cell % columns) as f64;
            let dv = f64::from(answer.at[cells + cell]) - (cell / columns) as f64;
            sum += libm::sqrt(du * du + dv * dv);
            count += 1;
        }
        if (count as f64) < LEAST_IN_PICTURE * cells as f64 {
            return f64::INFINITY;
        }
        CELL_PX * sum / count as f64
    }
}
