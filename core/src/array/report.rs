//! From a source found to its record: covariance with what noise does not explain, quality, closure.
//!
//! Covariance: the Cramér-Rao form of `refine` with the measured coherence. To it come what the segment itself shows and what
//! the surface does:
//!
//! * Noise makes the pairs' own delays differ from the common direction's by up to `NOISE_RESIDUAL` variances of a pair's
//!   delay. The mean square beyond that comes of paths and other vessels, and errors as large are in the arrival times of the
//!   common direction; more where they contradict it lastingly (`agreement`). Noise changes from segment to segment and
//!   another vessel's part does not, so the mean over `AVERAGED` segments tells of less than one segment alone.
//! * Hydrophones displaced by `position_sd_m` move their arrivals by as much over the speed of sound; a speed of sound or a
//!   distance that are not as assumed change all arrivals together. These errors last: [`crate::passage`] keeps the first of
//!   them apart from noise.
//! * A vessel d deep and its image in the surface, seen from depth D at elevation β, are `2 d sin β cos β / D` apart in
//!   elevation and come as one, from the surface between them. Half of that is taken off the elevation: with the depth that the
//!   image's fringes tell (`fringes`), or else `vessel_depth_m` (0: no surface), and as much as the deviation. Where the
//!   pairs' misfit says that the two come apart, what is found may be either: the deviation grows to the whole half.

use super::agreement::Doubt;
use super::estimate::{Context, Found, SpectrumWork};
use super::refine;
use super::wavefront::{self, PAIR_COUNT};
use crate::math::{self, f32 as m};
use crate::wire::Bearing;

/// Least standard deviation of a pair delay assumed when quality is judged, samples: calibration and multipath.
const DELAY_FLOOR_SAMPLES: f32 = 0.02;

/// Mean square by which pair delays miss the common direction's under noise alone, in variances of a pair's delay: 0.7 is
/// expected, nine in ten segments stay below this.
const NOISE_RESIDUAL: f32 = 3.0;
/// Segments over which the misfit is averaged; its mean under noise alone, in the same unit, and what an error so large in the pairs
/// puts on the direction: two of six dimensions are the direction's own, and the pairs share theirs unequally.
const AVERAGED: f32 = 12.0;
const MEAN_RESIDUAL: f32 = 1.2;
const SHARED_UNEQUALLY: f32 = 2.0;
/// The same at high signal-to-noise ratios, where what frames of two hydrophones do not share dominates: samples.
const ROUNDING_SAMPLES: f32 = 0.004;
/// Near its threshold a peak may stand on the neighbouring lobe, and its coherence is the luckiest of many: the variance is
/// larger by this over the fourth power of the statistic (a law that fits white noise from threshold to three times it).
const NEAR_THRESHOLD: f32 = 2.0;

/// Standard deviation of the height from which vessel and image are heard together, in units of the vessel's depth and for each
/// radian between the two: a law that fits passes of vessels 2 to 8 m deep, 200 m to 1 km away.
const HALF_WAY_SD: f32 = 0.8;

/// How it is known what other paths and sources do to a bearing.
pub(super) enum Others<'a> {
    /// By the mean of the pairs' misfit over segments, which this one joins: the strongest source is heard in each.
    /// And by the second while another source is heard.
    Lasting(&'a mut f32, f32),
    /// By how much more the segment's own cross-spectra scatter than noise explains ([`refine::scatter`]): what taking out a
    /// louder source left.
    Scatter(f32),
}

