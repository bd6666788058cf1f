//! Nothing is allocated per pair once the buffers have their size: counted at the allocator.

mod allocations;

use plumbline_vision::flow::Flow;
use plumbline_vision::flow::dis::{Dis, DisFrame, DisParams};
use plumbline_vision::image::Plane;

#[test]
fn pairs_after_the_first_allocate_nothing() {
    let picture = |shift: usize| {
        Plane::from_fn(101, 67, |x, y| {
            (((x + shift) * 7 + y * 13 + x * y) % 256) as f32
        })
    };
    for params in [DisParams::default(), DisParams::fast(), DisParams::medium()] {
        let frames = [0, 1, 3].map(|shift| DisFrame::new(&picture(shift), &params).unwrap());
        let mut dis = Dis::new(params);
        let mut flow = Flow::default();
        dis.flow_into(&frames[0], &frames[1], &mut flow).unwrap();
        let before = allocations::count();
        dis.flow_into(&frames[1], &frames[2], &mut flow).unwrap();
        dis.flow_into(&frames[2], &frames[0], &mut flow).unwrap();
        assert_eq!(allocations::count(), before);
    }
}
