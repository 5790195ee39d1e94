//! Steady noise from one side: what it adds to the intensity of every bin, learned while no vessel is heard.
//!
//! Enters: the mean intensity about the middle of each part of the band, frame by frame ([`Background`](super::background)). Leaves: a bin's
//! intensity without that of the steady noise, and by how much more than stated directions scatter where much of what is heard is such
//! noise. Distant shipping or surf on one side goes with a vessel's sound in every bin and turns its directions towards itself, by degrees
//! where it is as loud; intensities add, so what was there before the vessel is taken out. A line that stands out of the bins about it is
//! straightened by these and left as it is.
//! A vessel that is heard by its wideband sound before it is noticed would be taken for such noise, and its later directions would be pushed ahead
//! of it: what is heard counts ten to twenty minutes after it was, if nothing was noticed until then, and again ten minutes after the last notice.
//! Assumes: noise that changes slowly against 1.5 h. A vessel that is there from the first minute leaves nothing to learn from, nor does traffic
//! without half an hour of silence.

use super::limits::AZIMUTH_BINS;
use super::tonal::Directions;
use crate::math;

/// Intensity of a bin, east and north.
type Vector = [f32; 2];

/// Parts of the band, each with a mean: 3.3 Hz at 50 Hz, of which a frame's mean is.
const PARTS: usize = 4;

/// Bins of a part.
const BINS: usize = AZIMUTH_BINS.div_ceil(PARTS);

/// Frames of silence that a mean counts for from the first: that of a few frames is chance.
const BEFORE: u16 = 16;

/// Frames that a mean is of in the long run (1.5 h at 50 Hz).
const MEMORY: u16 = 512;

/// Frames of silence that are learned together (ten minutes at 50 Hz), once as many later ones are known to be of silence too.
const TOGETHER: u16 = 60;

/// Minutes after a vessel's last in which it may still be heard.
const AFTER_MIN: u8 = 10;

/// Share that a part of a frame has in [`Steady::share`]: three minutes' parts.
const NEWEST: f32 = 1.0 / (18 * PARTS) as f32;

/// Power of a bin over that of the noise about it up to which the noise is not in this bin: one that a filter has cut off before the recorder,
/// at the band's upper end, would point away from the noise.
const ABSENT: f32 = 1.0 / 16.0;

/// What is known of the steady noise.
#[derive(Clone, Debug)]
pub struct Steady {
    mean: [Vector; PARTS],
    /// Its part of the power of the mean intensities of late, 0 to 1.
    share: f32,
    frames: u16,
    /// No vessel and no call was heard in the last minute: its frames are those of the noise.
    learns: bool,
    /// Minutes in which a vessel that was noticed may still be heard.
    after: u8,
    /// What was heard and is not learned yet, the newer first.
    waiting: [Waiting; 2],
}

/// Sums of what was heard.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    sum: [Vector; PARTS],
    frames: u16,
}

impl Waiting {
    const NONE: Self = Self { sum: [[0.0; 2]; PARTS], frames: 0 };
}

/// What a minute holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Minute {
    /// A vessel is heard, or expected.
    Vessel,
    /// Something else that is no noise.
    Other,
    /// Nothing that stands out.
    Silence,
}

fn power([x, y]: Vector) -> f32 {
    x * x + y * y
}

impl Steady {
    /// Nothing learned; all zeros.
    pub const fn new() -> Self {
        Self {
            mean: [[0.0; 2]; PARTS],
            share: 0.0,
            frames: 0,
            learns: false,
            after: 0,
            waiting: [Waiting::NONE; 2],
        }
    }

    /// Ends a minute: whether the next one's frames are kept to be learned from, and whether those kept are.
    pub(super) fn minute(&mut self, minute: Minute) {
        match minute {
            Minute::Vessel => {
                self.waiting = [Waiting::NONE; 2];
                self.after = AFTER_MIN;
            }
            Minute::Other => {}
            Minute::Silence => self.after = self.after.saturating_sub(1),
        }
        self.learns = minute == Minute::Silence && self.after == 0;
        let [newer, older] = self.waiting;
        if newer.frames >= TOGETHER {
            self.learn(&older);
            self.waiting = [Waiting::NONE, newer];
        }
    }

