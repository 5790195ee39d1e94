//! Range as paper O finds it, for comparison: every window by itself.
//!
//! Enters: the cepstra of a three-minute window. Leaves: presence and the one range and radial speed told. Log ratios are summed over the
//! frames along `r + v (t_m − t0)`. Then, by whose choices ([`Compatibility`]):
//!
//! - the authors' programme: for each of three branches the ratios [O 19] of that branch alone; the exponentials of the sums are
//!   smoothed over range by a Gaussian of 140 m, which forgives the table's phase; the smoothed ratios are multiplied:
//!   `l = Π_b (w * exp G_b)`. Told is the greatest likelihood; segments get the plain mean, which knows no prior;
//! - the paper's text: the ratios of the summed model [O 18, 19], as they stand. Told is the greatest posterior [O 23], whose prior
//!   goes with range [O 20], and segments get its mean [O 24].
//!
//! By both a vessel is detected where `mean_v Σ r l / Σ r > 1` [O 20, 22].
//! On the recorder's grid of 140 m × 1 m/s, not 70 m × ½ m/s. Cost: 18 M instructions a minute by the programme's choices, a third by the
//! text's; no memory of its own: this mode has no recursive posterior, and the frames a minute's scratch cannot hold lie in that one's place.

use super::interference::Interference;
use super::limits::{
    MINUTE_FRAMES, MODEL_RANGES, QUEFRENCIES, RANGE_CELLS, RANGE_MODES, RANGE_STEP_M, SPEEDS,
};
use super::presence::{DETECTION, RangeMode, RangePresence, range_of};
use super::radial::{GRID_UNIT, RadialScratch, add_shifted, coded, row_code, speed_of};
use super::shared::{Grid, Shared};
use crate::config::Compatibility;
use crate::math;
use bytemuck::{must_cast_slice, must_cast_slice_mut};

/// Branches of the paper: 13, 35, 57.
const BRANCHES: usize = 3;

/// Half the smoothing kernel, model ranges (four standard deviations).
const REACH: usize = 8;

/// Its standard deviation, model ranges (140 m).
const SMOOTH: f32 = 2.0;

/// Half the patch whose moments give the spread, cells and speeds.
const PATCH: (usize, usize) = (4, 3);

/// Memory of the recursive posterior, idle in this mode.
pub type Spare = [[u16; RANGE_CELLS]; SPEEDS];

/// Frames that can be held: those of a minute, and one in every two columns of the spare memory (22: a window at 50 Hz
/// has 18).
const FRAMES: usize = MINUTE_FRAMES + SPEEDS / 2;

/// Range and radial speed from a window's frames `(offset_s, cepstrum)`, offsets from the window's middle.
pub fn window<I, C>(
    choices: Compatibility,
    model: &Interference<'_>,
    radial: &mut RadialScratch,
    spare: &mut Spare,
    shared: &mut Shared,
    frames: I,
) -> RangePresence
where
    I: Iterator<Item = (f32, C)> + Clone,
    C: Iterator<Item = f32>,
{
    let frames = || frames.clone().take(FRAMES);
    let by_text = choices == Compatibility::Paper;
    if by_text {
        radial.clear();
        for (offset_s, cepstrum) in frames() {
            let envelope = shared.envelope();
            model.envelope(cepstrum, envelope);
            model.log_ratio(envelope, &mut radial.sum);
            store(radial, spare, offset_s);
        }
    }
    let grid = shared.grid();
    *grid = [[0; RANGE_CELLS]; SPEEDS];
    if by_text {
        for (k, cells) in grid.iter_mut().enumerate() {
            along(radial, spare, speed_of(k));
            joined_into(&radial.sum, cells);
        }
    } else {
        for branch in 0..BRANCHES.min(model.branches()) {
            radial.clear();
            for (offset_s, cepstrum) in frames() {
                let mut y = [0f32; QUEFRENCIES];
                y.iter_mut().zip(cepstrum).for_each(|(y, c)| *y = c);
                model.branch_log_ratio(branch, &y, &mut radial.sum);
                store(radial, spare, offset_s);
            }
            for (k, cells) in grid.iter_mut().enumerate() {
                along(radial, spare, speed_of(k));
                smoothed_into(&mut radial.sum, cells);
            }
        }
    }
    if radial.frames() > 0 { detect(grid, model.max_range_m(), by_text) } else { silent() }
}

