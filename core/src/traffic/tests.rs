use super::*;
use crate::angle::{RAD_PER_DEG, wrap_pi, wrap_tau};
use crate::config::Tracking;
use crate::wire::{Fault, FaultCode};
use std::vec::Vec;

pub(super) const RATE_HZ: f64 = 64_000.0;

pub(super) fn config() -> Config {
    let tracking = Tracking { speed_m_s: 7.0, speed_sd_m_s: 0.0, ..Tracking::default() };
    Config::with(passage::Config::new(&tracking, 1484.0), RATE_HZ)
}

pub(super) fn gaussian(seed: &mut u64) -> f64 {
    let draws = (0..12).map(|_| {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 11) as f64 / (1u64 << 53) as f64
    });
    draws.sum::<f64>() - 6.0
}

pub(super) fn message(t_s: f64, azimuth: f64, sd: f64, band: u8) -> Bearing {
    Bearing {
        index: (t_s * RATE_HZ) as u64,
        azimuth: wrap_tau(azimuth) as f32,
        elevation: 0.0,
        var_azimuth: (sd * sd) as f32,
        var_elevation: 1e-4,
        cov: 0.0,
        snr_db: 10.0,
        quality: 1.0,
        closure_s: 0.0,
        statistic: 2.0,
        band,
        flags: 0,
    }
}

/// Lets time pass: [`advance`] at every 512th sample.
pub(super) fn wait(
    config: &Config,
    state: &mut State,
    from_s: f64,
    to_s: f64,
    sink: &mut dyn FnMut(Message),
) {
    let grid = |t_s: f64| (t_s * RATE_HZ) as u64 / 512;
    for k in grid(from_s) + 1..=grid(to_s) {
        advance(config, state, 512 * k, sink);
    }
}

/// Takes a bearing and lets half a second pass.
pub(super) fn hear(config: &Config, state: &mut State, heard: &Bearing, sink: &mut dyn FnMut(Message)) {
    bearing(config, state, heard, sink);
    let t_s = heard.index as f64 / RATE_HZ;
    wait(config, state, t_s, t_s + 0.5, sink);
}

/// Azimuth received from a straight track: CPA at `t_c`, range `r_c`, azimuth `a_c`, turning clockwise.
fn azimuth(t_s: f64, t_c: f64, r_c: f64, a_c: f64) -> f64 {
    let emitted = |t: f64| t - m::hypot(r_c, 7.0 * (t - t_c)) / 1484.0;
    a_c + m::atan(7.0 * (emitted(t_s) - t_c) / r_c)
}

pub(super) fn tracks(messages: &[Message], stage: u8) -> Vec<crate::wire::Track> {
    let mut out = Vec::new();
    for message in messages {
        if let Message::Track(t) = message
            && t.stage == stage
        {
            out.push(*t);
        }
    }
    out
}

#[test]
fn one_pass_is_one_track_with_one_solution() {
    let config = config();
    for sd_deg in [0.1, 0.5, 2.0] {
        let (mut state, mut out, mut seed) = (State::new(), Vec::new(), 7);
        for k in 0..600 {
            let t = 0.5 * f64::from(k);
            let sd = sd_deg * RAD_PER_DEG;
            let a = azimuth(t, 150.0, 500.0, 6.0) + sd * gaussian(&mut seed);
            hear(&config, &mut state, &message(t, a, sd, 0), &mut |m| out.push(m));
        }
        wait(&config, &mut state, 300.0, 350.0, &mut |m| out.push(m));
        let last = tracks(&out, 1);
        assert_eq!(last.len(), 1, "{sd_deg}");
        assert!(out.len() > 50 && tracks(&out, 0).iter().all(|t| t.id == last[0].id));
        let t = &last[0];
        assert!((t.cpa_range_m - 500.0).abs() < 4.0 * t.sd_cpa_range_m + 1.0, "{t:?}");
        assert!(t.sd_cpa_range_m < 40.0 && (t.cpa_time_s - 150.0).abs() < 5.0 && t.starboard);
        assert!(wrap_pi(f64::from(t.heading) - 6.0 - core::f64::consts::FRAC_PI_2).abs() < 0.1);
        finish(&config, &mut state, &mut |m| out.push(m));
        assert_eq!((tracks(&out, 1).len(), state.vessels()), (1, 0));
    }
}

