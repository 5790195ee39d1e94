//! What three hydrophones can tell: a direction, where it is not its mirror image in their plane that they hear, nor a mixture of two sources.
//!
//! Enters: a direction that was found, where the source was moments ago, and the pairs' correlations. Leaves: whether it may be told.
//! Cost: some hundred instructions, and only while a hydrophone is left out.

use super::agreement::half_apart;
use super::estimate::{Context, Found};
use super::search::SearchWork;
use super::wavefront::Direction;

/// Share of the mean of three pairs' correlations in a direction that each of them has at least.
const EACH_HEARS: f32 = 0.65;

/// Whether a direction is the one of the two that three hydrophones can mean.
pub(super) fn is_on_its_side(context: &Context<'_>, before: Option<&Direction>, u: &Direction) -> bool {
    let (plan, half) = (context.plan, half_apart(context.plan, u));
    context.band.used.upright(&plan.geometry, u, plan.elevation, before, half) == Some(*u)
}

/// Whether what three hydrophones found stands on the side of their plane that they can tell, and each of their pairs hears it. Two delays have
/// always a direction, also where one is a vessel's and the other another's or an image's; then the third pair hears nothing there.
#[inline(never)]
pub(super) fn is_heard(
    context: &Context<'_>,
    before: Option<&Direction>,
    found: &Found,
    search: &SearchWork,
) -> bool {
    let (plan, used) = (context.plan, context.band.used);
    let u = &found.refined.direction;
    if !is_on_its_side(context, before, u) {
        return false;
    }
    let values = || used.of(found.tau.iter().enumerate()).map(|(p, tau)| search.pair_value(plan, p, *tau));
    let (least, sum) = values().fold((f32::MAX, 0.0), |(least, sum), x| (least.min(x), sum + x));
    least > EACH_HEARS * sum / used.pairs()
}
