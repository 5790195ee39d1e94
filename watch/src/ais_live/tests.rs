//! Verdicts as reports come, and sources that misbehave.

use super::*;
use crate::report::rfc3339;
use seabearing_host::geodesy::LocalFrame;
use std::io::Write;
use std::net::{TcpListener, UdpSocket};
use std::sync::mpsc::Receiver;

/// Some time in 2026, s since 1970.
const THEN_S: f64 = 1_780_000_000.0;
const PLACE: (f64, f64) = (50.0, -1.0);
/// A published example of a position report.
const SENTENCE: &str = "!AIVDM,1,1,,B,177KQJ5000G?tO`K>RA1wUbN0TKH,0*5C";

/// A report of a vessel `east_m` of the station that goes North at 5 m/s, after so many seconds.
fn report(mmsi: u64, east_m: f64, after_s: f64) -> Told {
    let frame = LocalFrame::new(PLACE.0, PLACE.1);
    Told::Position(AisReport {
        mmsi,
        t_s: THEN_S + after_s + 0.1,
        lat_lon_deg: frame.lat_lon_deg(east_m, 5.0 * after_s - 500.0),
        speed_m_s: None,
        status: None,
        ship_type: None,
        terrestrial: None,
        length_m: None,
    })
}

fn track(id: u16, east_m: f64, after_s: f64, stage: &str) -> Value {
    json!({ "type": "track", "station": 7, "session": 3, "id": id, "stage": stage, "t_s": after_s, "utc": rfc3339(THEN_S + after_s),
        "sd_utc_s": 0.01, "x_m": east_m, "y_m": 5.0 * after_s - 500.0, "var_x_m2": 400.0, "var_y_m2": 400.0, "cov_xy_m2": 0.0,
        "range_observable": true, "heading_deg": 0.0, "sd_heading_deg": 3.0, "speed_m_s": 5.0, "sd_speed_m_s": 0.3,
        "cpa_time_s": 100.0, "sd_cpa_time_s": 2.0, "cpa_range_m": east_m.abs(), "sd_cpa_range_m": 20.0 })
}

fn live() -> Live {
    let mut live = Live::new(&BTreeMap::from([(7, PLACE)]), Rules::default());
    live.told(Told::Particulars { mmsi: 11, name: Some("ANNA".to_owned()), length_m: Some(80.0) });
    live
}

/// What is told of a passage of two tracks, of which the second has no vessel.
fn passage(live: &mut Live) -> Vec<Value> {
    let mut said = Vec::new();
    for k in 0..20 {
        let t_s = 10.0 * f64::from(k);
        live.told(report(11, 600.0, t_s));
        live.told(report(12, -9000.0, t_s));
        live.take(&track(1, 605.0, t_s, if k < 19 { "running" } else { "final" }), t_s);
        live.take(&track(2, -700.0, t_s, "running"), t_s);
        said.extend(live.judge(t_s).into_iter().map(|(station, record)| {
            assert_eq!(station, Some(7));
            record
        }));
    }
    said
}

#[test]
fn a_verdict_is_told_when_it_changes_and_once_more_with_errors_at_the_end() {
    let mut live = live();
    let said = passage(&mut live);
    let last = |id: u64| said.iter().rfind(|r| r["id"] == id).unwrap();
    assert_eq!(
        (&last(1)["verdict"], &last(1)["mmsi"], &last(1)["name"]),
        (&json!("vessel"), &json!(11), &json!("ANNA"))
    );
    assert_eq!((&last(2)["verdict"], &last(2)["stage"]), (&json!("dark"), &json!("running")));
    assert!(said.len() <= 6, "{said:?}");
    assert!(live.judge(200.0).is_empty());
    let end: Vec<Value> = live.judge(190.0 + SETTLED_S + 1.0).into_iter().map(|(_, r)| r).collect();
    assert_eq!(end.len(), 2);
    assert!(end.iter().all(|r| r["stage"] == "final"));
    let error_m = end[0]["rms_position_error_m"].as_f64().unwrap();
    assert!((1.0..15.0).contains(&error_m), "{error_m}");
    assert_eq!(end[0]["of_session"], 3);
    // Each is told once, and tracks of long ago are let go of.
    assert!(live.judge(400.0).is_empty());
    live.judge(190.0 + JUDGED_S + 1.0);
    assert!(live.tracks.is_empty());
}

