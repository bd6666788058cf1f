//! Runs a numeric kernel with the widest vectors this machine has.
//!
//! The kernels are plain Rust loops that the compiler vectorises; here they are only compiled twice.
//! Results do not depend on the choice: Rust never contracts a product and a sum into one operation
//! nor reorders a sum, so that every lane computes the same IEEE operations in the same order.

/// A computation worth compiling for several instruction sets. `run` and all it calls must be
/// `#[inline(always)]`, or it keeps the baseline's instructions.
pub(crate) trait Kernel {
    /// What it computes.
    type Output;

    /// The computation itself.
    fn run(self) -> Self::Output;
}

/// Runs `kernel` with AVX2 where the machine has it.
#[inline]
pub(crate) fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        #[expect(unsafe_code, reason = "the instruction set is only known at run time")]
        // SAFETY: AVX2 was detected on this very machine.
        return unsafe { run_avx2(kernel) };
    }
    kernel.run()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn run_avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run()
}

/// The integer that a whole number below 2^23 is; no frame is that wide. Its bits lie in the mantissa
/// once 2^23 is added, and unlike Rust's saturating casts this is done in whole vectors.
#[inline(always)]
pub(crate) fn whole(value: f32) -> u32 {
    const MANTISSA_BITS: u32 = 23;
    let shifted = value + (1u32 << MANTISSA_BITS) as f32;
    shifted.to_bits() & ((1 << MANTISSA_BITS) - 1)
}

/// Values per [`Lanes`].
pub(crate) const LANES: usize = 8;

/// Eight floats that are computed alike; the compiler keeps them in vector registers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Lanes([f32; LANES]);

impl Lanes {
    #[inline(always)]
    pub(crate) fn splat(value: f32) -> Self {
        Self([value; LANES])
    }

    /// The eight values of `slice` from `at` on.
    #[inline(always)]
    pub(crate) fn load(slice: &[f32], at: usize) -> Self {
        let mut lanes = [0.0; LANES];
        lanes.copy_from_slice(&slice[at..at + LANES]);
        Self(lanes)
    }

    #[inline(always)]
    pub(crate) fn store(self, slice: &mut [f32], at: usize) {
        slice[at..at + LANES].copy_from_slice(&self.0);
    }

    #[inline(always)]
    pub(crate) fn sqrt(self) -> Self {
        Self(self.0.map(f32::sqrt))
    }

    #[inline(always)]
    fn zip(self, other: Self, op: impl Fn(f32, f32) -> f32) -> Self {
        let mut lanes = self.0;
        for (lane, value) in lanes.iter_mut().zip(other.0) {
            *lane = op(*lane, value);
        }
        Self(lanes)
    }
}

impl std::ops::Add for Lanes {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, |a, b| a + b)
    }
}

impl std::ops::Sub for Lanes {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, |a, b| a - b)
    }
}

impl std::ops::Mul for Lanes {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, |a, b| a * b)
    }
}

impl std::ops::Div for Lanes {
    type Output = Self;

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        self.zip(other, |a, b| a / b)
    }
}
