//! Orientation of a linear array from a vessel of known track.
//!
//! With the vessel at azimuth φ, the array's axis at azimuth a and a common elevation ψ, `η = cos ψ`, the processor
//! gives `ξ = η cos(φ − a)` [L 3, 14-16]; where the track tells the vessel's height above the array, the elevation is that of each
//! bearing, and η stands beside it. For a given clock shift that is linear in `(η cos a, η sin a)`, so orientation
//! and η follow from a 2×2 system, whichever side the vessel is on and however often it changes sides; only the shift
//! is searched. The bearing stamped t belongs to the track's t − shift. A robust fit (Huber's, then Tukey's weights on
//! the median absolute deviation) finds the neighbourhood and what is wrong; `shift` then weighs all shifts about it.
//!
//! Fails (says so) where the vessel's bearing hardly turns: shift, η and orientation then trade against each other.
//! Cost: 241 plain fits for the noise, 260 robust ones of six rounds over the bearings, and some 1200 plain ones.

use super::{OrientError, quantile, shift};
use crate::angle::{wrap_pi, wrap_tau};
use crate::kit::{Huber, MAD_TO_SD, Normal, Tukey, golden};
use crate::math::f64 as m;
use crate::network::known_track::{TrackPoint, position_at};

/// Fewest bearings for three unknowns and a jackknife.
pub const LEAST_BEARINGS: usize = 8;
/// Steps of the shift's grid.
const GRID: u32 = 240;
/// Parts of a pass that show what lasts.
const PARTS: usize = 10;
/// Rounds of reweighting, half with either weight: they settle to 1e-3 in three.
const ROUNDS: u32 = 6;
/// Smallest noise of ξ the robust scale assumes, so that exact data do not divide by zero.
pub(super) const LEAST_SCALE: f64 = 1e-9;
/// Largest standard deviation of an orientation that is one, radians (20°).
const LARGEST_SD: f64 = 0.35;

/// One bearing of the linear array.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineBearing {
    /// Time by the array's clock, seconds.
    pub t_s: f64,
    /// Sine of the bearing from broadside, positive towards rising sensor numbers.
    pub sine: f64,
}

/// What is searched.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineSettings {
    /// Least and greatest time shift, seconds; equal limits fix it.
    pub shift_s: (f64, f64),
    /// Least and greatest η; equal limits fix it. Above one is no cosine but a model error [L, section 4].
    pub eta: (f64, f64),
    /// Longest gap of the track that is interpolated, seconds.
    pub gap_s: f64,
    /// Clocks that are set by whole seconds or blocks are wrong by whole ones: shifts of a multiple of this have nine tenths of
    /// the prior probability (paper L searches whole bearings only), seconds; zero: no preference.
    pub whole_s: f64,
}

/// Orientation of a linear array.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineOrientation {
    /// Azimuth of the direction of rising sensor numbers, radians in [0, 2π).
    pub orientation: f64,
    /// Its standard deviation, what is not known of shift and η included, radians.
    pub sd: f64,
    /// How late the array's clock is, seconds.
    pub time_shift_s: f64,
    /// Its standard deviation, seconds.
    pub sd_time_shift_s: f64,
    /// Cosine of the common elevation, beside that of the track's heights.
    pub eta: f64,
    /// Its standard deviation.
    pub sd_eta: f64,
    /// Mean angle between true and computed positions, Δ [L 13], radians.
    pub mean_error: f64,
    /// Bearings used.
    pub n: usize,
    /// Bearings on the track that contradict the others and were not used.
    pub wrong: usize,
    /// Bearings of times of which the track tells nothing.
    pub off_track: usize,
    /// What the bearings miss the track by for a tenth of the pass on end: root mean square of the tenths' medians, in sine.
    pub lasting: f64,
    /// Standard deviation of one by how those that follow each other differ, in sine.
    pub successive: f64,
    /// Median distance of the vessel, metres.
    pub range_m: f64,
    /// Least and greatest shift that were searched, seconds.
    pub searched_s: (f64, f64),
    /// Logarithm of the greatest likelihood, scatter at its best, for comparing tracks of the same bearings.
    pub ln_likelihood: f64,
}