#[test]
fn a_passage_of_small_errors_is_not_split_by_its_first_bearings() {
    let tracking = Tracking { speed_m_s: 7.0, speed_sd_m_s: 0.0, bearing_sd_deg: 0.0, ..Tracking::default() };
    let config = Config::with(passage::Config::new(&tracking, 1484.0), RATE_HZ);
    let (mut seed, sd) = (41, 0.1 * RAD_PER_DEG);
    for run in 0..100 {
        let (mut state, mut out) = (State::new(), Vec::new());
        let (t_c, r_c) = (20.0 + 1.5 * f64::from(run), 200.0 + 12.0 * f64::from(run));
        for k in 0..300 {
            let t = 0.5 * f64::from(k);
            let a = azimuth(t, t_c, r_c, 6.0) + sd * gaussian(&mut seed);
            hear(&config, &mut state, &message(t, a, sd, 0), &mut |m| out.push(m));
        }
        finish(&config, &mut state, &mut |m| out.push(m));
        let ends = tracks(&out, 1);
        assert!(ends.len() == 1 && ends[0].n >= 295, "{run} {ends:?}");
    }
}

#[test]
fn sub_bands_of_one_vessel_are_one_track_and_a_quiet_vessel_in_one_band_another() {
    let config = config();
    let (mut state, mut out, mut seed) = (State::new(), Vec::new(), 3);
    let sd = 0.01;
    for k in 0..400 {
        let t = 0.5 * f64::from(k);
        for (band, t_c, a_c) in [(0, 100.0, 1.0), (1, 100.0, 1.0), (2, 60.0, 3.5), (3, 100.0, 1.0)] {
            let a = azimuth(t, t_c, 400.0, a_c) + sd * gaussian(&mut seed);
            bearing(&config, &mut state, &message(t, a, sd, band), &mut |m| out.push(m));
        }
        wait(&config, &mut state, t, t + 0.5, &mut |m| out.push(m));
    }
    assert_eq!(state.vessels(), 2);
    finish(&config, &mut state, &mut |m| out.push(m));
    assert_eq!(tracks(&out, 1).len(), 2);
}

#[test]
fn a_measured_speed_takes_the_place_of_the_priors_spread() {
    // Traffic of 9 ± 2.5 m/s, a vessel of 7: bearings alone leave the prior's range, a shaft rate mends it.
    let tracking = Tracking { speed_m_s: 9.0, speed_sd_m_s: 2.5, ..Tracking::default() };
    let config = Config::with(passage::Config::new(&tracking, 1484.0), RATE_HZ);
    let final_with = |speed: Option<(f32, f32)>| {
        let (mut state, mut out, mut seed) = (State::new(), Vec::new(), 9);
        for k in 0..500 {
            let t = 0.5 * f64::from(k);
            let a = azimuth(t, 120.0, 500.0, 2.0) + 0.01 * gaussian(&mut seed);
            hear(&config, &mut state, &message(t, a, 0.01, 0), &mut |m| out.push(m));
            if k == 250
                && let Some((mean, sd)) = speed
            {
                let id = tracks(&out, 0)[0].id;
                assert!(set_speed(&mut state, id, mean, sd));
                assert!(!set_speed(&mut state, id + 1, mean, sd) && !set_speed(&mut state, 0, mean, sd));
                assert!(!set_speed(&mut state, id, mean, 0.0));
            }
        }
        finish(&config, &mut state, &mut |m| out.push(m));
        assert!(!set_speed(&mut state, 1, 7.0, 0.2), "no vessel is left");
        tracks(&out, 1)[0]
    };
    let (without, with) = (final_with(None), final_with(Some((7.1, 0.2))));
    assert!((without.cpa_range_m - 500.0 * 9.0 / 7.0).abs() < 30.0, "{without:?}");
    assert!((0.2..0.35).contains(&(without.sd_cpa_range_m / without.cpa_range_m)), "{without:?}");
    assert!((with.speed_m_s - 7.1).abs() < 0.1 && (with.sd_speed_m_s - 0.2).abs() < 0.02, "{with:?}");
    assert!((with.cpa_range_m - 500.0).abs() < 25.0 && with.sd_cpa_range_m < 25.0, "{with:?}");
    assert!(wrap_pi(f64::from(with.heading - without.heading)).abs() < 0.01);
}

