//! What happened and when, for programs that show recordings: Raven, Audacity, PAMpal, and those that read QuakeML.
//!
//! In: records. Out: events with a beginning and an end, seconds since sample 0 and, where there is a clock, UTC: a track from
//! its first report to its last, a presence of a vessel, a call or T phase (an impulsive direction of an ocean-bottom station)
//! and a bearing, which are moments. What was withdrawn or not detected is no event.

use anyhow::{Result, bail};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// One of them.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Event {
    /// `track`, `presence`, `call` or `bearing`.
    pub kind: &'static str,
    /// What to write beside it.
    pub label: String,
    /// Seconds since sample 0.
    pub span_s: (f64, f64),
    /// UTC of both, where known.
    pub utc: Option<(OffsetDateTime, OffsetDateTime)>,
    /// Frequencies, where the record tells them, Hz.
    pub band_hz: Option<(f64, f64)>,
    /// Azimuth of the source and its standard deviation, degrees.
    pub azimuth_deg: Option<(f64, Option<f64>)>,
}

/// UTC of a time since sample 0, by a record's own time.
fn utc_of(record: &Value, at_s: f64) -> Option<OffsetDateTime> {
    let utc = OffsetDateTime::parse(record["utc"].as_str()?, &Rfc3339).ok()?;
    utc.checked_add(time::Duration::checked_seconds_f64(at_s - record["t_s"].as_f64()?)?)
}

fn event(record: &Value, kind: &'static str, label: String, span_s: (f64, f64)) -> Event {
    let utc = utc_of(record, span_s.0).zip(utc_of(record, span_s.1));
    Event { kind, label, span_s, utc, band_hz: None, azimuth_deg: None }
}

/// The events of records, in order of their beginnings.
pub(super) fn events(records: &[Value]) -> Vec<Event> {
    let key = |r: &Value| ["station", "session", "id"].map(|k| r[k].as_u64());
    let withdrawn: BTreeSet<_> = records.iter().filter(|r| r["stage"] == "withdrawn").map(key).collect();
    let mut tracks: BTreeMap<_, Event> = BTreeMap::new();
    let mut out = Vec::new();
    for r in records {
        let Some(t) = r["t_s"].as_f64() else { continue };
        let azimuth = r["azimuth_deg"].as_f64();
        match r["type"].as_str() {
            Some("track") if !withdrawn.contains(&key(r)) => {
                let label = format!("track {}", r["id"]);
                let track = tracks.entry(key(r)).or_insert_with(|| event(r, "track", label, (t, t)));
                track.span_s.1 = track.span_s.1.max(t);
                if let (Some(utc), Some(end)) = (&mut track.utc, utc_of(r, t)) {
                    utc.1 = utc.1.max(end);
                }
            }
            Some("segment") => {
                let (Some(start), Some(end)) = (r["start_s"].as_f64(), r["end_s"].as_f64()) else { continue };
                let label = format!("presence {}: {}", r["id"], r["kind"].as_str().unwrap_or("general"));
                out.push(event(r, "presence", label, (start, end)));
            }
            Some("azimuth") if r["detected"] == true && r["source"] == "impulsive" => {
                let Some(azimuth) = azimuth else { continue };
                let mut call = event(r, "call", format!("call from {azimuth:.0}°"), (t, t));
                call.azimuth_deg = Some((azimuth, r["sd_deg"].as_f64()));
                out.push(call);
            }
            Some("bearing") => {
                let Some(azimuth) = azimuth else { continue };
                let mut bearing = event(r, "bearing", format!("bearing {azimuth:.1}°"), (t, t));
                bearing.azimuth_deg = Some((azimuth, r["sd_azimuth_deg"].as_f64()));
                // 0 and 1 are sources of the whole band.
                let octave = r["band"].as_i64().filter(|b| (2..12).contains(b));
                let low_hz = octave.map(|b| 125.0 * f64::from(1u32 << (b - 2)));
                bearing.band_hz = low_hz.map(|low| (low, 2.0 * low));
                out.push(bearing);
            }
            Some("transient") => {
                let (Some(lasts), Some(peak)) = (r["duration_s"].as_f64(), r["peak_db"].as_f64()) else {
                    continue;
                };
                let kind = if r["kind"] == "burst" { "burst" } else { "impulse" };
                let from = azimuth.map_or_else(String::new, |a| format!(" from {a:.1}°"));
                let others = match r["count"].as_u64() {
                    Some(n) if n > 1 => format!(", strongest of {n}"),
                    _ => String::new(),
                };
                let mut transient =
                    event(r, kind, format!("{kind} {peak:.1} dB{from}{others}"), (t, t + lasts));
                transient.azimuth_deg = azimuth.map(|a| (a, r["sd_azimuth_deg"].as_f64()));
                out.push(transient);
            }
            _ => {}
        }
    }
    out.extend(tracks.into_values());
    out.sort_by(|a, b| a.span_s.0.total_cmp(&b.span_s.0));
    out
}

