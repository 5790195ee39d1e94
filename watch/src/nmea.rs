//! Tracks for chart plotters: NMEA 0183 sentences TLL (where a target is) and TTM (as seen from its station) to whoever connects.
//!
//! Only tracks whose range is observable have a place. A target keeps its number (0 to 99) while its track lasts, and is told
//! lost (`L`) at its end. Distances are nautical miles from the track's own station, angles degrees from true North.

use crate::report::{TrackId, TrackReport};
use anyhow::{Context, Result};
use seabearing_base::feed::Feed;
use seabearing_core::angle::wrap_tau;
use seabearing_host::geodesy::LocalFrame;
use std::collections::BTreeMap;
use std::io::Write;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use time::OffsetDateTime;

/// Metres in a nautical mile.
const MILE_M: f64 = 1852.0;
/// Numbers of targets.
const NUMBERS: u8 = 100;
/// Sentences that wait for a plotter; one that lets more wait is dropped.
const WAITING: usize = 256;
/// Time in which it must take what is sent.
const STALLED: Duration = Duration::from_secs(5);
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

/// Turns reports into sentences.
#[derive(Debug)]
pub struct Targets {
    frames: BTreeMap<u16, LocalFrame>,
    numbers: BTreeMap<TrackId, u8>,
    next: u8,
}

impl Targets {
    /// With these stations (latitude and longitude, degrees).
    pub fn new(stations: &BTreeMap<u16, (f64, f64)>) -> Self {
        let frames = stations.iter().map(|(of, (lat, lon))| (*of, LocalFrame::new(*lat, *lon))).collect();
        Self { frames, numbers: BTreeMap::new(), next: 0 }
    }

    /// The sentences of a report; none where it has no place.
    pub fn sentences(&mut self, report: &TrackReport) -> Option<String> {
        let frame = *self.frames.get(&report.track.station?)?;
        let ends = report.is_final || report.is_withdrawn;
        let number = match self.numbers.get(&report.track) {
            Some(number) => *number,
            None if ends || report.place.is_none() => return None,
            None => self.number(report.track),
        };
        if ends {
            self.numbers.remove(&report.track);
        }
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
        let (time, status, name) = (time.unwrap_or_default(), if ends { 'L' } else { 'T' }, report.track);
        let (lat, lon) = (angle(lat, 2, ['N', 'S']), angle(lon, 3, ['E', 'W']));
        let place = sentence(&format!("RATLL,{number:02},{lat},{lon},{name},{time},{status},"));
        let number_or =
            |x: Option<f64>, decimals: usize| x.map_or(String::new(), |x| format!("{x:.decimals$}"));
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

    /// A number for a new track: the next that is free.
    fn number(&mut self, track: TrackId) -> u8 {
        for _ in 0..NUMBERS {
            let number = self.next;
            self.next = (self.next + 1) % NUMBERS;
            if self.numbers.values().all(|taken| *taken != number) {
                self.numbers.insert(track, number);
                return number;
            }
        }
        // A hundred at once: the oldest number is used again.
        let oldest = self.numbers.pop_first().map_or(0, |(_, number)| number);
        self.numbers.insert(track, oldest);
        oldest
    }
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
        while let Some(taken) = records.take() {
            let text: String = taken
                .records
                .iter()
                .filter_map(TrackReport::of)
                .filter_map(|r| targets.sentences(&r))
                .collect();
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
    use serde_json::{Value, json};
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
        let said = targets.sentences(&TrackReport::of(&record("running")).unwrap()).unwrap();
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
        let end = targets.sentences(&TrackReport::of(&record("final")).unwrap()).unwrap();
        assert!(
            end.contains(",L,*") && targets.sentences(&TrackReport::of(&record("final")).unwrap()).is_none()
        );
        let mut blind = record("running");
        blind["range_observable"] = false.into();
        assert!(targets.sentences(&TrackReport::of(&blind).unwrap()).is_none());
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
