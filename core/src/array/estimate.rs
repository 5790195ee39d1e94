//! One segment's estimate: from accumulated cross-spectra to a bearing, or to nothing.

use super::chain::Scratch;
use super::detect;
use super::plan::{BINS, HOP, Plan, Weighting};
use super::refine;
use super::spectra::Spectra;
use super::wavefront::{self, Direction, PAIR_COUNT};
use crate::math::{self, f32 as m};
use crate::wire::{Bearing, Fault, FaultCode, Message};

/// Segments over which the coherence spectrum is averaged: the weights need it steady, the vessel lets it change over
/// tens of seconds.
const AVERAGED_SEGMENTS: f32 = 16.0;
/// Least share of a full segment's frames that gives a bearing.
const LEAST_SHARE: f32 = 0.25;
/// Share below which the bearing carries the gap flag (a whole segment has it to within one frame).
const WHOLE_SHARE: f32 = 0.95;
/// Segments in a row whose pairs disagree before the fault is raised: 2 s at the usual step.
const DISAGREEING_SEGMENTS: u32 = 4;
/// Least standard deviation of a pair delay assumed when quality is judged, samples: calibration and multipath.
const DELAY_FLOOR_SAMPLES: f32 = 0.02;

/// What is remembered between segments (about 1 KiB).
#[derive(Clone, Debug)]
pub(crate) struct Memory {
    /// Averaged steered coherence of each bin.
    coherence: [f32; BINS],
    /// Segments in the average.
    averaged: f32,
    /// Last bearing: direction and index.
    last: Option<(Direction, u64)>,
    /// Turn rate between the last bearings, radians a second, newest first.
    turn_rate: [f32; 2],
    pub(crate) turn_rate_told: Option<f32>,
    pub(crate) range_m: Option<f32>,
    disagreeing: u32,
}

/// Work space over bins (3 KiB).
#[derive(Clone, Debug)]
pub(crate) struct SpectrumWork {
    raw: [f32; BINS],
    smooth: [f32; BINS],
    weight: [f32; BINS],
}

impl SpectrumWork {
    pub(crate) const fn new() -> Self {
        Self { raw: [0.0; BINS], smooth: [0.0; BINS], weight: [0.0; BINS] }
    }
}

impl SpectrumWork {
    /// Brings the measured coherence up to the field's.
    fn restore(&mut self, shared: f32) {
        for c in &mut self.raw {
            *c /= shared;
        }
    }
}

impl Memory {
    pub(crate) const fn new() -> Self {
        Self {
            coherence: [0.0; BINS],
            averaged: 0.0,
            last: None,
            turn_rate: [0.0; 2],
            turn_rate_told: None,
            range_m: None,
            disagreeing: 0,
        }
    }

    /// Drops what belongs to the past source.
    pub(crate) fn forget(&mut self) {
        self.averaged = 0.0;
        self.last = None;
        self.turn_rate = [0.0; 2];
    }

    /// Whether the bearing turns by more than two resolution cells within a full segment.
    pub(crate) fn turns_fast(&self, plan: &Plan) -> bool {
        let [a, b] = self.turn_rate;
        // Two changes in a row, so that one stray bearing does not shorten the next segment.
        let rate = self.turn_rate_told.unwrap_or(a.min(b));
        let segment_s = plan.nominal_frames * HOP as f32 / plan.rate_hz;
        rate.abs() * segment_s > 2.0 * plan.resolution
    }

