//! How stations are divided, and that regions keep out of each other's way.

use super::super::tests::{NORTHWARDS, by_time, sends};
use super::*;
use seabearing_core::config::StationConfig;

fn listed(id: u16, lat_lon_deg: Option<(f64, f64)>) -> Listed {
    let mut config = StationConfig::array(16_000.0, [[0.0; 3]; 4]);
    (config.id, config.lat_lon_deg, config.depth_m) = (id, lat_lon_deg, 100.0);
    Listed {
        config,
        line: None,
        key: None,
        start: None,
        sd_orientation_deg: 0.5,
        sd_clock_s: None,
        calibration: None,
    }
}

/// Stations in a plane, kilometres.
fn plane(at_km: impl IntoIterator<Item = (f64, f64)>) -> Vec<Listed> {
    let station = |(n, (x, y)): (usize, (f64, f64))| {
        let mut s = listed(n as u16 + 1, None);
        s.config.local_east_north_m = Some((1000.0 * x, 1000.0 * y));
        s
    };
    at_km.into_iter().enumerate().map(station).collect()
}

fn numbers(regions: &Regions) -> Vec<String> {
    regions.regions.iter().map(Sites::numbers).collect()
}

#[test]
fn sixteen_near_each_other_are_one_region_and_a_seventeenth_makes_two_with_neighbours_in_each() {
    let row = |n: usize| plane((0..n).map(|k| (2.0 * k as f64, 0.0)));
    let (regions, notes) = Regions::of(&row(16));
    assert_eq!((numbers(&regions), notes.len()), (vec!["1 to 16".to_owned()], 0), "{notes:?}");
    let (regions, notes) = Regions::of(&row(17));
    assert_eq!((regions.stations(), regions.left_out), (17, 0));
    assert_eq!(numbers(&regions), ["1 to 14", "15 to 17"]);
    assert!(notes[0].contains("2 regions of at most 16 stations: 1 to 14; 15 to 17; "), "{notes:?}");
}

#[test]
fn clusters_stay_whole_whatever_the_order_of_the_file() {
    // Three networks of seven, 60 km from each other; stations of one are 3 km apart.
    let place = |k: usize| {
        let (network, n) = ((k % 3) as f64, (k / 3) as f64);
        (60.0 * network, 3.0 * n)
    };
    let (regions, _) = Regions::of(&plane((0..21).map(place)));
    let of = |first: usize| (0..7).map(|n| (3 * n + first).to_string()).collect::<Vec<_>>().join(", ");
    // Two of them are within reach of each other and few enough to be one region.
    assert_eq!(regions.regions.len(), 2, "{:?}", numbers(&regions));
    assert_eq!(numbers(&regions)[1], of(3));
    // Too far for one plane.
    let (regions, _) = Regions::of(&plane((0..21).map(place).map(|(x, y)| (2.0 * x, y))));
    assert_eq!(numbers(&regions), [of(1), of(2), of(3)]);
}

proptest::proptest! {
    #![proptest_config(seabearing_testkit::property(60))]

    #[test]
    fn every_station_is_in_one_region_at_most_and_none_is_too_large(
        size_km in 10.0..300.0f64,
        at in proptest::collection::vec((0.0..1.0f64, 0.0..1.0f64), 2..120),
    ) {
        let n = at.len();
        let (regions, notes) = Regions::of(&plane(at.into_iter().map(|(x, y)| (size_km * x, size_km * y))));
        let mut seen: Vec<u16> = regions.regions.iter().flat_map(|r| r.sites.iter().map(|s| s.station)).collect();
        let alone = notes.iter().filter(|n| n.contains("has no other")).count();
        assert_eq!(seen.len() + alone, n, "{notes:?}");
        seen.sort_unstable();
        seen.dedup();
        assert_eq!(seen.len(), regions.stations());
        for r in &regions.regions {
            assert!((2..=MAX_ARRAYS).contains(&r.sites.len()));
            let first = r.sites[0].at_m;
            assert!(r.sites.iter().all(|s| (s.at_m[0] - first[0]).hypot(s.at_m[1] - first[1]) <= FARTHEST_M));
        }
    }
}