/// Finds the orientation; the track is in the array's frame (array at the origin).
///
/// # Errors
/// [`OrientError`].
pub fn orient(
    bearings: &[LineBearing],
    track: &[TrackPoint],
    settings: &LineSettings,
) -> Result<LineOrientation, OrientError> {
    check(bearings, settings)?;
    crate::network::known_track::check(track).map_err(|_| OrientError::NotFinite)?;
    let all = Data { bearings, track, settings };
    let rough = all.search(all.least_scale()?)?;
    let scale = all.scale(rough.shift_s, rough.components());
    let rough = shift::Rough { shift_s: rough.shift_s, components: rough.components(), scale };
    let interval_s = interval(bearings);
    let found = shift::Data { bearings, track, settings, interval_s }.refine(&rough)?;
    if !(found.orientation.1 <= LARGEST_SD) {
        return Err(OrientError::NotObservable);
    }
    let (orientation, eta) = (found.orientation.0, found.eta.0);
    let (lasting, successive) = all.lasting(found.shift_s.0, orientation, eta);
    let places = bearings.iter().filter_map(|b| position_at(track, b.t_s - found.shift_s.0, settings.gap_s));
    let range_m = quantile(places.map(|[x, y, z]| m::sqrt(x * x + y * y + z * z)), 0.5);
    let (mut on_track, mut error) = (0usize, 0.0);
    for ((c, s), b) in all.pairs(found.shift_s.0) {
        error += computed_error(m::atan2(s, c), b.sine / (eta * m::sqrt(c * c + s * s)), orientation);
        on_track += 1;
    }
    Ok(LineOrientation {
        orientation: wrap_tau(orientation),
        sd: found.orientation.1,
        time_shift_s: found.shift_s.0,
        sd_time_shift_s: found.shift_s.1,
        eta,
        sd_eta: found.eta.1,
        mean_error: error / on_track.max(1) as f64,
        n: found.n,
        wrong: on_track.saturating_sub(found.n),
        off_track: bearings.len() - on_track,
        lasting,
        successive,
        range_m,
        searched_s: settings.shift_s,
        ln_likelihood: found.ln_likelihood,
    })
}

/// North and East of the direction to a place: cosine and sine of its azimuth, times the cosine of its elevation; North where it is
/// the origin.
pub(super) fn unit([east, north, up]: [f64; 3]) -> (f64, f64) {
    let range = m::sqrt(east * east + north * north + up * up);
    if range > 0.0 { (north / range, east / range) } else { (1.0, 0.0) }
}

/// Usual time from one bearing to the next, seconds: the median of the positive ones; 1 where there is none.
fn interval(bearings: &[LineBearing]) -> f64 {
    let steps = bearings.iter().zip(bearings.iter().skip(1)).map(|(a, b)| b.t_s - a.t_s).filter(|d| *d > 0.0);
    crate::kit::order_statistic(steps, 0.5).unwrap_or(1.0)
}

pub(super) fn check(bearings: &[LineBearing], settings: &LineSettings) -> Result<(), OrientError> {
    if bearings.len() < LEAST_BEARINGS {
        return Err(OrientError::TooFew);
    }
    let (s0, s1) = settings.shift_s;
    let (e0, e1) = settings.eta;
    let limits = s0.is_finite() && s1.is_finite() && s0 <= s1 && e0 > 0.0 && e0 <= e1 && e1.is_finite();
    let finite = bearings.iter().all(|b| b.t_s.is_finite() && b.sine.is_finite());
    if limits && finite && settings.gap_s > 0.0 { Ok(()) } else { Err(OrientError::NotFinite) }
}