    /// Takes what is known to be of silence into the means.
    fn learn(&mut self, silence: &Waiting) {
        self.frames = (self.frames + silence.frames).min(MEMORY - BEFORE);
        let weight = 1.0 / f32::from(BEFORE + self.frames);
        let share = f32::from(silence.frames) * weight;
        let all = self.mean.iter_mut().flatten().zip(silence.sum.as_flattened());
        all.for_each(|(m, sum)| *m += weight * sum - share * *m);
    }

    /// A frame's mean intensity about a bin.
    #[inline(never)]
    pub(super) fn see(&mut self, bin: usize, around: Vector) {
        if bin % BINS != BINS / 2 {
            return;
        }
        let (Some(mean), [waiting, _]) = (self.mean.get(bin / BINS), &mut self.waiting) else { return };
        let (own, all) = (power(*mean), power(around));
        let part = if own < all { own / all } else { 1.0 };
        self.share += NEWEST * (if own > 0.0 { part } else { 0.0 } - self.share);
        if self.learns
            && let Some(sum) = waiting.sum.get_mut(bin / BINS)
        {
            // The first part counts the frame.
            waiting.frames += u16::from(bin < BINS);
            sum.iter_mut().zip(around).for_each(|(sum, x)| *sum += x);
        }
    }

    /// A bin's intensity without that of the noise; none stays none.
    #[inline(never)]
    pub(super) fn without(&self, bin: usize, own: &Vector) -> Vector {
        let ([x, y], Some([bx, by])) = (*own, self.mean.get(bin / BINS)) else { return *own };
        if power(*own) > ABSENT * power([*bx, *by]) { [x - bx, y - by] } else { *own }
    }

