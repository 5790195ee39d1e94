//! Layers of more points than a figure can show one by one: drawn into pixels, so that the picture of a week is no larger than that
//! of a minute. Axes, words, lines and what is sparse stay as they are. Nothing is left out: where points lie on each other their
//! pixels are darker, to a third one.

use super::axis::Axis;
use super::{Series, Shape};
use plotters::style::RGBColor;

/// Points and corners of bands above which they are drawn into pixels.
const MOST_DRAWN: usize = 1200;

/// Opacity of one, two, three or more points on each other, and of a band, as it has where it is drawn as a shape.
const POINTS: [f64; 3] = [0.55, 0.78, 0.92];
pub(super) const BAND: f64 = 0.25;

/// Whether a figure's points and bands are too many to be drawn one by one.
pub(super) fn is_dense(series: &[Series]) -> bool {
    let size = |s: &Series| match &s.shape {
        Shape::Points(points) => points.len(),
        Shape::Band(corners) => corners.len(),
        _ => 0,
    };
    series.iter().map(size).sum::<usize>() > MOST_DRAWN
}

/// Pixels over a figure's axes, row after row from the top: red, green, blue, opacity.
pub(super) struct Layer {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) pixels: Vec<[u8; 4]>,
}

impl Layer {
    /// Of all points and bands of a figure, the later ones on top. `scale`: pixels to a point.
    pub(super) fn of(
        series: &[Series],
        (x, y): (Axis, Axis),
        (width, height): (usize, usize),
        scale: f64,
    ) -> Self {
        let mut layer = Self { width, height, pixels: vec![[0; 4]; width * height] };
        let place = |(px, py): (f64, f64)| {
            let (across, up) = x.share(px).zip(y.share(py))?;
            Some((across * width as f64, (1.0 - up) * height as f64))
        };
        let mut hits = vec![0u8; width * height];
        for one in series {
            match &one.shape {
                Shape::Points(points) => {
                    hits.fill(0);
                    let radius = one.width * scale;
                    let shown =
                        points.iter().filter(|p| x.holds(p.0) && y.holds(p.1)).filter_map(|p| place(*p));
                    shown.for_each(|at| layer.disc(&mut hits, at, radius));
                    layer.paint(&hits, one.look.colour, |n| POINTS[usize::from(n.min(3)) - 1]);
                }
                Shape::Band(corners) => {
                    hits.fill(0);
                    let whole = |c: &&(f64, f64, f64)| c.1.is_finite() && c.2.is_finite() && x.holds(c.0);
                    for run in corners.split(|c| !whole(&c)) {
                        let run: Vec<_> =
                            run.iter().filter_map(|c| place((c.0, c.1)).zip(place((c.0, c.2)))).collect();
                        for pair in run.windows(2) {
                            layer.slice(&mut hits, pair[0], pair[1]);
                        }
                    }
                    layer.paint(&hits, one.look.colour, |_| BAND);
                }
                _ => {}
            }
        }
        layer
    }