#[test]
fn elevations_of_a_deep_array_tell_range_whatever_the_speed() {
    // Traffic of 10 ± 2.5 m/s, a vessel of 7 that passes 163 m above and 400 m aside; all elevations 0.7° too high.
    let tracking = Tracking { speed_m_s: 10.0, speed_sd_m_s: 2.5, ..Tracking::default() };
    let blind = Config::with(passage::Config::new(&tracking, 1484.0), RATE_HZ);
    let mut deep = blind;
    deep.motion.medium.height_m = 163.0;
    deep.motion.elevation_bias_sd_rad = RAD_PER_DEG;
    let pass = |config: &Config, range_m: f64| {
        let (mut state, mut out, mut seed) = (State::new(), Vec::new(), 5);
        for k in 0..500 {
            let t = 0.5 * f64::from(k);
            let a = azimuth(t, 120.0, range_m, 2.0) + 0.01 * gaussian(&mut seed);
            let truth = m::atan2(163.0, m::hypot(range_m, 7.0 * (t - 120.0)));
            let elevation = truth + RAD_PER_DEG * (0.7 + 1.5 * gaussian(&mut seed));
            let heard = Bearing { elevation: elevation as f32, ..message(t, a, 0.01, 0) };
            hear(config, &mut state, &heard, &mut |m| out.push(m));
        }
        finish(config, &mut state, &mut |m| out.push(m));
        assert_eq!(tracks(&out, 1).len(), 1);
        tracks(&out, 1)[0]
    };
    let (without, with) = (pass(&blind, 400.0), pass(&deep, 400.0));
    assert!(without.cpa_range_m > 520.0 && without.sd_cpa_range_m > 80.0, "{without:?}");
    assert!((with.cpa_range_m - 400.0).abs() < 25.0 && with.sd_cpa_range_m < 25.0, "{with:?}");
    assert!((with.speed_m_s - 7.0).abs() < 0.45 && with.sd_speed_m_s < 0.45, "{with:?}");
    // Far away they tell little, and say so.
    let far = pass(&deep, 1900.0);
    assert!(
        (far.cpa_range_m - 1900.0).abs() < 2.5 * far.sd_cpa_range_m && far.sd_cpa_range_m > 200.0,
        "{far:?}"
    );
}

#[test]
fn scattered_bearings_and_nonsense_are_no_vessel() {
    let config = config();
    let (mut state, mut seed) = (State::new(), 11u64);
    let mut sink = |_| panic!("no track is due");
    for k in 0..2000 {
        let a = 100.0 * gaussian(&mut seed);
        hear(&config, &mut state, &message(0.5 * f64::from(k), a, 0.02, 0), &mut sink);
    }
    for (a, v) in [(f32::NAN, 1e-4), (1.0, f32::INFINITY), (1.0, -1.0)] {
        let nonsense = Bearing { azimuth: a, var_azimuth: v, ..message(2000.0, 0.0, 0.01, 0) };
        bearing(&config, &mut state, &nonsense, &mut sink);
    }
    finish(&config, &mut state, &mut sink);
}

/// Eight vessels 45° apart in azimuth, heard together for `seconds`; the state then.
fn eight_vessels(config: &Config, seconds: u32, out: &mut Vec<Message>) -> State {
    let (mut state, mut seed) = (State::new(), 17);
    for k in 0..2 * seconds {
        let t = 0.5 * f64::from(k);
        for n in 0..8 {
            let a = azimuth(t, 100.0, 500.0 + 40.0 * f64::from(n), 0.785 * f64::from(n));
            let heard = message(t, a + 0.003 * gaussian(&mut seed), 0.003, 0);
            bearing(config, &mut state, &heard, &mut |m| out.push(m));
        }
        wait(config, &mut state, t, t + 0.5, &mut |m| out.push(m));
    }
    assert_eq!(state.vessels(), 8);
    state
}

