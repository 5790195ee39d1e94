//! One connection: its frames and packets taken apart, and what is owed to the other end.

use seabearing_core::wire::link::{Arrival, Inbox, Link, Loss, MemoryStore, Progress, Session, Settings};
use seabearing_core::wire::{Command, DecoderCounters, Encoder, Hello, Message, message_of};
use std::collections::{BTreeMap, VecDeque};

/// Bytes of commands that wait for their recorder.
const COMMAND_BYTES: usize = 1024;

/// What has come of each log, by station and boot in which it was begun.
pub(crate) type Logs = BTreeMap<(u16, u32), Progress>;

/// What comes out of a stream.
pub(crate) enum Came {
    /// The recorder has said its number over a link.
    Opened(u16),
    /// A message without a link; whether it is the first since the recorder started.
    Plain { sequence: u16, message: Message, first: bool },
    /// A record of a link.
    Record { ordinal: u32, boot: u32, message: Option<Message> },
    /// Records of a link that will never come.
    Lost(Loss),
    /// Frames without a link that were missed.
    Missed(u64),
}

/// What the link leaves, until it is taken.
struct Desk<'a> {
    logs: &'a Logs,
    came: Vec<Came>,
    plain: Option<(u16, Option<Message>)>,
}

impl Inbox for Desk<'_> {
    fn recall(&mut self, session: &Session) -> Option<Progress> {
        self.logs.get(&(session.station, session.log)).copied()
    }

    fn take(&mut self, arrival: Arrival<'_>) {
        match arrival {
            Arrival::Opened(session) => self.came.push(Came::Opened(session.station)),
            Arrival::Lost(loss) => self.came.push(Came::Lost(loss)),
            Arrival::Record(r) => {
                self.came.push(Came::Record {
                    ordinal: r.ordinal,
                    boot: r.boot,
                    message: message_of(r.bytes),
                });
            }
            Arrival::Plain { sequence, message } => self.plain = Some((sequence, message_of(message))),
        }
    }
}

/// A connection, from its beginning to its end.
pub(crate) struct Stream {
    link: Link<MemoryStore<COMMAND_BYTES>>,
    /// Commands that are not signed, to recorders without a link.
    plain: Encoder,
    /// Commands that wait to be given so.
    orders: VecDeque<Vec<u8>>,
    /// The recorder speaks without a link.
    pub(crate) unlinked: bool,
    /// The recorder is to be asked who it is.
    pub(crate) ask: bool,
    /// Bytes so far, and those since the last whole frame.
    pub(crate) bytes: u64,
    pub(crate) noise: u64,
    /// Records of a link whose message this version does not know.
    unknown: u64,
}

impl Stream {
    /// A stream that begins. `line`: it is spoken over, to recorders with a link, which speak first.
    pub(crate) fn new(line: Option<Settings>) -> Self {
        let settings = Settings { leads: false, ..line.unwrap_or(Settings::serial(super::LINE_BAUD)) };
        // A log of commands lives as long as the connection. Its name is another hundredth of a second: of two logs of one name
        // a recorder would take the second's commands for those that it has had.
        let boot = (time::OffsetDateTime::now_utc().unix_timestamp_nanos() / 10_000_000) as u32;
        let link = Link::new(settings, 0, boot, 0, MemoryStore::new());
        let (plain, orders) = (Encoder::default(), VecDeque::new());
        Self { link, plain, orders, unlinked: false, ask: false, bytes: 0, noise: 0, unknown: 0 }
    }

