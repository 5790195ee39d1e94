//! Where a transient comes from: its first arrival at the four hydrophones.
//!
//! Enters: raw codes about the moment at which the first hydrophone hears it. Leaves: a direction and its covariance, or
//! nothing where the hydrophones do not agree on one.
//!
//! * Kept are the differences of every second code, which is nearly white for the noise of the sea, in 8 bits: quantised 48 dB
//!   below the peak. They outlast the frame, because sound needs up to a quarter of a frame to cross the array.
//! * [`TEMPLATE`] samples about the greatest value of the strongest hydrophone are looked for in the three others, at the
//!   delays that the array allows, then aligned to a fraction of a sample (least squares of level and delay). Later arrivals, from
//!   surface and bottom, are mostly outside.
//! * A ping is as alike some periods off: where several delays are nearly as good no direction is told.
//! * Agreement: each hydrophone must resemble the template; the three pairs that it takes no part in must be most alike at the
//!   delays it gives, which closes the triangles; and the four times must be those of one wavefront.
//! * Variance of a delay: what the residuals of the other hydrophones, at other moments, have in common with the template's
//!   slope. So it holds whatever the noise's spectrum is, and contains what waveforms differ by.
//! * Direction: least squares with the wavefront's curvature ([`super::curved`]) and the speed of sound as two more unknowns
//!   of known spread: nobody knows how far away a snap is.
//!
//! Cost: about 200 000 instructions, three quarters of them for the search of the template.

use super::curved::{Arrival, wavefront_of};
use super::plan::{FRAME, Plan};
use crate::block::CHANNELS;
use crate::math::f32 as m;

/// Samples kept, and how many of them are before the first that stands out.
const WINDOW: usize = 256;
const BEFORE: usize = 96;
/// Samples compared, and how many of them are before the greatest.
const TEMPLATE: usize = 64;
const LEAD: usize = 24;
/// Samples on either side of the template from which noise is judged.
const BESIDE: usize = 32;
/// Least correlation of a hydrophone with the template.
const ALIKE: f32 = 0.5;
/// Share of a hydrophone's power that neither template nor noise may explain.
const UNEXPLAINED: f32 = 0.15;
/// Samples about the delay that closes a triangle in which a pair must not be more alike elsewhere, and by how many it may miss.
const CLOSING: i32 = 32;
const CLOSED_SAMPLES: f32 = 1.0;
/// Mean of a correlation's neighbours over itself within which the three are taken for a cosine: up to three quarters of half
/// the sampling rate.
const SMOOTHEST: f32 = 0.999;
const ROUGHEST: f32 = -0.75;
/// Share of the slope's power that must be sound and not noise.
const CLEAR: f32 = 0.25;
/// Share of the highest correlation's power that the fourth highest may have: a click of three periods has two so high beside it, a ping
/// all that there are.
const RIVALS: f32 = 0.8;
/// Reach of the interpolation, samples.
const TAPS: i32 = 4;
/// Standard deviation of the alignment itself, samples.
const ALIGNED_SAMPLES: f32 = 0.001;

/// What is kept of the sound about the first arrival (1.1 KiB).
#[derive(Clone, Debug)]
pub(super) struct Capture {
    /// Differences of every second code, over two to the power of `shift`; a row a channel.
    rows: [[i8; WINDOW]; CHANNELS],
    shift: [u8; CHANNELS],
    /// Index of the first of them, wrapping.
    from: u64,
    /// How many at their end have neither been taken nor missed.
    wanted: usize,
    /// Newest two codes of each channel.
    newest: [[i32; 2]; CHANNELS],
}

impl Capture {
    pub(super) const fn new() -> Self {
        Self {
            rows: [[0; WINDOW]; CHANNELS],
            shift: [0; CHANNELS],
            from: 0,
            wanted: 0,
            newest: [[0; 2]; CHANNELS],
        }
    }

