//! A seismometer's or hydrophone's own response taken out of a recording, as far as the station file tells it.
//!
//! Enters: blocks at the recorder's rate. Leaves: the same instants with components as flat and in phase as their sensitivities
//! say they are. Each component has a filter of its own, of `2 · HALF_S` seconds, without delay: the inverse of its poles and
//! zeros, with a water level below which nothing is raised further. Where indices jump it begins anew, on the value of the first
//! sample there. A code that is missing or at full scale stays as it is.
//!
//! Cost: `2 · HALF_S · rate` multiplications a sample of each component that has a response.

use super::BlockSource;
use crate::station::response::Response;
use anyhow::Result;
use seabearing_core::block::{Block, CHANNELS, Frame, MISSING};
use std::f64::consts::{PI, TAU};
use time::OffsetDateTime;

/// Half of a filter's length, seconds: eight periods of the lowest frequency that is listened to, where a geophone of 4.5 Hz is
/// then right within 0.7 %.
const HALF_S: f64 = 4.0;
/// What is smaller than this share of the response where the sensitivity is told is not raised further: 20 dB.
pub(crate) const WATER_LEVEL: f64 = 0.1;
/// Points of the spectra that filters are made of.
const POINTS: usize = 4096;

/// A source with its components made flat.
pub(super) struct Equalised {
    source: Box<dyn BlockSource>,
    /// Of each channel; none where it is flat already.
    filters: [Option<Filter>; CHANNELS],
    half: usize,
    full_scale: i32,
    stretch: Option<Stretch>,
    /// The block held back because a new stretch begins with it: its first index and frames.
    waiting: Option<(u64, Vec<Frame>)>,
    frames: Vec<Frame>,
    ended: bool,
}

/// One stretch without jumps.
struct Stretch {
    /// Index of the next instant that leaves, and of the next that is to come.
    first: u64,
    next: u64,
    /// Codes not yet left.
    codes: std::collections::VecDeque<Frame>,
    /// Values of each channel from half a filter before the next instant that leaves, less `offset`.
    values: [Vec<f32>; CHANNELS],
    offset: [i32; CHANNELS],
    last: [f32; CHANNELS],
}

/// A filter of a channel.
struct Filter {
    /// The last first, as a convolution meets them.
    taps: Vec<f32>,
    /// What becomes of a steady value.
    steady: f64,
}

/// A filter of `2 · half + 1` taps that undoes a response at a rate, Hz.
fn inverse(response: &Response, rate_hz: f64, half: usize) -> Filter {
    let spectrum: Vec<(f64, f64)> = (0..=POINTS / 2)
        .map(|k| {
            let (size, phase) = response.at((k as f64 * rate_hz / POINTS as f64).max(1e-6));
            let gain = if size >= WATER_LEVEL { 1.0 / size } else { size / (WATER_LEVEL * WATER_LEVEL) };
            (gain, -phase)
        })
        .collect();
    let window = |tap: usize| 0.5 + 0.5 * (PI * (tap as f64 - half as f64) / (half as f64 + 1.0)).cos();
    let tap = |tap: usize| {
        let n = tap as f64 - half as f64;
        let line = |(k, (gain, phase)): (usize, &(f64, f64))| {
            let share = if k == 0 || k == POINTS / 2 { 1.0 } else { 2.0 };
            share * gain * (TAU * k as f64 * n / POINTS as f64 + phase).cos()
        };
        spectrum.iter().enumerate().map(line).sum::<f64>() / POINTS as f64 * window(tap)
    };
    let taps: Vec<f64> = (0..=2 * half).map(tap).collect();
    // The window must not let through what is steady where the response does not, nor change it where it does.
    let steady = spectrum.first().map_or(0.0, |s| s.0);
    let too_much = (taps.iter().sum::<f64>() - steady) / (0..=2 * half).map(window).sum::<f64>();
    let taps = (0..).zip(taps).map(|(i, tap)| (tap - too_much * window(i)) as f32).collect();
    Filter { taps, steady }
}

