use super::*;
use crate::vessels::Word;
use serde_json::{Value, json};

const STATIONS: [(u16, (f64, f64)); 2] = [(1, (80.0, 10.0)), (2, (80.0, 11.0))];

fn report(station: u16, t_s: f64, east_m: f64) -> TrackReport {
    let record = json!({ "type": "track", "station": station, "session": 1, "id": 4, "stage": "running", "t_s": t_s,
        "utc": crate::report::rfc3339(t_s), "range_observable": true, "x_m": east_m, "y_m": 0.0,
        "var_x_m2": 100.0, "var_y_m2": 900.0, "cov_xy_m2": 0.0, "heading_deg": 90.0, "sd_heading_deg": 1.0,
        "cpa_time_s": t_s, "sd_cpa_time_s": 1.0, "cpa_range_m": 5.0, "sd_cpa_range_m": 1.0 });
    TrackReport::of(&record).unwrap()
}

fn network(state: &str, stations: &[u16]) -> Value {
    let members: Vec<Value> =
        stations.iter().map(|n| json!({ "station": n, "session": 1, "id": 4 })).collect();
    json!({ "type": "network_track", "id": 5, "state": state, "members": members, "utc": crate::report::rfc3339(100.0),
        "lat_deg": 80.0, "lon_deg": 10.5, "var_x_m2": 100.0, "var_y_m2": 900.0, "cov_xy_m2": 0.0 })
}

const fn track(station: u16) -> TrackId {
    TrackId { station: Some(station), session: Some(1), id: 4 }
}

#[test]
fn a_network_track_has_what_its_members_said_before_it_as_seen_from_its_first_station() {
    let mut vessels = Vessels::new(&STATIONS.into());
    let Some(Word::Says(own)) = vessels.take(&network("live", &[1, 2]), 0.0).pop() else { panic!() };
    let mut before = Before::default();
    before.joins(track(1), (5..12).map(|k| report(1, 10.0 * f64::from(k), 500.0)).collect(), 0.0);
    before.joins(track(2), (0..12).map(|k| report(2, 10.0 * f64::from(k), 500.0)).collect(), 0.0);
    let all = before.with(VesselId::Network(5), &own[..1], &vessels);
    let times: Vec<f64> = all.iter().map(|r| r.utc_s.unwrap().0.round()).collect();
    assert_eq!(times, [50.0, 60.0, 70.0, 80.0, 90.0, 0.0, 10.0, 20.0, 30.0, 40.0, 100.0]);
    assert!(all.iter().all(|r| r.station == Some(1) && r.vessel == VesselId::Network(5)));
    // The second station stands 19.4 km East of the first; its meridian turns by 0.985°.
    let ((x, y), covariance) = all[5].place.unwrap();
    let (lat, lon) = vessels.frame(1).unwrap().lat_lon_deg(x, y);
    let (east, north) = vessels.frame(2).unwrap().east_north_m(lat, lon);
    assert!((19_000.0..21_000.0).contains(&x) && (east - 500.0).abs() < 0.1 && north.abs() < 0.1, "{x} {y}");
    let turned = all[5].heading_rad.unwrap().0.to_degrees() - 90.0;
    assert!((turned + 0.985).abs() < 0.01 && covariance.xy < -10.0, "{turned} {covariance:?}");
    assert_eq!((all[5].cpa_range_m, all[0].cpa_range_m), (None, Some((5.0, 1.0))));
    // A member that has left takes its own along, and has it again when it speaks.
    vessels.take(&network("live", &[1]), 1.0);
    assert_eq!(before.with(VesselId::Network(5), &own[..1], &vessels).len(), 6);
    assert_eq!(
        (before.parts(VesselId::Track(track(2))).len(), before.parts(VesselId::Network(5)).len()),
        (12, 0)
    );
}

#[test]
fn a_vessel_that_its_first_station_hears_no_more_is_heard_from_the_others() {
    let vessels = Vessels::new(&STATIONS.into());
    let first = report(1, 0.0, 500.0);
    let seen = [report(2, 10.0, -19_000.0)];
    let goes_on = as_before(Some(&first), &seen, &vessels).unwrap();
    assert_eq!((goes_on.station, goes_on.utc_s), (Some(1), Some((10.0, None))));
    assert_eq!(as_before(None, &seen, &vessels), Some(seen[0]));
    assert_eq!(
        as_before(Some(&first), &[report(3, 0.0, 0.0)], &vessels),
        None,
        "nobody knows where that stands"
    );
}

#[test]
fn memory_is_bounded() {
    let mut before = Before::default();
    for id in 0..=TRACKS as u16 {
        before.joins(TrackId { id, ..track(1) }, vec![report(1, 0.0, 0.0)], f64::from(id));
    }
    assert_eq!(before.reports.len(), TRACKS);
    assert!(before.parts(VesselId::Track(TrackId { id: 0, ..track(1) })).is_empty());
    before.retain(&Vessels::default(), |_, joined_s| joined_s > 1999.0);
    assert_eq!(before.reports.len(), 1);
}
