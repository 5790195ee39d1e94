//! Words beside points, so that none lies on others.
//!
//! Words stand close beside their point where they have room there, or a little farther off where that keeps them from lying on lines. Those that would lie on others, on the label of a range circle or on
//! another point stand off in the direction and at the distance that are free first, with a thin line from their point. What has no room
//! within [`RINGS`] is left out. Cost: words times words, and the corners of lines, times 84 places.

use super::axis::Axis;
use super::draw::{FINE, GREY, failed, font};
use super::series::{Chart, Point};
use super::{Series, Shape, text};
use anyhow::Result;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};
use std::f64::consts::TAU;

/// Size of the words, and height of a line of them, points.
pub(super) const SIZE: i32 = 11;
const HEIGHT: f64 = 13.0;

/// Shares of the axes from which on words stand left of, and below, what they are of: elsewhere they would be cut.
const NEAR_THE_RIGHT: f64 = 0.8;
const NEAR_THE_TOP: f64 = 0.95;

/// How far beside and above their point words stand, points.
const BESIDE: f64 = 5.0;
const ABOVE: f64 = 3.0;

/// How far words stand off, points, and in how many directions.
const RINGS: [f64; 5] = [16.0, 26.0, 38.0, 54.0, 74.0];
const DIRECTIONS: usize = 16;

/// Among how many places with room for them one is looked for where they lie on no line.
const NEAR: usize = 4 + 2 * DIRECTIONS;

/// Half the side of the square about a point that other words leave free, points.
const POINT: f64 = 2.0;

/// A rectangle: left, top, right, bottom, points from the plot's upper left corner.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Space {
    left: f64,
    top: f64,
    right: f64,
    bottom: f64,
}

impl Space {
    fn about(at: Point, half: f64) -> Self {
        Self { left: at.0 - half, top: at.1 - half, right: at.0 + half, bottom: at.1 + half }
    }

    fn meets(&self, other: &Self) -> bool {
        self.left < other.right
            && other.left < self.right
            && self.top < other.bottom
            && other.top < self.bottom
    }

    fn within(&self, size: Point) -> bool {
        self.left >= 0.0 && self.top >= 0.0 && self.right <= size.0 && self.bottom <= size.1
    }

    /// Whether the way from one place to another leads through it.
    fn crossed(&self, (a, b): &(Point, Point)) -> bool {
        let (mut from, mut to) = (0.0f64, 1.0f64);
        for (start, end, least, most) in
            [(a.0, b.0, self.left, self.right), (a.1, b.1, self.top, self.bottom)]
        {
            let way = end - start;
            if way == 0.0 {
                if start < least || start > most {
                    return false;
                }
                continue;
            }
            let (one, other) = ((least - start) / way, (most - start) / way);
            (from, to) = (from.max(one.min(other)), to.min(one.max(other)));
        }
        from < to
    }

    /// The nearest place of it.
    fn nearest(&self, at: Point) -> Point {
        (at.0.clamp(self.left, self.right), at.1.clamp(self.top, self.bottom))
    }
}

/// Where words stand.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Stand {
    space: Space,
    /// The side of them that is towards their point.
    side: Side,
    /// Whether a line goes to it.
    line: bool,
}

/// Which end of the words is fixed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    Left,
    Right,
}

/// Where words of so many points can stand beside `at`, the best first; `right`, `top`: their point is near these edges.
fn stands(at: Point, wide: f64, right: bool, top: bool) -> impl Iterator<Item = Stand> {
    let corner = move |leftward: bool, below: bool| {
        let left = if leftward { at.0 - BESIDE - wide } else { at.0 + BESIDE };
        let upper = if below { at.1 + ABOVE } else { at.1 - ABOVE - HEIGHT };
        let space = Space { left, top: upper, right: left + wide, bottom: upper + HEIGHT };
        Stand { space, side: if leftward { Side::Right } else { Side::Left }, line: false }
    };
    let close = [(right, top), (right, !top), (!right, top), (!right, !top)].map(|(l, b)| corner(l, b));
    let ring = move |far: f64| {
        (0..DIRECTIONS).map(move |k| {
            // From the first corner on, alternately to either side.
            let turn = (k.div_ceil(2) as f64) * if k % 2 == 0 { 1.0 } else { -1.0 } / DIRECTIONS as f64;
            let first = match (right, top) {
                (false, false) => 0.125,
                (false, true) => 0.375,
                (true, true) => 0.625,
                (true, false) => 0.875,
            };
            let (s, c) = (TAU * (first + turn)).sin_cos();
            let end = (at.0 + far * s, at.1 - far * c);
            let leftward = s < 0.0;
            let left = if leftward { end.0 - wide } else { end.0 };
            let upper = end.1 - HEIGHT * 0.5 * (1.0 + c);
            let space = Space { left, top: upper, right: left + wide, bottom: upper + HEIGHT };
            Stand { space, side: if leftward { Side::Right } else { Side::Left }, line: true }
        })
    };
    close.into_iter().chain(RINGS.into_iter().flat_map(ring))
}

