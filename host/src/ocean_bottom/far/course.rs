//! The straight course of a curve of azimuths: what of it they tell, and all of it where ranges are there.
//!
//! The fit is that of `seabearing track` (`seabearing_locate::motion`, heavy tails). A range is an elevation of the sea floor's depth under it, as
//! for `locate`. Without ranges the speed is the fleet's of paper M, which nothing that is told depends on but for the travel time. Deviations are by the scatter that
//! azimuths show about the course, or, where that is more than chance, their means over 20 minutes, in which a course that bends shows.

use super::curves::Curve;
use super::heard::{Direction, Distance};
use super::{Closest, Known, Phase, Place, Scale, Track};
use crate::motion::estimate::batch;
use seabearing_core::angle::{wrap_pi, wrap_tau};
use seabearing_core::kit::spd::quadratic;
use seabearing_core::motion::model::PARAMETERS;
use seabearing_core::motion::{Medium, Solution};
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::ml::{Config, Sample};

/// Windows of three minutes begin each minute: so many say as much as one.
const OVERLAP: f64 = 3.0;
/// Speed where nothing tells it, and its deviation, m/s: the fleet of paper M.
const FLEET_M_S: (f64, f64) = (7.3, 2.3);
/// Ranges of closest points, m.
const RANGES_M: (f64, f64) = (50.0, 400_000.0);
/// Least standard deviation with which a range is taken, m: the step of the recorder's, whose neighbours share errors.
const LEAST_RANGE_SD_M: f64 = 70.0;
/// Depth of a vessel's source, m.
const SOURCE_M: f64 = 5.0;
/// Fewest ranges that tell a course's scale.
const LEAST_RANGES: usize = 5;
/// Longest time between an azimuth and a range of one minute, s.
const SAME_MINUTE_S: f64 = 1.0;
/// Length of the means in which a bend shows, s.
const MEAN_S: f64 = 1_200.0;
/// Independent azimuths for which the stated deviation counts against the measured scatter.
const BEFORE: f64 = 10.0;
/// Residuals farther off count as so many deviations.
const FAR: f64 = 4.0;
/// Greatest deviation of an azimuth of the closest point that is told, rad.
const KNOWN: f64 = 0.35;
/// Greatest relative deviation of speed over range that is told.
const KNOWN_SCALE: f64 = 0.5;
/// Deviations from the closest point at which a vessel is before or after it.
const SURELY: f64 = 2.0;
/// Two pieces are one vessel's at most so far apart, s, if one course explains them as well: misfit beyond that of two, the 99.9 % point of χ²
/// of the three parameters that are saved.
const APART_S: (f64, f64) = (-600.0, 5_400.0);
const WORSE: f64 = 16.3;

/// A fitted course.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Course {
    /// What the fit says, the covariance grown.
    pub solution: Solution,
    /// Travel time and depth of the fit.
    pub medium: Medium,
    /// What told its scale.
    pub scale: Option<Scale>,
    /// Variances of azimuths over those stated, as measured.
    pub growth: f64,
}

impl Course {
    /// Azimuth at a time, and its deviation, rad.
    pub fn azimuth(&self, t_s: f64) -> Known {
        let expected = self.solution.line.expected(&self.medium, t_s);
        Known { value: wrap_tau(expected.azimuth), sd: self.sd(&expected.d_azimuth) }
    }

    /// Rate of the azimuth, rad/s.
    pub fn turning(&self, t_s: f64) -> Known {
        let at = |t: f64| self.solution.line.expected(&self.medium, t);
        let (a, b) = (at(t_s - 60.0), at(t_s + 60.0));
        let mut j = [0.0; PARAMETERS];
        j.iter_mut().zip(a.d_azimuth.iter().zip(&b.d_azimuth)).for_each(|(j, (a, b))| *j = (b - a) / 120.0);
        Known { value: (b.azimuth - a.azimuth) / 120.0, sd: self.sd(&j) }
    }

    fn sd(&self, j: &[f64; PARAMETERS]) -> f64 {
        quadratic(j, &self.solution.covariance, j).max(0.0).sqrt()
    }

