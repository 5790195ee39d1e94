//! The azimuths and ranges of a minute as records.
//!
//! Enters: directions and modes of range of one minute, and what is not known of the station. Leaves, through the sink: `Azimuth` and `Range`
//! messages with deviations widened by errors that last; one of each that says so where nothing was detected.

use super::evidence::Evidence;
use super::impulsive::Call;
use super::lasting::{Lasting, widened};
use super::plan::Plan;
use super::presence::{RangeMode, RangePresence};
use super::tonal::{Directions, Mode};
use crate::wire::{Azimuth, Message, Range};

/// Modes lighter than this are not worth their bytes.
const LEAST_WEIGHT: f32 = 0.1;

/// Share of its vessel's posterior from which a mode is a measurement: below it another pair of paths is as good as one in ten
/// likely, and a stated spread of one mode would not hold the truth. Tracks weigh every mode.
const CLEAR_WEIGHT: f32 = 0.9;

/// Natural logarithm of the presence ratio, and standard deviation, rad (4.5 degrees), from which on a direction is a measurement. One just above the
/// threshold owes it in part to noise that pointed that way, and one that may be 10 degrees off is none: of such directions of vessels 10 dB
/// below the table's one in fourteen is. Tracks take them all.
const CLEAR_LOG: f32 = 10.5;
const CLEAR_SD: f32 = 0.079;

/// The same of a call's direction, rad (14 degrees): beside a louder vessel its bursts tell little.
const CALL_SD: f32 = 0.25;

/// Share of the band's bins from which on a direction is a measurement only where something was heard minutes ago, at the least and at the most. A vessel is heard
/// before its sound fills so much of the band, and from somewhere else, for it passes; a T phase or an earthquake fills it at once, out of silence, and is over.
/// Windows two minutes apart share a third of their frames.
const WIDEBAND: (usize, usize) = (1, 4);
const BEFORE: (u32, u32) = (2, 10);

/// Whether a direction is one of wideband sound before which, as of minute `k`, nothing was heard.
pub(super) fn is_sudden(m: &Mode, bins: usize, evidence: &Evidence, k: u32) -> bool {
    let mut heard = evidence.between_back(k.saturating_sub(BEFORE.1), k.saturating_sub(BEFORE.0));
    WIDEBAND.1 * usize::from(m.bins) >= WIDEBAND.0 * bins
        && !heard.any(|minute| minute.directions().next().is_some())
}

/// Whether a mode's range is a measurement.
fn is_clear(m: &RangeMode) -> bool {
    m.weight >= CLEAR_WEIGHT && m.sure
}

/// Radial speed of the vessel whose range is a measurement, m/s.
pub(super) fn clear_speed_m_s(ranges: &RangePresence) -> Option<f32> {
    let mut modes = ranges.modes.iter().flatten();
    modes.find(|m| ranges.log_odds > 0.0 && m.detected && is_clear(m)).map(|m| m.speed_m_s)
}

/// Sends the records of a minute, of its range so many modes, and says how many; while pairs of paths are in doubt no range is told as
/// detected, and no direction that is sudden ([`is_sudden`], of no vessel that is known otherwise).
pub(super) fn send(
    plan: &Plan<'_>,
    lasting: &Lasting,
    index: u64,
    directions: &Directions,
    is_sudden: impl Fn(&Mode) -> bool,
    call: Option<Call>,
    ranges: &RangePresence,
    pairs_in_doubt: bool,
    modes: usize,
    sink: &mut dyn FnMut(Message),
) -> u32 {
    let paper = plan.paper;
    let with_lasting = |azimuth: f32, sd: f32| widened(sd, lasting.of_direction(f64::from(azimuth)));
    let is_clear_direction = |m: &Mode| m.log_presence > CLEAR_LOG && m.sd < CLEAR_SD && !is_sudden(m);
    let is_told = |m: &Mode| if paper { m.log_presence > 0.0 } else { is_clear_direction(m) };
    let tonal = || directions.modes.iter().flatten().filter(|m| !m.impulsive);
    let total = tonal().count() as f32;
    for m in tonal() {
        sink(Message::Azimuth(Azimuth {
            index,
            azimuth: m.azimuth,
            sd: with_lasting(m.azimuth, m.sd),
            log_presence: m.log_presence,
            weight: 1.0 / total,
            detected: is_told(m),
            kind: 0,
        }));
    }
    if let Some(c) = call {
        let Call { azimuth, sd, log_presence, .. } = c;
        sink(Message::Azimuth(Azimuth {
            index,
            azimuth,
            sd: with_lasting(azimuth, sd),
            log_presence,
            weight: 1.0,
            detected: sd < CALL_SD,
            kind: 1,
        }));
    } else if total == 0.0 {
        sink(Message::Azimuth(Azimuth {
            index,
            azimuth: 0.0,
            sd: f32::INFINITY,
            log_presence: directions.log_presence,
            weight: 0.0,
            detected: false,
            kind: 0,
        }));
    }
    let detected = ranges.log_odds > 0.0 && !pairs_in_doubt;
    let mut ranges_sent = 0;
    let worth = |k: usize, m: &RangeMode| m.detected && (k == 0 || m.weight >= LEAST_WEIGHT);
    for (_, m) in ranges.modes.iter().flatten().enumerate().filter(|(k, m)| worth(*k, m)).take(modes) {
        ranges_sent += 1;
        let (of_range, of_speed) = lasting.of_range(f64::from(m.range_m), f64::from(m.speed_m_s));
        sink(Message::Range(Range {
            index,
            range_m: m.range_m,
            sd_range_m: widened(m.sd_range_m, of_range),
            speed_m_s: m.speed_m_s,
            sd_speed_m_s: widened(m.sd_speed_m_s, of_speed),
            log_presence: ranges.log_odds,
            weight: m.weight,
            detected: detected && (paper || is_clear(m)),
        }));
    }
    if ranges_sent == 0 {
        sink(Message::Range(Range {
            index,
            range_m: 0.0,
            sd_range_m: f32::INFINITY,
            speed_m_s: 0.0,
            sd_speed_m_s: f32::INFINITY,
            log_presence: ranges.log_odds,
            weight: 0.0,
            detected: false,
        }));
    }
    let azimuths = tonal().count() + usize::from(call.is_some());
    azimuths.max(1) as u32 + ranges_sent.max(1)
}

