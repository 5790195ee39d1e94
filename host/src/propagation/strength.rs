//! Strength of an interference against range: the skew-normal law [O D1] with Table II's parameters.

use seabearing_core::math::f64::erfc;
use serde::{Deserialize, Serialize};

/// `a(r) = k · pdf((r − location) / scale; shape) / scale`, ranges in metres; the pulse's height in the cepstrum.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkewNormal {
    /// Amplitude factor k, m.
    pub k_m: f64,
    /// Shape α: 0 symmetric, positive leans towards far ranges.
    pub shape: f64,
    /// Location ξ, m.
    pub location_m: f64,
    /// Scale ω, m.
    pub scale_m: f64,
}

/// Table II of \[O\] for branches 13, 35 and 57; the fourth, 79, is extended from them: its second path begins to be
/// totally reflected near 9/7 of the range at which branch 57's does, so location and height follow the row
/// (heights 0.083, 0.059, 0.035: ratios 0.71, 0.59, taken on as 0.55).
pub const RR03: [SkewNormal; 4] = [
    SkewNormal { k_m: 890.0, shape: 4.0, location_m: 8_000.0, scale_m: 7_500.0 },
    SkewNormal { k_m: 1600.0, shape: 6.0, location_m: 14_000.0, scale_m: 20_000.0 },
    SkewNormal { k_m: 1000.0, shape: 4.0, location_m: 27_000.0, scale_m: 20_000.0 },
    SkewNormal { k_m: 550.0, shape: 4.0, location_m: 36_000.0, scale_m: 20_000.0 },
];

/// Water depth at RR03, m.
pub const RR03_DEPTH_M: f64 = 4340.0;

/// Strengths of a floor `depth_m` deep before any is measured: those of RR03 with ranges in proportion to depth. Angles of the paths, and with
/// them the ratios of their amplitudes and the onset of total reflection, are functions of range over depth (exactly so in water of one
/// speed); levels against noise, spreading and absorption are taken as they are at RR03.
pub fn of_depth(depth_m: f64) -> [SkewNormal; 4] {
    let ratio = depth_m / RR03_DEPTH_M;
    RR03.map(|s| SkewNormal {
        k_m: s.k_m * ratio,
        shape: s.shape,
        location_m: s.location_m * ratio,
        scale_m: s.scale_m * ratio,
    })
}

impl SkewNormal {
    /// The strength at a range.
    pub fn at(&self, range_m: f64) -> f64 {
        let z = (range_m - self.location_m) / self.scale_m;
        let normal = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
        let cumulative = 0.5 * erfc(-self.shape * z / std::f64::consts::SQRT_2);
        2.0 * self.k_m / self.scale_m * normal * cumulative
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn peaks_of_the_paper() {
        // Curves of the station's table: 0.083 at 11.1 km, 0.059 at 20.7 km, 0.035 at 35.4 km.
        for (law, peak, at) in
            [(RR03[0], 0.083, 11_100.0), (RR03[1], 0.059, 20_700.0), (RR03[2], 0.035, 35_400.0)]
        {
            let (r, a) = (0..1000)
                .map(|i| 100.0 * f64::from(i))
                .map(|r| (r, law.at(r)))
                .fold((0.0, 0.0), |best, x| if x.1 > best.1 { x } else { best });
            assert!((a - peak).abs() < 0.0006, "{a}");
            assert!((r - at).abs() < 150.0, "{r}");
        }
    }

    #[test]
    fn half_as_deep_the_same_heights_lie_half_as_far() {
        assert_eq!(of_depth(RR03_DEPTH_M), RR03);
        for (a, b) in RR03.iter().zip(of_depth(0.5 * RR03_DEPTH_M)) {
            for r in [5_000.0, 12_000.0, 30_000.0] {
                assert!((a.at(r) - b.at(0.5 * r)).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn without_skew_it_is_a_normal_density() {
        let law = SkewNormal { k_m: 1000.0, shape: 0.0, location_m: 5000.0, scale_m: 1000.0 };
        assert!((law.at(5000.0) - 1.0 / std::f64::consts::TAU.sqrt()).abs() < 1e-12);
        assert!((law.at(4000.0) - law.at(6000.0)).abs() < 1e-15);
    }
}
