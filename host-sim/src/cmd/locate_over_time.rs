//! `seabearing locate --motion` and `--known-track`: what bearings of a network tell over time.

use super::locate::Args;
use crate::orientation::network_file::Network;
use crate::orientation::sets::Row;
use crate::orientation::track_file;
use anyhow::{Result, anyhow, bail};
use seabearing_core::angle::RAD_PER_DEG;
use seabearing_core::kit::median;
use seabearing_locate::network::Sighting;
use seabearing_locate::network::align::{AlignSettings, Heard, align};
use seabearing_locate::network::joint::{Dated, JointSettings, fit};
use serde_json::{Value, json};
use std::path::Path;

/// Depth of a vessel's sound source where none is given, metres: a propeller's.
const SOURCE_DEPTH_M: f64 = 5.0;
/// Longest gap of a known track that is interpolated, seconds.
const TRACK_GAP_S: f64 = 300.0;

/// One straight motion from all rows: a `track` record for each station that was heard.
///
/// # Errors
/// The bearings do not determine the motion.
pub fn motion(args: &Args, network: &Network, rows: &mut [Row]) -> Result<Vec<Value>> {
    rows.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    // Errors that last over so many bearings weigh like one.
    let shared: Vec<f64> =
        (0..network.stations.len()).map(|i| (args.tau_s / interval_s(rows, i)).max(1.0).sqrt()).collect();
    let bearings: Vec<Dated> = rows
        .iter()
        .map(|r| Dated {
            t_s: r.t_s,
            array: r.station,
            sighting: Sighting {
                array_m: network.arrays_m[r.station],
                azimuth: r.azimuth,
                elevation: r.elevation,
                sd_azimuth: r.sd.0 * shared[r.station],
                sd_elevation: r.sd.1 * shared[r.station],
            },
        })
        .collect();
    let heard: Vec<usize> =
        (0..network.stations.len()).filter(|i| rows.iter().any(|r| r.station == *i)).collect();
    let depth_m = args.depth_m.unwrap_or(SOURCE_DEPTH_M);
    let sound_speed_m_s = network.stations[heard[0]].sound_speed_m_s;
    let settings = JointSettings { z_m: -depth_m, sound_speed_m_s, robust: !args.keep_outliers };
    let found = fit(&bearings, &settings).map_err(|e| anyhow!("{}: {e}", args.name()))?;
    let (speed, sd_speed) = found.speed_m_s();
    let (heading, sd_heading) = found.heading();
    let [x0, y0] = found.position_m(rows[0].t_s);
    let rejected = found.rejected.map(|i| network.stations[i].id);
    heard
        .iter()
        .map(|&i| {
            let [x, y, _] = network.arrays_m[i];
            let Some(cpa) = found.closest([x, y]) else { bail!("{}: the vessel does not move", args.name()) };
            let mut record = json!({
                "type": "track", "station": network.stations[i].id,
                "cpa_time_s": cpa.t_s.0, "cpa_range_m": cpa.range_m.0, "heading_deg": heading / RAD_PER_DEG,
                "speed_m_s": speed, "side": if cpa.to_starboard { "starboard" } else { "port" },
                "sd_cpa_time_s": cpa.t_s.1, "sd_cpa_range_m": cpa.range_m.1,
                "sd_heading_deg": sd_heading / RAD_PER_DEG, "sd_speed_m_s": sd_speed, "range_observable": true,
                "x0_m": x0, "y0_m": y0, "n": rows.len(), "misfit": found.misfit, "freedom": found.freedom,
            });
            if let (Some(id), Some(map)) = (rejected, record.as_object_mut()) {
                map.insert("rejected".into(), id.into());
            }
            Ok(record)
        })
        .collect()
}

/// Median time between bearings of one station, seconds; infinite where there are fewer than two.
fn interval_s(rows: &[Row], station: usize) -> f64 {
    let times: Vec<f64> = rows.iter().filter(|r| r.station == station).map(|r| r.t_s).collect();
    let mut steps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).filter(|s| *s > 0.0).collect();
    median(&mut steps).unwrap_or(f64::INFINITY)
}

/// How late the heard vessel is behind its known track: an `alignment` record for each station that was heard.
///
/// # Errors
/// The track file cannot be used.
pub fn alignment(args: &Args, network: &Network, rows: &[Row], track: &Path) -> Result<Vec<Value>> {
    let depth_m = args.depth_m.unwrap_or(SOURCE_DEPTH_M);
    let mut records = Vec::new();
    for (i, station) in network.stations.iter().enumerate() {
        let mut heard: Vec<Heard> = rows
            .iter()
            .filter(|r| r.station == i)
            .map(|r| Heard { t_s: r.t_s, azimuth: Some(r.azimuth), elevation: r.elevation })
            .collect();
        if heard.is_empty() {
            continue;
        }
        let track = track_file::read(track, station, depth_m)?;
        // What is heard left the vessel the travel time ago: the shift is that of the source alone.
        for h in &mut heard {
            if let Some(p) = track_file::heard_at(&track, h.t_s, TRACK_GAP_S, station.sound_speed_m_s) {
                h.t_s -= p.iter().map(|x| x * x).sum::<f64>().sqrt() / station.sound_speed_m_s;
            }
        }
        let settings = AlignSettings {
            array_m: [0.0; 3],
            sd: [args.sigma_azimuth_deg * RAD_PER_DEG, args.sigma_elevation_deg * RAD_PER_DEG],
            largest_shift_s: args.max_shift_s,
            gap_s: TRACK_GAP_S,
        };
        records.push(match align(&heard, &track, &settings) {
            Ok(s) => json!({
                "type": "alignment", "station": station.id, "shift_s": s.shift_s, "sd_s": s.sd_s, "n": s.n,
            }),
            Err(e) => json!({ "type": "no_alignment", "station": station.id, "reason": e.to_string() }),
        });
    }
    Ok(records)
}
