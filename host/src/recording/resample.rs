//! A recording at another rate than the recorder's, brought to the recorder's by `rubato`.
//!
//! Enters: blocks at the file's rate. Leaves: blocks at the recorder's rate whose index 0 is the same moment. Between two
//! rates whose ratio is one of whole numbers up to [`MOST_PHASES`], each sample is one windowed sinc through the input
//! itself; other ratios interpolate between 256 of them. The sinc has [`ZEROS`] zeros of the lower rate under a squared
//! Blackman-Harris window: the pass band reaches 0.88 of half the lower rate with less than 0.001 dB of ripple, and
//! what would alias is 120 dB down or more (measured by the tests here).
//!
//! Where indices jump the filter begins anew, on the value of the first sample there, so that a seismometer's offset makes
//! no step. A code that is missing or at full scale is so in the samples about it.
//!
//! Of an ocean-bottom station spikes are put right before, at the file's own rate and by the recorder's hand (`mended`), for the filter would
//! spread them over seconds in which nobody finds them. What a spike added is in the one sample nearest to it, as the station's own converter
//! would have it there: the recorder finds it, puts it right and counts it as always. Of files above [`ALIKE`] times the recorder's rate, which are no
//! such converter's, what short sounds add is the share that is left of them behind the station's own filter: `to / from`.
//!
//! Cost: `ZEROS` · (higher rate / lower rate) multiplications a channel and output sample.

use super::BlockSource;
use super::rate::ALIKE;
use crate::ocean_bottom::mended::Mended;
use anyhow::{Result, anyhow};
use rubato::audioadapter_buffers::direct::SequentialSliceOfVecs;
use rubato::{
    Async, FixedAsync, Indexing, Resampler, SincInterpolationParameters, SincInterpolationType,
    WindowFunction, calculate_cutoff,
};
use seabearing_core::block::{Block, CHANNELS, Frame, MISSING};
use std::collections::VecDeque;
use time::OffsetDateTime;

/// Taps of the sinc at the lower rate.
const ZEROS: usize = 256;

/// Most phases that have a sinc each.
const MOST_PHASES: usize = 640;

/// Input frames at a time.
const CHUNK: usize = 4096;

/// A source at the recorder's rate.
pub(super) struct Resampled {
    source: Box<dyn BlockSource>,
    /// Output samples for an input sample.
    ratio: f64,
    /// Phases of the output against the input, and input samples after which they repeat; 0 where they do not.
    phases: (usize, usize),
    taps: usize,
    full_scale: i32,
    /// Where spikes are put right, how much of what each added is in the output.
    left: Option<f64>,
    filter: Option<Filter>,
    /// The block held back because a new stretch begins with it: its first index and frames.
    waiting: Option<(u64, Vec<Frame>)>,
    frames: Vec<Frame>,
    ended: bool,
}

/// One stretch without jumps.
struct Filter {
    inner: Async<f64>,
    input: Vec<Vec<f64>>,
    output: Vec<Vec<f64>>,
    /// What is subtracted from each channel while filtered, and its last value.
    offset: [f64; CHANNELS],
    last: [f64; CHANNELS],
    /// What spikes are put right in, codes that came, of those that are not filtered yet, and how much of what each added is left.
    mended: Option<(Mended, Vec<Frame>, f64)>,
    /// Marks of input samples not yet passed by the output, a bit a channel: missing, then at the top, then at the bottom. And what a spike
    /// added to each.
    marks: VecDeque<(u16, Frame)>,
    /// Index within the stretch of the first of `marks`, and input samples taken.
    marked: u64,
    taken: u64,
    /// Output samples still to drop at the start, made, and index of the first.
    drop: u64,
    made: u64,
    first: u64,
    /// Index of the next input sample.
    next: u64,
}

/// Whole numbers whose ratio is that of two rates.
fn ratio(from_hz: f64, to_hz: f64) -> (usize, usize) {
    let exact = |phases: &usize| {
        let steps = from_hz / to_hz * *phases as f64;
        (steps - steps.round()).abs() < 1e-6 && steps.round() >= 1.0
    };
    (1..=MOST_PHASES).find(exact).map_or((0, 0), |n| (n, (from_hz / to_hz * n as f64).round() as usize))
}

