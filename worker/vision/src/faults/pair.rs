//! Both directions of a frame pair with their change maps, computed once for all that read them.

use crate::consistency::Evidence;
use crate::image::Plane;

/// The evidence of a pair, earlier → later and back, each on the grid of the frame it starts from.
#[derive(Debug, Clone, PartialEq)]
pub struct ChangePair {
    /// Earlier → later.
    pub forward: Evidence,
    /// Later → earlier.
    pub backward: Evidence,
    /// q of `forward`, `[H, W]`, 0..=1.
    pub forward_change: Plane,
    /// q of `backward`, `[H, W]`, 0..=1.
    pub backward_change: Plane,
}

impl ChangePair {
    /// Derives the change maps.
    #[must_use]
    pub fn new(forward: Evidence, backward: Evidence) -> Self {
        Self {
            forward_change: forward.change_map(),
            backward_change: backward.change_map(),
            forward,
            backward,
        }
    }

    /// Width and height of every part; `None` where they differ.
    pub(crate) fn size(&self) -> Option<(usize, usize)> {
        let size = (self.forward.width, self.forward.height);
        let others = [
            (self.backward.width, self.backward.height),
            (self.forward_change.width, self.forward_change.height),
            (self.backward_change.width, self.backward_change.height),
        ];
        let cells = size.0 * size.1;
        let whole = [&self.forward, &self.backward].iter().all(|evidence| {
            evidence.appearance.len() == cells
                && evidence.flow_px.len() == cells
                && evidence.speed_px.len() == cells
                && evidence.in_frame.len() == cells
        }) && self.forward_change.data.len() == cells
            && self.backward_change.data.len() == cells;
        (whole && others.iter().all(|&other| other == size)).then_some(size)
    }
}
