//! The corrected forward/backward end-point error e = |F(x) + B(x + F(x))|.
//!
//! Differs from WorldScore's in that the backward flow is read bilinearly and that end points outside
//! the frame do not count. Nothing is masked by the error itself, which would hide anomalies;
//! `occluded_fraction` says how many in-frame pixels fail the usual test (Sundaram, Brox, Keutzer
//! 2010). Full working grid, `[H, W]`; unit: pixels of a picture `reference_height_px` high.

use super::look_up::{LookUpRow, mix};
use super::{
    ConsistencyError, ConsistencyParams, MAX_FLOW_PX, check_pair, check_values, squared_norm,
};
use crate::flow::Flow;
use crate::flow::simd::{Kernel, dispatch};
use crate::image::Bilinear;

// Vectors checked before looking whether one failed: a few cache lines.
const CHECK_CHUNK: usize = 256;

/// End-point errors of one direction of one pair.
#[derive(Debug, Clone, PartialEq)]
pub struct EndPointError {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Mean error over in-frame pixels; `None` when no pixel stays in the frame.
    pub mean_px: Option<f64>,
    /// Share of in-frame pixels where forward and backward flow disagree; `None` likewise.
    pub occluded_fraction: Option<f64>,
    /// Share of pixels whose end point lies in the frame.
    pub in_frame_fraction: f64,
    /// `[H, W]` error in pixels; `None` where the end point leaves the frame. Empty where it was not asked for.
    pub error_px: Vec<Option<f32>>,
}

impl EndPointError {
    /// Measures `forward` against `backward`, both in pixels of their own grid.
    ///
    /// # Errors
    /// [`ConsistencyError`] when the flows differ in size, are empty or hold absurd vectors.
    pub fn new(
        forward: &Flow,
        backward: &Flow,
        params: &ConsistencyParams,
    ) -> Result<Self, ConsistencyError> {
        check(forward, backward, params)?;
        Ok(dispatch(Measurement {
            forward,
            backward,
            params,
            keeps_map: true,
        }))
    }

    /// As [`Self::new`], without the map.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn without_map(
        forward: &Flow,
        backward: &Flow,
        params: &ConsistencyParams,
    ) -> Result<Self, ConsistencyError> {
        check(forward, backward, params)?;
        Ok(dispatch(Measurement {
            forward,
            backward,
            params,
            keeps_map: false,
        }))
    }
}

/// The errors of single pixels, for who reads few of them.
#[derive(Debug, Clone, Copy)]
pub struct EndPoints<'a> {
    forward: &'a Flow,
    backward: &'a Flow,
    /// Reference pixels per pixel of the flow.
    scale: f32,
}

impl<'a> EndPoints<'a> {
    /// Of `forward` against `backward`, both in pixels of their own grid.
    ///
    /// # Errors
    /// As [`EndPointError::new`].
    pub fn new(
        forward: &'a Flow,
        backward: &'a Flow,
        params: &ConsistencyParams,
    ) -> Result<Self, ConsistencyError> {
        check(forward, backward, params)?;
        Ok(Self {
            forward,
            backward,
            scale: (params.reference_height_px / forward.height as f64) as f32,
        })
    }

    /// The error at column `x`, row `y`, reference pixels, to the bit that of [`EndPointError::error_px`];
    /// `None` where the end point leaves the frame and of what is no pixel.
    #[must_use]
    pub fn error_px(&self, x: usize, y: usize) -> Option<f32> {
        let (width, height) = (self.forward.width, self.forward.height);
        if x >= width || y >= height {
            return None;
        }
        let [u, v] = self.forward.data[y * width + x];
        let (to_x, to_y) = (x as f32 + u, y as f32 + v);
        if !inside(to_x, to_y, width, height) {
            return None;
        }
        let at = Bilinear::at(to_x, to_y, width, height);
        let [a, b, c, d] = at.indices.map(|index| self.backward.data[index]);
        let back = [0, 1].map(|k| at.mix(a[k], b[k], c[k], d[k]) * self.scale);
        let squared = squared_norm([u * self.scale + back[0], v * self.scale + back[1]]);
        Some(squared.sqrt())
    }
}

/// Whether the flows belong together and hold nothing absurd.
fn check(
    forward: &Flow,
    backward: &Flow,
    params: &ConsistencyParams,
) -> Result<(), ConsistencyError> {
    params.validate()?;
    check_pair(forward, backward)?;
    for flow in [forward, backward] {
        if !all_plausible(flow) {
            check_values(flow)?;
        }
    }
    Ok(())
}

struct Measurement<'a> {
    forward: &'a Flow,
    backward: &'a Flow,
    params: &'a ConsistencyParams,
    keeps_map: bool,
}

