//! Sets that point the way of those about them at another elevation: an echo's, or a hydrophone's that hears one, and no vessel's.
//!
//! In: the sets of a file in order of time. Out: which accepted ones are such. Between sets whose delays agree well a vessel's direction goes on
//! evenly; one whose delays agree less, and whose azimuth lies on that way while its elevation does not, has measured some arrivals of another path.
//!
//! Not seen: an echo that lasts longer than the sets about it reach, or whose delays agree as well as the vessel's own.

use super::SetResult;
use seabearing_core::angle::{wrap_pi, wrap_pi_f32};
use seabearing_core::kit::median;

/// Residual over the median of the accepted sets' up to which delays agree well.
const WELL: f64 = 2.0;
/// How far sets that agree well reach, seconds, and how many on either side are looked at.
const REACH_S: f64 = 60.0;
const BESIDE: usize = 5;
/// By how much an azimuth may be off the way and the least by which an elevation must be, degrees; and in stated deviations.
const AZIMUTH_DEG: f64 = 5.0;
const ELEVATION_DEG: f64 = 5.0;
const DEVIATIONS: f64 = 5.0;

/// A direction at a time: azimuth and elevation, radians.
type Timed = (f64, [f64; 2]);

/// Which of the sets are echoes.
pub(super) fn of(sets: &[SetResult]) -> Vec<bool> {
    let accepted = |s: &SetResult| s.solution.filter(|_| s.accepted());
    let mut residuals: Vec<f64> = sets.iter().filter_map(accepted).map(|s| f64::from(s.residual_s)).collect();
    let Some(usual_s) = median(&mut residuals) else { return vec![false; sets.len()] };
    let agrees = |residual_s: f32| f64::from(residual_s) <= WELL * usual_s;
    let well: Vec<Timed> = sets
        .iter()
        .filter_map(|s| Some((s.t_s, accepted(s)?)))
        .filter(|(_, s)| agrees(s.residual_s))
        .map(|(t_s, s)| (t_s, [s.azimuth.into(), s.elevation.into()]))
        .collect();
    let is_echo = |set: &SetResult| {
        let Some(s) = accepted(set).filter(|s| !agrees(s.residual_s)) else { return false };
        let Some([azimuth, elevation]) = on_the_way(&well, set.t_s) else { return false };
        let across = f64::from(s.elevation).cos() * f64::from(wrap_pi_f32(s.azimuth - azimuth as f32));
        let up = (f64::from(s.elevation) - elevation).abs();
        let least = ELEVATION_DEG.to_radians().max(DEVIATIONS * f64::from(s.var_elevation).sqrt());
        across.abs() < AZIMUTH_DEG.to_radians() && up > least
    };
    sets.iter().map(is_echo).collect()
}

/// Where a vessel is between the sets that agree well before and after a time; `None` where a side has none near.
fn on_the_way(well: &[Timed], t_s: f64) -> Option<[f64; 2]> {
    let here = well.partition_point(|(t, _)| *t < t_s);
    let before = middle(&well[here.saturating_sub(BESIDE)..here], t_s)?;
    let after = middle(&well[here..(here + BESIDE).min(well.len())], t_s)?;
    let part = (t_s - before.0) / (after.0 - before.0);
    let turn = wrap_pi(after.1[0] - before.1[0]);
    Some([before.1[0] + part * turn, before.1[1] + part * (after.1[1] - before.1[1])])
}

/// The median of those within reach of a time.
fn middle(beside: &[Timed], t_s: f64) -> Option<Timed> {
    let near = || beside.iter().filter(|(t, _)| (t - t_s).abs() <= REACH_S);
    let first = near().next()?.1[0];
    let of = |value: &dyn Fn(&Timed) -> f64| median(&mut near().map(value).collect::<Vec<_>>());
    Some((of(&|x| x.0)?, [first + of(&|x| wrap_pi(x.1[0] - first))?, of(&|x| x.1[1])?]))
}

#[cfg(test)]
mod tests {
    use crate::delays::{SetResult, solve_rows};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};
    use seabearing_core::config::StationConfig;
    use seabearing_core::geometry::PAIRS;

    const H: [[f64; 3]; 4] =
        [[0.0, 1.0623, -0.3756], [0.92, -0.5312, -0.3756], [-0.92, -0.5312, -0.3756], [0.0, 0.0, 1.1267]];

    /// A source that turns by 0.3° a second, 15° up; `late_s` is hydrophone 3's by time, and errors of 5 µs.
    fn sets(late_s: impl Fn(f64) -> f64) -> Vec<SetResult> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
        let row = |k: i32| {
            let t_s = f64::from(k);
            let (azimuth, elevation) = ((0.3 * t_s).to_radians(), 15f64.to_radians());
            let (s, c) = azimuth.sin_cos();
            let u = [s * elevation.cos(), c * elevation.cos(), elevation.sin()];
            let arrival = |i: usize| {
                -(0..3).map(|x| H[i][x] * u[x]).sum::<f64>() / 1484.0 + if i == 3 { late_s(t_s) } else { 0.0 }
            };
            let mut row = [t_s; 7];
            for (p, (i, j)) in PAIRS.into_iter().enumerate() {
                row[p + 1] = arrival(j) - arrival(i) + 5e-6 * normal();
            }
            row
        };
        let station = StationConfig { sound_speed_m_s: 1484.0, ..StationConfig::array(64_000.0, H) };
        solve_rows(&station, (0..300).map(row).collect(), None).unwrap().sets
    }

    /// Accepted sets, and those of them more than 5° off in elevation.
    fn wrong(sets: &[SetResult]) -> (usize, usize) {
        let accepted = || sets.iter().filter(|s| s.accepted()).filter_map(|s| s.solution);
        let off = accepted().filter(|s| (s.elevation.to_degrees() - 15.0).abs() > 5.0).count();
        (accepted().count(), off)
    }

    #[test]
    fn sets_of_an_echo_are_not_accepted_and_a_vessels_are() {
        let (accepted, off) = wrong(&sets(|t_s| if (100.0..140.0).contains(&t_s) { 2e-4 } else { 0.0 }));
        assert!(accepted > 240 && off == 0, "{accepted} {off}");
        let found = sets(|_| 0.0);
        assert!(found.iter().all(|s| s.accepted() && !s.echo));
    }
}