    /// Begins about an `onset` within the frame that begins at `index`, with what that holds.
    #[inline(never)]
    pub(super) fn begin(&mut self, index: u64, onset: u64, codes: &[[i32; FRAME]; CHANNELS]) {
        self.rows = [[0; WINDOW]; CHANNELS];
        self.shift = [0; CHANNELS];
        self.from = onset.wrapping_sub(BEFORE as u64);
        // What the frame does not hold stays zero.
        let absent = (index.wrapping_add(2).wrapping_sub(self.from) as i64).max(0) as usize;
        self.wanted = WINDOW.saturating_sub(absent);
        let next = self.next().wrapping_sub(index) as usize;
        for (newest, codes) in self.newest.iter_mut().zip(codes) {
            let before = codes.get(next.wrapping_sub(2)..).and_then(|codes| codes.first_chunk());
            *newest = before.copied().unwrap_or_default();
        }
        self.take(index, codes);
    }

    /// Index of the next sample wanted.
    fn next(&self) -> u64 {
        self.from.wrapping_add(WINDOW.saturating_sub(self.wanted) as u64)
    }

    /// Takes what is still wanted of a frame, before anything in it is blanked.
    #[inline(never)]
    pub(super) fn take(&mut self, index: u64, codes: &[[i32; FRAME]; CHANNELS]) {
        if self.wanted == 0 {
            return;
        }
        let next = self.next().wrapping_sub(index) as usize;
        if !(2..FRAME).contains(&next) {
            // A break.
            self.wanted = 0;
            return;
        }
        let settled = WINDOW.saturating_sub(self.wanted);
        let count = (FRAME - next).min(self.wanted);
        let rows = self.rows.iter_mut().zip(&mut self.shift).zip(&mut self.newest);
        for (((row, shift), newest), codes) in rows.zip(codes) {
            let of = codes.get(next..next + count).unwrap_or(&[]);
            // Kept, because what this frame shares with the one before may be blanked there.
            let before = *newest;
            let older = before.iter().chain(of);
            let loudest = of.iter().zip(older.clone()).fold(0, |most, (x, old)| most | x.abs_diff(*old));
            let needed = (32 - loudest.leading_zeros()).saturating_sub(7) as u8;
            if needed > *shift {
                let less = needed - *shift;
                row.iter_mut().take(settled).for_each(|x| *x = x.checked_shr(less.into()).unwrap_or(0));
                *shift = needed;
            }
            let into = row.iter_mut().skip(settled);
            for ((into, x), old) in into.zip(of).zip(older) {
                *into = (x.wrapping_sub(*old) >> *shift) as i8;
            }
            if let Some(two) = codes.last_chunk::<2>() {
                *newest = *two;
            }
        }
        self.wanted -= count;
    }

    /// The direction of what was kept; `None` where the hydrophones do not agree on one. Apart: its memory is not that of a frame
    /// without a transient.
    #[inline(never)]
    pub(super) fn direction(&self, plan: &Plan) -> Option<Arrival> {
        let row = |h: usize| self.rows.get(usize::from(*plan.channels.get(h)?));
        let rows = [row(0)?, row(1)?, row(2)?, row(3)?];
        let (reference, peak) = self.strongest(plan)?;
        let start = peak.checked_sub(LEAD)?;
        let template = Template::new(rows.get(reference)?, start)?;
        let mut times = [0.0f32; CHANNELS];
        let (mut variance, mut others) = (0.0, 0.0);
        for (h, row) in rows.iter().enumerate().filter(|(h, _)| *h != reference) {
            let most = reach(plan, reference, h);
            let delay = most_alike(template.of, row, start, -most, most)?;
            let aligned = template.align(row, start, delay)?;
            if m::abs(aligned.delay) > most as f32 {
                return None;
            }
            *times.get_mut(h)? = aligned.delay;
            variance += aligned.variance;
            others += 1.0;
        }
        self.closes(&rows, reference, start, &times)?;
        // A delay has the noise of two hydrophones.
        let variance = template.few_looks() * 0.5 * variance / others + ALIGNED_SAMPLES * ALIGNED_SAMPLES;
        let sample_s = 1.0 / plan.rate_hz;
        let variance_s2 = variance * sample_s * sample_s + plan.position_sd_s * plan.position_sd_s;
        wavefront_of(plan, &times.map(|t| t * sample_s), variance_s2)
    }

