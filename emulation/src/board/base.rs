//! A base station at the other end of the modelled board's line, where the image's records wait until one has them.

use super::{Said, seconds};
use anyhow::{Result, bail};
use seabearing_board_model::Machine;
use seabearing_board_model::stm32h743::Stm32h743;
use seabearing_board_model::time::{PER_SECOND, Ticks};
use seabearing_core::wire::link::{Arrival, Inbox, Link, MemoryStore, Progress, Session, Settings};
use seabearing_core::wire::{Message, message_of};

/// Ticks of a microsecond.
const MICROSECOND: Ticks = PER_SECOND / 1_000_000;

/// The base station.
pub(super) struct Base {
    link: Link<MemoryStore<2000>>,
    desk: Desk,
    /// Bytes of the board's that were taken.
    taken: usize,
}

/// A record that came.
#[derive(Debug, Clone)]
struct Came {
    at: Ticks,
    boot: u32,
    ordinal: u32,
    class: u8,
    number: u32,
    bytes: Vec<u8>,
}

#[derive(Default)]
struct Desk {
    now: Ticks,
    records: Vec<Came>,
    /// What came without the link, of a board that has nothing but the line.
    plain: Vec<(Ticks, Message)>,
    lost: u32,
    known: Option<(Session, Progress)>,
}

impl Inbox for Desk {
    fn recall(&mut self, session: &Session) -> Option<Progress> {
        self.known.filter(|known| known.0.log == session.log).map(|known| known.1)
    }

    fn take(&mut self, arrival: Arrival<'_>) {
        match arrival {
            Arrival::Record(record) => self.records.push(Came {
                at: self.now,
                boot: record.boot,
                ordinal: record.ordinal,
                class: record.class as u8,
                number: record.number,
                bytes: record.bytes.to_vec(),
            }),
            Arrival::Lost(loss) => self.lost += loss.count,
            Arrival::Plain { message, .. } => {
                self.plain.extend(message_of(message).map(|message| (self.now, message)));
            }
            Arrival::Opened(_) => {}
        }
    }
}

impl Base {
    pub fn new(baud: u32) -> Self {
        let settings = Settings { leads: false, ..Settings::serial(baud) };
        let link = Link::new(settings, 0, 1, 0, MemoryStore::new());
        Self { link, desk: Desk::default(), taken: 0 }
    }

    /// Hears what the board has said, and answers.
    pub fn look(&mut self, machine: &mut Machine<Stm32h743>) {
        let now = machine.now();
        self.desk.now = now;
        let sent = machine.board.sent();
        for byte in &sent[self.taken..] {
            self.link.receive(now / MICROSECOND, *byte, &mut self.desk);
        }
        self.taken = sent.len();
        self.desk.known = self.link.peer().or(self.desk.known);
        while let Some(frame) = self.link.send(now / MICROSECOND) {
            machine.board.send(now, frame);
        }
    }

    /// What the recorder has said, in its order, and what did not come whole and once.
    pub fn said(&self) -> Result<(Vec<Said>, u32)> {
        let mut records = self.desk.records.clone();
        records.sort_by_key(|record| record.ordinal);
        let mut missing = self.desk.lost;
        for class in 0..5 {
            let numbers = self.desk.records.iter().filter(|r| r.class == class).map(|r| r.number);
            missing += numbers.zip(0u32..).filter(|(number, wanted)| number != wanted).count() as u32;
        }
        missing += records.windows(2).filter(|pair| pair[0].ordinal == pair[1].ordinal).count() as u32;
        let mut said: Vec<Said> = Vec::new();
        for record in records {
            let Some(message) = message_of(&record.bytes) else {
                bail!("record {} is no message", record.ordinal);
            };
            let mut earlier = said.iter().rev().take_while(|s| s.boot == record.boot);
            // The answer to a command is no beginning.
            let begins = match message {
                Message::Hello(hello) => {
                    earlier.all(|s| !matches!(s.message, Message::Hello(h) if h == hello))
                }
                _ => false,
            };
            let sequence = u16::from(!begins);
            said.push(Said { at_s: seconds(record.at), sequence, boot: record.boot, message });
        }
        // It waits: its frames begin no session of records.
        let plain = self.desk.plain.iter();
        said.extend(plain.map(|(at, message)| Said {
            at_s: seconds(*at),
            sequence: 1,
            boot: 0,
            message: *message,
        }));
        Ok((said, missing))
    }
}
