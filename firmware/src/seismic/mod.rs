//! An ocean-bottom recorder's samples: four seismic converters ([`chips`]), looked at and brought to the recorder's rate
//! ([`decimate`]). The host runs the same over the words that the chips gave.
//!
//! A chip whose code does not change ([`STILL`] times the same: its noise alone is a thousand steps) gives nothing any more:
//! it is told as `DeadChannel` and its samples are missing until the code changes (`ChannelBack`). A code that leaps out and back is
//! missing where the recorder's samples are made of several ([`leaps`]).

pub mod chips;
pub mod decimate;
pub mod leaps;

use chips::{DELAY, Rate};
use decimate::{Decimator, FACTOR, HALF};
use leaps::Leaps;
use seabearing_core::block::{CHANNELS, Frame, MISSING};
use seabearing_core::port::{Chunk, SampleSource};
use seabearing_core::utc::Pair;
use seabearing_core::wire::{FaultCode, Time};

/// So many times the same code is no sound.
pub const STILL: u32 = 8;
/// Samples of the converter's that are taken at a time.
const TAKEN: usize = 64;

/// How a station's rate is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conversion {
    /// Conversions of each chip.
    pub rate: Rate,
    /// Whether only every fifth leaves the filter.
    pub decimated: bool,
}

impl Conversion {
    /// For the rate a station asks for: 50, 100 or 200 Hz by decimation, 250 or 500 Hz as the chips give them.
    pub fn of(rate_hz: f64) -> Option<Self> {
        let all = [Rate::Sps250, Rate::Sps500, Rate::Sps1000].map(|rate| Self { rate, decimated: true });
        let direct = [Rate::Sps250, Rate::Sps500].map(|rate| Self { rate, decimated: false });
        all.into_iter().chain(direct).find(|made| made.hz() == rate_hz)
    }

    /// Samples of the converter's for one of the recorder's.
    pub fn factor(self) -> u64 {
        if self.decimated { FACTOR } else { 1 }
    }

    /// The recorder's samples a second.
    pub fn hz(self) -> f64 {
        f64::from(self.rate.hz()) / self.factor() as f64
    }

    /// The converter's sample that is the recorder's of this number.
    pub fn middle(self, number: u64) -> u64 {
        self.first() + number * self.factor()
    }

    /// The converter's samples without which the recorder's from `from` up to `to` cannot be made, and no others.
    pub fn needed(self, from: u64, to: u64) -> core::ops::Range<u64> {
        match self.decimated {
            true => FACTOR * from + 2 * HALF + 1 - FACTOR..FACTOR * to,
            false => from..to,
        }
    }

    /// The converter's sample after the last that is needed for the recorder's before this one.
    pub fn until(self, number: u64) -> u64 {
        match number.checked_sub(1) {
            Some(last) => self.middle(last) + self.first() + 1,
            None => 0,
        }
    }

    /// The converter's sample that is the recorder's first.
    fn first(self) -> u64 {
        if self.decimated { HALF } else { 0 }
    }

    /// What is told of the recorder's samples, told of the converter's.
    pub fn told(self, time: &Time) -> Time {
        let delay_us = (DELAY as f64 * self.period_us() + 0.5) as i64;
        Time { index: self.middle(time.index), utc_us: time.utc_us + delay_us, ..*time }
    }

    /// Microseconds of a conversion, nominally.
    fn period_us(self) -> f64 {
        1e6 / f64::from(self.rate.hz())
    }

    /// What the recorder's sample is that was heard when the converter ended a conversion, from that conversion's pair: all
    /// delays are taken out, which are so many conversions of `period_us` each.
    fn pair(self, converted: Pair, period_us: f64) -> Option<Pair> {
        let since = converted.index.checked_sub(self.first())?;
        let late = DELAY + since % self.factor();
        let late_us = (late as f64 * period_us + 0.5) as i64;
        Some(Pair { index: since / self.factor(), utc_us: converted.utc_us - late_us, ..converted })
    }
}

/// One channel's newest code, and how often it came in a row.
#[derive(Clone, Copy, Debug, Default)]
struct Still {
    code: i32,
    times: u32,
    told: bool,
}

/// A source of samples of [`chips::parse`] at the converter's rate, as one at the recorder's.
#[derive(Debug)]
pub struct Seismic<S> {
    source: S,
    conversion: Conversion,
    decimator: Decimator,
    still: [Still; CHANNELS],
    leaps: [Leaps; CHANNELS],
    /// The converter's sample after the newest.
    next: u64,
    fault: Option<(FaultCode, u64)>,
    /// The newest pair that was precise, of the converter's.
    precise: Option<Pair>,
}

