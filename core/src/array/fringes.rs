//! How deep a vessel lies, from the fringes that its image in the surface makes.
//!
//! Enters: the hydrophones' own spectra of a segment and the direction found in it. Leaves: the vessel's depth. The image is
//! heard `Δ = 2 d sin β / c` after the vessel (Lloyd's mirror; d the vessel's depth, β the elevation of vessel and image
//! together, which is that of the surface above it), so that the received spectrum goes as `1 − cos ωΔ`: the spectrum over
//! its own running mean has a negative cosine transform at that delay. Nothing is told where that is faint, where another delay
//! shows as much, and where the fringes are too wide for the running mean or too narrow for the bins. Several segments of one
//! source must agree ([`Depth::take`]).
//!
//! Cost: one transform of 512 points and some 60 instructions a bin, 45 000 a segment.

use super::estimate::{Context, Found};
use super::framed::{self, Image};
use super::plan::{BINS, Band, FRAME, Plan};
use super::refine;
use super::spectra::Spectra;
use super::transform::{self, Work};
use super::wavefront;
use crate::math::f32 as m;
use microfft::Complex32;

/// Bins on each side of the running mean: fringes narrower than this stay.
const MEAN_BINS: usize = 24;
/// Delays used, samples: shorter ones are the source's own spectrum, longer ones are lost between bins.
const DELAYS: (usize, usize) = (8, 220);
/// Depths considered, metres: a boat's propeller to that of a laden tanker.
const DEPTHS_M: (f32, f32) = (0.7, 24.0);
/// Bins whose mean coherence says whether a source is heard there.
const EDGE: usize = 8;
/// Least depth of the fringes over their mean, full fringes being 1.
const LEAST: f32 = 0.25;
/// And in units of what the two paths' coherence makes them, of which chance takes a part: those of three or four paths are fainter.
const CONTRAST: f32 = 0.85;
/// Greatest share of it that any other delay may have, of either sign (echoes off the bottom, another vessel), and how far from the first in main lobes it begins.
const NEXT: f32 = 0.3;
const LOBE: usize = 2;
/// The same of delays of its own sign where an echo off the bottom is known.
const BESIDE_ECHO: f32 = 0.5;

/// Segments whose depths are averaged, and how many must agree before they are believed.
const AVERAGED: f32 = 8.0;
const AGREEING: f32 = 4.0;
/// A depth farther than this share from the mean does not agree.
const SAME: f32 = 0.15;
/// Standard deviation of a depth believed: as a share, and of the fringes' delay, samples. A law that fits passes of vessels 2 to 8 m deep,
/// 200 m to 1 km away, at 16 and 64 kHz.
const SD: f32 = 0.003;
const SD_SAMPLES: f32 = 0.1;

/// Segments over which the image's loss is gathered, samples shared with a neighbour counted twice, and what it is beyond that of its longer way, before anything tells.
const REMEMBERED: f32 = 64.0;
const SHARED: f32 = 2.0;
const LOSS_SD: f32 = 0.15;
/// Share of what is found beyond that which its model may have wrong.
const MODEL_SD: f32 = 0.05;
/// What [`Loss`] leaves unexplained of two paths is up to 2.
pub(super) const THIRD_PATH: f32 = 4.0;
/// Least share of the mean power that a bin between fringes is taken to have, as a quotient.
const DARKEST: f32 = 8.0;

/// What the segments so far say of the vessel now heard.
#[derive(Clone, Copy, Debug)]
pub(super) struct Depth {
    mean_m: f32,
    /// What a segment's depth errs by, metres.
    sd_m: f32,
    /// How deep the fringes are.
    height: f32,
    /// Whether they told it last.
    by_fringes: bool,
    /// Segments in the means.
    agreed: f32,
    /// Sums over segments of what tells the image's loss: products with what it does, and squares of that.
    lost: f32,
    information: f32,
    /// What frames make of vessel and image, in units of the loss, and of the angle between the two ([`framed`]).
    framed: Option<(f32, f32)>,
    /// By how much nearer to the vessel than half-way to its image both were heard last ([`Depth::shift`]).
    nearer: f32,
}

