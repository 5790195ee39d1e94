//! Cells as images in a drawing: a tenth of the size of as many rectangles.
//!
//! plotters' SVG has no images. A rectangle of a colour that nothing else has keeps each one's place while the figure is
//! drawn; in the finished text it becomes the image, a PNG. Where the drawing is only the way to pixels or to a page (PNG, PDF) it
//! becomes rectangles, which need no decoder there.

use super::axis::{Axis, Scale};
use super::dense::Layer;
use super::draw::{Area, failed};
use super::{ColourMap, HeatMap, Series};
use anyhow::{Context, Result};
use base64::Engine;
use plotters::prelude::*;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::ops::Range;

/// Most cells drawn across and up; a larger grid is thinned.
const MOST_CELLS: usize = 400;

/// Steps of the colours.
pub(super) const COLOURS: f64 = 100.0;

/// Steps of their strength, and what shows where there is none: a light grey, apart from what is not there.
const STRENGTHS: f64 = 15.0;
const PAGE: f64 = 235.0;

/// Palette's entry of what is not there.
const NOTHING: u8 = 101;

/// What cells are drawn as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cells {
    Image,
    Rectangles,
}

/// The images of a page, in the order of their places.
pub(super) struct Images {
    cells: Cells,
    /// Pixels across and up, as a share of those that an image has where it may.
    pub(super) fineness: f64,
    made: Vec<String>,
}

impl Images {
    pub(super) fn of(cells: Cells, fineness: f64) -> Self {
        Self { cells, fineness, made: Vec::new() }
    }

    /// Keeps the place of a figure's cells on a page, `at` pixels from left to right and from top to bottom.
    pub(super) fn place(
        &mut self,
        area: &Area<'_>,
        heat: &HeatMap,
        (x, y): (Axis, Axis),
        at: (Range<i32>, Range<i32>),
    ) -> Result<()> {
        let most = (MOST_CELLS as f64 * self.fineness) as usize;
        let Some((pixels, across, up)) = pixels(heat, (x, y), most) else { return Ok(()) };
        let pixel = |range: &Range<i32>, share: f64| {
            f64::from(range.start) + share * f64::from(range.end - range.start)
        };
        let (left, right) = (pixel(&at.0, across.0), pixel(&at.0, across.1));
        let (bottom, top) = (pixel(&at.1, 1.0 - up.0), pixel(&at.1, 1.0 - up.1));
        let (left, right) = (left.min(right), left.max(right));
        let (top, bottom) = (top.min(bottom), top.max(bottom));
        let (width, height) = (right - left, bottom - top);
        let place = ((left, top), (width, height));
        let image = match self.cells {
            Cells::Rectangles => pixels.rectangles(place.0, place.1),
            Cells::Image => element(place, "pixelated", &pixels.png()?),
        };
        self.keep(area, image)
    }

    /// Keeps the place of a layer of points and bands over a figure's axes.
    pub(super) fn layer(
        &mut self,
        area: &Area<'_>,
        series: &[Series],
        axes: (Axis, Axis),
        at: (Range<i32>, Range<i32>),
    ) -> Result<()> {
        let (left, top) = (f64::from(at.0.start.min(at.0.end)), f64::from(at.1.start.min(at.1.end)));
        let (width, height) =
            (f64::from((at.0.end - at.0.start).abs()), f64::from((at.1.end - at.1.start).abs()));
        let pixels = |length: f64| (length * self.fineness).round().max(1.0) as usize;
        let scale = self.fineness * f64::from(super::draw::FINE);
        let layer = Layer::of(series, axes, (pixels(width), pixels(height)), scale);
        let place = ((left, top), (width, height));
        let image = match self.cells {
            Cells::Rectangles => runs(&layer, place),
            Cells::Image => element(place, "auto", &layer_png(&layer)?),
        };
        self.keep(area, image)
    }

    /// Draws the mark of an image. Where it is drawn does not matter, only after what.
    fn keep(&mut self, area: &Area<'_>, image: String) -> Result<()> {
        let colour = self.mark();
        self.made.push(image);
        area.draw(&Rectangle::new([(0, 0), (1, 1)], colour.filled())).map_err(failed)
    }

