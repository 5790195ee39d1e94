//! Levels sent unasked, against sounds of known level, and over what happens to recordings.

use super::Memory;
use super::test_recorder::{BOTH, Which, noise};
use crate::block::{Block, Frame};
use crate::config::Levels;
use crate::run::Application;
use crate::wire::{BANDS, EDGES, Message, Spectrum};
use std::boxed::Box;
use std::vec::Vec;

impl Which {
    /// Seconds of an interval: some hundred frames.
    fn every_s(self) -> u16 {
        if self == Self::Array { 20 } else { 1800 }
    }

    /// Instants of an interval.
    fn interval(self) -> u64 {
        u64::from(self.every_s()) * self.rate()
    }

    /// Frames that fit into an interval.
    fn frames(self) -> u64 {
        self.interval() / if self == Self::Array { 448 } else { 512 }
    }

    /// Uniform noise over so many intervals, of this variance in full scales squared.
    fn noise(self, intervals: usize) -> (Vec<Frame>, f64) {
        let variance = 4f64.powi(20) / 12.0 / 4f64.powi(23);
        (noise(intervals * self.interval() as usize), variance)
    }
}

/// The spectra of itself that a recorder sends of a channel, fed run by run in blocks of so many.
fn sent_in(which: Which, channel: u8, runs: &[(u64, &[Frame])], cut: usize) -> Vec<Spectrum> {
    let mut memory = Box::<Memory<'_>>::default();
    let (mut config, table) = which.config();
    config.levels = Levels { every_s: which.every_s(), channel };
    let mut recorder = memory.configure(&config, table).unwrap();
    let mut spectra = Vec::new();
    let mut sink = |message: &Message| {
        if let Message::Spectrum(s) = message {
            spectra.push(*s);
        }
    };
    for (first, frames) in runs {
        for (k, frames) in frames.chunks(cut).enumerate() {
            recorder.push(Block { first_index: first + (k * cut) as u64, frames }, &mut sink);
        }
    }
    recorder.finish(&mut sink);
    spectra
}

/// The same, however the runs are cut.
fn sent(which: Which, channel: u8, runs: &[(u64, &[Frame])]) -> Vec<Spectrum> {
    let spectra = sent_in(which, channel, runs, 64);
    assert_eq!(spectra, sent_in(which, channel, runs, 1111), "{which:?}: blocks matter");
    for s in &spectra {
        assert_eq!((s.token, s.channel, s.of), (Spectrum::UNASKED, channel, 0));
        assert!(s.is_unasked());
    }
    spectra
}

/// Level of band, dB, and how many bins it has, of those that were measured.
fn levels(s: &Spectrum) -> impl Iterator<Item = (f64, f64)> {
    let bins = EDGES.windows(2).map(|w| f64::from(w[1] - w[0]));
    let both = s.tenth_db.into_iter().zip(bins);
    both.filter(|(l, _)| *l != Spectrum::NOTHING).map(|(l, n)| (f64::from(l) / 10.0, n))
}

/// Level of the densities' mean, dB re full scale squared in a hertz.
fn mean_db(s: &Spectrum) -> f64 {
    let all = levels(s).fold((0.0, 0.0), |(sum, bins), (l, n)| (sum + n * 10f64.powf(l / 10.0), bins + n));
    10.0 * (all.0 / all.1).log10()
}

fn density_db(which: Which, variance: f64) -> f64 {
    10.0 * (variance / (which.rate() as f64 / 2.0)).log10()
}

#[test]
fn noise_has_its_level_in_every_band_and_every_interval() {
    for which in BOTH {
        let (frames, variance) = which.noise(3);
        let expected = density_db(which, variance);
        let spectra = sent(which, 0, &[(0, &frames)]);
        assert_eq!(spectra.len(), 3, "{which:?}");
        for (n, s) in (0..).zip(&spectra) {
            assert_eq!(s.index / which.interval(), n);
            let of_middle = (s.index % which.interval()) as f64 / which.interval() as f64;
            assert!((of_middle - 0.5).abs() < 0.05, "{of_middle}");
            assert!(
                which.frames().abs_diff(u64::from(s.frames)) <= 4,
                "{which:?} {} {}",
                s.frames,
                which.frames()
            );
            assert!(levels(s).count() >= 19, "{s:?}");
            // Frames overlap by half under a Hann window: 0.95 independent ones each.
            for (level, bins) in levels(s) {
                let sd_db = 4.34 / (0.94 * bins * f64::from(s.frames)).sqrt();
                assert!((level - expected).abs() < 4.5 * sd_db + 0.05, "{which:?} {bins} {level} {expected}");
                assert!(
                    sd_db > 0.04 || (level - expected).abs() < 0.2,
                    "{which:?} {bins} {level} {expected}"
                );
            }
            assert!((mean_db(s) - expected).abs() < 0.1, "{which:?} {} {expected}", mean_db(s));
        }
    }
}