/// A Raven selection table: columns behind tabs, frequencies where they are known.
pub(super) fn raven(events: &[Event], out: &mut impl Write) -> Result<()> {
    let mut w = csv::WriterBuilder::new().delimiter(b'\t').from_writer(out);
    w.write_record([
        "Selection",
        "View",
        "Channel",
        "Begin Time (s)",
        "End Time (s)",
        "Low Freq (Hz)",
        "High Freq (Hz)",
        "Type",
        "Azimuth (deg)",
        "Annotation",
    ])?;
    for (n, e) in (1..).zip(events) {
        let (low, high) = e.band_hz.map_or_else(Default::default, |(l, h)| (format!("{l}"), format!("{h}")));
        let view = if e.band_hz.is_some() { "Spectrogram 1" } else { "Waveform 1" };
        w.write_record([
            format!("{n}"),
            view.to_owned(),
            "1".to_owned(),
            format!("{:.6}", e.span_s.0),
            format!("{:.6}", e.span_s.1),
            low,
            high,
            e.kind.to_owned(),
            e.azimuth_deg.map_or_else(String::new, |(a, _)| format!("{a:.2}")),
            e.label.clone(),
        ])?;
    }
    Ok(w.flush()?)
}

/// Audacity's labels, with the line of frequencies where they are known.
pub(super) fn audacity(events: &[Event], out: &mut impl Write) -> Result<()> {
    for e in events {
        writeln!(out, "{:.6}\t{:.6}\t{}", e.span_s.0, e.span_s.1, e.label)?;
        if let Some((low, high)) = e.band_hz {
            writeln!(out, "\\\t{low}\t{high}")?;
        }
    }
    Ok(())
}

/// Events by their UTC as PAMpal groups PAMGuard's detections by them (`mode = "time"`): `id`, `start`, `end`, `species`.
/// Moments are widened to the second they lie in.
pub(super) fn pamguard(events: &[Event], out: &mut impl Write) -> Result<()> {
    let mut w = csv::Writer::from_writer(out);
    w.write_record(["id", "start", "end", "species"])?;
    let second = time::macros::format_description!("[year]-[month]-[day] [hour]:[minute]:[second]");
    for (n, e) in (1..).zip(events) {
        let (from, to) = utc(e)?;
        let to = if to.nanosecond() > 0 || from == to { to + time::Duration::SECOND } else { to };
        w.write_record([
            format!("{}-{n}", e.kind),
            from.format(second)?,
            to.format(second)?,
            e.kind.to_owned(),
        ])?;
    }
    Ok(w.flush()?)
}

fn utc(e: &Event) -> Result<(OffsetDateTime, OffsetDateTime)> {
    let Some(utc) = e.utc else {
        bail!("`{}` at {:.1} s has no UTC: this format needs it", e.label, e.span_s.0)
    };
    Ok(utc)
}

/// What QuakeML takes: calls and T phases.
pub(super) fn picks(events: &[Event]) -> impl Iterator<Item = &Event> {
    events.iter().filter(|e| e.kind == "call")
}

/// Calls and T phases as picks of QuakeML 1.2 (basic event description), one event a pick; `seed_id` is the station's
/// `NET.STA[.LOC[.CHAN]]`.
pub(super) fn quakeml(events: &[Event], seed_id: &str, out: &mut impl Write) -> Result<()> {
    let mut codes = seed_id.split('.').map(escaped);
    let mut code = || codes.next().filter(|c| !c.is_empty());
    let (Some(network), Some(station)) = (code(), code()) else {
        bail!("{seed_id}: not a station; NET.STA, NET.STA.LOC or NET.STA.LOC.CHAN was expected")
    };
    let (location, channel) = (code(), code());
    let optional =
        |name: &str, c: &Option<String>| c.as_ref().map_or_else(String::new, |c| format!(" {name}=\"{c}\""));
    let waveform = format!(
        "<waveformID networkCode=\"{network}\" stationCode=\"{station}\"{}{}/>",
        optional("locationCode", &location),
        optional("channelCode", &channel)
    );
    writeln!(
        out,
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<q:quakeml xmlns:q=\"http://quakeml.org/xmlns/quakeml/1.2\" \
         xmlns=\"http://quakeml.org/xmlns/bed/1.2\">\n<eventParameters publicID=\"smi:local/seabearing/{network}.{station}\">"
    )?;
    for e in picks(events) {
        let at = utc(e)?.0;
        let name = format!("smi:local/seabearing/{network}.{station}/{}", at.unix_timestamp_nanos() / 1000);
        let azimuth = e.azimuth_deg.map_or_else(String::new, |(azimuth, sd)| {
            let sd = sd.map_or_else(String::new, |sd| format!("<uncertainty>{sd:.3}</uncertainty>"));
            format!("<backazimuth><value>{azimuth:.3}</value>{sd}</backazimuth>")
        });
        writeln!(
            out,
            "<event publicID=\"{name}/event\"><pick publicID=\"{name}/pick\"><time><value>{}</value></time>{waveform}{azimuth}\
             <evaluationMode>automatic</evaluationMode></pick></event>",
            at.format(&Rfc3339)?
        )?;
    }
    Ok(writeln!(out, "</eventParameters>\n</q:quakeml>")?)
}

