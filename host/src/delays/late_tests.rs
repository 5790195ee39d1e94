use super::*;
use crate::delays::solve_rows;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use seabearing_core::config::StationConfig;

const C: f64 = 1484.0;
const H: [[f64; 3]; 4] = [[0.0, 1.07, -0.38], [0.93, -0.53, -0.38], [-0.93, -0.53, -0.38], [0.0, 0.0, 1.14]];

/// Sets of a vessel that circles out and in again, or that does not move, with errors of 2 µs; hydrophones that are late, and elsewhere.
fn sets(number: usize, moves: bool, late_s: [f64; 4], position_sd_m: f64, seed: u64) -> Vec<[f64; 6]> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
    let h = H.map(|h| h.map(|x| x + position_sd_m * normal()));
    let begin = ChaCha8Rng::seed_from_u64(seed).random_range(0.0..6.0);
    let of = |n: usize| {
        let turn = if moves { 18.8 * n as f64 / number as f64 } else { 0.0 };
        let (s, c) = (begin + turn).sin_cos();
        let r = 168.0 / (0.75 - 0.65 * (0.4 * turn).cos()).tan();
        let source = [r * s, r * c, 168.0];
        let mut t = [0.0; 4];
        for (k, t) in t.iter_mut().enumerate() {
            *t = norm(&minus(&source, &h[k])) / C + late_s[k] + 2e-6 * normal();
        }
        PAIRS.map(|(i, j)| t[j] - t[i] + 2e-6 * normal())
    };
    (0..number).map(of).collect()
}

fn found(sets: &[[f64; 6]], position_sd_m: f64) -> Option<Lateness> {
    let told = Told { range_m: 500.0, position_sd_m, sound_speed_sd_m_s: 0.0, tolerance_s: 28e-6 };
    lateness(&Geometry::new(&H, 0.0, C).unwrap(), &told, sets)
}

#[test]
fn the_late_one_is_named_with_what_puts_it_right() {
    for (k, late_s) in [(0, 60e-6), (1, -90e-6), (2, 78e-6), (3, 1e-3), (0, -1e-3), (2, 350e-6)] {
        let mut each = [0.0; 4];
        each[k] = late_s;
        let sets = sets(200, true, each, 0.005, 7 + k as u64);
        let l = found(&sets, 0.01).unwrap();
        let late = l.late();
        assert!(late.len() == 1 && late[0].hydrophone == k, "{k} {late_s}: {l:?}");
        assert!((late[0].late_s - late_s).abs() < 4.0 * late[0].sd_s && late[0].sd_s < 20e-6, "{late:?}");
        let unsure = l.unsure_s();
        assert!(unsure[k] >= 0.9 * late_s.abs() && unsure.iter().filter(|x| **x > 0.0).count() == 1);
        let said = l.said().unwrap();
        assert!(said.contains(&format!("hydrophone {k} is")) && said.contains('±'), "{said}");
        // As it is told.
        let mut mended = sets.clone();
        let amounts = said.split("its delays: ").nth(1).unwrap();
        for part in amounts.split(" less").flat_map(|p| p.split(" more")) {
            let columns: Vec<&str> = part.split("tdoa").skip(1).map(|p| &p[..2]).collect();
            let Some(by) = part.split_whitespace().rev().nth(1).and_then(|x| x.parse::<f64>().ok()) else {
                continue;
            };
            let way = if said.contains(&format!("{part} less")) { -1e-6 } else { 1e-6 };
            for (p, (i, j)) in PAIRS.into_iter().enumerate() {
                if columns.contains(&format!("{i}{j}").as_str()) {
                    mended.iter_mut().for_each(|s| s[p] += way * by);
                }
            }
        }
        assert_eq!(found(&mended, 0.01).unwrap().said(), None, "{said}");
    }
}

