//! Where vessels are whose tracks know their distance.
//!
//! In: azimuth and distance of each, and how well that is known. Out: the curvature of the wavefront from a direction: that of the vessel there, or of
//! where the direction meets the surface where no track is near, for one vessel's distance says nothing of another's.

use super::plan::Plan;
use super::wavefront::Direction;
use crate::angle::wrap_pi_f32;
use crate::math::f32 as m;

/// Vessels at once.
const PLACES: usize = 8;
/// A source farther than this from where a vessel was last heard is not taken for it, radians (10°): at 100 m a fast one
/// moves so far in a second.
const NEAR_RAD: f32 = 0.175;
/// Nearer than this no distance is believed, metres.
const LEAST_M: f32 = 5.0;

/// The places, in no order.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Places {
    /// Azimuth, radians, curvature and its standard deviation, 1/m.
    known: [(f32, f32, f32); PLACES],
    len: usize,
}

impl Places {
    /// None known.
    pub(crate) const fn new() -> Self {
        Self { known: [(0.0, 0.0, 0.0); PLACES], len: 0 }
    }

    /// These, by azimuth (radians), distance along the sound's way and its standard deviation (metres).
    pub(crate) fn of(places: impl Iterator<Item = (f32, f32, f32)>) -> Self {
        let mut all = Self::new();
        let usable = places.filter(|(a, r, sd)| (a + r + sd).is_finite() && *r >= LEAST_M);
        for (slot, (azimuth, range_m, sd_m)) in all.known.iter_mut().zip(usable) {
            *slot = (azimuth, 1.0 / range_m, sd_m / (range_m * range_m));
            all.len += 1;
        }
        all
    }

    /// Curvature of the wavefront from a direction and its standard deviation, 1/m: of a vessel known there, where its distance is known better than by
    /// the direction alone ([`Plan::curvature_from`]). What a surface tells otherwise is in the deviation: a track of a slow vessel takes the usual speed for its
    /// own until it has been heard for minutes, and its distance for a greater one.
    pub(super) fn curvature(&self, direction: &Direction, plan: &Plan) -> (f32, f32) {
        let azimuth = m::atan2(direction[0], direction[1]);
        let unseen = plan.curvature_from(direction);
        let (mut nearest, mut found) = (NEAR_RAD, unseen);
        for (at, curvature, sd) in self.known.iter().take(self.len) {
            let apart = m::abs(wrap_pi_f32(azimuth - at));
            if apart < nearest && *sd < unseen.1 {
                let otherwise = if plan.vessel_over_array_depth > 0.0 { curvature - unseen.0 } else { 0.0 };
                (nearest, found) = (apart, (*curvature, m::hypot(*sd, otherwise)));
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_sea::planned;
    use super::*;

    fn towards(azimuth: f32) -> Direction {
        [0.8 * m::sin(azimuth), 0.8 * m::cos(azimuth), 0.6]
    }

    #[test]
    fn every_source_has_the_distance_of_the_vessel_in_its_direction_and_no_other() {
        let plan = planned(16_000.0, |array| array.vessel_depth_m = 0.0);
        let places = Places::of(
            [(0.1, 170.0, 9.0), (3.0, 900.0, 9.0), (1.0, f32::NAN, 9.0), (1.5, 2.0, 9.0)].into_iter(),
        );
        let range = |azimuth: f32| 1.0 / places.curvature(&towards(azimuth), &plan).0;
        for (azimuth, range_m) in [(0.12, 170.0), (-0.05, 170.0), (2.95, 900.0), (1.5, 500.0), (1.0, 500.0)] {
            assert!((range(azimuth) - range_m).abs() < 0.1, "{azimuth}");
        }
    }

    #[test]
    fn under_a_surface_a_direction_tells_the_distance_unless_a_track_knows_it_better() {
        let plan = planned(16_000.0, |array| array.vessel_depth_m = 4.0);
        let far_m = plan.depth_m / 0.6;
        let places = Places::of([(0.1, 170.0, 1.0), (3.0, 170.0, 90.0)].into_iter());
        for (azimuth, range_m) in [(0.1, 170.0), (3.0, far_m), (2.0, far_m)] {
            let (curvature, sd) = places.curvature(&towards(azimuth), &plan);
            assert!((1.0 / curvature - range_m).abs() < 0.1, "{azimuth}");
            assert!(sd < 0.05 * curvature || azimuth == 0.1, "{azimuth}");
        }
        // A track that is sure of another distance than the surface's.
        let (near, sd) = places.curvature(&towards(0.1), &plan);
        assert!((sd - (near - 1.0 / far_m)).abs() < 0.1 * sd, "{sd}");
        let [east, north, up] = towards(2.0);
        let from_below = 1.0 / places.curvature(&[east, north, -up], &plan).0;
        assert!((from_below - 500.0).abs() < 0.1, "{from_below}");
    }
}
