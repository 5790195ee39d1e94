//! Refinement on the cross-spectra themselves, signal and noise spectra, and the covariance that follows.
//!
//! Maximises `J(u) = Σ_p Σ_f W(f) Re(ĝ_p(f) e^{iωτ_p(u)})` over the direction by Gauss-Newton in its tangent plane, with
//! `W = c/(n(n+4c))` where `c = S/(S+N)` and `n = 1 − c`: the maximum-likelihood weight for four sensors (see
//! docs/references.md; `S/(N(N+4S))` for whitened spectra; 3 for 4 where a hydrophone is left out). `c` is the real part of the *steered* cross-spectra, averaged over
//! pairs, neighbouring bins and past segments; it is capped at 17 dB because multipath, not noise, limits above.
//!
//! Covariance: with K independent snapshots a bin, `cov = σ_t² (Gᵀ(4I − 11ᵀ)G)⁻¹`,
//! `σ_t² = Σ W²ω² n(n+4c) / (2K (Σ Wω²c)²)`, which for these weights is the physical limit of docs/references.md.
//! Cost: about 30 000 instructions a pass over the six pairs; seven passes a segment.

use super::estimate::{Context, Found};
use super::plan::{BINS, Band, Plan, SHARE_STRIDE, SHARES};
use super::spectra::{BinRun, Spectra};
use super::transform::RUN;
use super::wavefront::{self, Direction, PAIR_COUNT, Used};
use crate::math::f32 as m;
use microfft::Complex32;

/// Least share of noise assumed (17 dB signal-to-noise ratio): above it multipath limits, not noise.
pub(crate) const LEAST_NOISE: f32 = 0.02;
/// Least `1 − r²` by which two sources' coherences are told apart.
const LEAST_APART: f32 = 0.2;
/// Bins on each side over which the coherence spectrum is averaged for the weights.
const SMOOTH: usize = 4;
/// Bins in all.
pub(super) const SMOOTHED: f32 = (2 * SMOOTH + 1) as f32;
/// Variances of noise taken off a squared coherence: two standard deviations are none.
const SIGNIFICANT: f32 = 4.0;
/// Gauss-Newton steps: from a fine-grid start three reach the level of rounding; after one shorter than this share of the
/// resolution the next would be its square.
const STEPS: usize = 3;
const CONVERGED: f32 = 0.003;
/// Least curvature of the response, both directions' product, in units of what it is if all pairs are curved as their mean is.
const LEAST_PEAKED: f32 = 0.1;

/// Sums over the band for each pair: `Σ W Re`, `Σ Wω Im`, `Σ Wω² Re` of the steered cross-spectrum.
#[derive(Clone, Copy, Debug)]
struct Steered {
    slope: [f32; PAIR_COUNT],
    bend: [f32; PAIR_COUNT],
}

/// A refined direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Refined {
    pub(crate) direction: Direction,
    /// Delays of the six pairs by themselves, seconds.
    pub(crate) pair_delay: [f32; PAIR_COUNT],
    /// By how much each pair pulls the direction, as the delay by which a pair of mean curvature would, seconds: less than its own delay's
    /// difference where its peak is flat, because a vessel and its image stand apart in it.
    pub(crate) pull: [f32; PAIR_COUNT],
    /// How curved each pair's response is there, `Σ Wω² Re`.
    pub(crate) bend: [f32; PAIR_COUNT],
}

/// Leaves out the pairs with hydrophones not used.
pub(crate) fn leave_out(spectra: &mut Spectra, used: Used) {
    for run in &mut spectra.runs {
        for (p, (re, im)) in run.re.iter_mut().zip(&mut run.im).enumerate() {
            if !used.pair(p) {
                (*re, *im) = ([0.0; RUN], [0.0; RUN]);
            }
        }
    }
}

/// Divides the cross-spectra by the geometric mean of their hydrophones' auto-spectra: `ĝ`, of magnitude at most one.
pub(crate) fn whiten(spectra: &mut Spectra) {
    for BinRun { re, im, auto } in &mut spectra.runs {
        let [a0, a1, a2, a3] =
            auto.map(|bins| bins.map(|a| if a > 1e-20 { m::inverse_sqrt(a) } else { 0.0 }));
        let pairs = [(a0, a1), (a0, a2), (a0, a3), (a1, a2), (a1, a3), (a2, a3)];
        for ((re, im), (a, b)) in re.iter_mut().zip(im).zip(pairs) {
            for i in 0..RUN {
                let scale = a[i] * b[i];
                re[i] *= scale;
                im[i] *= scale;
            }
        }
    }
}

