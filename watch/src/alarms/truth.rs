//! What is so of a rule, and what a record of a recorder says of it.

use super::About;
use serde_json::Value;
use std::collections::BTreeSet;

/// What is so of a rule.
#[derive(Clone, Debug)]
pub(super) struct Truth {
    /// `None`: nobody knows, and all stays as it is.
    pub(super) is: Option<bool>,
    pub(super) code: &'static str,
    pub(super) text: String,
    pub(super) probability: Option<f64>,
}

impl Truth {
    pub(super) fn yes(code: &'static str, text: String) -> Self {
        Self { is: Some(true), code, text, probability: None }
    }

    pub(super) fn over(why: &str) -> Self {
        Self { is: Some(false), code: "", text: why.to_owned(), probability: None }
    }

    pub(super) fn unknown() -> Self {
        Self { is: None, code: "", text: String::new(), probability: None }
    }
}

/// Channels that a record says are sick, or well.
pub(super) fn channels(station: u16, kind: &str, fault: &str, record: &Value) -> Vec<(About, Truth)> {
    let about = |channel: u8| About::Channel(station, channel);
    let sick = |channel: u8, how: &str| {
        (about(channel), Truth::yes("ChannelSick", format!("station {station}: channel {channel} {how}")))
    };
    let value = record["value"].as_u64().and_then(|c| u8::try_from(c).ok());
    match (kind, fault, value) {
        (_, "DeadChannel", Some(c)) => vec![sick(c, "is dead")],
        (_, "OwnNoise", Some(c)) => vec![sick(c, "does not hear what the others hear")],
        (_, "Inverted", Some(c)) => vec![sick(c, "has the sign of the others turned round")],
        (_, "Leaking", Some(c)) => vec![sick(c, "holds some of another's signal")],
        (_, "ChannelBack", Some(c)) => vec![(about(c), Truth::over("it is back"))],
        ("health", ..) => {
            let dead: BTreeSet<u8> = record["dead_channels"]
                .as_array()
                .into_iter()
                .flatten()
                .filter_map(|c| u8::try_from(c.as_u64()?).ok())
                .collect();
            (0..4u8)
                .map(|c| {
                    if dead.contains(&c) {
                        sick(c, "is dead or left out")
                    } else {
                        (about(c), Truth::over("it is well"))
                    }
                })
                .collect()
        }
        _ => Vec::new(),
    }
}

/// Whether a recorder has ended for want of supply.
pub(super) fn supply(station: u16, kind: &str, fault: &str, record: &Value) -> Option<Truth> {
    match (kind, fault) {
        (_, "SupplyLow") => {
            let text = format!("station {station}: the supply is below {} mV", record["value"]);
            Some(Truth::yes("SupplyLow", text))
        }
        ("hello" | "bearing" | "azimuth", _) => Some(Truth::over("it records again")),
        _ => None,
    }
}

/// Whether a recorder's full store drops records.
pub(super) fn storage(station: u16, kind: &str, record: &Value) -> Option<Truth> {
    match kind {
        "lost" if record["cause"].is_string() => {
            let text = format!(
                "station {station}: {} records lost: {}",
                record["frames"],
                record["cause"].as_str().unwrap_or("")
            );
            Some(Truth::yes("StorageFull", text))
        }
        "alarm" => None,
        // Nothing says that there is room: it is over when nothing is lost any more.
        _ => Some(Truth::over("nothing is lost any more")),
    }
}
