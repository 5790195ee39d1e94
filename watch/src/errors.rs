//! Errors of tracks against AIS, of each and over the fleet.
//!
//! In: tracks that are vessels of AIS ([`crate::matching`]). Out: the error of position, heading, speed and closest point
//! of each, as it is and in standard deviations (track and AIS together), how far away it was heard; and over all tracks a
//! histogram of the standardised errors and the range at which vessels are heard against their speed and length [N, §VI].

use crate::ais::{Fleet, Vessel};
use crate::matching::{Heard, Rules, Verdict, difference, motion_difference};
use crate::report::{VesselId, WithSd, rfc3339};
use seabearing_core::kit::{median, quantile};
use serde_json::{Map, Value, json};

/// An error and the same in standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Error {
    /// As it is.
    pub error: f64,
    /// Standardised.
    pub z: f64,
}

impl Error {
    fn of((error, sd): WithSd) -> Option<Self> {
        let z = error / sd;
        z.is_finite().then_some(Self { error, z })
    }
}

/// What a track's errors are.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrackErrors {
    /// Distances from AIS of the reports with a place, m.
    pub position_m: Vec<f64>,
    /// Squared standardised distances of the same, χ² with two degrees of freedom where they are honest.
    pub distance2: Vec<f64>,
    /// Heading at the last report, rad.
    pub heading_rad: Option<Error>,
    /// Speed there, m/s.
    pub speed_m_s: Option<Error>,
    /// Time of the closest point, s.
    pub cpa_time_s: Option<Error>,
    /// Range there, m.
    pub cpa_range_m: Option<Error>,
    /// Greatest range of the vessel (by AIS) at a report, m.
    pub heard_to_m: f64,
    /// Speed of the vessel by AIS at the last report, m/s.
    pub vessel_speed_m_s: f64,
}

/// Compares a track with its vessel; `None` where the vessel does not tell where it was.
pub fn of_track(heard: &Heard, vessel: &Vessel, fleet: &Fleet, rules: &Rules) -> Option<TrackErrors> {
    let at = |t_s: f64| vessel.at(t_s, &heard.frame, rules.gap_s, fleet.time_sd_s);
    let mut out = TrackErrors::default();
    let mut last = None;
    for report in &heard.reports {
        let Some(placed) = report.utc_s.and_then(|(t_s, _)| at(t_s)) else { continue };
        let (px, py) = placed.place_m;
        out.heard_to_m = out.heard_to_m.max(px.hypot(py));
        if let Some(((x, y), covariance)) = difference(report, &placed, fleet.time_sd_s)
            && let Some(d2) = covariance.distance2((x, y))
        {
            out.position_m.push(x.hypot(y));
            out.distance2.push(d2);
        }
        last = Some((report, placed));
    }
    let (report, placed) = last?;
    out.vessel_speed_m_s = placed.velocity_m_s.0.hypot(placed.velocity_m_s.1);
    let (heading, speed) = motion_difference(report, &placed);
    out.heading_rad = heading.and_then(Error::of);
    out.speed_m_s = speed.and_then(Error::of);
    if let Some((time, range)) = closest(heard, vessel, fleet, rules) {
        out.cpa_time_s = report.cpa_utc_s.and_then(|(t_s, sd)| Error::of((t_s - time.0, sd.hypot(time.1))));
        out.cpa_range_m = report.cpa_range_m.and_then(|(r, sd)| Error::of((r - range.0, sd.hypot(range.1))));
    }
    Some(out)
}