/// Rows of the spare memory.
fn spare_row(n: usize) -> core::ops::Range<usize> {
    let at = n.saturating_sub(MINUTE_FRAMES) * MODEL_RANGES;
    at..at + MODEL_RANGES
}

/// Keeps the frame in `radial.sum`.
fn store(radial: &mut RadialScratch, spare: &mut Spare, offset_s: f32) {
    let n = radial.frames;
    let row = match radial.rows.get_mut(n) {
        Some(row) => &mut row[..],
        None => {
            let spare: &mut [i16] = must_cast_slice_mut(spare.as_flattened_mut());
            spare.get_mut(spare_row(n)).unwrap_or_default()
        }
    };
    row.iter_mut().zip(&radial.sum).for_each(|(r, g)| *r = row_code(*g));
    radial.window_offset_s.iter_mut().skip(n).take(1).for_each(|t| *t = offset_s);
    radial.frames += 1;
}

/// Sum over the frames for a radial speed, at every model range, in `radial.sum`.
fn along(radial: &mut RadialScratch, spare: &Spare, speed_m_s: f32) {
    radial.sum = [0.0; MODEL_RANGES];
    let spare: &[i16] = must_cast_slice(spare.as_flattened());
    for (n, offset_s) in radial.window_offset_s.iter().enumerate().take(radial.frames) {
        let row = match radial.rows.get(n) {
            Some(row) => &row[..],
            None => spare.get(spare_row(n)).unwrap_or_default(),
        };
        add_shifted(row, speed_m_s * offset_s / RANGE_STEP_M, &mut radial.sum);
    }
}

/// Writes the logarithm of the mean ratio of a cell's two model ranges to its place in the grid.
fn joined_into(g: &[f32; MODEL_RANGES], cells: &mut [i16; RANGE_CELLS]) {
    for (cell, [a, b]) in cells.iter_mut().zip(g.as_chunks::<2>().0) {
        let (most, least) = (a.max(*b), a.min(*b));
        let both = 0.5 * (1.0 + math::f32::exp((least - most).max(-80.0)));
        *cell = coded(most + math::f32::ln(both));
    }
}

/// Adds `ln(w * exp G)` in the middle of each cell to its place in the grid; `g` is used up.
fn smoothed_into(g: &mut [f32; MODEL_RANGES], cells: &mut [i16; RANGE_CELLS]) {
    let top = g.iter().fold(f32::NEG_INFINITY, |a, b| a.max(*b));
    g.iter_mut().for_each(|g| *g = math::f32::exp((*g - top).max(-80.0)));
    // A cell's middle lies between its two model ranges: the mean of the kernels about either.
    let kernel: [f32; 2 * REACH + 2] = core::array::from_fn(|d| {
        let weight = |d: isize| {
            let x = d as f32 / SMOOTH;
            if d.unsigned_abs() <= REACH { math::f32::exp(-0.5 * x * x) } else { 0.0 }
        };
        let d = d as isize - REACH as isize;
        weight(d) + weight(d - 1)
    });
    let total: f32 = kernel.iter().sum();
    // Ranges beyond either end are those before it, reflected.
    let at = |j: isize| {
        let j = if j < 0 { -1 - j } else { j } as usize;
        let j = if j < MODEL_RANGES { j } else { (2 * MODEL_RANGES - 1).saturating_sub(j) };
        g.get(j).copied().unwrap_or(0.0)
    };
    for (i, cell) in cells.iter_mut().enumerate() {
        let from = 2 * i as isize - REACH as isize;
        let sum: f32 = kernel.iter().enumerate().map(|(d, w)| w * at(from + d as isize)).sum();
        *cell = coded(f32::from(*cell) * GRID_UNIT + math::f32::ln((sum / total).max(1e-35)) + top);
    }
}

