//! One set of bearings: what errors of orientations and clocks do to it, and what it tells of them.

use crate::orientation::sets::SightingSet;
use crate::orientation::way::Way;
use seabearing_core::angle::wrap_pi;
use seabearing_core::kit::spd::{self, Square};
use seabearing_core::kit::straight_line::through;
use seabearing_locate::network::model::{Sighting, bearing, gradients};
use seabearing_locate::network::{Fix, MAX_ARRAYS, NetworkError};

/// Unknowns: errors of the arrays' azimuths, then of their clocks, in units of their priors' deviations.
pub(super) const N: usize = 2 * MAX_ARRAYS;
/// Positions either side from which a vessel's velocity is taken at least, how far in time they may be, and within how many seconds all count.
const NEIGHBOURS: usize = 4;
const NEAR_S: f64 = 60.0;
const ALL_S: f64 = 10.0;

/// Sums over angles, positions eliminated.
pub(super) struct Sums {
    pub(super) information: Square<N>,
    pub(super) pull: [f64; N],
    pub(super) misfit: f64,
    pub(super) freedom: f64,
    /// What an error of each unknown does to the position.
    pub(super) moves: [[f64; N]; 3],
}

/// From where something was seen, metres.
pub(super) fn distance_m(seen: &Sighting, position_m: &[f64; 3]) -> f64 {
    let off = |k: usize| (position_m[k] - seen.array_m[k]).powi(2);
    (off(0) + off(1) + off(2)).sqrt()
}

/// Rates of azimuth and elevation of a vessel at a place, radians a second.
fn rates(seen: &Sighting, position_m: &[f64; 3], v: &[f64; 2]) -> (f64, f64) {
    let (a, b) = gradients(&seen.array_m, position_m);
    (a[0] * v[0] + a[1] * v[1], b[0] * v[0] + b[1] * v[1])
}

/// A set's sums, positions eliminated; `None` where they are none.
pub(super) fn sums(set: &SightingSet, fix: &Fix, v: &Velocity, prior: &[f64; N]) -> Option<Sums> {
    let known = fix.covariance_m2[2][2] == 0.0;
    let mut normal = [[0.0; 3]; 3];
    if known {
        normal[2][2] = 1.0;
    }
    let mut by = [[0.0; N]; 3];
    let mut out = Sums {
        information: [[0.0; N]; N],
        pull: [0.0; N],
        misfit: 0.0,
        freedom: f64::from(fix.freedom),
        moves: [[0.0; N]; 3],
    };
    let mut toward = [0.0; 3];
    let used = set.sightings.iter().zip(&set.stations).enumerate();
    for (_, (seen, station)) in used.filter(|(k, _)| fix.rejected != Some(*k)) {
        let (azimuth, elevation) = bearing(&seen.array_m, &fix.position_m);
        let (ga, gb) = gradients(&seen.array_m, &fix.position_m);
        let (turned, late) = (*station, MAX_ARRAYS + *station);
        let (turning, rising) = rates(seen, &fix.position_m, &v.m_s);
        let mut angle = |r: f64, g: [f64; 3], sd: f64, turns: f64, rate: f64| {
            let mut g = g.map(|x| x / sd);
            if known {
                g[2] = 0.0;
            }
            let mut j = [0.0; N];
            j[turned] = turns * prior[turned] / sd;
            j[late] = -rate * prior[late] / sd;
            let r = r / sd;
            out.misfit += r * r;
            for (k, g) in g.iter().enumerate() {
                toward[k] += g * r;
                for l in [turned, late] {
                    by[k][l] += g * j[l];
                }
            }
            spd::add_outer(&mut normal, &g, 1.0);
            for k in [turned, late] {
                out.pull[k] += j[k] * r;
                for l in [turned, late] {
                    out.information[k][l] += j[k] * j[l];
                }
            }
        };
        angle(wrap_pi(seen.azimuth - azimuth), ga, seen.sd_azimuth, 1.0, turning);
        if let Some(measured) = seen.elevation {
            angle(measured - elevation, gb, seen.sd_elevation, 0.0, rising);
        }
    }
    let inverse = spd::inverse(&normal)?;
    // All others are none of this set's arrays'.
    let unknowns = || set.stations.iter().flat_map(|station| [*station, MAX_ARRAYS + *station]);
    for k in 0..3 {
        for l in unknowns() {
            out.moves[k][l] = (0..3).map(|m| inverse[k][m] * by[m][l]).sum();
        }
    }
    for k in unknowns() {
        out.pull[k] -= (0..3).map(|m| out.moves[m][k] * toward[m]).sum::<f64>();
        for l in unknowns() {
            out.information[k][l] -= (0..3).map(|m| by[m][k] * out.moves[m][l]).sum::<f64>();
        }
    }
    out.misfit -= spd::quadratic(&toward, &inverse, &toward);
    Some(out)
}

