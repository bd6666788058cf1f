//! What the arm does: way points of the hand over the progress of a clip, and when it holds the block.
//!
//! Progress runs from 0 to 1; hand targets are in cylindrical coordinates about the arm's base (`arm`), metres and
//! radians. Nothing fails: beyond the ends the hand rests.

use crate::arm::HandTarget;
use crate::layout::Draw;
use crate::scene::Family;
use crate::texture::smoothstep;

/// Opening of the empty gripper: the block and a finger's breadth.
const OPEN_M: f64 = 0.085;
/// Opening of the closed gripper that pushes.
const SHUT_M: f64 = 0.01;
/// Height at which the hand travels: clear of everything on the table.
const LIFT_M: f64 = 0.17;
/// Half a block and half a closed gripper side by side, as an angle at the arm's working radius.
const BESIDE_RAD: f64 = 0.12;
/// Depth to which the pushing fingers come down: the upper half of the block.
const PUSH_HEIGHT_M: f64 = 0.03;
/// A block is put down this much higher than it was picked up: the mat lies 2 mm above the table.
const MAT_M: f64 = 0.002;

/// A point of the arm's trajectory; between two of them it moves smoothly.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Waypoint {
    progress: f64,
    hand: HandTarget,
}

/// A task: way points in order of progress, and the progress from which and until which the block is held.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Task {
    start: HandTarget,
    then: Vec<Waypoint>,
    pub(crate) held: Option<(f64, f64)>,
}

impl Task {
    /// Where the hand is at `progress`.
    pub(crate) fn hand(&self, progress: f64) -> HandTarget {
        let mut before = Waypoint {
            progress: 0.0,
            hand: self.start,
        };
        for &after in &self.then {
            if progress <= after.progress {
                let t = ((progress - before.progress) / (after.progress - before.progress))
                    .clamp(0.0, 1.0);
                // Half linear: the hand slows at a waypoint without resting there, as in fluent demonstrations.
                let s = 0.5 * (t + smoothstep(t));
                let mix = |a: f64, b: f64| a + s * (b - a);
                return HandTarget {
                    yaw_rad: mix(before.hand.yaw_rad, after.hand.yaw_rad),
                    radius_m: mix(before.hand.radius_m, after.hand.radius_m),
                    height_m: mix(before.hand.height_m, after.hand.height_m),
                    opening_m: mix(before.hand.opening_m, after.hand.opening_m),
                };
            }
            before = after;
        }
        before.hand
    }

    /// The task of a family. `grasp` is the hand above the block (its height is not used), `goal_yaw_rad` where the
    /// block goes, `grip_height_m` the height of the finger tips on the block.
    pub(crate) fn new(
        family: Family,
        grasp: &HandTarget,
        goal_yaw_rad: f64,
        grip_height_m: f64,
        draw: &mut Draw,
    ) -> Self {
        let hand = |yaw_rad: f64, radius_m: f64, height_m: f64, opening_m: f64| HandTarget {
            yaw_rad,
            radius_m,
            height_m,
            opening_m,
        };
        let (yaw, goal, radius, grip) =
            (grasp.yaw_rad, goal_yaw_rad, grasp.radius_m, grasp.opening_m);
        let outwards = yaw.signum();
        let home_yaw = draw.uniform(-0.15, 0.15);
        let home_radius = draw.uniform(0.26, 0.32);
        let (start, then, held) = match family {
            Family::Pick | Family::Pan | Family::Dolly | Family::Flyby => (
                hand(home_yaw, home_radius, 0.22, OPEN_M),
                vec![
                    (0.26, hand(yaw, radius, LIFT_M, OPEN_M)),
                    (0.40, hand(yaw, radius, grip_height_m, grip)),
                    (0.52, hand(yaw, radius, LIFT_M, grip)),
                    (0.76, hand(goal, radius, LIFT_M, grip)),
                    (0.88, hand(goal, radius, grip_height_m + MAT_M, grip)),
                    (1.0, hand(goal, radius - 0.03, LIFT_M, OPEN_M)),
                ],
                Some((0.40, 0.88)),
            ),
            // The closed hand comes down beside the block, on its outer side, and takes it along an arc.
            Family::Push => (
                hand(home_yaw, home_radius, 0.22, SHUT_M),
                vec![
                    (
                        0.24,
                        hand(yaw + outwards * BESIDE_RAD, radius, 0.12, SHUT_M),
                    ),
                    (
                        0.36,
                        hand(yaw + outwards * BESIDE_RAD, radius, PUSH_HEIGHT_M, SHUT_M),
                    ),
                    (
                        0.80,
                        hand(goal + outwards * BESIDE_RAD, radius, PUSH_HEIGHT_M, SHUT_M),
                    ),
                    (
                        1.0,
                        hand(
                            goal + outwards * (BESIDE_RAD + 0.2),
                            radius - 0.06,
                            LIFT_M,
                            SHUT_M,
                        ),
                    ),
                ],
                Some((0.36, 0.80)),
            ),
            Family::Reach => (
                hand(yaw, home_radius, 0.25, OPEN_M),
                vec![
                    (0.30, hand(0.3 * yaw, radius + 0.04, 0.16, 0.03)),
                    (0.62, hand(goal, radius, 0.2, OPEN_M)),
                    (1.0, hand(0.5 * goal + home_yaw, home_radius, 0.26, 0.03)),
                ],
                None,
            ),
        };
        let then = then
            .into_iter()
            .map(|(progress, hand)| Waypoint { progress, hand })
            .collect();
        Self { start, then, held }
    }
}