    /// The hydrophone with the greatest value, and where it is.
    fn strongest(&self, plan: &Plan) -> Option<(usize, usize)> {
        let mut best = (0, None);
        for (h, c) in plan.channels.iter().enumerate() {
            let c = usize::from(*c);
            let (value, at) = greatest(self.rows.get(c)?);
            let value = u32::from(value).checked_shl((*self.shift.get(c)?).into()).unwrap_or(u32::MAX);
            if value > best.0 {
                best = (value, Some((h, at)));
            }
        }
        best.1
    }

    /// Whether the pairs without the reference are most alike where the others' delays have them.
    #[inline(never)]
    fn closes(
        &self,
        rows: &[&[i8; WINDOW]; CHANNELS],
        reference: usize,
        start: usize,
        times: &[f32; CHANNELS],
    ) -> Option<()> {
        let start = start as f32;
        for (i, (first, from)) in rows.iter().zip(times).enumerate() {
            for (j, (second, to)) in rows.iter().zip(times).enumerate().skip(i + 1) {
                if i == reference || j == reference {
                    continue;
                }
                let at = usize::try_from(nearest(start + from)).ok()?;
                let of = first.get(at..)?.first_chunk()?;
                let delay = to - from;
                let about = nearest(delay);
                let own = most_alike(of, second, at, about - CLOSING, about + CLOSING)?;
                if m::abs(own - delay) > CLOSED_SAMPLES {
                    return None;
                }
            }
        }
        Some(())
    }
}

/// The greatest magnitude about which a template fits, and where it is.
#[inline(never)]
fn greatest(row: &[i8; WINDOW]) -> (u8, usize) {
    const FROM: usize = BEFORE - LEAD / 2;
    let about = row.get(FROM..WINDOW + LEAD - TEMPLATE).unwrap_or(&[]);
    (FROM..).zip(about).fold(
        (0, 0),
        |best, (at, x)| {
            if x.unsigned_abs() > best.0 { (x.unsigned_abs(), at) } else { best }
        },
    )
}

/// Samples that sound needs at most between two hydrophones, and two more.
fn reach(plan: &Plan, i: usize, j: usize) -> i32 {
    let apart = (i.min(j), i.max(j));
    let pairs = crate::geometry::PAIRS.iter().zip(&plan.crossing_s);
    let s = pairs.filter(|(pair, _)| **pair == apart).map(|(_, s)| *s).sum::<f32>();
    (s * plan.rate_hz) as i32 + 2
}

/// The delay, samples, at which a row is most like a template that begins at `start` in its own. Between whole samples the
/// correlation is taken for a cosine: a click of a quarter of the sampling rate is as alike a period off, where only that is
/// whole. `None` where several others are nearly as alike.
#[inline(never)]
fn most_alike(of: &[i8; TEMPLATE], row: &[i8; WINDOW], start: usize, from: i32, to: i32) -> Option<f32> {
    let correlation = |lag: i32| {
        let at = usize::try_from((start as i32).wrapping_add(lag)).ok()?;
        let there = row.get(at..)?.first_chunk::<TEMPLATE>()?;
        Some(of.iter().zip(there).map(|(a, b)| i32::from(*a) * i32::from(*b)).sum::<i32>() as f32)
    };
    // The highest correlations' powers, the highest first.
    let (mut most, mut delay) = ([0.0f32; 4], None);
    let (mut before, mut here) = (None, correlation(from - 1));
    for lag in from..=to {
        let older = core::mem::replace(&mut before, here);
        here = correlation(lag);
        // About the one before.
        let (Some(older), Some(middle), Some(newer)) = (older, before, here) else { continue };
        if middle <= 0.0 || middle < older || middle < newer {
            continue;
        }
        let turn = ((older + newer) / (2.0 * middle)).min(SMOOTHEST);
        if turn < ROUGHEST {
            continue;
        }
        let sine = m::sqrt(1.0 - turn * turn);
        let quadrature = 0.5 * (newer - older) / sine;
        let mut power = middle * middle + quadrature * quadrature;
        if power > most[0] {
            delay = Some((lag - 1) as f32 + m::atan2(quadrature, middle) / m::acos(turn));
        }
        for kept in &mut most {
            if power > *kept {
                core::mem::swap(kept, &mut power);
            }
        }
    }
    delay.filter(|_| most[3] < RIVALS * most[0])
}