    /// Noise taken out in the mean is there from frame to frame, and what of a bin's directions it throws beyond the limit of a vessel's does not
    /// show in their scatter: with nearly all of it noise directions err by 1.4 times what they would state (measured, a vessel 11 dB below it),
    /// with half of it as they state.
    #[inline(never)]
    pub(super) fn widen(&self, directions: &mut Directions) {
        let factor = math::f32::sqrt(1.0 + self.share * self.share);
        directions.modes.iter_mut().flatten().for_each(|m| m.sd *= factor);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn gaussian(seed: &mut u32) -> f32 {
        let mut sum = -6.0;
        for _ in 0..12 {
            *seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            sum += (*seed >> 8) as f32 / 16_777_216.0;
        }
        sum
    }

    /// Intensities of a frame: noise of power 2 from the east, a vessel of some power from the north, a sea without a direction of power 1.
    fn frame(vessel: f32, seed: &mut u32) -> Vec<Vector> {
        let bin = |_| {
            let mut wave = |power: f32| [(); 2].map(|()| gaussian(seed) * math::f32::sqrt(0.5 * power));
            let (noise, ship) = (wave(2.0), wave(vessel));
            let own = [wave(1.0), wave(1.0), wave(1.0)];
            let pressure = [0, 1].map(|k| noise[k] + ship[k] + own[0][k]);
            let with =
                |w: [f32; 2], own: [f32; 2]| pressure[0] * (w[0] + own[0]) + pressure[1] * (w[1] + own[1]);
            [with(noise, own[1]), with(ship, own[2])]
        };
        (0..AZIMUTH_BINS).map(bin).collect()
    }

    fn see(steady: &mut Steady, bins: &[Vector]) {
        let mut mean = [0.0; 2];
        bins.iter().for_each(|z| mean.iter_mut().zip(z).for_each(|(m, x)| *m += x / bins.len() as f32));
        (0..bins.len()).for_each(|bin| steady.see(bin, mean));
    }

    /// So many minutes of six frames.
    fn minutes(steady: &mut Steady, count: u32, minute: Minute, mut frame: impl FnMut() -> Vec<Vector>) {
        for _ in 0..count {
            steady.minute(minute);
            (0..6).for_each(|_| see(steady, &frame()));
        }
    }

    /// Angle from north of the mean intensity of a vessel's bins in a hundred frames, degrees.
    fn towards(steady: &Steady, seed: &mut u32) -> f32 {
        let frames = (0..100).flat_map(|_| frame(4.0, seed).into_iter().enumerate());
        let all = frames.map(|(bin, own)| steady.without(bin, &own));
        let [x, y] = all.fold([0.0; 2], |[a, b], [x, y]| [a + x, b + y]);
        math::f32::atan2(x, y).to_degrees()
    }

    #[test]
    fn noise_that_was_there_before_a_vessel_bends_its_directions_no_more() {
        let (mut steady, mut seed) = (Steady::new(), 5);
        assert!(towards(&steady, &mut seed) > 20.0);
        minutes(&mut steady, 150, Minute::Silence, || frame(0.0, &mut seed));
        assert!(steady.share > 0.9, "{}", steady.share);
        steady.minute(Minute::Vessel);
        (0..100).for_each(|_| see(&mut steady, &frame(4.0, &mut seed)));
        assert!(towards(&steady, &mut seed).abs() < 3.0, "{}", towards(&steady, &mut seed));
        // Of what is heard a fifth is the noise's: 2² of 2² + 4².
        assert!((steady.share - 0.2).abs() < 0.1, "{}", steady.share);
    }

    #[test]
    fn a_vessel_that_comes_nearer_before_it_is_noticed_is_not_learned_nor_one_that_goes() {
        let (mut steady, mut seed) = (Steady::new(), 11);
        let mut heard = |steady: &mut Steady, count, minute, power| {
            minutes(steady, count, minute, || frame(power, &mut seed));
            steady.mean
        };
        heard(&mut steady, 60, Minute::Silence, 0.0);
        assert!((180..300).contains(&steady.frames), "{}", steady.frames);
        // Minutes in which it is heard and not noticed, an hour in which it is, and some after it: nothing of them is learned.
        for (count, minute) in [(9, Minute::Silence), (60, Minute::Vessel), (9, Minute::Silence)] {
            heard(&mut steady, count, minute, 4.0);
        }
        let after = heard(&mut steady, 18, Minute::Silence, 0.0);
        // The noise is from the east, the vessel from the north.
        assert!(after.iter().all(|[x, y]| (1.5..2.2).contains(x) && y.abs() < 0.05), "{after:?}");
        let frames = steady.frames;
        heard(&mut steady, 20, Minute::Silence, 0.0);
        assert!(steady.frames > frames, "{}", steady.frames);
        // A call is neither learned nor does it undo anything.
        let before = steady.waiting;
        heard(&mut steady, 20, Minute::Other, 9.0);
        assert_eq!(
            (before[0].frames, before[1].frames),
            (steady.waiting[0].frames, steady.waiting[1].frames)
        );
    }

    #[test]
    fn of_a_sea_without_sides_nothing_is_taken_and_nothing_stays_nothing() {
        let (mut steady, mut seed) = (Steady::new(), 8);
        assert_eq!(steady.without(3, &[1.0, 2.0]), [1.0, 2.0]);
        minutes(&mut steady, 160, Minute::Silence, || {
            (0..AZIMUTH_BINS).map(|_| [gaussian(&mut seed), gaussian(&mut seed)]).collect()
        });
        assert!(steady.frames > 300, "{}", steady.frames);
        assert!(steady.mean.iter().all(|m| power(*m) < 1e-4) && steady.share < 0.05, "{steady:?}");
        assert_eq!(steady.without(3, &[0.0; 2]), [0.0; 2]);
        // Of a bin that hardly has anything neither.
        steady.mean = [[1.0, 0.0]; PARTS];
        assert_eq!(steady.without(260, &[0.0, 0.2]), [0.0, 0.2]);
        assert_eq!(steady.without(260, &[2.0, 1.0]), [1.0, 1.0]);
        let mode = crate::obs::tonal::Mode {
            azimuth: 1.0,
            sd: 0.02,
            log_presence: 20.0,
            bins: 9,
            step: 3,
            impulsive: false,
            moved: None,
        };
        let mut directions =
            Directions { modes: [Some(mode), None, None], log_presence: 20.0, log_below: 0.0, frames: 17 };
        steady.share = 1.0;
        steady.widen(&mut directions);
        assert!((directions.modes[0].unwrap().sd - 0.028_28).abs() < 1e-4);
    }
}
