//! The tabletop scenes: a room, a table, objects, an arm that does a task, and a camera.
//!
//! A [`Scene`] is drawn from a seed and a [`Family`]; [`Scene::snapshot`] gives its bodies and the camera pose at any
//! progress in [0, 1] of the clip. World frame: z up, table top at z = 0, the arm's base at the far side, the camera on
//! the near side (negative y). Metres and radians. A [`SceneEdit`] is a failure of the world itself: an object is gone,
//! is there all at once, changes its shape, or something jumps. Nothing fails.

use serde::{Deserialize, Serialize};

use crate::arm::Arm;
use crate::body::Body;
use crate::geometry::{Affine, Mat3, Vec3, vec3};
use crate::task::Task;
use crate::texture::Texture;

/// What happens in a scene and how the camera moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Family {
    /// Static camera; the arm picks a block and puts it down elsewhere.
    Pick,
    /// Static camera; the arm sweeps a block along the table.
    Push,
    /// Static camera; the arm moves above the objects and touches none.
    Reach,
    /// As `Pick`, seen by a camera that turns about its own centre.
    Pan,
    /// As `Pick`, seen by a camera that travels sideways: some parallax, over a scene that is nearly a plane.
    Dolly,
    /// As `Pick`, seen by a low camera that travels sideways close to the table: strong parallax, which no
    /// homography explains.
    Flyby,
}

impl Family {
    /// The name used in clip names.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Pick => "pick",
            Self::Push => "push",
            Self::Reach => "reach",
            Self::Pan => "pan",
            Self::Dolly => "dolly",
            Self::Flyby => "flyby",
        }
    }
}

/// A failure of the world at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SceneEdit {
    /// The bystander is not there.
    Vanish,
    /// An object is there that was not.
    Appear,
    /// The bystander is deformed and repainted by this share, 0..=1.
    Morph(f64),
    /// The arm, and what it holds, is turned about its base by this angle in radians.
    JumpArm(f64),
    /// The bystander is displaced by this vector in metres.
    JumpBystander(Vec3),
}

/// The world at one moment: what the renderer draws.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// All bodies; ids are unique. The first is the room, which encloses the camera.
    pub bodies: Vec<Body>,
    /// Rigid pose of the camera.
    pub camera_from_world: Affine,
}

/// A scene: everything that does not depend on time.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    pub(crate) still: Vec<Body>,
    pub(crate) carried: Body,
    pub(crate) bystander: Body,
    pub(crate) intruder: Body,
    /// What the bystander is deformed and repainted to.
    pub(crate) morph_to: (Mat3, Texture),
    pub(crate) arm: Arm,
    pub(crate) task: Task,
    pub(crate) eye_m: Vec3,
    pub(crate) camera: Family,
    pub(crate) side: f64,
}

/// What the default camera looks at.
pub(crate) const LOOK_AT_M: Vec3 = vec3(0.0, 0.1, 0.1);
/// Amplitude of the turning camera: about 2 px per frame at 256 px width and 32 frames.
const PAN_AMPLITUDE_RAD: f64 = 0.11;
/// Path of the travelling camera: about 2 px per frame at the same size.
const DOLLY_LENGTH_M: f64 = 0.5;
/// Where the low camera's path has its middle: the nearest object is 0.4 m away, the far wall 2.2 m.
const FLYBY_EYE_M: Vec3 = vec3(0.0, -0.7, 0.24);
/// Length of its path: some 7 px per frame for the nearest object and 1.3 px for the wall, at 256 px and 60 frames.
const FLYBY_LENGTH_M: f64 = 0.72;
impl Scene {
    /// Centre of the bystander, metres: the place of local faults.
    #[must_use]
    pub fn bystander_m(&self) -> Vec3 {
        self.bystander.world_from_unit.offset
    }

    /// +1 or −1: the side of the table where the task starts.
    #[must_use]
    pub const fn side(&self) -> f64 {
        self.side
    }

