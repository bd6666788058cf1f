//! Numbered shards in one word, as WebDataset's users write them: `rollout-{000..127}.tar`.

use std::path::Path;

use super::CorpusError;

/// Most files that one pattern names.
const MAX_NAMES: usize = 1_000_000;

/// The sources that a pattern with ranges in braces stands for, in its order; of any other source itself. A file
/// of exactly this name is no pattern.
///
/// # Errors
/// [`CorpusError::Glob`] for more than [`MAX_NAMES`].
pub(super) fn expanded(source: &str) -> Result<Vec<String>, CorpusError> {
    if Path::new(source).symlink_metadata().is_ok() {
        return Ok(vec![source.to_owned()]);
    }
    let mut names = vec![String::new()];
    let mut rest = source;
    while let Some(open) = rest.find('{') {
        let (before, from_brace) = rest.split_at(open);
        let Some((range, after)) = from_brace[1..].split_once('}') else {
            break;
        };
        let values = match range_of(range) {
            Some(values) => values,
            // Braces of another kind are the glob's.
            None => vec![format!("{{{range}}}")],
        };
        if names.len().saturating_mul(values.len()) > MAX_NAMES {
            return Err(CorpusError::Glob {
                pattern: source.to_owned(),
                reason: format!("it names more than {MAX_NAMES} files"),
            });
        }
        let each = |name: &String| {
            let name = format!("{name}{before}");
            values
                .iter()
                .map(move |value| format!("{name}{value}"))
                .collect::<Vec<_>>()
        };
        names = names.iter().flat_map(each).collect();
        rest = after;
    }
    for name in &mut names {
        name.push_str(rest);
    }
    Ok(names)
}

/// The numbers of `000..127`, upward or downward, as wide as the wider end where one begins with 0.
fn range_of(text: &str) -> Option<Vec<String>> {
    let (first, last) = text.split_once("..")?;
    let number = |text: &str| -> Option<usize> {
        let is_number = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        is_number.then(|| text.parse().ok())?
    };
    let (from, to) = (number(first)?, number(last)?);
    if from.abs_diff(to) >= MAX_NAMES {
        // As many as are too many: the caller says so.
        return Some(vec![String::new(); MAX_NAMES + 1]);
    }
    let is_padded = |text: &str| text.len() > 1 && text.starts_with('0');
    let width = match is_padded(first) || is_padded(last) {
        true => first.len().max(last.len()),
        false => 0,
    };
    let mut values: Vec<String> = (from.min(to)..=from.max(to))
        .map(|value| format!("{value:0width$}"))
        .collect();
    if from > to {
        values.reverse();
    }
    Some(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_those_of_a_shell() {
        for (source, expected) in [
            (
                "a-{8..11}.tar",
                &["a-8.tar", "a-9.tar", "a-10.tar", "a-11.tar"][..],
            ),
            ("a-{098..100}.tar", &["a-098.tar", "a-099.tar", "a-100.tar"]),
            (
                "s3://b/{1..0}/{0..1}x",
                &["s3://b/1/0x", "s3://b/1/1x", "s3://b/0/0x", "s3://b/0/1x"],
            ),
            ("{a,b}/{0..0}", &["{a,b}/0"]),
            ("plain.tar", &["plain.tar"]),
            ("open{0..2", &["open{0..2"]),
            ("{x..y}", &["{x..y}"]),
            ("{-1..2}", &["{-1..2}"]),
        ] {
            assert_eq!(expanded(source).unwrap(), expected, "{source}");
        }
        for source in [
            "{0..999999999}",
            "{0..9999}{0..9999}",
            "{0..99999999999999999999999}x{0..9}",
        ] {
            let many = expanded(source);
            assert!(many.is_err() || many.unwrap().len() <= 10, "{source}");
        }
    }
}
