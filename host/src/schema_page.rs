//! A schema as a page of the book: every record and field, or every table and key, with type, unit and sentence.

use serde_json::{Map, Value};
use std::fmt::Write as _;

/// What a schema says, without line breaks.
fn said(of: &Value) -> String {
    of["description"].as_str().unwrap_or_default().replace('\n', " ")
}

/// The page's title and first sentences.
fn opening(schema: &Value) -> String {
    let title = schema["title"].as_str().unwrap_or_default();
    format!("# {}\n\n{}\n", title.trim_end_matches(" of seabearing"), said(schema))
}

fn properties(of: &Value) -> impl Iterator<Item = (&String, &Value)> {
    of["properties"].as_object().into_iter().flat_map(Map::iter)
}

/// Types that a property allows, as JSON Schema names them.
fn allowed(property: &Value) -> Vec<&str> {
    match &property["type"] {
        Value::Array(types) => types.iter().filter_map(Value::as_str).collect(),
        one => one.as_str().into_iter().collect(),
    }
}

fn nullable(property: &Value) -> bool {
    allowed(property).contains(&"null")
}

/// A property's type in words, without whether it may be null.
fn kind(property: &Value) -> String {
    match allowed(property).first() {
        Some(&"integer") => "whole number".into(),
        Some(&"number") => "number".into(),
        Some(&"boolean") => "true or false".into(),
        Some(&"array") => {
            let items = &property["items"];
            // The noun comes first: lists of numbers.
            let of = kind(items);
            let (noun, rest) = of.split_once(" of ").unwrap_or((&of, ""));
            let rest = if rest.is_empty() { String::new() } else { format!(" of {rest}") };
            let nulls = if nullable(items) { " or nulls" } else { "" };
            format!("list of {noun}s{rest}{nulls}")
        }
        Some(&"object") => "object".into(),
        _ => "text".into(),
    }
}

/// A row for a field, and one for each field of the objects it lists.
fn field(page: &mut String, name: &str, property: &Value) {
    let null = if nullable(property) { " or null" } else { "" };
    let _ = writeln!(page, "| `{name}` | {}{null} | {} |", kind(property), said(property));
    for (below, property) in properties(&property["items"]) {
        field(page, &format!("{name}[].{below}"), property);
    }
}

/// The page of records, from [`crate::record::schema`]: a list of the records, fields of most of them, and those of each.
pub fn records(schema: &Value) -> String {
    const FIELDS: &str = "| field | type | meaning |\n|---|---|---|\n";
    let records: Vec<&Value> = schema["oneOf"].as_array().into_iter().flatten().collect();
    let with =
        |name: &str, of: &Value| records.iter().filter(|r| r["properties"].get(name) == Some(of)).count();
    let common = |name: &str, of: &Value| 2 * with(name, of) > records.len();
    let mut page = opening(schema);
    page += "\n| record | what it is |\n|---|---|\n";
    for record in &records {
        let title = record["title"].as_str().unwrap_or_default();
        let _ = writeln!(page, "| [`{title}`](#{title}) | {} |", said(record));
    }
    page +=
        "\n## Fields of most records\n\n`type` is the kind of record; the others where they are known.\n\n";
    page += FIELDS;
    let mut told = Vec::new();
    for (name, of) in records.iter().flat_map(|r| properties(r)).filter(|(name, of)| common(name, of)) {
        if !told.contains(&name) {
            told.push(name);
            field(&mut page, name, of);
        }
    }
    for record in &records {
        let own = |(name, of): &(&String, &Value)| *name != "type" && !common(name, of);
        let _ = write!(page, "\n## {}\n\n{}\n", record["title"].as_str().unwrap_or_default(), said(record));
        if properties(record).any(|p| own(&p)) {
            page = page + "\n" + FIELDS;
        }
        properties(record).filter(own).for_each(|(name, of)| field(&mut page, name, of));
    }
    page
}

/// The page of a file's keys, from [`crate::station::schema`], table by table.
pub fn keys(schema: &Value) -> String {
    let mut page = opening(schema);
    tables(schema, "", &mut page);
    page
}

/// The page of scenarios, from [`crate::station::schema::scenario`]: of each kind the keys of the file and then its tables.
pub fn scenarios(schema: &Value) -> String {
    let mut page = opening(schema);
    for kind in schema["oneOf"].as_array().into_iter().flatten() {
        let _ = write!(page, "\n# {}\n\n{}\n\n", kind["title"].as_str().unwrap_or_default(), said(kind));
        rows(kind, &mut page);
        tables(kind, "", &mut page);
    }
    page
}

/// The keys of a table that are no tables.
fn rows(body: &Value, page: &mut String) {
    let needed = |name: &str| body["required"].as_array().is_some_and(|all| all.iter().any(|n| n == name));
    let is_table = |key: &Value| {
        key["properties"].is_object()
            || key["items"]["properties"].is_object()
            || key["items"]["oneOf"].is_array()
    };
    if properties(body).all(|(_, key)| is_table(key)) {
        return;
    }
    *page += "| key | type | default | meaning |\n|---|---|---|---|\n";
    for (name, key) in properties(body).filter(|(_, key)| !is_table(key)) {
        let default = match &key["default"] {
            _ if needed(name) => "needed".to_owned(),
            Value::Null => String::new(),
            Value::Array(none) if none.is_empty() => String::new(),
            one => format!("`{one}`"),
        };
        let _ = writeln!(page, "| `{name}` | {} | {default} | {} |", kind(key), said(key));
    }
}

/// The tables of a table, each with its keys and then its own tables.
fn tables(of: &Value, above: &str, page: &mut String) {
    for (name, table) in properties(of) {
        let path = format!("{above}{name}");
        if let Some(kinds) = table["items"]["oneOf"].as_array() {
            let _ = write!(page, "\n## `[[{path}]]`\n\n{}\n", said(table));
            for one in kinds {
                let _ = write!(page, "\n`kind = {}`: {}\n\n", one["properties"]["kind"]["const"], said(one));
                rows(one, page);
            }
            continue;
        }
        let many = table["items"]["properties"].is_object();
        let body = if many { &table["items"] } else { table };
        if !body["properties"].is_object() {
            continue;
        }
        let heading = if many { format!("[[{path}]]") } else { format!("[{path}]") };
        let _ = write!(page, "\n## `{heading}`\n\n{}\n\n", said(table));
        rows(body, page);
        tables(body, &format!("{path}."), page);
    }
}
