mod fused;

use super::rules::Alarms;
use super::*;
use seabearing_host::toml_file::TomlFile;

const HERE: (f64, f64) = (50.0, -1.0);

fn watcher(rules: &str) -> Watcher {
    let alarms = Alarms::of(&TomlFile::of(rules, "alarms.toml")).unwrap();
    Watcher::new(alarms.rules, &[(1, HERE)].into(), [1, 2].into(), 0.0, true)
}

/// A vessel so far East of station 1, with a standard deviation of 20 m.
fn track(east_m: f64, stage: &str) -> Value {
    json!({
        "type": "track", "station": 1, "session": 3, "id": 7, "stage": stage, "t_s": 0.0, "utc": "1970-01-01T00:00:00Z",
        "x_m": east_m, "y_m": 0.0, "var_x_m2": 400.0, "var_y_m2": 400.0, "cov_xy_m2": 0.0, "range_observable": true,
        "cpa_time_s": 300.0, "sd_cpa_time_s": 5.0, "cpa_range_m": 200.0, "sd_cpa_range_m": 20.0,
    })
}

const EAST: &str = "[[alarms]]\nkind = \"inside\"\nname = \"east\"\n\
    polygon = [[49.99, -0.99], [50.01, -0.99], [50.01, -0.98], [49.99, -0.98]]\n";

fn states(records: &[Value]) -> Vec<&str> {
    records.iter().filter_map(|r| r["state"].as_str()).collect()
}

#[test]
fn a_vessel_in_an_area_is_told_once_and_its_leaving_once() {
    // The area begins 717 m East of the station.
    let mut watcher = watcher(EAST);
    let mut out = Vec::new();
    for t in 0..300 {
        let east_m = if (50..150).contains(&t) { 900.0 } else { 600.0 };
        let at = f64::from(t);
        out.extend(watcher.take(&track(east_m, "running"), at).into_iter().map(|r| (t, r)));
        out.extend(watcher.tick(at).into_iter().map(|r| (t, r)));
    }
    let told: Vec<_> = out.iter().map(|(t, r)| (*t, r["state"].as_str().unwrap())).collect();
    assert_eq!(told, [(50, "raised"), (180, "cleared")]);
    assert_eq!(out[0].1["id"], out[1].1["id"]);
    assert_eq!((&out[0].1["code"], &out[0].1["track"]), (&json!("VesselInside"), &json!(7)));
    assert!(
        out[0].1["text"].as_str().unwrap().starts_with("vessel 1.3.7: it is inside east, with probability")
    );
}

#[test]
fn the_border_is_no_place_for_an_alarm_to_come_and_go() {
    let mut watcher = watcher(EAST);
    let mut out = Vec::new();
    for t in 0..600 {
        // 1.5 standard deviations either side of the border.
        let east_m = 717.0 + 30.0 * f64::from(t).sin();
        out.extend(watcher.take(&track(east_m, "running"), f64::from(t)));
        out.extend(watcher.tick(f64::from(t)));
    }
    assert_eq!(states(&out), ["raised"]);
    let acknowledged = watcher.acknowledge(out[0]["id"].as_u64().unwrap()).unwrap();
    assert_eq!((&acknowledged["state"], watcher.standing()), (&json!("acknowledged"), (1, 0)));
    assert_eq!(watcher.acknowledge(out[0]["id"].as_u64().unwrap()), None);
    // Its track ends there.
    watcher.take(&track(717.0, "final"), 600.0);
    assert_eq!(states(&watcher.tick(631.0)), ["cleared"]);
}

#[test]
fn a_track_that_goes_silent_and_one_without_a_range_raise_nothing_for_ever() {
    let mut watcher = watcher(EAST);
    let mut blind = track(900.0, "running");
    blind["range_observable"] = false.into();
    assert!(watcher.take(&blind, 0.0).is_empty());
    assert_eq!(states(&watcher.take(&track(900.0, "running"), 1.0)), ["raised"]);
    let mut out = Vec::new();
    (2..400).for_each(|t| out.extend(watcher.tick(f64::from(t)).into_iter().map(|r| (t, r))));
    assert_eq!(out.iter().map(|(t, _)| *t).collect::<Vec<_>>(), [152], "120 s of silence and 30 s");
}

