//! Many base stations and a centre with a real broker between them: what is lost where the broker goes away and others are
//! killed, and how many records a second a centre takes.

use super::base_process::{Caller, Process};
use super::base_station::{bearing, track};
use super::mosquitto::Mosquitto;
use super::report::CsvReport;
use super::{Experiment, Options};
use anyhow::{Context, Result, bail};
use rumqttc::{AsyncClient, MqttOptions, PublishOptions, QoS};
use seabearing_base::record::{Body, Row};
use seabearing_base::store::{Numbered, Tail, Wanted, check, read};
use seabearing_host::beside::Folder;
use seabearing_watch::mqtt::payload;
use serde_json::Value;
use std::collections::{BTreeMap, VecDeque};
use std::path::Path;
use std::time::{Duration, Instant};

/// `seabearing reproduce mqtt`.
pub const OUTAGE: Experiment = Experiment {
    name: "mqtt",
    about: "a broker is gone for 5 s, or as many as --runs says, at 640 records a second; a base station and a centre are killed besides",
    run: outage,
};

/// `seabearing reproduce mqtt-node`.
pub const NODE: Experiment = Experiment {
    name: "mqtt-node",
    about: "how many records a second a centre takes from a broker onto its disk, of 100 000 or as many thousand as --runs says",
    run: node,
};

const RECORDERS: u16 = 64;
/// Records a second of each.
const RATE: f64 = 10.0;
/// Before the broker goes, and after it has come back.
const AROUND_S: f64 = 2.0;
/// Longest that what waited may take.
const PATIENCE: Duration = Duration::from_secs(180);

/// Recorders that speak at their pace.
struct Fleet {
    callers: Vec<Caller>,
    begun: Instant,
}