/// Time (s since 1970) and range (m) of a vessel's closest point, with standard deviations, where the track told one that
/// lies in its own time.
fn closest(heard: &Heard, vessel: &Vessel, fleet: &Fleet, rules: &Rules) -> Option<((f64, f64), (f64, f64))> {
    let (told_s, _) = heard.reports.last()?.cpa_utc_s?;
    let (from, to) = heard.span_s();
    if !(from..=to).contains(&told_s) {
        return None;
    }
    let at = |t_s: f64| vessel.at(t_s, &heard.frame, rules.gap_s, fleet.time_sd_s);
    // Newton's step on a straight leg is exact; reports may lie between.
    let mut t_s = told_s;
    for _ in 0..8 {
        let placed = at(t_s)?;
        let ((x, y), (vx, vy)) = (placed.place_m, placed.velocity_m_s);
        let step = -(x * vx + y * vy) / (vx * vx + vy * vy);
        if !step.is_finite() {
            return None;
        }
        t_s += step.clamp(-60.0, 60.0);
    }
    let placed = at(t_s).filter(|_| (t_s - told_s).abs() < 0.5 * (to - from).max(60.0))?;
    let ((x, y), (vx, vy), c) = (placed.place_m, placed.velocity_m_s, placed.covariance);
    let (range, speed) = (x.hypot(y), vx.hypot(vy));
    let variance = |(e, n): (f64, f64)| c.xx * e * e + 2.0 * c.xy * e * n + c.yy * n * n;
    let (along, radial) = (variance((vx / speed, vy / speed)), variance((x / range, y / range)));
    Some(((t_s, along.sqrt() / speed), (range, radial.sqrt())))
}

fn root_mean_square(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, n) = values.fold((0.0, 0u32), |(s, n), x| (s + x * x, n + 1));
    (n > 0).then(|| (sum / f64::from(n)).sqrt())
}

/// A number with three decimals; null where it is none.
fn rounded(x: impl Into<Option<f64>>) -> Value {
    x.into().filter(|x| x.is_finite()).map_or(Value::Null, |x| json!((x * 1e3).round() / 1e3))
}

/// The record of a track's verdict.
pub fn record(heard: &Heard, verdict: &Verdict, errors: Option<&TrackErrors>, fleet: &Fleet) -> Value {
    let (from, to) = heard.span_s();
    let mut out = match heard.vessel {
        VesselId::Track(track) => json!({
            "type": "ais_match", "station": track.station, "session": track.session, "id": track.id,
        }),
        VesselId::Network(id) => json!({
            "type": "ais_match", "station": null, "session": null, "id": null, "network": id,
        }),
    };
    (out["from_utc"], out["to_utc"]) = (rfc3339(from), rfc3339(to));
    match verdict {
        Verdict::Vessel { vessel, probability, distance2 } => {
            let of = fleet.vessels.get(*vessel);
            out["verdict"] = "vessel".into();
            out["probability"] = rounded(*probability);
            out["mmsi"] = json!(of.map(|v| v.mmsi));
            out["twin"] = json!(of.map(|v| v.twin));
            out["name"] = json!(of.and_then(|v| v.name.as_deref()));
            out["length_m"] = json!(of.and_then(|v| v.length_m));
            out["distance_sd"] = rounded(distance2.sqrt());
        }
        Verdict::Dark { probability } => {
            out["verdict"] = "dark".into();
            out["probability"] = rounded(*probability);
        }
        Verdict::Unmatched(reason) => {
            out["verdict"] = "unmatched".into();
            out["reason"] = reason.as_str().into();
        }
    }
    let Some(e) = errors else { return out };
    out["n"] = e.position_m.len().into();
    out["rms_position_error_m"] = rounded(root_mean_square(e.position_m.iter().copied()));
    out["mean_distance2"] = rounded(e.distance2.iter().sum::<f64>() / e.distance2.len() as f64);
    let mut both = |name: &str, unit: &str, error: Option<Error>, scale: f64| {
        out[format!("{name}_error_{unit}")] = rounded(error.map(|e| e.error * scale));
        out[format!("{name}_error_sd")] = rounded(error.map(|e| e.z));
    };
    both("heading", "deg", e.heading_rad, 1f64.to_degrees());
    both("speed", "m_s", e.speed_m_s, 1.0);
    both("cpa_time", "s", e.cpa_time_s, 1.0);
    both("cpa_range", "m", e.cpa_range_m, 1.0);
    out["heard_to_m"] = rounded(e.heard_to_m);
    out["vessel_speed_m_s"] = rounded(e.vessel_speed_m_s);
    out
}

/// A track's errors, and the length of its vessel (m) where known.
pub type Measured = (TrackErrors, Option<f64>);

