//! DROID-SLAM's networks (Teed & Deng, 2021) and the steps between them, as WorldScore runs them: features
//! and context of a picture, correlations of an edge, one update of many edges, damping of depths, and the
//! motion filter. Geometry is elsewhere ([`crate::slam`]).

use super::CELL_PX;
use super::correlation::{FeatureMap, Window};
use super::error::{LearnedError, check_finite, check_length};
use super::network::{Network, TensorView, run};
use super::picture::Planar;
use crate::image::Rgb8;

/// Numbers per cell of a hidden state, a context, a feature map.
pub const HIDDEN: usize = 128;
/// Numbers per cell of a context's share of the update's gates.
pub const GATES: usize = 3 * HIDDEN;
/// Numbers per cell of an edge's motion.
pub const MOTION: usize = 4;
/// The correlation window: products are of features divided by 4 each.
pub const WINDOW: Window = Window {
    radius: 3,
    scale: 1.0 / 16.0,
};
/// Motions are clamped to this, cells.
const MOST_MOTION: f32 = 64.0;
/// Least side of a picture: below it the reference's pyramid fails.
const LEAST_PX: usize = 128;

/// The converted networks; inputs and outputs are described in `deploy/models/droid.py`.
pub struct DroidNetworks {
    /// Picture to features.
    pub features: Box<dyn Network>,
    /// Picture to hidden state and context.
    pub context: Box<dyn Network>,
    /// Context to its share of the update's gates.
    pub gates: Box<dyn Network>,
    /// One update of edges.
    pub update: Box<dyn Network>,
    /// Hidden states of edges to the damping of their sources.
    pub aggregate: Box<dyn Network>,
}

/// What the context network gives for a frame, each `[128, rows, columns]`.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameContext {
    /// The hidden state at the start.
    pub net: Vec<f32>,
    /// What stays.
    pub context: Vec<f32>,
}

/// Edges that are updated together, each array `[edges, channels, rows, columns]`.
#[derive(Debug, Clone, Copy)]
pub struct Edges<'a> {
    /// Edges, rows, columns.
    pub shape: (usize, usize, usize),
    /// Hidden states.
    pub net: &'a [f32],
    /// What [`DroidNetworks::gates`] gives of the sources' contexts.
    pub gates: &'a [f32],
    /// Correlations.
    pub correlation: &'a [f32],
    /// Motions ([`motion`]).
    pub motion: &'a [f32],
}

/// What an update gives.
#[derive(Debug, Clone, PartialEq)]
pub struct Update {
    /// New hidden states, `[edges, 128, rows, columns]`.
    pub net: Vec<f32>,
    /// Change of the targets, `[edges, 2, rows, columns]`: column, row, in cells.
    pub change: Vec<f32>,
    /// What the targets are worth, in (0, 1), `[edges, 2, rows, columns]`.
    pub weight: Vec<f32>,
}

/// Rows and columns of a picture's grid.
///
/// # Errors
/// [`LearnedError`] where it is too small or not made of whole cells.
pub fn grid(picture: &Planar) -> Result<(usize, usize), LearnedError> {
    let (width, height) = (picture.width, picture.height);
    if width < LEAST_PX || height < LEAST_PX {
        return Err(LearnedError::TooSmall {
            width,
            height,
            least: LEAST_PX,
        });
    }
    if width % CELL_PX != 0 || height % CELL_PX != 0 {
        return Err(LearnedError::NotWholeCells { width, height });
    }
    Ok((height / CELL_PX, width / CELL_PX))
}

impl DroidNetworks {
    /// A frame's features.
    ///
    /// # Errors
    /// [`LearnedError`] where the frame does not fit or the network fails.
    pub fn features(&mut self, frame: &Rgb8) -> Result<FeatureMap, LearnedError> {
        let picture = Planar::imagenet(frame)?;
        let (rows, columns) = grid(&picture)?;
        let [features] = run(
            &mut *self.features,
            "DROID features",
            &[(
                "picture",
                view(&[1, 3, picture.height, picture.width], &picture.data),
            )],
            [("features", &[1, HIDDEN, rows, columns])],
        )?;
        check_finite("DROID's feature map", &features)?;
        FeatureMap::from_planar(&features, (HIDDEN, rows, columns))
    }

    /// A frame's hidden state and context.
    ///
    /// # Errors
    /// [`LearnedError`] where the frame does not fit or the network fails.
    pub fn context(&mut self, frame: &Rgb8) -> Result<FrameContext, LearnedError> {
        let picture = Planar::imagenet(frame)?;
        let (rows, columns) = grid(&picture)?;
        let [net, context] = run(
            &mut *self.context,
            "DROID context",
            &[(
                "picture",
                view(&[1, 3, picture.height, picture.width], &picture.data),
            )],
            [
                ("net", &[1, HIDDEN, rows, columns]),
                ("context", &[1, HIDDEN, rows, columns]),
            ],
        )?;
        Ok(FrameContext { net, context })
    }

