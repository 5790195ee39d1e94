//! Drawing figures with plotters' SVG backend, on a canvas of twice the size for finer positions.

use super::axis::{Axis, Scale};
use super::raster::{COLOURS, Cells, Images, heat_range};
use super::{HeatMap, Plot, Shape};
use anyhow::{Result, anyhow};
use plotters::coord::Shift;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// plotters places everything on whole units; two to a point keep curves smooth.
const FINE: i32 = 2;
/// Space for labels left of and below the data, for the margin elsewhere and for a colour bar, in points.
const LEFT_EDGE: i32 = 8;
const LEFT: i32 = 66;
const BELOW: i32 = 48;
const MARGIN: i32 = 14;
const BAR: i32 = 84;
/// Height of the title and of one row of the legend.
const TITLE: i32 = 34;
const LEGEND: i32 = 20;
/// Width from which on a map is in kilometres, m.
const LARGE_MAP_M: f64 = 10_000.0;
const GREY: RGBColor = RGBColor(110, 110, 110);

type Point = (f64, f64);
pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<Axis, Axis>>;

/// All figures on one page.
pub(super) fn page(figures: &[&Plot], columns: usize, cells: Cells) -> Result<String> {
    let columns = columns.clamp(1, figures.len().max(1));
    let rows: Vec<&[&Plot]> = figures.chunks(columns).collect();
    let row_height = |row: &&[&Plot]| row.iter().map(|f| f.size.1 as i32).max().unwrap_or(0);
    let column_width: Vec<i32> = (0..columns)
        .map(|c| rows.iter().filter_map(|r| r.get(c)).map(|f| f.size.0 as i32).max().unwrap_or(0))
        .collect();
    let (width, height) = (column_width.iter().sum::<i32>(), rows.iter().map(row_height).sum::<i32>());
    let (mut svg, mut images) = (String::new(), Images::of(cells));
    {
        let canvas = ((width * FINE) as u32, (height * FINE) as u32);
        let root = SVGBackend::with_string(&mut svg, canvas).into_drawing_area();
        root.fill(&WHITE).map_err(failed)?;
        let mut y = 0;
        for row in &rows {
            let mut x = 0;
            for (figure, w) in row.iter().zip(&column_width) {
                let corner = (x * FINE, y * FINE);
                let size = (figure.size.0 * FINE as u32, figure.size.1 * FINE as u32);
                one(&root.clone().shrink(corner, size), figure, &mut images)?;
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

fn font(size: i32) -> TextStyle<'static> {
    TextStyle::from(("sans-serif", size * FINE).into_font())
}

/// Width of a text in points: digits and letters of a sans-serif face are half as wide as high, on average.
fn text_width(text: &str, size: i32) -> i32 {
    (text.chars().count() as f64 * f64::from(size) * 0.5).ceil() as i32
}

fn one(area: &Area<'_>, figure: &Plot, images: &mut Images) -> Result<()> {
    let (width, _) = area.dim_in_pixel();
    let width = width as i32 / FINE;
    let title = font(17).pos(Pos::new(HPos::Center, VPos::Center));
    area.draw(&Text::new(figure.title.clone(), (width * FINE / 2, TITLE * FINE / 2), title))
        .map_err(failed)?;
    for (k, line) in (0..).zip(&figure.words) {
        let at = ((LEFT_EDGE + LEFT / 2) * FINE, (TITLE + 12 + 26 * k) * FINE);
        area.draw(&Text::new(line.clone(), at, font(15))).map_err(failed)?;
    }
    if !figure.words.is_empty() {
        return Ok(());
    }
    let legend_rows = legend(area, figure, width)?;
    let (_, body) = area.split_vertically((TITLE + legend_rows * LEGEND) * FINE);
    let (body, bar) = match &figure.heat {
        Some(heat) => {
            let (body, bar) = body.split_horizontally((width - BAR) * FINE);
            (body, Some((bar, heat)))
        }
        None => (body, None),
    };
    let (w, h) = body.dim_in_pixel();
    let plot = (w as i32 / FINE - LEFT_EDGE - LEFT - MARGIN, h as i32 / FINE - BELOW - 8 - MARGIN);
    if plot.0 < 40 || plot.1 < 40 {
        return Err(anyhow!("the figure `{}` is too small to draw in", figure.title));
    }
    let (x, y) = axes(figure, f64::from(plot.0) / f64::from(plot.1));
    let mut chart = ChartBuilder::on(&body)
        .margin(MARGIN * FINE)
        .margin_left(LEFT_EDGE * FINE)
        .margin_bottom(8 * FINE)
        .x_label_area_size(BELOW * FINE)
        .y_label_area_size(LEFT * FINE)
        .build_cartesian_2d(x, y)
        .map_err(failed)?;
    if let Some(heat) = &figure.heat {
        let (left_right, top_bottom) = chart.plotting_area().get_pixel_range();
        images.place(area, heat, (x, y), (left_right, top_bottom))?;
    }
    chart
        .configure_mesh()
        .x_desc(unit(&figure.x_label, x))
        .y_desc(unit(&figure.y_label, y))
        .x_labels((plot.0 / 62).clamp(2, 14) as usize)
        .y_labels((plot.1 / 30).clamp(2, 12) as usize)
        .max_light_lines(0)
        .bold_line_style(RGBColor(0, 0, 0).mix(0.10).stroke_width(FINE as u32))
        .light_line_style(TRANSPARENT)
        .axis_style(GREY.stroke_width(FINE as u32))
        .label_style(font(13))
        .axis_desc_style(font(14))
        .set_all_tick_mark_size(5 * FINE)
        .draw()
        .map_err(failed)?;
    if let Some(radii) = &figure.circles {
        circles(&mut chart, radii, x, y)?;
    }
    for series in &figure.series {
        draw_series(&mut chart, series, x, y)?;
    }
    if let Some((bar, heat)) = bar {
        colour_bar(&bar, heat)?;
    }
    Ok(())
}

/// What an axis is called, in the unit that it shows.
fn unit(label: &str, axis: Axis) -> String {
    if axis.scale == Scale::Kilometres { label.replace("(m)", "(km)") } else { label.to_owned() }
}

/// Draws the legend in rows under the title; how many.
fn legend(area: &Area<'_>, figure: &Plot, width: i32) -> Result<i32> {
    let mut rows: Vec<Vec<(usize, i32)>> = Vec::new();
    let mut used = width;
    for (i, series) in figure.series.iter().enumerate().filter(|(_, s)| !s.name.is_empty()) {
        let item = 34 + text_width(&series.name, 13) + 18;
        if used + item > width - 2 * MARGIN {
            rows.push(Vec::new());
            used = 0;
        }
        used += item;
        if let Some(row) = rows.last_mut() {
            row.push((i, item));
        }
    }
    for (r, row) in rows.iter().enumerate() {
        let total: i32 = row.iter().map(|(_, w)| w).sum();
        let mut x = ((width - total) / 2).max(MARGIN);
        let y = (TITLE + r as i32 * LEGEND + LEGEND / 2 - 2) * FINE;
        for (i, item) in row {
            let series = &figure.series[*i];
            let (x0, x1) = (x * FINE, (x + 26) * FINE);
            let stroke = series.colour.stroke_width((series.width * f64::from(FINE)) as u32);
            match series.shape {
                Shape::Line(_) | Shape::Outline(_) => {
                    area.draw(&PathElement::new(vec![(x0, y), (x1, y)], stroke)).map_err(failed)?;
                }
                Shape::Dashed(_) => {
                    for k in [0, 10, 20] {
                        let ends = vec![(x0 + k * FINE, y), (x0 + (k + 6) * FINE, y)];
                        area.draw(&PathElement::new(ends, stroke)).map_err(failed)?;
                    }
                }
                Shape::Points(_) => {
                    let r = (series.width * 1.4 * f64::from(FINE)) as i32;
                    area.draw(&Circle::new(((x0 + x1) / 2, y), r, series.colour.filled())).map_err(failed)?;
                }
                Shape::Notes(_) => {}
                Shape::Band(_) => {
                    let corners = [(x0, y - 5 * FINE), (x1, y + 5 * FINE)];
                    area.draw(&Rectangle::new(corners, series.colour.mix(0.25).filled())).map_err(failed)?;
                }
            }
            let style = font(13).pos(Pos::new(HPos::Left, VPos::Center));
            area.draw(&Text::new(series.name.clone(), (x1 + 6 * FINE, y), style)).map_err(failed)?;
            x += item;
        }
    }
    Ok(rows.len() as i32)
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
    let mut x = fixed(figure.x_range, figure.x_scale)
        .unwrap_or_else(|| Axis::around(xs.chain(origin.clone()), figure.x_scale, tight));
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

fn draw_series(chart: &mut Chart<'_>, series: &super::Series, x: Axis, y: Axis) -> Result<()> {
    let stroke = series.colour.stroke_width((series.width * f64::from(FINE)).round() as u32);
    match &series.shape {
        Shape::Line(points) | Shape::Outline(points) => {
            for run in runs(points, x, y) {
                chart.draw_series([PathElement::new(run, stroke)]).map_err(failed)?;
            }
        }
        Shape::Dashed(points) => {
            for run in runs(points, x, y) {
                chart.draw_series(DashedLineSeries::new(run, 7 * FINE, 5 * FINE, stroke)).map_err(failed)?;
            }
        }
        Shape::Points(points) => {
            let r = (series.width * f64::from(FINE)).round() as i32;
            let shown = points.iter().filter(|p| x.holds(p.0) && y.holds(p.1));
            chart
                .draw_series(shown.map(|p| Circle::new(*p, r, series.colour.mix(0.8).filled())))
                .map_err(failed)?;
        }
        Shape::Notes(notes) => {
            for (at, text) in notes.iter().filter(|(at, _)| x.holds(at.0) && y.holds(at.1)) {
                // Beside what it is of, not on it, and within the picture.
                let right = x.share(at.0).is_some_and(|share| share > 0.8);
                let (side, beside) = if right { (HPos::Right, -5) } else { (HPos::Left, 5) };
                let style = font(11).color(&series.colour).pos(Pos::new(side, VPos::Bottom));
                let text = Text::new(text.clone(), (beside * FINE, -3 * FINE), style);
                chart.draw_series([EmptyElement::at(*at) + text]).map_err(failed)?;
            }
        }
        Shape::Band(points) => {
            let (lo, hi) = if y.from < y.to { (y.from, y.to) } else { (y.to, y.from) };
            let whole = |p: &&(f64, f64, f64)| p.1.is_finite() && p.2.is_finite() && x.holds(p.0);
            for run in points.split(|p| !whole(&p)).filter(|r| r.len() > 1) {
                let lower = run.iter().map(|p| (p.0, p.1.clamp(lo, hi)));
                let upper = run.iter().rev().map(|p| (p.0, p.2.clamp(lo, hi)));
                let outline: Vec<(f64, f64)> = lower.chain(upper).collect();
                chart
                    .draw_series([Polygon::new(outline, series.colour.mix(0.25).filled())])
                    .map_err(failed)?;
            }
        }
    }
    Ok(())
}

/// The parts of a polyline inside the axes.
fn runs(points: &[(f64, f64)], x: Axis, y: Axis) -> Vec<Vec<(f64, f64)>> {
    let mut out: Vec<Vec<(f64, f64)>> = Vec::new();
    let mut open = false;
    for pair in points.windows(2) {
        let Some((a, b, whole)) = clip(pair[0], pair[1], x, y) else {
            open = false;
            continue;
        };
        match out.last_mut() {
            Some(run) if open => run.push(b),
            _ => out.push(vec![a, b]),
        }
        open = whole;
    }
    out
}

/// A segment clipped to the axes (Liang and Barsky, 1984), and whether its end stayed where it was.
fn clip(a: Point, b: Point, x: Axis, y: Axis) -> Option<(Point, Point, bool)> {
    let (ax, ay, bx, by) = (x.share(a.0)?, y.share(a.1)?, x.share(b.0)?, y.share(b.1)?);
    let (mut from, mut to) = (0.0f64, 1.0f64);
    for (start, delta) in [(ax, bx - ax), (ay, by - ay)] {
        for (p, q) in [(-delta, start), (delta, 1.0 - start)] {
            if p == 0.0 && q < 0.0 {
                return None;
            }
            if p < 0.0 {
                from = from.max(q / p);
            } else if p > 0.0 {
                to = to.min(q / p);
            }
        }
    }
    if from > to {
        return None;
    }
    let at = |axis: Axis, s: f64| match axis.scale {
        Scale::Log => axis.from * (axis.to / axis.from).powf(s),
        _ => axis.from + s * (axis.to - axis.from),
    };
    let point = |t: f64| (at(x, ax + t * (bx - ax)), at(y, ay + t * (by - ay)));
    Some((if from > 0.0 { point(from) } else { a }, if to < 1.0 { point(to) } else { b }, to >= 1.0))
}

/// Circles of range about the station, labelled in metres or kilometres.
fn circles(chart: &mut Chart<'_>, radii: &[f64], x: Axis, y: Axis) -> Result<()> {
    let reach = [x.from, x.to, y.from, y.to].iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let radii = if radii.is_empty() {
        Axis { from: 0.0, to: reach * 1.2, scale: Scale::Linear }.ticks(5)
    } else {
        radii.to_vec()
    };
    for r in radii.into_iter().filter(|r| *r > 0.0) {
        let ring: Vec<(f64, f64)> =
            (0..=180).map(|i| f64::from(i).to_radians() * 2.0).map(|t| (r * t.sin(), r * t.cos())).collect();
        for run in runs(&ring, x, y) {
            chart
                .draw_series([PathElement::new(run, GREY.mix(0.5).stroke_width(FINE as u32))])
                .map_err(failed)?;
        }
        let at =
            [(0.0, r), (0.0, -r), (r, 0.0), (-r, 0.0)].into_iter().find(|p| x.holds(p.0) && y.holds(p.1));
        if let Some(at) = at {
            let text = if r >= 1000.0 { format!("{} km", r / 1000.0) } else { format!("{r} m") };
            let style = font(11).color(&GREY).pos(Pos::new(HPos::Center, VPos::Bottom));
            chart.draw_series([Text::new(text, at, style)]).map_err(failed)?;
        }
    }
    chart
        .draw_series([TriangleMarker::new((0.0, 0.0), 7 * FINE, RGBColor(0, 0, 0).filled())])
        .map_err(failed)?;
    Ok(())
}

fn colour_bar(area: &Area<'_>, heat: &HeatMap) -> Result<()> {
    let (_, height) = area.dim_in_pixel();
    let (top, bottom) = (MARGIN * FINE, height as i32 - (BELOW + 8) * FINE);
    let (left, right) = (4 * FINE, 20 * FINE);
    let (from, to) = heat_range(heat);
    let axis = Axis { from, to, scale: heat.map.scale() };

    let y = |share: f64| bottom + (share * f64::from(top - bottom)).round() as i32;
    for k in 0..COLOURS as i32 {
        let share = f64::from(k) / COLOURS;
        let corners = [(left, y(share)), (right, y(share + 1.0 / COLOURS) - 1)];
        area.draw(&Rectangle::new(corners, heat.map.colour(share).filled())).map_err(failed)?;
    }
    let frame = GREY.stroke_width(FINE as u32);
    area.draw(&Rectangle::new([(left, bottom), (right, top)], frame)).map_err(failed)?;
    for tick in axis.ticks(8) {
        let at = y(axis.share(tick).unwrap_or(0.0));
        area.draw(&PathElement::new(vec![(right, at), (right + 4 * FINE, at)], frame)).map_err(failed)?;
        let style = font(12).pos(Pos::new(HPos::Left, VPos::Center));
        area.draw(&Text::new(axis.label(tick), (right + 6 * FINE, at), style)).map_err(failed)?;
    }
    let style = font(13).transform(FontTransform::Rotate270).pos(Pos::new(HPos::Center, VPos::Bottom));
    let at = ((BAR - 8) * FINE, (top + bottom) / 2);
    area.draw(&Text::new(heat.label.clone(), at, style)).map_err(failed)?;
    Ok(())
}
