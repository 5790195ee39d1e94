//! Counters for Prometheus (text format 0.0.4) at `/metrics`.

use crate::report::{is_of_recorder, utc};
use anyhow::{Context, Result};
use axum::http::header::CONTENT_TYPE;
use axum::{Router, routing::get};
use seabearing_base::feed::Feed;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::net::{SocketAddr, TcpListener};
use std::sync::{Arc, Mutex, PoisonError};

/// Records that wait to be counted.
const WAITING: usize = 50_000;
/// Numbers of `health` records that are handed on: the field, and its help.
const HEALTH: [(&str, &str); 7] = [
    ("processed", "Sample instants used since the recorder's start"),
    ("lost_gap", "Sample instants missing"),
    ("lost_invalid", "Sample instants without a code"),
    ("lost_clipped", "Sample instants lost to clipping"),
    ("lost_dead_channel", "Sample instants lost to dead channels"),
    ("records", "Records the recorder has sent"),
    ("frames_dropped", "Records it dropped because the line was full"),
];

/// Numbers of `margins` records that are handed on.
const MARGINS: [(&str, &str); 8] = [
    ("memory_bytes", "Memory that the stack may fill"),
    ("memory_free_bytes", "How much of it was never used since the start"),
    ("longest_s", "The longest work on one block of samples"),
    ("waiting", "Records that wait on the recorder"),
    ("room", "Records for which the recorder has room"),
    ("supply_v", "The processor's supply"),
    ("battery_v", "The cell that keeps the clock"),
    ("temperature_c", "Temperature of the processor"),
];

/// What is counted of a station.
#[derive(Clone, Debug, Default)]
struct Station {
    records: BTreeMap<String, u64>,
    heard_s: Option<f64>,
    up: Option<bool>,
    lost: u64,
    faults: BTreeMap<String, u64>,
    sd_utc_s: Option<f64>,
    health: [Option<f64>; HEALTH.len()],
    dead_channels: Option<usize>,
    margins: [Option<f64>; MARGINS.len()],
}

/// All counters.
#[derive(Clone, Debug, Default)]
pub struct Counters {
    stations: BTreeMap<Option<u64>, Station>,
    /// Alarms that stand, by number: their code and whether a person has seen them.
    alarms: BTreeMap<u64, (String, bool)>,
    missed: u64,
}

impl Counters {
    /// Counts a record.
    pub fn take(&mut self, record: &Value) {
        let kind = record["type"].as_str().unwrap_or("unknown");
        if kind == "acknowledge" {
            return;
        }
        if kind == "alarm" {
            self.stand(record);
        }
        let station = self.stations.entry(record["station"].as_u64()).or_default();
        *station.records.entry(kind.to_owned()).or_default() += 1;
        if is_of_recorder(kind) {
            station.heard_s = utc(&record["received_utc"]).or(station.heard_s);
        }
        match kind {
            "line" => station.up = Some(record["state"] == "up"),
            "lost" => station.lost += record["frames"].as_u64().unwrap_or(0),
            "fault" | "warning" => {
                *station.faults.entry(record["code"].as_str().unwrap_or("").to_owned()).or_default() += 1
            }
            "time" => station.sd_utc_s = record["sd_utc_s"].as_f64(),
            "health" => {
                station.health = HEALTH.map(|(field, _)| record[field].as_f64());
                station.dead_channels = record["dead_channels"].as_array().map(Vec::len);
            }
            "margins" => station.margins = MARGINS.map(|(field, _)| record[field].as_f64()),
            _ => {}
        }
    }

    /// Takes an alarm, of now or of before this began, without counting it.
    pub fn stand(&mut self, alarm: &Value) {
        let Some(id) = alarm["id"].as_u64() else { return };
        let code = alarm["code"].as_str().unwrap_or("").to_owned();
        match alarm["state"].as_str() {
            Some("cleared") => drop(self.alarms.remove(&id)),
            state => drop(self.alarms.insert(id, (code, state == Some("acknowledged")))),
        }
    }

    /// As Prometheus reads it.
    pub fn text(&self) -> String {
        let mut out = String::new();
        // Writing into a string cannot fail.
        let _ = self.write(&mut out);
        out
    }

