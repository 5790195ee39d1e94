//! How wide in azimuth the strongest source is.
//!
//! Enters: how curved each pair's response is in the direction found. Leaves: the variance that a source so wide puts on the azimuth. Two
//! vessels side by side, nearer to each other than the array resolves, are heard as one between them, and no bearing jumps; but the pairs
//! across their direction lose coherence with the frequency, those along it do not. Of sound from directions spread about one by a second
//! moment `M`, the cross-spectrum steered there is `1 − ½ω² gᵀMg` of a point's, with `g` the pair's change of delay along the tangents (two
//! terms of the cosine's series), so that a pair's `Σ Wω² Re` falls short of that of a point by `½ gᵀMg Σ Wω⁴ c`. What all pairs fall short
//! by is noise; what they do along products of `g` is `M`: its upper part a vessel's and its image's or an echo's, its level part only
//! another vessel's, which errs by no more from either than the square root of that, `√(s(1−s))` of what the two are apart, with shares s and 1 − s.
//!
//! Cost: some 2000 instructions.

use super::estimate::{Context, Found, SpectrumWork};
use super::patterns::{Pairs, along, times};
use super::refine::{self, LEAST_NOISE};
use super::wavefront::PAIR_COUNT;
use crate::math::f32 as m;

/// Segments over which it is averaged, and how many of them count as one because they overlap.
const AVERAGED: f32 = 12.0;
const SHARED: f32 = 1.5;
/// Standard deviations of noise, and share of the upper part, which the cosine's two terms do not fit where vessel and image are
/// resolved, beyond which it is told.
const SIGNIFICANT: f32 = 2.0;
const UNFITTING: f32 = 0.03;

/// One bin in so many is looked at: coherence and weights are means over nine.
const STRIDE: usize = 4;

/// Means over segments of the strongest source's second moments, rad².
#[derive(Clone, Copy, Debug)]
pub(super) struct Width {
    level: f32,
    upper: f32,
    /// What noise makes of the first in one segment, rad⁴.
    noise: f32,
    segments: f32,
}

impl Width {
    /// Of no source.
    pub(super) const NONE: Self = Self { level: 0.0, upper: 0.0, noise: 0.0, segments: 0.0 };

