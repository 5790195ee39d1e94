//! Whether what a vessel leaves is its image in the surface, where the array is longer than that is late.
//!
//! Enters: cross-spectra that a vessel was taken out of by its delays, and in which another direction was found. Leaves: whether there is another source.
//! Vessel and image are one sound: at each frequency the hydrophones hear it in proportion to four numbers, whose phases are the delays' and those
//! of each hydrophone's own fringes. Where sound crosses the array before the image is there the fringes of two hydrophones are shifted against each
//! other, and what the delays alone leave of a pair correlates once, twice and so on as late as the image: another direction that some pairs agree
//! on. The phases are found from the cross-spectra, from the delays' on; the amplitudes are one, as those are whitened. One sound leaves little power
//! when it is taken out by them, two leave the other.
//!
//! Cost: 500 instructions a bin where a long array finds something.

use super::estimate::{Context, Found};
use super::plan::BINS;
use super::refine::{self, Phasor};
use super::spectra::Spectra;
use super::transform::RUN;
use super::wavefront::PAIR_COUNT;
use crate::block::CHANNELS;
use crate::math::f32 as m;
use microfft::Complex32;

/// Arrays that sound crosses in less hear vessel and image in one direction, seconds: 3 m.
const COMPACT_S: f32 = 0.002;
/// How often the phases are found from each other.
const ROUNDS: usize = 6;
/// Least share of the power left that stays where there is another vessel: of what is the image's 0.1 to 0.25 does, with another mostly 0.3 to 0.6.
const STAYS: f32 = 0.25;

/// Real part of one against the other.
fn along(a: &Complex32, b: &Complex32) -> f32 {
    a.re * b.re + a.im * b.im
}

/// Cross-spectra of four hydrophones in these proportions.
#[inline(never)]
fn crossed([a, b, c, d]: [Complex32; CHANNELS]) -> [Complex32; PAIR_COUNT] {
    [a * b.conj(), a * c.conj(), a * d.conj(), b * c.conj(), b * d.conj(), c * d.conj()]
}

/// The proportions that the cross-spectra give to those that the others have, of amplitude one.
#[inline(never)]
fn again(pairs: &[Complex32; PAIR_COUNT], [a, b, c, d]: [Complex32; CHANNELS]) -> [Complex32; CHANNELS] {
    let [ab, ac, ad, bc, bd, cd] = *pairs;
    let sums = [
        ab * b + ac * c + ad * d,
        ab.conj() * a + bc * c + bd * d,
        ac.conj() * a + bc.conj() * b + cd * d,
        ad.conj() * a + bd.conj() * b + cd.conj() * c,
    ];
    sums.map(|x| x * m::inverse_sqrt(x.norm_sqr().max(1e-12)))
}

/// Power that is left of a bin (real and imaginary parts of the pairs), and that the phases of one sound leave, which `heard` are near; so much of that
/// was taken out by its delays.
#[inline(never)]
fn bin(
    (re, im): (&[f32; PAIR_COUNT], &[f32; PAIR_COUNT]),
    taken: f32,
    scale: &[f32; PAIR_COUNT],
    mut heard: [Complex32; CHANNELS],
) -> (f32, f32) {
    let mut pairs = crossed(heard);
    let mut left = 0.0;
    for (((pair, scale), re), im) in pairs.iter_mut().zip(scale).zip(re).zip(im) {
        left += re * re + im * im;
        *pair = *pair * (taken * scale) + Complex32::new(*re, *im);
    }
    for _ in 0..ROUNDS {
        heard = again(&pairs, heard);
    }
    let model = crossed(heard);
    let power = pairs.iter().zip(&model).map(|(pair, model)| along(pair, model)).sum::<f32>();
    let power = power / PAIR_COUNT as f32;
    let mut stays = 0.0;
    for ((pair, model), scale) in pairs.iter().zip(&model).zip(scale) {
        stays += (*pair - *model * (power * scale)).norm_sqr();
    }
    (left, stays)
}

