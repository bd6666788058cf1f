//! Exact ground truth at pixel centres: depth, body, and optical flow to the next frame with its visibility.
//!
//! A pixel's surface point is named by its body and its unit coordinates; the same point in the next snapshot is
//! projected by that snapshot's camera. `flow_px` is that position minus the pixel's. A point is *visible* in the next
//! frame where it falls into the picture and a ray cast at its position meets the same body at the same depth. Pixels
//! as in `render`; depth is along the camera's z axis, metres. The truth is that of the scene: image-space faults and
//! sensor noise do not touch it, failures of the scene do (a point that jumps has the flow of the jump).

use serde::{Deserialize, Serialize};

use crate::geometry::Pose;
use crate::render::{Antialias, Camera, Placed, Samples, place};
use crate::scene::Snapshot;

/// Depths that agree to this relative bound are one surface: far above the rounding of f64, far below any part's size.
const SAME_DEPTH: f64 = 1e-6;

/// Ground truth of one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameTruth {
    /// Intrinsics.
    pub camera: Camera,
    /// Extrinsics: world coordinates to this frame's camera coordinates.
    pub camera_from_world: Pose,
    /// `[height, width]`, z in the camera's frame, metres.
    pub depth_m: Vec<f32>,
    /// `[height, width]`, id of the body seen (each link of the arm is a body of its own).
    pub body_id: Vec<u16>,
    /// Flow to the next frame; `None` on the last frame of a clip.
    pub flow: Option<FlowTruth>,
}

/// Exact optical flow from a frame to the next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlowTruth {
    /// `[height, width]`, (x, y) displacement in pixels; (0, 0) and without meaning where not `valid`.
    pub flow_px: Vec<[f32; 2]>,
    /// `[height, width]`: the surface point still exists and lies in front of the camera in the next frame.
    pub valid: Vec<bool>,
    /// `[height, width]`: valid, inside the picture and not occluded in the next frame.
    pub visible: Vec<bool>,
}

/// Truth of `now`, with flow to `next` where given.
#[must_use]
pub fn truth(camera: &Camera, now: &Snapshot, next: Option<&Snapshot>) -> FrameTruth {
    let samples = Samples::cast(camera, Antialias::None, now);
    let pixels = camera.width * camera.height;
    let mut truth = FrameTruth {
        camera: *camera,
        camera_from_world: Pose::from_rigid(&now.camera_from_world),
        depth_m: Vec::with_capacity(pixels),
        body_id: Vec::with_capacity(pixels),
        flow: None,
    };
    for y in 0..camera.height {
        for x in 0..camera.width {
            // The room encloses the camera, so every ray of a scene meets something.
            let (depth, id) = samples
                .centre(x, y)
                .map_or((0.0, 0), |(placed, depth)| (depth, placed.body.id));
            truth.depth_m.push(depth as f32);
            truth.body_id.push(id);
        }
    }
    truth.flow = next.map(|next| flow(camera, &samples, next));
    truth
}

fn flow(camera: &Camera, samples: &Samples<'_>, next: &Snapshot) -> FlowTruth {
    let pixels = camera.width * camera.height;
    let mut flow = FlowTruth {
        flow_px: vec![[0.0; 2]; pixels],
        valid: vec![false; pixels],
        visible: vec![false; pixels],
    };
    let next_bodies = place(next);
    for y in 0..camera.height {
        for x in 0..camera.width {
            let Some((placed, depth)) = samples.centre(x, y) else {
                continue;
            };
            let Some(later) = next.bodies.iter().find(|b| b.id == placed.body.id) else {
                continue;
            };
            let (px, py) = (x as f64, y as f64);
            let unit = placed.unit_point(camera.ray(px, py), depth);
            let point = next
                .camera_from_world
                .apply(later.world_from_unit.apply(unit));
            let Some((qx, qy)) = camera.project(point) else {
                continue;
            };
            let k = y * camera.width + x;
            flow.flow_px[k] = [(qx - px) as f32, (qy - py) as f32];
            flow.valid[k] = true;
            flow.visible[k] =
                camera.contains(qx, qy) && sees(camera, &next_bodies, qx, qy, later.id, point.z);
        }
    }
    flow
}

/// Whether the ray through (x, y) meets the body `id` first, at `depth_m`.
fn sees(camera: &Camera, bodies: &[Placed<'_>], x: f64, y: f64, id: u16, depth_m: f64) -> bool {
    let direction = camera.ray(x, y);
    let bound = SAME_DEPTH * depth_m;
    let mut own = false;
    for placed in bodies {
        match placed.depth(direction) {
            Some(depth) if depth < depth_m - bound => return false,
            Some(depth) if placed.body.id == id && depth <= depth_m + bound => own = true,
            _ => {}
        }
    }
    own
}