    /// The pixels of a row between two of its places.
    fn row<'a>(&self, hits: &'a mut [u8], row: usize, from: f64, to: f64) -> &'a mut [u8] {
        let pixel = |at: f64| (at.round().max(0.0) as usize).min(self.width);
        let begins = row * self.width;
        hits.get_mut(begins + pixel(from)..begins + pixel(to)).unwrap_or(&mut [])
    }

    /// Counts a disc.
    fn disc(&self, hits: &mut [u8], (x, y): (f64, f64), radius: f64) {
        let rows =
            (y - radius).floor().max(0.0) as usize..((y + radius).ceil().max(0.0) as usize).min(self.height);
        for row in rows {
            let half = (radius * radius - (row as f64 + 0.5 - y).powi(2)).max(0.0).sqrt();
            self.row(hits, row, x - half, x + half).iter_mut().for_each(|hit| *hit = hit.saturating_add(1));
        }
    }

    /// Counts what lies between two corners of a band, each (lower, upper).
    fn slice(&self, hits: &mut [u8], a: ((f64, f64), (f64, f64)), b: ((f64, f64), (f64, f64))) {
        let (from, to) = (a.0.0.min(b.0.0), a.0.0.max(b.0.0));
        for column in from.floor().max(0.0) as usize..(to.ceil().max(0.0) as usize).min(self.width) {
            let middle = (column as f64 + 0.5).clamp(from, to);
            let share = if b.0.0 == a.0.0 { 0.5 } else { (middle - a.0.0) / (b.0.0 - a.0.0) };
            let (low, high) = (a.0.1 + share * (b.0.1 - a.0.1), a.1.1 + share * (b.1.1 - a.1.1));
            let row = |at: f64| (at.round().max(0.0) as usize).min(self.height);
            let rows = row(high.min(low))..row(high.max(low));
            let own = hits.iter_mut().skip(rows.start * self.width + column).step_by(self.width.max(1));
            own.take(rows.len()).for_each(|hit| *hit = 1);
        }
    }

    /// Lays a colour over what is there, where it was counted.
    fn paint(&mut self, hits: &[u8], colour: RGBColor, opacity: impl Fn(u8) -> f64) {
        for (pixel, hit) in self.pixels.iter_mut().zip(hits).filter(|(_, hit)| **hit > 0) {
            let (over, under) = (opacity(*hit), f64::from(pixel[3]) / 255.0);
            let whole = over + under * (1.0 - over);
            let mix = |new: u8, old: u8| {
                ((f64::from(new) * over + f64::from(old) * under * (1.0 - over)) / whole).round() as u8
            };
            let [r, g, b, _] = *pixel;
            *pixel = [mix(colour.0, r), mix(colour.1, g), mix(colour.2, b), (255.0 * whole).round() as u8];
        }
    }
}

