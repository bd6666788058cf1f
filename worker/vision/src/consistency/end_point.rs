//! The corrected forward/backward end-point error e = |F(x) + B(x + F(x))|.
//!
//! Differs from WorldScore's in that the backward flow is read bilinearly and that end points outside
//! the frame do not count. Nothing is masked by the error itself, which would hide anomalies;
//! `occluded_fraction` says how many in-frame pixels fail the usual test (Sundaram, Brox, Keutzer
//! 2010). Full working grid, `[H, W]`; unit: pixels of a picture `reference_height_px` high.

use super::{ConsistencyError, ConsistencyParams, check_pair, check_values, squared_norm};
use crate::flow::Flow;
use crate::image::Bilinear;

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
    /// `[H, W]` error in pixels; `None` where the end point leaves the frame.
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
        params.validate()?;
        check_pair(forward, backward)?;
        check_values(forward)?;
        check_values(backward)?;
        let (width, height) = (forward.width, forward.height);
        let scale = (params.reference_height_px / height as f64) as f32;
        let (mut sum, mut in_frame, mut occluded) = (0.0, 0usize, 0usize);
        let mut error_px = Vec::with_capacity(forward.data.len());
        for (y, row) in forward.data.chunks_exact(width).enumerate() {
            for (x, &[u, v]) in row.iter().enumerate() {
                let (to_x, to_y) = (x as f32 + u, y as f32 + v);
                if !inside(to_x, to_y, width, height) {
                    error_px.push(None);
                    continue;
                }
                let [back_u, back_v] = read(backward, to_x, to_y);
                let ahead = [u * scale, v * scale];
                let back = [back_u * scale, back_v * scale];
                let squared = squared_norm([ahead[0] + back[0], ahead[1] + back[1]]);
                let error = squared.sqrt();
                in_frame += 1;
                sum += f64::from(error);
                occluded += usize::from(squared >= params.tolerance(ahead, back));
                error_px.push(Some(error));
            }
        }
        let share = |count: f64| (in_frame > 0).then(|| count / in_frame as f64);
        Ok(Self {
            width,
            height,
            mean_px: share(sum),
            occluded_fraction: share(occluded as f64),
            in_frame_fraction: in_frame as f64 / forward.data.len() as f64,
            error_px,
        })
    }
}

/// Whether a point lies between the outermost pixel centres.
#[inline]
pub(super) fn inside(x: f32, y: f32, width: usize, height: usize) -> bool {
    x >= 0.0 && x <= (width - 1) as f32 && y >= 0.0 && y <= (height - 1) as f32
}

/// The field at a sub-pixel point.
#[inline]
fn read(flow: &Flow, x: f32, y: f32) -> [f32; 2] {
    let at = Bilinear::at(x, y, flow.width, flow.height);
    let [a, b, c, d] = at.indices.map(|index| flow.data[index]);
    [
        at.mix(a[0], b[0], c[0], d[0]),
        at.mix(a[1], b[1], c[1], d[1]),
    ]
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
