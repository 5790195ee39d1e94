//! What the page shows, made of records: of each station the newest state, its tracks and series for plots, and events.
//!
//! The same picture is made of what comes now and of what a store says of a moment; the browser goes on from it with the
//! records that follow.

use seabearing_base::store::Moment;
use serde::{Serialize, Serializer};
use serde_json::{Value, json};
use std::collections::{BTreeMap, VecDeque};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Records of one kind that a station shows at once: vessels, modes.
const AT_ONCE: usize = 6;
/// Tracks of a station.
const TRACKS: usize = 40;
/// Places of a track; of more every second one is left out.
const PLACES: usize = 400;
/// Points of a plot.
pub const POINTS: usize = 1500;
/// Azigrams of a plot, each of which is many numbers.
pub const AZIGRAMS: usize = 400;
/// Events of all stations.
const EVENTS: usize = 300;
/// Alarms, cleared ones too.
const ALARMS: usize = 200;
/// Network tracks.
const NETWORKS: usize = 60;

/// What a record tells that is worth a line of its own.
const TOLD: [&str; 7] = ["fault", "faults_held", "line", "lost", "warning", "note", "end"];
/// Records of which a station has one.
const STATES: [&str; 9] =
    ["hello", "health", "margins", "time", "line", "end", "shaft_rate", "segment", "transient"];

/// One station, by its number; those that have not said theirs are one.
#[derive(Default, Serialize)]
struct Station {
    states: BTreeMap<String, Value>,
    newest: BTreeMap<String, VecDeque<Value>>,
    #[serde(serialize_with = "listed")]
    tracks: BTreeMap<(u64, u64), Track>,
    #[serde(skip)]
    series: Series,
    /// The newest record: when it was true, and when it came.
    last_utc: Value,
    last_received_utc: Value,
}

/// Points of plots, by name: `bearings` as time (ms since 1970), azimuth, its deviation, elevation (degrees), SNR (dB), band;
/// `transients` as time, azimuth, its deviation (degrees), peak (dB), how many; `levels` as time and dB of each channel; `azimuths` as time, azimuth, its deviation, ln presence, detected; `ranges` as
/// time, metres, deviation, detected; `azigrams` as time, edges of the bands (Hz), their azimuths (degrees) and coherences.
pub type Series = BTreeMap<&'static str, VecDeque<Value>>;

fn listed<S: Serializer>(tracks: &BTreeMap<(u64, u64), Track>, to: S) -> Result<S::Ok, S::Error> {
    to.collect_seq(tracks.values())
}

fn numbered<S: Serializer>(stations: &BTreeMap<Option<u64>, Station>, to: S) -> Result<S::Ok, S::Error> {
    #[derive(Serialize)]
    struct Numbered<'a> {
        station: Option<u64>,
        #[serde(flatten)]
        of: &'a Station,
    }
    to.collect_seq(stations.iter().map(|(station, of)| Numbered { station: *station, of }))
}

/// A track: its newest report, and where it was.
#[derive(Serialize)]
struct Track {
    report: Value,
    /// Which vessel of AIS it is, as the newest `ais_match` says.
    ais: Value,
    /// Milliseconds since 1970, metres East and North of the station.
    path: Vec<[f64; 3]>,
}

/// A network track: its newest report, and where it was.
#[derive(Default, Serialize)]
struct Network {
    report: Value,
    /// Which vessel of AIS it is.
    ais: Value,
    /// Milliseconds since 1970, latitude, longitude (degrees).
    path: Vec<[f64; 3]>,
}

fn reported<S: Serializer>(networks: &BTreeMap<u64, Network>, to: S) -> Result<S::Ok, S::Error> {
    to.collect_seq(networks.values())
}

/// Everything but the series, as the browser is given it.
#[derive(Default, Serialize)]
pub struct Picture {
    #[serde(serialize_with = "numbered")]
    stations: BTreeMap<Option<u64>, Station>,
    events: VecDeque<Value>,
    alarms: VecDeque<Value>,
    #[serde(serialize_with = "reported")]
    networks: BTreeMap<u64, Network>,
}

/// When a record was true, milliseconds since 1970; when it came if that is unknown.
pub fn when_ms(record: &Value) -> Option<f64> {
    let text = record["utc"].as_str().or(record["received_utc"].as_str())?;
    let at = OffsetDateTime::parse(text, &Rfc3339).ok()?;
    Some((at.unix_timestamp_nanos() / 1_000_000) as f64)
}

