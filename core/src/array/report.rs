//! From a source found to its record: covariance with what noise does not explain, quality, closure.
//!
//! Covariance: the Cramér-Rao form of `refine` with the measured coherence. To it come what the segment itself shows and what
//! the surface does:
//!
//! * Noise makes the pairs' own delays differ from the common direction's by up to `NOISE_RESIDUAL` variances of a pair's
//!   delay. The mean square beyond that comes of paths and other vessels, and errors as large are in the arrival times of the
//!   common direction; more where they contradict it lastingly (`agreement`). Noise changes from segment to segment and
//!   another vessel's part does not, so the mean over `AVERAGED` segments tells of less than one segment alone. Paths of one vessel
//!   stand above each other: under a surface what the pairs contradict counts for the azimuth only as far as paths do not explain it (`aside`).
//! * Hydrophones displaced by `position_sd_m` move their arrivals by as much over the speed of sound; a speed of sound or a
//!   distance that are not as assumed change all arrivals together. These errors last: [`crate::passage`] keeps the first of
//!   them apart from noise.
//! * A vessel d deep and its image in the surface, seen from depth D at elevation β, are `2 d sin β cos β / D` apart in
//!   elevation and come as one, from the surface between them. Half of that is taken off the elevation: with the depth that the
//!   image's fringes tell (`fringes`), or else `vessel_depth_m` (0: no surface), and as much as the deviation. Where the
//!   pairs' misfit says that the two come apart, or that a third path joins, the elevation errs by more than the misfit shows: paths of
//!   one vessel differ in elevation alone.
//! * Where another source is heard, another vessel or an echo, the cross-spectra's scatter tells what it does to either angle
//!   (`refine::scatter`), noise taken off.
//! * Noise is taken as what the bearings' own scatter shows of it in either angle, where that is less (`steady`).

use super::agreement::Doubt;
use super::aside;
use super::change;
use super::echo::Echo;
use super::estimate::{Context, Found, SpectrumWork};
use super::refine::{self, Scatter};
use super::steady::Steady;
use super::wavefront::{self, PAIR_COUNT};
use super::width::Width;
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
/// Above this mean misfit the cross-spectra's scatter is looked at: whether it is in the elevation alone.
pub(super) const DISAGREEING: f32 = 1.5;
const SHARED_UNEQUALLY: f32 = 2.0;
/// What a dimension has of the pairs' noise, in units of a pair's share: the direction has taken two of six.
const A_DIMENSION: f32 = 1.5;
/// The same at high signal-to-noise ratios, where what frames of two hydrophones do not share dominates: samples.
const ROUNDING_SAMPLES: f32 = 0.004;
/// Near its threshold a peak may stand on the neighbouring lobe, and its coherence is the luckiest of many: the variance is
/// larger by this over the fourth power of the statistic (a law that fits white noise from threshold to three times it).
const NEAR_THRESHOLD: f32 = 2.0;

/// Standard deviation of the height from which vessel and image are heard together, in units of the vessel's depth and for each
/// radian between the two: a law that fits passes of vessels 2 to 8 m deep, 200 m to 1 km away, with the depth's own deviation.
const HALF_WAY_SD: f32 = 0.3;
/// Standard deviation of a depth that no fringes tell, in units of `vessel_depth_m`: propellers 2 to 8 m deep are, about 4 m, 2 m off
/// in the root mean square.
const UNKNOWN_DEPTH_SD: f32 = 0.5;
/// Where vessel and image are farther apart than the array's resolution, and no fringes tell the depth, the direction is of one of them or between:
/// standard deviation of the elevation, in units of half of what they are apart, for each `(apart / (2 · resolution))⁴` up to 1: a law that fits passes at 64 kHz,
/// 200 m to 1 km away from arrays 60 and 168 m deep.
const ONE_OF_TWO_SD: f32 = 0.7;
/// What the same puts on the azimuth, where they are more than [`FAR_APART`] resolutions from half-way, as each pair is nearer to the one or the other: a law that
/// fits passes 30 to 60 m from arrays 25 to 60 m deep at 64 kHz.
const ASIDE_OF_TWO_SD: f32 = 0.008;
const FAR_APART: f32 = 4.0;
/// What it puts on the azimuth from [`JOINED_APART`] resolutions on, where some pairs have gone over to the one and the others are half-way, in resolutions: a law that fits 42
/// random passes at 64 kHz, of vessels 10 m to 2 km aside of arrays 30 to 400 m deep.
const ASIDE_OF_JOINED_SD: f32 = 0.03;
const JOINED_APART: f32 = 1.5;
/// What is left of that where the vessel is found without its image, in units of half of what they are apart: a law that fits 360 such passes.
const ASIDE_OF_VESSEL_SD: f32 = 0.01;
/// The same of one pair beside the two others: a law that fits the same passes heard by three hydrophones.
const PAIRS_APART: f32 = 0.2;
/// Error of the elevation where paths of one vessel join, in units of what the pairs' misfit puts on a direction: a law that fits
/// bottoms 2 to 30 m below the array and passes with the surface's image, at 16 and 64 kHz. Fringes that tell the depth are those of two
/// paths: then nothing beside the misfit itself, or as much again where another source is heard.
const PATHS: f32 = 4.0;