#[test]
fn eight_passages_that_end_at_once_are_solved_one_piece_a_call() {
    let config = config();
    let mut out = Vec::new();
    let mut state = eight_vessels(&config, 120, &mut out);
    let after = (200.0 * RATE_HZ) as u64;
    let mut ends = Vec::new();
    for k in 0..40u64 {
        let mut told = 0;
        advance(&config, &mut state, after + 512 * k, &mut |_| told += 1);
        assert!(told <= 1, "{told} solutions in one call");
        ends.push(told);
    }
    assert_eq!((ends.iter().sum::<i32>(), state.vessels()), (8, 0), "{ends:?}");
    assert!(ends.iter().take(16).sum::<i32>() == 8, "two calls a passage: {ends:?}");
}

#[test]
fn after_a_restart_of_the_index_open_passages_are_sent_and_new_ones_are_found() {
    let config = config();
    for fresh in [0.0, 1000.0] {
        let mut out = Vec::new();
        let mut state = eight_vessels(&config, 60, &mut out);
        let newest = state.index;
        out.clear();
        restart(&config, &mut state, &mut |m| out.push(m));
        assert_eq!(state.vessels(), 0);
        let mut seed = 5;
        for k in 0..80 {
            let t = fresh + 0.5 * f64::from(k);
            let a = azimuth(t, fresh + 20.0, 500.0, 2.0) + 0.003 * gaussian(&mut seed);
            hear(&config, &mut state, &message(t, a, 0.003, 0), &mut |m| out.push(m));
        }
        let ends = tracks(&out, 1);
        assert!(ends.len() == 8 && ends.iter().all(|t| t.index == newest), "{ends:?}");
        assert_eq!(state.vessels(), 1);
        let running = tracks(&out, 0);
        assert!(running.len() > 2 && running.iter().all(|t| t.id == 9), "{running:?}");
    }
}

#[test]
fn distance_is_along_the_way_of_the_sound_and_each_vessels_own() {
    // 163 m above the array, 60 m aside: what reaches the hydrophones is a wavefront of 174 m.
    let config = Config { height_m: 163.0, ..config() };
    let (mut state, mut seed) = (State::new(), 5);
    for k in 0..130 {
        let t = 0.5 * f64::from(k);
        for (t_c, range_m, a_c) in [(60.0, 60.0, 1.0), (60.0, 400.0, 4.0)] {
            let a = azimuth(t, t_c, range_m, a_c) + 0.002 * gaussian(&mut seed);
            bearing(&config, &mut state, &message(t, a, 0.002, 0), &mut |_| ());
        }
        wait(&config, &mut state, t, t + 0.5, &mut |_| ());
    }
    let t = 64.5;
    let mut places: Vec<(f32, f32, f32)> = state.places().collect();
    places.sort_by(|a, b| a.1.total_cmp(&b.1));
    assert_eq!(places.len(), 2);
    for ((at, slant, _), (range_m, a_c)) in places.into_iter().zip([(60.0, 1.0), (400.0, 4.0)]) {
        let r = m::hypot(range_m, 7.0 * (t - 60.0));
        assert!((f64::from(slant) / m::hypot(r, 163.0) - 1.0).abs() < 0.05, "{slant}");
        assert!(wrap_pi(f64::from(at) - azimuth(t, 60.0, range_m, a_c)).abs() < 0.02);
    }
}