    /// The colour that stands for the next image.
    fn mark(&self) -> RGBColor {
        RGBColor(1, 2 + (self.made.len() / 256) as u8, (self.made.len() % 256) as u8)
    }

    /// The drawing with the images in their places.
    pub(super) fn put_into(self, svg: String) -> String {
        let mut out = svg;
        for (n, image) in self.made.iter().enumerate() {
            let mark = format!("fill=\"#01{:02X}{:02X}\"", 2 + n / 256, n % 256);
            let Some(at) = out.find(&mark) else { continue };
            let (Some(from), Some(length)) = (out[..at].rfind('<'), out[at..].find("/>")) else { continue };
            out.replace_range(from..at + length + 2, image);
        }
        out
    }
}

/// Corner and size of an image, pixels of the canvas.
type Place = ((f64, f64), (f64, f64));

fn element(((left, top), (width, height)): Place, rendering: &str, png: &[u8]) -> String {
    let data = base64::engine::general_purpose::STANDARD.encode(png);
    format!(
        "<image x=\"{left:.1}\" y=\"{top:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" \
         preserveAspectRatio=\"none\" style=\"image-rendering:{rendering}\" \
         href=\"data:image/png;base64,{data}\"/>"
    )
}

/// A layer as PNG, by its colours where they are few.
fn layer_png(layer: &Layer) -> Result<Vec<u8>> {
    let size = (layer.width, layer.height);
    let mut colours: BTreeMap<[u8; 4], u8> = BTreeMap::new();
    let mut indices = Vec::with_capacity(layer.pixels.len());
    for run in layer.pixels.chunk_by(|a, b| a == b) {
        let Some(pixel) = run.first() else { continue };
        let next = u8::try_from(colours.len());
        let index = colours.get(pixel).copied().or(next.ok());
        let Some(index) = index else {
            return png(size, png::ColorType::Rgba, layer.pixels.as_flattened(), None);
        };
        colours.entry(*pixel).or_insert(index);
        indices.resize(indices.len() + run.len(), index);
    }
    let mut palette = vec![[0; 4]; colours.len()];
    for (colour, index) in colours {
        palette[usize::from(index)] = colour;
    }
    png(size, png::ColorType::Indexed, &indices, Some(&palette))
}

/// A layer as one shape for each colour, of the rectangles of neighbours: shapes that are partly seen through cost, rectangles of one shape
/// show no seams.
fn runs(layer: &Layer, ((left, top), (width, height)): Place) -> String {
    let (w, h) = (width / layer.width as f64, height / layer.height as f64);
    let mut shapes: BTreeMap<[u8; 4], String> = BTreeMap::new();
    for (j, row) in layer.pixels.chunks(layer.width.max(1)).enumerate() {
        let mut i = 0;
        for run in row.chunk_by(|a, b| a == b) {
            if let [colour @ [_, _, _, 1..=255], ..] = run {
                let (x, y, along) = (left + i as f64 * w, top + j as f64 * h, run.len() as f64 * w);
                let _ = write!(
                    shapes.entry(*colour).or_default(),
                    "M{x:.1} {y:.1}h{along:.1}v{h:.1}h{:.1}z",
                    -along
                );
            }
            i += run.len();
        }
    }
    let shape = |([r, g, b, opacity], path): (&[u8; 4], &String)| {
        let opacity = f64::from(*opacity) / 255.0;
        format!("<path d=\"{path}\" fill=\"#{r:02x}{g:02x}{b:02x}\" fill-opacity=\"{opacity:.2}\"/>")
    };
    format!("<g>{}</g>", shapes.iter().map(shape).collect::<String>())
}

/// Shares of an axis between which something lies.
type Part = (f64, f64);

/// Cells to be drawn, row after row from the top.
struct Pixels {
    width: usize,
    height: usize,
    map: ColourMap,
    /// Whether some are weaker than others.
    faded: bool,
    /// Colour and strength in their steps; nothing where nothing is.
    values: Vec<Option<(u8, u8)>>,
}

impl Pixels {
    fn colour(&self, (colour, strength): (u8, u8)) -> [u8; 3] {
        let RGBColor(r, g, b) = self.map.colour(f64::from(colour) / COLOURS);
        let share = f64::from(strength) / STRENGTHS;
        [r, g, b].map(|c| (PAGE + share * (f64::from(c) - PAGE)).round() as u8)
    }

