//! Arrival times of one wavefront at the four hydrophones, and how they change with direction.
//!
//! Enters: a unit vector towards the source and the curvature of its wavefront (1/range; 0 is a plane wave).
//! Leaves: arrival times relative to the array's centre, pair delays `τ_ij = t_j − t_i`, and their derivatives in
//! the tangent plane of the direction.
//!
//! `t_i = (‖r u − h_i‖ − r)/c`, written as `(κ‖h‖² − 2 u·h) / ((q + 1) c)` with `κ = 1/r`, `q = √(1 − 2κ u·h + κ²‖h‖²)`:
//! no difference of large numbers, so single precision keeps 0.1 ns. Cost: about 300 instructions.

use crate::block::CHANNELS;
use crate::geometry::{Geometry, PAIRS};
use crate::math::f32 as m;

/// Number of hydrophone pairs.
pub const PAIR_COUNT: usize = 6;

/// A unit vector, East-North-Up.
pub type Direction = [f32; 3];

/// Delays of the six pairs from the four arrival times, in the order of [`crate::geometry::PAIRS`].
pub fn pair_delays(t: &[f32; CHANNELS]) -> [f32; PAIR_COUNT] {
    let [t0, t1, t2, t3] = *t;
    [t1 - t0, t2 - t0, t3 - t0, t2 - t1, t3 - t1, t3 - t2]
}

