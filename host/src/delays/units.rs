//! Whether delays are in seconds.
//!
//! In: the array, the sets of a file. Out: one line where most sets hold a delay many times what sound takes across the array: no error of
//! measurement is as large in most of them, another unit is.

use anyhow::{Result, bail};
use seabearing_core::geometry::{Geometry, PAIRS};
use seabearing_core::kit::median;

/// Times across the array that no delay in seconds has: milliseconds are a thousand times too large.
const MOST: f64 = 30.0;

/// Refuses delays in another unit.
///
/// # Errors
/// The line.
pub(super) fn check(geometry: &Geometry, rows: &[[f64; 7]]) -> Result<()> {
    let h = geometry.position_m.map(|h| h.map(f64::from));
    let apart_m = |(i, j): (usize, usize)| (0..3).map(|k| (h[i][k] - h[j][k]).powi(2)).sum::<f64>().sqrt();
    let across_s = PAIRS.map(apart_m).into_iter().fold(0.0, f64::max) / f64::from(geometry.sound_speed_m_s);
    let largest = |[_, delays @ ..]: &[f64; 7]| {
        delays.iter().filter(|d| d.is_finite()).map(|d| d.abs()).fold(0.0, f64::max)
    };
    let mut all: Vec<f64> = rows.iter().map(largest).collect();
    let usual = median(&mut all).unwrap_or(0.0);
    if usual > MOST * across_s {
        bail!(
            "delays are {usual:.3} in most sets, and sound crosses the array in {across_s:.5} s: seconds are needed; are they milliseconds, \
             microseconds or samples?"
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_unit_is_named_and_seconds_are_not() {
        let h = [[0.0, 1.07, -0.38], [0.93, -0.53, -0.38], [-0.93, -0.53, -0.38], [0.0, 0.0, 1.14]];
        let geometry = Geometry::new(&h, 0.0, 1484.0).unwrap();
        let rows = |unit: f64| -> Vec<[f64; 7]> {
            (0..20)
                .map(|k| [f64::from(k), 4e-4, -3e-4, 7e-4, f64::NAN, 2e-4, 9e-4].map(|d| d * unit))
                .collect()
        };
        assert!(check(&geometry, &rows(1.0)).is_ok() && check(&geometry, &[]).is_ok());
        for unit in [1e3, 1e6, 64_000.0] {
            let said = format!("{:#}", check(&geometry, &rows(unit)).unwrap_err());
            assert!(said.contains("seconds are needed") && said.lines().count() == 1, "{said}");
        }
        // A few wrong peaks are not.
        let mut few = rows(1.0);
        few[3][2] = 40.0;
        assert!(check(&geometry, &few).is_ok());
    }
}