/// What a segment tells.
#[derive(Clone, Copy, Debug)]
pub(super) struct Told {
    depth_m: f32,
    /// Its standard deviation, metres.
    sd_m: f32,
    /// How deep they are over their mean, full ones being 1.
    height: f32,
    /// Whether they tell it, and not vessel and image that are heard apart.
    by_fringes: bool,
}

impl Told {
    /// A depth and its standard deviation, metres, of a vessel and its image that are heard apart, and how deep fringes of it are.
    pub(super) const fn apart((depth_m, sd_m): (f32, f32), height: f32) -> Self {
        Self { depth_m, sd_m, height, by_fringes: false }
    }

    /// The depth, metres.
    pub(super) const fn depth_m(&self) -> f32 {
        self.depth_m
    }
}

/// Whether fringes of an image so late (seconds) are no narrower than the bins.
pub(super) fn are_wide(plan: &Plan, delay_s: f32) -> bool {
    delay_s * plan.rate_hz <= DELAYS.1 as f32
}

impl Depth {
    /// Nothing.
    pub(super) const UNKNOWN: Self = Self {
        mean_m: 0.0,
        sd_m: 0.0,
        height: 0.0,
        by_fringes: false,
        agreed: 0.0,
        lost: 0.0,
        information: 0.0,
        framed: None,
        nearer: 0.0,
    };

    /// Takes what a segment tells, if it tells anything.
    pub(super) fn take(&mut self, told: Option<Told>) {
        let Some(Told { depth_m, sd_m, height, by_fringes }) = told else { return };
        if m::abs(depth_m - self.mean_m) > SAME * self.mean_m {
            // Another vessel, or one of the two was wrong: the mean is given up where it was hardly begun or is gainsaid as often.
            self.agreed -= 1.0;
            if self.agreed <= 0.0 {
                *self = Self { mean_m: depth_m, sd_m, height, agreed: 1.0, by_fringes, ..Self::UNKNOWN };
            }
            return;
        }
        self.agreed = (self.agreed + 1.0).min(AVERAGED);
        self.mean_m += (depth_m - self.mean_m) / self.agreed;
        self.height += (height - self.height) / self.agreed;
        (self.sd_m, self.by_fringes) = (sd_m, by_fringes);
    }

    /// Sine of the elevation of the surface above the vessel, that of vessel and image together being this direction's: by what is known of
    /// how much fainter the image is.
    #[inline(never)]
    pub(super) fn surface(&self, plan: &Plan, direction: &wavefront::Direction) -> f32 {
        let sine = direction[2].max(0.0);
        sine * (1.0 + 2.0 * self.nearer * (1.0 - sine * sine).max(0.0) * self.mean_m / plan.depth_m)
    }

    /// The image of a source there, where it is time to look at what frames make of it.
    pub(super) fn image(&self, plan: &Plan, direction: &wavefront::Direction, segment: u32) -> Option<Image> {
        let due = self.framed.is_none() || segment.is_multiple_of(framed::EVERY);
        due.then(|| Image::of(plan, direction, self.surface(plan, direction), self.mean_m, self.height))
    }

    /// Depth and its standard deviation, metres, where segments agree.
    pub(super) fn known(&self) -> Option<(f32, f32)> {
        (self.agreed >= AGREEING).then_some((self.mean_m, self.sd_m))
    }

    /// The same where fringes told it: vessel and image are heard as one there, or nearly.
    pub(super) fn by_fringes(&self) -> Option<(f32, f32)> {
        self.known().filter(|_| self.by_fringes)
    }

    /// Takes what a segment tells of the image's loss.
    pub(super) fn take_loss(&mut self, loss: &Loss) {
        self.framed = loss.framed.or(self.framed);
        let (framed, _) = self.framed.unwrap_or_default();
        self.lost += loss.product - framed::FEIGNED * framed * loss.information - self.lost / REMEMBERED;
        self.information += loss.information - self.information / REMEMBERED;
    }

