//! Flow fields as files: Middlebury's and KITTI's.

use plumbline_vision::flow::file::{kitti, middlebury};

pub(crate) fn target(bytes: &[u8]) {
    if let Ok(field) = middlebury::decode(bytes) {
        let again = middlebury::encode(&field).expect("what was a field is one");
        assert_eq!(middlebury::decode(&again).expect("a field"), field);
    }
    if let Ok(field) = kitti::decode(bytes) {
        let again = kitti::encode(&field).expect("what was a field is one");
        assert_eq!(kitti::decode(&again).expect("a field"), field);
    }
}
