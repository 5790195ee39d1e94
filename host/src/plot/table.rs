//! A table in place of axes: a header, rows in columns that are as wide as they need, a mark of colour before each row.

use super::draw::{Area, FINE, TITLE, failed, font};
use super::{Look, RGBColor, text};
use anyhow::Result;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Size of the words and height of a row, points.
const SIZE: i32 = 11;
const ROW: i32 = 18;
/// Left of the marks, width of a mark, and room between columns.
const LEFT: i32 = 20;
const MARK: i32 = 18;
const GAP: f64 = 14.0;
/// Colour of the header and of the line below it.
const HEADER: RGBColor = RGBColor(70, 70, 70);

/// A table of words.
#[derive(Clone, Debug, Default)]
pub(super) struct Table {
    /// The first is the header.
    pub(super) rows: Vec<Vec<String>>,
    /// Of each row after the header.
    pub(super) looks: Vec<Look>,
}

/// Height of a figure that holds a table of so many rows, the header among them, points.
pub(super) fn height(rows: usize) -> u32 {
    (TITLE + ROW * rows as i32 + 14) as u32
}

/// Width of each column.
fn widths(rows: &[Vec<String>]) -> Vec<f64> {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let of =
        |c: usize| rows.iter().filter_map(|r| r.get(c)).map(|s| text::width(s, SIZE)).fold(0.0, f64::max);
    (0..columns).map(of).collect()
}

/// Width that a table needs, points.
pub(super) fn width(rows: &[Vec<String>]) -> u32 {
    let widths = widths(rows);
    (widths.iter().map(|w| w + GAP).sum::<f64>().ceil() as i32 + 2 * LEFT + MARK) as u32
}

/// Draws it below the title.
pub(super) fn draw(area: &Area<'_>, table: &Table) -> Result<()> {
    let widths = widths(&table.rows);
    let from = f64::from(LEFT + MARK);
    for (k, row) in (0..).zip(&table.rows) {
        let y = (TITLE + ROW * k + ROW / 2) * FINE;
        let look = (k as usize).checked_sub(1).and_then(|k| table.looks.get(k));
        // The mark is half as long as a legend's: so are its dashes.
        for (from, to) in look.iter().flat_map(|look| look.dashes(2 * (MARK - 6))) {
            let ends = vec![(LEFT * FINE + from * FINE / 2, y), (LEFT * FINE + to * FINE / 2, y)];
            let stroke = look.map_or(HEADER, |look| look.colour).stroke_width((4 * FINE) as u32);
            area.draw(&PathElement::new(ends, stroke)).map_err(failed)?;
        }
        let mut x = from;
        for (cell, w) in row.iter().zip(&widths) {
            let style = font(SIZE).pos(Pos::new(HPos::Left, VPos::Center));
            let style = if k == 0 { style.color(&HEADER) } else { style };
            area.draw(&Text::new(cell.clone(), ((x * f64::from(FINE)) as i32, y), style)).map_err(failed)?;
            x += w + GAP;
        }
        if k == 0 {
            let y = (TITLE + ROW) * FINE;
            let ends = vec![(LEFT * FINE, y), ((x - GAP) as i32 * FINE, y)];
            area.draw(&PathElement::new(ends, HEADER.stroke_width(1))).map_err(failed)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::{Look, Plot};

    #[test]
    fn a_table_has_its_words_below_each_other_and_room_for_all_rows() {
        let row = |cells: [&str; 2]| cells.map(str::to_owned).to_vec();
        let rows = vec![row(["track", "range"]), row(["1", "12.3 km"]), row(["214", "–"])];
        let mut figure = Plot::new("Ships", "", "");
        figure.table(rows, vec![Look::of(0), Look::of(1)]);
        assert_eq!(figure.size, (200, 150));
        let svg = figure.svg().unwrap();
        let place = |word: &str| {
            let at = svg.find(&format!("\n{word}\n")).unwrap();
            let from = svg[..at].rfind("<text x=\"").unwrap() + 9;
            svg[from..].split('"').next().unwrap().to_owned()
        };
        assert_eq!(place("range"), place("12.3 km"));
        assert_ne!(place("range"), place("214"));
        assert!(svg.contains("#D55E00") && svg.contains("#0072B2"));
    }
}
