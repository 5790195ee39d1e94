//! What the fits of one passage have in common: when two lines are the same, and what is known before any bearing.

use super::model::{Line, PARAMETERS};
use super::normal::{COLUMNS, Normal};
use crate::angle::wrap_pi;
use crate::math::f64 as m;

/// Whether two hypotheses have run into the same minimum.
pub fn same(a: &Line, b: &Line) -> bool {
    let d = |k: usize| m::abs(a.p[k] - b.p[k]);
    a.sense == b.sense && m::abs(wrap_pi(a.p[0] - b.p[0])) < 1e-3 && d(2) < 1e-2 && d(1) < 0.5
}

/// Adds the priors of speed (Gaussian in v) and elevation bias; a standard deviation of 0 or infinity adds nothing.
pub fn add_priors(normal: &mut Normal, line: &Line, speed_m_s: f64, speed_sd_m_s: f64, bias_sd_rad: f64) {
    if speed_sd_m_s > 0.0 && speed_sd_m_s.is_finite() {
        let mut row = [0.0; COLUMNS];
        row[3] = line.speed_m_s();
        row[PARAMETERS] = speed_m_s - line.speed_m_s();
        normal.add(&row, 1.0 / (speed_sd_m_s * speed_sd_m_s));
    }
    if bias_sd_rad > 0.0 && bias_sd_rad.is_finite() {
        let mut row = [0.0; COLUMNS];
        row[4] = 1.0;
        row[PARAMETERS] = -line.p[4];
        normal.add(&row, 1.0 / (bias_sd_rad * bias_sd_rad));
    }
}
