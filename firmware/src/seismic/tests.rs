use super::*;
use std::vec::Vec;

/// Frames with their numbers, a block at a time; pairs, the last first.
struct Blocks(Vec<(u64, Vec<Frame>)>, Vec<Pair>);

impl SampleSource for Blocks {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        let Some((first_index, block)) = self.0.pop() else { return Chunk::End };
        frames[..block.len()].copy_from_slice(&block);
        Chunk::Frames { first_index, count: block.len() }
    }
    fn fault(&mut self) -> Option<(FaultCode, u64)> {
        self.0.is_empty().then_some((FaultCode::ConverterRestarted, 250))
    }
    fn pair(&mut self) -> Option<Pair> {
        self.1.pop()
    }
    fn age_us(&mut self, index: u64) -> Option<u64> {
        Some(4000 * (1000 - index))
    }
}

/// Blocks of 64 of a signal, without those that are left out.
fn blocks(signal: impl Fn(u64) -> Frame, count: u64, without: std::ops::Range<u64>) -> Blocks {
    let all: Vec<u64> = (0..count).filter(|n| !without.contains(n)).collect();
    let mut blocks = Vec::new();
    for run in all.chunk_by(|a, b| a + 1 == *b) {
        blocks.extend(run.chunks(64).map(|c| (c[0], c.iter().map(|n| signal(*n)).collect())));
    }
    blocks.reverse();
    Blocks(blocks, Vec::new())
}

/// A code that never stays the same.
fn busy(n: u64) -> i32 {
    (n as i32 * 7919) % 1000 * 128
}

/// Samples with their numbers, and faults.
type Heard = (Vec<(u64, Frame)>, Vec<(FaultCode, u64)>);

/// Everything that comes out, and the faults told.
fn drain(source: Blocks, conversion: Conversion) -> Heard {
    let mut seismic = Seismic::new(source, conversion);
    let (mut all, mut faults) = (Vec::new(), Vec::new());
    let mut frames = [[0; CHANNELS]; 64];
    while let Chunk::Frames { first_index, count } = seismic.read(&mut frames) {
        all.extend((first_index..).zip(frames[..count].iter().copied()));
        faults.extend(seismic.fault());
    }
    (all, faults)
}

const FIFTY: Conversion = Conversion { rate: Rate::Sps250, decimated: true };

#[test]
fn rates_are_made_of_what_the_chips_can() {
    for (hz, converted, factor) in
        [(50.0, 250, 5), (100.0, 500, 5), (200.0, 1000, 5), (250.0, 250, 1), (500.0, 500, 1)]
    {
        let conversion = Conversion::of(hz).unwrap();
        assert_eq!((conversion.rate.hz(), conversion.factor(), conversion.hz()), (converted, factor, hz));
    }
    assert_eq!((Conversion::of(64_000.0), Conversion::of(62.5)), (None, None));
}

#[test]
fn numbers_stay_those_of_the_conversions_through_a_gap() {
    let ramp = |n: u64| [(n as i32) << 7; CHANNELS];
    let (all, _) = drain(blocks(ramp, 4000, 1003..2711), FIFTY);
    assert!(all.iter().all(|(n, frame)| frame[0] as u64 == FACTOR * n + HALF));
    assert!(all.windows(2).all(|w| w[0].0 < w[1].0));
    // What a window of 121 cannot be filled for is given up: on both sides of the gap.
    let lost = 4000 / FACTOR - all.len() as u64;
    assert!((1708 / FACTOR + 24..1708 / FACTOR + 50).contains(&lost), "{lost}");
    // Those that were lost say which were.
    let at = all.windows(2).position(|w| w[1].0 > w[0].0 + 1).unwrap();
    let needed = FIFTY.needed(all[at].0 + 1, all[at + 1].0);
    let (again, _) = drain(blocks(ramp, 4000, needed), FIFTY);
    assert_eq!(all, again);
}

#[test]
fn a_chip_that_says_the_same_again_and_again_is_missing_and_told_until_it_speaks() {
    let signal = |n: u64| {
        let stuck = (1000..1500).contains(&n);
        [busy(n), busy(n + 1), if stuck { -1 } else { busy(n + 2) }, busy(n + 3)]
    };
    let (all, faults) = drain(blocks(signal, 3000, 0..0), FIFTY);
    let told: Vec<_> =
        faults.into_iter().filter(|(code, _)| *code != FaultCode::ConverterRestarted).collect();
    assert_eq!(told, [(FaultCode::DeadChannel, 2), (FaultCode::ChannelBack, 2)]);
    let missing: Vec<u64> =
        all.iter().filter(|(_, f)| f[2] == MISSING).map(|(n, _)| FACTOR * n + HALF).collect();
    // The codes before it was noticed are in no sample that was still to come.
    assert!(missing[0] <= 1010 && *missing.last().unwrap() >= 1555, "{missing:?}");
    assert!(all.iter().all(|(_, f)| f[0] != MISSING && f[1] != MISSING && f[3] != MISSING));
}

