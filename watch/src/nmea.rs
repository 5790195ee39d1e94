//! Tracks for chart plotters: NMEA 0183 sentences TLL (where a target is) and TTM (as seen from its station) to whoever connects.
//!
//! Only tracks whose range is observable have a place. A target keeps its number (0 to 99) while its vessel is heard, by one station
//! or by several whose tracks are one vessel's, and is told lost (`L`) at its end, or when nothing was heard of it for [`SILENT_S`]. Distances
//! are nautical miles from the track's own station (of several from the first), angles degrees from true North.

use crate::report::{TrackReport, VesselId};
use crate::vessels::{Vessels, Word};
use anyhow::{Context, Result};
use seabearing_base::feed::Feed;
use seabearing_core::angle::wrap_tau;
use seabearing_host::geodesy::LocalFrame;
use serde_json::Value;
use std::collections::BTreeMap;
use std::io::Write;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use time::OffsetDateTime;

/// Metres in a nautical mile.
const MILE_M: f64 = 1852.0;
/// Numbers of targets.
const NUMBERS: u8 = 100;
/// Sentences that wait for a plotter; one that lets more wait is dropped.
const WAITING: usize = 256;
/// Time in which it must take what is sent.
const STALLED: Duration = Duration::from_secs(5);
/// A target of which nothing is heard for so long is lost, s; how often that is looked at.
pub const SILENT_S: f64 = 120.0;
const TICK: Duration = Duration::from_secs(1);
/// Records that wait to be told.
const RECORDS: usize = 20_000;

/// A sentence with its checksum and end.
fn sentence(body: &str) -> String {
    format!("${body}*{:02X}\r\n", body.bytes().fold(0u8, |sum, b| sum ^ b))
}

/// Degrees and minutes as `llll.lll` with so many digits of degrees, and the letter of the side.
fn angle(degrees: f64, digits: usize, sides: [char; 2]) -> String {
    // Rounded first, so that 59.9996' is no 60.000'.
    let thousandths = (degrees.abs() * 60_000.0).round() as u64;
    let (whole, minutes) = (thousandths / 60_000, (thousandths % 60_000) as f64 / 1000.0);
    format!("{whole:0digits$}{minutes:06.3},{}", sides[usize::from(degrees < 0.0)])
}

/// A target as it was told last.
#[derive(Clone, Debug)]
struct Target {
    number: u8,
    report: TrackReport,
    /// The station that it is seen from.
    frame: LocalFrame,
    /// When it was told, s.
    told_s: f64,
}

/// Turns records into sentences.
#[derive(Debug)]
pub struct Targets {
    vessels: Vessels,
    targets: BTreeMap<VesselId, Target>,
    next: u8,
}

impl Targets {
    /// With these stations (latitude and longitude, degrees).
    pub fn new(stations: &BTreeMap<u16, (f64, f64)>) -> Self {
        Self { vessels: Vessels::new(stations), targets: BTreeMap::new(), next: 0 }
    }

    /// The sentences to which a record leads at a time, s of any clock that goes on.
    pub fn take(&mut self, record: &Value, now_s: f64) -> String {
        let words = self.vessels.take(record, now_s);
        words.into_iter().map(|word| self.word(word, now_s)).collect()
    }

    /// Targets of which nothing was heard for so long are lost.
    pub fn tick(&mut self, now_s: f64) -> String {
        let silent = |t: &Target| now_s - t.told_s > SILENT_S;
        let gone: Vec<VesselId> = self.targets.iter().filter(|(_, t)| silent(t)).map(|(of, _)| *of).collect();
        gone.into_iter().map(|of| self.lost(of)).collect()
    }

    fn word(&mut self, word: Word, now_s: f64) -> String {
        match word {
            Word::Joins(track, network) => {
                self.goes_on(VesselId::Track(track), &[VesselId::Network(network)])
            }
            Word::Parts(network, into) => self.goes_on(VesselId::Network(network), &into),
            Word::Says(seen) => seen.first().map_or_else(String::new, |report| self.says(report, now_s)),
        }
    }

    /// A target is told as another vessel from now on, the first that has no target yet; where all have one it is lost.
    fn goes_on(&mut self, was: VesselId, into: &[VesselId]) -> String {
        match into.iter().find(|vessel| !self.targets.contains_key(vessel)) {
            Some(vessel) => {
                let target = self.targets.remove(&was);
                self.targets.extend(target.map(|target| (*vessel, target)));
                String::new()
            }
            None => self.lost(was),
        }
    }

