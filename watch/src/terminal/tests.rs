//! Pictures on a terminal that is a buffer; what is sent of them.

use super::*;
use ratatui::backend::TestBackend;
use ratatui::style::Color;
use serde_json::Value;

/// 2026-05-01 09:MM:SS, as a record tells it.
fn at(second: usize) -> String {
    format!("2026-05-01T09:{:02}:{:02}.000000Z", second / 60, second % 60)
}

/// Takes records at a time.
fn told(board: &mut Board, now_s: f64, records: &[Value]) {
    records.iter().for_each(|r| drop(board.take(r, now_s)));
}

fn track(station: u64, stage: &str) -> Value {
    json!({ "type": "track", "station": station, "session": 2, "id": 5, "stage": stage, "utc": at(100), "t_s": 100.0,
        "range_observable": true, "cpa_time_s": 160.0, "cpa_range_m": 512.0, "sd_cpa_range_m": 12.0, "heading_deg": 90.0,
        "sd_heading_deg": 2.0, "speed_m_s": 5.2, "sd_speed_m_s": 0.3 })
}

/// A few stations in every state.
fn harbour() -> Board {
    let mut board = Board::default();
    board.expect(7, "west");
    board.expect(8, "east entrance");
    board.expect(9, "outer");
    told(
        &mut board,
        0.0,
        &[
            json!({ "type": "line", "station": 7, "session": 1, "state": "up", "line": "tcp", "peer": "10.0.0.7:4500", "utc": at(0) }),
            json!({ "type": "line", "station": 8, "session": 1, "state": "up", "line": "tcp", "peer": null, "utc": at(1) }),
            json!({ "type": "line", "station": 9, "session": null, "state": "down", "line": "serial:/dev/ttyS0", "peer": null,
            "cause": "unplugged\u{1b}[2J", "utc": at(2) }),
            json!({ "type": "time", "station": 7, "session": 1, "sd_utc_s": 0.0005 }),
            json!({ "type": "health", "station": 8, "session": 1, "dead_channels": [2] }),
            json!({ "type": "azimuth", "station": 8, "session": 1, "detected": true, "azimuth_deg": 12.0, "sd_deg": 1.5 }),
        ],
    );
    told(
        &mut board,
        95.0,
        &[
            json!({ "type": "bearing", "station": 7, "session": 1, "azimuth_deg": 123.4, "sd_azimuth_deg": 0.52, "snr_db": 17.6 }),
            track(7, "running"),
            json!({ "type": "ais_match", "station": 7, "session": 3, "of_session": 2, "id": 5, "verdict": "vessel", "mmsi": 235_000_001, "name": "ANNA", "utc": at(100) }),
            json!({ "type": "alarm", "station": 9, "id": 41, "code": "RecorderSilent", "state": "raised",
            "text": "station 9 has not been heard for 60 s", "utc": at(62) }),
            json!({ "type": "alarm", "station": 8, "id": 42, "code": "ChannelSick", "state": "raised",
            "text": "station 8: channel 2 is dead or left out", "utc": at(70) }),
            json!({ "type": "alarm", "station": 8, "id": 42, "code": "ChannelSick", "state": "acknowledged",
            "text": "station 8: channel 2 is dead or left out", "utc": at(80) }),
        ],
    );
    board
}

fn shown<'a>(board: &'a Board, utc: &'a str, colour: bool) -> Shown<'a> {
    Shown { board, now_s: 100.0, utc, colour }
}

fn drawn(board: &Board, choice: &mut Choice, (width, height): (u16, u16), colour: bool) -> TestBackend {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    let shown = shown(board, "2026-05-01 09:01:40", colour);
    terminal.draw(|frame| shown.draw(frame, choice)).unwrap();
    terminal.backend().clone()
}

#[test]
fn the_picture_says_who_is_heard_what_they_hear_and_what_is_wrong() {
    let backend = drawn(&harbour(), &mut Choice::default(), (150, 20), true);
    insta::assert_snapshot!(backend);
}

#[test]
fn what_is_of_another_day_says_of_which() {
    let mut terminal = Terminal::new(TestBackend::new(150, 20)).unwrap();
    let board = harbour();
    let mut choice = Choice::default();
    terminal.draw(|frame| shown(&board, "2026-05-02 00:00:10", true).draw(frame, &mut choice)).unwrap();
    let text = terminal.backend().to_string();
    assert!(text.contains("2026-05-01 09:0"), "{text}");
    let same = drawn(&board, &mut choice, (150, 20), true).to_string();
    assert!(!same.contains("2026-05-01 09:00"), "{same}");
}

