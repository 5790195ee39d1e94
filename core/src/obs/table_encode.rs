//! Writing a propagation table: from delay, phase and strength against range to the bytes the recorder reads in place.
//!
//! Enters: columns over equal steps of range from 0, NaN where a branch does not exist. Leaves: the bytes of
//! [`super::table`]. This is work of the host, done once a station; it uses the core's own float shim, so the bytes are
//! the same wherever they are made.

use super::cepstrum::noise_sd;
use super::limits::{FINE, MODEL_RANGES, QUEFRENCIES, RANGE_STEP_M};
use super::table::{
    DELAY_UNIT_S, FAR_RANGES, FAR_STEP_M, HALF, KERNEL, KNOT_M, KNOTS, MAGIC, MAX_BRANCHES, PARTS, Pulse,
    STRENGTH_UNIT, Table, TableError, VERSION, blob_bytes,
};
use crate::angle::wrap_pi_f32;
use crate::math;
use crate::wire::hash::fnv1a;

/// Delays shorter than this (s) lie under the spectrum's smooth shape and are left out.
const SHORTEST_DELAY_S: f32 = 0.25;

/// Speed of sound beyond the table, m/s.
const BEYOND_M_S: f32 = 1500.0;

/// Widths of the pulse within half the kernel, at least: it is cut where less than a two-thousandth of it is left.
const LEAST_WIDTHS: f32 = 2.8;

/// One interference against range. All slices have the table's number of ranges; NaN = no such branch.
#[derive(Clone, Copy, Debug)]
pub struct BranchColumns<'a> {
    /// Delay between the two paths, s.
    pub delay_s: &'a [f32],
    /// Phase of the later path against the earlier in the convention of [`super::table`]'s formula, rad.
    pub phase_rad: &'a [f32],
    /// Height of the cepstral pulse, 0 to 1.
    pub strength: &'a [f32],
}

/// What a propagation says that is not a column.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Header {
    /// Distance between two ranges, m; the first is 0.
    pub step_m: f32,
    /// Centre frequency f0 of a vessel's wideband noise, Hz (RR03: 16.5).
    pub f0_hz: f32,
    /// Width Δτ of the pulse, s (RR03: 0.05).
    pub width_s: f32,
}

/// Writes the table for transforms at `rate_hz` into `out`; the bytes used.
///
/// # Errors
/// [`TableError::Size`] for unlike slices or too many of them, [`TableError::Length`] if `out` is too short,
/// [`TableError::Width`] for a pulse the detector cannot hold, [`TableError::Value`] for values no table may hold.
pub fn encode(
    header: &Header,
    rate_hz: f32,
    travel_time_s: &[f32],
    branches: &[BranchColumns<'_>],
    out: &mut [u8],
) -> Result<usize, TableError> {
    let source = Source { header, rate_hz, travel_time_s, branches };
    source.check()?;
    let wanted = blob_bytes(branches.len());
    let out = out.get_mut(..wanted).ok_or(TableError::Length(wanted))?;
    let (body, tail) = out.split_last_chunk_mut::<8>().ok_or(TableError::Length(wanted))?;
    let far_delays = (0..branches.len()).flat_map(|b| (0..FAR_RANGES).map(move |j| (b, j)));
    let pulses = (0..branches.len()).flat_map(|b| (0..MODEL_RANGES).map(move |j| (b, j)));
    let floats = [rate_hz, header.step_m * (travel_time_s.len() - 1) as f32].into_iter();
    let bytes = MAGIC
        .into_iter()
        .chain(VERSION.to_le_bytes())
        .chain((branches.len() as u16).to_le_bytes())
        .chain(floats.chain(source.travel_times()).flat_map(f32::to_le_bytes))
        .chain(far_delays.flat_map(|(b, j)| source.far_delay(b, j).to_le_bytes()))
        .chain((0..KERNEL).flat_map(|d| source.kernel(d)).flat_map(f32::to_le_bytes))
        .chain((0..QUEFRENCIES).flat_map(|k| source.weight(k)).flat_map(f32::to_le_bytes))
        .chain((0..MODEL_RANGES).flat_map(|j| (0.5 * source.energy(j)).to_le_bytes()))
        .chain(pulses.flat_map(|(b, j)| source.pulse(b, j).bytes()));
    body.iter_mut().zip(bytes).for_each(|(slot, byte)| *slot = byte);
    *tail = fnv1a(body).to_le_bytes();
    Table::parse(out)?;
    Ok(wanted)
}

struct Source<'a> {
    header: &'a Header,
    rate_hz: f32,
    travel_time_s: &'a [f32],
    branches: &'a [BranchColumns<'a>],
}