impl Picture {
    /// The picture of a moment.
    pub fn of(moment: &Moment) -> Self {
        let mut picture = Self::default();
        // A verdict may be as old as the report it is of: all tracks come first.
        let (verdicts, others): (Vec<_>, Vec<_>) =
            moment.records.iter().partition(|r| r["type"] == "ais_match");
        others.into_iter().chain(verdicts).for_each(|r| picture.take(r));
        for path in &moment.paths {
            let station = picture.stations.get_mut(&path.station.map(u64::from));
            if let Some(track) =
                station.and_then(|s| s.tracks.get_mut(&(path.session.into(), path.track.into())))
            {
                track.path.clone_from(&path.places);
            }
        }
        picture
    }

    /// Takes a record; what it is no picture of is left out.
    pub fn take(&mut self, record: &Value) {
        let Some(kind) = record["type"].as_str() else { return };
        match kind {
            "alarm" => return self.alarm(record),
            "network_track" => return self.network(record),
            "acknowledge" => return,
            "ais_match" => return self.matched(record),
            _ => {}
        }
        if TOLD.contains(&kind) {
            put(&mut self.events, record.clone(), EVENTS);
        }
        let of = record["station"].as_u64();
        // What the base station says of nobody is no station.
        if of.is_some() || !(TOLD.contains(&kind) && record["session"].is_null()) {
            self.stations.entry(of).or_default().take(kind, record);
        }
    }

    /// A track's vessel is that of the newest verdict.
    fn matched(&mut self, record: &Value) {
        if let Some(network) = record["network"].as_u64().and_then(|id| self.networks.get_mut(&id)) {
            network.ais = record.clone();
            return;
        }
        let key = record["of_session"].as_u64().or(record["session"].as_u64()).zip(record["id"].as_u64());
        let station = self.stations.get_mut(&record["station"].as_u64());
        if let Some(track) = station.zip(key).and_then(|(s, key)| s.tracks.get_mut(&key)) {
            track.ais = record.clone();
        }
    }

    /// An alarm is its newest state.
    fn alarm(&mut self, record: &Value) {
        self.stand(record);
        put(&mut self.events, record.clone(), EVENTS);
    }

    /// An alarm of before. One that stands is let go of only where all stand.
    pub fn stand(&mut self, record: &Value) {
        self.alarms.retain(|known| known["id"] != record["id"]);
        self.alarms.push_back(record.clone());
        if self.alarms.len() > ALARMS {
            let over = self.alarms.iter().position(|known| known["state"] == "cleared");
            self.alarms.remove(over.unwrap_or(0));
        }
    }

    fn network(&mut self, record: &Value) {
        let Some(id) = record["id"].as_u64() else { return };
        if record["state"] == "withdrawn" {
            self.networks.remove(&id);
            return;
        }
        let network = self.networks.entry(id).or_default();
        network.report = record.clone();
        let place = [when_ms(record), record["lat_deg"].as_f64(), record["lon_deg"].as_f64()];
        if let [Some(at), Some(lat), Some(lon)] = place {
            network.path.push([at, lat, lon]);
            thin(&mut network.path);
        }
        while self.networks.len() > NETWORKS {
            self.networks.pop_first();
        }
    }

    /// The alarms, oldest first.
    pub fn alarms(&self) -> Value {
        self.alarms.iter().cloned().collect()
    }

    /// What is plotted of a station.
    pub fn series(&self, of: Option<u64>) -> Series {
        self.stations.get(&of).map_or_else(Series::new, |s| s.series.clone())
    }
}