#[test]
fn a_narrow_and_a_low_terminal_show_what_fits_and_no_size_fails() {
    insta::assert_snapshot!(drawn(&harbour(), &mut Choice::default(), (60, 9), true));
    let board = harbour();
    for width in 0..12 {
        for height in 0..12 {
            drawn(
                &board,
                &mut Choice { station: 99, alarm: 99, back: 99, ..Choice::default() },
                (8 * width, height),
                true,
            );
        }
    }
}

#[test]
fn without_colours_there_are_none_and_with_them_what_is_bad_is_red() {
    let colours = |colour: bool| {
        let backend = drawn(&harbour(), &mut Choice::default(), (150, 20), colour);
        let cells: Vec<Color> = backend.buffer().content().iter().map(|c| c.fg).collect();
        cells.into_iter().filter(|c| *c != Color::Reset).collect::<Vec<_>>()
    };
    assert_eq!(colours(false), []);
    assert!(colours(true).contains(&Color::Red));
}

/// So many stations, of which each has just said a bearing.
fn many(stations: u64) -> Board {
    let mut board = Board::default();
    for station in 1..=stations {
        told(
            &mut board,
            100.0,
            &[
                json!({ "type": "line", "station": station, "session": 1, "state": "up", "peer": "x", "utc": at(1) }),
                json!({ "type": "bearing", "station": station, "session": 1, "azimuth_deg": 10.0, "sd_azimuth_deg": 1.0, "snr_db": 9.0 }),
            ],
        );
    }
    board
}

#[test]
fn all_of_64_stations_are_reached_by_keys() {
    let (mut board, feed) = (many(64), Feed::default());
    let mut choice = Choice::default();
    let mut seen = std::collections::BTreeSet::new();
    let key = |code: KeyCode| KeyEvent::new(code, KeyModifiers::NONE);
    for _ in 0..12 {
        let text = drawn(&board, &mut choice, (100, 24), true).to_string();
        seen.extend(
            text.lines()
                .filter_map(|l| l.trim_start_matches('"').split_whitespace().next()?.parse::<u64>().ok()),
        );
        act(key(KeyCode::PageDown), &mut choice, &mut board, &feed);
    }
    assert_eq!(seen, (1..=64).collect());
    let text = drawn(&board, &mut choice, (100, 24), true).to_string();
    assert!(text.contains("50-64 of 64"), "{text}");
    act(key(KeyCode::Home), &mut choice, &mut board, &feed);
    assert_eq!(choice.station, 0);
    // The log, from its newest line back.
    act(key(KeyCode::Tab), &mut choice, &mut board, &feed);
    act(key(KeyCode::Up), &mut choice, &mut board, &feed);
    assert_eq!((choice.part, choice.back), (Part::Events, 1));
}

#[test]
fn a_key_acknowledges_the_alarm_chosen_and_it_stays_until_it_is_cleared() {
    let (mut board, feed) = (harbour(), Feed::default());
    let records = feed.subscribe(10);
    act(KeyEvent::new(KeyCode::Char('a'), KeyModifiers::NONE), &mut Choice::default(), &mut board, &feed);
    let said = records.take_within(Duration::ZERO).unwrap();
    assert_eq!(said.records.to_vec(), [json!({ "type": "acknowledge", "id": 41 })]);
    // There is no other that nobody has seen.
    act(KeyEvent::new(KeyCode::Char('a'), KeyModifiers::NONE), &mut Choice::default(), &mut board, &feed);
    assert!(records.take_within(Duration::ZERO).unwrap().records.is_empty());
    let state = |state: &str| json!({ "type": "alarm", "station": 9, "id": 41, "state": state, "text": "", "utc": at(90) });
    board.take(&state("acknowledged"), 100.0);
    assert!(board.alarms.iter().all(|a| a.acknowledged) && board.alarms.len() == 2);
    board.take(&state("cleared"), 100.0);
    assert_eq!(board.alarms.iter().map(|a| a.id).collect::<Vec<_>>(), [42]);
    // Another key acknowledges all.
    for id in 50..53 {
        board.take(&json!({ "type": "alarm", "id": id, "state": "raised", "text": "" }), 100.0);
    }
    act(KeyEvent::new(KeyCode::Char('A'), KeyModifiers::SHIFT), &mut Choice::default(), &mut board, &feed);
    let said =
        (0..3).map(|_| records.take_within(Duration::ZERO).unwrap().records.to_vec()).collect::<Vec<_>>();
    assert_eq!(
        said.concat().iter().map(|r| r["id"].as_u64()).collect::<Vec<_>>(),
        [Some(50), Some(51), Some(52)]
    );
}

