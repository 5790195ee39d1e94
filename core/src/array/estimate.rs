//! One segment's estimate: from accumulated cross-spectra to a bearing, or to nothing.

use super::agreement::{Doubt, half_apart};
use super::apart::Apart;
use super::chain::Scratch;
use super::detect;
use super::followed::Turn;
use super::leak;
use super::memory::Memory;
use super::others;
use super::places::Places;
use super::plan::{BINS, Band, Plan};
use super::refine;
use super::report::{self, Others};
use super::sick::{self, Sign, Turned};
use super::spectra::Spectra;
use super::surface;
use super::three;
use super::wavefront::{self, Direction, PAIR_COUNT};
use crate::block::CHANNELS;
use crate::math::f32 as m;
use crate::wire::Message;

/// Least share of a full segment's frames that gives a bearing.
const LEAST_SHARE: f32 = 0.25;
/// Share below which the bearing carries the gap flag (a whole segment has it to within one frame).
const WHOLE_SHARE: f32 = 0.95;
/// Most uneven in time that a vessel's sound is ([`Spectra::unevenness`]): 3.9 where a propeller's sound goes to nothing in each turn and
/// nothing else is heard. Whistles, clicks, strokes of a pile driver and what is left of an explosion have more.
pub(super) const MOST_UNEVEN: f32 = 5.0;
/// Least number of bins that a direction is told from, `(Σ c)²/Σ c²` of their coherence c. A line has 4 to 8 with what its frame spreads of it, two and three
/// lines no more, and one in four of their directions is on another lobe; a vessel that noise hides above 2 kHz has 10 at 64 kHz, a white
/// one at the threshold 40.
const FEW_BINS: f32 = 9.0;
/// The same as a share of the bins of a narrow band.
const FEW_OF_BAND: f32 = 0.5;
/// Most uneven in time that all power in the upper half of the band is, where 1 is steady: beyond it that tells when snaps were loud, not the source.
const MOST_UNEVEN_MOMENT: f64 = 2.2;
/// Least coherence by which the moment of a bearing is doubted: below it the bearing itself is as uncertain.
const LEAST_COHERENCE: f32 = 0.1;
/// Standard deviation of the moment where the frames' powers do not tell it: by so much a propeller's beat moves it, seconds.
const UNKNOWN_MOMENT_S: f32 = 0.1;

/// Work space over bins (4 KiB).
#[derive(Clone, Debug)]
pub(crate) struct SpectrumWork {
    pub(super) raw: [f32; BINS],
    pub(super) measured: [f32; BINS],
    pub(super) smooth: [f32; BINS],
    pub(super) weight: [f32; BINS],
}

impl SpectrumWork {
    pub(crate) const fn new() -> Self {
        Self { raw: [0.0; BINS], measured: [0.0; BINS], smooth: [0.0; BINS], weight: [0.0; BINS] }
    }
}

impl SpectrumWork {
    /// Brings the measured coherence up to the field's.
    pub(super) fn restore(&mut self, shared: f32) {
        for c in &mut self.raw {
            *c /= shared;
        }
    }
}

/// A source found in a segment; the coherence it was found with is in the work space.
pub(super) struct Found {
    pub(super) refined: refine::Refined,
    pub(super) tau: [f32; PAIR_COUNT],
    pub(super) statistic: f32,
    /// Mean coherence over the detection band.
    pub(super) mean: f32,
}

/// What the steps of one segment share.
#[derive(Clone, Copy)]
pub(super) struct Context<'a> {
    pub(super) plan: &'a Plan,
    /// The bins looked at.
    pub(super) band: &'a Band,
    /// Vessels whose distance is known.
    pub(super) places: Places,
    pub(super) snapshots: f32,
    pub(super) index: u64,
    /// Standard deviation of that moment as the source's, s.
    pub(super) moment_sd_s: f32,
    /// Depth of the source and its standard deviation, metres, where it is known.
    pub(super) depth: Option<(f32, f32)>,
    /// By how much nearer to the source than half-way to its image both are heard because that is fainter, in units of the angle
    /// between them, and the standard deviation.
    pub(super) loss: (f32, f32),
    /// Whether an echo off the bottom joins the two, and fringes tell the depth nevertheless.
    pub(super) echo: bool,
    /// Where the source itself is, where it is heard apart from its image.
    pub(super) vessel: Option<Direction>,
    pub(super) flags: u8,
}

