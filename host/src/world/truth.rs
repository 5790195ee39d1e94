//! `truth.csv`: where every vessel really was.

use super::array::{ambient_power, motions, signal_power};
use super::scenario::ArrayScenario;
use anyhow::Result;
use std::fmt::Write;

/// Header of the file; `docs/simulate.md` describes every column.
pub const HEADER: &str = "t_s,vessel,x_m,y_m,range_m,azimuth_deg,elevation_deg,emission_t_s,emission_x_m,emission_y_m,\
arrival_azimuth_deg,arrival_elevation_deg,speed_m_s,heading_deg,cpa_time_s,cpa_range_m,snr_db";

/// The whole file.
///
/// # Errors
/// A vessel's track file cannot be used.
pub fn csv(scenario: &ArrayScenario) -> Result<String> {
    let motions = motions(scenario)?;
    let config = &scenario.station.config;
    let noise = ambient_power(scenario, &motions);
    let rate = 1.0 + scenario.recorder.clock_drift_ppm * 1e-6;
    let mut out = format!("{HEADER}\n");
    let closest: Vec<_> = motions.iter().map(|m| m.cpa(0.0, scenario.duration_s)).collect();
    let steps = (scenario.duration_s / scenario.truth_step_s + 1e-9).floor() as u64;
    for step in 0..=steps {
        let t = step as f64 * scenario.truth_step_s;
        let true_t = t / rate;
        for (v, ((motion, cpa), vessel)) in motions.iter().zip(&closest).zip(&scenario.vessels).enumerate() {
            let z = config.depth_m - vessel.depth_m;
            let [x, y] = motion.position(true_t);
            let (emitted, _) = motion.emission(true_t, [0.0; 3], z, config.sound_speed_m_s, true_t);
            let [ex, ey] = motion.position(emitted);
            let [vx, vy] = motion.velocity(true_t);
            let azimuth = |x: f64, y: f64| x.atan2(y).to_degrees().rem_euclid(360.0);
            let elevation = |x: f64, y: f64| z.atan2(x.hypot(y)).to_degrees();
            let snr = 10.0 * (signal_power(scenario, v, ex.hypot(ey)) / noise).log10();
            writeln!(
                out,
                "{t:.3},{},{x:.3},{y:.3},{:.3},{:.5},{:.5},{:.6},{ex:.3},{ey:.3},{:.5},{:.5},{:.4},{:.4},{:.4},{:.3},{snr:.2}",
                vessel.name,
                x.hypot(y),
                azimuth(x, y),
                elevation(x, y),
                emitted * rate,
                azimuth(ex, ey),
                elevation(ex, ey),
                vx.hypot(vy),
                azimuth(vx, vy),
                cpa.time_s * rate,
                cpa.range_m,
            )?;
        }
    }
    Ok(out)
}
