//! What a model's answer says: the one number, or that it cannot be read.

use serde_json::Value;

use super::labels::Verdict;

/// Reads an answer: a JSON object with `score` (also inside other text, the first there is), or the
/// bare number. Only 0, 0.5 and 1 are judgements.
pub(super) fn read(answer: &str) -> Verdict {
    match score(answer) {
        Some(label) if [0.0, 0.5, 1.0].contains(&label) => Verdict::Judged {
            label,
            answer: answer.to_owned(),
        },
        _ => Verdict::Unparsable(answer.to_owned()),
    }
}

fn score(answer: &str) -> Option<f64> {
    let number = |value: &Value| match value {
        Value::String(text) => text.trim().parse().ok(),
        other => other.as_f64(),
    };
    let object = answer.match_indices('{').find_map(|(start, _)| {
        let mut values = serde_json::Deserializer::from_str(&answer[start..]).into_iter::<Value>();
        let object = values.next()?.ok()?;
        object.get("score").and_then(number)
    });
    object.or_else(|| answer.trim().parse().ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_found_and_nothing_else_is_taken_for_one() {
        for (answer, expected) in [
            ("{\"score\": 1, \"reason\": \"done\"}", 1.0),
            (
                "Here:\n```json\n{\"reason\": \"{half}\", \"score\": \"0.5\"}\n```",
                0.5,
            ),
            ("{not json} {\"score\": 0}", 0.0),
            (" 0.5\n", 0.5),
        ] {
            match read(answer) {
                Verdict::Judged { label, .. } => assert_eq!(label, expected, "{answer}"),
                other => panic!("{answer}: {other:?}"),
            }
        }
        for answer in [
            "",
            "1 of 2",
            "{\"score\": 0.7}",
            "{\"score\": 2}",
            "{\"rating\": 1}",
            "NaN",
            "{",
        ] {
            assert!(matches!(read(answer), Verdict::Unparsable(_)), "{answer}");
        }
    }
}
