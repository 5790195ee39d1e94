//! Maximum-likelihood position inside the search region [N 8, 9, 10].
//!
//! The likelihood has several maxima (behind an array, along the ridge towards infinite range), so starting points
//! come from three sources: the crossings of every pair of bearings, each array's own bearing carried to the known or
//! middle height, and a polar grid about the network. The best of each group are improved by a few
//! Levenberg-Marquardt steps that stay inside the region, and the best two of those to convergence. A test holds the result
//! against the paper's exhaustive grid (5 m over ±2000 m).
//!
//! Cost: about 120 + 112 to 336 likelihoods, each of 2N arc tangents, and at most 200 steps; under 1 ms on a host.

use super::model::{self, Sighting, cost};
use super::{NetworkError, Region};
use crate::angle::wrap_pi;
use crate::kit::{Normal, Square, minimise};
use crate::math::f64 as m;

/// Azimuths, ranges and heights of the grid of starting points: 22.5° and a factor of about two in range lie well
/// inside the basin of a Gauss-Newton step for bearings; three heights span a water column.
const GRID_AZIMUTHS: u32 = 16;
const GRID_RANGES: u32 = 7;
const GRID_HEIGHTS: u32 = 3;
/// Nearest grid range, metres: closer in, the crossings of bearings are good starts themselves.
const GRID_NEAREST_M: f64 = 20.0;
/// Starting points kept: one of the crossings, one of the single bearings, a near and a far one per grid height.
const STARTS: usize = 2 + 2 * GRID_HEIGHTS as usize;
/// Steps for every start, then for the best two.
const FIRST_STEPS: usize = 6;
const LAST_STEPS: usize = 80;
/// Fall of the misfit that is not worth a step.
const LEAST_FALL: f64 = 1e-13;

/// The most likely position in the region, resolved or not: [`fn@super::locate`] decides whether it is a fix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Maximum {
    /// East, North, Up, metres.
    pub position_m: [f64; 3],
    /// Sum of squared standardised residuals at the maximum.
    pub misfit: f64,
    /// Fisher information by (x, y, z) there.
    pub information: Square<3>,
    /// Which of the region's coordinates ended at a limit (never those that are known).
    pub at_edge: [bool; 3],
}

/// Searches the region for the maximum of the likelihood.
///
/// # Errors
/// As [`model::check`] and [`Region::check`].
pub fn maximum(sightings: &[Sighting], region: &Region) -> Result<Maximum, NetworkError> {
    model::check(sightings)?;
    region.check()?;
    let mut starts = Starts::new(sightings, region);
    starts.add_crossings();
    starts.add_single_bearings();
    starts.add_grid();

    let mut best: [Option<(f64, [f64; 3])>; 2] = [None; 2];
    for (_, own) in starts.kept.into_iter().flatten() {
        let Some(improved) = climb(sightings, region, own, FIRST_STEPS) else { continue };
        let [first, second] = &mut best;
        if first.is_none_or(|(c, _)| improved.0 < c) {
            *second = *first;
            *first = Some(improved);
        } else if second.is_none_or(|(c, _)| improved.0 < c) {
            *second = Some(improved);
        }
    }
    let mut winner: Option<(f64, [f64; 3])> = None;
    for (_, own) in best.into_iter().flatten() {
        let Some(done) = climb(sightings, region, own, LAST_STEPS) else { continue };
        if winner.is_none_or(|(c, _)| done.0 < c) {
            winner = Some(done);
        }
    }
    let (misfit, own) = winner.ok_or(NetworkError::NotFinite)?;
    let position_m = region.position(&own);
    let (least, greatest) = region.limits();
    let mut at_edge = region.free();
    for (((edge, x), lo), hi) in at_edge.iter_mut().zip(&own).zip(&least).zip(&greatest) {
        let margin = 1e-9 * (hi - lo);
        *edge = *edge && (*x <= lo + margin || *x >= hi - margin);
    }
    Ok(Maximum {
        position_m,
        misfit,
        information: super::bound::information(sightings, &position_m),
        at_edge,
    })
}

/// Starting points, the best of each group.
struct Starts<'a> {
    sightings: &'a [Sighting],
    region: &'a Region,
    kept: [Option<(f64, [f64; 3])>; STARTS],
    /// Mean position of the arrays.
    centre_m: [f64; 3],
    /// Heights the grid uses.
    heights_m: [f64; GRID_HEIGHTS as usize],
    /// How far from the centre the region reaches, metres.
    reach_m: f64,
}

