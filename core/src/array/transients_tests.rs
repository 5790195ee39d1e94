//! Transients in a made sea: told once, at their time, from where they come, as well as is said; and what must not be told.

use super::super::test_sea::{Normal, hear, noisy, plan, planned, source};
use super::*;
use crate::angle::{unit_vector, wrap_pi};
use crate::array::{Scratch, State, finish, push, wavefront};
use crate::block::{Block, Frame};
use core::f64::consts::TAU;
use std::boxed::Box;
use std::vec::Vec;

type Sea = Vec<[f64; CHANNELS]>;

/// A click of a frequency and length: its pressure at a time after its middle.
fn click(peak: f64, f_hz: f64, sd_s: f64) -> impl Fn(f64) -> f64 {
    move |t| peak * (-0.5 * (t / sd_s).powi(2)).exp() * (TAU * f_hz * t).cos()
}

/// One that no hydrophone takes for anything else.
fn plain(peak: f64) -> impl Fn(f64) -> f64 {
    click(peak, 4000.0, 2e-4)
}

/// White noise of unit power.
fn noise(plan: &Plan, seconds: f64, seed: u64) -> Sea {
    noisy(std::vec![[0.0; CHANNELS]; (seconds * f64::from(plan.rate_hz())) as usize], seed)
}

/// Adds a sound from a direction, 500 m away, its middle at the array's centre at a time.
fn add(plan: &Plan, sea: &mut [[f64; CHANNELS]], at_s: f64, from: (f64, f64), sound: impl Fn(f64) -> f64) {
    let u = unit_vector(from.0 as f32, from.1 as f32);
    let rate = f64::from(plan.rate_hz());
    for (h, late) in wavefront::arrivals(plan.geometry(), &u, 1.0 / 500.0).iter().enumerate() {
        let middle = (at_s + f64::from(*late)) * rate;
        let of = (middle - 300.0).max(0.0) as usize..((middle + 900.0) as usize).min(sea.len());
        for (n, x) in of.clone().zip(&mut sea[of]) {
            x[usize::from(plan.channels[h])] += sound((n as f64 - middle) / rate);
        }
    }
}

/// Squared error in units of the covariance: beyond 5.991 in one of twenty.
fn standardised(t: &Transient, from: (f64, f64)) -> f64 {
    let (across, up) = (wrap_pi(f64::from(t.azimuth) - from.0), f64::from(t.elevation) - from.1);
    let (va, ve, c) = (f64::from(t.var_azimuth), f64::from(t.var_elevation), f64::from(t.cov));
    (ve * across * across - 2.0 * c * across * up + va * up * up) / (va * ve - c * c)
}

/// What is told of a sea whose samples come in blocks of some length, with so many missing from one on.
fn told(plan: &Plan, sea: &[[f64; CHANNELS]], block: usize, gap: Option<(usize, usize)>) -> Vec<Transient> {
    let frames: Vec<Frame> = sea.iter().map(|x| x.map(|x| (2000.0 * x).round() as i32)).collect();
    let (mut state, mut scratch) = (Box::new(State::new()), Box::new(Scratch::new()));
    let mut out = Vec::new();
    let mut sink = |message| {
        if let Message::Transient(t) = message {
            out.push(t);
        }
    };
    let (until, missing) = gap.unwrap_or((frames.len(), 0));
    for (from, part) in
        [(0, &frames[..until]), (until + missing, frames.get(until + missing..).unwrap_or(&[]))]
    {
        for (n, frames) in part.chunks(block).enumerate() {
            let first_index = (from + n * block) as u64;
            push(plan, &mut state, &mut scratch, Block { first_index, frames }, &mut sink);
        }
    }
    finish(plan, &mut state, &mut scratch, &mut sink);
    out
}

