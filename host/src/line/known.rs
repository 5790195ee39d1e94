//! Which of a line's sources is the vessel of known track, step by step.
//!
//! Enters: the sources of each step, the track. Leaves: the orientation from the sources that go with the track. Hypotheses of
//! orientation, clock shift and η on a grid are weighed by how near the nearest source of each step is to what the track gives;
//! from the best few the fit is repeated with the sources chosen by it until they stay the same. Which source is the
//! strongest does not matter, and a step that heard only another vessel is left out.

use super::records::Step;
use crate::orientation::known_vessel::{LineRecord, LineSearch};
use crate::orientation::track_file::as_heard;
use anyhow::{Context, Result, bail};
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_core::kit::median;
use seabearing_locate::network::known_track::{TrackPoint, position_at};
use seabearing_locate::orient::line::{LineBearing, LineOrientation};

/// Steps of the grid of orientations, degrees: a source moves by 0.035 in sine from one to the next at most.
const STEP_DEG: usize = 2;
/// Shifts and η of the grid.
const SHIFTS: usize = 9;
const ETAS: usize = 3;
/// Distances in sine beyond which a source is another's, while hypotheses are a grid's and when they are a fit's: a step of the grid
/// and the shift's, and 1 to 2 degrees, many deviations of a line's bearing.
const ROUGH: f64 = 0.08;
const FINE: f64 = 0.03;
/// Hypotheses followed up, and how far apart they are, radians (10°).
const FOLLOWED: usize = 8;
const APART: f64 = 0.175;
/// Rounds of choosing and fitting; two are usual.
const ROUNDS: usize = 6;
/// Share of the steps on the track by which the best hypothesis must surpass one of another orientation.
const SURPASS: f64 = 0.1;

/// Mean by which bearings may miss the track, radians (5°): those of a line near its axis err by some degrees, others by less than one.
const LARGEST_MEAN_ERROR: f64 = 5.0 * RAD_PER_DEG;

/// Where the array looks, when its clock is late by so much, with such an η.
#[derive(Clone, Copy)]
struct Hypothesis {
    orientation: f64,
    shift_s: f64,
    eta: f64,
}

