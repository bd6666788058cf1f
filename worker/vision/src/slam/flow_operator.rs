//! The flow operator: correspondences from dense optical flow, there and back, sampled on the grid.
//!
//! Cell (k, l) of the grid is the flow pixel (⌊step/2⌋ + k step, ⌊step/2⌋ + l step), as in
//! [`scene::sample_grid`](crate::scene::sample_grid). The target is where the flow takes it; its weight
//! is 1/(1 + e²) with e = |F(x) + B(x + F(x))| the end-point error in pixels of a 256-px-high picture,
//! at least [`LEAST_WEIGHT`], and 0 where the flow leaves the picture. Where the flows come from is
//! injected ([`FlowSource`]): stored, or computed on demand. The answer does not depend on what the
//! tracker believes.

use std::collections::BTreeMap;

use super::camera::Grid;
use super::operator::{CorrespondenceOperator, EdgeAnswer, EdgeQuery};
use crate::flow::Flow;
use crate::image::Bilinear;
use crate::scene::correspondence::{Correspondence, CorrespondenceField, REFERENCE_HEIGHT_PX};

/// Weight of a correspondence whose two flows disagree utterly: not zero, since the camera must not be
/// found on the consistent part alone.
pub const LEAST_WEIGHT: f64 = 1e-3;

/// Damping of a source's inverse depths, before the tracker's factor: the flows alone decide.
const DEPTH_DAMPING: f32 = 0.0;

/// Where the cells of one frame are in another.
#[derive(Debug, Clone, PartialEq)]
pub struct GridAnswer {
    /// `[2, rows, columns]`: column, then row, in cells of the target.
    pub at: Vec<f32>,
    /// `[2, rows, columns]`: what each coordinate is worth, in [0, 1].
    pub weight: Vec<f32>,
}

impl GridAnswer {
    /// The same for the motion models: the cells that stay in the picture, in pixels of a 256-px-high
    /// picture. The answer was sampled every `step` pixels of flows `height` rows high.
    #[must_use]
    pub fn field(&self, grid: Grid, step: usize, height: usize) -> CorrespondenceField {
        let unit_px = REFERENCE_HEIGHT_PX / height as f64;
        let px = |cell: f64| ((step / 2) as f64 + cell * step as f64 + 0.5) * unit_px;
        let mut field = CorrespondenceField {
            columns: grid.columns,
            rows: grid.rows,
            correspondences: Vec::with_capacity(grid.cells()),
            cells: Vec::with_capacity(grid.cells()),
            invalid: 0,
            out_of_frame: 0,
        };
        let [at, weights] = [&self.at, &self.weight];
        for cell in 0..grid.cells() {
            let weight = f64::from(weights[cell]);
            if weight <= 0.0 {
                field.out_of_frame += 1;
                continue;
            }
            let (u, v) = ((cell % grid.columns) as f64, (cell / grid.columns) as f64);
            let to = [at[cell], at[grid.cells() + cell]];
            field.correspondences.push(Correspondence {
                from_px: [px(u), px(v)],
                to_px: to.map(|cell| px(f64::from(cell))),
                weight,
            });
            field.cells.push(cell as u32);
        }
        field
    }
}