/// Text as XML has it.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn records() -> Vec<Value> {
        let utc = "2024-05-01T09:00:10.5Z";
        vec![
            json!({"type": "bearing", "t_s": 2.5, "azimuth_deg": 12.25, "sd_azimuth_deg": 0.5, "band": 3}),
            json!({"type": "bearing", "t_s": 3.5, "azimuth_deg": null, "band": 0}),
            json!({"type": "track", "id": 1, "stage": "running", "t_s": 4.0, "utc": "2024-05-01T09:00:04Z"}),
            json!({"type": "track", "id": 2, "stage": "running", "t_s": 5.0}),
            json!({"type": "track", "id": 1, "stage": "final", "t_s": 9.0, "utc": "2024-05-01T09:00:09Z"}),
            json!({"type": "track", "id": 2, "stage": "withdrawn", "t_s": 9.0}),
            json!({"type": "azimuth", "t_s": 10.5, "utc": utc, "azimuth_deg": 200.0, "sd_deg": 4.0, "detected": true,
                   "source": "impulsive"}),
            json!({"type": "azimuth", "t_s": 10.5, "utc": utc, "azimuth_deg": 20.0, "detected": true, "source": "tonal"}),
            json!({"type": "transient", "t_s": 6.0, "kind": "burst", "duration_s": 0.5, "peak_db": 168.25, "azimuth_deg": 45.5,
                   "sd_azimuth_deg": 0.1, "count": 3}),
            json!({"type": "segment", "t_s": 10.5, "utc": utc, "id": 7, "start_s": 1.5, "end_s": 10.5, "kind": "leaving"}),
        ]
    }

    fn text(write: impl FnOnce(&[Event], &mut Vec<u8>) -> Result<()>, of: &[Event]) -> String {
        let mut out = Vec::new();
        write(of, &mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn events_have_spans_and_labels() {
        let all = events(&records());
        let told: Vec<_> = all.iter().map(|e| (e.kind, e.span_s)).collect();
        assert_eq!(
            told,
            [
                ("presence", (1.5, 10.5)),
                ("bearing", (2.5, 2.5)),
                ("track", (4.0, 9.0)),
                ("burst", (6.0, 6.5)),
                ("call", (10.5, 10.5))
            ]
        );
        let audacity = text(audacity, &all);
        assert!(audacity.contains("2.500000\t2.500000\tbearing 12.2°\n\\\t250\t500\n"), "{audacity}");
        let raven = text(raven, &all);
        let rows: Vec<Vec<&str>> = raven.lines().map(|l| l.split('\t').collect()).collect();
        assert!(raven.contains("burst 168.2 dB from 45.5°, strongest of 3"), "{raven}");
        assert!(rows.len() == 6 && rows.iter().all(|r| r.len() == 10), "{raven}");
        assert_eq!(rows[3][..7], ["3", "Waveform 1", "1", "4.000000", "9.000000", "", ""]);
        // The bearing has no UTC.
        assert!(pamguard(&all, &mut Vec::new()).unwrap_err().to_string().contains("bearing 12.2°"));
        let dated: Vec<Event> = all.into_iter().filter(|e| !["bearing", "burst"].contains(&e.kind)).collect();
        let pampal = text(pamguard, &dated);
        assert!(pampal.contains("presence-1,2024-05-01 09:00:01,2024-05-01 09:00:11,presence\n"), "{pampal}");
        let picks = text(|e, out| quakeml(e, "XX.S01.00", out), &dated);
        assert_eq!(picks.matches("<pick ").count(), 1);
        for part in [
            "<time><value>2024-05-01T09:00:10.5Z</value></time><waveformID networkCode=\"XX\" stationCode=\"S01\" locationCode=\"00\"/>",
            "<backazimuth><value>200.000</value><uncertainty>4.000</uncertainty></backazimuth>",
        ] {
            assert!(picks.contains(part), "{picks}");
        }
        assert!(quakeml(&dated, "S01", &mut Vec::new()).is_err());
    }
}
