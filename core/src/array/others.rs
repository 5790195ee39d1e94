//! Other sources than the strongest of the whole band: in its octaves, one a segment in turn, and in the whole band once the
//! strongest is taken out, every eighth segment. Either costs about as much as the first search and uses the spectra up.

use super::agreement::Doubt;
use super::chain::Scratch;
use super::estimate::{Context, Found, Memory, SpectrumWork, examine, find};
use super::plan::{Band, OCTAVES};
use super::refine;
use super::report::{Others, bearing};
use super::spectra::Spectra;
use super::wavefront::{self, Direction};
use crate::math::f32 as m;
use crate::wire::Message;

/// Most bearings of one step: the strongest source's, and that of an octave or of a second source.
pub const BEARINGS_A_STEP: u32 = 2;

/// A second source nearer than this to the first, in resolution cells, is what is left of the first.
const SECOND_APART_CELLS: f32 = 6.0;
/// Farthest a second source moves between two searches, radians: a vessel at 100 m turns by 4° a second.
const SECOND_MOVES_RAD: f32 = 0.28;
/// A source in an octave nearer than this to the whole band's, in the octave's resolution cells, is the same.
const OCTAVE_APART_CELLS: f32 = 3.0;
/// Least coherence of a source in an octave, in units of the louder vessel's there: what multipath of that vessel leaves is
/// fainter, a vessel fainter than this is left to the search for a second source.
const OCTAVE_LEAST: f32 = 0.5;
/// `band` of the first octave's bearings.
const FIRST_OCTAVE: u8 = 2;
/// Least quality of a second source's bearing.
const SECOND_LEAST_QUALITY: f32 = 0.5;

/// Looks at one octave, the next of the round. A source there is reported where it is another than the whole band's and
/// the round before found it, too; what a louder vessel gives in this octave comes out of its cross-spectra first.
pub(super) fn octave(
    context: &Context<'_>,
    memory: &mut Memory,
    first: Option<&Found>,
    spectra: &mut Spectra,
    scratch: &mut Scratch,
    sink: &mut impl FnMut(Message),
) {
    let plan = context.plan;
    let next = (1..=OCTAVES).map(|n| (memory.octave + n) % OCTAVES);
    let Some((n, Some(band))) =
        next.map(|n| (n, plan.octaves.get(n).copied().flatten())).find(|o| o.1.is_some())
    else {
        return;
    };
    memory.octave = n;
    let Some(before) = memory.octaves.get_mut(n) else { return };
    let before = before.take();
    let band = Band { used: context.band.used, ..band };
    let context = Context { band: &band, ..*context };
    let mut least = 0.0;
    if let Some(first) = first {
        let raw = &mut scratch.spectrum.raw;
        refine::coherence(plan, &band, spectra, &first.tau, raw);
        refine::remove(plan, &band, spectra, &first.tau, raw);
        least = OCTAVE_LEAST * raw.iter().sum::<f32>() / context.bins();
    }
    let Some(mut found) = find(&context, None, spectra, scratch) else { return };
    if let Some(first) = first {
        let work = &mut scratch.spectrum;
        refine::smoothed(&band, context.noise(1.0), &work.raw, &mut work.smooth);
        refine::overdone(plan, &band, &first.tau, &found.tau, &mut work.smooth);
        refine::remove(plan, &band, spectra, &first.tau, &work.smooth);
        let again = examine(&context, None, &found.refined.direction, spectra, scratch);
        found = match again {
            Some(again) if again.mean > least => again,
            _ => return,
        };
    }
    let direction = found.refined.direction;
    let apart = (OCTAVE_APART_CELLS * band.resolution).max(SECOND_APART_CELLS * plan.whole.resolution);
    if first.is_some_and(|f| wavefront::dot(&f.refined.direction, &direction) > m::cos(apart.min(m::PI))) {
        return;
    }
    if let Some(slot) = memory.octaves.get_mut(n) {
        *slot = Some(direction);
    }
    let moves = SECOND_MOVES_RAD.max(band.resolution);
    if !before.is_some_and(|d| wavefront::dot(&d, &direction) > m::cos(moves)) {
        return;
    }
    let work = &mut scratch.spectrum;
    work.restore(refine::shared_signal(plan, context.band.used, &found.tau));
    refine::smoothed(&band, context.noise(1.0), &work.raw, &mut work.smooth);
    let others = scattered(&context, &found, spectra, work);
    let bearing = bearing(&context, &found, work, Doubt::NONE, 0.0, FIRST_OCTAVE + n as u8, others);
    if let Some(bearing) = bearing.filter(|b| b.quality >= SECOND_LEAST_QUALITY) {
        sink(Message::Bearing(bearing));
    }
}

/// What the first source left about another, whose smoothed coherence is in the work space.
fn scattered<'a>(context: &Context<'_>, found: &Found, spectra: &Spectra, work: &SpectrumWork) -> Others<'a> {
    let scatter = refine::scatter(context, found, spectra, (&work.smooth, &work.weight));
    Others::Scatter(scatter.ratio)
}

/// Looks for another source in what the first leaves: its expected cross-spectra are taken out and the search repeated.
/// The first source's fluctuations count as noise of the second. What multipath of the first leaves can look like a source,
/// but somewhere else each time and with pairs that disagree: a second source is reported only where the search before
/// found one too (`before`) and the pairs agree. The direction found, for the next search.
pub(super) fn second(
    context: &Context<'_>,
    before: Option<Direction>,
    first: &Found,
    spectra: &mut Spectra,
    scratch: &mut Scratch,
    sink: &mut impl FnMut(Message),
) -> Option<Direction> {
    let plan = context.plan;
    refine::remove(plan, context.band, spectra, &first.tau, &scratch.spectrum.measured);
    let other = find(context, None, spectra, scratch)?;
    let near = m::cos(SECOND_APART_CELLS * plan.whole.resolution);
    if wavefront::dot(&other.refined.direction, &first.refined.direction) > near {
        return None;
    }
    scratch.spectrum.restore(refine::shared_signal(plan, context.band.used, &other.tau));
    let work = &mut scratch.spectrum;
    refine::smoothed(context.band, context.noise(1.0), &work.raw, &mut work.smooth);
    let lasting =
        before.is_some_and(|d| wavefront::dot(&d, &other.refined.direction) > m::cos(SECOND_MOVES_RAD));
    let others = scattered(context, &other, spectra, work);
    let bearing = bearing(context, &other, work, Doubt::NONE, 0.0, 1, others);
    if let Some(bearing) = bearing.filter(|b| lasting && b.quality >= SECOND_LEAST_QUALITY) {
        sink(Message::Bearing(bearing));
    }
    Some(other.refined.direction)
}