/// Bins of the histogram, standard deviations; beyond both ends the first and the last go on.
const BINS: std::ops::RangeInclusive<i32> = -4..=3;
/// Limits of the classes of speed (m/s) and length (m).
const SPEEDS_M_S: [f64; 4] = [0.0, 4.0, 8.0, 12.0];
const LENGTHS_M: [f64; 4] = [0.0, 50.0, 100.0, 200.0];

/// The record over all tracks.
pub fn over_fleet(verdicts: &[Verdict], errors: &[Measured]) -> Value {
    let count = |is: fn(&Verdict) -> bool| verdicts.iter().filter(|v| is(v)).count();
    let mut out = json!({
        "type": "ais_fleet", "tracks": verdicts.len(),
        "vessels": count(|v| matches!(v, Verdict::Vessel { .. })),
        "dark": count(|v| matches!(v, Verdict::Dark { .. })),
        "unmatched": count(|v| matches!(v, Verdict::Unmatched(_))),
    });
    let mut positions: Vec<f64> = errors.iter().flat_map(|(e, _)| e.position_m.iter().copied()).collect();
    out["median_position_error_m"] = rounded(median(&mut positions));
    let distances: Vec<f64> = errors.iter().flat_map(|(e, _)| e.distance2.iter().copied()).collect();
    // 2 where the covariances are honest; 95 % of the places lie within 5.99.
    out["mean_distance2"] = rounded(distances.iter().sum::<f64>() / distances.len() as f64);
    let inside = distances.iter().filter(|d| **d <= 5.991).count();
    out["within_95_percent"] = rounded(100.0 * inside as f64 / distances.len() as f64);
    type Of = fn(&TrackErrors) -> Option<Error>;
    let kinds: [(&str, Of, f64); 4] = [
        ("heading_deg", |e| e.heading_rad, 1f64.to_degrees()),
        ("speed_m_s", |e| e.speed_m_s, 1.0),
        ("cpa_time_s", |e| e.cpa_time_s, 1.0),
        ("cpa_range_m", |e| e.cpa_range_m, 1.0),
    ];
    for (name, of, scale) in kinds {
        let found: Vec<Error> = errors.iter().filter_map(|(e, _)| of(e)).collect();
        let mut histogram = vec![0u32; BINS.count()];
        for e in &found {
            let bin = (e.z.floor() as i32).max(*BINS.start()).min(*BINS.end()) - BINS.start();
            if let Some(count) = histogram.get_mut(bin as usize) {
                *count += 1;
            }
        }
        let mut errors: Vec<f64> = found.iter().map(|e| e.error * scale).collect();
        out[name] = json!({
            "n": found.len(), "rms": rounded(root_mean_square(errors.iter().copied())),
            "median": rounded(median(&mut errors)), "rms_sd": rounded(root_mean_square(found.iter().map(|e| e.z))),
            "histogram_sd": { "from": BINS.start(), "counts": histogram },
        });
    }
    let classes = |limits: [f64; 4], of: &dyn Fn(&Measured) -> Option<f64>| {
        let mut table = Vec::new();
        for (k, from) in limits.iter().enumerate() {
            let to = limits.get(k + 1).copied();
            let in_class = |x: f64| x >= *from && to.is_none_or(|to| x < to);
            let mut ranges: Vec<f64> =
                errors.iter().filter(|e| of(e).is_some_and(in_class)).map(|(e, _)| e.heard_to_m).collect();
            let mut row = Map::new();
            row.insert("from".into(), json!(from));
            row.insert("to".into(), json!(to));
            row.insert("tracks".into(), ranges.len().into());
            row.insert("median_heard_to_m".into(), rounded(median(&mut ranges)));
            row.insert("heard_to_90_percent_m".into(), rounded(quantile(&mut ranges, 0.9)));
            table.push(Value::Object(row));
        }
        table
    };
    out["heard_by_speed_m_s"] = classes(SPEEDS_M_S, &|(e, _)| Some(e.vessel_speed_m_s)).into();
    out["heard_by_length_m"] = classes(LENGTHS_M, &|(_, length_m)| *length_m).into();
    out
}