/// Nothing to hear.
fn silent() -> RangePresence {
    RangePresence { log_odds: -12.0, log_evidence: 0.0, approaching: 0.5, modes: [None; RANGE_MODES] }
}

/// Presence, and the place of greatest likelihood, or of greatest posterior.
fn detect(grid: &Grid, max_range_m: f32, by_posterior: bool) -> RangePresence {
    let cells = grid.iter().enumerate().flat_map(|(k, row)| {
        row.iter()
            .enumerate()
            .map(move |(i, l)| (k, i, f32::from(*l) * GRID_UNIT))
            .filter(move |(_, i, _)| range_of(*i) <= max_range_m)
    });
    // What is weighed, not normalised: the likelihood, or it with the prior.
    let prior = |i: usize| if by_posterior { range_of(i) } else { 1.0 };
    let weighed = |i: usize, l: f32| if by_posterior { l + math::f32::ln(range_of(i)) } else { l };
    let (k0, i0, support, top) = cells.clone().fold((0, 0, 0.0, f32::NEG_INFINITY), |best, (k, i, l)| {
        let weight = weighed(i, l);
        if weight > best.3 { (k, i, l, weight) } else { best }
    });
    if !top.is_finite() {
        return silent();
    }
    let (mut all, mut priors, mut by_range, mut ranges, mut approaching) = (0f32, 0f32, 0f32, 0f32, 0f32);
    let (mut n, mut r, mut rr, mut v, mut vv) = (0f32, 0f32, 0f32, 0f32, 0f32);
    for (k, i, l) in cells {
        let (p, range_m) = (math::f32::exp((weighed(i, l) - top).max(-80.0)), range_of(i));
        all += p;
        priors += prior(i);
        by_range += p / prior(i) * range_m;
        ranges += range_m;
        if k < SPEEDS / 2 {
            approaching += p;
        }
        if i.abs_diff(i0) <= PATCH.0 && k.abs_diff(k0) <= PATCH.1 {
            let (dr, dv) = (range_m - range_of(i0), speed_of(k) - speed_of(k0));
            n += p;
            r += p * dr;
            rr += p * dr * dr;
            v += p * dv;
            vv += p * dv * dv;
        }
    }
    let (dr, dv) = (r / n, v / n);
    let log_odds = top + math::f32::ln(by_range / ranges);
    // About the place that is told; the grid itself spreads by a twelfth of a step².
    let step = range_of(1) - range_of(0);
    let mode = RangeMode {
        range_m: range_of(i0),
        sd_range_m: math::f32::sqrt((rr / n - dr * dr).max(0.0) + dr * dr + step * step / 12.0),
        speed_m_s: speed_of(k0),
        sd_speed_m_s: math::f32::sqrt((vv / n - dv * dv).max(0.0) + dv * dv + 1.0 / 12.0),
        weight: (n / all).min(1.0),
        support,
        detected: log_odds > 0.0,
        tracked: false,
        sure: true,
    };
    RangePresence {
        log_odds,
        log_evidence: math::f32::ln(
            1.0 - DETECTION + DETECTION * math::f32::exp((top + math::f32::ln(all / priors)).min(20.0)),
        ),
        approaching: approaching / all,
        modes: core::array::from_fn(|m| (m == 0).then_some(mode)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::f64 as m;
    use crate::obs::cepstrum::noise_sd;
    use crate::obs::radial::cubic;
    use crate::obs::table::{Table, blob_bytes};
    use crate::obs::table_encode::{BranchColumns, Header, encode};
    use std::boxed::Box;
    use std::vec;
    use std::vec::Vec;

    const HEADER: Header = Header { step_m: 70.0, f0_hz: 16.5, width_s: 0.05 };

    /// Delay, phase and strength of a branch at a range: image paths under 1500 m/s at 4340 m.
    fn branch(b: usize, range_m: f64) -> (f64, f64, f64) {
        let slant = |n: f64| m::hypot(range_m, 4340.0 * n) / 1500.0;
        let b = b as f64;
        (slant(2.0 * b + 3.0) - slant(2.0 * b + 1.0), 0.7 + b, 0.05 - 0.01 * b)
    }

    fn table() -> Vec<u8> {
        let columns = |b: usize| {
            let rows: Vec<_> = (0..716).map(|j| branch(b, 70.0 * f64::from(j))).collect();
            let part = |f: fn(&(f64, f64, f64)) -> f64| rows.iter().map(|x| f(x) as f32).collect::<Vec<_>>();
            (part(|x| x.0), part(|x| x.1), part(|x| x.2))
        };
        let all = [columns(0), columns(1)];
        let columns = all.each_ref().map(|(d, p, s)| BranchColumns { delay_s: d, phase_rad: p, strength: s });
        let mut blob = vec![0; blob_bytes(2)];
        encode(&HEADER, 50.0, &[1.0; 716], &columns, &mut blob).unwrap();
        blob
    }

    fn mu(b: usize, range_m: f64, q: f64) -> f64 {
        let (tau, phase, a) = branch(b, range_m);
        let x = (q - tau) / 0.05;
        if m::abs(x) > 3.0 { 0.0 } else { a * m::cos(m::TAU * 16.5 * (q - tau) - phase) * m::exp(-x * x) }
    }

    /// Frames of noise with a vessel 21 km away that leaves at 6 m/s.
    fn frames(strength: f64) -> Vec<(f32, [f32; QUEFRENCIES])> {
        let mut seed = 11u32;
        let mut noise = || {
            let mut sum = 0.0;
            for _ in 0..6 {
                seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                sum += f64::from(seed >> 8) / 8_388_608.0 - 1.0;
            }
            sum / 1.414
        };
        (0..14)
            .map(|f| {
                let t = -66.0 + 10.24 * f64::from(f);
                let c = core::array::from_fn(|k| {
                    let (q, range_m) = (k as f64 / 50.0, 21_000.0 + 6.0 * t);
                    let vessel = mu(0, range_m, q) + mu(1, range_m, q);
                    (f64::from(noise_sd(k)) * noise() + strength * vessel) as f32
                });
                (t as f32, c)
            })
            .collect()
    }

    fn run(choices: Compatibility, frames: &[(f32, [f32; QUEFRENCIES])]) -> (RangePresence, Box<Grid>) {
        let (table, mut radial) = (table(), Box::new(RadialScratch::new()));
        let model = Interference::new(&Table::parse(&table).unwrap());
        let mut spare = Box::new([[7u16; RANGE_CELLS]; SPEEDS]);
        let mut shared = Box::new(Shared::new());
        let input = frames.iter().map(|(t, c)| (*t, c.iter().copied()));
        let out = window(choices, &model, &mut radial, &mut spare, &mut shared, input);
        (out, Box::new(*shared.grid()))
    }

    /// The log ratio [O 19] of a model that is the sum of some branches, along a radial speed from model range `j`.
    fn log_ratio(frames: &[(f32, [f32; QUEFRENCIES])], of: &[usize], j: isize, speed_m_s: f64) -> f64 {
        let g = |j: isize, c: &[f32; QUEFRENCIES]| {
            let range_m = 70.0 * j as f64;
            let terms = c.iter().enumerate().map(|(k, c)| {
                let all = of.iter().map(|b| mu(*b, range_m, k as f64 / 50.0)).sum::<f64>();
                let sd = f64::from(noise_sd(k));
                all / (sd * sd) * (f64::from(*c) - 0.5 * all)
            });
            terms.sum::<f64>()
        };
        let along = frames.iter().map(|(t, c)| {
            let shift = speed_m_s * f64::from(*t) / 70.0;
            let whole = m::floor(shift);
            let w = cubic((shift - whole) as f32);
            let reads = (0..4).map(|k| f64::from(w[k as usize]) * g(j + whole as isize - 1 + k, c));
            reads.sum::<f64>()
        });
        along.sum::<f64>()
    }

    /// The programme's likelihood at one cell, written out.
    fn programme(frames: &[(f32, [f32; QUEFRENCIES])], i: usize, speed_m_s: f64) -> f64 {
        let sum = |b: usize, j: isize| log_ratio(frames, &[b], j, speed_m_s);
        let smoothed = |j: isize, all: &[f64], from: isize| {
            let weight = |d: isize| m::exp(-0.125 * (d * d) as f64);
            let norm: f64 = (-8..=8).map(weight).sum();
            (-8..=8).map(|d| weight(d) / norm * m::exp(all[(j + d - from) as usize])).sum::<f64>()
        };
        let j = 2 * i as isize;
        let one = |b: usize| {
            let from = j - 8;
            let all: Vec<f64> = (from..=j + 9).map(|j| sum(b, j)).collect();
            m::ln(0.5 * (smoothed(j, &all, from) + smoothed(j + 1, &all, from)))
        };
        one(0) + one(1)
    }

    /// The text's [O 18, 19].
    fn text(frames: &[(f32, [f32; QUEFRENCIES])], i: usize, speed_m_s: f64) -> f64 {
        let at = |j: usize| m::exp(log_ratio(frames, &[0, 1], j as isize, speed_m_s));
        m::ln(0.5 * (at(2 * i) + at(2 * i + 1)))
    }

    #[test]
    fn the_grid_is_the_formula() {
        type Formula = fn(&[(f32, [f32; QUEFRENCIES])], usize, f64) -> f64;
        let frames = frames(1.0);
        let both: [(_, Formula); 2] = [(Compatibility::Programme, programme), (Compatibility::Paper, text)];
        for (choices, formula) in both {
            let (_, grid) = run(choices, &frames);
            for (i, k) in [(150, 19), (150, 13), (151, 19), (100, 5), (260, 25), (60, 0)] {
                let have = f64::from(f32::from(grid[k][i]) * GRID_UNIT);
                let want = formula(&frames, i, f64::from(speed_of(k)));
                assert!((have - want).abs() < 0.15 + 0.02 * want.abs(), "{choices:?} {i} {k}: {have} {want}");
            }
        }
    }

    #[test]
    fn a_vessel_is_found_and_noise_is_not() {
        for choices in [Compatibility::Programme, Compatibility::Paper] {
            let (seen, _) = run(choices, &frames(1.0));
            let mode = seen.modes[0].unwrap();
            assert!(seen.log_odds > 10.0, "{seen:?}");
            assert!(
                (mode.range_m - 21_000.0).abs() < 300.0 && (mode.speed_m_s - 6.0).abs() <= 1.0,
                "{mode:?}"
            );
            assert!(mode.sd_range_m > 40.0 && seen.approaching < 0.1 && seen.modes[1].is_none());
            let (quiet, _) = run(choices, &frames(0.0));
            assert!(quiet.log_odds < 0.0, "{quiet:?}");
            assert_eq!(run(choices, &[]).0.modes, [None; RANGE_MODES]);
        }
    }

    #[test]
    fn what_is_told_is_the_greatest_likelihood_or_the_greatest_posterior() {
        // As likely at 7 km as at 42 km, but for a unit of the grid: six times the prior.
        let mut grid = Box::new([[-2000; RANGE_CELLS]; SPEEDS]);
        (grid[10][50], grid[10][300]) = (321, 320);
        let told = |by_posterior| detect(&grid, 50_000.0, by_posterior).modes[0].unwrap();
        assert_eq!([told(false), told(true)].map(|m| m.range_m), [range_of(50), range_of(300)]);
        assert_eq!([told(false), told(true)].map(|m| m.support), [321.0 * GRID_UNIT, 320.0 * GRID_UNIT]);
        let both = [false, true].map(|by_posterior| detect(&grid, 50_000.0, by_posterior).log_odds);
        assert!((both[0] - both[1]).abs() < 1e-3, "the same detection: {both:?}");
    }
}
