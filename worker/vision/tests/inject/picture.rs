//! The picture operations of the injections, as OpenCV names them; 8-bit RGB, `[H, W]` masks 0..=1.

use plumbline_vision::image::{Plane, Rgb8, gaussian_blur};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

/// Distance to the sides within which no fault is put, pixels.
const PICK_MARGIN: usize = 36;

pub(crate) fn pixel(picture: &Rgb8, x: usize, y: usize) -> [u8; 3] {
    let at = (y * picture.width + x) * 3;
    [0, 1, 2].map(|channel| picture.data[at + channel])
}

pub(crate) fn map_pixels(
    width: usize,
    height: usize,
    value: impl Fn(usize, usize) -> [u8; 3],
) -> Rgb8 {
    let data = (0..width * height).flat_map(|cell| value(cell % width, cell / width));
    Rgb8::new(width, height, data.collect()).unwrap()
}

fn channel(picture: &Rgb8, channel: usize) -> Plane {
    Plane {
        width: picture.width,
        height: picture.height,
        data: picture.data[channel..]
            .iter()
            .step_by(3)
            .map(|&v| f32::from(v))
            .collect(),
    }
}

fn from_channels(planes: &[Plane; 3]) -> Rgb8 {
    let byte = |value: f32| value.round_ties_even().clamp(0.0, 255.0) as u8;
    let (width, height) = (planes[0].width, planes[0].height);
    map_pixels(width, height, |x, y| {
        [0, 1, 2].map(|channel| byte(planes[channel].data[y * width + x]))
    })
}

pub(crate) fn blur(picture: &Rgb8, sigma: f64) -> Rgb8 {
    from_channels(&[0, 1, 2].map(|k| gaussian_blur(&channel(picture, k), sigma)))
}

/// A filled circle with a soft border.
pub(crate) fn circle(
    width: usize,
    height: usize,
    centre: [usize; 2],
    radius: f64,
    feather: f64,
) -> Plane {
    let disc = Plane::from_fn(width, height, |x, y| {
        let (dx, dy) = (x as f64 - centre[0] as f64, y as f64 - centre[1] as f64);
        f32::from(u8::from(dx.hypot(dy) <= radius))
    });
    gaussian_blur(&disc, feather)
}

/// Standard normal values (Box-Muller).
pub(crate) fn normal_plane(random: &mut Pcg64Mcg, width: usize, height: usize) -> Plane {
    Plane::from_fn(width, height, |_, _| {
        let (u, v): (f64, f64) = (random.random(), random.random());
        let radius = (-2.0 * (1.0 - u).ln()).sqrt();
        (radius * (2.0 * std::f64::consts::PI * v).cos()) as f32
    })
}

pub(crate) fn deviation(plane: &Plane) -> f64 {
    let count = plane.data.len() as f64;
    let mean = plane.data.iter().map(|&v| f64::from(v)).sum::<f64>() / count;
    let square = |&v: &f32| (f64::from(v) - mean) * (f64::from(v) - mean);
    (plane.data.iter().map(square).sum::<f64>() / count).sqrt()
}

/// A smooth random displacement field of standard deviation `amplitude`.
pub(crate) fn elastic(
    random: &mut Pcg64Mcg,
    width: usize,
    height: usize,
    amplitude: f64,
    sigma: f64,
) -> [Plane; 2] {
    let mut field = [0, 1].map(|_| gaussian_blur(&normal_plane(random, width, height), sigma));
    let spread = field
        .iter()
        .map(|plane| deviation(plane).powi(2))
        .sum::<f64>()
        / 2.0;
    for plane in &mut field {
        for value in &mut plane.data {
            *value *= (amplitude / (spread.sqrt() + 1e-9)) as f32;
        }
    }
    field
}

/// The picture at x + share · field, bilinear, borders repeated.
pub(crate) fn warp(picture: &Rgb8, field: &[Plane; 2], share: f32) -> Rgb8 {
    let warped = [0, 1, 2].map(|k| {
        let source = channel(picture, k);
        Plane::from_fn(picture.width, picture.height, |x, y| {
            let at = y * picture.width + x;
            let x = x as f32 + share * field[0].data[at];
            let y = y as f32 + share * field[1].data[at];
            source.sample(x, y).unwrap()
        })
    });
    from_channels(&warped)
}

/// a · (1 − m) + b · m, truncated to bytes as NumPy's cast does.
pub(crate) fn blend(a: &Rgb8, b: &Rgb8, mask: &Plane) -> Rgb8 {
    map_pixels(a.width, a.height, |x, y| {
        let m = mask.data[y * a.width + x];
        let (a, b) = (pixel(a, x, y), pixel(b, x, y));
        [0, 1, 2].map(|k| (f32::from(a[k]) * (1.0 - m) + f32::from(b[k]) * m) as u8)
    })
}

/// Adds grey noise under a mask.
pub(crate) fn add_grey(picture: &Rgb8, noise: &Plane, mask: &Plane, gain: f32) -> Rgb8 {
    map_pixels(picture.width, picture.height, |x, y| {
        let at = y * picture.width + x;
        let added = gain * noise.data[at] * mask.data[at];
        pixel(picture, x, y).map(|v| (f32::from(v) + added).clamp(0.0, 255.0) as u8)
    })
}

