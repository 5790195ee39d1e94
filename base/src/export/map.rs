//! Tracks on a map, as GeoJSON and KML.
//!
//! A track's line joins the places reported while its range was observable, each with its time; its last report gives
//! closest point, heading and speed with their standard deviations, and the 95 % ellipse of the last place.

use super::{Positions, degrees, east_north};
use crate::plot::ellipse_outline;
use crate::record::{rfc3339, us_of};
use anyhow::Result;
use seabearing_host::angle::turn_deg;
use seabearing_host::geodesy::LocalFrame;
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// Latitude and longitude of a place so many metres East and North of a station.
pub(super) fn lat_lon(station: (f64, f64), (x_m, y_m): (f64, f64)) -> (f64, f64) {
    LocalFrame::new(station.0, station.1).lat_lon_deg(x_m, y_m)
}

/// Longitude first, as both formats want it.
fn point((lat, lon): (f64, f64)) -> Value {
    json!([degrees(lon), degrees(lat)])
}

/// A track's record and the place it tells, metres East and North of the station.
type Report<'a> = (&'a Value, (f64, f64));

/// A track, by station, session and number; or a network track.
struct Drawn<'a> {
    name: String,
    kind: &'static str,
    /// Its reports with a place, in order.
    reports: Vec<(&'a Value, Value)>,
    ring: Vec<Value>,
}

/// Every track that has a place and was not withdrawn.
fn drawn<'a>(records: &'a [Value], places: &Positions) -> Vec<Drawn<'a>> {
    let mut tracks: BTreeMap<[Option<u64>; 3], Vec<Report<'_>>> = BTreeMap::new();
    let key = |record: &Value| ["station", "session", "id"].map(|k| record[k].as_u64());
    for record in records {
        let Some(place) = east_north(record) else { continue };
        tracks.entry(key(record)).or_default().push((record, place));
    }
    for record in records.iter().filter(|r| r["stage"] == "withdrawn") {
        tracks.remove(&key(record));
    }
    let mut out = Vec::new();
    for ([station, session, id], reports) in tracks {
        let Some(&(last, centre)) = reports.last() else { continue };
        let Some(at) = places.of(last) else { continue };
        let on_map = |place| point(lat_lon(at, place));
        let number = |n: Option<u64>| n.map_or_else(|| "?".to_owned(), |n| n.to_string());
        let ring = ring(centre, last, on_map);
        out.push(Drawn {
            name: format!("{}.{}.{}", number(station), number(session), number(id)),
            kind: "track",
            reports: reports.into_iter().map(|(record, place)| (record, on_map(place))).collect(),
            ring,
        });
    }
    out.extend(networks(records));
    out
}

/// The 95 % ellipse of a report about a place; empty where there is none.
fn ring(centre: (f64, f64), report: &Value, on_map: impl Fn((f64, f64)) -> Value) -> Vec<Value> {
    let variances =
        ["var_x_m2", "var_y_m2", "cov_xy_m2"].map(|k| report[k].as_f64().unwrap_or(f64::INFINITY));
    let outline = ellipse_outline(centre, variances.into(), 0.95);
    let ring: Vec<Value> =
        outline.into_iter().filter(|p| p.0.is_finite() && p.1.is_finite()).map(on_map).collect();
    if ring.len() > 3 { ring } else { Vec::new() }
}

/// Every network track that has a place and was not withdrawn: these say themselves where they are.
fn networks(records: &[Value]) -> Vec<Drawn<'_>> {
    let mut tracks: BTreeMap<Option<u64>, Vec<&Value>> = BTreeMap::new();
    for record in records.iter().filter(|r| r["type"] == "network_track") {
        if record["state"] == "withdrawn" {
            tracks.remove(&record["id"].as_u64());
        } else if record["lat_deg"].is_number() {
            tracks.entry(record["id"].as_u64()).or_default().push(record);
        }
    }
    let place = |r: &Value| Some((r["lat_deg"].as_f64()?, r["lon_deg"].as_f64()?));
    let mut out = Vec::new();
    for (id, reports) in tracks {
        let Some((last, at)) = reports.last().and_then(|r| Some((*r, place(r)?))) else { continue };
        out.push(Drawn {
            name: format!("network {}", id.unwrap_or(0)),
            kind: "network_track",
            ring: ring((0.0, 0.0), last, |off| point(lat_lon(at, off))),
            reports: reports.into_iter().filter_map(|r| Some((r, point(place(r)?)))).collect(),
        });
    }
    out
}

