//! Bearings of a uniform line array: MUSIC and root-MUSIC in one narrow band (paper L, section 3).
//!
//! In: snapshots, one complex value a sensor (the band's transform of one frame). Out: per source the sine of its
//! bearing from broadside, its standard deviation, and what is seen of its strength.
//!
//! Chain: recursive covariance with a forgetting factor ([`covariance`]); forward-backward averaging and spatial
//! smoothing over overlapping subarrays; Hermitian eigenvectors ([`hermitian`]); noise subspace, searched on the unit
//! circle (MUSIC) or by the roots of its polynomial (root-MUSIC, [`roots`]); [`music`] holds plan, state and scratch. At what
//! frequency a source was heard within the band, [`frequency`] measures; what several bands give is joined in [`average`].
//!
//! A line cannot tell the two sides of itself apart: [`Azimuths::Mirror`] keeps both. Fixed memory: the scratch of 32
//! sensors takes 53 KiB, meant for a host or external memory.

pub mod average;
pub mod complex;
pub mod covariance;
pub mod frequency;
pub mod hermitian;
pub mod music;
pub mod roots;
mod turning;

pub use average::{JoinedArrival, MAX_FREQUENCIES, join};
pub use complex::{Complex, unit};
pub use frequency::Heard;
pub use music::{LineArrival, LineError, LinePlan, MusicMethod, Scratch, State};

use crate::angle::wrap_tau;
use crate::math::f64 as m;

/// Most sensors of a line.
pub const MAX_SENSORS: usize = 32;
/// Most sources told apart at once.
pub const MAX_SOURCES: usize = 4;

/// Where a bearing of a line points to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Azimuths {
    /// Right and left of the axis, radians clockwise from North in [0, 2π): one of them is the source.
    Mirror(f64, f64),
    /// Along the axis: both sides are one.
    Endfire(f64),
}

/// Azimuths of a sine `ξ` for an axis at azimuth `axis` (of rising sensor numbers) and `η = cos` of the elevation;
/// `None` where `|ξ/η| > 1` by more than rounding: no direction at that elevation gives it.
pub fn azimuths(sine: f64, axis: f64, eta: f64) -> Option<Azimuths> {
    let ratio = sine / eta;
    if !(m::abs(ratio) <= 1.0 + 1e-12) || !axis.is_finite() {
        return None;
    }
    let off = m::acos(ratio.clamp(-1.0, 1.0));
    if off == 0.0 || off == m::PI {
        return Some(Azimuths::Endfire(wrap_tau(axis + off)));
    }
    Some(Azimuths::Mirror(wrap_tau(axis + off), wrap_tau(axis - off)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_sides_are_kept() {
        let Some(Azimuths::Mirror(right, left)) = azimuths(0.5, 0.2, 1.0) else { panic!("two sides") };
        assert!((right - 0.2 - m::PI / 3.0).abs() < 1e-12);
        assert!((left - wrap_tau(0.2 - m::PI / 3.0)).abs() < 1e-12);
        assert_eq!(azimuths(1.0, 0.2, 1.0), Some(Azimuths::Endfire(0.2)));
        assert_eq!(azimuths(0.99, 0.2, 0.95), None);
        assert_eq!(azimuths(f64::NAN, 0.2, 1.0), None);
    }
}