/// Angle between the true azimuth and the one computed from a sine, on the side that fits.
pub(super) fn computed_error(azimuth: f64, sine: f64, orientation: f64) -> f64 {
    let off_axis = m::acos(sine.clamp(-1.0, 1.0));
    let from_axis = wrap_pi(azimuth - orientation);
    m::abs(m::abs(from_axis) - off_axis)
}

/// One fit.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    cost: f64,
    n: usize,
    orientation: f64,
    eta: f64,
    shift_s: f64,
}

impl Candidate {
    /// (η cos a, η sin a).
    fn components(&self) -> (f64, f64) {
        let (s, c) = m::sin_cos(self.orientation);
        (self.eta * c, self.eta * s)
    }
}

#[derive(Clone, Copy)]
struct Data<'a> {
    bearings: &'a [LineBearing],
    track: &'a [TrackPoint],
    settings: &'a LineSettings,
}

impl<'a> Data<'a> {
    /// True direction ([`unit()`]), and bearing, of every bearing on the track at a shift.
    fn pairs(&self, shift_s: f64) -> impl Iterator<Item = ((f64, f64), &'a LineBearing)> + Clone + use<'a> {
        let (track, gap_s) = (self.track, self.settings.gap_s);
        self.bearings.iter().filter_map(move |b| Some((unit(position_at(track, b.t_s - shift_s, gap_s)?), b)))
    }

    /// Noise of ξ about the best unweighted fit of any shift: it scales the robust loss for all shifts alike.
    fn least_scale(&self) -> Result<f64, OrientError> {
        let mut least: Option<f64> = None;
        let (lo, hi) = self.settings.shift_s;
        for k in 0..=GRID {
            let shift_s = lo + (hi - lo) * f64::from(k) / f64::from(GRID);
            if let Some(c) = self.fit(shift_s, f64::INFINITY) {
                let scale = self.scale(shift_s, c.components());
                least = Some(least.map_or(scale, |l| l.min(scale)));
            }
            if hi <= lo {
                break;
            }
        }
        least.ok_or(if self.pairs(0.5 * (lo + hi)).count() < LEAST_BEARINGS {
            OrientError::TooFew
        } else {
            OrientError::NotObservable
        })
    }

    /// Best shift on a grid, then sections about it.
    fn search(&self, scale: f64) -> Result<Candidate, OrientError> {
        let (lo, hi) = self.settings.shift_s;
        let at = |k: u32| lo + (hi - lo) * f64::from(k) / f64::from(GRID);
        let most = (0..=GRID).map(|k| self.pairs(at(k)).count()).max().unwrap_or(0);
        if most < LEAST_BEARINGS {
            return Err(OrientError::TooFew);
        }
        let mut best: Option<(u32, Candidate)> = None;
        for k in 0..=GRID {
            let Some(c) = self.fit(at(k), scale) else { continue };
            // A shift that pushes a fifth of the bearings off the track is not comparable with one that keeps them.
            if 5 * c.n >= 4 * most && best.is_none_or(|(_, b)| c.cost < b.cost) {
                best = Some((k, c));
            }
            if hi <= lo {
                break;
            }
        }
        let (k, mut best) = best.ok_or(OrientError::NotObservable)?;
        if hi > lo {
            golden(at(k.saturating_sub(1)), at((k + 1).min(GRID)), 20, |shift_s| {
                let Some(found) = self.fit(shift_s, scale) else { return f64::NAN };
                if found.cost < best.cost && found.n == best.n {
                    best = found;
                }
                found.cost
            });
        }
        Ok(best)
    }

    /// Robust fit of orientation and η at a shift, for a noise of ξ (infinite: plain least squares).
    fn fit(&self, shift_s: f64, scale: f64) -> Option<Candidate> {
        let mut state: Option<(f64, f64)> = None;
        let rounds = if scale.is_finite() { ROUNDS } else { 1 };
        for round in 0..rounds {
            // Huber's weights find the neighbourhood from anywhere, Tukey's then leave wrong bearings out.
            let huber = 2 * round < rounds;
            let weight = |r| if huber { Huber::EFFICIENT.weight(r) } else { Tukey::EFFICIENT.weight(r) };
            let mut normal = Normal::<2>::default();
            for ((c, s), b) in self.pairs(shift_s) {
                let w = state.map_or(1.0, |(p, q)| weight((b.sine - p * c - q * s) / scale));
                normal.observe(&[c, s], b.sine, w);
            }
            // The two directions cos φ and sin φ must both vary: a bearing that never turns has no solution.
            let [p, q] = normal.solution()?;
            state = Some(bounded(self.settings.eta, p, q, &normal));
        }
        let (p, q) = state?;
        let (mut cost, mut n) = (0.0, 0usize);
        for ((c, s), b) in self.pairs(shift_s) {
            cost += Tukey::EFFICIENT.loss((b.sine - p * c - q * s) / scale);
            n += 1;
        }
        (n >= LEAST_BEARINGS).then(|| Candidate {
            cost: cost / n as f64,
            n,
            orientation: m::atan2(q, p),
            eta: m::sqrt(p * p + q * q),
            shift_s,
        })
    }

    /// What bearings miss a fit by: the root mean square of the medians of [`PARTS`] of the pass, and the standard deviation of one by how
    /// those that follow each other differ, whatever lasts.
    fn lasting(&self, shift_s: f64, orientation: f64, eta: f64) -> (f64, f64) {
        let (s, c) = m::sin_cos(orientation);
        let missed = self.pairs(shift_s).map(move |((cos, sin), b)| b.sine - eta * (c * cos + s * sin));
        let n = missed.clone().count();
        let parts = PARTS.min(n);
        let part = |k: usize| {
            let (from, to) = (k * n / parts, (k + 1) * n / parts);
            quantile(missed.clone().skip(from).take(to - from), 0.5)
        };
        let squares: f64 = (0..parts).map(|k| part(k) * part(k)).sum();
        let steps = missed.clone().zip(missed.clone().skip(1)).map(|(a, b)| m::abs(b - a));
        let successive = MAD_TO_SD * quantile(steps, 0.5) / m::sqrt(2.0);
        (m::sqrt(squares / parts.max(1) as f64), successive)
    }

    /// Robust standard deviation of ξ about a fit.
    fn scale(&self, shift_s: f64, (p, q): (f64, f64)) -> f64 {
        let residuals = self.pairs(shift_s).map(move |((c, s), b)| m::abs(b.sine - p * c - q * s));
        (MAD_TO_SD * quantile(residuals, 0.5)).max(LEAST_SCALE)
    }
}

/// Brings η inside its limits: the least squares on the circle of that radius, by Newton steps in the angle.
pub(super) fn bounded((lo, hi): (f64, f64), p: f64, q: f64, normal: &Normal<2>) -> (f64, f64) {
    let ([[cc, cs], [_, ss]], [cx, sx]) = (normal.upper, normal.gradient);
    let eta = m::sqrt(p * p + q * q);
    let radius = eta.clamp(lo, hi.max(lo));
    if radius == eta {
        return (p, q);
    }
    let mut a = m::atan2(q, p);
    for _ in 0..20 {
        let (s, c) = m::sin_cos(a);
        let (p, q) = (radius * c, radius * s);
        let (gp, gq) = (cc * p + cs * q - cx, cs * p + ss * q - sx);
        let slope = -gp * q + gq * p;
        let bend = cc * q * q - 2.0 * cs * p * q + ss * p * p - gp * p - gq * q;
        if !(m::abs(bend) > 0.0) {
            break;
        }
        a -= (slope / m::abs(bend)).clamp(-0.3, 0.3);
    }
    let (s, c) = m::sin_cos(a);
    (radius * c, radius * s)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::angle::RAD_PER_DEG;
    use std::vec::Vec;

    pub const SETTINGS: LineSettings =
        LineSettings { shift_s: (-6.0, 6.0), eta: (0.85, 1.05), gap_s: 60.0, whole_s: 0.0 };

    /// Nine positions ten seconds apart, as in the paper; the vessel crosses the array's axis.
    pub fn track() -> Vec<TrackPoint> {
        (0..9)
            .map(|k| {
                let t_s = 10.0 * f64::from(k);
                TrackPoint { t_s, position_m: [-150.0 + 5.0 * t_s, 300.0 + 2.0 * t_s, 0.0] }
            })
            .collect()
    }

    /// 87 bearings, one a second, of an array at −35.1° with η = 0.976 whose clock is 2 s late.
    pub fn bearings(noise: f64) -> Vec<LineBearing> {
        let track = track();
        (0..87)
            .filter_map(|k| {
                let t_s = f64::from(k);
                let [x, y, _] = position_at(&track, t_s - 2.0, 60.0)?;
                let e = noise * 1.4 * (2.1 * t_s + 0.3 * t_s * t_s).sin();
                Some(LineBearing { t_s, sine: 0.976 * (x.atan2(y) + 35.1 * RAD_PER_DEG).cos() + e })
            })
            .collect()
    }

    #[test]
    fn exact_bearings_give_the_exact_answer() {
        let found = orient(&bearings(0.0), &track(), &SETTINGS).unwrap();
        assert!(wrap_pi(found.orientation + 35.1 * RAD_PER_DEG).abs() < 1e-4, "{found:?}");
        assert!((found.time_shift_s - 2.0).abs() < 1e-2 && (found.eta - 0.976).abs() < 1e-4, "{found:?}");
        assert!(found.mean_error < 1e-3 && found.sd < 1e-3);
    }

    #[test]
    fn noise_and_wrong_bearings_are_survived() {
        let mut b = bearings(0.004);
        for (i, x) in b.iter_mut().enumerate() {
            if i % 11 == 3 {
                x.sine = 0.9 - x.sine;
            }
        }
        let found = orient(&b, &track(), &SETTINGS).unwrap();
        let error = wrap_pi(found.orientation + 35.1 * RAD_PER_DEG).abs();
        assert!(error < 0.3 * RAD_PER_DEG && error < 4.0 * found.sd, "{found:?}");
        assert!((found.time_shift_s - 2.0).abs() < 1.0, "{found:?}");
        let whole = orient(&b, &track(), &LineSettings { whole_s: 1.0, ..SETTINGS }).unwrap();
        assert!((whole.time_shift_s - 2.0).abs() <= 1.0, "{whole:?}");
        // Exact bearings speak for a whole shift, and against one that is not a multiple.
        let whole = orient(&bearings(0.0), &track(), &LineSettings { whole_s: 1.0, ..SETTINGS }).unwrap();
        assert!((whole.time_shift_s - 2.0).abs() < 1e-6 && whole.sd_time_shift_s < 1e-3, "{whole:?}");
        let free = orient(&bearings(0.0), &track(), &LineSettings { whole_s: 1.5, ..SETTINGS }).unwrap();
        assert!((free.time_shift_s - 2.0).abs() < 1e-2, "{free:?}");
    }

    #[test]
    fn a_bearing_that_never_turns_is_refused() {
        let track: Vec<_> = (0..9)
            .map(|k| TrackPoint { t_s: 10.0 * f64::from(k), position_m: [0.0, 500.0 + f64::from(k), 0.0] })
            .collect();
        let b: Vec<_> =
            (0..80).map(|k| LineBearing { t_s: f64::from(k), sine: 0.3 + 0.01 * f64::from(k % 3) }).collect();
        let e = orient(&b, &track, &SETTINGS);
        assert!(matches!(e, Err(OrientError::NotObservable | OrientError::TooFew)), "{e:?}");
        assert_eq!(orient(&b[..3], &track, &SETTINGS), Err(OrientError::TooFew));
    }
}