/// The record of a found source, with the covariance that its smoothed coherence gives and what it `turned` (radians) while its
/// moment is unknown; `None` where there is none.
pub(super) fn bearing(
    context: &Context<'_>,
    found: &Found,
    work: &SpectrumWork,
    doubt: Doubt,
    turned: f32,
    band: u8,
    others: Others<'_>,
) -> Option<Bearing> {
    let plan = context.plan;
    let used = context.band.used;
    let direction = &found.refined.direction;
    let variance =
        refine::arrival_variance(plan, context.band, &work.smooth, &work.weight, context.snapshots)?;
    let e = wavefront::tangents(direction);
    let (curvature, curvature_sd) = context.curvature(direction);
    let g1 = wavefront::gradient(&plan.geometry, direction, &e.0, curvature);
    let g2 = wavefront::gradient(&plan.geometry, direction, &e.1, curvature);
    let inverse = wavefront::inverse(used.information(&g1, &g2))?;
    let (first, cross, second) = inverse;
    let residual = used.of(found.refined.pair_delay.iter().zip(&found.tau));
    let residual = residual.map(|(own, tau)| (own - tau) * (own - tau)).sum::<f32>() / used.pairs();
    let rounding = ROUNDING_SAMPLES / plan.rate_hz;
    let unexplained = (residual - NOISE_RESIDUAL * variance.pair - rounding * rounding).max(0.0);
    let (mut lasting, mut scatter, mut usual) = (0.0, 1.0, 0.0f32);
    match others {
        Others::Lasting(mean, ratio) => {
            *mean += (residual / (variance.pair + rounding * rounding) - *mean) / AVERAGED;
            usual = m::sqrt(mean.max(0.0));
            // Misfit and scatter tell of the same other sound: the greater counts.
            let misfit = SHARED_UNEQUALLY * (*mean - MEAN_RESIDUAL).max(0.0) * variance.pair;
            lasting = misfit.max((ratio - 1.0) * variance.arrival);
        }
        Others::Scatter(ratio) => scatter = ratio,
    }
    let square = found.statistic * found.statistic;
    let lucky = NEAR_THRESHOLD / (square * square).max(1.0);
    let scale = variance.arrival * (scatter + lucky)
        + unexplained.max(lasting).max(doubt.unexplained_s2)
        + used.sensors() * plan.position_sd_s * plan.position_sd_s;
    // What a speed of sound and a distance that are not as assumed do to all arrival times together.
    let slowness = wavefront::arrivals(&plan.geometry, direction, curvature);
    let bends = plan.geometry.position_m.map(|h| {
        let along = wavefront::dot(&h, direction);
        0.5 * plan.inv_c * (wavefront::dot(&h, &h) - along * along)
    });
    let (mut first, mut cross, mut second) = (scale * first, scale * cross, scale * second);
    for (times, sd) in [(slowness, plan.sound_speed_sd), (bends, curvature_sd)] {
        let ((_, b1, _), (_, b2, _)) = (used.information(&g1, &times), used.information(&g2, &times));
        let (a, b) = (sd * (inverse.0 * b1 + inverse.1 * b2), sd * (inverse.1 * b1 + inverse.2 * b2));
        first += a * a;
        cross += a * b;
        second += b * b;
    }
    let (azimuth, elevation) = wavefront::angles(direction);
    // A step along the horizontal tangent turns the azimuth by 1/cos β; at the zenith azimuth means nothing.
    let widen = 1.0 / e.1[2].max(1e-3);
    let most = m::PI * m::PI / 3.0;
    let floor = DELAY_FLOOR_SAMPLES / plan.rate_hz;
    let misfit = m::sqrt(residual / (variance.pair + floor * floor));
    // A misfit of half as much again as noise explains costs nothing.
    let doubtful = misfit.max(1.5) / 1.5;
    // Pairs that usually disagree hear more than a vessel and its image: an echo off the bottom, or image and vessel apart.
    let more = misfit.max(usual).max(1.5) / 1.5 - 1.0;
    // Vessel and image come from where the surface is above them: d sin β cos β / D above the vessel.
    let rise = m::abs(e.1[2] * direction[2].max(0.0));
    let (image, image_sd) = match context.depth {
        Some((d, sd)) => {
            let apart = 2.0 * rise * d / plan.depth_m;
            let half_way = (HALF_WAY_SD * apart + more).min(1.0);
            (d / plan.depth_m, m::hypot(sd, half_way * d) / plan.depth_m)
        }
        // Propellers are 2 to 8 m deep, and where no fringes show other paths may join.
        None => (plan.vessel_over_array_depth, plan.vessel_over_array_depth),
    };
    let (image, image_sd) = (rise * image, rise * image_sd);
    let mean = found.mean.clamp(1e-6, 1.0 - 1e-6);
    Some(Bearing {
        index: context.index,
        azimuth,
        elevation: elevation - image,
        var_azimuth: ((first + turned * turned) * widen * widen).min(most),
        var_elevation: (second + image_sd * image_sd).min(most),
        cov: (cross * widen).clamp(-most, most),
        snr_db: math::db(mean / (1.0 - mean)),
        quality: doubt.quality / doubtful,
        closure_s: closure(&found.refined.pair_delay),
        statistic: found.statistic,
        band,
        flags: context.flags,
    })
}

/// Root-mean-square closure of the four triangles of pair delays, seconds.
pub fn closure(d: &[f32; PAIR_COUNT]) -> f32 {
    let [d01, d02, d03, d12, d13, d23] = *d;
    let loops = [d01 + d12 - d02, d01 + d13 - d03, d02 + d23 - d03, d12 + d23 - d13];
    m::sqrt(0.25 * loops.iter().map(|x| x * x).sum::<f32>())
}

#[cfg(test)]
#[path = "stated_tests.rs"]
mod tests;