/// Why flows give no correspondences.
#[derive(Debug, thiserror::Error)]
pub enum FlowOperatorError {
    /// A flow has no pixel, or another number of vectors than its size asks for.
    #[error("flow of {width} x {height} has {len} vectors")]
    Shape {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Vectors found.
        len: usize,
    },
    /// The flows there and back differ in size, or the grid does.
    #[error("flows and grid differ in size")]
    SizeMismatch,
    /// The cells are nowhere.
    #[error("cells must be at least one pixel apart")]
    Step,
    /// A vector is NaN or infinite.
    #[error("flow is not finite at column {x}, row {y}")]
    NonFinite {
        /// Column.
        x: usize,
        /// Row.
        y: usize,
    },
    /// The flows themselves are missing.
    #[error("flow from frame {from} to {to}: {source}")]
    Source {
        /// First frame.
        from: usize,
        /// Second frame.
        to: usize,
        /// Why.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

/// The grid that `step` lays on a picture.
#[must_use]
pub fn grid_of(width: usize, height: usize, step: usize) -> Grid {
    let cells = |length: usize| length.saturating_sub(step / 2).div_ceil(step.max(1));
    Grid {
        columns: cells(width),
        rows: cells(height),
    }
}

/// Samples one direction. `opposite` is the flow back; both are in pixels of their own grid, which
/// covers the picture.
///
/// # Errors
/// Every variant but `Source`.
pub fn sample_flow(
    flow: &Flow,
    opposite: &Flow,
    step: usize,
) -> Result<GridAnswer, FlowOperatorError> {
    sample_chain(&[flow], &[opposite], step)
}

/// As [`sample_flow`] between frames further apart, whose flow is followed from frame to frame: `there`
/// holds the flows on the way, in order, `back` those of the way back. A cell that leaves the picture on
/// its way weighs nothing.
///
/// # Errors
/// As [`sample_flow`].
pub fn sample_chain(
    there: &[&Flow],
    back: &[&Flow],
    step: usize,
) -> Result<GridAnswer, FlowOperatorError> {
    let (width, height) = there
        .first()
        .map_or((0, 0), |flow| (flow.width, flow.height));
    for field in there.iter().chain(back) {
        let len = field.data.len();
        if len == 0 || field.width.checked_mul(field.height) != Some(len) {
            return Err(FlowOperatorError::Shape {
                width: field.width,
                height: field.height,
                len,
            });
        }
    }
    let differs = |field: &&Flow| (field.width, field.height) != (width, height);
    if there.len() != back.len() || there.is_empty() || there.iter().chain(back).any(differs) {
        return Err(FlowOperatorError::SizeMismatch);
    }
    if step == 0 {
        return Err(FlowOperatorError::Step);
    }
    let (grid, first) = (grid_of(width, height, step), step / 2);
    let (cells, unit_px) = (grid.cells(), REFERENCE_HEIGHT_PX / height as f64);
    let mut answer = GridAnswer {
        at: vec![0.0; 2 * cells],
        weight: vec![0.0; 2 * cells],
    };
    for cell in 0..cells {
        let x = first + cell % grid.columns * step;
        let y = first + cell / grid.columns * step;
        let mut way = Way::from(x as f32, y as f32);
        for flow in there {
            way.follow(flow);
        }
        if !way.is_finite() {
            return Err(FlowOperatorError::NonFinite { x, y });
        }
        let in_cells = |to: f32| (to - first as f32) / step as f32;
        answer.at[cell] = in_cells(way.at[0]);
        answer.at[cells + cell] = in_cells(way.at[1]);
        if way.left {
            continue;
        }
        for flow in back {
            way.follow(flow);
        }
        let [du, dv] = way.moved;
        let squared_px = (du * du + dv * dv) * unit_px * unit_px;
        if !squared_px.is_finite() {
            return Err(FlowOperatorError::NonFinite { x, y });
        }
        let weight = (1.0 / (1.0 + squared_px)).max(LEAST_WEIGHT) as f32;
        answer.weight[cell] = weight;
        answer.weight[cells + cell] = weight;
    }
    Ok(answer)
}

/// A point on its way from frame to frame, pixels.
struct Way {
    at: [f32; 2],
    /// Sum of the vectors followed.
    moved: [f64; 2],
    /// Whether it was outside the picture.
    left: bool,
}

impl Way {
    fn from(x: f32, y: f32) -> Self {
        Self {
            at: [x, y],
            moved: [0.0; 2],
            left: false,
        }
    }

    /// Goes where `flow` takes it; outside the picture, its nearest pixel does.
    fn follow(&mut self, flow: &Flow) {
        let look_up = Bilinear::at(self.at[0], self.at[1], flow.width, flow.height);
        for axis in [0, 1] {
            let [a, b, c, d] = look_up.indices.map(|i| flow.data[i][axis]);
            let vector = look_up.mix(a, b, c, d);
            self.at[axis] += vector;
            self.moved[axis] += f64::from(vector);
        }
        let [x, y] = self.at;
        let (last_x, last_y) = ((flow.width - 1) as f32, (flow.height - 1) as f32);
        self.left |= x < 0.0 || y < 0.0 || x > last_x || y > last_y;
    }

    fn is_finite(&self) -> bool {
        self.at.iter().all(|value| value.is_finite())
    }
}

/// Gives the flows between two frames.
pub trait FlowSource {
    /// Why it may fail.
    type Error: std::error::Error + Send + Sync + 'static;

    /// Flow from `first` to `second` and back, on one grid.
    ///
    /// # Errors
    /// Whatever the source meets.
    fn flows(&mut self, first: usize, second: usize) -> Result<[Flow; 2], Self::Error>;
}

/// Answers edges from a [`FlowSource`]; one pair of flows answers both directions.
#[derive(Debug)]
pub struct FlowOperator<S> {
    source: S,
    step: usize,
    /// The other direction of an answered edge, until it is asked for; few, by
    /// [`forget_before`](Self::forget_before).
    ready: BTreeMap<(usize, usize), GridAnswer>,
}

impl<S: FlowSource> FlowOperator<S> {
    /// Cells are `step` pixels of the source's flows apart.
    #[must_use]
    pub fn new(source: S, step: usize) -> Self {
        Self {
            source,
            step,
            ready: BTreeMap::new(),
        }
    }

    /// The source of the flows.
    pub fn source_mut(&mut self) -> &mut S {
        &mut self.source
    }

    /// Drops what is kept of edges with an end before `frame`.
    pub fn forget_before(&mut self, frame: usize) {
        self.ready.retain(|(a, b), _| *a.min(b) >= frame);
    }

    /// Where the cells of `from` are in `to`.
    ///
    /// # Errors
    /// [`FlowOperatorError`].
    pub fn answer(&mut self, from: usize, to: usize) -> Result<GridAnswer, FlowOperatorError> {
        if let Some(answer) = self.ready.remove(&(from, to)) {
            return Ok(answer);
        }
        let flows = self.source.flows(from, to);
        let [there, back] = flows.map_err(|source| FlowOperatorError::Source {
            from,
            to,
            source: Box::new(source),
        })?;
        let answer = sample_flow(&there, &back, self.step)?;
        let reverse = sample_flow(&back, &there, self.step)?;
        self.ready.insert((to, from), reverse);
        Ok(answer)
    }
}

impl<S: FlowSource> CorrespondenceOperator for FlowOperator<S> {
    type Error = FlowOperatorError;

    fn update(
        &mut self,
        queries: &[EdgeQuery<'_>],
        answers: &mut [EdgeAnswer<'_>],
    ) -> Result<(), Self::Error> {
        for (query, answer) in queries.iter().zip(answers) {
            let found = self.answer(query.source_frame, query.target_frame)?;
            if found.at.len() != answer.at.len() {
                return Err(FlowOperatorError::SizeMismatch);
            }
            answer.at.copy_from_slice(&found.at);
            answer.weight.copy_from_slice(&found.weight);
        }
        Ok(())
    }

    fn depth_damping(
        &mut self,
        _source_frame: usize,
        damping: &mut [f32],
    ) -> Result<(), Self::Error> {
        damping.fill(DEPTH_DAMPING);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn constant(width: usize, height: usize, vector: [f32; 2]) -> Flow {
        Flow {
            width,
            height,
            data: vec![vector; width * height],
        }
    }

    #[test]
    fn a_shift_moves_every_cell_and_weighs_by_the_way_back() {
        let (there, back) = (
            constant(64, 256, [4.0, -2.0]),
            constant(64, 256, [-4.0, 3.0]),
        );
        let answer = sample_flow(&there, &back, 8).unwrap();
        let grid = grid_of(64, 256, 8);
        assert_eq!((grid.columns, grid.rows), (8, 32));
        let cells = grid.cells();
        for cell in 0..cells {
            let (u, v) = ((cell % 8) as f32, (cell / 8) as f32);
            assert_eq!(answer.at[cell], u + 0.5);
            assert_eq!(answer.at[cells + cell], v - 0.25);
            // One pixel apart: 1/(1 + 1²). The last column, 60 + 4, leaves the picture.
            let weight = if u < 7.0 { 0.5 } else { 0.0 };
            assert_eq!(answer.weight[cell], weight);
            assert_eq!(answer.weight[cells + cell], weight);
        }
    }

    #[test]
    fn a_chain_is_followed_from_frame_to_frame() {
        // A field that grows to the right, so that the second vector differs from the first.
        let ramp = |sign: f32| Flow {
            width: 64,
            height: 64,
            data: (0..64 * 64)
                .map(|i| [sign * (i % 64) as f32 / 16.0, sign])
                .collect(),
        };
        let (there, back) = (ramp(1.0), ramp(-1.0));
        let chain = sample_chain(&[&there, &there], &[&back, &back], 8).unwrap();
        let grid = grid_of(64, 64, 8);
        for cell in 0..grid.cells() {
            let (x, y) = (4 + cell % 8 * 8, 4 + cell / 8 * 8);
            if x as f64 * 17.0 / 16.0 > 63.0 {
                assert_eq!(chain.weight[cell], 0.0);
                continue;
            }
            // x → x (1 + 1/16)², linear and thus interpolated exactly; and back x → x (1 − 1/16)².
            let to = x as f64 * (17.0_f64 / 16.0).powi(2);
            assert!((f64::from(chain.at[cell]) - (to - 4.0) / 8.0).abs() < 1e-5);
            let back = to * (15.0_f64 / 16.0).powi(2);
            let error_px = (back - x as f64) * 4.0;
            let expected = match to <= 63.0 && y + 2 <= 63 {
                true => 1.0 / (1.0 + error_px * error_px),
                false => 0.0,
            };
            assert!((f64::from(chain.weight[cell]) - expected).abs() < 1e-4);
        }
        // A constant flow twice is twice the flow.
        let (there, back) = (constant(64, 64, [3.0, -2.0]), constant(64, 64, [-3.0, 2.0]));
        let double = sample_flow(
            &constant(64, 64, [6.0, -4.0]),
            &constant(64, 64, [-6.0, 4.0]),
            8,
        );
        let chain = sample_chain(&[&there, &there], &[&back, &back], 8);
        assert_eq!(chain.unwrap(), double.unwrap());
        let torn = sample_chain(&[&there, &there], &[&back], 8);
        assert!(matches!(torn, Err(FlowOperatorError::SizeMismatch)));
        assert!(sample_chain(&[], &[], 8).is_err());
    }

    #[test]
    fn errors_count_in_pixels_of_the_reference_height_and_leaving_weighs_nothing() {
        let (there, back) = (
            constant(32, 128, [40.0, 0.0]),
            constant(32, 128, [-40.0, 1.0]),
        );
        let answer = sample_flow(&there, &back, 4).unwrap();
        assert!(answer.weight.iter().all(|&w| w == 0.0));
        let there = constant(32, 128, [0.0, 0.0]);
        let answer = sample_flow(&there, &constant(32, 128, [0.0, 1.0]), 4).unwrap();
        // A pixel of 128 is two of 256.
        assert!(answer.weight.iter().all(|&w| w == 0.2));
    }

    #[test]
    fn the_motion_models_see_the_same_points_as_sampled_for_them() {
        use crate::scene::{GridParams, sample_grid};
        let (there, back) = (
            constant(64, 128, [3.0, -2.0]),
            constant(64, 128, [-3.0, 2.0]),
        );
        let grid = grid_of(64, 128, 4);
        let field = sample_flow(&there, &back, 4).unwrap().field(grid, 4, 128);
        let twin = sample_grid(&there, 2.0, &GridParams { step: 4 }, |_, _| Some(1.0)).unwrap();
        assert_eq!(field, twin);
    }

    #[test]
    fn malformed_flows_are_refused() {
        let good = constant(16, 16, [0.0; 2]);
        let torn = Flow {
            width: 17,
            ..good.clone()
        };
        let refused = |a: &Flow, b: &Flow, step| sample_flow(a, b, step).unwrap_err();
        assert!(matches!(
            refused(&torn, &good, 8),
            FlowOperatorError::Shape { len: 256, .. }
        ));
        let other = constant(16, 8, [0.0; 2]);
        assert!(matches!(
            refused(&good, &other, 8),
            FlowOperatorError::SizeMismatch
        ));
        assert!(matches!(refused(&good, &good, 0), FlowOperatorError::Step));
        let nan = constant(16, 16, [f32::NAN, 0.0]);
        assert!(matches!(
            refused(&nan, &good, 8),
            FlowOperatorError::NonFinite { x: 4, y: 4 }
        ));
    }

    /// Counts what it is asked for.
    struct Counting(Vec<(usize, usize)>);

    impl FlowSource for Counting {
        type Error = std::convert::Infallible;

        fn flows(&mut self, first: usize, second: usize) -> Result<[Flow; 2], Self::Error> {
            self.0.push((first, second));
            let step = second as f32 - first as f32;
            let flow = |by: f32| constant(32, 32, [by, 0.0]);
            Ok([flow(step), flow(-step)])
        }
    }

    #[test]
    fn one_pair_of_flows_answers_both_directions() {
        let mut operator = FlowOperator::new(Counting(Vec::new()), 8);
        let there = operator.answer(2, 4).unwrap();
        let back = operator.answer(4, 2).unwrap();
        assert_eq!((there.at[0], back.at[0]), (0.25, -0.25));
        assert_eq!(operator.source_mut().0, [(2, 4)]);
        let mut at = vec![0.0; 32];
        let mut weight = vec![0.0; 32];
        let query = EdgeQuery {
            id: super::super::operator::EdgeId(0),
            source_frame: 1,
            target_frame: 5,
            reprojected: &[],
            last_target: &[],
        };
        let mut answers = [EdgeAnswer {
            at: &mut at,
            weight: &mut weight,
        }];
        operator.update(&[query], &mut answers).unwrap();
        assert_eq!(at[0], 0.5);
        operator.forget_before(6);
        assert!(operator.ready.is_empty());
    }
}