#[test]
fn without_ais_nothing_is_dark() {
    let mut live = Live::new(&BTreeMap::from([(7, PLACE)]), Rules::default());
    for k in 0..20 {
        live.take(&track(2, -700.0, 10.0 * f64::from(k), "running"), 0.0);
    }
    let said = live.judge(0.0);
    assert_eq!((said.len(), &said[0].1["verdict"]), (1, &json!("unmatched")));
}

#[test]
fn two_vessels_with_one_number_are_told_once() {
    let mut live = live();
    for k in 0..20 {
        let t_s = 10.0 * f64::from(k);
        live.told(report(11, 600.0, t_s));
        live.told(report(11, 60_000.0, t_s + 5.0));
        live.take(&track(1, 605.0, t_s, "running"), t_s);
    }
    let said = live.judge(0.0);
    let warnings: Vec<&Value> = said.iter().map(|(_, r)| r).filter(|r| r["type"] == "warning").collect();
    assert_eq!(warnings.len(), 1, "{said:?}");
    assert!(warnings[0]["text"].as_str().unwrap().contains("11: 2 vessels have this number"));
    live.told(report(11, 600.0, 200.0));
    assert!(live.judge(1.0).iter().all(|(_, r)| r["type"] != "warning"));
}

#[test]
fn a_file_is_there_for_tracks_of_any_of_its_times() {
    let mut live = live();
    for k in 0..20 {
        live.told_of_file(report(11, 600.0, 10.0 * f64::from(k)));
        live.told_of_file(report(11, 600.0, 90_000.0 + 10.0 * f64::from(k)));
    }
    // Nothing is heard for a while.
    assert!(live.judge(2.0).is_empty() && live.judge(4.0).is_empty());
    for k in 0..20 {
        let t_s = 10.0 * f64::from(k);
        live.take(&track(1, 605.0, t_s, "running"), 5.0);
    }
    let said = live.judge(6.0);
    assert_eq!((said.len(), &said[0].1["mmsi"]), (1, &json!(11)), "{said:?}");
}

#[test]
fn memory_is_bounded_whatever_comes() {
    let mut live = live();
    for k in 0..3000u32 {
        live.told(report(11, 600.0, 10.0 * f64::from(k)));
        live.take(&track(k as u16, 1.0, 10.0 * f64::from(k), "running"), f64::from(k));
        live.take(&track(0, 1.0, 10.0 * f64::from(k), "running"), f64::from(k));
    }
    assert!(live.tracks.len() <= TRACKS && live.tracks.values().all(|t| t.reports.len() <= REPORTS));
    live.tracks.clear();
    live.judge(3000.0);
    assert!(live.ais.len() < 1000, "{}", live.ais.len());
}

#[test]
fn a_source_is_what_its_text_says() {
    let parse = |text: &str| text.parse::<Source>();
    assert_eq!(parse("tcp:host:10110"), Ok(Source::Tcp("host:10110".into())));
    assert_eq!(parse("udp:0.0.0.0:10110"), Ok(Source::Udp("0.0.0.0:10110".into())));
    assert_eq!(parse("serial:/dev/ttyUSB0:38400"), Ok(Source::Serial("/dev/ttyUSB0".into(), 38_400)));
    assert_eq!(parse("C:\\traffic.csv"), Ok(Source::File("C:\\traffic.csv".into())));
    for wrong in ["tcp:host", "udp::1", "serial:/dev/ttyUSB0", "serial:/dev/ttyUSB0:fast", ""] {
        assert!(parse(wrong).is_err(), "{wrong}");
    }
}