impl<'a> Starts<'a> {
    fn new(sightings: &'a [Sighting], region: &'a Region) -> Self {
        let n = sightings.len() as f64;
        let mut centre_m = [0.0; 3];
        for s in sightings {
            for (c, x) in centre_m.iter_mut().zip(&s.array_m) {
                *c += x / n;
            }
        }
        let ([x0, y0, z0], [x1, y1, z1]) = match *region {
            Region::Box { least_m, greatest_m } => (least_m, greatest_m),
            Region::Polar { elevation, range_m } => {
                let r = range_m.1;
                ([-r, -r, r * m::sin(elevation.0)], [r, r, r * m::sin(elevation.1)])
            }
        };
        let [cx, cy, _] = centre_m;
        let far = |lo: f64, hi: f64, c: f64| (hi - c).max(c - lo).max(0.0);
        let (fx, fy) = (far(x0, x1, cx), far(y0, y1, cy));
        let reach_m = m::sqrt(fx * fx + fy * fy).max(2.0 * GRID_NEAREST_M);
        // A polar region says nothing of the height; a source among the arrays' own scale is the likeliest.
        let (z0, z1) = match region {
            Region::Box { .. } => (z0, z1),
            Region::Polar { .. } => (z0.max(-0.2 * reach_m), z1.min(0.2 * reach_m)),
        };
        let heights_m = [0.95, 0.5, 0.1].map(|f| z0 + f * (z1 - z0));
        Self { sightings, region, kept: [None; STARTS], centre_m, heights_m, reach_m }
    }

    /// Offers a starting point to a group.
    fn offer(&mut self, group: usize, position_m: &[f64; 3]) {
        if !position_m.iter().all(|x| x.is_finite()) {
            return;
        }
        let own = self.region.own(position_m);
        let c = cost(self.sightings, &self.region.position(&own));
        if let Some(slot) = self.kept.get_mut(group)
            && c.is_finite()
            && slot.is_none_or(|(best, _)| c < best)
        {
            *slot = Some((c, own));
        }
    }

    /// Points where two bearings pass closest to each other.
    fn add_crossings(&mut self) {
        let sightings = self.sightings;
        for (i, a) in sightings.iter().enumerate() {
            for b in sightings.iter().skip(i + 1) {
                if let Some(p) = crossing(a, b, self.heights_m) {
                    self.offer(0, &p);
                }
            }
        }
    }

    /// Each array's own bearing, carried to the grid's heights.
    fn add_single_bearings(&mut self) {
        for s in self.sightings {
            let Some(elevation) = s.elevation else { continue };
            let (sa, ca) = m::sin_cos(s.azimuth);
            let [x, y, z] = s.array_m;
            for height in self.heights_m {
                let d = (height - z) / m::tan(elevation);
                // A horizontal bearing, or one that points away from that height, is carried to the region's end.
                let d = if d > 0.0 { d.min(self.reach_m) } else { self.reach_m };
                self.offer(1, &[x + d * sa, y + d * ca, height]);
            }
        }
    }

    /// A polar grid about the network.
    fn add_grid(&mut self) {
        let [cx, cy, _] = self.centre_m;
        let growth = m::powf(self.reach_m / GRID_NEAREST_M, 1.0 / f64::from(GRID_RANGES - 1));
        let levels = if self.region.depth_known() { 1 } else { GRID_HEIGHTS as usize };
        for (level, height) in self.heights_m.into_iter().take(levels).enumerate() {
            let mut range_m = GRID_NEAREST_M;
            for k in 0..GRID_RANGES {
                let group = 2 + 2 * level + usize::from(2 * k >= GRID_RANGES);
                for a in 0..GRID_AZIMUTHS {
                    let (sa, ca) = m::sin_cos(m::TAU * f64::from(a) / f64::from(GRID_AZIMUTHS));
                    self.offer(group, &[cx + range_m * sa, cy + range_m * ca, height]);
                }
                range_m *= growth;
            }
        }
    }
}

/// Where two bearings cross: in the horizontal plane, at the height their elevations give (or the middle one).
fn crossing(a: &Sighting, b: &Sighting, heights_m: [f64; 3]) -> Option<[f64; 3]> {
    let (sa, ca) = m::sin_cos(a.azimuth);
    let (sb, cb) = m::sin_cos(b.azimuth);
    let [dx, dy, _] = model::difference(&b.array_m, &a.array_m);
    let sine = m::sin(wrap_pi(b.azimuth - a.azimuth));
    if m::abs(sine) < 1e-6 {
        return None;
    }
    let along_a = (dy * sb - dx * cb) / sine;
    let along_b = (dy * sa - dx * ca) / sine;
    if along_a <= 0.0 || along_b <= 0.0 {
        return None;
    }
    let ([ax, ay, az], [_, _, bz]) = (a.array_m, b.array_m);
    let [_, middle, _] = heights_m;
    let z = match (a.elevation, b.elevation) {
        (Some(ea), Some(eb)) => 0.5 * (az + along_a * m::tan(ea) + bz + along_b * m::tan(eb)),
        (Some(ea), None) => az + along_a * m::tan(ea),
        (None, Some(eb)) => bz + along_b * m::tan(eb),
        (None, None) => middle,
    };
    Some([ax + along_a * sa, ay + along_a * ca, z])
}

/// Levenberg-Marquardt inside the region: misfit and place.
fn climb(sightings: &[Sighting], region: &Region, start: [f64; 3], steps: usize) -> Option<(f64, [f64; 3])> {
    let moved = |own: &[f64; 3], step: &[f64; 3]| {
        let mut to = *own;
        to.iter_mut().zip(step).for_each(|(x, s)| *x += s);
        region.clamp(&to)
    };
    let evaluate = |own: &[f64; 3]| Some(normal(sightings, region, own));
    let end = minimise(start, &[true; 3], steps, LEAST_FALL, moved, evaluate)?;
    Some((end.normal.cost(), end.at))
}