/// `e^{iωτ}` of one bin after another.
pub(super) struct Phasor {
    sine: f32,
    cosine: f32,
    sine_of_step: f32,
    cosine_of_step: f32,
}

impl Phasor {
    #[inline(never)]
    pub(super) fn new(plan: &Plan, tau: f32, first_bin: usize) -> Self {
        let (sine_of_step, cosine_of_step) = m::sin_cos(plan.bin_rad_s * tau);
        let (sine, cosine) = m::sin_cos(plan.bin_rad_s * tau * first_bin as f32);
        Self { sine, cosine, sine_of_step, cosine_of_step }
    }

    /// Sine and cosine of this bin; goes on to the next.
    #[inline(always)]
    pub(super) fn next(&mut self) -> (f32, f32) {
        let (s, c, ds, dc) = (self.sine, self.cosine, self.sine_of_step, self.cosine_of_step);
        (self.sine, self.cosine) = (s * dc + c * ds, c * dc - s * ds);
        (s, c)
    }
}

/// The steered coherence `c(f)`: mean over the pairs used (those not used are 0) of `Re(ĝ e^{iωτ})`, for every bin of the band.
pub(crate) fn coherence(
    plan: &Plan,
    band: &Band,
    g: &Spectra,
    tau: &[f32; PAIR_COUNT],
    out: &mut [f32; BINS],
) {
    out.fill(0.0);
    let runs = band.runs();
    // Those not used are 0; asked for one by one, the six are not written out in the image.
    for (p, tau) in tau.iter().enumerate().filter(|(p, _)| band.used.pair(*p)) {
        let mut phasor = Phasor::new(plan, *tau, runs.start * RUN);
        let out = out.as_chunks_mut::<RUN>().0.get_mut(runs.clone()).unwrap_or(&mut []);
        for (out, run) in out.iter_mut().zip(g.part(&runs)) {
            let (Some(re), Some(im)) = (run.re.get(p), run.im.get(p)) else { continue };
            for i in 0..RUN {
                let (s, c) = phasor.next();
                out[i] = out[i] + re[i] * c - im[i] * s;
            }
        }
    }
    let share = 1.0 / band.used.pairs();
    for (k, c) in out.iter_mut().enumerate() {
        *c = if k >= band.low && k < band.high { *c * share } else { 0.0 };
    }
}

/// Share of the signal that frames of two hydrophones have in common at a delay (seconds).
#[inline(never)]
pub(super) fn share(plan: &Plan, tau: f32) -> f32 {
    let at = m::abs(tau) * plan.rate_hz / SHARE_STRIDE as f32;
    let n = (at as usize).min(SHARES - 2);
    let part = (at - n as f32).min(1.0);
    plan.shared[n] + part * (plan.shared[n + 1] - plan.shared[n])
}

/// Mean of that share over the pairs: the measured coherence is lower than the field's by this factor, though the
/// estimate hardly suffers (what leaves one frame enters the next).
pub(crate) fn shared_signal(plan: &Plan, used: Used, tau: &[f32; PAIR_COUNT]) -> f32 {
    used.of(tau.iter()).map(|tau| share(plan, *tau)).sum::<f32>() / used.pairs()
}

/// Takes a source of delays `tau` and measured coherence (0 outside the band) out of whitened cross-spectra.
pub(crate) fn remove(
    plan: &Plan,
    band: &Band,
    g: &mut Spectra,
    tau: &[f32; PAIR_COUNT],
    coherence: &[f32; BINS],
) {
    let mean = shared_signal(plan, band.used, tau);
    let runs = band.runs();
    for (p, tau) in tau.iter().enumerate().filter(|(p, _)| band.used.pair(*p)) {
        let scale = share(plan, *tau) / mean;
        let mut phasor = Phasor::new(plan, *tau, runs.start * RUN);
        let coherence = coherence.as_chunks::<RUN>().0.get(runs.clone()).unwrap_or(&[]);
        for (run, power) in g.part_mut(&runs).iter_mut().zip(coherence) {
            let (Some(re), Some(im)) = (run.re.get_mut(p), run.im.get_mut(p)) else { continue };
            for ((power, re), im) in power.iter().zip(re).zip(im) {
                let (s, c) = phasor.next();
                *re -= power * scale * c;
                *im += power * scale * s;
            }
        }
    }
}

