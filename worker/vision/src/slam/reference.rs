//! WorldScore's tracker: DROID-SLAM's front end and two global adjustments, bookkeeping and quirks
//! included, with the correspondence operator injected.
//!
//! Every frame that is pushed becomes a keyframe (the motion filter stands before this and is the
//! operator's matter: with WorldScore's threshold practically every frame passes). From the eighth
//! on, each is tracked in a window; one of two keyframes that look alike is removed. At the end all
//! are adjusted together, twice; the score is the mean reprojection error that the second leaves.
//! Source: WorldScore's vendored droid_slam (Dec 2025) over DROID-SLAM commit 8016d2b. State is kept
//! as f32 between adjustments, as there. Units: grid cells (1/8 px of the working picture).

use serde::{Deserialize, Serialize};

use super::bundle::{BundleError, BundleOptions, EdgeObservation, Problem, Workspace, adjust};
use super::camera::{Grid, Pinhole};
use super::graph::{Edge, FactorGraph, Proximity, neighbourhood};
use super::keyframes::{Keyframes, MeanError};
use super::operator::{CorrespondenceOperator, EdgeAnswer, EdgeQuery};
use crate::scene::AdjustedEdge;

/// The tracker's constants; [`default`](Self::default) is WorldScore's.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReferenceParams {
    /// Keyframes at which tracking starts.
    pub warmup: usize,
    /// Most keyframes.
    pub buffer: usize,
    /// Share of the whole motion in a frame distance. At the start another one is used.
    pub beta: f64,
    /// Share of the whole motion while tracking starts: the function's default there.
    pub beta_at_start: f64,
    /// A keyframe nearer to the one before than this is removed, cells.
    pub keyframe_distance: f64,
    /// Largest distance of an edge, cells: front end, back end.
    pub edge_distance: [f64; 2],
    /// Keyframes that the front end looks back.
    pub window: usize,
    /// Most active edges of the front end.
    pub most_edges: usize,
    /// Updates after which an edge is retired.
    pub most_age: u32,
    /// Updates for each new keyframe, and once more where it stays.
    pub frontend_updates: [usize; 2],
    /// Most edges of the back end for each keyframe.
    pub backend_edges: usize,
    /// Updates of both back end runs.
    pub backend_steps: [usize; 2],
    /// A back end run ends early once an update moves its targets by less than this in the mean, cells. The
    /// reference never does.
    pub stop_below: Option<f64>,
    /// Factor of the operator's depth damping, and what is added to it.
    pub damping: [f32; 2],
    /// Least inverse depth after an adjustment.
    pub least_inverse_depth: f64,
}

impl Default for ReferenceParams {
    fn default() -> Self {
        Self {
            warmup: 8,
            buffer: 512,
            beta: f64::from(0.3f32),
            beta_at_start: 0.25,
            keyframe_distance: 4.0,
            edge_distance: [16.0, 22.0],
            window: 25,
            most_edges: 48,
            most_age: 25,
            frontend_updates: [4, 2],
            backend_edges: 16,
            backend_steps: [7, 12],
            stop_below: None,
            damping: [0.2, 1e-7],
            least_inverse_depth: 0.001,
        }
    }
}

/// Keyframes around which edges are made for each new one.
const FRONTEND_ROWS: usize = 5;
/// Frames on either side that are joined when tracking starts.
const START_RADIUS: usize = 3;
/// Updates at the start, twice.
const START_UPDATES: usize = 8;
/// Proximity edges: radius, and suppression at the start, while tracking, at the end.
const RADIUS: usize = 2;
const SUPPRESSION: [usize; 3] = [2, 1, 3];
/// Edges from keyframes before this one are retired after the start.
const RETIRED_AFTER_START: usize = 4;
/// Inactive edges reach this far before the adjusted window.
const INACTIVE_REACH: usize = 3;

