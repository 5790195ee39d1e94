//! The base station at work: lines read, their bytes kept, then decoded, then acknowledged.

use super::feed::Feed;
use super::line::{self, Answers, Line, Lines, Report, Stored};
use super::store::{Entry, Event, Retain, Store, may_pass};
use super::utc::Teller;
use super::waiting::Waiting;
use super::{Base, record::micros};
use anyhow::{Context, Result};
use seabearing_host::interrupt;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel};
use std::time::{Duration, Instant};

/// How often links are looked after while nothing comes.
const TICK: Duration = Duration::from_millis(20);
/// Most reports, and bytes, taken together.
const TOGETHER: (usize, usize) = (512, 1 << 20);
/// Time between attempts to write into a store that refuses.
const AGAIN: Duration = Duration::from_secs(2);
/// The stream of what is noted beside all connections; these are numbered from 1.
const BESIDE: u32 = 0;
/// How often a store moves some of its old months into their files, and lets go of what it keeps no longer.
const TIDY: Duration = Duration::from_secs(2);

/// What a service is told besides its lines.
#[derive(Clone, Copy, Debug)]
pub struct Rules {
    /// Time without a byte after which a line is silent.
    pub idle: Duration,
    /// Days that the store keeps; all if none is said.
    pub keep_days: Option<u32>,
    /// Months that the store keeps.
    pub retain: Retain,
    /// Ask every recorder who it is.
    pub identify: bool,
}

/// A base station at work.
pub struct Service {
    base: Base,
    store: Option<Store>,
    lines: Lines,
    settings: Vec<Line>,
    rules: Rules,
    answers: HashMap<u32, Answers>,
    left: usize,
    begun: Instant,
    tidied: Instant,
    notes: Vec<String>,
    teller: Option<Teller>,
    feed: Feed,
    noted: (Sender<Entry>, Receiver<Entry>),
    /// Records come from a broker, too.
    relays: bool,
    waiting: Option<Arc<Waiting>>,
}

/// Where records of other base stations are brought.
#[derive(Clone, Debug)]
pub struct Door(SyncSender<Report>);

impl Door {
    /// Brings records, as [`packed`](super::relay::packed) gives them, and waits until they are taken; `stored` is called once
    /// they are on the disk. False if the service has ended.
    pub fn bring(&self, records: Vec<u8>, stored: Box<dyn FnOnce() + Send>) -> bool {
        let received_us = Some(micros(time::OffsetDateTime::now_utc()));
        let entry = Entry { stream: BESIDE, received_us, event: Event::Relayed(records) };
        self.0.send(Report::Relayed(entry, Stored(stored))).is_ok()
    }

    /// Something that a person should know.
    pub fn note(&self, text: String) {
        // Of a service that has ended nobody reads it.
        let _ = self.0.send(Report::Note(text));
    }
}

/// Where others put records of their own, as alarms: they are stored and published as those of recorders are.
#[derive(Clone, Debug)]
pub struct Notebook(Sender<Entry>);

impl Notebook {
    /// Puts a record, an object with its `type`, of a station; false once the service has ended.
    pub fn note(&self, station: Option<u16>, what: Value) -> bool {
        let received_us = Some(micros(time::OffsetDateTime::now_utc()));
        self.0.send(Entry { stream: BESIDE, received_us, event: Event::Noted(station, what) }).is_ok()
    }
}

impl Service {
    /// Opens the lines.
    ///
    /// # Errors
    /// As [`line::start`].
    pub fn start(base: Base, store: Option<Store>, lines: Vec<Line>, rules: Rules) -> Result<Self> {
        let first = store.as_ref().map_or(1, Store::next_stream);
        let opened = line::start(&lines, first, rules.idle)?;
        let now = Instant::now();
        Ok(Self {
            base,
            store,
            lines: opened,
            left: lines.len(),
            settings: lines,
            rules,
            answers: HashMap::new(),
            begun: now,
            tidied: now,
            notes: Vec::new(),
            teller: None,
            feed: Feed::default(),
            noted: channel(),
            relays: false,
            waiting: None,
        })
    }

    /// From now on recorders are told the time.
    pub fn tell_utc(&mut self, teller: Teller) {
        self.teller = Some(teller);
    }

    /// What is known.
    pub fn base(&self) -> &Base {
        &self.base
    }

    /// The same, to give commands.
    pub fn base_mut(&mut self) -> &mut Base {
        &mut self.base
    }

    /// Where records are published once they are stored.
    pub fn feed(&self) -> &Feed {
        &self.feed
    }

    /// Where others put records of their own.
    pub fn notebook(&self) -> Notebook {
        Notebook(self.noted.0.clone())
    }

    /// Where records of other base stations are brought from now on. To be asked before the first turn.
    pub fn door(&mut self) -> Option<Door> {
        let door = self.lines.door.clone().map(Door)?;
        if !std::mem::replace(&mut self.relays, true) {
            self.left += 1;
        }
        Some(door)
    }

    /// What is taken from now on waits for somebody in memory, at most so many records.
    pub fn waiting(&mut self, room: usize) -> Arc<Waiting> {
        Arc::clone(self.waiting.get_or_insert_with(|| Arc::new(Waiting::new(room))))
    }

    /// The addresses listened at.
    pub fn listening(&self) -> &[std::net::SocketAddr] {
        &self.lines.listening
    }

    /// Whether every line comes to an end by itself, so that what does not keep up may be waited for.
    pub fn ends(&self) -> bool {
        !self.relays && self.settings.iter().all(|l| l.origin.ends())
    }

    /// What a person should know; each is told once.
    pub fn notes(&mut self) -> Vec<String> {
        let mut notes = std::mem::take(&mut self.notes);
        notes.extend(self.base.warnings());
        notes
    }

