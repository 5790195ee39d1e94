//! One segment's estimate: from accumulated cross-spectra to a bearing, or to nothing.

use super::chain::Scratch;
use super::detect;
use super::plan::{BINS, HOP, Plan, Weighting};
use super::refine;
use super::spectra::Spectra;
use super::wavefront::{self, Direction, PAIR_COUNT};
use crate::block::CHANNELS;
use crate::math::{self, f32 as m};
use crate::wire::{Bearing, Fault, FaultCode, Message};

/// Segments over which the coherence spectrum is averaged: the weights need it steady, the vessel lets it change over
/// tens of seconds.
const AVERAGED_SEGMENTS: f32 = 16.0;
/// Least share of a full segment's frames that gives a bearing.
const LEAST_SHARE: f32 = 0.25;
/// Share below which the bearing carries the gap flag (a whole segment has it to within one frame).
const WHOLE_SHARE: f32 = 0.95;
/// Segments in a row whose pairs contradict the direction before the fault is raised: 2 s at the usual step.
const CONTRADICTING_SEGMENTS: u32 = 4;
/// Segments from one search for a second source to the next: it costs as much as the first, and others move slowly.
const SECOND_EVERY: u32 = 8;
/// A second source nearer than this to the first, in resolution cells, is what is left of the first.
const SECOND_APART_CELLS: f32 = 6.0;
/// A change of bearing beyond so many resolution cells is another source, whose spectrum is not the remembered one.
const OTHER_SOURCE_CELLS: f32 = 10.0;
/// Farthest a second source moves between two searches, radians: a vessel at 100 m turns by 4° a second.
const SECOND_MOVES_RAD: f32 = 0.28;
/// Least quality of a second source's bearing.
const SECOND_LEAST_QUALITY: f32 = 0.5;
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
    contradicting: u32,
    /// Segments with a bearing so far.
    segments: u32,
    /// Direction of the second source the last search for one found.
    other: Option<Direction>,
}

/// Work space over bins (4 KiB).
#[derive(Clone, Debug)]
pub(crate) struct SpectrumWork {
    raw: [f32; BINS],
    measured: [f32; BINS],
    smooth: [f32; BINS],
    weight: [f32; BINS],
}

impl SpectrumWork {
    pub(crate) const fn new() -> Self {
        Self { raw: [0.0; BINS], measured: [0.0; BINS], smooth: [0.0; BINS], weight: [0.0; BINS] }
    }
}

impl SpectrumWork {
    /// The rows, for other use before a search.
    fn rows(&mut self) -> [&mut [f32; BINS]; CHANNELS] {
        [&mut self.raw, &mut self.measured, &mut self.smooth, &mut self.weight]
    }

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
            contradicting: 0,
            other: None,
            segments: 0,
        }
    }

    /// Drops what belongs to the past source.
    pub(crate) fn forget(&mut self) {
        self.averaged = 0.0;
        self.last = None;
        self.turn_rate = [0.0; 2];
        self.other = None;
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
        if turned > OTHER_SOURCE_CELLS * plan.resolution {
            self.averaged = 0.0;
        }
        self.averaged = (self.averaged + 1.0).min(AVERAGED_SEGMENTS);
        let part = 1.0 / self.averaged;
        for (mean, new) in self.coherence.iter_mut().zip(coherence) {
            *mean += part * (new - *mean);
        }
        self.last = Some((*direction, index));
    }

    /// Joins the remembered coherence to a segment's own where the direction is the one remembered.
    fn join_expected(&self, direction: &Direction, plan: &Plan, own: &mut [f32; BINS]) {
        let same = self.last.is_some_and(|(last, _)| {
            wavefront::dot(&last, direction) > m::cos(OTHER_SOURCE_CELLS * plan.resolution)
        });
        if !same {
            return;
        }
        let n = self.averaged.min(AVERAGED_SEGMENTS - 1.0);
        for (own, mean) in own.iter_mut().zip(&self.coherence) {
            *own = (*own + n * mean) / (n + 1.0);
        }
    }
}

/// A source found in a segment; the coherence it was found with is in the work space.
struct Found {
    refined: refine::Refined,
    tau: [f32; PAIR_COUNT],
    statistic: f32,
    /// Mean coherence over the detection band.
    mean: f32,
}

/// What the steps of one segment share.
struct Context<'a> {
    plan: &'a Plan,
    curvature: f32,
    snapshots: f32,
    index: u64,
    flags: u8,
}

