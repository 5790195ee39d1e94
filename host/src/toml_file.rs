//! TOML that a person wrote: read within a limit, and whatever is wrong said with file, line, column and key.

use anyhow::{Context, Result, anyhow, bail};
use serde::de::DeserializeOwned;
use std::path::Path;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// Longest text, bytes. A propagation table has some 300 KB; a parser takes many times its text in memory.
const LONGEST: u64 = 4 << 20;

/// The text of a TOML file and its name in messages.
#[derive(Clone, Debug)]
pub struct TomlFile {
    name: String,
    text: String,
}

impl TomlFile {
    /// Reads a file; `what` says in a message what it should have been, as `station file`.
    ///
    /// # Errors
    /// It cannot be read, is no text, or is longer than any such file.
    pub fn read(path: &Path, what: &str) -> Result<Self> {
        use std::io::Read;
        let name = path.display().to_string();
        let mut bytes = Vec::new();
        std::fs::File::open(path)
            .and_then(|file| file.take(LONGEST + 1).read_to_end(&mut bytes))
            .with_context(|| format!("cannot read {what} {name}"))?;
        if bytes.len() as u64 > LONGEST {
            bail!("{name}: longer than {} MiB, no {what} is: is it the right file?", LONGEST >> 20);
        }
        let text = String::from_utf8(bytes).map_err(|e| {
            let line = e.as_bytes()[..e.utf8_error().valid_up_to()].iter().filter(|b| **b == b'\n').count();
            anyhow!("{name}, line {}: not UTF-8 text; a {what} was expected", line + 1)
        })?;
        Ok(Self { name, text })
    }

    /// Text at hand, under a name for messages.
    pub fn of(text: &str, name: &str) -> Self {
        Self { name: name.to_owned(), text: text.to_owned() }
    }

    /// The name in messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The whole text.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// The values.
    ///
    /// # Errors
    /// One line: file, line, column, what is wrong, and the key it is wrong at.
    pub fn parse<T: DeserializeOwned>(&self) -> Result<T> {
        toml::from_str(&self.text).map_err(|e| self.explain(&e))
    }

    /// The tables and values with their places in the text.
    ///
    /// # Errors
    /// As [`TomlFile::parse`].
    pub fn table(&self) -> Result<Spanned<DeTable<'_>>> {
        DeTable::parse(&self.text).map_err(|e| self.explain(&e))
    }

    /// `FILE, line L, column C` of a key: `station.rate_hz`, or `vessels.1.depth_m` in a list of tables (from 0). Where
    /// the file leaves the key out, the table it belongs in; a key without its table is looked for in all of them.
    pub fn at(&self, key: &str) -> String {
        let place = self.table().ok().and_then(|table| {
            let path: Vec<&str> = key.split('.').collect();
            let direct = descend(table.get_ref(), &path);
            direct.or_else(|| anywhere(table.get_ref(), path.last().copied().unwrap_or(key)))
        });
        place.map_or_else(|| self.name.clone(), |at| self.place(at))
    }

    /// Whether the file says a key, `rate_hz` at its top or `array.hydrophones_m` in a table.
    pub fn has(&self, key: &str) -> bool {
        fn holds(table: &DeTable<'_>, key: &str) -> bool {
            let (first, rest) = key.split_once('.').map_or((key, None), |(first, rest)| (first, Some(rest)));
            let value = table.iter().find(|(k, _)| k.get_ref() == first).map(|(_, v)| v.get_ref());
            match (value, rest) {
                (Some(DeValue::Table(table)), Some(rest)) => holds(table, rest),
                (value, None) => value.is_some(),
                _ => false,
            }
        }
        self.table().is_ok_and(|t| holds(t.get_ref(), key))
    }

    /// The text with another value of a key in a table; as it is where the key is not there.
    pub fn text_with(&self, table: &str, key: &str, value: &str) -> String {
        let span = self.table().ok().and_then(|whole| {
            let (_, value) = whole.get_ref().iter().find(|(k, _)| k.get_ref() == table)?;
            let DeValue::Table(table) = value.get_ref() else { return None };
            table.iter().find(|(k, _)| k.get_ref() == key).map(|(_, v)| v.span())
        });
        let mut text = self.text.clone();
        if let Some(span) = span {
            text.replace_range(span, value);
        }
        text
    }

    /// An error about a key, in one line.
    pub fn wrong(&self, key: &str, what: impl std::fmt::Display) -> anyhow::Error {
        anyhow!("{}: {what}", self.at(key))
    }

    /// `FILE, line L, column C` of a byte of the text.
    fn place(&self, at: usize) -> String {
        let before = self.text.get(..at).unwrap_or(&self.text);
        let line = before.matches('\n').count() + 1;
        let column = before.rsplit('\n').next().unwrap_or("").chars().count() + 1;
        format!("{}, line {line}, column {column}", self.name)
    }

    fn explain(&self, e: &toml::de::Error) -> anyhow::Error {
        let what = e.message().trim().replace('\n', "; ");
        let Some(span) = e.span() else { return anyhow!("{}: {what}", self.name) };
        // Only a wrong value needs its key: a key that is unknown or twice there is named by the message.
        let key = DeTable::parse(&self.text).ok().and_then(|t| key_of(t.get_ref(), span.start, ""));
        match key {
            Some(key) => anyhow!("{}: `{key}`: {what}", self.place(span.start)),
            None => anyhow!("{}: {what}", self.place(span.start)),
        }
    }
}

