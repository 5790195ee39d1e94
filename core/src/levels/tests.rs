//! Tones and noise of known level, breaks, and what must not change anything.

use super::bands::{decidecade_hz, edge_hz, of_decidecade};
use super::*;
use crate::block::{Block, Frame, MISSING};
use proptest::prelude::*;
use std::boxed::Box;
use std::vec::Vec;

/// Reports of `n` instants of a recording.
pub(super) fn reports(plan: &Plan, n: u64, wave: impl Fn(u64) -> Frame) -> Vec<Report> {
    let frames: Vec<Frame> = (0..n).map(wave).collect();
    of_blocks(plan, &[Block { first_index: 0, frames: &frames }])
}

fn of_blocks(plan: &Plan, blocks: &[Block<'_>]) -> Vec<Report> {
    let (mut state, mut scratch) = (Box::new(State::new()), Box::new(Scratch::new()));
    let mut out = Vec::new();
    let mut sink = |report: &Report, _: &[Row]| out.push(report.clone());
    for block in blocks {
        push(plan, &mut state, &mut scratch, &mut [], *block, &mut sink);
    }
    finish(plan, &mut state, &mut scratch, &mut [], &mut sink);
    out
}

fn db(power: f64) -> f64 {
    10.0 * power.log10()
}

/// Level of a decidecade, dB re full scale squared.
pub(super) fn decidecade_db(plan: &Plan, report: &Report, number: i32, channel: usize) -> f64 {
    let cells = of_decidecade(number).map(|cell| report.mean_square[plan.place(cell).unwrap()][channel]);
    db(cells.map(f64::from).sum())
}

fn broadband(plan: &Plan, report: &Report, channel: usize) -> f64 {
    report.mean_square[..plan.cells().len()].iter().map(|cell| f64::from(cell[channel])).sum()
}

/// Noise of about Gaussian distribution and standard deviation 1, the same each time.
fn noise() -> impl FnMut() -> f64 {
    let mut state = 0x853c_49e6_748f_ea9bu64;
    move || {
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / 2f64.powi(31) - 0.5
        };
        (0..6).map(|_| uniform()).sum::<f64>() * 2f64.sqrt()
    }
}

const FULL_SCALE: f64 = 8_388_608.0;

#[test]
fn tones_and_noise_of_known_level_are_measured_within_a_tenth_of_a_decibel_at_all_rates() {
    for (rate, seconds) in
        [(50.0, 900.0), (100.0, 600.0), (8000.0, 40.0), (16_000.0, 30.0), (64_000.0, 20.0), (96_000.0, 20.0)]
    {
        let plan = Plan::new(rate, 1 << 23, seconds).unwrap();
        let number = (10.0 * (rate / 9.0_f64).log10()).round() as i32;
        let tone_hz = decidecade_hz(number);
        let mut random = noise();
        let n = (rate * seconds) as u64;
        let mut square = 0.0;
        let frames: Vec<Frame> = (0..n)
            .map(|n| {
                let white = 1e5 * random();
                square += white.round().powi(2);
                let tone = 3e5 * (std::f64::consts::TAU * tone_hz * n as f64 / rate).sin();
                // An offset, as converters have, is no sound.
                [
                    tone.round() as i32,
                    white.round() as i32,
                    (2.0 * tone).round() as i32,
                    white.round() as i32 + 500_000,
                ]
            })
            .collect();
        let report = &of_blocks(&plan, &[Block { first_index: 0, frames: &frames }])[0];
        let tone_db = db(0.5 * (3e5 / FULL_SCALE).powi(2));
        for (channel, more_db) in [(0, 0.0), (2, 6.0206)] {
            let level = decidecade_db(&plan, report, number, channel);
            assert!((level - tone_db - more_db).abs() < 0.1, "{rate} Hz: tone {level} dB, {tone_db}");
            let all = db(broadband(&plan, report, channel));
            assert!((all - tone_db - more_db).abs() < 0.1, "{rate} Hz: tone, broadband {all} dB, {tone_db}");
        }
        // White noise has the same in every hertz.
        let density = square / n as f64 / FULL_SCALE.powi(2) / (rate / 2.0);
        let cells = plan.cells();
        let whole = edge_hz(cells.start)..edge_hz(cells.end);
        for channel in [1, 3] {
            let all = db(broadband(&plan, report, channel) / (density * (whole.end - whole.start)));
            assert!(all.abs() < 0.1, "{rate} Hz: noise, broadband off by {all} dB");
            for number in plan.decidecades() {
                let band = edge_hz(of_decidecade(number).start)..edge_hz(of_decidecade(number).end);
                let off =
                    decidecade_db(&plan, report, number, channel) - db(density * (band.end - band.start));
                let sd_db = plan.sd_db(band, &report.transforms[channel]);
                assert!(
                    off.abs() < 0.02 + 4.0 * sd_db,
                    "{rate} Hz: decidecade {number} off by {off} dB, {sd_db}"
                );
            }
        }
        assert!(report.used.iter().all(|used| *used > 0.9), "{rate} Hz: {:?}", report.used);
    }
}

