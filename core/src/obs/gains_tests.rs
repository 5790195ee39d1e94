//! Gains of the horizontal components: noise, vessels, changes and jumps.

use super::*;
use std::vec::Vec;

/// Noise of which north has so much.
fn noise(north: f32) -> Moments {
    Moments {
        power: [1.0, north, 1.0, 1.0],
        with_pressure: [1.0, 0.0, 0.0, 0.0],
        instants: 3000,
        ..Moments::NONE
    }
}

/// A vessel as heard from an azimuth with that gain of north as a power, so steeply, beside so much noise of each component, and of north so many
/// times.
fn heard(gain: f32, azimuth: f32, level: f32, noise: f32, noisier: f32) -> Moments {
    let (s, c) = math::f32::sin_cos(azimuth);
    let (north, east) = (level * math::f32::sqrt(gain) * c, level * s);
    Moments {
        power: [1.0, north * north + gain * noise * noisier, east * east + noise, 1.0],
        with_pressure: [1.0, north, east, 0.0],
        north_east: north * east,
        instants: 3000,
        ..Moments::NONE
    }
}

/// Minutes of vessels from all around as heard with that gain of north, then so many without one; what is said of it, tenths of a decibel.
fn said(gain: f32, minutes: usize, quiet: impl Fn(usize) -> Moments) -> Vec<Option<i32>> {
    let mut gains = Gains::new();
    let vessels = (0..310).map(|n| (true, heard(gain, n as f32 / 19.0, 1.0, 0.2, 1.0)));
    let quiet = (0..minutes).map(|n| (false, quiet(n)));
    vessels
        .chain(quiet)
        .filter_map(|(vessel, m)| {
            if vessel {
                gains.vessel(&m)
            } else {
                gains.noise(&m, 1.0);
            }
            gains.news().map(|news| news.map(|db| math::f32::round(10.0 * db) as i32))
        })
        .collect()
}

#[test]
fn unequal_components_are_named_and_a_shaking_instrument_is_not() {
    let once =
        |said: &[Option<i32>], least: i32| matches!(said, [Some(db)] if (least..least + 10).contains(db));
    assert!(once(&said(2.0, 700, |_| noise(2.0)), 29));
    assert!(once(&said(0.5, 700, |_| noise(0.5)), -31));
    assert_eq!(said(1.3, 1000, |_| noise(1.3)), []);
    // However much it is, not before the tide turns.
    assert_eq!(said(100.0, 400, |_| noise(100.0)), []);
    assert!(said(100.0, 550, |_| noise(100.0)).first().is_some_and(|db| *db >= Some(190)));
    // Four hours of strumming along north, 10 dB above the noise.
    assert_eq!(said(10.0, 1440, |n| noise(if n % 720 > 480 { 10.0 } else { 1.0 })), []);
    // Noise from north that goes with pressure is no gain.
    let coherent = Moments { with_pressure: [1.0, 0.7, 0.0, 0.0], ..noise(1.49) };
    assert_eq!(said(1.5, 1000, |_| coherent), []);
    // Noise of two directions at once, whose difference points between north and east, or stronger.
    let two = Moments { north_east: 0.2, ..noise(2.0) };
    assert_eq!(said(2.0, 1000, |_| two), []);
    // As it would be without that.
    assert!(once(&said(1.7, 1000, |_| noise(1.7)), 20));
}

/// What is said to be open of minutes of noise, then of vessels with that gain of north and so many times the noise: tenths of a decibel.
fn open(noises: impl Iterator<Item = Moments>, gain: f32, noisier: f32) -> Vec<Option<i32>> {
    let mut gains = Gains::new();
    let vessels = (0..310).map(|n| (true, heard(gain, n as f32 / 19.0, 1.0, 0.2, noisier)));
    let mut said = Vec::new();
    for (vessel, m) in noises.map(|m| (false, m)).chain(vessels) {
        if vessel {
            gains.vessel(&m);
        } else {
            gains.noise(&m, 1.0);
        }
        gains.news();
        said.extend(gains.doubt().map(|news| news.map(|db| math::f32::round(10.0 * db) as i32)));
    }
    said
}

