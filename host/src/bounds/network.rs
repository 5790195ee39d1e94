//! What several arrays can tell at best of a source at a place [N 11-18], and of a straight passage through it.
//!
//! Nothing here is of its own: positions are bounded by [`seabearing_locate::network::bound`], passages by the information of
//! [`seabearing_locate::network::joint`], both as the experiments do. The error of an array's orientation is in each azimuth of a
//! position, and an unknown of a passage. That of its clock puts the vessel elsewhere on its way: where the list
//! says how large it is, it is in each bearing of a position, the vessel's heading being anything; in a passage it is an unknown.

use crate::orientation::network_file::Network;
use seabearing_core::kit::{median, spd};
use seabearing_locate::network::joint::{DatedSighting, JointSettings, Scatter, bound};
use seabearing_locate::network::locate::LARGEST_RELATIVE_SD;
use seabearing_locate::network::model::{bearing, gradients};
use seabearing_locate::network::{MAX_ARRAYS, Sighting, bound::about, known_depth_bound, rectangular_bound};

/// Directions of ways through a place whose median is stated.
pub const HEADINGS: usize = 8;

/// What is assumed of the bearings.
#[derive(Clone, Copy, Debug)]
pub struct Bearings {
    /// Standard deviation of azimuths, radians.
    pub sd_azimuth: f64,
    /// Standard deviation of elevations, radians.
    pub sd_elevation: f64,
    /// Depth of the source, metres.
    pub depth_m: f64,
}

/// What is assumed of a passage.
#[derive(Clone, Copy, Debug)]
pub struct Passage {
    /// Speed, m/s.
    pub speed_m_s: f64,
    /// How long it is heard, seconds, its middle at the place.
    pub duration_s: f64,
    /// Time between bearings of which the errors are independent, seconds.
    pub every_s: f64,
}

/// Standard deviations at one place; `None` where `locate` gives no number because it would be no better than half the
/// distance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Expected {
    /// Horizontal position, `√(σ_x² + σ_y²)` [N 18], the depth known, metres.
    pub position_m: Option<f64>,
    /// The same without a known depth.
    pub free_m: Option<f64>,
    /// The same, the depth known, from azimuths alone.
    pub azimuths_m: Option<f64>,
    /// Azimuth (radians) and horizontal range (metres) about the network's centre, the depth known.
    pub polar: Option<(f64, f64)>,
}

/// Standard deviations of a passage: median over its headings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpectedPassage {
    /// Horizontal position in its middle, metres.
    pub position_m: f64,
    /// Heading, radians.
    pub heading: f64,
    /// Speed, m/s.
    pub speed_m_s: f64,
}

/// Middle of the arrays, East and North, metres.
pub fn centre(network: &Network) -> [f64; 2] {
    let n = network.arrays_m.len() as f64;
    [0, 1].map(|k| network.arrays_m.iter().map(|a| a[k]).sum::<f64>() / n)
}

/// What is to be expected of a source at a place, of a vessel of this speed.
pub fn at(network: &Network, of: &Bearings, speed_m_s: f64, [x, y]: [f64; 2]) -> Expected {
    let source_m = [x, y, -of.depth_m];
    let clocks = network.said(&[]);
    let sightings: Vec<Sighting> = network
        .arrays_m
        .iter()
        .enumerate()
        .map(|(k, array_m)| {
            // Of a way of any heading half the variance is along a gradient.
            let away_m = clocks[k].clock_s * speed_m_s / std::f64::consts::SQRT_2;
            let (a, e) = gradients(array_m, &source_m);
            let seen = sighting(array_m, &source_m, of, of.sd_azimuth.hypot(network.sd_orientation[k]));
            Sighting {
                sd_azimuth: seen.sd_azimuth.hypot(away_m * a[0].hypot(a[1])),
                sd_elevation: seen.sd_elevation.hypot(away_m * e[0].hypot(e[1])),
                ..seen
            }
        })
        .collect();
    let alone: Vec<Sighting> = sightings.iter().map(|s| Sighting { elevation: None, ..*s }).collect();
    let away = |a: &[f64; 3]| source_m.iter().zip(a).map(|(s, a)| (s - a).powi(2)).sum::<f64>().sqrt();
    let mut distances: Vec<f64> = network.arrays_m.iter().map(away).collect();
    let most_m = LARGEST_RELATIVE_SD * median(&mut distances).unwrap_or(0.0);
    let told = |c: &spd::Square<2>| spd::largest_eigenvalue(c).sqrt() <= most_m;
    let known = known_depth_bound(&sightings, &source_m).ok().flatten().filter(told);
    let azimuths = known_depth_bound(&alone, &source_m).ok().flatten().filter(told);
    let free = rectangular_bound(&sightings, &source_m).ok().and_then(|b| b.free_m);
    let horizontal = |c: spd::Square<2>| (c[0][0] + c[1][1]).sqrt();
    Expected {
        position_m: known.map(horizontal),
        free_m: free.filter(|sd| sd.iter().all(|sd| *sd <= most_m)).map(|[x, y, _]| x.hypot(y)),
        azimuths_m: azimuths.map(horizontal),
        polar: known.map(|c| about(centre(network), &source_m, &c)).filter(|p| p.0.is_finite()),
    }
}

