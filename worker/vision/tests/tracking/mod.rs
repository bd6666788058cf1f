//! A clip's pictures as a source of flows, and what the truth says of a map.

#![allow(dead_code, reason = "each test binary uses its own part")]
#![allow(clippy::unwrap_used, reason = "what cannot be computed fails the test")]

use std::convert::Infallible;

use plumbline_sample::FrameTruth;
use plumbline_vision::flow::Flow;
use plumbline_vision::flow::dis::{Dis, DisFrame, DisParams};
use plumbline_vision::image::{Rgb8, resize_rgb};
use plumbline_vision::slam::camera::Pinhole;
use plumbline_vision::slam::flow_operator::{FlowOperator, FlowSource, grid_of};
use plumbline_vision::slam::intrinsics::Intrinsics;
use plumbline_vision::slam::se3::Se3;
use plumbline_vision::slam::tracker::{FlowGraph, FrontEnd, TrackParams};
use plumbline_vision::slam::trajectory::TimedPose;

/// Working height and grid of the `standard` profile.
const HEIGHT_PX: usize = 256;
const STEP_PX: usize = 8;

/// Pictures prepared for flow.
pub(crate) struct Pictures {
    dis: Dis,
    frames: Vec<DisFrame>,
    video: (usize, usize),
    working: (usize, usize),
}

impl Pictures {
    pub(crate) fn new(pictures: &[Rgb8]) -> Self {
        let params = DisParams::ultrafast(1);
        let video = (pictures[0].width, pictures[0].height);
        let width = (video.0 * HEIGHT_PX + video.1 / 2) / video.1;
        let prepare = |picture: &Rgb8| {
            let grey = resize_rgb(picture, width, HEIGHT_PX).grey();
            DisFrame::new(&grey, &params).unwrap()
        };
        Self {
            frames: pictures.iter().map(prepare).collect(),
            dis: Dis::new(params),
            video,
            working: (width, HEIGHT_PX),
        }
    }

    pub(crate) fn camera(&self, intrinsics: &Intrinsics) -> Pinhole {
        intrinsics.on_grid(self.video, self.working, STEP_PX)
    }

    /// Keyframes and their edges.
    pub(crate) fn graph(self, params: &TrackParams) -> FlowGraph {
        let grid = grid_of(self.working.0, self.working.1, STEP_PX);
        let frames = self.frames.len();
        let operator = FlowOperator::new(self, STEP_PX);
        let mut front_end = FrontEnd::new(operator, grid, params.clone());
        for frame in 0..frames {
            front_end.push(frame).unwrap();
        }
        front_end.finish().unwrap()
    }
}

impl FlowSource for Pictures {
    type Error = Infallible;

    fn flows(&mut self, first: usize, second: usize) -> Result<[Flow; 2], Infallible> {
        let mut flow = |a: usize, b: usize| {
            let (a, b) = (&self.frames[a], &self.frames[b]);
            self.dis.flow(a, b).unwrap()
        };
        Ok([flow(first, second), flow(second, first)])
    }
}

/// The truth's intrinsics.
pub(crate) fn intrinsics(truth: &FrameTruth) -> Intrinsics {
    let camera = &truth.camera;
    Intrinsics {
        fx: camera.fx,
        fy: camera.fy,
        cx: camera.cx,
        cy: camera.cy,
    }
}

/// `camera_from_world` of the truth.
pub(crate) fn pose(truth: &FrameTruth) -> Se3 {
    let pose = &truth.camera_from_world;
    let [tx, ty, tz] = pose.translation_m;
    let [qx, qy, qz, qw] = pose.quaternion_xyzw();
    Se3::from_array([tx, ty, tz, qx, qy, qz, qw])
}

/// Poses of frames as a trajectory, a second apart.
pub(crate) fn trajectory(poses: impl IntoIterator<Item = (usize, Se3)>) -> Vec<TimedPose> {
    let timed = |(frame, camera_from_world): (usize, Se3)| TimedPose {
        time_s: frame as f64,
        world_from_camera: camera_from_world.inverse(),
    };
    poses.into_iter().map(timed).collect()
}
