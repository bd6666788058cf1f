//! Numbers and names as the page shows them.
//!
//! Names come from file systems and lists, so they may be hostile: markup is escaped by maud, what
//! is invisible or turns the reading direction is spelled out here, and length is bounded.

use maud::{Markup, html};

/// What stands where a value is missing.
pub(crate) const MISSING: &str = "–";

/// A z-score or anomaly: signed, two decimals.
pub(crate) fn signed(value: Option<f64>) -> String {
    finite(value).map_or_else(
        || MISSING.to_owned(),
        |value| {
            if value.abs() >= 1e6 {
                return format!("{value:+.2e}");
            }
            let text = format!("{value:+.2}");
            match text.as_str() {
                "-0.00" => "+0.00".to_owned(),
                _ => text,
            }
        },
    )
}

/// A magnitude, about three significant digits.
pub(crate) fn magnitude(value: Option<f64>) -> String {
    finite(value).map_or_else(
        || MISSING.to_owned(),
        |value| match value.abs() {
            0.0 => "0".to_owned(),
            size if !(0.001..1e6).contains(&size) => format!("{value:.2e}"),
            size if size < 1.0 => {
                let decimals = (2.0 - libm::floor(libm::log10(size))) as usize;
                format!("{value:.decimals$}")
            }
            size if size < 100.0 => format!("{value:.2}"),
            _ => format!("{value:.0}"),
        },
    )
}

/// A weight or a correlation: `decimals` decimals.
pub(crate) fn fixed(value: Option<f64>, decimals: usize) -> String {
    finite(value).map_or_else(|| MISSING.to_owned(), |value| format!("{value:.decimals$}"))
}

/// A count that may be missing.
pub(crate) fn optional(value: Option<impl Into<u64>>) -> String {
    value.map_or_else(|| MISSING.to_owned(), |value| count(value.into()))
}

/// A count with thin thousands.
pub(crate) fn count(value: u64) -> String {
    let digits = value.to_string();
    let mut text = String::with_capacity(digits.len() + digits.len() / 3);
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// A length as a count.
pub(crate) fn length(value: usize) -> String {
    count(u64::try_from(value).unwrap_or(u64::MAX))
}

/// `1 video`, `2 videos`.
pub(crate) fn videos(value: u64) -> String {
    format!(
        "{} video{}",
        count(value),
        if value == 1 { "" } else { "s" }
    )
}

/// Seconds as a person says them.
pub(crate) fn seconds(value: f64) -> String {
    const MINUTE_S: f64 = 60.0;
    const HOUR_S: f64 = 3_600.0;
    if !value.is_finite() {
        MISSING.to_owned()
    } else if value < 10.0 {
        format!("{value:.2} s")
    } else if value < 2.0 * MINUTE_S {
        format!("{value:.0} s")
    } else if value < 2.0 * HOUR_S {
        format!("{:.1} min", value / MINUTE_S)
    } else {
        format!("{:.1} h", value / HOUR_S)
    }
}

fn finite(value: Option<f64>) -> Option<f64> {
    value.filter(|value| value.is_finite())
}

/// Longest name shown in full; a longer one keeps its two ends, where names differ.
const NAME_CHARS: usize = 96;
/// The same in the two lines of a card's heading.
const HEADING_CHARS: usize = 60;
/// Longest name in a tooltip.
const TOOLTIP_CHARS: usize = 400;

/// A name, isolated from the reading direction around it and read as a path, with its full form as
/// a tooltip where it was shortened.
pub(crate) fn name(name: &str) -> Markup {
    bounded(name, NAME_CHARS)
}

/// A name that fits a card's heading.
pub(crate) fn heading(name: &str) -> Markup {
    bounded(name, HEADING_CHARS)
}

fn bounded(name: &str, chars: usize) -> Markup {
    let full = visible(name);
    let short = shortened(&full, chars);
    let tooltip = (short != full).then(|| shortened(&full, TOOLTIP_CHARS));
    html! { bdi dir="ltr" title=[tooltip] { (short) } }
}

/// The name as plain text, shortened to `chars`.
pub(crate) fn plain_name(name: &str, chars: usize) -> String {
    shortened(&visible(name), chars)
}

/// The group's name, or what stands for none.
pub(crate) fn group(group: Option<&str>) -> Markup {
    match group {
        Some(group) => name(group),
        None => html! { span.quiet { "no group" } },
    }
}

/// Spells out characters that do not show or that turn the reading direction.
pub(crate) fn visible(text: &str) -> String {
    let mut shown = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '\n' => shown.push_str("\\n"),
            '\t' => shown.push_str("\\t"),
            '\r' => shown.push_str("\\r"),
            // Zero-width, line and paragraph separators, direction marks, overrides and isolates.
            '\u{200b}'..='\u{200f}'
            | '\u{2028}'..='\u{202e}'
            | '\u{2060}'..='\u{2069}'
            | '\u{061c}'
            | '\u{feff}' => shown.extend(character.escape_unicode()),
            control if control.is_control() => shown.extend(control.escape_unicode()),
            plain => shown.push(plain),
        }
    }
    shown
}

fn shortened(text: &str, chars: usize) -> String {
    let total = text.chars().count();
    if total <= chars {
        return text.to_owned();
    }
    let head = chars / 2;
    let tail = chars - head - 1;
    let start: String = text.chars().take(head).collect();
    let end: String = text.chars().skip(total - tail).collect();
    format!("{start}…{end}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short_and_never_nan() {
        assert_eq!(signed(Some(1.234)), "+1.23");
        assert_eq!(signed(Some(-0.001)), "+0.00");
        assert_eq!(signed(Some(f64::NAN)), MISSING);
        assert_eq!(signed(Some(1e300)), "+1.00e300");
        assert_eq!(magnitude(Some(0.01234)), "0.0123");
        assert_eq!(magnitude(Some(-0.5)), "-0.500");
        assert_eq!(magnitude(Some(0.001)), "0.00100");
        assert_eq!(magnitude(Some(12.345)), "12.35");
        assert_eq!(magnitude(Some(1234.5)), "1234");
        assert_eq!(magnitude(None), MISSING);
        assert_eq!(count(1_234_567), "1,234,567");
        assert_eq!(count(12), "12");
        assert_eq!(seconds(5_400.0), "90.0 min");
    }

    #[test]
    fn names_show_what_hides_and_keep_both_ends() {
        assert_eq!(
            visible("a\n\u{202e}gpj.exe\u{7}"),
            "a\\n\\u{202e}gpj.exe\\u{7}"
        );
        assert_eq!(visible("müll/日本.mp4"), "müll/日本.mp4");
        let long = format!("{}end.mp4", "é".repeat(300));
        let short = shortened(&long, 20);
        assert_eq!(short.chars().count(), 20);
        assert!(short.starts_with("éé") && short.ends_with("end.mp4"));
        assert_eq!(
            name("<b>\"x\"</b>").into_string(),
            "<bdi dir=\"ltr\">&lt;b&gt;&quot;x&quot;&lt;/b&gt;</bdi>"
        );
    }
}