#[test]
fn the_usual_speed_alone_tells_a_near_vessel_from_one_at_the_reference() {
    // A vessel of 7 m/s, 100 m aside and level with the array, of which 4, 7 and 12 m/s are told, each by a third.
    for told_m_s in [4.0, 7.0, 12.0] {
        let tracking = Tracking { speed_m_s: told_m_s, speed_sd_m_s: 0.33 * told_m_s, ..Tracking::default() };
        let config = Config::with(passage::Config::new(&tracking, 1484.0), RATE_HZ);
        let (mut state, mut seed) = (State::new(), 5);
        for k in 0..130 {
            let t = 0.5 * f64::from(k);
            let a = azimuth(t, 60.0, 100.0, 1.0) + 0.002 * gaussian(&mut seed);
            bearing(&config, &mut state, &message(t, a, 0.002, 0), &mut |_| ());
            wait(&config, &mut state, t, t + 0.5, &mut |_| ());
        }
        let (_, slant_m, sd_m) = state.places().next().unwrap();
        let (curvature, sd) = (1.0 / slant_m, sd_m / (slant_m * slant_m));
        let off = 1.0 / m::hypot(100.0, 31.5) as f32 - curvature;
        assert!(off.abs() < 1.96 * sd && (sd_m / slant_m - 0.6).abs() < 1e-3, "{told_m_s} {slant_m} {sd_m}");
    }
}

#[test]
fn a_wrong_declared_speed_is_told_while_the_vessel_is_heard_and_its_ranges_are_doubted_by_as_much() {
    // 160 m below vessels of 7 m/s that pass 400 m aside, and are declared to have 7 m/s, half and twice that.
    for (declared, wrong) in [(7.0, false), (3.5, true), (14.0, true)] {
        let mut config = config();
        config.height_m = 160.0;
        config.motion = passage::Config {
            speed_m_s: declared,
            speed_sd_m_s: 0.0,
            medium: crate::motion::Medium { height_m: 160.0, ..config.motion.medium },
            height_sd_m: 2.0,
            elevation_bias_sd_rad: RAD_PER_DEG,
            ..config.motion
        };
        let (mut state, mut out, mut seed) = (State::new(), Vec::new(), 5);
        for k in 0..480 {
            let t = 0.5 * f64::from(k);
            let range_m = m::hypot(400.0, 7.0 * (t - 120.0));
            let azimuth = azimuth(t, 120.0, 400.0, 6.0) + 0.002 * gaussian(&mut seed);
            let elevation = m::atan(160.0 / range_m) + 0.002 * gaussian(&mut seed);
            let heard = Bearing { elevation: elevation as f32, ..message(t, azimuth, 0.002, 0) };
            bearing(&config, &mut state, &heard, &mut |m| out.push(m));
            wait(&config, &mut state, t, t + 0.5, &mut |m| out.push(m));
            if t >= 120.0 {
                let (_, slant, sd) = state.places().next().unwrap();
                let off = f64::from(slant) - m::hypot(range_m, 160.0);
                assert!(m::abs(off) < 2.0 * f64::from(sd), "{declared} {t} {off} {sd}");
            }
        }
        finish(&config, &mut state, &mut |m| out.push(m));
        let told: Vec<&Fault> = out
            .iter()
            .filter_map(|m| if let Message::Fault(f) = m { Some(f) } else { None })
            .inspect(|f| assert_eq!(f.code, FaultCode::SpeedContradicted))
            .collect();
        assert_eq!(told.len(), usize::from(wrong), "{declared} {told:?}");
        for fault in told {
            assert!((fault.value - 700).abs() < 70, "{fault:?}");
            assert!(config.seconds(fault.index) < 125.0, "{fault:?}");
        }
        let last = *tracks(&out, 1).last().unwrap();
        assert!((last.cpa_range_m - 400.0).abs() < 2.0 * last.sd_cpa_range_m, "{last:?}");
        assert!((last.speed_m_s - 7.0).abs() <= 2.0 * last.sd_speed_m_s, "{last:?}");
        assert_eq!(last.sd_speed_m_s > 0.0, wrong, "{last:?}");
    }
}

#[test]
fn memory_stays_within_its_budget() {
    assert!(size_of::<State>() <= 18 * 1024, "{}", size_of::<State>());
}

