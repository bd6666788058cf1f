//! DROID-SLAM as a correspondence operator: a motion filter that chooses keyframes, then, per edge, a
//! hidden state that every update refines. For [`ReferenceTracker`](crate::slam::reference).
//!
//! Features, context and its share of the gates are computed once per frame. An edge's state begins as its source's and is dropped
//! when the edge is no longer asked for. Edges go through the network in batches, each on its own, so that
//! the size of a batch changes nothing but time and memory. Source: DROID-SLAM (Teed & Deng, 2021) as
//! WorldScore runs it, its slip with the first keyframe included.

use std::collections::BTreeMap;

use half::f16;
use half::slice::HalfFloatSliceExt;
use serde::{Deserialize, Serialize};

use super::correlation::{FeatureMap, FeaturePyramid, look_up};
use super::droid::{DroidNetworks, Edges, GATES, HIDDEN, MOTION, WINDOW, mean_length, motion};
use super::error::{LearnedError, check_length};
use crate::image::Rgb8;
use crate::slam::operator::{CorrespondenceOperator, EdgeAnswer, EdgeId, EdgeQuery};

/// The operator's constants; [`default`](Self::default) is WorldScore's where it has one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DroidOperatorParams {
    /// A frame becomes a keyframe where its mean motion from the last one is above this, cells.
    pub keyframe_motion: f64,
    /// Hidden states and what is made of contexts are kept as 16-bit floats, as upstream: half the memory.
    pub half_storage: bool,
    /// The first keyframe's hidden state and context are its first channel in all channels: upstream's
    /// slip, on which its scores rest.
    pub broadcast_first: bool,
    /// Edges that go through the network together.
    pub edges_per_call: usize,
}

impl Default for DroidOperatorParams {
    fn default() -> Self {
        Self {
            keyframe_motion: 0.01,
            half_storage: true,
            broadcast_first: true,
            edges_per_call: 8,
        }
    }
}

/// Numbers kept for later, `[channels, rows, columns]`.
#[derive(Debug, Clone)]
enum Stored {
    Single(Vec<f32>),
    Half(Vec<f16>),
}

impl Stored {
    fn new(values: &[f32], half: bool) -> Self {
        if !half {
            return Self::Single(values.to_vec());
        }
        let mut stored = vec![f16::ZERO; values.len()];
        stored.convert_from_f32_slice(values);
        Self::Half(stored)
    }

    fn write(&self, out: &mut [f32]) {
        match self {
            Self::Single(values) => out.copy_from_slice(values),
            Self::Half(values) => values.convert_to_f32_slice(out),
        }
    }
}

#[derive(Debug)]
struct Keyframe {
    features: FeaturePyramid,
    net: Stored,
    gates: Stored,
}

#[derive(Debug)]
struct EdgeState {
    source_frame: usize,
    net: Stored,
}

/// The newest keyframe as the motion filter sees it: whole, whatever is stored of it.
#[derive(Debug)]
struct Newest {
    frame: usize,
    net: Vec<f32>,
    gates: Vec<f32>,
}

/// DROID-SLAM's networks with what they know of a video.
pub struct DroidOperator {
    networks: DroidNetworks,
    params: DroidOperatorParams,
    keyframes: BTreeMap<usize, Keyframe>,
    newest: Option<Newest>,
    edges: BTreeMap<EdgeId, EdgeState>,
    edge_updates: u64,
}

impl DroidOperator {
    /// An operator that has seen nothing.
    #[must_use]
    pub fn new(networks: DroidNetworks, params: DroidOperatorParams) -> Self {
        Self {
            networks,
            params,
            keyframes: BTreeMap::new(),
            newest: None,
            edges: BTreeMap::new(),
            edge_updates: 0,
        }
    }

    /// Updates of single edges so far, the motion filter's among them: nearly all of the work.
    #[must_use]
    pub fn edge_updates(&self) -> u64 {
        self.edge_updates
    }