impl Kernel for Measurement<'_> {
    type Output = EndPointError;

    /// Row by row: where every pixel goes, the four vectors there, then errors in whole vectors; the
    /// mean is one f64 sum over the in-frame pixels in reading order.
    #[inline(always)]
    fn run(self) -> EndPointError {
        let (width, height) = (self.forward.width, self.forward.height);
        let scale = (self.params.reference_height_px / height as f64) as f32;
        let mut row = Row::new(width);
        let (mut sum, mut in_frame, mut occluded) = (0.0, 0usize, 0usize);
        let mut error_px = Vec::new();
        if self.keeps_map {
            error_px.reserve_exact(self.forward.data.len());
        }
        for (y, ahead) in self.forward.data.chunks_exact(width).enumerate() {
            row.to.locate(ahead, [1.0; 2], y, height);
            row.to.gather(&self.backward.data, &mut row.around);
            row.compare(ahead, scale, self.params);
            let errors = row.error.iter().zip(&row.to.inside);
            if self.keeps_map {
                let error = |(&error, &inside): (&f32, &bool)| inside.then_some(error);
                error_px.extend(errors.clone().map(error));
            }
            for ((&error, &inside), &apart) in errors.zip(&row.apart) {
                if inside {
                    sum += f64::from(error);
                    in_frame += 1;
                    occluded += usize::from(apart);
                }
            }
        }
        let share = |count: f64| (in_frame > 0).then(|| count / in_frame as f64);
        EndPointError {
            width,
            height,
            mean_px: share(sum),
            occluded_fraction: share(occluded as f64),
            in_frame_fraction: in_frame as f64 / self.forward.data.len() as f64,
            error_px,
        }
    }
}

/// What is known of one row of pixels, plane by plane; where a pixel leaves the frame, the nearest
/// point of the frame stands in.
struct Row {
    to: LookUpRow,
    /// Backward vectors: top left, top right, bottom left, bottom right.
    around: [Vec<[f32; 2]>; 4],
    error: Vec<f32>,
    /// Whether forward and backward flow disagree.
    apart: Vec<bool>,
}

impl Row {
    fn new(width: usize) -> Self {
        Self {
            to: LookUpRow::new(width),
            around: std::array::from_fn(|_| vec![[0.0; 2]; width]),
            error: vec![0.0; width],
            apart: vec![false; width],
        }
    }

    #[inline(always)]
    fn compare(&mut self, ahead: &[[f32; 2]], scale: f32, params: &ConsistencyParams) {
        let width = ahead.len();
        let [a, b, c, d] = &self.around;
        let (a, b, c, d) = (&a[..width], &b[..width], &c[..width], &d[..width]);
        let fraction_x = &self.to.fraction_x[..width];
        let fraction_y = &self.to.fraction_y[..width];
        let error = &mut self.error[..width];
        let apart = &mut self.apart[..width];
        for x in 0..width {
            let (fx, fy) = (fraction_x[x], fraction_y[x]);
            let back_u = mix([a[x][0], b[x][0], c[x][0], d[x][0]], fx, fy) * scale;
            let back_v = mix([a[x][1], b[x][1], c[x][1], d[x][1]], fx, fy) * scale;
            let (u, v) = (ahead[x][0] * scale, ahead[x][1] * scale);
            let squared = squared_norm([u + back_u, v + back_v]);
            error[x] = squared.sqrt();
            apart[x] = squared >= params.tolerance([u, v], [back_u, back_v]);
        }
    }
}

/// Whether `check_values` would accept; without branches, so that it is done in whole vectors.
fn all_plausible(flow: &Flow) -> bool {
    let plausible =
        |ok: bool, &[u, v]: &[f32; 2]| ok & (u.abs() <= MAX_FLOW_PX) & (v.abs() <= MAX_FLOW_PX);
    !flow.data.is_empty()
        && flow
            .data
            .chunks(CHECK_CHUNK)
            .all(|chunk| chunk.iter().fold(true, plausible))
}

