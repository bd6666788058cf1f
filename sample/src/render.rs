//! Draws a snapshot: ray casting into a z-buffer of sub-samples, Lambert shading, box filter, 8-bit RGB.
//!
//! Pixels: (x, y) with x right and y down; pixel centres have whole-number coordinates, the picture covers
//! [−0.5, width − 0.5] × [−0.5, height − 0.5], and a point (X, Y, Z) of the camera's frame is seen at
//! (fx X/Z + cx, fy Y/Z + cy). With an odd number of sub-samples per side the middle one lies on the pixel centre, so
//! that picture and ground truth come from the same rays. Only the bounding rectangle of each body is tested. The light
//! is fixed in the world and casts no shadows: a surface keeps its brightness unless it turns.
//!
//! Fails on a picture size outside [`MIN_SIDE_PX`]..=[`MAX_SIDE_PX`] (checked by [`Camera::new`]).

use serde::{Deserialize, Serialize};

use crate::SampleError;
use crate::body::{Body, NEAR_M, Shape};
use crate::geometry::{Affine, Vec3, vec3};
use crate::scene::Snapshot;
use crate::texture::Rgb;

/// Smallest side of a picture: below it nothing of a scene is left.
pub const MIN_SIDE_PX: usize = 8;
/// Largest side of a picture: bounds the sub-sample buffers to about 1.5 GB.
pub const MAX_SIDE_PX: usize = 4096;

/// Share of light that reaches every surface.
const AMBIENT: f64 = 0.62;
/// Share of light from the lamp on a surface that faces it.
const DIFFUSE: f64 = 0.38;
/// Direction to the lamp: above, in front and to the left.
const LIGHT: Vec3 = vec3(-0.39, -0.49, 0.78);
/// Focal length over picture width: 58 degrees of horizontal view, as a webcam.
const FOCAL_PER_WIDTH: f64 = 0.9;

/// A pinhole camera without distortion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Picture width in pixels.
    pub width: usize,
    /// Picture height in pixels.
    pub height: usize,
    /// Horizontal focal length, pixels.
    pub fx: f64,
    /// Vertical focal length, pixels.
    pub fy: f64,
    /// Principal point, x, pixels.
    pub cx: f64,
    /// Principal point, y, pixels.
    pub cy: f64,
}

impl Camera {
    /// The sample corpus's camera for a picture size: square pixels, principal point in the middle.
    ///
    /// # Errors
    /// [`SampleError::Size`] where a side is out of bounds.
    pub fn new(width: usize, height: usize) -> Result<Self, SampleError> {
        let sides = MIN_SIDE_PX..=MAX_SIDE_PX;
        if !sides.contains(&width) || !sides.contains(&height) {
            return Err(SampleError::Size { width, height });
        }
        let focal = FOCAL_PER_WIDTH * width as f64;
        Ok(Self {
            width,
            height,
            fx: focal,
            fy: focal,
            cx: 0.5 * (width as f64 - 1.0),
            cy: 0.5 * (height as f64 - 1.0),
        })
    }

    /// Direction of the ray through (x, y), with depth 1, in the camera's frame.
    #[must_use]
    pub fn ray(&self, x: f64, y: f64) -> Vec3 {
        vec3((x - self.cx) / self.fx, (y - self.cy) / self.fy, 1.0)
    }

    /// Where a point of the camera's frame is seen, or `None` at or behind the camera.
    #[must_use]
    pub fn project(&self, point: Vec3) -> Option<(f64, f64)> {
        (point.z > NEAR_M).then(|| {
            (
                self.fx * point.x / point.z + self.cx,
                self.fy * point.y / point.z + self.cy,
            )
        })
    }

    /// Whether (x, y) lies in the picture.
    #[must_use]
    pub fn contains(&self, x: f64, y: f64) -> bool {
        x >= -0.5 && y >= -0.5 && x <= self.width as f64 - 0.5 && y <= self.height as f64 - 0.5
    }
}

/// Sub-samples per pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Antialias {
    /// One ray through the pixel centre.
    None,
    /// 3×3 rays, box filter.
    #[default]
    Three,
}

impl Antialias {
    const fn per_side(self) -> usize {
        match self {
            Self::None => 1,
            Self::Three => 3,
        }
    }
}

/// An 8-bit RGB picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RgbFrame {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// `[height, width, 3]`, row-major.
    pub rgb: Vec<u8>,
}

/// A body prepared for one camera: rays in its unit coordinates start at `origin`.
pub(crate) struct Placed<'a> {
    pub(crate) body: &'a Body,
    unit_from_camera: Affine,
    /// Lit share of the six faces; balls are lit point by point.
    face_light: [f64; 6],
    world_from_unit_normal: crate::geometry::Mat3,
}

