//! Scenes of three stations and straight ways: what is fused of them, and what is not.

use super::*;
use sites::Site;

pub(super) const PLACES: [[f64; 2]; 3] = [[0.0, 0.0], [3000.0, 0.0], [1500.0, 2600.0]];
/// 2026-06-01.
const BEGIN_US: i64 = 1_780_272_000_000_000;
const LASTS_S: u32 = 400;
/// 99.9 % of chi-squared of four.
const FAR: f64 = 18.47;

/// Place at the beginning, velocity.
pub(super) type Way = [f64; 4];

pub(super) const NORTHWARDS: Way = [900.0, -1500.0, 1.0, 6.0];
const WESTWARDS: Way = [4200.0, 1100.0, -6.5, -0.5];

fn sites() -> Sites {
    let site = |(n, [x, y]): (usize, &[f64; 2])| Site {
        station: n as u16 + 1,
        at_m: [*x, *y, -100.0],
        north: 0.0,
        sd_orientation: 0.5f64.to_radians(),
        sd_clock_s: None,
        sound_speed_m_s: 1484.0,
    };
    Sites { sites: PLACES.iter().enumerate().map(site).collect(), frame: None }
}

/// Errors that are normal, the same in every run.
struct Errors(u64);

impl Errors {
    fn next(&mut self) -> f64 {
        let mut sum = -6.0;
        for _ in 0..12 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum += (self.0 >> 40) as f64 / (1u64 << 24) as f64;
        }
        sum
    }
}

fn at([x, y, vx, vy]: Way, t_s: f64) -> [f64; 2] {
    [x + vx * t_s, y + vy * t_s]
}

/// What a station sends of vessels, in order of time: a bearing of each a second, a report of each track every five, and the
/// last ones. It believes that vessels are 1.3 times as fast as they are, and is turned by `turned` radians.
pub(super) fn sends(n: usize, ways: &[Way], turned: f64) -> Vec<Value> {
    let mut errors = Errors(n as u64 + 1);
    let utc = |t_s: f64| rfc3339(BEGIN_US + (t_s * 1e6) as i64);
    let mut out = Vec::new();
    for second in 0..=LASTS_S {
        let t_s = f64::from(second);
        for (id, way) in ways.iter().enumerate() {
            let seen = |t_s: f64| {
                let [x, y] = at(*way, t_s);
                let (x, y) = (x - PLACES[n][0], y - PLACES[n][1]);
                (x.atan2(y) - turned, x.hypot(y))
            };
            let (azimuth, range) = seen(t_s - seen(t_s).1 / 1484.0);
            let azimuth = azimuth + 0.3f64.to_radians() * errors.next();
            out.push(json!({
                "type": "bearing", "station": n + 1, "session": 1, "t_s": t_s, "utc": utc(t_s), "sd_utc_s": 0.01,
                "azimuth_deg": azimuth.to_degrees().rem_euclid(360.0), "sd_azimuth_deg": 0.3,
            }));
            if second % 5 == 0 && second >= 20 {
                let (azimuth, _) = seen(t_s);
                let heading = way[2].atan2(way[3]) - turned;
                out.push(json!({
                    "type": "track", "station": n + 1, "session": 1, "id": id + 1, "t_s": t_s, "utc": utc(t_s),
                    "stage": if second == LASTS_S { "final" } else { "running" },
                    "x_m": 1.3 * range * azimuth.sin(), "y_m": 1.3 * range * azimuth.cos(),
                    "heading_deg": heading.to_degrees(), "speed_m_s": 1.3 * way[2].hypot(way[3]),
                }));
            }
        }
    }
    out
}

/// Network tracks as they stand at the end, and what else was said.
fn fused(fusion: &mut Fusion, records: &[Value]) -> (Vec<Value>, Vec<Value>) {
    let (mut standing, mut said): (Vec<Value>, Vec<Value>) = Default::default();
    for (_, what) in records.iter().flat_map(|r| fusion.take(r)) {
        if what["type"] != "network_track" {
            said.push(what);
            continue;
        }
        standing.retain(|t| t["id"] != what["id"]);
        standing.extend(Some(what).filter(|w| w["state"] != "withdrawn"));
    }
    (standing, said)
}

pub(super) fn by_time(mut records: Vec<Value>) -> Vec<Value> {
    records.sort_by_key(|r| us_of(&r["utc"]));
    records
}

fn all(ways: &[Way], turned: [f64; 3]) -> Vec<Value> {
    by_time((0..3).flat_map(|n| sends(n, ways, turned[n])).collect())
}

