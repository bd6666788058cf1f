//! Draws a scene from a seed: room, table, objects, paint, arm and camera position.
//!
//! The layout keeps roles apart: the arm's base at the far side, the block's start and goal within its reach on either
//! side, the bystander and the intruder on the near side, where the arm never comes between them and the camera.
//! World frame and units as in `scene`. Nothing fails.

use rand::{Rng, SeedableRng};
use rand_pcg::Pcg32;

use crate::arm::{Arm, HandTarget};
use crate::body::{Body, Shape};
use crate::geometry::{Affine, Mat3, Vec3, vec3};
use crate::scene::{Family, LOOK_AT_M, Scene};
use crate::task::Task;
use crate::texture::{Pattern, Rgb, Texture};

/// Paint of the arm: links, bands, joints.
const ARM_PAINTS: [[Rgb; 3]; 4] = [
    [
        [232.0, 128.0, 38.0],
        [196.0, 92.0, 22.0],
        [58.0, 60.0, 66.0],
    ],
    [
        [222.0, 222.0, 216.0],
        [150.0, 158.0, 168.0],
        [52.0, 88.0, 140.0],
    ],
    [
        [70.0, 112.0, 176.0],
        [212.0, 214.0, 218.0],
        [48.0, 50.0, 58.0],
    ],
    [[214.0, 192.0, 72.0], [88.0, 86.0, 80.0], [60.0, 58.0, 58.0]],
];
/// Table tops: base, accent.
const TABLE_PAINTS: [[Rgb; 2]; 4] = [
    [[194.0, 152.0, 104.0], [142.0, 98.0, 60.0]],
    [[162.0, 166.0, 168.0], [104.0, 110.0, 118.0]],
    [[142.0, 106.0, 80.0], [92.0, 62.0, 44.0]],
    [[206.0, 198.0, 178.0], [150.0, 140.0, 124.0]],
];
/// Walls: base, accent.
const WALL_PAINTS: [[Rgb; 2]; 3] = [
    [[184.0, 194.0, 194.0], [128.0, 140.0, 146.0]],
    [[204.0, 192.0, 170.0], [146.0, 136.0, 120.0]],
    [[128.0, 142.0, 160.0], [80.0, 92.0, 110.0]],
];
/// Objects: base, accent.
const OBJECT_PAINTS: [[Rgb; 2]; 6] = [
    [[206.0, 48.0, 44.0], [246.0, 214.0, 196.0]],
    [[40.0, 146.0, 82.0], [206.0, 232.0, 130.0]],
    [[46.0, 92.0, 190.0], [190.0, 214.0, 244.0]],
    [[232.0, 190.0, 46.0], [122.0, 74.0, 22.0]],
    [[140.0, 64.0, 158.0], [238.0, 204.0, 240.0]],
    [[44.0, 162.0, 172.0], [18.0, 62.0, 84.0]],
];

/// Where the base stands: the far side of the table.
const BASE_M: Vec3 = vec3(0.0, 0.42, 0.0);
/// Horizontal distance from the camera to what it looks at: the whole arm is just in view.
const EYE_DISTANCE_M: f64 = 1.06;

/// Ids below the arm's: room, table, mat, poster, ball, block, bystander, intruder.
const ARM_FIRST_ID: u16 = 8;

/// Draws from a seeded generator. Written out because the range sampling of `rand` may change between releases.
pub(crate) struct Draw(Pcg32);

impl Draw {
    /// A number in [`low`, `high`).
    pub(crate) fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * f64::from(self.0.next_u32()) / 4_294_967_296.0
    }
    fn pick<T: Copy>(&mut self, from: &[T], otherwise: T) -> T {
        let k = self.uniform(0.0, from.len() as f64) as usize;
        from.get(k).copied().unwrap_or(otherwise)
    }
    fn seed(&mut self) -> u32 {
        self.0.next_u32()
    }
}

/// A box, ball or rectangle at rest on the table or elsewhere.
fn body(
    id: u16,
    name: &'static str,
    shape: Shape,
    centre: Vec3,
    yaw_rad: f64,
    half_m: Vec3,
    texture: Texture,
) -> Body {
    let linear = Mat3::rotation_z(yaw_rad) * Mat3::diagonal(half_m);
    Body {
        id,
        name,
        shape,
        world_from_unit: Affine::new(linear, centre),
        half_m,
        texture,
        overlay: None,
    }
}