#[test]
fn a_silent_recorder_is_told_within_ten_seconds_once_and_cleared_once() {
    let mut watcher = watcher("[[alarms]]\nkind = \"silent\"\nafter_s = 60\nstations = [1]\n");
    let bearing = json!({ "type": "bearing", "station": 1 });
    let line = json!({ "type": "line", "station": 1, "state": "down" });
    let mut out = Vec::new();
    for half in 0..1000 {
        let t = 0.5 * f64::from(half);
        if !(100.0..300.0).contains(&t) {
            out.extend(watcher.take(&bearing, t).into_iter().map(|r| (t, r)));
        }
        out.extend(watcher.take(&line, t).into_iter().map(|r| (t, r)));
        out.extend(watcher.tick(t).into_iter().map(|r| (t, r)));
    }
    let told: Vec<_> = out.iter().map(|(t, r)| (*t, r["state"].as_str().unwrap())).collect();
    assert_eq!(told, [(160.0, "raised"), (300.5, "cleared")], "after the 60 s that the rule asks for");
}

#[test]
fn what_is_expected_and_what_is_near_count_by_their_probability() {
    let mut approach = watcher("[[alarms]]\nkind = \"approach\"\ndistance_m = 250\nwithin_s = 600\n");
    assert_eq!(states(&approach.take(&track(2000.0, "running"), 0.0)), ["raised"]);
    let mut far = track(2000.0, "running");
    far["sd_cpa_range_m"] = 500.0.into();
    assert!(
        watcher("[[alarms]]\nkind = \"approach\"\ndistance_m = 250\nwithin_s = 600\n")
            .take(&far, 0.0)
            .is_empty()
    );
    assert!(
        watcher("[[alarms]]\nkind = \"approach\"\ndistance_m = 250\nwithin_s = 60\n")
            .take(&track(2000.0, "running"), 0.0)
            .is_empty()
    );
    let mut range = watcher("[[alarms]]\nkind = \"range\"\nrange_m = 500\n");
    assert!(range.take(&track(495.0, "running"), 0.0).is_empty(), "60 % are not 80 %");
    assert_eq!(states(&range.take(&track(450.0, "running"), 0.0)), ["raised"]);
}

#[test]
fn channels_clocks_supplies_and_stores_are_watched() {
    let every = "[[alarms]]\nkind = \"channel\"\n[[alarms]]\nkind = \"clock\"\n[[alarms]]\nkind = \"supply\"\n[[alarms]]\nkind = \"storage\"\n";
    let mut watcher = watcher(every);
    let fault =
        |code: &str, value: i64| json!({ "type": "fault", "station": 2, "code": code, "value": value });
    let health = |dead: Value| json!({ "type": "health", "station": 2, "dead_channels": dead });
    let time = |sd: f64| json!({ "type": "time", "station": 2, "sd_utc_s": sd });
    let lost = json!({ "type": "lost", "station": 2, "frames": 3, "cause": "the recorder's store was full" });
    let steps = [
        (fault("OwnNoise", 2), "ChannelSick"),
        (time(3.0), "ClockUnsure"),
        (fault("SupplyLow", 9600), "SupplyLow"),
        (lost, "StorageFull"),
        (health(json!([2])), ""),
        (time(0.9), ""),
        (fault("ChannelBack", 2), ""),
        (time(0.1), ""),
        (json!({ "type": "hello", "station": 2 }), ""),
    ];
    let mut codes = Vec::new();
    for (t, (record, code)) in steps.iter().enumerate() {
        let out = watcher.take(record, t as f64);
        let found = out.first().and_then(|r| r["code"].as_str()).unwrap_or("");
        assert_eq!(found, *code, "{record}");
        codes.extend(
            watcher.tick(t as f64 + 0.9).iter().map(|r| (r["state"].to_string(), r["code"].to_string())),
        );
    }
    assert_eq!(watcher.standing().0, 1, "the store's alarm waits for ten minutes");
    assert_eq!(states(&watcher.tick(1000.0)), ["cleared"]);
    assert!(codes.iter().all(|(state, _)| state == "\"cleared\"") && codes.len() == 3, "{codes:?}");
}

