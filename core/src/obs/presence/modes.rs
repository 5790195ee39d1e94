//! The peaks of the posterior over range and radial speed, as measurements with a spread.

use super::super::interference::Interference;
use super::super::limits::{CLASSES, MAX_SPEED_M_S, RANGE_CELLS, RANGE_MODES};
use super::super::radial::{GRID_UNIT, RadialScratch, speed_of};
use super::super::shared::Grid;
use super::{
    Expected, ExpectedVessels, OWNERS, Presence, RangePresence, SHARES, Shown, UNCLAIMED, at_share, of,
    range_of, unpack,
};
use crate::math;

/// Half width within which a mode is alone, cells (1.1 km).
const ALONE: usize = 8;

/// Half width of the moments of a mode, cells.
const MODE_HALF: usize = 4;

/// Part of a mode at the greatest of the strengths from which on it is sure.
const SURE: f32 = 0.7;

/// Natural logarithm of how much better than the prior a mode must be.
const MODE_LOG_RATIO: f32 = 4.0;

/// Log ratio this minute's own data must give a mode: what is only remembered is no measurement. Cells where not even a
/// vessel is expected to reach it show nothing.
pub(super) const LEAST_SUPPORT: f32 = 3.0;

/// Cells whose greatest densities are looked for together.
const TOGETHER: usize = 32;

/// One mode of the posterior.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeMode {
    /// Range, m.
    pub range_m: f32,
    /// Its standard deviation, m.
    pub sd_range_m: f32,
    /// Radial speed, m/s, positive when leaving.
    pub speed_m_s: f32,
    /// Its standard deviation, m/s.
    pub sd_speed_m_s: f32,
    /// Share of its vessel's posterior.
    pub weight: f32,
    /// What this minute's frames say for it, at the share of the table's strengths that they say most of, natural logarithm.
    pub support: f32,
    /// Whether its vessel is more likely there than not.
    pub detected: bool,
    /// Whether it is a tracked vessel's: where its track says, or where its echoes may put it too.
    pub tracked: bool,
    /// Whether no other pair of paths explains it as well: its echoes are nearly of the table's strengths, or an
    /// established track expects it. A weak one's may be one echo of a vessel elsewhere, beyond the model too.
    pub sure: bool,
}

/// Radial speed below which what is not a tracked vessel's may stand still, m/s: the lines of a propeller's comb draw a pulse at
/// one quefrency for as long as it turns evenly, and so does a whale that calls in time. A vessel is this slow about its
/// closest point alone.
const STILL_M_S: f32 = 1.0;

/// Radial speed above which what is not a tracked vessel's may be faster than the posterior reaches, m/s: an echo read as a pair
/// of paths twice as far.
const FASTEST_M_S: f32 = MAX_SPEED_M_S - 0.5;

/// Radial speed by which such a mode may differ from that of the vessel that a track expects there, m/s: what stands still may lie at its range.
const AS_FAST_M_S: f32 = 1.2;

/// Share of its posterior with which a vessel shows itself.
const ITSELF: f32 = 0.5;

/// By how much more a minute's frames must say for a mode than for a tracked vessel that its echoes might be of, natural logarithm, to
/// be none of its echoes: noise of a minute hardly makes such a difference.
const BETTER: f32 = 5.0;

/// Range from which on a vessel's own echoes do not look like those of one twice as far, m over the water of RR03: nearer, the pair 13 is so strong
/// that read as 35 it has the strength of that.
const RIVALS_M: f32 = 17_000.0;

/// Range within which a mode is the vessel a track expects, m.
pub(super) const EXPECTED_WITHIN_M: f32 = 1500.0;

impl Expected {
    /// Whether a mode may be this vessel.
    fn is_near(&self, m: &RangeMode) -> bool {
        math::f32::abs(m.range_m - self.range_m) < EXPECTED_WITHIN_M
    }
}

/// About where the model ends, m, and how much nearer another pair of paths reads vessels beyond it: those louder than the table's are
/// heard to 100 km.
const BEYOND_M: f32 = 43_000.0;
const NEARER: [f32; 2] = [2.0, 1.5];