/// Where the deepest part of a path that exists stands; `None` where not even its first part does.
fn descend(table: &DeTable<'_>, path: &[&str]) -> Option<usize> {
    let (first, rest) = path.split_first()?;
    let (key, value) = table.iter().find(|(k, _)| k.get_ref() == first)?;
    if rest.is_empty() {
        return Some(key.span().start);
    }
    let (mut value, mut rest, mut at) = (value, rest, key.span().start);
    while let (Some((index, after)), DeValue::Array(list)) = (rest.split_first(), value.get_ref()) {
        let Some(element) = index.parse::<usize>().ok().and_then(|i| list.get(i)) else { return Some(at) };
        (value, rest, at) = (element, after, element.span().start);
    }
    match value.get_ref() {
        DeValue::Table(t) => Some(descend(t, rest).unwrap_or(at)),
        _ => Some(at),
    }
}

/// The first place of a key of this name in any table.
fn anywhere(table: &DeTable<'_>, name: &str) -> Option<usize> {
    let own = table.iter().filter(|(k, _)| k.get_ref() == name).map(|(k, _)| k.span().start).min();
    own.into_iter().chain(table.iter().filter_map(|(_, v)| within(v.get_ref(), name))).min()
}

fn within(value: &DeValue<'_>, name: &str) -> Option<usize> {
    match value {
        DeValue::Table(t) => anywhere(t, name),
        DeValue::Array(list) => list.iter().filter_map(|v| within(v.get_ref(), name)).min(),
        _ => None,
    }
}

/// The key whose value, no table, holds a byte of the text.
fn key_of(table: &DeTable<'_>, at: usize, above: &str) -> Option<String> {
    table.iter().find_map(|(key, value)| {
        let path =
            if above.is_empty() { key.get_ref().to_string() } else { format!("{above}.{}", key.get_ref()) };
        holder(value, at, &path)
    })
}

fn holder(value: &Spanned<DeValue<'_>>, at: usize, path: &str) -> Option<String> {
    match value.get_ref() {
        DeValue::Table(t) => key_of(t, at, path),
        DeValue::Array(list) if list.iter().any(|v| v.get_ref().is_table()) => {
            list.iter().enumerate().find_map(|(i, v)| holder(v, at, &format!("{path}.{i}")))
        }
        _ => value.span().contains(&at).then(|| path.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code)]
    struct File {
        depth_m: f64,
        vessels: Vec<Vessel>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code)]
    struct Vessel {
        name: String,
        depth_m: Option<f64>,
    }

    const GOOD: &str =
        "depth_m = 1.0\n\n[[vessels]]\nname = \"a\"\n[[vessels]]\n  name = \"b\"\n  depth_m = 4.0\n";

    fn error(text: &str) -> String {
        TomlFile::of(text, "f.toml").parse::<File>().unwrap_err().to_string()
    }

    #[test]
    fn errors_name_line_column_and_key() {
        let unknown = error(&GOOD.replace("  depth_m", "  depht_m"));
        assert!(unknown.starts_with("f.toml, line 7, column 3: unknown field `depht_m`"), "{unknown}");
        let kind = error(&GOOD.replace("4.0", "\"deep\""));
        assert!(kind.starts_with("f.toml, line 7, column 13: `vessels.1.depth_m`: invalid type"), "{kind}");
        let syntax = error(&GOOD.replace("\"b\"", "b b"));
        assert!(syntax.starts_with("f.toml, line 6, column "), "{syntax}");
        let missing = error(&GOOD.replace("name = \"a\"\n", ""));
        assert!(missing.starts_with("f.toml, line 3, column 1: missing field `name`"), "{missing}");
    }

    #[test]
    fn a_key_is_found_by_its_path_and_not_by_its_first_mention() {
        let file = TomlFile::of(GOOD, "f.toml");
        assert_eq!(file.at("depth_m"), "f.toml, line 1, column 1");
        assert_eq!(file.at("vessels.1.depth_m"), "f.toml, line 7, column 3");
        // Left out: the table it belongs in. Without its table: wherever it stands.
        assert_eq!(file.at("vessels.0.depth_m"), "f.toml, line 3, column 1");
        assert_eq!(file.at("name"), "f.toml, line 4, column 1");
        assert_eq!(file.at("nothing"), "f.toml");
    }

    #[test]
    fn absurd_depth_and_size_are_refused_in_one_line() {
        let deep = error(&"[".repeat(LONGEST as usize));
        assert!(deep.starts_with("f.toml, line 1, ") && deep.lines().count() == 1, "{deep}");
        let nested = error(&format!("depth_m = {}", "[".repeat(100_000)));
        assert!(nested.starts_with("f.toml, line 1, ") && nested.lines().count() == 1, "{nested}");
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("big.toml");
        // Sparse: 200 MB on no disk.
        std::fs::File::create(&path).unwrap().set_len(200_000_000).unwrap();
        let big = TomlFile::read(&path, "station file").unwrap_err().to_string();
        assert!(big.contains("big.toml") && big.contains("longer than 4 MiB"), "{big}");
        std::fs::write(&path, b"depth_m = 1.0\n\xff").unwrap();
        let bytes = TomlFile::read(&path, "station file").unwrap_err().to_string();
        assert!(bytes.contains("big.toml, line 2: not UTF-8"), "{bytes}");
    }
}
