//! The recorder's passage fit against the batch fit, and what must not change it: turning the map, shifting the clock,
//! mirroring the passage, scaling range with speed.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use seabearing_core::angle::wrap_pi;
use seabearing_core::motion::{Line, Medium, Solution};
use seabearing_core::passage::{self, Config, Measurement, RECORDED};
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::ml::{self, Sample};
use seabearing_locate::motion::whiten::Workspace;

/// What the recorder keeps of a vessel.
type Passage = passage::Passage<RECORDED>;

fn config(sd_rad: f64, tau_s: f64) -> Config {
    Config {
        speed_m_s: 7.0,
        speed_sd_m_s: 0.0,
        extra_sd_rad: sd_rad,
        extra_tau_s: tau_s,
        medium: Medium::of_sound_speed(1484.0),
        // As the batch fit: a way is exactly straight.
        course_sd_rad: 0.0,
        ..Config::default()
    }
}

fn track(c: &Config, bearings: &[(f64, f64)]) -> Passage {
    let mut passage = Passage::new();
    for (t_s, azimuth_rad) in bearings {
        passage.push(c, &Measurement::azimuth(*t_s, *azimuth_rad, 0.0));
        while passage.work(c) {}
    }
    passage
}

fn bearings(line: &Line, c: &Config, seed: u64) -> Vec<(f64, f64)> {
    let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
    let keep = if c.extra_tau_s > 0.0 { (-0.5 / c.extra_tau_s).exp() } else { 0.0 };
    let mut e: f64 = rng.sample(StandardNormal);
    (0..400)
        .map(|k| {
            let t = 0.5 * f64::from(k);
            let now = e;
            e = keep * e + (1.0 - keep * keep).sqrt() * rng.sample::<f64, _>(StandardNormal);
            (t, line.azimuth(&c.medium, t) + c.extra_sd_rad * now)
        })
        .collect()
}

fn pass(alpha: f64, t_c: f64, range_m: f64, sense: f64) -> Line {
    Line { p: [alpha, t_c, (7.0 / range_m).ln(), 7f64.ln(), 0.0], sense }
}

#[test]
fn agrees_with_the_batch_within_a_third_of_the_reported_spread() {
    let mut work = Box::new(Workspace::<401>::new());
    for (i, (sd_deg, tau_s, range_m)) in
        [(0.1, 0.0, 500.0), (2.0, 0.0, 500.0), (0.5, 5.0, 500.0), (0.5, 5.0, 200.0), (2.0, 50.0, 700.0)]
            .into_iter()
            .enumerate()
    {
        let c = config(f64::to_radians(sd_deg), tau_s);
        let mut squares = 0.0;
        for run in 0..8 {
            let sense = if run % 2 == 0 { 1.0 } else { -1.0 };
            let truth = pass(6.1 + 0.3 * f64::from(run), 100.0, range_m, sense);
            let b = bearings(&truth, &c, 100 * i as u64 + run as u64);
            let samples: Vec<_> = b.iter().map(|(t, a)| Sample::azimuth(*t, *a, c.extra_sd_rad)).collect();
            let model = if tau_s > 0.0 { Model::Markov } else { Model::White };
            let batch = ml::Config {
                model,
                tau_s,
                white_share: 0.0,
                speed_m_s: 7.0,
                speed_sd_m_s: 0.0,
                range_m: c.range_m,
                medium: c.medium,
                elevation_bias_sd_rad: 0.0,
                acceleration_sd_m_s2: 0.0,
            };
            let a = ml::fit(&batch, &samples, &mut work, &mut []).unwrap().solution;
            let mut passage = track(&c, &b);
            for r in [passage.solution(&c).unwrap(), passage.finish(&c).unwrap()] {
                let d = [
                    (r.cpa_range_m - a.cpa_range_m) / a.sd_cpa_range_m,
                    wrap_pi(r.heading_rad - a.heading_rad) / a.sd_heading_rad,
                    (r.cpa_time_s - a.cpa_time_s) / a.sd_cpa_time_s,
                ];
                let worst = d.iter().fold(0.0f64, |m, x| m.max(x.abs()));
                assert!(worst < 0.3, "{sd_deg} {tau_s} {range_m} {run}: {d:?}");
                squares += worst * worst / 16.0;
                assert!((r.sd_cpa_range_m / a.sd_cpa_range_m - 1.0).abs() < 0.1, "{r:?} {a:?}");
                assert_eq!(r.starboard, sense > 0.0);
            }
        }
        assert!(squares.sqrt() < 0.3, "{sd_deg} {tau_s} {range_m}: {}", squares.sqrt());
    }
}