#[test]
fn a_second_in_which_64_stations_speak_on_is_a_few_dozen_bytes() {
    let (mut board, sent) = (many(64), Arc::new(std::sync::Mutex::new(Vec::new())));
    /// Keeps what is written.
    struct Line(Arc<std::sync::Mutex<Vec<u8>>>);
    impl Write for Line {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0.lock().unwrap().extend(bytes);
            Ok(bytes.len())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let options = ratatui::TerminalOptions {
        viewport: ratatui::Viewport::Fixed(ratatui::layout::Rect::new(0, 0, 120, 80)),
    };
    let mut terminal =
        Terminal::with_options(CrosstermBackend::new(Line(Arc::clone(&sent))), options).unwrap();
    let mut bytes = Vec::new();
    for second in 0..10usize {
        told(
            &mut board,
            100.0,
            &(1..=64).map(|s| json!({ "type": "health", "station": s, "session": 1 })).collect::<Vec<_>>(),
        );
        let utc = format!("2026-05-01 09:01:{:02}", 40 + second);
        let shown = shown(&board, &utc, true);
        terminal.draw(|frame| shown.draw(frame, &mut Choice::default())).unwrap();
        bytes.push(std::mem::take(&mut *sent.lock().unwrap()).len());
    }
    assert!(bytes[0] > 2000 && bytes[1..].iter().all(|n| *n < 60), "{bytes:?}");
}

#[test]
fn a_track_is_withdrawn_and_what_comes_from_outside_is_printable() {
    let mut board = Board::default();
    told(&mut board, 0.0, &[track(7, "running")]);
    assert!(board.stations[&Some(7)].track(1.0).unwrap().1);
    assert!(!board.stations[&Some(7)].track(200.0).unwrap().1);
    told(&mut board, 0.0, &[track(7, "withdrawn")]);
    assert!(board.stations[&Some(7)].track(1.0).is_none());
    assert!(harbour().events.iter().all(|e| !e.text.contains('\u{1b}')));
    assert_eq!(board::age(Some(-7300.0), 0.0), "2 h");
    assert_eq!((board::age(None, 0.0).as_str(), board::age(Some(9.0), 5.0).as_str()), ("-", "<10 s"));
}

/// What panics while the terminal is taken; only in the process that the test below starts.
#[test]
#[cfg(target_os = "linux")]
fn on_a_terminal() {
    if std::env::var_os("SEABEARING_PANICS").is_some() {
        let _tty = Tty::take().unwrap();
        std::thread::spawn(|| panic!("somewhere else")).join().unwrap_err();
        std::process::exit(7);
    }
}

#[test]
#[cfg(target_os = "linux")]
fn a_panic_anywhere_gives_the_terminal_back_before_it_is_told() {
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    use std::io::Read;
    use std::os::unix::ffi::OsStrExt;
    let ours = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&ours).unwrap();
    unlockpt(&ours).unwrap();
    let name = ptsname(&ours, Vec::new()).unwrap();
    let name = std::ffi::OsStr::from_bytes(name.to_bytes());
    let tty = std::fs::File::options().read(true).write(true).open(name).unwrap();
    let end = || std::process::Stdio::from(tty.try_clone().unwrap());
    let mut run = std::process::Command::new(std::env::current_exe().unwrap());
    run.args(["--exact", "terminal::tests::on_a_terminal", "--nocapture"]).env("SEABEARING_PANICS", "1");
    let mut child = run.stdin(end()).stdout(end()).stderr(end()).spawn().unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(7));
    drop((tty, run));
    let (mut said, mut buffer) = (Vec::new(), [0; 4096]);
    let mut ours = std::fs::File::from(ours);
    while let Ok(n @ 1..) = ours.read(&mut buffer) {
        said.extend(&buffer[..n]);
    }
    let said = String::from_utf8_lossy(&said);
    let place = |words: &str| said.find(words).unwrap_or_else(|| panic!("no {words:?} in {said:?}"));
    assert!(place("\x1b[?1049h") < place("\x1b[?1049l") && place("\x1b[?1049l") < place("somewhere else"));
}