    /// By how much nearer to the vessel than half-way to the image both are heard, in units of the angle between them, and its
    /// standard deviation, if the image's loss (see [`Loss`]) is `usual` because of its longer way alone, and `nearer` for a unit of it.
    pub(super) fn shift(&mut self, usual: f32, nearer: f32) -> (f32, f32) {
        let prior = 1.0 / (LOSS_SD * LOSS_SD);
        // Neighbouring segments share their halves.
        let information = self.information / SHARED;
        let known = prior + information;
        let loss = (prior * usual + self.lost / SHARED) / known;
        let loss = loss.max(usual).min(0.5);
        let sd = m::hypot(m::sqrt(1.0 / known), MODEL_SD * (loss - usual));
        let (framed, shift) = self.framed.unwrap_or_default();
        let doubt = framed::SD * m::hypot(nearer * framed * information / known, shift);
        self.nearer = nearer * loss + shift;
        (self.nearer, m::hypot(nearer * sd, doubt))
    }
}

/// What a segment tells of how much fainter the image is than the vessel: of `(1 − r²)/2(1 + r²)` where it has r of the vessel's
/// amplitude. Vessel and image of one strength are heard from half-way between them at any frequency; where the image is
/// fainter, the sound comes from nearer the vessel, by that loss over the power that both together have there, in units of its mean: between the fringes,
/// where they nearly cancel, from beyond the vessel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Loss {
    product: f32,
    information: f32,
    /// How much nearer the vessel the whole band is heard for a unit of the loss, in units of the angle between the two.
    pub(super) nearer: f32,
    /// By how much the cross-spectra's push up and down varies over the bins more than noise and the loss make it, as a ratio of variances: a
    /// third path, an echo off the bottom, makes it tens.
    pub(super) unexplained: f32,
    /// What frames make of vessel and image, where it was looked at: the loss they feign, and by how much nearer to the vessel than half-way
    /// they bring both, in units of the angle between them.
    framed: Option<(f32, f32)>,
}

/// What the whitened cross-spectra about a source `found`, whose image is heard so late (seconds) and `apart` (radians) above it, tell of the image's loss,
/// by the refinement's weights and the coherence seen; and, of the `image`, what frames make of it. `work` is used up.
///
/// A bin's share of what the loss does is the mean power about it over its own, less the noise in it. Where nothing is heard at the band's end
/// that quotient is large and means nothing: those bins are left out. The running mean keeps a part of fringes that are not much
/// narrower than it: that part is taken off.
#[inline(never)]
pub(super) fn loss(
    context: &Context<'_>,
    found: &Found,
    g: &Spectra,
    (weight, coherence): (&[f32; BINS], &[f32; BINS]),
    (delay_s, apart): (f32, f32),
    image: Option<Image>,
    work: &mut Work,
) -> Option<Loss> {
    let (plan, band) = (context.plan, context.band);
    let direction = &found.refined.direction;
    let (curvature, _) = context.curvature(direction);
    let up = wavefront::tangents(direction).1;
    let g2 = wavefront::pair_delays(&wavefront::gradient(&plan.geometry, direction, &up, curvature));
    let turn = g2.iter().map(|x| x * x).sum::<f32>();
    let (values, sums) = work.split_first_chunk_mut::<FRAME>()?;
    flattened(plan, g, sums);
    values.fill(Complex32::new(0.0, 0.0));
    refine::push(plan, band, g, &found.tau, &g2, values);
    let (low, high) = (band.low, heard(band, coherence, found.mean));
    // Means of mean power over a bin's own, and of the coherence, which tell the noise.
    let kept = ripple(plan, delay_s);
    let (mut mean, mut coherent) = (0.0f32, 0.0f32);
    for (k, c) in coherence.iter().enumerate().take(high).skip(low) {
        let (running, own) = mean_power((low, high), sums, k)?;
        let share = (running / own.max(1e-3 * running)).min(DARKEST);
        let share = ((share - kept) / (1.0 - kept)).max(0.0);
        values.get_mut(k)?.im = share;
        (mean, coherent) = (mean + share, coherent + c);
    }
    let bins = high.saturating_sub(low).max(1) as f32;
    let noise = (1.0 - coherent / bins).max(refine::LEAST_NOISE) * bins / mean.max(f32::MIN_POSITIVE);
    let (mut upper, mut lower) = (0.0f32, 0.0f32);
    let at = |k: usize| values.get(k).map_or((0.0, 0.0), |z| (z.re, z.im));
    for (k, (w, c)) in weight.iter().zip(coherence).enumerate().take(high).skip(low) {
        let (_, share) = at(k);
        let square = w * (k * k) as f32;
        upper += square * (1.0 - noise) * share;
        lower += square * c;
    }
    if !(lower > 0.0) {
        return None;
    }
    let nearer = upper / lower;
    // The running sums have served.
    sums.iter_mut().for_each(|sum| sum.re = 0.0);
    if let Some(image) = image {
        image.push(plan, band, g, (&found.tau, &g2), values, sums);
    }
    let (mut feigned, mut moved) = (0.0f32, 0.0f32);
    let (mut product, mut information, mut seen) = (0.0f32, 0.0f32, 0.0f32);
    for (k, (w, c)) in weight.iter().zip(coherence).enumerate().take(high).skip(low) {
        let (push, share) = at(k);
        let does = k as f32 * plan.bin_rad_s * turn * apart * ((1.0 - noise) * share - c * nearer);
        let known = 1.0 / (1.0 - c * c).max(refine::LEAST_NOISE);
        product += push * does * known;
        information += does * does * known;
        seen += push * push * known;
        let framed = sums.get(k).map_or(0.0, |z| z.re);
        feigned += framed * does * known;
        moved += framed * k as f32 * w;
    }
    let framed = image.map(|_| {
        let unit = lower * plan.bin_rad_s * turn * apart;
        (feigned / information.max(f32::MIN_POSITIVE), moved / unit.max(f32::MIN_POSITIVE))
    });
    let scale = 2.0 * context.snapshots / turn.max(f32::MIN_POSITIVE);
    let left = seen - product * product / information.max(f32::MIN_POSITIVE);
    let unexplained = (scale * left / bins).max(1.0);
    let scale = scale / unexplained;
    let (product, information) = (scale * product, scale * information);
    let finite = (product + information + unexplained).is_finite();
    let framed = framed.filter(|(loss, shift)| (loss + shift).is_finite());
    finite.then_some(Loss { product, information, nearer, unexplained, framed })
}