#[test]
fn a_tone_anywhere_is_in_the_sum_of_the_cells_once() {
    let plan = Plan::new(8000.0, 1 << 23, 21.0).unwrap();
    let from_hz = edge_hz(plan.cells().start);
    let tones: Vec<f64> = (0..64).map(|k| 1.3 * from_hz * 1.13f64.powi(k)).filter(|f| *f < 3500.0).collect();
    for four in tones.chunks(4) {
        let wave = |n: u64| -> Frame {
            core::array::from_fn(|c| {
                let f = four[c.min(four.len() - 1)];
                (1e6 * (std::f64::consts::TAU * (f * n as f64 / 8000.0).fract()).sin()).round() as i32
            })
        };
        let report = &reports(&plan, 168_000, wave)[0];
        for (c, tone) in four.iter().enumerate() {
            let off = db(broadband(&plan, report, c) / (0.5 * (1e6 / FULL_SCALE).powi(2)));
            assert!(off.abs() < 0.1, "{tone} Hz: {off} dB");
        }
    }
}

#[test]
fn what_is_missing_or_clipped_is_left_out_and_told() {
    let plan = Plan::new(8000.0, 1 << 23, 30.0).unwrap();
    let mut random = noise();
    let mut frames: Vec<Frame> = (0..480_000).map(|_| [(1e5 * random()) as i32; 4]).collect();
    for (n, frame) in frames.iter_mut().enumerate().take(240_000) {
        if (60_000..120_000).contains(&n) {
            frame[1] = MISSING;
        }
        if n > 180_000 && n.is_multiple_of(100) {
            frame[2] = (1 << 23) - 1;
        }
        frame[3] = MISSING;
    }
    let reports = of_blocks(&plan, &[Block { first_index: 0, frames: &frames }]);
    let [first, second] = &reports[..] else { panic!("{}", reports.len()) };
    let near = |a: f32, b: f32| (a - b).abs() < 0.02;
    assert!(near(first.used[0], 1.0) && near(first.used[1], 0.75) && near(first.used[2], 0.75));
    assert_eq!((first.good[1], first.clipped[1]), (180_000, 0));
    assert_eq!((first.good[2], first.clipped[2]), (239_401, 599));
    assert_eq!((first.good[3], first.used[3]), (0, 0.0));
    let all = broadband(&plan, first, 0);
    for c in [1, 2] {
        let off = db(broadband(&plan, first, c) / all);
        assert!(off.abs() < 0.1, "{c}: {off}");
    }
    assert!(broadband(&plan, first, 3).is_nan());
    assert!(near(second.used[3], 1.0) && broadband(&plan, second, 3) > 0.0);
}

#[test]
fn a_gap_in_time_is_no_silence_and_repeats_count_once() {
    let plan = Plan::new(8000.0, 1 << 23, 30.0).unwrap();
    let mut random = noise();
    let frames: Vec<Frame> = (0..240_000).map(|_| [(1e5 * random()) as i32; 4]).collect();
    let block = |from: usize, to: usize| Block { first_index: from as u64, frames: &frames[from..to] };
    let whole = of_blocks(&plan, &[block(0, 240_000)]);
    let gap = of_blocks(&plan, &[block(0, 80_000), block(120_000, 240_000)]);
    let off = db(broadband(&plan, &gap[0], 0) / broadband(&plan, &whole[0], 0));
    assert!(off.abs() < 0.1, "{off} dB");
    assert!((gap[0].used[0] - 0.83).abs() < 0.02 && gap[0].good[0] == 200_000, "{:?}", gap[0].used);
    let twice = of_blocks(&plan, &[block(0, 100_000), block(90_000, 200_000), block(200_000, 240_000)]);
    assert_eq!(twice[0].mean_square[0], whole[0].mean_square[0]);
    // An interval without a sample has no report.
    let far = Block { first_index: 1_000_000, frames: &frames };
    let reports = of_blocks(&plan, &[block(0, 80_000), far]);
    let begins: Vec<u64> = reports.iter().map(|r| r.first_index).collect();
    assert_eq!(begins, [0, 960_000, 1_200_000]);
    assert_eq!((reports[0].instants, reports[2].instants), (80_000, 40_000));
    // Time that starts again: what was is told first.
    let again = Block { first_index: 0, frames: &frames };
    let begins: Vec<u64> = of_blocks(&plan, &[far, again]).iter().map(|r| r.first_index).collect();
    assert_eq!(begins, [960_000, 1_200_000, 0]);
}

