use super::*;
use crate::tests::a_track;
use crate::{Base, Beginning};
use seabearing_core::wire::{Encoder, Message, Reply, Track};
use serde_json::json;

/// Five reports of one track; in the first its range is not observable.
fn records() -> Vec<Value> {
    let mut encoder = Encoder::default();
    let start = time::macros::datetime!(2024-05-01 09:00 UTC);
    let mut base = Base::new(Some(1000.0));
    base.say_start(Some(crate::record::micros(start)));
    base.begin(1, Beginning::default(), None);
    let mut out = Vec::new();
    for i in 0..5u16 {
        let track = Track {
            stage: u8::from(i == 4),
            index: 1000 * u64::from(i),
            sd_cpa_range_m: f32::INFINITY,
            x_m: 100.0 * f32::from(i),
            range_observable: i > 0,
            n: i,
            ..a_track()
        };
        base.push(1, 0, None, encoder.frame(&Message::Track(track)), &mut out);
    }
    base.push(1, 0, None, encoder.frame(&Message::Reply(Reply { token: 1, status: 0 })), &mut out);
    out.iter().map(|row| base.json(row)).collect()
}

fn written(name: &str, places: &Positions) -> Result<Vec<u8>> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(name);
    write(&path, Format::of(&path)?, &records(), places)?;
    Ok(std::fs::read(&path).unwrap())
}

fn at(lat: f64, lon: f64) -> Positions {
    Positions { otherwise: Some((lat, lon)), ..Positions::default() }
}

#[test]
fn a_table_has_a_row_a_record_and_no_made_up_number() {
    let text = String::from_utf8(written("t.csv", &Positions::default()).unwrap()).unwrap();
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let header = reader.headers().unwrap().clone();
    let rows: Vec<_> = reader.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 6);
    let place = |key: &str| header.iter().position(|h| h == key).unwrap();
    // Infinite, or of a record that has no such key: an empty cell.
    assert!(rows.iter().all(|r| r[place("sd_cpa_range_m")].is_empty()));
    assert_eq!((&rows[5][place("token")], &rows[5][place("heading_deg")]), ("1", ""));
    assert_eq!((&rows[0][place("token")], &rows[4][place("utc")]), ("", "2024-05-01T09:00:04Z"));
    assert!(!header.iter().any(|h| h == "lat_deg") && !text.contains("inf") && !text.contains("NaN"));
    let lines = written("t.jsonl", &at(49.0, -123.0)).unwrap();
    let lines: Vec<Value> = lines
        .split(|b| *b == b'\n')
        .filter(|l| !l.is_empty())
        .map(|l| serde_json::from_slice(l).unwrap())
        .collect();
    assert!(lines.len() == 6 && lines[0].get("lat_deg").is_none());
    assert!((lines[4]["lat_deg"].as_f64().unwrap() - 49.0045).abs() < 1e-4, "{}", lines[4]);
}

#[test]
fn maps_hold_the_track_with_its_times() {
    let map: Value = serde_json::from_slice(&written("t.geojson", &at(49.0, -123.0)).unwrap()).unwrap();
    let features = map["features"].as_array().unwrap();
    assert_eq!(features.len(), 3);
    let track = &features[1];
    assert_eq!(track["geometry"]["coordinates"].as_array().unwrap().len(), 4);
    assert_eq!(track["properties"]["times"][0], "2024-05-01T09:00:01Z");
    let ring = features[2]["geometry"]["coordinates"][0].as_array().unwrap();
    assert_eq!(ring.first(), ring.last());
    let kml = String::from_utf8(written("t.kml", &at(49.0, -123.0)).unwrap()).unwrap();
    assert_eq!(kml.matches("<when>").count(), 4);
}

#[test]
fn closest_points_have_their_utc() {
    let (places, mut all) = (at(49.0, -123.0), records());
    let last = &mut all[4];
    (last["cpa_time_s"], last["sd_cpa_time_s"], last["sd_cpa_range_m"]) =
        (63.6.into(), 2.0.into(), 20.0.into());
    last["cpa_range_m"] = 500.0.into();
    let kml = map::kml(&all, &places).unwrap();
    assert!(kml.contains("CPA 500±20 m at 2024-05-01T09:01:04Z ± 2 s, heading"), "{kml}");
    assert_eq!(map::geojson(&all, &places)["features"][1]["properties"]["cpa_utc"], "2024-05-01T09:01:03.6Z");
    all[4]["utc"] = Value::Null;
    let kml = map::kml(&all, &places).unwrap();
    assert!(kml.contains("CPA 500±20 m 63.6±2.0 s after the first sample"), "{kml}");
    let network = json!({ "type": "network_track", "id": 3, "state": "final", "lat_deg": 49.0, "lon_deg": -123.0,
        "closest": [{ "station": 7, "utc": "2024-05-01T09:01:03Z", "sd_s": 3.0, "range_m": 500.0, "sd_range_m": 20.0 }] });
    let kml = map::kml(&[network], &places).unwrap();
    assert!(kml.contains("CPA to station 7 500±20 m at 2024-05-01T09:01:03Z ± 3 s, heading"), "{kml}");
}

