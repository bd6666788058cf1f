//! Dense Inverse Search optical flow (T. Kroeger, R. Timofte, D. Dai, L. Van Gool, "Fast Optical
//! Flow using Dense Inverse Search", ECCV 2016), with OpenCV's variational refinement.
//!
//! Coarse to fine over an area-filtered pyramid, at each scale: inverse-compositional search of
//! overlapping patches (`search`), then a dense field as their photometrically weighted mean
//! (`densify`), then, where asked for, its variational refinement (`refine`). Input: grey frames in 0..=255; output: pixels of the full-resolution grid. The
//! conventions (coarsest scale, two sweeps, acceptance rule) follow OpenCV's `DISOpticalFlow`; where
//! this differs:
//! - the pyramid stays in floats, not 8 bits;
//! - the number of stripes inside which vectors propagate is free (OpenCV, and the presets: eight);
//! - a last patch row and column touch the far borders, so that every pixel is covered;
//! - vectors scale between levels by the true size ratio, so odd sizes have no bias.
//!
//! Textureless and saturated patches keep the vector they started from; the result is finite for
//! every accepted input. Fails with [`FlowError`] on frames that are too small, differ in size, or
//! hold pixels that are no grey values. Deterministic: one thread, fixed order, f32 throughout.

mod densify;
mod frame;
mod params;
mod patch;
mod refine;
mod search;

pub use frame::DisFrame;
pub use params::{DisParams, RefinementParams};

use self::densify::{DenseField, Densifier, Upsampler};
use self::refine::Refiner;
use self::search::Search;
use super::{Flow, FlowError};

/// The solver with its buffers; reuse it for many pairs.
#[derive(Debug, Clone)]
pub struct Dis {
    params: DisParams,
    search: Search,
    densifier: Densifier,
    refiner: Refiner,
    field: DenseField,
    upsampler: Upsampler,
}

impl Dis {
    /// A solver with these parameters; they are checked when a frame is prepared.
    #[must_use]
    pub fn new(params: DisParams) -> Self {
        Self {
            params,
            search: Search::default(),
            densifier: Densifier::default(),
            refiner: Refiner::default(),
            field: DenseField::default(),
            upsampler: Upsampler::default(),
        }
    }

    /// Flow from `first` to `second` on the full-resolution grid, `[H, W, 2]`, pixels.
    ///
    /// # Errors
    /// [`FlowError::SizeMismatch`] when the frames differ in size, [`FlowError::ParamsMismatch`] when
    /// one was prepared with other parameters.
    pub fn flow(&mut self, first: &DisFrame, second: &DisFrame) -> Result<Flow, FlowError> {
        let mut flow = Flow::default();
        self.flow_into(first, second, &mut flow)?;
        Ok(flow)
    }

    /// As [`flow`](Self::flow), into a field that is resized where needed: with frames of one size
    /// nothing is allocated after the first pair.
    ///
    /// # Errors
    /// As [`flow`](Self::flow); `flow` is unchanged then.
    pub fn flow_into(
        &mut self,
        first: &DisFrame,
        second: &DisFrame,
        flow: &mut Flow,
    ) -> Result<(), FlowError> {
        if first.size() != second.size() {
            return Err(FlowError::SizeMismatch {
                first: first.size(),
                second: second.size(),
            });
        }
        if *first.params() != self.params || *second.params() != self.params {
            return Err(FlowError::ParamsMismatch);
        }
        self.field.reset_to_zero();
        for (a, b) in first.levels().iter().zip(second.levels()) {
            self.search.start_from(&self.field, a, &self.params);
            self.search.run(a, b, &self.params);
            self.densifier
                .densify(self.search.vectors(), a, b, &self.params, &mut self.field);
            self.refiner.refine(
                &mut self.field,
                a,
                b,
                self.params.refinement_iterations,
                &self.params.refinement,
            );
        }
        let (width, height) = first.size();
        self.upsampler.upsample(&self.field, width, height, flow);
        Ok(())
    }
}

#[cfg(test)]
mod tests;
