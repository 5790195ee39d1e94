//! What a compact array's fit says against itself.
//!
//! In: by how much each bearing misses the track under the rotation found, along the horizon and upwards, and the clock's shift. Out: a clause
//! for each thing that makes the deviations too small. Errors of measurement change from bearing to bearing, or last and are what was
//! stated; those of another vessel's track or another clock last for parts of the pass and are larger than both. Judged are the medians
//! of ten parts of the pass: against the errors stated, or where none are, against the scatter of successive bearings; what tracks and
//! places are usually off by is allowed beside.
//!
//! Not seen: a wrong track or clock that a turn of the array explains, as of a distant vessel.

use seabearing_core::angle::RAD_PER_DEG;
use seabearing_core::kit::{Huber, median};

/// Parts of the pass.
const PARTS: usize = 10;
/// What a track, with the way from its antenna to what is heard, is off by for long, metres.
const TRACK_M: f64 = 3.0;
/// How often the stated error what lasts may be: of ten independent errors in a pass the root mean square is less in 999 of 1000.
const BEYOND_STATED: f64 = 1.5;
/// How often the scatter of successive bearings: errors of which each has 0.95 of the one before last 4.4 times as large.
const BEYOND_SCATTER: f64 = 5.0;
/// Variance of the median of m normal numbers, times m.
const MEDIAN_VARIANCE: f64 = 1.57;
/// Where an error is a wrong bearing's, and is cut, in standard deviations.
const CORNER: Huber = Huber { corner: 2.5 };
/// Standard deviations of the shift within which the end of what was searched is one it may have, and beyond which it is one at all.
const NEAR_SD: f64 = 2.0;

/// By how much a bearing misses the track.
#[derive(Clone, Copy, Debug)]
pub(super) struct Missed {
    /// Along the horizon, radians.
    pub(super) along: f64,
    /// Upwards, radians.
    pub(super) up: f64,
    /// Standard deviation of either, where one is stated, radians.
    pub(super) sd: Option<f64>,
    /// Distance of the vessel, metres.
    pub(super) range_m: f64,
}

/// The clauses. `places`: variance of what places and the speed of sound do to all bearings, radians²; the shift and its deviation, the
/// largest that was searched, and the step of the search, seconds.
pub(super) fn doubts(
    missed: &[Missed],
    places: f64,
    (shift_s, sd_s): (f64, f64),
    most_s: f64,
    step_s: f64,
) -> Vec<String> {
    let mut all = Vec::new();
    let reach_s = if shift_s.abs() > NEAR_SD * sd_s { NEAR_SD * sd_s } else { 0.0 };
    if most_s > 0.0 && shift_s.abs() + reach_s.max(1.5 * step_s) > most_s {
        all.push(format!(
            "the likeliest shift of the clocks, {shift_s:.1} ± {sd_s:.1} s, reaches to the largest that was searched, {most_s:.1} s: are the \
             track's times others? (--max-shift-s)"
        ));
    }
    if let Some((lasts, usual)) = lasting(missed, places) {
        all.push(format!(
            "bearings miss the track by {:.1}° for a tenth of the pass on end, and one by itself errs by {:.1}°: was another vessel than the \
             track's heard, or are the track's times others?",
            lasts / RAD_PER_DEG,
            usual / RAD_PER_DEG
        ));
    }
    all
}

