//! Is there a source? The detection statistic, its threshold, and what diffuse noise does to it.
//!
//! Statistic: the sum over bins and pairs of the steered, whitened cross-spectra `Re(ĝ_ij e^{iωτ_ij(u)})`, over its
//! standard deviation under noise alone (each `ĝ` has variance 1/(2K) in its real part for K independent snapshots).
//! For a fixed direction it is standard normal; for the maximum over all directions the probability of exceeding a
//! high level is the expected Euler characteristic of its excursion set (Adler and Taylor, Random Fields and
//! Geometry, 2007): `E χ(z) = A (2π)^{−3/2} z e^{−z²/2} + 2 Q(z)`, with A the area of the sphere in units of the field's
//! own cells, `A = ∫ √det Λ`, `Λ = ⟨ω²⟩ Σ_p ∇τ_p ∇τ_pᵀ / 6`. Nothing here is fitted to data.
//!
//! Diffuse ambient noise is coherent at low frequency and would lift the statistic everywhere. Its expected
//! contribution is subtracted: the larger of an isotropic field's (`γ = sinc kd`) and a surface-generated field's
//! (density `4 sin⁺β`, expanded to second order in spherical harmonics: `γ = j₀ + 2i j₁ μ − (5/4) j₂ P₂(μ)`, with μ the
//! pair's direction cosine with the vertical).

use super::wavefront::{self, PAIR_COUNT, Used};
use crate::geometry::{Geometry, PAIRS};
use crate::math::{f32 as m, f64 as md};

/// The steered response's shape over the sphere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Area of the sphere in the field's cells.
    pub area_in_cells: f64,
    /// Radius of a cell in radians, averaged over directions.
    pub resolution: f64,
}

/// Cells of the steered response for bins `low..high` of spacing `bin_rad_s`.
pub fn shape(geometry: &Geometry, low: usize, high: usize, bin_rad_s: f32) -> Shape {
    let mut mean_square = 0.0f64;
    for k in low..high {
        let w = k as f64 * f64::from(bin_rad_s);
        mean_square += w * w;
    }
    mean_square /= (high.saturating_sub(low)).max(1) as f64;
    // Rings of equal area (equal steps of the sine of elevation).
    let (rings, spokes) = (24, 48);
    let mut area = 0.0f64;
    for ring in 0..rings {
        let z = (2.0 * (ring as f32) + 1.0) / rings as f32 - 1.0;
        let r = m::sqrt(1.0 - z * z);
        for spoke in 0..spokes {
            let (s, c) = m::sin_cos(m::TAU * spoke as f32 / spokes as f32);
            let u = [r * s, r * c, z];
            let e = wavefront::tangents(&u);
            let g1 = wavefront::gradient(geometry, &u, &e.0, 0.0);
            let g2 = wavefront::gradient(geometry, &u, &e.1, 0.0);
            // Σ over pairs of products of differences is exactly Gᵀ(4I − 11ᵀ)G.
            let (a, b, d) = wavefront::information(&g1, &g2);
            let determinant = f64::from(a) * f64::from(d) - f64::from(b) * f64::from(b);
            area += md::sqrt(determinant.max(0.0)) * mean_square / PAIR_COUNT as f64;
        }
    }
    let mean_density = area / f64::from(rings * spokes);
    Shape { area_in_cells: mean_density * 4.0 * md::PI, resolution: 1.0 / md::sqrt(mean_density.max(1e-12)) }
}

/// The level that the maximum over the sphere exceeds with probability `p` under noise alone.
#[inline(never)]
pub fn threshold(p: f64, area_in_cells: f64) -> f64 {
    let exceed = |z: f64| {
        area_in_cells * z * md::exp(-0.5 * z * z) / md::powf(md::TAU, 1.5)
            + md::erfc(z / core::f64::consts::SQRT_2)
    };
    let (mut lo, mut hi) = (1.0, 40.0);
    for _ in 0..60 {
        let mid = 0.5 * (lo + hi);
        if exceed(mid) > p {
            lo = mid;
        } else {
            hi = mid;
        }
    }
    hi
}

/// Mean of `Σ_bins Σ_pairs Re(γ e^{iωτ})` in a fully diffuse field for pair delays `tau` (seconds): the larger of
/// the isotropic and the surface-generated field's, and never below zero. About 30 000 instructions.
pub(crate) fn diffuse_mean(
    geometry: &Geometry,
    crossing_s: &[f32; PAIR_COUNT],
    tau: &[f32; PAIR_COUNT],
    low: usize,
    high: usize,
    bin_rad_s: f32,
    used: Used,
) -> f32 {
    let (mut isotropic, mut surface) = (0.0f32, 0.0f32);
    for (p, (i, j)) in used.of(PAIRS.into_iter().enumerate()) {
        let (Some(hi), Some(hj)) = (geometry.position_m.get(i), geometry.position_m.get(j)) else { continue };
        let (Some(&crossing), Some(&tau)) = (crossing_s.get(p), tau.get(p)) else { continue };
        let mu = (hj[2] - hi[2]) / (crossing * geometry.sound_speed_m_s);
        let p2 = 1.5 * mu * mu - 0.5;
        let from = low as f32 * bin_rad_s;
        let ((mut sx, mut cx), (dsx, dcx)) = (m::sin_cos(from * crossing), m::sin_cos(bin_rad_s * crossing));
        let ((mut st, mut ct), (dst, dct)) = (m::sin_cos(from * tau), m::sin_cos(bin_rad_s * tau));
        for k in low..high {
            let inv = 1.0 / (k as f32 * bin_rad_s * crossing);
            let j0 = sx * inv;
            let j1 = (j0 - cx) * inv;
            let j2 = 3.0 * j1 * inv - j0;
            isotropic += j0 * ct;
            surface += (j0 - 1.25 * p2 * j2) * ct - 2.0 * mu * j1 * st;
            (sx, cx) = (sx * dcx + cx * dsx, cx * dcx - sx * dsx);
            (st, ct) = (st * dct + ct * dst, ct * dct - st * dst);
        }
    }
    isotropic.max(surface).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threshold_falls_with_allowed_rate() {
        let z1 = threshold(1e-4, 5e4);
        let z2 = threshold(1e-6, 5e4);
        assert!(z1 > 5.5 && z2 > z1 && z2 < 8.0, "{z1} {z2}");
        let back = 5e4 * z1 * (-0.5 * z1 * z1).exp() / (2.0 * md::PI).powf(1.5);
        assert!((back / 1e-4 - 1.0).abs() < 0.01);
    }
}
