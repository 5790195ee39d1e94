//! Orientation and place of an ocean-bottom station from vessels of known track.
//!
//! Place: the offset from the nominal position that makes the interference delays of all frames most likely, given where
//! each vessel was when its sound left it. Orientation: on each passage the mode of the differences between the azimuths
//! measured in the tone band and the azimuth of the vessel; the mode of all and the scatter of the passages' modes give
//! the value and its uncertainty. Assumes one vessel at a time near the station.

use super::course::{Course, Place, polar};
use super::score::wrap;
use super::stages::{Frame, RANGE_STEP_M, range_evidence};
use crate::propagation::Propagation;
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Ranges at which passages are used, m: nearer the azimuth turns fast, farther the vessel drowns.
const USED_M: std::ops::Range<f64> = 3_000.0..40_000.0;

/// Farthest offset searched, m.
const SEARCH_M: f64 = 1_500.0;

/// Cells of the histogram of azimuth differences, and standard deviation of its smoothing in cells of one degree.
const CELLS: usize = 360;
const SMOOTHING: f64 = 2.0;

/// Fewest frames of a passage that count.
const LEAST_FRAMES: usize = 30;

/// The station's place relative to its nominal position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offset {
    /// East, m.
    pub east_m: f64,
    /// North, m.
    pub north_m: f64,
    /// Standard deviations of both, m.
    pub sd_m: (f64, f64),
    /// Frames used.
    pub frames: usize,
}

/// The correction to add to the orientation that frames were computed with.
#[derive(Clone, Debug, PartialEq)]
pub struct Turn {
    /// Correction, rad.
    pub correction: f64,
    /// Its standard deviation, rad: the scatter of passages, or of half hours where there is one passage.
    pub sd: f64,
    /// Correction of each passage (or half hour), rad.
    pub each: Vec<f64>,
}

/// Where a vessel was when what arrives at a time left it (power-weighted travel time), from a station at an offset.
fn heard(table: &Propagation, course: &Course, t_s: f64, offset: Place) -> Option<Place> {
    let mut place = course.at(t_s)?;
    for _ in 0..3 {
        let range = (place.0 - offset.0).hypot(place.1 - offset.1);
        let delay = table.travel_time_s((range / table.step_m).round() as usize)?;
        place = course.at(t_s - delay)?;
    }
    Some((place.0 - offset.0, place.1 - offset.1))
}

/// The vessel that is alone near the station at a time.
fn alone(courses: &[Course], t_s: f64) -> Option<(usize, &Course)> {
    let near = |c: &Course| c.at(t_s).is_some_and(|p| p.0.hypot(p.1) < 1.5 * USED_M.end);
    let mut inside = courses.iter().enumerate().filter(|(_, c)| near(c));
    let one = inside.next()?;
    inside.next().is_none().then_some(one)
}

/// The station's place; `None` where too few frames have a lone vessel near.
pub fn place(frames: &[Frame], courses: &[Course], table: &Propagation) -> Option<Offset> {
    let evidence = range_evidence(frames, table);
    let used: Vec<Used<'_>> = frames
        .iter()
        .zip(&evidence)
        .filter_map(|(f, e)| {
            let (_, course) = alone(courses, f.t_s)?;
            let range = polar(heard(table, course, f.t_s, (0.0, 0.0))?).0;
            USED_M.contains(&range).then_some((f.t_s, course, e))
        })
        .collect();
    if used.len() < LEAST_FRAMES {
        return None;
    }
    let best = climb(&used, table, (0.0, 0.0), &[(SEARCH_M, 75.0), (100.0, 20.0), (30.0, 4.0)]);
    // Model errors are common to neighbouring frames: the scatter of interleaved parts tells more than the curvature.
    let parts: Vec<Place> = (0..PARTS)
        .map(|part| {
            let some: Vec<Used<'_>> =
                used.iter().filter(|u| (u.0 / PART_S) as usize % PARTS == part).copied().collect();
            climb(&some, table, best, &[(240.0, 40.0), (40.0, 8.0)])
        })
        .collect();
    let sd = |f: &dyn Fn(&Place) -> f64| {
        let n = PARTS as f64;
        let mean = parts.iter().map(f).sum::<f64>() / n;
        (parts.iter().map(|p| (f(p) - mean).powi(2)).sum::<f64>() / (n - 1.0) / n).sqrt()
    };
    let sd_m = (sd(&|p| p.0).max(LEAST_SD_M), sd(&|p| p.1).max(LEAST_SD_M));
    Some(Offset { east_m: best.0, north_m: best.1, sd_m, frames: used.len() })
}

/// A frame that is used: its time, the vessel, its evidence of range.
type Used<'a> = (f64, &'a Course, &'a Vec<f32>);

/// Interleaved parts of the frames whose scatter gives the uncertainty, and the length of a part's pieces, s.
const PARTS: usize = 6;
const PART_S: f64 = 1200.0;

/// The last step of the search: no uncertainty is below it.
const LEAST_SD_M: f64 = 4.0;

