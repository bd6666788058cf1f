//! Erosion of cell masks.

/// Keeps cells whose box of `radius` holds only set cells; outside the grid does not matter.
pub(super) fn erode(mask: &[bool], width: usize, radius: usize) -> Vec<bool> {
    if width == 0 {
        return Vec::new();
    }
    let mut along_rows = mask.to_vec();
    let rows = along_rows
        .chunks_exact_mut(width)
        .zip(mask.chunks_exact(width));
    for (out, row) in rows {
        for reach in 1..=radius.min(width - 1) {
            and(&mut out[reach..], &row[..width - reach]);
            and(&mut out[..width - reach], &row[reach..]);
        }
    }
    let mut eroded = along_rows.clone();
    let rows = mask.len() / width;
    for reach in 1..=radius.min(rows.saturating_sub(1)) {
        let cells = reach * width;
        and(&mut eroded[cells..], &along_rows);
        and(&mut eroded, &along_rows[cells..]);
    }
    eroded
}

/// `to[i] &= from[i]`, as far as both reach.
fn and(to: &mut [bool], from: &[bool]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to &= *from;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every cell of the box, one by one.
    fn twin(mask: &[bool], width: usize, radius: usize) -> Vec<bool> {
        let height = mask.len() / width;
        let near = |position: usize, length: usize| {
            position.saturating_sub(radius)..(position + radius + 1).min(length)
        };
        (0..mask.len())
            .map(|cell| {
                let (x, y) = (cell % width, cell / width);
                near(y, height).all(|row| near(x, width).all(|column| mask[row * width + column]))
            })
            .collect()
    }

    #[test]
    fn shifted_rows_equal_the_boxes() {
        for (width, height) in [(1, 1), (1, 7), (6, 1), (9, 8), (40, 17)] {
            // Mostly set, or nothing would be left.
            let mask: Vec<bool> = (0..width * height)
                .map(|i| (i * 7919 + i * i) % 23 != 0)
                .collect();
            for radius in 0..4 {
                assert_eq!(erode(&mask, width, radius), twin(&mask, width, radius));
            }
        }
        assert_eq!(erode(&[], 0, 1), Vec::<bool>::new());
    }
}