    /// Says that a target is lost, where it was told last.
    fn lost(&mut self, vessel: VesselId) -> String {
        let gone = self.targets.remove(&vessel);
        gone.and_then(|t| sentences(t.number, &t.report, &t.frame, 'L')).unwrap_or_default()
    }

    fn says(&mut self, report: &TrackReport, now_s: f64) -> String {
        let Some(frame) = report.station.and_then(|of| self.vessels.frame(of)).copied() else {
            return String::new();
        };
        if report.is_final || report.is_withdrawn {
            // At its last place, where that is told.
            if let Some(target) = self.targets.get_mut(&report.vessel).filter(|_| report.place.is_some()) {
                (target.report, target.frame) = (*report, frame);
            }
            return self.lost(report.vessel);
        }
        if report.place.is_none() {
            if let Some(target) = self.targets.get_mut(&report.vessel) {
                target.told_s = now_s;
            }
            return String::new();
        }
        let (number, before) = match self.targets.get(&report.vessel) {
            Some(target) => (target.number, String::new()),
            None => self.number(),
        };
        self.targets.insert(report.vessel, Target { number, report: *report, frame, told_s: now_s });
        before + &sentences(number, report, &frame, 'T').unwrap_or_default()
    }

    /// A number for a new target: the next that is free. Of a hundred that of the one which was not told for longest, which is lost.
    fn number(&mut self) -> (u8, String) {
        for _ in 0..NUMBERS {
            let number = self.next;
            self.next = (self.next + 1) % NUMBERS;
            if self.targets.values().all(|t| t.number != number) {
                return (number, String::new());
            }
        }
        let oldest = self.targets.iter().min_by(|a, b| a.1.told_s.total_cmp(&b.1.told_s));
        let Some((vessel, number)) = oldest.map(|(vessel, t)| (*vessel, t.number)) else {
            return (0, String::new());
        };
        (number, self.lost(vessel))
    }
}

/// The sentences of a target; none where it has no place.
fn sentences(number: u8, report: &TrackReport, frame: &LocalFrame, status: char) -> Option<String> {
    let ((x, y), _) = report.place?;
    let (mut lat, mut lon) = frame.lat_lon_deg(x, y);
    lat = lat.clamp(-90.0, 90.0);
    lon = (lon + 180.0).rem_euclid(360.0) - 180.0;
    let time = report.utc_s.and_then(|(t_s, _)| {
        let at =
            OffsetDateTime::from_unix_timestamp_nanos((t_s * 100.0).round() as i128 * 10_000_000).ok()?;
        let (h, m, s) = at.to_hms();
        Some(format!("{h:02}{m:02}{s:02}.{:02}", at.millisecond() / 10))
    });
    let (time, name) = (time.unwrap_or_default(), report.vessel);
    let (lat, lon) = (angle(lat, 2, ['N', 'S']), angle(lon, 3, ['E', 'W']));
    let place = sentence(&format!("RATLL,{number:02},{lat},{lon},{name},{time},{status},"));
    let number_or = |x: Option<f64>, decimals: usize| x.map_or(String::new(), |x| format!("{x:.decimals$}"));
    let knots = number_or(report.speed_m_s.map(|(v, _)| v * 3600.0 / MILE_M), 1);
    let course = number_or(report.heading_rad.map(|(h, _)| wrap_tau(h).to_degrees()), 1);
    let cpa = number_or(report.cpa_range_m.map(|(r, _)| r / MILE_M), 3);
    let until = report.cpa_utc_s.zip(report.utc_s).map(|((cpa_s, _), (now_s, _))| (cpa_s - now_s) / 60.0);
    let seen = sentence(&format!(
        "RATTM,{number:02},{:.3},{:.1},T,{knots},{course},T,{cpa},{},N,{name},{status},,{time},A",
        x.hypot(y) / MILE_M,
        wrap_tau(x.atan2(y)).to_degrees(),
        number_or(until, 1)
    ));
    Some(place + &seen)
}

