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
    /// Reads a file. Blank lines and lines that start with `#`, after blanks or not, are skipped.
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
    /// There is no header, or a quote is open at the end of its line.
    pub fn parse(text: &str, name: &str) -> Result<Self> {
        let mut reader = ::csv::ReaderBuilder::new()
            .has_headers(false)
            .comment(Some(b'#'))
            .flexible(true)
            .trim(::csv::Trim::All)
            .from_reader(text.as_bytes());
        let mut header = None;
        let mut rows = Vec::new();
        let mut record = ::csv::StringRecord::new();
        while reader.read_record(&mut record).with_context(|| format!("{name}: not CSV"))? {
            // Where the record ends: a record's own position is that of the blank lines before it.
            let end = reader.position();
            let ended =
                end.byte().checked_sub(1).and_then(|b| text.as_bytes().get(b as usize)) == Some(&b'\n');
            let breaks: usize = record.iter().map(|cell| cell.matches('\n').count()).sum();
            let line = end.line() as usize - usize::from(ended) - breaks;
            let comment = record.get(0).is_some_and(|first| first.starts_with('#'));
            if comment || record.iter().all(str::is_empty) {
                continue;
            }
            if breaks > 0 {
                bail!(
                    "{name}, line {line}: a `\"` opens a text that does not end on its line; close or remove it"
                );
            }
            let cells = record.iter().map(str::to_owned).collect();
            match header {
                None => header = Some(cells),
                Some(_) => rows.push((line, cells)),
            }
        }
        let header = header.with_context(|| format!("{name}: empty file, a CSV header was expected"))?;
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

    /// The columns' names, in file order.
    pub fn header(&self) -> &[String] {
        &self.header
    }

    /// Every row's cells, in file order.
    pub fn rows(&self) -> impl Iterator<Item = &[String]> {
        self.rows.iter().map(|(_, cells)| cells.as_slice())
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
            let separated = match self.header.as_slice() {
                [one] if one.contains(';') => "; separate cells by commas, not by `;`",
                [one] if one.contains('\t') => "; separate cells by commas, not by tabs",
                _ => "",
            };
            let header = shown(&self.header.join(","));
            format!("{}: no column `{column}`; the header is `{header}`{separated}", self.name)
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
                    log::warn!("skipped {e:#}");
                }
            }
        }
    }
    if bad > 10 {
        log::warn!("skipped {} more bad rows of {name}", bad - 10);
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

    #[test]
    fn what_is_no_row_is_skipped_before_the_header_and_after_it() {
        let text = "  \n  # made by hand\nt_s,x\n # rows\n\n1,2\n# end\n\n3,4";
        for text in [text.to_owned(), text.replace('\n', "\r\n")] {
            let rows = CsvTable::parse(&text, "t.csv").unwrap().numbers(["t_s", "x"]).unwrap();
            let rows: Vec<_> = rows.into_iter().map(|(line, row)| (line, row.unwrap())).collect();
            assert_eq!(rows, [(6, [1.0, 2.0]), (9, [3.0, 4.0])]);
        }
    }

    #[test]
    fn an_open_quote_is_refused_by_its_line() {
        let refusal = CsvTable::parse("t_s,name\n1,\"a\n2,b\n3,c\n", "t.csv").unwrap_err();
        assert!(format!("{refusal}").starts_with("t.csv, line 2: a `\"` opens"), "{refusal}");
    }

    #[test]
    fn other_separators_are_named() {
        let of = |text| format!("{}", CsvTable::parse(text, "t.csv").unwrap().column("x").unwrap_err());
        assert!(of("t_s;x\n1;2\n").ends_with("by commas, not by `;`"));
        assert!(of("t_s\tx\n1\t2\n").ends_with("by commas, not by tabs"));
        assert!(of("t_s,y\n1,2\n").ends_with("the header is `t_s,y`"));
    }
}
