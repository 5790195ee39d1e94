//! What vessels of known track say of a station's horizontal components: turned, exchanged or reversed.
//!
//! A station alone cannot know: its world is then turned or mirrored, and vessels of a mirrored world are vessels. An
//! orientation that is off adds one angle to every azimuth; components exchanged, or one of them reversed, mirror the azimuths,
//! so that not the difference of true and measured azimuth stays the same but their sum: 2 o + 90° where o is the true azimuth
//! of the north component and the components are exchanged, 2 o + 180° where north is reversed, 2 o where east is.

use seabearing_core::angle::{wrap_pi, wrap_tau};
use seabearing_locate::orient::offset::{Offset, Residual, offset};
use std::f64::consts::{FRAC_PI_2, PI};

/// A mirrored world is believed where this much more of the azimuths supports it than supports a turned one.
const CLEARER: f64 = 0.15;

/// An orientation is off where it errs by this many standard deviations, and by more than this, rad (1°).
const SIGNIFICANT: f64 = 3.0;
const LEAST_OFF: f64 = PI / 180.0;

/// An azimuth and that of the one vessel near.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pairing {
    /// Where the vessel was, rad.
    pub truth: f64,
    /// What the station said, rad.
    pub measured: f64,
    /// Which passage it belongs to; in rising order.
    pub pass: u32,
}

/// What is wrong with the horizontal components.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Horizontals {
    /// North and east are exchanged.
    Exchanged,
    /// North is reversed.
    NorthReversed,
    /// East is reversed.
    EastReversed,
    /// North and east are exchanged, and both reversed.
    ExchangedAndReversed,
    /// Their orientation is off by this, rad.
    Turned(f64),
}

impl Horizontals {
    /// The name of the warning.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Exchanged => "HorizontalsExchanged",
            Self::NorthReversed => "NorthReversed",
            Self::EastReversed => "EastReversed",
            Self::ExchangedAndReversed => "HorizontalsExchangedAndReversed",
            Self::Turned(_) => "OrientationOff",
        }
    }

    /// The same in words, with what to do.
    pub fn text(&self) -> String {
        match self {
            Self::Exchanged => "the horizontal components are exchanged: exchange `north` and `east` in the station file".into(),
            Self::NorthReversed => "the north component has its sign turned round".into(),
            Self::EastReversed => "the east component has its sign turned round".into(),
            Self::ExchangedAndReversed => {
                "the horizontal components are exchanged and have their signs turned round: exchange `north` and `east`, and turn the orientation by 180°".into()
            }
            Self::Turned(by) => format!(
                "the orientation is off: add {:.1}° to `orientation_of_north_deg`",
                wrap_pi(*by).to_degrees()
            ),
        }
    }
}

/// What azimuths say against those of the vessels; `orientation` is the north component's, as configured, rad. `None` where all
/// is as configured, or too little is known.
pub fn doubt(pairings: &[Pairing], orientation: f64) -> Option<Horizontals> {
    let of = |angle: fn(&Pairing) -> f64| {
        let all: Vec<Residual> =
            pairings.iter().map(|p| Residual { angle: angle(p), pass: p.pass }).collect();
        offset(&all).ok()
    };
    let turned = of(|p| wrap_pi(p.truth - p.measured));
    let mirrored = of(|p| wrap_pi(p.truth + p.measured));
    // Both by the same measure: the share of azimuths within three times the smaller scale.
    let within = |found: &Option<Offset>, angle: fn(&Pairing) -> f64| {
        let scale =
            [&turned, &mirrored].iter().filter_map(|o| Some(o.as_ref()?.scale)).fold(f64::INFINITY, f64::min);
        let near = |o: &Offset| {
            pairings.iter().filter(|p| wrap_pi(angle(p) - o.offset).abs() < 3.0 * scale).count() as f64
        };
        found.as_ref().map_or(0.0, near) / pairings.len() as f64
    };
    let of_turned = within(&turned, |p| p.truth - p.measured);
    let of_mirrored = within(&mirrored, |p| p.truth + p.measured);
    if of_mirrored > of_turned + CLEARER {
        let quarters = (wrap_tau(mirrored?.offset - 2.0 * orientation) / FRAC_PI_2).round() as i64;
        return Some(match quarters.rem_euclid(4) {
            0 => Horizontals::EastReversed,
            1 => Horizontals::Exchanged,
            2 => Horizontals::NorthReversed,
            _ => Horizontals::ExchangedAndReversed,
        });
    }
    let turned = turned?;
    let by = wrap_pi(turned.offset);
    (by.abs() > LEAST_OFF.max(SIGNIFICANT * turned.sd)).then_some(Horizontals::Turned(by))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three passages heard by horizontal components of which `seen` says what they are: azimuth in their own frame.
    fn heard(orientation: f64, seen: impl Fn(f64) -> f64) -> Vec<Pairing> {
        (0..300u32)
            .map(|k| {
                let pass = k / 100;
                let truth = 1.9 * f64::from(pass) + 0.015 * f64::from(k % 100);
                let jitter = 0.03 * f64::from(k * 7919 % 101) / 50.0 - 0.03;
                let measured = orientation + seen(truth - orientation) + jitter;
                Pairing { truth, measured, pass }
            })
            .collect()
    }

    #[test]
    fn what_is_mirrored_is_named_and_what_is_right_is_not() {
        for orientation in [0.0, 1.34, -2.0] {
            let found = |seen: &dyn Fn(f64) -> f64| doubt(&heard(orientation, seen), orientation);
            assert_eq!(found(&|a| a), None);
            assert_eq!(found(&|a| FRAC_PI_2 - a), Some(Horizontals::Exchanged));
            assert_eq!(found(&|a| PI - a), Some(Horizontals::NorthReversed));
            assert_eq!(found(&|a| -a), Some(Horizontals::EastReversed));
            assert_eq!(found(&|a| -FRAC_PI_2 - a), Some(Horizontals::ExchangedAndReversed));
            let Some(Horizontals::Turned(by)) = found(&|a| a - 0.09) else { panic!("{orientation}") };
            assert!((by - 0.09).abs() < 0.01, "{by}");
        }
        assert_eq!(doubt(&[], 0.0), None);
    }
}
