//! What frames make of a vessel and its image.
//!
//! A frame holds a part of the vessel's sound without what the surface gives back of it, and of the image's without the vessel's. For
//! two hydrophones that hear the vessel τ apart, and its image Δ later than it, the cross-spectrum's products of one's direct sound
//! with the other's image have the lags τ − Δ and τ + Δ, of which the frames share `w(τ − Δ)` and `w(τ + Δ)`, w the window's
//! autocorrelation. Their difference turns the phase half-way between vessel and image by a part in quadrature,
//! `(w(τ + Δ) − w(τ − Δ)) sin ωΔ`, up on one flank of each fringe and down on the other. Whitened by spectra whose fringes lie
//! elsewhere, because each hydrophone is another way below the surface, it does not average out: it looks like an image fainter
//! than it is, and moves the direction itself. Both grow with delay against frame: at 64 kHz by a fourteenth of the angle
//! between the two, at 16 kHz by a hundredth.
//!
//! Enters: depth and elevation of the vessel, how deep its fringes are. Leaves: the push of each bin that comes of it. Cost: 130
//! instructions a bin, every [`EVERY`] segments.

use super::plan::{Band, Plan};
use super::refine::{self, Phasor};
use super::spectra::Spectra;
use super::transform::RUN;
use super::wavefront::{self, Direction, PAIR_COUNT};
use crate::block::CHANNELS;
use crate::geometry::PAIRS;
use crate::math::f32 as m;
use microfft::Complex32;

/// Segments from one look to the next: the geometry changes slowly.
pub(super) const EVERY: u32 = 8;
/// What is feigned of a loss, in units of what this says: a law that fits passes of vessels 2 to 8 m deep, 200 m to 1 km away, at 64 kHz.
pub(super) const FEIGNED: f32 = 1.15;
/// Share of what is taken out that may be wrong.
pub(super) const SD: f32 = 0.1;
/// Least share of a fringe's depth that the mean over hydrophones keeps.
const LEAST_KEPT: f32 = 0.3;
/// Least power of a bin against its neighbours' mean.
const LEAST_POWER: f32 = 1e-3;

/// A vessel's image.
#[derive(Clone, Copy, Debug)]
pub(super) struct Image {
    /// By how much later than the vessel each hydrophone hears it, s.
    delay_s: [f32; CHANNELS],
    /// Depth of the fringes in the mean spectrum of all hydrophones, full ones being 1.
    height: f32,
}

impl Image {
    /// That of a vessel so deep (metres) under a surface seen at an elevation of this `sine`, heard from there, whose fringes are so deep in
    /// the spectra's mean.
    pub(super) fn of(plan: &Plan, direction: &Direction, sine: f32, depth_m: f32, height: f32) -> Self {
        let delay_s = plan.geometry.position_m.map(|h| {
            // The hydrophone's way to the surface, and to where vessel and image are heard together.
            let nearer = (wavefront::dot(&h, direction) * sine - h[2]) / plan.depth_m;
            2.0 * depth_m * sine * plan.inv_c * (1.0 + nearer)
        });
        Self { delay_s, height }
    }

    fn mean_s(&self) -> f32 {
        self.delay_s.iter().sum::<f32>() / CHANNELS as f32
    }

    /// Share of a fringe's depth that is left in the mean over the hydrophones, whose fringes lie beside each other.
    fn kept(&self, plan: &Plan, band: &Band) -> f32 {
        let (low, high) = (band.low as f32, band.high as f32);
        let mean_s = self.mean_s();
        let kept = self.delay_s.iter().map(|delay| {
            // The mean of cos ω(Δ − Δ̄) over the band.
            let turn = plan.bin_rad_s * (delay - mean_s);
            if m::abs(turn) * high < 1e-2 {
                return 1.0;
            }
            (m::sin_cos(turn * high).0 - m::sin_cos(turn * low).0) / (turn * (high - low))
        });
        (kept.sum::<f32>() / CHANNELS as f32).max(LEAST_KEPT)
    }

