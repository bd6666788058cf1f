//! Values that can be gone through again and again, wherever they lie.
//!
//! Statistics are written once, over this trait: a small corpus is a vector, a large one a file that
//! two threads read. Each is a fold whose parts are merged, and every merge here is exact (counts,
//! extremes, exact sums), so that neither order nor split can change a bit. Values are finite and
//! hold no −0.

use std::convert::Infallible;

/// Finite values in no particular order.
pub trait Values: Sync {
    /// Why they cannot be read.
    type Error: Send;

    /// Hands every value to some state, in pieces; states of different pieces are merged.
    ///
    /// # Errors
    /// Where the values cannot be read.
    fn fold<S: Send>(
        &self,
        start: &(dyn Fn() -> S + Sync),
        step: &(dyn Fn(&mut S, &[f64]) + Sync),
        merge: &dyn Fn(&mut S, S),
    ) -> Result<S, Self::Error>;
}

/// Values in memory: what is not finite is left out, and −0 is 0.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct InMemory(Vec<f64>);

impl FromIterator<f64> for InMemory {
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        let finite = values.into_iter().filter(|value| value.is_finite());
        Self(finite.map(|value| value + 0.0).collect())
    }
}

impl Values for InMemory {
    type Error = Infallible;

    fn fold<S: Send>(
        &self,
        start: &(dyn Fn() -> S + Sync),
        step: &(dyn Fn(&mut S, &[f64]) + Sync),
        _merge: &dyn Fn(&mut S, S),
    ) -> Result<S, Infallible> {
        let mut state = start();
        step(&mut state, &self.0);
        Ok(state)
    }
}

/// How far values lie from a point: |x − centre|, at most the largest float.
#[derive(Debug, Clone, Copy)]
pub struct Distances<'a, V> {
    /// The values.
    pub values: &'a V,
    /// The point.
    pub centre: f64,
}

impl<V: Values> Values for Distances<'_, V> {
    type Error = V::Error;

    fn fold<S: Send>(
        &self,
        start: &(dyn Fn() -> S + Sync),
        step: &(dyn Fn(&mut S, &[f64]) + Sync),
        merge: &dyn Fn(&mut S, S),
    ) -> Result<S, V::Error> {
        self.values.fold(
            start,
            &|state, piece| {
                let mut distances = [0.0; 1024];
                for piece in piece.chunks(distances.len()) {
                    for (distance, &value) in distances.iter_mut().zip(piece) {
                        *distance = (value - self.centre).abs().min(f64::MAX);
                    }
                    step(state, &distances[..piece.len()]);
                }
            },
            merge,
        )
    }
}
