//! A line's orientation, with what is not known of its clock's shift averaged out.
//!
//! Enters: a rough fit. Leaves: means and standard deviations of orientation, shift and η over all shifts, each with its
//! likelihood. The same bearings speak for every shift: those that lie on the track at the best one and agree with it. Where
//! another shift needs the track beyond its ends, it goes on straight.
//!
//! Errors of ξ follow one another as `e' = ρ e + …`, because a covariance with forgetting factor μ remembers (ρ = μ): ρ is
//! measured on what the rough fit leaves, the bearings are whitened by it, and their scatter is measured, too, so that
//! likelihoods are those of Student's t. Clocks are mostly wrong by whole units: [`WHOLE`] of the prior lies on whole shifts,
//! if they are preferred, the rest on all alike.
//!
//! Cost: three rounds of two times [`POINTS`] passes over the bearings.

use super::OrientError;
use super::line::{LEAST_BEARINGS, LineBearing, LineSettings, unit};
use crate::angle::wrap_pi;
use crate::kit::Normal;
use crate::math::f64 as m;
use crate::network::known_track::{TrackPoint, position_at};

/// Share of the prior on whole shifts.
const WHOLE: f64 = 0.9;
/// Shifts looked at.
const POINTS: u32 = 80;
/// Rounds: what lies on the track at the best shift, and the best shift.
const ROUNDS: u32 = 3;
/// A bearing farther from the rough fit is wrong, standard deviations.
const WRONG: f64 = 4.0;
/// Most that successive errors are taken to have in common.
const MOST_COMMON: f64 = 0.9;
/// Squared deviations by which a shift may be worse than the best and still be looked at.
const LEAST_LIKELY: f64 = 25.0;

/// A fit at one shift: `ξ = p cos φ + q sin φ`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rough {
    pub shift_s: f64,
    /// (η cos a, η sin a).
    pub components: (f64, f64),
    /// Robust standard deviation of ξ about it.
    pub scale: f64,
}

/// Mean and standard deviation of what is sought.
#[derive(Clone, Copy, Debug)]
pub(super) struct Estimate {
    pub orientation: (f64, f64),
    pub shift_s: (f64, f64),
    pub eta: (f64, f64),
    /// Bearings used.
    pub n: usize,
    /// See [`super::line::LineOrientation`].
    pub ln_likelihood: f64,
}

/// What the data say at one shift.
#[derive(Clone, Copy, Debug)]
struct AtShift {
    /// Sum of squared whitened residuals.
    squares: f64,
    /// Orientation, and its variance in units of that of ξ.
    orientation: (f64, f64),
    eta: (f64, f64),
}

#[derive(Clone, Copy)]
pub(super) struct Data<'a> {
    pub bearings: &'a [LineBearing],
    pub track: &'a [TrackPoint],
    pub settings: &'a LineSettings,
    /// Usual time between bearings, seconds.
    pub interval_s: f64,
}

impl<'a> Data<'a> {
    /// Refines a rough fit.
    ///
    /// # Errors
    /// [`OrientError::TooFew`], [`OrientError::NotObservable`].
    pub fn refine(&self, rough: &Rough) -> Result<Estimate, OrientError> {
        let mut rough = *rough;
        let mut estimate = self.posterior(&rough)?;
        for _ in 1..ROUNDS {
            rough.shift_s = estimate.shift_s.0;
            let (s, c) = m::sin_cos(estimate.orientation.0);
            rough.components = (estimate.eta.0 * c, estimate.eta.0 * s);
            estimate = self.posterior(&rough)?;
        }
        Ok(estimate)
    }