impl Context<'_> {
    /// Curvature of the wavefront from a direction and its standard deviation, 1/m.
    pub(super) fn curvature(&self, u: &Direction) -> (f32, f32) {
        self.places.curvature(u, self.plan)
    }

    /// Variance of a bin's coherence under noise alone, averaged over so many segments that overlap by half.
    pub(super) fn noise(&self, segments: f32) -> f32 {
        1.0 / (self.snapshots.max(1.0) * self.band.used.pairs() * (segments + 1.0))
    }

    /// Whether the segment shares samples with the one before: not where it was shortened or a gap lies in it.
    pub(super) fn shares(&self) -> bool {
        self.flags & (BRIDGED | SHORTENED) == 0
    }

    #[inline(never)]
    pub(super) fn delays(&self, u: &Direction, curvature: f32) -> [f32; PAIR_COUNT] {
        wavefront::pair_delays(&wavefront::arrivals(&self.plan.geometry, u, curvature))
    }

    /// The pairs' delays, seconds, at which what is in a direction is heard, as far away as is known.
    #[inline(never)]
    pub(super) fn delays_from(&self, u: &Direction) -> [f32; PAIR_COUNT] {
        self.delays(u, self.curvature(u).0)
    }

    /// Sum of a coherence over the detection band.
    #[inline(never)]
    fn detected(&self, coherence: &[f32; BINS]) -> f32 {
        coherence.iter().take(self.band.high).skip(self.band.incoherent).sum()
    }

    /// Whether what is heard with this mean coherence is in so few bins that the direction may be another: lines and narrow bands are
    /// as alike a period off.
    pub(super) fn is_narrow(&self, coherence: &[f32; BINS], mean: f32) -> bool {
        let squares: f32 =
            coherence.iter().take(self.band.high).skip(self.band.incoherent).map(|c| c * c).sum();
        let sum = mean * self.bins();
        sum * sum < FEW_BINS.min(FEW_OF_BAND * self.bins()) * squares
    }

    /// Bins of the detection band.
    pub(super) fn bins(&self) -> f32 {
        self.band.high.saturating_sub(self.band.incoherent).max(1) as f32
    }

    /// Standard deviation of the sum over `terms` whitened, steered cross-spectra under noise alone.
    pub(super) fn deviation(&self, terms: f32) -> f32 {
        m::sqrt(0.5 * terms / self.snapshots.max(1.0))
    }
}

/// Flags of a bearing from a segment with a gap, and from one of a step.
const BRIDGED: u8 = 1 << 1;
const SHORTENED: u8 = 1 << 2;
/// Flag of a bearing by three hydrophones, the sign of whose elevation is assumed.
const LEFT_OUT: u8 = 1 << 3;
/// Flag of a bearing after an exchange of channels that nobody saw end.
const MIRRORED: u8 = 1 << 4;