#[test]
fn a_louder_component_is_in_doubt_until_vessels_have_decided() {
    let louder = |minutes| (0..minutes).map(|_| noise(2.0));
    // Gain and noise of its own alike.
    assert_eq!(open(louder(550), 2.0, 1.0), [Some(30), None]);
    assert_eq!(open(louder(550), 1.0, 2.0), [Some(30), None]);
    // Not within hours, nor where it is nothing, or where an instrument shakes that long.
    assert_eq!(open(louder(160), 1.0, 1.0), []);
    assert_eq!(open((0..400).map(|_| noise(1.3)), 1.0, 1.0), []);
    let shaking = (0..1440).map(|n| noise(if n % 720 > 480 { 10.0 } else { 1.0 }));
    assert_eq!(open(shaking, 1.0, 1.0), []);
}

#[test]
fn vessels_from_many_sides_tell_any_gain_and_from_one_none() {
    for gain_db in [-20.0f32, -3.0, 0.0, 1.0, 10.0] {
        for (turns, many) in [(0.02, false), (1.0, true)] {
            let mut gains = Gains::new();
            for n in 0..200u32 {
                // As steep as it likes.
                let level = 0.6 + 0.1 * ((n * 7 % 11) as f32 - 5.0) / 5.0;
                let gain = math::f32::exp(gain_db * (core::f32::consts::LN_10 / 10.0));
                gains.vessel(&heard(gain, 0.9 + turns * n as f32 / 30.0, level, 0.01, 1.0));
            }
            let (db, variance) = gains.by_vessels().unwrap_or((0.0, 1e6));
            let off_db = (db as f32 - gain_db).abs();
            if many {
                assert!(off_db < 0.3 && variance < 1.5, "{gain_db}: {db} {variance}");
            } else {
                assert!(variance > 30.0, "{gain_db}: {db} {variance}");
            }
        }
    }
}

#[test]
fn before_vessels_decide_a_ratio_may_be_gain_or_noise() {
    let mut gains = Gains::new();
    let mut after = |minutes: usize, vessel: Option<f32>| {
        for n in 0..minutes {
            if let Some(gain) = vessel {
                gains.vessel(&heard(gain, n as f32 / 19.0, 1.0, 0.2, 1.0));
            } else {
                gains.noise(&noise(4.0), 1.0);
            }
            gains.news();
        }
        let Gain { db, sd_db } = gains.gain();
        (db, sd_db)
    };
    let (db, sd_db) = after(60, None);
    // Both, 0 and 6 dB, are inside 95 % of that.
    assert!((2.5..3.5).contains(&db) && db < 1.96 * sd_db && sd_db < 0.8 * db, "{db} {sd_db}");
    // Vessels hear no gain: noise.
    let (db, sd_db) = after(120, Some(1.0));
    assert!(db < 0.05 && sd_db < 2.0, "{db} {sd_db}");
    // And it becomes one.
    let (db, _) = after(2000, Some(4.0));
    assert!((5.5..6.5).contains(&db), "{db}");
}

#[test]
fn beside_vessels_from_the_first_minute_on_noise_is_had_and_forgotten_where_there_is_other() {
    // 3 dB of gain, 9 dB of noise.
    for (gain, noisier, told_db) in [(2.0, 1.0, 3.0), (1.0, 8.0, 0.0)] {
        let mut gains = Gains::new();
        for n in 0..400 {
            let m = heard(gain, n as f32 / 19.0, 0.6, 0.3, noisier);
            gains.vessel(&m);
            gains.beside(&m);
            gains.news();
        }
        let Gain { db, sd_db } = gains.gain();
        assert!((db - told_db).abs() < 0.3 && sd_db < 1.5, "{gain} {noisier}: {db} {sd_db}");
    }
    let mut gains = Gains::new();
    (0..300).for_each(|n| gains.beside(&heard(1.0, n as f32 / 19.0, 0.6, 0.3, 4.0)));
    (0..30).for_each(|_| {
        gains.noise(&noise(1.0), 1.0);
    });
    assert!(gains.ratio_db.abs() < 0.3, "{}", gains.ratio_db);
}