/// The end of the bins in which the source is heard: less than half its mean coherence is above. What is below them counts little.
#[inline(never)]
fn heard(band: &Band, coherence: &[f32; BINS], mean: f32) -> usize {
    let mut high = band.high;
    let least = 0.5 * mean * EDGE as f32;
    while high > band.low + EDGE
        && coherence.get(high - EDGE..high).is_some_and(|bins| bins.iter().sum::<f32>() < least)
    {
        high -= 1;
    }
    // Half of the last ones may be beyond.
    if high < band.high { high - EDGE / 2 } else { high }
}

/// Share of a fringe's depth that the running mean keeps, if the image is heard so late (seconds).
fn ripple(plan: &Plan, delay_s: f32) -> f32 {
    let half = 0.5 * (2 * MEAN_BINS + 1) as f32 * plan.bin_rad_s * delay_s;
    m::sin_cos(half).0 / half.max(1e-3)
}

/// Running mean of the flattened power about a bin, and its own.
#[inline(never)]
fn mean_power((low, high): (usize, usize), sums: &[Complex32], k: usize) -> Option<(f32, f32)> {
    let (from, to) = (k.saturating_sub(MEAN_BINS).max(low), (k + MEAN_BINS + 1).min(high));
    let (a, b, own) = (sums.get(from)?, sums.get(to)?, sums.get(k)?);
    Some(((b.re - a.re) / to.saturating_sub(from).max(1) as f32, own.im))
}