#[test]
fn good_sets_of_places_that_are_off_are_not_called_late() {
    for seed in 0..60 {
        for (number, off_m, told_m) in [
            (20, 0.01, 0.01),
            (150, 0.03, 0.0),
            (150, 0.03, 0.03),
            (400, 0.01, 0.0),
            (150, 0.03, 0.01),
            (400, 0.06, 0.02),
        ] {
            let sets = sets(number, true, [0.0; 4], off_m, seed);
            // As they are, and in steps of 10 µs.
            let coarse: Vec<[f64; 6]> =
                sets.iter().map(|s| s.map(|tau| (tau * 1e5).round() * 1e-5)).collect();
            for sets in [sets, coarse] {
                let l = found(&sets, told_m);
                assert_eq!(l.and_then(|l| l.said()), None, "{seed} {number} {off_m} {told_m}");
            }
        }
    }
}

#[test]
fn one_direction_tells_nothing() {
    for late_s in [0.0, 20e-6, 60e-6] {
        let l = found(&sets(300, false, [late_s, 0.0, 0.0, 0.0], 0.0, 3), 0.01);
        assert_eq!(l.as_ref().and_then(Lateness::said), None, "{l:?}");
        assert!(l.is_none_or(|l| l.unsure_s() == [0.0; 4]));
    }
    assert_eq!(found(&[], 0.01), None);
}

#[test]
fn channels_sampled_one_after_the_other_are_told_as_several() {
    let l = found(&sets(400, true, [0.0, 40e-6, 80e-6, 120e-6], 0.0, 5), 0.01).unwrap();
    assert!(l.late().is_empty(), "{l:?}");
    assert!(l.said().unwrap().contains("several hydrophones"));
    for (k, (each, sd)) in l.each_s.iter().zip(&l.each_sd_s).enumerate() {
        assert!((each - (40e-6 * k as f64 - 60e-6)).abs() < 4.0 * sd && *sd < 30e-6, "{l:?}");
        assert!(l.unsure_s()[k] > each.abs());
    }
}

/// A straight pass 300 m away of which every tenth set has one hydrophone, any, 200 µs late; and of a hydrophone late throughout besides.
#[test]
fn a_few_sets_that_are_off_are_no_lateness_of_all() {
    let config = StationConfig { depth_m: 168.0, sound_speed_m_s: C, ..StationConfig::array(64_000.0, H) };
    let mut said = 0;
    for seed in 0..40 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let course: f64 = rng.random_range(0.0..std::f64::consts::TAU);
        let rows = |late_s: f64| -> Vec<[f64; 7]> {
            let mut rng = ChaCha8Rng::seed_from_u64(seed + 100);
            (0..200)
                .map(|n| {
                    let along = 7.0 * (f64::from(n) - 100.0);
                    let (s, c) = course.sin_cos();
                    let source = [along * s + 300.0 * c, along * c - 300.0 * s, 164.0];
                    let mut t = H.map(|h| norm(&minus(&source, &h)) / C);
                    for t in &mut t {
                        let normal: f64 = StandardNormal.sample(&mut rng);
                        *t += 2e-6 * normal;
                    }
                    t[1] += late_s;
                    if rng.random_range(0.0..1.0) < 0.1 {
                        t[rng.random_range(0..4)] += 200e-6;
                    }
                    let mut row = [f64::from(n); 7];
                    for (d, (i, j)) in row[1..].iter_mut().zip(PAIRS) {
                        let normal: f64 = StandardNormal.sample(&mut rng);
                        *d = t[j] - t[i] + 5e-6 * normal;
                    }
                    row
                })
                .collect()
        };
        let few = solve_rows(&config, rows(0.0), None).unwrap();
        let all = few.lateness.as_ref().and_then(Lateness::said);
        assert!(all.is_none(), "{seed}: {all:?}");
        assert!(few.sets.iter().filter(|s| s.accepted()).count() > 160, "{seed}");
        let throughout = solve_rows(&config, rows(300e-6), None).unwrap();
        said += usize::from(throughout.lateness.is_some_and(|l| l.said().is_some()));
    }
    assert!(said > 30, "{said}");
}
