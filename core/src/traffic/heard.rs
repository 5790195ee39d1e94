//! A bearing as the tracks take it, and whether it came by another way.

use super::Config;
use crate::math::f64 as m;
use crate::passage::Measurement;
use crate::wire::Bearing;

/// Elevations used, radians (−30 to 80°). Low ones are not cut off: where noise decides which of them are kept, their mean
/// is too high. Further up the array's own tilt decides.
const ELEVATIONS_RAD: (f32, f32) = (-0.52, 1.4);
/// Standard deviation of an elevation beyond what is reported, radians (1°): multipath that changes as the vessel moves.
const ELEVATION_SD_RAD: f32 = 0.017_453;

/// An elevation farther from another than this and three deviations of both is another path's, radians (3°).
const OTHER_PATH_RAD: f32 = 0.052;
/// Seconds for which a bearing of the whole band says where its vessel is heard.
const RECENT_S: f64 = 3.0;

/// A bearing within this of where a vessel's depth was measured is of that vessel, radians (10°).
const SAME_RAD: f64 = 0.175;

/// Least share of a bearing's variance that is its own noise.
const LEAST_OWN: f64 = 0.01;

/// A bearing without what association does not need.
#[derive(Clone, Copy, Debug)]
pub(super) struct Heard {
    pub(super) azimuth: f64,
    pub(super) variance: f64,
    /// Elevation and its variance, radians and rad²; infinite where there is none.
    pub(super) elevation: (f32, f32),
}

impl Heard {
    const NO_ELEVATION: (f32, f32) = (0.0, f32::INFINITY);

    /// An azimuth alone.
    pub(super) const fn azimuth(azimuth: f64, variance: f64) -> Self {
        Self { azimuth, variance, elevation: Self::NO_ELEVATION }
    }

    /// A bearing; its elevation where the vessel's height above the array is known and it can tell range.
    /// `depth` is what [`super::State::set_depth`] was told.
    pub(super) fn of(config: &Config, depth: Option<(f32, f32)>, bearing: &Bearing) -> Self {
        let azimuth = f64::from(bearing.azimuth);
        // What lasts is the track's, not the noise's of each bearing.
        let lasting = config.motion.lasting_sd_rad * config.motion.lasting_sd_rad;
        let variance = f64::from(bearing.var_azimuth) - lasting;
        let variance = variance.max(LEAST_OWN * f64::from(bearing.var_azimuth));
        let (least, most) = ELEVATIONS_RAD;
        let usable = config.motion.medium.height_m > 0.0
            && (least..=most).contains(&bearing.elevation)
            && bearing.var_elevation >= 0.0
            && bearing.var_elevation.is_finite();
        if !usable {
            return Self::azimuth(azimuth, variance);
        }
        let own = bearing.var_elevation + ELEVATION_SD_RAD * ELEVATION_SD_RAD;
        // With its image the vessel is heard from the surface above it, whose height is known.
        let same = depth.filter(|(at, _)| m::abs(crate::angle::wrap_pi(azimuth - f64::from(*at))) < SAME_RAD);
        let depth_m =
            same.filter(|_| bearing.band == 0).map_or(config.vessel_depth_m, |(_, depth_m)| depth_m);
        let (sine, cosine) = crate::math::f32::sin_cos(bearing.elevation.max(0.0));
        let image = depth_m * config.per_depth * sine * cosine;
        Self { azimuth, variance, elevation: (bearing.elevation + image, own) }
    }

    /// As a passage takes it.
    pub(super) fn measured(&self, t_s: f64) -> Measurement {
        let (elevation, variance) = (f64::from(self.elevation.0), f64::from(self.elevation.1));
        let elevation = variance.is_finite().then_some((elevation, variance));
        Measurement { elevation, ..Measurement::azimuth(t_s, self.azimuth, self.variance) }
    }

    /// Whether a bearing is of a vessel's sound by way of the bottom or the surface: from below the horizon, where no vessel is
    /// when the array lies deep; or from the azimuth of the loudest source and another elevation.
    /// `loudest` is the newest bearing of the whole band and its time, seconds.
    pub(super) fn is_echo(&self, config: &Config, bearing: &Bearing, loudest: Option<&(f64, Self)>) -> bool {
        if config.motion.medium.height_m <= 0.0 {
            return false;
        }
        let three_sd = |variance: f32| 3.0 * crate::math::f32::sqrt(variance.max(0.0));
        if bearing.elevation < -three_sd(bearing.var_elevation) - OTHER_PATH_RAD {
            return true;
        }
        let Some((at_s, loudest)) = loudest.filter(|_| bearing.band != 0) else { return false };
        let recent = m::abs(config.seconds(bearing.index) - at_s) < RECENT_S;
        let same = m::abs(crate::angle::wrap_pi(self.azimuth - loudest.azimuth)) < config.merge_rad;
        let apart = three_sd(self.elevation.1 + loudest.elevation.1) + OTHER_PATH_RAD;
        recent && same && (self.elevation.0 - loudest.elevation.0).abs() > apart
    }
}
