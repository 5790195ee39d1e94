//! Snaps, clicks and explosions kept out of the frames: a sound of milliseconds thirty times as strong as the sea would take
//! the bearing of a second with it, and one of a second would be taken for a vessel.
//!
//! Enters: a full frame of codes, and bounds on their magnitudes. Leaves: the frame with each channel's impulses blanked, or
//! the word that the frame as a whole is a burst. Each channel is measured by its own usual power, a median over some seconds
//! of the frames' powers, which rises and falls by at most 6 dB a second: a passing vessel is slower.
//!
//! * Blanked: what exceeds [`BLANK`] standard deviations of the frame without its impulses (or of the usual power, if that is
//!   more), with [`BEFORE`] samples before and [`AFTER`] behind, where anything exceeds five of them, or four and a half where
//!   another channel or the frame before has heard an impulse. One that rings beyond its frame is blanked in the next.
//! * Burst: a frame with [`BURST`] times the usual power that is no impulse, on two channels at least.
//!
//! A vessel's own beat stays within both: its loud moments are of two or three times its mean power. Cost: about 150
//! instructions a frame; 8000 for each channel of a frame that holds an impulse.

use super::plan::{FRAME, HOP, Plan};
use super::transients::Outstanding;
use crate::block::CHANNELS;
use crate::math::f32 as m;

/// Standard deviations that an impulse exceeds. One shorter than [`GLANCE_EVERY`] samples and weaker than twice the limit may
/// be overlooked, and one within the shared samples of the first frame of a run. Four channels at 64 kHz exceed it by chance
/// every seven seconds, and lose a thousandth of a second.
const IMPULSE: f32 = 5.0;
/// What is told of exceeds this: by chance every half an hour.
pub(super) const TOLD: f32 = 6.0;
/// The same where another channel, or the frame before, has heard one: by chance a snap that stands out on one hydrophone does
/// not on the next.
pub(super) const NEAR: f32 = 4.5;
/// Of so many samples not shared with the frame before one is glanced at, where the bound on a frame's magnitudes does not
/// tell that there is no impulse.
const GLANCE_EVERY: usize = 4;
/// Samples glanced at in one piece, as the compiler unrolls it.
const GLANCE: usize = 32;
/// Standard deviations beyond which a sample is blanked where there is an impulse.
const BLANK: f32 = 4.0;
/// Samples blanked before and behind: the rise of a snap, and of what a steep filter of linear phase makes of it, and its ringing below
/// the limit, of 0.4 ms in each neper.
const BEFORE: usize = 24;
const AFTER: u8 = 64;
/// Power over the usual one of a burst (12 dB).
const BURST: f32 = 16.0;
/// Channels that must hear a burst: one alone is sick.
const HEARD_BY: usize = 2;
/// Share by which the usual power may change in a second (6 dB).
const CHANGE_A_SECOND: f32 = 1.4;
/// Share of a frame's mean in the constant part.
const CONSTANT_SHARE: f32 = 1.0 / 16.0;
/// Looks at a frame's scale, each limited at three times the one before: more than a third of impulses would not do.
const LOOKS: usize = 4;
/// Of so many samples one is looked at for it.
const LOOK_EVERY: usize = 4;
/// Mean magnitude of a normal number.
const MEAN_MAGNITUDE: f32 = 0.797_885;

/// What is known of the channels.
#[derive(Clone, Debug)]
pub(crate) struct Impulses {
    /// Usual power of each channel, codes²; 0 before the first frame.
    usual: [f32; CHANNELS],
    /// Constant part of each channel, codes: the mean of frames in which nothing stands out.
    constant: [f32; CHANNELS],
    /// Samples of each channel behind the newest frame in which an impulse of it rings.
    rings: [u8; CHANNELS],
    /// Whether the frame before held an impulse.
    near: bool,
    /// Frames with impulses or bursts that have not been told.
    frames: u32,
    /// [`crate::intake::Intake::elapsed`] when they were told last.
    told: Option<u64>,
}

