//! What the positions of many instants tell of an array: errors of its azimuths that last.
//!
//! At one instant an array that is turned by less than its bearings are said to err looks right. Over many, what its azimuths
//! are off those of the positions has a mean, and the bearings' own scatter, with what successive ones have in common, says
//! how well it is known. A mean beyond what is said of the array's orientation and four of its own deviations is no chance:
//! the array or another one is turned, or its clock is wrong.

use super::network_file::Network;
use super::sets::SightingSet;
use seabearing_core::angle::wrap_pi;
use seabearing_locate::network::model::bearing;
use seabearing_locate::network::{Fix, NetworkError};

/// Fewest positions from which a mean is taken.
const LEAST_FIXES: usize = 20;
/// Standard deviations of an orientation, and of the mean, beyond which a mean is no chance.
const BEYOND_SD: f64 = 2.0;
const BEYOND_MEAN_SD: f64 = 4.0;
/// Most that successive errors are taken to have in common.
const MOST_COMMON: f64 = 0.95;

/// What the azimuths of a station are off those of the positions in the mean, and how well that is known, radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lasting {
    /// Mean.
    pub mean: f64,
    /// Its standard deviation.
    pub sd: f64,
}

/// Of each station of a network; `None` where the positions tell nothing, or nothing but chance.
pub fn lasting(
    network: &Network,
    sets: &[SightingSet],
    fixes: &[Result<Fix, NetworkError>],
) -> Vec<Option<Lasting>> {
    let of = |station: usize| {
        let off: Vec<f64> = sets
            .iter()
            .zip(fixes)
            .filter_map(|(set, fix)| {
                let fix = fix.as_ref().ok().filter(|fix| fix.freedom > 0)?;
                let k =
                    set.stations.iter().position(|s| *s == station).filter(|k| fix.rejected != Some(*k))?;
                let seen = &set.sightings[k];
                Some(wrap_pi(seen.azimuth - bearing(&seen.array_m, &fix.position_m).0))
            })
            .collect();
        let found = mean(&off)?;
        let said = BEYOND_SD * network.sd_orientation[station] + BEYOND_MEAN_SD * found.sd;
        (found.mean.abs() > said).then_some(found)
    };
    (0..network.stations.len()).map(of).collect()
}

/// Mean of values in order of time, with the standard deviation that their scatter and what neighbours have in common leave
/// it.
fn mean(values: &[f64]) -> Option<Lasting> {
    let n = values.len() as f64;
    if values.len() < LEAST_FIXES {
        return None;
    }
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|x| (x - mean).powi(2)).sum();
    let products: f64 = values.windows(2).map(|w| (w[0] - mean) * (w[1] - mean)).sum();
    let common = if squares > 0.0 { (products / squares + 1.0 / n).clamp(0.0, MOST_COMMON) } else { 0.0 };
    let variance = squares / (n - 1.0) / n * (1.0 + common) / (1.0 - common);
    Some(Lasting { mean, sd: variance.sqrt() })
}

/// The sets with what lasts joined to the deviations of a station's azimuths.
pub fn widened(sets: &[SightingSet], of: &[Option<Lasting>]) -> Vec<SightingSet> {
    let mut out = sets.to_vec();
    for set in &mut out {
        for (seen, station) in set.sightings.iter_mut().zip(&set.stations) {
            if let Some(lasting) = of[*station] {
                seen.sd_azimuth = seen.sd_azimuth.hypot(lasting.mean);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mean_is_as_well_known_as_its_neighbours_are_independent() {
        let turned: Vec<f64> = (0..400).map(|k| 0.02 + if k % 2 == 0 { 0.01 } else { -0.01 }).collect();
        let found = mean(&turned).unwrap();
        assert!((found.mean - 0.02).abs() < 1e-9 && (found.sd - 0.01 / 20.0).abs() < 1e-4, "{found:?}");
        let slow: Vec<f64> = (0..400).map(|k| 0.01 * (f64::from(k) / 50.0).sin()).collect();
        assert!(mean(&slow).unwrap().sd > 4.0 * found.sd * 0.7);
        assert_eq!(mean(&turned[..19]), None);
    }
}
