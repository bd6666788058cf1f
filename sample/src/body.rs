//! Textured bodies: a unit shape (cube, ball, rectangle, or the inside of a cube) under an affine map.
//!
//! The map `world_from_unit` carries size, pose and any deformation, so that one ray test serves rigid and deformed
//! bodies, and a surface point is named by its unit coordinates: they stay with the material when the body moves or
//! changes shape. Rays are given in unit coordinates as `origin + s · direction`; where the direction has depth 1 in
//! the camera, `s` is the depth in metres. Nothing fails; a miss is `None`.

use crate::geometry::{Affine, Vec3, vec3};
use crate::texture::{Rgb, Texture};

/// Nearer surfaces are not seen, metres: far less than any distance in the scenes, far more than rounding.
pub const NEAR_M: f64 = 0.01;

/// The unit shape of a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// The cube [−1, 1]³, seen from outside.
    Cube,
    /// The cube [−1, 1]³, seen from inside: a room, which every ray from within meets.
    Room,
    /// The ball of radius 1.
    Ball,
    /// The rectangle [−1, 1]² in the plane z = 0, seen from both sides.
    Rectangle,
}

/// A body in the world at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// Identity; the same number is the same body in all frames of a clip.
    pub id: u16,
    /// What it is, for people.
    pub name: &'static str,
    /// Its unit shape.
    pub shape: Shape,
    /// Size, pose and deformation.
    pub world_from_unit: Affine,
    /// Half extents at rest, metres: scales unit coordinates to those of the texture.
    pub half_m: Vec3,
    /// Colour.
    pub texture: Texture,
    /// A second colour and its share 0..=1, for a body that changes its looks.
    pub overlay: Option<(Texture, f64)>,
}

/// The unit normal and face number of a surface point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Face {
    /// Outward normal in unit coordinates (towards the viewer's side for a room).
    pub normal: Vec3,
    /// 0..6 for the faces of a cube, 0 otherwise.
    pub index: u32,
}

impl Shape {
    /// The smallest `s` > [`NEAR_M`] at which the ray meets the surface.
    #[must_use]
    pub fn hit(self, origin: Vec3, direction: Vec3) -> Option<f64> {
        let s = match self {
            Self::Cube => {
                let (near, far) = slabs(origin, direction);
                if near > far {
                    return None;
                }
                near
            }
            Self::Room => {
                let (near, far) = slabs(origin, direction);
                if near > far {
                    return None;
                }
                far
            }
            Self::Ball => {
                let a = direction.dot(direction);
                let half_b = origin.dot(direction);
                let c = origin.dot(origin) - 1.0;
                let discriminant = half_b * half_b - a * c;
                if discriminant < 0.0 {
                    return None;
                }
                (-half_b - discriminant.sqrt()) / a
            }
            Self::Rectangle => {
                let s = -origin.z / direction.z;
                let (x, y) = (origin.x + s * direction.x, origin.y + s * direction.y);
                if !(x.abs() <= 1.0 && y.abs() <= 1.0) {
                    return None;
                }
                s
            }
        };
        (s.is_finite() && s > NEAR_M).then_some(s)
    }

    /// The face a surface point in unit coordinates belongs to: of a cube, the one it is nearest to.
    #[must_use]
    pub fn face(self, unit: Vec3) -> Face {
        match self {
            Self::Ball => Face {
                normal: unit,
                index: 0,
            },
            Self::Rectangle => Face {
                normal: vec3(0.0, 0.0, 1.0),
                index: 0,
            },
            Self::Cube | Self::Room => {
                let size = vec3(unit.x.abs(), unit.y.abs(), unit.z.abs());
                let (axis, value) = if size.x >= size.y && size.x >= size.z {
                    (0, unit.x)
                } else if size.y >= size.z {
                    (1, unit.y)
                } else {
                    (2, unit.z)
                };
                let outward = if value < 0.0 { -1.0 } else { 1.0 };
                let sign = if self == Self::Room {
                    -outward
                } else {
                    outward
                };
                let mut normal = [0.0; 3];
                normal[axis] = sign;
                let [x, y, z] = normal;
                Face {
                    normal: vec3(x, y, z),
                    index: 2 * axis as u32 + u32::from(value < 0.0),
                }
            }
        }
    }
}