#[test]
fn margins_and_cards_are_watched() {
    let mut watcher = watcher(
        "[[alarms]]\nkind = \"margin\"\n[[alarms]]\nkind = \"card\"\n[[alarms]]\nkind = \"supply\"\n",
    );
    let margins = |supply_v: Value, waiting: u32| {
        json!({ "type": "margins", "station": 2, "memory_bytes": 90000, "memory_free_bytes": 66144, "longest_s": 0.007,
            "waiting": waiting, "room": 7000, "supply_v": supply_v, "battery_v": null, "temperature_c": 12 })
    };
    let fault =
        |code: &str, value: i64| json!({ "type": "fault", "station": 2, "code": code, "value": value });
    let held =
        |code: &str| json!({ "type": "faults_held", "station": 2, "code": code, "count": 1, "value": 4 });
    let hello =
        |kind: &str, cause: u8| json!({ "type": "hello", "station": 2, "kind": kind, "reset_cause": cause });
    let steps = [
        (margins(json!(3.3), 0), vec![]),
        (margins(Value::Null, 0), vec![]),
        (margins(json!(2.996), 0), vec![("raised", "MarginSmall")]),
        (margins(json!(3.01), 0), vec![]),
        // What could not be measured is not over, and one limit hides no other.
        (margins(Value::Null, 6000), vec![("raised", "MarginSmall")]),
        (margins(json!(3.2), 6000), vec![("cleared", "MarginSmall")]),
        (margins(json!(3.2), 100), vec![("cleared", "MarginSmall")]),
        (fault("CardFailed", 64_000 << 8 | 4), vec![("raised", "CardFailed")]),
        (fault("CardFailed", 128_000 << 8 | 4), vec![]),
        (fault("CardBack", 192_000), vec![("cleared", "CardFailed")]),
        (held("CardFailed"), vec![("raised", "CardFailed")]),
        (fault("CardFull", 1 << 40), vec![("raised", "CardFull"), ("cleared", "CardFailed")]),
        // A pause by the schedule is no fault.
        (fault("Paused", 192_000), vec![]),
        (hello("array", 255), vec![]),
        (hello("waiting", 2), vec![]),
        (hello("array", 0), vec![("cleared", "CardFull")]),
        (fault("SupplyLow", 2850), vec![("raised", "SupplyLow")]),
        (json!({ "type": "bearing", "station": 2, "session": 1 }), vec![]),
        (hello("waiting", 0), vec![]),
        (hello("array", 2), vec![("cleared", "SupplyLow")]),
    ];
    for (t, (record, wanted)) in steps.into_iter().enumerate() {
        let mut out = watcher.take(&record, t as f64);
        out.extend(watcher.tick(t as f64 + 0.5));
        let found: Vec<_> =
            out.iter().map(|r| (r["state"].as_str().unwrap(), r["code"].as_str().unwrap())).collect();
        assert_eq!(found, wanted, "{record}");
    }
}

#[test]
fn a_base_station_that_starts_again_goes_on_with_what_stood() {
    let mut before = watcher(EAST);
    let raised = before.take(&track(900.0, "running"), 10.0);
    let mut after = watcher(EAST);
    assert!(after.resume(&raised, 20.0).is_empty());
    assert!(after.take(&track(900.0, "running"), 21.0).is_empty(), "it is raised once");
    after.take(&track(300.0, "running"), 30.0);
    assert_eq!(states(&after.tick(61.0)), ["cleared"]);
}

#[test]
fn rules_of_one_kind_go_on_with_their_own_alarms_and_none_stands_for_ever_without_a_rule() {
    let silent = |after_s: u32| format!("[[alarms]]\nkind = \"silent\"\nafter_s = {after_s}\n");
    let both = silent(2) + &silent(4);
    let mut before = watcher(&both);
    let raised = [before.tick(3.0), before.tick(5.0)].concat();
    let many = raised.len();
    assert!(many >= 2 && states(&raised).iter().all(|s| *s == "raised"), "{raised:?}");
    let mut after = watcher(&both);
    assert!(after.resume(&raised, 6.0).is_empty());
    assert_eq!((after.standing().0, after.tick(20.0).len()), (many, 0));
    assert_eq!(states(&watcher(&silent(2)).resume(&raised, 6.0)), vec!["cleared"; many / 2]);
    // Two of one name.
    let mut alike = raised.clone();
    alike.iter_mut().for_each(|record| record["name"] = "silent".into());
    assert_eq!(states(&watcher(&both).resume(&alike, 6.0)), vec!["cleared"; many / 2]);
}

#[test]
fn what_goes_on_has_times_of_its_own_and_ends_where_its_rule_names_other_stations() {
    let silent = |rest: &str| format!("[[alarms]]\nkind = \"silent\"\n{rest}\n");
    let mut raised = watcher(&silent("stations = [1]")).tick(200.0);
    assert_eq!(states(&raised), ["raised"]);
    // As the store hands it out.
    for key in ["utc", "received_utc"] {
        raised[0][key] = "1970-01-01T00:03:20Z".into();
    }
    let mut after = watcher(&silent("after_s = 900"));
    assert!(after.resume(&raised, 300.0).is_empty());
    let seen = after.acknowledge(raised[0]["id"].as_u64().unwrap()).unwrap();
    after.take(&json!({ "type": "bearing", "station": 1 }), 301.0);
    let heard = after.tick(302.0);
    let other = watcher(&silent("stations = [2]")).resume(&raised, 300.0);
    assert_eq!((states(&heard), states(&other)), (vec!["cleared"], vec!["cleared"]));
    for said in [&seen, &heard[0], &other[0]] {
        assert_eq!((&said["id"], &said["station"]), (&raised[0]["id"], &json!(1)));
        assert!(said["utc"].is_null() && said["received_utc"].is_null(), "{said}");
    }
}