/// The stations that the records are of, with their places.
fn stations(records: &[Value], places: &Positions) -> Vec<(Value, Value)> {
    let of_recorders = records.iter().filter(|r| r["type"] != "network_track");
    let seen: BTreeSet<Option<u64>> = of_recorders.map(|r| r["station"].as_u64()).collect();
    // Records before the recorder said who it is belong to the one that does.
    let known = |s: &Option<u64>| s.is_some() || seen.len() == 1;
    let of = |s: &Option<u64>| {
        let at = places.of(&json!({ "station": s }))?;
        Some((json!(s), point(at)))
    };
    seen.iter().filter(|s| known(s)).filter_map(of).collect()
}

/// Records that stand on a map.
pub(super) fn written(records: &[Value], places: &Positions) -> usize {
    drawn(records, places).iter().map(|track| track.reports.len()).sum()
}

/// What is said of a track besides its line.
fn properties(report: &Value) -> Map<String, Value> {
    const SAID: [&str; 14] = [
        "station",
        "session",
        "id",
        "stage",
        "t_s",
        "utc",
        "heading_deg",
        "sd_heading_deg",
        "speed_m_s",
        "sd_speed_m_s",
        "cpa_time_s",
        "sd_cpa_time_s",
        "cpa_range_m",
        "sd_cpa_range_m",
    ];
    const OF_NETWORK: [&str; 12] = [
        "id",
        "state",
        "members",
        "from_utc",
        "utc",
        "heading_deg",
        "sd_heading_deg",
        "speed_m_s",
        "sd_speed_m_s",
        "closest",
        "consistent",
        "n",
    ];
    let said = if report["type"] == "network_track" { &OF_NETWORK[..] } else { &SAID };
    let mut properties: Map<String, Value> =
        said.iter().map(|key| ((*key).to_owned(), report[*key].clone())).collect();
    if report["type"] != "network_track" {
        properties.insert("cpa_utc".into(), closest_utc(report));
    }
    properties
}

/// UTC of a track's closest point to its station; null where it is not known.
fn closest_utc(report: &Value) -> Value {
    let number = |key: &str| report[key].as_f64();
    let dated = us_of(&report["utc"]).zip(number("cpa_time_s").zip(number("t_s")));
    dated.map_or(Value::Null, |(us, (cpa_s, t_s))| rfc3339(us + ((cpa_s - t_s) * 1e6) as i64))
}

/// A track's closest point, or a network track's closest points, as a person reads it.
fn closest(report: &Value) -> String {
    let with_sd = |of: &Value, key: &str| {
        let number = |key: &str| of[key].as_f64().unwrap_or(f64::NAN);
        crate::view::with_sd(number(key), number(&format!("sd_{key}")))
    };
    // To the second: what it is known to stands behind it.
    let at = |utc: &Value| {
        let to_second = us_of(utc).map(|us| rfc3339((us + 500_000).div_euclid(1_000_000) * 1_000_000));
        to_second.and_then(|utc| utc.as_str().map(str::to_owned))
    };
    let sd = |sd_s: &Value| sd_s.as_f64().map_or_else(String::new, |sd_s| format!(" ± {sd_s:.0} s"));
    if report["type"] == "network_track" {
        let points = report["closest"].as_array().into_iter().flatten().filter_map(|of| {
            let (range, at, sd) = (with_sd(of, "range_m"), at(&of["utc"])?, sd(&of["sd_s"]));
            Some(format!("CPA to station {} {range} m at {at}{sd}, ", of["station"]))
        });
        return points.collect();
    }
    let range = with_sd(report, "cpa_range_m");
    match at(&closest_utc(report)) {
        Some(at) => format!("CPA {range} m at {at}{}, ", sd(&report["sd_cpa_time_s"])),
        None => format!("CPA {range} m {} s after the first sample, ", with_sd(report, "cpa_time_s")),
    }
}