/// Squared error of a record's state in units of its covariance.
fn chi2(record: &Value, way: Way) -> f64 {
    let n = |key: &str| record[key].as_f64().unwrap();
    let t_s = (us_of(&record["utc"]).unwrap() - BEGIN_US) as f64 * 1e-6;
    let (speed, heading) = (n("speed_m_s"), n("heading_deg").to_radians());
    let [x, y] = at(way, t_s);
    let d = [n("x_m") - x, n("y_m") - y, speed * heading.sin() - way[2], speed * heading.cos() - way[3]];
    let mut c = [[0.0; 4]; 4];
    let given = record["covariance"].as_array().unwrap();
    assert_eq!(given.len(), 16);
    c.iter_mut().flatten().zip(given).for_each(|(c, x)| *c = x.as_f64().unwrap());
    spd::dot(&d, &spd::solve(&c, &d).unwrap())
}

fn members(record: &Value) -> Vec<(u64, u64)> {
    let of = |m: &Value| (m["station"].as_u64().unwrap(), m["id"].as_u64().unwrap());
    record["members"].as_array().unwrap().iter().map(of).collect()
}

#[test]
fn a_vessel_past_three_stations_is_one_track_whatever_the_order_in_which_they_come() {
    let records = all(&[NORTHWARDS], [0.0; 3]);
    let (standing, said) = fused(&mut Fusion::new(sites()), &records);
    let [track] = &standing[..] else { panic!("{standing:?}") };
    assert!(said.is_empty() && track["state"] == "final" && track["consistent"] == true, "{track}");
    assert_eq!(members(track), [(1, 1), (2, 1), (3, 1)]);
    assert!(chi2(track, NORTHWARDS) < FAR, "{}", chi2(track, NORTHWARDS));
    assert!((track["speed_m_s"].as_f64().unwrap() - 37f64.sqrt()).abs() < 0.3, "{track}");
    assert_eq!((&track["lat_deg"], &track["from_utc"]), (&Value::Null, &"2026-06-01T00:00:00Z".into()));
    let closest = track["closest"].as_array().unwrap();
    assert_eq!(closest.len(), 3, "{track}");
    for (n, of) in closest.iter().enumerate() {
        let ([x, y], [vx, vy]) = (at(NORTHWARDS, 0.0), [NORTHWARDS[2], NORTHWARDS[3]]);
        let (x, y) = (x - PLACES[n][0], y - PLACES[n][1]);
        let after_s = -(x * vx + y * vy) / (vx * vx + vy * vy);
        let [x, y] = [x + vx * after_s, y + vy * after_s];
        let told_s = (us_of(&of["utc"]).unwrap() - BEGIN_US) as f64 * 1e-6;
        let number = |key: &str| of[key].as_f64().unwrap();
        assert!((told_s - after_s).abs() < 5.0 * number("sd_s"), "{of}: {after_s} s");
        assert!(
            (number("range_m") - x.hypot(y)).abs() < 5.0 * number("sd_range_m"),
            "{of}: {} m",
            x.hypot(y)
        );
    }
    // One station after the other, as files are read.
    let mut in_turn = Fusion::new(sites());
    let late: Vec<Value> = [1, 2, 0].into_iter().flat_map(|n| sends(n, &[NORTHWARDS], 0.0)).collect();
    let (other, _) = fused(&mut in_turn, &late);
    assert_eq!((other.len(), members(&other[0])), (1, members(track)));
    assert!((other[0]["x_m"].as_f64().unwrap() - track["x_m"].as_f64().unwrap()).abs() < 1.0);
    // A link sends the last word of a track before the bearings that made it.
    let mut last_first = records;
    last_first.sort_by_key(|r| (r["stage"] != "final", us_of(&r["utc"])));
    let (other, _) = fused(&mut Fusion::new(sites()), &last_first);
    assert_eq!((other.len(), members(&other[0])), (1, members(track)));
    assert!(chi2(&other[0], NORTHWARDS) < FAR);
}

#[test]
fn two_vessels_whose_ways_cross_are_two_tracks_and_no_stations_track_is_in_both() {
    let (standing, _) = fused(&mut Fusion::new(sites()), &all(&[NORTHWARDS, WESTWARDS], [0.0; 3]));
    assert_eq!(standing.len(), 2, "{standing:?}");
    for (id, way) in [(1, NORTHWARDS), (2, WESTWARDS)] {
        let track = standing.iter().find(|t| members(t) == [(1, id), (2, id), (3, id)]);
        let track = track.unwrap_or_else(|| panic!("{standing:?}"));
        assert!(chi2(track, way) < FAR, "{}", chi2(track, way));
    }
}