#[test]
fn what_the_base_station_finds_itself_is_no_recorder_heard() {
    let mut watcher = watcher("[[alarms]]\nkind = \"silent\"\nafter_s = 60\nstations = [1]\n");
    watcher.take(&json!({ "type": "network_track", "station": 1 }), 50.0);
    watcher.take(&json!({ "type": "ais_fleet", "station": 1 }), 55.0);
    assert_eq!(states(&watcher.tick(61.0)), ["raised"]);
}

#[test]
fn a_disk_that_fills_is_told_once_and_cleared_with_room_to_spare() {
    let mut watcher = watcher("[[alarms]]\nkind = \"disk\"\nfree_mb = 100\nfree_percent = 10\n");
    let mut out = Vec::new();
    for (t, free_mb) in [2000, 101, 99, 98, 101, 109, 111, 111, 50, 2000].into_iter().enumerate() {
        // A disk of 500 MB: a tenth is less than what is asked for in bytes.
        out.extend(watcher.disk(free_mb * 1_000_000, 500_000_000, t as f64));
        out.extend(watcher.tick(t as f64));
        out.extend(watcher.tick(t as f64 + 0.5));
    }
    assert_eq!(states(&out), ["raised", "cleared", "raised", "cleared"]);
    assert_eq!((&out[0]["code"], &out[0]["station"]), (&json!("DiskLow"), &Value::Null));
    assert!(out[0]["text"].as_str().unwrap().contains("99 MB free, 19.8 % of it"), "{}", out[0]);
    // By its share of a large disk.
    assert_eq!(states(&watcher.disk(9_000_000_000, 100_000_000_000, 20.0)), ["raised"]);
}

#[test]
fn a_store_that_takes_nothing_is_an_alarm_until_it_takes_records_again() {
    let mut watcher = watcher("[[alarms]]\nkind = \"disk\"\n");
    let fails = json!({ "type": "note", "code": "StoreFails", "text": "cannot write: no space left" });
    let said = watcher.take(&fails, 0.0);
    assert_eq!((states(&said), &said[0]["code"]), (vec!["raised"], &json!("StoreFails")));
    assert!(said[0]["text"].as_str().unwrap().contains("no space left"));
    // Room alone does not say that it takes records, and a disk that is low is an alarm of its own, before it or after.
    watcher.disk(50, 100, 1.0);
    assert!(watcher.tick(2.0).is_empty());
    let codes = |said: &[Value]| said.iter().map(|r| r["code"].clone()).collect::<Vec<_>>();
    let mut low = self::watcher("[[alarms]]\nkind = \"disk\"\n");
    assert_eq!(codes(&low.disk(1, 100, 0.0)), ["DiskLow"]);
    let both = [low.disk(1, 100, 0.0), low.take(&fails, 0.5)].concat();
    assert_eq!((codes(&both), states(&both)), (vec![json!("StoreFails")], vec!["raised"]));
    low.take(&json!({ "type": "note", "code": "StoreTakes" }), 1.0);
    assert_eq!(codes(&low.tick(2.0)), ["StoreFails"]);
    // A base station that starts again goes on with it.
    let mut again = self::watcher("[[alarms]]\nkind = \"disk\"\n");
    again.resume(&said, 3.0);
    assert!(again.take(&fails, 4.0).is_empty());
    for watcher in [&mut watcher, &mut again] {
        watcher.take(&json!({ "type": "note", "code": "StoreTakes" }), 5.0);
        watcher.disk(50, 100, 6.0);
        assert_eq!(states(&watcher.tick(6.0)), ["cleared"]);
    }
}