impl Source<'_> {
    fn check(&self) -> Result<(), TableError> {
        let ranges = self.travel_time_s.len();
        let same =
            |c: &BranchColumns<'_>| [c.delay_s, c.phase_rad, c.strength].iter().all(|s| s.len() == ranges);
        let sized = (1..=MAX_BRANCHES).contains(&self.branches.len()) && ranges >= 2;
        if !sized || !self.branches.iter().all(same) {
            return Err(TableError::Size);
        }
        let h = self.header;
        let positive = [h.step_m, h.f0_hz, h.width_s, self.rate_hz].iter().all(|x| x.is_finite() && *x > 0.0);
        // NaN marks a missing branch: only a present value can be wrong.
        let fits = |x: &f32, most: f32| x.is_nan() || (0.0..=most).contains(x);
        let possible = |c: &BranchColumns<'_>| {
            c.delay_s.iter().all(|x| fits(x, 100.0))
                && c.strength.iter().all(|x| fits(x, 1.0))
                && !c.phase_rad.iter().any(|x| x.is_infinite())
        };
        if !positive
            || !self.travel_time_s.iter().all(|x| fits(x, 900.0))
            || !self.branches.iter().all(possible)
        {
            return Err(TableError::Value);
        }
        let widest = HALF as f32 / LEAST_WIDTHS / self.rate_hz;
        if h.width_s > widest { Err(TableError::Width(h.width_s, widest)) } else { Ok(()) }
    }

    /// Place of a range between two rows: the lower row and the part of a step above it.
    fn place(&self, range_m: f32) -> Option<(usize, f32)> {
        let ranges = self.travel_time_s.len();
        let x = range_m / self.header.step_m;
        if !(x >= 0.0 && x <= (ranges - 1) as f32) {
            return None;
        }
        let j = (x as usize).min(ranges - 2);
        Some((j, x - j as f32))
    }

    /// Delay (s), phase (rad) and strength of a branch at a range, linear between rows (the phase the short way
    /// round); `None` where the branch does not exist.
    fn branch(&self, branch: usize, range_m: f32) -> Option<(f32, f32, f32)> {
        let c = self.branches.get(branch)?;
        let (j, part) = self.place(range_m)?;
        let line = |s: &[f32]| blend(*s.get(j)?, *s.get(j + 1)?, part);
        let phase = *c.phase_rad.get(j)?;
        let turn = wrap_pi_f32(*c.phase_rad.get(j + 1)? - phase);
        Some((line(c.delay_s)?, blend(phase, phase + turn, part)?, line(c.strength)?))
    }

    /// Travel time of the first arrival at every knot, s; where the propagation is silent, straight on.
    fn travel_times(&self) -> impl Iterator<Item = f32> + '_ {
        let at = |range_m: f32| {
            let (j, part) = self.place(range_m)?;
            blend(*self.travel_time_s.get(j)?, *self.travel_time_s.get(j + 1)?, part)
        };
        // The first row is often empty: the overhead time then comes from its nearest neighbour.
        let step_m = self.header.step_m;
        let overhead = (0..self.travel_time_s.len()).find_map(|j| at(step_m * j as f32)).unwrap_or(0.0);
        (0..KNOTS).scan(overhead, move |last, k| {
            let known = at(KNOT_M * k as f32);
            *last = known.unwrap_or(if k == 0 { overhead } else { *last + KNOT_M / BEYOND_M_S });
            Some(*last)
        })
    }

    fn far_delay(&self, branch: usize, j: usize) -> u16 {
        self.branch(branch, FAR_STEP_M * j as f32)
            .map_or(0, |(delay_s, ..)| math::f32::round(delay_s / DELAY_UNIT_S).clamp(0.0, 65_535.0) as u16)
    }

    /// The pulse's Gaussian, `d − HALF` quefrencies from each fine delay.
    fn kernel(&self, d: usize) -> [f32; FINE] {
        core::array::from_fn(|s| {
            let q = (d as f32 - HALF as f32 - s as f32 / FINE as f32) / self.rate_hz / self.header.width_s;
            if q.abs() < 3.0 { math::f32::exp(-q * q) } else { 0.0 }
        })
    }

    /// Carrier and inverse variance of a quefrency.
    fn weight(&self, k: usize) -> [f32; 3] {
        let turn = math::f32::TAU * self.header.f0_hz * k as f32 / self.rate_hz;
        [math::f32::cos(turn), math::f32::sin(turn), inverse_variance(k)]
    }

    fn pulse(&self, branch: usize, j: usize) -> Pulse {
        let longest = (QUEFRENCIES - 2 * HALF) as f32 / self.rate_hz;
        match self.branch(branch, RANGE_STEP_M * j as f32) {
            Some((delay_s, phase, strength)) if (SHORTEST_DELAY_S..=longest).contains(&delay_s) => {
                let angle = math::f32::TAU * self.header.f0_hz * delay_s + phase;
                let code = |x: f32| (strength.min(0.99) * x / STRENGTH_UNIT) as i16;
                Pulse {
                    delay: math::f32::round(delay_s * self.rate_hz * (FINE * PARTS) as f32) as u16,
                    re: code(math::f32::cos(angle)),
                    im: code(math::f32::sin(angle)),
                }
            }
            _ => Pulse::NONE,
        }
    }

    /// `Σ_q μ²/σ²` at model range `j`, all branches summed before squaring.
    fn energy(&self, j: usize) -> f32 {
        let pulses: [Pulse; MAX_BRANCHES] = core::array::from_fn(|b| self.pulse(b, j));
        let present = || pulses.iter().filter(|p| p.delay > 0);
        let mut total = 0.0;
        for p in present() {
            let first = (p.centre() as usize).saturating_sub(HALF);
            for k in first..first + 2 * HALF + 2 {
                // Every pair is met twice, once from either pulse.
                let all: f32 = present().map(|p| self.mu(*p, k)).sum();
                total += self.mu(*p, k) * all * inverse_variance(k);
            }
        }
        total.max(0.0)
    }

    /// A pulse's value at quefrency index `k`.
    fn mu(&self, p: Pulse, k: usize) -> f32 {
        let q = k as f32 / self.rate_hz;
        let x = (q - p.centre() / self.rate_hz) / self.header.width_s;
        if x.abs() >= 3.0 {
            return 0.0;
        }
        let turn = math::f32::TAU * self.header.f0_hz * q;
        let (re, im) = (f32::from(p.re) * STRENGTH_UNIT, f32::from(p.im) * STRENGTH_UNIT);
        (re * math::f32::cos(turn) + im * math::f32::sin(turn)) * math::f32::exp(-x * x)
    }
}

