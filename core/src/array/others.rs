//! Other sources than the strongest of the whole band: in its octaves, one a segment in turn, and in the whole band once the
//! strongest is taken out, every eighth segment, or every fourth once one is followed. One that two searches found, not much fainter than the strongest, is followed
//! from then on, each in turn, and the searches look for further ones in what is left without them too. A search costs about as
//! much as the first, a look at one that is followed half of that; each uses the spectra up, so that a segment has one of them.

use super::agreement::Doubt;
use super::apart::Apart;
use super::chain::Scratch;
use super::echo::Echo;
use super::estimate::{Context, Found, MOST_UNEVEN, examine, find};
use super::followed::{Known, SECOND_APART_CELLS, SECOND_MOVES_RAD, is_near};
use super::memory::Memory;
use super::paths;
use super::plan::{Band, OCTAVES};
use super::refine;
use super::report::{Others, bearing};
use super::spectra::Spectra;
use super::three;
use super::wavefront::{self, Direction};
use crate::math::f32 as m;
use crate::wire::{Bearing, Message};

/// Most bearings of one step: the strongest source's, and that of an octave or of a second source.
pub const BEARINGS_A_STEP: u32 = 2;

/// Least coherence of a source that is followed, in units of the strongest one's: what multipath of that leaves is fainter, and may move as a
/// vessel does. A fainter source is left to the searches.
const FOLLOWED_LEAST: f32 = 0.2;
/// The same by three hydrophones, whose directions of what louder ones leave are wrong sooner.
const FOLLOWED_LEAST_BY_THREE: f32 = 0.3;
/// Looks in a row without it that end it.
const MISSED: u8 = 4;
/// A source in an octave nearer than this to the whole band's, in the octave's resolution cells, is the same.
const OCTAVE_APART_CELLS: f32 = 3.0;
/// Least coherence of a source in an octave, in units of the louder vessel's there: what multipath of that vessel leaves is
/// fainter, a vessel fainter than this is left to the search for a second source.
const OCTAVE_LEAST: f32 = 0.5;
/// Sine of the angle below the horizon beyond which a source is no vessel: errors put one that is far away so low. What multipath leaves
/// of a loud vessel may come from there, with quality.
const BELOW: f32 = 0.05;
/// `band` of the whole band's strongest source.
const WHOLE: u8 = 0;
/// `band` of the whole band's other sources.
const SECOND: u8 = 1;
/// `band` of the first octave's bearings.
const FIRST_OCTAVE: u8 = 2;
/// Least quality of a second source's bearing.
const SECOND_LEAST_QUALITY: f32 = 0.5;

/// Least coherence of a source that is followed, in units of the strongest one's.
fn followed_least(context: &Context<'_>) -> f32 {
    if context.band.used.all() { FOLLOWED_LEAST } else { FOLLOWED_LEAST_BY_THREE }
}

/// Whether a direction is below the horizon, where no vessel is.
#[inline]
pub(super) fn is_below(direction: &Direction) -> bool {
    let [.., up] = direction;
    *up < -BELOW
}

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
        scratch.spectrum.measured = *raw;
        least = OCTAVE_LEAST * raw.iter().sum::<f32>() / context.bins();
    }
    let Some(mut found) = find(&context, None, spectra, scratch) else { return };
    if let Some(first) = first {
        let work = &mut scratch.spectrum;
        if paths::is_image(&context, spectra, first, &work.measured) {
            return;
        }
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
    if is_below(&direction) {
        return;
    }
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
    if let Some(bearing) = told(&context, &found, FIRST_OCTAVE + n as u8, spectra, scratch) {
        sink(Message::Bearing(bearing));
    }
}

/// Looks for another source in what the first and those that are followed leave: their expected cross-spectra are taken out and the
/// search repeated. Their fluctuations count as noise of the other. What multipath of the first leaves can look like a source,
/// but somewhere else each time and with pairs that disagree: another source is reported only where the search before
/// found one too and the pairs agree.
pub(super) fn search(
    context: &Context<'_>,
    memory: &mut Memory,
    (first, apart): (&Found, Option<Apart>),
    spectra: &mut Spectra,
    scratch: &mut Scratch,
    sink: &mut impl FnMut(Message),
) {
    let plan = context.plan;
    let segment = memory.segments;
    match apart {
        Some(apart) => apart.remove(context, spectra, &mut scratch.spectrum),
        None => refine::remove(plan, context.band, spectra, &first.tau, &scratch.spectrum.measured),
    }
    let known = memory.others.known;
    for known in known.iter().filter(|k| k.lasts()) {
        let at = known.expected(segment);
        let tau = context.delays_from(&at);
        let raw = &mut scratch.spectrum.raw;
        refine::coherence(plan, context.band, spectra, &tau, raw);
        for c in raw.iter_mut() {
            *c = c.max(0.0);
        }
        refine::remove(plan, context.band, spectra, &tau, raw);
    }
    let is_new = |direction: &Direction| {
        !is_below(direction)
            && !is_near(plan, direction, &first.refined.direction)
            // By three hydrophones what is left of a vessel stands beside it as well.
            && (context.band.used.all()
                || wavefront::dot(direction, &first.refined.direction)
                    <= m::cos(SECOND_APART_CELLS * plan.whole.resolution))
            && !known.iter().any(|k| k.lasts() && k.is_at(plan, direction, segment))
    };
    let other = find(context, None, spectra, scratch);
    // What comes from below in the vessel's own direction is no vessel.
    memory.echo.look(context, first, &scratch.search, apart.is_some());
    let echo = |other: &Found| Echo::is(context, first, other);
    let image = || apart.is_none() && paths::is_image(context, spectra, first, &scratch.spectrum.measured);
    let other = other.filter(|other| !echo(other) && is_new(&other.refined.direction) && !image());
    let Some(other) = other else {
        memory.others.drop_doubtful();
        return;
    };
    let strong = other.mean > followed_least(context) * first.mean;
    if memory.others.found(other.refined.direction, segment, strong)
        && let Some(bearing) = told(context, &other, SECOND, spectra, scratch)
    {
        sink(Message::Bearing(bearing));
    }
}