impl Fleet {
    /// So long, in seconds from the first record.
    fn speak(&mut self, until_s: f64) {
        while self.begun.elapsed().as_secs_f64() < until_s {
            let due = (self.begun.elapsed().as_secs_f64() * RATE) as u32;
            for caller in &mut self.callers {
                while caller.said < due && caller.waiting() < 200 {
                    let n = u64::from(caller.said);
                    let of_track = n % 40 == 39;
                    caller.say(&if of_track { track((n / 400) as u16, n, false) } else { bearing(n * 100) });
                }
                caller.work(self.begun.elapsed().as_micros() as u64);
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// Until the base station has all that was said.
    fn settle(&mut self) -> Result<()> {
        let begun = Instant::now();
        while self.callers.iter().any(|c| c.waiting() > 0) {
            if begun.elapsed() > PATIENCE {
                bail!("the base station does not take what recorders say");
            }
            self.callers.iter_mut().for_each(|c| c.work(self.begun.elapsed().as_micros() as u64));
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(())
    }

    fn call(&mut self, base: &Process) -> Result<()> {
        self.callers.iter_mut().try_for_each(|c| c.call(base))
    }
}

fn outage(options: &Options) -> Result<()> {
    let Some(program) = Mosquitto::program_or_say("mqtt") else { return no_broker(options) };
    let outage_s = options.runs.unwrap_or(5) as f64;
    let folder = Folder::new()?;
    let at = |name: &str| folder.path().join(name);
    let mut broker = Mosquitto::start(program, folder.path(), None)?;
    let url = broker.url("fleet/north");
    let base = |broker: &str| Process::start_with(&at("north"), &["--mqtt", broker], folder.path());
    let centre = |broker: &str| Process::start_with(&at("centre"), &["--from-mqtt", broker], folder.path());
    let mut central = centre(&url)?;
    central.wait_for(": connected")?;
    let mut near = base(&url)?;
    let mut fleet = Fleet { callers: (1..=RECORDERS).map(Caller::new).collect(), begun: Instant::now() };
    fleet.call(&near)?;
    fleet.speak(AROUND_S);
    broker.stop();
    fleet.speak(AROUND_S + outage_s / 2.0);
    near.kill();
    near = base(&url)?;
    fleet.call(&near)?;
    fleet.speak(AROUND_S + outage_s);
    broker.again()?;
    let back = Instant::now();
    let before = Tail::open(&at("centre"))?.newest()?;
    // In the midst of what has waited.
    let mut came = before;
    while came == before && back.elapsed() < PATIENCE {
        fleet.speak(fleet.begun.elapsed().as_secs_f64() + 0.01);
        came = Tail::open(&at("centre"))?.newest()?;
    }
    fleet.speak(fleet.begun.elapsed().as_secs_f64() + 0.1);
    near.kill();
    central.kill();
    central = centre(&url)?;
    near = base(&url)?;
    fleet.call(&near)?;
    fleet.speak(fleet.begun.elapsed().as_secs_f64() + AROUND_S);
    fleet.settle()?;
    let said: u32 = fleet.callers.iter().map(|c| c.said).sum();
    let wanted = Tail::open(&at("north"))?.newest()?;
    let came = reach(&at("centre"), wanted);
    let caught_up_s = back.elapsed().as_secs_f64();
    near.kill();
    central.kill();
    let (sent, there) = (records(&at("north"))?, records(&at("centre"))?);
    let compared = compare(&sent, &there);
    let found = check(&at("centre"))?;
    let figures = &options.figures;
    figures.state("the broker was gone, s", outage_s);
    figures.state("records that recorders have said", f64::from(said));
    figures.at_most("of them missing at the centre", f64::from(said) - compared.told as f64, 0.0);
    figures.at_most("records of the base station missing at the centre", compared.missing as f64, 0.0);
    figures.at_most("records twice at the centre", compared.twice as f64, 0.0);
    figures.at_most("stations of which the order is another", compared.disordered as f64, 0.0);
    figures.at_most("faults that a check of the centre's store finds", found.faults.len() as f64, 0.0);
    figures.state("records that came again and were known", found.contents["relayed"]["again"].as_f64());
    figures.at_most(
        "from the broker's return until the centre had all, s",
        Some(caught_up_s).filter(|_| came),
        AROUND_S + outage_s + 60.0,
    );
    let mut table = CsvReport::new("mqtt", "outage_s,said,missing,twice,caught_up_s");
    table.row(&[outage_s, said.into(), compared.missing as f64, compared.twice as f64, caught_up_s]);
    table.finish(options)
}

fn no_broker(options: &Options) -> Result<()> {
    options.figures.at_most("records missing at the centre", None, 0.0);
    Ok(())
}

/// Waits until a store has so many records; false if it never has.
fn reach(store: &Path, wanted: i64) -> bool {
    let begun = Instant::now();
    while begun.elapsed() < PATIENCE {
        if Tail::open(store).and_then(|t| t.newest()).is_ok_and(|n| n >= wanted) {
            return true;
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    false
}

/// The records of each station, as text, in their order.
type OfStations = BTreeMap<Option<u64>, Vec<String>>;

fn records(store: &Path) -> Result<OfStations> {
    let mut found = OfStations::new();
    read(store, &Wanted::default(), |r| found.entry(r["station"].as_u64()).or_default().push(r.to_string()))?;
    Ok(found)
}

struct Compared {
    /// Messages of recorders.
    told: usize,
    missing: usize,
    twice: usize,
    disordered: usize,
}

fn compare(sent: &OfStations, came: &OfStations) -> Compared {
    let count = |all: &[String]| {
        let mut counts = BTreeMap::<String, i64>::new();
        all.iter().for_each(|r| *counts.entry(r.clone()).or_default() += 1);
        counts
    };
    let of_recorder = |r: &&String| serde_json::from_str::<Value>(r).is_ok_and(|r| r["sequence"].is_u64());
    let mut out = Compared { told: 0, missing: 0, twice: 0, disordered: 0 };
    for (station, sent) in sent {
        let came = came.get(station).map(Vec::as_slice).unwrap_or_default();
        let (of_sent, of_came) = (count(sent), count(came));
        out.told += came.iter().filter(of_recorder).count();
        out.missing +=
            of_sent.iter().map(|(r, n)| (n - of_came.get(r).unwrap_or(&0)).max(0)).sum::<i64>() as usize;
        out.twice +=
            of_came.iter().map(|(r, n)| (n - of_sent.get(r).unwrap_or(&0)).max(0)).sum::<i64>() as usize;
        out.disordered += usize::from(sent != came && of_sent == of_came);
    }
    out
}

/// Messages on their way while the broker is filled.
const WINDOW: usize = 500;

fn node(options: &Options) -> Result<()> {
    let figures = &options.figures;
    let bar = 20_000.0;
    let Some(program) = Mosquitto::program_or_say("mqtt-node") else {
        figures.at_least("records a second from a broker onto the disk", None, bar);
        return Ok(());
    };
    let all = options.runs.unwrap_or(100) as i64 * 1000;
    let folder = Folder::new()?;
    let store = folder.path().join("centre");
    let broker = Mosquitto::start(program, folder.path(), None)?;
    let url = broker.url("fleet/north");
    // It is known to the broker before there is anything, and takes what has waited.
    let first = Process::start_with(&store, &["--from-mqtt", &url], folder.path())?;
    first.wait_for(": connected")?;
    fill(&broker, 1, 1)?;
    if !reach(&store, 1) {
        bail!("the centre takes nothing");
    }
    first.kill();
    let begun = Instant::now();
    fill(&broker, 2, all)?;
    figures.state("published by one client, records a second", all as f64 / begun.elapsed().as_secs_f64());
    // With the time that it takes to start.
    let begun = Instant::now();
    let centre = Process::start_with(&store, &["--from-mqtt", &url], folder.path())?;
    if !reach(&store, all) {
        bail!("the centre has not taken all of {all}");
    }
    let took_s = begun.elapsed().as_secs_f64();
    let rate = (all - 1) as f64 / took_s;
    let processor_us = centre.processor_s().map(|s| s / (all - 1) as f64 * 1e6);
    figures.at_least("records a second from a broker onto the disk", rate, bar);
    figures.state("processor time of the centre, µs a record", processor_us);
    figures.at_most("most memory of the centre, MB", centre.peak_mb(), 300.0);
    centre.kill();
    let mut twice = BTreeMap::<u64, u64>::new();
    read(&store, &Wanted::default(), |r| {
        *twice.entry(r["sequence"].as_u64().unwrap_or(0)).or_default() += 1
    })?;
    figures.at_most("records missing", (all - twice.len() as i64) as f64, 0.0);
    figures.at_most("records twice", twice.values().map(|n| n - 1).sum::<u64>() as f64, 0.0);
    let mut table = CsvReport::new("mqtt-node", "records,seconds,processor_us");
    table.row(&[all as f64, took_s, processor_us.unwrap_or(f64::NAN)]);
    table.finish(options)
}

/// Publishes bearings of all stations as a base station does, with these numbers.
fn fill(broker: &Mosquitto, first: i64, last: i64) -> Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let mut options = MqttOptions::new("fleet", ("127.0.0.1", broker.port));
        options.set_outgoing_inflight_upper_limit(WINDOW as u16);
        let (client, mut events) = AsyncClient::builder(options).capacity(WINDOW).try_build()?;
        let publish = async {
            let mut on_their_way = VecDeque::new();
            for number in first..=last {
                let (topic, text) = message(number)?;
                let options = PublishOptions::new(QoS::AtLeastOnce);
                on_their_way.push_back(client.publish_tracked(topic, text, options).await?);
                if on_their_way.len() >= WINDOW
                    && let Some(notice) = on_their_way.pop_front()
                {
                    notice.wait_completion_async().await?;
                }
            }
            for notice in on_their_way {
                notice.wait_completion_async().await?;
            }
            Ok::<_, anyhow::Error>(())
        };
        let drive = async {
            loop {
                if let Err(e) = events.poll().await {
                    return anyhow::Error::from(e).context("the broker");
                }
            }
        };
        tokio::select! {
            published = publish => published,
            ended = drive => Err(ended),
        }
    })
}

fn message(number: i64) -> Result<(String, String)> {
    let at_us = 1_790_000_000_000_000 + number * 1000;
    let row = Row {
        origin: None,
        station: Some((number % i64::from(RECORDERS)) as u16 + 1),
        session: Some(1),
        sequence: Some(u32::try_from(number).context("too many records")?),
        utc: Some((at_us, Some(1e-3))),
        received_us: Some(at_us + 50_000),
        body: Body::Message(bearing(number as u64)),
    };
    let record = payload::record(&Numbered { number, row, rate_hz: Some(1000.0) }, "north", 7)?;
    Ok((format!("fleet/north/{}", payload::topic(&record)), record.to_string()))
}
