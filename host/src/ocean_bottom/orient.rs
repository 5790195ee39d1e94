//! Orientation of an ocean-bottom station from vessels of known track.
//!
//! On each passage the mode of the differences between the azimuths measured in the tone band and the azimuth of the
//! vessel; the mode of all and the scatter of the passages' modes give the value and its uncertainty. Assumes one vessel
//! at a time near the station, and the station's place known ([`super::place`]).

use super::place::{Travel, USED_M, alone, heard};
use super::stages::SpectralFrame;
use crate::course::{EastNorth, VesselCourse, polar};
use seabearing_core::angle::wrap_pi;
use std::f64::consts::TAU;

/// Cells of the histogram of azimuth differences, and standard deviation of its smoothing in cells of one degree.
const CELLS: usize = 360;
const SMOOTHING: f64 = 2.0;

/// Fewest frames of a passage that count.
const LEAST_FRAMES: usize = 30;

/// The correction to add to the orientation that frames were computed with.
#[derive(Clone, Debug, PartialEq)]
pub struct ModeOfTurns {
    /// Correction, rad.
    pub correction: f64,
    /// Its standard deviation, rad: the scatter of passages, or of half hours where there is one passage.
    pub sd: f64,
    /// Correction of each passage (or half hour), rad.
    pub each: Vec<f64>,
    /// Passages used.
    pub passages: usize,
}

/// The orientation, with the station at an offset from where courses are counted; `None` where no passage is usable.
pub fn orientation(
    frames: &[SpectralFrame],
    courses: &[VesselCourse],
    travel: &Travel<'_>,
    offset: EastNorth,
    tones: std::ops::Range<usize>,
) -> Option<ModeOfTurns> {
    // Histogram of differences per passage, and per half hour of each.
    let mut passages = vec![vec![0f64; CELLS]; courses.len()];
    let mut counts = vec![0usize; courses.len()];
    let mut parts: std::collections::BTreeMap<(usize, u64), (Vec<f64>, usize)> = Default::default();
    for f in frames {
        let Some((n, course)) = alone(courses, f.t_s) else { continue };
        let Some((range, azimuth)) = heard(travel, course, f.t_s, offset).map(polar) else { continue };
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
    let passages = good.len();
    let each = match passages {
        0 => return None,
        1 => parts.values().filter(|p| p.1 >= LEAST_FRAMES).map(|p| mode(&p.0)).collect(),
        _ => good,
    };
    let correction = mode(&sum);
    let n = each.len() as f64;
    let scatter = each.iter().map(|x| wrap_pi(x - correction).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    let sd = if each.len() > 1 { (scatter / n).sqrt() } else { f64::INFINITY };
    Some(ModeOfTurns {
        correction: wrap_pi(correction),
        sd,
        each: each.into_iter().map(wrap_pi).collect(),
        passages,
    })
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
        assert!(wrap_pi(mode(&h)).abs() < 1e-6);
        h[1] = 20.0;
        assert!((0.0..0.01).contains(&wrap_pi(mode(&h))));
    }
}