    fn write(&self, out: &mut String) -> std::fmt::Result {
        let name = |of: &Option<u64>| of.map_or_else(|| "unknown".to_owned(), |n| n.to_string());
        let mut family = |name: &str, kind: &str, help: &str, lines: Vec<(String, f64)>| {
            if lines.is_empty() {
                return Ok(());
            }
            writeln!(out, "# HELP seabearing_{name} {help}.\n# TYPE seabearing_{name} {kind}")?;
            lines.iter().try_for_each(|(labels, value)| writeln!(out, "seabearing_{name}{labels} {value}"))
        };
        let of = |value: &dyn Fn(&Station) -> Option<f64>| {
            let line =
                |(n, s): (&Option<u64>, &Station)| Some((format!("{{station=\"{}\"}}", name(n)), value(s)?));
            self.stations.iter().filter_map(line).collect::<Vec<_>>()
        };
        let by = |label: &str, counts: &dyn Fn(&Station) -> &BTreeMap<String, u64>| {
            let lines = self.stations.iter().flat_map(|(n, s)| {
                counts(s).iter().map(move |(key, count)| (n, key, *count as f64)).collect::<Vec<_>>()
            });
            lines
                .map(|(n, key, count)| {
                    // What another base station tells of may be called anything.
                    let key = key.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n");
                    (format!("{{station=\"{}\",{label}=\"{key}\"}}", name(n)), count)
                })
                .collect()
        };
        family("records_total", "counter", "Records stored", by("type", &|s| &s.records))?;
        family("faults_total", "counter", "Faults told by recorders", by("code", &|s| &s.faults))?;
        family("records_lost_total", "counter", "Records that never came", of(&|s| Some(s.lost as f64)))?;
        family("heard_timestamp_seconds", "gauge", "When the station was last heard", of(&|s| s.heard_s))?;
        family(
            "line_up",
            "gauge",
            "Whether the station's line is up",
            of(&|s| s.up.map(|up| f64::from(u8::from(up)))),
        )?;
        family("utc_sd_seconds", "gauge", "Standard deviation of the station's UTC", of(&|s| s.sd_utc_s))?;
        family(
            "dead_channels",
            "gauge",
            "Channels dead or left out",
            of(&|s| s.dead_channels.map(|n| n as f64)),
        )?;
        for (k, (field, help)) in HEALTH.iter().enumerate() {
            family(&format!("health_{field}"), "gauge", help, of(&|s| s.health[k]))?;
        }
        for (k, (field, help)) in MARGINS.iter().enumerate() {
            family(&format!("margins_{field}"), "gauge", help, of(&|s| s.margins[k]))?;
        }
        let mut alarms: BTreeMap<(&str, bool), u64> = BTreeMap::new();
        for (code, seen) in self.alarms.values() {
            *alarms.entry((code, *seen)).or_default() += 1;
        }
        let lines = alarms
            .iter()
            .map(|((code, seen), n)| (format!("{{code=\"{code}\",acknowledged=\"{seen}\"}}"), *n as f64));
        family("alarms", "gauge", "Alarms that stand", lines.collect())?;
        family(
            "records_missed_total",
            "counter",
            "Records these counters missed",
            vec![(String::new(), self.missed as f64)],
        )
    }
}

