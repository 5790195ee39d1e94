//! Samples that no sound makes: spikes, which are put right, and a converter's rail below its full scale, which is told.
//!
//! A spike is one to `LONGEST` samples, each far off the line between those on either side, which are themselves where their neighbours
//! expect them once it is gone; sound that fills the band bends its neighbours too. The distances of the three used components are judged
//! together, each against its own running mean square, so that a spike common to all is found where it is weak in each.
//! The samples are replaced by that line. Enters: one instant after another of a run; leaves: the instant [`Mender::LAG`] before.
//!
//! A rail is a code that is the extreme of a hop and comes up in it [`RAIL_HITS`] times: extremes of a sound are met once.
//! Cost: 60 instructions an instant.

use super::limits::{HOP, USED_CHANNELS};
use crate::block::{CHANNELS, Frame};
use crate::math;

/// Most samples of a spike, 0.16 s at 50 Hz: what takes longer may be a whale's note.
const LONGEST: usize = 8;

/// Instants looked at together: those judged and two on either side.
const WINDOW: usize = LONGEST + 4;

/// Places for them, a power of two: the newest takes that of one done with.
const PLACES: usize = 16;

/// Instants before the first that is judged.
const BEFORE: usize = 2;

/// Instants of a run before its level is known; none is put right in them.
const WARM_UP: u16 = 64;

/// Instants over which the mean square of a component's distances is kept, a power of two.
const MEMORY: u16 = 256;

/// Sum of the squared distances of the components, each in its mean square, from which on an instant is a spike. Gaussian noise
/// gets there in one instant of 10¹² (χ² of three degrees of freedom).
const SPIKE: f32 = 60.0;

/// The same from which on a neighbour of what is put right is not where it is expected (one instant of 4000).
const ORDINARY: f32 = 18.0;

/// How many times farther out a spike is, squared, than what was before it and than its neighbours are when it is gone.
const STANDS_OUT: f32 = 6.0;

/// The same of a spike of several samples: two to eight on one side are also half a period of sound at a quarter to a sixteenth of the rate, which
/// stands out from before 4.6 times and more where it sets in.
const LONGER_STANDS_OUT: f32 = 40.0;

/// What is remembered of what was before, from instant to instant: half after four.
const RECENT: f32 = 0.85;

/// A component is put right where its own squared distance is above this.
const OWN: f32 = 9.0;

/// One distance moves the mean square as if it were at most so large against it.
const MOST: f32 = 9.0;

/// Least mean square of a distance, codes squared: below it a component is as good as still.
const STILL: f32 = 1.0;

/// Samples of the used components at an instant.
pub type Instant = [f32; USED_CHANNELS];

/// The same, or something else of each, and a nought: a desktop processor takes four numbers at once.
type Four = [f32; USED_CHANNELS + 1];

/// The instants about the one that is judged, and the levels.
#[derive(Clone, Debug)]
pub struct Mender {
    ring: [Four; PLACES],
    /// Place of the newest.
    newest_at: u8,
    held: u8,
    mean_square: Four,
    /// The greatest of the latest sums of squared distances, decaying.
    recent: f32,
    /// The sum of the instant before the one judged, of which the next may have been a part.
    newest: f32,
    /// Instants from the first judged on that are put right already.
    mended: u8,
    /// Instants that the mean squares are of, up to [`MEMORY`].
    known: u16,
}

/// Squared distance of each component of `b` from the middle between `a` and `c`.
fn squares(a: &Four, b: &Four, c: &Four) -> Four {
    core::array::from_fn(|i| {
        let d = b[i] - 0.5 * (a[i] + c[i]);
        d * d
    })
}

/// The sum of squared distances of all components, each in its mean square.
fn total(distances: &Four, mean_square: &Four) -> f32 {
    let weighed: Four = core::array::from_fn(|i| distances[i] / math::greater(mean_square[i], STILL));
    weighed.iter().sum()
}

/// What is at that part of the way from one instant to another.
fn between(a: &Four, b: &Four, part: f32) -> Four {
    core::array::from_fn(|i| a[i] + part * (b[i] - a[i]))
}

/// The components of an instant.
fn three([a, b, c, _]: Four) -> Instant {
    [a, b, c]
}

impl Mender {
    /// Instants by which what leaves is behind what enters.
    pub const LAG: usize = WINDOW - 1 - BEFORE;

    /// Nothing heard; all zeros.
    pub const fn new() -> Self {
        Self {
            ring: [[0.0; USED_CHANNELS + 1]; PLACES],
            newest_at: 0,
            held: 0,
            mean_square: [0.0; USED_CHANNELS + 1],
            recent: 0.0,
            newest: 0.0,
            mended: 0,
            known: 0,
        }
    }

