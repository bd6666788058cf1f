//! Points with the front among them.

use plumbline_worker::explain::scatter::{Palette, ScatterPanel, draw_panel};

use super::{Ink, drawn};

/// Size of a drawing, in units.
const SIZE: (u32, u32) = (620, 420);

/// The chart of a panel; `x_title` stands below.
pub(crate) fn fronts(panel: &ScatterPanel, x_title: &str) -> Option<String> {
    let palette = Palette {
        ink: Ink::Text.number(),
        quiet: Ink::Soft.number(),
        faint: Ink::Grid.number(),
        front: Ink::Series(0).number(),
    };
    let says = format!("{} over {x_title}", panel.title);
    drawn(SIZE, &says, |area| {
        draw_panel(area, panel, x_title, &palette)
    })
}
