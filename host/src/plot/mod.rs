//! Pictures: SVG figures of one style, with title, axes with units, and a legend outside the data.
//!
//! A [`Plot`] collects series and is written atomically; [`write_panels`] puts several on one page. What a figure
//! cannot show (NaN, values at or below zero on a logarithmic axis, points outside a given range) is left out, and a
//! line is interrupted there. A page is at most half a megabyte, however much is on it: layers of many points become pixels.
//!
//! ```
//! use seabearing_host::plot::{Plot, Scale};
//! # let folder = tempfile::tempdir()?;
//! # let path = folder.path().join("bearing.svg");
//! let mut figure = Plot::new("Bearing of a passing vessel", "time (s)", "azimuth (°)");
//! figure.y_scale(Scale::Degrees).band("95 % of the errors", &[(0.0, 10.0, 14.0), (60.0, 80.0, 84.0)]);
//! figure.truth("truth", &[(0.0, 12.0), (60.0, 82.0)]).points("measured", &[(0.0, 11.0), (60.0, 83.0)]);
//! figure.write(&path)?;
//! # Ok::<(), anyhow::Error>(())
//! ```

mod axis;
mod clock;
mod colour;
pub mod contour;
pub mod correlation;
mod dense;
pub(crate) mod directions;
mod draw;
pub mod format;
pub(crate) mod heard;
mod legend;
mod notes;
pub mod passage;
mod raster;
pub mod result;
mod series;
mod spectrogram;
mod table;
mod text;
pub mod times;
pub(crate) mod ways;

pub use axis::{Axis, Scale};
pub use colour::{ColourMap, Look, PALETTE, TRUTH};
pub use plotters::style::RGBColor;

use anyhow::Result;
use std::path::Path;

/// Values on a regular grid, drawn as coloured cells.
#[derive(Clone, Debug)]
pub struct HeatMap {
    /// Left edge of the first column and right edge of the last.
    pub x: (f64, f64),
    /// Lower edge of the first row and upper edge of the last.
    pub y: (f64, f64),
    /// Number of columns.
    pub columns: usize,
    /// Row after row from the lowest; what is not finite stays blank.
    pub values: Vec<f64>,
    /// How much of its colour each cell shows, 0 (the page's) to 1; empty: all of it.
    pub strength: Vec<f64>,
    /// Values at the two ends of the colours; `None`: least and greatest value.
    pub range: Option<(f64, f64)>,
    /// Which colours.
    pub map: ColourMap,
    /// What the colours mean, with its unit.
    pub label: String,
}

/// The looks of one series.
#[derive(Clone, Debug)]
enum Shape {
    Line(Vec<(f64, f64)>),
    Dashed(Vec<(f64, f64)>),
    Points(Vec<(f64, f64)>),
    Band(Vec<(f64, f64, f64)>),
    Outline(Vec<(f64, f64)>),
    Notes(Vec<((f64, f64), String)>),
}

#[derive(Clone, Debug)]
struct Series {
    name: String,
    look: Look,
    width: f64,
    shape: Shape,
}

/// One figure.
#[derive(Clone, Debug)]
pub struct Plot {
    title: String,
    x_label: String,
    y_label: String,
    size: (u32, u32),
    series: Vec<Series>,
    heat: Option<HeatMap>,
    x_range: Option<(f64, f64)>,
    y_range: Option<(f64, f64)>,
    x_scale: Scale,
    y_scale: Scale,
    equal: bool,
    circles: Option<Vec<f64>>,
    next: usize,
    words: Vec<String>,
    table: table::Table,
    caption: String,
}

impl Plot {
    /// An empty figure of 800 by 500 points. Labels carry the unit: `range (m)`.
    pub fn new(title: &str, x_label: &str, y_label: &str) -> Self {
        Self {
            title: title.to_owned(),
            x_label: x_label.to_owned(),
            y_label: y_label.to_owned(),
            size: (800, 500),
            series: Vec::new(),
            heat: None,
            x_range: None,
            y_range: None,
            x_scale: Scale::Linear,
            y_scale: Scale::Linear,
            equal: false,
            circles: None,
            next: 0,
            words: Vec::new(),
            table: table::Table::default(),
            caption: String::new(),
        }
    }

    /// A map in metres East and North of a station at the origin: equal aspect, and circles at round ranges.
    pub fn map(title: &str) -> Self {
        let mut figure = Self::new(title, "East (m)", "North (m)");
        figure.size = (800, 700);
        figure.equal = true;
        figure.circles = Some(Vec::new());
        figure
    }

