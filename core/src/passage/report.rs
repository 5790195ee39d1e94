//! A solution as the telemetry's track record.

use crate::angle;
use crate::motion::Solution;
use crate::wire::Track;

/// The record of a solution: `id` of the vessel's track, `stage` 0 running or 1 final, `index` of the newest sample.
pub fn track(solution: &Solution, id: u16, stage: u8, index: u64) -> Track {
    let azimuth = |a: f64| angle::wrap_tau(a) as f32;
    Track {
        id,
        stage,
        index,
        cpa_time_s: solution.cpa_time_s,
        cpa_range_m: solution.cpa_range_m as f32,
        cpa_azimuth: azimuth(solution.cpa_azimuth_rad),
        heading: azimuth(solution.heading_rad),
        speed_m_s: solution.speed_m_s as f32,
        starboard: solution.starboard,
        sd_cpa_time_s: solution.sd_cpa_time_s as f32,
        sd_cpa_range_m: solution.sd_cpa_range_m as f32,
        sd_heading: solution.sd_heading_rad as f32,
        sd_speed_m_s: solution.sd_speed_m_s as f32,
        x_m: solution.position1_m[0] as f32,
        y_m: solution.position1_m[1] as f32,
        var_x_m2: solution.covariance1_m2[0] as f32,
        var_y_m2: solution.covariance1_m2[1] as f32,
        cov_xy_m2: solution.covariance1_m2[2] as f32,
        range_observable: solution.range_observable,
        n: solution.n.min(u32::from(u16::MAX)) as u16,
    }
}
