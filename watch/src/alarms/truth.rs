//! What is so of a rule, and what a record of a recorder says of it.

use super::About;
use super::rules::Limits;
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
        // It begins a new session when its supply is good. Bearings of before may come later.
        ("hello", _) if record["kind"] != "waiting" => Some(Truth::over("it records again")),
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

/// A limit is kept again only so far away from it.
const AWAY: f64 = 0.02;

/// Whether a recorder's margins are smaller than they should be; between a limit and 2 % more nothing changes.
pub(super) fn margin(station: u16, limits: &Limits, record: &Value) -> Truth {
    let number = |key: &str| record[key].as_f64();
    let full = number("waiting").zip(number("room")).map(|(waiting, room)| 100.0 * waiting / room.max(1.0));
    // What it is, in which unit; its value, the limit, and whether that is the least one.
    let watched = [
        ("the supply is", " V", number("supply_v"), limits.supply_v, true),
        ("the clock's cell has", " V", number("battery_v"), limits.cell_v, true),
        ("memory never used is", " bytes", number("memory_free_bytes"), limits.memory_bytes, true),
        ("what waits fills", " % of its room", full, limits.full_percent, false),
        ("the processor has", " °C", number("temperature_c"), limits.temperature_c, false),
    ];
    let mut near = false;
    for (what, unit, value, limit, least) in watched {
        let Some(limit) = limit else { continue };
        // What could not be measured is not known.
        let Some(value) = value else { return Truth::unknown() };
        let beyond = |x: f64, limit: f64| if least { x < limit } else { x > limit };
        if beyond(value, limit) {
            let (value, than) = ((1000.0 * value).round() / 1000.0, if least { "below" } else { "above" });
            return Truth::yes(
                "MarginSmall",
                format!("station {station}: {what} {value}{unit}, {than} {limit}"),
            );
        }
        near |= beyond(value, limit * if least { 1.0 + AWAY } else { 1.0 - AWAY });
    }
    if near { Truth::unknown() } else { Truth::over("its margins are large enough") }
}

/// Whether a recorder's card takes no sound, or, where that is asked, is full. Faults that were held back count as others do.
pub(super) fn card(station: u16, of_full: bool, kind: &str, record: &Value) -> Option<Truth> {
    let fault =
        if matches!(kind, "fault" | "faults_held") { record["code"].as_str().unwrap_or("") } else { "" };
    let why = match record["value"].as_u64().unwrap_or(0) & 0xff {
        1 => "there is no card",
        2 => "the card is not prepared",
        3 => "the card answers with errors",
        4 => "the card is too slow",
        _ => "the card takes no sound",
    };
    // An answer to `Identify` has no reason of a start.
    const ANSWER: u64 = 255;
    let starts = kind == "hello" && record["reset_cause"] != ANSWER && record["kind"] != "waiting";
    match (fault, of_full) {
        ("CardFull", true) => Some(Truth::yes("CardFull", format!("station {station}: the card is full"))),
        ("CardFull", false) => Some(Truth::over("the card is full")),
        ("CardFailed", false) => Some(Truth::yes("CardFailed", format!("station {station}: {why}"))),
        ("CardBack", _) => Some(Truth::over("it takes sound again")),
        // A new start says anew what is wrong with its card.
        _ => starts.then(|| Truth::over("the recorder has started again")),
    }
}
