//! The factor graph: which frame pairs are compared, and for how long.
//!
//! Edges are directed and know keyframes by slot. Active edges are updated; inactive ones keep their
//! last answer and still hold the adjustment. All lists keep their order, which decides ties. The
//! rules are those of DROID-SLAM commit 8016d2b as WorldScore uses it.

use super::operator::EdgeId;

/// A directed frame pair with its last answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Edge {
    /// Its name.
    pub id: EdgeId,
    /// Keyframe slot whose cells are sought.
    pub source: usize,
    /// Keyframe slot they are sought in.
    pub target: usize,
    /// Updates since it was added.
    pub age: u32,
    /// `[2, rows, columns]`: where the cells are, in cells of the target.
    pub at: Vec<f32>,
    /// `[2, rows, columns]`: what that is worth.
    pub weight: Vec<f32>,
}

/// Edges of a set of keyframes.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FactorGraph {
    /// Updated edges.
    pub active: Vec<Edge>,
    /// Edges that are only kept.
    pub inactive: Vec<Edge>,
    next_id: u64,
}

impl FactorGraph {
    /// An empty graph whose edges will have other names than this one's: an operator's state of an edge
    /// does not pass to another's.
    #[must_use]
    pub fn emptied(&self) -> Self {
        Self {
            next_id: self.next_id,
            ..Self::default()
        }
    }

    /// Whether the pair is in the graph, active or not.
    #[must_use]
    pub fn contains(&self, source: usize, target: usize) -> bool {
        let is_it = |e: &Edge| e.source == source && e.target == target;
        self.active.iter().any(is_it) || self.inactive.iter().any(is_it)
    }

    /// Adds those pairs that are not there yet, in order, with weight 0. `reprojection` gives where
    /// the cells of the first slot are in the second, `[2, rows, columns]`.
    ///
    /// With `limit`, room is made first by [`evict`](Self::evict).
    pub fn add(
        &mut self,
        pairs: &[(usize, usize)],
        limit: Option<usize>,
        mut reprojection: impl FnMut(usize, usize) -> Vec<f32>,
    ) {
        let mut new: Vec<(usize, usize)> = Vec::new();
        for &(source, target) in pairs {
            if !self.contains(source, target) && !new.contains(&(source, target)) {
                new.push((source, target));
            }
        }
        if let Some(limit) = limit.filter(|limit| self.active.len() + new.len() > *limit) {
            self.evict(limit.saturating_sub(new.len()));
        }
        for (source, target) in new {
            let at = reprojection(source, target);
            self.active.push(Edge {
                id: EdgeId(self.next_id),
                source,
                target,
                age: 0,
                weight: vec![0.0; at.len()],
                at,
            });
            self.next_id += 1;
        }
    }

    /// Retires edges by the reference's rule: with p the stable argsort of the ages, the edge at
    /// position k goes where p\[k\] ≥ `room`. That is not "the oldest": it compares the entry of the
    /// permutation, e.g. ages \[5, 0, 3, 1\] give p = \[1, 3, 2, 0\], and with room for two the edges
    /// at positions 1 and 2 go.
    pub fn evict(&mut self, room: usize) {
        let mut by_age: Vec<usize> = (0..self.active.len()).collect();
        by_age.sort_by_key(|&k| self.active[k].age);
        let mut position = 0;
        self.retire(|_| {
            position += 1;
            by_age[position - 1] >= room
        });
    }

    /// Moves the active edges that `leaves` names to the inactive ones, in order.
    pub fn retire(&mut self, mut leaves: impl FnMut(&Edge) -> bool) {
        let retired = self.active.extract_if(.., |edge| leaves(edge));
        self.inactive.extend(retired);
    }

    /// Deletes the edges of a keyframe and closes the gap in the numbering.
    pub fn remove_keyframe(&mut self, slot: usize) {
        for edges in [&mut self.active, &mut self.inactive] {
            edges.retain(|e| e.source != slot && e.target != slot);
            for edge in edges {
                edge.source -= usize::from(edge.source >= slot);
                edge.target -= usize::from(edge.target >= slot);
            }
        }
    }
}

/// All ordered pairs of slots `0..frames` at most `radius` apart, row by row.
#[must_use]
pub fn neighbourhood(frames: usize, radius: usize) -> Vec<(usize, usize)> {
    let pairs = (0..frames).flat_map(|i| (0..frames).map(move |j| (i, j)));
    pairs
        .filter(|&(i, j)| i != j && i.abs_diff(j) <= radius)
        .collect()
}

/// Which pairs are near enough to be compared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Proximity {
    /// First slot of the later frames.
    pub first_row: usize,
    /// First slot of the earlier frames.
    pub first_column: usize,
    /// Pairs closer in time than this are no candidates; the `radius + 1` frames before each are
    /// always joined.
    pub radius: usize,
    /// Around an edge, candidates within this many slots (in sum) are left out.
    pub suppression: usize,
    /// Largest distance of a candidate, cells.
    pub most_distance: f64,
    /// No candidate is taken once the list is longer than this.
    pub most_edges: usize,
}

/// Distances beyond this are never candidates, cells.
const DISTANCE_CUTOFF: f64 = 100.0;