/// What is said next, waited for.
fn next(said: &Receiver<Said>) -> Said {
    said.recv_timeout(Duration::from_secs(30)).unwrap()
}

#[test]
fn a_peer_that_goes_away_is_told_once_and_called_again() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let (to, said) = sync_channel(100);
    source::start(Source::Tcp(listener.local_addr().unwrap().to_string()), to).unwrap();
    for round in 0..2 {
        let mut peer = listener.accept().unwrap().0;
        write!(peer, "noise\n{SENTENCE}\r\n!AIVDM,1,1,,B,177KQJ5").unwrap();
        if round > 0 {
            assert!(matches!(next(&said), Said::Note("AisBack", _)));
        } else {
            let Said::Note("AisBroken", text) = next(&said) else { panic!("no note") };
            assert!(text.contains("1 broken sentences") && text.contains("noise"), "{text}");
        }
        assert!(matches!(next(&said), Said::Of(Told::Position(_))));
        drop(peer);
        let Said::Note("AisAway", text) = next(&said) else { panic!("no note") };
        assert!(text.contains("tried again"), "{text}");
    }
}

#[test]
fn a_peer_that_lets_in_and_sends_away_is_named_once() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let (to, said) = sync_channel(100);
    source::start(Source::Tcp(listener.local_addr().unwrap().to_string()), to).unwrap();
    for _ in 0..3 {
        drop(listener.accept().unwrap());
    }
    assert!(matches!(next(&said), Said::Note("AisAway", _)));
    assert_eq!(said.try_recv().ok(), None);
}

#[test]
fn datagrams_are_taken_and_times_far_from_the_clock_are_told() {
    let probe = UdpSocket::bind("127.0.0.1:0").unwrap();
    let at = probe.local_addr().unwrap().to_string();
    drop(probe);
    let (to, said) = sync_channel(100);
    source::start(Source::Udp(at.clone()), to).unwrap();
    let from = UdpSocket::bind("127.0.0.1:0").unwrap();
    from.send_to(format!("\\c:1696241893*5F\\{SENTENCE}").as_bytes(), &at).unwrap();
    assert!(matches!(next(&said), Said::Note("AisClock", _)));
    let Said::Of(Told::Position(report)) = next(&said) else { panic!("no position") };
    assert!((report.t_s - 1_696_241_893.0).abs() <= 30.0);
    // Beside it a receiver that tells no time: it is not told with every sentence.
    for _ in 0..3 {
        from.send_to(SENTENCE.as_bytes(), &at).unwrap();
        from.send_to(format!("\\c:1696241893*5F\\{SENTENCE}").as_bytes(), &at).unwrap();
    }
    for _ in 0..6 {
        assert!(matches!(next(&said), Said::Of(Told::Position(_))));
    }
}

#[test]
fn what_became_of_all_tracks_is_told_at_the_end_and_every_hour() {
    let mut live = live();
    passage(&mut live);
    let end = live.finish();
    let kinds: Vec<(&str, &str)> =
        end.iter().map(|(_, r)| (r["type"].as_str().unwrap(), r["stage"].as_str().unwrap_or(""))).collect();
    assert_eq!(kinds, [("ais_match", "final"), ("ais_match", "final"), ("ais_fleet", "")]);
    let fleet = &end[2].1;
    assert_eq!((&fleet["tracks"], &fleet["vessels"], &fleet["dark"]), (&json!(2), &json!(1), &json!(1)));
    let heading = &fleet["heading_deg"]["histogram_sd"]["counts"];
    assert_eq!(heading.as_array().unwrap().iter().filter_map(Value::as_u64).sum::<u64>(), 1);
    // 80 m long and 5 m/s fast.
    assert_eq!(
        (&fleet["heard_by_length_m"][1]["tracks"], &fleet["heard_by_speed_m_s"][1]["tracks"]),
        (&json!(1), &json!(1))
    );
    // Nothing has ended since.
    assert!(live.finish().is_empty());
    // One that goes on and ends again is still one; it is told an hour later.
    live.take(&track(1, 605.0, 210.0, "final"), 250.0);
    assert!(live.judge(320.0).iter().all(|(_, r)| r["type"] != "ais_fleet"));
    live.take(&track(3, 5000.0, 220.0, "running"), 4000.0);
    let hourly = live.judge(4001.0);
    let fleet = hourly.iter().find(|(_, r)| r["type"] == "ais_fleet").map(|(_, r)| r);
    assert_eq!(fleet.map(|f| f["tracks"].clone()), Some(json!(2)), "{hourly:?}");
}