/// Estimates one segment and emits what it holds. `spectra` is used up.
pub(crate) fn segment(
    plan: &Plan,
    memory: &mut Memory,
    spectra: &mut Spectra,
    scratch: &mut Scratch,
    shortened: bool,
    sink: &mut impl FnMut(Message),
) {
    let without = spectra.added.dead | memory.sick.out();
    let alike = core::mem::replace(&mut memory.without, without) == without;
    let share = spectra.added.frames as f32 / plan.nominal_frames * if shortened { 2.0 } else { 1.0 };
    // What a burst leaves fades away over the next segment.
    let fading = core::mem::replace(&mut memory.burst, spectra.added.burst);
    if share < LEAST_SHARE || spectra.added.burst || fading {
        return;
    }
    let start = spectra.added.step.saturating_mul(plan.step_samples.get());
    let centre = spectra.added.centres / u64::from(spectra.added.frames.max(1));
    let mut band = plan.whole;
    let mut context = Context {
        plan,
        band: &plan.whole,
        places: memory.places,
        snapshots: spectra.added.frames as f32 * plan.snapshots_per_frame,
        index: start.saturating_add(centre),
        moment_sd_s: 0.0,
        depth: None,
        loss: (0.0, 0.0),
        echo: false,
        vessel: None,
        flags: u8::from(spectra.added.clipped)
            | (u8::from(spectra.added.bridged || share < WHOLE_SHARE) * BRIDGED)
            | (u8::from(shortened) * SHORTENED)
            | (u8::from(memory.agreement.given_up()) * MIRRORED),
    };
    refine::whiten(spectra);
    scratch.search.correlate(&band, spectra, &mut scratch.work);
    let peaks = scratch.search.pairs(plan);
    let deviation = context.deviation(context.bins());
    let sign = sick::heard(&memory.sick, spectra.added.dead, &peaks, deviation);
    if let Sign::Sick(..) | Sign::Divided = sign {
        memory.sick.take(plan, sign, None, leak::Seen::NONE, context.index, sink);
        // While it is not yet sure, or another of those that are left is sick as well, nothing can be said of directions.
        match sick::heard(&memory.sick, spectra.added.dead, &peaks, deviation) {
            Sign::Sick(_, h) if memory.sick.out() >> h & 1 == 1 => {}
            _ => return,
        }
    }
    let Some(used) = sick::used(&memory.sick, spectra.added.dead) else { return };
    if !used.all() {
        band.used = used;
        (context.band, context.flags) = (&band, context.flags | LEFT_OUT);
        scratch.search.leave_out(used);
        refine::leave_out(spectra, used);
    }
    let first = found(&context, Some(&*memory), spectra, scratch);
    if let Some(sound) = &first
        && alike
        && spectra.unevenness(plan, &scratch.spectrum.raw) > MOST_UNEVEN
    {
        // No vessel, and nothing to judge hydrophones by.
        if used.all() {
            others::beside(&context, sound, spectra, scratch, sink);
        }
        return;
    }
    // What inverts a channel leaves no direction that the pairs agree on: then no other source is looked for, but that channel.
    let found_sum = first.as_ref().map_or(0.0, |first| first.mean * context.bins() * PAIR_COUNT as f32);
    let turned = Turned { plan, band: &plan.whole, found: found_sum, most: Turned::most(&peaks) };
    let doubtful = sign == Sign::Well && used.all() && turned.doubtful();
    if !doubtful && first.as_ref().is_some_and(|first| context.is_narrow(&scratch.spectrum.raw, first.mean)) {
        return;
    }
    let segment = memory.segments.wrapping_add(1);
    let other =
        first.as_ref().is_some_and(|first| memory.others.strongest(plan, first.refined.direction, segment));
    let doubt = match &first {
        Some(first) if used.all() => {
            let context = Context { depth: memory.depth.by_fringes(), ..context };
            let elsewhere = memory.is_elsewhere(&context, &first.refined.direction);
            let others = (other, elsewhere, &memory.others, segment);
            memory.agreement.take(&context, first, others, &peaks, &scratch.search, sink)
        }
        Some(_) => memory.agreement.of_three(&context),
        None => Some(Doubt::NONE),
    };
    if doubtful {
        let is = turned.is(&mut scratch.search, memory.sick.tried());
        let sign = memory.sick.turned(is);
        memory.sick.take(plan, sign, None, leak::Seen::NONE, context.index, sink);
        // Pairs that heard one direction do not hear what is left of it, but where a channel that is known to be late makes that, with its
        // error; nor is one told that is elsewhere than the source was.
        let changed = memory.was_explained(&context) && doubt.is_none_or(|doubt| doubt.quality == 1.0);
        let elsewhere = |found: &Found| memory.is_elsewhere(&context, &found.refined.direction);
        if is || changed || first.as_ref().is_some_and(elsewhere) {
            return;
        }
    }
    // A vessel that was heard does not dive.
    let dives = |found: &Found| {
        let direction = &found.refined.direction;
        others::is_below(direction) && memory.is_elsewhere(&context, direction)
    };
    if first.as_ref().is_some_and(dives) {
        return;
    }
    let Some(mut doubt) = doubt else { return };
    let mut leaks = false;
    if sign == Sign::Well && !doubtful {
        let (sign, seen) = match &first {
            Some(first) if used.all() => {
                memory.explained = context.index;
                let (search, coherence) = (&scratch.search, &scratch.spectrum.raw);
                let Found { tau, mean, .. } = first;
                let others = (&memory.others, segment);
                let context = &context;
                let beyond = leak::Beyond {
                    search,
                    tau,
                    coherence,
                    mean: *mean,
                    deviation,
                    context,
                    others,
                    echo: memory.echo.amplitude(),
                };
                let said = beyond.sign();
                let hidden = beyond.hides_of(memory.sick.suspected());
                if said.0 == Sign::Well && !hidden {
                    memory.sick.deny();
                }
                leaks = said.1.other.is_some() || said.0 == Sign::Well && hidden;
                said
            }
            _ => (sign, leak::Seen::NONE),
        };
        let vessel = first.as_ref().map(|f| &f.refined.direction);
        memory.sick.take(plan, sign, vessel, seen, context.index, sink);
    }
    if leaks || memory.sick.is_tainted() {
        let leaked = leak::LEAKED_SAMPLES / plan.rate_hz;
        doubt.unexplained_s2 += CHANNELS as f32 * leaked * leaked;
    }
    let mut apart = None;
    if let Some(first) = &first {
        let uneven = spectra.added.loudness.unevenness(spectra.added.frames) > MOST_UNEVEN_MOMENT;
        let heard = if alike && !uneven {
            heard(&context, spectra, start, centre, first.mean)
        } else {
            // The powers of its two steps are not of the same hydrophones, or of snaps more than of it.
            Context { moment_sd_s: UNKNOWN_MOMENT_S, ..context }
        };
        apart = whole(heard, memory, first, doubt, spectra, scratch, sink);
        // What else is heard is told of the same moment: bearings of one index are judged together.
        context.index = heard.index;
    }
    memory.segments = segment;
    if doubtful {
        return;
    }
    // Each uses the spectra up.
    let Some(first) = first else {
        // Of three hydrophones an octave's direction is told from its mirror image by nothing better than the whole band's.
        if used.all() {
            others::octave(&context, memory, None, spectra, scratch, sink);
        }
        return;
    };
    match memory.others.turn(memory.segments) {
        // With two delays to go by, a period more or less of an octave has a direction as well.
        Turn::Octave if !used.all() => {}
        // What leaks into one of the three stands beside the vessel, and is nobody.
        Turn::Search | Turn::Follow(_) if memory.sick.is_tainted() => {}
        Turn::Octave => others::octave(&context, memory, Some(&first), spectra, scratch, sink),
        Turn::Search => others::search(&context, memory, (&first, apart), spectra, scratch, sink),
        Turn::Follow(place) => others::follow(&context, memory, place, &first, spectra, scratch, sink),
    }
}

