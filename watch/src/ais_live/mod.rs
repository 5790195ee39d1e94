//! AIS beside the base station as it comes: every track with its vessel, or none.
//!
//! In: records of the feed, sentences of any number of [`source`]s. Out: records `ais_match`, one when the verdict on a track
//! changes and one with its errors when it has ended (a network track in the place of the stations' tracks that it joins), `ais_fleet` over all that have ended, every hour and at the end, and `warning`s. Tracks of the last quarter of an hour are judged anew
//! as reports come; those of AIS are kept for as long as a vessel that leaves its reports out is thought of.

mod fleet;
pub mod source;

use crate::ais::Fleet;
use crate::ais::aivdm::Told;
use crate::before::{Before, as_before};
use crate::errors::{of_track, record};
use crate::matching::{HIDDEN_S, Heard, Rules, Verdict, heard, judge};
use crate::report::{TrackReport, VesselId};
use crate::vessels::{Vessels, Word};
use anyhow::Result;
use fleet::Ended;
use seabearing_base::feed::{Feed, Subscription};
use seabearing_base::service::Notebook;
use seabearing_host::ais::AisReport;
use serde_json::{Value, json};
use source::{Said, Source};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::mpsc::{Receiver, Sender, channel, sync_channel};
use std::time::{Duration, Instant};

/// Records, and sentences, that wait.
const RECORDS: usize = 20_000;
const SENTENCES: usize = 10_000;
/// How often tracks are judged.
const EVERY: Duration = Duration::from_secs(2);
const TICK: Duration = Duration::from_millis(100);
/// A track that has said nothing for so long has ended: the reports after it have come, s.
const SETTLED_S: f64 = 60.0;
/// Tracks are judged for so long after their last report, s.
const JUDGED_S: f64 = 900.0;
/// Most reports of AIS, of tracks, and of one track: of more every second one is left out.
const AIS: usize = 400_000;
const TRACKS: usize = 2000;
const REPORTS: usize = 200;
/// What is said of a set of vessels is said again at most so many times.
const REMARKS: usize = 1000;
/// Vessels of which name and length are kept: of more those with the lowest numbers are forgotten, whose reports tell them again.
const NAMES: usize = 100_000;
/// At the end all has come once nothing has for so long, and is not waited for any longer than that.
const QUIET: Duration = Duration::from_millis(300);
const LONGEST: Duration = Duration::from_secs(10);

/// What is known of a track.
#[derive(Debug, Default)]
struct Known {
    reports: Vec<TrackReport>,
    /// When it was told of last, seconds of the steady clock.
    heard_s: f64,
    over: bool,
    /// The verdict told last, as kind and vessel; and that its end was told.
    told: Option<(&'static str, Option<u64>)>,
    settled: bool,
}

/// Tracks beside AIS.
pub struct Live {
    stations: BTreeMap<Option<u16>, (f64, f64)>,
    rules: Rules,
    ais: Vec<AisReport>,
    /// Those of files: tracks of any of their times may come.
    files: Vec<AisReport>,
    names: BTreeMap<u64, String>,
    lengths: BTreeMap<u64, f64>,
    vessels: Vessels,
    tracks: BTreeMap<VesselId, Known>,
    before: Before,
    remarked: BTreeSet<(u64, bool)>,
    ended: Ended,
    changed: bool,
}

impl Live {
    /// With these stations: latitude and longitude, degrees.
    pub fn new(stations: &BTreeMap<u16, (f64, f64)>, rules: Rules) -> Self {
        Self {
            stations: stations.iter().map(|(of, at)| (Some(*of), *at)).collect(),
            rules,
            ais: Vec::new(),
            files: Vec::new(),
            names: BTreeMap::new(),
            lengths: BTreeMap::new(),
            vessels: Vessels::new(stations),
            tracks: BTreeMap::new(),
            before: Before::default(),
            remarked: BTreeSet::new(),
            ended: Ended::default(),
            changed: false,
        }
    }