/// Scalar product.
pub fn dot(a: &[f32; 3], b: &[f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Arrival times in seconds at the four hydrophones from direction `u`; `curvature` in 1/m.
#[inline(never)]
pub fn arrivals(geometry: &Geometry, u: &Direction, curvature: f32) -> [f32; CHANNELS] {
    let mut t = [0.0; CHANNELS];
    for (t, h) in t.iter_mut().zip(&geometry.position_m) {
        let along = dot(u, h);
        let bend = curvature * dot(h, h);
        let q = m::sqrt((1.0 + curvature * (bend - 2.0 * along)).max(0.0));
        *t = (bend - 2.0 * along) / ((q + 1.0) * geometry.sound_speed_m_s);
    }
    t
}

/// Derivative of the arrival times along the tangent vector `e` (seconds per radian).
#[inline(never)]
pub fn gradient(geometry: &Geometry, u: &Direction, e: &[f32; 3], curvature: f32) -> [f32; CHANNELS] {
    let mut g = [0.0; CHANNELS];
    for (g, h) in g.iter_mut().zip(&geometry.position_m) {
        let along = dot(u, h);
        let q = m::sqrt((1.0 + curvature * (curvature * dot(h, h) - 2.0 * along)).max(0.01));
        *g = -dot(e, h) / (q * geometry.sound_speed_m_s);
    }
    g
}

/// The two unit tangent vectors at a direction: of rising azimuth and of rising elevation.
#[inline(never)]
pub fn tangents(u: &Direction) -> ([f32; 3], [f32; 3]) {
    let horizontal = m::sqrt(u[0] * u[0] + u[1] * u[1]);
    let (s, c) = if horizontal > 1e-6 { (u[0] / horizontal, u[1] / horizontal) } else { (0.0, 1.0) };
    ([c, -s, 0.0], [-s * u[2], -c * u[2], horizontal])
}

/// The direction reached by a step `(a, b)` in the tangent plane, brought back to length one.
#[inline(never)]
pub fn stepped(u: &Direction, e: &([f32; 3], [f32; 3]), a: f32, b: f32) -> Direction {
    let mut v = [0.0; 3];
    for k in 0..3 {
        v[k] = u[k] + a * e.0[k] + b * e.1[k];
    }
    let length = m::sqrt(dot(&v, &v)).max(1e-6);
    v.map(|x| x / length)
}

/// Azimuth in [0, 2π) and elevation of a direction, radians.
#[inline(never)]
pub fn angles(u: &Direction) -> (f32, f32) {
    let horizontal = m::sqrt(u[0] * u[0] + u[1] * u[1]);
    (crate::angle::wrap_tau_f32(m::atan2(u[0], u[1])), m::atan2(u[2], horizontal))
}

/// `Gᵀ (4 I − 1 1ᵀ) G` of two gradients: the geometric part of the information about the two tangent components,
/// as (first, cross, second).
pub fn information(g1: &[f32; CHANNELS], g2: &[f32; CHANNELS]) -> (f32, f32, f32) {
    information_of(CHANNELS as f32, g1, g2)
}

#[inline(never)]
fn information_of(sensors: f32, g1: &[f32; CHANNELS], g2: &[f32; CHANNELS]) -> (f32, f32, f32) {
    let sum = |a: &[f32; CHANNELS], b: &[f32; CHANNELS]| {
        let (mut ab, mut sa, mut sb) = (0.0, 0.0, 0.0);
        for (x, y) in a.iter().zip(b) {
            ab += x * y;
            sa += x;
            sb += y;
        }
        sensors * ab - sa * sb
    };
    (sum(g1, g1), sum(g1, g2), sum(g2, g2))
}

/// The hydrophones that are listened to: all four, or three where one is left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Used {
    /// Bit h: hydrophone h.
    hydrophones: u8,
    /// Bit p: pair p.
    pairs: u8,
}

impl Used {
    /// All four.
    pub(crate) const ALL: Self = Self { hydrophones: 0b1111, pairs: 0b11_1111 };

    /// Those that are not `out` (bit h: hydrophone h); `None` where fewer than three are left.
    pub(crate) fn without(out: u8) -> Option<Self> {
        let hydrophones = Self::ALL.hydrophones & !out;
        let kept = |h: usize| hydrophones >> h & 1 == 1;
        let pairs = PAIRS.iter().rev().fold(0u8, |bits, (i, j)| bits << 1 | u8::from(kept(*i) && kept(*j)));
        (hydrophones.count_ones() >= 3).then_some(Self { hydrophones, pairs })
    }

    /// Whether all four are used.
    pub(crate) fn all(self) -> bool {
        self == Self::ALL
    }

    /// How many hydrophones.
    pub(crate) fn sensors(self) -> f32 {
        if self.all() { 4.0 } else { 3.0 }
    }

    /// How many pairs.
    pub(crate) fn pairs(self) -> f32 {
        if self.all() { 6.0 } else { 3.0 }
    }

    /// Whether hydrophone `h` is used.
    pub(crate) fn hydrophone(self, h: usize) -> bool {
        self.hydrophones >> (h & 7) & 1 == 1
    }

    /// Whether both hydrophones of pair `p` are used.
    #[inline]
    pub(crate) fn pair(self, p: usize) -> bool {
        self.pairs >> (p & 7) & 1 == 1
    }

    /// Of what there is for each pair, that of the pairs used.
    #[inline]
    pub(crate) fn of<T>(self, pairs: impl Iterator<Item = T>) -> impl Iterator<Item = T> {
        pairs.enumerate().filter(move |(p, _)| self.pair(*p)).map(|(_, of)| of)
    }

    /// `Gᵀ (M I − 1 1ᵀ) G` of two gradients over the M hydrophones used, as [`information`].
    #[inline(never)]
    pub(crate) fn information(self, g1: &[f32; CHANNELS], g2: &[f32; CHANNELS]) -> (f32, f32, f32) {
        let kept = |g: &[f32; CHANNELS]| {
            let mut out = *g;
            for (h, x) in out.iter_mut().enumerate() {
                if self.hydrophones >> h & 1 == 0 {
                    *x = 0.0;
                }
            }
            out
        };
        information_of(self.sensors(), &kept(g1), &kept(g2))
    }

    /// The direction that gives these delays and lies where vessels are. Three hydrophones cannot tell a direction from its
    /// mirror image in their plane: the one that rises from the horizon (by the sine of elevation, within `elevation`) is
    /// taken where the other lies [`BELOW`] it; where both may rise, the one that is much nearer to where the source was `before`, moments
    /// ago; `None` where that tells neither. The image of a vessel that crosses the plane comes back the way it came: without that
    /// moment its past says nothing. Where pairs hear a vessel and its image in the surface apart, each up to `half` (radians) from
    /// half-way, they give no direction in the plane, and one that crosses it seems to turn back before.
    #[inline(never)]
    pub(crate) fn upright(
        self,
        geometry: &Geometry,
        u: &Direction,
        elevation: (f32, f32),
        before: Option<&Direction>,
        half: f32,
    ) -> Option<Direction> {
        if self.all() {
            return Some(*u);
        }
        let mut corners =
            geometry.position_m.iter().enumerate().filter(|(h, _)| self.hydrophones >> h & 1 == 1);
        let (a, b, c) = (corners.next()?.1, corners.next()?.1, corners.next()?.1);
        let side = |to: &[f32; 3]| [to[0] - a[0], to[1] - a[1], to[2] - a[2]];
        let (b, c) = (side(b), side(c));
        let n = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
        let twice = 2.0 * dot(u, &n) / dot(&n, &n).max(1e-12);
        let mirrored = [u[0] - twice * n[0], u[1] - twice * n[1], u[2] - twice * n[2]];
        let rises = |d: &Direction, from: f32| d[2] >= from && d[2] <= elevation.1;
        let horizon = elevation.0.max(0.0);
        let either = |a: bool, b: bool| match (a, b) {
            (true, false) => Some(*u),
            (false, true) => Some(mirrored),
            _ => None,
        };
        let (a, b) = (rises(u, horizon), rises(&mirrored, horizon));
        let may = |d: &Direction| rises(d, horizon - BELOW);
        if a != b && !(may(u) && may(&mirrored)) {
            return either(a, b);
        }
        let before = before?;
        let from = |d: &Direction| m::acos(dot(before, d).clamp(-1.0, 1.0));
        let apart = APART_RAD + 2.0 * m::sqrt(half);
        let much =
            |near: f32, far: f32| far > apart && near < (MUCH_NEARER * far).min(APART_RAD + 2.0 * half);
        let (a, b) = (a.then(|| from(u)), b.then(|| from(&mirrored)));
        let (a, b) = (a.unwrap_or(m::PI), b.unwrap_or(m::PI));
        either(much(a, b), much(b, a))
    }
}

/// A direction whose sine is so far below the horizon is no vessel's, however faint or curved its sound.
const BELOW: f32 = 0.05;
/// Where the source was tells a direction from its mirror image where it is nearer to it by this factor, and farther than this from the
/// image, and as near as this to the direction (what is farther off is another's), radians.
const MUCH_NEARER: f32 = 0.3;
const APART_RAD: f32 = 0.1;

/// Inverse of a symmetric matrix of two rows, (first, cross, second) as it enters; `None` unless it is positive definite.
#[inline(never)]
pub fn inverse(m: (f32, f32, f32)) -> Option<(f32, f32, f32)> {
    let determinant = m.0 * m.2 - m.1 * m.1;
    (determinant > 0.0).then(|| (m.2 / determinant, -m.1 / determinant, m.0 / determinant))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::angle::unit_vector;

    fn tetra() -> Geometry {
        let a = [[0.0, 1.07, -0.38], [0.93, -0.53, -0.38], [-0.93, -0.53, -0.38], [0.0, 0.0, 1.13]];
        Geometry::new(&a, 0.3, 1484.0).unwrap()
    }

    #[test]
    fn arrival_times_are_distances_over_speed() {
        let g = tetra();
        let u = unit_vector(1.1, 0.4);
        for range in [20.0f64, 500.0, 1e6] {
            let t = arrivals(&g, &u, (1.0 / range) as f32);
            for (t, h) in t.iter().zip(&g.position_m) {
                let d2: f64 = (0..3).map(|k| (range * f64::from(u[k]) - f64::from(h[k])).powi(2)).sum();
                let exact = (d2.sqrt() - range) / 1484.0;
                assert!((f64::from(*t) - exact).abs() < 1e-9 + 1e-7 * range / 1484.0, "{range}");
            }
        }
    }

    #[test]
    fn three_hydrophones_tell_no_side_of_their_plane_where_an_image_in_the_surface_hides_it() {
        let g = tetra();
        // Hydrophones 0, 2 and 3 are in an upright plane; directions aside of it, and moments before a little farther.
        let used = Used::without(0b0010).unwrap();
        let tells = |aside: f32, half: f32| {
            let along = |aside: f32| {
                let [a, b, c] = [0, 2, 3].map(|h: usize| g.position_m[h]);
                let (b, c) = ([0, 1, 2].map(|k: usize| b[k] - a[k]), [0, 1, 2].map(|k: usize| c[k] - a[k]));
                let n = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
                let n = n.map(|x| x / m::sqrt(dot(&n, &n)));
                // In the plane, 15° above the horizon or so.
                let level = [-n[1], n[0], 0.0].map(|x| x / m::hypot(n[0], n[1]));
                let rising = [0, 1, 2].map(|k: usize| level[k] + if k == 2 { 0.25 } else { 0.0 });
                let off = dot(&rising, &n);
                let flat = [0, 1, 2].map(|k: usize| rising[k] - off * n[k]);
                let flat = flat.map(|x| x / m::sqrt(dot(&flat, &flat)));
                let (s, c) = m::sin_cos(aside);
                [0, 1, 2].map(|k: usize| c * flat[k] + s * n[k])
            };
            let (u, before) = (along(aside), along(aside + 0.01));
            let told = used.upright(&g, &u, (-1.0, 1.0), Some(&before), half);
            assert!(told.is_none_or(|told| dot(&told, &u) > 0.9999), "{aside} {half}");
            told.is_some()
        };
        assert!(!tells(0.04, 0.0) && tells(0.07, 0.0));
        // 200 m from a vessel, 60 m deep.
        assert!(!tells(0.07, 0.03) && !tells(0.2, 0.03) && tells(0.3, 0.03));
    }

    #[test]
    fn gradients_are_finite_differences() {
        let g = tetra();
        let u = unit_vector(5.0, -0.7);
        let e = tangents(&u);
        for curvature in [0.0, 0.02] {
            for (a, b, tangent) in [(1e-2, 0.0, e.0), (0.0, 1e-2, e.1)] {
                let plus = arrivals(&g, &stepped(&u, &e, a, b), curvature);
                let minus = arrivals(&g, &stepped(&u, &e, -a, -b), curvature);
                for (i, d) in gradient(&g, &u, &tangent, curvature).iter().enumerate() {
                    assert!((d - (plus[i] - minus[i]) / 2e-2).abs() < 3e-7);
                }
            }
        }
    }
}