    /// Takes bytes at a time in microseconds, which only decides when they are acknowledged.
    pub(crate) fn push(&mut self, now_us: u64, bytes: &[u8], logs: &mut Logs, take: &mut impl FnMut(Came)) {
        self.bytes += bytes.len() as u64;
        let mut desk = Desk { logs, came: Vec::new(), plain: None };
        for byte in bytes {
            let (before, newest) = (self.link.line(), self.link.decoder().newest());
            self.link.receive(now_us, *byte, &mut desk);
            self.noise += 1;
            if *byte != 0 {
                continue;
            }
            if self.link.line().frames > before.frames {
                self.noise = 0;
            }
            if let Some((sequence, message)) = desk.plain.take() {
                self.unlinked = true;
                let Some(message) = message else {
                    self.link.decoder().unknown();
                    continue;
                };
                // The first frame of a recorder that has started, unless zero is the next number anyway.
                let is_hello = matches!(message, Message::Hello(_));
                let first = is_hello && sequence == 0 && newest != Some(u16::MAX);
                if first {
                    self.link.decoder().begin_again(0, before);
                } else {
                    let missed = self.link.line().lost.saturating_sub(before.lost);
                    desk.came.extend((missed > 0).then_some(Came::Missed(missed)));
                }
                desk.came.push(Came::Plain { sequence, message, first });
            }
            for came in desk.came.drain(..) {
                self.unlinked &= matches!(came, Came::Plain { .. } | Came::Missed(_));
                self.unknown += u64::from(matches!(came, Came::Record { message: None, .. }));
                take(came);
            }
        }
        if let Some((session, progress)) = self.link.peer() {
            logs.insert((session.station, session.log), progress);
        }
    }

    /// The log that the other end sends.
    pub(crate) fn log(&self) -> Option<(u16, u32)> {
        self.link.peer().map(|(session, _)| (session.station, session.log))
    }

    /// The link, to give it commands.
    pub(crate) fn link(&mut self) -> &mut Link<MemoryStore<COMMAND_BYTES>> {
        &mut self.link
    }

    /// The session that the recorder has opened.
    pub(crate) fn peer(&self) -> Option<Session> {
        self.link.peer().map(|(session, _)| session)
    }

    /// The number of the newest frame.
    pub(crate) fn newest(&mut self) -> Option<u16> {
        self.link.decoder().newest()
    }

    /// Goes on where another program stopped: after a frame of this number, with a log of which so much has come.
    pub(crate) fn resume(&mut self, newest: Option<u16>, log: Option<(Session, Progress)>) {
        if let Some(newest) = newest {
            let counters = self.link.line();
            self.link.decoder().begin_again(newest, counters);
        }
        if let Some((session, progress)) = log {
            self.link.resume(session, progress);
        }
    }

    /// Gives a command to a recorder without a link, in a frame of its own.
    pub(crate) fn order(&mut self, command: &[u8]) {
        self.orders.push_back(command.to_vec());
    }

    /// The next bytes for the recorder, if any are due.
    pub(crate) fn answer(&mut self, now_us: u64) -> Option<&[u8]> {
        if std::mem::take(&mut self.ask) {
            return Some(self.plain.frame(&Command::Identify { token: 1 }));
        }
        if let Some(command) = self.orders.pop_front() {
            return Some(self.plain.frame_of(&command));
        }
        self.link.send(now_us)
    }

    /// The stream has ended: bytes of an unfinished frame are damage.
    pub(crate) fn cut(&mut self) {
        self.link.decoder().cut();
    }

    /// What the frames say about the line.
    pub(crate) fn line(&self) -> DecoderCounters {
        let line = self.link.line();
        DecoderCounters { unknown: line.unknown + self.unknown, ..line }
    }
}

/// What a person should know about a recorder that says this of itself.
pub(crate) fn foreign(hello: &Hello) -> Option<String> {
    use seabearing_core::wire::{SCHEMA_HASH, WIRE_VERSION};
    if hello.wire_version != WIRE_VERSION {
        return Some(format!(
            "the recorder speaks wire version {}, this base station {WIRE_VERSION}: numbers may be misread",
            hello.wire_version
        ));
    }
    (hello.schema_hash != SCHEMA_HASH).then(|| {
        format!(
            "the recorder's message schema is {:016x}, this base station's {SCHEMA_HASH:016x}: messages it does not know \
             are counted as unknown",
            hello.schema_hash
        )
    })
}
