use super::*;
use std::vec::Vec;

const SAID: [[f64; 3]; 4] =
    [[0.0, 1.07, -0.38], [0.93, -0.53, -0.38], [-0.93, -0.53, -0.38], [0.0, -0.01, 1.14]];
const DOUBTS: Doubts = Doubts {
    position_m: 0.01,
    sound_speed_m_s: 1.0,
    track_m: 2.0,
    height_m: 1.0,
    clock_s: 0.5,
    image_m2: 0.0,
};

/// Numbers that look random, about normal, of standard deviation one.
fn noise(k: usize) -> f64 {
    let of = |n: usize| {
        let x = (n as f64 * 12.9898).sin() * 43_758.545;
        x - x.floor() - 0.5
    };
    (0..12).map(|i| of(12 * k + i + 1)).sum()
}

/// A course that goes north past the array and, where it turns, west; its delays for hydrophones at `built`, turned by `heading`.
fn pass(built: &[[f64; 3]; 4], heading: f64, turns: bool) -> (Vec<TrackPoint>, Vec<TimedDelays>) {
    let (mut at, mut way) = ([120.0, -500.0], 0.0f64);
    let mut track = Vec::new();
    for k in 0..800 {
        track.push(TrackPoint { t_s: 0.25 * f64::from(k), position_m: [at[0], at[1], 160.0] });
        if turns && at[1] > 0.0 && way > -1.6 {
            way -= 0.02;
        }
        at = [at[0] + 1.25 * way.sin(), at[1] + 1.25 * way.cos()];
    }
    let (s, c) = heading.sin_cos();
    let built = built.map(|[x, y, z]| [x * c + y * s, y * c - x * s, z]);
    let mut sets = Vec::new();
    let model = Model::new(&built, 1484.0, &track, 10.0, DOUBTS);
    for k in 4..380 {
        let t_s = 0.5 * k as f64;
        let mut tdoa_s = model.residuals(&TimedDelays { t_s, tdoa_s: [0.0; 6] }).map(|x| -x);
        let times: Vec<f64> = (0..4).map(|h| 1e-6 * noise(4 * k + h)).collect();
        for (x, (i, j)) in tdoa_s.iter_mut().zip(PAIRS) {
            *x += times[j] - times[i];
        }
        if k % 12 == 5 {
            tdoa_s[2] += 4e-4;
        }
        if k % 10 == 1 {
            tdoa_s[4] = f64::NAN;
        }
        sets.push(TimedDelays { t_s, tdoa_s });
    }
    (track, sets)
}

fn displaced() -> [[f64; 3]; 4] {
    let mut built = SAID;
    for (k, x) in built.iter_mut().flatten().enumerate() {
        *x += 0.01 * noise(k + 5000);
    }
    built
}

/// Root mean square of the errors of shape, metres, and the greatest in standard deviations.
fn errors(found: &Mended, built: &[[f64; 3]; 4]) -> (f64, f64) {
    let truth = aligned(built, &SAID);
    let (mut square, mut most) = (0.0, 0.0f64);
    for (k, (a, b)) in found.position_m.iter().flatten().zip(truth.iter().flatten()).enumerate() {
        square += (a - b) * (a - b) / 12.0;
        most = most.max((a - b).abs() / found.covariance_m2[k][k].sqrt());
    }
    (square.sqrt(), most)
}

#[test]
fn a_course_that_turns_mends_the_shape_and_tells_the_heading() {
    let built = displaced();
    let (track, sets) = pass(&built, 2.0, true);
    let found = geometry(&sets, &track, 10.0, &SAID, 1484.0, &DOUBTS).unwrap();
    let (rms, most) = errors(&found, &built);
    assert!(rms < 0.002 && most < 4.0, "{rms} {most} {found:?}");
    assert!(found.sd_m.0 < 0.001 && found.untold < 0.5, "{found:?}");
    // The displacements turn the array a little, too.
    assert!(wrap_pi(found.heading - 2.0).abs() < 0.02, "{found:?}");
    assert!(found.wrong >= 30 && found.wrong < 60, "{found:?}");
}

#[test]
fn a_straight_course_leaves_half_of_the_shape_and_says_so() {
    let built = displaced();
    let (track, sets) = pass(&built, -1.0, false);
    let found = geometry(&sets, &track, 10.0, &SAID, 1484.0, &DOUBTS).unwrap();
    let (_, most) = errors(&found, &built);
    assert!((found.untold - 3.0).abs() < 0.3, "{found:?}");
    assert!(found.sd_m.1 > 0.009 && most < 4.0, "{most} {found:?}");
}

#[test]
fn what_is_exact_stays_and_what_cannot_be_is_refused() {
    let (track, sets) = pass(&SAID, 0.3, true);
    let exact = Doubts { position_m: 0.0, sound_speed_m_s: 0.0, ..DOUBTS };
    let found = geometry(&sets, &track, 10.0, &SAID, 1484.0, &exact).unwrap();
    assert!(errors(&found, &SAID).0 < 1e-9 && found.sound_speed_m_s == (1484.0, 0.0));
    assert_eq!(geometry(&sets[..9], &track, 10.0, &SAID, 1484.0, &DOUBTS), Err(OrientError::TooFew));
    let wrong = Doubts { clock_s: f64::NAN, ..DOUBTS };
    assert_eq!(geometry(&sets, &track, 10.0, &SAID, 1484.0, &wrong), Err(OrientError::NotFinite));
    let still: Vec<_> = track.iter().map(|p| TrackPoint { position_m: [300.0, 0.0, 160.0], ..*p }).collect();
    assert!(geometry(&sets, &still, 10.0, &SAID, 1484.0, &DOUBTS).is_err());
}

#[test]
fn alignment_takes_out_place_and_turn_alone() {
    let turn = nalgebra::Rotation3::new(nalgebra::Vector3::new(0.02, -0.03, 0.05)).into_inner();
    let moved = SAID.map(|h| {
        let p = turn * nalgebra::Vector3::from(h);
        [p.x + 3.0, p.y - 1.0, p.z]
    });
    let (back, said) = (aligned(&moved, &SAID), aligned(&SAID, &SAID));
    for (a, b) in back.iter().flatten().zip(said.iter().flatten()) {
        assert!((a - b).abs() < 1e-9);
    }
}

#[test]
fn a_clock_is_told_alike_where_the_track_begins_after_the_sound_left() {
    let doubts = Doubts {
        position_m: 0.03,
        sound_speed_m_s: 2.0,
        track_m: 2.0,
        height_m: 3.0,
        clock_s: 1.0,
        image_m2: 128.0,
    };
    let (track, sets) = pass(&displaced(), 0.0, false);
    let of = |first_s: f64, left_out: usize| {
        let track: Vec<_> = track.iter().copied().filter(|p| p.t_s >= first_s).collect();
        geometry(&sets[left_out..], &track, 10.0, &SAID, 1484.0, &doubts).unwrap()
    };
    // Of the set at 2.5 s the sound left at 2.15 s.
    let (whole, cut) = (of(0.0, 1), of(2.25, 1));
    let apart = whole.late_s.0 - cut.late_s.0;
    assert!(apart.abs() < 0.02 * whole.late_s.1, "{apart} {whole:?} {cut:?}");
    assert!((whole.track_m.0[1] - cut.track_m.0[1]).abs() < 0.02 * whole.track_m.1[1], "{whole:?} {cut:?}");
}