#[test]
fn names_of_vessels_that_nobody_ever_saw_fill_no_memory() {
    let mut live = live();
    for mmsi in 0..NAMES as u64 + 500 {
        live.told(Told::Particulars { mmsi, name: Some("X".to_owned()), length_m: Some(9.0) });
    }
    assert_eq!((live.names.len(), live.lengths.len()), (NAMES, NAMES));
}

#[test]
fn a_track_withdrawn_after_its_end_is_counted_no_more() {
    let mut live = live();
    passage(&mut live);
    live.judge(190.0 + SETTLED_S + 1.0);
    live.take(&track(2, -700.0, 200.0, "withdrawn"), 260.0);
    let end = live.finish();
    let fleet = end.iter().find(|(_, r)| r["type"] == "ais_fleet").map(|(_, r)| r).unwrap();
    assert_eq!((&fleet["tracks"], &fleet["dark"]), (&json!(1), &json!(0)));
}

#[test]
fn one_report_of_a_clock_that_has_jumped_ahead_lets_no_others_be_forgotten() {
    let mut live = live();
    live.told(report(12, 600.0, 1e8));
    for k in 0..20 {
        live.told(report(11, 600.0, 10.0 * f64::from(k)));
        live.judge(f64::from(k));
    }
    assert_eq!(live.ais.len(), 21);
}

fn by_two() -> Live {
    Live::new(&BTreeMap::from([(7, PLACE), (8, (50.0, -1.01))]), Rules::default())
}

/// The network track of track 1 of these stations, 605 m East of the first.
fn network(t_s: f64, state: &str, stations: &[u16]) -> Value {
    let (lat, lon) = LocalFrame::new(PLACE.0, PLACE.1).lat_lon_deg(605.0, 5.0 * t_s - 500.0);
    let members: Vec<Value> =
        stations.iter().map(|station| json!({ "station": station, "session": 3, "id": 1 })).collect();
    json!({ "type": "network_track", "id": 4, "state": state, "utc": rfc3339(THEN_S + t_s), "members": members,
        "lat_deg": lat, "lon_deg": lon, "var_x_m2": 100.0, "var_y_m2": 100.0, "cov_xy_m2": 0.0,
        "heading_deg": 0.0, "sd_heading_deg": 3.0, "speed_m_s": 5.0, "sd_speed_m_s": 0.3 })
}

/// The same as [`track`] 1, as the second station has it.
fn by_second(t_s: f64, stage: &str) -> Value {
    let mut record = track(1, 605.0 + 717.0, t_s, stage);
    record["station"] = 8.into();
    record
}

/// The last that is told of the network track, all having ended.
fn last_of_network(live: &mut Live) -> Value {
    live.finish().into_iter().map(|(_, r)| r).rfind(|r| r["network"] == 4).unwrap()
}

