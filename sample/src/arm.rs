//! A four-joint tabletop robot arm made of boxes and balls: turret, upper arm, forearm, a hand that points down, and a
//! two-finger gripper.
//!
//! A [`HandTarget`] says where the finger tips are in cylindrical coordinates about the base axis; [`Arm::joints`]
//! gives the joint angles by the two-link closed form (law of cosines, elbow up), [`Arm::bodies`] the bodies. World
//! frame: z up, table top at z = 0; metres and radians. Targets out of reach are brought to the nearest reachable
//! distance, so that nothing fails.

use crate::body::{Body, Shape};
use crate::geometry::{Affine, Mat3, Vec3, vec3};
use crate::texture::{Pattern, Rgb, Texture};

/// Height of the shoulder joint above the table.
const SHOULDER_HEIGHT_M: f64 = 0.24;
/// Shoulder to elbow.
const UPPER_LENGTH_M: f64 = 0.32;
/// Elbow to wrist.
const FORE_LENGTH_M: f64 = 0.30;
/// Wrist to finger tips, straight down.
const HAND_LENGTH_M: f64 = 0.19;
/// How far short of full stretch the arm stays, and how far from folding flat: keeps the elbow's side unambiguous.
const REACH_MARGIN_M: f64 = 0.005;

/// Where the finger tips are, about the base axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandTarget {
    /// Rotation of the turret; 0 faces the camera's side of the table (world −y).
    pub yaw_rad: f64,
    /// Distance from the base axis.
    pub radius_m: f64,
    /// Height of the finger tips above the table.
    pub height_m: f64,
    /// Clear width between the fingers.
    pub opening_m: f64,
}

/// Joint angles of the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joints {
    /// Turret about z.
    pub yaw_rad: f64,
    /// Upper arm above the horizontal.
    pub shoulder_rad: f64,
    /// Forearm above the horizontal (elbow angle plus shoulder angle).
    pub forearm_rad: f64,
    /// Clear width between the fingers, metres.
    pub opening_m: f64,
}

/// The arm: where it stands and how it is painted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Arm {
    /// Centre of the base on the table.
    pub base_m: Vec3,
    /// Paint of the links.
    pub paint: Rgb,
    /// Paint of the bands on the links.
    pub band: Rgb,
    /// Paint of joints and hand.
    pub joint: Rgb,
    /// Noise of the textures.
    pub seed: u32,
    /// Identity of its first body; the others follow.
    pub first_id: u16,
}

/// How many bodies [`Arm::bodies`] returns.
pub const ARM_BODIES: u16 = 11;

impl Arm {
    /// Inverse kinematics: the joint angles that bring the finger tips to the target.
    #[must_use]
    pub fn joints(&self, target: &HandTarget) -> Joints {
        let out = target.radius_m;
        let up = target.height_m + HAND_LENGTH_M - SHOULDER_HEIGHT_M;
        let distance = (out * out + up * up).sqrt().clamp(
            UPPER_LENGTH_M - FORE_LENGTH_M + REACH_MARGIN_M,
            UPPER_LENGTH_M + FORE_LENGTH_M - REACH_MARGIN_M,
        );
        let direction = libm::atan2(up, out);
        let cosine = (UPPER_LENGTH_M * UPPER_LENGTH_M + distance * distance
            - FORE_LENGTH_M * FORE_LENGTH_M)
            / (2.0 * UPPER_LENGTH_M * distance);
        let shoulder = direction + libm::acos(cosine.clamp(-1.0, 1.0));
        let (sin, cos) = libm::sincos(shoulder);
        let (dir_sin, dir_cos) = libm::sincos(direction);
        let forearm = libm::atan2(
            distance * dir_sin - UPPER_LENGTH_M * sin,
            distance * dir_cos - UPPER_LENGTH_M * cos,
        );
        Joints {
            yaw_rad: target.yaw_rad,
            shoulder_rad: shoulder,
            forearm_rad: forearm,
            opening_m: target.opening_m,
        }
    }

    /// Rigid map of the turret: x outwards along the arm, z up, origin at the base.
    fn world_from_turret(&self, joints: &Joints) -> Affine {
        // A quarter turn back makes yaw 0 point to −y.
        let turn = Mat3::rotation_z(joints.yaw_rad - std::f64::consts::FRAC_PI_2);
        Affine::new(turn, self.base_m)
    }

    /// Rigid map of the hand (axes of the turret, origin at the finger tips): what a held object is fixed to.
    #[must_use]
    pub fn world_from_hand(&self, joints: &Joints) -> Affine {
        let (elbow, wrist) = elbow_and_wrist(joints);
        let tips = elbow + wrist - vec3(0.0, 0.0, HAND_LENGTH_M);
        self.world_from_turret(joints) * Affine::translation(tips)
    }