/// Serves sentences of what a feed brings; gives the address listened at.
///
/// # Errors
/// The address cannot be listened at.
pub fn serve(at: &str, stations: &BTreeMap<u16, (f64, f64)>, feed: &Feed) -> Result<SocketAddr> {
    let listener = TcpListener::bind(at).with_context(|| format!("--nmea {at}: cannot listen"))?;
    let address = listener.local_addr()?;
    let plotters: Arc<Mutex<Vec<SyncSender<Arc<str>>>>> = Arc::default();
    let (records, mut targets) = (feed.subscribe(RECORDS), Targets::new(stations));
    let told = Arc::clone(&plotters);
    std::thread::spawn(move || {
        let begun = Instant::now();
        while let Some(taken) = records.take_within(TICK) {
            let now_s = begun.elapsed().as_secs_f64();
            let mut text: String = taken.records.iter().map(|record| targets.take(record, now_s)).collect();
            text.push_str(&targets.tick(now_s));
            if !text.is_empty() {
                let text: Arc<str> = text.into();
                // Who takes nothing for so long gets nothing any more.
                told.lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .retain(|p| p.try_send(Arc::clone(&text)).is_ok());
            }
        }
    });
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let (plotter, texts) = sync_channel::<Arc<str>>(WAITING);
            plotters.lock().unwrap_or_else(PoisonError::into_inner).push(plotter);
            std::thread::spawn(move || write(stream, texts.iter()));
        }
    });
    Ok(address)
}

