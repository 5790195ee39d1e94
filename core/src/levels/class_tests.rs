//! Decidecades against class 1 of IEC 61260-1: tones across the edges of bands in every stage and where stages meet.

use super::bands::{class_1_db, decidecade_hz};
use super::tests::{decidecade_db, reports};
use super::*;
use std::vec::Vec;

#[test]
fn decidecades_are_filters_of_class_1() {
    let rate = 8000.0;
    let plan = Plan::new(rate, 1 << 23, 21.0).unwrap();
    let all = plan.decidecades();
    let amplitude = 4e6;
    let tone_db = 20.0 * (amplitude / 8_388_608.0_f64).log10() - 3.0103;
    // Where a mask turns, and between; also far away.
    let ratios =
        [0.1855, 0.2, 0.3275, 0.45, 0.5314, 0.65, 0.7726, 0.85, 0.892, 0.9196, 0.9472, 0.974, 1.0, 1.0267];
    let ratios: Vec<f64> =
        ratios.into_iter().chain([1.0557, 1.0874, 1.121, 1.18, 1.2944, 1.5, 1.8817, 3.0537]).collect();
    // The lowest of the last stage, those at which the stages meet, and the highest.
    for number in [all.start, 16, 17, 25, 26, all.end - 1] {
        let middle = decidecade_hz(number);
        let tones: Vec<f64> = ratios.iter().map(|r| r * middle).filter(|f| *f < 0.499 * rate).collect();
        for four in tones.chunks(4) {
            let f = |c: usize| four[c.min(four.len() - 1)];
            let wave = |n: u64| -> [i32; 4] {
                core::array::from_fn(|c| {
                    (amplitude * (std::f64::consts::TAU * (f(c) * n as f64 / rate).fract() + 0.3).sin())
                        .round() as i32
                })
            };
            let report = &reports(&plan, 168_000, wave)[0];
            for (c, tone) in four.iter().enumerate() {
                let attenuation = tone_db - decidecade_db(&plan, report, number, c);
                let (least, greatest) = class_1_db(tone / middle);
                assert!(
                    (least..=greatest).contains(&attenuation),
                    "decidecade {number} at {} of its middle: {attenuation:.2} dB, {least:.2} to {greatest:.2}",
                    tone / middle
                );
            }
        }
    }
}