/// Range below which the pair 13 alone shows a vessel, m over the water of RR03: of one 70 to 85 km away and 15 dB louder than the table's the pair
/// 59 does that, with the same delay. A vessel is tracked before it is that near.
const ONE_PAIR_M: f32 = 8_500.0;

/// Ranges at which a vessel half as far is read as well, m over the water of RR03: its pair 13 is so strong that it has the strength of the
/// pair 35 here.
const HALF_AS_FAR_M: core::ops::Range<f32> = 15_000.0..24_000.0;

impl RangeMode {
    /// Whether it may read the echoes of a vessel elsewhere as another pair of paths: of one beyond the model's end, of which the posterior
    /// knows nothing, so that no share of it says that the vessel is here (none there is faster than vessels are), or of one half as far.
    fn may_be_elsewhere(&self, depth_ratio: f32, tracked: bool) -> bool {
        let slow = |nearer: f32| nearer * math::f32::abs(self.speed_m_s) < MAX_SPEED_M_S + 1.0;
        let beyond = NEARER.iter().any(|nearer| nearer * self.range_m >= BEYOND_M && slow(*nearer));
        let range_m = self.range_m / depth_ratio;
        beyond || HALF_AS_FAR_M.contains(&range_m) || range_m < ONE_PAIR_M && !tracked
    }

    /// Whether it shows a vessel where a track expects it.
    fn shows(&self, e: &Expected) -> bool {
        self.weight > ITSELF && e.is_near(self)
    }

    /// Whether a minute's frames say so much more for it than for a vessel's mode that has its echoes in common with it that those are its, and
    /// not it one of those.
    fn is_truer(&self, model: &Interference<'_>, than: &Self) -> bool {
        than.range_m > RIVALS_M * model.depth_ratio() && self.support > than.support + BETTER
    }

    /// Whether it moves as the echoes of an established vessel of the table's strengths read as another pair of paths do, and no
    /// such vessel is there. Where the vessel itself does not show among a minute's modes its track may be the other pair's.
    fn is_an_echo(
        &self,
        model: &Interference<'_>,
        expected: &ExpectedVessels,
        all: &[Option<Self>; RANGE_MODES],
    ) -> bool {
        let known = || expected.iter().flatten().filter(|e| e.strong);
        let shows = |e: &Expected| all.iter().flatten().any(|m| m.shows(e) && !self.is_truer(model, m));
        let along = |e: &Expected| model.follows((self.range_m, self.speed_m_s), (e.range_m, e.speed_m_s));
        !known().any(|e| e.is_near(self)) && known().any(|e| shows(e) && along(e))
    }
}

impl RangePresence {
    /// Drops the modes that read the echoes of an established vessel as another pair of paths: those that are not sure, as its own
    /// are, and those that move as these echoes do. They are no evidence of another one. Of a track's own modes go those whose echoes are of
    /// another mode that a minute's frames say much more for: the track is on a wrong pair of paths.
    pub fn without_echoes(&mut self, model: &Interference<'_>, expected: &ExpectedVessels) {
        let known = || expected.iter().flatten();
        let all = self.modes;
        let tracked = |m: &RangeMode| known().any(|e| e.is_near(m));
        let untrue = |m: &RangeMode| {
            let truer = |other: &RangeMode| {
                !tracked(other)
                    && other.is_truer(model, m)
                    && model.follows((other.range_m, other.speed_m_s), (m.range_m, m.speed_m_s))
            };
            tracked(m) && all.iter().flatten().any(truer)
        };
        for slot in &mut self.modes {
            if let Some(m) = slot
                && (!m.sure
                    && !tracked(m)
                    && known().any(|e| e.strong && model.doubtful(m.range_m, e.range_m))
                    || m.is_an_echo(model, expected, &all)
                    || untrue(m))
            {
                *slot = None;
            }
        }
    }

