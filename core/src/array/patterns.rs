//! Patterns over the six pairs: what of one does not lie along others, and how much of it there is in the pairs' values.
//!
//! Enters: values of the pairs, and what each pair would have of a cause. Leaves: shares of causes that leave different patterns. Pure arithmetic.

use super::wavefront::PAIR_COUNT;
use crate::math::f32 as m;

/// A value of each pair.
pub(super) type Pairs = [f32; PAIR_COUNT];

/// Share of a pattern that must be left beside the others for it to count as one of its own.
const LEAST_LEFT: f32 = 1e-3;

/// Scalar product.
#[inline(never)]
pub(super) fn product(a: &Pairs, b: &Pairs) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Takes out of `from` what lies along a pattern of length one, or of length 0, which takes nothing.
#[inline(never)]
pub(super) fn take(from: &mut Pairs, pattern: &Pairs) {
    let along = product(from, pattern);
    from.iter_mut().zip(pattern).for_each(|(x, p)| *x -= along * p);
}

/// Makes patterns of length one of what of each does not lie along those before it, of length 0 where that is too little. How many are left.
#[inline(never)]
pub(super) fn part(patterns: &mut [Pairs]) -> f32 {
    let mut left = 0.0;
    for n in 0..patterns.len() {
        let (before, rest) = patterns.split_at_mut(n);
        let Some(own) = rest.first_mut() else { continue };
        let whole = product(own, own);
        before.iter().for_each(|other| take(own, other));
        let square = product(own, own);
        let enough = square > LEAST_LEFT * whole;
        left += if enough { 1.0 } else { 0.0 };
        scale(own, if enough { m::inverse_sqrt(square) } else { 0.0 });
    }
    left
}

/// Each pair's values times the other's.
#[inline(never)]
pub(super) fn times(a: &Pairs, b: &Pairs) -> Pairs {
    let mut product = *a;
    product.iter_mut().zip(b).for_each(|(a, b)| *a *= b);
    product
}

/// Each value times the same.
#[inline(never)]
pub(super) fn scale(pattern: &mut Pairs, by: f32) {
    pattern.iter_mut().for_each(|x| *x *= by);
}

/// How much there is in the pairs' values of the last of these patterns, in its own units, beside what lies along those before it, and the square
/// of what of it does not lie along those; `None` where too little.
#[inline(never)]
pub(super) fn along(values: &Pairs, mut patterns: [Pairs; 4]) -> Option<(f32, f32)> {
    let [.., last] = patterns;
    part(&mut patterns);
    let [.., own] = &patterns;
    let length = product(own, &last);
    (length > 0.0).then(|| (product(own, values) / length, length * length))
}