/// Points of a line or ring that goes across the date line, so that none is a turn of the Earth from the one before: a
/// reader of GeoJSON draws a line between two numbers, and would draw it the other way round.
fn in_one_piece(mut points: Vec<Value>) -> Vec<Value> {
    let mut before: Option<f64> = None;
    for point in &mut points {
        let Some(lon) = point[0].as_f64() else { continue };
        let turned = before.map_or(lon, |before| before + turn_deg(before, lon));
        before = Some(turned);
        if (turned - lon).abs() > 1.0 {
            point[0] = json!(degrees(turned));
        }
    }
    points
}

/// The tracks as GeoJSON.
pub(super) fn geojson(records: &[Value], places: &Positions) -> Value {
    let feature = |geometry: Value, properties: Value| json!({ "type": "Feature", "geometry": geometry, "properties": properties });
    let mut features = Vec::new();
    for (station, at) in stations(records, places) {
        features.push(feature(
            json!({ "type": "Point", "coordinates": at }),
            json!({ "kind": "station", "station": station }),
        ));
    }
    for track in drawn(records, places) {
        let Some((last, at)) = track.reports.last() else { continue };
        let mut said = properties(last);
        said.insert("kind".into(), track.kind.into());
        said.insert("times".into(), track.reports.iter().map(|(r, _)| r["utc"].clone()).collect());
        let line = in_one_piece(track.reports.iter().map(|(_, at)| at.clone()).collect());
        let geometry = match &line[..] {
            [_] => json!({ "type": "Point", "coordinates": at }),
            _ => json!({ "type": "LineString", "coordinates": line }),
        };
        features.push(feature(geometry, said.into()));
        if !track.ring.is_empty() {
            features.push(feature(
                json!({ "type": "Polygon", "coordinates": [in_one_piece(track.ring)] }),
                json!({ "kind": "ellipse", "of": track.kind, "probability": 0.95, "station": last["station"],
                        "session": last["session"], "id": last["id"] }),
            ));
        }
    }
    json!({ "type": "FeatureCollection", "features": features })
}

/// The tracks as KML. Reports with a time stand beside the line as points with that time, so that viewers animate them.
pub(super) fn kml(records: &[Value], places: &Positions) -> Result<String> {
    let text = |points: &[&Value]| {
        points.iter().map(|p| format!("{},{},0", p[0], p[1])).collect::<Vec<_>>().join(" ")
    };
    let mut out = String::from(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<kml xmlns=\"http://www.opengis.net/kml/2.2\">\n<Document>\n",
    );
    for (station, at) in stations(records, places) {
        let name = station.as_u64().map_or_else(|| "unknown".to_owned(), |s| s.to_string());
        writeln!(
            out,
            "<Placemark><name>station {name}</name><Point><coordinates>{}</coordinates></Point></Placemark>",
            text(&[&at])
        )?;
    }
    for track in drawn(records, places) {
        let Some((last, _)) = track.reports.last() else { continue };
        let name = &track.name;
        let with_sd = |key: &str| {
            let number = |key: &str| last[key].as_f64().unwrap_or(f64::NAN);
            crate::view::with_sd(number(key), number(&format!("sd_{key}")))
        };
        let line: Vec<&Value> = track.reports.iter().map(|(_, at)| at).collect();
        let closest = closest(last);
        // A line has two places or more.
        let shape = if line.len() > 1 { "LineString" } else { "Point" };
        writeln!(
            out,
            "<Placemark><name>track {name}</name><description>{closest}heading {}°, speed {} m/s\
             </description><{shape}><coordinates>{}</coordinates></{shape}></Placemark>",
            with_sd("heading_deg"),
            with_sd("speed_m_s"),
            text(&line)
        )?;
        for (report, at) in &track.reports {
            let Some(utc) = report["utc"].as_str() else { continue };
            writeln!(
                out,
                "<Placemark><name>{name}</name><TimeStamp><when>{utc}</when></TimeStamp>\
                 <Point><coordinates>{}</coordinates></Point></Placemark>",
                text(&[at])
            )?;
        }
        if !track.ring.is_empty() {
            writeln!(
                out,
                "<Placemark><name>95 % of track {name}</name><Polygon><outerBoundaryIs><LinearRing>\
                 <coordinates>{}</coordinates></LinearRing></outerBoundaryIs></Polygon></Placemark>",
                text(&track.ring.iter().collect::<Vec<_>>())
            )?;
        }
    }
    out.push_str("</Document>\n</kml>\n");
    Ok(out)
}
