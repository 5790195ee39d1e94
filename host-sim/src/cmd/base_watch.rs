//! What watches the records of `seabearing base`: alarms, AIS, chart plotters, counters.

use super::mistake;
use crate::base::export::Positions;
use crate::base::service::Service;
use crate::base::stations::Listed;
use crate::base::store::{self, Wanted};
use anyhow::{Result, bail};
use seabearing_watch::ais_live::source::Source;
use seabearing_watch::ais_live::{self, Live};
use seabearing_watch::alarms::rules::{Alarms, Condition};
use seabearing_watch::alarms::{Watcher, deliver};
use seabearing_watch::report::utc;
use seabearing_watch::{matching, metrics, nmea};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use time::OffsetDateTime;

/// Options.
#[derive(clap::Args)]
pub(super) struct Watch {
    /// File of alarms: when they are raised and who is told
    #[arg(long, value_name = "ALARMS.toml")]
    alarms: Option<PathBuf>,
    /// Tracks as NMEA 0183 (TLL, TTM) for chart plotters that connect to this address
    #[arg(long, value_name = "ADDRESS:PORT", value_parser = super::address)]
    nmea: Option<String>,
    /// Live AIS beside the tracks, or a file of it: each track is told its vessel, or that it is dark (may be given several times)
    #[arg(long, value_name = "tcp:HOST:PORT|udp:ADDRESS:PORT|serial:DEVICE:BAUD|FILE")]
    ais: Vec<Source>,
    /// Counters for Prometheus at http://ADDRESS:PORT/metrics
    #[arg(long, value_name = "ADDRESS:PORT", value_parser = super::address)]
    metrics: Option<String>,
}

/// Arguments of `seabearing base acknowledge`.
#[derive(clap::Args)]
pub(super) struct Acknowledge {
    /// Folder of the store
    #[arg(long, value_name = "DIR")]
    store: PathBuf,
    /// Numbers of the alarms (`id` of their records)
    #[arg(required_unless_present = "all")]
    id: Vec<u64>,
    /// All that stand and that nobody has acknowledged
    #[arg(long, conflicts_with = "id")]
    all: bool,
}

/// What is at work.
pub(super) struct AtWork {
    /// The alarms of the store, oldest first.
    pub(super) standing: Vec<Value>,
    ais: Option<ais_live::AtWork>,
    delivery: Option<deliver::AtWork>,
}

impl AtWork {
    /// All input has ended: what came is looked at, judged and stored. Live sentences of AIS that go on coming are waited for at most so
    /// long, where that is said.
    pub(super) fn settle(&self, service: &mut Service, hurry: Option<Duration>) -> Result<()> {
        if let Some(ais) = &self.ais {
            ais.settle(hurry);
            while service.take_noted()? {}
        }
        if let Some(delivery) = &self.delivery {
            delivery.settle();
            while service.take_noted()? {}
        }
        Ok(())
    }

    /// Alarms are delivered, for so long at most.
    pub(super) fn finish(&self, most: Duration) {
        self.delivery.iter().for_each(|delivery| delivery.finish(most));
    }
}

/// Days of records in which alarms that still stand are looked for, and hours of network tracks that these may be about.
const STANDING_DAYS: i64 = 30;
const NETWORK_HOURS: i64 = 2;

impl Watch {
    /// Reads the alarms, and refuses what cannot be: before anything is begun.
    pub(super) fn read(&self, places: &Positions, listed: &[Listed], stores: bool) -> Result<Option<Alarms>> {
        let nowhere = known(places).is_empty();
        if let Some(at) = self.nmea.as_ref().filter(|_| nowhere) {
            mistake!(
                "--nmea {at}: no station's position is known: give --stations with `lat_deg` and `lon_deg`"
            );
        }
        if let Some(source) = self.ais.first().filter(|_| nowhere) {
            mistake!(
                "--ais {source}: no station's position is known: give --stations with `lat_deg` and `lon_deg`"
            );
        }
        let Some(path) = &self.alarms else { return Ok(None) };
        let listed: BTreeSet<u16> = listed.iter().map(|s| s.config.id).collect();
        let alarms = Alarms::read(path, Some(&listed).filter(|l| !l.is_empty()))?;
        if nowhere && alarms.rules.iter().any(|r| matches!(r.condition, Condition::Inside(_))) {
            bail!("{}: an area needs stations with `lat_deg` and `lon_deg` (--stations)", path.display());
        }
        if !stores && alarms.rules.iter().any(|r| matches!(r.condition, Condition::Disk { .. })) {
            bail!("{}: kind = \"disk\" needs a store (--store)", path.display());
        }
        Ok(Some(alarms))
    }