/// The sum of products, in an order of its own that is always the same.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    const LANES: usize = 16;
    let mut sums = [0f32; LANES];
    let (whole_a, whole_b) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest: f32 = whole_a.remainder().iter().zip(whole_b.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in whole_a.zip(whole_b) {
        sums.iter_mut().zip(x.iter().zip(y)).for_each(|(sum, (x, y))| *sum += x * y);
    }
    sums.iter().sum::<f32>() + rest
}

impl Equalised {
    /// Makes a source at a rate, Hz, flat; `full_scale` is the code that means clipping.
    pub(super) fn new(
        source: Box<dyn BlockSource>,
        rate_hz: f64,
        responses: &[Option<Response>; CHANNELS],
        full_scale: i32,
    ) -> Self {
        let half = (HALF_S * rate_hz).ceil() as usize;
        let filters = responses.each_ref().map(|r| {
            let mut filter = inverse(r.as_ref()?, rate_hz, half);
            filter.taps.reverse();
            Some(filter)
        });
        Self {
            source,
            filters,
            half,
            full_scale,
            stretch: None,
            waiting: None,
            frames: Vec::new(),
            ended: false,
        }
    }

    /// Takes frames that follow on, or begin a stretch.
    fn push(&mut self, first: u64, frames: &[Frame]) {
        let half = self.half;
        let stretch = self.stretch.get_or_insert_with(|| Stretch {
            first,
            next: first,
            codes: Default::default(),
            values: [const { Vec::new() }; CHANNELS].map(|mut v| {
                v.resize(half, 0.0);
                v
            }),
            offset: frames.first().map_or([0; CHANNELS], |f| f.map(|x| if x == MISSING { 0 } else { x })),
            last: [0.0; CHANNELS],
        });
        for frame in frames {
            for (c, x) in frame.iter().enumerate() {
                if *x != MISSING {
                    stretch.last[c] = (i64::from(*x) - i64::from(stretch.offset[c])) as f32;
                }
                stretch.values[c].push(stretch.last[c]);
            }
            stretch.codes.push_back(*frame);
        }
        stretch.next += frames.len() as u64;
    }

    /// Filters what has half a filter behind it; at the end of a stretch all of it.
    fn run(&mut self, end: bool) {
        let Some(stretch) = &mut self.stretch else { return };
        if end {
            let (half, last) = (self.half, stretch.last);
            stretch.values.iter_mut().zip(last).for_each(|(v, x)| v.resize(v.len() + half, x));
        }
        let taps = 2 * self.half + 1;
        let ready = (stretch.values[0].len() + 1).saturating_sub(taps);
        for i in 0..ready {
            let Some(code) = stretch.codes.pop_front() else { break };
            let mut frame = code;
            for (c, out) in frame.iter_mut().enumerate() {
                let usable = *out != MISSING && *out < self.full_scale - 1 && *out > -self.full_scale;
                if let (Some(filter), Some(values), true) =
                    (&self.filters[c], stretch.values[c].get(i..i + taps), usable)
                {
                    let most = f64::from(self.full_scale - 2);
                    let value =
                        f64::from(dot(&filter.taps, values)) + filter.steady * f64::from(stretch.offset[c]);
                    *out = value.round().clamp(-most, most) as i32;
                }
            }
            self.frames.push(frame);
        }
        stretch.values.iter_mut().for_each(|v| drop(v.drain(..ready.min(v.len()))));
        stretch.first += ready as u64;
    }
}

impl BlockSource for Equalised {
    fn start(&self) -> Option<OffsetDateTime> {
        self.source.start()
    }

    fn expected_end(&self) -> Option<u64> {
        self.source.expected_end()
    }