impl Resampled {
    /// Brings a source from one rate to another; `full_scale` is the code that means clipping.
    pub(super) fn new(source: Box<dyn BlockSource>, from_hz: f64, to_hz: f64, full_scale: i32) -> Self {
        let taps = (ZEROS as f64 * (from_hz / to_hz).max(1.0)).ceil() as usize;
        Self {
            source,
            ratio: to_hz / from_hz,
            phases: ratio(from_hz, to_hz),
            taps: taps.next_multiple_of(8),
            full_scale,
            left: None,
            filter: None,
            waiting: None,
            frames: Vec::new(),
            ended: false,
        }
    }

    /// The same of a source in which spikes are put right.
    pub(super) fn mending(self) -> Self {
        let left = if self.ratio * ALIKE < 1.0 { self.ratio } else { 1.0 };
        Self { left: Some(left), ..self }
    }

    fn begin(&self, first: u64, frame: Frame) -> Result<Filter> {
        let (phases, steps) = self.phases;
        let window = WindowFunction::BlackmanHarris2;
        // Relative to half the lower rate.
        let cutoff = calculate_cutoff::<f32>(ZEROS, window);
        let mut sinc = SincInterpolationParameters::new(self.taps, window).f_cutoff(cutoff);
        sinc = match phases {
            0 => sinc.oversampling_factor(256).interpolation(SincInterpolationType::Cubic),
            n => sinc.oversampling_factor(n).interpolation(SincInterpolationType::Nearest),
        };
        let inner = Async::new_sinc(self.ratio, 1.0, &sinc, CHUNK, CHANNELS, FixedAsync::Input)
            .map_err(|e| anyhow!("cannot resample: {e}"))?;
        // With a sinc for each of n phases, output k stands (k + 1) / ratio + 1 / n − taps / 2 after the first input
        // sample. So many values before the first that one output falls on it; those before that one are dropped.
        let half = self.taps / 2;
        let (pad, drop) = if phases > 0 {
            let place = |k: usize| (k + 1) * steps + 1;
            let falls_on = |k: &usize| place(*k).is_multiple_of(phases) && place(*k) / phases >= half;
            let k = (half * phases / steps).saturating_sub(1);
            let k = (k..k + 2 * phases + 2).find(falls_on).unwrap_or(k);
            ((place(k) / phases).saturating_sub(half), k)
        } else {
            let k = (half as f64 * self.ratio).ceil();
            (((k + 1.0) / self.ratio).round() as usize - half, k as usize)
        };
        let room = inner.output_frames_max();
        let offset = frame.map(|x| if x == MISSING { 0.0 } else { f64::from(x) });
        let output_first = (first as f64 * self.ratio).round() as u64;
        let mut filter = Filter {
            inner,
            input: vec![Vec::new(); CHANNELS],
            output: vec![vec![0.0; room]; CHANNELS],
            offset,
            last: [0.0; CHANNELS],
            mended: self.left.map(|left| (Mended::new(), Vec::new(), left)),
            marks: VecDeque::new(),
            marked: 0,
            taken: 0,
            drop: drop as u64,
            made: 0,
            first: output_first,
            next: first,
        };
        filter.input.iter_mut().for_each(|c| c.resize(pad, 0.0));
        Ok(filter)
    }
}

impl Filter {
    /// Takes frames that follow on.
    fn push(&mut self, frames: &[Frame], full_scale: i32) {
        self.next += frames.len() as u64;
        let Some((mended, came, _)) = &mut self.mended else {
            return frames.iter().for_each(|frame| self.take(frame, frame, 1.0, full_scale));
        };
        mended.extend(frames);
        came.extend_from_slice(frames);
        self.settle(false, full_scale);
    }

    /// Filters what stays as it is of what is looked at for spikes: all where the stretch has `ended`.
    fn settle(&mut self, ended: bool, full_scale: i32) {
        let Some((mut mended, mut came, left)) = self.mended.take() else { return };
        let settled = mended.settled(ended).to_vec();
        for (frame, came) in settled.iter().zip(came.drain(..settled.len())) {
            self.take(frame, &came, left, full_scale);
        }
        mended.drop_before(mended.first() + settled.len() as u64);
        self.mended = Some((mended, came, left));
    }

