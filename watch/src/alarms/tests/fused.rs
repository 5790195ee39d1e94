//! Vessels that several stations hear: one alarm, that is not lost.

use super::*;

/// Two stations 717 m apart; the second stands where the area of [`EAST`] begins.
fn by_two(rules: &str) -> Watcher {
    let alarms = Alarms::of(&TomlFile::of(rules, "alarms.toml")).unwrap();
    Watcher::new(alarms.rules, &[(1, HERE), (2, (50.0, -0.99))].into(), [1, 2].into(), 0.0, true)
}

/// The same vessel as [`track`] has it, as the second station does.
fn by_second(east_m: f64, stage: &str) -> Value {
    let mut record = track(east_m - 717.0, stage);
    (record["station"], record["id"]) = (2.into(), 4.into());
    record
}

/// The network track of both, so far East of the first station.
fn network(id: u32, east_m: f64, state: &str) -> Value {
    let member = |station: u16, id: u16| json!({ "station": station, "session": 3, "id": id });
    let closest = |station: u16, range_m: f64| json!({ "station": station, "utc": "1970-01-01T00:05:00Z", "sd_s": 5.0, "range_m": range_m, "sd_range_m": 20.0 });
    json!({
        "type": "network_track", "id": id, "state": state, "members": [member(1, 7), member(2, 4)], "station": null,
        "utc": "1970-01-01T00:00:00Z", "lat_deg": 50.0, "lon_deg": -1.0 + 0.01 * east_m / 717.0,
        "var_x_m2": 100.0, "var_y_m2": 100.0, "cov_xy_m2": 0.0, "closest": [closest(1, 2000.0), closest(2, 200.0)],
    })
}

#[test]
fn a_vessel_that_two_stations_hear_has_one_alarm_that_goes_on_when_fusion_finds_it_and_ends_with_it() {
    let mut watcher = by_two(EAST);
    let mut out = Vec::new();
    for t in 0..300 {
        let at = f64::from(t);
        let stage = if t == 200 { "final" } else { "running" };
        if t <= 200 && t % 5 == 0 {
            out.extend(watcher.take(&track(900.0, stage), at).into_iter().map(|r| (t, r)));
            // The second hears it a little later, and fusion finds that at 30 s.
            let second = if t >= 20 { watcher.take(&by_second(910.0, stage), at) } else { Vec::new() };
            out.extend(second.into_iter().map(|r| (t, r)));
        }
        if (30..=200).contains(&t) && t % 10 == 0 {
            let state = if t == 200 { "final" } else { "live" };
            out.extend(watcher.take(&network(5, 905.0, state), at).into_iter().map(|r| (t, r)));
        }
        out.extend(watcher.tick(at).into_iter().map(|r| (t, r)));
    }
    let told: Vec<_> = out.iter().map(|(t, r)| (*t, r["state"].as_str().unwrap())).collect();
    assert_eq!(told, [(0, "raised"), (230, "cleared")]);
    let (raised, cleared) = (&out[0].1, &out[1].1);
    assert_eq!((&raised["id"], &raised["station"]), (&cleared["id"], &cleared["station"]));
    assert_eq!((&raised["track"], &raised["network"]), (&json!(7), &Value::Null));
    assert_eq!((&cleared["track"], &cleared["network"]), (&Value::Null, &json!(5)));
}

#[test]
fn of_two_alarms_of_one_vessel_the_later_is_cleared_when_that_is_found() {
    let mut watcher = by_two(EAST);
    let first = watcher.take(&track(900.0, "running"), 0.0);
    // Far from there: another vessel, as it seems, and nothing to wait for.
    let second = watcher.take(&by_second(1200.0, "running"), 1.0);
    assert_eq!((states(&first), states(&second)), (vec!["raised"], vec!["raised"]));
    let joined = watcher.take(&network(5, 1000.0, "live"), 2.0);
    assert_eq!((states(&joined), &joined[0]["id"]), (vec!["cleared"], &second[0]["id"]));
    assert_eq!(watcher.standing(), (1, 1));
    // It was a mistake: there are two again, and the alarm goes on with the first of them.
    assert!(watcher.take(&network(5, 1000.0, "withdrawn"), 3.0).is_empty());
    assert!(watcher.take(&track(900.0, "running"), 4.0).is_empty());
    assert_eq!(states(&watcher.take(&by_second(1200.0, "running"), 4.0)), ["raised"]);
}