/// Whether what the first source left is its image's, where its measured coherence `taken` (0 outside the band) was taken out.
#[inline(never)]
pub(super) fn is_image(context: &Context<'_>, g: &Spectra, first: &Found, taken: &[f32; BINS]) -> bool {
    let (plan, band) = (context.plan, context.band);
    let longest = plan.crossing_s.iter().fold(COMPACT_S, |a, b| a.max(*b));
    let late = 2.0 * plan.vessel_over_array_depth * plan.depth_m * first.refined.direction[2] * plan.inv_c;
    if longest <= late.max(COMPACT_S) || !(late > 0.0) || !band.used.all() {
        return false;
    }
    let mean = refine::shared_signal(plan, band.used, &first.tau);
    let scale = first.tau.map(|tau| refine::share(plan, tau) / mean);
    let runs = band.runs();
    let [b, c, d, ..] = first.tau;
    let mut phasors = [0.0, b, c, d].map(|t| Phasor::new(plan, t, runs.start * RUN));
    let (mut left, mut stays) = (0.0f32, 0.0f32);
    let taken = taken.as_chunks::<RUN>().0.get(runs.clone()).unwrap_or(&[]);
    for (run, taken) in g.part(&runs).iter().zip(taken) {
        for k in 0..RUN {
            let of = |values: &[[f32; RUN]; PAIR_COUNT]| values.map(|value| value[k]);
            let heard = phasors.each_mut().map(|phasor| {
                let (s, c) = phasor.next();
                Complex32::new(c, s)
            });
            let (was, is) = bin((&of(&run.re), &of(&run.im)), taken[k], &scale, heard);
            left += was;
            stays += is;
        }
    }
    stays < STAYS * left
}

#[cfg(test)]
mod tests {
    use super::super::test_sea::{error_from, hear, noisy, planned, source};
    use crate::block::CHANNELS;
    use std::vec::Vec;

    const RATE_HZ: f64 = 8000.0;

    /// A vessel 4 m deep, 300 m from an array of 15 m 168 m deep, and what else is in the sea.
    fn told(azimuth: f64, other: Option<(f64, f64)>, seed: u64) -> Vec<crate::wire::Bearing> {
        let plan = planned(RATE_HZ, |array| {
            array.hydrophones_m.iter_mut().flatten().for_each(|x| *x *= 15.0 / 1.84);
            array.vessel_depth_m = 4.0;
        });
        // The image comes from 0.9° higher, 2.6 ms later.
        let (late, seconds) = (21, 40);
        let [direct, image] = [0.504, 0.520].map(|up| source(&plan, (azimuth, up), 6.0, None, seconds, seed));
        let mut sea: Vec<_> = (late..direct.len())
            .map(|n| core::array::from_fn::<f64, CHANNELS, _>(|c| direct[n][c] - image[n - late][c]))
            .collect();
        if let Some(other) = other {
            let heard = source(&plan, other, 7.0, None, seconds, seed ^ 77);
            sea.iter_mut().flatten().zip(heard.as_flattened()).for_each(|(sum, x)| *sum += x);
        }
        hear(&plan, &noisy(sea, seed ^ 5)).bearings
    }

    #[test]
    fn what_the_image_leaves_to_a_long_array_is_nobody() {
        for n in 0..6u64 {
            let azimuth = 0.4 + n as f64;
            let bearings = told(azimuth, None, 60 + n);
            assert!(bearings.iter().filter(|b| b.band == 0).count() > 70, "{n}");
            let nobody = |b: &&crate::wire::Bearing| error_from(b, (azimuth, 0.5)).0.abs() > 0.05;
            assert_eq!(bearings.iter().filter(nobody).count(), 0, "{n}");
        }
    }

    #[test]
    fn another_vessel_is_told_to_a_long_array() {
        let other = (3.3, 0.3);
        let bearings = told(1.0, Some(other), 71);
        let of = |at: (f64, f64)| bearings.iter().filter(|b| error_from(b, at).0.abs() < 0.05).count();
        assert!(of(other) > 20 && of((1.0, 0.5)) > 20, "{} {}", of(other), of((1.0, 0.5)));
    }
}