/// Bilateral filter over a disc: weights by distance and by the sum of the channels' differences.
pub(crate) fn bilateral(picture: &Rgb8, radius: i64, sigma_colour: f64, sigma_space: f64) -> Rgb8 {
    let (width, height) = (picture.width as i64, picture.height as i64);
    let gauss = |squared: f64, sigma: f64| (-0.5 * squared / (sigma * sigma)).exp();
    let colour: Vec<f64> = (0..=765)
        .map(|d| gauss(f64::from(d * d), sigma_colour))
        .collect();
    let mirror = |i: i64, n: i64| if i < 0 { -i } else { i.min(2 * n - 2 - i) } as usize;
    map_pixels(picture.width, picture.height, |x, y| {
        let here = pixel(picture, x, y);
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for dy in -radius..=radius {
            for dx in -radius..=radius {
                let squared = dx * dx + dy * dy;
                if squared > radius * radius {
                    continue;
                }
                let there = pixel(
                    picture,
                    mirror(x as i64 + dx, width),
                    mirror(y as i64 + dy, height),
                );
                let far: usize = (0..3)
                    .map(|k| usize::from(here[k].abs_diff(there[k])))
                    .sum();
                let weight = colour[far] * gauss(squared as f64, sigma_space);
                total += weight;
                for k in 0..3 {
                    sum[k] += weight * f64::from(there[k]);
                }
            }
        }
        sum.map(|s| (s / total).round_ties_even() as u8)
    })
}

/// A point among the 30% most textured ones, away from the sides.
pub(crate) fn textured_point(picture: &Rgb8, random: &mut Pcg64Mcg) -> [usize; 2] {
    let grey = picture.grey();
    let squares = Plane {
        data: grey.data.iter().map(|g| g * g).collect(),
        ..grey
    };
    let (mean, square) = (gaussian_blur(&grey, 6.0), gaussian_blur(&squares, 6.0));
    let mut points: Vec<([usize; 2], f32)> = Vec::new();
    for y in PICK_MARGIN..grey.height - PICK_MARGIN {
        for x in PICK_MARGIN..grey.width - PICK_MARGIN {
            let at = y * grey.width + x;
            let spread = (square.data[at] - mean.data[at] * mean.data[at])
                .max(0.0)
                .sqrt();
            if spread > 0.0 {
                points.push(([x, y], spread));
            }
        }
    }
    points.sort_by(|a, b| a.1.total_cmp(&b.1));
    let first = points.len() * 7 / 10;
    points[random.random_range(first..points.len())].0
}

/// Median of each channel over the clip, as NumPy's cast to bytes gives it.
pub(crate) fn median_picture(frames: &[Rgb8]) -> Rgb8 {
    let middle = frames.len() / 2;
    let mut levels = vec![0u8; frames.len()];
    let data = (0..frames[0].data.len()).map(|at| {
        for (level, frame) in levels.iter_mut().zip(frames) {
            *level = frame.data[at];
        }
        levels.sort_unstable();
        if frames.len() % 2 == 1 {
            levels[middle]
        } else {
            ((u16::from(levels[middle - 1]) + u16::from(levels[middle])) / 2) as u8
        }
    });
    Rgb8::new(frames[0].width, frames[0].height, data.collect()).unwrap()
}

pub(crate) fn dilated(mask: &[bool], width: usize, radius: usize) -> Vec<bool> {
    let height = mask.len() / width;
    let near = |i: usize, n: usize| i.saturating_sub(radius)..(i + radius + 1).min(n);
    let rows: Vec<bool> = (0..mask.len())
        .map(|at| near(at % width, width).any(|x| mask[at - at % width + x]))
        .collect();
    (0..mask.len())
        .map(|at| near(at / width, height).any(|y| rows[y * width + at % width]))
        .collect()
}

fn eroded(mask: &[bool], width: usize, radius: usize) -> Vec<bool> {
    let inverse: Vec<bool> = mask.iter().map(|m| !m).collect();
    dilated(&inverse, width, radius)
        .iter()
        .map(|m| !m)
        .collect()
}

pub(crate) fn opened(mask: &[bool], width: usize, radius: usize) -> Vec<bool> {
    dilated(&eroded(mask, width, radius), width, radius)
}

pub(crate) fn closed(mask: &[bool], width: usize, radius: usize) -> Vec<bool> {
    eroded(&dilated(mask, width, radius), width, radius)
}

/// The position `by` before (x, y), if in the picture.
fn origin(x: usize, y: usize, by: [i64; 2], width: usize, height: usize) -> Option<[usize; 2]> {
    let column = usize::try_from(x as i64 - by[0])
        .ok()
        .filter(|&c| c < width)?;
    let row = usize::try_from(y as i64 - by[1])
        .ok()
        .filter(|&r| r < height)?;
    Some([column, row])
}

pub(crate) fn shift_mask(mask: &Plane, by: [i64; 2]) -> Plane {
    Plane::from_fn(mask.width, mask.height, |x, y| {
        origin(x, y, by, mask.width, mask.height)
            .map_or(0.0, |[x, y]| mask.data[y * mask.width + x])
    })
}

pub(crate) fn shift_picture(picture: &Rgb8, by: [i64; 2]) -> Rgb8 {
    let (width, height) = (picture.width, picture.height);
    map_pixels(width, height, |x, y| {
        origin(x, y, by, width, height).map_or([0; 3], |[x, y]| pixel(picture, x, y))
    })
}