/// What is to be expected of a straight passage whose middle is at a place; `None` where no heading is told.
pub fn passage(
    network: &Network,
    of: &Bearings,
    pass: &Passage,
    elevations: bool,
    [x, y]: [f64; 2],
) -> Option<ExpectedPassage> {
    let mut sd: [Vec<f64>; 3] = Default::default();
    for k in 0..HEADINGS {
        let (s, c) = (std::f64::consts::TAU * k as f64 / HEADINGS as f64).sin_cos();
        let state = [x, y, pass.speed_m_s * s, pass.speed_m_s * c];
        let found = of_state(network, of, pass, elevations, &state);
        // What is not told is worse than anything that is.
        let found = found.unwrap_or([f64::INFINITY; 3]);
        sd.iter_mut().zip(found).for_each(|(all, sd)| all.push(sd));
    }
    let [position_m, heading, speed_m_s] = sd.map(|mut all| median(&mut all).unwrap_or(f64::INFINITY));
    position_m.is_finite().then_some(ExpectedPassage { position_m, heading, speed_m_s })
}

/// Standard deviations of place (m), heading (radians) and speed (m/s) of one way.
fn of_state(
    network: &Network,
    of: &Bearings,
    pass: &Passage,
    elevations: bool,
    state: &[f64; 4],
) -> Option<[f64; 3]> {
    let [x, y, vx, vy] = *state;
    let count = (pass.duration_s / pass.every_s).floor() as i32;
    let (mut heard, mut distances_m) = (Vec::new(), 0.0);
    for k in 0..=count {
        let t_s = (f64::from(k) - 0.5 * f64::from(count)) * pass.every_s;
        let source_m = [x + vx * t_s, y + vy * t_s, -of.depth_m];
        for (array, array_m) in network.arrays_m.iter().enumerate() {
            distances_m += source_m.iter().zip(array_m).map(|(s, a)| (s - a).powi(2)).sum::<f64>().sqrt();
            let seen = sighting(array_m, &source_m, of, of.sd_azimuth);
            let sighting = Sighting { elevation: seen.elevation.filter(|_| elevations), ..seen };
            heard.push(DatedSighting { t_s, array, sighting });
        }
    }
    let settings = JointSettings {
        z_m: -of.depth_m,
        // Travel time moves nothing that a bound tells.
        sound_speed_m_s: f64::INFINITY,
        robust: false,
        scatter: Scatter::Told,
        shared: network.shared(&[]),
        alike: [1.0; MAX_ARRAYS],
    };
    let c = bound(&heard, &settings, 0.0, state)?;
    let speed = vx.hypot(vy);
    let along = [0.0, 0.0, vx / speed, vy / speed];
    let across = [0.0, 0.0, vy / speed, -vx / speed];
    let variance = |u: &[f64; 4]| spd::quadratic(u, &c, u).max(0.0);
    let place = [[c[0][0], c[0][1]], [c[1][0], c[1][1]]];
    // As the fit itself refuses it.
    let told =
        spd::largest_eigenvalue(&place).sqrt() <= LARGEST_RELATIVE_SD * distances_m / heard.len() as f64;
    let position_m = (c[0][0] + c[1][1]).sqrt();
    told.then(|| [position_m, variance(&across).sqrt() / speed, variance(&along).sqrt()])
}

fn sighting(array_m: &[f64; 3], source_m: &[f64; 3], of: &Bearings, sd_azimuth: f64) -> Sighting {
    let (azimuth, elevation) = bearing(array_m, source_m);
    Sighting {
        array_m: *array_m,
        azimuth,
        elevation: Some(elevation),
        sd_azimuth,
        sd_elevation: of.sd_elevation,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_list_says_of_clocks_is_in_positions() {
        let dir = tempfile::tempdir().unwrap();
        let of_clocks = |said: [&str; 2]| {
            let path = dir.path().join("network.toml");
            let station = |id: u8, x: f64| {
                let said = said[usize::from(id) - 1];
                format!(
                    "[[stations]]\nid = {id}\nname = \"s{id}\"\nposition = {{ local_m = [{x:.1}, 0.0, -100.0] }}\n{said}\n"
                )
            };
            std::fs::write(&path, station(1, -400.0) + &station(2, 400.0)).unwrap();
            let network = Network::read(&path).unwrap();
            let of = Bearings { sd_azimuth: 0.0035, sd_elevation: 0.005, depth_m: 5.0 };
            at(&network, &of, 10.0, [100.0, 300.0]).position_m.unwrap()
        };
        let (silent, good) = (of_clocks([""; 2]), of_clocks(["clock_sd_s = 0.001"; 2]));
        let poor = of_clocks(["clock_sd_s = 0.001", "clock_sd_s = 2.0"]);
        let (both, none) = (of_clocks(["clock_sd_s = 2.0"; 2]), of_clocks(["", "clock_sd_s = 1000.0"]));
        assert!((good / silent - 1.0).abs() < 0.01, "{good} {silent}");
        // Two seconds of 10 m/s are 20 m of the second array; with no clock the first array alone is left. Where both are as bad, the time is too.
        assert!(poor > 1.5 * good && poor < good.hypot(20.0) && none > 1.05 * poor, "{good} {poor} {none}");
        assert!(both > 1.05 * poor && both < good.hypot(20.0), "{poor} {both}");
    }
}
