//! The published schema says what the records hold: it is that of the types, and records of the command agree with it.

use serde_json::Value;
use std::path::Path;
use std::process::Command;

const PUBLISHED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/records.schema.json");

fn output(folder: &Path, args: &[&str]) -> String {
    let out = Command::new(env!("CARGO_BIN_EXE_seabearing")).args(args).current_dir(folder).output().unwrap();
    assert!(out.status.success(), "{args:?}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8(out.stdout).unwrap()
}

/// Whether a value is of one of the types a property allows.
fn is_of(value: &Value, property: &Value) -> bool {
    let own = match value {
        Value::Null => "null",
        Value::Bool(_) => "boolean",
        Value::Number(n) if n.is_f64() => "number",
        Value::Number(_) => "integer",
        Value::String(_) => "string",
        Value::Array(_) => "array",
        Value::Object(_) => "object",
    };
    let agrees = |t: &Value| t == own || (t == "number" && own == "integer");
    match &property["type"] {
        Value::Array(types) => types.iter().any(agrees),
        Value::Null => &property["const"] == value,
        one => agrees(one),
    }
}

/// The record is of a kind of the schema, with all its fields, no other ones, and their types.
fn agrees(record: &Value, schema: &Value) {
    let kinds = schema["oneOf"].as_array().unwrap();
    let kind = kinds.iter().find(|k| k["title"] == record["type"]);
    let kind = kind.unwrap_or_else(|| panic!("no such kind: {record}"));
    for (key, value) in record.as_object().unwrap() {
        let property = &kind["properties"][key];
        assert!(property["description"].is_string(), "{key} of {record} is not described");
        assert!(is_of(value, property), "{key} of {record} is not {property}");
    }
    for key in kind["required"].as_array().unwrap() {
        assert!(record.get(key.as_str().unwrap()).is_some(), "{key} is missing in {record}");
    }
}

#[test]
fn the_published_schema_is_that_of_the_types() {
    let made = output(Path::new("."), &["schema"]);
    let published = std::fs::read_to_string(PUBLISHED).unwrap_or_default();
    assert!(
        made == published,
        "docs/records.schema.json is old: `seabearing schema > docs/records.schema.json`"
    );
    let schema: Value = serde_json::from_str(&made).unwrap();
    for kind in schema["oneOf"].as_array().unwrap() {
        assert!(kind["description"].is_string(), "{kind}");
        for (key, property) in kind["properties"].as_object().unwrap() {
            let sentence = property["description"].as_str().unwrap_or_default();
            assert!(sentence.ends_with('.'), "{key} of {} is not described", kind["title"]);
        }
    }
}

#[test]
fn what_process_and_base_print_agrees_with_it() {
    let scenarios = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenarios");
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let schema: Value = serde_json::from_str(&std::fs::read_to_string(PUBLISHED).unwrap()).unwrap();
    output(at, &["simulate", &format!("{scenarios}/short-pass.toml"), "--out", "pass"]);
    let station = [
        "process",
        "--station",
        "pass/station.toml",
        "pass",
        "--telemetry",
        "pass.telemetry",
        "--levels",
        "2",
    ];
    let heard = output(at, &station);
    assert!(heard.contains(r#"{"type":"level""#));
    let received = output(at, &["base", "--store", "store", "--json", "pass.telemetry"]);
    for text in [heard, received] {
        let records: Vec<Value> = text.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
        assert!(records.iter().any(|r| r["type"] == "bearing"), "{text}");
        records.iter().for_each(|record| agrees(record, &schema));
    }
}

/// Every property of a schema, with its path.
fn properties(schema: &Value, above: &str, out: &mut Vec<(String, Value)>) {
    for (key, property) in schema["properties"].as_object().into_iter().flatten() {
        let path = format!("{above}.{key}");
        out.push((path.clone(), property.clone()));
        properties(property, &path, out);
        for one in property["anyOf"].as_array().into_iter().flatten().chain([&property["items"]]) {
            properties(one, &path, out);
        }
    }
}

#[test]
fn the_schemas_of_files_are_those_of_the_types_and_explain_every_key() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    for (what, keys) in [("station", 60), ("network", 10), ("scenario", 60)] {
        let made = output(Path::new("."), &["schema", what]);
        let name = format!("{what}.schema.json");
        let published = std::fs::read_to_string(docs.join(&name)).unwrap_or_default();
        assert!(made == published, "docs/{name} is old: `seabearing schema {what} > docs/{name}`");
        let schema: Value = serde_json::from_str(&made).unwrap();
        let mut all = Vec::new();
        for one in schema["oneOf"].as_array().into_iter().flatten().chain([&schema]) {
            properties(one, "", &mut all);
        }
        assert!(all.len() >= keys, "{what}: {}", all.len());
        for (path, property) in all {
            assert!(property["description"].is_string(), "{what}: {path} is not described");
        }
    }
    let station = docs.join("../scenarios/tetrahedron.toml");
    let station = ["config", "check", station.to_str().unwrap(), "--explain"];
    let explained = output(Path::new("."), &station);
    for part in [
        "array.hydrophones_m ",
        "tracking.speed_from_shaft.blades ",
        "obs.components.pressure ",
        "Default 8388608",
    ] {
        assert!(explained.contains(part), "{part}: {explained}");
    }
}

/// What of a value a schema does not allow, if anything.
fn misfit(value: &Value, schema: &Value, path: &str) -> Option<String> {
    for several in ["oneOf", "anyOf"] {
        if let Some(kinds) = schema[several].as_array() {
            let misfits: Vec<String> = kinds.iter().map_while(|k| misfit(value, k, path)).collect();
            return (misfits.len() == kinds.len()).then(|| misfits.join("; or "));
        }
    }
    if schema.get("const").is_some_and(|c| c != value)
        || (schema.get("type").is_some() && !is_of(value, schema))
    {
        return Some(format!("{path}: {value} is not {}", schema.get("const").unwrap_or(&schema["type"])));
    }
    if let (Some(table), Some(keys)) = (value.as_object(), schema["properties"].as_object()) {
        let missing = schema["required"].as_array().into_iter().flatten();
        let missing = missing.filter_map(Value::as_str).find(|key| !table.contains_key(*key));
        return missing.map(|key| format!("{path}: {key} is missing")).or_else(|| {
            table.iter().find_map(|(key, value)| match keys.get(key) {
                Some(property) => misfit(value, property, &format!("{path}.{key}")),
                None => Some(format!("{path}: no key {key}")),
            })
        });
    }
    let items = value.as_array().filter(|_| schema["items"].is_object());
    items?.iter().enumerate().find_map(|(i, item)| misfit(item, &schema["items"], &format!("{path}[{i}]")))
}

/// What an editor checks: every file of `scenarios` is as its schema says, and a wrong one is not.
#[test]
fn the_files_of_scenarios_agree_with_their_schemas() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let schema =
        |what: &str| -> Value { serde_json::from_str(&output(Path::new("."), &["schema", what])).unwrap() };
    let (scenario, station, network) = (schema("scenario"), schema("station"), schema("network"));
    let mut seen = [0; 3];
    for file in std::fs::read_dir(here.join("../scenarios")).unwrap() {
        let path = file.unwrap().path();
        if path.extension().is_none_or(|e| e != "toml") {
            continue;
        }
        let text = std::fs::read_to_string(&path).unwrap();
        let value = serde_json::to_value(text.parse::<toml::Table>().unwrap()).unwrap();
        let (kind, schema) = match () {
            () if value["stations"].is_array() => (0, &network),
            () if value["station"].is_object() => (1, &station),
            () if value["kind"].is_string() => (2, &scenario),
            () => continue,
        };
        seen[kind] += 1;
        assert_eq!(misfit(&value, schema, ""), None, "{}", path.display());
        let mut wrong = value.clone();
        wrong["sation"] = 1.into();
        assert!(misfit(&wrong, schema, "").is_some(), "{}", path.display());
    }
    assert!(seen.iter().all(|n| *n > 0), "{seen:?}");
}

/// The book's pages of records and keys are those of the schemas.
#[test]
fn the_book_explains_every_record_and_every_key() {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs");
    for (what, name, lines) in [
        ("records", "records.md", 300),
        ("station", "station-file.md", 100),
        ("network", "network-file.md", 25),
        ("scenario", "scenario-file.md", 100),
    ] {
        let made = output(Path::new("."), &["schema", what, "--markdown"]);
        let book = std::fs::read_to_string(docs.join(name)).unwrap();
        assert!(made == book, "docs/{name} is old: `seabearing schema {what} --markdown > docs/{name}`");
        assert!(made.lines().count() > lines, "{name}");
    }
    // All of what the schemas say is there, whatever writes the pages.
    let page = std::fs::read_to_string(docs.join("records.md")).unwrap();
    let schema: Value = serde_json::from_str(&std::fs::read_to_string(PUBLISHED).unwrap()).unwrap();
    for kind in schema["oneOf"].as_array().unwrap() {
        let mut all = Vec::new();
        properties(kind, "", &mut all);
        for (path, of) in all.iter().filter(|(path, _)| path != ".type") {
            let said = of["description"].as_str().unwrap_or_default().replace('\n', " ");
            let key = format!("{}`", path.rsplit('.').next().unwrap());
            let row = |line: &str| {
                line.starts_with("| `") && line.contains(&key) && line.ends_with(&format!(" {said} |"))
            };
            assert!(page.lines().any(row), "docs/records.md does not explain {path} of {}", kind["title"]);
        }
    }
    for (what, name) in [("station", "station-file.md"), ("network", "network-file.md")] {
        let page = std::fs::read_to_string(docs.join(name)).unwrap();
        let schema = std::fs::read_to_string(docs.join(format!("{what}.schema.json"))).unwrap();
        let mut all = Vec::new();
        properties(&serde_json::from_str(&schema).unwrap(), "", &mut all);
        for (path, of) in all {
            let key = path.rsplit('.').next().unwrap();
            let said = of["description"].as_str().unwrap_or_default().replace('\n', " ");
            let row = |line: &str| {
                line.starts_with(&format!("| `{key}` | ")) && line.ends_with(&format!(" {said} |"))
            };
            let headings = [format!("## `[{}]`", &path[1..]), format!("## `[[{}]]`", &path[1..])];
            let headed = page.lines().any(|line| headings.iter().any(|h| h == line));
            assert!(headed || page.lines().any(row), "docs/{name} does not explain {path}");
        }
    }
}
