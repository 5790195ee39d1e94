//! A record on its way over a broker: as `--json` prints it, and beside that what another base station needs to keep it as it
//! was kept here.

use anyhow::{Context, Result, bail};
use seabearing_base::record::Origin;
use seabearing_base::relay::Relayed;
use seabearing_base::store::Numbered;
use serde::Deserialize;
use serde_json::{Value, json};

/// What stands for a station that is not known, or in records that are of none.
const NONE: &str = "none";
/// Greatest number of a record in a store.
const MOST: u64 = i64::MAX as u64;

/// Topic below the prefix of a record: `STATION/TYPE`.
pub fn topic(record: &Value) -> String {
    let station = record["station"].as_u64().map_or_else(|| NONE.to_owned(), |n| n.to_string());
    format!("{station}/{}", record["type"].as_str().unwrap_or("unknown"))
}

/// Topic below the prefix at which the last of such records is retained, if it is: `STATION/state/TYPE`, and of an alarm
/// `STATION/alarms/ID`. With it whether it stands; what stands no more is removed there.
pub fn retained(record: &Value) -> Option<(String, bool)> {
    let station = record["station"].as_u64().map_or_else(|| NONE.to_owned(), |n| n.to_string());
    match record["type"].as_str()? {
        "alarm" => {
            let (base, id) = (&record["relay"]["base"], record["id"].as_u64()?);
            let base = base.as_str().unwrap_or(NONE);
            Some((format!("{station}/alarms/{base}-{id}"), record["state"] != "cleared"))
        }
        kind @ ("hello" | "health" | "line" | "time") => Some((format!("{station}/state/{kind}"), true)),
        _ => None,
    }
}

/// A record of a store as it is published. `base`: what the base station is called, `log`: its store.
///
/// # Errors
/// There is no memory for it.
pub fn record(record: &Numbered, base: &str, log: u64) -> Result<Value> {
    let Numbered { number, row, rate_hz } = record;
    let relayed = Relayed::of(row, log, *number as u64, *rate_hz);
    let packed = postcard::to_stdvec(&relayed).context("a record cannot be packed")?;
    let mut out = row.json(*rate_hz);
    out["relay"] =
        json!({ "base": base, "log": format!("{log:016x}"), "number": number, "packed": hex(&packed) });
    if let Some(Origin { log, number }) = row.origin {
        out["relay"]["origin"] = json!({ "log": format!("{log:016x}"), "number": number });
    }
    Ok(out)
}

#[derive(Deserialize)]
struct Envelope<'a> {
    #[serde(borrow)]
    relay: Relay<'a>,
}

#[derive(Deserialize)]
struct Relay<'a> {
    packed: &'a str,
}

/// What a published record holds for another base station.
///
/// # Errors
/// It is no record that a base station has published.
pub fn relayed(payload: &[u8]) -> Result<Relayed> {
    let envelope: Envelope<'_> = serde_json::from_slice(payload).context("no record of a base station")?;
    let packed =
        bytes(envelope.relay.packed).context("no record of a base station: `relay.packed` is no hex")?;
    let relayed: Relayed =
        postcard::from_bytes(&packed).context("no record of a base station: `relay.packed` is damaged")?;
    if !(1..=MOST).contains(&relayed.number) {
        bail!("no record of a base station: no store has a record {}", relayed.number);
    }
    Ok(relayed)
}

fn hex(bytes: &[u8]) -> String {
    let digit = |n: u8| char::from_digit(n.into(), 16).unwrap_or('0');
    bytes.iter().flat_map(|b| [digit(b >> 4), digit(b & 15)]).collect()
}

fn bytes(hex: &str) -> Option<Vec<u8>> {
    let digit = |d: u8| char::from(d).to_digit(16).map(|d| d as u8);
    let (pairs, rest) = hex.as_bytes().as_chunks::<2>();
    let pair = |[high, low]: &[u8; 2]| Some(digit(*high)? << 4 | digit(*low)?);
    rest.is_empty().then(|| pairs.iter().map(pair).collect())?
}

#[cfg(test)]
mod tests {
    use super::*;
    use seabearing_base::record::{Body, Row};
    use seabearing_core::wire::{End, Message};

    fn numbered(station: Option<u16>, body: Body) -> Numbered {
        let utc = Some((1_790_000_000_250_001, Some(0.1 + 0.2)));
        let row = Row {
            origin: None,
            station,
            session: Some(3),
            sequence: Some(9),
            utc,
            received_us: Some(-5),
            body,
        };
        Numbered { number: 12, row, rate_hz: Some(1000.1) }
    }

    #[test]
    fn a_record_comes_out_as_it_went_in_to_the_last_bit() {
        for body in [
            Body::Message(Message::End(End { index: 100, frames: 7 })),
            Body::Said(json!({ "type": "lost", "frames": 3 })),
        ] {
            let sent = numbered(Some(7), body.clone());
            let published = record(&sent, "pier", 0xfeed_0000_0000_0001).unwrap();
            assert_eq!(published["station"], 7);
            assert_eq!(published["relay"]["log"], "feed000000000001");
            let came = relayed(published.to_string().as_bytes()).unwrap();
            assert_eq!(came, Relayed::of(&sent.row, 0xfeed_0000_0000_0001, 12, Some(1000.1)));
            assert_eq!(Row::body(came.kind, &came.body).unwrap(), (body, None));
        }
        for number in [0, u64::MAX] {
            let sent = Relayed::of(&numbered(Some(7), Body::Said(json!({}))).row, 1, number, None);
            let packed = hex(&postcard::to_stdvec(&sent).unwrap());
            let wrong = json!({ "relay": { "packed": packed } }).to_string();
            assert!(relayed(wrong.as_bytes()).is_err(), "{number}");
        }
        for wrong in [
            "",
            "{}",
            r#"{"relay":{"packed":"0g"}}"#,
            r#"{"relay":{"packed":"abc"}}"#,
            r#"{"relay":{"packed":"00"}}"#,
        ] {
            assert!(relayed(wrong.as_bytes()).is_err(), "{wrong}");
        }
    }

    #[test]
    fn topics_name_station_and_type_and_the_last_state_is_retained_elsewhere() {
        assert_eq!(topic(&json!({ "type": "bearing", "station": 7 })), "7/bearing");
        assert_eq!(topic(&json!({ "type": "network_track", "station": null })), "none/network_track");
        assert_eq!(retained(&json!({ "type": "bearing", "station": 7 })), None);
        let line = json!({ "type": "line", "station": 7, "state": "down" });
        assert_eq!(retained(&line), Some(("7/state/line".to_owned(), true)));
        let mut alarm =
            json!({ "type": "alarm", "station": 7, "id": 4, "state": "raised", "relay": { "base": "b" } });
        assert_eq!(retained(&alarm), Some(("7/alarms/b-4".to_owned(), true)));
        alarm["state"] = "cleared".into();
        assert_eq!(retained(&alarm), Some(("7/alarms/b-4".to_owned(), false)));
    }
}