/// Looks for a vessel in what a sound that is none leaves.
#[inline(never)]
pub(super) fn beside(
    context: &Context<'_>,
    sound: &Found,
    spectra: &mut Spectra,
    scratch: &mut Scratch,
    sink: &mut impl FnMut(Message),
) {
    let plan = context.plan;
    scratch.spectrum.measured = scratch.spectrum.raw.map(|c| c.max(0.0));
    refine::remove(plan, context.band, spectra, &sound.tau, &scratch.spectrum.measured);
    if let Some(found) = find(context, None, spectra, scratch)
        && !is_near(plan, &found.refined.direction, &sound.refined.direction)
        && let Some(bearing) = told(context, &found, WHOLE, spectra, scratch)
    {
        sink(Message::Bearing(bearing));
    }
}

/// Looks at a source that is followed, in what the first leaves, from where it is expected.
pub(super) fn follow(
    context: &Context<'_>,
    memory: &mut Memory,
    place: usize,
    first: &Found,
    spectra: &mut Spectra,
    scratch: &mut Scratch,
    sink: &mut impl FnMut(Message),
) {
    let plan = context.plan;
    let segment = memory.segments;
    let Some(known) = memory.others.known.get_mut(place) else { return };
    let expected = known.expected(segment);
    known.missed = known.missed.saturating_add(1);
    // Two vessels in one direction: it may come out on the other side.
    if !is_near(plan, &expected, &first.refined.direction) {
        refine::remove(plan, context.band, spectra, &first.tau, &scratch.spectrum.measured);
        let again = examine(context, None, &expected, spectra, scratch)
            .filter(|found| is_near(plan, &found.refined.direction, &expected))
            .filter(|found| three::is_on_its_side(context, Some(&expected), &found.refined.direction));
        if let Some(found) = again.filter(|found| found.mean > followed_least(context) * first.mean) {
            known.take(found.refined.direction, segment);
            if let Some(bearing) = told(context, &found, SECOND, spectra, scratch) {
                sink(Message::Bearing(bearing));
            }
        }
    }
    if known.missed >= MISSED {
        *known = Known::NONE;
    }
}

/// The bearing of a source that was found in what louder ones left, where the pairs agree. What those left counts as its noise.
#[inline(never)]
fn told(
    context: &Context<'_>,
    found: &Found,
    band: u8,
    spectra: &Spectra,
    scratch: &mut Scratch,
) -> Option<Bearing> {
    let work = &mut scratch.spectrum;
    if context.is_narrow(&work.raw, found.mean) || spectra.unevenness(context.plan, &work.raw) > MOST_UNEVEN {
        return None;
    }
    work.restore(refine::shared_signal(context.plan, context.band.used, &found.tau));
    refine::smoothed(context.band, context.noise(1.0), &work.raw, &mut work.smooth);
    let scatter = refine::scatter(context, found, spectra, (&work.smooth, &work.weight));
    let others = Others::Scatter(scatter.ratio);
    bearing(context, found, work, Doubt::NONE, 0.0, band, others)
        .filter(|b| b.quality >= SECOND_LEAST_QUALITY)
}

#[cfg(test)]
mod tests {
    use super::super::test_sea::{hear, noisy, plan, source};

    #[test]
    fn a_source_below_the_horizon_is_told_neither_beside_a_vessel_nor_instead_of_it() {
        let plan = plan(16_000.0);
        // A second source as loud as the vessel, and for two seconds a louder one, from below and from above.
        for (elevation, heard) in [(-0.5, false), (0.5, true)] {
            let mut sea = noisy(source(&plan, (2.1, 0.3), 3.0, None, 20, 3), 4);
            for (seconds, from_s, rms, azimuth, seed) in [(20, 0, 2.0, -1.0, 5), (2, 16, 9.0, 0.4, 6)] {
                let other = source(&plan, (azimuth, elevation), rms, None, seconds, seed);
                for (sum, x) in sea.iter_mut().skip(from_s * 16_000).zip(other) {
                    sum.iter_mut().zip(x).for_each(|(sum, x)| *sum += x);
                }
            }
            let away = |b: &&crate::wire::Bearing| (b.azimuth - 2.1).abs() > 0.5;
            let heard_away = hear(&plan, &sea).bearings.iter().filter(away).count();
            assert_eq!(heard_away > 2, heard, "{elevation}: {heard_away}");
            assert!(heard || heard_away == 0, "{heard_away} from below");
        }
    }
}
