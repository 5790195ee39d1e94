//! Shaft rate inside the array recorder: the rate of the vessel's propeller, its speed by the station's curve, and whose it is.
//!
//! Enters: what the array chain's last analysis of the envelope said. Leaves: [`Message::ShaftRate`] while there is a rate,
//! and a measured speed for the track it belongs to. A rate is told at the recorder's next look at the time, so that its
//! place among the other messages does not depend on how samples are cut into blocks.

use crate::demon::{RateReport, Reading, SpeedCurve};
use crate::traffic;
use crate::wire::{Message, ShaftRate};

/// Tells a rate and gives its speed by the station's curve to the only vessel there is.
pub(super) fn tell(
    curve: Option<&SpeedCurve>,
    report: &RateReport,
    vessels: &mut traffic::State,
    sink: &mut dyn FnMut(&Message),
) {
    let RateReport { index, rate: Ok(rate) } = *report else { return };
    let speed = match curve.map(|curve| curve.speeds(&rate)) {
        Some([Some(one), None] | [None, Some(one)]) => Some(one),
        _ => None,
    };
    let (speed_m_s, sd_speed_m_s) =
        speed.map_or((f32::INFINITY, f32::INFINITY), |s| (s.mean_m_s as f32, s.sd_m_s as f32));
    let vessel = vessels.only_vessel().filter(|_| speed.is_some());
    let track = vessel.filter(|id| traffic::set_speed(vessels, *id, speed_m_s, sd_speed_m_s));
    sink(&Message::ShaftRate(ShaftRate {
        index,
        rate_hz: rate.rate_hz,
        sd_hz: rate.sd_hz,
        confidence: rate.confidence,
        ln_false_alarm: rate.ln_false_alarm,
        harmonics: rate.harmonics,
        blades: match rate.reading {
            Reading::ShaftWithBlades(blades) => blades,
            Reading::ShaftOrBlade => 0,
        },
        speed_m_s,
        sd_speed_m_s,
        track: track.unwrap_or(0),
    }));
}