    fn png(&self) -> Result<Vec<u8>> {
        let size = (self.width, self.height);
        if self.faded {
            let bytes: Vec<u8> =
                self.values.iter().flat_map(|p| p.map_or([255; 3], |p| self.colour(p))).collect();
            return png(size, png::ColorType::Rgb, &bytes, None);
        }
        let bytes: Vec<u8> = self.values.iter().map(|p| p.map_or(NOTHING, |(colour, _)| colour)).collect();
        let colours = (0..=COLOURS as u8).map(|k| self.colour((k, STRENGTHS as u8)));
        let palette: Vec<[u8; 4]> =
            colours.map(|[r, g, b]| [r, g, b, 255]).chain([[255, 255, 255, 0]]).collect();
        png(size, png::ColorType::Indexed, &bytes, Some(&palette))
    }

    /// The same as rectangles, neighbours of one colour as one; each reaches a little under those drawn after it, or viewers show
    /// the seams.
    fn rectangles(&self, (left, top): (f64, f64), (width, height): (f64, f64)) -> String {
        let mut out = String::from("<g shape-rendering=\"crispEdges\">");
        let (w, h) = (width / self.width as f64, height / self.height as f64);
        for (j, row) in self.values.chunks(self.width).enumerate() {
            let mut i = 0;
            while let Some(value) = row.get(i) {
                let run = row.iter().skip(i).take_while(|v| *v == value).count();
                if let Some([r, g, b]) = value.map(|v| self.colour(v)) {
                    let more = |at_end: bool| if at_end { 0.0 } else { 0.6 };
                    let _ = write!(
                        out,
                        "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{:.1}\" fill=\"#{r:02x}{g:02x}{b:02x}\"/>",
                        left + i as f64 * w,
                        top + j as f64 * h,
                        run as f64 * w + more(i + run == self.width),
                        h + more(j + 1 == self.height),
                    );
                }
                i += run;
            }
        }
        out + "</g>"
    }
}

/// What of the cells lies on the axes, and the shares of the axes that it takes; `None` where nothing does.
fn pixels(heat: &HeatMap, (x, y): (Axis, Axis), most: usize) -> Option<(Pixels, Part, Part)> {
    let columns = heat.columns.max(1);
    let rows = heat.values.len() / columns;
    let (across, up) = part(x, heat.x).zip(part(y, heat.y))?;
    if rows == 0 {
        return None;
    }
    // As many pixels as there are cells to be seen.
    let seen = |axis: Axis, cells: (f64, f64), (from, to): Part, n: usize| {
        let all = axis.share(cells.1).zip(axis.share(cells.0)).map_or(1.0, |(b, a)| (b - a).abs());
        (((to - from).abs() / all * n as f64).ceil() as usize).clamp(1, most.max(1))
    };
    let (width, height) = (seen(x, heat.x, across, columns), seen(y, heat.y, up, rows));
    // The cell at a share of an axis; those of a logarithmic axis have one ratio.
    let cell = |axis: Axis, cells: (f64, f64), share: f64, n: usize| {
        let (a, b) = axis.share(cells.0).zip(axis.share(cells.1))?;
        let at = ((share - a) / (b - a) * n as f64).floor();
        (at >= 0.0 && at < n as f64).then_some(at as usize)
    };
    let middle = |(from, to): Part, k: usize, n: usize| from + (to - from) * (k as f64 + 0.5) / n as f64;
    let (from, to) = heat_range(heat);
    let colours = Axis { from, to, scale: heat.map.scale() };
    let mut values = Vec::with_capacity(width * height);
    for j in (0..height).rev() {
        for i in 0..width {
            let c = cell(x, heat.x, middle(across, i, width), columns);
            let r = cell(y, heat.y, middle(up, j, height), rows);
            let at = c.zip(r).map(|(c, r)| r * columns + c);
            let value = at.and_then(|at| heat.values.get(at)).copied().filter(|v| v.is_finite());
            let strength = at.and_then(|at| heat.strength.get(at)).copied().unwrap_or(1.0).clamp(0.0, 1.0);
            values.push(value.and_then(|v| colours.share(v)).map(|share| {
                let share = share.clamp(0.0, 1.0);
                ((share * COLOURS).round() as u8, (strength * STRENGTHS).round() as u8)
            }));
        }
    }
    let faded = !heat.strength.is_empty();
    Some((Pixels { width, height, map: heat.map, faded, values }, across, up))
}

