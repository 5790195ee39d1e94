//! Models of the correlation between bearing errors [M 11-14].
//!
//! In: a lag and the correlation interval. Out: the correlation `ρ(τ) = C(τ)/σ_α²`, 1 at lag 0. The paper prints
//! `[C]_ij = C(τ_j) − C(τ_i)`; what is meant is `C(|t_i − t_j|)`.

use crate::math::f64 as m;

/// Correlation of bearing errors with the lag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// Independent errors.
    White,
    /// `max(0, 1 − |τ|/τ_α)` [M 13], the paper's choice.
    Linear,
    /// `sin(τ/τ_α)/(τ/τ_α)` [M 12]; nearly singular for records much longer than a sample.
    Sinc,
    /// `exp{−(τ/(0.5 τ_α))²}` [M 14]; nearly singular likewise.
    Gaussian,
    /// `exp(−|τ|/τ_α)`, first-order Gauss-Markov.
    Markov,
}

impl Model {
    /// Every model with the name people and records give it.
    pub const NAMED: [(&str, Self); 5] = [
        ("white", Self::White),
        ("linear", Self::Linear),
        ("sinc", Self::Sinc),
        ("gaussian", Self::Gaussian),
        ("markov", Self::Markov),
    ];

    /// Its name in [`Model::NAMED`].
    pub fn name(self) -> &'static str {
        Self::NAMED.iter().find(|(_, model)| *model == self).map_or("", |(name, _)| name)
    }

    /// Correlation at a lag (s) for correlation interval `tau_s`; a `tau_s` of 0 or less means independent.
    pub fn rho(self, lag_s: f64, tau_s: f64) -> f64 {
        let lag = lag_s.abs();
        if lag == 0.0 {
            return 1.0;
        }
        if tau_s.is_nan() || tau_s <= 0.0 {
            return 0.0;
        }
        let x = lag / tau_s;
        match self {
            Self::White => 0.0,
            Self::Linear => (1.0 - x).max(0.0),
            Self::Sinc => m::sin(x) / x,
            Self::Gaussian => m::exp(-4.0 * x * x),
            Self::Markov => m::exp(-x),
        }
    }
}
