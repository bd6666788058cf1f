//! Seeded draws that stay the same in every version of the random number library.

use rand_pcg::rand_core::Rng;

/// A number below `n`, which is above 0. Multiply-shift: its bias of n/2⁶⁴ is nothing.
pub fn index_below(n: usize, rng: &mut impl Rng) -> usize {
    ((u128::from(rng.next_u64()) * n as u128) >> 64) as usize
}

/// `k` of `n` places without repetition (all of them where k > n), in the order drawn
/// (Fisher-Yates, stopped early).
pub fn sample(n: usize, k: usize, rng: &mut impl Rng) -> Vec<usize> {
    let mut places: Vec<usize> = (0..n).collect();
    let k = k.min(n);
    for i in 0..k {
        let other = i + index_below(n - i, rng);
        places.swap(i, other);
    }
    places.truncate(k);
    places
}

#[cfg(test)]
mod tests {
    use rand_pcg::Pcg64;
    use rand_pcg::rand_core::SeedableRng;

    use super::*;

    #[test]
    fn every_place_is_drawn_about_as_often() {
        let mut rng = Pcg64::from_seed([7; 32]);
        let mut drawn = [0_u32; 10];
        for _ in 0..3000 {
            let mut places = sample(10, 3, &mut rng);
            places.iter().for_each(|&place| drawn[place] += 1);
            places.sort_unstable();
            places.dedup();
            assert_eq!(places.len(), 3);
        }
        // 900 expected, binomial standard deviation 25.
        assert!(drawn.iter().all(|n| (800..1000).contains(n)), "{drawn:?}");
        assert_eq!(sample(2, 5, &mut rng).len(), 2);
        assert!(sample(0, 5, &mut rng).is_empty());
    }
}
