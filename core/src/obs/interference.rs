//! The interference model: the log-likelihood ratio of a vessel at each range, from one cepstrum.
//!
//! Enters: a clutter-filtered cepstrum y. Leaves, for each model range r, `Σ_q μ(r,q)/σ²(q) · (y(q) − μ(r,q)/2)`
//! [O 19] with μ the sum of all branches [O 17], cross terms included. The second term does not depend on data and
//! stands in the table. The first is linear in y: one complex envelope Z(τ), the correlation of y/σ² with a pulse at
//! delay τ, is computed on a fine grid of delays and read by every branch at every range:
//! `a Re(exp(−i(2π f0 τ + φ)) Z(τ))`. Cost: 90 k instructions a cepstrum; the tables stay where the blob is.

use super::limits::{FINE, MODEL_RANGES, QUEFRENCIES, RANGE_STEP_M};
use super::shared::Envelope;
use super::table::{HALF, KERNEL, PARTS, Pulse, STRENGTH_UNIT, Table, three};
use super::travel::RR03_S;
use crate::math;

/// Delays closer than this draw pulses that cannot be told apart, s.
const SAME_DELAY_S: f32 = 0.07;

/// Share of a vessel's modelled energy that, drawn by another vessel, makes it doubtful.
const SHARED_ENERGY: f32 = 0.1;

/// How long before and after a moment an echo must keep to a known vessel's to be that vessel's, s: in 5 minutes speeds that differ by
/// 2 m/s part a pair's delays by [`SAME_DELAY_S`] at 20 km.
const ALONG_S: f32 = 300.0;

/// Radial speed by which what moves along with an echo may differ from what its range makes of the vessel's, m/s: twice that which parts
/// delays within [`ALONG_S`].
const ALONG_M_S: f32 = 4.0;

/// Ranges closer than this are one place, m.
const SAME_PLACE_M: f32 = 1500.0;

/// The model.
#[derive(Clone, Copy, Debug)]
pub struct Interference<'t> {
    table: Option<Table<'t>>,
    /// First quefrency with a pulse, and how many there are to the last.
    span: (usize, usize),
}

/// Pulses read together: a desktop processor computes four at once.
const TOGETHER: usize = if cfg!(target_arch = "arm") { 1 } else { 4 };
const _: () = assert!(MODEL_RANGES.is_multiple_of(TOGETHER));

/// Adds the projections of an envelope on pulses; nothing of those that are none.
#[inline(always)]
fn add_along(envelope: &Envelope, pulses: &[[u8; 6]; TOGETHER], sums: &mut [f32; TOGETHER]) {
    let pulses = pulses.map(Pulse::read);
    let near = pulses.map(|p| {
        let near = envelope.z.get(usize::from(p.delay) / PARTS..).and_then(|z| z.first_chunk::<2>());
        near.filter(|_| p.delay > 0).copied().unwrap_or_default()
    });
    let part = pulses.map(|p| f32::from(p.delay % PARTS as u16) * (1.0 / PARTS as f32));
    let read = |of: usize| -> [f32; TOGETHER] {
        core::array::from_fn(|k| near[k][0][of] + (near[k][1][of] - near[k][0][of]) * part[k])
    };
    let (re, im) = (read(0), read(1));
    *sums = core::array::from_fn(|k| {
        sums[k] + STRENGTH_UNIT * (f32::from(pulses[k].re) * re[k] + f32::from(pulses[k].im) * im[k])
    });
}

/// Whether the pulse that a branch draws at the first ranges lies on one pulse of a vessel at the second ones, at all pairs of them.
// Wanted twice, and large.
#[inline(never)]
fn is_drawn(table: &Table<'_>, branch: usize, ranges: &[(f32, f32)]) -> bool {
    let mut delays = ranges.iter().map(|(range_m, known_m)| (table.delay_s(branch, *range_m), *known_m));
    // The first pair of ranges tells most that are not the same.
    let Some((Some(first), known_m)) = delays.next() else { return false };
    (0..table.branches()).any(|of| {
        let near = |known_m: f32, delay: f32| {
            let known = table.delay_s(of, known_m);
            known.is_some_and(|d| math::f32::abs(d - delay) < SAME_DELAY_S)
        };
        near(known_m, first) && delays.clone().all(|(delay, known_m)| delay.is_some_and(|d| near(known_m, d)))
    })
}

impl<'t> Interference<'t> {
    /// Nothing known; all zeros.
    pub const EMPTY: Self = Self { table: None, span: (0, 0) };

    /// Of a table, read where it is.
    pub fn new(table: &Table<'t>) -> Self {
        let drawn = || {
            let pulses = (0..table.branches()).flat_map(|b| table.pulses(b));
            pulses.map(|p| usize::from(p.delay) / (FINE * PARTS)).filter(|k| *k > 0)
        };
        let (first, last) = (drawn().min().unwrap_or(0).max(HALF), drawn().max().unwrap_or(0));
        Self { table: Some(*table), span: (first, (last + 2).saturating_sub(first)) }
    }

