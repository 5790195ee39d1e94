use super::*;
use crate::network::model::bearing;
use std::vec::Vec;

const TWO: [[f64; 3]; 2] = [[0.0, 100.0, -168.0], [0.0, -100.0, -168.0]];
const EXACT: SharedError = SharedError { azimuth: 0.0, clock_s: 0.0 };
const SETTINGS: JointSettings = JointSettings {
    z_m: -5.0,
    sound_speed_m_s: 1484.0,
    robust: true,
    scatter: Scatter::Told,
    shared: [EXACT; MAX_ARRAYS],
    alike: [1.0; MAX_ARRAYS],
};

/// Exact bearings of a vessel with travel time, at different instants for each array.
fn bearings(arrays: &[[f64; 3]], elevation: bool) -> Vec<DatedSighting> {
    let mut out = Vec::new();
    for k in 0..100 {
        for (i, array_m) in arrays.iter().enumerate() {
            let emitted = 2.0 * f64::from(k) + 0.7 * i as f64;
            let p = [400.0 + 2.0 * emitted, -700.0 + 7.0 * emitted, -5.0];
            let (a, b) = bearing(array_m, &p);
            let d: f64 = p.iter().zip(array_m).map(|(x, y)| (x - y) * (x - y)).sum();
            let sighting = Sighting {
                array_m: *array_m,
                azimuth: a,
                elevation: elevation.then_some(b),
                sd_azimuth: 0.026,
                sd_elevation: 0.028,
            };
            out.push(DatedSighting { t_s: emitted + d.sqrt() / 1484.0, array: i, sighting });
        }
    }
    out
}

#[test]
fn two_arrays_need_no_speed_and_one_with_depth_neither() {
    for (arrays, elevation) in [(&TWO[..], false), (&TWO[..], true), (&TWO[..1], true)] {
        let motion = fit(&bearings(arrays, elevation), &SETTINGS).unwrap();
        let (v, sd) = motion.speed_m_s();
        assert!((v - 53f64.sqrt()).abs() < 1e-4 && sd > 0.0, "{v} {sd}");
        assert!((motion.heading().0 - 2f64.atan2(7.0)).abs() < 1e-5);
        let [x, y] = motion.position_m(0.0);
        assert!((x - 400.0).abs() < 0.01 && (y + 700.0).abs() < 0.01, "{x} {y}");
    }
}

#[test]
fn one_array_without_elevation_is_refused() {
    assert_eq!(fit(&bearings(&TWO[..1], false), &SETTINGS), Err(NetworkError::NotObservable));
}

#[test]
fn a_turned_array_is_set_aside_and_single_wrong_bearings_hardly_pull() {
    let three = [TWO[0], TWO[1], [150.0, 0.0, -168.0]];
    let mut turned = bearings(&three, false);
    for b in turned.iter_mut().filter(|b| b.array == 2) {
        b.sighting.azimuth += 0.4;
    }
    let motion = fit(&turned, &SETTINGS).unwrap();
    assert_eq!(motion.rejected, Some(2));
    assert!((motion.speed_m_s().0 - 53f64.sqrt()).abs() < 1e-3, "{motion:?}");
    let mut wrong = bearings(&TWO, false);
    for b in wrong.iter_mut().step_by(17) {
        b.sighting.azimuth += 2.0;
    }
    let motion = fit(&wrong, &SETTINGS).unwrap();
    let (v, sd) = motion.speed_m_s();
    assert!((v - 53f64.sqrt()).abs() < 2.0 * sd && sd < 0.2, "{v} {sd}");
}

/// Three arrays 2 km apart, and a vessel between them; no error but what is shared.
fn shared(turned: [f64; 3], late_s: [f64; 3]) -> Vec<DatedSighting> {
    let three = [[0.0, 0.0, -168.0], [2000.0, 0.0, -168.0], [900.0, 1800.0, -168.0]];
    let mut all = bearings(&three, false);
    for b in &mut all {
        b.sighting.azimuth += turned[b.array];
        b.sighting.sd_azimuth = 0.003;
        b.t_s += late_s[b.array];
    }
    all
}

