//! One column table drives every format: a column has a name, a type and a getter.
//!
//! A value that is missing is [`Cell::Null`] in every format; so is a float that is not finite,
//! since no output says NaN or infinity.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Map, Value};

/// The type of a column.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// UTF-8.
    Text,
    /// 32-bit count.
    UInt32,
    /// 64-bit count.
    UInt64,
    /// 64-bit signed; only carried columns.
    Int64,
    /// 64-bit float.
    Float64,
    /// True or false.
    Bool,
    /// A list of 32-bit counts.
    ListUInt32,
    /// A list of texts.
    ListText,
}

/// One value on its way out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cell<'r> {
    /// Missing.
    Null,
    /// A text.
    Text(&'r str),
    /// A count.
    Unsigned(u64),
    /// A finite float.
    Float(f64),
    /// True or false.
    Bool(bool),
    /// A list of counts.
    Counts(&'r [u32]),
    /// A list of texts.
    Texts(&'r [String]),
    /// A carried value, as it came.
    Carried(&'r Value),
}

impl<'r> From<&'r str> for Cell<'r> {
    fn from(text: &'r str) -> Self {
        Self::Text(text)
    }
}
impl<'r> From<&'r Vec<u32>> for Cell<'r> {
    fn from(counts: &'r Vec<u32>) -> Self {
        Self::Counts(counts)
    }
}
impl<'r> From<&'r Vec<String>> for Cell<'r> {
    fn from(texts: &'r Vec<String>) -> Self {
        Self::Texts(texts)
    }
}
impl From<u32> for Cell<'_> {
    fn from(count: u32) -> Self {
        Self::Unsigned(count.into())
    }
}
impl From<u64> for Cell<'_> {
    fn from(count: u64) -> Self {
        Self::Unsigned(count)
    }
}
impl From<f64> for Cell<'_> {
    fn from(value: f64) -> Self {
        if value.is_finite() {
            Self::Float(value)
        } else {
            Self::Null
        }
    }
}
impl From<bool> for Cell<'_> {
    fn from(value: bool) -> Self {
        Self::Bool(value)
    }
}
impl<'r, T: Into<Self>> From<Option<T>> for Cell<'r> {
    fn from(value: Option<T>) -> Self {
        value.map_or(Self::Null, Into::into)
    }
}

/// Reads a column's value from a record.
type Getter<R> = for<'r> fn(&'r R) -> Cell<'r>;
/// Finds a record's carried values.
pub type CarriedOf<R> = for<'r> fn(&'r R) -> &'r Map<String, Value>;

/// One column of a table over records `R`.
#[derive(Debug)]
pub struct Column<R> {
    /// The name in every format.
    pub name: String,
    /// The type in Parquet.
    pub kind: Kind,
    source: Source<R>,
}

#[derive(Debug)]
enum Source<R> {
    Field(Getter<R>),
    Carried { key: String, of: CarriedOf<R> },
}

impl<R> Column<R> {
    /// A column of ours.
    #[must_use]
    pub fn field(name: &str, kind: Kind, get: Getter<R>) -> Self {
        Self {
            name: name.to_owned(),
            kind,
            source: Source::Field(get),
        }
    }

    /// A column carried through from the input list.
    #[must_use]
    pub fn carried(column: &CarriedColumn, of: CarriedOf<R>) -> Self {
        Self {
            name: column.name.clone(),
            kind: column.kind,
            source: Source::Carried {
                key: column.key.clone(),
                of,
            },
        }
    }

    /// Whether it comes from the input list, not from us.
    #[must_use]
    pub fn is_carried(&self) -> bool {
        matches!(self.source, Source::Carried { .. })
    }

    /// The value of `record` in this column.
    #[must_use]
    pub fn cell<'r>(&'r self, record: &'r R) -> Cell<'r> {
        match &self.source {
            Source::Field(get) => get(record),
            Source::Carried { key, of } => match of(record).get(key) {
                None | Some(Value::Null) => Cell::Null,
                Some(value) => Cell::Carried(value),
            },
        }
    }
}

/// A column carried through from the input list.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CarriedColumn {
    /// Its name in the list.
    pub key: String,
    /// Its name in the table.
    pub name: String,
    /// A number or boolean type where every value is one; otherwise text.
    pub kind: Kind,
}

/// What a carried column whose name is one of ours is prefixed with.
const CARRIED_PREFIX: &str = "carried_";

/// The carried columns of a table, in the order in which their keys first appear. Names in
/// `reserved` are taken; a carried name that collides is prefixed until it is free.
pub fn carried_columns<'v>(
    rows: impl Iterator<Item = &'v Map<String, Value>>,
    reserved: &[String],
) -> Vec<CarriedColumn> {
    let mut places: BTreeMap<&str, usize> = BTreeMap::new();
    let mut columns: Vec<(&str, Seen)> = Vec::new();
    for (key, value) in rows.flatten() {
        let place = *places.entry(key).or_insert_with(|| {
            columns.push((key, Seen::default()));
            columns.len() - 1
        });
        if let Some((_, seen)) = columns.get_mut(place) {
            seen.note(value);
        }
    }
    // A prefixed name must not meet a carried column that bears that very name.
    let mut taken: BTreeSet<String> = reserved.iter().cloned().collect();
    taken.extend(columns.iter().map(|(key, _)| (*key).to_owned()));
    columns
        .into_iter()
        .map(|(key, seen)| {
            let mut name = key.to_owned();
            if reserved.contains(&name) {
                while taken.contains(&name) {
                    name.insert_str(0, CARRIED_PREFIX);
                }
                taken.insert(name.clone());
            }
            CarriedColumn {
                key: key.to_owned(),
                name,
                kind: seen.kind(),
            }
        })
        .collect()
}