#[test]
fn a_network_track_that_comes_at_the_end_is_judged_by_what_its_members_said_before() {
    // One vessel goes the same way; another meets it at the end and no time before.
    for (mmsi, from_m, verdict) in [(11, 605.0, "vessel"), (12, -3000.0, "dark")] {
        let mut live = by_two();
        for k in 0..25 {
            let t_s = 10.0 * f64::from(k);
            live.told(report(mmsi, from_m + (605.0 - from_m) * t_s / 190.0, t_s));
        }
        for k in 0..20 {
            let t_s = 10.0 * f64::from(k);
            live.take(&track(1, 605.0, t_s, if k < 19 { "running" } else { "final" }), 0.0);
            live.take(&by_second(t_s, if k < 19 { "running" } else { "final" }), 0.0);
        }
        live.take(&network(190.0, "live", &[7, 8]), 0.0);
        live.take(&network(190.0, "final", &[7, 8]), 0.0);
        let last = last_of_network(&mut live);
        assert_eq!((&last["verdict"], &last["from_utc"]), (&json!(verdict), &rfc3339(THEN_S)), "{last}");
    }
}

#[test]
fn a_network_track_of_one_moment_is_of_nobody_for_certain() {
    let mut live = by_two();
    for k in 0..20 {
        live.told(report(11, 605.0, 10.0 * f64::from(k)));
    }
    live.take(&network(190.0, "live", &[7, 8]), 0.0);
    let last = last_of_network(&mut live);
    assert_eq!(
        (&last["verdict"], &last["reason"]),
        (&json!("unmatched"), &json!("too short: its places are those of 0 s"))
    );
}

#[test]
fn a_network_track_goes_on_when_its_first_station_leaves_it() {
    let mut live = by_two();
    for k in 0..20 {
        let t_s = 10.0 * f64::from(k);
        live.told(report(11, 600.0, t_s));
        live.take(&network(t_s, "live", if k < 3 { &[7, 8] } else { &[8] }), t_s);
    }
    let last = last_of_network(&mut live);
    assert_eq!((&last["verdict"], &last["to_utc"]), (&json!("vessel"), &rfc3339(THEN_S + 190.0)), "{last}");
}

#[test]
fn a_track_that_fusion_lets_go_of_has_all_it_said() {
    let mut live = by_two();
    for k in 0..20 {
        let t_s = 10.0 * f64::from(k);
        live.told(report(11, 600.0, t_s));
        live.take(&track(1, 605.0, t_s, "running"), t_s);
        if k == 17 {
            live.take(&network(t_s, "live", &[7, 8]), t_s);
            live.take(&network(t_s, "withdrawn", &[7, 8]), t_s);
        }
    }
    let end = live.finish();
    let last = end.iter().map(|(_, r)| r).find(|r| r["type"] == "ais_match").unwrap();
    assert_eq!(
        (&last["verdict"], &last["from_utc"], &last["id"]),
        (&json!("vessel"), &rfc3339(THEN_S), &json!(1))
    );
}

#[test]
fn a_vessel_that_two_stations_hear_has_one_verdict_and_counts_once() {
    let mut live = by_two();
    let mut said = Vec::new();
    for k in 0..20 {
        let t_s = 10.0 * f64::from(k);
        live.told(report(11, 600.0, t_s));
        live.take(&track(1, 605.0, t_s, "running"), t_s);
        live.take(&by_second(t_s, "running"), t_s);
        if k >= 5 {
            live.take(&network(t_s, if k < 19 { "live" } else { "final" }, &[7, 8]), t_s);
        }
        said.extend(live.judge(t_s));
    }
    said.extend(live.finish());
    let last: Vec<&Value> = said.iter().map(|(_, r)| r).filter(|r| r["stage"] == "final").collect();
    assert_eq!(last.len(), 1, "{said:?}");
    assert_eq!(
        (&last[0]["network"], &last[0]["id"], &last[0]["mmsi"]),
        (&json!(4), &Value::Null, &json!(11))
    );
    let fleet = &said.iter().rfind(|(_, r)| r["type"] == "ais_fleet").unwrap().1;
    assert_eq!((&fleet["tracks"], &fleet["vessels"]), (&json!(1), &json!(1)));
}
