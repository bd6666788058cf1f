//! Point correspondences sampled from a flow field on a regular grid.
//!
//! Pixels are those of a 256-px-high picture, continuous, origin at the picture's top-left
//! *corner*: the centre of flow pixel (0, 0) is at half a flow pixel. That keeps one frame for all
//! working sizes. Fails on a malformed or non-finite flow.

use serde::{Deserialize, Serialize};

use super::SceneError;
use crate::flow::Flow;

/// Height of the picture in whose pixels everything is measured.
pub const REFERENCE_HEIGHT_PX: f64 = 256.0;

/// Largest coordinate accepted: far beyond any picture, far below where fourth powers lose digits.
pub const MAX_COORDINATE_PX: f64 = 1e6;

/// One point in the source picture and where it is in the target picture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Correspondence {
    /// x, y in the source picture, px of a 256-px-high picture.
    pub from_px: [f64; 2],
    /// x, y in the target picture, px of a 256-px-high picture.
    pub to_px: [f64; 2],
    /// In (0, 1]: the fraction of a full observation that this point is worth.
    pub weight: f64,
}

/// Correspondences with their place on a grid of `rows` × `columns` cells.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CorrespondenceField {
    /// Cells per row.
    pub columns: usize,
    /// Rows of cells.
    pub rows: usize,
    /// The valid cells' correspondences, in the order of `cells`.
    pub correspondences: Vec<Correspondence>,
    /// Row-major cell index (`row * columns + column`) of each correspondence, increasing.
    pub cells: Vec<u32>,
    /// Cells that the caller's predicate left out.
    pub invalid: usize,
    /// Valid cells whose target is outside the picture.
    pub out_of_frame: usize,
}

/// How the grid lies on the flow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct GridParams {
    /// Distance between cells, in flow pixels; the first is at `step / 2`. 8 is the grid of dense
    /// bundle adjustment.
    pub step: usize,
}

impl Default for GridParams {
    fn default() -> Self {
        Self { step: 8 }
    }
}

/// Samples `flow` on a grid.
///
/// `unit_px` is the side of one flow pixel in pixels of a 256-px-high picture (256 / flow height
/// when the flow covers the picture). Flow vectors are in flow pixels. `weight_at(x, y)` says what
/// the flow at that pixel is worth, in (0, 1], or `None` where it is not valid (inconsistent,
/// margin). Valid cells whose target lies outside the picture are dropped.
///
/// # Errors
/// [`SceneError::FlowShape`], [`SceneError::NonFiniteFlow`], [`SceneError::Weight`],
/// [`SceneError::Coordinate`], [`SceneError::Parameter`] (`step` of 0, `unit_px` not positive).
pub fn sample_grid(
    flow: &Flow,
    unit_px: f64,
    params: &GridParams,
    weight_at: impl Fn(usize, usize) -> Option<f64>,
) -> Result<CorrespondenceField, SceneError> {
    let (width, height) = (flow.width, flow.height);
    if width == 0 || height == 0 || width.checked_mul(height) != Some(flow.data.len()) {
        return Err(SceneError::FlowShape {
            width,
            height,
            len: flow.data.len(),
        });
    }
    if params.step == 0 {
        return Err(SceneError::Parameter { name: "step" });
    }
    if !(unit_px.is_finite() && unit_px > 0.0) {
        return Err(SceneError::Parameter { name: "unit_px" });
    }
    let first = params.step / 2;
    let columns = width.saturating_sub(first).div_ceil(params.step);
    let rows = height.saturating_sub(first).div_ceil(params.step);
    if u32::try_from(columns * rows).is_err() {
        return Err(SceneError::Cells);
    }
    let mut field = CorrespondenceField {
        columns,
        rows,
        correspondences: Vec::with_capacity(columns * rows),
        cells: Vec::with_capacity(columns * rows),
        invalid: 0,
        out_of_frame: 0,
    };
    for cell in 0..columns * rows {
        let (x, y) = (
            first + cell % columns * params.step,
            first + cell / columns * params.step,
        );
        let Some(weight) = weight_at(x, y) else {
            field.invalid += 1;
            continue;
        };
        let [u, v] = flow.data[y * width + x].map(f64::from);
        if !(u.is_finite() && v.is_finite()) {
            return Err(SceneError::NonFiniteFlow { x, y });
        }
        let (from_x, from_y) = (x as f64, y as f64);
        let (to_x, to_y) = (from_x + u, from_y + v);
        let inside =
            to_x >= 0.0 && to_y >= 0.0 && to_x <= (width - 1) as f64 && to_y <= (height - 1) as f64;
        if !inside {
            field.out_of_frame += 1;
            continue;
        }
        let centre_px = |p: f64| (p + 0.5) * unit_px;
        field.correspondences.push(Correspondence {
            from_px: [centre_px(from_x), centre_px(from_y)],
            to_px: [centre_px(to_x), centre_px(to_y)],
            weight,
        });
        field.cells.push(cell as u32);
    }
    field.validate()?;
    Ok(field)
}

