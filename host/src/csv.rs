//! Small CSV files with a header: reading, where a bad row is named by its line, and writing.

use anyhow::{Context, Result, bail};
use std::fmt::{Display, Formatter};
use std::path::Path;

/// A parsed CSV file: named columns, one row a record, with the line each row came from.
#[derive(Debug, Clone)]
pub struct CsvTable {
    header: Vec<String>,
    rows: Vec<(usize, Vec<String>)>,
    name: String,
}

impl CsvTable {
    /// Reads a file. Blank lines and lines that start with `#` are skipped.
    ///
    /// # Errors
    /// The file cannot be read, or has no header.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        let text = String::from_utf8(bytes)
            .ok()
            .filter(|text| !text.contains('\0'))
            .with_context(|| format!("{}: not a text file (CSV expected)", path.display()))?;
        Self::parse(&text, &path.display().to_string())
    }

    /// Parses text; `name` stands in messages.
    ///
    /// # Errors
    /// There is no header.
    pub fn parse(text: &str, name: &str) -> Result<Self> {
        let mut reader = ::csv::ReaderBuilder::new()
            .comment(Some(b'#'))
            .flexible(true)
            .trim(::csv::Trim::All)
            .from_reader(text.as_bytes());
        let unreadable = || format!("{name}: not CSV");
        let cells = |r: &::csv::StringRecord| r.iter().map(str::to_owned).collect::<Vec<_>>();
        let header = cells(reader.headers().with_context(unreadable)?);
        if header.is_empty() {
            bail!("{name}: empty file, a CSV header was expected");
        }
        let mut rows = Vec::new();
        for record in reader.records() {
            let record = record.with_context(unreadable)?;
            // A line of blanks is none.
            if record.iter().any(|c| !c.is_empty()) {
                rows.push((record.position().map_or(0, |p| p.line() as usize), cells(&record)));
            }
        }
        Ok(Self { header, rows, name: name.to_owned() })
    }

    /// The file's name, as it stands in messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Whether a column is there.
    pub fn has(&self, column: &str) -> bool {
        self.header.iter().any(|h| h == column)
    }

    /// Index of a column that must be there.
    ///
    /// # Errors
    /// It is not.
    pub fn column(&self, column: &str) -> Result<usize> {
        self.header.iter().position(|h| h == column).with_context(|| {
            format!("{}: no column `{column}`; the header is `{}`", self.name, shown(&self.header.join(",")))
        })
    }

    /// Every row as the numbers of the named columns, in file order; bad rows (missing or non-finite numbers) come
    /// back as errors that name the line, so that the caller can keep the good ones.
    ///
    /// # Errors
    /// A column is missing from the header.
    pub fn numbers<const N: usize>(&self, columns: [&str; N]) -> Result<Vec<(usize, Result<[f64; N]>)>> {
        let mut index = [0usize; N];
        for (slot, column) in index.iter_mut().zip(columns) {
            *slot = self.column(column)?;
        }
        Ok(self
            .rows
            .iter()
            .map(|(line, cells)| {
                let mut out = [0.0; N];
                for ((slot, i), column) in out.iter_mut().zip(index).zip(columns) {
                    match number(cells.get(i).map(String::as_str), column) {
                        Ok(x) => *slot = x,
                        Err(e) => return (*line, Err(e.context(format!("{}, line {line}", self.name)))),
                    }
                }
                (*line, Ok(out))
            })
            .collect())
    }

    /// A cell as text (`None` where the row is too short).
    pub fn text(&self, row: usize, column: usize) -> Option<&str> {
        self.rows.get(row).and_then(|(_, c)| c.get(column)).map(String::as_str)
    }
}

/// Splits rows into good ones and complaints: each bad row is named on stderr and skipped.
///
/// # Errors
/// No row is good.
pub fn good_rows<T>(name: &str, rows: Vec<(usize, Result<T>)>) -> Result<Vec<T>> {
    let total = rows.len();
    let mut good = Vec::with_capacity(total);
    let mut bad = 0usize;
    for (_, row) in rows {
        match row {
            Ok(r) => good.push(r),
            Err(e) => {
                bad += 1;
                if bad <= 10 {
                    eprintln!("seabearing: skipped {e:#}");
                }
            }
        }
    }
    if bad > 10 {
        eprintln!("seabearing: skipped {} more bad rows of {name}", bad - 10);
    }
    if good.is_empty() {
        bail!("{name}: no usable row in {total}");
    }
    Ok(good)
}

fn number(cell: Option<&str>, column: &str) -> Result<f64> {
    let Some(cell) = cell else { bail!("no value for `{column}`") };
    let x: f64 =
        cell.parse().map_err(|_| anyhow::anyhow!("`{column}` is `{cell}`, a number was expected"))?;
    if !x.is_finite() {
        bail!("`{column}` is `{cell}`, a finite number was expected");
    }
    Ok(x)
}

/// CSV text row by row; cells that need quotes get them.
pub struct CsvText(::csv::Writer<Vec<u8>>);

impl CsvText {
    /// A text of its header, names with commas between, so far.
    pub fn new(header: &str) -> Self {
        let mut text = Self(::csv::WriterBuilder::new().flexible(true).from_writer(Vec::new()));
        text.record(header.split(','));
        text
    }

    /// Adds a row.
    pub fn row(&mut self, cells: &[&dyn Display]) {
        self.record(cells.iter().map(ToString::to_string));
    }

    fn record(&mut self, cells: impl IntoIterator<Item = impl AsRef<[u8]>>) {
        // Memory takes every byte, and rows of unequal length are allowed.
        let _ = self.0.write_record(cells);
    }

    /// The whole text.
    pub fn finish(self) -> String {
        String::from_utf8(self.0.into_inner().unwrap_or_default()).unwrap_or_default()
    }
}

/// A number with so many decimals.
pub struct Fixed(pub f64, pub usize);

impl Display for Fixed {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:.*}", self.1, self.0)
    }
}

/// As much of a header as a message shows.
pub fn shown(header: &str) -> String {
    const MOST: usize = 100;
    let cut = header.chars().count() > MOST;
    header.chars().take(MOST).chain("…".chars().filter(|_| cut)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_again_whatever_the_name() {
        let mut text = CsvText::new("vessel,t_s");
        text.row(&[&"Anna, of \"Bergen\"", &Fixed(1.0 / 3.0, 2)]);
        let text = text.finish();
        assert_eq!(text, "vessel,t_s\n\"Anna, of \"\"Bergen\"\"\",0.33\n");
        let table = CsvTable::parse(&text, "t.csv").unwrap();
        assert_eq!(table.text(0, 0), Some("Anna, of \"Bergen\""));
    }
}