    /// Takes a new bearing into turn rate and averages.
    fn accept(&mut self, plan: &Plan, direction: &Direction, index: u64, coherence: &[f32; BINS]) {
        let mut turned = f32::MAX;
        if let Some((last, at)) = self.last {
            let dt = index.saturating_sub(at) as f32 / plan.rate_hz;
            turned = m::acos(wavefront::dot(&last, direction).clamp(-1.0, 1.0));
            if dt > 0.0 {
                self.turn_rate = [turned / dt, self.turn_rate[0]];
            }
            if dt > 5.0 {
                turned = f32::MAX;
            }
        }
        // Another source, or the same after a long silence: its spectrum is learnt afresh.
        if turned > 10.0 * plan.resolution {
            self.averaged = 0.0;
        }
        self.averaged = (self.averaged + 1.0).min(AVERAGED_SEGMENTS);
        let part = 1.0 / self.averaged;
        for (mean, new) in self.coherence.iter_mut().zip(coherence) {
            *mean += part * (new - *mean);
        }
        self.last = Some((*direction, index));
    }

    /// The coherence to weight this segment with: its own joined to the average.
    fn expected(&self, own: &mut [f32; BINS]) {
        let n = self.averaged.min(AVERAGED_SEGMENTS - 1.0);
        for (own, mean) in own.iter_mut().zip(&self.coherence) {
            *own = (*own + n * mean) / (n + 1.0);
        }
    }
}