    /// Equal lengths on both axes.
    pub fn equal(&mut self) -> &mut Self {
        self.equal = true;
        self
    }

    /// Width and height in points.
    pub fn size(&mut self, width: u32, height: u32) -> &mut Self {
        self.size = (width.max(200), height.max(150));
        self
    }

    /// Width in points.
    pub(crate) fn width(&self) -> u32 {
        self.size.0
    }

    /// Fixes the ends of the horizontal axis.
    pub fn x_range(&mut self, from: f64, to: f64) -> &mut Self {
        self.x_range = Some((from, to));
        self
    }

    /// Fixes the ends of the vertical axis.
    pub fn y_range(&mut self, from: f64, to: f64) -> &mut Self {
        self.y_range = Some((from, to));
        self
    }

    /// How the horizontal axis runs.
    pub fn x_scale(&mut self, scale: Scale) -> &mut Self {
        self.x_scale = scale;
        self
    }

    /// How the vertical axis runs.
    pub fn y_scale(&mut self, scale: Scale) -> &mut Self {
        self.y_scale = scale;
        self
    }

    /// Circles about the origin at these ranges instead of round ones.
    pub fn range_circles(&mut self, radii: &[f64]) -> &mut Self {
        self.circles = Some(radii.to_vec());
        self
    }

    /// A line through points (x, y).
    pub fn line(&mut self, name: &str, points: &[(f64, f64)]) -> &mut Self {
        self.add(name, 2.0, Shape::Line(points.to_vec()))
    }

    /// A dashed line: limits, models, what is not data.
    pub fn dashed(&mut self, name: &str, points: &[(f64, f64)]) -> &mut Self {
        self.add(name, 1.6, Shape::Dashed(points.to_vec()))
    }

    /// The truth: a thin dark line.
    pub fn truth(&mut self, name: &str, points: &[(f64, f64)]) -> &mut Self {
        self.push(name, TRUTH, 1.3, Shape::Line(points.to_vec()))
    }

    /// Separate points.
    pub fn points(&mut self, name: &str, points: &[(f64, f64)]) -> &mut Self {
        self.add(name, 2.2, Shape::Points(points.to_vec()))
    }

    /// A band between two curves: (x, lower, upper).
    pub fn band(&mut self, name: &str, points: &[(f64, f64, f64)]) -> &mut Self {
        self.add(name, 0.0, Shape::Band(points.to_vec()))
    }

    /// Lines of text in place of axes.
    pub fn words(&mut self, lines: Vec<String>) -> &mut Self {
        self.words = lines;
        self
    }

    /// A table in place of axes: rows of words, the first the header, and before each other row a mark of its look. The figure becomes as high
    /// as the table, and at least as wide.
    pub fn table(&mut self, rows: Vec<Vec<String>>, looks: Vec<Look>) -> &mut Self {
        self.size(table::width(&rows), table::height(rows.len()));
        self.table = table::Table { rows, looks };
        self
    }

    /// What is drawn, in plain words that stand below the figure: what, of which unit, what bands mean, where the data are from.
    pub fn caption(&mut self, words: &str) -> &mut Self {
        self.caption = words.to_owned();
        self
    }

    /// Words beside points. Those that would lie on others stand off, at the end of a thin line; where there is no room for that either they are left out.
    pub fn notes(&mut self, notes: Vec<((f64, f64), String)>) -> &mut Self {
        self.push("", TRUTH, 0.0, Shape::Notes(notes))
    }

    /// The ellipse that holds a two-dimensional Gaussian position with a probability: centre, variances of x and y and
    /// their covariance, probability (0.95). One that is not finite is not drawn.
    pub fn ellipse(
        &mut self,
        name: &str,
        centre: (f64, f64),
        variances: (f64, f64, f64),
        probability: f64,
    ) -> &mut Self {
        self.add(name, 1.6, Shape::Outline(ellipse_outline(centre, variances, probability)))
    }

    /// Gives the last series this colour, or the look of one of many, instead of the next of the palette; the palette does not move on.
    pub fn coloured(&mut self, look: impl Into<Look>) -> &mut Self {
        if let Some(last) = self.series.last_mut() {
            if PALETTE.get((self.next + PALETTE.len() - 1) % PALETTE.len()) == Some(&last.look.colour) {
                self.next += PALETTE.len() - 1;
            }
            last.look = look.into();
        }
        self
    }

    /// Gives the last series lines or points of another width or radius, points of the page.
    pub fn sized(&mut self, width: f64) -> &mut Self {
        if let Some(last) = self.series.last_mut() {
            last.width = width;
        }
        self
    }

