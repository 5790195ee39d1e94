//! The base station's picture for a person: status, latest tracks, health and losses as text.

use super::{Base, Recorder};
use seabearing_core::wire::Track;
use std::fmt::Write;

/// Tracks shown.
const SHOWN: usize = 8;

/// The whole view, line by line, without escape codes.
pub fn text(base: &Base) -> String {
    let mut out = String::new();
    // Writing into a string cannot fail.
    let _ = fill(base, &mut out);
    out
}

/// Recorders shown with all that is known of them; more have a line each.
const FULL: usize = 2;

fn fill(base: &Base, out: &mut String) -> std::fmt::Result {
    let recorders: Vec<&Recorder> = base.recorders().collect();
    if recorders.is_empty() {
        writeln!(out, "station unknown (no Hello heard yet)")?;
    }
    writeln!(out, "stream   {}", base.counters())?;
    for recorder in &recorders {
        match recorders.len() {
            0..=FULL => full(recorder, out)?,
            _ => line(recorder, out)?,
        }
    }
    Ok(())
}

/// A recorder on one line.
fn line(recorder: &Recorder, out: &mut String) -> std::fmt::Result {
    let station = recorder.station.map_or_else(|| "unknown".to_owned(), |s| s.to_string());
    let heard = recorder.heard_us.map_or(serde_json::Value::Null, super::record::rfc3339);
    write!(out, "station {station:>7}  session {:>3}", recorder.session().unwrap_or(0))?;
    write!(out, "  heard {}  {} records", heard.as_str().unwrap_or("-"), recorder.records)?;
    writeln!(out, "  {} tracks  {} faults", recorder.tracks().count(), recorder.faults_in_all())
}

fn full(base: &Recorder, out: &mut String) -> std::fmt::Result {
    let session = base.session().unwrap_or(0);
    let rate = base.rate_hz(session).unwrap_or(f64::NAN);
    let at = |index: u64| time_s(index as f64 / rate);
    match base.hello() {
        Some(h) => writeln!(
            out,
            "station {}  {}  {} Hz  firmware {}.{}.{}  configuration {:016x}  session {}{}",
            h.station,
            match h.kind {
                0 => "array",
                1 => "ocean bottom",
                _ => "waits for commands",
            },
            h.rate_hz,
            h.version.0,
            h.version.1,
            h.version.2,
            h.config_hash,
            session,
            if base.ended() { "  ended" } else { "" }
        )?,
        None => writeln!(out, "station unknown (no Hello heard yet)")?,
    }
    if let Some((_, b)) = base.bearings().next_back() {
        writeln!(
            out,
            "bearing  {} azimuth {}° elevation {}° SNR {:.1} dB quality {:.2}",
            at(b.index),
            with_sd(deg(b.azimuth), deg(b.var_azimuth.sqrt())),
            with_sd(deg(b.elevation), deg(b.var_elevation.sqrt())),
            b.snr_db,
            b.quality
        )?;
    }
    if base.tracks().next().is_some() {
        writeln!(
            out,
            "{:>7} {:9} {:>10}  {:>16}  {:>15}  {:>14}  {:>12}  {:10}",
            "track", "state", "time", "CPA time (s)", "CPA range (m)", "heading (°)", "speed (m/s)", "side"
        )?;
    }
    for ((session, id), mut history) in base.tracks().rev().take(SHOWN) {
        let Some(t) = history.next_back() else { continue };
        writeln!(
            out,
            "{:>7} {:9} {:>10}  {:>16}  {:>15}  {:>14}  {:>12}  {:10}",
            format!("{session}.{id}"),
            t.stage_name(),
            at(t.index),
            with_sd(t.cpa_time_s, t.sd_cpa_time_s.into()),
            range(t),
            with_sd(deg(t.heading), deg(t.sd_heading)),
            with_sd(t.speed_m_s.into(), t.sd_speed_m_s.into()),
            if t.starboard { "starboard" } else { "port" }
        )?;
    }
    if let Some(h) = base.health() {
        let seconds = |n: u64| time_s(n as f64 / rate);
        let names = ["gaps", "overlaps", "invalid", "clipped", "dead channel", "remainders"];
        let losses: Vec<String> = names
            .iter()
            .zip(h.lost)
            .filter(|(_, n)| *n > 0)
            .map(|(name, n)| format!("{name} {}", seconds(n)))
            .collect();
        let losses = if losses.is_empty() { "nothing".to_owned() } else { losses.join(", ") };
        let levels: Vec<String> =
            h.level_half_db.iter().map(|l| format!("{:.1}", f64::from(*l) / 2.0)).collect();
        writeln!(
            out,
            "health   {} processed, lost {losses}; level {} dB re full scale; {} records, {} frames dropped",
            seconds(h.processed),
            levels.join(" "),
            h.records,
            h.frames_dropped
        )?;
        for channel in 0..4 {
            if h.channels >> channel & 1 == 1 {
                writeln!(out, "         channel {channel} is dead or stuck")?;
            }
            if h.channels >> (4 + channel) & 1 == 1 {
                writeln!(out, "         channel {channel} clips")?;
            }
        }
    }
    if base.faults_in_all() > 0 {
        let last: Vec<String> =
            base.faults().map(|f| format!("{:?} {} at {}", f.code, f.value, at(f.index))).collect();
        writeln!(out, "faults   {} in all; last: {}", base.faults_in_all(), last.join(", "))?;
    }
    Ok(())
}

fn range(t: &Track) -> String {
    if t.range_observable {
        with_sd(t.cpa_range_m.into(), t.sd_cpa_range_m.into())
    } else {
        "not observable".to_owned()
    }
}

fn deg(x: f32) -> f64 {
    f64::from(x).to_degrees()
}

/// A value with its standard deviation, to the digits that mean something; one that nothing is known of is unknown.
pub fn with_sd(x: f64, sd: f64) -> String {
    if !x.is_finite() || !sd.is_finite() {
        return "unknown".to_owned();
    }
    let decimals = if sd > 0.0 { (1.0 - sd.log10().floor()).clamp(0.0, 4.0) as usize } else { 1 };
    format!("{x:.decimals$}±{sd:.decimals$}")
}

fn time_s(t: f64) -> String {
    if t.is_finite() { format!("{t:.1} s") } else { "unknown".to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digits_follow_the_uncertainty() {
        assert_eq!(with_sd(123.456_78, 0.031), "123.457±0.031");
        assert_eq!(with_sd(498.3, 12.2), "498±12");
        assert_eq!(with_sd(7.0, 0.0), "7.0±0.0");
        assert_eq!(with_sd(7.0, f64::INFINITY), "unknown");
        assert_eq!(with_sd(f64::NAN, 1.0), "unknown");
    }
}
