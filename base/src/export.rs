//! Tracks as CSV, GeoJSON (RFC 7946) and KML (OGC 2.3).
//!
//! A track's line joins the positions reported while range was observable; its last report gives CPA, heading and
//! speed with their standard deviations. GeoJSON and KML also hold the 95 % ellipse of the last position. CSV rows carry
//! local East and North always, latitude and longitude where the station's position is known.

use super::{Base, TrackKey};
use crate::plot::ellipse_outline;
use anyhow::{Result, bail};
use seabearing_core::wire::Track;
use seabearing_host::geodesy::LocalFrame;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::Path;

/// A format, with the station's latitude and longitude where it needs them.
enum Format {
    Csv(Option<(f64, f64)>),
    GeoJson((f64, f64)),
    Kml((f64, f64)),
}

/// The format a file's name asks for.
fn format(path: &Path, station: Option<(f64, f64)>) -> Result<Format> {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    match (ending.as_str(), station) {
        ("csv", at) => Ok(Format::Csv(at)),
        ("geojson" | "json", Some(at)) => Ok(Format::GeoJson(at)),
        ("kml", Some(at)) => Ok(Format::Kml(at)),
        ("geojson" | "json" | "kml", None) => bail!(
            "{}: a map needs the station's position: give --station with `lat_deg` and `lon_deg`",
            path.display()
        ),
        _ => bail!("{}: the name of an export must end in .csv, .geojson or .kml", path.display()),
    }
}

/// Whether [`write()`] knows what to do with this file.
///
/// # Errors
/// The ending is none of `.csv`, `.geojson`, `.json`, `.kml`, or a map format lacks the station's position.
pub fn check(path: &Path, station: Option<(f64, f64)>) -> Result<()> {
    format(path, station).map(|_| ())
}

/// Writes the tracks in the format the file's name asks for, atomically. `station` is latitude and longitude in degrees.
///
/// # Errors
/// As [`check`], or the file cannot be written.
pub fn write(path: &Path, base: &Base, station: Option<(f64, f64)>) -> Result<()> {
    let text = match format(path, station)? {
        Format::Csv(at) => csv(base, at)?,
        Format::GeoJson(at) => format!("{:#}\n", geojson(base, at)),
        Format::Kml(at) => kml(base, at)?,
    };
    crate::atomic::write(path, text.as_bytes())
}

fn placed(t: &Track) -> bool {
    t.range_observable && t.x_m.is_finite() && t.y_m.is_finite()
}

fn csv(base: &Base, station: Option<(f64, f64)>) -> Result<String> {
    let clock = base.clock();
    let mut out = String::from(
        "session,track,state,t_s,utc,x_m,y_m,sd_x_m,sd_y_m,cov_xy_m2,lat_deg,lon_deg,heading_deg,sd_heading_deg,\
         speed_m_s,sd_speed_m_s,cpa_time_s,sd_cpa_time_s,cpa_range_m,sd_cpa_range_m,side,n\n",
    );
    let num = |x: f64, decimals: usize| if x.is_finite() { format!("{x:.decimals$}") } else { String::new() };
    for ((session, id), history) in base.tracks() {
        for t in history {
            let time = clock.t_s(t.index);
            let where_ = |x: f32, decimals| if placed(t) { num(x.into(), decimals) } else { String::new() };
            let (lat, lon) = match station.filter(|_| placed(t)) {
                Some(s) => {
                    let (lat, lon) = LocalFrame::new(s.0, s.1).lat_lon_deg(t.x_m.into(), t.y_m.into());
                    (num(lat, 7), num(lon, 7))
                }
                None => (String::new(), String::new()),
            };
            writeln!(
                out,
                "{session},{id},{},{},{},{},{},{},{},{},{lat},{lon},{},{},{},{},{},{},{},{},{},{}",
                if t.stage == 0 { "running" } else { "final" },
                num(time, 3),
                clock.utc(time).unwrap_or_default(),
                where_(t.x_m, 2),
                where_(t.y_m, 2),
                where_(t.var_x_m2.sqrt(), 2),
                where_(t.var_y_m2.sqrt(), 2),
                where_(t.cov_xy_m2, 2),
                num(f64::from(t.heading).to_degrees(), 3),
                num(f64::from(t.sd_heading).to_degrees(), 3),
                num(t.speed_m_s.into(), 3),
                num(t.sd_speed_m_s.into(), 3),
                num(t.cpa_time_s, 3),
                num(t.sd_cpa_time_s.into(), 3),
                where_(t.cpa_range_m, 2),
                where_(t.sd_cpa_range_m, 2),
                if t.starboard { "starboard" } else { "port" },
                t.n
            )?;
        }
    }
    Ok(out)
}

