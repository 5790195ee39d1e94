//! Reflection of sound at an elastic sea floor (fluid over a solid half-space): coefficient and phase (Brekhovskikh and Lysanov).
//!
//! `R = (Zp cos²2θs + Zs sin²2θs − Zw) / (Zp cos²2θs + Zs sin²2θs + Zw)`, `Z = ρ c / cos θ` of water, compressional and
//! shear wave, Snell's law between the angles; beyond a critical angle the cosine is `+i √(sin² − 1)`, which in
//! `exp(−iωt)` is the wave that decays with depth. [O section III C] takes 2000 and 500 m/s.

use super::Complex;
use serde::{Deserialize, Serialize};

/// Density of sea water assumed, kg/m³; the RR03 table was made with this figure.
const WATER_DENSITY_KG_M3: f64 = 1000.0;

/// An elastic half-space under the water.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bottom {
    /// Speed of compressional waves, m/s.
    pub compressional_m_s: f64,
    /// Speed of shear waves, m/s; 0 for a fluid floor.
    pub shear_m_s: f64,
    /// Density, kg/m³.
    pub density_kg_m3: f64,
}

impl Default for Bottom {
    /// The floor of \[O\]; the density is the one that gives the RR03 table's 0.447 at normal incidence.
    fn default() -> Self {
        Self { compressional_m_s: 2000.0, shear_m_s: 500.0, density_kg_m3: 2000.0 }
    }
}

impl Bottom {
    /// Pressure reflection coefficient for a ray parameter (sin θ / c, s/m) where the water's speed at the floor is
    /// `water_m_s`; convention `exp(−iωt)`. Beyond grazing (no such ray) it is −1.
    pub fn reflection(&self, ray_parameter_s_m: f64, water_m_s: f64) -> Complex<f64> {
        let one = Complex::new(1.0, 0.0);
        let cos = |c: f64| Complex::new(1.0 - (ray_parameter_s_m * c).powi(2), 0.0).sqrt();
        let water_cos = cos(water_m_s);
        if water_cos.im != 0.0 || water_cos.re < 1e-9 {
            return -one;
        }
        let zw = Complex::from(WATER_DENSITY_KG_M3 * water_m_s) / water_cos;
        let zp = Complex::from(self.density_kg_m3 * self.compressional_m_s) / cos(self.compressional_m_s);
        let solid = if self.shear_m_s > 0.0 {
            let sin2 = (ray_parameter_s_m * self.shear_m_s).powi(2);
            let zs = Complex::from(self.density_kg_m3 * self.shear_m_s) / cos(self.shear_m_s);
            let (c2, s2) = ((1.0 - 2.0 * sin2).powi(2), 4.0 * sin2 * (1.0 - sin2));
            zp * c2 + zs * s2
        } else {
            zp
        };
        if solid.is_finite() { (solid - zw) / (solid + zw) } else { one }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const C: f64 = 1528.0;

    #[test]
    fn normal_incidence_is_the_impedance_contrast() {
        let r = Bottom::default().reflection(0.0, C);
        let (z2, z1) = (2000.0 * 2000.0, 1000.0 * C);
        assert!((r - Complex::new((z2 - z1) / (z2 + z1), 0.0)).norm() < 1e-12);
    }

    #[test]
    fn a_fluid_floor_reflects_all_beyond_the_critical_angle() {
        let b = Bottom { shear_m_s: 0.0, ..Bottom::default() };
        for p in [1.0 / 1999.0, 1.0 / 1800.0, 1.0 / 1600.0] {
            let r = b.reflection(p, C);
            assert!((r.norm() - 1.0).abs() < 1e-12 || p < 1.0 / 2000.0, "{r}");
            assert!(r.im < 0.0, "in exp(-iwt) total reflection has a negative phase: {r}");
        }
    }

    #[test]
    fn shear_waves_carry_energy_away() {
        let r = Bottom::default().reflection(1.0 / 1700.0, C);
        assert!(r.norm() < 0.97 && r.norm() > 0.85, "{r}");
    }

    #[test]
    fn passive_at_every_angle() {
        for i in 0..1000 {
            let r = Bottom::default().reflection(f64::from(i) / 1000.0 / C, C);
            assert!(r.norm() <= 1.0 + 1e-9 && r.is_finite(), "{i} {r}");
        }
    }
}