#[test]
fn a_track_where_another_station_has_an_alarm_waits_for_fusion_and_no_longer() {
    let mut watcher = by_two(EAST);
    watcher.take(&track(900.0, "running"), 0.0);
    // The same station's own tracks are two vessels.
    let mut beside = track(905.0, "running");
    beside["id"] = 8.into();
    assert_eq!(states(&watcher.take(&beside, 0.0)), ["raised"]);
    let mut out = Vec::new();
    for t in 1..40 {
        let at = f64::from(t);
        out.extend(watcher.take(&by_second(910.0, "running"), at).into_iter().map(|r| (t, r)));
        out.extend(watcher.tick(at).into_iter().map(|r| (t, r)));
    }
    let told: Vec<_> = out.iter().map(|(t, r)| (*t, &r["state"], &r["station"])).collect();
    assert_eq!(told, [(13, &json!("raised"), &json!(2))]);
}

/// Both tracks, the second of which waits.
fn waiting(rules: &str) -> Watcher {
    let mut watcher = by_two(rules);
    assert_eq!(states(&watcher.take(&track(900.0, "running"), 0.0)), ["raised"]);
    assert!(watcher.take(&by_second(910.0, "running"), 1.0).is_empty());
    watcher
}

#[test]
fn an_alarm_whose_track_ends_while_it_waits_is_told_and_then_cleared() {
    for last in [by_second(910.0, "final"), by_second(300.0, "running")] {
        let mut watcher = waiting(EAST);
        let mut out = watcher.take(&last, 2.0).into_iter().map(|r| (2, r)).collect::<Vec<_>>();
        (3..60).for_each(|t| out.extend(watcher.tick(f64::from(t)).into_iter().map(|r| (t, r))));
        let told: Vec<_> = out.iter().map(|(t, r)| (*t, &r["state"], &r["station"])).collect();
        assert_eq!(told, [(13, &json!("raised"), &json!(2)), (43, &json!("cleared"), &json!(2))]);
    }
    // What was no vessel is not told.
    let mut watcher = waiting(EAST);
    watcher.take(&by_second(910.0, "withdrawn"), 2.0);
    assert!(watcher.tick(20.0).is_empty() && watcher.finish(20.0).is_empty());
}

#[test]
fn an_alarm_that_waits_when_all_ends_is_told() {
    let mut watcher = waiting(EAST);
    watcher.take(&by_second(910.0, "final"), 2.0);
    let told = watcher.finish(2.5);
    assert_eq!((states(&told), &told[0]["station"]), (vec!["raised"], &json!(2)));
    assert!(watcher.finish(3.0).is_empty());
    // Of one vessel, as fusion has found, it is no other alarm.
    for joined in ["live", "final"] {
        let mut watcher = waiting(EAST);
        watcher.take(&by_second(910.0, "final"), 2.0);
        watcher.take(&network(5, 905.0, joined), 2.0);
        assert!(watcher.finish(3.0).is_empty());
    }
    // Of one that fusion finds to be another's it goes on.
    let mut watcher = waiting(EAST);
    let mut other = network(6, 905.0, "final");
    other["members"][0]["id"] = 99.into();
    assert!(watcher.take(&other, 2.0).is_empty());
    let told = watcher.finish(3.0);
    assert_eq!((states(&told), &told[0]["network"]), (vec!["raised"], &json!(6)));
}

#[test]
fn what_was_there_at_another_time_is_nothing_to_wait_for() {
    for (later_s, states_now) in [(50, vec![]), (3600, vec!["raised"])] {
        let mut watcher = by_two(EAST);
        watcher.take(&track(900.0, "running"), 0.0);
        let mut other = by_second(910.0, "running");
        other["utc"] = rfc3339(f64::from(later_s));
        assert_eq!(states(&watcher.take(&other, 1.0)), states_now, "{later_s} s");
    }
    // Of files one comes behind the other: where the first was then counts.
    let mut watcher = by_two(EAST);
    for t in 0..100 {
        let mut first = track(900.0, "running");
        first["utc"] = rfc3339(10.0 * f64::from(t));
        watcher.take(&first, 0.0);
    }
    assert!(watcher.take(&by_second(910.0, "running"), 1.0).is_empty());
}

