//! How much the pairs contradict a direction aside of the vertical plane through it.
//!
//! A vessel, its image in the surface and echoes off the bottom stand above each other. A pair's delay differs between them by its change
//! with elevation, x, times what they are apart, and where their peaks join it pulls the direction up or down by an odd function of x. Pulls by
//! x, x³ and x⁵ are therefore theirs, whatever their size: they err in elevation, and leave the azimuth to what the other pairs say. Another
//! vessel, a hydrophone elsewhere than told or a late channel pull as they like. Six pairs less the direction's two dimensions and the two
//! odd powers leave two, in which those show and a vessel's own paths do not.
//!
//! Cost: about 500 instructions.

use super::patterns::{Pairs, part, product, scale, take, times};
use super::wavefront::PAIR_COUNT;
use crate::math::f32 as m;

/// Mean square of the pairs' pulls (seconds) in a dimension that neither the direction nor paths above each other explain, s², for the pairs'
/// changes of delay along the horizontal and upward tangents.
#[inline(never)]
pub(super) fn mean_square(pull: &Pairs, across: &Pairs, up: &Pairs) -> f32 {
    let most = up.iter().map(|x| m::abs(*x)).fold(f32::MIN_POSITIVE, f32::max);
    let mut up = *up;
    scale(&mut up, 1.0 / most);
    let square = times(&up, &up);
    let cube = times(&up, &square);
    let mut patterns = [*across, up, cube, times(&cube, &square)];
    let dimensions = PAIR_COUNT as f32 - part(&mut patterns);
    let mut left = *pull;
    patterns.iter().for_each(|pattern| take(&mut left, pattern));
    product(&left, &left) / dimensions
}

#[cfg(test)]
mod tests {
    use super::super::test_sea::{Normal, plan};
    use super::super::wavefront::{arrivals, gradient, pair_delays, tangents};
    use super::*;
    use crate::angle::unit_vector;

    /// Changes of the pairs' delays with a direction, along its tangents, s.
    fn changes(azimuth: f32, elevation: f32) -> (Pairs, Pairs) {
        let plan = plan(64_000.0);
        let u = unit_vector(azimuth, elevation);
        let e = tangents(&u);
        let along = |e: &[f32; 3]| pair_delays(&gradient(plan.geometry(), &u, e, 0.0));
        (along(&e.0), along(&e.1))
    }

    #[test]
    fn paths_above_each_other_leave_nothing_and_anything_else_does() {
        let mut random = Normal(3);
        for n in 0..60 {
            let (across, up) = changes(0.1 * n as f32, 0.1 + 0.01 * n as f32);
            let most = up.iter().fold(0.0f32, |most, x| most.max(x.abs()));
            // Peaks that join: a slope that rises, falls and turns.
            let joined = up.map(|x| 1e-5 * m::sin_cos(3.0 * x / most).0);
            let square = |pull: &Pairs| product(pull, pull) / PAIR_COUNT as f32;
            let left = mean_square(&joined, &across, &up);
            assert!(left < 0.1 * square(&joined), "{n}: {left} of {}", square(&joined));
            let mut anything = [0.0f32; PAIR_COUNT];
            anything.iter_mut().for_each(|x| *x = 1e-5 * random.next() as f32);
            let both = mean_square(&anything, &across, &up);
            assert!(both <= PAIR_COUNT as f32 * square(&anything), "{n}");
            std::println!("{n}: {:.3} {:.3}", left / square(&joined), both / square(&anything));
        }
    }

    #[test]
    fn in_the_mean_a_dimension_left_has_what_a_pair_has() {
        let mut random = Normal(11);
        let (mut sum, mut of) = (0.0f64, 0.0);
        for n in 0..3000 {
            let (across, up) = changes(0.37 * n as f32, 0.1 + 0.0002 * n as f32);
            let mut pull = [0.0f32; PAIR_COUNT];
            pull.iter_mut().for_each(|x| *x = random.next() as f32);
            sum += f64::from(mean_square(&pull, &across, &up));
            of += 1.0;
        }
        assert!((sum / of - 1.0).abs() < 0.06, "{}", sum / of);
    }

    #[test]
    fn a_late_channel_shows_in_most_directions() {
        let (mut shown, mut of) = (0, 0);
        for n in 0..200 {
            let (azimuth, elevation) = (0.0317 * n as f32, 0.1 + 0.003 * n as f32);
            let (across, up) = changes(azimuth, elevation);
            let mut late = arrivals(plan(64_000.0).geometry(), &unit_vector(azimuth, elevation), 0.0);
            late = late.map(|_| 0.0);
            late[n % 4] = 1e-5;
            shown += usize::from(mean_square(&pair_delays(&late), &across, &up) > 1e-12);
            of += 1;
        }
        assert!(5 * shown > 3 * of, "{shown} of {of}");
    }
}