    /// Takes a record at a time, seconds of the steady clock.
    pub fn take(&mut self, record: &Value, now_s: f64) {
        for word in self.vessels.take(record, now_s) {
            match word {
                // The tracks of its stations count no more, and after that they count again.
                Word::Joins(track, _) => {
                    let known = self.tracks.get_mut(&VesselId::Track(track));
                    let said = known.map(|known| std::mem::take(&mut known.reports)).unwrap_or_default();
                    self.before.joins(track, said, now_s);
                    self.forget_track(VesselId::Track(track));
                }
                Word::Parts(network, _) => self.forget_track(VesselId::Network(network)),
                Word::Says(seen) => self.says(&seen, now_s),
            }
        }
    }

    fn forget_track(&mut self, vessel: VesselId) {
        self.tracks.remove(&vessel);
        self.ended.withdraw(vessel);
    }

    /// Takes a report; of a vessel that several stations hear as seen from the station of its first report, which may have left it.
    fn says(&mut self, seen: &[TrackReport], now_s: f64) {
        let Some(report) = seen.first() else { return };
        let before = self.before.parts(report.vessel);
        if report.is_withdrawn {
            return self.forget_track(report.vessel);
        }
        let known = self.tracks.entry(report.vessel).or_default();
        known.reports.extend(before);
        let Some(report) = as_before(known.reports.first(), seen, &self.vessels) else { return };
        (known.heard_s, known.over) = (now_s, report.is_final);
        known.settled = false;
        known.reports.push(report);
        if known.reports.len() > REPORTS {
            let mut n = 0;
            known.reports.retain(|_| {
                n += 1;
                n % 2 == 1
            });
        }
        self.changed = true;
        if self.tracks.len() > TRACKS {
            let oldest =
                self.tracks.iter().min_by(|a, b| a.1.heard_s.total_cmp(&b.1.heard_s)).map(|(id, _)| *id);
            oldest.into_iter().for_each(|id| drop(self.tracks.remove(&id)));
        }
    }

    /// Takes what AIS tells.
    pub fn told(&mut self, told: Told) {
        match told {
            Told::Position(report) => self.ais.push(report),
            Told::Particulars { mmsi, name, length_m } => {
                self.names.extend(name.map(|name| (mmsi, name)));
                self.lengths.extend(length_m.map(|l| (mmsi, l)));
                if self.names.len() > NAMES {
                    self.names.pop_first();
                }
                if self.lengths.len() > NAMES {
                    self.lengths.pop_first();
                }
            }
        }
        self.changed = true;
    }

    /// Takes what a file tells: it is kept.
    pub fn told_of_file(&mut self, told: Told) {
        match told {
            Told::Position(report) => {
                self.files.push(report);
                self.changed = true;
            }
            particulars @ Told::Particulars { .. } => self.told(particulars),
        }
    }

    /// What files tell of the time of the tracks.
    fn of_files(&self) -> Vec<AisReport> {
        let times = self.tracks.values().flat_map(|k| k.reports.iter().filter_map(|r| r.utc_s.map(|t| t.0)));
        let (from_s, to_s) = times.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| (a.min(t), b.max(t)));
        let near = from_s - HIDDEN_S..=to_s + HIDDEN_S;
        self.files.iter().filter(|r| near.contains(&r.t_s)).copied().collect()
    }

