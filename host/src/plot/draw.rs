//! Drawing figures with plotters' SVG backend, on a canvas of twice the size for finer positions.

use super::axis::{Axis, LABEL, Ruler, Scale};
use super::legend::{LEGEND, caption, caption_height, colour_bar, legend};
use super::raster::{Cells, Images};
use super::series::{Chart, circles, draw_series};
use super::{Plot, Shape, clock, dense, notes, table};
use anyhow::{Result, anyhow};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// plotters places everything on whole units; two to a point keep curves smooth.
pub(super) const FINE: i32 = 2;
/// Space for labels left of and below the data, for the margin elsewhere and for a colour bar, in points.
const LEFT_EDGE: i32 = 8;
const LEFT: i32 = 66;
pub(super) const BELOW: i32 = 48;
pub(super) const MARGIN: i32 = 14;
/// Right of an axis of UTC, whose last label is wide.
const RIGHT_OF_TIMES: i32 = 34;
pub(super) const BAR: i32 = 84;
/// Height of the title.
pub(super) const TITLE: i32 = 34;
/// Width from which on a map is in kilometres, m.
const LARGE_MAP_M: f64 = 10_000.0;
pub(super) const GREY: RGBColor = RGBColor(110, 110, 110);

/// Most bytes of a page; its images are made coarser until it holds.
const MOST_BYTES: usize = 490_000;
/// Coarsest images, as a share of their full fineness.
const COARSEST: f64 = 0.1;

pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// All figures on one page.
pub(super) fn page(figures: &[&Plot], columns: usize, cells: Cells) -> Result<String> {
    let mut fineness = 1.0;
    loop {
        let svg = page_of(figures, columns, Images::of(cells, fineness))?;
        // What is only on the way to pixels may be long.
        if svg.len() <= MOST_BYTES || cells == Cells::Rectangles || fineness <= COARSEST {
            return Ok(svg);
        }
        // Bytes go as the area, or a little slower.
        fineness = (fineness * 0.9 * (MOST_BYTES as f64 / svg.len() as f64).sqrt()).max(COARSEST);
    }
}

fn page_of(figures: &[&Plot], columns: usize, mut images: Images) -> Result<String> {
    let columns = columns.clamp(1, figures.len().max(1));
    let rows: Vec<&[&Plot]> = figures.chunks(columns).collect();
    let whole_height = |f: &Plot| f.size.1 as i32 + caption_height(f);
    let row_height = |row: &&[&Plot]| row.iter().map(|f| whole_height(f)).max().unwrap_or(0);
    let column_width: Vec<i32> = (0..columns)
        .map(|c| rows.iter().filter_map(|r| r.get(c)).map(|f| f.size.0 as i32).max().unwrap_or(0))
        .collect();
    let (width, height) = (column_width.iter().sum::<i32>(), rows.iter().map(row_height).sum::<i32>());
    // Figures below each other with one horizontal axis line up, also beside a bar of colours.
    let lines_up = |figure: &Plot, column: usize| {
        let others = rows.iter().filter_map(|row| row.get(column));
        let same = |other: &Plot| (&other.x_label, other.x_scale) == (&figure.x_label, figure.x_scale);
        !figure.equal && others.into_iter().any(|other| other.heat.is_some() && same(other))
    };
    let mut svg = String::new();
    {
        let canvas = ((width * FINE) as u32, (height * FINE) as u32);
        let root = SVGBackend::with_string(&mut svg, canvas).into_drawing_area();
        root.fill(&WHITE).map_err(failed)?;
        let mut y = 0;
        for row in &rows {
            let mut x = 0;
            for (column, (figure, w)) in row.iter().zip(&column_width).enumerate() {
                let corner = (x * FINE, y * FINE);
                let size = |height: i32| (figure.size.0 * FINE as u32, (height * FINE) as u32);
                let room = lines_up(figure, column);
                one(&root.clone().shrink(corner, size(figure.size.1 as i32)), figure, room, &mut images)?;
                caption(
                    &root.clone().shrink(corner, size(whole_height(figure))),
                    figure,
                    figure.size.1 as i32,
                )?;
                x += w;
            }
            y += row_height(row);
        }
        root.present().map_err(failed)?;
    }
    let svg = images.put_into(svg);
    let canvas = format!("width=\"{}\" height=\"{}\"", width * FINE, height * FINE);
    Ok(svg.replacen(&canvas, &format!("width=\"{width}\" height=\"{height}\""), 1))
}

pub(super) fn failed<E: std::fmt::Display>(e: E) -> anyhow::Error {
    anyhow!("cannot draw the figure: {e}")
}

pub(super) fn font(size: i32) -> TextStyle<'static> {
    TextStyle::from(("sans-serif", size * FINE).into_font())
}