#[test]
fn turned_arrays_and_late_clocks_are_within_the_stated_error_where_they_are_assumed() {
    let one = SharedError { azimuth: 0.01, clock_s: 3.0 };
    let assumed = JointSettings { shared: [one; MAX_ARRAYS], ..SETTINGS };
    for (turned, late_s) in
        [([0.01, -0.01, 0.0], [0.0; 3]), ([0.0; 3], [3.0, 0.0, -3.0]), ([0.01, 0.0, -0.01], [0.0, 3.0, 0.0])]
    {
        let bearings = shared(turned, late_s);
        let off = |settings: &JointSettings| {
            let motion = fit(&bearings, settings).unwrap();
            let truth = [400.0 + 2.0 * motion.t_ref_s, -700.0 + 7.0 * motion.t_ref_s, 2.0, 7.0];
            let mut d = motion.state;
            d.iter_mut().zip(truth).for_each(|(x, t)| *x -= t);
            let chi2 = spd::dot(&d, &spd::solve(&motion.covariance, &d).unwrap());
            (chi2, motion.rejected)
        };
        let (chi2, rejected) = off(&assumed);
        // 95 % of four degrees of freedom: 9.5.
        assert!(chi2 < 9.5 && rejected.is_none(), "{turned:?} {late_s:?}: {chi2}");
    }
    // Without any such error the estimate is the same, and knows less.
    let exact = shared([0.0; 3], [0.0; 3]);
    let (with, without) = (fit(&exact, &assumed).unwrap(), fit(&exact, &SETTINGS).unwrap());
    assert!((0..4).all(|k| (with.state[k] - without.state[k]).abs() < 1e-3), "{with:?} {without:?}");
    assert!((0..4).all(|k| with.covariance[k][k] > 4.0 * without.covariance[k][k]));
}

#[test]
fn closest_approach() {
    let motion = JointTrack {
        t_ref_s: 10.0,
        state: [300.0, -100.0, 0.0, 5.0],
        covariance: [[4.0, 0.0, 0.0, 0.0], [0.0, 9.0, 0.0, 0.0], [0.0, 0.0, 0.01, 0.0], [0.0, 0.0, 0.0, 0.0]],
        misfit: 0.0,
        freedom: 1,
        rejected: None,
        growth: 1.0,
        wrong: Wrong::default(),
        consistent: true,
        bent: false,
        clock_of: 0,
        offsets: [Offset::default(); MAX_ARRAYS],
        scatter: [[1.0; 2]; MAX_ARRAYS],
    };
    let a = motion.closest([0.0, 0.0]).unwrap();
    assert!((a.t_s.0 - 30.0).abs() < 1e-12 && (a.range_m.0 - 300.0).abs() < 1e-12);
    // A vessel heading North at x = 300: the origin is to port. The range moves with x and, 20 s later, with v_x.
    assert!(!a.to_starboard && (a.range_m.1 - (4.0f64 + 400.0 * 0.01).sqrt()).abs() < 1e-9, "{a:?}");
    // The time: σ_y/v, and the turn of the way by δv_x/v at 300 m.
    let turned = (9.0f64 / 25.0 + (300.0f64 / 25.0).powi(2) * 0.01).sqrt();
    assert!((a.t_s.1 - turned).abs() < 1e-9, "{a:?}");
}

/// Bearings of the vessel between two arrays 900 m apart, or more; errors of `noise` radians, stated as 0.026.
fn noisy(arrays: &[[f64; 3]], elevation: bool, noise: f64, turned: f64, late_s: f64) -> Vec<DatedSighting> {
    let mut all = bearings(arrays, elevation);
    let mut x = 7u64;
    let mut white = || {
        let mut sum = 0.0;
        for _ in 0..12 {
            x = x.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum += (x >> 11) as f64 / (1u64 << 53) as f64 - 0.5;
        }
        noise * sum
    };
    for b in &mut all {
        b.sighting.azimuth += white();
        b.sighting.elevation = b.sighting.elevation.map(|e| e + white());
        if b.array == 1 {
            b.sighting.azimuth += turned;
            b.t_s += late_s;
        }
    }
    all
}

const APART: [[f64; 3]; 2] = [[0.0, 0.0, -100.0], [900.0, 100.0, -100.0]];
const MEASURED: JointSettings = JointSettings {
    scatter: Scatter::Measured,
    shared: [SharedError { azimuth: 0.0087, clock_s: 1.0 }; MAX_ARRAYS],
    ..SETTINGS
};

/// Squared error of the state in units of its covariance.
fn chi2(motion: &JointTrack) -> f64 {
    let truth = [400.0 + 2.0 * motion.t_ref_s, -700.0 + 7.0 * motion.t_ref_s, 2.0, 7.0];
    let mut d = motion.state;
    d.iter_mut().zip(truth).for_each(|(x, t)| *x -= t);
    spd::dot(&d, &spd::solve(&motion.covariance, &d).unwrap())
}