/// What is looked for.
struct Template<'a> {
    row: &'a [i8; WINDOW],
    of: &'a [i8; TEMPLATE],
    /// Its slope, for each sample.
    slope: [f32; TEMPLATE],
    /// Sum of the squares of the samples, noise among them, and of their products with the slope.
    whole: f32,
    along: f32,
    /// Sums of the squares of both, without noise.
    power: f32,
    steep: f32,
}

/// A hydrophone aligned with the template.
struct Aligned {
    /// How much later than the template's, samples.
    delay: f32,
    /// Variance of that, samples².
    variance: f32,
}

/// Value of a row between its samples, `weights` about sample `at`.
#[inline(never)]
fn between(row: &[i8; WINDOW], at: i32, weights: &[f32; 2 * TAPS as usize + 1]) -> f32 {
    let taps = weights.iter().zip(at - TAPS..);
    taps.map(|(w, n)| usize::try_from(n).ok().and_then(|n| row.get(n)).map_or(0.0, |x| w * f32::from(*x)))
        .sum()
}

/// Weights of the samples about one for the value `late` (at most half a sample) behind it.
#[inline(never)]
fn fraction(late: f32) -> [f32; 2 * TAPS as usize + 1] {
    core::array::from_fn(|k| weight(k as f32 - TAPS as f32 - late))
}

/// That of a sample so far away: what a band-limited sound has there, under a window.
#[inline(never)]
fn weight(x: f32) -> f32 {
    if m::abs(x) < 1e-4 {
        return 1.0;
    }
    let window = m::sin_cos(m::PI * x / (2.0 * (TAPS as f32 + 1.0))).1;
    m::sin_cos(m::PI * x).0 / (m::PI * x) * window * window
}

impl<'a> Template<'a> {
    /// The template that begins at `start`; `None` where it is not within the row or there is no sound.
    fn new(row: &'a [i8; WINDOW], start: usize) -> Option<Self> {
        let of = row.get(start..)?.first_chunk::<TEMPLATE>()?;
        // Derivative of the band-limited sound, between a quarter of a sample before and behind.
        let mut weights = fraction(0.25);
        weights.iter_mut().zip(fraction(-0.25)).for_each(|(after, before)| *after = 2.0 * (*after - before));
        let slope: [f32; TEMPLATE] = core::array::from_fn(|n| between(row, (start + n) as i32, &weights));
        let (mut whole, mut along, mut all) = (0.0, 0.0, 0.0);
        for (x, slope) in of.iter().zip(&slope) {
            let x = f32::from(*x);
            whole += x * x;
            along += x * slope;
            all += slope * slope;
        }
        // What noise has of both, as the samples before show.
        let before = QUIET.start as i32 + TAPS..QUIET.end as i32;
        let share = TEMPLATE as f32 / before.len() as f32;
        let steep = all - share * before.map(|n| between(row, n, &weights)).map(|x| x * x).sum::<f32>();
        let power = whole - noise_of(row);
        (power > 0.0 && steep > CLEAR * all).then_some(Self { row, of, slope, whole, along, power, steep })
    }

    /// By how much a variance from so few looks at the noise must be larger, so that the ellipse of 95 % holds as many (F-distribution
    /// of two numbers). Three hydrophones, which share the template's noise, look as often as two.
    #[inline(never)]
    fn few_looks(&self) -> f32 {
        let mut alike = LOOKS as f32;
        for apart in 1..=LOOKS {
            // Pairs of looks so far apart; the one in the middle is none.
            let pairs = (LOOKS + 1).saturating_sub(apart) - if 2 * apart <= LOOKS { 2 } else { 0 };
            let later = self.slope.get(apart * NOISE_EVERY..).unwrap_or(&[]);
            let shared = product(&self.slope, later) / self.steep;
            alike += 2.0 * pairs as f32 * shared * shared;
        }
        let freedom = 2.0 * (LOOKS * LOOKS) as f32 / alike;
        const HOLDS: f32 = 5.991;
        freedom * (m::exp(HOLDS / freedom) - 1.0) / HOLDS
    }