/// A pair so sure measures the converter's pace, s.
const PRECISE_S: f64 = 1e-4;
/// The pace is the nominal one within this.
const PACE_WITHIN: f64 = 1e-3;
/// Pulses so far apart measure it, µs: over a longer time an index that was shifted meanwhile by one would pass for another pace.
const APART_US: i64 = 3_500_000;

impl<S: SampleSource> Seismic<S> {
    /// Nothing heard yet.
    pub fn new(source: S, conversion: Conversion) -> Self {
        let (decimator, still, leaps) = (Decimator::default(), Default::default(), Default::default());
        Self { source, conversion, decimator, still, leaps, next: 0, fault: None, precise: None }
    }

    /// The recorder's pair of one of the converter's. The delays are 31 conversions and more, so what a pulse tells is worth as
    /// much as their length is known: it is measured from pulse to pulse, and the first alone gives nothing.
    fn placed(&mut self, converted: Pair) -> Option<Pair> {
        let nominal_us = self.conversion.period_us();
        if converted.sd_s > PRECISE_S {
            return self.conversion.pair(converted, nominal_us);
        }
        let before = self.precise.replace(converted)?;
        let conversions = converted.index.checked_sub(before.index).filter(|n| *n > 0)?;
        let passed_us =
            converted.utc_us.checked_sub(before.utc_us).filter(|us| (1..APART_US).contains(us))?;
        let period_us = passed_us as f64 / conversions as f64;
        let near = (period_us - nominal_us).abs() <= PACE_WITHIN * nominal_us;
        self.conversion.pair(converted, period_us).filter(|_| near)
    }

    /// Takes a sample of the converter's; the recorder's that is complete with it.
    fn push(&mut self, number: u64, mut frame: Frame) -> Option<(u64, Frame)> {
        if number != self.next {
            self.leaps.iter_mut().for_each(Leaps::begin);
        }
        self.next = number.wrapping_add(1);
        for (channel, (code, leaps)) in frame.iter().zip(&mut self.leaps).enumerate() {
            if leaps.take(*code) {
                self.decimator.strike(channel, number.saturating_sub(2)..number.saturating_sub(1));
            }
        }
        for (channel, (code, still)) in frame.iter_mut().zip(&mut self.still).enumerate() {
            still.times = if *code == still.code { still.times.saturating_add(1) } else { 1 };
            still.code = *code;
            let silent = still.times >= STILL && *code != MISSING;
            if silent {
                *code = MISSING;
            }
            if silent && still.times == STILL {
                self.decimator.strike(channel, (number + 1).saturating_sub(STILL.into())..number);
            }
            let changed = if still.told { *code != MISSING } else { silent };
            // Each is told, one after the other.
            if changed && self.fault.is_none() {
                still.told = silent;
                let what = if silent { FaultCode::DeadChannel } else { FaultCode::ChannelBack };
                self.fault = Some((what, channel as u64));
            }
        }
        match self.conversion.decimated {
            true => self.decimator.push(number, &frame),
            false => Some((number, decimate::as_is(&frame))),
        }
    }
}

impl<S: SampleSource> SampleSource for Seismic<S> {
    fn read(&mut self, frames: &mut [Frame]) -> Chunk {
        let mut taken = [[0; CHANNELS]; TAKEN];
        loop {
            let room = frames.len().min(TAKEN);
            let (first, count) = match self.source.read(&mut taken[..room]) {
                Chunk::Frames { first_index, count } => (first_index, count),
                other => return other,
            };
            let mut made = None;
            let mut slots = frames.iter_mut();
            for (number, frame) in (first..).zip(taken.iter().take(count)) {
                if let Some((index, frame)) = self.push(number, *frame)
                    && let Some(slot) = slots.next()
                {
                    *slot = frame;
                    let (_, count) = made.get_or_insert((index, 0));
                    *count += 1;
                }
            }
            if let Some((first_index, count)) = made {
                return Chunk::Frames { first_index, count };
            }
        }
    }

    fn waits(&self) -> bool {
        self.source.waits()
    }

    fn fault(&mut self) -> Option<(FaultCode, u64)> {
        let instants = |(code, value)| match code {
            FaultCode::ConverterRestarted => (code, value / self.conversion.factor()),
            _ => (code, value),
        };
        self.source.fault().map(instants).or_else(|| self.fault.take())
    }

    fn told(&mut self, time: &Time) {
        self.source.told(&self.conversion.told(time));
    }

    fn age_us(&mut self, index: u64) -> Option<u64> {
        let delay_us = (DELAY as f64 * self.conversion.period_us() + 0.5) as u64;
        self.source.age_us(self.conversion.middle(index)).map(|us| us.saturating_add(delay_us))
    }

    fn pair(&mut self) -> Option<Pair> {
        let pair = self.source.pair()?;
        self.placed(pair)
    }
}

#[cfg(test)]
mod tests;