/// Standard deviation of what an echo turns the azimuth by, in units of that: a law that fits irregular arrays over bottoms 2 to 30 m below.
const ECHO_SD: f32 = 0.5;

/// How it is known what other paths and sources do to a bearing.
pub(super) enum Others<'a> {
    /// By the means over segments, which this one joins: the strongest source is heard in each.
    Lasting {
        /// Of the pairs' misfit.
        misfit: &'a mut f32,
        /// Of what the pairs contradict the direction aside of the vertical plane through it.
        aside: &'a mut f32,
        /// Of the bearings' scatter.
        steady: &'a mut Steady,
        /// Of how wide it is, and the angle by which it turned in the segment.
        width: (&'a mut Width, f32),
        /// Of its echo off the bottom.
        echo: &'a Echo,
        /// And what the segment's own cross-spectra show while another source is heard.
        scatter: Option<Scatter>,
        /// Whether neither another source nor an echo is known.
        alone: bool,
        /// What a vessel that it passes by puts on it, across and up, rad².
        beside: Option<[f32; 2]>,
        /// Takes what of its variances changes from segment to segment and what does not.
        stated: &'a mut change::Scatter,
    },
    /// By how much more the segment's own cross-spectra scatter than noise explains (`refine::scatter`): what taking out a
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
    // Of arrival times, s²: what is in the azimuth, what is in the elevation, and what paths of the vessel itself put on that.
    let (mut level, mut rise, mut paths) = (unexplained, unexplained, 0.0);
    // What another source does to the angles, rad².
    let mut other = (0.0f32, 0.0f32, 0.0f32);
    let mut told_of = None;
    // What its width and its echo leave to the azimuth's doubt, rad²: no scatter by which a channel's change would be judged.
    let mut wide = 0.0;
    // By how much an echo turns it.
    let mut aside_rad = 0.0;
    let noise = match others {
        Others::Lasting { misfit, aside, steady, width, echo, scatter, alone, beside, stated } => {
            told_of = Some(stated);
            let known = variance.pair + rounding * rounding;
            *misfit += (residual / known - *misfit) / AVERAGED;
            let lasting = SHARED_UNEQUALLY * (*misfit - MEAN_RESIDUAL).max(0.0) * variance.pair;
            rise = rise.max(lasting);
            let scatter = scatter.filter(|s| s.ratio > 1.0);
            paths = match context.depth {
                // Under no surface only what lasts, and of another source its scatter tells what it does.
                None if plan.vessel_over_array_depth <= 0.0 && alone => PATHS * PATHS * lasting,
                None if plan.vessel_over_array_depth <= 0.0 => 0.0,
                Some(_) if alone => 0.0,
                Some(_) if !context.echo => rise,
                _ => PATHS * PATHS * rise,
            };
            if let Some(scatter) = scatter {
                // The scatter has the noise in it.
                let (across, both, up) = scatter.direction;
                let beyond = |seen: f32, noise: f32| (seen - variance.arrival * noise).max(0.0);
                let (more_across, more_up) = (beyond(across, first), beyond(up, second));
                let kept = more_across * more_up / (across * up).max(f32::MIN_POSITIVE);
                other = (more_across, both * m::sqrt(kept), more_up);
                let share = (more_across / more_up.max(f32::MIN_POSITIVE)).min(1.0);
                (rise, paths) = (share * rise / SHARED_UNEQUALLY, (1.0 - share) * paths);
            }
            if let Some([across, up]) = beside {
                (other.0, other.2) = (other.0 + across, other.2 + up);
            }
            level = rise;
            let (across, up) = (wavefront::pair_delays(&g1), wavefront::pair_delays(&g2));
            if used.all() {
                let (width, swept) = width;
                wide = width.take(context, found, work, (&across, &up), swept);
                aside_rad = echo.turns(context, found, (&across, &up), inverse);
                let doubt = ECHO_SD * aside_rad;
                wide += doubt * doubt;
            }
            if plan.vessel_over_array_depth > 0.0 && used.all() {
                let square = aside::mean_square(&found.refined.pull, &across, &up);
                *aside += (square / known - *aside) / AVERAGED;
                let now = square - A_DIMENSION * NOISE_RESIDUAL * variance.pair - rounding * rounding;
                // What another source's scatter shows it does is the same.
                let seen = other.0 / first.max(f32::MIN_POSITIVE);
                level = (now.max((*aside - A_DIMENSION * MEAN_RESIDUAL) * variance.pair) - seen).max(0.0);
            }
            let said = [first, second].map(|x| variance.arrival * x);
            let factors = steady.take(plan, direction, context.index, said, context.shares());
            // With the depth known, what lasts of the elevation's errors is stated for itself.
            let least = 1.0 - found.mean;
            let [across, up] = factors;
            [across.max(least), if context.depth.is_some() { up } else { up.max(least) }]
        }
        Others::Scatter(ratio) => [ratio; 2],
    };
    let square = found.statistic * found.statistic;
    let lucky = NEAR_THRESHOLD / (square * square).max(1.0);
    let told = used.sensors() * plan.position_sd_s * plan.position_sd_s;
    let level = level.max(doubt.unexplained_s2);
    let scale = |noise: f32, lasting: f32| variance.arrival * (noise + lucky) + lasting + told;
    let [across, up] = noise;
    let mut first_angle = scale(across, level) * first + other.0;
    let mut both_angles = scale(m::sqrt(across * up), level) * cross + other.1;
    let mut second_angle = scale(up, level.max(rise)) * second + other.2;
    if let Some(stated) = told_of {
        let noise = |noise: f32| variance.arrival * (noise + lucky);
        stated.noise = [noise(across) * first + other.0 + turned * turned, noise(up) * second + other.2];
        stated.lasting = [level * first, level.max(rise) * second];
    }
    first_angle += wide;
    // What a speed of sound and a distance that are not as assumed do to all arrival times together.
    let slowness = wavefront::arrivals(&plan.geometry, direction, curvature);
    let bends = plan.geometry.position_m.map(|h| {
        let along = wavefront::dot(&h, direction);
        0.5 * plan.inv_c * (wavefront::dot(&h, &h) - along * along)
    });
    for (times, sd) in [(slowness, plan.sound_speed_sd), (bends, curvature_sd)] {
        let ((_, b1, _), (_, b2, _)) = (used.information(&g1, &times), used.information(&g2, &times));
        let (a, b) = (sd * (inverse.0 * b1 + inverse.1 * b2), sd * (inverse.1 * b1 + inverse.2 * b2));
        first_angle += a * a;
        both_angles += a * b;
        second_angle += b * b;
    }
    let (azimuth, elevation) = wavefront::angles(&context.vessel.unwrap_or(*direction));
    // A step along the horizontal tangent turns the azimuth by 1/cos β; at the zenith azimuth means nothing.
    let widen = 1.0 / e.1[2].max(1e-3);
    let most = m::PI * m::PI / 3.0;
    let floor = DELAY_FLOOR_SAMPLES / plan.rate_hz;
    let misfit = m::sqrt(residual / (variance.pair + floor * floor));
    // A misfit of half as much again as noise explains costs nothing.
    let doubtful = misfit.max(1.5) / 1.5;
    // Vessel and image come from where the surface is above them: d sin β cos β / D above the vessel. The image is fainter by its
    // longer way, 2 d sin² β / D, so that they come from as much nearer the vessel.
    let sine = direction[2].max(0.0);
    let rise = m::abs(e.1[2] * sine);
    let (half, image_sd) = match context.depth {
        Some((d, sd)) => {
            let (apart, _) = image(plan, direction, d);
            let (nearer, nearer_sd) = context.loss;
            let half_way = (HALF_WAY_SD * apart).min(1.0);
            let sd = m::hypot(sd, m::hypot(half_way, 2.0 * nearer_sd) * d);
            (d * (1.0 - 2.0 * nearer) / plan.depth_m, sd / plan.depth_m)
        }
        None => (plan.vessel_over_array_depth, UNKNOWN_DEPTH_SD * plan.vessel_over_array_depth),
    };
    let image = if context.vessel.is_some() { 0.0 } else { rise * half };
    let mut image_sd = rise * image_sd;
    // From the middle, of the deepest that it may be where that is not known.
    let depth = context
        .depth
        .map_or((1.0 + 2.0 * UNKNOWN_DEPTH_SD) * plan.vessel_over_array_depth, |(d, _)| d / plan.depth_m);
    let from_middle = rise * depth;
    let resolved = from_middle / context.band.resolution;
    let square = resolved * resolved;
    if context.vessel.is_some() {
        // An upper hydrophone that is late looks as if the vessel were as far from where it is as its image.
        image_sd = ONE_OF_TWO_SD * from_middle;
        let aside = ASIDE_OF_VESSEL_SD * from_middle;
        first_angle += aside * aside;
    } else {
        let part = (square * square).min(1.0);
        // With a depth known it is sudden.
        let part = if context.depth.is_some() && !context.echo { part * part } else { part };
        image_sd = m::hypot(image_sd, ONE_OF_TWO_SD * from_middle * part);
        let far = ASIDE_OF_TWO_SD * from_middle * (square / (FAR_APART * FAR_APART)).min(1.0);
        let joined = (square / (JOINED_APART * JOINED_APART)).min(1.0);
        let joined = ASIDE_OF_JOINED_SD * context.band.resolution * joined * joined;
        first_angle += far * far + joined * joined;
    }
    // Told of a surface or not: what a channel hears of another, or an echo, moves the pairs together as well.
    image_sd = m::hypot(image_sd, m::sqrt(paths * inverse.2));
    if plan.vessel_over_array_depth > 0.0 && !used.all() {
        // Three hydrophones have no pair to spare: what each hears nearer to the vessel or to the image turns both angles.
        let (i11, i12, i22) = inverse;
        let (across, up) = (wavefront::pair_delays(&g1), wavefront::pair_delays(&g2));
        let apart = PAIRS_APART * from_middle * square.min(1.0);
        for (a, b) in used.of(across.iter().zip(&up)) {
            let off = apart * b;
            let (a, b) = (off * (i11 * a + i12 * b), off * (i12 * a + i22 * b));
            first_angle += a * a;
            both_angles += a * b;
            second_angle += b * b;
        }
    }
    let mean = found.mean.clamp(1e-6, 1.0 - 1e-6);
    Some(Bearing {
        index: context.index,
        azimuth: crate::angle::wrap_tau_f32(azimuth - aside_rad * widen),
        elevation: elevation - image,
        var_azimuth: ((first_angle + turned * turned) * widen * widen).min(most),
        var_elevation: (second_angle + image_sd * image_sd).min(most),
        cov: (both_angles * widen).clamp(-most, most),
        snr_db: math::db(mean / (1.0 - mean)),
        quality: doubt.quality / doubtful,
        closure_s: closure(&found.refined.pair_delay),
        statistic: found.statistic,
        band,
        flags: context.flags,
    })
}

/// How far above a vessel this deep its image is heard (radians), and the loss of it by its longer way alone ([`super::fringes::Loss`]).
pub(super) fn image(plan: &super::plan::Plan, direction: &wavefront::Direction, depth_m: f32) -> (f32, f32) {
    let sine = direction[2].max(0.0);
    let level = m::sqrt((1.0 - sine * sine).max(0.0));
    let share = depth_m / plan.depth_m;
    (2.0 * sine * level * share, sine * sine * share)
}

/// Root-mean-square closure of the four triangles of pair delays, seconds.
#[inline(never)]
pub fn closure(d: &[f32; PAIR_COUNT]) -> f32 {
    let [d01, d02, d03, d12, d13, d23] = *d;
    let loops = [d01 + d12 - d02, d01 + d13 - d03, d02 + d23 - d03, d12 + d23 - d13];
    m::sqrt(0.25 * loops.iter().map(|x| x * x).sum::<f32>())
}

#[cfg(test)]
#[path = "stated_tests.rs"]
mod tests;
