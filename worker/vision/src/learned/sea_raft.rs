//! Optical flow by SEA-RAFT (Wang, Lipson & Deng, 2024), as WorldScore runs it.
//!
//! A frame is halved (WorldScore's scale −1), centred, padded to whole cells and made features once; a pair
//! gives a hidden state and a first flow, which a few iterations correct by correlations around where the
//! flow now points; the last flow is up-sampled, cropped, and doubled back to the frame's size.

use super::convex::{LOGITS, upsample};
use super::correlation::{FeatureMap, FeaturePyramid, Window, look_up};
use super::error::{LearnedError, check_finite};
use super::network::{Network, TensorView, run};
use super::picture::{Padding, Planar, doubled};
use super::{CELL_PX, correlation};
use crate::flow::Flow;
use crate::image::Rgb8;

/// Least side of the padded picture: below it a level of the pyramid would have no cell, which is an
/// error in the reference too.
const LEAST_PADDED_PX: usize = CELL_PX << (correlation::LEVELS);

/// Largest logarithm of a scale (`var_max`); the least is 0.
const MOST_LOG_SCALE: f32 = 10.0;

/// The converted networks; inputs and outputs are described in `deploy/models/sea_raft.py`.
pub struct SeaRaftNetworks {
    /// Picture to features.
    pub features: Box<dyn Network>,
    /// Pair of pictures to hidden state, context and first flow.
    pub context: Box<dyn Network>,
    /// One iteration.
    pub update: Box<dyn Network>,
    /// Hidden state to up-sampling logits.
    pub upsample: Box<dyn Network>,
}

/// What the weights prescribe, and how they are used.
#[derive(Debug, Clone, PartialEq)]
pub struct SeaRaftParams {
    /// Width of the hidden state; features are twice as wide.
    pub width: usize,
    /// Radius of the correlation window, cells.
    pub radius: usize,
    /// Most iterations.
    pub iterations: usize,
    /// Whether frames are halved first, as WorldScore does.
    pub half_resolution: bool,
    /// Iterations end when the mean change of the flow, pixels of the network's picture, is below this.
    pub stop_below_px: Option<f32>,
}

/// SEA-RAFT with its weights.
pub struct SeaRaft {
    networks: SeaRaftNetworks,
    params: SeaRaftParams,
}

/// A frame, prepared once for all pairs it is part of.
#[derive(Debug, Clone)]
pub struct SeaRaftFrame {
    /// Width and height as given.
    size: (usize, usize),
    /// `[3, H, W]`, centred and padded.
    picture: Vec<f32>,
    padding: Padding,
    features: FeaturePyramid,
}

/// A flow field with what the network says of its own certainty.
#[derive(Debug, Clone, PartialEq)]
pub struct SeaRaftFlow {
    /// Pixels of the frame. With half resolution, an odd last row or column of the frame is not part of it.
    pub flow: Flow,
    /// The flow in pixels of the network's picture, `[2, H, W]`.
    pub network_flow: Vec<f32>,
    /// `[4, H, W]` of the network's picture: two mixture logits, then two raw logarithms of scales.
    pub uncertainty: Vec<f32>,
    /// Width and height of the network's picture.
    pub network_size: (usize, usize),
    /// Iterations done.
    pub iterations: usize,
}

impl SeaRaftFlow {
    /// How far the network trusts its flow, in (0, 1], `[H, W]` of its picture: exp(−E\[ln b\]) over the two
    /// Laplacians that it mixes, the first of a scale b of 1 to e¹⁰ px, the second of 1.
    #[must_use]
    pub fn confidence(&self) -> Vec<f32> {
        let cells = self.network_size.0 * self.network_size.1;
        let planes: Vec<&[f32]> = self.uncertainty.chunks_exact(cells.max(1)).collect();
        let [first, second, scale, _] = planes[..] else {
            return Vec::new();
        };
        let terms = first.iter().zip(second).zip(scale);
        terms
            .map(|((&first, &second), &scale)| {
                // The first one's share of the mixture.
                let share = 1.0 / (1.0 + libm::expf(second - first));
                libm::expf(-share * scale.clamp(0.0, MOST_LOG_SCALE))
            })
            .collect()
    }
}