#[test]
fn clicks_are_told_once_from_where_they_come_and_as_well_as_is_said() {
    for (rate, f_hz, sd_s) in [(16e3, 5000.0, 2.5e-4), (64e3, 12_000.0, 1e-4)] {
        for peak in [12.0, 40.0] {
            let plan = plan(rate);
            let (mut random, mut held, mut all) = (Normal(77), 0, 0);
            for seed in 0..4 {
                let mut sea = noise(&plan, 27.0, 5 + seed);
                let made: Vec<_> = (0..24)
                    .map(|n| {
                        let from = (3.0 + random.next(), 0.3 * random.next());
                        let at = 1.0 + 1.05 * f64::from(n) + 0.01 * random.next();
                        add(&plan, &mut sea, at, from, click(peak, f_hz, sd_s));
                        (at, from)
                    })
                    .collect();
                let told = hear(&plan, &sea).transients;
                assert_eq!(told.len(), made.len(), "{told:?}");
                for (t, (at, from)) in told.iter().zip(made) {
                    let late = t.index as f64 / rate - at;
                    assert!(
                        (-2e-3..1e-3).contains(&late) && t.count == 1 && t.kind == Transient::IMPULSE,
                        "{late} {t:?}"
                    );
                    assert!(t.channels & 0b1111 == 0b1111 && t.duration < 200, "{t:?}");
                    let db = 20.0 * (peak * 2000.0 / f64::from(plan.full_scale)).log10();
                    assert!((f64::from(t.peak_tenth_db) / 10.0 - db).abs() < 2.5, "{t:?} {db}");
                    if t.has_direction() {
                        all += 1;
                        held += usize::from(standardised(t, from) < 5.991);
                    }
                }
            }
            // 95 % of 96: fewer than 84 or none outside is by chance once in three hundred.
            assert!(all >= 94 && (84..=all).contains(&held), "{rate} {peak}: {held} of {all}");
        }
    }
}

#[test]
fn noise_and_a_loud_vessel_are_no_transients() {
    let plan = plan(16_000.0);
    let vessel = source(&plan, (2.0, 0.2), 3.0, None, 60, 3);
    for sea in [noise(&plan, 120.0, 9), noisy(vessel, 4)] {
        let told = hear(&plan, &sea).transients;
        assert!(told.is_empty(), "{told:?}");
    }
}

#[test]
fn a_click_on_one_channel_is_told_of_that_channel_alone_and_of_nowhere() {
    let plan = planned(64_000.0, |array| array.channels = [2, 0, 3, 1]);
    let mut sea = noise(&plan, 4.0, 8);
    for (n, x) in sea.iter_mut().skip(128_000).take(40).enumerate() {
        x[3] += 30.0 * (-(n as f64) / 12.0).exp() * (0.9 * n as f64).cos();
    }
    let told = hear(&plan, &sea).transients;
    assert!(
        matches!(&told[..], [t] if t.channels == 0b1000 && t.channel == 3 && !t.has_direction()),
        "{told:?}"
    );
}

#[test]
fn one_that_clips_is_told_with_its_channels_also_where_its_frames_are_left_out() {
    let plan = plan(64_000.0);
    let mut sea = noise(&plan, 6.0, 8);
    let mut random = Normal(4);
    // A tenth of a second at twice full scale.
    let limit = f64::from(plan.full_scale) / 2000.0;
    for n in 192_000..198_400 {
        sea[n] = core::array::from_fn(|_| (2.0 * limit * random.next()).clamp(-limit, limit));
    }
    let told = hear(&plan, &sea).transients;
    assert!(
        matches!(&told[..], [t] if t.channels == 0xff && t.peak_tenth_db == 0 && t.kind == Transient::BURST
        && t.index.abs_diff(192_000) < 4 && (6300..6500).contains(&t.duration)),
        "{told:?}"
    );
}

#[test]
fn wherever_it_lies_in_its_frame_and_however_samples_come_it_is_the_same() {
    let plan = plan(64_000.0);
    let quiet = noise(&plan, 1.0, 21);
    let from = (4.0, 0.4);
    // Every border of a frame, and between them.
    for at in (31_000..31_000 + HOP).step_by(37) {
        let mut sea = quiet.clone();
        add(&plan, &mut sea, at as f64 / 64e3, from, plain(40.0));
        let whole = told(&plan, &sea, sea.len(), None);
        assert_eq!(whole, told(&plan, &sea, 64, None));
        assert!(
            matches!(&whole[..], [t] if t.has_direction() && standardised(t, from) < 16.0),
            "{at}: {whole:?}"
        );
    }
}