    /// Squared residuals of azimuths in deviations, none beyond [`FAR`] of them.
    fn misfit(&self, directions: &[Direction], place: &Place<'_>) -> f64 {
        residuals(&self.solution, &self.medium, directions, place).map(|(_, z)| (z * z).min(FAR * FAR)).sum()
    }

    /// What it tells of a vessel with these azimuths.
    pub(super) fn track(&self, directions: Vec<Direction>, place: &Place<'_>) -> Track {
        let last_s = directions.last().map_or(0.0, |d| d.t_s);
        let s = &self.solution;
        let lasting = |sd: f64| sd.hypot(place.orientation_sd);
        let azimuth = self.azimuth(last_s);
        let sd_azimuth = lasting(s.covariance[0][0].max(0.0).sqrt());
        let turned = s.sd_heading_rad.is_finite() && sd_azimuth < KNOWN;
        let sd_q = s.covariance[2][2].max(0.0).sqrt();
        let q = s.line.p[2].exp();
        let closest = turned.then(|| Closest {
            time_s: Known { value: s.cpa_time_s, sd: s.sd_cpa_time_s },
            azimuth: Known { value: s.cpa_azimuth_rad, sd: sd_azimuth },
            heading: Known { value: s.heading_rad, sd: sd_azimuth },
            starboard: s.starboard,
            speed_over_range: (sd_q < KNOWN_SCALE).then_some(Known { value: q, sd: q * sd_q }),
        });
        let phase = closest.map(|c| {
            let past = (last_s - c.time_s.value) / c.time_s.sd;
            if past > SURELY {
                Phase::Leaving
            } else if past < -SURELY {
                Phase::Approaching
            } else {
                Phase::Passing
            }
        });
        let ranged = self.scale.is_some() && closest.is_some();
        Track {
            course: *self,
            azimuth: Known { sd: lasting(azimuth.sd), ..azimuth },
            turning: self.turning(last_s),
            closest,
            phase,
            speed_m_s: ranged.then_some(Known { value: s.speed_m_s, sd: s.sd_speed_m_s }),
            range_m: (ranged && s.sd_cpa_range_m.is_finite())
                .then_some(Known { value: s.cpa_range_m, sd: s.sd_cpa_range_m }),
            scale: self.scale.filter(|_| ranged),
            directions,
            ranges: 0,
            ranges_refused: 0,
            tones: Vec::new(),
            recorder_tracks: Vec::new(),
        }
    }
}

/// An azimuth's own deviation, without what lasts, as one of overlapping windows counts.
fn own_sd(d: &Direction, place: &Place<'_>) -> f64 {
    let own = d.sd * d.sd - place.orientation_sd * place.orientation_sd;
    (OVERLAP * own.max(0.006 * 0.006)).sqrt()
}

/// Times and residuals of azimuths in deviations.
fn residuals<'d>(
    s: &Solution,
    medium: &Medium,
    directions: &'d [Direction],
    place: &'d Place<'_>,
) -> impl Iterator<Item = (f64, f64)> + 'd {
    let view = s.line.view(medium);
    directions
        .iter()
        .map(move |d| (d.t_s, wrap_pi(d.azimuth - view.expected(d.t_s).azimuth) / own_sd(d, place)))
}