    /// The networks, for the next video.
    #[must_use]
    pub fn into_networks(self) -> DroidNetworks {
        self.networks
    }

    /// Shows the next frame, of whole cells; true if it is a keyframe, which the tracker is then told of.
    ///
    /// # Errors
    /// [`LearnedError`] where the frame does not fit, or a network fails.
    pub fn offer(&mut self, frame: usize, picture: &Rgb8) -> Result<bool, LearnedError> {
        let features = self.networks.features(picture)?;
        let is_first = self.newest.is_none();
        if let Some(motion) = self.motion_to(&features)?
            && motion <= self.params.keyframe_motion
        {
            return Ok(false);
        }
        let context = self.networks.context(picture)?;
        let size = (features.rows, features.columns);
        let gates = self.networks.gates(&context.context, size)?;
        let half = self.params.half_storage;
        let keyframe = if is_first && self.params.broadcast_first {
            let first = |values: &[f32]| values[..values.len() / HIDDEN].repeat(HIDDEN);
            let gates = self.networks.gates(&first(&context.context), size)?;
            Keyframe {
                features: FeaturePyramid::new(features),
                net: Stored::new(&first(&context.net), half),
                gates: Stored::new(&gates, half),
            }
        } else {
            Keyframe {
                features: FeaturePyramid::new(features),
                net: Stored::new(&context.net, half),
                gates: Stored::new(&gates, half),
            }
        };
        self.keyframes.insert(frame, keyframe);
        self.newest = Some(Newest {
            frame,
            net: context.net,
            gates,
        });
        Ok(true)
    }

    /// Mean motion from the newest keyframe to these features, cells; `None` before the first.
    fn motion_to(&mut self, features: &FeatureMap) -> Result<Option<f64>, LearnedError> {
        let Some(newest) = &self.newest else {
            return Ok(None);
        };
        let source = keyframe(&self.keyframes, newest.frame)?.features.finest();
        let (rows, columns) = (source.rows, source.columns);
        if (features.rows, features.columns) != (rows, columns) {
            return Err(LearnedError::SizeMismatch {
                first: (columns, rows),
                second: (features.columns, features.rows),
            });
        }
        let cells = rows * columns;
        let x = (0..cells).map(|cell| (cell % columns) as f32);
        let own: Vec<f32> = x
            .chain((0..cells).map(|cell| (cell / columns) as f32))
            .collect();
        let mut correlation = vec![0.0; WINDOW.channels() * cells];
        let target = FeaturePyramid::new(features.clone());
        look_up(source, &target, &own, WINDOW, &mut correlation)?;
        self.edge_updates += 1;
        let update = self.networks.update(Edges {
            shape: (1, rows, columns),
            net: &newest.net,
            gates: &newest.gates,
            correlation: &correlation,
            motion: &vec![0.0; MOTION * cells],
        })?;
        Ok(Some(mean_length(&update.change)))
    }

