//! Records of different kinds as one table.
//!
//! In: records. Out: a column for each key that occurs, in order of first appearance, with the type its values have in
//! common. A record without the key, or with `null`, leaves its cell empty. What is neither number, truth value nor text
//! is written as JSON.

use anyhow::Result;
use serde_json::Value;
use std::collections::HashMap;
use std::io::Write;

/// What all values of a column are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Only `null` so far.
    Unknown,
    Bool,
    Integer,
    Number,
    Text,
}

impl Kind {
    fn of(value: &Value) -> Self {
        match value {
            Value::Null => Self::Unknown,
            Value::Bool(_) => Self::Bool,
            Value::Number(n) if n.is_i64() => Self::Integer,
            Value::Number(_) => Self::Number,
            _ => Self::Text,
        }
    }

    /// What holds both.
    fn with(self, other: Self) -> Self {
        match (self, other) {
            (a, b) if a == b => a,
            (Self::Unknown, a) | (a, Self::Unknown) => a,
            (Self::Integer, Self::Number) | (Self::Number, Self::Integer) => Self::Number,
            _ => Self::Text,
        }
    }
}

/// A key that occurs in records, and the type of its values.
pub(super) struct Column<'a> {
    pub(super) key: &'a str,
    pub(super) kind: Kind,
}

/// The columns of a table with these records.
pub(super) fn columns(records: &[Value]) -> Vec<Column<'_>> {
    let mut columns: Vec<Column<'_>> = Vec::new();
    let mut places: HashMap<&str, usize> = HashMap::new();
    for (key, value) in records.iter().filter_map(Value::as_object).flatten() {
        let place = *places.entry(key).or_insert_with(|| {
            columns.push(Column { key, kind: Kind::Unknown });
            columns.len() - 1
        });
        let kind = &mut columns[place].kind;
        *kind = kind.with(Kind::of(value));
    }
    columns
}

/// A value as text; `None` for an empty cell.
pub(super) fn text(value: Option<&Value>) -> Option<String> {
    match value? {
        Value::Null => None,
        Value::String(text) => Some(text.clone()),
        other => Some(other.to_string()),
    }
}

/// Writes the table as CSV.
pub(super) fn csv(records: &[Value], out: &mut impl Write) -> Result<()> {
    let columns = columns(records);
    let mut writer = csv::Writer::from_writer(out);
    if !columns.is_empty() {
        writer.write_record(columns.iter().map(|c| c.key))?;
    }
    for record in records {
        writer.write_record(columns.iter().map(|c| text(record.get(c.key)).unwrap_or_default()))?;
    }
    Ok(writer.flush()?)
}