    /// The world at `progress` (0 at the first frame, 1 at the last; beyond the ends everything rests), possibly failing.
    #[must_use]
    pub fn snapshot(&self, progress: f64, edit: Option<SceneEdit>) -> Snapshot {
        let mut target = self.task.hand(progress);
        if let Some(SceneEdit::JumpArm(angle_rad)) = edit {
            target.yaw_rad += angle_rad;
        }
        let joints = self.arm.joints(&target);
        let mut bodies = self.still.clone();
        bodies.push(self.carried_at(progress, &self.arm.world_from_hand(&joints)));
        let mut bystander = self.bystander;
        match edit {
            Some(SceneEdit::Morph(share)) => morph(&mut bystander, share, &self.morph_to),
            Some(SceneEdit::JumpBystander(by)) => {
                bystander.world_from_unit.offset = bystander.world_from_unit.offset + by;
            }
            _ => {}
        }
        if edit != Some(SceneEdit::Vanish) {
            bodies.push(bystander);
        }
        if edit == Some(SceneEdit::Appear) {
            bodies.push(self.intruder);
        }
        bodies.extend(self.arm.bodies(&joints));
        Snapshot {
            bodies,
            camera_from_world: self.camera_at(progress),
        }
    }

    /// The carried object: at rest, fixed to the hand, or where the undisturbed hand left it.
    fn carried_at(&self, progress: f64, world_from_hand: &Affine) -> Body {
        let mut body = self.carried;
        let Some((from, until)) = self.task.held.filter(|&(from, _)| progress > from) else {
            return body;
        };
        let hand_at = |p: f64| {
            self.arm
                .world_from_hand(&self.arm.joints(&self.task.hand(p)))
        };
        let now = if progress < until {
            *world_from_hand
        } else {
            hand_at(until)
        };
        if let Some(hand_from_world) = hand_at(from).inverse() {
            body.world_from_unit = now * hand_from_world * body.world_from_unit;
        }
        body
    }

    fn camera_at(&self, progress: f64) -> Affine {
        match self.camera {
            Family::Pick | Family::Push | Family::Reach => look(self.eye_m, LOOK_AT_M),
            Family::Pan => {
                let turn = self.side * PAN_AMPLITUDE_RAD * (1.0 - 2.0 * progress);
                let ahead = LOOK_AT_M - self.eye_m;
                look(self.eye_m, self.eye_m + Mat3::rotation_z(turn) * ahead)
            }
            Family::Dolly => {
                let aside = vec3(self.side * DOLLY_LENGTH_M * (progress - 0.5), 0.0, 0.0);
                look(self.eye_m + aside, LOOK_AT_M)
            }
            // Always ahead: what is near passes by faster than what is far.
            Family::Flyby => {
                let aside = vec3(self.side * FLYBY_LENGTH_M * (progress - 0.5), 0.0, 0.0);
                let eye = FLYBY_EYE_M + aside;
                look(eye, eye + vec3(0.0, 1.0, -0.12))
            }
        }
    }
}

/// Deforms a body about the middle of its foot and lays the second texture over it.
fn morph(body: &mut Body, share: f64, (linear, texture): &(Mat3, Texture)) {
    let foot = Affine::translation(vec3(0.0, 0.0, -1.0));
    let unfoot = Affine::translation(vec3(0.0, 0.0, 1.0));
    let mix = |a: Vec3, b: Vec3| a + (b - a) * share;
    let [a, b, c] = Mat3::IDENTITY.columns;
    let [p, q, r] = linear.columns;
    let partly = Mat3::from_columns(mix(a, p), mix(b, q), mix(c, r));
    body.world_from_unit =
        body.world_from_unit * foot * Affine::new(partly, Vec3::default()) * unfoot;
    body.overlay = Some((*texture, share));
}

/// Pose `camera_from_world` of a camera at `eye` that looks at `target`, upright.
fn look(eye: Vec3, target: Vec3) -> Affine {
    let forward = (target - eye).normalised();
    let right = forward.cross(vec3(0.0, 0.0, 1.0)).normalised();
    let down = forward.cross(right);
    let rotation = Mat3::from_columns(right, down, forward).transposed();
    Affine::new(rotation, -(rotation * eye))
}