#[test]
fn what_is_wrong_is_told_by_the_scatter_that_the_bearings_show() {
    // Turned by 3° against 0.5° that are assumed; errors of 0.3° stated as 1.5°.
    let turned = fit(&noisy(&APART, true, 0.005, 0.052, 0.0), &MEASURED).unwrap();
    assert_eq!(
        (turned.wrong, turned.consistent),
        (Wrong { orientation: Some(1), clock: None }, true),
        "{turned:?}"
    );
    let (found, sd) = turned.offsets[1].azimuth;
    assert!((found - 0.052).abs() < 0.005 && sd < 0.02 && chi2(&turned) < 9.5, "{turned:?}");
    let late = fit(&noisy(&APART, true, 0.002, 0.0, 8.0), &MEASURED).unwrap();
    assert_eq!(
        (late.wrong, late.consistent),
        (Wrong { orientation: None, clock: Some(1) }, true),
        "{late:?}"
    );
    let (found, sd) = late.offsets[1].clock_s;
    assert!((found - 8.0).abs() < 0.5 && sd < 2.0, "{late:?}");
    // Nothing is wrong.
    let good = fit(&noisy(&APART, true, 0.005, 0.0, 0.0), &MEASURED).unwrap();
    assert_eq!((good.wrong, good.consistent, good.growth), (Wrong::default(), true, 1.0));
    assert!(good.scatter[..2].iter().flatten().all(|s| (0.15..0.25).contains(s)), "{:?}", good.scatter);
    // The errors that were stated would hide it.
    let told = JointSettings { scatter: Scatter::Told, ..MEASURED };
    assert!(fit(&noisy(&APART, true, 0.005, 0.052, 0.0), &told).unwrap().consistent);
}

#[test]
fn the_first_of_three_arrays_is_named_where_its_clock_is_wrong() {
    let three = [APART[0], APART[1], [300.0, 700.0, -100.0]];
    for late in 0..3 {
        let mut all = noisy(&three, true, 0.002, 0.0, 0.0);
        all.iter_mut().filter(|b| b.array == late).for_each(|b| b.t_s += 30.0);
        all.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
        let found = fit(&all, &MEASURED).unwrap();
        assert_eq!(found.wrong, Wrong { orientation: None, clock: Some(late) }, "{found:?}");
        for (k, offset) in found.offsets.iter().take(3).enumerate() {
            let told = if k == late { 30.0 } else { 0.0 };
            assert!((offset.clock_s.0 - told).abs() < 1.0, "{late} {k} {found:?}");
            assert_eq!(offset.clock_s.1 == 0.0, k == found.clock_of, "{late} {k} {found:?}");
        }
        assert_eq!(found.clock_of, usize::from(late == 0));
    }
}

#[test]
fn which_of_two_arrays_side_by_side_is_wrong_cannot_be_told() {
    // Only that they differ is observable: no parallax tells where North is.
    let beside = [[0.0, 0.0, -168.0], [20.0, 5.0, -168.0]];
    let motion = fit(&noisy(&beside, true, 0.005, 0.08, 0.0), &MEASURED).unwrap();
    assert!(!motion.consistent && motion.wrong == Wrong::default(), "{motion:?}");
    // What is stated holds whichever it is.
    assert!(chi2(&motion) < 9.5 && motion.offsets[1].azimuth.1 > 0.03, "{} {motion:?}", chi2(&motion));
}

#[test]
fn an_orientation_that_nothing_tells_stays_as_unknown_as_it_was() {
    // One array, elevations and the depth: the way is known but for the array's own North.
    let motion = fit(&noisy(&APART[..1], true, 0.002, 0.0, 0.0), &MEASURED).unwrap();
    let assumed = MEASURED.shared[0].azimuth;
    let (turned, sd) = motion.offsets[0].azimuth;
    assert!((sd / assumed - 1.0).abs() < 1e-3 && turned.abs() < 1e-3, "{turned} {sd}");
    assert!(motion.consistent && motion.heading().1 > assumed, "{motion:?}");
}

#[test]
fn bearings_that_scatter_more_than_stated_make_the_error_grow() {
    let sd = |noise: f64| fit(&noisy(&APART, true, noise, 0.0, 0.0), &MEASURED).unwrap().speed_m_s().1;
    let (stated, larger) = (sd(0.02), sd(0.1));
    assert!(larger > 2.0 * stated, "{larger} {stated}");
}

#[test]
fn the_bound_is_the_covariance_of_an_exact_fit() {
    let exact = bearings(&APART, true);
    let settings = JointSettings { shared: MEASURED.shared, ..SETTINGS };
    let motion = fit(&exact, &settings).unwrap();
    let least = bound(&exact, &settings, motion.t_ref_s, &motion.state).unwrap();
    for (a, b) in least.iter().flatten().zip(motion.covariance.iter().flatten()) {
        assert!((a - b).abs() <= 1e-6 * (a.abs() + b.abs()), "{least:?} {motion:?}");
    }
    assert_eq!(bound(&bearings(&TWO[..1], false), &SETTINGS, 100.0, &[400.0, 0.0, 2.0, 7.0]), None);
}