impl Context<'_> {
    fn delays(&self, u: &Direction) -> [f32; PAIR_COUNT] {
        wavefront::pair_delays(&wavefront::arrivals(&self.plan.geometry, u, self.curvature))
    }

    /// Bins of the detection band.
    fn bins(&self) -> f32 {
        self.plan.high.saturating_sub(self.plan.incoherent).max(1) as f32
    }

    /// Standard deviation of the sum over `terms` whitened, steered cross-spectra under noise alone.
    fn deviation(&self, terms: f32) -> f32 {
        m::sqrt(0.5 * terms / self.snapshots.max(1.0))
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
    let context = Context {
        plan,
        curvature: memory.range_m.map_or(plan.curvature, |r| 1.0 / r),
        snapshots: spectra.frames as f32 * plan.snapshots_per_frame,
        index: start.saturating_add(spectra.centres / u64::from(spectra.frames.max(1))),
        flags: u8::from(spectra.clipped) | (u8::from(share < WHOLE_SHARE) << 1) | (u8::from(shortened) << 2),
    };
    refine::whiten(spectra, scratch.spectrum.rows());
    let Some(first) = find(&context, Some(&*memory), spectra, scratch) else { return };
    scratch.spectrum.measured = scratch.spectrum.raw;
    scratch.spectrum.restore(refine::shared_signal(plan, &first.tau));
    memory.accept(plan, &first.refined.direction, context.index, &scratch.spectrum.raw);
    refine::smoothed(plan, &memory.coherence, &mut scratch.spectrum.smooth);
    let agreeing = agreement(&context, memory, &first, scratch, sink);
    if let Some(bearing) = bearing(&context, &first, &scratch.spectrum, agreeing, 0) {
        sink(Message::Bearing(bearing));
    }
    memory.segments = memory.segments.wrapping_add(1);
    if memory.segments.is_multiple_of(SECOND_EVERY) && plan.weighting == Weighting::Joint {
        memory.other = second(&context, memory.other, &first, spectra, scratch, sink);
    }
}

/// Looks for another source in what the first leaves: its expected cross-spectra are taken out and the search repeated.
/// The first source's fluctuations count as noise of the second. What multipath of the first leaves can look like a source,
/// but somewhere else each time and with pairs that disagree: a second source is reported only where the search before
/// found one too (`before`) and the pairs agree. The direction found, for the next search.
fn second(
    context: &Context<'_>,
    before: Option<Direction>,
    first: &Found,
    spectra: &mut Spectra,
    scratch: &mut Scratch,
    sink: &mut impl FnMut(Message),
) -> Option<Direction> {
    let plan = context.plan;
    refine::remove(plan, spectra, &first.tau, &scratch.spectrum.measured);
    let other = find(context, None, spectra, scratch)?;
    let near = m::cos(SECOND_APART_CELLS * plan.resolution);
    if wavefront::dot(&other.refined.direction, &first.refined.direction) > near {
        return None;
    }
    scratch.spectrum.restore(refine::shared_signal(plan, &other.tau));
    let work = &mut scratch.spectrum;
    refine::smoothed(plan, &work.raw, &mut work.smooth);
    let lasting =
        before.is_some_and(|d| wavefront::dot(&d, &other.refined.direction) > m::cos(SECOND_MOVES_RAD));
    let bearing = bearing(context, &other, &scratch.spectrum, 1.0, 1);
    if let Some(bearing) = bearing.filter(|b| lasting && b.quality >= SECOND_LEAST_QUALITY) {
        sink(Message::Bearing(bearing));
    }
    Some(other.refined.direction)
}

/// Searches, refines and tests: the strongest source of whitened spectra, if there is one.
fn find(
    context: &Context<'_>,
    memory: Option<&Memory>,
    spectra: &mut Spectra,
    scratch: &mut Scratch,
) -> Option<Found> {
    let plan = context.plan;
    let start = scratch.search.best(plan, spectra, context.curvature, &mut scratch.work);
    let work = &mut scratch.spectrum;
    // Weights from the coherence seen in this direction, own and remembered.
    let tau = context.delays(&start.direction);
    refine::coherence(plan, spectra, &tau, &mut work.raw);
    if plan.weighting != Weighting::Joint {
        work.measured = work.raw;
        refine::reweight(plan, spectra);
    }
    work.restore(refine::shared_signal(plan, &tau));
    if let Some(memory) = memory {
        memory.join_expected(&start.direction, plan, &mut work.raw);
    }
    refine::smoothed(plan, &work.raw, &mut work.smooth);
    refine::weights(plan, &work.smooth, &mut work.weight);
    let refined = refine::refine(plan, spectra, &work.weight, &start.direction, context.curvature)?;
    let tau = context.delays(&refined.direction);
    if plan.weighting == Weighting::Joint {
        refine::coherence(plan, spectra, &tau, &mut work.raw);
    } else {
        work.raw = work.measured;
    }
    let bins = context.bins();
    let terms = PAIR_COUNT as f32 * bins;
    let sum = PAIR_COUNT as f32 * work.raw.iter().take(plan.high).skip(plan.incoherent).sum::<f32>();
    let level = plan.threshold * context.deviation(terms);
    if sum <= level || sum.is_nan() {
        return None;
    }
    let (low, high) = (plan.incoherent, plan.high);
    let diffuse = detect::diffuse_mean(&plan.geometry, &plan.crossing_s, &tau, low, high, plan.bin_rad_s);
    let statistic = (sum - diffuse) / level;
    (statistic > 1.0).then_some(Found { refined, tau, statistic, mean: sum / terms })
}