/// Where each of the words stands in a plot of a size, points; `None`: nowhere. `taken`: what is there already; `lines`: what they would better
/// not lie on.
fn placed(
    words: &[(Point, &str)],
    mut taken: Vec<Space>,
    lines: &[(Point, Point)],
    size: Point,
) -> Vec<Option<Stand>> {
    let points: Vec<Space> = words.iter().map(|(at, _)| Space::about(*at, POINT)).collect();
    let place = |(at, words): &(Point, &str)| {
        let (right, top) = (at.0 > NEAR_THE_RIGHT * size.0, at.1 < (1.0 - NEAR_THE_TOP) * size.1);
        let own = Space::about(*at, POINT);
        let free = |stand: &Stand, taken: &[Space]| {
            let others = points.iter().filter(|point| !point.meets(&own));
            taken.iter().chain(others).all(|other| !stand.space.meets(other))
        };
        let fits = |stand: &Stand| stand.space.within(size) && free(stand, &taken);
        let all = || stands(*at, text::width(words, SIZE), right, top).filter(fits);
        let clear = |stand: &Stand| !lines.iter().any(|line| stand.space.crossed(line));
        let found = all().take(NEAR).find(clear).or_else(|| all().next());
        taken.extend(found.map(|stand| stand.space));
        found
    };
    words.iter().map(place).collect()
}