    /// Drops the modes that stand still or reach the end of the speeds and that no track expects: no evidence of a vessel.
    pub fn without_odd_speeds(&mut self, expected: &ExpectedVessels) {
        for slot in &mut self.modes {
            let along = |m: &RangeMode, e: &Expected| math::f32::abs(m.speed_m_s - e.speed_m_s) < AS_FAST_M_S;
            let near = |m: &RangeMode| expected.iter().flatten().any(|e| e.is_near(m) && along(m, e));
            let plausible = |m: &RangeMode| (STILL_M_S..FASTEST_M_S).contains(&math::f32::abs(m.speed_m_s));
            if slot.is_some_and(|m| !plausible(&m) && !near(&m)) {
                *slot = None;
            }
        }
    }

    /// Puts the modes of tracked vessels first, the likelier ones before the others, and drops those that may only read a
    /// tracked vessel's echoes as another pair of paths.
    pub fn prefer(&mut self, model: &Interference<'_>, expected: &ExpectedVessels) {
        let mistaken = |m: &RangeMode| {
            let echoes = |e: &Expected| model.doubtful(m.range_m, e.range_m);
            let known = || expected.iter().flatten();
            !known().any(|e| e.is_near(m)) && known().any(echoes)
        };
        for m in self.modes.iter_mut().flatten() {
            let near = || expected.iter().flatten().filter(|e| e.is_near(m));
            let elsewhere = m.may_be_elsewhere(model.depth_ratio(), near().next().is_some());
            m.sure = near().any(|e| e.placed) || m.sure && !elsewhere;
        }
        let old = self.modes;
        let first = old.iter().flatten().filter(|m| m.tracked && !mistaken(m));
        let rest = old.iter().flatten().filter(|m| !m.tracked && !mistaken(m));
        self.modes = [None; RANGE_MODES];
        self.modes.iter_mut().zip(first.chain(rest)).for_each(|(slot, m)| *slot = Some(*m));
    }
}

/// The best of a minute's log ratios at and next to a cell, at any share.
fn support(grid: &Grid, energy: &[f32; RANGE_CELLS], i: usize, k: usize) -> f32 {
    let near = grid.iter().skip(k.saturating_sub(1)).take(3);
    let best = near.flat_map(|g| g.iter().skip(i.saturating_sub(1)).take(3)).max();
    let log_ratio = best.map_or(f32::NEG_INFINITY, |g| f32::from(*g) * GRID_UNIT);
    let energy = energy.get(i).copied().unwrap_or(0.0);
    SHARES.iter().fold(f32::NEG_INFINITY, |best, share| best.max(at_share(log_ratio, energy, *share)))
}

impl Presence {
    /// The speed of the greatest density at each of some cells that follow each other, and that density.
    fn best(&self, first: usize) -> [(u32, f32); TOGETHER] {
        let (mut speeds, mut most) = ([0u32; TOGETHER], [0f32; TOGETHER]);
        let [all, some, little] = self.density.each_ref().map(|density| density.iter());
        for (k, ((a, b), c)) in (0u32..).zip(all.zip(some).zip(little)) {
            let [a, b, c] = [a, b, c].map(|column| column.get(first..).unwrap_or_default());
            let cells = a.iter().zip(b).zip(c);
            for ((speed, most), ((a, b), c)) in speeds.iter_mut().zip(&mut most).zip(cells) {
                let p = unpack(*a) + unpack(*b) + unpack(*c);
                (*speed, *most) = if p > *most { (k, p) } else { (*speed, *most) };
            }
        }
        let mut out = [(0, 0.0); TOGETHER];
        out.iter_mut().zip(speeds.into_iter().zip(most)).for_each(|(out, best)| *out = best);
        out
    }