/// Writes to a plotter until it has gone or stalls.
fn write(mut stream: TcpStream, texts: impl Iterator<Item = Arc<str>>) {
    let _ = stream.set_write_timeout(Some(STALLED));
    for text in texts {
        if stream.write_all(text.as_bytes()).is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::io::{BufRead, BufReader};

    fn record(stage: &str) -> Value {
        json!({
            "type": "track", "station": 1, "session": 3, "id": 7, "stage": stage, "t_s": 100.0, "utc": "2024-05-01T09:08:07.25Z",
            "x_m": -1852.0, "y_m": 0.0, "var_x_m2": 400.0, "var_y_m2": 400.0, "cov_xy_m2": 0.0, "range_observable": true,
            "heading_deg": 45.0, "sd_heading_deg": 1.0, "speed_m_s": 5.144444, "sd_speed_m_s": 0.5,
            "cpa_time_s": 190.0, "sd_cpa_time_s": 5.0, "cpa_range_m": 926.0, "sd_cpa_range_m": 20.0,
        })
    }

    #[test]
    fn sentences_say_where_a_target_is_and_when_it_is_lost() {
        let mut targets = Targets::new(&[(1, (-16.5, 179.999))].into());
        let said = targets.take(&record("running"), 0.0);
        let lines: Vec<&str> = said.split("\r\n").collect();
        assert!(lines[0].starts_with("$RATLL,00,1630.000,S,17958.8"), "{said}");
        assert!(lines[0].contains(",E,1.3.7,090807.25,T,*"), "{said}");
        assert!(
            lines[1].starts_with("$RATTM,00,1.000,270.0,T,10.0,45.0,T,0.500,1.5,N,1.3.7,T,,090807.25,A*"),
            "{said}"
        );
        for line in &lines[..2] {
            let (body, sum) = line[1..].split_once('*').unwrap();
            assert_eq!(format!("{:02X}", body.bytes().fold(0, |a, b| a ^ b)), sum);
            assert!(line.len() + 2 <= 82, "{line}");
        }
        let end = targets.take(&record("final"), 1.0);
        assert!(end.contains(",L,*") && targets.take(&record("final"), 2.0).is_empty());
        let mut blind = record("running");
        blind["range_observable"] = false.into();
        assert!(targets.take(&blind, 3.0).is_empty());
    }

    /// Numbers and statuses of the sentences TLL, in order.
    fn told(text: &str) -> Vec<(u8, char)> {
        let tll = text.lines().filter(|l| l.starts_with("$RATLL"));
        let fields = tll.map(|l| l.split(',').collect::<Vec<_>>());
        fields.map(|f| (f[1].parse().unwrap(), f[8].chars().next().unwrap())).collect()
    }

    #[test]
    fn a_target_whose_recorder_goes_away_is_lost_where_it_was_told_last() {
        let mut targets = Targets::new(&[(1, (50.0, -1.0))].into());
        let said = targets.take(&record("running"), 0.0);
        assert!(targets.tick(SILENT_S).is_empty());
        let end = targets.tick(SILENT_S + 1.0);
        assert_eq!(told(&end), [(0, 'L')]);
        assert_eq!(end.split(',').nth(2), said.split(',').nth(2), "{end}");
        assert!(targets.tick(1000.0).is_empty());
        // Heard again it is another target.
        assert_eq!(told(&targets.take(&record("running"), 1000.0)), [(1, 'T')]);
    }

    #[test]
    fn of_more_than_a_hundred_targets_the_one_not_told_for_longest_is_lost() {
        let mut targets = Targets::new(&[(1, (50.0, -1.0))].into());
        let of = |id: u32| {
            let mut record = record("running");
            record["id"] = id.into();
            record
        };
        for id in 0..100u32 {
            targets.take(&of(id), f64::from(id) / 10.0);
        }
        // All but one go on.
        for id in (0..100u32).filter(|id| *id != 42) {
            targets.take(&of(id), 20.0);
        }
        assert_eq!(told(&targets.take(&of(100), 21.0)), [(42, 'L'), (42, 'T')]);
        assert_eq!(told(&targets.take(&of(0), 22.0)), [(0, 'T')]);
    }

    #[test]
    fn a_vessel_that_two_stations_hear_is_one_target_and_keeps_its_number() {
        let mut targets = Targets::new(&[(1, (50.0, -1.0)), (2, (50.0, -0.9))].into());
        let mut by_two = record("running");
        (by_two["station"], by_two["x_m"]) = (2.into(), (-9000.0).into());
        let network = |state: &str| {
            json!({ "type": "network_track", "id": 5, "state": state, "utc": "2024-05-01T09:08:10Z", "lat_deg": 50.0,
                "lon_deg": -1.025, "var_x_m2": 100.0, "var_y_m2": 100.0, "cov_xy_m2": 0.0,
                "members": [{ "station": 1, "session": 3, "id": 7 }, { "station": 2, "session": 3, "id": 7 }],
                "closest": [{ "station": 1, "utc": "2024-05-01T09:10:10Z", "sd_s": 3.0, "range_m": 926.0, "sd_range_m": 9.0 }] })
        };
        assert_eq!(told(&targets.take(&record("running"), 0.0)), [(0, 'T')]);
        assert_eq!(told(&targets.take(&by_two, 1.0)), [(1, 'T')]);
        // The first goes on, the other is lost.
        let said = targets.take(&network("live"), 2.0);
        assert_eq!(told(&said), [(1, 'L'), (0, 'T')]);
        assert!(said.contains(",0.500,2.0,N,N5,T,"), "{said}");
        assert!(targets.take(&record("running"), 3.0).is_empty() && targets.take(&by_two, 3.0).is_empty());
        // Where fusion takes it back there are two again.
        assert!(targets.take(&network("withdrawn"), 4.0).is_empty());
        assert_eq!(told(&targets.take(&record("running"), 5.0)), [(0, 'T')]);
        assert_eq!(told(&targets.take(&by_two, 5.0)), [(2, 'T')]);
        targets.take(&network("live"), 6.0);
        assert_eq!(told(&targets.take(&network("final"), 7.0)), [(0, 'L')]);
        assert!(targets.tick(1000.0).is_empty());
    }

    #[test]
    fn degrees_are_rounded_with_their_minutes() {
        assert_eq!(angle(49.999_999_9, 2, ['N', 'S']), "5000.000,N");
        assert_eq!(angle(-1.25, 3, ['E', 'W']), "00115.000,W");
    }

    #[test]
    fn a_plotter_hears_and_one_that_does_not_listen_is_dropped() {
        let feed = Feed::default();
        let address = serve("127.0.0.1:0", &[(1, (50.0, -1.0))].into(), &feed).unwrap();
        let _deaf = TcpStream::connect(address).unwrap();
        let hears = TcpStream::connect(address).unwrap();
        hears.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        let heard = std::thread::spawn(move || {
            BufReader::new(hears).lines().map_while(Result::ok).take(4).collect::<Vec<_>>()
        });
        // Both are taken in within a moment, and the deaf one holds up nothing.
        for _ in 0..200 {
            feed.publish(vec![record("running")]);
            std::thread::sleep(Duration::from_millis(2));
        }
        let heard = heard.join().unwrap();
        assert!(heard.len() == 4 && heard[0].starts_with("$RATLL"), "{heard:?}");
    }
}