/// Normal equations by the region's own coordinates. Known coordinates are held, and so is one at its limit that wants
/// to leave.
fn normal(sightings: &[Sighting], region: &Region, own: &[f64; 3]) -> Normal<3> {
    let position = region.position(own);
    let derivatives = region.derivatives(own);
    let mut normal = Normal::default();
    for s in sightings {
        let (azimuth, elevation) = model::bearing(&s.array_m, &position);
        let (ga, gb) = model::gradients(&s.array_m, &position);
        let weight = 1.0 / (s.sd_azimuth * s.sd_azimuth);
        normal.observe(&model::chain(&ga, &derivatives), wrap_pi(s.azimuth - azimuth), weight);
        if let Some(measured) = s.elevation {
            let weight = 1.0 / (s.sd_elevation * s.sd_elevation);
            normal.observe(&model::chain(&gb, &derivatives), measured - elevation, weight);
        }
    }
    let (least, greatest) = region.limits();
    let downhill = normal.gradient;
    let limits = least.iter().zip(&greatest).zip(region.free());
    for (i, ((x, g), ((low, high), free))) in own.iter().zip(&downhill).zip(limits).enumerate() {
        if !free || (*x <= *low && *g < 0.0) || (*x >= *high && *g > 0.0) {
            normal.hold(i);
        }
    }
    normal
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::angle::RAD_PER_DEG;

    fn seen_from(arrays: &[[f64; 3]], source: [f64; 3], errors: &[(f64, f64)]) -> std::vec::Vec<Sighting> {
        arrays
            .iter()
            .zip(errors)
            .map(|(array_m, (ea, eb))| {
                let (a, b) = model::bearing(array_m, &source);
                Sighting {
                    array_m: *array_m,
                    azimuth: a + ea,
                    elevation: Some(b + eb),
                    sd_azimuth: 1.5 * RAD_PER_DEG,
                    sd_elevation: 1.6 * RAD_PER_DEG,
                }
            })
            .collect()
    }

    const THREE: [[f64; 3]; 3] = [[0.0, 100.0, -168.0], [86.6, -50.0, -168.0], [-86.6, -50.0, -168.0]];

    #[test]
    fn exact_bearings_give_the_exact_position_in_every_form() {
        for source in [[300.0, -400.0, -5.0], [3.0, 0.0, -5.0], [-20.0, 95.0, -30.0], [-700.0, 150.0, -100.0]]
        {
            let s = seen_from(&THREE, source, &[(0.0, 0.0); 3]);
            for region in [
                Region::between([0.0, 0.0], 2000.0, (-168.0, 0.0)),
                Region::at_depth([0.0, 0.0], 2000.0, source[2]),
                Region::Polar { elevation: (-1.57, 0.5), range_m: (1.0, 2000.0) },
            ] {
                let found = maximum(&s, &region).unwrap();
                for (a, b) in found.position_m.iter().zip(&source) {
                    assert!((a - b).abs() < 1e-3, "{source:?} {region:?} {found:?}");
                }
            }
        }
    }

    /// A source and the errors of azimuth and elevation at three arrays.
    type Case = ([f64; 3], [(f64, f64); 3]);

    /// The paper's own search, here every 10 m over ±2000 m: nothing on that grid is likelier than what we return.
    #[test]
    fn no_point_of_the_exhaustive_grid_is_likelier() {
        let cases: [Case; 4] = [
            ([150.0, 20.0, -5.0], [(0.05, -0.03), (-0.02, 0.04), (0.01, 0.02)]),
            ([-80.0, 997.0, -5.0], [(0.03, -0.05), (-0.03, -0.04), (0.02, -0.03)]),
            ([0.0, 60.0, -5.0], [(0.3, 0.2), (-0.4, -0.2), (0.1, 0.1)]),
            ([600.0, -600.0, -5.0], [(1.0, 0.0), (0.0, 0.3), (-0.7, 0.1)]),
        ];
        for (source, errors) in cases {
            let s = seen_from(&THREE, source, &errors);
            let found = maximum(&s, &Region::at_depth([0.0, 0.0], 2000.0, -5.0)).unwrap();
            let mut best = f64::INFINITY;
            for i in -200..=200 {
                for j in -200..=200 {
                    best = best.min(cost(&s, &[f64::from(i) * 10.0, f64::from(j) * 10.0, -5.0]));
                }
            }
            assert!(0.5 * found.misfit <= best + 1e-9, "{source:?}: {found:?} against {best}");
        }
    }

    #[test]
    fn the_result_stays_inside_the_region() {
        let s = seen_from(&THREE, [3000.0, 0.0, -5.0], &[(0.0, 0.0); 3]);
        let found = maximum(&s, &Region::at_depth([0.0, 0.0], 1000.0, -5.0)).unwrap();
        assert!(found.position_m[0] <= 1000.0 && found.at_edge[0]);
    }
}
