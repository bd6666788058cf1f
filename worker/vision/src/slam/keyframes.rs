//! The keyframes of a tracker: a scene whose slots come and go, and what is asked of it.

use super::bundle::Scene;
use super::camera::{DepthRule, Grid, Pinhole, project};
use super::distance::symmetric_distance;
use super::graph::{Edge, FactorGraph};
use super::se3::Se3;

/// Slots with pose, inverse depths and the input frame that each holds.
#[derive(Debug, Clone, PartialEq)]
pub struct Keyframes {
    /// Poses and inverse depths of all slots: the used ones, then one that is prepared for the next.
    pub scene: Scene,
    /// Input frame of each used slot.
    pub frames: Vec<usize>,
    /// Depth damping of each slot, `[slots, rows, columns]`; slots keep theirs when keyframes move.
    pub damping: Vec<f32>,
}

/// Inverse depth of a frame of which nothing is known.
const INITIAL_INVERSE_DEPTH: f64 = 1.0;

/// Damping before the operator's first answer; the reference's.
const INITIAL_DAMPING: f32 = 1e-6;

impl Keyframes {
    /// No keyframes; the first slot is prepared.
    #[must_use]
    pub fn new(camera: Pinhole, grid: Grid) -> Self {
        let mut keyframes = Self {
            scene: Scene {
                camera,
                grid,
                poses: Vec::new(),
                inverse_depths: Vec::new(),
            },
            frames: Vec::new(),
            damping: Vec::new(),
        };
        keyframes.prepare_slot();
        keyframes
    }

    /// Number of used slots.
    #[must_use]
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Puts an input frame into the prepared slot, with the pose and depths that are there.
    pub fn append(&mut self, frame: usize) {
        self.frames.push(frame);
        self.prepare_slot();
    }

    fn prepare_slot(&mut self) {
        let cells = self.scene.grid.cells();
        if self.scene.poses.len() <= self.frames.len() {
            self.scene.poses.push(Se3::IDENTITY);
            let depths = &mut self.scene.inverse_depths;
            depths.resize(depths.len() + cells, INITIAL_INVERSE_DEPTH);
            self.damping
                .resize(self.damping.len() + cells, INITIAL_DAMPING);
        }
    }

    /// The prepared slot starts from the last pose and from the mean inverse depth of slots `from..`.
    pub fn prepare_from(&mut self, from: usize) {
        let (next, cells) = (self.len(), self.scene.grid.cells());
        if from >= next {
            return;
        }
        self.scene.poses[next] = self.scene.poses[next - 1];
        let recent = &self.scene.inverse_depths[from * cells..next * cells];
        let mean = recent.iter().sum::<f64>() / recent.len() as f64;
        self.scene.inverse_depths[next * cells..(next + 1) * cells].fill(round(mean));
    }

    /// The last keyframe but one gives way to the last.
    pub fn replace_by_last(&mut self) {
        let Some(slot) = self.len().checked_sub(2) else {
            return;
        };
        let cells = self.scene.grid.cells();
        self.scene.poses[slot] = self.scene.poses[slot + 1];
        let last = (slot + 1) * cells..(slot + 2) * cells;
        self.scene.inverse_depths.copy_within(last, slot * cells);
        self.frames[slot] = self.frames[slot + 1];
        self.frames.pop();
    }

    /// Where the cells of one slot are in another, `[2, rows, columns]`, and whether each lies far
    /// enough in front of the camera.
    #[must_use]
    pub fn reprojection(&self, source: usize, target: usize) -> (Vec<f32>, Vec<bool>) {
        let (grid, cells) = (self.scene.grid, self.scene.grid.cells());
        // The reference normalises here (lietorch does when it composes), but not in the adjustment:
        // rounding to f32 leaves the norms off by 1e-7, which near cells magnify.
        let pose = |slot: usize| {
            let stored = self.scene.poses[slot];
            stored.normalised().unwrap_or(stored)
        };
        let relative = pose(target).relative_to(&pose(source));
        let rule = DepthRule::WORLDSCORE;
        let (mut at, mut valid) = (vec![0.0; 2 * cells], vec![false; cells]);
        for (cell, &d) in self.scene.inverse_depths_of(source).iter().enumerate() {
            let from = [(cell % grid.columns) as f64, (cell / grid.columns) as f64];
            let (to, point) = project(&self.scene.camera, &relative, from, d, rule);
            at[cell] = to.x as f32;
            at[cells + cell] = to.y as f32;
            valid[cell] = point.z > rule.valid_above;
        }
        (at, valid)
    }

    /// Symmetric frame distance of two slots, cells.
    #[must_use]
    pub fn distance(&self, first: usize, second: usize, beta: f64) -> Option<f64> {
        let side = |slot: usize| (&self.scene.poses[slot], self.scene.inverse_depths_of(slot));
        let sides = [side(first), side(second)];
        symmetric_distance(&self.scene.camera, self.scene.grid, sides, beta)
    }

    /// Divides by the mean inverse depth of the used slots, and returns it.
    pub fn normalise_scale(&mut self) -> f64 {
        let used = self.len() * self.scene.grid.cells();
        let depths = &mut self.scene.inverse_depths[..used];
        let mean = round(depths.iter().sum::<f64>() / used.max(1) as f64);
        if mean > 0.0 {
            depths.iter_mut().for_each(|d| *d /= mean);
            let poses = self.scene.poses.iter_mut().take(self.frames.len());
            poses.for_each(|p| p.translation *= mean);
        }
        mean
    }

    /// Keeps every inverse depth at least `least`, and rounds all state to f32 as the reference's
    /// buffers do.
    pub(super) fn store_as_f32(&mut self, least: f64) {
        for d in &mut self.scene.inverse_depths {
            *d = round(d.max(least));
        }
        for pose in &mut self.scene.poses {
            *pose = Se3::from_array(pose.to_array().map(round));
        }
    }

    /// Distance between reprojection and target of each cell of an edge, cells; none behind the camera.
    pub(super) fn residuals(&self, edge: &Edge) -> Vec<Option<f64>> {
        let cells = self.scene.grid.cells();
        let (at, good) = self.reprojection(edge.source, edge.target);
        let length = |cell: usize| {
            let difference = |k: usize| f64::from(at[k]) - f64::from(edge.at[k]);
            let (du, dv) = (difference(cell), difference(cells + cell));
            good[cell].then(|| libm::sqrt(du * du + dv * dv))
        };
        (0..cells).map(length).collect()
    }

    /// Mean distance between reprojection and target over all valid cells of the active edges, cells;
    /// how many those are, and of how many. The score of WorldScore's 3D consistency.
    #[must_use]
    pub fn mean_error(&self, graph: &FactorGraph) -> MeanError {
        let cells = self.scene.grid.cells();
        let (mut sum, mut valid, mut total) = (0.0, 0usize, 0usize);
        for edge in &graph.active {
            for length in self.residuals(edge).into_iter().flatten() {
                sum += length;
                valid += 1;
            }
            total += cells;
        }
        MeanError {
            mean_cells: (valid > 0).then(|| sum / valid as f64),
            valid,
            total,
        }
    }
}

/// What the adjustment leaves.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeanError {
    /// Mean error, cells of the grid; `None` where no cell is valid.
    pub mean_cells: Option<f64>,
    /// Valid cells, over all edges.
    pub valid: usize,
    /// All cells of all edges.
    pub total: usize,
}

fn round(value: f64) -> f64 {
    f64::from(value as f32)
}