    /// A run begins: what was before is no neighbour; levels stay.
    pub fn restart(&mut self) {
        self.held = 0;
        self.mended = 0;
    }

    /// The place of the instant looked at as number `k`, from the oldest.
    fn place(&self, k: usize) -> usize {
        (usize::from(self.newest_at) + PLACES + 1 + k - WINDOW) % PLACES
    }

    /// Takes an instant; gives the one [`Self::LAG`] before, once there is one, and whether it was a spike.
    #[inline]
    pub fn push(&mut self, [a, b, c]: Instant) -> Option<(Instant, bool)> {
        self.newest_at = (self.newest_at + 1) % PLACES as u8;
        self.ring[self.place(WINDOW - 1)] = [a, b, c, 0.0];
        self.held = (self.held + 1).min(WINDOW as u8);
        let [before, middle, after] = [1, 2, 3].map(|k| self.ring[self.place(k)]);
        if usize::from(self.held) < WINDOW {
            // The first of a run have no neighbours before them.
            return (usize::from(self.held) > Self::LAG).then_some((three(middle), false));
        }
        if self.mended > 0 {
            self.mended -= 1;
            return Some((three(middle), true));
        }
        let distances = squares(&before, &middle, &after);
        let all = total(&distances, &self.mean_square);
        // Where a spike is longer its first sample is at least half as far from the middle between its neighbours.
        if self.known >= WARM_UP && all > 0.25 * SPIKE && (1..=LONGEST).any(|samples| self.mend(samples)) {
            self.newest = 0.0;
            return Some((three(self.ring[self.place(2)]), true));
        }
        self.known = (self.known + 1).min(MEMORY);
        let warm = self.known > WARM_UP;
        let known = f32::from(self.known);
        let mean_square = self.mean_square;
        // A component that stands still has no codes, or none of its own.
        let far: Four = core::array::from_fn(|i| {
            let (m, d) = (mean_square[i], distances[i]);
            let limited = if warm { math::lesser(d, MOST * math::greater(m, STILL)) } else { d };
            if d > 0.0 { limited - m } else { 0.0 }
        });
        // A product where it is the same: each mean waits for the one before.
        let part = if self.known == MEMORY {
            far.map(|x| x * (1.0 / f32::from(MEMORY)))
        } else {
            far.map(|x| x / known)
        };
        self.mean_square = core::array::from_fn(|i| mean_square[i] + part[i]);
        self.recent = math::greater(RECENT * self.recent, core::mem::replace(&mut self.newest, all));
        Some((three(middle), false))
    }

    /// Puts that many samples right if they are a spike. Seldom asked, and large.
    #[inline(never)]
    fn mend(&mut self, samples: usize) -> bool {
        let mean_square = self.mean_square;
        let mut window: [Four; WINDOW] = core::array::from_fn(|k| self.ring[self.place(k)]);
        let [first, before, spike @ ..] = &mut window;
        let Some((spike, [after, last, ..])) = spike.split_at_mut_checked(samples) else { return false };
        // Each sample must be far off, or what is beside a spike would be taken for a part of it.
        let (mut least, mut own) = (f32::INFINITY, [0f32; USED_CHANNELS + 1]);
        for (n, x) in spike.iter().enumerate() {
            let expected = between(before, after, (n + 1) as f32 / (samples + 1) as f32);
            let mut all = 0.0;
            for (own, ((x, e), m)) in own.iter_mut().zip(x.iter().zip(expected).zip(mean_square)) {
                let weighed = (x - e) * (x - e) / m.max(STILL);
                all += weighed;
                *own = own.max(weighed);
            }
            least = least.min(all);
        }
        let stands_out = if samples > 1 { LONGER_STANDS_OUT } else { STANDS_OUT };
        if !(least > SPIKE && least > stands_out * self.recent) {
            return false;
        }
        for (n, x) in spike.iter_mut().enumerate() {
            let expected = between(before, after, (n + 1) as f32 / (samples + 1) as f32);
            for ((x, e), _) in x.iter_mut().zip(expected).zip(own).filter(|(_, own)| *own > OWN) {
                *x = e;
            }
        }
        let most = ORDINARY.min(least / stands_out);
        let (Some(head), Some(tail)) = (spike.first(), spike.last()) else { return false };
        let ordinary = |distances: Four| total(&distances, &mean_square) < most;
        if !(ordinary(squares(first, before, head)) && ordinary(squares(tail, after, last))) {
            return false;
        }
        for (k, x) in window.into_iter().enumerate() {
            self.ring[self.place(k)] = x;
        }
        self.mended = (samples - 1) as u8;
        true
    }
}

/// Times that the extreme code of 512 instants comes up in them where it is a rail.
pub const RAIL_HITS: u16 = 5;

/// Least distance between a hop's extremes where one may be a rail, codes: between fewer, noise meets its own extreme again.
pub const SPAN_CODES: i32 = 1024;