#[test]
fn stations_across_the_date_line_and_at_a_pole_stand_side_by_side() {
    let two = |a, b| {
        let (regions, notes) = Regions::of(&[listed(1, Some(a)), listed(2, Some(b))]);
        assert!(notes.is_empty(), "{notes:?}");
        regions.regions[0].sites[1]
    };
    let east = two((60.0, 179.99), (60.0, -179.99));
    assert!((east.at_m[0] - 1116.0).abs() < 2.0 && east.at_m[1].abs() < 1.0, "{east:?}");
    // 0.02° of longitude at 60° turn North by 0.0173°, to the West as one goes East.
    assert!((east.north.to_degrees() + 0.02 * 60f64.to_radians().sin()).abs() < 1e-4, "{east:?}");
    let quarter = two((89.99, 0.0), (89.99, 90.0));
    // A quarter of the way round the pole North is turned by a quarter circle.
    assert!((quarter.north.to_degrees() + 90.0).abs() < 0.01, "{quarter:?}");
}

#[test]
fn stations_beyond_the_most_are_counted_and_told_in_one_line() {
    let all: Vec<Listed> =
        (1..=1030).map(|id| listed(id, Some((49.0, -123.0 + 0.01 * f64::from(id))))).collect();
    let (regions, notes) = Regions::of(&all);
    assert_eq!((regions.stations(), regions.left_out, notes.len()), (MOST, 6, 2), "{notes:?}");
    assert!(notes[1].contains("6 are not (from 1025 to 1030)"), "{notes:?}");
}

#[test]
fn who_has_no_position_or_is_far_away_is_named() {
    let all = [
        listed(1, Some((49.0, -123.0))),
        listed(2, None),
        listed(3, Some((49.0, -120.0))),
        listed(4, Some((-49.0, 57.0))),
        listed(5, Some((49.01, -123.0))),
        listed(6, Some((90.0, 0.0))),
    ];
    let (regions, notes) = Regions::of(&all);
    assert_eq!(numbers(&regions), ["1, 5"]);
    let said = [
        "station 2 has no position",
        "station 6 is at latitude 90°, where North has no direction",
        "station 3 has no other within 100 km",
        "station 4 has no other within 100 km",
    ];
    assert_eq!(notes.len(), said.len(), "{notes:?}");
    for (note, said) in notes.iter().zip(said) {
        assert!(note.starts_with(said), "{note}");
    }
    let mut two = [listed(1, None), listed(2, None)];
    two[1].config.local_east_north_m = Some((1500.0, 20.0));
    let (regions, notes) = Regions::of(&two);
    assert_eq!((regions.regions.len(), notes.len()), (0, 2), "{notes:?}");
}

/// Stations 1 to 3 at the origin, and seven such networks 40 km further each.
fn networks() -> Vec<Listed> {
    let places = super::super::tests::PLACES;
    plane((0..21).map(|k| (40.0 * (k / 3) as f64 + places[k % 3][0] / 1000.0, places[k % 3][1] / 1000.0)))
}

#[test]
fn vessels_of_seven_networks_are_a_track_each_under_numbers_of_their_own() {
    let (regions, notes) = Regions::of(&networks());
    assert_eq!(regions.stations(), 21, "{notes:?}");
    let mut fusions = Fusions::new(regions);
    let of = |network: u64| {
        let moved = move |mut record: Value| {
            record["station"] = (record["station"].as_u64().unwrap() + 3 * network).into();
            record
        };
        (0..3).flat_map(move |n| sends(n, &[NORTHWARDS], 0.0)).map(moved)
    };
    let records = by_time((0..7).flat_map(of).collect());
    let mut standing: HashMap<u64, Value> = HashMap::new();
    for (_, what) in records.iter().flat_map(|r| fusions.take(r)) {
        standing.insert(what["id"].as_u64().unwrap(), what);
    }
    standing.retain(|_, t| t["state"] != "withdrawn");
    assert_eq!(standing.len(), 7, "{standing:?}");
    let mut heard: Vec<u64> =
        standing.values().map(|t| t["members"][0]["station"].as_u64().unwrap()).collect();
    heard.sort_unstable();
    assert_eq!(heard, (0..7).map(|n| 3 * n + 1).collect::<Vec<_>>());
    assert!(standing.values().all(|t| t["state"] == "final" && t["members"].as_array().unwrap().len() == 3));
    // Taken up by a program that begins anew, numbers go on.
    let mut again = Fusions::new(Regions::of(&networks()).0);
    standing.values().for_each(|t| assert!(again.take(t).is_empty()));
    let most = *standing.keys().max().unwrap();
    let late = sends(0, &[NORTHWARDS], 0.0).into_iter().chain(sends(1, &[NORTHWARDS], 0.0)).map(|mut r| {
        r["session"] = 2.into();
        r
    });
    let new: Vec<_> = by_time(late.collect()).iter().flat_map(|r| again.take(r)).collect();
    assert!(!new.is_empty() && new.iter().all(|(_, t)| t["id"].as_u64().unwrap() > most), "{new:?}");
}