/// Whether the pairs' own correlation peaks agree with the common direction: 1, or 0.1 where at least three contradict it
/// (swapped channels, a wrong geometry). Lasting contradiction is a fault.
fn agreement(
    context: &Context<'_>,
    memory: &mut Memory,
    found: &Found,
    scratch: &Scratch,
    sink: &mut impl FnMut(Message),
) -> f32 {
    let plan = context.plan;
    let strong = 8.0 * context.deviation(context.bins());
    let mut contradicting = 0;
    for (p, tau) in found.tau.iter().enumerate() {
        let (delay, peak) = scratch.search.pair_peak(plan, p);
        let apart = m::abs(delay - tau) * plan.rate_hz > 3.0;
        if apart && peak > strong && peak > 1.5 * scratch.search.pair_value(plan, p, *tau) {
            contradicting += 1;
        }
    }
    if contradicting < 3 {
        memory.contradicting = 0;
        return 1.0;
    }
    memory.contradicting = memory.contradicting.saturating_add(1);
    if memory.contradicting == CONTRADICTING_SEGMENTS {
        let value = i64::from(memory.contradicting);
        sink(Message::Fault(Fault { code: FaultCode::Inconsistent, index: context.index, value }));
    }
    0.1
}

/// The record of a found source, with the covariance that its smoothed coherence gives; `None` where there is none.
fn bearing(
    context: &Context<'_>,
    found: &Found,
    work: &SpectrumWork,
    agreeing: f32,
    band: u8,
) -> Option<Bearing> {
    let plan = context.plan;
    let direction = &found.refined.direction;
    let variance = refine::arrival_variance(plan, &work.smooth, &work.weight, context.snapshots)?;
    let e = wavefront::tangents(direction);
    let g1 = wavefront::gradient(&plan.geometry, direction, &e.0, context.curvature);
    let g2 = wavefront::gradient(&plan.geometry, direction, &e.1, context.curvature);
    let (i11, i12, i22) = wavefront::information(&g1, &g2);
    let determinant = i11 * i22 - i12 * i12;
    if determinant <= 0.0 || determinant.is_nan() {
        return None;
    }
    let scale = variance.arrival / determinant;
    let (azimuth, elevation) = wavefront::angles(direction);
    // A step along the horizontal tangent turns the azimuth by 1/cos β; at the zenith azimuth means nothing.
    let widen = 1.0 / e.1[2].max(1e-3);
    let most = m::PI * m::PI / 3.0;

    let residual = found.refined.pair_delay.iter().zip(&found.tau);
    let residual = residual.map(|(own, tau)| (own - tau) * (own - tau)).sum::<f32>();
    let floor = DELAY_FLOOR_SAMPLES / plan.rate_hz;
    let misfit = m::sqrt(residual / PAIR_COUNT as f32 / (variance.pair + floor * floor));
    let mean = found.mean.clamp(1e-6, 1.0 - 1e-6);
    Some(Bearing {
        index: context.index,
        azimuth,
        elevation,
        var_azimuth: (scale * i22 * widen * widen).min(most),
        var_elevation: (scale * i11).min(most),
        cov: (-scale * i12 * widen).clamp(-most, most),
        snr_db: math::db(mean / (1.0 - mean)),
        // A misfit of half as much again as noise explains costs nothing.
        quality: agreeing * (1.5 / misfit.max(1.5)),
        closure_s: closure(&found.refined.pair_delay),
        statistic: found.statistic,
        band,
        flags: context.flags,
    })
}

/// Root-mean-square closure of the four triangles of pair delays, seconds.
pub(crate) fn closure(d: &[f32; PAIR_COUNT]) -> f32 {
    let [d01, d02, d03, d12, d13, d23] = *d;
    let loops = [d01 + d12 - d02, d01 + d13 - d03, d02 + d23 - d03, d12 + d23 - d13];
    m::sqrt(0.25 * loops.iter().map(|x| x * x).sum::<f32>())
}