    /// The push of each bin along a change of the pairs' delays that comes of the frames, as [`refine::push`] has it, into the real parts of
    /// `own`, whose imaginary parts are the hydrophones' flattened power; `share` has that power's running mean over it in its
    /// imaginary parts.
    #[inline(never)]
    pub(super) fn push(
        &self,
        plan: &Plan,
        band: &Band,
        g: &Spectra,
        (tau, along): (&[f32; PAIR_COUNT], &[f32; PAIR_COUNT]),
        share: &[Complex32],
        own: &mut [Complex32],
    ) {
        let amplitude = 0.5 * self.height / (refine::share(plan, self.mean_s()) * self.kept(plan, band));
        let mut turns = [0.0f32; PAIR_COUNT];
        for (((turn, (i, j)), tau), along) in turns.iter_mut().zip(PAIRS).zip(tau).zip(along) {
            let delay = |h: usize| self.delay_s.get(h).copied().unwrap_or(0.0);
            let delay = 0.5 * (delay(i) + delay(j));
            *turn = amplitude * along * (refine::share(plan, tau + delay) - refine::share(plan, tau - delay));
        }
        let bins = || (band.low..band.high).filter_map(|k| Some((k, g.runs.get(k / RUN)?)));
        let mut powers = [f32::MIN_POSITIVE; CHANNELS];
        for (k, run) in bins() {
            for (power, auto) in powers.iter_mut().zip(&run.auto) {
                *power += auto.get(k % RUN).map_or(0.0, |auto| auto * (k * k) as f32);
            }
        }
        let total = powers.iter().sum::<f32>();
        // Each hydrophone's power against its running mean, which goes as that of all.
        let parts = powers.map(|power| total / power);
        // Half of each delay: the sum of two is a pair's mean.
        let mut phasors = self.delay_s.map(|delay| Phasor::new(plan, 0.5 * delay, band.low));
        for (k, run) in bins() {
            let Some(place) = own.get_mut(k) else { return };
            let mean = place.im * share.get(k).map_or(0.0, |z| z.im);
            let mut waves = [(0.0f32, 0.0f32); CHANNELS];
            for (((wave, phasor), part), auto) in
                waves.iter_mut().zip(&mut phasors).zip(&parts).zip(&run.auto)
            {
                let power = auto.get(k % RUN).map_or(0.0, |auto| auto * part * (k * k) as f32);
                let whiten = m::inverse_sqrt((power / mean).max(LEAST_POWER));
                let (s, c) = phasor.next();
                *wave = (s * whiten, c * whiten);
            }
            let mut sum = 0.0;
            for (turn, (i, j)) in turns.iter().zip(PAIRS) {
                let wave = |h: usize| waves.get(h).copied().unwrap_or_default();
                let ((si, ci), (sj, cj)) = (wave(i), wave(j));
                sum += turn * (si * cj + ci * sj);
            }
            place.re = if sum.is_finite() { sum } else { 0.0 };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::plan::FRAME;
    use super::super::test_sea::plan;
    use super::*;
    use std::boxed::Box;
    use std::vec;

    const TAU_S: [f32; PAIR_COUNT] = [1e-4, -2e-4, 3e-4, 0.0, 5e-4, -4e-4];
    const ALONG_S: [f32; PAIR_COUNT] = [0.0, 1e-4, 9e-4, -1e-4, 8e-4, 7e-4];

    /// The push of spectra without fringes, of which half the depth is told.
    fn pushed(delay_s: [f32; CHANNELS]) -> (Box<Plan>, Image, vec::Vec<Complex32>) {
        let plan = Box::new(plan(64_000.0));
        let mut spectra = Box::new(Spectra::new());
        for (r, run) in spectra.runs.iter_mut().enumerate() {
            for i in 0..RUN {
                // Flattened by the square of the bin, as `fringes::flattened` has it.
                let k = (RUN * r + i).max(1) as f32;
                run.auto.iter_mut().for_each(|auto| auto[i] = 1.0 / (k * k));
            }
        }
        let image = Image { delay_s, height: 0.5 };
        let share = vec![Complex32::new(0.0, 1.0); FRAME];
        let mut own = vec![Complex32::new(0.0, CHANNELS as f32); FRAME];
        image.push(&plan, &plan.whole, &spectra, (&TAU_S, &ALONG_S), &share, &mut own);
        (plan, image, own)
    }

    #[test]
    fn the_push_is_the_frames_part_in_quadrature() {
        let delay_s = [1.60e-3, 1.60e-3, 1.61e-3, 1.59e-3];
        let (plan, image, own) = pushed(delay_s);
        let whole = &plan.whole;
        let amplitude = 0.25 / (refine::share(&plan, image.mean_s()) * image.kept(&plan, whole));
        for k in (whole.low..whole.high).step_by(13) {
            let omega = plan.bin_rad_s * k as f32;
            let want: f32 = (PAIRS.iter().zip(TAU_S).zip(ALONG_S))
                .map(|(((i, j), tau), along)| {
                    let delay = 0.5 * (delay_s[*i] + delay_s[*j]);
                    let apart = refine::share(&plan, tau + delay) - refine::share(&plan, tau - delay);
                    amplitude * along * apart * m::sin_cos(omega * delay).0
                })
                .sum();
            assert!((own[k].re - want).abs() < 2e-6, "{k}: {} {want}", own[k].re);
        }
        let largest = own.iter().map(|z| z.re.abs()).fold(0.0, f32::max);
        assert!(largest > 2e-5, "{largest}");
    }

    #[test]
    fn an_image_that_is_not_late_pushes_nothing() {
        let (_, _, own) = pushed([0.0; CHANNELS]);
        assert!(own.iter().all(|z| z.re.abs() < 1e-9));
    }
}