    /// Farthest range modelled, m.
    pub fn max_range_m(&self) -> f32 {
        let most = RANGE_STEP_M * (MODEL_RANGES - 1) as f32;
        self.table.as_ref().map_or(0.0, |t| t.max_range_m().min(most))
    }

    /// As [`super::travel::TravelTime::depth_ratio`]; 1 without a table.
    pub(super) fn depth_ratio(&self) -> f32 {
        let straight_up_s = self.table.as_ref().and_then(|t| t.travel_times_s().next());
        straight_up_s.map_or(1.0, |up_s| up_s / RR03_S as f32)
    }

    /// Number of branches.
    pub fn branches(&self) -> usize {
        self.table.as_ref().map_or(0, Table::branches)
    }

    /// Adds the power of the envelope where a branch draws its pulse, at the model ranges from number `first` on.
    pub(super) fn powers(&self, envelope: &Envelope, branch: usize, first: usize, out: &mut [f32]) {
        let Some(table) = &self.table else { return };
        for (power, p) in out.iter_mut().zip(table.pulses(branch).skip(first)) {
            let z = envelope.z.get(usize::from(p.delay) / PARTS).filter(|_| p.delay > 0);
            *power += z.map_or(0.0, |[re, im]| re * re + im * im);
        }
    }

    /// Half the energy modelled in a range cell for so many frames: the log ratio that a vessel is expected to reach there.
    /// 0 without a table.
    pub(super) fn energy(&self, cell: usize, frames: usize) -> f32 {
        let Some(table) = &self.table else { return 0.0 };
        let near = table.half_energy.iter().skip(2 * cell).take(2).map(|e| f32::from_le_bytes(*e));
        near.sum::<f32>() * 0.5 * frames as f32
    }

    /// Whether `count` frames would show a vessel in a range cell: the log ratio it is expected to reach there, half the
    /// modelled energy a frame [O 19], is at least `least`. Without a table every cell is taken for one that shows.
    pub(super) fn shows(&self, cell: usize, count: usize, least: f32) -> bool {
        let Some(table) = &self.table else { return true };
        let near = table.half_energy.iter().skip(2 * cell).take(2).map(|e| f32::from_le_bytes(*e));
        near.fold(0.0, f32::max) * count as f32 >= least
    }

    /// Whether the strongest pulse of a vessel at `range_m` would lie where a vessel known to be at `known_m` draws one:
    /// the same echo read as another pair of paths.
    pub fn mistakes(&self, range_m: f32, known_m: f32) -> bool {
        if math::f32::abs(range_m - known_m) < SAME_PLACE_M {
            return false;
        }
        let Some(table) = &self.table else { return false };
        let j = (range_m / RANGE_STEP_M) as usize;
        let (mut strongest, mut most) = (0, f32::NEG_INFINITY);
        for b in 0..table.branches() {
            let energy = table.pulse(b, j).energy();
            (strongest, most) = if energy > most { (b, energy) } else { (strongest, most) };
        }
        is_drawn(table, strongest, &[(range_m, known_m)])
    }

    /// Whether any notable part of what a vessel at `range_m` would draw may be a known vessel's: enough not to report
    /// it as another vessel, too little to disregard it as evidence.
    pub fn doubtful(&self, range_m: f32, known_m: f32) -> bool {
        let (strongest, share) = self.shared(range_m, known_m);
        strongest || share > SHARED_ENERGY
    }

    /// Whether a notable part of what a vessel at `range_m` and `speed_m_s` would draw moves along with what a known vessel draws: the
    /// same echo read as another pair of paths, for another vessel would have to keep to that range for [`ALONG_S`] to either side.
    pub fn follows(&self, (range_m, speed_m_s): (f32, f32), (known_m, known_m_s): (f32, f32)) -> bool {
        // Delays go as one over range: an echo moves as many times faster as it seems farther. Most of what is none is told by that.
        let odd = speed_m_s * known_m - known_m_s * range_m;
        if math::f32::abs(odd) > ALONG_M_S * known_m.max(range_m) {
            return false;
        }
        let at = |t_s: f32| (range_m + speed_m_s * t_s, known_m + known_m_s * t_s);
        let (strongest, share) = self.shared_at(&[at(0.0), at(-ALONG_S), at(ALONG_S)]);
        strongest || share > SHARED_ENERGY
    }

    /// Whether the strongest pulse, and what share of the energy, of a vessel at `range_m` lies where one at `known_m`
    /// draws pulses.
    fn shared(&self, range_m: f32, known_m: f32) -> (bool, f32) {
        self.shared_at(&[(range_m, known_m)])
    }

