//! What is remembered between segments: of the strongest source its direction, how it turns, its coherence and depth; of others
//! where they were; of the hydrophones which are sick.

use super::agreement::Agreement;
use super::echo::Echo;
use super::estimate::Context;
use super::followed::Followed;
use super::fringes::Depth;
use super::places::Places;
use super::plan::{BINS, HOP, OCTAVES, Plan};
use super::refine;
use super::sick::Sick;
use super::steady::Steady;
use super::wavefront::{self, Direction};
use super::width::Width;
use crate::math::f32 as m;

/// Segments over which the coherence spectrum is averaged: a faint vessel's weights need it steady.
const AVERAGED_SEGMENTS: f32 = 16.0;
/// Relative variance of a coherence that costs the weights nothing.
const STEADY: f32 = 0.005;
/// A change of bearing beyond so many resolution cells is another source, whose spectrum is not the remembered one.
const OTHER_SOURCE_CELLS: f32 = 10.0;
/// For so long after pairs heard one direction it is no wrong position that they do not, as that was so before, seconds.
const EXPLAINED_S: f32 = 60.0;
/// For so long a source is where it was last, but for some degrees, seconds.
const MOMENTS_S: f32 = 3.0;

/// What is remembered between segments (about 1 KiB).
#[derive(Clone, Debug)]
pub(crate) struct Memory {
    /// Averaged steered coherence of each bin.
    pub(super) coherence: [f32; BINS],
    /// Segments in the average.
    pub(super) averaged: f32,
    /// Last bearing: direction and index.
    pub(super) last: Option<(Direction, u64)>,
    /// Index of the last segment in which a direction explained what the pairs heard; 0: none.
    pub(super) explained: u64,
    /// Turn rate between the last bearings, radians a second, newest first.
    pub(super) turn_rate: [f32; 2],
    /// The horizontal part of it, clockwise.
    pub(super) swing: [f32; 2],
    /// Vessels whose distance is known.
    pub(crate) places: Places,
    pub(super) agreement: Agreement,
    /// Mean square by which pair delays miss the common direction's, in variances of a pair's delay.
    pub(super) misfit: f32,
    /// Mean square of what they contradict it by aside of the vertical plane through it, in the same unit.
    pub(super) aside: f32,
    /// How much its bearings scatter.
    pub(super) steady: Steady,
    /// How wide the source is.
    pub(super) width: Width,
    /// Its echo off the bottom.
    pub(super) echo: Echo,
    /// How deep the source is.
    pub(super) depth: Depth,
    /// Segments so far.
    pub(super) segments: u32,
    /// Other sources than the strongest.
    pub(super) others: Followed,
    /// Octave looked at last.
    pub(super) octave: usize,
    /// Another source than the whole band's that the last look at each octave found.
    pub(super) octaves: [Option<Direction>; OCTAVES],
    /// Which hydrophone to leave out.
    pub(crate) sick: Sick,
    /// Whether the last segment held a burst.
    pub(super) burst: bool,
    /// Hydrophones left out when the last segment ended.
    pub(super) without: u8,
}

impl Memory {
    pub(crate) const fn new() -> Self {
        Self {
            coherence: [0.0; BINS],
            averaged: 0.0,
            last: None,
            explained: 0,
            turn_rate: [0.0; 2],
            swing: [0.0; 2],
            places: Places::new(),
            agreement: Agreement::new(),
            misfit: 0.0,
            aside: 0.0,
            steady: Steady::NEW,
            width: Width::NONE,
            echo: Echo::NONE,
            depth: Depth::UNKNOWN,
            others: Followed::NONE,
            octave: 0,
            octaves: [None; OCTAVES],
            segments: 0,
            sick: Sick::new(),
            burst: false,
            without: 0,
        }
    }

    /// Azimuth (radians) and depth (metres) of the source, where its depth is known.
    pub(crate) fn depth_known(&self) -> Option<(f32, f32)> {
        let ((direction, _), (depth_m, _)) = (self.last?, self.depth.known()?);
        Some((wavefront::angles(&direction).0, depth_m))
    }

    /// Drops what belongs to the past source.
    pub(crate) fn forget(&mut self) {
        self.averaged = 0.0;
        self.last = None;
        self.explained = 0;
        self.turn_rate = [0.0; 2];
        self.swing = [0.0; 2];
        self.others = Followed::NONE;
        self.octaves = [None; OCTAVES];
        self.width = Width::NONE;
        self.echo = Echo::NONE;
        self.depth = Depth::UNKNOWN;
    }