/// The context with the moment at which the strongest source is heard. Its frames weigh by their power, so that it is the
/// centre of its own loudness, for which the centre of all sound is taken. Steady noise would hold that nearer to the
/// frames' own `centre`, at most in the proportion of the coherence's `mean`, which an image in the surface lowers as well:
/// how far is the moment's deviation.
fn heard<'a>(context: &Context<'a>, spectra: &Spectra, start: u64, centre: u64, mean: f32) -> Context<'a> {
    let moment = spectra.added.loudness.centre().unwrap_or(centre as f64);
    let shift = (moment - centre as f64) as f32;
    // Anywhere between nothing and all of it.
    let moment_sd_s =
        shift.abs() * (1.0 / mean.clamp(LEAST_COHERENCE, 1.0) - 1.0) / (m::sqrt(3.0) * context.plan.rate_hz);
    Context { index: start.saturating_add(moment.max(0.0) as u64), moment_sd_s, ..*context }
}

/// Takes the whole band's source into the averages and reports it. Returns vessel and image where they are heard apart.
fn whole(
    mut context: Context<'_>,
    memory: &mut Memory,
    first: &Found,
    mut doubt: Doubt,
    spectra: &mut Spectra,
    scratch: &mut Scratch,
    sink: &mut impl FnMut(Message),
) -> Option<Apart> {
    let plan = context.plan;
    let mut apart = None;
    scratch.spectrum.measured = scratch.spectrum.raw.map(|c| c.max(0.0));
    scratch.spectrum.restore(refine::shared_signal(plan, context.band.used, &first.tau));
    memory.accept(plan, &first.refined.direction, context.index, &scratch.spectrum.raw);
    let turned = memory.turned_meanwhile(&context);
    if plan.vessel_over_array_depth > 0.0 && context.band.used.all() {
        apart = surface::joins(&mut context, memory, first, &mut doubt, spectra, scratch);
    }
    let noise = context.noise(memory.averaged);
    refine::smoothed(context.band, noise, &memory.coherence, &mut scratch.spectrum.smooth);
    let spectrum = &scratch.spectrum;
    let alone = !memory.others.any() && !memory.echo.heard();
    let scatter = (!alone || memory.misfit > report::DISAGREEING)
        .then(|| refine::scatter(&context, first, spectra, (&spectrum.smooth, &spectrum.weight)));
    let beside = memory.others.puts(plan, memory.segments);
    let steps = if context.flags & SHORTENED == 0 { plan.steps_per_segment } else { 1 };
    let swept = memory.others.strongest_turning() * steps as f32;
    let Memory { misfit, aside, steady, width, echo, .. } = memory;
    let mut stated = Default::default();
    let others = Others::Lasting {
        misfit,
        aside,
        steady,
        width: (width, swept),
        echo,
        scatter,
        alone,
        beside,
        stated: &mut stated,
    };
    if let Some(bearing) = report::bearing(&context, first, &scratch.spectrum, doubt, turned, 0, others) {
        if doubt.quality == 1.0 {
            memory.agreement.stated(stated);
        }
        sink(Message::Bearing(bearing));
    }
    apart
}

