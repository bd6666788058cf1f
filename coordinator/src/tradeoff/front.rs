//! Which points are worth their cost: those that no other point beats (Pareto's front).

/// A point by what it costs and how good it is; neither is NaN.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bought {
    /// Less is better.
    pub(super) cost: f64,
    /// More is better.
    pub(super) good: f64,
}

/// For each point whether it lies on the front: no other point is as cheap and better, or as good and
/// cheaper. Of points alike in both the first does.
pub(super) fn front(points: &[Bought]) -> Vec<bool> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| {
        let (a, b) = (&points[a], &points[b]);
        a.cost.total_cmp(&b.cost).then(b.good.total_cmp(&a.good))
    });
    let mut on_front = vec![false; points.len()];
    let mut best = f64::NEG_INFINITY;
    for place in order {
        if points[place].good > best {
            best = points[place].good;
            on_front[place] = true;
        }
    }
    on_front
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn agrees_with_all_pairs(points in prop::collection::vec((0_u8..6, 0_u8..6), 0..14)) {
            let points: Vec<Bought> = points
                .into_iter()
                .map(|(cost, good)| Bought { cost: cost.into(), good: good.into() })
                .collect();
            let found = front(&points);
            for (i, a) in points.iter().enumerate() {
                let beaten = points.iter().enumerate().any(|(j, b)| {
                    let no_worse = b.cost <= a.cost && b.good >= a.good;
                    no_worse && (b != a || j < i)
                });
                prop_assert_eq!(found[i], !beaten);
            }
        }
    }
}