    /// One batch of edges.
    fn update_batch(
        &mut self,
        queries: &[EdgeQuery<'_>],
        answers: &mut [EdgeAnswer<'_>],
    ) -> Result<(), LearnedError> {
        let Some(first) = queries.first() else {
            return Ok(());
        };
        let finest = keyframe(&self.keyframes, first.source_frame)?
            .features
            .finest();
        let (rows, columns) = (finest.rows, finest.columns);
        let cells = rows * columns;
        let zeros = |channels: usize| vec![0.0; queries.len() * channels * cells];
        let (mut net, mut gates) = (zeros(HIDDEN), zeros(GATES));
        let mut correlation = zeros(WINDOW.channels());
        let mut motions = Vec::with_capacity(queries.len() * MOTION * cells);
        for (index, query) in queries.iter().enumerate() {
            let source = keyframe(&self.keyframes, query.source_frame)?;
            let target = keyframe(&self.keyframes, query.target_frame)?;
            let state = self.edges.get(&query.id);
            let of_edge = &mut net[index * HIDDEN * cells..][..HIDDEN * cells];
            state.map_or(&source.net, |s| &s.net).write(of_edge);
            let of_edge = &mut gates[index * GATES * cells..][..GATES * cells];
            source.gates.write(of_edge);
            let taps = WINDOW.channels() * cells;
            look_up(
                source.features.finest(),
                &target.features,
                query.reprojected,
                WINDOW,
                &mut correlation[index * taps..(index + 1) * taps],
            )?;
            motions.extend(motion(
                query.reprojected,
                query.last_target,
                (rows, columns),
            )?);
        }
        self.edge_updates += queries.len() as u64;
        let update = self.networks.update(Edges {
            shape: (queries.len(), rows, columns),
            net: &net,
            gates: &gates,
            correlation: &correlation,
            motion: &motions,
        })?;
        let nets = update.net.chunks_exact(HIDDEN * cells);
        let changes = update.change.chunks_exact(2 * cells);
        let weights = update.weight.chunks_exact(2 * cells);
        for ((query, answer), ((net, change), weight)) in queries
            .iter()
            .zip(answers)
            .zip(nets.zip(changes).zip(weights))
        {
            check_length("targets of an edge", answer.at.len(), 2 * cells)?;
            check_length("weights of an edge", answer.weight.len(), 2 * cells)?;
            for ((at, from), by) in answer.at.iter_mut().zip(query.reprojected).zip(change) {
                *at = from + by;
            }
            answer.weight.copy_from_slice(weight);
            let state = EdgeState {
                source_frame: query.source_frame,
                net: Stored::new(net, self.params.half_storage),
            };
            self.edges.insert(query.id, state);
        }
        Ok(())
    }
}

fn keyframe(
    keyframes: &BTreeMap<usize, Keyframe>,
    frame: usize,
) -> Result<&Keyframe, LearnedError> {
    keyframes
        .get(&frame)
        .ok_or(LearnedError::UnknownFrame { frame })
}

impl CorrespondenceOperator for DroidOperator {
    type Error = LearnedError;

    fn update(
        &mut self,
        queries: &[EdgeQuery<'_>],
        answers: &mut [EdgeAnswer<'_>],
    ) -> Result<(), LearnedError> {
        check_length("answers", answers.len(), queries.len())?;
        let mut kept = std::mem::take(&mut self.edges);
        for query in queries {
            if let Some(state) = kept.remove(&query.id) {
                self.edges.insert(query.id, state);
            }
        }
        drop(kept);
        let size = self.params.edges_per_call.max(1);
        for (queries, answers) in queries.chunks(size).zip(answers.chunks_mut(size)) {
            self.update_batch(queries, answers)?;
        }
        Ok(())
    }

    fn depth_damping(
        &mut self,
        source_frame: usize,
        damping: &mut [f32],
    ) -> Result<(), LearnedError> {
        let finest = keyframe(&self.keyframes, source_frame)?.features.finest();
        let (rows, columns) = (finest.rows, finest.columns);
        let of_source: Vec<&EdgeState> = self
            .edges
            .values()
            .filter(|edge| edge.source_frame == source_frame)
            .collect();
        let size = HIDDEN * rows * columns;
        let mut nets = vec![0.0; of_source.len() * size];
        for (edge, net) in of_source.iter().zip(nets.chunks_exact_mut(size)) {
            edge.net.write(net);
        }
        let found = self
            .networks
            .damping(&nets, (of_source.len(), rows, columns))?;
        check_length("damping of a source", damping.len(), found.len())?;
        damping.copy_from_slice(&found);
        Ok(())
    }

    fn forget(&mut self, frame: usize) {
        // The motion filter compares the next frame with the newest keyframe, whatever became of it.
        if self
            .newest
            .as_ref()
            .is_none_or(|newest| newest.frame != frame)
        {
            self.keyframes.remove(&frame);
        }
    }
}

#[cfg(test)]
mod tests;