    /// The bearings that lie on the track at a rough fit's shift and agree with it.
    fn kept(self, rough: Rough) -> impl Iterator<Item = &'a LineBearing> + Clone {
        let (p, q) = rough.components;
        self.bearings.iter().filter(move |b| {
            let Some(place) = position_at(self.track, b.t_s - rough.shift_s, self.settings.gap_s) else {
                return false;
            };
            let (c, s) = unit(place);
            m::abs(b.sine - p * c - q * s) <= WRONG * rough.scale
        })
    }

    /// The vessel's direction ([`unit()`]); beyond its ends and gaps the track goes on straight.
    fn direction(&self, t_s: f64) -> (f64, f64) {
        let at = |t_s| position_at(self.track, t_s, f64::INFINITY);
        let beyond = |end: Option<&TrackPoint>, before: Option<&TrackPoint>| {
            let (end, before) = end.zip(before)?;
            let share = (t_s - end.t_s) / (end.t_s - before.t_s);
            let ([x, y, z], [u, v, _]) = (end.position_m, before.position_m);
            Some([x + share * (x - u), y + share * (y - v), z])
        };
        let (first, second) = (self.track.first(), self.track.get(1));
        let place = at(t_s).or_else(|| match first {
            Some(first) if t_s < first.t_s => beyond(Some(first), second),
            _ => beyond(self.track.last(), self.track.len().checked_sub(2).and_then(|n| self.track.get(n))),
        });
        unit(place.unwrap_or([0.0, 1.0, 0.0]))
    }

    /// How much successive errors have in common, from what a rough fit leaves: the correlation of neighbours, with what
    /// fitting three unknowns takes from it put back.
    fn common(&self, rough: &Rough) -> f64 {
        let (p, q) = rough.components;
        let (mut last, mut n, mut squares, mut products) = (None, 0.0, 0.0, 0.0);
        for b in self.kept(*rough) {
            let (c, s) = self.direction(b.t_s - rough.shift_s);
            let e = b.sine - p * c - q * s;
            squares += e * e;
            n += 1.0;
            if let Some((t_s, before)) = last
                && b.t_s - t_s < 1.5 * self.interval_s
            {
                products += before * e;
            }
            last = Some((b.t_s, e));
        }
        let found: f64 = if squares > 0.0 { products / squares } else { 0.0 };
        // Marriott and Pope 1954: the mean of an estimate of ρ is low by (1 + 3ρ)/n, and as much again for what was fitted.
        let found = found + (1.0 + 4.0 * found.max(0.0)) / n;
        found.clamp(0.0, MOST_COMMON)
    }

    fn at(&self, rough: &Rough, common: f64, shift_s: f64) -> Option<AtShift> {
        let mut normal = Normal::<2>::default();
        let mut squares = 0.0;
        let mut last: Option<(f64, f64, f64, f64)> = None;
        for b in self.kept(*rough) {
            let (c, s) = self.direction(b.t_s - shift_s);
            let (mut row, mut sine) = ([c, s], b.sine);
            if let Some((t_s, c0, s0, sine0)) = last
                && common > 0.0
            {
                let rho = m::exp(m::ln(common) * (b.t_s - t_s) / self.interval_s);
                let part = 1.0 / m::sqrt((1.0 - rho * rho).max(1e-3));
                row = [part * (c - rho * c0), part * (s - rho * s0)];
                sine = part * (sine - rho * sine0);
            }
            last = Some((b.t_s, c, s, b.sine));
            normal.observe(&row, sine, 1.0);
            squares += sine * sine;
        }
        let [p, q] = normal.solution()?;
        let (p, q) = super::line::bounded(self.settings.eta, p, q, &normal);
        let ([[cc, cs], [_, ss]], [cx, sx]) = (normal.upper, normal.gradient);
        let squares = squares - 2.0 * (p * cx + q * sx) + cc * p * p + 2.0 * cs * p * q + ss * q * q;
        let eta = m::sqrt(p * p + q * q);
        let determinant = cc * ss - cs * cs;
        if !(determinant > 0.0 && eta > 0.0) {
            return None;
        }
        // Across and along the vector (p, q): orientation and η.
        let spread = |u: f64, v: f64| (ss * u * u - 2.0 * cs * u * v + cc * v * v) / determinant;
        let (low, high) = self.settings.eta;
        let (across, along) = if eta <= low * (1.0 + 1e-9) || eta >= high * (1.0 - 1e-9) {
            (1.0 / (cc * q * q - 2.0 * cs * p * q + ss * p * p), 0.0)
        } else {
            (spread(-q / eta, p / eta) / (eta * eta), spread(p / eta, q / eta))
        };
        Some(AtShift { squares: squares.max(0.0), orientation: (m::atan2(q, p), across), eta: (eta, along) })
    }

    fn posterior(&self, rough: &Rough) -> Result<Estimate, OrientError> {
        let n = self.kept(*rough).count();
        if n < LEAST_BEARINGS {
            return Err(OrientError::TooFew);
        }
        let common = self.common(rough);
        let at = |shift_s: f64| self.at(rough, common, shift_s);
        let (low, high) = self.settings.shift_s;
        let freedom = n as f64 - if high > low { 3.0 } else { 2.0 };
        // The scatter that a fit may leave by rounding alone.
        let floor = freedom * super::line::LEAST_SCALE * super::line::LEAST_SCALE;
        let (low, high, least) = self.window(rough.shift_s.clamp(low, high), freedom, floor, &at)?;
        let likelihood = |squares: f64| {
            // Student's t of the scatter's own freedom.
            let excess = (squares - least) / (least.max(floor) / freedom);
            m::exp(-0.5 * (freedom + 1.0) * m::ln(1.0 + excess.max(0.0) / freedom))
        };
        let mut sums = Sums::default();
        let whole_s = self.settings.whole_s;
        let share = if whole_s > 0.0 { WHOLE } else { 0.0 };
        let points = if high > low { POINTS } else { 0 };
        let width = (high - low) / f64::from(points.max(1));
        for k in 0..=points {
            let Some(found) = at(low + width * f64::from(k)) else { continue };
            let weight = if points == 0 { 1.0 } else { (1.0 - share) * width };
            sums.add(weight * likelihood(found.squares), low + width * f64::from(k), &found);
        }
        if share > 0.0 {
            let (first, last) = (m::ceil(low / whole_s), m::floor(high / whole_s));
            let mut k = first;
            while k <= last {
                if let Some(found) = at(k * whole_s) {
                    sums.add(share * whole_s * likelihood(found.squares), k * whole_s, &found);
                }
                k += 1.0;
            }
        }
        let mut found = sums.estimate(least.max(floor) / freedom, n).ok_or(OrientError::NotObservable)?;
        // Whitened errors have the variance of the bearings': each but the first is narrower by √(1 − ρ²) for what the one before told.
        found.ln_likelihood = -0.5 * n as f64 * m::ln(least.max(floor) / n as f64)
            - 0.5 * (n as f64 - 1.0) * m::ln(1.0 - common * common);
        Ok(found)
    }

    /// The shifts about a rough one that are not much worse than the best, and the best one's squares.
    fn window(
        &self,
        middle_s: f64,
        freedom: f64,
        floor: f64,
        at: &impl Fn(f64) -> Option<AtShift>,
    ) -> Result<(f64, f64, f64), OrientError> {
        let (low, high) = self.settings.shift_s;
        let mut least = at(middle_s).ok_or(OrientError::NotObservable)?.squares;
        let mut reach_s = 0.125 * self.interval_s;
        let ends = |reach_s: f64| ((middle_s - reach_s).max(low), (middle_s + reach_s).min(high));
        while reach_s < high - low {
            let (from, to) = ends(reach_s);
            let of_ends = [from, to].map(|s| at(s).map_or(f64::INFINITY, |a| a.squares));
            least = of_ends.iter().fold(least, |a, b| a.min(*b));
            let most = least + LEAST_LIKELY * least.max(floor) / freedom;
            if (of_ends[0] > most || from <= low) && (of_ends[1] > most || to >= high) {
                break;
            }
            reach_s *= 1.5;
        }
        let (from, to) = ends(reach_s);
        for k in 0..=POINTS {
            if let Some(found) = at(from + (to - from) * f64::from(k) / f64::from(POINTS)) {
                least = least.min(found.squares);
            }
        }
        Ok((from, to, least))
    }
}

