//! Which frames to keep for a constant visual motion per step.
//!
//! From the kept frame i, the next is the first j > i whose flow i → j (DIS on the evidence grid, cells
//! scaled to reference pixels) has more than `min_moving_share` of its cells longer than `moving_px`
//! and, over those, a mean of min(|F|, `speed_limit_px`) of at least `motion_px`; else i + `max_gap`.
//! Cells near the border do not count. The first frame fed is kept. One prepared frame is held; one
//! flow is computed per frame until `max_frames` are kept.

use serde::{Deserialize, Serialize};

use crate::consistency::NormalisedFrame;
use crate::flow::dis::{Dis, DisFrame, DisParams};
use crate::flow::{Flow, FlowError};

/// Constants of the selection.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ArcSelectorParams {
    /// The flow on the evidence grid.
    pub flow: DisParams,
    /// Height of the picture whose pixels are the unit of motion.
    pub reference_height_px: f64,
    /// Cells at the border that do not count.
    pub margin_cells: usize,
    /// A cell moves when its flow is longer than this, reference pixels.
    pub moving_px: f32,
    /// More than this share of the counted cells must move.
    pub min_moving_share: f64,
    /// Mean motion of the moving cells that makes a step, reference pixels.
    pub motion_px: f64,
    /// Longer flow counts as this long, reference pixels.
    pub speed_limit_px: f32,
    /// Frames after which a frame is kept whatever moved.
    pub max_gap: usize,
    /// No more frames are kept than this: a bound on the work, enough for stable medians.
    pub max_frames: usize,
}

impl Default for ArcSelectorParams {
    fn default() -> Self {
        Self {
            flow: DisParams::ultrafast(1),
            reference_height_px: 256.0,
            margin_cells: 8,
            moving_px: 1.0,
            min_moving_share: 0.01,
            motion_px: 3.5,
            speed_limit_px: 40.0,
            max_gap: 12,
            max_frames: 44,
        }
    }
}

/// The selection while the frames stream by.
#[derive(Debug, Clone)]
pub struct ArcSelector {
    params: ArcSelectorParams,
    dis: Dis,
    kept: Option<DisFrame>,
    kept_frames: usize,
    /// Frames since the kept one.
    gap: usize,
}

impl ArcSelector {
    /// A selector that has seen nothing.
    #[must_use]
    pub fn new(params: ArcSelectorParams) -> Self {
        Self {
            dis: Dis::new(params.flow.clone()),
            params,
            kept: None,
            kept_frames: 0,
            gap: 0,
        }
    }

    /// Takes the next frame; whether to keep it.
    ///
    /// # Errors
    /// [`FlowError`] when no flow can be computed on the frame (no picture, too small, of another size
    /// than the one before); the frame is then as if it had not been fed.
    pub fn push(&mut self, frame: &NormalisedFrame) -> Result<bool, FlowError> {
        if self.kept_frames >= self.params.max_frames {
            return Ok(false);
        }
        let candidate = DisFrame::new(&frame.grey, &self.params.flow)?;
        let keep = match &self.kept {
            None => true,
            Some(kept) => {
                let flow = self.dis.flow(kept, &candidate)?;
                self.gap += 1;
                self.gap >= self.params.max_gap || self.is_a_step(&flow)
            }
        };
        if keep {
            self.kept = Some(candidate);
            self.kept_frames += 1;
            self.gap = 0;
        }
        Ok(keep)
    }

    /// Frames kept so far.
    #[must_use]
    pub fn kept_frames(&self) -> usize {
        self.kept_frames
    }

    fn is_a_step(&self, flow: &Flow) -> bool {
        let params = &self.params;
        let px_per_cell = (params.reference_height_px / flow.height as f64) as f32;
        let margin = params.margin_cells;
        let rows = margin..flow.height.saturating_sub(margin);
        let columns = margin..flow.width.saturating_sub(margin);
        let counted = rows.len() * columns.len();
        let (mut sum, mut moving) = (0.0, 0usize);
        for y in rows {
            for [u, v] in &flow.data[y * flow.width..][columns.clone()] {
                let speed = px_per_cell * (u * u + v * v).sqrt();
                if speed > params.moving_px {
                    sum += f64::from(speed.min(params.speed_limit_px));
                    moving += 1;
                }
            }
        }
        moving as f64 > params.min_moving_share * counted as f64
            && sum >= params.motion_px * moving as f64
    }
}