/// Shares of an axis that a range takes, as far as it can be seen.
fn part(axis: Axis, range: (f64, f64)) -> Option<Part> {
    let (a, b) = axis.share(range.0).zip(axis.share(range.1))?;
    let (from, to) = (a.min(b).max(0.0), a.max(b).min(1.0));
    (to > from).then_some((from, to))
}

fn png(
    (width, height): (usize, usize),
    kind: png::ColorType,
    pixels: &[u8],
    palette: Option<&[[u8; 4]]>,
) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, width as u32, height as u32);
    encoder.set_color(kind);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Best);
    if let Some(palette) = palette {
        encoder.set_palette(palette.iter().flat_map(|c| [c[0], c[1], c[2]]).collect::<Vec<u8>>());
        encoder.set_trns(palette.iter().map(|c| c[3]).collect::<Vec<u8>>());
    }
    let mut writer = encoder.write_header().context("an image of cells")?;
    writer.write_image_data(pixels).context("an image of cells")?;
    writer.finish().context("an image of cells")?;
    Ok(out)
}

/// Values at the two ends of the colours.
pub(super) fn heat_range(heat: &HeatMap) -> (f64, f64) {
    let scale = heat.map.scale();
    let axis = Axis::around(heat.values.iter().copied(), scale, true);
    let shown = |a: f64| a.is_finite() && (scale != Scale::Log || a > 0.0);
    heat.range.filter(|(a, b)| shown(*a) && shown(*b) && a != b).unwrap_or((axis.from, axis.to))
}

#[cfg(test)]
mod tests {
    use super::super::Plot;
    use super::*;

    #[test]
    fn a_large_grid_is_an_image_of_bounded_size() {
        let mut seed = 1u32;
        let mut random = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(seed >> 8)
        };
        let heat = |values: Vec<f64>, strength| HeatMap {
            x: (0.0, 10.0),
            y: (0.0, 5.0),
            columns: 1000,
            values,
            strength,
            range: None,
            map: ColourMap::Amount,
            label: "x".into(),
        };
        let values: Vec<f64> = (0..800_000).map(|_| random()).collect();
        let mut figure = Plot::new("noise", "x", "y");
        let svg = figure.heat(heat(values.clone(), Vec::new())).svg().unwrap();
        assert_eq!((svg.matches("<image").count(), svg.matches("#0102").count()), (1, 0));
        assert!(svg.len() < 500_000, "{}", svg.len());
        let faded = figure.heat(heat(values.clone(), vec![0.0; values.len()])).svg().unwrap();
        assert!(faded.len() < svg.len() / 4, "all of one grey: {}", faded.len());
        let drawn = super::super::draw::page(&[&figure], 1, Cells::Rectangles).unwrap();
        assert!(!drawn.contains("<image") && drawn.contains("fill=\"#ebebeb\""));
        // By decades the middle of the colours is the geometric mean.
        let of = |map, value: f64| {
            let cells =
                HeatMap { map, range: Some((1.0, 100.0)), columns: 1, ..heat(vec![value], Vec::new()) };
            let mut figure = Plot::new("one", "x", "y");
            super::super::draw::page(&[figure.heat(cells)], 1, Cells::Rectangles).unwrap()
        };
        assert!(of(ColourMap::Decades, 0.0).matches("crispEdges\"></g>").count() == 1);
        let middle = ColourMap::Amount.colour(0.5);
        let fill = format!("fill=\"#{:02x}{:02x}{:02x}\"/></g>", middle.0, middle.1, middle.2);
        assert!(of(ColourMap::Decades, 10.0).contains(&fill) && !of(ColourMap::Amount, 10.0).contains(&fill));
        // Outside the axes nothing is drawn, half outside half of it.
        assert!(!figure.x_range(20.0, 30.0).svg().unwrap().contains("<image"));
    }
}
