//! How the lines that come from a direction move from minute to minute: the fall of their frequency as their vessel passes.
//!
//! Enters: pressure in every bin of the tone band, frame by frame, and a minute's directions with the bins that each is of. Leaves: by how much
//! the lines of a direction have moved since the minute before, relative to their frequency. A line fills a bin or three with one
//! frequency, which the advance of the phase from frame to frame tells to a twentieth of a bin; where it is steady over a minute the bin has a
//! line. What a line's frequency is need not be known, so its change alone is told.
//! Assumes: frames that follow one another by half their length. Cost: 30 k instructions a frame, 60 k a minute with a vessel.

use super::azigram::{Band, turns};
use super::cauchy::distance;
use super::limits::AZIMUTH_BINS;
use super::shared::Tonal;
use super::tonal::{Directions, SAME_VESSEL};
use crate::math;

/// Length of one frame's phasor in a sum; so many frames fit into it.
const UNIT: f32 = 12.0;
const MOST_FRAMES: u8 = 10;

/// Fewest frames of a minute that tell a frequency.
const LEAST_FRAMES: u8 = 3;

/// Share of the whole length that a sum of phasors has where there is a line: six of noise have it once in fifty minutes.
const STEADY: f32 = 0.8;

/// Steps of an advance of the phase in a turn, and the code that says that there is no line.
const TURN: i16 = 254;
const NO_LINE: i8 = i8::MIN;

/// Bins with a line that a direction needs: those of one.
const LEAST_BINS: u16 = 3;

/// Error of one bin's move, relative: from three times as much on it is taken for another vessel's.
const ERROR: f32 = 1e-4;

/// Times that the mean of the bins is taken anew with weights by how far each is from it.
const ROUNDS: u8 = 4;

/// What the frames of a minute have told so far, and the minute before.
#[derive(Clone, Debug)]
pub(super) struct Lines {
    /// Phase of each bin in the newest frame, in 256ths of a turn.
    phase: [u8; AZIMUTH_BINS],
    /// Phasors of its advances since the minute before, summed.
    sum: [[i8; 2]; AZIMUTH_BINS],
    /// Mean advance in the minute before, in [`TURN`]ths of a turn.
    before: [i8; AZIMUTH_BINS],
    /// Advances summed.
    frames: u8,
}

impl Lines {
    /// Nothing heard, to be [`interrupted`](Self::interrupted) before the first frame; all zeros.
    pub(super) const fn new() -> Self {
        Self { phase: [0; AZIMUTH_BINS], sum: [[0; 2]; AZIMUTH_BINS], before: [0; AZIMUTH_BINS], frames: 0 }
    }

    /// What is heard next does not follow what was heard before.
    pub(super) fn interrupted(&mut self) {
        self.sum.fill([0; 2]);
        self.before.fill(NO_LINE);
        self.frames = 0;
    }

    /// Takes a frame's pressure, real and imaginary, in the bins of the band; `follows` says whether the last frame was half a frame before.
    pub(super) fn frame(&mut self, band: &Band, pressure: &[[f32; 2]], follows: bool) {
        let adds = follows && self.frames < MOST_FRAMES;
        self.frames += u8::from(adds);
        let bins = pressure.iter().zip(self.phase.iter_mut().zip(&mut self.sum));
        for (f, ([re, im], (phase, sum))) in bins.enumerate() {
            // One turn more, so that what is cut to a whole code is never negative.
            let code = math::whole((turns(*im, *re) + 1.0) * 256.0 + 0.5) as u8;
            // In half a frame the middle of bin k turns k/2 times.
            let half = if (band.first_bin + f).is_multiple_of(2) { 0 } else { 128 };
            let advance = code.wrapping_sub(*phase).wrapping_add(half);
            *phase = code;
            if adds {
                let (s, c) = math::f32::sin_cos(f32::from(advance) * (math::f32::TAU / 256.0));
                let [x, y] = sum;
                *x += math::f32::round(UNIT * c) as i8;
                *y += math::f32::round(UNIT * s) as i8;
            }
        }
    }

    /// Ends a minute: gives each of its directions, found in `s`, by how much its lines have moved since the minute before.
    // Called from `report`, whose stack lies below that of the tracks.
    #[inline(never)]
    pub(super) fn minute(&mut self, band: &Band, s: &Tonal, directions: &mut Directions) {
        let frames = core::mem::take(&mut self.frames);
        let least = STEADY * UNIT * f32::from(frames);
        let mut moved = [NO_LINE; AZIMUTH_BINS];
        for ((sum, before), moved) in self.sum.iter_mut().zip(&mut self.before).zip(&mut moved) {
            let [x, y] = core::mem::take(sum).map(f32::from);
            let line = frames >= LEAST_FRAMES && x * x + y * y > least * least;
            let now = if line { math::f32::round(turns(y, x) * f32::from(TURN)) as i8 } else { NO_LINE };
            if line && *before != NO_LINE {
                let apart = i16::from(now) - i16::from(*before);
                *moved = ((apart + 3 * TURN / 2) % TURN - TURN / 2) as i8;
            }
            *before = now;
        }
        // A turn more in half a frame is two bins.
        let unit = 2.0 / f32::from(TURN);
        for mode in directions.modes.iter_mut().flatten() {
            mode.moved = mean(s, usize::from(mode.step), band, unit, &moved);
        }
    }
}