    /// Aligns a row that is alike at about a `delay`, samples.
    #[inline(never)]
    fn align(&self, row: &[i8; WINDOW], start: usize, mut delay: f32) -> Option<Aligned> {
        let (mut gain, mut energy, mut along) = (0.0, 0.0, 0.0);
        for _ in 0..ALIGNMENTS {
            let (whole, weights) = split(delay);
            let mut across = 0.0;
            (energy, along) = (0.0, 0.0);
            for (n, (x, slope)) in self.of.iter().zip(&self.slope).enumerate() {
                let there = between(row, start as i32 + n as i32 + whole, &weights);
                along += there * f32::from(*x);
                across += there * slope;
                energy += there * there;
            }
            gain = along / self.power;
            if gain <= 0.0 || gain.is_nan() {
                return None;
            }
            delay -= ((across - gain * self.along) / (gain * self.steep)).clamp(-0.5, 0.5);
        }
        let alike = along / m::sqrt(self.whole * energy.max(f32::MIN_POSITIVE));
        let unlike = energy - 2.0 * gain * along + gain * gain * self.whole;
        let noise = noise_of(row) + gain * gain * (self.whole - self.power);
        if alike < ALIKE || unlike > 2.0 * noise + UNEXPLAINED * energy {
            return None;
        }
        let variance = self.noise(row, start, delay, gain);
        Some(Aligned { delay, variance })
    }

    /// Variance of a delay, samples²: how much the residual at other moments looks like the template's slope.
    #[inline(never)]
    fn noise(&self, row: &[i8; WINDOW], start: usize, delay: f32, gain: f32) -> f32 {
        let (whole, weights) = split(delay);
        let residual: [f32; TEMPLATE + 2 * BESIDE] = core::array::from_fn(|n| {
            let at = (start + n) as i32 - BESIDE as i32;
            let own = usize::try_from(at).ok().and_then(|at| self.row.get(at)).map_or(0.0, |x| f32::from(*x));
            between(row, at + whole, &weights) - gain * own
        });
        let mut seen = 0.0;
        for from in (0..=2 * BESIDE).step_by(NOISE_EVERY) {
            let sum = product(&self.slope, residual.get(from..).unwrap_or(&[]));
            // Not where the template was aligned.
            seen += if from == BESIDE { 0.0 } else { sum * sum };
        }
        let scale = gain * self.steep;
        seen / (LOOKS as f32 * scale * scale)
    }
}

/// Rounds of the alignment.
const ALIGNMENTS: usize = 3;
/// Samples between looks at the noise, and how many looks there are.
const NOISE_EVERY: usize = 4;
const LOOKS: usize = 2 * BESIDE / NOISE_EVERY;

/// Sum of the products of two series, as long as the shorter one.
#[inline(never)]
fn product(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Samples before the sound.
const QUIET: core::ops::Range<usize> = 0..BEFORE - BESIDE;

/// Power of a row's noise in as many samples as a template has.
#[inline(never)]
fn noise_of(row: &[i8; WINDOW]) -> f32 {
    let quiet = row.iter().take(QUIET.end).skip(QUIET.start);
    quiet.map(|x| f32::from(*x) * f32::from(*x)).sum::<f32>() * (TEMPLATE as f32 / QUIET.len() as f32)
}

/// The nearest whole number of a small one.
fn nearest(x: f32) -> i32 {
    (x + 1024.5) as i32 - 1024
}

/// Whole samples of a delay and the weights for the rest.
fn split(delay: f32) -> (i32, [f32; 2 * TAPS as usize + 1]) {
    let whole = nearest(delay);
    (whole, fraction(delay - whole as f32))
}
