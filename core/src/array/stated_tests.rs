//! Whether what a bearing states of its error holds.

use super::super::test_sea::{Normal, error_from, hear, noisy, planned, source, standardised};
use crate::angle::unit_vector;
use crate::array::wavefront;
use crate::wire::Bearing;
use std::vec::Vec;

/// A bearing and the direction it should have.
type Told = (Bearing, (f64, f64));

/// Root mean square azimuth error and stated standard deviation, degrees, and share of ellipses that hold the truth, %.
fn held(bearings: &[Told]) -> (f64, f64, f64) {
    let n = bearings.len() as f64;
    let rms = |f: &dyn Fn(&Told) -> f64| (bearings.iter().map(f).sum::<f64>() / n).sqrt().to_degrees();
    let within = bearings.iter().filter(|(b, at)| standardised(b, *at) < 5.991).count();
    (
        rms(&|(b, at)| error_from(b, *at).0.powi(2)),
        rms(&|(b, _)| f64::from(b.var_azimuth)),
        100.0 * within as f64 / n,
    )
}

#[test]
fn white_noise_is_no_coherence() {
    let plan = planned(64_000.0, |array| array.vessel_depth_m = 0.0);
    for snr_db in [-12.0, -14.0] {
        let mut all = Vec::new();
        for n in 0..6u64 {
            let at = (0.3 + n as f64, 0.1 + 0.1 * n as f64);
            let sound = source(&plan, at, 10f64.powf(snr_db / 20.0), Some(300.0), 8, 50 + n);
            let heard = hear(&plan, &noisy(sound, 90 + n));
            all.extend(heard.bearings.iter().filter(|b| b.band == 0 && b.flags == 0).map(|b| (*b, at)));
        }
        let (rms, stated, within) = held(&all);
        std::println!(
            "{snr_db} dB in white noise: {} bearings, azimuth {rms:.3} of {stated:.3} degrees, {within:.1} % in",
            all.len()
        );
        assert!((88.0..=98.5).contains(&within), "{within}");
    }
}

#[test]
fn positions_told_uncertain_are_counted() {
    for sd_m in [0.01, 0.03] {
        let told = planned(16_000.0, |array| {
            array.position_sd_m = sd_m;
            array.vessel_depth_m = 0.0;
        });
        let mut random = Normal(17);
        let mut all = Vec::new();
        for n in 0..120u64 {
            let built = planned(16_000.0, |array| {
                array.hydrophones_m.iter_mut().flatten().for_each(|x| *x += sd_m * random.next());
            });
            let at = (0.05 * n as f64, 0.2 + 0.003 * n as f64);
            let heard = hear(&told, &noisy(source(&built, at, 3.0, None, 2, n), 200 + n));
            all.extend(heard.bearings.iter().filter(|b| b.band == 0 && b.flags == 0).map(|b| (*b, at)));
        }
        let (rms, stated, within) = held(&all);
        std::println!("{sd_m} m: azimuth {rms:.2} of {stated:.2} degrees, {within:.1} % in the ellipse");
        assert!((90.0..=98.5).contains(&within), "{within}");
    }
}

#[test]
fn another_source_is_in_the_angle_that_it_turns() {
    let plan = planned(16_000.0, |array| array.vessel_depth_m = 0.0);
    let at = (1.0, 0.5);
    // Standard deviation of azimuth (as an angle in space) over that of elevation.
    let stated = |beside: (f64, f64)| {
        let mut sound = source(&plan, at, 4.0, None, 12, 5);
        for (sum, other) in sound.iter_mut().zip(source(&plan, beside, 1.8, None, 12, 6)) {
            sum.iter_mut().zip(other).for_each(|(sum, x)| *sum += x);
        }
        let heard = hear(&plan, &noisy(sound, 7));
        let late = heard.bearings.iter().filter(|b| b.band == 0 && b.index > 5 * 16_000);
        let told: Vec<_> = late.map(|b| (*b, at)).collect();
        let (rms, sd, within) = held(&told);
        let ratios = told.iter().map(|(b, _)| f64::from(b.var_azimuth / b.var_elevation));
        let ratio = (ratios.sum::<f64>() / told.len() as f64).sqrt() * at.1.cos();
        std::println!(
            "beside {beside:?}: azimuth {rms:.3} of {sd:.3} degrees, {within:.0} % in, ratio {ratio:.2}"
        );
        assert!(within >= 85.0, "{within}");
        ratio
    };
    let (below, aside) = (stated((1.0, -0.5)), stated((2.2, 0.5)));
    assert!(below < 0.5, "from below: {below}");
    assert!(aside > 0.8, "from aside: {aside}");
}

#[test]
fn lines_alone_give_no_direction_and_with_the_vessels_noise_they_take_none_away() {
    let plan = planned(64_000.0, |array| array.vessel_depth_m = 0.0);
    for (n, lines_hz) in
        [&[1130.0][..], &[300.0, 600.0, 900.0], &[120.0, 240.0, 480.0, 1130.0]].iter().enumerate()
    {
        let at = (0.4 + 1.9 * n as f64, 0.15);
        let u = unit_vector(at.0 as f32, at.1 as f32);
        let delays = wavefront::arrivals(plan.geometry(), &u, 1.0 / 500.0);
        let told = |noise_rms: f64| {
            let mut sea = noisy(source(&plan, at, noise_rms, None, 10, 60 + n as u64), 80 + n as u64);
            for (i, x) in sea.iter_mut().enumerate() {
                for (x, delay) in x.iter_mut().zip(&delays) {
                    let t = i as f64 / 64e3 - f64::from(*delay);
                    *x += lines_hz.iter().map(|f| (core::f64::consts::TAU * f * t).sin()).sum::<f64>();
                }
            }
            // Of two lines in the octave from 500 Hz, which has four bins, what is left of a vessel may still pass for another.
            let mut bearings = hear(&plan, &sea).bearings;
            bearings.retain(|b| b.band == 0);
            let wrong = bearings.iter().filter(|b| standardised(b, at) > 16.0).count();
            (bearings.len(), wrong)
        };
        let (alone, wrong) = told(0.0);
        assert!(alone <= 1 && wrong <= 1, "{lines_hz:?}: {alone}, wrong {wrong}");
        let (with_noise, wrong) = told(1.0);
        assert!(with_noise >= 18 && wrong == 0, "{lines_hz:?}: {with_noise}, wrong {wrong}");
    }
}