#[test]
fn a_tone_has_its_power_in_its_band() {
    for which in BOTH {
        // At a bin's centre, within a band of sixteen bins, and nearly full scale.
        let bin = 70.0 / if which == Which::Array { 512.0 } else { 1024.0 };
        let amplitude = 8e6;
        let tone = |n: u64| (amplitude * (core::f64::consts::TAU * bin * n as f64).sin()).round() as i32;
        let frames: Vec<Frame> = noise(which.interval() as usize)
            .iter()
            .zip(0..)
            .map(|(f, n)| [tone(n), f[1], f[2], f[3]])
            .collect();
        let spectra = sent(which, 0, &[(0, &frames)]);
        let [s] = spectra[..] else { panic!("{which:?} {spectra:?}") };
        let band = EDGES.iter().position(|e| *e == 62).unwrap();
        let width = f64::from(EDGES[band + 1] - EDGES[band]) * f64::from(s.bin_hz);
        let level = f64::from(s.tenth_db[band]) / 10.0 + 10.0 * width.log10();
        let expected = 10.0 * (0.5 * amplitude * amplitude / 4f64.powi(23)).log10();
        assert!((level - expected).abs() < 0.1, "{which:?} {level} {expected}");
        let others = s.tenth_db.iter().enumerate().filter(|(b, _)| b.abs_diff(band) > 1);
        assert!(others.into_iter().all(|(_, l)| f64::from(*l) / 10.0 < expected - 60.0), "{s:?}");
    }
}

#[test]
fn what_is_averaged_is_power_over_the_whole_interval() {
    for which in BOTH {
        let (mut frames, variance) = which.noise(1);
        // 12 dB louder for a quarter of the time.
        let from = 3 * frames.len() / 4;
        frames[from..].iter_mut().for_each(|f| *f = f.map(|x| 4 * x));
        let spectra = sent(which, which.of(1), &[(0, &frames)]);
        let expected = density_db(which, variance * (0.75 + 0.25 * 16.0));
        assert_eq!(spectra.len(), 1);
        assert!(
            (mean_db(&spectra[0]) - expected).abs() < 0.2,
            "{which:?} {} {expected}",
            mean_db(&spectra[0])
        );
    }
}

impl Which {
    /// A channel other than pressure only where there are several to choose from.
    fn of(self, channel: u8) -> u8 {
        if self == Self::Array { channel } else { 0 }
    }
}

#[test]
fn over_gaps_and_restarts_each_interval_with_samples_is_told_once() {
    for which in BOTH {
        let (frames, _) = which.noise(4);
        let length = which.interval();
        let (half, third) = (length as usize / 2, length as usize / 3);
        // Half of an interval is missing, then two whole ones; the index begins again, and again later.
        let runs: [(u64, &[Frame]); 5] = [
            (7 * length, &frames[..half]),
            (8 * length, &frames[..length as usize]),
            (11 * length + 5, &frames[..3 * half]),
            (0, &frames[..third]),
            (2 * length, &frames[..third]),
        ];
        let spectra = sent(which, which.of(3), &runs);
        let intervals: Vec<u64> = spectra.iter().map(|s| s.index / length).collect();
        assert_eq!(intervals, [7, 8, 11, 12, 0, 2], "{which:?}");
        let share = |s: &Spectrum| f64::from(s.frames) / which.frames() as f64;
        for (s, expected) in spectra.iter().zip([0.5, 1.0, 1.0, 0.5, 0.33, 0.33]) {
            assert!((share(s) - expected).abs() < 0.03, "{which:?} {} {expected}", share(s));
        }
    }
}

#[test]
fn a_dead_or_clipped_channel_is_told_as_nothing_and_not_as_a_level() {
    for which in BOTH {
        let (frames, variance) = which.noise(4);
        let middle = which.interval()..3 * which.interval();
        for wrong in [|_: i32| 1234, |x: i32| if x > 0 { (1 << 23) - 1 } else { x }] {
            let of = |(n, f): (u64, &Frame)| {
                if middle.contains(&n) { [wrong(f[0]), f[1], f[2], f[3]] } else { *f }
            };
            let changed: Vec<Frame> = (0..).zip(&frames).map(of).collect();
            let spectra = sent(which, 0, &[(0, &changed)]);
            let [before, first, second, after] = spectra[..] else { panic!("{which:?} {spectra:?}") };
            for s in [before, after] {
                assert!((mean_db(&s) - density_db(which, variance)).abs() < 0.2, "{which:?} {s:?}");
            }
            // The frame across the beginning may be of use still.
            assert!(first.frames <= 1, "{which:?} {first:?}");
            assert_eq!((second.frames, second.tenth_db), (0, [Spectrum::NOTHING; BANDS]), "{which:?}");
            assert_eq!(second.index, which.interval() * 5 / 2);
        }
        // What another hydrophone hears is told.
        if which == Which::Array {
            let dead: Vec<Frame> = frames.iter().map(|f| [1234, f[1], f[2], f[3]]).collect();
            let spectra = sent(which, 1, &[(0, &dead)]);
            assert!(spectra.iter().skip(1).all(|s| (mean_db(s) - density_db(which, variance)).abs() < 0.1));
        }
    }
}

#[test]
fn nothing_is_sent_unasked_unless_a_configuration_says_so() {
    for which in BOTH {
        let mut memory = Box::<Memory<'_>>::default();
        let mut recorder = which.configure(&mut memory);
        let (frames, _) = which.noise(2);
        let mut sink = |m: &Message| assert!(!matches!(m, Message::Spectrum(_)), "{m:?}");
        recorder.push(Block { first_index: 0, frames: &frames }, &mut sink);
        recorder.finish(&mut sink);
    }
}