/// One extreme of a component in a hop, and the rail it is known to have.
#[derive(Clone, Copy, Debug)]
struct Extreme {
    code: i32,
    /// A code that was a rail, and whether it was not passed since.
    rail: i32,
    holds: bool,
    hits: u16,
}

impl Extreme {
    const NEW: Self = Self { code: 0, rail: 0, holds: false, hits: 0 };

    /// Takes the farthest `code` of a channel in some instants; `far` says how far out it is, as this extreme counts.
    // Copied for each channel it would be long.
    #[inline(never)]
    fn see(&mut self, far: i32, code: i32, channel: usize, frames: &[Frame]) {
        if self.hits > 0 && far < self.code {
            return;
        }
        let hits = frames.iter().filter(|frame| frame.get(channel) == Some(&code)).count() as u16;
        let before = if far == self.code { self.hits } else { 0 };
        (self.code, self.hits) = (far, before.saturating_add(hits));
    }

    /// Instants at the rail in the hop that ends; the next begins.
    fn end(&mut self, instants: u32, span: i32) -> u32 {
        let hits = core::mem::take(&mut self.hits);
        let least = u32::from(RAIL_HITS) * (instants / HOP as u32);
        let met = hits > 0 && u32::from(hits) >= least && span >= SPAN_CODES;
        if met {
            (self.rail, self.holds) = (self.code, true);
        } else if hits > 0 && self.code > self.rail {
            self.holds = false;
        }
        if hits > 0 && self.holds && self.rail == self.code { u32::from(hits) } else { 0 }
    }
}

/// Extremes of every channel, upper and lower.
#[derive(Clone, Debug)]
pub(super) struct Rails([[Extreme; 2]; CHANNELS]);

impl Rails {
    /// Nothing seen; all zeros.
    pub(super) const fn new() -> Self {
        Self([[Extreme::NEW; 2]; CHANNELS])
    }

    /// Takes instants, in which no code is missing.
    pub(super) fn see(&mut self, frames: &[Frame]) {
        let Some(first) = frames.first() else { return };
        let (mut most, mut least) = (*first, *first);
        for frame in frames {
            // Few instants are farther out than all before: the four are looked at together first.
            let out: [bool; CHANNELS] =
                core::array::from_fn(|c| (frame[c] > most[c]) | (frame[c] < least[c]));
            if out.iter().fold(false, |any, out| any | out) {
                most = core::array::from_fn(|c| most[c].max(frame[c]));
                least = core::array::from_fn(|c| least[c].min(frame[c]));
            }
        }
        for (c, ([upper, lower], (most, least))) in self.0.iter_mut().zip(most.iter().zip(&least)).enumerate()
        {
            upper.see(*most, *most, c, frames);
            lower.see(least.saturating_neg(), *least, c, frames);
        }
    }

    /// Samples of each channel at a rail in the hop that ends, which has so many instants of the recording's own rate; the next begins. A
    /// channel that hardly leaves one extreme is stuck and not at a rail; one that goes from one to the other is.
    pub(super) fn end(&mut self, instants: u32) -> [u32; CHANNELS] {
        self.0.each_mut().map(|[upper, lower]| {
            let span = upper.code.saturating_add(lower.code);
            let (upper, lower) = (upper.end(instants, span), lower.end(instants, span));
            if upper.max(lower) < instants / 2 { upper + lower } else { 0 }
        })
    }