/// Degrees to seven places (a centimetre), longitude first as GeoJSON and KML want it.
fn point((lat, lon): (f64, f64)) -> Value {
    let round = |x: f64| (x * 1e7).round() / 1e7;
    json!([round(lon), round(lat)])
}

/// Line, last report and ellipse of every track that has a position.
fn drawn(base: &Base, at: (f64, f64)) -> Vec<(TrackKey, Track, Vec<Value>, Vec<Value>)> {
    let frame = LocalFrame::new(at.0, at.1);
    let place = |x: f64, y: f64| point(frame.lat_lon_deg(x, y));
    base.tracks()
        .iter()
        .filter_map(|(key, history)| {
            let last = history.iter().rev().find(|t| placed(t))?;
            let line =
                history.iter().filter(|t| placed(t)).map(|t| place(t.x_m.into(), t.y_m.into())).collect();
            let variances = (last.var_x_m2.into(), last.var_y_m2.into(), last.cov_xy_m2.into());
            let outline = ellipse_outline((last.x_m.into(), last.y_m.into()), variances, 0.95);
            let ring = outline
                .iter()
                .filter(|p| p.0.is_finite() && p.1.is_finite())
                .map(|p| place(p.0, p.1))
                .collect();
            Some((*key, *last, line, ring))
        })
        .collect()
}

fn geojson(base: &Base, at: (f64, f64)) -> Value {
    let mut features = vec![json!({
        "type": "Feature",
        "geometry": { "type": "Point", "coordinates": point(at) },
        "properties": { "kind": "station", "station": base.hello().map(|h| h.station) },
    })];
    for ((session, id), t, line, ring) in drawn(base, at) {
        let properties = json!({
            "kind": "track", "session": session, "track": id,
            "state": if t.stage == 0 { "running" } else { "final" },
            "t_s": base.clock().t_s(t.index), "utc": base.clock().utc(base.clock().t_s(t.index)),
            "heading_deg": f64::from(t.heading).to_degrees(),
            "sd_heading_deg": f64::from(t.sd_heading).to_degrees(),
            "speed_m_s": t.speed_m_s, "sd_speed_m_s": t.sd_speed_m_s,
            "cpa_time_s": t.cpa_time_s, "sd_cpa_time_s": t.sd_cpa_time_s,
            "cpa_range_m": t.cpa_range_m, "sd_cpa_range_m": t.sd_cpa_range_m,
        });
        let geometry = match &line[..] {
            [one] => json!({ "type": "Point", "coordinates": one }),
            _ => json!({ "type": "LineString", "coordinates": line }),
        };
        features.push(json!({ "type": "Feature", "geometry": geometry, "properties": properties }));
        if ring.len() > 3 {
            features.push(json!({
                "type": "Feature",
                "geometry": { "type": "Polygon", "coordinates": [ring] },
                "properties": { "kind": "ellipse", "probability": 0.95, "session": session, "track": id },
            }));
        }
    }
    json!({ "type": "FeatureCollection", "features": features })
}