/// The depth of a source below a surface that is seen from the array at an elevation of this sine, by one segment's spectra, where fringes are at
/// least as deep as its `coherence`: those of two paths are, fainter ones are of three or four. An `echo` off the bottom that is known shows a delay of the other sign,
/// and that as much later and earlier than the image. `work` is used up.
pub(super) fn depth_m(
    plan: &Plan,
    spectra: &Spectra,
    sine: f32,
    (coherence, echo): (f32, bool),
    work: &mut Work,
) -> Option<Told> {
    // Samples of delay for a metre of depth.
    let per_m = 2.0 * sine * plan.inv_c * plan.rate_hz;
    let first = ((DEPTHS_M.0 * per_m) as usize).max(DELAYS.0);
    let last = ((DEPTHS_M.1 * per_m) as usize).min(DELAYS.1);
    if last < first + LOBE {
        return None;
    }
    let (values, sums) = work.split_first_chunk_mut::<FRAME>()?;
    let used = flattened(plan, spectra, sums);
    values.fill(Complex32::new(0.0, 0.0));
    for k in plan.whole.low..plan.passed {
        let Some((mean, own)) = mean_power((plan.whole.low, plan.passed), sums, k) else { continue };
        if let Some(value) = values.get_mut(transform::reversed(k))
            && mean > 0.0
        {
            value.re = own / mean - 1.0;
        }
    }
    transform::transform_reversed(values);
    let scale = -2.0 / used;
    let at = |n: usize| values.get(n).map_or(0.0, |z| scale * z.re);
    let mut best = (0.0, 0);
    for n in first..=last {
        if at(n) > best.0 {
            best = (at(n), n);
        }
    }
    let (height, n) = best;
    let (before, after) = (at(n.saturating_sub(1)), at(n + 1));
    // Frames hold a part of either path's sound without the other's.
    let contrast = CONTRAST * coherence * refine::share(plan, n as f32 / plan.rate_hz);
    if height < LEAST.max(contrast) || before > height || after > height {
        return None;
    }
    // The lobe of a band of so many bins reaches to its first zero.
    let lobe = LOBE * (FRAME as f32 / used) as usize + 1;
    let mut others = (DELAYS.0..=DELAYS.1).filter(|other| other.abs_diff(n) > lobe);
    let (like, unlike) = if echo { (BESIDE_ECHO, f32::MAX) } else { (NEXT, NEXT) };
    let is_as_deep = |n: usize| at(n) > like * height || -at(n) > unlike * height;
    if others.any(is_as_deep) {
        return None;
    }
    let bend = before - 2.0 * height + after;
    let shift = if bend < 0.0 { 0.5 * (before - after) / bend } else { 0.0 };
    let depth_m = (n as f32 + shift) / per_m;
    let sd_m = m::hypot(SD * depth_m, SD_SAMPLES / per_m);
    let height = height - 0.25 * (before - after) * shift;
    Some(Told { depth_m, sd_m, height, by_fringes: true })
}

/// Sum of the hydrophones' spectra times the squared frequency (a vessel's sound falls by about as much), in the imaginary
/// parts, and its running sum from the band's first bin on in the real parts, one place a bin. Returns the number of bins.
fn flattened(plan: &Plan, spectra: &Spectra, sums: &mut [Complex32]) -> f32 {
    let mut sum = 0.0;
    let autos = spectra.runs.iter().flat_map(|run| {
        let [a, b, c, d] = run.auto;
        [a[0] + b[0] + c[0] + d[0], a[1] + b[1] + c[1] + d[1]]
    });
    // One place more, for the sum of all.
    for ((k, auto), place) in autos.chain([0.0]).enumerate().take(BINS + 1).zip(sums) {
        let inside = k >= plan.whole.low && k < plan.passed;
        let own = if inside { auto * (k * k) as f32 } else { 0.0 };
        *place = Complex32::new(sum, own);
        sum += own;
    }
    plan.passed.saturating_sub(plan.whole.low).max(1) as f32
}

#[cfg(test)]
mod tests {
    use super::super::test_sea::plan;
    use super::*;
    use crate::math::f64 as md;
    use std::boxed::Box;

    const SINE: f32 = 0.3;

    /// A spectrum falling by 20 dB a decade from `shape` of the angular frequency, in a third as much noise.
    fn told(plan: &Plan, shape: impl Fn(f64) -> f64) -> Option<f32> {
        told_beside(plan, false, shape)
    }