    fn is_live(&self) -> bool {
        self.source.is_live()
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        self.frames.clear();
        loop {
            let new = match self.waiting.take() {
                Some(held) => Some(held),
                None if self.ended => None,
                None => self.source.next_block()?.map(|b| (b.first_index, b.frames.to_vec())),
            };
            let first_index = match (self.stretch.as_ref().map(|s| (s.first, s.next)), new) {
                (None, None) => return Ok(None),
                // The stretch is over: what is left of it first.
                (Some((first, next)), new) if new.as_ref().is_none_or(|n| n.0 != next) => {
                    self.ended = new.is_none();
                    self.waiting = new;
                    self.run(true);
                    self.stretch = None;
                    first
                }
                (open, Some((index, frames))) => {
                    if frames.is_empty() {
                        continue;
                    }
                    self.push(index, &frames);
                    self.run(false);
                    open.map_or(index, |(first, _)| first)
                }
                (Some(_), None) => return Ok(None),
            };
            if !self.frames.is_empty() {
                return Ok(Some(Block { first_index, frames: &self.frames }));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::memory::Memory;
    use crate::station::response::tests::geophone;
    use std::sync::Arc;

    const RATE_HZ: f64 = 50.0;
    const FULL: i32 = 8_388_608;

    /// What leaves of frames, with the index of each.
    fn through(frames: Vec<Frame>, responses: &[Option<Response>; CHANNELS]) -> Vec<(u64, Frame)> {
        let source = Memory::new(Arc::from(frames), None);
        let mut source = Equalised::new(Box::new(source), RATE_HZ, responses, FULL);
        let mut out = Vec::new();
        while let Some(block) = source.next_block().unwrap() {
            out.extend((block.first_index..).zip(block.frames.iter().copied()));
        }
        out
    }

    #[test]
    fn a_tone_through_a_geophone_comes_out_as_it_went_in() {
        let high_pass = Response {
            poles: vec![[-TAU * 2.0, 0.0]],
            zeros: vec![[0.0, 0.0]],
            at_hz: 20.0,
            reversed: false,
        };
        let responses = [Some(high_pass.clone()), Some(geophone(4.5, 0.56)), None, Some(geophone(4.5, 0.56))];
        for hz in [2.0, 3.0, 4.5, 7.3, 12.0, 20.0] {
            let of = |response: Option<&Response>, i: usize| {
                let (size, phase) = response.map_or((1.0, 0.0), |r| r.at(hz));
                (1e6 * size * (TAU * hz * i as f64 / RATE_HZ + phase).cos()).round() as i32
            };
            let frames = |with: bool| -> Vec<Frame> {
                let frame = |i| [0, 1, 2, 3].map(|c: usize| of(responses[c].as_ref().filter(|_| with), i));
                (0..2000).map(frame).collect()
            };
            let (out, wanted) = (through(frames(true), &responses), frames(false));
            assert_eq!(out.len(), wanted.len());
            let worst = out.iter().zip(&wanted).skip(300).take(1400);
            let worst =
                worst.flat_map(|((_, a), b)| (0..CHANNELS).map(|c| (a[c] - b[c]).abs())).max().unwrap();
            assert!(f64::from(worst) < 0.01 * 1e6, "{hz} Hz: {worst}");
        }
    }

    #[test]
    fn instants_marks_and_flat_channels_stay() {
        let responses = [None, Some(geophone(4.5, 0.56)), None, None];
        let mut frames: Vec<Frame> = (0..700).map(|i| [i, 1000 * (i % 7) + 5_000, -i, 3]).collect();
        frames[300][1] = MISSING;
        frames[400][1] = FULL - 1;
        frames[500][2] = MISSING;
        let out = through(frames.clone(), &responses);
        assert!(out.iter().map(|o| o.0).eq(0..700));
        for ((_, a), b) in out.iter().zip(&frames) {
            assert_eq!([a[0], a[2], a[3]], [b[0], b[2], b[3]]);
        }
        assert_eq!((out[300].1[1], out[400].1[1]), (MISSING, FULL - 1));
        // What does not change is not heard by a geophone.
        let mean: f64 = out[100..290].iter().map(|o| f64::from(o.1[1])).sum::<f64>() / 190.0;
        assert!(mean.abs() < 300.0, "{mean}");
    }
}