    /// Takes the next frame, as it is after `came` was put right; of what a spike added so much is `left`.
    fn take(&mut self, frame: &Frame, came: &Frame, left: f64, full_scale: i32) {
        let (mut mark, mut added) = (0u16, [0; CHANNELS]);
        let spike = frame != came;
        for (c, (x, came)) in frame.iter().zip(came).enumerate() {
            if *x == MISSING {
                mark |= 1 << c;
            } else {
                // The vertical component, which is not looked at, stands still meanwhile.
                let stands = spike && c + 1 == CHANNELS;
                self.last[c] = if stands { self.last[c] } else { f64::from(*x) - self.offset[c] };
                let high = came.saturating_sub((self.last[c] + self.offset[c]) as i32);
                added[c] = (left * f64::from(high)).round() as i32;
                // What was a spike at full scale is none that is clipped.
                let whole = high == 0;
                mark |= u16::from(whole && *x >= full_scale - 1) << (4 + c)
                    | u16::from(whole && *x <= -full_scale) << (8 + c);
            }
            self.input[c].push(self.last[c]);
        }
        self.marks.push_back((mark, added));
        self.taken += 1;
    }

    /// Filters all whole chunks; at the end also the rest, as far as there was input.
    fn run(&mut self, ratio: f64, end: bool, out: &mut Vec<Frame>, full_scale: i32) -> Result<()> {
        if end {
            self.settle(true, full_scale);
        }
        let whole = (self.taken as f64 * ratio).round() as u64;
        while self.input[0].len() >= CHUNK || end && self.made < whole {
            if self.input[0].len() < CHUNK {
                let last = self.last;
                self.input.iter_mut().zip(last).for_each(|(c, x)| c.resize(CHUNK, x));
            }
            let room = self.output[0].len();
            let input = SequentialSliceOfVecs::new(&self.input, CHANNELS, CHUNK)?;
            let mut output = SequentialSliceOfVecs::new_mut(&mut self.output, CHANNELS, room)?;
            let (_, made) = self.inner.process_into_buffer(&input, &mut output, None::<&Indexing>)?;
            self.input.iter_mut().for_each(|c| drop(c.drain(..CHUNK)));
            for i in 0..made {
                if self.drop > 0 {
                    self.drop -= 1;
                    continue;
                }
                if end && self.made >= whole {
                    break;
                }
                // The input samples nearer to this output than to those beside it.
                let upto = ((self.made as f64 + 0.5) / ratio).ceil().max(1.0) as u64;
                let (mut mark, mut added) = self.marks.front().copied().unwrap_or_default();
                while self.marked < upto.min(self.taken) {
                    let (newer, more) = self.marks.pop_front().unwrap_or_default();
                    mark |= newer;
                    for (most, more) in added.iter_mut().zip(more) {
                        *most = if more.abs() > most.abs() { more } else { *most };
                    }
                    self.marked += 1;
                }
                let frame = std::array::from_fn(|c| {
                    let x = (self.output[c][i] + self.offset[c]).round() + f64::from(added[c]);
                    match mark >> c & 0x111 {
                        0 => x.max(-f64::from(i32::MAX)).min(f64::from(i32::MAX)) as i32,
                        m if m & 1 != 0 => MISSING,
                        m if m & 0x10 != 0 => full_scale - 1,
                        _ => -full_scale,
                    }
                });
                out.push(frame);
                self.made += 1;
            }
        }
        Ok(())
    }
}

impl BlockSource for Resampled {
    fn start(&self) -> Option<OffsetDateTime> {
        self.source.start()
    }

    fn expected_end(&self) -> Option<u64> {
        self.source.expected_end().map(|n| (n as f64 * self.ratio) as u64)
    }