impl SeaRaft {
    /// The networks with their parameters.
    #[must_use]
    pub fn new(networks: SeaRaftNetworks, params: SeaRaftParams) -> Self {
        Self { networks, params }
    }

    /// Its parameters.
    #[must_use]
    pub fn params(&self) -> &SeaRaftParams {
        &self.params
    }

    /// Its parameters, to use it otherwise than WorldScore does. Width and radius are the weights'.
    pub fn params_mut(&mut self) -> &mut SeaRaftParams {
        &mut self.params
    }

    /// Makes a frame ready: padded picture and features.
    ///
    /// # Errors
    /// [`LearnedError`] where the frame is no picture or too small, or the network fails.
    pub fn prepare(&mut self, frame: &Rgb8) -> Result<SeaRaftFrame, LearnedError> {
        let whole = Planar::new(frame)?;
        let scaled = if self.params.half_resolution {
            whole.halved()
        } else {
            whole
        };
        let factor = if self.params.half_resolution { 2 } else { 1 };
        // 121 px are padded to 128.
        let least = LEAST_PADDED_PX - CELL_PX + 1;
        if scaled.width < least || scaled.height < least {
            return Err(LearnedError::TooSmall {
                width: frame.width,
                height: frame.height,
                least: least * factor,
            });
        }
        let (padded, padding) = scaled.centred().padded();
        let (rows, columns) = (padded.height / CELL_PX, padded.width / CELL_PX);
        let channels = 2 * self.params.width;
        let picture = TensorView {
            shape: &[1, 3, padded.height, padded.width],
            data: &padded.data,
        };
        let [features] = run(
            &mut *self.networks.features,
            "SEA-RAFT features",
            &[("picture", picture)],
            [("features", &[1, channels, rows, columns])],
        )?;
        check_finite("SEA-RAFT's feature map", &features)?;
        let map = FeatureMap::from_planar(&features, (channels, rows, columns))?;
        Ok(SeaRaftFrame {
            size: (frame.width, frame.height),
            picture: padded.data,
            padding,
            features: FeaturePyramid::new(map),
        })
    }

    /// Flow from `first` to `second`.
    ///
    /// # Errors
    /// [`LearnedError`] where the frames differ in size, or a network fails.
    pub fn flow(
        &mut self,
        first: &SeaRaftFrame,
        second: &SeaRaftFrame,
    ) -> Result<SeaRaftFlow, LearnedError> {
        if first.size != second.size {
            return Err(LearnedError::SizeMismatch {
                first: first.size,
                second: second.size,
            });
        }
        let mut state = self.start(first, second)?;
        let mut done = 0;
        while done < self.params.iterations {
            let change_px = self.iterate(&mut state, first, second)?;
            done += 1;
            if self
                .params
                .stop_below_px
                .is_some_and(|stop| change_px < stop)
            {
                break;
            }
        }
        self.finish(&state, first, done)
    }

    /// Hidden state, context and first flow.
    fn start(
        &mut self,
        first: &SeaRaftFrame,
        second: &SeaRaftFrame,
    ) -> Result<State, LearnedError> {
        let (rows, columns) = grid(first);
        let pair = [first.picture.as_slice(), &second.picture].concat();
        let view = TensorView {
            shape: &[
                1,
                6,
                first.padding.padded_height,
                first.padding.padded_width,
            ],
            data: &pair,
        };
        let width = self.params.width;
        let [net, context, flow, uncertainty] = run(
            &mut *self.networks.context,
            "SEA-RAFT context",
            &[("pair", view)],
            [
                ("net", &[1, width, rows, columns]),
                ("context", &[1, width, rows, columns]),
                ("flow", &[1, 2, rows, columns]),
                ("uncertainty", &[1, 4, rows, columns]),
            ],
        )?;
        Ok(State {
            net,
            context,
            flow,
            uncertainty,
        })
    }

