//! How far a flow is from ground truth: mean end-point error and outlier shares, in pixels of the
//! flow's own grid, over the pixels whose truth is known. Sums in f64, in reading order.
//!
//! Fails with [`FlowError`] when the sizes differ; without a known pixel there is no mean (`None`).

use super::file::KnownFlow;
use super::{Flow, FlowError};

/// KITTI 2015 counts a pixel as wrong above 3 px and above 5% of the true motion.
const FL_PX: f64 = 3.0;
const FL_RELATIVE: f64 = 0.05;

/// Accuracy over the known pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct FlowAccuracy {
    /// Pixels whose truth is known; all shares are of these.
    pub known_pixels: usize,
    /// Mean of |found − true|, pixels.
    pub mean_epe_px: f64,
    /// Share of errors above 1 px.
    pub outlier_share_1px: f64,
    /// Share of errors above 3 px.
    pub outlier_share_3px: f64,
    /// KITTI's Fl-all: share of errors above 3 px and above 5% of the true vector's length.
    pub fl_all_share: f64,
}

impl FlowAccuracy {
    /// Compares `found` with `truth`; `None` when no pixel's truth is known.
    ///
    /// # Errors
    /// [`FlowError::SizeMismatch`] when the fields differ in size or a buffer is incomplete.
    pub fn new(found: &Flow, truth: &KnownFlow) -> Result<Option<Self>, FlowError> {
        let size = |flow: &Flow| (flow.width, flow.height);
        let whole =
            found.data.len() == truth.flow.data.len() && truth.flow.data.len() == truth.known.len();
        if size(found) != size(&truth.flow) || !whole {
            return Err(FlowError::SizeMismatch {
                first: size(found),
                second: size(&truth.flow),
            });
        }
        let (mut known_pixels, mut sum) = (0_usize, 0.0);
        let [mut above_1px, mut above_3px, mut wrong] = [0_usize; 3];
        let vectors = found.data.iter().zip(&truth.flow.data).zip(&truth.known);
        for ((found, truth), _) in vectors.filter(|&(_, &known)| known) {
            let [u, v] = truth.map(f64::from);
            let (du, dv) = (f64::from(found[0]) - u, f64::from(found[1]) - v);
            let error = (du * du + dv * dv).sqrt();
            let length = (u * u + v * v).sqrt();
            known_pixels += 1;
            sum += error;
            above_1px += usize::from(error > 1.0);
            above_3px += usize::from(error > 3.0);
            wrong += usize::from(error > FL_PX && error > FL_RELATIVE * length);
        }
        let share = |count: usize| count as f64 / known_pixels as f64;
        Ok((known_pixels > 0).then(|| Self {
            known_pixels,
            mean_epe_px: sum / known_pixels as f64,
            outlier_share_1px: share(above_1px),
            outlier_share_3px: share(above_3px),
            fl_all_share: share(wrong),
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_counted_over_known_pixels_by_strict_thresholds() {
        let found = Flow {
            width: 3,
            height: 2,
            data: vec![[0.0; 2]; 6],
        };
        let truth = KnownFlow {
            flow: Flow {
                width: 3,
                height: 2,
                // Errors 0, 1, 3, 5 (its own length), 100 but unknown, and 4 of 104 in the last one.
                data: vec![
                    [0.0, 0.0],
                    [1.0, 0.0],
                    [0.0, -3.0],
                    [3.0, 4.0],
                    [100.0, 0.0],
                    [104.0, 0.0],
                ],
            },
            known: vec![true, true, true, true, false, true],
        };
        let mut found = found;
        found.data[5] = [100.0, 0.0];
        let accuracy = FlowAccuracy::new(&found, &truth).unwrap().unwrap();
        assert_eq!(
            accuracy,
            FlowAccuracy {
                known_pixels: 5,
                mean_epe_px: 13.0 / 5.0,
                outlier_share_1px: 3.0 / 5.0,
                outlier_share_3px: 2.0 / 5.0,
                // 4 of 104 px is below 5%.
                fl_all_share: 1.0 / 5.0,
            }
        );
    }

    #[test]
    fn nothing_known_is_no_mean_and_other_sizes_are_an_error() {
        let still = |width: usize, height: usize| Flow {
            width,
            height,
            data: vec![[0.0; 2]; width * height],
        };
        let mut truth = KnownFlow::dense(still(4, 3));
        truth.known.fill(false);
        assert_eq!(FlowAccuracy::new(&still(4, 3), &truth), Ok(None));
        assert!(matches!(
            FlowAccuracy::new(&still(3, 4), &truth),
            Err(FlowError::SizeMismatch { .. })
        ));
    }
}