impl Impulses {
    pub(crate) const fn new() -> Self {
        Self {
            usual: [0.0; CHANNELS],
            constant: [0.0; CHANNELS],
            rings: [0; CHANNELS],
            near: false,
            frames: 0,
            told: None,
        }
    }

    /// Blanks what is no steady sound, after `see` has seen it. True where the frame as a whole is a burst. `rough` is each
    /// channel's mean and power as some of the samples show them, `loudest` a bound on each channel's magnitudes, `dead` (bit c)
    /// the channels that tell nothing.
    pub(crate) fn take(
        &mut self,
        plan: &Plan,
        codes: &mut [[i32; FRAME]; CHANNELS],
        rough: &[(f32, f32); CHANNELS],
        loudest: &[i32; CHANNELS],
        dead: u8,
        see: impl FnOnce(&[[i32; FRAME]; CHANNELS], &Outstanding),
    ) -> bool {
        let mut found = [Found::Nothing; CHANNELS];
        let mut ringing = [0u8; CHANNELS];
        let (mut of, mut limit, mut heard) = (!dead, if self.near { NEAR } else { IMPULSE }, 0u8);
        loop {
            let channels = codes.iter().zip(rough).zip(loudest).zip(self.usual.iter().zip(&mut self.rings));
            let channels = channels.zip(found.iter_mut().zip(&mut ringing)).enumerate();
            for (c, ((((codes, (mean, power)), loudest), (usual, rings)), (found, ringing))) in
                channels.filter(|(c, _)| of >> c & 1 == 1)
            {
                let usual = if *usual > 0.0 { *usual } else { *power };
                let most = *loudest as f32 + m::abs(*mean);
                if *rings > 0 || most * most > limit * limit * usual {
                    *ringing = core::mem::take(rings);
                    *found = examine(codes, *mean, usual, limit, *ringing > 0);
                    heard |= u8::from(matches!(found, Found::Impulse { .. })) << c;
                }
            }
            if heard == 0 || limit <= NEAR {
                break;
            }
            // What stands out on one channel may less on another.
            (of, limit) = (!(dead | heard), NEAR);
        }
        self.near = heard != 0;
        let bursts = found.iter().filter(|f| matches!(f, Found::Burst { .. })).count();
        let burst = bursts >= HEARD_BY;
        let known = self.constant.iter_mut().zip(rough).zip(self.usual.iter().zip(&found));
        for ((constant, (mean, _)), (usual, found)) in known {
            if *usual <= 0.0 {
                *constant = *mean;
            } else if matches!(found, Found::Nothing) {
                *constant += CONSTANT_SHARE * (mean - *constant);
            }
        }
        // A loud frame's own mean may be anything.
        let constant = self.constant.map(|x| x as i32);
        see(codes, &Outstanding { constant, sd: found.map(Found::sd), burst });
        let mut strong = false;
        if heard != 0 {
            let channels = codes.iter_mut().zip(rough).zip(&found).zip(ringing.iter().zip(&mut self.rings));
            for (((codes, (mean, _)), found), (ringing, rings)) in channels {
                if let Found::Impulse { scale, told } = found {
                    strong |= told;
                    *rings = blank(codes, *mean as i32, *scale, *ringing);
                }
            }
        }
        let change = CHANGE_A_SECOND * HOP as f32 / plan.rate_hz;
        let known = self.usual.iter_mut().zip(rough).enumerate();
        for (_, (usual, (_, power))) in known.filter(|(c, _)| dead >> c & 1 == 0) {
            if *usual <= 0.0 {
                *usual = *power;
            }
            let step = if power > usual { 1.0 + change } else { 1.0 - change };
            *usual = (*usual * step).max(f32::MIN_POSITIVE);
        }
        self.frames = self.frames.saturating_add(u32::from(strong || burst));
        burst
    }

    /// How many frames held impulses since they were last told, where that is due: at once and then once a minute.
    pub(crate) fn due(&mut self, elapsed: u64, minute: u64) -> Option<u32> {
        let due = self.told.is_none_or(|told| elapsed.saturating_sub(told) >= minute);
        if self.frames == 0 || !due {
            return None;
        }
        self.told = Some(elapsed);
        Some(core::mem::take(&mut self.frames))
    }
}