fn inverse_variance(k: usize) -> f32 {
    if k < QUEFRENCIES { 1.0 / (noise_sd(k) * noise_sd(k)) } else { 0.0 }
}

/// Linear between two values; `None` unless those that count are finite.
fn blend(a: f32, b: f32, part: f32) -> Option<f32> {
    let x = if part == 0.0 { a } else { a + (b - a) * part };
    x.is_finite().then_some(x)
}

/// A small table: one branch that begins at 70 m.
#[cfg(test)]
pub(super) fn example(rate_hz: f32) -> std::vec::Vec<u8> {
    let delay: std::vec::Vec<f32> =
        (0..300).map(|j| if j == 0 { f32::NAN } else { 5.0 - 0.01 * j as f32 }).collect();
    let (phase, strength, toa) = ([0.5; 300], [0.05; 300], delay.iter().map(|d| 8.0 - d));
    let c = BranchColumns { delay_s: &delay, phase_rad: &phase, strength: &strength };
    let h = Header { step_m: 70.0, f0_hz: 16.5, width_s: 0.05 };
    let mut out = std::vec![0; blob_bytes(1)];
    let toa: std::vec::Vec<f32> = toa.collect();
    assert_eq!(encode(&h, rate_hz, &toa, &[c], &mut out), Ok(out.len()));
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec;
    use std::vec::Vec;

    #[test]
    fn what_was_written_is_read_between_rows_and_beyond_the_end() {
        let bytes = example(50.0);
        let t = Table::parse(&bytes).unwrap();
        assert_eq!((t.branches(), t.rate_hz(), t.max_range_m()), (1, 50.0, 70.0 * 299.0));
        let toa: Vec<f32> = t.travel_times_s().collect();
        // Overhead from the first row that is there; 7 km is row 100; beyond the last row on at 1500 m/s.
        assert!((toa[0] - 3.01).abs() < 1e-5 && (toa[7] - 4.0).abs() < 1e-5, "{toa:?}");
        assert!((toa[30] - toa[20] - 10_000.0 / 1500.0).abs() < 1e-3, "{toa:?}");
        assert!(t.delay_s(0, 100.0).is_none() && t.delay_s(1, 5000.0).is_none());
        assert!((t.delay_s(0, 7100.0).unwrap() - (5.0 - 0.01 * 7100.0 / 70.0)).abs() < 1e-4);
        let pulses: Vec<Pulse> = t.pulses(0).collect();
        assert_eq!((pulses.len(), pulses[0], pulses[300]), (MODEL_RANGES, Pulse::NONE, Pulse::NONE));
        assert!((pulses[100].centre() - 200.0).abs() < 0.01, "{:?}", pulses[100]);
        let angle = math::f32::TAU * 16.5 * 4.0 + 0.5;
        let strength = 0.05 / STRENGTH_UNIT;
        assert!((f32::from(pulses[100].re) - strength * math::f32::cos(angle)).abs() < 2.0);
        assert!((f32::from(pulses[100].im) - strength * math::f32::sin(angle)).abs() < 2.0);
        assert_eq!(t.pulses(1).count(), 0);
    }

    #[test]
    fn impossible_values_are_refused() {
        let (h, x) = (Header { step_m: 70.0, f0_hz: 16.5, width_s: 0.05 }, [1.0f32, 1.0]);
        let mut out = vec![0; blob_bytes(1)];
        let bad = BranchColumns { delay_s: &[-1.0, 1.0], phase_rad: &x, strength: &x };
        assert_eq!(encode(&h, 50.0, &x, &[bad], &mut out), Err(TableError::Value));
        let good = BranchColumns { delay_s: &x, phase_rad: &x, strength: &x };
        assert_eq!(encode(&h, 50.0, &x, &[good], &mut out[..20]), Err(TableError::Length(blob_bytes(1))));
        assert_eq!(encode(&Header { step_m: 0.0, ..h }, 50.0, &x, &[good], &mut out), Err(TableError::Value));
        assert_eq!(encode(&h, 50.0, &x[..1], &[good], &mut out), Err(TableError::Size));
    }

    #[test]
    fn a_pulse_wider_than_the_detector_s_is_refused() {
        let (h, x) = (Header { step_m: 70.0, f0_hz: 16.5, width_s: 0.05 }, [1.0f32, 1.0]);
        let mut out = vec![0; blob_bytes(1)];
        let c = BranchColumns { delay_s: &x, phase_rad: &x, strength: &x };
        assert!(encode(&h, 62.5, &x, &[c], &mut out).is_ok());
        let wide = Header { width_s: 0.06, ..h };
        assert!(encode(&wide, 50.0, &x, &[c], &mut out).is_ok());
        assert!(matches!(encode(&wide, 62.5, &x, &[c], &mut out), Err(TableError::Width(..))));
    }
}