/// Weighted sums over shifts.
#[derive(Default)]
struct Sums {
    weight: f64,
    /// Orientation of the first shift: others are counted from it.
    origin: Option<f64>,
    /// Sum and sum of squares of orientation, shift and η.
    first: [f64; 3],
    second: [f64; 3],
    /// Variances of orientation and η at a shift.
    own: [f64; 3],
}

impl Sums {
    fn add(&mut self, weight: f64, shift_s: f64, found: &AtShift) {
        let origin = *self.origin.get_or_insert(found.orientation.0);
        self.weight += weight;
        let values = [wrap_pi(found.orientation.0 - origin), shift_s, found.eta.0];
        let own = [found.orientation.1, 0.0, found.eta.1];
        for i in 0..3 {
            self.first[i] += weight * values[i];
            self.second[i] += weight * values[i] * values[i];
            self.own[i] += weight * own[i];
        }
    }

    fn estimate(&self, variance: f64, n: usize) -> Option<Estimate> {
        let origin = self.origin.filter(|_| self.weight > 0.0)?;
        let of = |i: usize| {
            let mean = self.first[i] / self.weight;
            let spread = (self.second[i] / self.weight - mean * mean).max(0.0);
            (mean, m::sqrt(spread + variance * self.own[i] / self.weight))
        };
        let (orientation, sd) = of(0);
        Some(Estimate {
            orientation: (origin + orientation, sd),
            shift_s: of(1),
            eta: of(2),
            n,
            ln_likelihood: 0.0,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::line::orient;
    use super::super::line::tests::{SETTINGS, bearings, track};
    use super::*;
    use crate::angle::RAD_PER_DEG;

    #[test]
    fn bearings_beyond_the_track_are_told_and_do_not_move_the_answer() {
        let (all, track) = (bearings(0.002), track());
        let found = orient(&all, &track[2..7], &SETTINGS).unwrap();
        let error = m::abs(wrap_pi(found.orientation + 35.1 * RAD_PER_DEG));
        assert!(error < 3.0 * found.sd && found.sd < 2.0 * RAD_PER_DEG, "{found:?}");
        assert!(found.off_track > 35 && found.n + found.wrong + found.off_track == all.len(), "{found:?}");
    }

    #[test]
    fn a_shift_that_is_known_is_taken_and_narrows_the_orientation() {
        let (all, track) = (bearings(0.004), track());
        let free = orient(&all, &track, &SETTINGS).unwrap();
        let known = orient(&all, &track, &LineSettings { shift_s: (2.0, 2.0), ..SETTINGS }).unwrap();
        assert!(known.sd < 0.8 * free.sd && known.sd_time_shift_s == 0.0, "{known:?} {free:?}");
        let whole = orient(&all, &track, &LineSettings { whole_s: 1.0, ..SETTINGS }).unwrap();
        assert!(whole.sd <= free.sd, "{whole:?} {free:?}");
    }

    #[test]
    fn what_successive_errors_have_in_common_widens_what_is_stated() {
        let (mut all, track) = (bearings(0.0), track());
        let mut error = 0.0;
        for (i, b) in all.iter_mut().enumerate() {
            error = 0.8 * error + 0.002 * m::sin(2.1 * i as f64 + 0.3 * (i * i) as f64);
            b.sine += error;
        }
        let found = orient(&all, &track, &SETTINGS).unwrap();
        let alike = orient(&bearings(0.0024), &track, &SETTINGS).unwrap();
        assert!(found.sd > 1.2 * alike.sd, "{found:?} {alike:?}");
    }
}