impl Placed<'_> {
    /// Depth in metres at which the camera ray `direction` (depth 1) meets the body.
    pub(crate) fn depth(&self, direction: Vec3) -> Option<f64> {
        self.body.shape.hit(
            self.unit_from_camera.offset,
            self.unit_from_camera.linear * direction,
        )
    }

    /// The surface point at depth `depth_m` on the ray, in unit coordinates.
    pub(crate) fn unit_point(&self, direction: Vec3, depth_m: f64) -> Vec3 {
        self.unit_from_camera.offset + (self.unit_from_camera.linear * direction) * depth_m
    }

    fn colour(&self, unit: Vec3) -> Rgb {
        let face = self.body.shape.face(unit);
        let light = match self.body.shape {
            Shape::Ball => lambert(self.world_from_unit_normal * face.normal),
            _ => self.face_light[face.index as usize],
        };
        self.body.albedo(unit, &face).map(|c| c * light)
    }
}

fn lambert(normal: Vec3) -> f64 {
    AMBIENT + DIFFUSE * (normal.normalised().dot(LIGHT.normalised())).max(0.0)
}

/// Prepares the bodies. A flattened body (singular map) has no inside and is left out.
pub(crate) fn place(snapshot: &Snapshot) -> Vec<Placed<'_>> {
    let to_camera = &snapshot.camera_from_world;
    let prepared = snapshot.bodies.iter().filter_map(|body| {
        let unit_from_camera = (*to_camera * body.world_from_unit).inverse()?;
        let world_from_unit_normal = body.world_from_unit.linear.inverse()?.transposed();
        let face_light = std::array::from_fn(|index| {
            let sign = if (index % 2 == 1) ^ (body.shape == Shape::Room) {
                -1.0
            } else {
                1.0
            };
            let normal = match (body.shape, index / 2) {
                (Shape::Rectangle, _) | (_, 2) => vec3(0.0, 0.0, 1.0),
                (_, 0) => vec3(1.0, 0.0, 0.0),
                _ => vec3(0.0, 1.0, 0.0),
            };
            lambert(world_from_unit_normal * normal * sign)
        });
        Some(Placed {
            body,
            unit_from_camera,
            face_light,
            world_from_unit_normal,
        })
    });
    prepared.collect()
}

/// What the rays of one picture meet: for every sub-sample the index of the nearest body and its depth.
pub(crate) struct Samples<'a> {
    pub(crate) bodies: Vec<Placed<'a>>,
    camera: Camera,
    per_side: usize,
    /// `[height · per_side, width · per_side]`; infinite depth where nothing was met.
    nearest: Vec<(f64, u16)>,
}

impl<'a> Samples<'a> {
    /// Casts all rays of a picture.
    pub(crate) fn cast(camera: &Camera, antialias: Antialias, snapshot: &'a Snapshot) -> Self {
        let per_side = antialias.per_side();
        let bodies = place(snapshot);
        let mut samples = Self {
            nearest: vec![(f64::INFINITY, 0); camera.width * camera.height * per_side * per_side],
            bodies: Vec::new(),
            camera: *camera,
            per_side,
        };
        for (index, placed) in bodies.iter().enumerate() {
            samples.draw(index as u16, placed, &snapshot.camera_from_world);
        }
        samples.bodies = bodies;
        samples
    }

    /// Pixel coordinate of a row or column of sub-samples.
    fn coordinate(&self, sub: usize) -> f64 {
        let middle = (self.per_side - 1) as f64 / 2.0;
        (sub as f64 - middle) / self.per_side as f64
    }

    fn draw(&mut self, index: u16, placed: &Placed<'_>, camera_from_world: &Affine) {
        let (columns, rows) = (
            self.camera.width * self.per_side,
            self.camera.height * self.per_side,
        );
        let [x0, x1, y0, y1] = self.bounds(&(*camera_from_world * placed.body.world_from_unit));
        for row in y0..y1.min(rows) {
            let y = self.coordinate(row);
            for column in x0..x1.min(columns) {
                let direction = self.camera.ray(self.coordinate(column), y);
                if let Some(depth) = placed.depth(direction) {
                    let sample = &mut self.nearest[row * columns + column];
                    if depth < sample.0 {
                        *sample = (depth, index);
                    }
                }
            }
        }
    }

    /// Sub-sample rectangle [x0, x1, y0, y1) around the projected unit cube; everything if a corner is not in front.
    fn bounds(&self, camera_from_unit: &Affine) -> [usize; 4] {
        let all = [0, usize::MAX, 0, usize::MAX];
        let (mut low, mut high) = ((f64::MAX, f64::MAX), (f64::MIN, f64::MIN));
        for corner in 0..8_u32 {
            let sign = |bit: u32| if corner >> bit & 1 == 1 { 1.0 } else { -1.0 };
            let point = camera_from_unit.apply(vec3(sign(0), sign(1), sign(2)));
            let Some((x, y)) = self.camera.project(point) else {
                return all;
            };
            low = (low.0.min(x), low.1.min(y));
            high = (high.0.max(x), high.1.max(y));
        }
        // One pixel of slack against rounding; the cast to usize clips below 0.
        let sub = |x: f64| ((x + 0.5) * self.per_side as f64) as usize;
        [
            sub(low.0 - 1.0),
            sub(high.0 + 1.0) + 1,
            sub(low.1 - 1.0),
            sub(high.1 + 1.0) + 1,
        ]
    }

