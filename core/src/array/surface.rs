//! What the surface makes of the strongest source: how deep the vessel is, whether it is heard apart from its image, and where between the two.
//!
//! Enters: a source found and the segment's spectra. Leaves, in the segment's context: the depth, by the image's fringes ([`super::fringes`]) or by the angle between the
//! two ([`super::apart`]); the vessel's own direction where they are apart; and by how much nearer to the vessel than half-way both are heard elsewhere. An echo off the bottom joins
//! both: of what is heard with one the angle tells nothing, fringes still do, and where they are heard is told with as large a deviation as without a depth.

use super::agreement::Doubt;
use super::apart::Apart;
use super::chain::Scratch;
use super::estimate::{Context, Found};
use super::fringes;
use super::memory::Memory;
use super::report;
use super::spectra::Spectra;

/// Takes what a segment tells of it, by which its bearing may be doubted more; returns vessel and image where they are heard apart.
#[inline(never)]
pub(super) fn joins(
    context: &mut Context<'_>,
    memory: &mut Memory,
    first: &Found,
    doubt: &mut Doubt,
    spectra: &mut Spectra,
    scratch: &mut Scratch,
) -> Option<Apart> {
    let plan = context.plan;
    let direction = &first.refined.direction;
    let sine = memory.depth.surface(plan, direction);
    let (others, echo) = (memory.others.any(), memory.echo.heard());
    // Another vessel in the same azimuth would be taken for the image.
    let seen = if memory.others.lasts() { None } else { Apart::seen(context, &scratch.search, first) };
    // Where the two are heard as one that is the surface's direction.
    let surface = seen.map_or(sine, |seen| seen.surface());
    let by_fringes = fringes::depth_m(plan, spectra, surface, (first.mean, echo), &mut scratch.work);
    let fringes_m = by_fringes.map(|told| told.depth_m()).or(memory.depth.by_fringes().map(|(d, _)| d));
    let seen = seen.filter(|seen| fringes_m.is_none_or(|d| !seen.contradicts(d)));
    // An echo pulls what the angle tells.
    let known = memory.depth.known().filter(|_| !echo);
    let by_angle = seen.filter(|_| !echo).map(|seen| seen.told(first.mean));
    memory.depth.take(by_fringes.or(by_angle));
    context.depth = if echo { memory.depth.by_fringes() } else { memory.depth.known() };
    // Believed by what segments before this one agreed on.
    if let Some(seen) = seen.filter(|seen| known.is_some_and(|(d, _)| !seen.contradicts(d))) {
        // That uses the coherence up, which the image's loss is told by.
        let apart = seen.told_apart(context, spectra, &mut scratch.spectrum);
        if let Some(apart) = &apart {
            let vessel = apart.vessel();
            context.vessel = Some(vessel);
            *doubt = doubt.or(memory.agreement.of_vessel(context, &vessel, apart.pair_delays()));
        }
        return apart.or(Some(seen));
    }
    let Some((d, _)) = context.depth else { return seen };
    context.echo = echo && !others;
    let (angle, usual) = report::image(plan, direction, d);
    let delay_s = 2.0 * d * sine * plan.inv_c;
    if !fringes::are_wide(plan, delay_s) {
        context.loss = (usual, 0.0);
        return seen;
    }
    let image = memory.depth.image(plan, direction, memory.segments);
    let heard = (&scratch.spectrum.weight, &scratch.spectrum.raw);
    if let Some(loss) =
        fringes::loss(context, first, spectra, heard, (delay_s, angle), image, &mut scratch.work)
    {
        // Beyond that the fringes are not those of vessel and image alone.
        let most = fringes::THIRD_PATH * if others { 2.0 } else { 1.0 };
        if loss.unexplained > most && !context.echo {
            context.depth = None;
        }
        // The farther apart they stand, the less is a loss what it is taken for.
        let resolved = 0.5 * angle / plan.whole.resolution;
        if loss.unexplained < most * (1.0 - resolved * resolved) {
            memory.depth.take_loss(&loss);
        }
        context.loss = memory.depth.shift(usual, loss.nearer);
    }
    seen
}
