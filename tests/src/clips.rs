//! Small clips, rendered and encoded when a test asks for them: 64×48 pixels, 10 frames per second.

use std::path::Path;

use plumbline_sample::corpus::ClipSpec;
use plumbline_sample::scene::Family;
use plumbline_vision::image::Rgb8;
use plumbline_worker::encode::Mp4Writer;

/// Columns and rows of every clip.
pub const SIZE_PX: (usize, usize) = (64, 48);

/// Frames of a clip: one more than the paper's warm-up of 7 needs, and the conditioning frame.
pub const FRAMES: usize = 10;

const FPS: f64 = 10.0;

const FAMILIES: [Family; 5] = [
    Family::Pick,
    Family::Push,
    Family::Reach,
    Family::Pan,
    Family::Dolly,
];

/// The `seed`-th clip: families take turns, every seed gives another scene.
pub fn spec(seed: u64) -> ClipSpec {
    let family = FAMILIES[(seed % FAMILIES.len() as u64) as usize];
    ClipSpec {
        frames: FRAMES,
        fps: FPS,
        ..ClipSpec::clean(family, 0, seed).with_size(SIZE_PX.0, SIZE_PX.1)
    }
}

/// The pictures of a clip.
pub fn frames(spec: &ClipSpec) -> Vec<Rgb8> {
    let pictures = spec.render_frames().map(|frame| {
        let frame = frame.expect("the specification is valid");
        Rgb8 {
            width: frame.width,
            height: frame.height,
            data: frame.rgb,
        }
    });
    pictures.collect()
}

/// Picture `index` of a checkered plane that moves a pixel per frame, of any size.
pub fn moving_squares(width: usize, height: usize, index: usize) -> Rgb8 {
    const SIDE_PX: usize = 4;
    let mut data = Vec::with_capacity(width * height * 3);
    for y in 0..height {
        for x in 0..width {
            let (column, row) = ((x + index) / SIDE_PX, y / SIDE_PX);
            // Squares of many greys, so that one is not taken for another.
            let grey = 40 + (column * 37 + row * 59) % 7 * 30;
            data.extend([grey as u8; 3]);
        }
    }
    Rgb8 {
        width,
        height,
        data,
    }
}

/// Writes pictures as an mp4, making its directory.
pub fn write(path: &Path, frames: &[Rgb8]) {
    std::fs::create_dir_all(path.parent().expect("a directory")).expect("directory");
    let (width, height) = (frames[0].width as u32, frames[0].height as u32);
    let mut writer = Mp4Writer::create(path, width, height, FPS).expect("an encoder");
    for frame in frames {
        writer.push(frame).expect("the frame encodes");
    }
    writer.finish().expect("the clip is written");
}

/// Writes pictures as numbered PNG files into a directory.
pub fn write_images(directory: &Path, frames: &[Rgb8]) {
    std::fs::create_dir_all(directory).expect("directory");
    for (index, frame) in frames.iter().enumerate() {
        let (width, height) = (frame.width as u32, frame.height as u32);
        let path = directory.join(format!("frame_{index:04}.png"));
        let picture = image::RgbImage::from_raw(width, height, frame.data.clone());
        picture
            .expect("a whole picture")
            .save(path)
            .expect("the picture is written");
    }
}

/// Writes the `seed`-th clip.
pub fn write_moving(path: &Path, seed: u64) {
    write(path, &frames(&spec(seed)));
}

/// Writes a clip that takes tens of seconds to measure at `standard`, minutes at `accurate`: the `seed`-th, over and over.
pub fn write_long(path: &Path, seed: u64) {
    const ROUNDS: usize = 100;
    let once = frames(&spec(seed));
    write(path, &vec![once; ROUNDS].concat());
}

/// Writes a clip that shows one picture all the time.
pub fn write_still(path: &Path, seed: u64) {
    let first = frames(&spec(seed)).swap_remove(0);
    write(path, &vec![first; FRAMES]);
}

/// Writes only the first `count` frames of the `seed`-th clip.
pub fn write_short(path: &Path, seed: u64, count: usize) {
    write(path, &frames(&spec(seed))[..count]);
}

/// Replaces the first occurrence of `pattern` in a file by as many other bytes.
pub fn patch(path: &Path, pattern: &[u8], with: &[u8]) {
    let mut bytes = std::fs::read(path).expect("the clip reads");
    let found = bytes
        .windows(pattern.len())
        .position(|window| window == pattern);
    let at = found.expect("the pattern is in the clip");
    bytes[at..at + with.len()].copy_from_slice(with);
    std::fs::write(path, bytes).expect("the clip is written");
}

/// A whole one-frame GIF whose canvas is `side` pixels square and whose only picture is one pixel.
pub fn huge_gif(side: u16) -> Vec<u8> {
    let mut bytes = b"GIF89a".to_vec();
    bytes.extend(side.to_le_bytes());
    bytes.extend(side.to_le_bytes());
    // Two global colours, background 0, square pixels.
    bytes.extend([0x80, 0, 0, 0, 0, 0, 255, 255, 255]);
    // Image descriptor: one pixel at the origin; then its LZW data and the trailer.
    bytes.extend([0x2c, 0, 0, 0, 0, 1, 0, 1, 0, 0, 2, 2, 0x44, 1, 0, 0x3b]);
    bytes
}