#[test]
fn a_vessel_that_turns_is_not_consistent_and_noise_beyond_what_is_stated_is() {
    let three = [[0.0, 0.0, -168.0], [800.0, 0.0, -168.0], [400.0, 600.0, -168.0]];
    let mut all = noisy(&three, true, 0.005, 0.0, 0.0);
    for b in &mut all {
        // East, and South from the middle on.
        let t = b.t_s;
        let straight = [400.0 + 2.0 * t, -700.0 + 7.0 * t, -5.0];
        let p = if t < 100.0 {
            [-300.0 + 6.0 * t, 700.0, -5.0]
        } else {
            [300.0, 700.0 - 6.0 * (t - 100.0), -5.0]
        };
        let ((a0, e0), (a, e)) = (bearing(&three[b.array], &straight), bearing(&three[b.array], &p));
        b.sighting.azimuth += a - a0;
        b.sighting.elevation = b.sighting.elevation.map(|x| x + e - e0);
    }
    let turned = fit(&all, &MEASURED).unwrap();
    assert!(turned.bent && !turned.consistent, "{turned:?}");
    // Four times what is stated.
    let plain = fit(&noisy(&three, true, 0.1, 0.0, 0.0), &MEASURED).unwrap();
    assert!(!plain.bent && plain.consistent, "{plain:?}");
}

/// Bearings, one a second from each of three arrays, of a vessel on a circle (`turn` radians a second); errors of `noise` radians that have
/// `common` with those a second before.
fn turning(turn: f64, noise: f64, common: f64, elevation: bool, seed: u64) -> Vec<DatedSighting> {
    const THREE: [[f64; 3]; 3] = [[0.0, 460.0, -168.0], [400.0, -230.0, -168.0], [-400.0, -230.0, -168.0]];
    let mut x = seed;
    let mut white = || {
        let mut sum = 0.0;
        for _ in 0..12 {
            x = x.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum += (x >> 11) as f64 / (1u64 << 53) as f64 - 0.5;
        }
        noise * sum
    };
    let (aside, toward) = (600.0 * (white() / noise).clamp(-1.0, 1.0), white() / noise);
    let (s, c) = (m::sin(toward), m::cos(toward));
    let at = |t: f64| {
        let (along, over) = if turn == 0.0 {
            (7.0 * t, 0.0)
        } else {
            (7.0 / turn * m::sin(turn * t), 7.0 / turn * (1.0 - m::cos(turn * t)))
        };
        [s * along + c * (aside + over), c * along - s * (aside + over), -5.0]
    };
    let mut errors = [[0.0; 2]; 3].map(|e| e.map(|_: f64| white()));
    let mut all = Vec::new();
    for k in -100..100 {
        for (array, array_m) in THREE.iter().enumerate() {
            let emitted = f64::from(k) + 0.3 * array as f64;
            let p = at(emitted);
            let (a, e) = bearing(array_m, &p);
            let d: f64 = p.iter().zip(array_m).map(|(x, y)| (x - y) * (x - y)).sum();
            for e in &mut errors[array] {
                *e = common * *e + m::sqrt(1.0 - common * common) * white();
            }
            let sighting = Sighting {
                array_m: *array_m,
                azimuth: a + errors[array][0],
                elevation: elevation.then_some(e + errors[array][1]),
                sd_azimuth: 0.026,
                sd_elevation: 0.028,
            };
            all.push(DatedSighting { t_s: emitted + d.sqrt() / 1484.0, array, sighting });
        }
    }
    all
}

#[test]
fn a_turn_within_what_is_stated_of_bearings_is_said_and_the_errors_hold_it() {
    for elevation in [true, false] {
        for turn in [0.03f64, 0.1, 0.2].map(|x| x * m::PI / 180.0) {
            for seed in 1..5 {
                let motion = fit(&turning(turn, 0.0035, 0.0, elevation, seed), &MEASURED).unwrap();
                assert!(motion.bent && !motion.consistent, "{turn} {elevation} {seed} {motion:?}");
                // The heading at either end is half the turn off.
                assert!(motion.heading().1 * 3.0 > 100.0 * turn, "{turn} {elevation} {seed} {motion:?}");
            }
        }
    }
}

#[test]
fn a_straight_way_is_none_whatever_errors_last() {
    let mut said = [0; 3];
    for (said, common) in said.iter_mut().zip([0.0, 0.8, 0.9]) {
        for elevation in [true, false] {
            for seed in 1..16 {
                let found = fit(&turning(0.0, 0.0035, common, elevation, seed), &MEASURED);
                *said += u32::from(found.is_ok_and(|motion| motion.bent));
            }
        }
    }
    assert!(said.iter().all(|n| *n <= 1), "{said:?} of 30");
}