impl Station {
    fn take(&mut self, kind: &str, record: &Value) {
        (self.last_utc, self.last_received_utc) = (record["utc"].clone(), record["received_utc"].clone());
        if STATES.contains(&kind) {
            self.states.insert(kind.to_owned(), record.clone());
        }
        let at = json!(when_ms(record));
        let columns = |name: &'static str, keys: &[&str]| {
            let values = std::iter::once(at.clone()).chain(keys.iter().map(|k| record[*k].clone()));
            (name, values.collect::<Value>())
        };
        let point = match kind {
            "bearing" => {
                columns("bearings", &["azimuth_deg", "sd_azimuth_deg", "elevation_deg", "snr_db", "band"])
            }
            "azimuth" => columns("azimuths", &["azimuth_deg", "sd_deg", "log_presence", "detected"]),
            "transient" => columns("transients", &["azimuth_deg", "sd_azimuth_deg", "peak_db", "count"]),
            "range" => columns("ranges", &["range_m", "sd_range_m", "detected"]),
            "azigram" => columns("azigrams", &["edges_hz", "azimuth_deg", "coherence"]),
            "health" => {
                let levels = record["level_db_full_scale"].as_array().into_iter().flatten().cloned();
                ("levels", std::iter::once(at).chain(levels).collect())
            }
            "track" => return self.report(record),
            // A recorder that starts has forgotten its end.
            "hello" => return drop(self.states.remove("end")),
            _ => return,
        };
        let most = if kind == "azigram" { AZIGRAMS } else { POINTS };
        put(self.series.entry(point.0).or_default(), point.1, most);
        if !matches!(kind, "health" | "azigram" | "transient") {
            put(self.newest.entry(kind.to_owned()).or_default(), record.clone(), AT_ONCE);
        }
    }

    fn report(&mut self, record: &Value) {
        let (Some(session), Some(id)) = (record["session"].as_u64(), record["id"].as_u64()) else { return };
        let place = [when_ms(record), record["x_m"].as_f64(), record["y_m"].as_f64()];
        let track = self.tracks.entry((session, id)).or_insert_with(|| Track {
            report: Value::Null,
            ais: Value::Null,
            path: Vec::new(),
        });
        track.report = record.clone();
        if let ([Some(at), Some(x), Some(y)], true) = (place, record["range_observable"] == true) {
            track.path.push([at, x, y]);
            thin(&mut track.path);
        }
        if record["stage"] == "withdrawn" {
            self.tracks.remove(&(session, id));
        }
        while self.tracks.len() > TRACKS {
            self.tracks.pop_first();
        }
    }
}

/// Of more than so many places every second one is left out.
fn thin(path: &mut Vec<[f64; 3]>) {
    if path.len() > PLACES {
        let mut n = 0;
        path.retain(|_| {
            n += 1;
            n % 2 == 1
        });
    }
}