/// Integers up to here are exact as 64-bit floats.
const EXACT_FLOAT_INTEGER: u64 = 1 << 53;

/// What values of a carried column have been met.
#[derive(Debug, Clone, Copy, Default)]
pub struct Seen {
    bools: bool,
    integers: bool,
    negative: bool,
    beyond_i64: bool,
    beyond_float: bool,
    floats: bool,
    others: bool,
}

impl Seen {
    /// Takes note of a value.
    pub fn note(&mut self, value: &Value) {
        match value {
            Value::Null => {}
            Value::Bool(_) => self.bools = true,
            Value::Number(number) => match (number.as_i64(), number.as_u64()) {
                (None, None) => self.floats = true,
                (signed, unsigned) => {
                    self.integers = true;
                    self.negative |= signed.is_some_and(|n| n < 0);
                    self.beyond_i64 |= signed.is_none();
                    let magnitude = signed.map(i64::unsigned_abs).or(unsigned);
                    self.beyond_float |= magnitude.is_some_and(|n| n > EXACT_FLOAT_INTEGER);
                }
            },
            Value::String(_) | Value::Array(_) | Value::Object(_) => self.others = true,
        }
    }

    /// What a typed column has seen.
    #[must_use]
    pub fn of_kind(kind: Kind) -> Self {
        let nothing = Self::default();
        match kind {
            Kind::Bool => Self {
                bools: true,
                ..nothing
            },
            Kind::Int64 | Kind::UInt32 => Self {
                integers: true,
                ..nothing
            },
            Kind::UInt64 => Self {
                integers: true,
                beyond_i64: true,
                ..nothing
            },
            Kind::Float64 => Self {
                floats: true,
                ..nothing
            },
            Kind::Text | Kind::ListUInt32 | Kind::ListText => Self {
                others: true,
                ..nothing
            },
        }
    }

    /// Adds what another part has seen.
    pub fn merge(&mut self, other: Self) {
        self.bools |= other.bools;
        self.integers |= other.integers;
        self.negative |= other.negative;
        self.beyond_i64 |= other.beyond_i64;
        self.beyond_float |= other.beyond_float;
        self.floats |= other.floats;
        self.others |= other.others;
    }

    /// The narrowest type that holds every value exactly.
    #[must_use]
    pub fn kind(self) -> Kind {
        match (self.others, self.bools, self.integers, self.floats) {
            (false, true, false, false) => Kind::Bool,
            (false, false, true, false) if !self.beyond_i64 => Kind::Int64,
            (false, false, true, false) if !self.negative => Kind::UInt64,
            (false, false, _, true) if !self.beyond_float => Kind::Float64,
            _ => Kind::Text,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn columns(rows: &[Value], reserved: &[&str]) -> Vec<(String, String, Kind)> {
        let maps: Vec<_> = rows.iter().map(|row| row.as_object().unwrap()).collect();
        let reserved: Vec<_> = reserved.iter().map(|name| (*name).to_owned()).collect();
        carried_columns(maps.into_iter(), &reserved)
            .into_iter()
            .map(|column| (column.key, column.name, column.kind))
            .collect()
    }

    #[test]
    fn keeps_source_order_and_finds_exact_kinds() {
        let rows = [
            json!({"z": "text", "a": 1, "b": true, "f": 1, "big": 5, "n": null}),
            json!({"a": -3, "b": null, "f": 0.5, "big": u64::MAX, "late": [1, 2]}),
        ];
        let expected = [
            ("z", Kind::Text),
            ("a", Kind::Int64),
            ("b", Kind::Bool),
            ("f", Kind::Float64),
            ("big", Kind::UInt64),
            ("n", Kind::Text),
            ("late", Kind::Text),
        ];
        let expected: Vec<_> = expected
            .map(|(name, kind)| (name.to_owned(), name.to_owned(), kind))
            .into();
        assert_eq!(columns(&rows, &[]), expected);
    }

    #[test]
    fn mixtures_that_no_number_type_holds_are_text() {
        for values in [
            [json!(-1), json!(u64::MAX)],
            [json!((1_u64 << 53) + 1), json!(0.5)],
            [json!(true), json!(1)],
            [json!(1), json!("1")],
        ] {
            let rows = values.map(|value| json!({ "x": value }));
            assert_eq!(columns(&rows, &[])[0].2, Kind::Text, "{rows:?}");
        }
    }

    #[test]
    fn colliding_names_are_prefixed_until_free() {
        let rows = [json!({"status": 1, "carried_status": 2, "mine": 3})];
        let names: Vec<_> = columns(&rows, &["status"])
            .into_iter()
            .map(|c| c.1)
            .collect();
        assert_eq!(names, ["carried_carried_status", "carried_status", "mine"]);
    }

    #[test]
    fn floats_that_are_not_finite_are_missing() {
        assert_eq!(Cell::from(f64::NAN), Cell::Null);
        assert_eq!(Cell::from(Some(f64::INFINITY)), Cell::Null);
        assert_eq!(Cell::from(-0.5), Cell::Float(-0.5));
    }
}
