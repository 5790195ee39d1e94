use super::*;
use serde_json::json;

const STATIONS: [(u16, (f64, f64)); 2] = [(1, (80.0, 10.0)), (2, (80.0, 11.0))];

fn track(station: u16, stage: &str) -> Value {
    json!({ "type": "track", "station": station, "session": 1, "id": 4, "stage": stage, "t_s": 0.0, "range_observable": true,
        "x_m": 500.0, "y_m": 0.0, "var_x_m2": 100.0, "var_y_m2": 100.0, "cov_xy_m2": 0.0 })
}

fn network(id: u32, state: &str, stations: &[u16]) -> Value {
    let members: Vec<Value> =
        stations.iter().map(|n| json!({ "station": n, "session": 1, "id": 4 })).collect();
    json!({ "type": "network_track", "id": id, "state": state, "members": members, "utc": "2026-05-01T00:00:00Z",
        "lat_deg": 80.1, "lon_deg": 11.0, "var_x_m2": 100.0, "var_y_m2": 900.0, "cov_xy_m2": 0.0,
        "heading_deg": 90.0, "sd_heading_deg": 1.0, "speed_m_s": 5.0, "sd_speed_m_s": 0.1,
        "closest": [{ "station": 2, "utc": "2026-05-01T00:01:00Z", "sd_s": 2.0, "range_m": 700.0, "sd_range_m": 20.0 }] })
}

fn who(words: &[Word]) -> Vec<VesselId> {
    words.iter().filter_map(|w| if let Word::Says(seen) = w { Some(seen[0].vessel) } else { None }).collect()
}

const OWN: TrackId = TrackId { station: Some(1), session: Some(1), id: 4 };

#[test]
fn a_network_track_stands_for_the_tracks_that_it_joins_until_it_is_withdrawn() {
    let mut vessels = Vessels::new(&STATIONS.into());
    assert_eq!(who(&vessels.take(&track(1, "running"), 0.0)), [VesselId::Track(OWN)]);
    let words = vessels.take(&network(5, "live", &[1, 2]), 1.0);
    assert!(
        matches!(words[..], [Word::Joins(a, 5), Word::Joins(b, 5), Word::Says(_)] if a == OWN && b.station == Some(2))
    );
    assert_eq!(vessels.stations(VesselId::Network(5)), [1, 2]);
    assert!(
        vessels.take(&track(1, "running"), 2.0).is_empty()
            && vessels.take(&track(2, "final"), 2.0).is_empty()
    );
    // Another takes one of its members; what the first leaves behind is what its members are told as now.
    assert_eq!(vessels.take(&network(6, "live", &[1, 3]), 3.0).len(), 3);
    let other = TrackId { station: Some(2), ..OWN };
    let parts = vessels.take(&network(5, "withdrawn", &[1, 2]), 3.0);
    assert_eq!(parts, [Word::Parts(5, vec![VesselId::Network(6), VesselId::Track(other)])]);
    assert_eq!(who(&vessels.take(&track(2, "running"), 4.0)), [VesselId::Track(other)]);
    // One that leaves is a vessel of its own.
    vessels.take(&network(6, "live", &[3, 4]), 5.0);
    assert_eq!(who(&vessels.take(&track(1, "running"), 6.0)), [VesselId::Track(OWN)]);
}

#[test]
fn it_is_seen_from_each_of_its_stations_with_their_own_north_and_closest_points() {
    let mut vessels = Vessels::new(&STATIONS.into());
    let Some(Word::Says(seen)) = vessels.take(&network(5, "live", &[1, 2]), 0.0).pop() else { panic!() };
    let [west, own] = &seen[..] else { panic!() };
    // The vessel is due North of the second; meridians of 80° turn by 0.985° a degree.
    let ((x, y), covariance) = own.place.unwrap();
    assert!(x.abs() < 0.1 && (y - 11_166.0).abs() < 10.0, "{x} {y}");
    assert!((covariance.xx - 100.0).abs() < 0.1 && (covariance.yy - 900.0).abs() < 0.1);
    assert_eq!(own.cpa_range_m, Some((700.0, 20.0)));
    assert!((own.cpa_utc_s.unwrap().0 - own.utc_s.unwrap().0 - 60.0).abs() < 1e-6);
    assert_eq!((west.station, west.cpa_range_m), (Some(1), None));
    let (heading, _) = west.heading_rad.unwrap();
    assert!((90.0 - heading.to_degrees() - 0.985).abs() < 0.02, "{}", heading.to_degrees());
    // Its North is West of North there: the covariance with it.
    assert!(west.place.unwrap().1.xy < -10.0, "{:?}", west.place);
}

#[test]
fn while_it_has_no_place_one_of_its_stations_speaks_for_it() {
    let mut vessels = Vessels::new(&STATIONS.into());
    let mut nowhere = network(5, "live", &[1, 2]);
    nowhere["lat_deg"] = Value::Null;
    vessels.take(&nowhere, 0.0);
    let says = vessels.take(&track(2, "running"), 1.0);
    assert_eq!(who(&says), [VesselId::Network(5)]);
    assert!(vessels.take(&track(1, "running"), 2.0).is_empty(), "one speaks");
    let Some(Word::Says(seen)) = vessels.take(&track(2, "running"), 3.0).pop() else { panic!() };
    assert_eq!(seen.iter().map(|r| r.station).collect::<Vec<_>>(), [Some(2), Some(1)]);
    // It falls silent, or ends.
    assert_eq!(who(&vessels.take(&track(1, "running"), 3.5 + STALE_S)), [VesselId::Network(5)]);
    vessels.take(&track(1, "final"), 100.0);
    assert_eq!(who(&vessels.take(&track(2, "running"), 101.0)), [VesselId::Network(5)]);
    // A place ends that, and its lack for a while begins it again.
    vessels.take(&network(5, "live", &[1, 2]), 102.0);
    assert!(vessels.take(&track(2, "running"), 101.0 + STALE_S).is_empty());
    assert_eq!(who(&vessels.take(&track(2, "running"), 103.0 + STALE_S)), [VesselId::Network(5)]);
    // So does what contradicts itself, at once.
    vessels.take(&network(5, "live", &[1, 2]), 170.0);
    let mut contradicts = network(5, "live", &[1, 2]);
    contradicts["consistent"] = false.into();
    vessels.take(&contradicts, 180.0);
    assert_eq!(who(&vessels.take(&track(2, "running"), 181.0)), [VesselId::Network(5)]);
    vessels.take(&network(5, "final", &[1, 2]), 200.0);
    assert!(vessels.take(&track(2, "running"), 300.0).is_empty());
}