#[test]
fn what_vessels_said_is_forgotten_where_the_noise_has_changed() {
    let mut gains = Gains::new();
    let mut day = |gain: f32, quiet: usize, vessels: usize| {
        let mut changes = 0;
        for n in 0..quiet {
            let m = noise(gain * (1.0 + 0.1 * math::f32::sin(n as f32)));
            changes += usize::from(gains.noise(&m, 1.0));
            gains.news();
        }
        for n in 0..vessels {
            gains.vessel(&heard(gain, n as f32 / 19.0, 1.0, 0.2, 1.0));
            gains.news();
        }
        (changes, gains.gain())
    };
    let (changes, gain) = day(1.0, 300, 400);
    assert!(changes == 0 && gain.db.abs() < 0.1 && gain.sd_db < 0.5, "{gain:?}");
    // 6 dB from here on: known within half an hour, and either may be so before vessels decide.
    let (changes, gain) = day(4.0, 25, 0);
    assert!(
        changes > 0 && (gain.db - 6.0).abs() < 1.96 * gain.sd_db && gain.db < 1.96 * gain.sd_db,
        "{gain:?}"
    );
    let (changes, gain) = day(4.0, 20, 400);
    assert!(changes < 2 && (gain.db - 6.0).abs() < 0.5 && gain.sd_db < 1.5, "{gain:?}");
}

#[test]
fn a_component_that_is_noisier_but_hears_vessels_as_the_other_does_is_of_its_gain() {
    for north in [0.01, 0.25, 4.0, 100.0] {
        assert_eq!(said(1.0, 3000, |_| noise(north)), []);
    }
    // Nor is anything said before vessels were heard.
    let mut gains = Gains::new();
    assert!((0..3000).all(|_| {
        gains.noise(&noise(4.0), 1.0);
        gains.news().is_none()
    }));
}

#[test]
fn a_jump_that_vessels_contradict_was_noise() {
    let mut gains = Gains::new();
    let mut told = Vec::new();
    for n in 0..1200usize {
        if n == 300 {
            gains.jumped(3.0, true);
        }
        // Noise of north's own, from the moment on.
        let noisier = if n < 300 { 1.0 } else { 2.0 };
        let m =
            if n.is_multiple_of(3) { noise(noisier) } else { heard(1.0, n as f32 / 19.0, 1.0, 0.2, noisier) };
        let m = gains.without_known(&m);
        if n.is_multiple_of(3) {
            gains.noise(&m, 1.0);
        } else {
            gains.vessel(&m);
        }
        told.extend(gains.news());
    }
    let gain = gains.gain();
    assert!(gain.db.abs() < 1.0 && gains.known_db == 0.0, "{gain:?}");
    assert!(matches!(told[..], [Some(_), None]), "{told:?}");
}

#[test]
fn a_gain_that_jumps_beside_a_vessel_is_told_and_taken_out_at_once() {
    let mut gains = Gains::new();
    let minute = |gains: &mut Gains, n: usize, gain: f32| {
        let m = if n.is_multiple_of(3) { noise(gain) } else { heard(gain, n as f32 / 19.0, 1.0, 0.2, 1.0) };
        let m = gains.without_known(&m);
        if n.is_multiple_of(3) {
            assert!(!gains.noise(&m, 1.0), "{n}");
        } else {
            gains.vessel(&m);
        }
        gains.news()
    };
    assert!((0..300).all(|n| minute(&mut gains, n, 1.0).is_none()));
    gains.jumped(3.0, true);
    let told: Vec<_> = (300..900).filter_map(|n| minute(&mut gains, n, 1.995)).collect();
    let [Some(db)] = told[..] else { panic!("{told:?}") };
    assert!((db - 3.0).abs() < 0.3, "{db}");
    let gain = gains.gain();
    assert!((gain.db - 3.0).abs() < 0.3 && (0.2..0.8).contains(&gain.sd_db), "{gain:?}");
    // And back.
    gains.jumped(-3.0, true);
    let told: Vec<_> = (900..1500).filter_map(|n| minute(&mut gains, n, 1.0)).collect();
    assert_eq!(told, [None]);
}
