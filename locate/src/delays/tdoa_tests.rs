//! Tests of directions from measured delays.

use super::*;
use crate::angle::unit_vector;

fn solver() -> Solver {
    let h = [[0.0, 0.0, 0.0], [0.52, -0.12, -0.81], [-0.46, -0.36, -0.8], [-0.14, 0.61, -0.77]];
    Solver::new(&Geometry::new(&h, 0.4, 1488.0).unwrap(), 500.0, None, (-90.0, 90.0))
}

fn delays(s: &Solver, azimuth: f32, elevation: f32) -> [f32; 6] {
    let u = unit_vector(azimuth, elevation);
    wavefront::pair_delays(&wavefront::arrivals(&s.geometry, &u, s.curvature(&u)))
}

#[test]
fn a_source_at_the_surface_is_as_far_away_as_its_elevation_tells() {
    let deep = solver().under_surface(60.0);
    for elevation in [0.1f32, 0.5, 1.2] {
        let measured = delays(&deep, 1.0, elevation);
        let found = |s: &Solver| s.solve(&mut Continuity::new(), 0.0, &measured).unwrap();
        let off = |x: DelaySolution| (x.azimuth - 1.0).hypot(x.elevation - elevation);
        let [known, assumed] = [off(found(&deep)), off(found(&solver()))];
        assert!(known < 1e-4 && assumed > 5.0 * known, "{elevation}: {known} {assumed}");
    }
}

#[test]
fn uncertain_positions_and_speed_are_in_the_covariance() {
    let at = |x: f32, h: usize, along: usize| {
        let mut places = [[0.0, 0.0, 0.0], [0.52, -0.12, -0.81], [-0.46, -0.36, -0.8], [-0.14, 0.61, -0.77]];
        places[h][along] += f64::from(x);
        Solver::new(&Geometry::new(&places, 0.4, 1488.0).unwrap(), 500.0, None, (-90.0, 90.0))
    };
    let truth = solver();
    let measured = delays(&truth, 1.0, 0.4);
    let told = solver().uncertain(0.01, 0.0).solve(&mut Continuity::new(), 0.0, &measured).unwrap();
    let untold = truth.solve(&mut Continuity::new(), 0.0, &measured).unwrap();
    // What wrong places of a centimetre, one coordinate at a time, do to the azimuth.
    let mut expected = 0.0;
    for h in 0..4 {
        for along in 0..3 {
            let wrong = at(0.01, h, along).solve(&mut Continuity::new(), 0.0, &measured).unwrap();
            expected += (wrong.azimuth - untold.azimuth).powi(2);
        }
    }
    let stated = told.var_azimuth - untold.var_azimuth;
    assert!((stated / expected - 1.0).abs() < 0.1, "{stated} {expected}");
    // An arrival that is off by as long as sound takes for what the places are.
    let late = solver().late([0.01 / 1488.0; 4]).solve(&mut Continuity::new(), 0.0, &measured).unwrap();
    assert!((late.var_azimuth / told.var_azimuth - 1.0).abs() < 1e-4, "{late:?} {told:?}");
    let fast = solver().uncertain(0.0, 15.0).solve(&mut Continuity::new(), 0.0, &measured).unwrap();
    assert!(fast.var_elevation > 10.0 * untold.var_elevation.max(1e-9), "{fast:?} {untold:?}");
}

#[test]
fn exact_delays_give_their_direction() {
    let s = solver();
    for n in 0..60 {
        let (az, el) = (n as f32 * 0.104, -1.2 + n as f32 * 0.04);
        let got = s.solve(&mut Continuity::new(), 0.0, &delays(&s, az, el)).unwrap();
        let off = wavefront::dot(&got.direction, &unit_vector(az, el));
        assert!(off > 1.0 - 1e-6, "{az} {el}");
        assert!(got.residual_s < 1e-8 && got.closure_s < 1e-8 && got.dropped == 0);
        assert!(got.accepted, "all pairs agree exactly: {az} {el}");
    }
}

#[test]
fn a_wrong_pair_is_left_out_and_continuity_carries_two() {
    let s = solver();
    let mut c = Continuity::new();
    for n in 0..40 {
        let az = 1.0 + 0.004 * n as f32;
        let mut d = delays(&s, az, 0.6);
        if n >= 5 {
            d[n % 6] += 9e-5;
        }
        if n >= 20 {
            d[(n + 2) % 6] -= 13e-5;
        }
        let got = s.solve(&mut c, n as f64, &d).unwrap();
        let off = m::acos(wavefront::dot(&got.direction, &unit_vector(az, 0.6)).min(1.0));
        assert!(got.accepted, "set {n}");
        assert!(off < 0.002, "set {n} errs by {off}");
        assert_eq!(got.dropped.count_ones(), u32::from(n >= 5) + u32::from(n >= 20), "set {n}");
    }
}

#[test]
fn stated_ellipses_hold_what_arrivals_and_pairs_err_by() {
    let s = solver();
    let mut state = 11u64;
    // Sums of twelve even numbers: normal enough for 95 %.
    let mut normal = || {
        (0..12).fold(-6.0f32, |sum, _| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum + (state >> 40) as f32 / 16_777_216.0
        })
    };
    for (arrivals_s, pairs_s) in [(4e-6, 0.0), (4e-6, 4e-6), (8e-6, 6e-6)] {
        let (mut held, mut all) = (0, 0);
        for pass in 0..20 {
            let mut c = Continuity::new();
            for n in 0..150 {
                let (az, el) = (0.3 * pass as f32 + 0.01 * n as f32, 0.6);
                let mut d = delays(&s, az, el);
                let t: [f32; CHANNELS] = core::array::from_fn(|_| arrivals_s * normal());
                for (d, (i, j)) in d.iter_mut().zip(PAIRS) {
                    *d += t[j] - t[i] + pairs_s * normal();
                }
                let Some(got) = s.solve(&mut c, f64::from(n), &d).filter(|got| got.accepted) else {
                    continue;
                };
                let da = crate::angle::wrap_pi(f64::from(got.azimuth - az)) as f32;
                let (de, va, ve) = (got.elevation - el, got.var_azimuth, got.var_elevation);
                let square =
                    (ve * da * da - 2.0 * got.cov * da * de + va * de * de) / (va * ve - got.cov * got.cov);
                all += 1;
                held += u32::from(square <= 5.991);
            }
        }
        let share = f64::from(held) / f64::from(all);
        assert!(all > 2900 && (0.93..0.97).contains(&share), "{arrivals_s} {pairs_s}: {share} of {all}");
    }
}

#[test]
fn nonsense_is_not_accepted() {
    let s = solver();
    let mut c = Continuity::new();
    assert!(s.solve(&mut c, 0.0, &[f32::NAN; 6]).is_none());
    for n in 0..50u32 {
        let mix = |k: u32| ((n * 7919 + k * 104_729) % 1000) as f32 * 1e-6 - 5e-4;
        let d = [mix(1), mix(2), mix(3), mix(4), mix(5), mix(6)];
        assert!(!s.solve(&mut c, f64::from(n), &d).is_some_and(|b| b.accepted));
    }
}