    /// Judges the tracks; gives the records that are to be told, each with its station.
    pub fn judge(&mut self, now_s: f64) -> Vec<(Option<u16>, Value)> {
        self.tracks.retain(|_, known| now_s - known.heard_s <= JUDGED_S);
        let tracks = &self.tracks;
        let counts = |vessel, joined_s| now_s - joined_s <= JUDGED_S || tracks.contains_key(&vessel);
        self.before.retain(&self.vessels, counts);
        let settles = |known: &Known| !known.settled && now_s - known.heard_s > SETTLED_S;
        let due = self.tracks.values().any(settles);
        if self.tracks.is_empty() || !(std::mem::take(&mut self.changed) || due) {
            self.forget();
            return Vec::new();
        }
        self.forget();
        let mut of_files = self.of_files();
        for report in self.ais.iter_mut().chain(&mut of_files) {
            report.length_m = report.length_m.or(self.lengths.get(&report.mmsi).copied());
        }
        let all =
            |(vessel, known): (&VesselId, &Known)| self.before.with(*vessel, &known.reports, &self.vessels);
        let reports = self.tracks.iter().flat_map(all);
        let (mut tracks, _) = heard(reports, &self.stations);
        for track in tracks.iter_mut().filter(|t| matches!(t.vessel, VesselId::Network(_))) {
            track.stations = self.vessels.stations(track.vessel).into_iter().map(Some).collect();
        }
        let fleet = match of_files.is_empty() {
            true => Fleet::of(&self.ais, &self.names),
            false => Fleet::of(&[of_files, self.ais.clone()].concat(), &self.names),
        };
        let mut out: Vec<(Option<u16>, Value)> = self.remarks(&fleet.remarks).map(|r| (None, r)).collect();
        let verdicts = judge(&tracks, &fleet, &self.rules);
        for (track, verdict) in tracks.iter().zip(&verdicts) {
            let record = self.tell(track, verdict, &fleet, now_s);
            let station = match track.vessel {
                VesselId::Track(track) => track.station,
                VesselId::Network(_) => None,
            };
            out.extend(record.map(|r| (station, r)));
        }
        out.extend(self.ended.due(now_s).map(|r| (None, r)));
        out
    }

    /// Nothing more comes: what is to be told, all tracks being at their end, and of all together.
    pub fn finish(&mut self) -> Vec<(Option<u16>, Value)> {
        let last_s = self.tracks.values().map(|known| known.heard_s).fold(0.0, f64::max);
        let mut out = Vec::new();
        if self.tracks.values().any(|known| !known.settled) {
            // None that was judged so far is forgotten for that.
            self.tracks.values_mut().for_each(|known| known.heard_s = last_s);
            self.changed = true;
            out = self.judge(last_s + SETTLED_S + 1.0);
        }
        out.extend(self.ended.record(last_s).map(|r| (None, r)));
        out
    }

    /// The record of a track, where it says something new.
    fn tell(&mut self, track: &Heard, verdict: &Verdict, fleet: &Fleet, now_s: f64) -> Option<Value> {
        let known = self.tracks.get_mut(&track.vessel)?;
        let settles = !known.settled && now_s - known.heard_s > SETTLED_S;
        let is = match verdict {
            Verdict::Vessel { vessel, .. } => ("vessel", fleet.vessels.get(*vessel).map(|v| v.mmsi)),
            Verdict::Dark { .. } => ("dark", None),
            Verdict::Unmatched(_) => ("unmatched", None),
        };
        if known.told == Some(is) && !settles {
            return None;
        }
        known.told = Some(is);
        known.settled |= settles;
        let errors = match verdict {
            Verdict::Vessel { vessel, .. } => {
                fleet.vessels.get(*vessel).and_then(|v| of_track(track, v, fleet, &self.rules))
            }
            _ => None,
        };
        let mut record = record(track, verdict, errors.as_ref(), fleet);
        if settles {
            let length_m = match verdict {
                Verdict::Vessel { vessel, .. } => fleet.vessels.get(*vessel).and_then(|v| v.length_m),
                _ => None,
            };
            self.ended.take(track.vessel, verdict, errors.map(|e| (e, length_m)));
        }
        record["stage"] = if known.settled { "final" } else { "running" }.into();
        if let VesselId::Track(track) = track.vessel {
            record["of_session"] = json!(track.session);
        }
        record["utc"] = record["to_utc"].clone();
        Some(record)
    }

    /// What is doubtful about vessels, each once.
    fn remarks(&mut self, remarks: &[String]) -> impl Iterator<Item = Value> + use<> {
        let new: Vec<&String> = remarks
            .iter()
            .filter(|text| {
                let mmsi = text.split(':').next().and_then(|n| n.parse().ok()).unwrap_or(0);
                self.remarked.len() < REMARKS
                    && self.remarked.insert((mmsi, text.contains("vessels have this number")))
            })
            .collect();
        let texts: Vec<Value> =
            new.into_iter().map(|text| warning("AisDoubtful", &format!("AIS: {text}"))).collect();
        texts.into_iter()
    }