#[cfg(test)]
mod tests {
    use super::super::evidence::Minute;
    use super::*;
    use std::boxed::Box;
    use std::vec::Vec;

    /// A direction of lines.
    const MODE: Mode =
        Mode { azimuth: 1.0, sd: 0.03, log_presence: 12.0, bins: 5, step: 0, impulsive: false, moved: None };

    /// Nothing heard.
    const SILENT: RangePresence =
        RangePresence { log_odds: -5.0, log_evidence: 0.0, approaching: 0.5, modes: [None; 4] };

    /// What is told as detected of directions and ranges.
    fn detected(directions: &Directions, ranges: &RangePresence) -> Vec<bool> {
        let (plan, mut out) = (Box::new(Plan { rate_hz: 50.0, ..Plan::EMPTY }), Vec::new());
        send(
            &plan,
            &plan.lasting,
            0,
            directions,
            |m| m.bins > 100,
            None,
            ranges,
            false,
            2,
            &mut |m| match m {
                Message::Azimuth(a) => out.push(a.detected),
                Message::Range(r) => out.push(r.detected),
                _ => {}
            },
        );
        out
    }

    #[test]
    fn a_direction_is_told_as_detected_where_it_is_clear_and_close() {
        let told = |log_presence: f32, sd: f32, bins: u16| {
            let modes = [Some(Mode { sd, log_presence, bins, ..MODE }), None, None];
            let log_below = f32::NEG_INFINITY;
            let directions = Directions { modes, log_presence, log_below, frames: 17 };
            detected(&directions, &SILENT)[0]
        };
        assert!(told(12.0, 0.03, 5) && !told(10.0, 0.03, 5) && !told(12.0, 0.1, 5) && !told(12.0, 0.03, 120));
    }

    #[test]
    fn wideband_sound_is_sudden_until_it_was_heard_for_minutes() {
        let mut evidence = Box::new(Evidence::new());
        let sudden = |evidence: &Evidence, bins: u16, k: u32| {
            is_sudden(&Mode { azimuth: 3.0, bins, ..MODE }, 266, evidence, k)
        };
        assert!(sudden(&evidence, 200, 10) && !sudden(&evidence, 20, 10));
        // Lines were heard in minute 10 alone, from elsewhere.
        let modes = [Some(MODE), None, None];
        let heard = Directions { modes, log_presence: 12.0, log_below: f32::NEG_INFINITY, frames: 17 };
        evidence.push(Minute::new(10, &heard, &SILENT));
        for (k, want) in [(11, true), (12, false), (20, false), (21, true)] {
            assert_eq!(sudden(&evidence, 200, k), want, "{k}");
        }
    }

    #[test]
    fn a_range_is_told_as_detected_where_its_place_holds_nine_tenths() {
        let told = |weight: f32, sure: bool| {
            let mode = RangeMode {
                range_m: 12_000.0,
                sd_range_m: 60.0,
                speed_m_s: 4.0,
                sd_speed_m_s: 0.4,
                weight,
                support: 20.0,
                detected: true,
                tracked: false,
                sure,
            };
            let modes = [Some(mode), None, None, None];
            let nothing =
                Directions { modes: [None; 3], log_presence: 0.0, log_below: f32::NEG_INFINITY, frames: 17 };
            detected(&nothing, &RangePresence { log_odds: 5.0, modes, ..SILENT })[1]
        };
        assert!(told(0.95, true) && !told(0.85, true) && !told(0.95, false));
    }
}