    /// Whether the bearing turns by more than two resolution cells within a full segment.
    pub(crate) fn turns_fast(&self, plan: &Plan) -> bool {
        let [a, b] = self.turn_rate;
        // Two changes in a row, so that one stray bearing does not shorten the next segment.
        let rate = a.min(b);
        let segment_s = plan.nominal_frames * HOP as f32 / plan.rate_hz;
        rate.abs() * segment_s > 2.0 * plan.whole.resolution
    }

    /// The last direction, where that was moments ago.
    pub(super) fn moments_ago(&self, context: &Context<'_>) -> Option<&Direction> {
        let (direction, index) = self.last.as_ref()?;
        (context.index.saturating_sub(*index) as f32 <= MOMENTS_S * context.plan.rate_hz).then_some(direction)
    }

    /// Whether a direction explained what the pairs heard in the last minute.
    pub(super) fn was_explained(&self, context: &Context<'_>) -> bool {
        let since = context.index.saturating_sub(self.explained) as f32;
        self.explained > 0 && since <= EXPLAINED_S * context.plan.rate_hz
    }

    /// Whether a direction is another source's than that of moments ago.
    #[inline(never)]
    pub(super) fn is_elsewhere(&self, context: &Context<'_>, direction: &Direction) -> bool {
        let far = m::cos(OTHER_SOURCE_CELLS * context.plan.whole.resolution);
        self.moments_ago(context).is_some_and(|last| wavefront::dot(last, direction) < far)
    }

    /// Standard deviation of the horizontal angle for the moment's, radians: how far the source turns meanwhile.
    pub(super) fn turned_meanwhile(&self, context: &Context<'_>) -> f32 {
        let [a, b] = self.swing;
        0.5 * (a + b) * context.moment_sd_s
    }

    /// Takes a new bearing into turn rate and averages.
    pub(super) fn accept(&mut self, plan: &Plan, direction: &Direction, index: u64, coherence: &[f32; BINS]) {
        let mut turned = f32::MAX;
        if let Some((last, at)) = self.last {
            let dt = index.saturating_sub(at) as f32 / plan.rate_hz;
            turned = m::acos(wavefront::dot(&last, direction).clamp(-1.0, 1.0));
            if dt > 0.0 {
                self.turn_rate = [turned / dt, self.turn_rate[0]];
                let across = wavefront::dot(direction, &wavefront::tangents(&last).0);
                self.swing = [across / dt, self.swing[0]];
            }
            if dt > 5.0 {
                turned = f32::MAX;
            }
        }
        // Another source, or the same after a long silence: its spectrum is learnt afresh.
        if turned > OTHER_SOURCE_CELLS * plan.whole.resolution {
            self.averaged = 0.0;
            self.width = Width::NONE;
            self.echo = Echo::NONE;
            self.depth = Depth::UNKNOWN;
        }
        self.averaged = (self.averaged + 1.0).min(AVERAGED_SEGMENTS);
        let part = 1.0 / self.averaged;
        for (mean, new) in self.coherence.iter_mut().zip(coherence) {
            *mean += part * (new - *mean);
        }
        self.last = Some((*direction, index));
    }

    /// Joins the remembered coherence to a segment's own, whose mean over the detection band is `mean`, where the direction is the one
    /// remembered, as far as its own is not steady enough; of how many segments it is then. Under a surface the coherence has fringes, and they
    /// move: a memory of them weighs bins that a fringe leaves less than those that one comes to, which are loud early in the segment,
    /// so that a bearing would be of up to 20 ms before its moment.
    pub(super) fn join_expected(
        &self,
        context: &Context<'_>,
        direction: &Direction,
        mean: f32,
        own: &mut [f32; BINS],
    ) -> f32 {
        let same = self.last.is_some_and(|(last, _)| {
            wavefront::dot(&last, direction) > m::cos(OTHER_SOURCE_CELLS * context.plan.whole.resolution)
        });
        let variance = context.noise(1.0) / (STEADY * refine::SMOOTHED * mean * mean).max(f32::MIN_POSITIVE);
        let n = self.averaged.min(variance - 1.0).min(AVERAGED_SEGMENTS - 1.0);
        if !(same && n > 0.0) {
            return 1.0;
        }
        for (own, mean) in own.iter_mut().zip(&self.coherence) {
            *own = (*own + n * mean) / (n + 1.0);
        }
        n + 1.0
    }
}
