//! A table of results: printed for people or as JSON Lines, and kept as CSV.

use super::Options;
use super::figure::short;
use crate::csv::CsvText;
use anyhow::Result;
use serde_json::{Map, Value, json};
use std::fmt::{Display, Write as _};

/// Rows of named numbers; a number that is not finite is blank (`null` in JSON).
#[derive(Debug, Clone)]
pub struct CsvReport {
    name: String,
    columns: Vec<String>,
    rows: Vec<Vec<f64>>,
}

impl CsvReport {
    /// An empty table; `name` is that of the CSV file and of the JSON records' `experiment`, `header` the columns' names
    /// with commas between.
    pub fn new(name: &str, header: &str) -> Self {
        let columns = header.split(',').map(str::to_owned).collect();
        Self { name: name.to_owned(), columns, rows: Vec::new() }
    }

    /// Adds a row, one number a column.
    pub fn row(&mut self, values: &[f64]) {
        self.rows.push(values.to_vec());
    }

    /// Prints the table and writes `NAME.csv` into the output folder.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(&self, options: &Options) -> Result<()> {
        if options.json {
            for row in &self.rows {
                println!("{}", self.record(row));
            }
        } else {
            print!("{}", self.text());
        }
        crate::atomic::write(&options.out.join(format!("{}.csv", self.name)), self.csv().as_bytes())
    }

    fn record(&self, row: &[f64]) -> Value {
        let mut map = Map::new();
        map.insert("type".into(), "row".into());
        map.insert("experiment".into(), self.name.as_str().into());
        for (column, x) in self.columns.iter().zip(row) {
            map.insert(column.clone(), json!(x));
        }
        Value::Object(map)
    }

    fn text(&self) -> String {
        let mut out = String::new();
        let width = |c: &String| c.chars().count().max(9);
        for c in &self.columns {
            let _ = write!(out, " {c:>w$}", w = width(c));
        }
        out.push('\n');
        for row in &self.rows {
            for (c, x) in self.columns.iter().zip(row) {
                let _ = write!(out, " {:>w$}", short(*x), w = width(c));
            }
            out.push('\n');
        }
        out
    }

    /// The table as CSV.
    pub fn csv(&self) -> String {
        let mut out = CsvText::new(&self.columns.join(","));
        for row in &self.rows {
            let blank: &dyn Display = &"";
            out.row(&row.iter().map(|x| if x.is_finite() { x } else { blank }).collect::<Vec<_>>());
        }
        out.finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blanks_stay_blank() {
        let mut r = CsvReport::new("x", "a,b");
        r.row(&[1.5, f64::INFINITY]);
        assert_eq!(r.csv(), "a,b\n1.5,\n");
        assert_eq!(r.record(&r.rows[0])["b"], Value::Null);
    }
}