/// The most likely offset on grids (reach and step, m) of falling size about a start.
fn climb(used: &[Used<'_>], table: &Propagation, start: Place, grids: &[(f64, f64)]) -> Place {
    let score = |offset: Place| -> f64 {
        used.iter()
            .map(|(t, course, e)| {
                let Some(place) = heard(table, course, *t, offset) else { return 0.0 };
                let x = polar(place).0 / RANGE_STEP_M;
                let (j, w) = (x as usize, x.fract());
                match (e.get(j), e.get(j + 1)) {
                    // A frame in which the vessel is not heard says nothing: half the frames may be such.
                    (Some(a), Some(b)) => {
                        let g = f64::from(*a) * (1.0 - w) + f64::from(*b) * w;
                        (0.5 + 0.5 * g.min(50.0).exp()).ln()
                    }
                    _ => 0.0,
                }
            })
            .sum()
    };
    let mut best = start;
    for &(reach, step) in grids {
        let n = (reach / step) as i32;
        let cells: Vec<Place> = (-n..=n)
            .flat_map(|i| (-n..=n).map(move |j| (i, j)))
            .map(|(i, j)| (best.0 + step * f64::from(i), best.1 + step * f64::from(j)))
            .collect();
        let scored: Vec<(f64, Place)> = cells.into_par_iter().map(|c| (score(c), c)).collect();
        best = scored.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).map_or(best, |x| x.1);
    }
    best
}

/// The orientation, with the station at an offset from where courses are counted; `None` where no passage is usable.
pub fn orientation(
    frames: &[Frame],
    courses: &[Course],
    table: &Propagation,
    offset: Place,
    tones: std::ops::Range<usize>,
) -> Option<Turn> {
    // Histogram of differences per passage, and per half hour of each.
    let mut passages = vec![vec![0f64; CELLS]; courses.len()];
    let mut counts = vec![0usize; courses.len()];
    let mut parts: std::collections::BTreeMap<(usize, u64), (Vec<f64>, usize)> = Default::default();
    for f in frames {
        let Some((n, course)) = alone(courses, f.t_s) else { continue };
        let Some((range, azimuth)) = heard(table, course, f.t_s, offset).map(polar) else { continue };
        if !USED_M.contains(&range) {
            continue;
        }
        counts[n] += 1;
        let part = parts.entry((n, (f.t_s / 1800.0) as u64)).or_insert_with(|| (vec![0.0; CELLS], 0));
        part.1 += 1;
        for a in f.azimuth.get(tones.clone()).into_iter().flatten().filter(|a| a.is_finite()) {
            let off = (azimuth - f64::from(*a)).rem_euclid(TAU);
            let cell = (off / TAU * CELLS as f64) as usize % CELLS;
            passages[n][cell] += 1.0;
            part.0[cell] += 1.0;
        }
    }
    let mut sum = vec![0.0; CELLS];
    for p in &passages {
        sum.iter_mut().zip(p).for_each(|(s, x)| *s += x);
    }
    let good: Vec<f64> =
        passages.iter().zip(&counts).filter(|(_, n)| **n >= LEAST_FRAMES).map(|(p, _)| mode(p)).collect();
    let each = match good.len() {
        0 => return None,
        1 => parts.values().filter(|p| p.1 >= LEAST_FRAMES).map(|p| mode(&p.0)).collect(),
        _ => good,
    };
    let correction = mode(&sum);
    let n = each.len() as f64;
    let scatter = each.iter().map(|x| wrap(x - correction).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    let sd = if each.len() > 1 { (scatter / n).sqrt() } else { f64::INFINITY };
    Some(Turn { correction: wrap(correction), sd, each: each.into_iter().map(wrap).collect() })
}

/// Mode of a cyclic histogram after smoothing, between cells by a parabola.
fn mode(histogram: &[f64]) -> f64 {
    let n = histogram.len();
    let reach = (4.0 * SMOOTHING) as usize;
    let smooth: Vec<f64> = (0..n)
        .map(|i| {
            (0..=2 * reach)
                .map(|k| {
                    let d = k as f64 - reach as f64;
                    histogram[(i + n + k - reach) % n] * (-0.5 * (d / SMOOTHING).powi(2)).exp()
                })
                .sum()
        })
        .collect();
    let top = (0..n).max_by(|a, b| smooth[*a].total_cmp(&smooth[*b])).unwrap_or(0);
    let (a, b, c) = (smooth[(top + n - 1) % n], smooth[top], smooth[(top + 1) % n]);
    let bend = a - 2.0 * b + c;
    let shift = if bend < 0.0 { 0.5 * (a - c) / bend } else { 0.0 };
    (top as f64 + 0.5 + shift) / n as f64 * TAU
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mode_lies_between_cells_and_across_north() {
        let mut h = vec![1.0; 360];
        h[359] = 50.0;
        h[0] = 50.0;
        assert!(wrap(mode(&h)).abs() < 1e-6);
        h[1] = 20.0;
        assert!((0.0..0.01).contains(&wrap(mode(&h))));
    }
}