/// Whether a point lies between the outermost pixel centres.
pub(super) fn inside(x: f32, y: f32, width: usize, height: usize) -> bool {
    x >= 0.0 && x <= (width - 1) as f32 && y >= 0.0 && y <= (height - 1) as f32
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
    fn opposite_constant_flows_agree_and_only_leavers_are_masked() {
        let params = ConsistencyParams::default();
        let (ahead, back) = (
            constant(40, 256, [3.25, 0.0]),
            constant(40, 256, [-3.25, 0.0]),
        );
        let measured = EndPointError::new(&ahead, &back, &params).unwrap();
        assert_eq!(measured.mean_px, Some(0.0));
        assert_eq!(measured.occluded_fraction, Some(0.0));
        // Columns 36..=39 land beyond column 39.
        assert!((measured.in_frame_fraction - 0.9).abs() < 1e-12);
        assert_eq!(
            measured.error_px.iter().filter(|e| e.is_none()).count(),
            4 * 256
        );
    }

    #[test]
    fn errors_are_in_pixels_of_the_reference_height() {
        let params = ConsistencyParams::default();
        // 2 px at 128 rows are 4 px at 256; 4² > 0.5 + 0.01 (4² + 0), so every pixel is occluded.
        let measured = EndPointError::new(
            &constant(64, 128, [0.0, 2.0]),
            &constant(64, 128, [0.0, 0.0]),
            &params,
        )
        .unwrap();
        assert_eq!(measured.mean_px, Some(4.0));
        assert_eq!(measured.occluded_fraction, Some(1.0));
    }

    #[test]
    fn backward_flow_is_read_bilinearly() {
        let params = ConsistencyParams::default();
        let ahead = constant(256, 256, [0.25, 0.5]);
        let back = Flow {
            width: 256,
            height: 256,
            data: (0..256 * 256)
                .map(|i| [0.0625 * (i % 256) as f32, -0.125 * (i / 256) as f32])
                .collect(),
        };
        let measured = EndPointError::new(&ahead, &back, &params).unwrap();
        // A linear field is interpolated exactly; the constants are exact in f32.
        let expected = |x: f32, y: f32| (0.25 + 0.0625 * (x + 0.25)).hypot(0.5 - 0.125 * (y + 0.5));
        for (x, y) in [(0, 0), (17, 200), (254, 254)] {
            let error = measured.error_px[y * 256 + x].unwrap();
            assert!((error - expected(x as f32, y as f32)).abs() < 1e-5);
        }
    }

    /// The definition, pixel by pixel.
    fn twin(forward: &Flow, backward: &Flow, params: &ConsistencyParams) -> EndPointError {
        let (width, height) = (forward.width, forward.height);
        let scale = (params.reference_height_px / height as f64) as f32;
        let (mut sum, mut in_frame, mut occluded) = (0.0, 0usize, 0usize);
        let mut error_px = Vec::new();
        for (i, &[u, v]) in forward.data.iter().enumerate() {
            let (x, y) = ((i % width) as f32 + u, (i / width) as f32 + v);
            if !inside(x, y, width, height) {
                error_px.push(None);
                continue;
            }
            let at = Bilinear::at(x, y, width, height);
            let [a, b, c, d] = at.indices.map(|index| backward.data[index]);
            let read = |k: usize| at.mix(a[k], b[k], c[k], d[k]) * scale;
            let (ahead, back) = ([u * scale, v * scale], [read(0), read(1)]);
            let squared = squared_norm([ahead[0] + back[0], ahead[1] + back[1]]);
            error_px.push(Some(squared.sqrt()));
            sum += f64::from(squared.sqrt());
            in_frame += 1;
            occluded += usize::from(squared >= params.tolerance(ahead, back));
        }
        let share = |count: f64| (in_frame > 0).then(|| count / in_frame as f64);
        EndPointError {
            width,
            height,
            mean_px: share(sum),
            occluded_fraction: share(occluded as f64),
            in_frame_fraction: in_frame as f64 / forward.data.len() as f64,
            error_px,
        }
    }

    #[test]
    fn row_wise_kernel_equals_the_definition_bit_for_bit() {
        let params = ConsistencyParams::default();
        for (width, height) in [(1, 1), (1, 9), (7, 1), (2, 2), (37, 23), (64, 48)] {
            // Whole and broken vectors, some to the border exactly, some out of the frame.
            let flow = |seed: usize, step: f32| Flow {
                width,
                height,
                data: (0..width * height)
                    .map(|i| [7919, 104_729].map(|k| ((i * k + seed) % 23) as f32 * step - 3.0))
                    .collect(),
            };
            for step in [0.25, 0.37, 1.0] {
                let (ahead, back) = (flow(1, step), flow(5, 0.31));
                let expected = twin(&ahead, &back, &params);
                let measured = EndPointError::new(&ahead, &back, &params).unwrap();
                let plain = Measurement {
                    forward: &ahead,
                    backward: &back,
                    params: &params,
                    keeps_map: true,
                };
                let mut summary = EndPointError::without_map(&ahead, &back, &params).unwrap();
                assert!(summary.error_px.is_empty());
                summary.error_px.clone_from(&expected.error_px);
                assert_eq!(summary, expected);
                assert_eq!(measured, expected);
                assert_eq!(plain.run(), expected);
                let single = EndPoints::new(&ahead, &back, &params).unwrap();
                for (i, error_px) in expected.error_px.iter().enumerate() {
                    assert_eq!(single.error_px(i % width, i / width), *error_px);
                }
                assert_eq!(single.error_px(width, 0), None);
            }
        }
    }

    #[test]
    fn nothing_in_frame_and_bad_values_are_typed() {
        let params = ConsistencyParams::default();
        let away = constant(8, 8, [100.0, 0.0]);
        let measured = EndPointError::new(&away, &away, &params).unwrap();
        assert_eq!((measured.mean_px, measured.occluded_fraction), (None, None));
        assert_eq!(measured.in_frame_fraction, 0.0);
        let still = constant(8, 8, [0.0; 2]);
        for bad in [f32::NAN, f32::INFINITY, 1e30] {
            let result = EndPointError::new(&constant(8, 8, [bad, 0.0]), &still, &params);
            assert!(matches!(
                result,
                Err(ConsistencyError::FlowOutOfRange { index: 0, .. })
            ));
        }
        let other = EndPointError::new(&still, &constant(8, 9, [0.0; 2]), &params);
        assert!(matches!(other, Err(ConsistencyError::SizeMismatch { .. })));
        assert!(
            EndPointError::new(
                &constant(0, 0, [0.0; 2]),
                &constant(0, 0, [0.0; 2]),
                &params
            )
            .is_err()
        );
    }
}
