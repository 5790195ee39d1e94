//! Strength of an interference against range: the skew-normal law [O D1] with Table II's parameters.

use super::RayPath;
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

/// Range at which a vessel's wideband noise is taken to be as loud as the ambient noise at RR03, m: where the simulator states levels too.
const AS_LOUD_AS_NOISE_M: f64 = 20_000.0;

/// Changes strengths of a floor `depth_m` deep that hold over one floor to those over another: `usual` are the paths over the floor they
/// hold for, `told` the same rays over that of the station, both in rows of `step_m`.
///
/// Two paths of amplitudes a and b make the power go up and down by `2 a b / (N + Σ A²)` of itself, N being the noise, and to
/// first order in it its logarithm too (`ln(1 + x cos φ) ≈ x cos φ`): that share is what the pulse in the cepstrum grows with.
/// Over a harder floor total reflection begins at steeper angles, so that every interference is heard nearer, and the paths between
/// bounce with other losses. The law of each branch keeps its form; its ranges are taken in proportion to the share's mean range, and k,
/// which is its integral over range, to the share's.
pub fn over_another_floor(
    strengths: &mut [SkewNormal],
    depth_m: f64,
    step_m: f64,
    usual: &[RayPath],
    told: &[RayPath],
) {
    let rows = usual.first().map_or(0, |p| p.arrivals.len());
    let loud = (AS_LOUD_AS_NOISE_M * depth_m / RR03_DEPTH_M / step_m) as usize;
    let noise = power(usual, loud.min(rows.saturating_sub(1)));
    for (branch, law) in strengths.iter_mut().enumerate() {
        let ((area, mean), (of_usual, usual_mean)) =
            (share(told, branch, noise), share(usual, branch, noise));
        if of_usual > 0.0 && usual_mean > 0.0 && mean > 0.0 {
            law.k_m *= area / of_usual;
            law.location_m *= mean / usual_mean;
            law.scale_m *= mean / usual_mean;
        }
    }
}

/// Amplitude of a path in a row, where it exists.
fn amplitude(paths: &[RayPath], path: usize, row: usize) -> Option<f64> {
    paths.get(path)?.arrivals.get(row).copied()?.map(|a| a.amplitude.norm())
}

/// Power of all paths in a row.
fn power(paths: &[RayPath], row: usize) -> f64 {
    (0..paths.len()).filter_map(|n| amplitude(paths, n, row)).map(|a| a * a).sum()
}

/// Integral over range, and mean range, of a branch's share `|Aᵢ Aᵢ₊₁| / (N + Σ |A|²)` of the power; in rows.
fn share(paths: &[RayPath], branch: usize, noise: f64) -> (f64, f64) {
    let rows = paths.first().map_or(0, |p| p.arrivals.len());
    let (mut area, mut moment) = (0.0, 0.0);
    for row in 0..rows {
        let all = noise + power(paths, row);
        if let Some((a, b)) = amplitude(paths, branch, row).zip(amplitude(paths, branch + 1, row))
            && all > 0.0
        {
            area += a * b / all;
            moment += row as f64 * a * b / all;
        }
    }
    (area, if area > 0.0 { moment / area } else { 0.0 })
}

impl SkewNormal {
    /// The strength at a range.
    pub fn at(&self, range_m: f64) -> f64 {
        let z = (range_m - self.location_m) / self.scale_m;
        let normal = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
        let cumulative = 0.5 * erfc(-self.shape * z / std::f64::consts::SQRT_2);
        2.0 * self.k_m / self.scale_m * normal * cumulative
    }

    /// Greatest strength at any range.
    pub fn peak(&self) -> f64 {
        let places = (-500..=500).map(|i| self.location_m + 0.01 * f64::from(i) * self.scale_m);
        places.filter(|r| *r >= 0.0).map(|r| self.at(r)).fold(0.0, f64::max)
    }

    /// Whether it can be the height of a pulse in the cepstrum: two paths of like amplitude, and nothing else, make one of 1.
    pub fn is_one(&self) -> bool {
        self.peak() <= 1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_higher_than_a_pulse_can_be_is_no_strength() {
        assert!(RR03.iter().all(SkewNormal::is_one));
        assert!((RR03[0].peak() - 0.083).abs() < 1e-3);
        let far = SkewNormal { k_m: 5.8e21, shape: 0.0, location_m: 90_000.0, scale_m: 4_000.0 };
        assert!(!far.is_one() && far.at(20_000.0) < 1e-30 * far.peak(), "{}", far.at(20_000.0));
    }

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
    fn over_a_harder_floor_interferences_are_heard_nearer() {
        use super::super::{bottom::Bottom, profile::SpeedProfile, trace};
        let profile =
            SpeedProfile::new(vec![(0.0, 1540.0), (1000.0, 1486.0), (4340.0, 1528.0)], 4340.0).unwrap();
        let over = |bottom: &Bottom| trace::trace("t", &profile, bottom, 500.0, 150, || ()).strengths;
        assert_eq!(over(&Bottom::default()), RR03);
        // A floor that differs by nothing worth mention has all but the same.
        let all_but = over(&Bottom { compressional_m_s: 2000.5, ..Bottom::default() });
        for (a, b) in RR03.iter().zip(&all_but) {
            assert!((a.k_m / b.k_m - 1.0).abs() < 0.01 && (a.location_m / b.location_m - 1.0).abs() < 0.01);
        }
        let harder = over(&Bottom { compressional_m_s: 2500.0, shear_m_s: 900.0, ..Bottom::default() });
        let peak = |law: &SkewNormal| {
            let at = (0..500).map(|i| 100.0 * f64::from(i));
            at.fold((0.0, 0.0), |best, r| if law.at(r) > best.1 { (r, law.at(r)) } else { best })
        };
        // Measured with `propagation fit` on vessels simulated over that floor: 7.0, 14.5, 22.5 and 29.5 km.
        for (law, measured_m) in harder.iter().zip([7_000.0, 14_500.0, 22_500.0, 29_500.0]) {
            let (at_m, height) = peak(law);
            assert!((at_m / measured_m - 1.0).abs() < 0.25, "{at_m} {measured_m}");
            assert!((0.01..0.12).contains(&height), "{height}");
        }
    }

    #[test]
    fn without_skew_it_is_a_normal_density() {
        let law = SkewNormal { k_m: 1000.0, shape: 0.0, location_m: 5000.0, scale_m: 1000.0 };
        assert!((law.at(5000.0) - 1.0 / std::f64::consts::TAU.sqrt()).abs() < 1e-12);
        assert!((law.at(4000.0) - law.at(6000.0)).abs() < 1e-15);
    }
}
