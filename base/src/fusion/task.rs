//! The thread that fuses, beside a base station at work: what it is too slow for waits on its subscription.

use super::Found;
use super::regions::{Fusions, Regions};
use crate::feed::{Behind, Feed, Subscription};
use crate::service::{Notebook, Service};
use crate::store::{self, Wanted};
use anyhow::Result;
use std::path::Path;
use std::time::Duration;
use time::OffsetDateTime;

/// Records that wait for it.
const WAITING: usize = 200_000;
/// Records of before that a base station which starts takes up.
const TAKEN_UP: time::Duration = time::Duration::hours(1);
/// How often it is seen whether it has done all.
const LOOK: Duration = Duration::from_millis(2);

/// Bearings being fused.
pub struct Task {
    behind: Behind,
}

impl Task {
    /// Starts to fuse what a service publishes: what comes of it goes into its store and onto its feed. `store`: what it held
    /// of the last hour is taken up first, so that network tracks keep their numbers, and those that had ended are told.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn start(regions: Regions, service: &Service, store: Option<&Path>) -> Result<Self> {
        let (feed, notebook): (&Feed, Notebook) = (service.feed(), service.notebook());
        let (fusion, due) = taken_up(regions, store)?;
        let records = if service.ends() { feed.subscribe_waiting() } else { feed.subscribe(WAITING) };
        let behind = records.behind();
        for (station, what) in due {
            notebook.note(station, what);
        }
        std::thread::spawn(move || work(fusion, &records, &notebook));
        Ok(Self { behind })
    }

    /// Waits until all that was published is fused; what came of it is in the service's notebook.
    pub fn settle(&self) {
        while self.behind.waiting() > 0 {
            std::thread::sleep(LOOK);
        }
    }
}

fn work(mut fusion: Fusions, records: &Subscription, notebook: &Notebook) {
    while let Some(taken) = records.take() {
        if taken.missed > 0 {
            log::warn!("{} records came faster than they were fused, and are not", taken.missed);
        }
        for record in taken.records.iter().filter(|r| r["type"] != "network_track") {
            for (station, what) in fusion.take(record) {
                if !notebook.note(station, what) {
                    return;
                }
            }
        }
    }
}

/// Fusion as it stood, and network tracks that had ended and were not told.
fn taken_up(regions: Regions, store: Option<&Path>) -> Result<(Fusions, Vec<Found>)> {
    let mut fusion = Fusions::new(regions);
    let mut due = Vec::new();
    let Some(folder) = store else { return Ok((fusion, due)) };
    let newest = store::newest_us(folder)?.unwrap_or(0);
    let from = OffsetDateTime::from_unix_timestamp_nanos(i128::from(newest) * 1000)? - TAKEN_UP;
    let (mut records, mut told) = (Vec::new(), Vec::new());
    store::read(folder, &Wanted { from: Some(from), ..Wanted::default() }, |record| {
        match record["type"].as_str() {
            // These first: the numbers are theirs.
            Some("network_track") => {
                fusion.take(&record);
                if record["state"] != "live" {
                    told.push((record["id"].clone(), record["members"].clone()));
                }
            }
            Some("bearing" | "azimuth" | "track") => records.push(record),
            _ => {}
        }
    })?;
    for record in &records {
        due.extend(fusion.take(record));
    }
    // Only what stands at the end, and is not what was told.
    let mut last: Vec<Found> = Vec::new();
    for (station, what) in due.into_iter().filter(|(_, what)| what["type"] == "network_track") {
        last.retain(|(_, other)| other["id"] != what["id"]);
        last.push((station, what));
    }
    last.retain(|(_, what)| {
        what["state"] != "live" && !told.contains(&(what["id"].clone(), what["members"].clone()))
    });
    Ok((fusion, last))
}