/// Draws the words of all series on axes that are so long and high, points. `labels`: words that are drawn already, each centred above its place.
pub(super) fn draw(
    chart: &mut Chart<'_>,
    series: &[Series],
    labels: &[(Point, String)],
    (x, y): (Axis, Axis),
    size: (i32, i32),
) -> Result<()> {
    let size = (f64::from(size.0), f64::from(size.1));
    let pixel = |at: Point| Some((x.share(at.0)? * size.0, (1.0 - y.share(at.1)?) * size.1));
    let mut of = Vec::new();
    let mut words: Vec<(Point, &str)> = Vec::new();
    for one in series {
        let Shape::Notes(notes) = &one.shape else { continue };
        for (at, text) in notes.iter().filter(|(at, _)| x.holds(at.0) && y.holds(at.1)) {
            let Some(pixel) = pixel(*at) else { continue };
            of.push((*at, one.look.colour));
            words.push((pixel, text.as_str()));
        }
    }
    let label = |(at, text): &(Point, String)| {
        let ((x, y), half) = (pixel(*at)?, 0.5 * text::width(text, SIZE));
        Some(Space { left: x - half, top: y - HEIGHT, right: x + half, bottom: y })
    };
    let lines: Vec<(Point, Point)> = (series.iter())
        .filter_map(|one| match &one.shape {
            Shape::Line(points) | Shape::Outline(points) | Shape::Dashed(points) => Some(points),
            _ => None,
        })
        .flat_map(|points| points.windows(2))
        .filter_map(|ends| Some((pixel(ends[0])?, pixel(ends[1])?)))
        .collect();
    let taken = labels.iter().filter_map(label).collect();
    let stands = placed(&words, taken, &lines, size);
    let fine = |d: f64| (d * f64::from(FINE)).round() as i32;
    for (((at, colour), (from, text)), stand) in of.iter().zip(&words).zip(stands) {
        let Some(Stand { space, side, line }) = stand else { continue };
        let (side, edge_x) = match side {
            Side::Left => (HPos::Left, space.left),
            Side::Right => (HPos::Right, space.right),
        };
        let style = font(SIZE).color(colour).pos(Pos::new(side, VPos::Bottom));
        let offset = (fine(edge_x - from.0), fine(space.bottom - from.1));
        let words = Text::new((*text).to_owned(), offset, style);
        if line {
            let to = space.nearest(*from);
            let ends = vec![(0, 0), (fine(to.0 - from.0), fine(to.1 - from.1))];
            let thin = PathElement::new(ends, GREY.stroke_width(1));
            chart.draw_series([EmptyElement::at(*at) + thin + words]).map_err(failed)?;
        } else {
            chart.draw_series([EmptyElement::at(*at) + words]).map_err(failed)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE_OF_PLOT: Point = (700.0, 500.0);

    fn none_meet(words: &[(Point, &str)], stands: &[Option<Stand>]) {
        for (k, one) in stands.iter().enumerate() {
            let Some(one) = one else { continue };
            assert!(one.space.within(SIZE_OF_PLOT), "{k}: {one:?}");
            let width = text::width(words[k].1, SIZE);
            assert!((one.space.right - one.space.left - width).abs() < 1e-9, "{k}");
            for other in stands[..k].iter().flatten() {
                assert!(!one.space.meets(&other.space), "{k}: {one:?} {other:?}");
            }
        }
    }

    #[test]
    fn words_with_room_stand_close_beside_their_points() {
        let words = [((100.0, 200.0), "1 at 00:20:00"), ((690.0, 300.0), "00:05:00"), ((300.0, 2.0), "x")];
        let stands = placed(&words, Vec::new(), &[], SIZE_OF_PLOT);
        none_meet(&words, &stands);
        let of = |k: usize| stands[k].unwrap();
        assert_eq!((of(0).side, of(0).line, of(0).space.bottom), (Side::Left, false, 197.0));
        assert_eq!((of(1).side, of(1).space.right), (Side::Right, 685.0));
        assert_eq!(of(2).space.top, 5.0);
        // A line through where they would stand: they stand where none is, close by.
        let lines = [((100.0, 194.0), (300.0, 150.0))];
        let moved = placed(&words[..1], Vec::new(), &lines, SIZE_OF_PLOT)[0].unwrap();
        assert!(!moved.line && moved.space.top == 203.0 && moved.side == Side::Left, "{moved:?}");
    }

    #[test]
    fn a_way_through_a_space_is_told_from_one_beside_it() {
        let space = Space { left: 10.0, top: 10.0, right: 30.0, bottom: 20.0 };
        for (a, b, through) in [
            ((0.0, 0.0), (40.0, 30.0), true),
            ((15.0, 15.0), (16.0, 15.0), true),
            ((20.0, 0.0), (20.0, 40.0), true),
            ((0.0, 25.0), (40.0, 25.0), false),
            ((0.0, 0.0), (9.0, 30.0), false),
            ((0.0, 15.0), (9.0, 15.0), false),
        ] {
            assert_eq!(space.crossed(&(a, b)), through, "{a:?} {b:?}");
        }
    }

    #[test]
    fn words_of_points_that_lie_together_stand_off_and_none_lies_on_another() {
        let names: Vec<String> = (0..20).map(|k| format!("{k} at 00:20:00")).collect();
        let near: Vec<(Point, &str)> = (names.iter().enumerate())
            .map(|(k, name)| ((350.0 + 2.0 * (k % 5) as f64, 250.0 + 3.0 * (k / 5) as f64), name.as_str()))
            .collect();
        let label = Space { left: 330.0, top: 180.0, right: 370.0, bottom: 245.0 };
        let stands = placed(&near, vec![label], &[], SIZE_OF_PLOT);
        none_meet(&near, &stands);
        assert!(stands.iter().flatten().all(|s| !s.space.meets(&label)));
        let shown = stands.iter().flatten().count();
        assert!(shown >= 12 && stands.iter().flatten().any(|s| s.line), "{shown} of 20");
        // Where there is no room at all they are left out.
        let everything = Space { left: 0.0, top: 0.0, right: 700.0, bottom: 500.0 };
        assert!(placed(&near, vec![everything], &[], SIZE_OF_PLOT).iter().all(Option::is_none));
    }
}
