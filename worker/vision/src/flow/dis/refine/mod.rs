//! Variational refinement of a dense field: the small increment (du, dv) that minimises
//!
//! Σ δ ψ(brightness) + γ ψ(gradient) + ζ² (du² + dv²) + α √(|∇(u + du)|² + |∇(v + dv)|² + ε²)
//!
//! where ψ(r²) = √(r² + ε²) of the linearised, normalised constancy residuals (T. Brox et al., "High
//! accuracy optical flow estimation based on a theory for warping", ECCV 2004; normalisation after
//! H. Zimmer, A. Bruhn, J. Weickert, "Optic flow in harmony", IJCV 2011), with the terms, constants
//! and difference stencils of OpenCV's `VariationalRefinement`, as its `DISOpticalFlow` uses it.
//!
//! `linearise` warps and differentiates once; then each fixed-point iteration freezes the robust
//! weights (`system`) and relaxes the linear system by red-black SOR (`relax`). Pixels of one level's
//! grid; grey levels 0..=255. Where this differs from OpenCV: residuals are normalised once instead
//! of in every iteration, and diagonals are inverted once instead of in every sweep. Total: every
//! accepted field gives a finite one, and flat ground keeps its vectors exactly.

mod grid;
mod linearise;
mod relax;
mod system;

use self::grid::{Field, Grid};
use self::linearise::{Linearisation, Scratch};
use self::system::System;
use super::densify::DenseField;
use super::frame::Level;
use super::params::RefinementParams;
use crate::flow::simd::{Kernel, dispatch};

/// The solver's buffers, reused from level to level and pair to pair.
#[derive(Debug, Clone, Default)]
pub(super) struct Refiner {
    grid: Grid,
    scratch: Scratch,
    linearisation: Linearisation,
    /// The field to refine, with its border repeated to the right and below.
    base: Field,
    /// What is added to it; zero outside the frame.
    increment: Field,
    /// Their sum, whose differences give the smoothness weights.
    current: Field,
    system: System,
}

impl Refiner {
    /// Refines `field`, the flow from `first` to `second` on their grid.
    // A stage of its own in a profile.
    #[inline(never)]
    pub(super) fn refine(
        &mut self,
        field: &mut DenseField,
        first: &Level,
        second: &Level,
        iterations: usize,
        params: &RefinementParams,
    ) {
        if iterations > 0 {
            dispatch(Refinement {
                refiner: self,
                field,
                first,
                second,
                iterations,
                params,
            });
        }
    }

    #[inline(always)]
    fn run(
        &mut self,
        field: &mut DenseField,
        first: &Level,
        second: &Level,
        iterations: usize,
        params: &RefinementParams,
    ) {
        self.grid = Grid::new(field.width, field.height);
        let grid = &self.grid;
        self.scratch
            .differentiate(field, first, second, params.difference_scale);
        self.linearisation.fill(grid, &mut self.scratch, params);
        self.base.split(grid, &field.u, &field.v);
        self.increment.reset(grid);
        self.current.reset(grid);
        self.system.reset(grid, params.relaxation);
        for _ in 0..iterations {
            self.current.set_sum(grid, &self.base, &self.increment);
            self.system.assemble(
                grid,
                &self.linearisation,
                &self.base,
                &self.increment,
                &self.current,
                params,
            );
            relax::relax(
                grid,
                &self.system,
                &mut self.increment,
                1.0 - params.relaxation,
                params.sor_iterations,
            );
        }
        self.current.set_sum(grid, &self.base, &self.increment);
        self.current.merge(grid, &mut field.u, &mut field.v);
    }
}

struct Refinement<'a> {
    refiner: &'a mut Refiner,
    field: &'a mut DenseField,
    first: &'a Level,
    second: &'a Level,
    iterations: usize,
    params: &'a RefinementParams,
}

impl Kernel for Refinement<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        self.refiner.run(
            self.field,
            self.first,
            self.second,
            self.iterations,
            self.params,
        );
    }
}

#[cfg(test)]
mod tests;