/// Turns the coherence `c` of a second source, measured in what the first left, into what has to be put back at the first:
/// along the first's delays the pairs' mean had shown `c₁ + r c₂`, with `r` the mean over pairs of `cos ω(τ₁ − τ₂)`, and all of it
/// was taken out, which leaves `(1 − r²) c₂` along the second's. Gives `−r c₂`, to be removed.
pub(crate) fn overdone(
    plan: &Plan,
    band: &Band,
    first: &[f32; PAIR_COUNT],
    second: &[f32; PAIR_COUNT],
    c: &mut [f32; BINS],
) {
    for (k, c) in c.iter_mut().enumerate().take(band.high).skip(band.low) {
        let r = alike(plan, band, (first, second), k);
        *c *= -r / (1.0 - r * r).max(LEAST_APART);
    }
}

/// Turns the coherence `c` measured along the delays of a second source, beside that measured along a `first`, into what the second has alone: either shows
/// of the other the mean over pairs of `cos ω(τ₁ − τ₂)`. Of what is not told apart it has nothing.
#[inline(never)]
pub(crate) fn alone(
    plan: &Plan,
    band: &Band,
    (first, second): (&[f32; PAIR_COUNT], &[f32; PAIR_COUNT]),
    of_first: &[f32; BINS],
    c: &mut [f32; BINS],
) {
    for (k, (c, of_first)) in c.iter_mut().zip(of_first).enumerate().take(band.high).skip(band.low) {
        let r = alike(plan, band, (first, second), k);
        *c = (*c - r * of_first) / (1.0 - r * r).max(LEAST_APART);
    }
}

/// Mean over pairs of the cosine of what two sources' delays turn a bin by.
fn alike(
    plan: &Plan,
    band: &Band,
    (first, second): (&[f32; PAIR_COUNT], &[f32; PAIR_COUNT]),
    bin: usize,
) -> f32 {
    let omega = bin as f32 * plan.bin_rad_s;
    let turns = band.used.of(first.iter().zip(second)).map(|(a, b)| m::cos(omega * (a - b)));
    turns.sum::<f32>() / band.used.pairs()
}

/// Average over neighbouring bins within the band, less what noise may have made of it; `noise` is the variance of one bin's
/// value under noise alone. Weights and information grow with the square of a coherence that noise alone gives as often as
/// not, times the frequency's: `c (1 − k v/c²)` for a mean of variance v, and none where that is negative, shrinks what is
/// not [`SIGNIFICANT`] (James and Stein, Proc. 4th Berkeley Symp. 1961, with k for their count of means).
pub(crate) fn smoothed(band: &Band, noise: f32, raw: &[f32; BINS], out: &mut [f32; BINS]) {
    out.fill(0.0);
    let (low, high) = (band.low, band.high.min(BINS));
    let at = |k: usize| if k >= low && k < high { raw.get(k).copied().unwrap_or(0.0) } else { 0.0 };
    let mut sum = (low..low + SMOOTH).map(at).sum::<f32>();
    for k in low..high {
        sum += at(k + SMOOTH) - k.checked_sub(SMOOTH + 1).map_or(0.0, at);
        let span = (k + SMOOTH + 1).min(high).saturating_sub(k.saturating_sub(SMOOTH).max(low)) as f32;
        if let Some(out) = out.get_mut(k) {
            let own = SIGNIFICANT * noise * span;
            *out = if sum > 0.0 { (sum - own / sum).max(0.0) / span } else { 0.0 };
        }
    }
}

/// `c` and `n` fit for weights: `c` at least zero, `n` at least [`LEAST_NOISE`].
#[inline]
fn shares(c: f32) -> (f32, f32) {
    let c = c.max(0.0);
    (c, (1.0 - c).max(LEAST_NOISE))
}

/// Weights of every bin from the smoothed coherence: `S/(N(N+4S))`, the maximum likelihood's for four sensors with one
/// signal spectrum and one noise spectrum.
pub(crate) fn weights(band: &Band, smooth: &[f32; BINS], out: &mut [f32; BINS]) {
    out.fill(0.0);
    let sensors = band.used.sensors();
    for (out, c) in out.iter_mut().zip(smooth).take(band.high).skip(band.low) {
        let (c, n) = shares(*c);
        *out = c / (n * (n + sensors * c));
    }
}