#[test]
fn a_track_of_one_place_is_a_point() {
    let (places, all) = (at(49.0, -123.0), records());
    let kml = map::kml(&all[4..], &places).unwrap();
    assert!(
        !kml.contains("<LineString>") && map::kml(&all, &places).unwrap().contains("<LineString>"),
        "{kml}"
    );
    assert_eq!(map::geojson(&all[4..], &places)["features"][1]["geometry"]["type"], "Point");
}

#[test]
fn a_track_across_the_date_line_does_not_go_round_the_earth() {
    for lon in [179.9975, -179.9975] {
        let map: Value = serde_json::from_slice(&written("t.geojson", &at(0.0, lon)).unwrap()).unwrap();
        for (feature, pointer) in [(1, "/geometry/coordinates"), (2, "/geometry/coordinates/0")] {
            let points = map["features"][feature].pointer(pointer).and_then(Value::as_array).unwrap();
            let lons: Vec<f64> = points.iter().map(|p| p[0].as_f64().unwrap()).collect();
            assert!(lons.windows(2).all(|w| (w[1] - w[0]).abs() < 0.1), "{lons:?}");
        }
    }
    // Points of KML stay between -180 and 180 degrees: its readers take the shorter way.
    let kml = String::from_utf8(written("t.kml", &at(0.0, 179.9975)).unwrap()).unwrap();
    assert!(kml.contains(">-179.99"), "{kml}");
}

#[test]
fn what_a_map_leaves_out_is_not_counted_as_written() {
    let all = records();
    let elsewhere = Positions { of_station: [(999, (1.0, 2.0))].into(), ..Positions::default() };
    for format in [Format::GeoJson, Format::Kml] {
        let counts =
            [at(49.0, -123.0), elsewhere.clone()].map(|places| super::written(format, &all, &places));
        assert_eq!(counts, [4, 0], "{format:?}");
    }
    assert_eq!(super::written(Format::Csv, &all, &elsewhere), all.len());
}

#[test]
fn what_cannot_be_written_is_told_with_the_remedy() {
    let refused = |name: &str| written(name, &Positions::default()).unwrap_err().to_string();
    assert!(refused("t.kml").contains("a station file"));
    assert!(refused("t.xls").contains(".csv"));
}

#[test]
fn columns_of_mixed_values_are_text() {
    let records = [json!({ "a": 1, "b": true, "c": null }), json!({ "a": 1.5, "b": "x", "c": [1, 2] })];
    let mut out = Vec::new();
    table::csv(&records, &mut out).unwrap();
    assert_eq!(String::from_utf8(out).unwrap(), "a,b,c\n1,true,\n1.5,x,\"[1,2]\"\n");
}

#[cfg(feature = "parquet")]
#[test]
fn parquet_gives_back_what_was_put_in() {
    use ::parquet::file::reader::{FileReader, SerializedFileReader};
    use ::parquet::record::RowAccessor;
    let bytes = written("t.parquet", &at(49.0, -123.0)).unwrap();
    let reader = SerializedFileReader::new(bytes::Bytes::from(bytes)).unwrap();
    let schema = reader.metadata().file_metadata().schema_descr_ptr();
    let place = |key: &str| schema.columns().iter().position(|c| c.name() == key).unwrap();
    let rows: Vec<_> = reader.get_row_iter(None).unwrap().map(Result::unwrap).collect();
    assert_eq!(rows.len(), 6);
    assert_eq!(rows[4].get_long(place("id")).unwrap(), 3);
    // A timestamp, nanoseconds since 1970.
    assert_eq!(rows[4].get_long(place("utc")).unwrap(), 1_714_554_004_000_000_000);
    assert!(rows[4].get_double(place("x_m")).unwrap() == 400.0 && rows[5].get_double(place("x_m")).is_err());
}