/// Why a video has no score.
#[derive(Debug, thiserror::Error)]
pub enum TrackError {
    /// An adjustment failed.
    #[error(transparent)]
    Bundle(#[from] BundleError),
    /// The operator failed.
    #[error("correspondences: {0}")]
    Operator(#[source] Box<dyn std::error::Error + Send + Sync>),
    /// More keyframes than the buffer holds.
    #[error("more than {most} keyframes")]
    TooManyKeyframes {
        /// The limit.
        most: usize,
    },
    /// Fewer than two keyframes: there is nothing to compare.
    #[error("no frame pair to compare")]
    NoEdges,
}

/// A video being tracked.
#[derive(Debug)]
pub struct ReferenceTracker<O> {
    params: ReferenceParams,
    operator: O,
    /// The keyframes.
    pub keyframes: Keyframes,
    /// The front end's graph; after [`global`](Self::global) the back end's.
    pub graph: FactorGraph,
    /// Keyframes that the front end has taken; 0 before it starts.
    pub tracked: usize,
    /// Distance of the last two settled keyframes, cells, when last looked at.
    pub keyframe_distance: Option<f64>,
    workspace: Workspace,
}

/// Which poses an update adjusts, and how.
struct Update {
    first_free: Option<usize>,
    uses_inactive: bool,
    options: BundleOptions,
}

impl Update {
    fn frontend(first_free: Option<usize>) -> Self {
        Self {
            first_free,
            uses_inactive: true,
            options: BundleOptions::worldscore(),
        }
    }
}

impl<O: CorrespondenceOperator> ReferenceTracker<O> {
    /// A tracker without frames. `camera` is in cells of `grid`.
    #[must_use]
    pub fn new(camera: Pinhole, grid: Grid, operator: O, params: ReferenceParams) -> Self {
        Self {
            params,
            operator,
            keyframes: Keyframes::new(camera, grid),
            graph: FactorGraph::default(),
            tracked: 0,
            keyframe_distance: None,
            workspace: Workspace::default(),
        }
    }

    /// The operator, which a frame may have to be shown to before it is pushed.
    pub fn operator_mut(&mut self) -> &mut O {
        &mut self.operator
    }

    /// The operator, when all is done.
    #[must_use]
    pub fn into_operator(self) -> O {
        self.operator
    }

    /// Takes the next frame.
    ///
    /// # Errors
    /// [`TrackError`].
    pub fn push(&mut self, frame: usize) -> Result<(), TrackError> {
        if self.keyframes.len() == self.params.buffer {
            return Err(TrackError::TooManyKeyframes {
                most: self.params.buffer,
            });
        }
        self.keyframes.append(frame);
        if self.tracked > 0 {
            self.track()
        } else if self.keyframes.len() == self.params.warmup {
            self.start()
        } else {
            Ok(())
        }
    }

    /// The two global adjustments; returns what the second leaves, the score. The front end's graph
    /// is discarded.
    ///
    /// # Errors
    /// [`TrackError::NoEdges`] below two keyframes; see [`TrackError`].
    pub fn finish(&mut self) -> Result<MeanError, TrackError> {
        let [first, second] = self.params.backend_steps;
        self.global(first)?;
        self.global(second)
    }

    fn start(&mut self) -> Result<(), TrackError> {
        self.tracked = self.keyframes.len();
        self.add(&neighbourhood(self.tracked, START_RADIUS), None);
        self.updates(START_UPDATES, Some(1))?;
        let proximity = Proximity {
            first_row: 0,
            first_column: 0,
            radius: RADIUS,
            suppression: SUPPRESSION[0],
            most_distance: self.params.edge_distance[0],
            most_edges: self.params.most_edges,
        };
        self.add_near(&proximity, self.params.beta_at_start, None);
        self.updates(START_UPDATES, Some(1))?;
        self.keyframes.prepare_from(self.tracked.saturating_sub(4));
        self.graph.retire(|edge| edge.source < RETIRED_AFTER_START);
        Ok(())
    }

    fn track(&mut self) -> Result<(), TrackError> {
        self.tracked += 1;
        let most_age = self.params.most_age;
        self.graph.retire(|edge| edge.age > most_age);
        let proximity = Proximity {
            first_row: self.tracked.saturating_sub(FRONTEND_ROWS),
            first_column: self.tracked.saturating_sub(self.params.window),
            radius: RADIUS,
            suppression: SUPPRESSION[1],
            most_distance: self.params.edge_distance[0],
            most_edges: self.params.most_edges,
        };
        self.add_near(&proximity, self.params.beta, Some(self.params.most_edges));
        self.updates(self.params.frontend_updates[0], None)?;
        let (before, after) = (self.tracked - 3, self.tracked - 2);
        self.keyframe_distance = self.keyframes.distance(before, after, self.params.beta);
        if self
            .keyframe_distance
            .is_some_and(|d| d < self.params.keyframe_distance)
        {
            self.operator.forget(self.keyframes.frames[after]);
            self.keyframes.replace_by_last();
            self.graph.remove_keyframe(after);
            self.tracked -= 1;
        } else {
            self.updates(self.params.frontend_updates[1], None)?;
        }
        self.keyframes.prepare_from(self.tracked - 1);
        Ok(())
    }

    /// One global adjustment of `steps` updates.
    ///
    /// # Errors
    /// As [`finish`](Self::finish).
    pub fn global(&mut self, steps: usize) -> Result<MeanError, TrackError> {
        self.keyframes.normalise_scale();
        self.keyframes.store_as_f32(f64::NEG_INFINITY);
        self.graph = self.graph.emptied();
        let frames = self.keyframes.len();
        let proximity = Proximity {
            first_row: 0,
            first_column: 0,
            radius: RADIUS,
            suppression: SUPPRESSION[2],
            most_distance: self.params.edge_distance[1],
            most_edges: self.params.backend_edges * frames,
        };
        self.add_near(&proximity, self.params.beta, None);
        if self.graph.active.is_empty() {
            return Err(TrackError::NoEdges);
        }
        let update = Update {
            first_free: Some(1),
            uses_inactive: false,
            options: BundleOptions::worldscore_backend(),
        };
        for _ in 0..steps {
            let moved = self.update(&update)?;
            if self.params.stop_below.is_some_and(|least| moved < least) {
                break;
            }
        }
        Ok(self.keyframes.mean_error(&self.graph))
    }

    /// What is left on each edge of the graph, in its order: after [`finish`](Self::finish) the parts of the
    /// score. Lengths are cells, also where a name says px.
    #[must_use]
    pub fn residuals(&self) -> Vec<AdjustedEdge> {
        let (frames, grid) = (&self.keyframes.frames, self.keyframes.scene.grid);
        let of_edge = |edge: &Edge| {
            let lengths = self.keyframes.residuals(edge);
            AdjustedEdge {
                from_frame: frames[edge.source],
                to_frame: frames[edge.target],
                columns: grid.columns,
                rows: grid.rows,
                sum_px: lengths.iter().flatten().sum(),
                cells: lengths.iter().flatten().count(),
                map_px: lengths
                    .iter()
                    .map(|length| length.map(|l| l as f32))
                    .collect(),
            }
        };
        self.graph.active.iter().map(of_edge).collect()
    }

    fn add_near(&mut self, proximity: &Proximity, beta: f64, limit: Option<usize>) {
        let keyframes = &self.keyframes;
        let distance = |i, j| keyframes.distance(i, j, beta);
        let pairs = proximity.pairs(&self.graph, keyframes.len(), distance);
        self.add(&pairs, limit);
    }

    fn add(&mut self, pairs: &[(usize, usize)], limit: Option<usize>) {
        let keyframes = &self.keyframes;
        self.graph
            .add(pairs, limit, |i, j| keyframes.reprojection(i, j).0);
    }

    fn updates(&mut self, count: usize, first_free: Option<usize>) -> Result<(), TrackError> {
        for _ in 0..count {
            self.update(&Update::frontend(first_free))?;
        }
        Ok(())
    }

    /// Asks the operator about the active edges, then adjusts to its answers. Gives how far those moved the
    /// targets, mean over all cells of all edges, cells.
    fn update(&mut self, update: &Update) -> Result<f64, TrackError> {
        let moved = self.ask().map_err(|e| TrackError::Operator(Box::new(e)))?;
        let active = self.graph.active.iter();
        let default = active.map(|e| e.source + 1).min().unwrap_or(1).max(1);
        let first_free = update.first_free.unwrap_or(default);
        let reach = first_free.saturating_sub(INACTIVE_REACH);
        let is_near =
            |edge: &&Edge| update.uses_inactive && edge.source >= reach && edge.target >= reach;
        let observe = |edge| {
            let Edge {
                source,
                target,
                at,
                weight,
                ..
            }: &Edge = edge;
            EdgeObservation {
                source: *source,
                target: *target,
                at,
                weight,
            }
        };
        let inactive = self.graph.inactive.iter().filter(is_near);
        let edges: Vec<EdgeObservation<'_>> =
            inactive.chain(&self.graph.active).map(observe).collect();
        let last = edges.iter().map(|e| e.source.max(e.target) + 1).max();
        let [factor, floor] = self.params.damping;
        let damping: Vec<f32> = self
            .keyframes
            .damping
            .iter()
            .map(|d| factor * d + floor)
            .collect();
        let free = first_free..last.unwrap_or(first_free).max(first_free);
        let problem = Problem {
            edges: &edges,
            free,
            depth_damping: Some(&damping),
            measured: None,
        };
        adjust(
            &mut self.keyframes.scene,
            &problem,
            &update.options,
            &mut self.workspace,
        )?;
        self.keyframes.store_as_f32(self.params.least_inverse_depth);
        for edge in &mut self.graph.active {
            edge.age += 1;
        }
        Ok(moved)
    }

    fn ask(&mut self) -> Result<f64, O::Error> {
        let keyframes = &self.keyframes;
        let reprojected: Vec<Vec<f32>> = self
            .graph
            .active
            .iter()
            .map(|e| keyframes.reprojection(e.source, e.target).0)
            .collect();
        let last: Vec<Vec<f32>> = self.graph.active.iter().map(|e| e.at.clone()).collect();
        let fields = reprojected.iter().zip(&last);
        let queries: Vec<EdgeQuery<'_>> = self
            .graph
            .active
            .iter()
            .zip(fields)
            .map(|(edge, (reprojected, last_target))| EdgeQuery {
                id: edge.id,
                source_frame: keyframes.frames[edge.source],
                target_frame: keyframes.frames[edge.target],
                reprojected,
                last_target,
            })
            .collect();
        let active = self.graph.active.iter_mut();
        let mut answers: Vec<EdgeAnswer<'_>> = active
            .map(|edge| EdgeAnswer {
                at: &mut edge.at,
                weight: &mut edge.weight,
            })
            .collect();
        self.operator.update(&queries, &mut answers)?;
        let (mut moved, mut count) = (0.0, 0usize);
        for (query, answer) in queries.iter().zip(&answers) {
            let (x, y) = answer.at.split_at(answer.at.len() / 2);
            let (from_x, from_y) = query.reprojected.split_at(x.len());
            for ((x, from_x), (y, from_y)) in x.iter().zip(from_x).zip(y.iter().zip(from_y)) {
                let (dx, dy) = (f64::from(x - from_x), f64::from(y - from_y));
                moved += libm::sqrt(dx * dx + dy * dy);
            }
            count += x.len();
        }
        let moved = moved / count.max(1) as f64;
        let mut sources: Vec<usize> = self.graph.active.iter().map(|e| e.source).collect();
        sources.sort_unstable();
        sources.dedup();
        let cells = self.keyframes.scene.grid.cells();
        for slot in sources {
            let damping = &mut self.keyframes.damping[slot * cells..(slot + 1) * cells];
            self.operator
                .depth_damping(self.keyframes.frames[slot], damping)?;
        }
        Ok(moved)
    }
}