/// What a channel's frame holds.
#[derive(Clone, Copy, Debug)]
enum Found {
    Nothing,
    Impulse {
        /// Standard deviation that it is measured by, codes.
        scale: f32,
        /// Strong enough to be told of.
        told: bool,
    },
    Burst {
        /// The usual standard deviation, codes.
        usual: f32,
    },
}

impl Found {
    /// What it is measured by; 0 where there is nothing.
    fn sd(self) -> f32 {
        match self {
            Self::Nothing => 0.0,
            Self::Impulse { scale, .. } => scale,
            Self::Burst { usual } => usual,
        }
    }
}

/// Whether one of the samples glanced at is farther than `limit` from `quiet`.
fn glance(codes: &[i32; FRAME], quiet: i32, limit: f32) -> bool {
    // One comparison for both signs.
    let (least, most) = (quiet.wrapping_sub(limit as i32), 2 * (limit as u32));
    const { assert!(FRAME.is_multiple_of(GLANCE) && (FRAME - HOP).is_multiple_of(GLANCE)) };
    let pieces = codes.as_chunks::<GLANCE>().0.iter();
    pieces
        .skip((FRAME - HOP) / GLANCE)
        .any(|piece| piece.iter().step_by(GLANCE_EVERY).any(|x| x.wrapping_sub(least) as u32 > most))
}

/// Sum of the magnitudes of some of the samples, each up to a limit.
#[inline(never)]
fn limited(codes: &[i32; FRAME], mean: f32, limit: f32) -> f32 {
    let some = codes.iter().step_by(LOOK_EVERY);
    some.map(|x| m::abs(*x as f32 - mean).min(limit)).sum()
}

/// Whether a sample is farther than `limit` from `quiet`.
#[inline(never)]
fn beyond(codes: &[i32; FRAME], quiet: i32, limit: u32) -> bool {
    codes.iter().any(|x| x.abs_diff(quiet) > limit)
}

/// Whether there is an impulse beyond `limit` standard deviations, or one that rings on, or a burst. Apart: most frames have
/// none.
#[inline(never)]
fn examine(codes: &[i32; FRAME], mean: f32, usual: f32, limit: f32, rings: bool) -> Found {
    let quiet = mean as i32;
    let beyond = |limit: f32| beyond(codes, quiet, limit as u32);
    let seen = if limit < IMPULSE {
        beyond(limit * m::sqrt(usual))
    } else {
        glance(codes, quiet, limit * m::sqrt(usual))
    };
    if !rings && !seen {
        return Found::Nothing;
    }
    let mut scale = f32::MAX;
    for _ in 0..LOOKS {
        scale = limited(codes, mean, 3.0 * scale) * (LOOK_EVERY as f32 / (FRAME as f32 * MEAN_MAGNITUDE));
    }
    if scale * scale > BURST * usual {
        return Found::Burst { usual: m::sqrt(usual) };
    }
    let scale = m::sqrt(usual.max(scale * scale));
    if !rings && !beyond(limit * scale) {
        return Found::Nothing;
    }
    Found::Impulse { scale, told: beyond(TOLD * scale) }
}

/// Blanks the impulses of a channel; `ringing` is how far one of the frame before rings beyond that. How far one of this frame
/// does.
#[inline(never)]
fn blank(codes: &mut [i32; FRAME], quiet: i32, scale: f32, ringing: u8) -> u8 {
    let least = (BLANK * scale) as u32;
    let far = |x: &i32| x.abs_diff(quiet) > least;
    // The last sample beyond the limit before each, forwards and then backwards.
    let mut left = [0u8; FRAME];
    let mut after = 0;
    for (n, (left, x)) in left.iter_mut().zip(codes.iter()).enumerate() {
        if n == FRAME - HOP {
            // What is shared with the frame before was blanked there.
            after = after.max(ringing);
        }
        after = if far(x) { AFTER + 1 } else { after };
        *left = u8::from(after > 0);
        after = after.saturating_sub(1);
    }
    let rings = after;
    let mut before = 0;
    for (left, x) in left.iter().zip(codes.iter_mut()).rev() {
        before = if far(x) { BEFORE + 1 } else { before };
        if *left != 0 || before > 0 {
            *x = quiet;
        }
        before = before.saturating_sub(1);
    }
    rings
}