/// Fits a course; `None` where none fits.
pub fn fit(directions: &[Direction], distances: &[Distance], place: &Place<'_>) -> Option<Course> {
    let depth_m = place.depth_m.map(|d| d - SOURCE_M).filter(|d| *d > 0.0 && distances.len() >= LEAST_RANGES);
    let samples: Vec<Sample> = directions
        .iter()
        .map(|d| {
            let mut sample = Sample::azimuth(d.t_s, wrap_tau(d.azimuth), own_sd(d, place));
            let same = distances.iter().find(|r| (r.t_s - d.t_s).abs() < SAME_MINUTE_S);
            if let Some((depth_m, r)) = depth_m.zip(same) {
                // d atan(z / r) = z dr / (r² + z²).
                let sd_m = OVERLAP.sqrt() * r.sd_m.max(LEAST_RANGE_SD_M);
                let sd = depth_m * sd_m / (r.range_m * r.range_m + depth_m * depth_m);
                sample.elevation_rad = (depth_m.atan2(r.range_m) as f32, sd as f32);
            }
            sample
        })
        .collect();
    let ranged = samples.iter().filter(|s| s.elevation_rad.1.is_finite()).count() >= LEAST_RANGES;
    let medium = Medium {
        height_m: if ranged { depth_m.unwrap_or(0.0) } else { 0.0 },
        ..Medium::of_sound_speed(place.sound_speed_m_s)
    };
    let config = Config {
        model: Model::White,
        tau_s: 0.0,
        white_share: 0.0,
        speed_m_s: FLEET_M_S.0,
        speed_sd_m_s: if ranged { f64::INFINITY } else { FLEET_M_S.1 },
        range_m: RANGES_M,
        medium,
        elevation_bias_sd_rad: 0.0,
        acceleration_sd_m_s2: 0.0,
    };
    let mut solution = batch(&config, &samples, true).ok()?.solution;
    let growth = growth(&solution, &medium, directions, place);
    // Near the station what all azimuths share is more than what hundreds of them leave.
    let growth = if ranged { growth.max(1.0) } else { growth };
    solution.covariance.iter_mut().flatten().for_each(|c| *c *= growth);
    for sd in [
        &mut solution.sd_cpa_time_s,
        &mut solution.sd_cpa_range_m,
        &mut solution.sd_cpa_azimuth_rad,
        &mut solution.sd_heading_rad,
        &mut solution.sd_speed_m_s,
    ] {
        *sd *= growth.sqrt();
    }
    Some(Course { solution, medium, scale: ranged.then_some(Scale::Ranges), growth })
}

/// Variances over those stated: what single residuals show, or their means over [`MEAN_S`], where that is beyond the 95 % point of chance.
fn growth(s: &Solution, medium: &Medium, directions: &[Direction], place: &Place<'_>) -> f64 {
    let all: Vec<(f64, f64)> = residuals(s, medium, directions, place).collect();
    let bounded = |z: f64| z.clamp(-FAR, FAR);
    // Overlapping windows were given a third each: their residuals are smaller than one by that.
    let single = OVERLAP * all.iter().map(|(_, z)| bounded(*z).powi(2)).sum::<f64>() / all.len() as f64;
    let block = |t_s: f64| (t_s / MEAN_S).floor();
    let means: Vec<f64> = all
        .chunk_by(|a, b| block(a.0) == block(b.0))
        .map(|c| c.iter().map(|(_, z)| bounded(*z)).sum::<f64>().powi(2) / c.len() as f64)
        .collect();
    // What few azimuths scatter by is not well known.
    let independent = all.len() as f64 / OVERLAP;
    let single = (single * independent + BEFORE) / (independent + BEFORE);
    let free = (means.len() as f64 - 3.0).max(1.0);
    let of_means = means.iter().sum::<f64>() / free;
    let chance = 1.0 + 1.645 * (2.0 / free).sqrt();
    if of_means > chance * single { of_means } else { single }
}

/// Curves of which one course explains several as well as several courses, made one.
pub fn joined(mut curves: Vec<Curve>, place: &Place<'_>) -> Vec<Curve> {
    let known = |c: &Curve| fit(&c.directions, &[], place);
    let mut fits: Vec<Option<Course>> = curves.iter().map(known).collect();
    loop {
        let mut best: Option<(f64, usize, usize, Curve, Course)> = None;
        for i in 0..curves.len() {
            for j in 0..curves.len() {
                let apart = curves[j].span_s().0 - curves[i].span_s().1;
                if i == j || !(APART_S.0..APART_S.1).contains(&apart) {
                    continue;
                }
                let Some((a, b)) = fits[i].zip(fits[j]) else { continue };
                let mut both = curves[i].clone();
                both.directions.extend(&curves[j].directions);
                both.directions.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
                let Some(one) = known(&both) else { continue };
                let two = a.misfit(&curves[i].directions, place) + b.misfit(&curves[j].directions, place);
                let worse = (one.misfit(&both.directions, place) - two) / a.growth.max(b.growth);
                if worse < WORSE && best.as_ref().is_none_or(|b| worse < b.0) {
                    best = Some((worse, i, j, both, one));
                }
            }
        }
        let Some((_, i, j, both, course)) = best else { return curves };
        (curves[i], fits[i]) = (both, Some(course));
        curves.remove(j);
        fits.remove(j);
    }
}