#[test]
fn channels_may_be_exchanged_and_the_array_turned() {
    let (turn, from) = (0.7f64, (1.0, -0.2));
    let channels = [3, 1, 0, 2];
    let usual = plan(64_000.0);
    let other = planned(64_000.0, |array| {
        array.channels = channels;
        // Clockwise from above.
        let (s, c) = turn.sin_cos();
        array.hydrophones_m = array.hydrophones_m.map(|[x, y, z]| [x * c + y * s, y * c - x * s, z]);
    });
    let mut sea = noise(&usual, 1.0, 2);
    add(&usual, &mut sea, 0.5, from, plain(30.0));
    let exchanged: Sea = sea
        .iter()
        .map(|x| {
            let mut out = [0.0; CHANNELS];
            channels
                .iter()
                .zip(&usual.channels)
                .for_each(|(to, of)| out[usize::from(*to)] = x[usize::from(*of)]);
            out
        })
        .collect();
    let (a, b) = (hear(&usual, &sea).transients, hear(&other, &exchanged).transients);
    let ([a], [b]) = (&a[..], &b[..]) else { panic!("{a:?} {b:?}") };
    let turned = wrap_pi(f64::from(b.azimuth) - f64::from(a.azimuth) - turn);
    assert!(turned.abs() < 1e-5 && (a.elevation - b.elevation).abs() < 1e-5, "{a:?} {b:?}");
    assert_eq!((a.index, a.duration, a.peak_tenth_db), (b.index, b.duration, b.peak_tenth_db));
}

#[test]
fn two_at_once_from_two_sides_come_from_neither() {
    let plan = plan(64_000.0);
    let mut random = Normal(6);
    let (mut wrong, mut said) = (0, 0);
    for seed in 0..40 {
        let mut sea = noise(&plan, 0.6, 40 + seed);
        let froms = [(1.0 + 0.3 * random.next(), 0.3), (3.5 + 0.3 * random.next(), -0.1)];
        let apart = 4e-4 * random.next();
        add(&plan, &mut sea, 0.3, froms[0], plain(25.0));
        add(&plan, &mut sea, 0.3 + apart, froms[1], plain(25.0));
        for t in hear(&plan, &sea).transients.iter().filter(|t| t.has_direction()) {
            said += 1;
            wrong += usize::from(froms.iter().all(|from| standardised(t, *from) > 30.0));
        }
    }
    assert!(wrong <= 1, "{wrong} of {said}");
}

#[test]
fn many_are_counted_and_the_strongest_of_them_told() {
    let plan = plan(64_000.0);
    let mut sea = noise(&plan, 70.0, 3);
    let (each, loud) = (0.05, 777);
    let made = (68.0 / each) as usize;
    for n in 0..made {
        let peak = if n == loud { 40.0 } else { 15.0 };
        add(&plan, &mut sea, 0.5 + each * n as f64, (n as f64 % TAU, 0.1), plain(peak));
    }
    let told = hear(&plan, &sea).transients;
    let counted: u32 = told.iter().map(|t| t.count).sum();
    assert_eq!(counted as usize, made);
    let one_by_one = told.iter().filter(|t| t.count == 1).count();
    assert!((AT_ONCE as usize + 60..AT_ONCE as usize + 72).contains(&one_by_one), "{one_by_one}");
    let held: Vec<_> = told.iter().filter(|t| t.count > 1).collect();
    let at = |t: &Transient| t.index as f64 / 64e3 - (0.5 + each * loud as f64);
    // The loud one may be among those told by themselves.
    let found = told.iter().find(|t| at(t).abs() < 2e-3).unwrap();
    assert!(found.has_direction() && standardised(found, (loud as f64 % TAU, 0.1)) < 16.0, "{found:?}");
    assert!(held.len() == 2 && told.len() == one_by_one + 2, "{held:?}");
}

#[test]
fn a_gap_within_one_ends_it_and_time_that_starts_again_loses_none() {
    let plan = plan(64_000.0);
    let mut sea = noise(&plan, 2.0, 12);
    for at in [0.5, 1.0, 1.5] {
        add(&plan, &mut sea, at, (5.0, 0.1), plain(30.0));
    }
    // From the middle of the second on, or soon after it, a tenth of a second is not there.
    for from in [64_010, 64_400, 64_900] {
        let with = told(&plan, &sea, 64, Some((from, 6400)));
        let all = with.iter().all(|t| !t.has_direction() || standardised(t, (5.0, 0.1)) < 16.0);
        assert!(all && with.len() >= 2 && (from < 64_900 || with.len() == 3), "{with:?}");
    }
    let frames: Vec<Frame> = sea.iter().map(|x| x.map(|x| (2000.0 * x).round() as i32)).collect();
    let (mut state, mut scratch) = (Box::new(State::new()), Box::new(Scratch::new()));
    let mut out = Vec::new();
    for first_index in [50_000_000, 0] {
        let mut sink = |message| {
            if let Message::Transient(t) = message {
                out.push(t.index >= 50_000_000);
            }
        };
        push(&plan, &mut state, &mut scratch, Block { first_index, frames: &frames }, &mut sink);
    }
    finish(&plan, &mut state, &mut scratch, &mut |message| {
        if let Message::Transient(t) = message {
            out.push(t.index >= 50_000_000);
        }
    });
    assert_eq!(out, [true, true, true, false, false, false]);
}