    /// A context's share of the update's gates, `[384, rows, columns]`: the same in every update of every
    /// edge of a source, and a fifth of an update's work.
    ///
    /// # Errors
    /// [`LearnedError`] where sizes do not fit or the network fails.
    pub fn gates(
        &mut self,
        context: &[f32],
        (rows, columns): (usize, usize),
    ) -> Result<Vec<f32>, LearnedError> {
        let [gates] = run(
            &mut *self.gates,
            "DROID gates",
            &[("context", view(&[1, HIDDEN, rows, columns], context))],
            [("gates", &[1, GATES, rows, columns])],
        )?;
        Ok(gates)
    }

    /// One update of edges.
    ///
    /// # Errors
    /// [`LearnedError`] where sizes do not fit or the network fails.
    pub fn update(&mut self, edges: Edges<'_>) -> Result<Update, LearnedError> {
        let (count, rows, columns) = edges.shape;
        let shape = |channels| [count, channels, rows, columns];
        let hidden = shape(HIDDEN);
        let pairs = shape(2);
        let [net, change, weight] = run(
            &mut *self.update,
            "DROID update",
            &[
                ("net", view(&hidden, edges.net)),
                ("gates", view(&shape(GATES), edges.gates)),
                (
                    "correlation",
                    view(&shape(WINDOW.channels()), edges.correlation),
                ),
                ("motion", view(&shape(MOTION), edges.motion)),
            ],
            [
                ("next_net", &hidden),
                ("target_change", &pairs),
                ("weight", &pairs),
            ],
        )?;
        check_finite("DROID's change of targets", &change)?;
        check_finite("DROID's weights of targets", &weight)?;
        Ok(Update {
            net,
            change,
            weight,
        })
    }

    /// The damping of a source's inverse depths, `[rows, columns]`, from the hidden states
    /// `[edges, 128, rows, columns]` of all edges that leave it.
    ///
    /// # Errors
    /// [`LearnedError`] where there is no edge, sizes do not fit, or the network fails.
    pub fn damping(
        &mut self,
        net: &[f32],
        (edges, rows, columns): (usize, usize, usize),
    ) -> Result<Vec<f32>, LearnedError> {
        check_length(
            "hidden states",
            net.len(),
            edges.max(1) * HIDDEN * rows * columns,
        )?;
        let averages = vec![1.0 / edges as f32; edges];
        let [damping] = run(
            &mut *self.aggregate,
            "DROID aggregate",
            &[
                ("net", view(&[edges, HIDDEN, rows, columns], net)),
                ("averages", view(&[1, edges], &averages)),
            ],
            [("damping", &[1, 1, rows, columns])],
        )?;
        check_finite("DROID's damping of depths", &damping)?;
        Ok(damping)
    }
}

fn view<'a>(shape: &'a [usize], data: &'a [f32]) -> TensorView<'a> {
    TensorView { shape, data }
}

/// The motion features of an edge, `[4, rows, columns]`: where poses and depths put a cell less where it
/// is, and the last target less that, clamped. Positions are `[2, rows, columns]`: column, row, in cells.
///
/// # Errors
/// [`LearnedError::LengthMismatch`] where sizes do not fit.
pub fn motion(
    reprojected: &[f32],
    last_target: &[f32],
    (rows, columns): (usize, usize),
) -> Result<Vec<f32>, LearnedError> {
    let cells = rows * columns;
    check_length("reprojections", reprojected.len(), 2 * cells)?;
    check_length("last targets", last_target.len(), 2 * cells)?;
    let own = |index: usize| {
        let cell = index % cells;
        (if index < cells {
            cell % columns
        } else {
            cell / columns
        }) as f32
    };
    let moved = reprojected.iter().enumerate().map(|(n, at)| at - own(n));
    let corrected = last_target.iter().zip(reprojected).map(|(to, at)| to - at);
    Ok(moved
        .chain(corrected)
        .map(|value| value.clamp(-MOST_MOTION, MOST_MOTION))
        .collect())
}

/// The motion filter's measure of a change `[2, rows, columns]`: its mean length, cells.
#[must_use]
pub fn mean_length(change: &[f32]) -> f64 {
    let (x, y) = change.split_at(change.len() / 2);
    let sum: f64 = x
        .iter()
        .zip(y)
        .map(|(&x, &y)| (f64::from(x) * f64::from(x) + f64::from(y) * f64::from(y)).sqrt())
        .sum();
    sum / x.len().max(1) as f64
}
