//! Covariance of the sensors: recursive in time, averaged forward-backward and over subarrays.
//!
//! `R ← μ R + (1 − μ) · mean(x xᴴ)`, μ the share of the past (paper L: 0.4). The smoothed matrix of subarray length
//! `m = M − K + 1` is `S = 1/(2K) Σ_k (R_k + J R_k* J)` over the K subarrays (paper L: K = 5): sources that are coherent
//! through multipath become separable, and every snapshot counts about twice.

use super::MAX_SENSORS;
use super::complex::Complex;
use super::hermitian::HermitianMatrix;

/// Mixes the mean outer product of new snapshots into a covariance; `share` is μ (zero: nothing of the past).
/// Snapshots with a value that is not finite are left out; how many were used is returned.
pub fn update(
    covariance: &mut HermitianMatrix,
    sensors: usize,
    share: f64,
    snapshots: &[[Complex; MAX_SENSORS]],
) -> usize {
    let good =
        |x: &&[Complex; MAX_SENSORS]| x.iter().take(sensors).all(|v| v.re.is_finite() && v.im.is_finite());
    let n = snapshots.iter().filter(good).count();
    if n == 0 {
        return 0;
    }
    for row in covariance.iter_mut() {
        for x in row.iter_mut() {
            *x = x.scale(share);
        }
    }
    let weight = (1.0 - share) / n as f64;
    for snapshot in snapshots.iter().filter(good) {
        for (row, a) in covariance.iter_mut().zip(snapshot).take(sensors) {
            for (x, b) in row.iter_mut().zip(snapshot).take(sensors) {
                *x += (*a * b.conj()).scale(weight);
            }
        }
    }
    n
}

/// Forward-backward, spatially smoothed covariance over `subarrays` overlapping subarrays; returns their length m.
pub fn smooth(
    covariance: &HermitianMatrix,
    sensors: usize,
    subarrays: usize,
    out: &mut HermitianMatrix,
) -> usize {
    let sensors = sensors.min(MAX_SENSORS);
    let length = (sensors + 1).saturating_sub(subarrays.max(1));
    let weight = 0.5 / subarrays.max(1) as f64;
    for (i, row) in out.iter_mut().enumerate().take(length) {
        for (j, x) in row.iter_mut().enumerate().take(length) {
            let mut sum = Complex::ZERO;
            for k in 0..subarrays {
                let forward = at(covariance, k + i, k + j);
                // J R* J: the matrix read from its far corner, conjugated.
                let backward = at(covariance, k + length - 1 - i, k + length - 1 - j).conj();
                sum += forward + backward;
            }
            *x = sum.scale(weight);
        }
    }
    length
}

fn at(a: &HermitianMatrix, i: usize, j: usize) -> Complex {
    a.get(i).and_then(|row| row.get(j)).copied().unwrap_or(Complex::ZERO)
}

#[cfg(test)]
mod tests {
    use super::super::complex::unit;
    use super::*;

    #[test]
    fn smoothing_keeps_a_plane_wave_and_its_power() {
        let sensors = 23;
        let mut x = [Complex::ZERO; MAX_SENSORS];
        for (k, v) in x.iter_mut().enumerate().take(sensors) {
            *v = unit(0.7 * k as f64 + 0.2).scale(2.0);
        }
        let mut r = [[Complex::ZERO; MAX_SENSORS]; MAX_SENSORS];
        assert_eq!(update(&mut r, sensors, 0.0, &[x]), 1);
        let mut s = r;
        assert_eq!(smooth(&r, sensors, 5, &mut s), 19);
        for i in 0..19 {
            for j in 0..19 {
                let expected = unit(0.7 * (i as f64 - j as f64)).scale(4.0);
                assert!((s[i][j] - expected).norm() < 1e-12);
            }
        }
        x[3].re = f64::NAN;
        assert_eq!(update(&mut r, sensors, 0.4, &[x]), 0);
    }
}
