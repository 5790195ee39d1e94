//! The antenna is not the propeller: the time shift between a vessel's reported track and where it is heard from.
//!
//! `τ_p = argmin Σ_k ρ(θ̂_k − θ(t_k − τ))` over the vessel's own track, `r_P(t) = r_GPS(t − τ_p)` [N 22]; the paper
//! uses elevation and squares, here azimuth too, and Huber's ρ so that single wrong bearings do not pull. A grid over
//! the admissible shifts, then golden sections. Positive shifts: the sound source is behind the antenna.
//!
//! Fails (says so) where the vessel's direction hardly changes, or where the best shift is at a limit.

use super::known_track::{KnownTrackError, TrackPoint, check, position_at};
use super::model::bearing;
use crate::angle::wrap_pi;
use crate::kit::{Huber, golden};
use crate::math::f64 as m;

/// Fewest bearings that say anything of a shift and its error.
pub const LEAST_BEARINGS: usize = 8;
/// Grid steps across the admissible shifts.
const GRID: u32 = 200;

/// One bearing of the vessel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedBearing {
    /// Time, seconds, on the track's clock.
    pub t_s: f64,
    /// Azimuth, radians, where used.
    pub azimuth: Option<f64>,
    /// Elevation, radians, where used.
    pub elevation: Option<f64>,
}

/// What the fit is told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlignSettings {
    /// East, North, Up of the array, metres.
    pub array_m: [f64; 3],
    /// Standard deviations of azimuth and elevation, radians.
    pub sd: [f64; 2],
    /// Largest shift considered either way, seconds.
    pub largest_shift_s: f64,
    /// Longest gap of the track that is interpolated, seconds.
    pub gap_s: f64,
}

/// The shift found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shift {
    /// `τ_p`, seconds.
    pub shift_s: f64,
    /// Its standard deviation, seconds.
    pub sd_s: f64,
    /// Bearings used.
    pub n: usize,
}

/// Why there is no shift.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AlignError {
    /// The track is unusable.
    Track(KnownTrackError),
    /// A setting is not a positive finite number.
    FixSettings,
    /// Fewer than [`LEAST_BEARINGS`] bearings fall on the track.
    TooFew,
    /// The direction of the vessel hardly changes, or the best shift is at a limit.
    NotObservable,
}

impl core::fmt::Display for AlignError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Track(KnownTrackError::TooShort) => "the track has fewer than two positions",
            Self::Track(KnownTrackError::NotIncreasing(_)) => "the track's times do not rise",
            Self::Track(KnownTrackError::NotFinite) => "a position of the track is not a number",
            Self::FixSettings => "a setting is not a positive number",
            Self::TooFew => "fewer than eight bearings fall on the track",
            Self::NotObservable => {
                "not observable: the vessel's direction hardly changes, or the shift is at its limit"
            }
        })
    }
}

impl core::error::Error for AlignError {}

/// Finds the shift.
///
/// # Errors
/// [`AlignError`].
pub fn align(
    heard: &[TimedBearing],
    track: &[TrackPoint],
    settings: &AlignSettings,
) -> Result<Shift, AlignError> {
    check(track).map_err(AlignError::Track)?;
    let [sa, sb] = settings.sd;
    let limit = settings.largest_shift_s;
    let positive = sa > 0.0 && sb > 0.0 && limit > 0.0 && settings.gap_s > 0.0;
    if !positive || !(sa + sb + limit).is_finite() || !settings.array_m.iter().all(|x| x.is_finite()) {
        return Err(AlignError::FixSettings);
    }
    let most = (0..=GRID).map(|k| mean_cost(heard, track, settings, at(limit, k)).1).max().unwrap_or(0);
    if most < LEAST_BEARINGS {
        return Err(AlignError::TooFew);
    }
    // A shift that pushes a fifth of the bearings off the track is not comparable with one that keeps them.
    let mut best: Option<(f64, u32)> = None;
    for k in 0..=GRID {
        let (c, n) = mean_cost(heard, track, settings, at(limit, k));
        if n >= LEAST_BEARINGS && 5 * n >= 4 * most && best.is_none_or(|(b, _)| c < b) {
            best = Some((c, k));
        }
    }
    let (_, k) = best.ok_or(AlignError::TooFew)?;
    if k == 0 || k == GRID {
        return Err(AlignError::NotObservable);
    }
    let shift_s =
        golden(at(limit, k - 1), at(limit, k + 1), 40, |tau| mean_cost(heard, track, settings, tau).0);
    let (scatter, information, n) = curvature(heard, track, settings, shift_s);
    // The mean squared standardised residual scales the error where bearings are worse than claimed.
    let sd_s = m::sqrt(scatter.max(1.0) / information);
    if !sd_s.is_finite() || sd_s > limit {
        return Err(AlignError::NotObservable);
    }
    Ok(Shift { shift_s, sd_s, n })
}

fn at(limit: f64, k: u32) -> f64 {
    limit * (2.0 * f64::from(k) / f64::from(GRID) - 1.0)
}