/// What the parts of the pass miss by, and what a bearing by itself does, where the first is too large: root mean squares, radians.
fn lasting(missed: &[Missed], places: f64) -> Option<(f64, f64)> {
    let parts = PARTS.min(missed.len());
    let length = missed.len() as f64 / parts.max(1) as f64;
    let by_track = |m: &Missed| (TRACK_M / m.range_m).powi(2) + places;
    let stated = missed.iter().all(|m| m.sd.is_some());
    let of = |side: fn(&Missed) -> f64| {
        let sides: Vec<f64> = missed.iter().map(side).collect();
        let scatter = if stated { 0.0 } else { successive(&sides) };
        let own = |m: &Missed| m.sd.unwrap_or(scatter).powi(2);
        let usual = (missed.iter().map(own).sum::<f64>() / missed.len().max(1) as f64).sqrt();
        let times = if stated { BEYOND_STATED } else { BEYOND_SCATTER };
        let allowed = |m: &Missed| times * (own(m) * (1.0 + MEDIAN_VARIANCE / length) + by_track(m)).sqrt();
        let (mut square, mut told) = (0.0, 0.0);
        for k in 0..parts {
            let part = &missed[k * missed.len() / parts..(k + 1) * missed.len() / parts];
            let mut in_units: Vec<f64> = part.iter().map(|m| side(m) / allowed(m)).collect();
            square += median(&mut in_units).unwrap_or(0.0).powi(2);
            let mut as_is: Vec<f64> = part.iter().map(side).collect();
            told += median(&mut as_is).unwrap_or(0.0).powi(2);
        }
        let n = parts.max(1) as f64;
        (square > n).then(|| ((told / n).sqrt(), usual))
    };
    let larger = |a: (f64, f64), b: (f64, f64)| if a.0 > b.0 { a } else { b };
    [of(|m| m.along), of(|m| m.up)].into_iter().flatten().reduce(larger)
}

/// Standard deviation of one number by how those that follow each other differ; what lasts is no part of it.
fn successive(all: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = all.iter().map(|x| x.abs()).collect();
    let scale = (1.4826 * median(&mut sizes).unwrap_or(0.0)).max(1e-9);
    let kept: Vec<f64> = all.iter().map(|x| scale * CORNER.clipped(x / scale)).collect();
    let squares: f64 = kept.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum();
    (0.5 * squares / kept.len().saturating_sub(1).max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// So many bearings at 500 m that err by 0.3°, each with such a share of the error before, and by a swing along the horizon; the mean is
    /// what a fit takes out.
    fn missed(n: usize, share: f64, swing_deg: f64, stated: bool, seed: u64) -> Vec<Missed> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut last = [0.0; 2];
        let sd = 0.3 * RAD_PER_DEG;
        let mut all: Vec<Missed> = (0..n)
            .map(|k| {
                for x in &mut last {
                    let own: f64 = StandardNormal.sample(&mut rng);
                    *x = if k == 0 { own } else { share * *x + (1.0 - share * share).sqrt() * own };
                }
                let swing = swing_deg * RAD_PER_DEG * (12.0 * k as f64 / n as f64).sin();
                let [along, up] = last.map(|x| sd * x);
                Missed { along: along + swing, up, sd: stated.then_some(sd), range_m: 500.0 }
            })
            .collect();
        let mean = |side: fn(&Missed) -> f64| all.iter().map(side).sum::<f64>() / n as f64;
        let (along, up) = (mean(|m| m.along), mean(|m| m.up));
        for m in &mut all {
            m.along -= along;
            m.up -= up;
        }
        all
    }

    #[test]
    fn errors_as_stated_and_errors_that_last_are_no_doubt() {
        for n in [10, 25, 60, 200, 2000] {
            for share in [0.0, 0.5, 0.9, 0.95] {
                for seed in 0..40 {
                    for stated in [true, false] {
                        let found = lasting(&missed(n, share, 0.0, stated, seed), 0.0);
                        assert!(found.is_none(), "{n} {share} {stated} {seed}: {found:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn what_lasts_beyond_both_is_one() {
        for seed in 0..40 {
            assert!(lasting(&missed(200, 0.0, 1.5, true, seed), 0.0).is_some());
            assert!(lasting(&missed(200, 0.0, 6.0, false, seed), 0.0).is_some());
            // Nor where hydrophones may be off by as much.
            let places = (2.0 * RAD_PER_DEG).powi(2);
            assert!(lasting(&missed(200, 0.0, 1.5, true, seed), places).is_none());
        }
    }

    #[test]
    fn a_shift_that_reaches_to_the_end_is_one_and_an_unknown_one_is_none() {
        let at = |shift_s: f64, sd_s: f64| !doubts(&[], 0.0, (shift_s, sd_s), 20.0, 1.0).is_empty();
        assert!(at(17.9, 2.5) && at(-19.0, 0.1) && !at(12.0, 2.5) && !at(0.5, 11.0) && !at(0.0, 0.1));
    }
}
