//! SEA-RAFT's flow in the place of the classical one, at the working size.

use plumbline_vision::flow::Flow;
use plumbline_vision::image::{Plane, Rgb8, resize_plane};
use plumbline_vision::learned::sea_raft::{SeaRaft, SeaRaftFrame};

use super::error::ClipError;
use super::learned::learned_error;

/// How far the network trusts its flow, in (0, 1], of the working size.
pub(super) type Confidence = Plane;

/// The network.
pub(super) struct NetworkFlow<'a> {
    sea_raft: &'a mut SeaRaft,
}

impl<'a> NetworkFlow<'a> {
    pub(super) fn new(sea_raft: &'a mut SeaRaft) -> Self {
        Self { sea_raft }
    }

    /// Makes a working frame ready for its pairs.
    pub(super) fn prepare(&mut self, frame: u32, rgb: &Rgb8) -> Result<SeaRaftFrame, ClipError> {
        let prepared = self.sea_raft.prepare(rgb);
        prepared.map_err(learned_error("flow by SEA-RAFT", frame))
    }

    /// Flow between two frames of the size of `of`, and how far it is trusted.
    pub(super) fn flow(
        &mut self,
        frame: u32,
        first: &SeaRaftFrame,
        second: &SeaRaftFrame,
        of: &Rgb8,
    ) -> Result<(Flow, Confidence), ClipError> {
        let found = self
            .sea_raft
            .flow(first, second)
            .map_err(learned_error("flow by SEA-RAFT", frame))?;
        let (width, height) = found.network_size;
        let confidence = Plane {
            width,
            height,
            data: found.confidence(),
        };
        Ok((
            whole(found.flow, of.width, of.height),
            resize_plane(&confidence, of.width, of.height),
        ))
    }
}

/// Repeats the last column and row where halving a frame has lost an odd one.
fn whole(flow: Flow, width: usize, height: usize) -> Flow {
    if (flow.width, flow.height) == (width, height) {
        return flow;
    }
    let at = |n: usize| {
        let (x, y) = (n % width, n / width);
        flow.data[y.min(flow.height - 1) * flow.width + x.min(flow.width - 1)]
    };
    Flow {
        width,
        height,
        data: (0..width * height).map(at).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_odd_border_is_repeated() {
        let flow = Flow {
            width: 2,
            height: 1,
            data: vec![[1.0, 2.0], [3.0, 4.0]],
        };
        let found = whole(flow, 3, 2);
        let row = [[1.0, 2.0], [3.0, 4.0], [3.0, 4.0]];
        assert_eq!(found.data, [row, row].concat());
        assert_eq!((found.width, found.height), (3, 2));
    }
}