#[test]
fn percentiles_are_those_of_the_seconds() {
    let plan = Plan::new(8000.0, 1 << 23, 40.0).unwrap();
    let mut random = noise();
    // Ten seconds 20 dB louder.
    let frames: Vec<Frame> =
        (0..320_000).map(|n| [(if n < 80_000 { 1e6 } else { 1e5 } * random()) as i32; 4]).collect();
    let mut counts = std::vec![EMPTY_ROW; ROWS];
    let (mut state, mut scratch) = (Box::new(State::new()), Box::new(Scratch::new()));
    let mut seen = 0;
    let block = Block { first_index: 0, frames: &frames };
    push(&plan, &mut state, &mut scratch, &mut counts, block, &mut |report, counts| {
        let place = plan.place(of_decidecade(32).start).unwrap();
        let quiet = db((1e5 / FULL_SCALE).powi(2) * 0.2308 * decidecade_hz(32) / 4000.0);
        let at = percentiles_db(counts, row_of_decidecade(place), 1).map(|level| f64::from(level.unwrap()));
        let [_, middle, high] = at;
        assert!((middle - quiet).abs() < 0.7 && (high - quiet - 20.0).abs() < 1.0, "{at:?}");
        let mean = decidecade_db(&plan, report, 32, 1);
        assert!((mean - quiet - db(0.25 * 100.0 + 0.75)).abs() < 0.3, "{mean}");
        seen += 1;
    });
    assert_eq!(seen, 1);
}

#[test]
fn plans_are_refused_where_there_is_no_time_for_two_windows() {
    assert!(matches!(Plan::new(50.0, 1 << 23, 10.0), Err(PlanError::Interval(..))));
    assert!(matches!(Plan::new(f64::NAN, 1 << 23, 10.0), Err(PlanError::Rate(_))));
    assert!(Plan::new(50.0, 1 << 23, 60.0).is_ok() && Plan::new(64_000.0, 1 << 23, 1.0).is_ok());
    for rate in [20.0, 50.0, 4000.0, 64_000.0, 200_000.0, 999_999.0] {
        let plan = Plan::new(rate, 1 << 23, 3600.0).unwrap();
        assert!(edge_hz(plan.cells().end) <= 0.5 * rate * 1.000_001 && plan.cells().len() < CELLS);
    }
}

proptest! {
    #![proptest_config(seabearing_testkit::property(12))]
    #[test]
    fn twice_the_pressure_is_six_decibels_more_however_the_samples_come(
        seed in 1u32..1_000_000,
        cuts in proptest::collection::vec(1usize..900, 1..30),
    ) {
        let plan = Plan::new(100.0, 1 << 23, 60.0).unwrap();
        let mut state = seed;
        let frames: Vec<Frame> = (0..7000).map(|_| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let x = (state >> 12) as i32 - (1 << 19);
            [x, 2 * x, -x, x / 2]
        }).collect();
        let whole = of_blocks(&plan, &[Block { first_index: 0, frames: &frames }]);
        let mut blocks = Vec::new();
        let (mut at, mut cuts) = (0, cuts.iter().cycle());
        while at < frames.len() {
            let to = (at + cuts.next().unwrap()).min(frames.len());
            blocks.push(Block { first_index: at as u64, frames: &frames[at..to] });
            at = to;
        }
        let cut = of_blocks(&plan, &blocks);
        prop_assert_eq!(whole.len(), 2);
        for (a, b) in whole.iter().zip(&cut) {
            prop_assert_eq!(std::format!("{a:?}"), std::format!("{b:?}"));
        }
        for number in plan.decidecades() {
            let level = |c| decidecade_db(&plan, &whole[0], number, c);
            prop_assert!((level(1) - level(0) - 6.0206).abs() < 0.001);
            prop_assert!((level(2) - level(0)).abs() < 0.001);
        }
    }
}
