//! The command `Spectrum` against noise of known density.

use super::Memory;
use super::test_recorder::{BOTH, Which, noise};
use crate::block::{Block, Frame};
use crate::run::Application;
use crate::wire::{Command, EDGES, Message, Reply, Spectrum};
use std::boxed::Box;
use std::vec::Vec;

/// What a recorder answers that has heard these samples, channel c weaker by c factors of two.
fn answer(which: Which, instants: usize, channels: u8) -> (Vec<Spectrum>, Vec<Message>) {
    let mut memory = Box::<Memory<'_>>::default();
    let mut recorder = which.configure(&mut memory);
    let shifted = |frame: Frame| -> Frame { core::array::from_fn(|c| frame[c] >> c) };
    let frames: Vec<Frame> = noise(instants).into_iter().map(shifted).collect();
    for (n, frames) in frames.chunks(64).enumerate() {
        recorder.push(Block { first_index: 64 * n as u64, frames }, &mut |_| ());
    }
    let (mut spectra, mut others) = (Vec::new(), Vec::new());
    recorder.command(Command::SendSpectrum { token: 5, channels }, &mut |message| match message {
        Message::Spectrum(s) => spectra.push(*s),
        other => others.push(*other),
    });
    (spectra, others)
}

#[test]
fn levels_are_those_of_noise_of_a_known_density() {
    for which in BOTH {
        let rate = which.rate();
        let (seconds, used, least) = match which {
            Which::Array => (2, 4, 8),
            Which::Bottom => (120, 3, 6),
        };
        let (spectra, others) = answer(which, seconds * rate as usize, 0b1111);
        assert_eq!(others, [Message::Reply(Reply { token: 5, status: 0 })]);
        assert!(spectra.iter().map(|s| s.channel).eq(0..used), "{which:?} {spectra:?}");
        for s in &spectra {
            assert_eq!((s.token, s.of), (5, (1 << used) - 1), "{s:?}");
            assert!(s.frames >= least && s.frames < 20, "{s:?}");
            // A step of half a second, or six frames that overlap, and not later than the end.
            let age_s = (seconds as u64 * rate - s.index) as f64 / rate as f64;
            let span_s = if which == Which::Array { (0.25, 1.25) } else { (10.0, 110.0) };
            assert!(age_s > span_s.0 && age_s < span_s.1, "{which:?} {age_s}");
            // Uniform over 2^20 codes, and half that a channel on; one-sided.
            let variance = 4f64.powi(20 - i32::from(s.channel)) / 12.0;
            let expected = 10.0 * (variance / 4f64.powi(23) / (rate as f64 / 2.0)).log10();
            let (mut sum, mut bins) = (0.0, 0.0);
            for (level, edges) in s.tenth_db.iter().zip(EDGES.windows(2)) {
                if *level == Spectrum::NOTHING {
                    continue;
                }
                let (n, level) = (f64::from(edges[1] - edges[0]), f64::from(*level) / 10.0);
                let sd_db = 4.34 / (n * f64::from(s.frames)).sqrt();
                assert!((level - expected).abs() < 5.0 * sd_db + 0.05, "{which:?} {s:?} {level} {expected}");
                sum += n * 10f64.powf(level / 10.0);
                bins += n;
            }
            // An array's last one is the last whole one below seven eighths of half the rate.
            assert!(bins > if which == Which::Array { 190.0 } else { 230.0 }, "{s:?}");
            let mean = 10.0 * (sum / bins).log10();
            assert!((mean - expected).abs() < 0.4, "{which:?} channel {}: {mean} {expected}", s.channel);
            let bin_hz = rate as f32 / if which == Which::Array { 512.0 } else { 1024.0 };
            assert_eq!(s.bin_hz, bin_hz);
        }
    }
}

#[test]
fn what_was_not_analysed_has_no_spectrum() {
    for which in BOTH {
        let rate = which.rate() as usize;
        let refused = [Message::Reply(Reply { token: 5, status: 1 })];
        for (instants, channels) in [(0, 15), (300, 15), (120 * rate.min(1000), 0)] {
            let (spectra, others) = answer(which, instants, channels);
            assert!(spectra.is_empty() && others == refused, "{which:?} {instants} {others:?}");
        }
        let (one, _) = answer(which, 120 * rate.min(1000), 0b0010);
        assert!(one.iter().map(|s| (s.channel, s.of)).eq([(1, 2)]), "{one:?}");
    }
    let (vertical, others) = answer(Which::Bottom, 6000, 0b1000);
    assert!(vertical.is_empty() && others == [Message::Reply(Reply { token: 5, status: 1 })]);
}