    /// Takes a segment's source, for the pairs' changes of delay along the horizontal and upward tangents (s/rad), which turned by
    /// `swept` (radians) meanwhile. Leaves what its width puts on the horizontal angle, rad².
    #[inline(never)]
    pub(super) fn take(
        &mut self,
        context: &Context<'_>,
        found: &Found,
        work: &SpectrumWork,
        (across, up): (&Pairs, &Pairs),
        swept: f32,
    ) -> f32 {
        let plan = context.plan;
        let (mut curved, mut noise) = (0.0f32, 0.0f32);
        let mut k = context.band.low;
        while k < context.band.high
            && let (Some(c), Some(w)) = (work.smooth.get(k), work.weight.get(k))
        {
            let omega = k as f32 * plan.bin_rad_s;
            let square = w * omega * omega;
            let incoherent = (1.0 - c * c).max(LEAST_NOISE);
            curved += square * omega * omega * c;
            noise += square * square * incoherent * incoherent;
            k += STRIDE;
        }
        (curved, noise) = (STRIDE as f32 * curved, STRIDE as f32 * noise);
        // Short of a point's, but for what all pairs have in common.
        let mut short = found.refined.bend;
        short
            .iter_mut()
            .zip(&found.tau)
            .for_each(|(bend, tau)| *bend /= -0.5 * curved * refine::share(plan, *tau));
        // The square of `curved` is beyond single precision.
        let noise = 2.0 * noise / (context.snapshots * curved) / curved;
        let (square_across, square_up) = (times(across, across), times(up, up));
        let (all, both) = ([1.0; PAIR_COUNT], times(across, up));
        let level = along(&short, [all, both, square_up, square_across]);
        let upper = along(&short, [all, both, square_across, square_up]);
        if let (Some((level, own)), Some((upper, _))) = (level, upper)
            && curved > 0.0
        {
            self.segments = (self.segments + 1.0).min(AVERAGED);
            let part = 1.0 / self.segments;
            self.level += part * (level - swept * swept / 12.0 - self.level);
            self.upper += part * (upper.max(0.0) - self.upper);
            self.noise += part * (noise / own - self.noise);
        }
        let doubt = m::sqrt(self.noise * SHARED / self.segments.max(SHARED));
        if self.level > SIGNIFICANT * doubt + UNFITTING * self.upper { self.level } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_sea::{Normal, hear, noisy, plan, source};
    use super::super::wavefront::{gradient, pair_delays, tangents};
    use super::*;
    use crate::angle::{unit_vector, wrap_pi};
    use std::vec::Vec;

    /// Root mean square of the stated deviation and worst distance from either of two like vessels, or of one, in resolution cells, and how many
    /// bearings.
    fn heard(rate_hz: f64, apart_cells: f64, seconds: usize) -> (f64, f64, usize) {
        let plan = plan(rate_hz);
        let cell = f64::from(plan.whole.resolution);
        let of = [-0.5, 0.5].map(|x| 1.7 + x * apart_cells * cell);
        let mut sea = source(&plan, (of[0], 0.3), 4.0, None, seconds, 21);
        if apart_cells > 0.0 {
            let second = source(&plan, (of[1], 0.3), 3.0, None, seconds, 22);
            sea.iter_mut().flatten().zip(second.into_iter().flatten()).for_each(|(x, y)| *x += y);
        }
        let bearings: Vec<_> = hear(&plan, &noisy(sea, 5))
            .bearings
            .into_iter()
            .filter(|b| b.band == 0 && b.index > 4 * rate_hz as u64)
            .collect();
        let off = |b: &crate::wire::Bearing| {
            of.map(|at| wrap_pi(f64::from(b.azimuth) - at).abs()).into_iter().fold(f64::MAX, f64::min)
        };
        let worst = bearings.iter().map(off).fold(0.0, f64::max);
        let stated = bearings.iter().map(|b| f64::from(b.var_azimuth)).sum::<f64>() / bearings.len() as f64;
        (stated.sqrt() / cell, worst / cell, bearings.len())
    }

    #[test]
    fn two_side_by_side_are_told_as_wide_as_they_are_and_one_is_none_the_wider() {
        for rate_hz in [16_000.0, 64_000.0] {
            let (alone, _, of) = heard(rate_hz, 0.0, 10);
            assert!(alone < 0.03 && of > 10, "{rate_hz}: {alone} {of}");
            for apart in [0.3, 0.6, 1.0] {
                let (stated, worst, of) = heard(rate_hz, apart, 10);
                std::println!("{rate_hz} {apart}: {stated:.3} {worst:.3} {of}");
                // Shares of 16 and 9.
                assert!((0.35..=0.6).contains(&(stated / apart)), "{rate_hz} {apart}: {stated}");
                assert!(worst < 1.2 * stated && of > 10, "{rate_hz} {apart}: {worst} of {stated} {of}");
            }
        }
    }

    #[test]
    fn what_lies_along_a_pattern_is_told_beside_others() {
        let plan = plan(16_000.0);
        let mut random = Normal(8);
        for n in 0..200 {
            let u = unit_vector(0.1 * n as f32, 0.05 + 0.004 * n as f32);
            let e = tangents(&u);
            let [across, up] = [e.0, e.1].map(|e| pair_delays(&gradient(plan.geometry(), &u, &e, 0.0)));
            let patterns = [[1.0; PAIR_COUNT], times(&across, &up), times(&up, &up), times(&across, &across)];
            let of = [
                random.next() as f32 * 1e-6,
                random.next() as f32,
                random.next() as f32,
                random.next() as f32,
            ];
            let mut values = [0.0f32; PAIR_COUNT];
            for (pattern, of) in patterns.iter().zip(of) {
                values.iter_mut().zip(pattern).for_each(|(x, p)| *x += of * p);
            }
            let (found, square) = along(&values, patterns).unwrap();
            assert!((found - of[3]).abs() < 1e-3 && square > 0.0, "{n}: {found} {}", of[3]);
        }
    }
}