    /// Starts what is asked for. `more`: counters of others.
    pub(super) fn start(
        &self,
        alarms: Option<Alarms>,
        service: &Service,
        store: Option<&Path>,
        listed: &[Listed],
        places: &Positions,
        more: impl Fn() -> String + Clone + Send + Sync + 'static,
    ) -> Result<AtWork> {
        let known = known(places);
        if let Some(at) = &self.nmea {
            log::info!("NMEA 0183 for chart plotters at {}", nmea::serve(at, &known, service.feed())?);
        }
        let standing = alarms.as_ref().and(store).map_or(Ok(Vec::new()), standing)?;
        if let Some(at) = &self.metrics {
            let address = metrics::serve(at, service.feed(), &standing, more)?;
            log::info!("counters at http://{address}/metrics");
        }
        let (mut ais, mut delivery) = (None, None);
        if !self.ais.is_empty() {
            let live = Live::new(&known, matching::Rules::default());
            ais = Some(ais_live::start(live, &self.ais, service.feed(), service.notebook())?);
        }
        let Some(alarms) = alarms else {
            let left = store.map_or(0, deliver::undelivered);
            if left > 0 {
                log::warn!("{left} alarms wait in the store to be delivered: they are told with --alarms");
            }
            return Ok(AtWork { standing, ais, delivery });
        };
        let stations = listed.iter().map(|s| s.config.id).collect();
        let now_s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64());
        let watcher = Watcher::new(alarms.rules, &known, stations, now_s, !service.ends());
        let folder = store.map(Path::to_owned);
        let mut before = store.map_or(Ok(Vec::new()), networks)?;
        before.extend(standing.iter().cloned());
        // Whose an alarm is follows from both, as they came.
        let came_s = |record: &Value| utc(&record["received_utc"]).unwrap_or(0.0);
        before.sort_by(|a, b| came_s(a).total_cmp(&came_s(b)));
        let (feed, notebook) = (service.feed(), service.notebook());
        delivery = Some(deliver::start(watcher, alarms.deliveries, feed, notebook, folder, &before));
        Ok(AtWork { standing, ais, delivery })
    }
}

/// The alarm records of a store, oldest first.
fn standing(store: &Path) -> Result<Vec<Value>> {
    records(store, OffsetDateTime::now_utc() - time::Duration::days(STANDING_DAYS), "alarm")
}

/// The network tracks of the end of a store, oldest first.
fn networks(store: &Path) -> Result<Vec<Value>> {
    let newest = store::newest_us(store)?.unwrap_or(0);
    let newest = OffsetDateTime::from_unix_timestamp_nanos(i128::from(newest) * 1000)?;
    records(store, newest - time::Duration::hours(NETWORK_HOURS), "network_track")
}

/// The records of a kind in a store from a time on, oldest first.
fn records(store: &Path, from: OffsetDateTime, kind: &str) -> Result<Vec<Value>> {
    let mut out = Vec::new();
    store::read(store, &Wanted { from: Some(from), ..Wanted::default() }, |record| {
        if record["type"] == kind {
            out.push(record);
        }
    })?;
    Ok(out)
}

/// Latitudes and longitudes of the stations that have them, degrees.
fn known(places: &Positions) -> BTreeMap<u16, (f64, f64)> {
    places.of_station.iter().filter_map(|(of, at)| Some((u16::try_from(*of).ok()?, *at))).collect()
}

/// `seabearing base acknowledge`.
pub(super) fn acknowledge(args: &Acknowledge) -> Result<()> {
    if !args.store.is_dir() {
        bail!("{}: no base station's store", args.store.display());
    }
    // Any other folder is left as it is.
    store::newest_us(&args.store)?;
    let standing = standing(&args.store)?;
    let ids =
        if args.all { raised(&standing, &deliver::acknowledgements(&args.store)) } else { args.id.clone() };
    // None is acknowledged where one is not there, or stands no more.
    for id in &args.id {
        match state(&args.store, &standing, *id)?.as_deref() {
            None => bail!("{}: the store holds no alarm {id}", args.store.display()),
            Some("cleared") => bail!("{}: alarm {id} is cleared already", args.store.display()),
            Some(_) => {}
        }
    }
    for id in &ids {
        deliver::acknowledge(&args.store, *id)?;
    }
    if args.all {
        println!("{} acknowledged", ids.len());
    }
    Ok(())
}

/// The numbers of the alarms that stand and that nobody has acknowledged, nor will have by what `waits`.
fn raised(standing: &[Value], waits: &BTreeSet<u64>) -> Vec<u64> {
    let newest: BTreeMap<u64, &Value> =
        standing.iter().filter_map(|r| Some((r["id"].as_u64()?, &r["state"]))).collect();
    let is_new = |(id, state): &(u64, &Value)| *state == "raised" && !waits.contains(id);
    newest.into_iter().filter(is_new).map(|(id, _)| id).collect()
}

/// The state of an alarm that the store holds.
fn state(store: &Path, standing: &[Value], id: u64) -> Result<Option<String>> {
    let of = |record: &Value| (record["id"] == id).then(|| record["state"].as_str().map(str::to_owned))?;
    let recent = standing.iter().rev().find_map(of);
    if recent.is_some() {
        return Ok(recent);
    }
    let mut last = None;
    store::read(store, &Wanted::default(), |record| {
        if record["type"] == "alarm" {
            last = of(&record).or(last.take());
        }
    })?;
    Ok(last)
}