#[test]
fn a_clock_without_utc_or_of_another_year_is_unsure() {
    let rule = "[[alarms]]\nkind = \"clock\"\nsd_s = 0.5\nwithout_s = 60\n";
    let utc = |t_s: f64| rfc3339(1_780_000_000.0 + t_s);
    let bearing = |t_s: f64, dated: Value| json!({ "type": "bearing", "station": 2, "t_s": t_s, "utc": dated, "received_utc": utc(t_s) });
    let time = |t_s: f64, off_s: f64| json!({ "type": "time", "station": 2, "t_s": t_s, "sd_utc_s": 0.01, "utc": utc(t_s + off_s), "received_utc": utc(t_s) });
    let mut out = Vec::new();
    let mut take = |watcher: &mut Watcher, t: u32, record: &Value| {
        out.extend(watcher.take(record, f64::from(t)).into_iter().map(|r| (t, r)));
        out.extend(watcher.tick(f64::from(t) + 0.9).into_iter().map(|r| (t, r)));
    };
    let mut dated = watcher(rule);
    for t in 0..200 {
        let at = f64::from(t);
        take(&mut dated, t, &bearing(at, if t < 100 { Value::Null } else { utc(at) }));
        // What has no moment says nothing of a clock.
        take(&mut dated, t, &json!({ "type": "hello", "station": 2, "utc": null }));
        if t >= 100 && t % 10 == 0 {
            take(&mut dated, t, &time(at, 0.0));
        }
    }
    let two_years = 2.0 * 365.25 * 86_400.0;
    for (t, off_s) in
        [(300, 0.0), (310, -two_years), (320, -2_500_000.0), (330, -86_400.0), (340, 90.0), (350, 1.0)]
    {
        take(&mut dated, t, &time(f64::from(t), off_s));
    }
    let told: Vec<_> =
        out.iter().map(|(t, r)| (*t, r["state"].as_str().unwrap(), r["code"].as_str().unwrap())).collect();
    assert_eq!(
        told,
        [
            (61, "raised", "ClockMissing"),
            (100, "cleared", "ClockMissing"),
            (310, "raised", "ClockWrong"),
            (330, "cleared", "ClockWrong"),
            (340, "raised", "ClockWrong"),
            (350, "cleared", "ClockWrong"),
        ]
    );
    let text = |n: usize| out[n].1["text"].as_str().unwrap();
    assert!(text(0).contains("no UTC since 1970-01-01T00:00:00Z"), "{}", text(0));
    assert!(text(2).contains("is 2 years behind this computer's clock"), "{}", text(2));
    assert!(text(4).contains("is 90 s ahead of this computer's clock"), "{}", text(4));
    // What is read from files is of any time.
    let alarms = Alarms::of(&TomlFile::of(rule, "alarms.toml")).unwrap();
    let mut of_files = Watcher::new(alarms.rules, &[].into(), [2].into(), 0.0, false);
    assert!(of_files.take(&time(0.0, -two_years), 0.0).is_empty());
}

#[test]
fn a_silent_recorder_is_told_with_the_time_since_when() {
    let mut watcher = watcher("[[alarms]]\nkind = \"silent\"\nafter_s = 5\n");
    watcher.take(&json!({ "type": "bearing", "station": 1 }), 3.5);
    let said = watcher.tick(10.0);
    let texts: Vec<_> = said.iter().map(|r| r["text"].as_str().unwrap()).collect();
    assert_eq!(
        texts,
        [
            "station 1 has not been heard since 1970-01-01T00:00:03Z",
            "station 2 has not been heard since this base station began, 1970-01-01T00:00:00Z",
        ]
    );
}

#[test]
fn an_alarm_of_a_rule_that_is_of_another_kind_now_is_cleared() {
    let silent = "[[alarms]]\nkind = \"silent\"\nname = \"watch\"\nstations = [1]\n";
    let raised = watcher(silent).tick(200.0);
    assert_eq!(states(&raised), ["raised"]);
    assert!(watcher(silent).resume(&raised, 300.0).is_empty());
    let of_clock = silent.replace("silent", "clock");
    assert_eq!(states(&watcher(&of_clock).resume(&raised, 300.0)), ["cleared"]);
}

#[test]
fn limits_that_nothing_can_reach_are_refused_and_what_is_over_is_cleared_at_the_end() {
    for wrong in ["full_percent = 100", "temperature_c = 200", "supply_v = 3000", "cell_v = 0"] {
        let text = format!("[[alarms]]\nkind = \"margin\"\n{wrong}\n");
        let key = wrong.split(' ').next().unwrap();
        let said = Alarms::of(&TomlFile::of(&text, "a.toml")).unwrap_err().to_string();
        assert!(said.contains(key) && said.contains("above"), "{said}");
    }
    let mut watcher = watcher("[[alarms]]\nkind = \"card\"\nclear_after_s = 60\n");
    let fault = |code: &str| json!({ "type": "fault", "station": 2, "code": code, "value": 4 });
    assert_eq!(states(&watcher.take(&fault("CardFailed"), 0.0)), ["raised"]);
    assert!(watcher.take(&fault("CardBack"), 1.0).is_empty());
    assert_eq!(states(&watcher.finish(2.0)), ["cleared"]);
}