/// Keeps the newest.
fn put(into: &mut VecDeque<Value>, value: Value, most: usize) {
    into.push_back(value);
    if into.len() > most {
        into.pop_front();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bearing(station: u64, second: usize) -> Value {
        json!({ "type": "bearing", "station": station, "session": 1, "utc": format!("2026-01-01T00:{:02}:{:02}Z", second / 60 % 60, second % 60),
                "azimuth_deg": second as f64 % 360.0, "sd_azimuth_deg": 0.5, "elevation_deg": 3.0, "snr_db": 12.0, "band": 0 })
    }

    #[test]
    fn a_picture_is_bounded_whatever_comes() {
        let mut picture = Picture::default();
        for n in 0..2000 {
            picture.take(&bearing(7, n));
            picture.take(&json!({ "type": "fault", "station": 7, "session": 1, "code": "Gap", "utc": null }));
            picture.take(&json!({ "type": "alarm", "id": n, "state": "raised", "station": 7 }));
            let track = json!({ "type": "track", "station": 7, "session": 1, "id": n / 500, "stage": "running", "x_m": 1.0,
                "y_m": n, "range_observable": true, "utc": "2026-01-01T00:00:00Z" });
            picture.take(&track);
        }
        let all = json!(picture);
        let station = &all["stations"][0];
        assert_eq!(station["newest"]["bearing"].as_array().map(Vec::len), Some(AT_ONCE));
        assert_eq!(all["events"].as_array().map(Vec::len), Some(EVENTS));
        assert_eq!(picture.alarms().as_array().map(Vec::len), Some(ALARMS));
        let series = json!(picture.series(Some(7)));
        assert_eq!(series["bearings"].as_array().map(Vec::len), Some(POINTS));
        assert_eq!(series["bearings"][0].as_array().map(Vec::len), Some(6));
        let tracks = station["tracks"].as_array().unwrap();
        assert_eq!(tracks.len(), 4);
        for track in tracks {
            let path = track["path"].as_array().unwrap();
            assert!(path.len() > PLACES / 2 - 2 && path.len() <= PLACES, "{}", path.len());
        }
        assert_eq!(tracks[3]["report"]["y_m"], 1999);
    }

    #[test]
    fn a_track_has_the_vessel_of_its_newest_verdict_also_in_a_moment_of_one_time() {
        let track = json!({ "type": "track", "station": 1, "session": 2, "id": 3, "stage": "running", "utc": "2026-01-01T00:00:00Z" });
        let verdict = |verdict: &str, session: u64| json!({ "type": "ais_match", "station": 1, "session": session, "of_session": 2, "id": 3, "verdict": verdict });
        let records = vec![verdict("dark", 2), verdict("vessel", 4), track];
        let picture = json!(Picture::of(&Moment { records, paths: Vec::new() }));
        let of = &picture["stations"][0];
        assert_eq!(
            (&of["tracks"][0]["ais"]["verdict"], of["tracks"].as_array().map(Vec::len)),
            (&json!("vessel"), Some(1))
        );
    }

    #[test]
    fn an_azigram_is_a_point_of_its_series_and_stays_out_of_the_picture_itself() {
        let mut picture = Picture::default();
        picture.take(&json!({ "type": "azigram", "station": 1, "session": 2, "utc": "2026-01-01T00:00:00Z", "frames": 6,
            "edges_hz": [11.0, 12.0, 13.0], "azimuth_deg": [90.0, null], "coherence": [0.5, 0.0] }));
        let wanted = json!([[1767225600000.0, [11.0, 12.0, 13.0], [90.0, null], [0.5, 0.0]]]);
        assert_eq!(json!(picture.series(Some(1)))["azigrams"], wanted);
        for _ in 0..2 * AZIGRAMS {
            picture.take(
                &json!({ "type": "azigram", "station": 1, "session": 2, "utc": "2026-01-01T00:00:00Z" }),
            );
        }
        assert_eq!(picture.series(Some(1))["azigrams"].len(), AZIGRAMS);
        assert_eq!(json!(picture)["stations"][0]["newest"], json!({}));
    }

    #[test]
    fn withdrawn_tracks_go_and_an_alarm_is_its_newest_state() {
        let mut picture = Picture::default();
        let track = |stage: &str| {
            json!({ "type": "track", "station": 1, "session": 2, "id": 3, "stage": stage, "x_m": null, "y_m": null,
                    "range_observable": false, "utc": "2026-01-01T00:00:00Z" })
        };
        picture.take(&track("running"));
        let json = json!(picture);
        let tracks = json["stations"][0]["tracks"].as_array().unwrap();
        // Without a range there is no place.
        assert_eq!((tracks.len(), tracks[0]["path"].as_array().map(Vec::len)), (1, Some(0)));
        picture.take(&track("withdrawn"));
        assert_eq!(json!(picture)["stations"][0]["tracks"], json!([]));
        for state in ["raised", "acknowledged"] {
            picture.take(&json!({ "type": "alarm", "id": 5, "state": state, "station": 1 }));
        }
        assert_eq!(picture.alarms().as_array().map(Vec::len), Some(1));
        assert_eq!(picture.alarms()[0]["state"], "acknowledged");
    }

    #[test]
    fn an_alarm_that_stands_outlasts_any_number_of_others() {
        let mut picture = Picture::default();
        picture.stand(&json!({ "type": "alarm", "id": 1, "state": "raised", "station": 1 }));
        for id in 2..1000 {
            for state in ["raised", "cleared"] {
                picture.take(&json!({ "type": "alarm", "id": id, "state": state, "station": 1 }));
            }
        }
        let alarms = picture.alarms();
        assert_eq!((&alarms[0]["id"], alarms.as_array().map(Vec::len)), (&json!(1), Some(ALARMS)));
    }

    #[test]
    fn a_network_track_is_its_newest_report_with_its_places_until_it_is_withdrawn() {
        let mut picture = Picture::default();
        let track = |state: &str, lat: Option<f64>| {
            json!({ "type": "network_track", "id": 3, "state": state, "lat_deg": lat, "lon_deg": -123.0, "station": null,
                    "session": null, "utc": "2026-01-01T00:00:00Z" })
        };
        picture.take(&track("live", Some(49.0)));
        picture.take(&track("live", None));
        picture.take(
            &json!({ "type": "ais_match", "station": null, "id": null, "network": 3, "verdict": "dark" }),
        );
        let all = json!(picture);
        assert_eq!(all["networks"][0]["ais"]["verdict"], "dark");
        assert_eq!(
            (&all["networks"][0]["path"], &all["stations"]),
            (&json!([[1767225600000.0, 49.0, -123.0]]), &json!([]))
        );
        picture.take(&track("withdrawn", None));
        assert_eq!(json!(picture)["networks"], json!([]));
    }

    #[test]
    fn what_cannot_be_is_left_out() {
        let mut picture = Picture::default();
        for record in
            [json!(null), json!(7), json!({}), json!({ "type": 3 }), json!({ "type": "track", "station": 1 })]
        {
            picture.take(&record);
        }
        picture.take(&json!({ "type": "bearing", "station": 1, "utc": "no time", "azimuth_deg": null }));
        assert_eq!(json!(picture.series(Some(1)))["bearings"][0][0], Value::Null);
        // A line that could not be opened is an event, and no station.
        picture.take(&json!({ "type": "line", "state": "down", "station": null, "session": null }));
        assert_eq!(json!(picture)["stations"].as_array().map(Vec::len), Some(1));
        assert_eq!(json!(picture)["events"].as_array().map(Vec::len), Some(1));
    }
}
