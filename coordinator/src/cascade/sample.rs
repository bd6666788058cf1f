//! Which videos are measured at every rung.

use rand_pcg::Pcg64;
use rand_pcg::rand_core::SeedableRng;

use crate::reduce::draw;

/// Fewest videos that a flip model is fitted to: below, spreads of residuals mean little.
pub const FEWEST: usize = 16;
/// One in so many of a larger corpus...
const ONE_IN: usize = 25;
/// ...but no more than this: the error of a share of 1% is then half of it.
const MOST: usize = 400;

/// How many of `n` videos; all of them where half would be needed, since nothing is saved then.
#[must_use]
pub fn size(n: usize) -> usize {
    let wanted = n.div_ceil(ONE_IN).clamp(FEWEST, MOST);
    if 2 * wanted >= n { n } else { wanted }
}

/// The sample of `n` videos, ascending, by a seed: the digest of the corpus.
#[must_use]
pub fn sample(n: usize, seed: [u8; 32]) -> Vec<usize> {
    let mut rng = Pcg64::from_seed(seed);
    let mut places = draw::sample(n, size(n), &mut rng);
    places.sort_unstable();
    places
}
