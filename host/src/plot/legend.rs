//! What stands around a figure's axes: legend, bar of colours, and the lines below that say what is drawn.

use super::axis::{Axis, LABEL, Ruler};
use super::draw::{Area, BAR, BELOW, FINE, GREY, MARGIN, TITLE, failed, font};
use super::raster::{COLOURS, heat_range};
use super::series::marker;
use super::{HeatMap, Plot, Series, Shape, dense, text};
use anyhow::Result;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Height of a row of the legend, and most rows.
pub(super) const LEGEND: i32 = 20;
const MOST_ROWS: usize = 4;
/// Width of the words about what is not in it.
const REST: i32 = 110;

/// Size and height of a line of the caption, and the room above it.
const CAPTION: i32 = 11;
const CAPTION_LINE: i32 = 15;
const CAPTION_ABOVE: i32 = 4;

/// Left and right of a caption.
const INDENT: i32 = 20;

fn caption_lines(figure: &Plot) -> Vec<String> {
    text::wrapped(&figure.caption, CAPTION, f64::from(figure.size.0 as i32 - 2 * INDENT))
}

/// Height of a figure's caption, points.
pub(super) fn caption_height(figure: &Plot) -> i32 {
    match caption_lines(figure).len() as i32 {
        0 => 0,
        n => n * CAPTION_LINE + 2 * CAPTION_ABOVE,
    }
}

/// Draws the caption below a figure that is so high, points.
pub(super) fn caption(area: &Area<'_>, figure: &Plot, height: i32) -> Result<()> {
    for (k, line) in (0..).zip(caption_lines(figure)) {
        let at = (INDENT * FINE, (height + CAPTION_ABOVE + k * CAPTION_LINE) * FINE);
        area.draw(&Text::new(line, at, font(CAPTION).color(&RGBColor(70, 70, 70)))).map_err(failed)?;
    }
    Ok(())
}

/// Draws the legend in rows under the title; how many. What has no room there is counted.
pub(super) fn legend(area: &Area<'_>, figure: &Plot, width: i32) -> Result<i32> {
    let named: Vec<&Series> = figure.series.iter().filter(|s| !s.name.is_empty()).collect();
    let mut rows: Vec<Vec<(&Series, i32)>> = Vec::new();
    let mut used = width;
    let mut shown = 0;
    for series in &named {
        let item = 34 + text::width(&series.name, LABEL).ceil() as i32 + 18;
        // The last row has room for words about the rest.
        let room = if rows.len() == MOST_ROWS { width - 2 * MARGIN - REST } else { width - 2 * MARGIN };
        if used + item > room {
            if rows.len() == MOST_ROWS {
                break;
            }
            rows.push(Vec::new());
            used = 0;
        }
        used += item;
        shown += 1;
        if let Some(row) = rows.last_mut() {
            row.push((series, item));
        }
    }
    for (r, row) in rows.iter().enumerate() {
        let rest = named.len() - shown;
        let counted = rest > 0 && r + 1 == rows.len();
        let total = row.iter().map(|(_, w)| w).sum::<i32>() + if counted { REST } else { 0 };
        let mut x = ((width - total) / 2).max(MARGIN);
        let y = (TITLE + r as i32 * LEGEND + LEGEND / 2 - 2) * FINE;
        for (series, item) in row {
            let (x0, x1) = (x * FINE, (x + 26) * FINE);
            let look = figure.shown(series.look);
            let stroke = look.colour.stroke_width((series.width * f64::from(FINE)) as u32);
            match series.shape {
                Shape::Line(_) | Shape::Outline(_) => {
                    for (from, to) in look.dashes(26) {
                        let ends = vec![(x0 + from * FINE, y), (x0 + to * FINE, y)];
                        area.draw(&PathElement::new(ends, stroke)).map_err(failed)?;
                    }
                }
                Shape::Dashed(_) => {
                    for k in [0, 10, 20] {
                        let ends = vec![(x0 + k * FINE, y), (x0 + (k + 6) * FINE, y)];
                        area.draw(&PathElement::new(ends, stroke)).map_err(failed)?;
                    }
                }
                Shape::Points(_) => {
                    let r = (series.width * 1.4 * f64::from(FINE)) as i32;
                    area.draw(&marker(((x0 + x1) / 2, y), r, look, 1.0)).map_err(failed)?;
                }
                Shape::Notes(_) => {}
                Shape::Band(_) => {
                    let corners = [(x0, y - 5 * FINE), (x1, y + 5 * FINE)];
                    area.draw(&Rectangle::new(corners, look.colour.mix(dense::BAND).filled()))
                        .map_err(failed)?;
                }
            }
            let style = font(LABEL).pos(Pos::new(HPos::Left, VPos::Center));
            area.draw(&Text::new(series.name.clone(), (x1 + 6 * FINE, y), style)).map_err(failed)?;
            x += item;
        }
        if counted {
            let style = font(LABEL).pos(Pos::new(HPos::Left, VPos::Center));
            area.draw(&Text::new(format!("and {rest} more"), (x * FINE, y), style)).map_err(failed)?;
        }
    }
    Ok(rows.len() as i32)
}

pub(super) fn colour_bar(area: &Area<'_>, heat: &HeatMap) -> Result<()> {
    let (_, height) = area.dim_in_pixel();
    let (top, bottom) = (MARGIN * FINE, height as i32 - (BELOW + 8) * FINE);
    let (left, right) = (4 * FINE, 20 * FINE);
    let (from, to) = heat_range(heat);
    let axis = Axis { from, to, scale: heat.map.scale() };
    let length = f64::from((bottom - top) / FINE);

    let y = |share: f64| bottom + (share * f64::from(top - bottom)).round() as i32;
    for k in 0..COLOURS as i32 {
        let share = f64::from(k) / COLOURS;
        let corners = [(left, y(share)), (right, y(share + 1.0 / COLOURS) - 1)];
        area.draw(&Rectangle::new(corners, heat.map.colour(share).filled())).map_err(failed)?;
    }
    let frame = GREY.stroke_width(FINE as u32);
    area.draw(&Rectangle::new([(left, bottom), (right, top)], frame)).map_err(failed)?;
    for (tick, label) in (Ruler { axis, length, across: false }).ticks() {
        let at = y(axis.share(tick).unwrap_or(0.0));
        area.draw(&PathElement::new(vec![(right, at), (right + 4 * FINE, at)], frame)).map_err(failed)?;
        let style = font(12).pos(Pos::new(HPos::Left, VPos::Center));
        area.draw(&Text::new(label, (right + 6 * FINE, at), style)).map_err(failed)?;
    }
    let style = font(13).transform(FontTransform::Rotate270).pos(Pos::new(HPos::Center, VPos::Bottom));
    let at = ((BAR - 8) * FINE, (top + bottom) / 2);
    area.draw(&Text::new(heat.label.clone(), at, style)).map_err(failed)?;
    Ok(())
}