#[test]
fn a_station_that_is_not_listed_is_not_missed() {
    let silent = "[[alarms]]\nkind = \"silent\"\nafter_s = 5\n";
    let of = |listed: &[u16], rules: &str| {
        let alarms = Alarms::of(&TomlFile::of(rules, "alarms.toml")).unwrap();
        Watcher::new(
            alarms.rules,
            &[(1, HERE), (2, HERE)].into(),
            listed.iter().copied().collect(),
            0.0,
            true,
        )
    };
    let missed =
        |records: &[Value]| records.iter().map(|r| r["station"].as_u64().unwrap()).collect::<Vec<_>>();
    let heard = |station: u16| json!({ "type": "bearing", "station": station });
    // Where the second once stood is known from the store, and it is heard now and then.
    let mut listed = of(&[1], silent);
    listed.take(&heard(2), 1.0);
    let raised = listed.tick(10.0);
    assert_eq!(missed(&raised), [1]);
    // Without a list those are that have been heard, and those that a rule names.
    let mut unlisted = of(&[], silent);
    unlisted.take(&heard(2), 1.0);
    assert_eq!(missed(&unlisted.tick(10.0)), [2]);
    assert_eq!(missed(&of(&[], &format!("{silent}stations = [1]\n")).tick(10.0)), [1]);
    // One that was taken out of the list.
    assert_eq!(states(&of(&[2], silent).resume(&raised, 20.0)), ["cleared"]);
    assert!(of(&[1, 2], silent).resume(&raised, 20.0).is_empty());
}

#[test]
fn whose_an_alarm_is_after_a_network_track_was_withdrawn_is_known_after_a_restart() {
    let mut before = by_two(EAST);
    let mut stored = vec![network(5, 905.0, "live")];
    stored.extend(before.take(&stored[0].clone(), 10.0));
    stored.push(network(5, 905.0, "withdrawn"));
    assert!(before.take(&stored[2].clone(), 11.0).is_empty());
    // As the one before would go on.
    for watcher in [&mut before, &mut {
        let mut after = by_two(EAST);
        assert!(after.resume(&stored, 20.0).is_empty());
        after
    }] {
        assert!(watcher.take(&track(900.0, "running"), 21.0).is_empty());
        assert!(watcher.take(&track(900.0, "final"), 22.0).is_empty());
        let cleared = watcher.tick(60.0);
        assert_eq!((states(&cleared), &cleared[0]["track"]), (vec!["cleared"], &json!(7)));
    }
}

#[test]
fn a_rule_about_some_stations_counts_what_is_seen_from_those() {
    let near = "[[alarms]]\nkind = \"range\"\nrange_m = 300\nstations = [STATION]\n[[alarms]]\nkind = \"approach\"\n\
        distance_m = 250\nwithin_s = 600\nstations = [STATION]\n";
    for (station, codes) in [("1", vec![]), ("2", vec!["VesselNear", "VesselApproaches"])] {
        let out = by_two(&near.replace("STATION", station)).take(&network(5, 900.0, "live"), 0.0);
        assert_eq!(out.iter().filter_map(|r| r["code"].as_str()).collect::<Vec<_>>(), codes);
        assert!(out.iter().all(|r| r["station"] == 2 && r["network"] == 5), "{out:?}");
    }
    let out = by_two(&near.replace("STATION", "2")).take(&network(5, 900.0, "live"), 0.0);
    let text = out[1]["text"].as_str().unwrap();
    assert!(
        text.starts_with("vessel N5 (station 2): it will pass at 200 m at 1970-01-01T00:05:00Z"),
        "{text}"
    );
}

#[test]
fn a_base_station_that_starts_again_knows_whose_alarm_it_is() {
    let mut before = by_two(EAST);
    let mut stored = before.take(&track(900.0, "running"), 10.0);
    stored.push(network(5, 905.0, "live"));
    let mut after = by_two(EAST);
    assert!(after.resume(&stored, 20.0).is_empty());
    for report in [by_second(910.0, "running"), network(5, 905.0, "live"), track(900.0, "running")] {
        assert!(after.take(&report, 21.0).is_empty(), "{report}");
    }
    assert!(after.take(&network(5, 905.0, "final"), 22.0).is_empty());
    let cleared = after.tick(60.0);
    assert_eq!((states(&cleared), &cleared[0]["network"]), (vec!["cleared"], &json!(5)));
}