    /// Nearest body and depth on the ray through the centre of pixel (x, y); `None` where nothing is met.
    pub(crate) fn centre(&self, x: usize, y: usize) -> Option<(&Placed<'a>, f64)> {
        let middle = (self.per_side - 1) / 2;
        let columns = self.camera.width * self.per_side;
        let (depth, index) =
            self.nearest[(y * self.per_side + middle) * columns + x * self.per_side + middle];
        depth
            .is_finite()
            .then(|| (&self.bodies[usize::from(index)], depth))
    }

    /// Calls `visit` with the pixel index and the body of every sub-sample that meets one.
    pub(crate) fn for_each_body(&self, mut visit: impl FnMut(usize, &Body)) {
        let columns = self.camera.width * self.per_side;
        for (k, &(depth, index)) in self.nearest.iter().enumerate() {
            if depth.is_finite() {
                let pixel =
                    k / columns / self.per_side * self.camera.width + k % columns / self.per_side;
                visit(pixel, self.bodies[usize::from(index)].body);
            }
        }
    }

    /// Shades all sub-samples and averages them: `[height, width]` colours; black where nothing was met.
    pub(crate) fn shade(&self) -> Vec<Rgb> {
        let (width, n) = (self.camera.width, self.per_side);
        let mut picture = vec![[0.0; 3]; width * self.camera.height];
        let share = 1.0 / (n * n) as f64;
        for (row, line) in self.nearest.chunks_exact(width * n).enumerate() {
            let y = self.coordinate(row);
            for (column, &(depth, index)) in line.iter().enumerate() {
                if depth.is_finite() {
                    let placed = &self.bodies[usize::from(index)];
                    let direction = self.camera.ray(self.coordinate(column), y);
                    let colour = placed.colour(placed.unit_point(direction, depth));
                    let pixel = &mut picture[row / n * width + column / n];
                    for c in 0..3 {
                        pixel[c] += share * colour[c];
                    }
                }
            }
        }
        picture
    }
}

/// Casts and shades a snapshot: `[height, width]` colours in 0..=255 before sensor noise and rounding.
#[must_use]
pub fn render(camera: &Camera, antialias: Antialias, snapshot: &Snapshot) -> Vec<Rgb> {
    Samples::cast(camera, antialias, snapshot).shade()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Family, Scene};

    /// Slow twin: every ray against every body, no rectangles and no buffer.
    #[test]
    fn nearest_bodies_equal_brute_force() {
        let camera = Camera::new(48, 36).unwrap();
        for (family, progress) in [
            (Family::Pick, 0.45),
            (Family::Push, 0.6),
            (Family::Dolly, 0.8),
        ] {
            let snapshot = Scene::new(family, 11).snapshot(progress, None);
            let samples = Samples::cast(&camera, Antialias::Three, &snapshot);
            let mut seen = std::collections::BTreeSet::new();
            for (k, &(depth, index)) in samples.nearest.iter().enumerate() {
                let (x, y) = (samples.coordinate(k % 144), samples.coordinate(k / 144));
                let mut twin = (f64::INFINITY, 0);
                for (i, placed) in samples.bodies.iter().enumerate() {
                    match placed.depth(camera.ray(x, y)) {
                        Some(d) if d < twin.0 => twin = (d, i as u16),
                        _ => {}
                    }
                }
                assert_eq!((depth, index), twin, "{family:?} at {x},{y}");
                assert!(depth.is_finite(), "the room must enclose the camera");
                seen.insert(index);
            }
            // Room, table, four objects and most of the arm are in view.
            assert!(seen.len() >= 12, "{seen:?}");
        }
    }

    #[test]
    fn ray_and_projection_are_inverse() {
        let camera = Camera::new(64, 48).unwrap();
        let (x, y) = camera.project(camera.ray(12.25, 40.5) * 3.0).unwrap();
        assert!((x - 12.25).abs() < 1e-12 && (y - 40.5).abs() < 1e-12);
        assert!(camera.project(vec3(0.0, 0.0, -1.0)).is_none());
    }

    #[test]
    fn sizes_out_of_bounds_are_errors() {
        assert_eq!(
            Camera::new(0, 48),
            Err(SampleError::Size {
                width: 0,
                height: 48
            })
        );
        assert!(Camera::new(64, 5000).is_err());
    }
}