    /// What was counted is of a hop that does not end.
    pub(super) fn restart(&mut self) {
        self.0.iter_mut().flatten().for_each(|e| e.hits = 0);
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::vec::Vec;

    /// Gaussian noise of deviation 1000.
    pub(in crate::obs) fn gaussian(seed: &mut u32) -> f32 {
        let mut sum = 0.0;
        for _ in 0..12 {
            *seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            sum += (*seed >> 8) as f32 / 16_777_216.0;
        }
        1000.0 * (sum - 6.0)
    }

    fn run(x: &[Instant]) -> Vec<(Instant, bool)> {
        let mut m = Mender::new();
        x.iter().filter_map(|x| m.push(*x)).collect()
    }

    #[test]
    fn spikes_are_put_right_and_nothing_else_is_touched() {
        let mut seed = 9;
        let clean: Vec<Instant> =
            (0..20_000).map(|_| core::array::from_fn(|_| gaussian(&mut seed))).collect();
        let out = run(&clean);
        assert_eq!(out.len(), clean.len() - Mender::LAG);
        assert!(out.iter().zip(&clean).all(|((y, spike), x)| y == x && !spike), "noise is not touched");
        // Common to all components and weak in each, and strong in one alone.
        for (common, height) in [(true, 8_000.0), (true, 1e6), (false, 15_000.0)] {
            let mut hit = clean.clone();
            let at: Vec<usize> = (500..19_000).step_by(607).collect();
            for k in &at {
                hit[*k].iter_mut().take(if common { 3 } else { 1 }).for_each(|x| *x += height);
            }
            let out = run(&hit);
            let found = at.iter().filter(|k| out[**k].1).count();
            assert!(found * 100 >= at.len() * 90, "{common} {height}: {found} of {}", at.len());
            let left = |k: usize| (0..3).map(|c| (out[k].0[c] - clean[k][c]).abs()).fold(0.0, f32::max);
            assert!(at.iter().filter(|k| out[**k].1).all(|k| left(*k) < 6_000.0));
            assert!((0..out.len()).all(|k| at.contains(&k) || out[k].0 == clean[k]), "only what is a spike");
        }
    }

    #[test]
    fn spikes_of_two_to_eight_samples_are_put_right_and_longer_ones_are_not() {
        let mut seed = 21;
        let clean: Vec<Instant> =
            (0..20_000).map(|_| core::array::from_fn(|_| gaussian(&mut seed))).collect();
        // A plateau, a decay, and one that swings to the other side.
        for shape in [
            &[1.0, 1.0][..],
            &[1.0, 1.0, 1.0],
            &[1.0, 0.5],
            &[1.0, 0.7, 0.4],
            &[1.0, -0.8],
            &[1.0; 5],
            &[1.0; 8],
            &[0.6, 1.0, 0.9, 0.5, 0.3],
            &[1.0, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.25],
        ] {
            for height in [70_000.0, 1e6] {
                let mut hit = clean.clone();
                let at: Vec<usize> = (500..19_000).step_by(607).collect();
                for k in &at {
                    for (n, part) in shape.iter().enumerate() {
                        hit[k + n].iter_mut().for_each(|x| *x += part * height);
                    }
                }
                let out = run(&hit);
                let whole = |k: usize| (k..k + shape.len()).all(|k| out[k].1);
                let found = at.iter().filter(|k| whole(**k)).count();
                assert!(found * 100 >= at.len() * 90, "{shape:?} {height}: {found} of {}", at.len());
                let inside = |k: usize| at.iter().any(|a| (*a..a + shape.len()).contains(&k));
                assert!((0..out.len()).all(|k| inside(k) || out[k].0 == clean[k]), "{shape:?}");
            }
        }
        let mut long = clean.clone();
        (500..510).for_each(|k| long[k].iter_mut().for_each(|x| *x += 1e6));
        assert!(run(&long).iter().zip(&long).all(|((y, spike), x)| y == x && !spike));
    }

    #[test]
    fn a_whale_s_note_and_a_loud_tone_are_no_spikes() {
        let mut seed = 5;
        for hz in [1.5, 3.0, 4.2, 6.0, 8.3, 10.0, 12.0, 16.67, 20.0, 24.0] {
            let x: Vec<Instant> = (0..10_000)
                .map(|k| {
                    // A note of 1 s, 26 dB above the noise, every 10 s.
                    let t = k as f32 / 50.0 % 10.0;
                    let envelope = math::f32::exp(-0.5 * ((t - 5.0) / 0.22) * ((t - 5.0) / 0.22));
                    let s = 20_000.0 * envelope * math::f32::sin(math::f32::TAU * hz * k as f32 / 50.0);
                    [1.0, 0.6, -0.5].map(|a| a * s + gaussian(&mut seed))
                })
                .collect();
            let out = run(&x);
            let touched = out.iter().filter(|(_, spike)| *spike).count();
            assert!(touched <= 2, "{hz} Hz: {touched}");
        }
    }

    #[test]
    fn a_rail_below_full_scale_is_recognised_until_it_is_passed() {
        let (mut rails, mut seed) = (Rails::new(), 3);
        let mut hop = |limit: i32| {
            let frames: Vec<Frame> = (0..HOP)
                .map(|_| {
                    let x = gaussian(&mut seed) as i32;
                    [x.clamp(-limit, limit), x / 100, 77, x]
                })
                .collect();
            // However they are cut.
            frames.chunks(100).for_each(|some| rails.see(some));
            rails.end(HOP as u32)
        };
        assert_eq!(hop(100_000), [0; 4]);
        let [clipped, quiet, stuck, free] = hop(2_000);
        assert!((10..60).contains(&clipped) && quiet == 0 && stuck == 0 && free == 0, "{clipped}");
        assert!(hop(2_000)[0] > 0);
        assert_eq!(hop(100_000)[0], 0);
        assert_eq!(hop(100_000)[0], 0);
        // Most samples at a rail are no stuck channel.
        let [most, ..] = hop(600);
        assert!((HOP / 2..HOP).contains(&(most as usize)), "{most}");
    }
}
