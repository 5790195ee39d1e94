//! What the tests of motion share: the assumptions of a plain pass, and noise.

use crate::motion::covariance::Model;
use crate::motion::ml::Config;
use crate::motion::model::Medium;

/// A vessel at 7 m/s, known, on a line; no refraction, white errors.
pub(super) fn config() -> Config {
    Config {
        model: Model::White,
        tau_s: 0.0,
        white_share: 0.0,
        speed_m_s: 7.0,
        speed_sd_m_s: 0.0,
        range_m: (5.0, 20_000.0),
        medium: Medium::of_sound_speed(f64::INFINITY),
        elevation_bias_sd_rad: 0.0,
        acceleration_sd_m_s2: 0.0,
    }
}

/// Normal numbers from a seed: sums of twelve uniform ones.
pub(super) fn normal(seed: u64) -> impl FnMut() -> f64 {
    let mut state = seed;
    move || {
        let mut sum = -6.0;
        for _ in 0..12 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum += (state >> 11) as f64 / (1_u64 << 53) as f64;
        }
        sum
    }
}