/// Mean Huber loss of the standardised residuals at a shift, and the number of bearings on the track.
fn mean_cost(
    heard: &[TimedBearing],
    track: &[TrackPoint],
    settings: &AlignSettings,
    tau: f64,
) -> (f64, usize) {
    let (mut sum, mut n) = (0.0, 0usize);
    for h in heard {
        let Some(residuals) = residuals(h, track, settings, tau) else { continue };
        n += 1;
        for r in residuals {
            sum += Huber::EFFICIENT.loss(r);
        }
    }
    if n == 0 { (f64::INFINITY, 0) } else { (sum / n as f64, n) }
}

/// Standardised azimuth and elevation residuals of one bearing; zero where an angle is not used.
fn residuals(h: &TimedBearing, track: &[TrackPoint], settings: &AlignSettings, tau: f64) -> Option<[f64; 2]> {
    let p = position_at(track, h.t_s - tau, settings.gap_s)?;
    let (azimuth, elevation) = bearing(&settings.array_m, &p);
    let [sa, sb] = settings.sd;
    let a = h.azimuth.map_or(0.0, |x| wrap_pi(x - azimuth) / sa);
    let b = h.elevation.map_or(0.0, |x| (x - elevation) / sb);
    (a.is_finite() && b.is_finite()).then_some([a, b])
}

/// Mean squared standardised residual, information about the shift (1/s²) and bearings used.
fn curvature(
    heard: &[TimedBearing],
    track: &[TrackPoint],
    settings: &AlignSettings,
    tau: f64,
) -> (f64, f64, usize) {
    const STEP_S: f64 = 0.05;
    let (mut squares, mut information, mut angles, mut n) = (0.0, 0.0, 0.0, 0usize);
    for h in heard {
        let (Some(r), Some(later), Some(earlier)) = (
            residuals(h, track, settings, tau),
            residuals(h, track, settings, tau + STEP_S),
            residuals(h, track, settings, tau - STEP_S),
        ) else {
            continue;
        };
        n += 1;
        angles += f64::from(u8::from(h.azimuth.is_some())) + f64::from(u8::from(h.elevation.is_some()));
        for ((x, up), down) in r.iter().zip(later).zip(earlier) {
            let slope = (up - down) / (2.0 * STEP_S);
            // Beyond Huber's constant a residual carries no curvature.
            if m::abs(*x) <= Huber::EFFICIENT.corner {
                information += slope * slope;
            }
            let bounded = Huber::EFFICIENT.clipped(*x);
            squares += bounded * bounded;
        }
    }
    if angles > 0.0 { (squares / angles, information, n) } else { (0.0, 0.0, 0) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn passage() -> Vec<TrackPoint> {
        (0..30)
            .map(|k| {
                let t_s = 10.0 * f64::from(k);
                TrackPoint { t_s, position_m: [300.0, -1000.0 + 7.0 * t_s, -5.0] }
            })
            .collect()
    }

    fn settings() -> AlignSettings {
        AlignSettings { array_m: [0.0, 0.0, -168.0], sd: [0.026, 0.028], largest_shift_s: 40.0, gap_s: 60.0 }
    }

    fn heard(shift: f64, azimuth: bool, elevation: bool) -> Vec<TimedBearing> {
        let track = passage();
        (0..200)
            .filter_map(|k| {
                let t_s = 40.0 + f64::from(k);
                let p = position_at(&track, t_s - shift, 60.0)?;
                let (a, b) = bearing(&[0.0, 0.0, -168.0], &p);
                // A regular error of one standard deviation, and one bearing in twenty that is wrong altogether.
                let e = if k % 2 == 0 { 0.01 } else { -0.01 } + if k % 20 == 7 { 0.8 } else { 0.0 };
                Some(TimedBearing {
                    t_s,
                    azimuth: azimuth.then_some(a + e),
                    elevation: elevation.then_some(b - e),
                })
            })
            .collect()
    }

    #[test]
    fn the_shift_is_found_from_either_angle() {
        for (azimuth, elevation) in [(true, false), (false, true), (true, true)] {
            let found = align(&heard(12.3, azimuth, elevation), &passage(), &settings()).unwrap();
            assert!((found.shift_s - 12.3).abs() < 0.4, "{found:?}");
            assert!(found.sd_s < 0.8 && found.n >= 190, "{found:?}");
        }
    }

    #[test]
    fn a_vessel_that_does_not_turn_the_bearing_is_refused() {
        let track: Vec<_> = (0..30)
            .map(|k| TrackPoint { t_s: 10.0 * f64::from(k), position_m: [500.0, 0.0, -5.0] })
            .collect();
        let (a, _) = bearing(&settings().array_m, &[500.0, 0.0, -5.0]);
        let heard: Vec<_> = (0..100)
            .map(|k| TimedBearing { t_s: 100.0 + f64::from(k), azimuth: Some(a), elevation: None })
            .collect();
        assert_eq!(align(&heard, &track, &settings()), Err(AlignError::NotObservable));
        assert_eq!(align(&heard[..3], &track, &settings()), Err(AlignError::TooFew));
    }
}