fn kml(base: &Base, at: (f64, f64)) -> Result<String> {
    let text = |points: &[Value]| {
        points.iter().map(|p| format!("{},{},0", p[0], p[1])).collect::<Vec<_>>().join(" ")
    };
    let mut out = String::from(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<kml xmlns=\"http://www.opengis.net/kml/2.2\">\n<Document>\n",
    );
    writeln!(
        out,
        "<Placemark><name>station {}</name><Point><coordinates>{}</coordinates></Point></Placemark>",
        base.hello().map_or_else(|| "unknown".to_owned(), |h| h.station.to_string()),
        text(&[point(at)])
    )?;
    for ((session, id), t, line, ring) in drawn(base, at) {
        writeln!(
            out,
            "<Placemark><name>track {session}.{id}</name><description>CPA {} m at {} s, heading {}°, speed {} m/s\
             </description><LineString><coordinates>{}</coordinates></LineString></Placemark>",
            super::view::with_sd(t.cpa_range_m.into(), t.sd_cpa_range_m.into()),
            super::view::with_sd(t.cpa_time_s, t.sd_cpa_time_s.into()),
            super::view::with_sd(f64::from(t.heading).to_degrees(), f64::from(t.sd_heading).to_degrees()),
            super::view::with_sd(t.speed_m_s.into(), t.sd_speed_m_s.into()),
            text(&line)
        )?;
        if ring.len() > 3 {
            writeln!(
                out,
                "<Placemark><name>95 % of track {session}.{id}</name><Polygon><outerBoundaryIs><LinearRing>\
                 <coordinates>{}</coordinates></LinearRing></outerBoundaryIs></Polygon></Placemark>",
                text(&ring)
            )?;
        }
    }
    out.push_str("</Document>\n</kml>\n");
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use seabearing_core::wire::{Encoder, Message};

    fn base() -> Base {
        let mut encoder = Encoder::default();
        let mut base = Base::new(Some(1000.0), None);
        for i in 0..5u16 {
            let track = Track {
                id: 3,
                stage: u8::from(i == 4),
                index: 1000 * u64::from(i),
                cpa_time_s: 2.0,
                cpa_range_m: 500.0,
                cpa_azimuth: 1.5,
                heading: 0.5,
                speed_m_s: 7.0,
                starboard: true,
                sd_cpa_time_s: 0.1,
                sd_cpa_range_m: f32::INFINITY,
                sd_heading: 0.01,
                sd_speed_m_s: 0.2,
                x_m: 100.0 * f32::from(i),
                y_m: 500.0,
                var_x_m2: 100.0,
                var_y_m2: 400.0,
                cov_xy_m2: 50.0,
                range_observable: i > 0,
                n: i,
            };
            base.push(encoder.frame(&Message::Track(track)), &mut Vec::new());
        }
        base
    }

    #[test]
    fn every_format_holds_the_track_and_csv_every_report() {
        let dir = tempfile::tempdir().unwrap();
        let base = base();
        let file = |name: &str| dir.path().join(name);
        write(&file("t.csv"), &base, None).unwrap();
        let csv = std::fs::read_to_string(file("t.csv")).unwrap();
        assert_eq!(csv.lines().count(), 6);
        let columns = csv.lines().map(|l| l.split(',').count()).collect::<Vec<_>>();
        assert!(columns.iter().all(|n| *n == columns[0]), "{columns:?}");
        // Range not observable, or infinite: an empty cell, never a number.
        assert!(!csv.contains("inf") && !csv.contains("NaN"));
        write(&file("t.geojson"), &base, Some((49.0, -123.0))).unwrap();
        let map: Value = serde_json::from_slice(&std::fs::read(file("t.geojson")).unwrap()).unwrap();
        assert_eq!(map["features"].as_array().unwrap().len(), 3);
        assert_eq!(map["features"][1]["geometry"]["coordinates"].as_array().unwrap().len(), 4);
        let ring = map["features"][2]["geometry"]["coordinates"][0].as_array().unwrap();
        assert_eq!(ring.first(), ring.last());
        write(&file("t.kml"), &base, Some((49.0, -123.0))).unwrap();
        assert!(write(&file("u.kml"), &base, None).unwrap_err().to_string().contains("--station"));
        assert!(write(&file("u.xls"), &base, None).is_err());
    }
}