#[cfg(test)]
mod tests {
    use super::super::test_sea::{Normal, error, hear, plan, sea};
    use super::*;
    use crate::array::wavefront;
    use crate::wire::FaultCode;

    fn frame(seed: u32) -> [i32; FRAME] {
        let mut x = seed;
        core::array::from_fn(|_| {
            let mut sum = 0;
            for _ in 0..12 {
                x = x.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                sum += (x >> 16) as i32;
            }
            // Standard deviation 1000 about 500.
            500 + (sum - 12 * 32_768) * 1000 / 65_536
        })
    }

    fn take(impulses: &mut Impulses, codes: &mut [[i32; FRAME]; CHANNELS]) -> bool {
        let rough = codes.map(|c| {
            let n = FRAME as f32;
            let mean = c.iter().map(|x| *x as f32).sum::<f32>() / n;
            (mean, c.iter().map(|x| (*x as f32 - mean).powi(2)).sum::<f32>() / n)
        });
        let loudest = codes.map(|c| c.iter().fold(0, |a, x| a | (x ^ (x >> 31))));
        impulses.take(&plan(64_000.0), codes, &rough, &loudest, 0, |_, _| {})
    }

    #[test]
    fn a_snap_is_blanked_on_its_channel_and_noise_is_left_alone() {
        let mut impulses = Impulses::new();
        for seed in 0..400 {
            let clean: [[i32; FRAME]; CHANNELS] = core::array::from_fn(|c| frame(seed * 4 + c as u32));
            let mut codes = clean;
            if seed >= 50 && seed % 5 == 0 {
                for (k, x) in codes[2].iter_mut().skip(200).take(60).enumerate() {
                    *x += (30_000.0 * (-(k as f32) / 12.0).exp() * (0.9 * k as f32).cos()) as i32;
                }
            }
            let snapped = codes[2] != clean[2];
            assert!(!take(&mut impulses, &mut codes));
            assert!(codes.iter().zip(&clean).enumerate().all(|(c, (a, b))| a == b || (snapped && c == 2)));
            if snapped {
                assert!(codes[2].iter().all(|x| (x - 500).abs() < 5500), "{:?}", codes[2].iter().max());
                let kept = codes[2].iter().zip(&clean[2]).filter(|(a, b)| a == b).count();
                assert!(kept > 320, "{kept}");
            }
        }
        assert_eq!(impulses.frames, 70);
    }

    #[test]
    fn a_burst_is_one_until_it_lasts_and_a_louder_sea_is_none() {
        let mut impulses = Impulses::new();
        let mut bursts = 0;
        for seed in 0..1400 {
            // 20 dB for one second, 9 dB for good, at 143 frames a second.
            let gain = match seed {
                300..443 => 10,
                800.. => 3,
                _ => 1,
            };
            let mut codes: [[i32; FRAME]; CHANNELS] =
                core::array::from_fn(|c| frame(seed * 4 + c as u32).map(|x| gain * x));
            bursts += u32::from(take(&mut impulses, &mut codes));
        }
        assert!((100..=143).contains(&bursts), "{bursts}");
    }