    /// The same where an echo off the bottom is known or is not.
    fn told_beside(plan: &Plan, echo: bool, shape: impl Fn(f64) -> f64) -> Option<f32> {
        let mut spectra = Box::new(Spectra::new());
        for (r, run) in spectra.runs.iter_mut().enumerate() {
            for i in 0..transform::RUN {
                let k = (transform::RUN * r + i).max(1) as f64;
                let sound = (shape(k * f64::from(plan.bin_rad_s)) + 0.3) / (k * k);
                run.auto.iter_mut().for_each(|auto| auto[i] = sound as f32);
            }
        }
        let mut work = Box::new([Complex32::new(0.0, 0.0); 2 * FRAME + 1]);
        depth_m(plan, &spectra, SINE, (0.5, echo), &mut work).map(|told| told.depth_m)
    }

    #[test]
    fn fringes_tell_the_depth_and_nothing_else_does() {
        for rate_hz in [16_000.0, 64_000.0] {
            let plan = plan(rate_hz);
            let delay_s = |depth_m: f64| 2.0 * depth_m * f64::from(SINE * plan.inv_c);
            for depth_m in [2.0, 4.3, 8.0] {
                let told = told(&plan, |omega| 1.0 - md::cos(omega * delay_s(depth_m)));
                if delay_s(depth_m) * rate_hz > DELAYS.1 as f64 {
                    assert_eq!(told, None, "too narrow for the bins");
                    continue;
                }
                let told = told.unwrap_or(0.0);
                assert!((f64::from(told) / depth_m - 1.0).abs() < 0.03, "{rate_hz} Hz, {depth_m} m: {told}");
            }
            assert_eq!(told(&plan, |_| 1.0), None, "no image");
            assert_eq!(
                told(&plan, |omega| 1.0 + md::cos(omega * delay_s(4.0))),
                None,
                "an echo of the same sign"
            );
            let two = |omega: f64| 2.0 - md::cos(omega * delay_s(3.0)) - 0.8 * md::cos(omega * delay_s(5.5));
            assert_eq!(told(&plan, two), None, "two vessels");
        }
    }

    #[test]
    fn fringes_tell_the_depth_over_a_bottom_where_its_echo_is_known() {
        let plan = plan(64_000.0);
        let delay_s = |depth_m: f64| 2.0 * depth_m * f64::from(SINE * plan.inv_c);
        for (below_m, coefficient) in [(1.5, 0.3), (8.0, 0.3), (8.0, 0.5)] {
            let heard = |omega: f64| {
                let image = 1.0 - md::cos(omega * delay_s(4.0));
                let echo = 2.0 * coefficient * md::cos(omega * delay_s(below_m));
                image * (1.0 + coefficient * coefficient + echo)
            };
            assert_eq!(told(&plan, heard), None, "{below_m} m, {coefficient}");
            let told = told_beside(&plan, true, heard);
            assert!(told.is_some_and(|m| (m - 4.0).abs() < 0.1), "{below_m} m, {coefficient}: {told:?}");
        }
        // Two vessels are two beside an echo as well.
        let two = |omega: f64| 2.0 - md::cos(omega * delay_s(3.0)) - 0.8 * md::cos(omega * delay_s(5.5));
        assert_eq!(told_beside(&plan, true, two), None);
    }

    #[test]
    fn segments_must_agree_and_one_stray_changes_nothing() {
        let told = |depth_m| Some(Told { depth_m, sd_m: 0.02, height: 0.5, by_fringes: true });
        let mut depth = Depth::UNKNOWN;
        for (n, depth_m) in [5.0, 5.1, 4.9].into_iter().enumerate() {
            depth.take(told(depth_m));
            assert_eq!(depth.known(), None, "{n}");
        }
        depth.take(told(5.0));
        depth.take(None);
        depth.take(told(9.0));
        depth.take(told(5.0));
        let known = depth.known();
        assert!(known.is_some_and(|(m, sd)| (m - 5.0).abs() < 0.1 && sd > 0.01), "{known:?}");
        // Another vessel's takes over.
        for _ in 0..16 {
            depth.take(told(2.5));
        }
        assert!(depth.known().is_some_and(|(m, _)| m == 2.5));
    }
}