impl Proximity {
    /// The pairs to join among slots `..frames`: the fixed ones first, then by increasing distance,
    /// each in both directions. `distance` may be `None` where too little of one frame is visible in
    /// the other.
    pub fn pairs(
        &self,
        graph: &FactorGraph,
        frames: usize,
        mut distance: impl FnMut(usize, usize) -> Option<f64>,
    ) -> Vec<(usize, usize)> {
        let mut table = Table {
            first_row: self.first_row,
            first_column: self.first_column,
            frames,
            distance: Vec::new(),
        };
        for i in self.first_row..frames {
            for j in self.first_column..frames {
                let candidate = j + self.radius <= i;
                let d = candidate.then(|| distance(i, j)).flatten();
                table.distance.push(d.filter(|d| *d <= DISTANCE_CUTOFF));
            }
        }
        for edge in graph.active.iter().chain(&graph.inactive) {
            table.suppress(edge.source, edge.target, self.suppression);
        }
        let mut pairs = Vec::new();
        for i in self.first_row..frames {
            for j in i.saturating_sub(self.radius + 1)..i {
                pairs.extend([(i, j), (j, i)]);
                table.suppress(i, j, 0);
            }
        }
        let columns = frames.saturating_sub(self.first_column);
        let mut order: Vec<(f64, usize)> = Vec::new();
        for (k, d) in table.distance.iter().enumerate() {
            if let Some(d) = d.filter(|d| *d <= self.most_distance) {
                order.push((d, k));
            }
        }
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (_, k) in order {
            if table.distance[k].is_none() {
                continue;
            }
            if pairs.len() > self.most_edges {
                break;
            }
            let (i, j) = (
                self.first_row + k / columns,
                self.first_column + k % columns,
            );
            pairs.extend([(i, j), (j, i)]);
            table.suppress(i, j, self.suppression);
        }
        pairs
    }
}

/// Distances of candidates; `None` where there is none (any more).
struct Table {
    first_row: usize,
    first_column: usize,
    frames: usize,
    distance: Vec<Option<f64>>,
}

impl Table {
    /// Drops the candidates in the diamond around (i, j); of frames at most two apart only the pair
    /// itself.
    fn suppress(&mut self, i: usize, j: usize, suppression: usize) {
        let reach = i.abs_diff(j).saturating_sub(2).min(suppression);
        let columns = self.frames.saturating_sub(self.first_column);
        for row in i.saturating_sub(reach).max(self.first_row)..(i + reach + 1).min(self.frames) {
            let left = reach - row.abs_diff(i);
            let near =
                j.saturating_sub(left).max(self.first_column)..(j + left + 1).min(self.frames);
            for column in near {
                let k = (row - self.first_row) * columns + (column - self.first_column);
                self.distance[k] = None;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pairs_of(edges: &[Edge]) -> Vec<(usize, usize)> {
        edges.iter().map(|e| (e.source, e.target)).collect()
    }

    #[test]
    fn eviction_follows_the_worked_example_of_the_reference() {
        let mut graph = FactorGraph::default();
        graph.add(&[(0, 1), (1, 2), (2, 3), (3, 4)], None, |_, _| vec![0.0; 2]);
        for (edge, age) in graph.active.iter_mut().zip([5, 0, 3, 1]) {
            edge.age = age;
        }
        graph.evict(2);
        assert_eq!(pairs_of(&graph.active), [(0, 1), (3, 4)]);
        assert_eq!(pairs_of(&graph.inactive), [(1, 2), (2, 3)]);
    }

    #[test]
    fn room_is_made_for_new_edges_only_beyond_the_limit() {
        let mut graph = FactorGraph::default();
        graph.add(&[(0, 1), (1, 0), (0, 2)], Some(3), |_, _| vec![0.0; 2]);
        assert_eq!((graph.active.len(), graph.inactive.len()), (3, 0));
        graph.add(&[(0, 1), (2, 0), (2, 0)], Some(3), |_, _| vec![0.0; 2]);
        assert_eq!(pairs_of(&graph.active), [(0, 1), (1, 0), (2, 0)]);
        assert_eq!(pairs_of(&graph.inactive), [(0, 2)]);
        assert!(graph.contains(0, 2) && !graph.contains(2, 1));
        assert_eq!(graph.active[2].id, EdgeId(3));
    }

    #[test]
    fn a_removed_keyframe_leaves_no_edge_and_no_gap() {
        let mut graph = FactorGraph::default();
        graph.add(&neighbourhood(4, 3), None, |_, _| Vec::new());
        graph.retire(|e| e.source == 3);
        graph.remove_keyframe(1);
        assert_eq!(pairs_of(&graph.active), [(0, 1), (0, 2), (1, 0), (1, 2)]);
        assert_eq!(pairs_of(&graph.inactive), [(2, 0), (2, 1)]);
    }

    #[test]
    fn proximity_takes_the_near_first_and_thins_out_around_them() {
        let proximity = Proximity {
            first_row: 0,
            first_column: 0,
            radius: 2,
            suppression: 1,
            most_distance: 10.0,
            most_edges: 100,
        };
        // Frames 5 and 0 look alike; 6 and 0 are second, in the diamond of the first.
        let distance = |i: usize, j: usize| match (i, j) {
            (5, 0) => Some(1.0),
            (6, 0) => Some(2.0),
            (6, 2) => None,
            _ => Some(50.0),
        };
        let fixed = 2 * (1 + 2 + 3 * 4);
        let pairs = proximity.pairs(&FactorGraph::default(), 7, distance);
        assert_eq!(pairs.len(), fixed + 2);
        assert_eq!(&pairs[fixed..], [(5, 0), (0, 5)]);
        let few = Proximity {
            most_edges: fixed - 1,
            ..proximity
        };
        assert_eq!(few.pairs(&FactorGraph::default(), 7, distance).len(), fixed);
        assert!(
            proximity
                .pairs(&FactorGraph::default(), 0, distance)
                .is_empty()
        );
    }
}
