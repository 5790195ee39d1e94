//! Where vessels are whose tracks know their distance.
//!
//! In: azimuth and distance of each, and how well that is known. Out: the curvature of the wavefront from a direction: that of the vessel there, or of
//! the reference range where no track is near, for one vessel's distance says nothing of another's.

use super::wavefront::Direction;
use crate::angle::wrap_pi_f32;
use crate::math::f32 as m;

/// Vessels at once.
const PLACES: usize = 8;
/// A source farther than this from where a vessel was last heard is not taken for it, radians (10°): at 100 m a fast one
/// moves so far in a second.
const NEAR_RAD: f32 = 0.175;
/// Relative standard deviation of a curvature of which nothing is known.
const UNKNOWN: f32 = 0.6;
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

    /// Curvature of the wavefront from a direction and its standard deviation, 1/m; where no vessel is known there, that of
    /// the `reference`, which may be anything from half as far as infinitely far.
    pub(super) fn curvature(&self, direction: &Direction, reference: f32) -> (f32, f32) {
        let azimuth = m::atan2(direction[0], direction[1]);
        let (mut nearest, mut found) = (NEAR_RAD, (reference, UNKNOWN * reference));
        for (at, curvature, sd) in self.known.iter().take(self.len) {
            let apart = m::abs(wrap_pi_f32(azimuth - at));
            if apart < nearest {
                (nearest, found) = (apart, (*curvature, *sd));
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_source_has_the_distance_of_the_vessel_in_its_direction_and_no_other() {
        let places = Places::of(
            [(0.1, 170.0, 9.0), (3.0, 900.0, 9.0), (1.0, f32::NAN, 9.0), (1.5, 2.0, 9.0)].into_iter(),
        );
        let towards = |azimuth: f32| [0.8 * m::sin(azimuth), 0.8 * m::cos(azimuth), 0.6];
        let range = |azimuth: f32| 1.0 / places.curvature(&towards(azimuth), 1.0 / 500.0).0;
        for (azimuth, range_m) in [(0.12, 170.0), (-0.05, 170.0), (2.95, 900.0), (1.5, 500.0), (1.0, 500.0)] {
            assert!((range(azimuth) - range_m).abs() < 0.1, "{azimuth}");
        }
    }
}