    /// Lets go of reports that no track can be compared with any more.
    fn forget(&mut self) {
        let time = |r: &TrackReport| r.utc_s.map(|(t_s, _)| t_s);
        let first =
            self.tracks.values().flat_map(|k| k.reports.iter().filter_map(time)).min_by(f64::total_cmp);
        // That of the last to come: of a receiver whose clock has jumped ahead once all others would be old for ever.
        let newest = self.ais.last().map(|r| r.t_s);
        let from_s = first.or(newest).unwrap_or(0.0).min(newest.unwrap_or(0.0)) - HIDDEN_S;
        self.ais.retain(|r| r.t_s >= from_s);
        if self.ais.len() > AIS {
            self.ais.drain(..self.ais.len() - AIS);
        }
    }
}

/// A warning as a record.
fn warning(code: &str, text: &str) -> Value {
    json!({ "type": "warning", "code": code, "text": text })
}

/// Asks for the end: who is told of it, and how long it may wait for more.
type End = (Sender<()>, Duration);

/// Matching at work.
pub struct AtWork {
    finish: Sender<End>,
}

impl AtWork {
    /// All input has ended: waits until what came is judged and told. Live sentences that go on coming are waited for at most
    /// so long.
    pub fn settle(&self, most: Option<Duration>) {
        let (done, is_done) = channel();
        let most = most.unwrap_or(LONGEST);
        if self.finish.send((done, most)).is_ok() {
            let _ = is_done.recv_timeout(most + LONGEST);
        }
    }
}

/// Starts to match the tracks of a feed with these sources, in threads of their own.
///
/// # Errors
/// A file cannot be read, or an address not be listened at.
pub fn start(live: Live, sources: &[Source], feed: &Feed, notebook: Notebook) -> Result<AtWork> {
    let (to, said) = sync_channel(SENTENCES);
    for source in sources {
        source::start(source.clone(), to.clone())?;
    }
    let records = feed.subscribe(RECORDS);
    let (finish, ends) = channel();
    std::thread::spawn(move || watch(live, &records, &said, &notebook, &ends));
    Ok(AtWork { finish })
}

fn watch(
    mut live: Live,
    records: &Subscription,
    said: &Receiver<Said>,
    notebook: &Notebook,
    ends: &Receiver<End>,
) {
    let begun = Instant::now();
    let (mut judged, mut ending, mut came) = (begun, None, begun);
    while let Some(taken) = records.take_within(TICK) {
        let now_s = begun.elapsed().as_secs_f64();
        if !taken.records.is_empty() {
            came = Instant::now();
        }
        taken.records.iter().for_each(|record| live.take(record, now_s));
        for said in said.try_iter().take(SENTENCES) {
            came = Instant::now();
            let goes_on = match said {
                Said::Of(told) => {
                    live.told(told);
                    true
                }
                Said::OfFile(told) => {
                    live.told_of_file(told);
                    true
                }
                Said::Note(code, text) => notebook.note(None, warning(code, &text)),
            };
            if !goes_on {
                return;
            }
        }
        ending = ending.or_else(|| ends.try_recv().ok().map(|(done, most)| (done, Instant::now() + most)));
        let over =
            ending.as_ref().is_some_and(|(_, until)| came.elapsed() >= QUIET || Instant::now() >= *until);
        let told = match over {
            true => live.finish(),
            false if judged.elapsed() >= EVERY => {
                judged = Instant::now();
                live.judge(now_s)
            }
            false => Vec::new(),
        };
        if !told.into_iter().all(|(station, record)| notebook.note(station, record)) {
            return;
        }
        if let Some((done, _)) = ending.take_if(|_| over) {
            let _ = done.send(());
        }
    }
}

#[cfg(test)]
mod tests;