#[test]
fn a_conversion_that_was_damaged_is_no_dead_chip() {
    let signal = |n: u64| if (500..600).contains(&n) { [MISSING; CHANNELS] } else { [busy(n); CHANNELS] };
    let (_, faults) = drain(blocks(signal, 1000, 0..0), FIFTY);
    assert!(faults.iter().all(|(code, _)| *code == FaultCode::ConverterRestarted), "{faults:?}");
}

#[test]
fn delays_are_taken_out_of_the_time_and_restarts_are_told_in_the_recorders_samples() {
    let mut source = blocks(|n| [busy(n); CHANNELS], 64, 0..0);
    // Told to a tenth of a second: the nominal pace does.
    source.1 = [Pair { index: 60 + 5 * 1000 + 2, utc_us: 1_000_000_000, sd_s: 0.1 }].into();
    let mut seismic = Seismic::new(source, FIFTY);
    let mut frames = [[0; CHANNELS]; 64];
    assert_eq!(seismic.read(&mut frames), Chunk::End);
    assert_eq!(seismic.fault(), Some((FaultCode::ConverterRestarted, 50)));
    // Two conversions after the middle of sample 1000, and the chip's own 31: 33 of 4 ms.
    let pair = seismic.pair().unwrap();
    assert_eq!((pair.index, pair.utc_us), (1000, 1_000_000_000 - 132_000));
    let direct = Conversion { decimated: false, ..FIFTY };
    let pair = direct.pair(Pair { index: 77, utc_us: 0, sd_s: 1.0 }, 4000.0).unwrap();
    assert_eq!((pair.index, pair.utc_us), (77, -124_000));
}

#[test]
fn a_sample_was_heard_all_delays_before_the_newest_conversion() {
    let mut seismic = Seismic::new(blocks(|n| [busy(n); CHANNELS], 64, 0..0), FIFTY);
    // In the middle of its taps is conversion 160; 1000 are done, and the chip's own filter delays by 31.
    assert_eq!(seismic.age_us(20), Some(4000 * (1000 - 160 + 31)));
}

#[test]
fn delays_are_as_long_as_the_converter_takes_for_them_between_two_pulses() {
    // 100 parts in a million slow: 4000.4 us a conversion. The third second has stepped; a minute later
    // one conversion was counted too many.
    let pulse = |k: u64, utc_us: i64| Pair { index: 62 + 250 * k, utc_us, sd_s: 2e-6 };
    let mut source = blocks(|n| [busy(n); CHANNELS], 64, 0..0);
    let shifted = Pair { index: 62 + 250 * 60 + 1, utc_us: 61_006_000, sd_s: 2e-6 };
    source.1 = [shifted, pulse(3, 4_000_300), pulse(2, 3_000_200), pulse(1, 1_000_100), pulse(0, 0)].into();
    let mut seismic = Seismic::new(source, FIFTY);
    let told: Vec<_> = (0..5).map(|_| seismic.pair().map(|pair| (pair.index, pair.utc_us))).collect();
    let delay_us = (33.0f64 * 4000.4).round() as i64;
    assert_eq!(told, [None, Some((50, 1_000_100 - delay_us)), None, Some((150, 4_000_300 - delay_us)), None]);
}

/// What is told of the recorder's samples comes back as what was heard of the converter's.
#[test]
fn what_is_told_is_of_the_conversion_that_was_heard() {
    for made in [50.0, 100.0, 200.0, 250.0, 500.0].map(|hz| Conversion::of(hz).unwrap()) {
        let heard = Pair { index: made.middle(1234), utc_us: 1_790_000_000_000_000, sd_s: 1e-3 };
        let Pair { index, utc_us, .. } = made.pair(heard, made.period_us()).unwrap();
        let time = Time { index, utc_us, sd_s: 0.001, drift: 1e-6, sd_drift: 1e-7, correlation: 0.5 };
        let told = made.told(&time);
        assert_eq!((index, told.index, told.utc_us), (1234, heard.index, heard.utc_us), "{made:?}");
        assert_eq!((told.drift, told.sd_s), (time.drift, time.sd_s));
    }
}

#[test]
fn a_wrong_bit_makes_the_samples_missing_that_are_made_of_it() {
    let wave = |n: u64| (3e6 * (n as f64 * 0.07).sin()) as i32 + busy(n) / 64;
    let signal = |n: u64| [wave(n), wave(n + 1), wave(n + 2) ^ i32::from(n == 1500) << 27, wave(n + 3)];
    let (all, _) = drain(blocks(signal, 3000, 0..0), FIFTY);
    let missing: Vec<u64> =
        all.iter().filter(|(_, f)| f[2] == MISSING).map(|(n, _)| FACTOR * n + HALF).collect();
    assert!(missing.first().is_some_and(|n| (1440..1450).contains(n)), "{missing:?}");
    assert!(missing.last().is_some_and(|n| (1555..1561).contains(n)) && missing.len() == 24, "{missing:?}");
    assert!(all.iter().all(|(_, f)| f[0] != MISSING && f[1] != MISSING && f[3] != MISSING));
}