impl Scene {
    /// Draws a scene. The same seed gives the same scene; families of one seed share room, objects and paint.
    #[must_use]
    pub fn new(family: Family, seed: u64) -> Self {
        let mut draw = Draw(Pcg32::seed_from_u64(seed));
        let side = if draw.uniform(0.0, 1.0) < 0.5 {
            -1.0
        } else {
            1.0
        };
        let first = draw.uniform(0.0, OBJECT_PAINTS.len() as f64) as usize;
        let object = |k: usize, pattern: Pattern, draw: &mut Draw| {
            let [base, accent] = OBJECT_PAINTS[(first + k) % OBJECT_PAINTS.len()];
            Texture {
                pattern,
                base,
                accent,
                wavelength_m: 0.05,
                grain: 0.2,
                seed: draw.seed(),
            }
        };

        let [wall_base, wall_accent] = draw.pick(&WALL_PAINTS, WALL_PAINTS[0]);
        let wall = Texture {
            pattern: Pattern::Blotches,
            base: wall_base,
            accent: wall_accent,
            wavelength_m: 0.2,
            grain: 0.08,
            seed: draw.seed(),
        };
        let [table_base, table_accent] = draw.pick(&TABLE_PAINTS, TABLE_PAINTS[0]);
        let planks = if draw.uniform(0.0, 1.0) < 0.5 {
            Pattern::Stripes { period_m: 0.26 }
        } else {
            Pattern::Blotches
        };
        let table = Texture {
            pattern: planks,
            base: table_base,
            accent: table_accent,
            wavelength_m: 0.08,
            grain: 0.16,
            seed: draw.seed(),
        };
        let mat = object(3, Pattern::Checker { period_m: 0.06 }, &mut draw);
        let poster = object(4, Pattern::Checker { period_m: 0.3 }, &mut draw);
        let ball = object(0, Pattern::Stripes { period_m: 0.07 }, &mut draw);
        let block = object(1, Pattern::Checker { period_m: 0.045 }, &mut draw);
        let bystander = object(2, Pattern::Stripes { period_m: 0.06 }, &mut draw);
        let intruder = object(5, Pattern::Checker { period_m: 0.07 }, &mut draw);
        let morphed = object(0, Pattern::Blotches, &mut draw);

        let start = HandTarget {
            yaw_rad: side * draw.uniform(0.52, 0.66),
            radius_m: draw.uniform(0.40, 0.44),
            height_m: 0.0,
            opening_m: 0.05,
        };
        let goal_yaw = -side * draw.uniform(0.45, 0.6);
        let block_half = vec3(0.034, 0.025, draw.uniform(0.028, 0.04));
        let ground = |yaw: f64, radius: f64, z: f64| {
            BASE_M + vec3(radius * libm::sin(yaw), -radius * libm::cos(yaw), z)
        };
        let goal = ground(goal_yaw, start.radius_m, 0.002);
        let still = vec![
            body(
                0,
                "room",
                Shape::Room,
                vec3(0.0, 0.0, 0.5),
                0.0,
                vec3(2.2, 1.5, 1.3),
                wall,
            ),
            body(
                1,
                "table",
                Shape::Cube,
                vec3(0.0, 0.1, -0.025),
                0.0,
                vec3(0.75, 0.58, 0.025),
                table,
            ),
            body(
                2,
                "mat",
                Shape::Rectangle,
                goal,
                goal_yaw,
                vec3(0.09, 0.09, 1.0),
                mat,
            ),
            body(
                3,
                "poster",
                Shape::Cube,
                vec3(side * 0.55, 1.49, 0.42),
                0.0,
                vec3(0.36, 0.01, 0.26),
                poster,
            ),
            body(
                4,
                "ball",
                Shape::Ball,
                vec3(
                    side * draw.uniform(0.42, 0.48),
                    draw.uniform(0.26, 0.32),
                    0.065,
                ),
                0.0,
                vec3(0.065, 0.065, 0.065),
                ball,
            ),
        ];
        let held_z = block_half.z;
        let carried = body(
            5,
            "block",
            Shape::Cube,
            ground(start.yaw_rad, start.radius_m, held_z),
            start.yaw_rad - std::f64::consts::FRAC_PI_2,
            block_half,
            block,
        );
        let bystander_half = vec3(0.05, 0.04, draw.uniform(0.062, 0.072));
        let bystander_body = body(
            6,
            "bystander",
            Shape::Cube,
            vec3(
                -side * draw.uniform(0.10, 0.16),
                draw.uniform(-0.30, -0.26),
                bystander_half.z,
            ),
            draw.uniform(-0.5, 0.5),
            bystander_half,
            bystander,
        );
        let intruder_half = vec3(0.05, 0.05, 0.055);
        let intruder_body = body(
            7,
            "intruder",
            Shape::Cube,
            vec3(
                side * draw.uniform(0.12, 0.2),
                draw.uniform(-0.3, -0.25),
                intruder_half.z,
            ),
            draw.uniform(0.2, 0.7),
            intruder_half,
            intruder,
        );
        // Wider, lower and leaning: half as much again across, a third lower, sheared by 0.45 of the height.
        let lean = draw.pick(&[-0.45, 0.45], 0.45);
        let morph_linear = Mat3::from_columns(
            vec3(1.5, 0.0, 0.0),
            vec3(0.0, 1.2, 0.0),
            vec3(lean, 0.0, 0.68),
        );
        let [paint, band, joint] = draw.pick(&ARM_PAINTS, ARM_PAINTS[0]);
        let arm = Arm {
            base_m: BASE_M,
            paint,
            band,
            joint,
            seed: draw.seed(),
            first_id: ARM_FIRST_ID,
        };
        let task = Task::new(family, &start, goal_yaw, held_z, &mut draw);
        let azimuth = draw.uniform(-0.35, 0.35);
        let eye_m = vec3(
            EYE_DISTANCE_M * libm::sin(azimuth),
            LOOK_AT_M.y - EYE_DISTANCE_M * libm::cos(azimuth),
            draw.uniform(0.62, 0.78),
        );
        Self {
            still,
            carried,
            bystander: bystander_body,
            intruder: intruder_body,
            morph_to: (morph_linear, morphed),
            arm,
            task,
            eye_m,
            camera: family,
            side,
        }
    }
}
