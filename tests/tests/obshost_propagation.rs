//! The RR03 ray table: what the data's own description says of it, our converter, and our ray tracer's physics against it.

use seabearing::ocean_bottom::table::blob;
use seabearing::propagation::{bottom::Bottom, convert, file, profile::SpeedProfile, trace};
use seabearing_core::obs::table::Table;
use seabearing_testkit::shared_data;

fn rr03(test: &str, conjugate: bool) -> Option<seabearing::propagation::Propagation> {
    let csv = shared_data(test, "ray_tracing_rr03.csv")?;
    Some(convert::read(&csv, Some(4340.0), conjugate).unwrap())
}

#[test]
fn the_table_is_as_described() {
    let Some(t) = rr03("the_table_is_as_described", false) else { return };
    // Spans and the vertical time as the data's description states them; range 0 is filled by symmetry.
    let last: Vec<f64> = t.paths.iter().map(|p| t.step_m * p.span().unwrap().1 as f64).collect();
    assert_eq!(last, [24_570.0, 73_710.0, 99_890.0, 99_680.0, 99_750.0, 99_750.0, 99_960.0]);
    assert!((t.paths[0].arrivals[0].unwrap().toa_s - 2.885).abs() < 1e-3);
    // A flat floor: toa_n(n r) = n toa_1(r).
    for j in 1..351 {
        let one = t.paths[0].arrivals[j].unwrap().toa_s;
        for (p, n) in [(1, 3), (2, 5)] {
            if let Some(Some(a)) = t.paths[p].arrivals.get(n * j) {
                assert!((a.toa_s - n as f64 * one).abs() < 1e-4);
            }
        }
    }
    // Delays the method quotes: 5.77 s overhead, 1.90 s and 2.66 s at 50 km.
    for (branch, row, delay) in [(0, 0, 5.77), (1, 0, 5.77), (1, 714, 1.90), (2, 714, 2.66)] {
        let (tau, _) = t.branch(branch, row).unwrap();
        assert!((tau - delay).abs() < 0.01, "{branch} {row} {tau}");
    }
}

#[test]
fn conversion_survives_file_and_core() {
    let Some(t) = rr03("conversion_survives_file_and_core", false) else { return };
    let back = file::parse(&file::format(&t), "rr03.toml").unwrap();
    let (bytes, again) = (blob(&t, "a", 50.0).unwrap(), blob(&back, "b", 50.0).unwrap());
    let (a, b) = (Table::parse(&bytes).unwrap(), Table::parse(&again).unwrap());
    // The file holds six digits: a step of delay, and of phase what turns by 10⁻⁴ rad.
    for (branch, (p, q)) in (0..4).flat_map(|k| a.pulses(k).zip(b.pulses(k)).map(move |x| (k, x))) {
        assert!(p.delay.abs_diff(q.delay) <= 1, "{branch} {p:?} {q:?}");
        let apart = f64::from(p.re.abs_diff(q.re)).hypot(f64::from(p.im.abs_diff(q.im)));
        let strength = f64::from(p.re).hypot(f64::from(p.im));
        assert!(apart <= 2.0 + 2e-3 * strength, "{branch} {p:?} {q:?}");
    }
    for range_m in (0..1400).map(|j| 70.0 * j as f32 + 13.0) {
        for branch in 0..4 {
            match (a.delay_s(branch, range_m), b.delay_s(branch, range_m)) {
                (Some(x), Some(y)) => assert!((x - y).abs() < 1.5e-4, "{branch} {range_m} {x} {y}"),
                (None, None) => {}
                other => panic!("{branch} {range_m} {other:?}"),
            }
        }
    }
}

#[test]
fn our_floor_is_the_table_s_up_to_the_sign_of_phase() {
    let Some(t) = rr03("our_floor_is_the_table_s_up_to_the_sign_of_phase", false) else { return };
    // Paths 1 and 3 leave at one angle at r and 3 r; their amplitudes differ by −R and a third of the spreading.
    let (floor_m_s, bottom) = (1527.5, Bottom::default());
    let mut compared = 0;
    for j in (5..340).step_by(5) {
        let one = t.paths[0].arrivals[j].unwrap();
        let three = t.paths[1].arrivals[3 * j].unwrap();
        let table = -three.amplitude / one.amplitude * 3.0;
        let slowness = t.slowness_s_m(0, t.step_m * j as f64).unwrap();
        let ours = bottom.reflection(slowness, floor_m_s);
        // At the critical angle (72 and 73 rows out) the coefficient jumps within one row.
        if (68..78).contains(&j) {
            continue;
        }
        compared += 1;
        assert!((table.norm() - ours.norm()).abs() < 0.02, "{j} {table} {ours}");
        // The table's phase grows beyond the critical angle: that is exp(+iωt), not the exp(−iωt) it is said to follow.
        assert!((table - ours.conj()).norm() < 0.06, "{j} {table} {ours}");
    }
    assert!(compared > 50);
}

#[test]
fn a_subtropical_profile_gives_the_table_s_times() {
    let Some(t) = rr03("a_subtropical_profile_gives_the_table_s_times", false) else { return };
    let profile = SpeedProfile::subtropical(4340.0).unwrap();
    let ours = trace::trace("s", &profile, &Bottom::default(), 70.0, 1429, || ());
    // The table's own profile is not known: a climatological one must come within a thousandth in time, and within a
    // fiftieth in the delays, the quantity that ranges are made of.
    for (p, q) in t.paths.iter().zip(&ours.paths) {
        for (a, b) in p.arrivals.iter().zip(&q.arrivals) {
            if let (Some(a), Some(b)) = (a, b) {
                assert!((a.toa_s / b.toa_s - 1.0).abs() < 4e-3, "{} {} {}", p.crossings, a.toa_s, b.toa_s);
            }
        }
    }
    for branch in 0..3 {
        for row in (0..714).step_by(7) {
            if let (Some(a), Some(b)) = (t.branch(branch, row), ours.branch(branch, row)) {
                assert!((a.0 / b.0 - 1.0).abs() < 0.03, "{branch} {row} {} {}", a.0, b.0);
            }
        }
    }
}