impl Hypothesis {
    /// The source of a step that is nearest to what the track gives, and its distance in sine. `None` off the track.
    fn nearest(&self, step: &Step, track: &[TrackPoint], gap_s: f64) -> Option<(f64, f64)> {
        let [x, y, up] = position_at(track, step.t_s - self.shift_s, gap_s)?;
        let level = x.hypot(y) / x.hypot(y).hypot(up).max(f64::MIN_POSITIVE);
        let expected = self.eta * level * (x.atan2(y) - self.orientation).cos();
        let distances = step.sines.iter().map(|s| (*s, (s - expected).abs()));
        distances.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Share of steps on the track that have a source near what it gives, near ones counting more; and of how many.
    fn agreement(&self, steps: &[Step], track: &[TrackPoint], gap_s: f64, within: f64) -> (f64, usize) {
        let near = steps.iter().filter_map(|s| self.nearest(s, track, gap_s));
        let (sum, n) = near.fold((0.0, 0usize), |(sum, n), (_, d)| {
            (sum + (1.0 - (d / within) * (d / within)).max(0.0), n + 1)
        });
        (sum / n.max(1) as f64, n)
    }
}

/// Orientation of a line whose steps hold several sources, one of them the vessel of the track in most of them.
///
/// # Errors
/// The data do not tell; no orientation has a source near the track in most steps, or two have.
pub fn fit(steps: &[Step], track: &[TrackPoint], search: &LineSearch, name: &str) -> Result<LineOrientation> {
    // As for bearings without a choice.
    let mut intervals: Vec<f64> = steps.windows(2).map(|w| w[1].t_s - w[0].t_s).collect();
    let duration_s = steps.last().zip(steps.first()).map_or(0.0, |(b, a)| b.t_s - a.t_s);
    let interval_s = median(&mut intervals).unwrap_or(1.0);
    let most_s = search.max_shift_s.unwrap_or((6.0 * interval_s).max(0.1 * duration_s));
    let mut fits: Vec<(f64, LineOrientation)> = Vec::new();
    let mut failed = None;
    for start in starts(steps, track, search, most_s) {
        match follow(start, steps, track, search, name) {
            Ok(found) => fits.push(found),
            Err(e) => failed = Some(e),
        }
    }
    fits.sort_by(|a, b| b.0.total_cmp(&a.0));
    let Some((best, found)) = fits.first().copied() else {
        return Err(failed.unwrap_or_else(|| anyhow::anyhow!("{name}: no bearing is on the track")));
    };
    if best < 0.5 {
        bail!(
            "{name}: at no orientation does a source follow the track in most steps (at best near it in {:.0} %): is it the track of a vessel that was heard, and its clock right?",
            100.0 * best
        );
    }
    let other = fits.iter().find(|(share, o)| {
        let away = wrap_pi(o.orientation - found.orientation).abs();
        away > APART.max(3.0 * (o.sd + found.sd)) && *share > best - SURPASS
    });
    if let Some((_, other)) = other {
        bail!(
            "{name}: two sources follow the track, one if the line looks to {:.0}°, another if to {:.0}°: give a time when one vessel is heard, or another pass",
            wrap_pi(found.orientation) / RAD_PER_DEG,
            wrap_pi(other.orientation) / RAD_PER_DEG
        );
    }
    Ok(found)
}

/// Heights of the vessel above the line that are tried where its depth is not told, in units of the closest range: sound from steeper
/// than 45° is told apart by no line.
const HEIGHTS: [f64; 8] = [0.0, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0];

/// Orientation by what was heard: the track is taken as its sound arrives, with the vessel so high above the line (`up_m`; where that is
/// not told, at the heights that go with the bearings, each as likely as it makes them). `fit` is one fit with such a track.
///
/// # Errors
/// Those of the fit, where no height has one.
pub fn heard(
    track: &[TrackPoint],
    up_m: Option<f64>,
    sound_speed_m_s: f64,
    fit: impl Fn(&[TrackPoint]) -> Result<LineOrientation>,
) -> Result<LineOrientation> {
    let closest_m =
        track.iter().map(|p| p.position_m[0].hypot(p.position_m[1])).fold(f64::INFINITY, f64::min);
    let heights: Vec<f64> = up_m.map_or_else(|| HEIGHTS.map(|h| h * closest_m).to_vec(), |up_m| vec![up_m]);
    let (mut fits, mut failed) = (Vec::new(), None);
    for up_m in heights {
        match fit(&as_heard(track, up_m, sound_speed_m_s)) {
            Ok(found) => fits.push(found),
            Err(e) => failed = failed.or(Some(e)),
        }
    }
    let Some(best) = fits.iter().copied().max_by(|a, b| a.ln_likelihood.total_cmp(&b.ln_likelihood)) else {
        return Err(failed.unwrap_or_else(|| anyhow::anyhow!("the track has no position")));
    };
    // A few bearings more or less that count as wrong do not make a height likely: the scatter of one bearing does.
    let per_bearing = |f: &LineOrientation| f.ln_likelihood / f.n.max(1) as f64;
    let weight = |f: &LineOrientation| (best.n as f64 * (per_bearing(f) - per_bearing(&best))).min(0.0).exp();
    let sum: f64 = fits.iter().map(weight).sum();
    let mean =
        |of: &dyn Fn(&LineOrientation) -> f64| fits.iter().map(|f| weight(f) * of(f)).sum::<f64>() / sum;
    let spread = |of: &dyn Fn(&LineOrientation) -> (f64, f64)| {
        let middle = mean(&|f| of(f).0);
        (middle, mean(&|f| of(f).1.powi(2) + (of(f).0 - middle).powi(2)).sqrt())
    };
    let (turn, sd) = spread(&|f| (wrap_pi(f.orientation - best.orientation), f.sd));
    let (time_shift_s, sd_time_shift_s) = spread(&|f| (f.time_shift_s, f.sd_time_shift_s));
    let (eta, sd_eta) = spread(&|f| (f.eta, f.sd_eta));
    let orientation = best.orientation + turn;
    Ok(LineOrientation { orientation, sd, time_shift_s, sd_time_shift_s, eta, sd_eta, ..best })
}

/// Refuses an orientation that most bearings contradict, or that they miss by far more than a line's bearings err.
///
/// # Errors
/// One line that says by how much.
pub fn check(found: &LineOrientation, name: &str) -> Result<()> {
    if found.n < found.wrong || found.mean_error > LARGEST_MEAN_ERROR {
        bail!(
            "{name}: no orientation goes with the track: at the best one {} of {} bearings contradict it, and they miss it by {:.1}° in the mean; was another vessel than the track's heard, or are the track's times others?",
            found.wrong,
            found.n + found.wrong,
            found.mean_error / RAD_PER_DEG
        );
    }
    Ok(())
}

/// The best hypotheses of the grid, apart from each other.
fn starts(steps: &[Step], track: &[TrackPoint], search: &LineSearch, most_s: f64) -> Vec<Hypothesis> {
    let share = |k: usize, n: usize| k as f64 / (n - 1) as f64;
    let mut all: Vec<(f64, Hypothesis)> = Vec::new();
    for degrees in (0..360).step_by(STEP_DEG) {
        for shift in 0..SHIFTS {
            for eta in 0..ETAS {
                let at = Hypothesis {
                    orientation: degrees as f64 * RAD_PER_DEG,
                    shift_s: most_s * (2.0 * share(shift, SHIFTS) - 1.0),
                    eta: search.eta.0 + (search.eta.1 - search.eta.0) * share(eta, ETAS),
                };
                let (agreement, n) = at.agreement(steps, track, search.gap_s, ROUGH);
                // A shift that pushes a fifth of the steps off the track is not comparable with one that keeps them.
                if n > 0 {
                    all.push((agreement * (n as f64 / steps.len() as f64).min(0.8), at));
                }
            }
        }
    }
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut out: Vec<Hypothesis> = Vec::new();
    for (_, at) in all {
        if out.len() < FOLLOWED && out.iter().all(|o| wrap_pi(o.orientation - at.orientation).abs() > APART) {
            out.push(at);
        }
    }
    out
}

/// Chooses and fits in turn; how well the steps agree with the outcome, and the outcome.
fn follow(
    mut at: Hypothesis,
    steps: &[Step],
    track: &[TrackPoint],
    search: &LineSearch,
    name: &str,
) -> Result<(f64, LineOrientation)> {
    let (mut chosen, mut found): (Vec<LineBearing>, Option<LineOrientation>) = (Vec::new(), None);
    for round in 0..ROUNDS {
        let within = if round == 0 { 2.0 * ROUGH } else { 2.0 * FINE };
        let choice = |s: &Step| match at.nearest(s, track, search.gap_s) {
            Some((sine, distance)) => (distance < within).then_some(LineBearing { t_s: s.t_s, sine }),
            // Of a step off the track nothing is known: another shift may have it on the track.
            None => s.sines.first().map(|sine| LineBearing { t_s: s.t_s, sine: *sine }),
        };
        let choice: Vec<LineBearing> = steps.iter().filter_map(choice).collect();
        if choice == chosen {
            break;
        }
        chosen = choice;
        let fit = LineRecord::of_bearings(chosen.clone(), search, name.to_owned()).fit(track)?;
        at = Hypothesis { orientation: fit.orientation, shift_s: fit.time_shift_s, eta: fit.eta };
        found = Some(fit);
    }
    let mut found = found.with_context(|| format!("{name}: no bearing is on the track"))?;
    let (agreement, on_track) = at.agreement(steps, track, search.gap_s, FINE);
    found.wrong = on_track.saturating_sub(found.n);
    found.off_track = steps.len() - on_track;
    Ok((agreement, found))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SEARCH: LineSearch =
        LineSearch { max_shift_s: None, free_shift: false, eta: (0.85, 1.05), gap_s: 60.0 };

    fn track(velocity: [f64; 2], from: [f64; 2]) -> Vec<TrackPoint> {
        let at = |t_s: f64| [from[0] + velocity[0] * t_s, from[1] + velocity[1] * t_s, 0.0];
        (-2..9).map(|k| 10.0 * f64::from(k)).map(|t_s| TrackPoint { t_s, position_m: at(t_s) }).collect()
    }

    /// A line at 40° that hears two vessels, now one, now the other the stronger, in a part of the steps both.
    fn steps(known: &[TrackPoint], other: &[TrackPoint], alone: bool) -> Vec<Step> {
        let sine = |track: &[TrackPoint], t_s: f64| {
            let [x, y, _] = position_at(track, t_s, 60.0).unwrap();
            (x.atan2(y) - 40.0 * RAD_PER_DEG).cos() + 0.001 * (7.3 * t_s * t_s).sin()
        };
        (0..60)
            .map(|k| {
                let t_s = f64::from(k) + 0.5;
                let (a, b) = (sine(known, t_s), sine(other, t_s));
                let sines = match k % 5 {
                    _ if alone => vec![b],
                    0 | 1 => vec![b, a],
                    2 => vec![a],
                    3 => vec![a, b],
                    _ => vec![b],
                };
                Step { t_s, sines }
            })
            .collect()
    }

    #[test]
    fn the_vessel_of_the_track_is_followed_whichever_is_stronger() {
        let known = track([30.0, 0.0], [-1200.0, 2000.0]);
        let other = track([-3.0, 8.0], [2500.0, 500.0]);
        let found = fit(&steps(&known, &other, false), &known, &SEARCH, "test").unwrap();
        let error = wrap_pi(found.orientation - 40.0 * RAD_PER_DEG).abs();
        assert!(error < 0.5 * RAD_PER_DEG && error < 4.0 * found.sd, "{found:?}");
        assert!(found.n > 40 && found.n + found.wrong + found.off_track == 60, "{found:?}");
    }

    #[test]
    fn another_vessel_alone_gives_no_orientation() {
        let known = track([30.0, 0.0], [-1200.0, 2000.0]);
        let other = track([-3.0, 8.0], [2500.0, 500.0]);
        let found = fit(&steps(&known, &other, true), &known, &SEARCH, "test");
        let error = found.and_then(|found| check(&found, "test")).unwrap_err();
        assert!(format!("{error:#}").lines().count() == 1, "{error:#}");
    }

    #[test]
    fn sound_takes_its_way_and_a_near_vessel_has_an_elevation_of_its_own() {
        let known = track([0.0, 6.0], [400.0, -240.0]);
        let up_m: f64 = 60.0;
        let (mut errors, mut mean_sd) = (Vec::new(), 0.0);
        for phase in 0..3 {
            let steps: Vec<Step> = (0..78)
                .filter_map(|k| {
                    let t_s = f64::from(k);
                    let [x, y, _] = position_at(&as_heard(&known, up_m, 1484.0), t_s, 60.0)?;
                    let level = x.hypot(y) / x.hypot(y).hypot(up_m);
                    let sine = level * (x.atan2(y) - 40.0 * RAD_PER_DEG).cos();
                    let noise = 0.003 * (7.3 * t_s * t_s + f64::from(phase) * t_s).sin();
                    Some(Step { t_s, sines: vec![sine + noise, -0.9] })
                })
                .collect();
            // Whether the depth is told or not.
            let told = (phase % 2 == 0).then_some(up_m);
            let found = heard(&known, told, 1484.0, |t| fit(&steps, t, &SEARCH, "test")).unwrap();
            errors.push(wrap_pi(found.orientation - 40.0 * RAD_PER_DEG));
            assert!(errors[phase as usize].abs() < 3.0 * found.sd, "{phase} {errors:?} {found:?}");
            mean_sd += found.sd / 3.0;
        }
        assert!(mean_sd < 0.5 * RAD_PER_DEG, "{mean_sd}");
    }
}