/// A vessel's velocity, m/s, and its covariance, m²/s².
#[derive(Clone, Copy, Debug)]
pub(super) struct Velocity {
    pub(super) m_s: [f64; 2],
    covariance: [[f64; 2]; 2],
}

/// The vessel's velocity at each position; none where it has no neighbours in time.
pub(super) fn velocities(sets: &[SightingSet], fixes: &[Result<Fix, NetworkError>]) -> Vec<Velocity> {
    let known: Vec<(f64, &Fix)> =
        sets.iter().zip(fixes).filter_map(|(set, fix)| Some((set.t_s, fix.as_ref().ok()?))).collect();
    let at = |t_s: f64| {
        let here = known.partition_point(|(t, _)| *t < t_s);
        let from = known.partition_point(|(t, _)| *t < t_s - ALL_S).min(here.saturating_sub(NEIGHBOURS));
        let to =
            known.partition_point(|(t, _)| *t <= t_s + ALL_S).max((here + NEIGHBOURS + 1).min(known.len()));
        let near = known[from..to].iter().filter(|(t, _)| (t - t_s).abs() <= NEAR_S);
        let n = near.clone().count();
        let along = |k: usize| through(near.clone().map(|(t, fix)| (t - t_s, fix.position_m[k])));
        let (Some(x), Some(y), true) = (along(0), along(1), n > NEIGHBOURS) else {
            return Velocity { m_s: [0.0; 2], covariance: [[0.0; 2]; 2] };
        };
        let of = |k: usize, l: usize| {
            x.var_slope * near.clone().map(|(_, fix)| fix.covariance_m2[k][l]).sum::<f64>() / n as f64
        };
        Velocity { m_s: [x.slope, y.slope], covariance: [[of(0, 0), of(0, 1)], [of(1, 0), of(1, 1)]] }
    };
    sets.iter().map(|set| at(set.t_s)).collect()
}

/// The bearings of a set without the errors that last, and of what was heard at one instant of the vessel: the sound of the
/// nearer array is younger. `fix`: where the vessel was, `v` how fast, as far as is known. What a velocity may be off by is in the deviations,
/// or its noise passes for an error of the clock.
pub(super) fn without(
    given: &SightingSet,
    prior: &[f64; N],
    state: &[f64; N],
    v: &Velocity,
    fix: Option<&Fix>,
    way: &Way,
) -> SightingSet {
    let mut out = given.clone();
    let Some(fix) = fix else { return out };
    let mean_s = way.mean_s(given, &fix.position_m);
    for (seen, station) in out.sightings.iter_mut().zip(&given.stations) {
        let (turned, late) = (*station, MAX_ARRAYS + *station);
        let late_s = prior[late] * state[late] + way.time_s(&seen.array_m, &fix.position_m) - mean_s;
        let now = fix.position_m;
        let then = [now[0] - v.m_s[0] * late_s, now[1] - v.m_s[1] * late_s, now[2]];
        let ((azimuth, elevation), (azimuth_then, elevation_then)) =
            (bearing(&seen.array_m, &now), bearing(&seen.array_m, &then));
        seen.azimuth += wrap_pi(azimuth - azimuth_then);
        seen.elevation = seen.elevation.map(|e| e + elevation - elevation_then);
        let ([a, b, _], [c, d, _]) = gradients(&seen.array_m, &fix.position_m);
        let by_velocity = |g: [f64; 2]| late_s * spd::quadratic(&g, &v.covariance, &g).max(0.0).sqrt();
        seen.sd_azimuth = seen.sd_azimuth.hypot(by_velocity([a, b]));
        seen.sd_elevation = seen.sd_elevation.hypot(by_velocity([c, d]));
        seen.azimuth -= prior[turned] * state[turned];
    }
    out
}