    /// The same at several pairs of ranges: a pulse must lie on the same one at all of them. The first tells energies.
    fn shared_at(&self, ranges: &[(f32, f32)]) -> (bool, f32) {
        let Some((range_m, known_m)) = ranges.first() else { return (false, 0.0) };
        if math::f32::abs(range_m - known_m) < SAME_PLACE_M {
            return (false, 0.0);
        }
        let Some(table) = &self.table else { return (false, 0.0) };
        let j = (range_m / RANGE_STEP_M) as usize;
        let (mut strongest, mut most, mut all, mut shared) = (false, f32::NEG_INFINITY, 0f32, 0f32);
        for b in 0..table.branches() {
            let p = table.pulse(b, j);
            let energy = p.energy();
            let drawn = is_drawn(table, b, ranges);
            if energy > most {
                (strongest, most) = (drawn, energy);
            }
            all += energy;
            shared += if drawn { energy } else { 0.0 };
        }
        (strongest, shared / all.max(1.0))
    }

    /// Computes the envelope of a cepstrum.
    pub fn envelope(&self, y: impl Iterator<Item = f32>, out: &mut Envelope) {
        let Some(table) = &self.table else { return };
        for ((w, y), weight) in out.weighted.iter_mut().zip(y).zip(table.weights) {
            let [cos, sin, v] = three(*weight);
            let x = y * v;
            *w = [cos * x, sin * x];
        }
        let kernel = kernel(table);
        let (first, count) = self.span;
        let spans = out.weighted.get(first.saturating_sub(HALF)..).unwrap_or_default();
        let z = out.z.as_chunks_mut::<FINE>().0.get_mut(first..).unwrap_or_default();
        // Two neighbours at a time, the last two once more where their number is odd.
        for n in (0..count).step_by(2).map(|n| n.min(count.saturating_sub(2))) {
            let spans = spans.get(n..).and_then(|spans| spans.first_chunk::<{ KERNEL + 1 }>());
            let z = z.get_mut(n..).and_then(|z| z.first_chunk_mut::<2>());
            let (Some(spans), Some(z)) = (spans, z) else { continue };
            let (mut a, mut b) = ([[0f32; 2]; FINE], [[0f32; 2]; FINE]);
            for (near, kernel) in spans.windows(2).zip(&kernel) {
                let [[are, aim], [bre, bim]] = *near.first_chunk().unwrap_or(&[[0.0; 2]; 2]);
                a = core::array::from_fn(|k| [a[k][0] + are * kernel[k], a[k][1] + aim * kernel[k]]);
                b = core::array::from_fn(|k| [b[k][0] + bre * kernel[k], b[k][1] + bim * kernel[k]]);
            }
            *z = [a, b];
        }
    }

    /// Writes the log-likelihood ratio at every range to `out`, all branches summed.
    pub fn log_ratio(&self, envelope: &Envelope, out: &mut [f32; MODEL_RANGES]) {
        out.fill(0.0);
        let Some(table) = &self.table else { return };
        for b in 0..table.branches() {
            let (pulses, sums) = (table.stored(b).as_chunks().0, out.as_chunks_mut().0);
            sums.iter_mut().zip(pulses).for_each(|(sums, pulses)| add_along(envelope, pulses, sums));
        }
        out.iter_mut().zip(table.half_energy).for_each(|(g, e)| *g -= f32::from_le_bytes(*e));
    }

    /// Writes the log-likelihood ratio of one branch alone at every range to `out`, 0 where it does not exist: the sum
    /// over quefrencies as it stands [O 19], which needs no memory. Cost: 200 k instructions.
    pub(super) fn branch_log_ratio(
        &self,
        branch: usize,
        y: &[f32; QUEFRENCIES],
        out: &mut [f32; MODEL_RANGES],
    ) {
        out.fill(0.0);
        let Some(table) = &self.table else { return };
        let kernel = kernel(table);
        for (g, p) in out.iter_mut().zip(table.pulses(branch)) {
            let fine = (usize::from(p.delay) + PARTS / 2) / PARTS;
            let (first, part) = ((fine / FINE).saturating_sub(HALF), fine % FINE);
            let (re, im) = (f32::from(p.re) * STRENGTH_UNIT, f32::from(p.im) * STRENGTH_UNIT);
            let near = table.weights.iter().zip(y).skip(first).zip(&kernel);
            *g = near
                .map(|((weight, y), k)| {
                    let [cos, sin, v] = three(*weight);
                    let mu = (re * cos + im * sin) * k.get(part).copied().unwrap_or(0.0);
                    v * mu * (y - 0.5 * mu)
                })
                .sum();
        }
    }
}

/// The pulse's Gaussian by distance in quefrencies and by fine delay.
fn kernel(table: &Table<'_>) -> [[f32; FINE]; KERNEL] {
    let mut out = [[0.0; FINE]; KERNEL];
    let numbers = table.kernel.as_flattened().as_chunks().0;
    out.as_flattened_mut().iter_mut().zip(numbers).for_each(|(k, b)| *k = f32::from_le_bytes(*b));
    out
}