/// Counts what a feed brings and serves it, and after it what others count (`more`, text of the same format); gives the address
/// listened at. `standing`: the alarm records of before, oldest first.
///
/// # Errors
/// The address cannot be listened at.
pub fn serve(
    at: &str,
    feed: &Feed,
    standing: &[Value],
    more: impl Fn() -> String + Clone + Send + Sync + 'static,
) -> Result<SocketAddr> {
    let listener = TcpListener::bind(at).with_context(|| format!("--metrics {at}: cannot listen"))?;
    let address = listener.local_addr()?;
    listener.set_nonblocking(true)?;
    let mut counters = Counters::default();
    standing.iter().for_each(|alarm| counters.stand(alarm));
    let counters = Arc::new(Mutex::new(counters));
    let (records, counted) = (feed.subscribe(WAITING), Arc::clone(&counters));
    std::thread::spawn(move || {
        while let Some(taken) = records.take() {
            let mut counters = counted.lock().unwrap_or_else(PoisonError::into_inner);
            counters.missed += taken.missed as u64;
            taken.records.iter().for_each(|record| counters.take(record));
        }
    });
    let text = move || {
        let text = counters.lock().unwrap_or_else(PoisonError::into_inner).text() + &more();
        std::future::ready(([(CONTENT_TYPE, "text/plain; version=0.0.4")], text))
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build()?;
    std::thread::spawn(move || {
        runtime.block_on(async {
            let Ok(listener) = tokio::net::TcpListener::from_std(listener) else { return };
            // It ends with the program.
            let _ = axum::serve(listener, Router::new().route("/metrics", get(text))).await;
        });
    });
    Ok(address)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::time::{Duration, Instant};

    #[test]
    fn counters_are_served_as_prometheus_reads_them() {
        let feed = Feed::default();
        let before = [(3, "raised"), (4, "raised"), (3, "acknowledged"), (4, "cleared")]
            .map(|(id, state)| json!({ "type": "alarm", "id": id, "state": state, "code": "ChannelSick" }));
        let address = serve("127.0.0.1:0", &feed, &before, || "seabearing_more 1\n".to_owned()).unwrap();
        feed.publish(vec![
            json!({ "type": "bearing", "station": 7, "received_utc": "1970-01-01T00:01:40Z" }),
            json!({ "type": "bearing", "station": 7, "received_utc": "1970-01-01T00:01:41Z" }),
            // What the base station says itself.
            json!({ "type": "lost", "station": 7, "frames": 3, "received_utc": "1970-01-01T00:02:00Z" }),
            json!({ "type": "network_track", "id": 1, "received_utc": "1970-01-01T00:02:00Z" }),
            json!({ "type": "a\"\n\\", "station": 8 }),
            json!({ "type": "alarm", "station": 7, "id": 1, "state": "raised", "code": "RecorderSilent" }),
            json!({ "type": "alarm", "station": 7, "id": 2, "state": "raised", "code": "SupplyLow" }),
            json!({ "type": "alarm", "station": 7, "id": 2, "state": "cleared", "code": "SupplyLow" }),
        ]);
        let begun = Instant::now();
        let text = loop {
            let answer = minreq::get(format!("http://{address}/metrics")).with_timeout(5).send().unwrap();
            let kind = answer.headers.iter().find(|(name, _)| name.eq_ignore_ascii_case("content-type"));
            assert!(kind.is_some_and(|(_, kind)| kind.starts_with("text/plain; version=0.0.4")), "{kind:?}");
            let text = answer.as_str().unwrap().to_owned();
            if text.contains("alarms{code=\"RecorderSilent") || begun.elapsed() > Duration::from_secs(5) {
                break text;
            }
        };
        for line in [
            "# TYPE seabearing_records_total counter",
            "seabearing_records_total{station=\"7\",type=\"bearing\"} 2",
            "seabearing_records_lost_total{station=\"7\"} 3",
            r#"seabearing_records_total{station="8",type="a\"\n\\"} 1"#,
            "seabearing_heard_timestamp_seconds{station=\"7\"} 101",
            "seabearing_alarms{code=\"RecorderSilent\",acknowledged=\"false\"} 1",
            "seabearing_alarms{code=\"ChannelSick\",acknowledged=\"true\"} 1",
            "seabearing_more 1",
        ] {
            assert!(text.lines().any(|l| l == line), "{line} is missing in\n{text}");
        }
        assert!(!text.contains("heard_timestamp_seconds{station=\"unknown"), "{text}");
        assert!(
            !text.contains("ChannelSick\",acknowledged=\"false")
                && !text.contains("records_total{station=\"unknown\",type=\"alarm")
        );
        assert!(!text.contains("SupplyLow\",ack") && text.ends_with('\n'));
        assert_eq!(
            minreq::get(format!("http://{address}/")).with_timeout(5).send().unwrap().status_code,
            404
        );
    }
}