/// Verdicts on all tracks: a record each, and one over the fleet at the end.
pub fn records(tracks: &[Heard], fleet: &Fleet, rules: &Rules) -> Vec<Value> {
    let verdicts = crate::matching::judge(tracks, fleet, rules);
    let (mut out, mut all) = (Vec::new(), Vec::new());
    for (heard, verdict) in tracks.iter().zip(&verdicts) {
        let vessel = match verdict {
            Verdict::Vessel { vessel, .. } => fleet.vessels.get(*vessel),
            _ => None,
        };
        let errors = vessel.and_then(|v| Some((of_track(heard, v, fleet, rules)?, v.length_m)));
        out.push(record(heard, verdict, errors.as_ref().map(|(e, _)| e), fleet));
        all.extend(errors);
    }
    out.push(over_fleet(&verdicts, &all));
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{Covariance, TrackId, TrackReport};
    use seabearing_host::ais::AisReport;
    use seabearing_host::geodesy::LocalFrame;
    use std::collections::BTreeMap;

    #[test]
    fn errors_are_differences_from_the_vessel_in_their_standard_deviations() {
        // North at 5 m/s, 1000 m East, abeam at 600 s.
        let frame = LocalFrame::new(50.0, -1.0);
        let reports: Vec<AisReport> = (0..41)
            .map(|k| 30.0 * f64::from(k) + 0.25)
            .map(|t_s| AisReport {
                mmsi: 7,
                t_s,
                lat_lon_deg: frame.lat_lon_deg(1000.0, 5.0 * (t_s - 600.0)),
                speed_m_s: None,
                status: None,
                ship_type: None,
                terrestrial: None,
                length_m: Some(120.0),
            })
            .collect();
        let fleet = Fleet::of(&reports, &BTreeMap::new());
        let vessel = VesselId::Track(TrackId { station: Some(1), session: Some(1), id: 1 });
        let report = |t_s: f64| TrackReport {
            vessel,
            station: Some(1),
            is_final: false,
            is_withdrawn: false,
            utc_s: Some((t_s, Some(0.0))),
            place: Some(((1040.0, 5.0 * (t_s - 600.0)), Covariance { xx: 400.0, yy: 400.0, xy: 0.0 })),
            heading_rad: Some((0.02, 0.01)),
            speed_m_s: Some((5.5, 0.5)),
            cpa_utc_s: Some((610.0, 5.0)),
            cpa_range_m: Some((1040.0, 20.0)),
        };
        let reports = [400.0, 600.0, 800.0].map(report).to_vec();
        let heard = Heard { vessel, stations: vec![Some(1)], frame, reports };
        let rules = Rules::default();
        let e = of_track(&heard, &fleet.vessels[0], &fleet, &rules).unwrap();
        assert!(e.position_m.iter().all(|d| (d - 40.0).abs() < 1.0), "{e:?}");
        // 40 m across the course: 20 m of the track and 15.. m of AIS.
        assert!(e.distance2.iter().all(|d| (2.3..2.6).contains(d)), "{e:?}");
        let speed = e.speed_m_s.unwrap();
        assert!((speed.error - 0.5).abs() < 0.01 && speed.z < 1.0 && speed.z > 0.5, "{speed:?}");
        assert!(
            (e.cpa_time_s.unwrap().error - 10.0).abs() < 0.2
                && (e.cpa_range_m.unwrap().error - 40.0).abs() < 1.0
        );
        assert!((e.heard_to_m - 1414.0).abs() < 2.0);
        let records = records(&[heard], &fleet, &rules);
        assert_eq!(records[0]["mmsi"], 7);
        assert_eq!(
            (&records[1]["vessels"], &records[1]["heard_by_length_m"][2]["tracks"]),
            (&json!(1), &json!(1))
        );
        let counts = records[1]["cpa_range_m"]["histogram_sd"]["counts"].as_array().unwrap();
        assert_eq!(counts.iter().filter_map(Value::as_u64).sum::<u64>(), 1);
    }
}