/// Draws a figure without its caption; `bar_room`: leaves room for a bar of colours, though it may have none.
fn one(area: &Area<'_>, figure: &Plot, bar_room: bool, images: &mut Images) -> Result<()> {
    let (width, _) = area.dim_in_pixel();
    let width = width as i32 / FINE;
    let title = font(17).pos(Pos::new(HPos::Center, VPos::Center));
    area.draw(&Text::new(figure.title.clone(), (width * FINE / 2, TITLE * FINE / 2), title))
        .map_err(failed)?;
    for (k, line) in (0..).zip(&figure.words) {
        let at = ((LEFT_EDGE + LEFT / 2) * FINE, (TITLE + 12 + 26 * k) * FINE);
        area.draw(&Text::new(line.clone(), at, font(15))).map_err(failed)?;
    }
    if !figure.table.rows.is_empty() {
        return table::draw(area, &figure.table);
    }
    if !figure.words.is_empty() {
        return Ok(());
    }
    let legend_rows = legend(area, figure, width)?;
    let (_, body) = area.split_vertically((TITLE + legend_rows * LEGEND) * FINE);
    let (body, bar) = if bar_room || figure.heat.is_some() {
        let (body, bar) = body.split_horizontally((width - BAR) * FINE);
        (body, Some(bar))
    } else {
        (body, None)
    };
    let right = if figure.x_scale == Scale::Utc && bar.is_none() { RIGHT_OF_TIMES } else { MARGIN };
    let (w, h) = body.dim_in_pixel();
    let plot = (w as i32 / FINE - LEFT_EDGE - LEFT - right, h as i32 / FINE - BELOW - 8 - MARGIN);
    if plot.0 < 40 || plot.1 < 40 {
        return Err(anyhow!("the figure `{}` is too small to draw in", figure.title));
    }
    let (x, y) = axes(figure, f64::from(plot.0) / f64::from(plot.1));
    let ruler = |axis, length, across| Ruler { axis, length: f64::from(length), across };
    let mut chart: Chart<'_> = ChartBuilder::on(&body)
        .margin(MARGIN * FINE)
        .margin_left(LEFT_EDGE * FINE)
        .margin_right(right * FINE)
        .margin_bottom(8 * FINE)
        .x_label_area_size(BELOW * FINE)
        .y_label_area_size(LEFT * FINE)
        .build_cartesian_2d(ruler(x, plot.0, true), ruler(y, plot.1, false))
        .map_err(failed)?;
    let place = chart.plotting_area().get_pixel_range();
    if let Some(heat) = &figure.heat {
        images.place(area, heat, (x, y), place.clone())?;
    }
    chart
        .configure_mesh()
        .x_desc(named(&figure.x_label, x))
        .y_desc(named(&figure.y_label, y))
        .max_light_lines(0)
        .bold_line_style(RGBColor(0, 0, 0).mix(0.10).stroke_width(FINE as u32))
        .light_line_style(TRANSPARENT)
        .axis_style(GREY.stroke_width(FINE as u32))
        .label_style(font(LABEL))
        .axis_desc_style(font(14))
        .set_all_tick_mark_size(5 * FINE)
        .draw()
        .map_err(failed)?;
    let labels = match &figure.circles {
        Some(radii) => circles(&mut chart, radii, x, y)?,
        None => Vec::new(),
    };
    let dense = dense::is_dense(&figure.series);
    if dense {
        images.layer(area, &figure.series, (x, y), place)?;
    }
    let in_pixels = |shape: &Shape| dense && matches!(shape, Shape::Points(_) | Shape::Band(_));
    for series in figure.series.iter().filter(|s| !in_pixels(&s.shape)) {
        draw_series(&mut chart, series, figure.shown(series.look), (x, y), plot)?;
    }
    notes::draw(&mut chart, &figure.series, &labels, (x, y), plot)?;
    if let Some((bar, heat)) = bar.zip(figure.heat.as_ref()) {
        colour_bar(&bar, heat)?;
    }
    Ok(())
}

/// What an axis is called, in the unit that it shows, with its dates.
fn named(label: &str, axis: Axis) -> String {
    match axis.scale {
        Scale::Kilometres => label.replace("(m)", "(km)"),
        Scale::Utc => format!("{label} ({})", clock::dates((axis.from, axis.to))),
        _ => label.to_owned(),
    }
}