/// Adds a sound given sample by sample, heard from a direction from a time on, to the nearest sample.
fn play(plan: &Plan, sea: &mut [[f64; CHANNELS]], at_s: f64, from: (f64, f64), sound: &[f64]) {
    let u = unit_vector(from.0 as f32, from.1 as f32);
    let rate = f64::from(plan.rate_hz());
    for (h, late) in wavefront::arrivals(plan.geometry(), &u, 1.0 / 500.0).iter().enumerate() {
        let start = ((at_s + f64::from(*late)) * rate).round() as usize;
        for (x, sound) in sea[start..].iter_mut().zip(sound) {
            x[usize::from(plan.channels[h])] += sound;
        }
    }
}

/// Adds noise of unit power below some kilohertz, as the sea has it.
fn low(sea: &mut [[f64; CHANNELS]], seed: u64) {
    let mut random = Normal(seed);
    let keep = (-TAU * 1500.0 / 64_000.0).exp();
    let mut last = [0.0; CHANNELS];
    for x in sea {
        for (x, last) in x.iter_mut().zip(&mut last) {
            *last = keep * *last + (1.0 - keep * keep).sqrt() * random.next();
            *x += *last;
        }
    }
}

#[test]
fn whistles_are_no_vessels() {
    let plan = plan(64_000.0);
    let rate = 64_000.0;
    let vessels = |sea: &[[f64; CHANNELS]]| hear(&plan, sea).bearings.len();
    for seed in 1..2u64 {
        let from = (0.9 * seed as f64, 0.1);
        let mut whistled = std::vec![[0.0; CHANNELS]; 12 * 64_000];
        low(&mut whistled, seed);
        for n in 0..7 {
            let (at_s, turned) = (0.5 + 1.5 * f64::from(n), (from.0 + 0.05 * f64::from(n), from.1));
            let whistle: Vec<f64> = (0..(0.7 * rate) as usize)
                .map(|k| {
                    let t = k as f64 / rate;
                    (TAU / 1.4 * t).sin() * (TAU * (6000.0 * t + 6000.0 * t * t)).sin()
                })
                .collect();
            play(&plan, &mut whistled, at_s, turned, &whistle);
        }
        let whistles = vessels(&whistled);
        assert!(whistles < 3, "{seed}: {whistles}");
    }
}

#[test]
fn weak_snaps_hide_no_vessel() {
    let plan = plan(64_000.0);
    for (seed, rms) in [(1u64, 3.0f64), (2, 1.0)] {
        let from = (2.0, 0.2);
        // The vessel and the noise are low, as they are in the sea, and the snaps are not.
        let mut sea = source(&plan, from, rms, Some(1500.0), 12, seed);
        low(&mut sea, 90 + seed);
        let mut random = Normal(7 + seed);
        let peak = 5.0 * (1.0 + rms * rms).sqrt();
        for n in 0..230 {
            let at_s = 0.2 + 0.05 * f64::from(n) + 0.01 * random.next().clamp(-2.0, 2.0);
            let snap = (3.0 * random.next(), (0.5 * random.next()).clamp(-1.5, 0.5));
            let sound: Vec<f64> =
                (0..60).map(|k| peak * (-f64::from(k) / 10.0).exp() * (1.2 * f64::from(k)).cos()).collect();
            play(&plan, &mut sea, at_s, snap, &sound);
        }
        let bearings = hear(&plan, &sea).bearings;
        let right = bearings.iter().filter(|b| wrap_pi(f64::from(b.azimuth) - from.0).abs() < 0.01).count();
        assert!(right >= 18 && right == bearings.len(), "{rms}: {right} of {}", bearings.len());
    }
}