impl CorrespondenceField {
    /// Checks every coordinate, weight and cell index.
    ///
    /// # Errors
    /// [`SceneError::Coordinate`], [`SceneError::Weight`], [`SceneError::Cells`].
    pub fn validate(&self) -> Result<(), SceneError> {
        let cell_count = self.columns.saturating_mul(self.rows);
        let increasing = self.cells.windows(2).all(|w| w[0] < w[1]);
        let inside = self
            .cells
            .last()
            .is_none_or(|&last| (last as usize) < cell_count);
        if self.cells.len() != self.correspondences.len() || !increasing || !inside {
            return Err(SceneError::Cells);
        }
        for (index, c) in self.correspondences.iter().enumerate() {
            // A NaN fails both comparisons, so that it is rejected too.
            let usable = |p: &f64| p.abs() <= MAX_COORDINATE_PX;
            if !c.from_px.iter().chain(&c.to_px).all(usable) {
                return Err(SceneError::Coordinate { index });
            }
            if !(c.weight > 0.0 && c.weight <= 1.0) {
                return Err(SceneError::Weight { index });
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn constant_flow(width: usize, height: usize, vector: [f32; 2]) -> Flow {
        Flow {
            width,
            height,
            data: vec![vector; width * height],
        }
    }

    #[test]
    fn cells_carry_their_place_and_the_unit() {
        let flow = constant_flow(12, 8, [1.0, 0.0]);
        let field = sample_grid(&flow, 2.0, &GridParams { step: 4 }, |x, _| {
            (x != 6).then_some(0.5)
        })
        .unwrap();
        assert_eq!((field.columns, field.rows), (3, 2));
        // Columns at x = 2, 6, 10; 6 is invalid, 10 + 1 = 11 is the last pixel: inside.
        assert_eq!(field.cells, vec![0, 2, 3, 5]);
        assert_eq!((field.invalid, field.out_of_frame), (2, 0));
        assert_eq!(
            field.correspondences[0],
            Correspondence {
                from_px: [5.0, 5.0],
                to_px: [7.0, 5.0],
                weight: 0.5
            }
        );
    }

    #[test]
    fn targets_outside_the_picture_are_dropped_on_every_side() {
        for vector in [[2.5, 0.0], [-2.5, 0.0], [0.0, 2.5], [0.0, -2.5]] {
            let field = sample_grid(
                &constant_flow(8, 8, vector),
                1.0,
                &GridParams { step: 4 },
                |_, _| Some(1.0),
            )
            .unwrap();
            assert_eq!(
                (field.cells.len(), field.out_of_frame),
                (2, 2),
                "{vector:?}"
            );
        }
    }

    #[test]
    fn malformed_input_is_a_typed_error() {
        let grid = GridParams { step: 4 };
        let all = |_: usize, _: usize| Some(1.0);
        let mut flow = constant_flow(8, 8, [0.0; 2]);
        assert_eq!(
            sample_grid(&flow, 1.0, &GridParams { step: 0 }, all),
            Err(SceneError::Parameter { name: "step" })
        );
        for unit in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(
                sample_grid(&flow, unit, &grid, all),
                Err(SceneError::Parameter { name: "unit_px" })
            );
        }
        assert_eq!(
            sample_grid(&flow, 1e7, &grid, all),
            Err(SceneError::Coordinate { index: 0 })
        );
        for weight in [0.0, -1.0, 1.5, f64::NAN] {
            assert_eq!(
                sample_grid(&flow, 1.0, &grid, |_, _| Some(weight)),
                Err(SceneError::Weight { index: 0 })
            );
        }
        flow.data[2 * 8 + 6] = [f32::NAN, 0.0];
        assert_eq!(
            sample_grid(&flow, 1.0, &grid, all),
            Err(SceneError::NonFiniteFlow { x: 6, y: 2 })
        );
        assert!(
            sample_grid(&flow, 1.0, &grid, |x, _| (x != 6).then_some(1.0)).is_ok(),
            "NaN where nothing is valid is no fault"
        );
        flow.data.pop();
        assert!(matches!(
            sample_grid(&flow, 1.0, &grid, all),
            Err(SceneError::FlowShape { .. })
        ));
        // A grid that misses the picture is empty, not an error.
        let empty = sample_grid(
            &constant_flow(2, 2, [0.0; 2]),
            1.0,
            &GridParams { step: 64 },
            all,
        )
        .unwrap();
        assert!(empty.correspondences.is_empty());
    }
}