/// The solution of a passage, moved back by what was done to it.
fn solve(c: &Config, b: &[(f64, f64)]) -> Solution {
    track(c, b).finish(c).unwrap()
}

/// Range and heading of a pass for a speed and for `factor` times that speed: without travel time, bearings know no
/// scale [M 5, 6].
fn range_scales(seed: u64, factor: f64) -> Result<(), TestCaseError> {
    let still = Config { medium: Medium::of_sound_speed(f64::INFINITY), ..config(0.01, 0.0) };
    let b = bearings(&pass(1.0, 90.0, 500.0, 1.0), &still, seed);
    let faster = Config { speed_m_s: 7.0 * factor, ..still };
    // On the way, too: a line that has run astray must not be stopped by a limit in metres at one speed only.
    let (mut slow, mut fast) = (Passage::new(), Passage::new());
    for (t_s, azimuth_rad) in &b {
        if let (Some(x), Some(y)) = (slow.expected(&still, *t_s), fast.expected(&faster, *t_s)) {
            prop_assert!((x.1 / y.1 - 1.0).abs() < 1e-3, "at {} s: {:?} and {:?}", t_s, x, y);
        }
        for (passage, c) in [(&mut slow, &still), (&mut fast, &faster)] {
            passage.push(c, &Measurement::azimuth(*t_s, *azimuth_rad, 0.0));
            while passage.work(c) {}
        }
    }
    let (a, s) = (slow.finish(&still).unwrap(), fast.finish(&faster).unwrap());
    prop_assert!((s.cpa_range_m / a.cpa_range_m / factor - 1.0).abs() < 1e-6);
    prop_assert!(wrap_pi(s.heading_rad - a.heading_rad).abs() < 1e-6);
    Ok(())
}

#[test]
fn range_scales_where_young_lines_ran_into_a_limit() {
    for (seed, factor) in [(950, 1.9606), (521, 0.6181)] {
        range_scales(seed, factor).unwrap();
    }
}

proptest! {
    #![proptest_config(seabearing_testkit::property(12))]

    #[test]
    fn turning_shifting_and_mirroring_change_nothing_else(
        turn in 0.0f64..6.0, shift in -1e5f64..1e5, seed in 0u64..1000, range_m in 150.0f64..1200.0
    ) {
        let c = config(0.01, 5.0);
        let b = bearings(&pass(1.0, 90.0, range_m, 1.0), &c, seed);
        let base = solve(&c, &b);
        let moved: Vec<_> = b.iter().map(|(t, a)| (t + shift, a + turn)).collect();
        let other = solve(&c, &moved);
        prop_assert!((other.cpa_range_m - base.cpa_range_m).abs() < 1e-2 * base.sd_cpa_range_m);
        prop_assert!((other.cpa_time_s - base.cpa_time_s - shift).abs() < 1e-2 * base.sd_cpa_time_s);
        prop_assert!(wrap_pi(other.heading_rad - base.heading_rad - turn).abs() < 1e-2 * base.sd_heading_rad);
        let mirrored: Vec<_> = b.iter().map(|(t, a)| (*t, -a)).collect();
        let other = solve(&c, &mirrored);
        prop_assert!((other.cpa_range_m - base.cpa_range_m).abs() < 1e-2 * base.sd_cpa_range_m);
        prop_assert!(wrap_pi(other.heading_rad + base.heading_rad).abs() < 1e-2 * base.sd_heading_rad);
        prop_assert!(other.starboard != base.starboard);
    }

    #[test]
    fn range_scales_with_the_speed_assumed(seed in 0u64..1000, factor in 0.5f64..2.0) {
        range_scales(seed, factor)?;
    }

    #[test]
    fn whatever_comes_in_nothing_infinite_comes_out(
        raw in proptest::collection::vec((-10.0f64..10.0, -7.0f64..7.0, 0.0f64..0.1), 0..150)
    ) {
        let c = Config::default();
        let mut passage = Passage::new();
        let mut t = 0.0;
        for (dt, azimuth_rad, variance_rad2) in raw {
            t += dt.max(-0.5);
            passage.push(&c, &Measurement::azimuth(t, azimuth_rad, variance_rad2));
            passage.work(&c);
        }
        for s in [passage.solution(&c), passage.finish(&c)].into_iter().flatten() {
            let all = [s.cpa_time_s, s.cpa_range_m, s.heading_rad, s.sd_cpa_time_s, s.position1_m[0], s.covariance1_m2[0]];
            prop_assert!(all.iter().all(|x| x.is_finite()), "{s:?}");
            prop_assert!(!s.sd_heading_rad.is_nan() && !s.sd_cpa_range_m.is_nan());
        }
    }
}
