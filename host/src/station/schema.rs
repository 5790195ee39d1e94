//! The published schemas of station files, of lists of stations and of scenarios (JSON Schema 2020-12), made of the types that read them.
//!
//! Editors that know JSON Schema complete and check such files with them; `config check --explain` prints their words.

use super::tables::{File, NetworkFile};
use crate::ocean_bottom::scenario::ObsScenario;
use crate::world::scenario::Scene;
use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, SchemaGenerator};
use serde_json::{Map, Value, json};

fn generator() -> SchemaGenerator {
    let mut settings = SchemaSettings::draft2020_12();
    settings.inline_subschemas = true;
    settings.into_generator()
}

fn of<T: JsonSchema>(title: &str) -> Value {
    let mut schema = generator().into_root_schema_for::<T>().to_value();
    schema["title"] = title.into();
    schema
}

/// Of a station file.
pub fn station() -> Value {
    of::<File>("Station file of seabearing")
}

/// Of a list of stations.
pub fn network() -> Value {
    of::<NetworkFile>("List of stations of seabearing")
}

/// Of a scenario: one of two.
pub fn scenario() -> Value {
    let array = of::<Scene>("Scenario of an array");
    let obs = of::<ObsScenario>("Scenario of an ocean-bottom station");
    let mut schema = json!({ "$schema": array["$schema"], "title": "Scenario of seabearing",
        "description": "What `seabearing simulate` plays: `kind` says for which recorder. Paths are taken from the file's folder." });
    schema["oneOf"] = [array, obs]
        .map(|mut one| {
            one.as_object_mut().map(|o| o.remove("$schema"));
            one
        })
        .into();
    schema
}

/// Every key of a station file with its meaning and, where it has one, its default, in order.
pub fn keys() -> Vec<(String, String)> {
    let mut out = Vec::new();
    walk(&station(), "", &mut out);
    out
}

fn walk(schema: &Value, above: &str, out: &mut Vec<(String, String)>) {
    let empty = Map::new();
    for (key, property) in schema["properties"].as_object().unwrap_or(&empty) {
        let path = if above.is_empty() { key.clone() } else { format!("{above}.{key}") };
        let mut text = property["description"].as_str().unwrap_or_default().replace('\n', " ");
        if let Some(default) = property.get("default").filter(|d| !d.is_null() && !d.is_object()) {
            text.push_str(&format!(" Default {default}."));
        }
        out.push((path.clone(), text));
        // An optional table is one of two.
        let tables = property["anyOf"].as_array().into_iter().flatten().chain([property]);
        tables.for_each(|t| walk(t, &path, out));
    }
}