/// Entry and exit of a ray through the cube [−1, 1]³ (slab method). Where a component of the direction is zero the
/// quotients are infinite, or not a number on the slab's very boundary, which `min` and `max` pass over.
fn slabs(origin: Vec3, direction: Vec3) -> (f64, f64) {
    let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
    for (o, d) in [
        (origin.x, direction.x),
        (origin.y, direction.y),
        (origin.z, direction.z),
    ] {
        let inverse = 1.0 / d;
        let (a, b) = ((-1.0 - o) * inverse, (1.0 - o) * inverse);
        near = near.max(a.min(b));
        far = far.min(a.max(b));
    }
    (near, far)
}

impl Body {
    /// Colour of the surface point `unit` on `face`, unlit.
    #[must_use]
    pub fn albedo(&self, unit: Vec3, face: &Face) -> Rgb {
        let p = unit.scaled(self.half_m);
        let (u, v) = match (self.shape, face.index / 2) {
            // The ball's texture is solid and constant along an oblique direction: no seam and no pole.
            (Shape::Ball, _) => (p.x + 0.4 * p.y, p.z + 0.3 * p.y),
            (Shape::Rectangle, _) => (p.x, p.y),
            (_, 0) => (p.z, p.y),
            (_, 1) => (p.x, p.z),
            _ => (p.x, p.y),
        };
        let base = self.texture.albedo(u, v, face.index);
        match &self.overlay {
            None => base,
            Some((texture, share)) => {
                let other = texture.albedo(u, v, face.index);
                std::array::from_fn(|c| base[c] + share * (other[c] - base[c]))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twin: march along the ray in small steps until inside (outside, for the room) and compare.
    #[test]
    fn hits_agree_with_marching() {
        let origin = vec3(-2.5, 0.3, 0.2);
        let mut hits = 0;
        for i in 0..60 {
            let direction = vec3(1.0, -0.6 + 0.02 * f64::from(i), 0.45 - 0.017 * f64::from(i));
            for shape in [Shape::Cube, Shape::Ball] {
                let inside = |s: f64| {
                    let p = origin + direction * s;
                    match shape {
                        Shape::Ball => p.dot(p) <= 1.0,
                        _ => p.x.abs() <= 1.0 && p.y.abs() <= 1.0 && p.z.abs() <= 1.0,
                    }
                };
                let step = 1e-4;
                let marched = (0..60_000)
                    .map(|k| f64::from(k) * step)
                    .find(|&s| inside(s));
                match (shape.hit(origin, direction), marched) {
                    (Some(s), Some(m)) => {
                        hits += 1;
                        assert!((s - m).abs() <= 2.0 * step, "{shape:?} {s} {m}");
                    }
                    (None, None) => {}
                    // A grazing ray may be inside for less than one step.
                    (Some(s), None) => assert!(!inside(s + 2.0 * step)),
                    (None, Some(m)) => panic!("{shape:?} missed at {m}"),
                }
            }
        }
        assert!(hits > 40);
    }

    #[test]
    fn a_room_is_always_met_and_an_axis_parallel_ray_is_no_accident() {
        assert_eq!(
            Shape::Room.hit(vec3(0.0, 0.0, 0.0), vec3(0.0, 0.0, 1.0)),
            Some(1.0)
        );
        assert_eq!(
            Shape::Cube.hit(vec3(0.5, 0.5, -3.0), vec3(0.0, 0.0, 1.0)),
            Some(2.0)
        );
        assert_eq!(
            Shape::Cube.hit(vec3(1.5, 0.5, -3.0), vec3(0.0, 0.0, 1.0)),
            None
        );
        assert_eq!(
            Shape::Rectangle.hit(vec3(0.5, 0.5, -3.0), vec3(0.0, 0.0, 1.0)),
            Some(3.0)
        );
        assert_eq!(
            Shape::Rectangle.hit(vec3(0.5, 0.5, -3.0), vec3(1.0, 0.0, 0.0)),
            None
        );
    }
}
