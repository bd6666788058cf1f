//! Bodies of AMQP messages, and the frames of the compute child's pipes and of the journal.

use plumbline_common::frame;
use plumbline_common::message::{self, FleetJob, FleetResult, Outcome};
use plumbline_worker::profile::Profile;

pub(crate) fn target(bytes: &[u8]) {
    let mut stream = bytes;
    while let Ok(Some(payload)) = frame::read(&mut stream) {
        let mut again = Vec::new();
        frame::write(&mut again, &payload).expect("what was a frame is one");
        assert_eq!(
            frame::read(&mut again.as_slice()).expect("a frame"),
            Some(payload)
        );
    }
    if let Ok(job) = message::decode::<FleetJob>(bytes) {
        let again = message::encode(&job).expect("what was a job is one");
        assert_eq!(message::decode::<FleetJob>(&again).expect("a job"), job);
        let _id_and_address = (job.message_id(), job.job.location.to_string());
        let _profile: Result<Profile, _> = serde_json::from_slice(&job.job.profile);
    }
    if let Ok(result) = message::decode::<FleetResult>(bytes) {
        // Compared as bytes: a NaN is not equal to itself.
        let again = message::encode(&result).expect("what was a result is one");
        let back: FleetResult = message::decode(&again).expect("a result");
        assert_eq!(message::encode(&back).expect("a result"), again);
    }
    let _outcome = message::decode::<Outcome>(bytes);
}