/// Searches, refines and tests: the strongest source of whitened spectra, if there is one.
#[inline(never)]
pub(super) fn find(
    context: &Context<'_>,
    memory: Option<&Memory>,
    spectra: &mut Spectra,
    scratch: &mut Scratch,
) -> Option<Found> {
    scratch.search.correlate(context.band, spectra, &mut scratch.work);
    found(context, memory, spectra, scratch)
}

/// The same from the correlations as they are.
#[inline(never)]
fn found(
    context: &Context<'_>,
    memory: Option<&Memory>,
    spectra: &mut Spectra,
    scratch: &mut Scratch,
) -> Option<Found> {
    let plan = context.plan;
    let best = scratch.search.best(plan, context.band, plan.curvature);
    let before = memory.and_then(|memory| memory.moments_ago(context));
    let half = half_apart(plan, &best);
    let used = context.band.used;
    let start = used.upright(&plan.geometry, &best, plan.elevation, before, half)?;
    let found = examine(context, memory, &start, spectra, scratch)?;
    (used.all() || three::is_heard(context, before, &found, &scratch.search)).then_some(found)
}

/// Refines from a direction and tests what is there.
#[inline(never)]
pub(super) fn examine(
    context: &Context<'_>,
    memory: Option<&Memory>,
    start: &Direction,
    spectra: &mut Spectra,
    scratch: &mut Scratch,
) -> Option<Found> {
    let plan = context.plan;
    let work = &mut scratch.spectrum;
    // Weights from the coherence seen in this direction, own and remembered.
    let (curvature, _) = context.curvature(start);
    let tau = context.delays(start, curvature);
    refine::coherence(plan, context.band, spectra, &tau, &mut work.raw);
    work.restore(refine::shared_signal(plan, context.band.used, &tau));
    let mean = context.detected(&work.raw) / context.bins();
    let segments = memory.map_or(1.0, |memory| memory.join_expected(context, start, mean, &mut work.raw));
    refine::smoothed(context.band, context.noise(segments), &work.raw, &mut work.smooth);
    refine::weights(context.band, &work.smooth, &mut work.weight);
    let refined = refine::refine(plan, context.band, spectra, &work.weight, start, curvature)?;
    let tau = context.delays(&refined.direction, curvature);
    refine::coherence(plan, context.band, spectra, &tau, &mut work.raw);
    let bins = context.bins();
    let pairs = context.band.used.pairs();
    let terms = pairs * bins;
    let sum = pairs * context.detected(&work.raw);
    let level = context.band.threshold * context.deviation(terms);
    if sum <= level || sum.is_nan() {
        return None;
    }
    let (low, high) = (context.band.incoherent, context.band.high);
    let used = context.band.used;
    let diffuse =
        detect::diffuse_mean(&plan.geometry, &plan.crossing_s, &tau, low, high, plan.bin_rad_s, used);
    let statistic = (sum - diffuse) / level;
    (statistic > 1.0).then_some(Found { refined, tau, statistic, mean: sum / terms })
}
