//! Inpainting by fast marching (A. Telea, "An Image Inpainting Technique Based on the Fast Marching
//! Method", 2004): the hole is filled from its border inwards, each pixel from the known ones near it,
//! weighted by distance, level and the direction of the front.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use plumbline_vision::image::Rgb8;

const FAR: f32 = 1e6;

#[derive(Debug, Clone, Copy, PartialEq)]
enum State {
    Known,
    Band,
    Inside,
}

/// The front: pixels by arrival time (its bits order as positive floats do), then in order of entry.
struct Front {
    heap: BinaryHeap<Reverse<(u32, usize, usize)>>,
    entered: usize,
}

impl Front {
    fn push(&mut self, time: f32, at: usize) {
        self.heap.push(Reverse((time.to_bits(), self.entered, at)));
        self.entered += 1;
    }
}

struct March {
    width: usize,
    height: usize,
    state: Vec<State>,
    time: Vec<f32>,
}

impl March {
    fn neighbours(&self, at: usize) -> impl Iterator<Item = usize> + use<> {
        let (x, y) = (at % self.width, at / self.width);
        let (width, height) = (self.width, self.height);
        [
            (y > 0).then(|| at - width),
            (x > 0).then(|| at - 1),
            (y + 1 < height).then(|| at + width),
            (x + 1 < width).then(|| at + 1),
        ]
        .into_iter()
        .flatten()
    }

    /// Arrival time from one vertical and one horizontal neighbour.
    fn solve(&self, a: Option<usize>, b: Option<usize>) -> f32 {
        let known = |at: Option<usize>| {
            at.filter(|&at| self.state[at] != State::Inside)
                .map(|at| self.time[at])
        };
        match (known(a), known(b)) {
            (Some(a), Some(b)) if (a - b).abs() < 1.0 => {
                (a + b + (2.0 - (a - b) * (a - b)).sqrt()) / 2.0
            }
            (Some(a), Some(b)) => 1.0 + a.min(b),
            (Some(a), None) | (None, Some(a)) => 1.0 + a,
            (None, None) => FAR,
        }
    }

    fn arrival(&self, at: usize) -> f32 {
        let (x, y) = (at % self.width, at / self.width);
        let vertical = [
            (y > 0).then(|| at - self.width),
            (y + 1 < self.height).then(|| at + self.width),
        ];
        let horizontal = [
            (x > 0).then(|| at - 1),
            (x + 1 < self.width).then(|| at + 1),
        ];
        let mut least = FAR;
        for a in vertical {
            for b in horizontal {
                least = least.min(self.solve(a, b));
            }
        }
        least
    }

    /// Marches into `Inside` pixels; `fill` sees each before it joins the band.
    fn run(&mut self, limit: f32, mut fill: impl FnMut(&Self, usize)) {
        let mut front = Front {
            heap: BinaryHeap::new(),
            entered: 0,
        };
        for at in (0..self.state.len()).filter(|&at| self.state[at] == State::Band) {
            front.push(self.time[at], at);
        }
        while let Some(Reverse((bits, _, at))) = front.heap.pop() {
            if f32::from_bits(bits) > limit {
                break;
            }
            self.state[at] = State::Known;
            for next in self.neighbours(at) {
                if self.state[next] == State::Inside {
                    self.time[next] = self.arrival(next);
                    fill(self, next);
                    self.state[next] = State::Band;
                    front.push(self.time[next], next);
                }
            }
        }
    }
}

/// Fills the hole from the `radius` pixels around each of its pixels.
pub(crate) fn telea(picture: &Rgb8, hole: &[bool], radius: i64) -> Rgb8 {
    let (width, height) = (picture.width, picture.height);
    let mut inward = March {
        width,
        height,
        state: hole
            .iter()
            .map(|&h| if h { State::Inside } else { State::Known })
            .collect(),
        time: vec![0.0; hole.len()],
    };
    for at in 0..hole.len() {
        if !hole[at] && inward.neighbours(at).any(|next| hole[next]) {
            inward.state[at] = State::Band;
        }
        if hole[at] {
            inward.time[at] = FAR;
        }
    }
    // Times outside the hole are negative distances to it, as far as pixels are looked up.
    let mut outward = March {
        width,
        height,
        state: (0..hole.len())
            .map(|at| match inward.state[at] {
                State::Known => State::Inside,
                State::Inside => State::Known,
                State::Band => State::Band,
            })
            .collect(),
        time: vec![0.0; hole.len()],
    };
    outward.run(2.0 * radius as f32, |_, _| {});
    for at in (0..hole.len()).filter(|&at| inward.state[at] == State::Known) {
        inward.time[at] = -outward.time[at];
    }
    let mut data = picture.data.clone();
    inward.run(FAR, |march, at| {
        for channel in 0..3 {
            data[3 * at + channel] = estimate(march, &data, at, channel, radius);
        }
    });
    Rgb8::new(width, height, data).unwrap()
}

/// One channel of a pixel from the known ones around it.
fn estimate(march: &March, data: &[u8], at: usize, channel: usize, radius: i64) -> u8 {
    let (x, y) = ((at % march.width) as i64, (at / march.width) as i64);
    let index = |x: i64, y: i64| {
        let inside = x >= 0 && y >= 0 && x < march.width as i64 && y < march.height as i64;
        inside.then(|| y as usize * march.width + x as usize)
    };
    let known = |x: i64, y: i64| index(x, y).filter(|&at| march.state[at] != State::Inside);
    // Central, one-sided or no difference, by what is known.
    let slope = |here: f32, before: Option<f32>, after: Option<f32>| match (before, after) {
        (Some(b), Some(a)) => (a - b) / 2.0,
        (None, Some(a)) => a - here,
        (Some(b), None) => here - b,
        (None, None) => 0.0,
    };
    let time = |x: i64, y: i64| known(x, y).map(|at| march.time[at]);
    let level = |x: i64, y: i64| known(x, y).map(|at| f32::from(data[3 * at + channel]));
    let front = [
        slope(march.time[at], time(x - 1, y), time(x + 1, y)),
        slope(march.time[at], time(x, y - 1), time(x, y + 1)),
    ];
    let (mut sum, mut total, mut lift) = (0.0f32, 1e-20f32, [0.0f32; 2]);
    for dy in -radius..=radius {
        for dx in -radius..=radius {
            let Some(other) =
                known(x + dx, y + dy).filter(|_| dx * dx + dy * dy <= radius * radius)
            else {
                continue;
            };
            let toward = [-dx as f32, -dy as f32];
            let squared = (dx * dx + dy * dy) as f32;
            let mut direction = toward[0] * front[0] + toward[1] * front[1];
            if direction.abs() <= 0.01 {
                direction = 1e-6;
            }
            let same_level = 1.0 / (1.0 + (march.time[other] - march.time[at]).abs());
            let weight = (direction * same_level / (squared * squared.sqrt())).abs();
            let here = f32::from(data[3 * other + channel]);
            let (ox, oy) = (x + dx, y + dy);
            lift[0] += weight * slope(here, level(ox - 1, oy), level(ox + 1, oy)) * toward[0];
            lift[1] += weight * slope(here, level(ox, oy - 1), level(ox, oy + 1)) * toward[1];
            sum += weight * here;
            total += weight;
        }
    }
    let norm = (lift[0] * lift[0] + lift[1] * lift[1]).sqrt() + 1e-20;
    (sum / total + (lift[0] + lift[1]) / norm + 0.5).clamp(0.0, 255.0) as u8
}