#[test]
fn vessels_that_one_station_each_hears_are_no_network_track() {
    let records = [sends(0, &[NORTHWARDS], 0.0), sends(1, &[[4500.0, -2500.0, 1.0, 7.0]], 0.0)].concat();
    let (standing, _) = fused(&mut Fusion::new(sites()), &by_time(records));
    assert!(standing.iter().all(|t| t["consistent"] == false), "{standing:?}");
}

#[test]
fn a_station_turned_by_more_than_it_states_gives_no_confident_wrong_track() {
    for bad in 0..3 {
        let mut turned = [0.0; 3];
        turned[bad] = 3f64.to_radians();
        let (standing, _) = fused(&mut Fusion::new(sites()), &all(&[NORTHWARDS], turned));
        for track in standing {
            assert!(track["consistent"] == false || chi2(&track, NORTHWARDS) < FAR, "{bad}: {track}");
        }
    }
}

#[test]
fn where_the_geometry_tells_nothing_it_is_null() {
    // Along the line through two stations, from outside: neither bearing turns.
    let away: Way = [-3000.0, 0.0, -5.0, 0.0];
    let records = [sends(0, &[away], 0.0), sends(1, &[away], 0.0)].concat();
    let (standing, _) = fused(&mut Fusion::new(sites()), &by_time(records));
    let [track] = &standing[..] else { panic!("{standing:?}") };
    for key in ["x_m", "y_m", "var_x_m2", "heading_deg", "speed_m_s", "covariance", "closest", "consistent"] {
        assert!(track[key].is_null(), "{key} of {track}");
    }
    assert_eq!(members(track), [(1, 1), (2, 1)]);
}

#[test]
fn a_clock_that_jumps_is_named_and_what_it_said_before_moves_no_track() {
    let mut jumped = sends(1, &[NORTHWARDS], 0.0);
    for record in jumped.iter_mut().filter(|r| r["t_s"].as_f64() > Some(200.0)) {
        record["utc"] = rfc3339(us_of(&record["utc"]).unwrap() + 20_000_000);
    }
    let records = [sends(0, &[NORTHWARDS], 0.0), jumped, sends(2, &[NORTHWARDS], 0.0)].concat();
    let (standing, said) = fused(&mut Fusion::new(sites()), &by_time(records));
    let [warning] = &said[..] else { panic!("{said:?}") };
    assert!(
        warning["text"].as_str().unwrap().starts_with("station 2: its UTC has jumped by 20.0 s"),
        "{warning}"
    );
    for track in standing {
        assert!(track["consistent"] == false || chi2(&track, NORTHWARDS) < FAR, "{track}");
    }
}

#[test]
fn taken_up_again_a_network_track_keeps_its_number_and_its_tracks() {
    let records = all(&[NORTHWARDS, WESTWARDS], [0.0; 3]);
    let (half, _) = fused(&mut Fusion::new(sites()), &records[..records.len() / 4 * 3]);
    assert!(half.len() == 2 && half.iter().all(|t| t["state"] == "live"), "{half:?}");
    let mut again = Fusion::new(sites());
    half.iter().for_each(|t| assert!(again.take(t).is_empty()));
    let (end, _) = fused(&mut again, &records);
    assert_eq!(end.len(), 2);
    for track in &end {
        let before = half.iter().find(|t| t["id"] == track["id"]).unwrap();
        assert_eq!(members(before), members(track));
    }
}

#[test]
fn records_that_say_nothing_lead_to_nothing() {
    let mut fusion = Fusion::new(sites());
    for record in [
        json!(null),
        json!({ "type": "bearing" }),
        json!({ "type": "bearing", "station": 1, "session": 1, "utc": null, "azimuth_deg": 3.0, "sd_azimuth_deg": 1.0, "t_s": 1.0 }),
        json!({ "type": "bearing", "station": 70_000, "session": 1, "utc": "2026-06-01T00:00:00Z" }),
        json!({ "type": "track", "station": 1, "session": 1, "id": 1, "utc": "2026-06-01T00:00:00Z", "x_m": null }),
        json!({ "type": "track", "station": 9, "session": 1, "id": 1, "utc": "2026-06-01T00:00:00Z", "stage": "withdrawn" }),
        json!({ "type": "network_track", "id": 3, "members": [{ "station": 99 }] }),
    ] {
        assert!(fusion.take(&record).is_empty(), "{record}");
    }
}
