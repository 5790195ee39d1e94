use super::*;
use std::vec::Vec;

const RATE_HZ: f64 = 64_000.0;
const HOP: u64 = 448;
const EACH: NonZeroU64 = NonZeroU64::new(HOP).unwrap();
/// Frames of so many seconds.
const fn frames(seconds: u64) -> u64 {
    seconds * 64_000 / HOP
}

/// Powers of frames of Gaussian noise: each the mean of 150 independent squares, as a band of 20 kHz gives, swinging
/// by `depth` at `rate_hz`.
fn recording(seconds: u64, rate_hz: f64, depth: f64, seed: u64) -> Vec<f32> {
    recording_at(RATE_HZ, frames(seconds), rate_hz, depth, seed)
}

fn recording_at(sampled_hz: f64, frames: u64, rate_hz: f64, depth: f64, seed: u64) -> Vec<f32> {
    let mut noise = seed;
    (0..frames)
        .map(|n| {
            let mut sum = 0.0;
            for _ in 0..12 {
                noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                sum += (noise >> 40) as f64 / (1u64 << 24) as f64 - 0.5;
            }
            let t = (n * HOP) as f64 / sampled_hz;
            let swing = 1.0 + depth * (2.0 * std::f64::consts::PI * rate_hz * t).sin();
            (1e8 * swing * (1.0 + sum * (2.0f64 / 150.0).sqrt())) as f32
        })
        .collect()
}

fn run(config: &Config, state: &mut State, first_frame: u64, powers: &[f32]) -> Vec<RateReport> {
    let mut scratch = EMPTY_SCRATCH;
    let numbered = (first_frame..).zip(powers);
    numbered.filter_map(|(n, power)| frame(config, state, &mut scratch, n * HOP, *power)).collect()
}

fn config() -> Config {
    Config::new(&Settings::default(), RATE_HZ, EACH).unwrap()
}

#[test]
fn a_modulated_noise_gives_its_rate_and_a_steady_one_none() {
    let config = config();
    let reports = run(&config, &mut State::new(), 0, &recording(32, 4.37, 0.1, 1));
    assert_eq!(reports[0].rate, Err(NoRate::NotEnoughData));
    let rate = reports.last().unwrap().rate.unwrap();
    assert!((rate.rate_hz - 4.37).abs() < 4.0 * rate.sd_hz && rate.sd_hz < 0.005, "{rate:?}");
    assert!(rate.confidence > 0.999);
    let reports = run(&config, &mut State::new(), 0, &recording(32, 4.37, 0.0, 2));
    assert_eq!(reports.last().unwrap().rate, Err(NoRate::Unmodulated));
}

/// The window lasts as long where frames come slower than the envelope's usual outputs.
#[test]
fn low_sampling_rates_give_a_rate_as_soon() {
    for (sampled_hz, update_s) in
        [(64_000.0, 5.0), (48_000.0, 5.0), (32_000.0, 5.0), (16_000.0, 10.0), (8000.0, 10.0)]
    {
        let settings = Settings { update_s, ..Settings::default() };
        let config = Config::new(&settings, sampled_hz, EACH).unwrap();
        assert!((0.025..0.045).contains(&config.bin_hz()), "{sampled_hz}: {}", config.bin_hz());
        let powers = recording_at(sampled_hz, (36.0 * sampled_hz) as u64 / HOP, 5.0, 0.2, 6);
        let mut state = State::new();
        let reports = run(&config, &mut state, 0, &powers);
        let rate = reports.last().unwrap().rate.unwrap();
        assert!((rate.rate_hz - 5.0).abs() < 0.01, "{sampled_hz}: {rate:?}");
        // A steady noise after it: nothing of the old window is left in the ring.
        let steady = recording_at(sampled_hz, powers.len() as u64, 5.0, 0.0, 7);
        let reports = run(&config, &mut state, powers.len() as u64, &steady);
        assert_eq!(reports.last().unwrap().rate, Err(NoRate::Unmodulated), "{sampled_hz}");
    }
}

#[test]
fn a_gap_is_left_out_and_of_a_long_one_nothing_is_left() {
    let config = config();
    let powers = recording(40, 6.0, 0.2, 3);
    let mut state = State::new();
    run(&config, &mut state, 0, &powers[..frames(20) as usize]);
    let jumped = run(&config, &mut state, frames(23), &powers[frames(23) as usize..]);
    let rate = jumped.last().unwrap().rate.unwrap();
    assert!((rate.rate_hz - 6.0).abs() < 0.01, "{rate:?}");
    let later = run(&config, &mut state, 1 << 40, &powers[..frames(6) as usize]);
    assert_eq!(later[0].rate, Err(NoRate::NotEnoughData));
}

#[test]
fn a_louder_moment_clicks_or_silence_are_no_rate_and_hide_none() {
    let config = config();
    let mut powers = recording(32, 4.0, 0.0, 4);
    for power in powers.iter_mut().skip(frames(15) as usize).take(36) {
        *power *= 4e4;
    }
    let loud = run(&config, &mut State::new(), 0, &powers);
    assert_eq!(loud.last().unwrap().rate, Err(NoRate::Unmodulated));
    let silent = std::vec![0.0; frames(32) as usize];
    assert_eq!(run(&config, &mut State::new(), 0, &silent).last().unwrap().rate, Err(NoRate::Unmodulated));
    // Five clicks a second, each 13 dB over its frame's noise.
    let mut clicks = recording(32, 4.0, 0.2, 5);
    let mut noise = 9u64;
    for power in &mut clicks {
        noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        if noise >> 32 < (1 << 32) / 28 {
            *power *= 20.0;
        }
    }
    let rate = run(&config, &mut State::new(), 0, &clicks).last().unwrap().rate.unwrap();
    assert!((rate.rate_hz - 4.0).abs() < 0.02, "{rate:?}");
}

#[test]
fn settings_outside_their_range_are_named() {
    let bad = |s: Settings, rate_hz| Config::new(&s, rate_hz, EACH).unwrap_err().0;
    assert_eq!(bad(Settings::default(), f64::NAN), "rate_hz");
    assert_eq!(bad(Settings { high_pass_hz: 0.0, ..Settings::default() }, RATE_HZ), "high_pass_hz");
    assert_eq!(bad(Settings { search_hz: (5.0, 40.0), ..Settings::default() }, RATE_HZ), "search_hz[1]");
}

#[test]
fn memory_stays_within_its_budget() {
    assert!(size_of::<State>() + size_of::<Scratch>() < 13 * 1024);
}