/// Effective variance of an arrival time, s² (see the module's formula), for weights from `smooth` and K snapshots.
/// `None` where the weights hold no information.
pub(crate) fn arrival_variance(
    plan: &Plan,
    band: &Band,
    smooth: &[f32; BINS],
    weight: &[f32; BINS],
    snapshots: f32,
) -> Option<Variance> {
    let (mut scatter, mut pair_scatter, mut information) = (0.0f32, 0.0f32, 0.0f32);
    let sensors = band.used.sensors();
    for (k, (c, w)) in smooth.iter().zip(weight).enumerate().take(band.high).skip(band.low) {
        let (c, n) = shares(*c);
        let omega = k as f32 * plan.bin_rad_s;
        let w_omega = w * omega;
        scatter += w_omega * w_omega * n * (n + sensors * c);
        pair_scatter += w_omega * w_omega * (1.0 - c * c).max(LEAST_NOISE);
        information += w_omega * omega * c;
    }
    if information <= 0.0 || snapshots <= 0.0 {
        return None;
    }
    let scale = 1.0 / (2.0 * snapshots * information);
    let variance =
        Variance { arrival: scatter * scale / information, pair: pair_scatter * scale / information };
    (variance.arrival.is_finite() && variance.pair.is_finite()).then_some(variance)
}

/// How each bin's steered cross-spectra push along a change of the pairs' delays, unweighted, into the real parts of `out`.
pub(super) fn push(
    plan: &Plan,
    band: &Band,
    g: &Spectra,
    tau: &[f32; PAIR_COUNT],
    along: &[f32; PAIR_COUNT],
    out: &mut [Complex32],
) {
    let runs = band.runs();
    let start = runs.start * RUN;
    for (p, (tau, along)) in tau.iter().zip(along).enumerate().filter(|(p, _)| band.used.pair(*p)) {
        let mut phasor = Phasor::new(plan, *tau, start);
        let mut out = out.iter_mut().skip(start);
        for run in g.part(&runs) {
            let (Some(re), Some(im)) = (run.re.get(p), run.im.get(p)) else { continue };
            for (re, im) in re.iter().zip(im) {
                let (s, c) = phasor.next();
                let Some(out) = out.next() else { return };
                out.re += along * (re * s + im * c);
            }
        }
    }
}

/// Runs over whose bins what is not noise keeps its phase: a source that stands elsewhere turns against the pair's delay with
/// the frequency, by a radian in 160 Hz at a millisecond and in 1600 Hz at a tenth of one.
const RUNS_TOGETHER: usize = 4;

/// Sums of so many bins.
const SUMS: usize = BINS / (RUNS_TOGETHER * RUN) + 1;

/// Sums whose pushes are taken together, a fifth of the band's: those of a source that stands elsewhere swing with the frequency, once in
/// 1 kHz at a millisecond and in 10 kHz at a tenth of one, and mostly cancel each other.
const TOGETHER: usize = 6;

/// By how much the cross-spectra scatter about a source more than noise does.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scatter {
    /// As a ratio of variances; 1 where it may be noise.
    pub(crate) ratio: f32,
    /// What the direction along the tangents scatters with it, noise included: (first, cross, second), rad². Where the ratio is 1,
    /// of no use.
    pub(crate) direction: (f32, f32, f32),
}