/// Estimates one segment and emits what it holds. `spectra` is used up.
pub(crate) fn segment(
    plan: &Plan,
    memory: &mut Memory,
    spectra: &mut Spectra,
    scratch: &mut Scratch,
    shortened: bool,
    sink: &mut impl FnMut(Message),
) {
    let share = spectra.frames as f32 / plan.nominal_frames * if shortened { 2.0 } else { 1.0 };
    if share < LEAST_SHARE {
        return;
    }
    let start = spectra.step.saturating_mul(plan.step_samples.get());
    let index = start.saturating_add(spectra.centres / u64::from(spectra.frames.max(1)));
    let curvature = memory.range_m.map_or(plan.curvature, |r| 1.0 / r);
    let snapshots = spectra.frames as f32 * plan.snapshots_per_frame;
    let delays = |u: &Direction| wavefront::pair_delays(&wavefront::arrivals(&plan.geometry, u, curvature));

    refine::whiten(spectra, &mut scratch.frame);
    let found = scratch.search.best(plan, spectra, curvature);
    let work = &mut scratch.spectrum;

    // Weights from the coherence seen in this direction, own and remembered.
    let tau = delays(&found.direction);
    refine::coherence(plan, spectra, &tau, &mut work.raw);
    work.restore(refine::shared_signal(plan, &tau));
    memory.expected_or_own(&found.direction, plan, &mut work.raw);
    refine::smoothed(plan, &work.raw, &mut work.smooth);
    refine::weights(plan, &work.smooth, &mut work.weight);
    if plan.weighting != Weighting::Joint {
        refine::coherence(plan, spectra, &tau, &mut work.raw);
        refine::reweight(plan, spectra);
    }
    let Some(refined) = refine::refine(plan, spectra, &work.weight, &found.direction, curvature) else {
        return;
    };
    let tau = delays(&refined.direction);
    if plan.weighting == Weighting::Joint {
        refine::coherence(plan, spectra, &tau, &mut work.raw);
    }

    // Detection.
    let bins = plan.high.saturating_sub(plan.incoherent).max(1) as f32;
    let sum = PAIR_COUNT as f32 * work.raw.iter().take(plan.high).skip(plan.incoherent).sum::<f32>();
    let deviation = m::sqrt(0.5 * PAIR_COUNT as f32 * bins / snapshots.max(1.0));
    if sum <= plan.threshold * deviation || sum.is_nan() {
        return;
    }
    let diffuse = detect::diffuse_mean(
        &plan.geometry,
        &plan.crossing_s,
        &tau,
        plan.incoherent,
        plan.high,
        plan.bin_rad_s,
    );
    let statistic = (sum - diffuse) / (plan.threshold * deviation);
    if statistic <= 1.0 {
        return;
    }
    work.restore(refine::shared_signal(plan, &tau));
    memory.accept(plan, &refined.direction, index, &work.raw);
    refine::smoothed(plan, &memory.coherence, &mut work.smooth);
    let Some(variance) = refine::arrival_variance(plan, &work.smooth, &work.weight, snapshots) else {
        return;
    };

    // Disagreement of pairs with the common direction.
    let strong = 8.0 * m::sqrt(0.5 * bins / snapshots.max(1.0));
    let mut disagreeing = 0;
    for (p, tau) in tau.iter().enumerate() {
        let (delay, peak) = scratch.search.pair_peak(plan, p);
        let apart = (delay - tau).abs() * plan.rate_hz > 3.0;
        if apart && peak > strong && peak > 1.5 * scratch.search.pair_value(plan, p, *tau) {
            disagreeing += 1;
        }
    }
    let inconsistent = disagreeing >= 3;
    memory.disagreeing = if inconsistent { memory.disagreeing.saturating_add(1) } else { 0 };
    if memory.disagreeing == DISAGREEING_SEGMENTS {
        sink(Message::Fault(Fault {
            code: FaultCode::Inconsistent,
            index,
            value: i64::from(memory.disagreeing),
        }));
    }

    let e = wavefront::tangents(&refined.direction);
    let g1 = wavefront::gradient(&plan.geometry, &refined.direction, &e.0, curvature);
    let g2 = wavefront::gradient(&plan.geometry, &refined.direction, &e.1, curvature);
    let (i11, i12, i22) = wavefront::information(&g1, &g2);
    let determinant = i11 * i22 - i12 * i12;
    if determinant <= 0.0 {
        return;
    }
    let scale = variance.arrival / determinant;
    let (azimuth, elevation) = wavefront::angles(&refined.direction);
    // A step along the horizontal tangent turns the azimuth by 1/cos β; at the zenith azimuth means nothing.
    let widen = 1.0 / e.1[2].max(1e-3);
    let most = m::PI * m::PI / 3.0;

    let mut residual = 0.0;
    for (own, tau) in refined.pair_delay.iter().zip(&tau) {
        residual += (own - tau) * (own - tau);
    }
    let floor = DELAY_FLOOR_SAMPLES / plan.rate_hz;
    let expected = m::sqrt(variance.pair + floor * floor);
    let misfit = m::sqrt(residual / PAIR_COUNT as f32) / expected;
    let agreeing = if inconsistent { 0.1 } else { 1.0 };
    let mean = work.raw.iter().take(plan.high).skip(plan.incoherent).sum::<f32>() / bins;
    let mean = mean.clamp(1e-6, 1.0 - 1e-6);
    sink(Message::Bearing(Bearing {
        index,
        azimuth,
        elevation,
        var_azimuth: (scale * i22 * widen * widen).min(most),
        var_elevation: (scale * i11).min(most),
        cov: (-scale * i12 * widen).clamp(-most, most),
        snr_db: math::db(mean / (1.0 - mean)),
        quality: agreeing * (1.5 / misfit.max(1.5)),
        closure_s: closure(&refined.pair_delay),
        statistic,
        band: 0,
        flags: u8::from(spectra.clipped) | (u8::from(share < WHOLE_SHARE) << 1) | (u8::from(shortened) << 2),
    }));
}

impl Memory {
    /// Joins the remembered coherence to the segment's own where the direction is the one remembered.
    fn expected_or_own(&self, direction: &Direction, plan: &Plan, own: &mut [f32; BINS]) {
        let same = self
            .last
            .is_some_and(|(last, _)| wavefront::dot(&last, direction) > m::cos(10.0 * plan.resolution));
        if same {
            self.expected(own);
        }
    }
}

/// Root-mean-square closure of the four triangles of pair delays, seconds.
pub(crate) fn closure(d: &[f32; PAIR_COUNT]) -> f32 {
    let [d01, d02, d03, d12, d13, d23] = *d;
    let loops = [d01 + d12 - d02, d01 + d13 - d03, d02 + d23 - d03, d12 + d23 - d13];
    m::sqrt(0.25 * loops.iter().map(|x| x * x).sum::<f32>())
}
