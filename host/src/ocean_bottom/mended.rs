//! Samples of a run as the recorder takes them: spikes put right by its own hand (`core/src/obs/mend.rs`), and which samples are clipped.
//!
//! Enters: frames, pressure, north and east first, with gaps told. Leaves: the frames held, of which all but the last few are as they stay;
//! of any stretch of them the components that are at a limit, instant by instant.

use seabearing_core::block::{CHANNELS, Frame, MISSING};
use seabearing_core::obs::limits::USED_CHANNELS;
use seabearing_core::obs::mend::{Mender, RAIL_HITS, SPAN_CODES};

/// Frames that follow each other.
pub(crate) struct Mended {
    frames: Vec<Frame>,
    /// Index of the first held.
    first: u64,
    mender: Mender,
    /// The last code of each component that was there.
    last: [i32; USED_CHANNELS],
    /// Instants put right so far.
    pub(super) spikes: u64,
}

impl Mended {
    /// Nothing held.
    pub(crate) fn new() -> Self {
        Self { frames: Vec::new(), first: 0, mender: Mender::new(), last: [0; USED_CHANNELS], spikes: 0 }
    }

    /// Index of the first instant held.
    pub(crate) fn first(&self) -> u64 {
        self.first
    }

    /// Index after the last instant held.
    pub(super) fn end(&self) -> u64 {
        self.first + self.frames.len() as u64
    }

    /// What comes next begins at an index that does not follow: what is held is dropped.
    pub(crate) fn restart(&mut self, index: u64) {
        self.frames.clear();
        self.first = index;
        self.mender.restart();
    }

    /// Takes frames that follow those held. A component without a code stands still for the mender, and stays without.
    pub(crate) fn extend(&mut self, frames: &[Frame]) {
        for frame in frames {
            self.frames.push(*frame);
            for (last, code) in self.last.iter_mut().zip(frame).filter(|(_, code)| **code != MISSING) {
                *last = *code;
            }
            let Some((mended, true)) = self.mender.push(self.last.map(|code| code as f32)) else { continue };
            self.spikes += 1;
            let at = self.frames.len().checked_sub(1 + Mender::LAG);
            let Some(frame) = at.and_then(|at| self.frames.get_mut(at)) else { continue };
            for (code, x) in frame.iter_mut().zip(mended).filter(|(code, _)| **code != MISSING) {
                *code = x.round() as i32;
            }
        }
    }

    /// What is held and stays as it is: all of it where the run has `ended`.
    pub(crate) fn settled(&self, ended: bool) -> &[Frame] {
        let open = if ended { 0 } else { Mender::LAG };
        self.frames.get(..self.frames.len().saturating_sub(open)).unwrap_or_default()
    }

    /// Drops what is before an index.
    pub(crate) fn drop_before(&mut self, index: u64) {
        let done = (index.saturating_sub(self.first) as usize).min(self.frames.len());
        self.frames.drain(..done);
        self.first += done as u64;
    }
}

/// Bit c of each instant: component c is clipped there, at the converter's full scale or at a rail below it, which is the extreme code of
/// these frames and comes up in them more often than a sound's would.
pub(super) fn clipped(frames: &[Frame], full_scale: i32) -> Vec<u8> {
    let mut out = vec![0; frames.len()];
    for c in 0..CHANNELS {
        let codes = || frames.iter().map(|f| f[c]).filter(|code| *code != MISSING);
        let Some((least, most)) = codes().min().zip(codes().max()) else { continue };
        let often = |rail: i32| {
            let hits = codes().filter(|code| *code == rail).count();
            // What hardly leaves its extreme is stuck and not clipped.
            hits >= usize::from(RAIL_HITS) && 2 * hits < frames.len()
        };
        let wide = most.saturating_sub(least) >= SPAN_CODES;
        let (upper, lower) = (wide && often(most), wide && often(least));
        let limit = full_scale.saturating_sub(1);
        for (bits, code) in out.iter_mut().zip(frames.iter().map(|f| f[c])).filter(|(_, c)| *c != MISSING) {
            let full = code >= limit || code <= -limit;
            *bits |= u8::from(full || upper && code == most || lower && code == least) << c;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise of about 600 codes, alike in nothing.
    fn noise(n: usize) -> Vec<Frame> {
        let mut seed = 7u32;
        let mut next = || {
            (0..12)
                .map(|_| {
                    seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (seed >> 22) as i32 - 512
                })
                .sum::<i32>()
        };
        (0..n).map(|_| [next(), next(), next(), next()]).collect()
    }

    #[test]
    fn spikes_are_put_right_however_blocks_are_cut_and_missing_codes_stay() {
        let clean = noise(3000);
        let mut hit = clean.clone();
        for k in (200..2900).step_by(350) {
            hit[k].iter_mut().for_each(|code| *code += 50_000);
        }
        hit.iter_mut().for_each(|f| f[2] = MISSING);
        let mended = |length: usize| {
            let mut m = Mended::new();
            hit.chunks(length).for_each(|some| m.extend(some));
            (m.settled(true).to_vec(), m.spikes)
        };
        let (frames, spikes) = mended(3000);
        assert_eq!(spikes, 8);
        assert_eq!(mended(77), (frames.clone(), 8));
        for (k, (f, c)) in frames.iter().zip(&clean).enumerate() {
            assert!((f[0] - c[0]).abs() < 6_000 && (f[1] - c[1]).abs() < 6_000 && f[2] == MISSING, "{k}");
        }
        // After a gap what was before is no neighbour.
        let mut m = Mended::new();
        m.extend(&clean[..100]);
        assert_eq!((m.settled(false).len(), m.end()), (100 - Mender::LAG, 100));
        m.restart(500);
        m.extend(&clean[500..700]);
        m.drop_before(600);
        assert_eq!((m.first(), m.settled(true)), (600, &clean[600..700]));
    }

    #[test]
    fn what_is_at_a_limit_is_clipped_and_what_only_comes_near_is_not() {
        let mut frames = noise(9000);
        frames.iter_mut().for_each(|f| f[1] = f[1].clamp(-1500, 8_388_607));
        frames[40][0] = 8_388_607;
        frames.iter_mut().for_each(|f| f[2] = 5);
        let bits = clipped(&frames, 8_388_607);
        for (k, (bits, f)) in bits.iter().zip(&frames).enumerate() {
            let own = u8::from(k == 40) | u8::from(f[1] == -1500) << 1;
            assert_eq!(*bits, own, "{k}");
        }
        assert!(bits.iter().filter(|b| **b == 2).count() > 50);
    }
}