    /// The highest peaks over range that are better than the prior by [`MODE_LOG_RATIO`].
    pub(super) fn modes(
        &self,
        evidence: &mut [f32; OWNERS],
        grid: &Grid,
        energy: &[f32; RANGE_CELLS],
        shown: &Shown,
        radial: &RadialScratch,
    ) -> [Option<RangeMode>; RANGE_MODES] {
        let mut found = [(0usize, 0usize, 0f32, 0f32); RANGE_MODES];
        let cells = self.owner.iter().zip(shown).enumerate().take(self.cells);
        let best = (0..self.cells).step_by(TOGETHER).flat_map(|first| self.best(first));
        for ((i, (owner, _)), (k, p)) in cells.zip(best).filter(|((_, (_, shown)), _)| **shown) {
            let (k, log_evidence) = (k as usize, *of(evidence, *owner));
            let prior = range_of(i) * self.prior_scale;
            let unlikely = p <= 1e-36 || math::f32::ln(p / prior) + log_evidence < MODE_LOG_RATIO;
            if unlikely {
                continue;
            }
            let support = support(grid, energy, i, k);
            if support < LEAST_SUPPORT {
                continue;
            }
            // A peak close to a higher one already found is part of it; a lower one close by gives way.
            let near = found.iter_mut().find(|f| f.2 > 0.0 && f.0.abs_diff(i) <= ALONE);
            if let Some(f) = near {
                if p > f.2 {
                    *f = (i, k, p, support);
                }
                continue;
            }
            let least = found.iter_mut().min_by(|a, b| a.2.total_cmp(&b.2));
            if let Some(f) = least
                && p > f.2
            {
                *f = (i, k, p, support);
            }
        }
        let mut out = [None; RANGE_MODES];
        for slot in &mut out {
            let highest = found.iter_mut().max_by(|a, b| a.2.total_cmp(&b.2));
            if let Some((i, k, p, support)) = highest
                && *p > 0.0
            {
                *slot = Some(self.moments(*i, *k, *support, radial));
                *p = 0.0;
            }
        }
        out
    }

    /// Mean and spread of the posterior about a peak; the minute's frames tell where in a cell the vessel is that is there.
    fn moments(&self, i: usize, k: usize, support: f32, radial: &RadialScratch) -> RangeMode {
        let (r0, v0) = (range_of(i), speed_of(k));
        let first = i.saturating_sub(MODE_HALF);
        let columns = self
            .density
            .iter()
            .enumerate()
            .flat_map(|(c, d)| d.iter().enumerate().map(move |(j, x)| (c, j, x)))
            .filter(|(_, j, _)| j.abs_diff(k) <= 3);
        let mut held = [0f32; CLASSES];
        for (c, _, column) in columns.clone() {
            let near = column.iter().skip(first).take(2 * MODE_HALF + 1);
            if let Some(held) = held.get_mut(c) {
                *held += near.map(|cell| unpack(*cell)).sum::<f32>();
            }
        }
        let [strong, ..] = held;
        let n = held.iter().sum::<f32>().max(1e-37);
        let share = held.iter().zip(SHARES).map(|(held, (least, _))| held * least).sum::<f32>() / n;
        let places: [(f32, f32); 2 * MODE_HALF + 1] =
            core::array::from_fn(|d| radial.within(first + d, k, share));
        let (mut r, mut rr, mut v, mut vv) = (0f32, 0f32, 0f32, 0f32);
        for (_, j, column) in columns {
            let dv = speed_of(j) - v0;
            for ((d, cell), (place, spread)) in column.iter().enumerate().skip(first).zip(&places) {
                let (p, dr) = (unpack(*cell), range_of(d) - r0 + place);
                r += p * dr;
                rr += p * (dr * dr + spread);
                v += p * dv;
                vv += p * dv * dv;
            }
        }
        let (r, v) = (r / n, v / n);
        let var_r = (rr / n - r * r).max(0.0);
        // The grid itself spreads by a twelfth of a step squared.
        let var_v = (vv / n - v * v).max(0.0) + 1.0 / 12.0;
        RangeMode {
            range_m: r0 + r,
            sd_range_m: math::f32::sqrt(var_r),
            speed_m_s: v0 + v,
            sd_speed_m_s: math::f32::sqrt(var_v),
            weight: n.min(1.0),
            support,
            sure: strong > SURE * n,
            tracked: self.owner.get(i).is_some_and(|o| *o < UNCLAIMED),
            detected: self.owner.get(i).is_some_and(|o| *of(&mut { self.present }, *o) > 0.5),
        }
    }
}
