//! Drawing what a figure shows within its axes.

use super::axis::{Axis, Ruler, Scale};
use super::draw::{FINE, GREY, failed, font};
use super::{Look, Series, Shape, dense, notes};
use anyhow::Result;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

pub(super) type Point = (f64, f64);
pub(super) type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<Ruler, Ruler>>;

/// Draws a series on axes that are so long and high, points.
pub(super) fn draw_series(
    chart: &mut Chart<'_>,
    series: &Series,
    look: Look,
    (x, y): (Axis, Axis),
    size: (i32, i32),
) -> Result<()> {
    let stroke = look.colour.stroke_width((series.width * f64::from(FINE)).round() as u32);
    let pixel = |p: Point| {
        let place =
            |axis: Axis, at: f64, length: i32| axis.share(at).unwrap_or(f64::NAN) * f64::from(length * FINE);
        (place(x, p.0, size.0), place(y, p.1, size.1))
    };
    match &series.shape {
        Shape::Line(points) | Shape::Outline(points) => {
            for run in runs(points, x, y) {
                let run = dense::thinned(&run, pixel);
                match look.dash() {
                    None => chart.draw_series([PathElement::new(run, stroke)]).map_err(failed)?,
                    Some((dash, gap)) => chart
                        .draw_series(DashedLineSeries::new(run, dash * FINE, gap * FINE, stroke))
                        .map_err(failed)?,
                };
            }
        }
        Shape::Dashed(points) => {
            for run in runs(points, x, y) {
                chart
                    .draw_series(DashedLineSeries::new(
                        dense::thinned(&run, pixel),
                        7 * FINE,
                        5 * FINE,
                        stroke,
                    ))
                    .map_err(failed)?;
            }
        }
        Shape::Points(points) => {
            let r = (series.width * f64::from(FINE)).round() as i32;
            let shown = points.iter().filter(|p| x.holds(p.0) && y.holds(p.1));
            chart.draw_series(shown.map(|p| marker(*p, r, look, 0.8))).map_err(failed)?;
        }
        // Words are drawn when all else is: where they stand is a matter of all of them.
        Shape::Notes(_) => {}
        Shape::Band(points) => {
            let (lo, hi) = if y.from < y.to { (y.from, y.to) } else { (y.to, y.from) };
            let whole = |p: &&(f64, f64, f64)| p.1.is_finite() && p.2.is_finite() && x.holds(p.0);
            for run in points.split(|p| !whole(&p)).filter(|r| r.len() > 1) {
                let lower = run.iter().map(|p| (p.0, p.1.clamp(lo, hi)));
                let upper = run.iter().rev().map(|p| (p.0, p.2.clamp(lo, hi)));
                let outline: Vec<(f64, f64)> = lower.chain(upper).collect();
                chart
                    .draw_series([Polygon::new(outline, look.colour.mix(dense::BAND).filled())])
                    .map_err(failed)?;
            }
        }
    }
    Ok(())
}

/// A point of a series: a disc, or a ring where colours return.
pub(super) fn marker<C>(at: C, r: i32, look: Look, strength: f64) -> Circle<C, i32> {
    let colour = look.colour.mix(strength);
    let style = if look.round == 0 { colour.filled() } else { colour.stroke_width(FINE as u32) };
    Circle::new(at, r, style)
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

/// Circles of range about the station, labelled in metres or kilometres; the labels, each centred above its place.
pub(super) fn circles(
    chart: &mut Chart<'_>,
    radii: &[f64],
    x: Axis,
    y: Axis,
) -> Result<Vec<(Point, String)>> {
    let reach = [x.from, x.to, y.from, y.to].iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let radii = if radii.is_empty() {
        Axis { from: 0.0, to: reach * 1.2, scale: Scale::Linear }.ticks(5)
    } else {
        radii.to_vec()
    };
    let mut labels = Vec::new();
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
            let style = font(notes::SIZE).color(&GREY).pos(Pos::new(HPos::Center, VPos::Bottom));
            chart.draw_series([Text::new(text.clone(), at, style)]).map_err(failed)?;
            labels.push((at, text));
        }
    }
    chart
        .draw_series([TriangleMarker::new((0.0, 0.0), 7 * FINE, RGBColor(0, 0, 0).filled())])
        .map_err(failed)?;
    Ok(labels)
}