/// The scatter about a source `found`, of smoothed coherence and weights `work`. What was left of a louder source, echoes and images
/// scatter the cross-spectra; they do so in neighbouring bins alike, so these are summed first. What comes from above or below the
/// source turns its elevation and not its azimuth: the direction's covariance is that of the sums' own push along the tangents,
/// `A⁻¹ B A⁻¹` with `A` the information (Huber, Proc. 5th Berkeley Symp. 1967, vol. 1, p. 221) and `B` the sum of their products, those of
/// neighbours included, the less the farther apart they are (Newey and West, Econometrica 55, 1987, p. 703, eq. 5).
pub(super) fn scatter(
    context: &Context<'_>,
    found: &Found,
    g: &Spectra,
    work: (&[f32; BINS], &[f32; BINS]),
) -> Scatter {
    let (smooth, weight) = work;
    let (plan, band, tau) = (context.plan, context.band, &found.tau);
    let direction = &found.refined.direction;
    let e = wavefront::tangents(direction);
    let (curvature, _) = context.curvature(direction);
    let [g1, g2] = [&e.0, &e.1].map(|tangent| {
        wavefront::pair_delays(&wavefront::gradient(&plan.geometry, direction, tangent, curvature))
    });
    let runs = band.runs();
    let (mut seen, mut expected, mut information, mut sums) = (0.0f32, 0.0f32, 0.0f32, 0u32);
    let mut push = [[0.0f32; 2]; SUMS];
    let mut normal = (0.0f32, 0.0f32, 0.0f32);
    let pairs = tau.iter().zip(g1.iter().zip(&g2)).enumerate();
    for (p, (tau, (a, b))) in pairs.filter(|(p, _)| band.used.pair(*p)) {
        normal = (normal.0 + a * a, normal.1 + a * b, normal.2 + b * b);
        let mut phasor = Phasor::new(plan, *tau, runs.start * RUN);
        let mut k = runs.start * RUN;
        for (together, push) in g.part(&runs).chunks(RUNS_TOGETHER).zip(&mut push) {
            let mut sum = 0.0;
            for run in together {
                let (Some(re), Some(im)) = (run.re.get(p), run.im.get(p)) else { continue };
                for (re, im) in re.iter().zip(im) {
                    let (s, c) = phasor.next();
                    let (w, coherence) = (weight.get(k).unwrap_or(&0.0), smooth.get(k).unwrap_or(&0.0));
                    let omega = k as f32 * plan.bin_rad_s;
                    let w_omega = w * omega;
                    sum += w_omega * (re * s + im * c);
                    expected += w_omega * w_omega * (1.0 - coherence * coherence).max(LEAST_NOISE);
                    information += w_omega * omega * coherence;
                    k += 1;
                }
            }
            *push = [push[0] + sum * a, push[1] + sum * b];
            seen += sum * sum;
            sums += 1;
        }
    }
    let ratio = 2.0 * context.snapshots * seen / expected.max(f32::MIN_POSITIVE);
    // The pairs' scatters are those of all hydrophones but one.
    let independent = sums as f32 * (band.used.sensors() - 1.0) / band.used.pairs();
    let noise = !(ratio > 1.0 + 2.0 * m::sqrt(2.0 / independent.max(1.0)));
    // One pair's.
    let information = information / band.used.pairs();
    let (Some((i11, i12, i22)), false) = (wavefront::inverse(normal), noise || information <= 0.0) else {
        return Scatter { ratio: 1.0, direction: (0.0, 0.0, 0.0) };
    };
    let mut direction = (0.0, 0.0, 0.0);
    // The running sum over TOGETHER, from the first alone to the last alone.
    let mut running = [0.0f32; 2];
    let scale = 1.0 / (m::sqrt(TOGETHER as f32) * information);
    for n in 0..SUMS + TOGETHER - 1 {
        for (k, running) in running.iter_mut().enumerate() {
            let at = |n: Option<usize>| n.and_then(|n| push.get(n)).map_or(0.0, |push| push[k]);
            *running += at(Some(n)) - at(n.checked_sub(TOGETHER));
        }
        let [a, b] = running;
        let step = [(i11 * a + i12 * b) * scale, (i12 * a + i22 * b) * scale];
        direction.0 += step[0] * step[0];
        direction.1 += step[0] * step[1];
        direction.2 += step[1] * step[1];
    }
    Scatter { ratio, direction }
}

/// Variances of time estimates, s².
#[derive(Clone, Copy, Debug)]
pub(crate) struct Variance {
    /// Scale of the arrival times in `cov = arrival · (Gᵀ(4I − 11ᵀ)G)⁻¹`.
    pub(crate) arrival: f32,
    /// A single pair's delay.
    pub(crate) pair: f32,
}