/// The axes that show everything, stretched to equal units where asked (`aspect`: width over height of the plot).
fn axes(figure: &Plot, aspect: f64) -> (Axis, Axis) {
    let points = || figure.series.iter().flat_map(|s| extent(&s.shape));
    let heat = figure.heat.iter();
    let xs = points().map(|p| p.0).chain(heat.clone().flat_map(|h| [h.x.0, h.x.1]));
    let ys = points().map(|p| p.1).chain(heat.flat_map(|h| [h.y.0, h.y.1]));
    let tight = figure.heat.is_some();
    let fixed = |range: Option<(f64, f64)>, scale| {
        range
            .filter(|(a, b)| {
                a.is_finite() && b.is_finite() && a != b && (scale != Scale::Log || (*a > 0.0 && *b > 0.0))
            })
            .map(|(from, to)| Axis { from, to, scale })
    };
    // The origin of a map is the station: it is always shown.
    let origin = figure.circles.iter().map(|_| 0.0);
    let mut x = fixed(figure.x_range, figure.x_scale).unwrap_or_else(|| {
        Axis::around(xs.chain(origin.clone()), figure.x_scale, tight || figure.x_scale == Scale::Utc)
    });
    let mut y = fixed(figure.y_range, figure.y_scale)
        .unwrap_or_else(|| Axis::around(ys.chain(origin), figure.y_scale, tight));
    if figure.equal {
        let (w, h) = (x.to - x.from, y.to - y.from);
        if w / h < aspect {
            let extra = (h * aspect - w) / 2.0;
            (x.from, x.to) = (x.from - extra, x.to + extra);
        } else {
            let extra = (w / aspect - h) / 2.0;
            (y.from, y.to) = (y.from - extra, y.to + extra);
        }
        if x.to - x.from > LARGE_MAP_M {
            (x.scale, y.scale) = (Scale::Kilometres, Scale::Kilometres);
        }
    }
    (x, y)
}

fn extent(shape: &Shape) -> Vec<(f64, f64)> {
    match shape {
        Shape::Line(p) | Shape::Dashed(p) | Shape::Points(p) | Shape::Outline(p) => p.clone(),
        Shape::Band(p) => p.iter().flat_map(|(x, a, b)| [(*x, *a), (*x, *b)]).collect(),
        Shape::Notes(notes) => notes.iter().map(|(at, _)| *at).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{ColourMap, HeatMap};
    use super::*;

    /// Where a text stands, across, each time that it is there.
    fn places<'a>(svg: &'a str, text: &str) -> Vec<&'a str> {
        let ends: Vec<usize> = svg.match_indices(&format!("\n{text}\n")).map(|(at, _)| at).collect();
        let rests =
            ends.into_iter().filter_map(|at| svg[..at].rfind("<text x=\"").map(|from| &svg[from + 9..]));
        rests.filter_map(|rest| rest.split('"').next()).collect()
    }

    #[test]
    fn panels_below_each_other_have_one_axis_also_beside_a_bar_of_colours() {
        let begins = 1_714_521_600.0;
        let panel = || {
            let mut figure = Plot::new("t", "time", "y");
            let line = [(begins, 0.0), (begins + 7200.0, 1.0)];
            figure.x_scale(Scale::Utc).x_range(begins, begins + 7200.0).line("l", &line);
            figure
        };
        let (mut above, below) = (panel(), panel());
        above.heat(HeatMap {
            x: (begins, begins + 7200.0),
            y: (0.0, 1.0),
            columns: 2,
            values: vec![0.0, 1.0],
            strength: Vec::new(),
            range: None,
            map: ColourMap::Amount,
            label: "c".into(),
        });
        let svg = page(&[&above, &below], 1, Cells::Image).unwrap();
        let found = places(&svg, "01:00");
        assert!(found.len() == 2 && found[0] == found[1], "{found:?}");
        // Beside what has another axis nothing is kept free.
        let mut other = panel();
        other.x_label = "frequency".into();
        let svg = page(&[&above, &other], 1, Cells::Image).unwrap();
        let found = places(&svg, "01:00");
        assert!(found.len() == 2 && found[0] != found[1], "{found:?}");
    }

    #[test]
    fn words_beside_a_point_at_the_top_edge_stand_within_the_picture() {
        let mut figure = Plot::new("t", "x", "y");
        figure.x_range(0.0, 1.0).y_range(0.0, 1.0).line("", &[(0.0, 0.0), (1.0, 1.0)]);
        figure.notes(vec![((0.5, 1.0), "200 m".into()), ((0.5, 0.5), "100 m".into())]);
        let svg = figure.svg().unwrap();
        let down = |text: &str| -> i32 {
            let at = svg.find(&format!("\n{text}\n")).unwrap();
            let tag = &svg[svg[..at].rfind("<text ").unwrap()..at];
            tag.split(" y=\"").nth(1).unwrap().split('"').next().unwrap().parse().unwrap()
        };
        assert!(
            down("200 m") > (TITLE + MARGIN) * FINE && down("100 m") > down("200 m"),
            "{}",
            down("200 m")
        );
    }

    #[test]
    fn a_caption_stands_below_its_figure() {
        let mut figure = Plot::new("t", "x", "y");
        figure.line("l", &[(0.0, 0.0), (1.0, 1.0)]);
        let without = figure.svg().unwrap();
        let words = "What is drawn here, in so many words that they need a second line below the figure, because one is not as \
                     wide as all of them together are.";
        let with = figure.caption(words).svg().unwrap();
        let height = |svg: &str| -> i32 {
            svg.split("height=\"").nth(1).unwrap().split('"').next().unwrap().parse().unwrap()
        };
        assert_eq!((height(&without), height(&with)), (500, 500 + 2 * 15 + 8));
        assert!(with.contains("What is drawn here,") && !without.contains("What is drawn"));
    }
}