    /// Waits a moment for what comes, keeps it, decodes it, publishes the records, acknowledges them. False once all lines
    /// have come to their ends.
    ///
    /// # Errors
    /// A file cannot be read, or the store cannot be written and waiting does not help.
    pub fn turn(&mut self) -> Result<bool> {
        self.lines.door = None;
        let (mut entries, mut brought) = (Vec::new(), Vec::new());
        let mut bytes = 0;
        let mut next = match self.lines.reports.recv_timeout(TICK) {
            Ok(report) => Some(report),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => {
                self.left = 0;
                None
            }
        };
        while let Some(report) = next {
            match report {
                Report::Happened(entry, answers) => {
                    if let Event::Bytes(b) = &entry.event {
                        bytes += b.len();
                    }
                    entries.push((entry, answers));
                }
                Report::Relayed(entry, stored) => {
                    if let Event::Relayed(b) = &entry.event {
                        bytes += b.len();
                    }
                    entries.push((entry, None));
                    brought.push(stored);
                }
                Report::Note(note) => self.notes.push(note),
                Report::Finished => self.left = self.left.saturating_sub(1),
                Report::Failed(e) => return Err(e),
            }
            let room = entries.len() < TOGETHER.0 && bytes < TOGETHER.1;
            next = if room { self.lines.reports.try_recv().ok() } else { None };
        }
        entries.extend(self.noted.1.try_iter().take(TOGETHER.0).map(|entry| (entry, None)));
        self.take(entries)?;
        brought.into_iter().for_each(|Stored(tell)| tell());
        if let Some(teller) = &mut self.teller {
            teller.work(&mut self.base);
        }
        self.answer();
        self.tidy()?;
        Ok(self.left > 0)
    }

    /// Stores and publishes what others have noted by now; false if that is nothing.
    ///
    /// # Errors
    /// As [`Self::turn`].
    pub fn take_noted(&mut self) -> Result<bool> {
        let entries: Vec<_> = self.noted.1.try_iter().take(TOGETHER.0).map(|entry| (entry, None)).collect();
        let some = !entries.is_empty();
        self.take(entries)?;
        Ok(some)
    }

    fn take(&mut self, came: Vec<(Entry, Option<(Answers, usize)>)>) -> Result<()> {
        if came.is_empty() {
            return Ok(());
        }
        let (entries, ways): (Vec<Entry>, Vec<_>) = came.into_iter().unzip();
        self.persist(|store, _| store.keep(&entries))?;
        let mut rows = Vec::new();
        let now_us = self.begun.elapsed().as_micros() as u64;
        for (entry, way) in entries.iter().zip(ways) {
            let settings = way.as_ref().map(|(_, n)| self.settings[*n].settings);
            entry.tell(&mut self.base, now_us, settings, &mut rows);
            if matches!(entry.event, Event::Ended(_)) {
                self.answers.remove(&entry.stream);
            }
            if let Some((answers, _)) = way {
                self.answers.insert(entry.stream, answers);
                if self.rules.identify {
                    self.base.identify(entry.stream);
                }
            }
        }
        self.persist(|store, base| store.derive(base, &rows))?;
        if let Some(waiting) = &self.waiting {
            waiting.put(&self.base, &rows);
        }
        if self.feed.is_taken() {
            self.feed.publish(rows.iter().map(|row| self.base.json(row)).collect());
        }
        Ok(())
    }

    /// Writes into the store, again and again where that may help: what comes waits meanwhile.
    fn persist(&mut self, mut write: impl FnMut(&mut Store, &mut Base) -> Result<()>) -> Result<()> {
        let ends = self.ends();
        let Some(store) = &mut self.store else {
            self.base.forget_changes();
            return Ok(());
        };
        let mut complained = false;
        loop {
            match write(store, &mut self.base) {
                Ok(()) => break,
                Err(e) if ends || !may_pass(&e) || interrupt::asked() => return Err(e),
                Err(e) if !std::mem::replace(&mut complained, true) => {
                    // Whoever waits for records must know at once.
                    let text = format!("{e:#}; it is tried again, and nothing is acknowledged meanwhile");
                    log::warn!("{text}");
                    self.feed.publish(vec![json!({ "type": "note", "code": "StoreFails", "text": text })]);
                }
                Err(_) => {}
            }
            std::thread::sleep(AGAIN);
        }
        if complained {
            let text = "the store takes records again";
            log::info!("{text}");
            self.feed.publish(vec![json!({ "type": "note", "code": "StoreTakes", "text": text })]);
        }
        Ok(())
    }

    /// Says what is due on every connection.
    fn answer(&mut self) {
        let now_us = self.begun.elapsed().as_micros() as u64;
        for (stream, answers) in &self.answers {
            while let Some(frame) = self.base.answer(*stream, now_us) {
                answers.say(frame);
            }
        }
        for stream in self.base.closing() {
            if let Some(answers) = self.answers.get(&stream) {
                answers.close();
            }
        }
    }

    /// Moves old months into their files and lets go of what is kept no longer, a little at a time. What the disk does not
    /// take now is tried again.
    fn tidy(&mut self) -> Result<()> {
        let Some(store) = &mut self.store else { return Ok(()) };
        if self.tidied.elapsed() < TIDY {
            return Ok(());
        }
        self.tidied = Instant::now();
        let mut tidied = store.tidy(self.rules.retain).map(drop);
        if let (Ok(()), Some(days)) = (&tidied, self.rules.keep_days) {
            let before = micros(time::OffsetDateTime::now_utc()) - i64::from(days) * 86_400_000_000;
            tidied = store.forget(before).map(drop);
        }
        match tidied {
            Err(e) if !may_pass(&e) => Err(e).context("cannot move or let go of old records"),
            _ => Ok(()),
        }
    }
}
