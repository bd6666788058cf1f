//! A profile's knobs by name, for people: as TOML, and as what differs between two.

use plumbline_worker::profile::Profile;
use serde_json::Value;

/// A knob that two profiles have set differently; `None` where one does not have it set.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// Its name, sections before dots.
    pub knob: String,
    /// In the first profile.
    pub first: Option<Value>,
    /// In the second.
    pub second: Option<Value>,
}

/// Every knob as a TOML file that [`load`](super::load) reads back as the same profile. A knob that is not
/// set is left out.
///
/// # Errors
/// When a number is not finite.
pub fn to_toml(profile: &Profile) -> Result<String, serde_json::Error> {
    let table = toml_value(values(profile)?);
    toml::to_string(&table).map_err(serde::ser::Error::custom)
}

/// The knobs set differently, in the order of their names.
///
/// # Errors
/// As [`to_toml`].
pub fn differences(
    first: &Profile,
    second: &Profile,
) -> Result<Vec<Difference>, serde_json::Error> {
    let mut differences = Vec::new();
    compare(
        "",
        Some(&values(first)?),
        Some(&values(second)?),
        &mut differences,
    );
    Ok(differences)
}

/// By way of the canonical text, which has the shortest form of every number.
fn values(profile: &Profile) -> Result<Value, serde_json::Error> {
    serde_json::from_slice(&profile.canonical()?)
}

fn compare(
    name: &str,
    first: Option<&Value>,
    second: Option<&Value>,
    differences: &mut Vec<Difference>,
) {
    let (a, b) = (
        first.and_then(Value::as_object),
        second.and_then(Value::as_object),
    );
    if a.is_none() && b.is_none() {
        if first != second {
            let set = |value: Option<&Value>| value.filter(|value| !value.is_null()).cloned();
            differences.push(Difference {
                knob: name.to_owned(),
                first: set(first),
                second: set(second),
            });
        }
        return;
    }
    let names = [a, b].into_iter().flatten().flat_map(serde_json::Map::keys);
    for key in names.collect::<std::collections::BTreeSet<_>>() {
        let of = |map: Option<&'_ serde_json::Map<String, Value>>| {
            map.and_then(|map| map.get(key)).cloned()
        };
        let name = match name {
            "" => key.clone(),
            name => format!("{name}.{key}"),
        };
        compare(&name, of(a).as_ref(), of(b).as_ref(), differences);
    }
}

/// TOML has no null.
fn toml_value(value: Value) -> Option<toml::Value> {
    Some(match value {
        Value::Null => return None,
        Value::Bool(yes) => toml::Value::Boolean(yes),
        Value::Number(number) => match number.as_i64() {
            Some(whole) => toml::Value::Integer(whole),
            None => toml::Value::Float(number.as_f64()?),
        },
        Value::String(text) => toml::Value::String(text),
        Value::Array(items) => {
            toml::Value::Array(items.into_iter().filter_map(toml_value).collect())
        }
        Value::Object(map) => {
            let set = map
                .into_iter()
                .filter_map(|(name, value)| Some((name, toml_value(value)?)));
            toml::Value::Table(set.collect())
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_vision::slam::intrinsics::Intrinsics;
    use plumbline_worker::profile::Rung;

    #[test]
    fn differences_are_told_by_knob_and_only_where_there_are_any() {
        let standard = Profile::new(Rung::Standard);
        assert_eq!(differences(&standard, &standard).unwrap(), []);
        let mut other = standard.clone();
        other.flow.finest_scale = 0;
        other.edge_spans = vec![1];
        other.intrinsics = Some(Intrinsics {
            fx: 1.5,
            fy: 2.0,
            cx: 3.0,
            cy: 4.0,
        });
        let differences = differences(&standard, &other).unwrap();
        let told: Vec<_> = differences
            .iter()
            .map(|d| {
                (
                    d.knob.as_str(),
                    d.first.clone().unwrap_or_default(),
                    d.second.clone().unwrap_or_default(),
                )
            })
            .collect();
        let json = |value| value;
        assert_eq!(
            told,
            [
                (
                    "edge_spans",
                    json(serde_json::json!([1, 2])),
                    json(serde_json::json!([1]))
                ),
                ("flow.finest_scale", json(1.into()), json(0.into())),
                ("intrinsics.cx", Value::Null, json(3.0.into())),
                ("intrinsics.cy", Value::Null, json(4.0.into())),
                ("intrinsics.fx", Value::Null, json(1.5.into())),
                ("intrinsics.fy", Value::Null, json(2.0.into())),
            ]
        );
    }

    #[test]
    fn numbers_are_printed_as_short_as_they_are() {
        let text = to_toml(&Profile::new(Rung::Standard)).unwrap();
        assert!(text.contains("tolerance_relative = 0.01\n"), "{text}");
    }
}
