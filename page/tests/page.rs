//! The page as a browser asks for it, without one: files, pictures, series, what comes live, refusals.

use seabearing_base::feed::Feed;
use seabearing_page::{Page, Place};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::time::Duration;

struct Asked {
    status: String,
    headers: String,
    body: String,
}

fn ask(url: &str, request: &str, more: &str) -> Asked {
    let host = url.trim_start_matches("http://").trim_end_matches('/');
    let mut stream = TcpStream::connect(host).unwrap();
    write!(stream, "{request} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n{more}\r\n").unwrap();
    let mut text = String::new();
    stream.read_to_string(&mut text).unwrap();
    let (head, body) = text.split_once("\r\n\r\n").unwrap();
    let (status, headers) = head.split_once("\r\n").unwrap();
    Asked { status: status.to_owned(), headers: headers.to_lowercase(), body: body.to_owned() }
}

fn json_of(url: &str, path: &str) -> Value {
    serde_json::from_str(&ask(url, &format!("GET {path}"), "").body).unwrap()
}

fn bearing(station: u64, azimuth_deg: f64) -> Value {
    json!({ "type": "bearing", "station": station, "session": 1, "utc": "2026-01-01T00:00:00Z", "received_utc": "2026-01-01T00:00:01Z",
            "azimuth_deg": azimuth_deg, "sd_azimuth_deg": 0.5, "elevation_deg": 1.0, "snr_db": 9.0, "band": 0 })
}

/// Waits until the page shows what is wanted.
fn until(url: &str, path: &str, what: impl Fn(&Value) -> bool) -> Value {
    for _ in 0..500 {
        let value = json_of(url, path);
        if what(&value) {
            return value;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    panic!("{}", json_of(url, path));
}

#[test]
fn a_browser_gets_files_pictures_and_what_comes_live() {
    let feed = Feed::default();
    let page = Page::bind("127.0.0.1:0").unwrap();
    let url = page.url();
    let places = [Place { station: Some(7), name: Some("west".into()), lat_lon_deg: Some((49.0, -123.0)) }];
    let serving = page.serve(&feed, None, &places).unwrap();
    for file in [
        "/",
        "/page.css",
        "/page.js",
        "/coast.js",
        "/model.js",
        "/map.js",
        "/sphere.js",
        "/plots.js",
        "/azigram.js",
        "/words.js",
        "/health.js",
    ] {
        let asked = ask(&url, &format!("GET {file}"), "");
        assert!(asked.status.contains("200") && asked.body.len() > 500, "{file}");
        assert!(asked.headers.contains("default-src 'none'; script-src 'self'"), "{file}");
        // Nothing is loaded from outside, and no style or script stands in the page itself.
        assert!(!asked.body.contains("https://") && !asked.body.contains("style=\""), "{file}");
    }
    assert!(ask(&url, "GET /../Cargo.toml", "").status.contains("404"));
    // What comes is in the picture, in the series, and at a browser that listens.
    let host = url.trim_start_matches("http://").trim_end_matches('/');
    let mut live = TcpStream::connect(host).unwrap();
    live.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    write!(live, "GET /api/live HTTP/1.1\r\nHost: {host}\r\n\r\n").unwrap();
    let mut lines = BufReader::new(live).lines().map(Result::unwrap);
    assert!(lines.any(|l| l.contains("text/event-stream")));
    feed.publish(vec![bearing(7, 12.5), bearing(8, 13.5)]);
    let picture = until(&url, "/api/moment", |p| p["stations"].as_array().is_some_and(|s| s.len() == 2));
    assert_eq!(picture["stations"][0]["newest"]["bearing"][0]["azimuth_deg"], 12.5);
    assert_eq!(picture["places"][0]["name"], "west");
    assert_eq!(json_of(&url, "/api/series?station=8")["bearings"][0][1], 13.5);
    let said = lines.find(|l| l.starts_with("data:")).unwrap();
    let said: Value = serde_json::from_str(said.trim_start_matches("data:")).unwrap();
    assert_eq!((said["missed"].as_u64(), said["records"].as_array().map(Vec::len)), (Some(0), Some(2)));
    // A browser that goes away is nothing to the page; notes are events.
    drop(lines);
    serving.note("a disk is full");
    until(&url, "/api/moment", |p| p["events"][0]["text"] == "a disk is full");
}

#[test]
fn an_alarm_is_shown_and_acknowledged_by_the_page_alone() {
    let feed = Feed::default();
    let page = Page::bind("127.0.0.1:0").unwrap();
    let url = page.url();
    let _serving = page.serve(&feed, None, &[]).unwrap();
    let heard = feed.subscribe(100);
    let alarm = json!({ "type": "alarm", "id": 3, "code": "Silent", "station": 7, "state": "raised", "text": "station 7 is silent",
                        "utc": "2026-01-01T00:00:00Z" });
    feed.publish(vec![alarm]);
    until(&url, "/api/alarms", |a| a[0]["state"] == "raised");
    assert_eq!(heard.take().unwrap().records[0]["type"], "alarm");
    let other = ask(&url, "POST /api/alarms/3/acknowledge", "Sec-Fetch-Site: cross-site\r\n");
    assert!(other.status.contains("403"), "{}", other.status);
    assert!(ask(&url, "POST /api/alarms/4/acknowledge", "").status.contains("404"));
    assert!(
        ask(&url, "POST /api/alarms/3/acknowledge", "Sec-Fetch-Site: same-origin\r\n").status.contains("200")
    );
    let acknowledged = heard.take().unwrap();
    assert_eq!(acknowledged.records[0], json!({ "type": "acknowledge", "id": 3 }));
}

#[test]
fn what_is_wrong_is_said_in_one_line() {
    let page = Page::bind("127.0.0.1:0").unwrap();
    let (url, at) = (page.url(), page.url().trim_start_matches("http://").trim_end_matches('/').to_owned());
    let said = format!("{:#}", Page::bind(&at).unwrap_err());
    assert!(said.contains(&at) && said.contains("--page") && said.lines().count() == 1, "{said}");
    assert!(Page::bind("nowhere").is_err());
    let _serving = page.serve(&Feed::default(), None, &[]).unwrap();
    for (path, status) in [
        ("/api/moment?at=soon", "400"),
        ("/api/moment?at=1e300", "400"),
        ("/api/moment?at=0", "404"),
        ("/api/series?station=x", "400"),
        ("/nothing", "404"),
    ] {
        let asked = ask(&url, &format!("GET {path}"), "");
        assert!(asked.status.contains(status), "{path}: {}", asked.status);
        assert!(asked.body.lines().count() == 1, "{path}: {}", asked.body);
    }
}