/// Mean relative move of the bins of a direction, higher ones weighing more; `None` of too few.
fn mean(s: &Tonal, step: usize, band: &Band, unit: f32, moved: &[i8; AZIMUTH_BINS]) -> Option<f32> {
    let bins = moved.iter().zip(&s.best).zip(s.free.iter().zip(&s.peak)).enumerate().take(band.bins);
    let own = bins.filter(|(_, ((moved, best), (free, peak)))| {
        **moved != NO_LINE
            && **free == 0
            && **peak > 0.0
            && distance(usize::from(**best), step) <= SAME_VESSEL
    });
    let own = own.map(|(f, ((moved, _), _))| {
        let bin = (band.first_bin + f) as f32;
        (bin, f32::from(*moved) * unit / bin)
    });
    let (mut value, mut narrow, mut used) = (0.0, 0.1, 0u16);
    for _ in 0..ROUNDS {
        let (mut weights, mut sum) = (0f32, 0f32);
        used = 0;
        for (bin, moved) in own.clone() {
            let off = (moved - value) * (1.0 / ERROR);
            let weight = bin * bin / (1.0 + narrow * off * off);
            used += u16::from(off * off < 9.0);
            (weights, sum) = (weights + weight, sum + weight * moved);
        }
        if weights <= 0.0 {
            return None;
        }
        (value, narrow) = (sum / weights, 1.0);
    }
    (used >= LEAST_BINS).then_some(value)
}

#[cfg(test)]
mod tests {
    use super::super::limits::AZIMUTH_MODES;
    use super::super::shared::Shared;
    use super::super::tonal::Mode;
    use super::*;

    const BAND: Band = Band { first_bin: 225, bins: AZIMUTH_BINS, turn: 0.0, paper: false };

    /// Pressure in the band of a frame that begins `hop` hops after the start, of lines at such frequencies in bins, which all fall by `fall` of
    /// themselves in a hop, and of noise.
    fn pressure(lines: &[f32], fall: f64, hop: u32, seed: &mut u32) -> std::vec::Vec<[f32; 2]> {
        (0..AZIMUTH_BINS)
            .map(|f| {
                let mut out = [0, 1].map(|_| 0.03e-3 * super::super::mend::tests::gaussian(seed));
                for line in lines {
                    let h = f64::from(hop);
                    let offset = f64::from(*line) * (1.0 - fall * h) - (BAND.first_bin + f) as f64;
                    // A Hann window's line, near enough.
                    let height =
                        if offset.abs() < 2.0 { (0.25 * core::f64::consts::PI * offset).cos() } else { 0.0 };
                    let turns = 0.5 * f64::from(*line) * (h - 0.5 * fall * h * h);
                    let angle = core::f64::consts::TAU * turns.fract();
                    out[0] += (height * angle.cos()) as f32;
                    out[1] += (height * angle.sin()) as f32;
                }
                out
            })
            .collect()
    }

    fn directions() -> Directions {
        let mode = Mode {
            azimuth: 0.0,
            sd: 0.01,
            log_presence: 20.0,
            bins: 9,
            step: 40,
            impulsive: false,
            moved: None,
        };
        let mut modes = [None; AZIMUTH_MODES];
        modes[0] = Some(mode);
        Directions { modes, log_presence: 20.0, log_below: 0.0, frames: 17 }
    }

    fn heard(lines: &[f32], fall: f64) -> std::vec::Vec<Option<f32>> {
        let (mut state, mut seed) = (Lines::new(), 7);
        state.interrupted();
        let mut shared = Shared::new();
        let s = shared.tonal();
        (s.best, s.free) = ([40; AZIMUTH_BINS], [0; AZIMUTH_BINS]);
        s.peak = [5.0; AZIMUTH_BINS];
        let mut told = std::vec::Vec::new();
        for hop in 0..60 {
            state.frame(&BAND, &pressure(lines, fall, hop, &mut seed), hop > 0);
            if hop % 6 == 5 {
                let mut directions = directions();
                state.minute(&BAND, shared.tonal(), &mut directions);
                told.push(directions.modes[0].unwrap().moved);
            }
        }
        told
    }

    #[test]
    fn lines_that_fall_are_told_by_how_much() {
        // Beside bins and between them; six hops are a minute.
        for fall in [0.0, 3e-5, -5e-5] {
            for lines in [&[240.0f32, 300.3, 411.5][..], &[280.4]] {
                let told = heard(lines, fall);
                assert!(told[0].is_none(), "there is no minute before the first");
                for moved in told.iter().skip(2).map(|m| m.unwrap()) {
                    assert!((f64::from(moved) + 6.0 * fall).abs() < 6e-5, "{fall} {lines:?}: {moved}");
                }
            }
        }
    }

    #[test]
    fn noise_has_no_lines_and_a_lost_frame_no_advance() {
        assert!(heard(&[], 0.0).iter().all(|m| m.is_none_or(|m| m.abs() < 2e-4)));
        assert!(heard(&[], 0.0).iter().filter(|m| m.is_some()).count() <= 3);
        let (mut state, mut seed) = (Lines::new(), 7);
        for hop in 0..6 {
            state.frame(&BAND, &pressure(&[300.0], 0.0, hop, &mut seed), false);
        }
        assert_eq!(state.frames, 0);
        assert!(state.sum.iter().all(|s| *s == [0, 0]));
    }
}
