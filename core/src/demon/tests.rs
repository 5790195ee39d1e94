use super::*;
use crate::block::{Frame, MISSING};
use std::vec::Vec;

/// Reproducible noise: a 64-bit linear congruential generator, four uniform values summed (near enough to Gaussian).
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let mut sum = 0.0;
        for _ in 0..4 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum += (self.0 >> 40) as f64 / (1u64 << 24) as f64 - 0.5;
        }
        sum * 3f64.sqrt()
    }
}

/// `seconds` of noise at 16 kHz, its power swinging by `depth` at `rate_hz`.
fn recording(seconds: usize, rate_hz: f64, depth: f64, seed: u64) -> Vec<Frame> {
    let mut noise = Noise(seed);
    (0..16_000 * seconds)
        .map(|i| {
            let swing = 1.0 + depth * (2.0 * std::f64::consts::PI * rate_hz * i as f64 / 16_000.0).sin();
            [(1e4 * swing.sqrt() * noise.next()) as i32, 0, 0, 0]
        })
        .collect()
}

fn run(config: &Config, state: &mut State, first_index: u64, frames: &[Frame]) -> Vec<Report> {
    let mut reports = Vec::new();
    let mut scratch = EMPTY_SCRATCH;
    for (i, frames) in frames.chunks(777).enumerate() {
        let block = Block { first_index: first_index + 777 * i as u64, frames };
        process(config, state, &mut scratch, &block, &mut |r| reports.push(r));
    }
    reports
}

fn config() -> Config {
    Config::new(&Settings { rate_hz: 16_000.0, high_pass_hz: 1000.0, ..Settings::default() }).unwrap()
}

#[test]
fn a_modulated_noise_gives_its_rate_and_a_steady_one_none() {
    let config = config();
    let reports = run(&config, &mut State::new(), 0, &recording(32, 4.37, 0.2, 1));
    assert_eq!(reports[0].rate, Err(NoRate::NotEnoughData));
    let rate = reports.last().unwrap().rate.unwrap();
    assert!((rate.rate_hz - 4.37).abs() < 4.0 * rate.sd_hz && rate.sd_hz < 0.005, "{rate:?}");
    assert!(rate.confidence > 0.999);
    let reports = run(&config, &mut State::new(), 0, &recording(32, 4.37, 0.0, 2));
    assert_eq!(reports.last().unwrap().rate, Err(NoRate::Unmodulated));
}

#[test]
fn a_gap_is_left_out_and_a_long_one_starts_afresh() {
    let config = config();
    let frames = recording(40, 6.0, 0.3, 3);
    let (mut state, mut with_missing) = (State::new(), frames.clone());
    for frame in with_missing.iter_mut().skip(16_000 * 20).take(16_000 * 3) {
        frame[0] = MISSING;
    }
    let missing = run(&config, &mut State::new(), 0, &with_missing);
    // The same three seconds absent altogether.
    run(&config, &mut state, 0, &frames[..16_000 * 20]);
    let jumped = run(&config, &mut state, 16_000 * 23, &frames[16_000 * 23..]);
    let rate = jumped.last().unwrap().rate.unwrap();
    assert!((rate.rate_hz - 6.0).abs() < 0.01);
    assert!((rate.rate_hz - missing.last().unwrap().rate.unwrap().rate_hz).abs() < 1e-3);
    assert!(
        missing
            .iter()
            .map(|r| r.index)
            .eq(run(&config, &mut State::new(), 0, &frames).iter().map(|r| r.index))
    );
    let later = run(&config, &mut state, 1 << 40, &frames[..16_000 * 6]);
    assert_eq!(later[0].rate, Err(NoRate::NotEnoughData));
}

#[test]
fn a_louder_moment_or_a_dead_channel_is_no_rate() {
    let config = config();
    let mut frames = recording(32, 4.0, 0.0, 4);
    for frame in frames.iter_mut().skip(16_000 * 15).take(4000) {
        frame[0] *= 200;
    }
    let click = run(&config, &mut State::new(), 0, &frames);
    assert_eq!(click.last().unwrap().rate, Err(NoRate::Unmodulated));
    let dead = std::vec![[7; 4]; 16_000 * 32];
    assert_eq!(run(&config, &mut State::new(), 0, &dead).last().unwrap().rate, Err(NoRate::Unmodulated));
}

#[test]
fn settings_outside_their_range_are_named() {
    let bad = |s: Settings| Config::new(&s).unwrap_err().0;
    assert_eq!(bad(Settings { rate_hz: f64::NAN, ..Settings::default() }), "rate_hz");
    assert_eq!(bad(Settings { channels: 0, ..Settings::default() }), "channels");
    assert_eq!(bad(Settings { search_hz: (5.0, 40.0), ..Settings::default() }), "search_hz[1]");
}

#[test]
fn memory_stays_within_its_budget() {
    assert!(size_of::<State>() + size_of::<Scratch>() < 13 * 1024);
}
