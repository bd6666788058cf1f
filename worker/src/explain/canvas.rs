//! An RGB picture to draw on: other pictures, boxes, and text in the built-in font.

use std::sync::OnceLock;

use plotters::backend::BitMapBackend;
use plotters::drawing::IntoDrawingArea;
use plotters::element::Text;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use plotters::style::{FontStyle, IntoFont, RGBColor, register_font};
use plumbline_vision::image::{Rgb8, resize_rgb};

/// Behind everything.
pub(super) const BACKGROUND: [u8; 3] = [22, 22, 28];
/// Text.
pub(super) const LIGHT: [u8; 3] = [236, 236, 240];
/// Less important text and lines.
pub(super) const MUTED: [u8; 3] = [160, 160, 172];
/// Marks of a fault: not a colour of the heat maps, and told from them by people who see few colours by
/// its lightness and its dark rim.
pub(super) const MARK: [u8; 3] = [72, 224, 255];

/// The name under which the built-in font is known to the drawing library.
pub const FONT: &str = "sans-serif";
/// Height of text, px.
pub(super) const TEXT_PX: u32 = 17;
/// Height of small text, px.
pub(super) const SMALL_PX: u32 = 14;

/// Largest picture of a frame in a drawing, px: legible, and one screen wide with another beside it.
const MAX_FRAME_PX: (usize, usize) = (768, 432);

/// The drawing library failed.
#[derive(Debug, thiserror::Error)]
#[error("a picture cannot be drawn: {0}")]
pub struct DrawError(String);

impl DrawError {
    /// For the reason that the library gave.
    #[must_use]
    pub fn new(reason: impl std::fmt::Display) -> Self {
        Self(reason.to_string())
    }
}

/// Makes the built-in font known to the drawing library, once.
///
/// # Errors
/// [`DrawError`], when it does not load.
pub fn load_font() -> Result<(), DrawError> {
    static LOADED: OnceLock<bool> = OnceLock::new();
    let loaded = *LOADED
        .get_or_init(|| register_font(FONT, FontStyle::Normal, dejavu::sans::regular()).is_ok());
    if loaded {
        Ok(())
    } else {
        Err(DrawError::new("the built-in font does not load"))
    }
}

/// Where text stands about its point.
#[derive(Debug, Clone, Copy)]
pub(super) enum Anchor {
    Left,
    Centre,
    Right,
}

/// The picture.
pub(super) struct Canvas {
    pub(super) picture: Rgb8,
}

impl Canvas {
    /// A canvas of the background's colour; sizes are rounded up to even, as video needs them.
    pub(super) fn new(width: usize, height: usize) -> Self {
        let (width, height) = (width.next_multiple_of(2), height.next_multiple_of(2));
        Self {
            picture: Rgb8 {
                width,
                height,
                data: BACKGROUND.repeat(width * height),
            },
        }
    }

    /// Fills `[x0, y0, x1, y1]` (x1 and y1 exclusive), as far as it lies on the canvas.
    pub(super) fn fill(&mut self, [x0, y0, x1, y1]: [usize; 4], colour: [u8; 3]) {
        let (width, height) = (self.picture.width, self.picture.height);
        for y in y0..y1.min(height) {
            for x in x0..x1.min(width) {
                self.picture.data[(y * width + x) * 3..][..3].copy_from_slice(&colour);
            }
        }
    }

    /// A box of two pixels with a dark rim on both sides, seen on any picture.
    pub(super) fn outline(&mut self, [x0, y0, x1, y1]: [usize; 4]) {
        for (grow, thick, colour) in [(3, 4, BACKGROUND), (2, 2, MARK)] {
            let (x0, y0) = (x0.saturating_sub(grow), y0.saturating_sub(grow));
            let (x1, y1) = (x1 + grow, y1 + grow);
            self.fill([x0, y0, x1, y0 + thick], colour);
            self.fill([x0, y1 - thick, x1, y1], colour);
            self.fill([x0, y0, x0 + thick, y1], colour);
            self.fill([x1 - thick, y0, x1, y1], colour);
        }
    }

    /// Copies a picture to `(x, y)`; it must fit.
    pub(super) fn place(&mut self, picture: &Rgb8, (x, y): (usize, usize)) {
        let width = self.picture.width;
        for (row, line) in picture.data.chunks_exact(picture.width * 3).enumerate() {
            let start = ((y + row) * width + x) * 3;
            if let Some(target) = self.picture.data.get_mut(start..start + line.len()) {
                target.copy_from_slice(line);
            }
        }
    }

    /// Writes a line of text with its top at `(x, y)`.
    pub(super) fn text(
        &mut self,
        text: &str,
        (x, y): (usize, usize),
        anchor: Anchor,
        height_px: u32,
        colour: [u8; 3],
    ) -> Result<(), DrawError> {
        load_font()?;
        let size = (self.picture.width as u32, self.picture.height as u32);
        let area = BitMapBackend::with_buffer(&mut self.picture.data, size).into_drawing_area();
        let horizontal = match anchor {
            Anchor::Left => HPos::Left,
            Anchor::Centre => HPos::Center,
            Anchor::Right => HPos::Right,
        };
        let [r, g, b] = colour;
        let style = (FONT, height_px)
            .into_font()
            .color(&RGBColor(r, g, b))
            .pos(Pos::new(horizontal, VPos::Top));
        area.draw(&Text::new(text.to_owned(), (x as i32, y as i32), style))
            .and_then(|()| area.present())
            .map_err(DrawError::new)
    }
}

/// A frame in the size in which it is drawn.
pub(super) fn fitted(frame: &Rgb8) -> Rgb8 {
    let (max_width, max_height) = MAX_FRAME_PX;
    let (width, height) = (frame.width.max(1), frame.height.max(1));
    // The larger of the two ratios decides.
    let (w, h) = if width * max_height > height * max_width {
        (max_width, (height * max_width).div_ceil(width))
    } else {
        ((width * max_height).div_ceil(height), max_height)
    };
    resize_rgb(frame, w.max(1), h.max(1))
}