    /// The arm's bodies at these joint angles, in fixed order and number.
    #[must_use]
    pub fn bodies(&self, joints: &Joints) -> Vec<Body> {
        let turret = self.world_from_turret(joints);
        let hand = self.world_from_hand(joints);
        let (elbow, fore) = elbow_and_wrist(joints);
        let shoulder = vec3(0.0, 0.0, SHOULDER_HEIGHT_M);
        // A link's own frame: x along the link, rotated up by its angle (rotation_y turns z to x, hence the minus).
        let link =
            |angle: f64, middle: Vec3| turret * Affine::new(Mat3::rotation_y(-angle), middle);
        let wrist = elbow + fore;
        let finger = |side: f64| {
            // Half the finger's own thickness lies outside the clear width.
            hand * Affine::translation(vec3(0.0, side * (0.5 * joints.opening_m + 0.009), 0.035))
        };

        let links = self.texture(Pattern::Stripes { period_m: 0.13 }, self.paint, self.band);
        let joint = self.texture(Pattern::Blotches, self.joint, self.joint.map(|c| 0.6 * c));
        let dark = self.texture(
            Pattern::Checker { period_m: 0.05 },
            [66.0, 68.0, 74.0],
            [40.0, 41.0, 46.0],
        );
        let parts = [
            (
                "base",
                Shape::Cube,
                Affine::translation(self.base_m + vec3(0.0, 0.0, 0.025)),
                vec3(0.11, 0.11, 0.025),
                dark,
            ),
            (
                "turret",
                Shape::Cube,
                turret * Affine::translation(vec3(0.0, 0.0, 0.13)),
                vec3(0.06, 0.06, 0.085),
                links,
            ),
            (
                "shoulder",
                Shape::Ball,
                turret * Affine::translation(shoulder),
                vec3(0.068, 0.068, 0.068),
                joint,
            ),
            (
                "upper arm",
                Shape::Cube,
                link(joints.shoulder_rad, (shoulder + elbow) * 0.5),
                vec3(0.5 * UPPER_LENGTH_M, 0.042, 0.042),
                links,
            ),
            (
                "elbow",
                Shape::Ball,
                turret * Affine::translation(elbow),
                vec3(0.057, 0.057, 0.057),
                joint,
            ),
            (
                "forearm",
                Shape::Cube,
                link(joints.forearm_rad, elbow + fore * 0.5),
                vec3(0.5 * FORE_LENGTH_M, 0.034, 0.034),
                links,
            ),
            (
                "wrist",
                Shape::Ball,
                turret * Affine::translation(wrist),
                vec3(0.046, 0.046, 0.046),
                joint,
            ),
            (
                "hand",
                Shape::Cube,
                hand * Affine::translation(vec3(0.0, 0.0, 0.125)),
                vec3(0.03, 0.034, 0.04),
                links,
            ),
            (
                "palm",
                Shape::Cube,
                hand * Affine::translation(vec3(0.0, 0.0, 0.078)),
                vec3(0.022, 0.068, 0.012),
                dark,
            ),
            (
                "left finger",
                Shape::Cube,
                finger(-1.0),
                vec3(0.016, 0.009, 0.036),
                dark,
            ),
            (
                "right finger",
                Shape::Cube,
                finger(1.0),
                vec3(0.016, 0.009, 0.036),
                dark,
            ),
        ];
        parts
            .into_iter()
            .zip(self.first_id..)
            .map(
                |((name, shape, world_from_part, half_m, texture), id)| Body {
                    id,
                    name,
                    shape,
                    world_from_unit: world_from_part
                        * Affine::new(Mat3::diagonal(half_m), Vec3::default()),
                    half_m,
                    texture: Texture {
                        seed: texture.seed.wrapping_add(u32::from(id) * 97),
                        ..texture
                    },
                    overlay: None,
                },
            )
            .collect()
    }

    fn texture(&self, pattern: Pattern, base: Rgb, accent: Rgb) -> Texture {
        Texture {
            pattern,
            base,
            accent,
            wavelength_m: 0.06,
            grain: 0.22,
            seed: self.seed,
        }
    }
}

/// Elbow position and the vector from elbow to wrist, in the turret's frame.
fn elbow_and_wrist(joints: &Joints) -> (Vec3, Vec3) {
    let (s1, c1) = libm::sincos(joints.shoulder_rad);
    let (s2, c2) = libm::sincos(joints.forearm_rad);
    let elbow = vec3(
        UPPER_LENGTH_M * c1,
        0.0,
        SHOULDER_HEIGHT_M + UPPER_LENGTH_M * s1,
    );
    (elbow, vec3(FORE_LENGTH_M * c2, 0.0, FORE_LENGTH_M * s2))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arm() -> Arm {
        Arm {
            base_m: vec3(0.1, 0.4, 0.0),
            paint: [200.0; 3],
            band: [90.0; 3],
            joint: [60.0; 3],
            seed: 3,
            first_id: 7,
        }
    }

    /// Forward kinematics of the inverse kinematics is the identity within reach.
    #[test]
    fn hand_reaches_its_target() {
        for k in 0..50 {
            let t = f64::from(k) / 49.0;
            let target = HandTarget {
                yaw_rad: 1.6 * t - 0.8,
                radius_m: 0.25 + 0.27 * t,
                height_m: 0.2 * (1.0 - t),
                opening_m: 0.05,
            };
            let hand = arm().world_from_hand(&arm().joints(&target)).offset;
            let (sin, cos) = libm::sincos(target.yaw_rad - std::f64::consts::FRAC_PI_2);
            let wanted = arm().base_m
                + vec3(
                    target.radius_m * cos,
                    target.radius_m * sin,
                    target.height_m,
                );
            // A dozen roundings of numbers below 1.
            assert!((hand - wanted).length() < 1e-12, "{hand:?} {wanted:?}");
        }
    }

    #[test]
    fn bodies_have_the_declared_number_and_ids_and_finite_maps_even_out_of_reach() {
        let target = HandTarget {
            yaw_rad: 0.0,
            radius_m: 9.0,
            height_m: 3.0,
            opening_m: 0.0,
        };
        let bodies = arm().bodies(&arm().joints(&target));
        assert_eq!(bodies.len(), usize::from(ARM_BODIES));
        for (k, body) in bodies.iter().enumerate() {
            assert_eq!(usize::from(body.id), 7 + k);
            assert!(body.world_from_unit.inverse().is_some());
            assert!(body.world_from_unit.offset.length().is_finite());
        }
    }
}