#[test]
fn echoes_of_another_elevation_are_no_vessel_and_turn_no_track() {
    // 160 m below the vessels: 500 m away they are 18° up. The bottom's echo comes from as far below, the surface's from above.
    let mut config = config();
    config.motion.medium.height_m = 160.0;
    config.motion.elevation_bias_sd_rad = RAD_PER_DEG;
    config.height_m = 160.0;
    for echo in [-1.0, 2.0] {
        let (mut state, mut out, mut seed) = (State::new(), Vec::new(), 5);
        for k in 0..500 {
            let t = 0.5 * f64::from(k);
            let at = |sd: f64, band: u8, part: f64, seed: &mut u64| {
                let range_m = m::hypot(500.0, 7.0 * (t - 120.0));
                let elevation = m::atan(part * 160.0 / range_m);
                let a = azimuth(t, 120.0, 500.0, 6.0) + sd * gaussian(seed);
                Bearing { elevation: (elevation + 0.01 * gaussian(seed)) as f32, ..message(t, a, sd, band) }
            };
            let direct = at(0.004, 0, 1.0, &mut seed);
            bearing(&config, &mut state, &direct, &mut |m| out.push(m));
            // Echoes a quarter of a second later, as often, and from 2° beside.
            let mut later = at(0.004, 1, echo, &mut seed);
            later.index += 16_000;
            later.azimuth += 0.035;
            bearing(&config, &mut state, &later, &mut |m| out.push(m));
            wait(&config, &mut state, t + 0.25, t + 0.5, &mut |m| out.push(m));
        }
        finish(&config, &mut state, &mut |m| out.push(m));
        let ends = tracks(&out, 1);
        assert_eq!(ends.len(), 1, "{ends:?}");
        let error = wrap_pi(f64::from(ends[0].heading) - 6.0 - core::f64::consts::FRAC_PI_2);
        let range_error = f64::from(ends[0].cpa_range_m) - 500.0;
        std::println!(
            "echo {echo}: heading off by {:.2} degrees, range by {range_error:.1} m",
            error / RAD_PER_DEG
        );
        assert!(error.abs() < RAD_PER_DEG && error.abs() < 1.96 * f64::from(ends[0].sd_heading));
        assert!(range_error.abs() < 1.96 * f64::from(ends[0].sd_cpa_range_m), "{ends:?}");
    }
}

#[test]
fn a_vessel_that_passes_over_the_array_is_one_track() {
    // 164 m above the array: its azimuth turns round within a second, its elevation says where it is all the way.
    for (seed, range_m) in [(5, 1.0), (6, 2.0), (7, 5.0), (8, 12.0), (9, 25.0)] {
        let mut config = config();
        config.height_m = 164.0;
        config.motion = passage::Config {
            speed_m_s: 7.3,
            speed_sd_m_s: 2.3,
            medium: crate::motion::Medium { height_m: 164.0, ..config.motion.medium },
            height_sd_m: 2.0,
            elevation_bias_sd_rad: RAD_PER_DEG,
            ..config.motion
        };
        let (mut state, mut out, mut seed) = (State::new(), Vec::new(), seed);
        for k in 0..200 {
            let t = 0.5 * f64::from(k);
            let aside = m::hypot(range_m, 7.0 * (t - 50.0));
            let elevation = m::atan(164.0 / aside);
            // What is known of the azimuth of a sound from above is less.
            let sd = 0.002 / (aside / m::hypot(aside, 164.0));
            let seen = elevation + 0.002 * gaussian(&mut seed);
            let azimuth = azimuth(t, 50.0, range_m, 1.0) + sd * gaussian(&mut seed);
            let heard = Bearing { elevation: seen as f32, ..message(t, azimuth, sd, 0) };
            bearing(&config, &mut state, &heard, &mut |m| out.push(m));
            wait(&config, &mut state, t, t + 0.5, &mut |m| out.push(m));
        }
        finish(&config, &mut state, &mut |m| out.push(m));
        let [last] = tracks(&out, 1)[..] else { panic!("{range_m}: {:?}", tracks(&out, 1)) };
        let off = wrap_pi(f64::from(last.heading) - (1.0 + 0.5 * m::PI));
        assert!(m::abs(off) < 3.0 * f64::from(last.sd_heading), "{range_m} {last:?}");
        assert!(
            m::abs(last.cpa_time_s - 50.0) < 3.0 * f64::from(last.sd_cpa_time_s) + 0.12,
            "{range_m} {last:?}"
        );
        assert!(
            (f64::from(last.cpa_range_m) - range_m).abs() < 2.0 * f64::from(last.sd_cpa_range_m),
            "{range_m} {last:?}"
        );
    }
}
