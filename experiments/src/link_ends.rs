//! The two ends of the link experiment: a recorder that writes records and is reset, a base station that is killed.

use seabearing_core::wire::link::{
    Arrival, CLASSES, Class, Inbox, Link, Loss, MemoryStore, Progress, Session, Settings, Store,
};
use std::collections::BTreeMap;

/// A record as it was written or came: class, boot, bytes.
pub type Written = (Class, u32, Vec<u8>);

/// What a recorder says in a second: one record of so many bytes every so many milliseconds, of a class.
#[derive(Clone, Copy, Debug)]
pub struct Talk {
    /// Class of the records.
    pub class: Class,
    /// Milliseconds from one to the next.
    pub every_ms: u64,
    /// Their length.
    pub bytes: usize,
}

/// Of an array with a vessel: two bearings a second, a running track every two, `Health`, some faults, some passages.
pub const ARRAY: [Talk; 5] = [
    Talk { class: Class::Bearing, every_ms: 500, bytes: 43 },
    Talk { class: Class::Bearing, every_ms: 2000, bytes: 95 },
    Talk { class: Class::Health, every_ms: 60_000, bytes: 40 },
    Talk { class: Class::Alarm, every_ms: 97_000, bytes: 14 },
    Talk { class: Class::Final, every_ms: 300_000, bytes: 95 },
];

/// A recorder whose store survives its resets.
pub struct Recorder<S> {
    settings: Settings,
    /// The link, while the recorder runs.
    pub link: Option<Link<S>>,
    store: Option<S>,
    boot: u32,
    /// All that was ever written, in order.
    pub written: Vec<Written>,
    talk: &'static [Talk],
    /// Factor on the intervals of the talk.
    slower: u64,
    next_ms: Vec<u64>,
}

impl<S: Store> Recorder<S> {
    /// A recorder that starts for the first time.
    pub fn new(settings: Settings, store: S, talk: &'static [Talk], slower: u64) -> Self {
        let next_ms = talk.iter().map(|t| t.every_ms * slower).collect();
        let mut recorder = Self {
            settings,
            link: None,
            store: Some(store),
            boot: 0,
            written: Vec::new(),
            talk,
            slower,
            next_ms,
        };
        recorder.start(0);
        recorder
    }

    /// Starts; what it would have said while it was off is not said.
    pub fn start(&mut self, now_ms: u64) {
        self.boot += 1;
        for (next, talk) in self.next_ms.iter_mut().zip(self.talk) {
            *next = (*next).max(now_ms.next_multiple_of(talk.every_ms * self.slower));
        }
        self.link = self.store.take().map(|store| Link::new(self.settings, 7, self.boot, 99, store));
    }

    /// Power is gone: only the store is left.
    pub fn reset(&mut self) {
        if let Some(link) = self.link.take() {
            self.store = Some(link.into_store());
        }
    }

    /// Says what is due.
    pub fn speak(&mut self, now_ms: u64) {
        for i in 0..self.talk.len() {
            while self.link.is_some() && self.next_ms[i] <= now_ms {
                self.next_ms[i] += self.talk[i].every_ms * self.slower;
                self.say(self.talk[i]);
            }
        }
    }

    /// Says one record: bytes that tell it from any other, with zeros among them.
    pub fn say(&mut self, talk: Talk) {
        let Some(link) = &mut self.link else { return };
        let n = self.written.len() as u32;
        let byte = |i: u32| match n.to_le_bytes().get(i as usize) {
            Some(byte) => *byte,
            None => (n.wrapping_mul(i) >> 7) as u8 & 0xf1,
        };
        let bytes: Vec<u8> = (0..talk.bytes as u32).map(byte).collect();
        link.offer(talk.class, &bytes);
        self.written.push((talk.class, self.boot, bytes));
    }
}

/// What a base station has on its disk.
#[derive(Default)]
pub struct Disk {
    /// Records by their ordinal.
    pub records: BTreeMap<u32, Written>,
    /// Records that came although they were there.
    pub twice: u64,
    /// Losses told.
    pub losses: Vec<Loss>,
    /// Records of each class that were told lost.
    pub lost: [u32; CLASSES],
    /// Of each log by station and boot.
    progress: BTreeMap<(u16, u32), Progress>,
    /// Records counted from the first on without a gap, but for losses.
    pub complete: u32,
}

impl Disk {
    fn commit(&mut self, pending: &mut Pending, link: &Link<MemoryStore<64>>) {
        for (ordinal, record) in pending.records.drain(..) {
            self.twice += u64::from(self.records.insert(ordinal, record).is_some());
        }
        for loss in pending.losses.drain(..) {
            self.lost[loss.class as usize] += loss.count;
            self.losses.push(loss);
        }
        if let Some((session, progress)) = link.peer() {
            self.progress.insert((session.station, session.log), progress);
        }
        while self.records.contains_key(&self.complete) {
            self.complete += 1;
        }
    }
}

/// What has come and is not on the disk yet.
#[derive(Default)]
struct Pending {
    records: Vec<(u32, Written)>,
    losses: Vec<Loss>,
}

struct Desk<'a>(&'a mut Pending, &'a Disk);

impl Inbox for Desk<'_> {
    fn recall(&mut self, session: &Session) -> Option<Progress> {
        self.1.progress.get(&(session.station, session.log)).copied()
    }

    fn take(&mut self, arrival: Arrival<'_>) {
        match arrival {
            Arrival::Record(r) => self.0.records.push((r.ordinal, (r.class, r.boot, r.bytes.to_vec()))),
            Arrival::Lost(loss) => self.0.losses.push(loss),
            Arrival::Opened(_) | Arrival::Plain { .. } => {}
        }
    }
}

/// A base station.
pub struct BaseStation {
    settings: Settings,
    /// The link, while it runs.
    pub link: Option<Link<MemoryStore<64>>>,
    pending: Pending,
    /// What survives.
    pub disk: Disk,
}

impl BaseStation {
    /// A base station that has never heard anything.
    pub fn new(settings: Settings) -> Self {
        let settings = Settings { leads: false, ..settings };
        let mut base = Self { settings, link: None, pending: Pending::default(), disk: Disk::default() };
        base.start();
        base
    }

    /// Starts.
    pub fn start(&mut self) {
        self.link = Some(Link::new(self.settings, 0, 0, 0, MemoryStore::new()));
    }

    /// Takes a frame of the line. `killed`: before (`Some(false)`) or after (`Some(true)`) it is on the disk.
    pub fn take(&mut self, now: u64, frame: &[u8], killed: Option<bool>) {
        let Some(link) = &mut self.link else { return };
        for byte in frame {
            link.receive(now, *byte, &mut Desk(&mut self.pending, &self.disk));
        }
        if killed != Some(false) {
            self.disk.commit(&mut self.pending, link);
        }
        if killed.is_some() {
            (self.link, self.pending) = (None, Pending::default());
        }
    }
}