    /// Gives the last series the colour of the one before: a band and the line within it.
    pub fn same_colour(&mut self) -> &mut Self {
        let before = self.series.len().checked_sub(2).and_then(|i| self.series.get(i)).map(|s| s.look.colour);
        match before {
            Some(colour) => self.coloured(colour),
            None => self,
        }
    }

    /// How a series with a look is drawn.
    fn shown(&self, look: Look) -> Look {
        if self.series.iter().all(|s| s.look.is_own()) { look } else { look.colour.into() }
    }

    /// The coloured cells under everything else.
    pub fn heat(&mut self, heat: HeatMap) -> &mut Self {
        self.heat = Some(heat);
        self
    }

    /// The figure as SVG text.
    ///
    /// # Errors
    /// The figure is too small to draw in.
    pub fn svg(&self) -> Result<String> {
        draw::page(&[self], 1, raster::Cells::Image)
    }

    /// Writes the figure, atomically.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        write_panels(path, &[self], 1)
    }

    fn add(&mut self, name: &str, width: f64, shape: Shape) -> &mut Self {
        let colour = PALETTE[self.next % PALETTE.len()];
        self.next += 1;
        self.push(name, colour, width, shape)
    }

    /// Adds a series; one without a name is not in the legend.
    fn push(&mut self, name: &str, look: impl Into<Look>, width: f64, shape: Shape) -> &mut Self {
        self.series.push(Series { name: name.to_owned(), look: look.into(), width, shape });
        self
    }
}

/// Writes several figures on one page, row after row, atomically.
///
/// # Errors
/// The file cannot be written.
pub fn write_panels(path: &Path, figures: &[&Plot], columns: usize) -> Result<()> {
    format::write(path, |cells| draw::page(figures, columns, cells))
}

/// A cyclic curve (degrees) cut where it jumps by more than half a turn, so that it is not drawn across the figure.
pub fn cut_at_wraps(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut out = Vec::with_capacity(points.len());
    let mut last: Option<f64> = None;
    for &(x, y) in points {
        if last.is_some_and(|l| (y - l).abs() > 180.0) {
            out.push((x, f64::NAN));
        }
        out.push((x, y));
        last = Some(y);
    }
    out
}

/// Outline of the ellipse of a Gaussian: `P(χ²₂ < k²) = 1 − exp(−k²/2)`.
pub fn ellipse_outline(
    centre: (f64, f64),
    (vx, vy, cxy): (f64, f64, f64),
    probability: f64,
) -> Vec<(f64, f64)> {
    let k = (-2.0 * (1.0 - probability.clamp(0.0, 0.999_999)).ln()).sqrt();
    // Lower Cholesky factor of the covariance turns the unit circle into the ellipse.
    let a = vx.max(0.0).sqrt();
    let b = if a > 0.0 { cxy / a } else { 0.0 };
    let c = (vy - b * b).max(0.0).sqrt();
    (0..=72)
        .map(|i| {
            let (s, o) = (f64::from(i) * std::f64::consts::TAU / 72.0).sin_cos();
            (centre.0 + k * a * o, centre.1 + k * (b * o + c * s))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ellipse_has_the_extent_of_its_marginals() {
        let points = ellipse_outline((10.0, 20.0), (9.0, 4.0, -3.0), 0.95);
        let k = 5.991_464_547f64.sqrt(); // 95 % point of chi-square with two degrees of freedom
        let x = points.iter().map(|p| p.0).fold(f64::MIN, f64::max);
        let y = points.iter().map(|p| p.1).fold(f64::MIN, f64::max);
        assert!((x - 10.0 - 3.0 * k).abs() < 0.02 && (y - 20.0 - 2.0 * k).abs() < 0.02, "{x} {y}");
    }

    #[test]
    fn a_figure_of_nonsense_is_still_a_figure() {
        let mut f = Plot::new("a < b & c", "x", "y");
        f.line("n", &[(f64::NAN, 1.0), (1.0, f64::INFINITY)]).points("p", &[]).band("b", &[]);
        f.ellipse("e", (0.0, 0.0), (f64::INFINITY, 1.0, 0.0), 0.95).y_scale(Scale::Log);
        let svg = f.svg().unwrap();
        assert!(svg.ends_with("</svg>\n") && !svg.contains("NaN") && svg.contains("a &lt; b &amp; c"));
    }

    #[test]
    fn wraps_are_cut() {
        let cut = cut_at_wraps(&[(0.0, 350.0), (1.0, 359.0), (2.0, 3.0)]);
        assert_eq!(cut.len(), 4);
        assert!(cut[2].1.is_nan());
    }
}