/// A line without what cannot be seen: of the points in one column of pixels the first, the lowest, the highest and the last.
pub(super) fn thinned(line: &[(f64, f64)], pixel: impl Fn((f64, f64)) -> (f64, f64)) -> Vec<(f64, f64)> {
    let mut out = Vec::new();
    let mut rest = line;
    while let Some(first) = rest.first() {
        let column = |p: &(f64, f64)| pixel(*p).0.floor();
        let own = column(first);
        let n = rest.iter().take_while(|p| column(p) == own).count().max(1);
        let (here, after) = rest.split_at(n);
        rest = after;
        if n <= 4 {
            out.extend_from_slice(here);
            continue;
        }
        let by = |a: &&(usize, f64), b: &&(usize, f64)| a.1.total_cmp(&b.1);
        let heights: Vec<(usize, f64)> = here.iter().map(|p| pixel(*p).1).enumerate().collect();
        let ends = [heights.iter().min_by(by), heights.iter().max_by(by)].map(|e| e.map_or(0, |e| e.0));
        let mut kept = [0, ends[0], ends[1], n - 1];
        kept.sort_unstable();
        out.extend(kept.iter().filter_map(|k| here.get(*k)));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::{ColourMap, HeatMap, Plot, Scale, draw, raster::Cells};
    use super::*;
    use cpu_time::ThreadTime;
    use proptest::prelude::*;

    const WEEK_S: f64 = 604_800.0;

    /// Azimuths of several vessels and of noise, every so many seconds, with bands, a jagged line and a likelihood: nothing
    /// that compresses well.
    fn busy(seconds: f64, step_s: f64) -> Plot {
        let begins = 1_714_600_000.0;
        let mut seed = 7u64;
        let mut random = move || {
            seed ^= seed << 13;
            seed ^= seed >> 7;
            seed ^= seed << 17;
            (seed >> 11) as f64 / (1u64 << 53) as f64
        };
        let mut figure = Plot::new("Azimuth", "time", "azimuth (°)");
        figure.x_scale(Scale::Utc).y_scale(Scale::Degrees).caption("A week of bearings.");
        for vessel in 0..6 {
            let (mut points, mut band) = (Vec::new(), Vec::new());
            for k in 0..(seconds / step_s) as usize {
                let t = begins + k as f64 * step_s;
                let azimuth = if vessel == 5 {
                    360.0 * random()
                } else {
                    (60.0 * f64::from(vessel) + t / 300.0 + 8.0 * random()).rem_euclid(360.0)
                };
                points.push((t, azimuth));
                band.push((t, azimuth - 5.0 * random(), azimuth + 5.0 * random()));
            }
            figure.band("95 %", &band).points(&format!("track {vessel}"), &points).same_colour();
        }
        let jagged: Vec<_> = (0..(seconds / step_s) as usize)
            .map(|k| (begins + k as f64 * step_s, 360.0 * random()))
            .collect();
        figure.truth("truth", &jagged);
        let cells = (0..160_000).map(|_| random()).collect();
        figure.heat(HeatMap {
            x: (begins, begins + seconds),
            y: (0.0, 360.0),
            columns: 400,
            values: cells,
            strength: Vec::new(),
            range: None,
            map: ColourMap::Amount,
            label: "likelihood".into(),
        });
        figure
    }

    #[test]
    fn a_busy_week_is_a_small_file_with_its_words_and_is_drawn_at_once() {
        let week = busy(WEEK_S, 10.0);
        let begun = ThreadTime::now();
        // Three on one page, as a passage has.
        let svg = draw::page(&[&week, &week, &week], 1, Cells::Image).unwrap();
        assert!(begun.elapsed().as_secs_f64() < 10.0, "{:?}", begun.elapsed());
        assert!(svg.len() < 500_000, "{}", svg.len());
        // What must stay lines and text does: title, axes, legend, the truth.
        for words in ["Azimuth", "azimuth (°)", "track 5", "A week of bearings.", "truth"] {
            assert_eq!(svg.matches(&format!("\n{words}\n")).count(), 3, "{words}");
        }
        assert!(svg.matches("<polyline").count() > 3 && svg.matches("<image").count() == 6);
        // One in the legend for each series.
        assert_eq!(svg.matches("<circle").count(), 18);
        assert!(svg.matches("<text").count() > 60);
    }

    #[test]
    fn on_the_way_to_a_page_the_pixels_are_one_shape_for_each_colour() {
        let mut figure = busy(WEEK_S, 600.0);
        figure.heat = None;
        let drawn = draw::page(&[&figure], 1, Cells::Rectangles).unwrap();
        let shapes = drawn.matches("<path d=\"M").count();
        assert!((6..2000).contains(&shapes) && !drawn.contains("<image"), "{shapes}");
    }

    #[test]
    fn what_can_be_drawn_one_by_one_is() {
        let few = busy(600.0, 6.0).svg().unwrap();
        assert!(few.matches("<circle").count() > 500 && few.matches("<image").count() == 1);
    }

    #[test]
    fn every_point_is_among_the_pixels_and_nothing_else() {
        let axis = |from, to| Axis { from, to, scale: Scale::Linear };
        let points: Vec<(f64, f64)> =
            (0..2000).map(|k| (f64::from(k % 100), f64::from(k / 100) * 5.0)).collect();
        let mut figure = Plot::new("", "", "");
        figure.points("p", &points).band("b", &[(10.0, 40.0, 60.0), (20.0, 50.0, 70.0)]);
        assert!(is_dense(&figure.series));
        let layer = Layer::of(&figure.series, (axis(0.0, 100.0), axis(0.0, 100.0)), (1000, 1000), 1.0);
        let at = |x: f64, y: f64| layer.pixels[(1000.0 - 10.0 * y) as usize * 1000 + (10.0 * x) as usize];
        assert!(points.iter().filter(|p| p.1 > 0.0).all(|p| at(p.0, p.1)[3] > 100));
        assert_eq!(
            (at(50.5, 52.5), at(15.0, 47.5)[3] > 0, at(15.5, 44.0)[3], at(15.5, 66.5)[3]),
            ([0; 4], true, 0, 0)
        );
        assert_eq!(at(15.5, 57.3)[3], (BAND * 255.0).round() as u8);
    }

    proptest! {
        #![proptest_config(seabearing_testkit::property(64))]

        #[test]
        fn a_thinned_line_reaches_as_far_in_every_column(line in prop::collection::vec((0.0..20.0f64, -50.0..50.0f64), 0..300)) {
            let mut line = line;
            line.sort_by(|a, b| a.0.total_cmp(&b.0));
            let thin = thinned(&line, |p| p);
            prop_assert!(thin.len() <= 80);
            for column in 0..20 {
                let ends = |points: &[(f64, f64)]| {
                    let own = points.iter().filter(|p| p.0 as i32 == column).map(|p| p.1);
                    own.fold((f64::MAX, f64::MIN), |(a, b), y| (a.min(y), b.max(y)))
                };
                prop_assert_eq!(ends(&thin), ends(&line));
            }
        }
    }
}
