//! What is doubtful about a set-up, in words.

#[cfg(feature = "schema")]
use schemars::JsonSchema;
use seabearing_core::wire::{Fault, FaultCode};
use serde::Serialize;

/// Something is doubtful about a set-up.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(JsonSchema))]
pub struct Warning {
    /// What, by name.
    pub code: String,
    /// The same in words, with what to do.
    pub text: String,
    /// The number of a recorder's own finding (docs/wire.md).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub value: Option<i64>,
    /// Seconds since sample 0 of the session, of a recorder's own finding; null where the sample rate is unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub t_s: Option<f64>,
}

impl Warning {
    /// What a recorder finds doubtful about its own set-up; other faults are none.
    pub fn of(fault: &Fault) -> Option<Self> {
        let value = fault.value;
        let text = match fault.code {
            FaultCode::Reversed => {
                "pressure or motion has its sign turned round: vertical motion goes with pressure as it cannot for sound from above, or for \
                 earthquakes from below; until that is put right no azimuth and no track is told, for they may be half a turn off (look at the \
                 wiring, and at `intensity` in the station file)"
                    .to_owned()
            }
            FaultCode::SignInDoubt => {
                "vertical motion goes with pressure as it cannot for sound from above: a sign is turned round or channels are exchanged, and which \
                 is said once vessels have passed on all sides; until then no azimuth and no track is told (look at the wiring, at the order of \
                 the channels, and at `intensity` in the station file)"
                    .to_owned()
            }
            FaultCode::Exchanged => {
                let other = if value & 4 == 0 { "the vertical component" } else { "pressure" };
                let component = match value & 3 {
                    1 => "north",
                    2 => "east",
                    _ => "the vertical component",
                };
                format!(
                    "{other} and {component} stand for each other: look at the order of the channels; until then no azimuth and no track is told{}",
                    if value & 4 == 0 { "" } else { ", and no range as detected" }
                )
            }
            FaultCode::Unequal => format!(
                "the gain of north is {:.1} dB over that of east: look at `sensitivity` of both, and at the sensor's levelling; directions are told with that put right",
                value as f64 / 10.0
            ),
            FaultCode::GainInDoubt => format!(
                "north is {:.1} dB louder than east where no vessel is heard: a gain that is not as told, noise of one component alone, or noise along it, and whether it is a \
                 gain is known once vessels have passed; until then directions hold it for either (look at `sensitivity` of both, and at the sensor's levelling)",
                value as f64 / 10.0
            ),
            FaultCode::TableOff => format!(
                "two pairs of paths put one vessel at ranges {value} m apart: look at the propagation table's depth and sound speed \
                 (`propagation fit`); until then no range is told as detected, and tracks hold half of their range and speed for uncertain"
            ),
            FaultCode::SpeedContradicted => format!(
                "a vessel's elevations or its shaft rate tell {:.1} m/s, far from the speed that `[tracking]` in the station file declares; \
                 its track goes by what it shows, and is as uncertain as the two are apart (is `depth_m` right?)",
                value as f64 / 100.0
            ),
            FaultCode::SetUpGood => {
                let over = FaultCode::ALL.iter().find(|code| **code as i64 == value);
                over.map_or_else(
                    || "what was doubtful is so no more".to_owned(),
                    |code| format!("{code:?} is so no more"),
                )
            }
            _ => return None,
        };
        Some(Self { code: format!("{:?}", fault.code), text, value: Some(value), t_s: None })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::RecordFormat;
    use seabearing_core::utc::Times;
    use seabearing_core::wire::Message;

    #[test]
    fn what_a_recorder_doubts_of_its_set_up_is_a_warning_in_words() {
        let records = RecordFormat { rate_hz: 50.0, start: None, times: Times::default() };
        let said = |code, value| records.json(&Message::Fault(Fault { code, index: 100, value }));
        let unequal = said(FaultCode::Unequal, -31);
        assert_eq!((&unequal["type"], &unequal["code"]), (&"warning".into(), &"Unequal".into()), "{unequal}");
        assert_eq!((&unequal["t_s"], &unequal["value"]), (&2.0.into(), &(-31).into()), "{unequal}");
        assert!(unequal["text"].as_str().unwrap().contains("-3.1 dB"), "{unequal}");
        let open = said(FaultCode::GainInDoubt, 24)["text"].as_str().unwrap().to_owned();
        assert!(open.starts_with("north is 2.4 dB louder"), "{open}");
        for (value, words) in [
            (2, "the vertical component and east"),
            (5, "pressure and north"),
            (7, "pressure and the vertical component"),
        ] {
            let text = said(FaultCode::Exchanged, value)["text"].as_str().unwrap().to_owned();
            assert!(text.starts_with(words), "{text}");
        }
        let good = said(FaultCode::SetUpGood, FaultCode::Reversed as i64);
        assert_eq!(good["text"], "Reversed is so no more");
        assert_eq!(said(FaultCode::Gap, 3)["type"], "fault");
    }
}