    /// One iteration; the mean change of the flow, pixels of the network's picture.
    fn iterate(
        &mut self,
        state: &mut State,
        first: &SeaRaftFrame,
        second: &SeaRaftFrame,
    ) -> Result<f32, LearnedError> {
        let (rows, columns) = grid(first);
        let cells = rows * columns;
        let window = Window {
            radius: self.params.radius,
            scale: 1.0 / (2.0 * self.params.width as f32).sqrt(),
        };
        let mut at = state.flow.clone();
        for (cell, x) in at[..cells].iter_mut().enumerate() {
            *x += (cell % columns) as f32;
        }
        for (cell, y) in at[cells..].iter_mut().enumerate() {
            *y += (cell / columns) as f32;
        }
        let mut correlation = vec![0.0; window.channels() * cells];
        look_up(
            first.features.finest(),
            &second.features,
            &at,
            window,
            &mut correlation,
        )?;
        let width = self.params.width;
        let hidden = [1, width, rows, columns];
        let correlations = [1, window.channels(), rows, columns];
        let [flows, uncertainties] = [2, 4].map(|channels| [1, channels, rows, columns]);
        let view = |shape, data| TensorView { shape, data };
        let [net, change, uncertainty] = run(
            &mut *self.networks.update,
            "SEA-RAFT update",
            &[
                ("net", view(&hidden, &state.net)),
                ("context", view(&hidden, &state.context)),
                ("correlation", view(&correlations, &correlation)),
                ("flow", view(&flows, &state.flow)),
            ],
            [
                ("next_net", &hidden),
                ("flow_change", &flows),
                ("uncertainty", &uncertainties),
            ],
        )?;
        for (flow, change) in state.flow.iter_mut().zip(&change) {
            *flow += change;
        }
        state.net = net;
        state.uncertainty = uncertainty;
        let (dx, dy) = change.split_at(cells);
        let total: f64 = dx
            .iter()
            .zip(dy)
            .map(|(&dx, &dy)| f64::from(dx * dx + dy * dy).sqrt())
            .sum();
        Ok((total / cells as f64) as f32 * CELL_PX as f32)
    }

    /// Up-samples, crops and scales back.
    fn finish(
        &mut self,
        state: &State,
        frame: &SeaRaftFrame,
        iterations: usize,
    ) -> Result<SeaRaftFlow, LearnedError> {
        let (rows, columns) = grid(frame);
        let net = TensorView {
            shape: &[1, self.params.width, rows, columns],
            data: &state.net,
        };
        let [logits] = run(
            &mut *self.networks.upsample,
            "SEA-RAFT upsample",
            &[("net", net)],
            [("logits", &[1, LOGITS, rows, columns])],
        )?;
        let scaled: Vec<f32> = state.flow.iter().map(|v| v * CELL_PX as f32).collect();
        let fine = [scaled, state.uncertainty.clone()].concat();
        let fine = frame
            .padding
            .crop(&upsample(&fine, &logits, (6, rows, columns))?);
        check_finite("SEA-RAFT's flow", &fine)?;
        let (width, height) = (frame.padding.width, frame.padding.height);
        let (network_flow, uncertainty) = fine.split_at(2 * width * height);
        let (x, y) = network_flow.split_at(width * height);
        let flow = if self.params.half_resolution {
            let [x, y] = [x, y].map(|plane| doubled(plane, width, height, 2.0));
            interleaved(2 * width, 2 * height, &x, &y)
        } else {
            interleaved(width, height, x, y)
        };
        Ok(SeaRaftFlow {
            flow,
            network_flow: network_flow.to_vec(),
            uncertainty: uncertainty.to_vec(),
            network_size: (width, height),
            iterations,
        })
    }
}

/// Between iterations, all planar on the grid.
struct State {
    net: Vec<f32>,
    context: Vec<f32>,
    /// Cells.
    flow: Vec<f32>,
    uncertainty: Vec<f32>,
}

/// Rows and columns of the grid.
fn grid(frame: &SeaRaftFrame) -> (usize, usize) {
    let finest = frame.features.finest();
    (finest.rows, finest.columns)
}

fn interleaved(width: usize, height: usize, x: &[f32], y: &[f32]) -> Flow {
    Flow {
        width,
        height,
        data: x.iter().zip(y).map(|(&x, &y)| [x, y]).collect(),
    }
}