    fn next_block(&mut self) -> Result<Option<Block<'_>>> {
        self.frames.clear();
        loop {
            let held = self.waiting.take();
            let new = match held {
                Some(held) => Some(held),
                None if self.ended => None,
                None => self.source.next_block()?.map(|b| (b.first_index, b.frames.to_vec())),
            };
            let follows = |f: &Filter, index: u64| f.next == index;
            let first_index = match (self.filter.take(), new) {
                (None, None) => return Ok(None),
                // The stretch is over: what is left of it first.
                (Some(mut filter), new) if !new.as_ref().is_some_and(|n| follows(&filter, n.0)) => {
                    self.ended = new.is_none();
                    self.waiting = new;
                    let first = filter.first + filter.made;
                    filter.run(self.ratio, true, &mut self.frames, self.full_scale)?;
                    first
                }
                (filter, Some((first, frames))) => {
                    let Some(frame) = frames.first() else { continue };
                    let mut filter = match filter {
                        Some(filter) => filter,
                        None => self.begin(first, *frame)?,
                    };
                    filter.push(&frames, self.full_scale);
                    let first = filter.first + filter.made;
                    filter.run(self.ratio, false, &mut self.frames, self.full_scale)?;
                    self.filter = Some(filter);
                    first
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
    use super::super::rate::PASS;
    use super::*;

    /// Blocks of a function of the sample's index, in stretches of indices.
    struct Made<F>(F, Vec<std::ops::Range<u64>>, Vec<Frame>);

    impl<F: Fn(u64) -> Frame> BlockSource for Made<F> {
        fn start(&self) -> Option<OffsetDateTime> {
            None
        }
        fn expected_end(&self) -> Option<u64> {
            None
        }
        fn next_block(&mut self) -> Result<Option<Block<'_>>> {
            let Some(stretch) = self.1.first_mut() else { return Ok(None) };
            let (first, end) = (stretch.start, stretch.end.min(stretch.start + 1000));
            stretch.start = end;
            if stretch.is_empty() {
                self.1.remove(0);
            }
            self.2 = (first..end).map(&self.0).collect();
            Ok(Some(Block { first_index: first, frames: &self.2 }))
        }
    }

    fn resampled(
        of: impl Fn(u64) -> Frame + 'static,
        stretches: &[std::ops::Range<u64>],
        from_hz: f64,
        to_hz: f64,
    ) -> Vec<(u64, Frame)> {
        let made = Box::new(Made(of, stretches.to_vec(), Vec::new()));
        let mut source = Resampled::new(made, from_hz, to_hz, 1 << 23);
        let mut out = Vec::new();
        while let Some(b) = source.next_block().unwrap() {
            out.extend((b.first_index..).zip(b.frames.iter().copied()));
        }
        out
    }

    const RATES_HZ: [(f64, f64); 9] = [
        (192_000.0, 64_000.0),
        (96_000.0, 64_000.0),
        (44_100.0, 16_000.0),
        (500.0, 50.0),
        (8000.0, 50.0),
        (125.0, 50.0),
        (62.5, 50.0),
        (16.0, 50.0),
        (100.003, 50.0),
    ];

    /// Samples of which more are left than a sinc covers at either end.
    fn enough(from_hz: f64, to_hz: f64) -> u64 {
        12_000u64.max((1_400.0 * from_hz / to_hz) as u64)
    }

    #[test]
    fn a_tone_in_the_pass_band_stays_where_and_what_it_is() {
        for (from_hz, to_hz) in RATES_HZ {
            for share in [0.01, 0.5, PASS] {
                let hz = share * from_hz.min(to_hz) / 2.0;
                let tone = move |t: f64| 4e6 * (std::f64::consts::TAU * hz * t + 0.7).sin();
                let n = enough(from_hz, to_hz);
                let got = resampled(
                    move |i| [tone(i as f64 / from_hz) as i32; 4],
                    std::slice::from_ref(&(0..n)),
                    from_hz,
                    to_hz,
                );
                assert_eq!(got.len(), (n as f64 * to_hz / from_hz).round() as usize);
                let edge = (2.0 * ZEROS as f64 * (to_hz / from_hz).max(1.0)) as usize;
                let worst = got[edge..got.len() - edge]
                    .iter()
                    .map(|(i, f)| (f64::from(f[2]) - tone(*i as f64 / to_hz)).abs())
                    .fold(0.0, f64::max);
                // A ten-thousandth: 0.001 dB of ripple, or of the shortest period. Without a sinc for each phase the
                // grid may lie half an input sample beside.
                let bar = if ratio(from_hz, to_hz).0 > 0 {
                    1e-4
                } else {
                    std::f64::consts::PI * hz / from_hz + 1e-4
                };
                assert!(worst < bar * 4e6, "{from_hz} to {to_hz}, {hz} Hz: {}", worst / 4e6);
            }
        }
    }

    #[test]
    fn what_would_alias_is_gone() {
        for (from_hz, to_hz) in RATES_HZ.into_iter().filter(|(from, to)| *from > 1.2 * to) {
            let hz = 0.5 * to_hz * 1.001;
            let tone =
                move |i: u64| [(8e6 * (std::f64::consts::TAU * hz * i as f64 / from_hz).sin()) as i32; 4];
            let got = resampled(tone, std::slice::from_ref(&(0..enough(from_hz, to_hz))), from_hz, to_hz);
            let inside = &got[2 * ZEROS..got.len() - 2 * ZEROS];
            let worst = inside.iter().map(|(_, f)| f[1].abs()).max().unwrap();
            // 120 dB below 8·10⁶ codes, and rounding.
            assert!(worst <= 9, "{from_hz} to {to_hz}: {worst}");
        }
    }

    #[test]
    fn gaps_missing_codes_clipping_and_an_offset_come_through() {
        let of = |i: u64| match i {
            6000..6010 => [1_000_000, MISSING, 1_000_000, 1_000_000],
            9000..9003 => [1_000_000, 1_000_000, 0x7f_ffff, -0x80_0000],
            _ => [1_000_000; 4],
        };
        let got = resampled(of, &[3..12_000, 15_000..21_000], 96_000.0, 32_000.0);
        let indices: Vec<u64> = got.iter().map(|g| g.0).collect();
        assert!(indices.iter().copied().eq((1..4000).chain(5000..7000)), "{indices:?}");
        let at = |i: u64| got.iter().find(|g| g.0 == i).unwrap().1;
        for i in [1, 500, 3999, 5000, 6999] {
            assert_eq!(at(i), [1_000_000; 4], "{i}");
        }
        assert!((2001..2003).all(|i| at(i)[1] == MISSING && at(i)[0] == 1_000_000));
        assert_eq!((at(1995)[1], at(2010)[1]), (1_000_000, 1_000_000));
        assert_eq!(at(3000)[2..], [0x7f_ffff, -0x80_0000]);
    }

    #[test]
    fn of_a_file_of_a_far_higher_rate_short_sounds_are_what_is_left_of_them() {
        let of = |i: u64| [(1e5 * (i as f64 * 5.0 * std::f64::consts::TAU / 8000.0).sin()) as i32; 4];
        let snaps = move |i: u64| of(i).map(|x| x + if i % 1603 == 801 { 400_000 } else { 0 });
        let run = |of: Box<dyn Fn(u64) -> Frame>| {
            let made = Box::new(Made(of, std::iter::once(0..80_000).collect(), Vec::new()));
            let mut source = Resampled::new(made, 8000.0, 50.0, 1 << 23).mending();
            let mut out = Vec::new();
            while let Some(b) = source.next_block().unwrap() {
                out.extend(b.frames.iter().copied());
            }
            out
        };
        let (clean, heard) = (run(Box::new(of)), run(Box::new(snaps)));
        assert_eq!((clean.len(), heard.len()), (500, 500));
        let off = |c: usize| clean.iter().zip(&heard).map(|(a, b)| (a[c] - b[c]).abs()).max().unwrap();
        // One sample of 160, whether it is found or not, and two where they fall into one.
        assert!((0..4).all(|c| (1500..6000).contains(&off(c))), "{:?}", [0, 1, 2, 3].map(off));
    }

    #[test]
    fn a_spike_stays_in_one_sample_and_what_is_about_it_is_not_touched() {
        // Tones that the mender takes for no spikes, each component with its own.
        let of = |i: u64| {
            std::array::from_fn(|c| {
                let t = i as f64 / 100.0;
                let tone = |hz: f64| (std::f64::consts::TAU * hz * (t + 0.13 * c as f64)).sin();
                (3000.0 * (tone(3.1) + tone(8.3) + tone(13.7) + tone(19.1) + 0.3 * tone(37.0))) as i32
            })
        };
        let hit = move |i: u64| of(i).map(|x| x + if i > 500 && i % 1400 == 701 { 1_000_000 } else { 0 });
        let run = |of: Box<dyn Fn(u64) -> Frame>, mends| {
            let made = Box::new(Made(of, vec![0..12_000, 13_000..20_000], Vec::new()));
            let resampled = Resampled::new(made, 100.0, 50.0, 1 << 23);
            let mut source = if mends { resampled.mending() } else { resampled };
            let mut out = Vec::new();
            while let Some(b) = source.next_block().unwrap() {
                out.extend((b.first_index..).zip(b.frames.iter().copied()));
            }
            out
        };
        let (clean, mended) = (run(Box::new(of), true), run(Box::new(hit), true));
        assert_eq!(clean, run(Box::new(of), false), "what has no spike is as it was");
        assert_eq!(clean.len(), mended.len());
        let (mut spikes, mut worst) = (0, 0);
        for (clean, mended) in clean.iter().zip(&mended) {
            let off = (0..CHANNELS).map(|c| (mended.1[c] - clean.1[c]).abs()).max().unwrap_or(0);
            if off > 500_000 {
                spikes += 1;
            } else {
                worst = worst.max(off);
            }
        }
        assert_eq!(spikes, 14);
        // A straight line across a hundredth of a second of these tones.
        assert!(worst < 6_000, "{worst}");
        let smeared = run(Box::new(hit), false);
        assert!(smeared.iter().zip(&clean).filter(|(a, b)| (a.1[0] - b.1[0]).abs() > 6_000).count() > 300);
    }
}