/// Gauss-Newton from a start; `None` where the response has no peak there.
#[inline(never)]
pub(crate) fn refine(
    plan: &Plan,
    band: &Band,
    g: &Spectra,
    weight: &[f32; BINS],
    start: &Direction,
    curvature: f32,
) -> Option<Refined> {
    let mut direction = *start;
    for _ in 0..STEPS {
        let tau = wavefront::pair_delays(&wavefront::arrivals(&plan.geometry, &direction, curvature));
        let sums = steer(plan, band, g, &tau, weight);
        let e = wavefront::tangents(&direction);
        let g1 = wavefront::pair_delays(&wavefront::gradient(&plan.geometry, &direction, &e.0, curvature));
        let g2 = wavefront::pair_delays(&wavefront::gradient(&plan.geometry, &direction, &e.1, curvature));
        let bend = sums.bend.iter().sum::<f32>() / band.used.pairs();
        if !(bend > 0.0) {
            return None;
        }
        let (mut b1, mut b2) = (0.0, 0.0);
        // With each pair's own curvature, and with the mean of all.
        let (mut own, mut even) = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0));
        for (((a, b), slope), curved) in band.used.of(g1.iter().zip(&g2).zip(&sums.slope).zip(&sums.bend)) {
            for (h, bend) in [(&mut own, *curved), (&mut even, bend)] {
                *h = (h.0 + bend * a * a, h.1 + bend * a * b, h.2 + bend * b * b);
            }
            b1 -= slope * a;
            b2 -= slope * b;
        }
        // Where vessel and image stand apart, pairs along the vertical are flat: the mean's steps would not arrive. What is flat altogether is
        // noise, or beside the peak.
        let determinant = |h: (f32, f32, f32)| h.0 * h.2 - h.1 * h.1;
        let peaked = own.0 > 0.0 && determinant(own) > LEAST_PEAKED * determinant(even);
        let (i11, i12, i22) = wavefront::inverse(if peaked { own } else { even })?;
        let mut step = [i11 * b1 + i12 * b2, i12 * b1 + i22 * b2];
        // A step beyond the peak's own width means the quadratic model does not hold: go part of the way.
        let length = m::sqrt(step[0] * step[0] + step[1] * step[1]);
        if length > band.resolution {
            step = step.map(|x| x * band.resolution / length);
        }
        direction = wavefront::stepped(&direction, &e, step[0], step[1]);
        if length < CONVERGED * band.resolution {
            break;
        }
    }
    let tau = wavefront::pair_delays(&wavefront::arrivals(&plan.geometry, &direction, curvature));
    let sums = steer(plan, band, g, &tau, weight);
    let mean = sums.bend.iter().sum::<f32>() / band.used.pairs();
    let pull = sums.slope.map(|slope| if mean > 0.0 { -slope / mean } else { 0.0 });
    let mut pair_delay = tau;
    for ((delay, slope), bend) in pair_delay.iter_mut().zip(&sums.slope).zip(&sums.bend) {
        if *bend > 0.0 {
            // Half a sample is as far as a single Newton step can be trusted.
            let most = 0.5 / plan.rate_hz;
            *delay -= (slope / bend).max(-most).min(most);
        }
    }
    direction.iter().all(|x| x.is_finite()).then_some(Refined {
        direction,
        pair_delay,
        pull,
        bend: sums.bend,
    })
}

/// Sums over the band of each pair's steered cross-spectrum (weights are 0 outside the band).
fn steer(plan: &Plan, band: &Band, g: &Spectra, tau: &[f32; PAIR_COUNT], weight: &[f32; BINS]) -> Steered {
    let mut out = Steered { slope: [0.0; PAIR_COUNT], bend: [0.0; PAIR_COUNT] };
    let runs = band.runs();
    let sums = out.slope.iter_mut().zip(&mut out.bend);
    for (p, ((slope, bend), tau)) in sums.zip(tau).enumerate() {
        let mut phasor = Phasor::new(plan, *tau, runs.start * RUN);
        let mut omega = (runs.start * RUN) as f32 * plan.bin_rad_s;
        let (mut first, mut second) = (0.0f32, 0.0f32);
        let weight = weight.as_chunks::<RUN>().0.get(runs.clone()).unwrap_or(&[]);
        for (run, weight) in g.part(&runs).iter().zip(weight) {
            for i in 0..RUN {
                let (s, c) = phasor.next();
                let w_omega = weight[i] * omega;
                first += w_omega * (run.re[p][i] * s + run.im[p][i] * c);
                second += w_omega * omega * (run.re[p][i] * c - run.im[p][i] * s);
                omega += plan.bin_rad_s;
            }
        }
        *slope = first;
        *bend = second;
    }
    out
}