    /// Snaps of a millisecond, 30 times the noise at their peak, each from a direction of its own.
    fn snapped(plan: &Plan, sea: &mut [[f64; CHANNELS]], a_second: f64) {
        let mut random = Normal(3);
        let rate = f64::from(plan.rate_hz());
        let mut t = 0.05;
        while t < sea.len() as f64 / rate - 0.1 {
            let u = [random.next(), random.next(), random.next()];
            let length = u.iter().map(|x| x * x).sum::<f64>().sqrt();
            let u = u.map(|x| (x / length) as f32);
            let arrivals = wavefront::arrivals(plan.geometry(), &u, 0.0);
            for (c, late) in arrivals.iter().enumerate() {
                let start = (t + f64::from(*late)) * rate;
                for k in 0..(0.002 * rate) as usize {
                    let at = start.ceil() + k as f64;
                    let x = (at - start) / rate;
                    sea[at as usize][c] +=
                        30.0 * (-x / 4e-4).exp() * (core::f64::consts::TAU * 3000.0 * x).cos();
                }
            }
            // Between half and one and a half of the mean interval.
            t += (1.0 + 0.5 * random.next().clamp(-1.0, 1.0)) / a_second;
        }
    }

    #[test]
    fn snaps_neither_turn_a_bearing_nor_blur_it() {
        let plan = plan(64_000.0);
        for snr_db in [10.0, 0.0] {
            let quiet = sea(&plan, snr_db, 31);
            let rms = |sea: &[[f64; CHANNELS]]| {
                let heard = hear(&plan, sea);
                let whole: std::vec::Vec<_> = heard.bearings.iter().filter(|b| b.band == 0).collect();
                let far = heard.bearings.iter().filter(|b| error(b).0.abs() > 5f64.to_radians()).count();
                let square = whole.iter().map(|b| error(b).0.powi(2)).sum::<f64>();
                let told = heard.faults.iter().map(|f| f.0).all(|code| code == FaultCode::Impulses);
                assert!(told, "{:?}", heard.faults);
                ((square / whole.len() as f64).sqrt().to_degrees(), far, whole.len(), heard.faults.len())
            };
            let (without, _, n, _) = rms(&quiet);
            for a_second in [5.0, 20.0] {
                let mut sea = quiet.clone();
                snapped(&plan, &mut sea, a_second);
                let (with, far, heard, told) = rms(&sea);
                std::println!(
                    "{a_second} snaps a second, vessel at {snr_db} dB: azimuth RMSE {with:.4} for {without:.4} degrees, \
                     {far} beyond 5 degrees, {heard} bearings of {n}"
                );
                assert!(far == 0 && with <= 1.5 * without && heard + 1 >= n && told > 0);
            }
        }
    }

    #[test]
    fn explosions_and_clicks_are_no_vessels() {
        let plan = plan(16_000.0);
        let rate = f64::from(plan.rate_hz());
        // Three seconds apart, 40 dB and 0.6 s long, from one direction; clicks between them.
        let mut random = Normal(8);
        let mut sea: std::vec::Vec<[f64; CHANNELS]> =
            (0..60 * rate as usize).map(|_| core::array::from_fn(|_| random.next())).collect();
        let arrivals = wavefront::arrivals(plan.geometry(), &[0.0, 1.0, 0.0], 0.0);
        let later = arrivals.map(|t| (f64::from(t) * rate).round() as i64);
        for start in (3..57).step_by(3) {
            let sound: std::vec::Vec<f64> =
                (0..9600).map(|k| 100.0 * (-f64::from(k) / 2000.0).exp() * random.next()).collect();
            let click: std::vec::Vec<f64> = (0..16).map(|k| 60.0 * f64::from(k * 2 - 15).cos()).collect();
            for c in 0..CHANNELS {
                let mut add = |at_s: f64, sound: &[f64]| {
                    for (k, x) in sound.iter().enumerate() {
                        sea[((at_s * rate) as i64 + k as i64 + later[c]) as usize][c] += x;
                    }
                };
                add(start as f64, &sound);
                for n in 0..4 {
                    add(start as f64 + 1.0 + 0.5 * f64::from(n), &click);
                }
            }
        }
        let heard = hear(&plan, &sea);
        std::println!(
            "{} bearings in a minute of explosions and clicks: {:?}",
            heard.bearings.len(),
            heard.faults
        );
        assert!(heard.bearings.len() < 8);
    }
}
