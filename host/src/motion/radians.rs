//! Whether azimuths that are given as degrees are radians.
//!
//! In: bearings all of whose azimuths are numbers between −π and 2π. Out: yes, or no and not told. A vessel that passes on a straight course
//! turns slowly, fast at its closest, and slowly again; over a few degrees it turns evenly, whatever the course. So where a straight course
//! fits the numbers as radians, and none does nearly as well as degrees, they are radians. Not told: fewer than `LEAST` bearings, a pass that as
//! radians too turns little, bearings whose errors hide which it is.

use super::estimate::batch;
use seabearing_core::angle::{wrap_pi, wrap_tau};
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::ml::{Config, Sample};
use std::f64::consts::{PI, TAU};

/// Fewest bearings.
const LEAST: usize = 20;
/// Error with which both are fitted, in the file's numbers.
const ERROR: f64 = 0.05;
/// How many times the mean square of what is left of the numbers as radians that as degrees must be.
const WORSE: f64 = 25.0;
/// Root mean square of what may be left as radians (9°), and least turn as radians.
const LEFT: f64 = 0.15;
const LEAST_TURN: f64 = 1.0;
/// Farthest vessel that fits, metres.
const FARTHEST_M: f64 = 1e7;

/// Whether azimuths read as degrees are radians. What is assumed of the vessel is `config`'s.
pub fn are_radians(config: &Config, samples: &[Sample]) -> bool {
    let numbers: Vec<f64> = samples.iter().map(|s| wrap_pi(s.azimuth_rad).to_degrees()).collect();
    if numbers.len() < LEAST || !numbers.iter().all(|x| (-PI - 1e-3..=TAU + 1e-3).contains(x)) {
        return false;
    }
    let (mut at, mut low, mut high) = (0.0f64, 0.0f64, 0.0f64);
    for pair in numbers.windows(2) {
        at += wrap_pi(pair[1] - pair[0]);
        (low, high) = (low.min(at), high.max(at));
    }
    if high - low < LEAST_TURN {
        return false;
    }
    // However far away: it is the shape alone that counts.
    let config =
        Config { model: Model::White, tau_s: 0.0, range_m: (config.range_m.0, FARTHEST_M), ..*config };
    let left = |unit: f64| {
        let as_read = |(s, x): (&Sample, &f64)| Sample::azimuth(s.t_s, wrap_tau(x * unit), ERROR * unit);
        let samples: Vec<Sample> = samples.iter().zip(&numbers).map(as_read).collect();
        batch(&config, &samples, false).ok().map(|found| found.solution.consistency)
    };
    let (Some(degrees), Some(radians)) = (left(1f64.to_radians()), left(1.0)) else { return false };
    radians * ERROR * ERROR < LEFT * LEFT && degrees > WORSE * radians
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};
    use seabearing_core::motion::Medium;

    fn config() -> Config {
        Config {
            model: Model::White,
            tau_s: 0.0,
            white_share: 0.0,
            speed_m_s: 7.3,
            speed_sd_m_s: 2.3,
            range_m: (5.0, 20_000.0),
            medium: Medium::of_sound_speed(1484.0),
            elevation_bias_sd_rad: 0.0,
            acceleration_sd_m_s2: 0.0,
        }
    }

    /// Azimuths (radians) of a straight course, with errors; `bends`: how it sways aside, metres.
    fn pass(cpa_m: f64, long_s: f64, sd_deg: f64, bends_m: f64, seed: u64) -> Vec<(f64, f64)> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let heading = normal() * 3.0;
        (0..200)
            .map(|k| {
                let t_s = long_s * f64::from(k) / 199.0;
                let along = 6.0 * (t_s - 0.45 * long_s);
                let aside = cpa_m + bends_m * (7.0 * t_s / long_s).sin();
                (t_s, (along / aside).atan() + heading + sd_deg.to_radians() * normal())
            })
            .collect()
    }

    fn told(azimuths: &[(f64, f64)], unit: f64) -> bool {
        let sample = |(t_s, x): &(f64, f64)| Sample::azimuth(*t_s, wrap_tau(x * unit), 1f64.to_radians());
        are_radians(&config(), &azimuths.iter().map(sample).collect::<Vec<_>>())
    }

    #[test]
    fn radians_of_a_pass_are_told() {
        for seed in 0..12 {
            let of = |sd_deg| {
                let wrap = |(t, x): (f64, f64)| (t, if seed % 2 == 0 { wrap_tau(x) } else { wrap_pi(x) });
                pass(200.0 + 50.0 * seed as f64, 300.0, sd_deg, 0.0, seed)
                    .into_iter()
                    .map(wrap)
                    .collect::<Vec<_>>()
            };
            for sd_deg in [0.0, 0.3, 1.0] {
                assert!(told(&of(sd_deg), 1f64.to_radians()), "{seed} {sd_deg}");
                // The same pass in degrees, as it should be, covers more; noise that hides the shape tells nothing.
                assert!(!told(&of(sd_deg), 1.0));
            }
            assert!(!told(&of(25.0), 1f64.to_radians()));
        }
    }

    #[test]
    fn passes_over_few_degrees_are_not() {
        for seed in 0..40 {
            for sd_deg in [0.01, 0.2, 1.0] {
                // Far vessels about North: 1 to 6° in all, straight or swaying.
                let far = 20_000.0 + 1000.0 * seed as f64;
                for bends_m in [0.0, 300.0] {
                    let azimuths: Vec<(f64, f64)> = pass(far, 250.0, sd_deg, bends_m, seed);
                    let first = azimuths[0].1;
                    let about: Vec<(f64, f64)> = azimuths.iter().map(|(t, x)| (*t, x - first)).collect();
                    assert!(!told(&about, 1.0), "{seed} {sd_deg} {bends_m}");
                }
            }
        }
    }
}
