//! The base station: what it heard of whom, what it could say of each record's time, and what it was answered.

use super::board::{BAUD, Shared};
use super::world::{DAY_US, Event, World};
use seabearing_core::config_blob::CRC;
use seabearing_core::utc::Times;
use seabearing_core::wait::WAITING;
use seabearing_core::wire::configure::{Configure, PIECE_BYTES};
use seabearing_core::wire::link::{
    Arrival, CLASSES, Class, Inbox, Link, MemoryStore, Progress, Session, Settings,
};
use seabearing_core::wire::{Command, FaultCode, Message, bytes_of, message_of};
use std::collections::VecDeque;

/// A record as it came.
#[derive(Clone, Debug)]
pub struct Came {
    /// The start in which it was written, from 1.
    pub boot: u32,
    pub ordinal: u32,
    pub class: Class,
    pub number: u32,
    pub message: Message,
}

/// What the base station has.
#[derive(Default)]
pub struct Desk {
    pub records: Vec<Came>,
    pub lost: u32,
    pub undecodable: u32,
    pub answered: u32,
    pub taken: u32,
    known: Option<(Session, Progress)>,
    /// What is to be sent of a configuration, and what was sent last.
    pieces: VecDeque<Configure>,
    sent: Option<Configure>,
    /// What it says by itself.
    replies: VecDeque<Command>,
}

impl Inbox for Desk {
    fn recall(&mut self, session: &Session) -> Option<Progress> {
        self.known.filter(|known| known.0.log == session.log).map(|known| known.1)
    }

    fn take(&mut self, arrival: Arrival<'_>) {
        match arrival {
            Arrival::Record(record) => {
                let Some(message) = message_of(record.bytes) else {
                    self.undecodable += 1;
                    return;
                };
                match message {
                    Message::Reply(reply) if reply.token == CONFIGURES => {
                        let sent = self.sent.take();
                        self.taken +=
                            u32::from(reply.status == 0 && matches!(sent, Some(Configure::Take { .. })));
                        if reply.status != 0 {
                            self.pieces.clear();
                        }
                    }
                    Message::Reply(reply) => self.answered += u32::from(reply.token == ASKS),
                    Message::Fault(fault) if fault.code == FaultCode::ManyResets => {
                        self.replies.push_back(Command::Start { token: 2 });
                    }
                    Message::Hello(hello) if hello.kind != WAITING => self.replies.clear(),
                    _ => {}
                }
                self.records.push(Came {
                    boot: record.boot,
                    ordinal: record.ordinal,
                    class: record.class,
                    number: record.number,
                    message,
                });
            }
            Arrival::Lost(loss) => self.lost += loss.count,
            Arrival::Opened(_) | Arrival::Plain { .. } => {}
        }
    }
}

/// Tokens of orders about configurations, and of questions.
const CONFIGURES: u8 = 9;
const ASKS: u8 = 1;

/// The base station.
pub struct Base {
    link: Link<MemoryStore<2000>>,
    pub desk: Desk,
    blob: Vec<u8>,
    /// Records there were when the part of the day began, for how long the line was up in it, and which part it was.
    part: (usize, u64, u64),
    /// Parts of days in which the line was up and nothing came, or samples should have come and did not.
    pub stuck: u32,
    pub parts: u32,
}

impl Base {
    /// With the configuration that it sends now and then.
    pub fn new(blob: Vec<u8>) -> Self {
        let settings = Settings { leads: false, ..Settings::serial(BAUD) };
        let link = Link::new(settings, 0, 1, 0, MemoryStore::new());
        Self { link, desk: Desk::default(), blob, part: (0, 0, 0), stuck: 0, parts: 0 }
    }

    /// Hears, and answers.
    pub fn look(&mut self, shared: &Shared) {
        let mut world = shared.borrow_mut();
        let now_us = world.computed_us;
        while let Some(byte) = world.to_base.pop_front() {
            self.link.receive(now_us, byte, &mut self.desk);
        }
        self.desk.known = self.link.peer().or(self.desk.known);
        self.orders(&mut world);
        while let Some(frame) = self.link.send(now_us) {
            if world.line {
                world.to_board.extend(frame);
            }
        }
        self.watch(&world);
    }

    fn orders(&mut self, world: &mut World) {
        let mut buffer = [0; 140];
        while let Some(order) = world.orders.pop_front() {
            match order {
                Event::Command(command) => {
                    world.counts.commands += 1;
                    self.link.offer(Class::Alarm, bytes_of(&command, &mut buffer));
                }
                _ => {
                    world.counts.configurations += 1;
                    let (length, crc) = (self.blob.len() as u32, CRC.checksum(&self.blob));
                    self.desk.pieces.push_back(Configure::Begin { token: CONFIGURES, length, crc });
                    for (number, piece) in (0..).zip(self.blob.chunks(PIECE_BYTES)) {
                        let mut bytes = [[0; 32]; 3];
                        bytes.as_flattened_mut()[..piece.len()].copy_from_slice(piece);
                        self.desk.pieces.push_back(Configure::Piece { token: CONFIGURES, number, bytes });
                    }
                    self.desk.pieces.push_back(Configure::Take { token: CONFIGURES });
                }
            }
        }
        while let Some(command) = self.desk.replies.pop_front() {
            self.link.offer(Class::Alarm, bytes_of(&command, &mut buffer));
        }
        if self.desk.sent.is_none()
            && let Some(next) = self.desk.pieces.pop_front()
        {
            self.desk.sent = Some(next);
            self.link.offer(Class::Alarm, next.encode(&mut buffer));
        }
    }

    /// A part of a day in which the line was up and nobody said anything is one in which the board was stuck.
    fn watch(&mut self, world: &World) {
        let part = world.now_us / (DAY_US / super::world::PARTS);
        if part != self.part.2 {
            let (before, up_us, _) = self.part;
            self.parts += 1;
            self.stuck += u32::from(up_us > 150_000_000 && self.desk.records.len() == before);
            self.part = (self.desk.records.len(), 0, part);
        }
        if world.line {
            self.part.1 += 64_000;
        }
    }
}

/// Errors of what the base station could say of a record's time when it came, beyond the microsecond to which it is told, in units of
/// the stated standard deviation; the largest, s; records whose time it could not say.
pub fn times(
    desk: &Desk,
    world: &World,
    conversion: seabearing_firmware::seismic::Conversion,
) -> (Vec<f64>, f64, u64) {
    let (mut errors, mut worst_s, mut unknown) = (Vec::new(), 0f64, 0);
    let mut records: Vec<&Came> = desk.records.iter().collect();
    records.sort_by_key(|came| came.ordinal);
    let (mut times, mut boot, mut stepped) = (Times::default(), 0, false);
    for came in records {
        if came.boot != boot {
            (times, boot, stepped) = (Times::default(), came.boot, false);
        }
        let index = match came.message {
            Message::Time(time) => {
                times.note(time, std::mem::take(&mut stepped), conversion.hz());
                time.index
            }
            Message::Fault(fault) if fault.code == FaultCode::ClockStepped => {
                stepped = true;
                continue;
            }
            Message::Health(health) => health.index,
            Message::Azimuth(azimuth) => azimuth.index,
            _ => continue,
        };
        let Some(boot) = world.boots.iter().rfind(|boot| boot.number == came.boot) else { continue };
        let Some(at_us) = boot.at_us(conversion.middle(index)) else { continue };
        // The chips' own filter.
        let true_us = at_us - 31e6 / super::world::RATE_HZ + super::world::BEGIN_S as f64 * 1e6;
        match times.utc(index, conversion.hz()) {
            Some((utc_us, sd_s)) => {
                let error_s = (utc_us as f64 - true_us) * 1e-6;
                worst_s = worst_s.max(error_s.abs());
                // They are told to the microsecond.
                errors.push((error_s.abs() - 1e-6).max(0.0) / sd_s);
            }
            None => unknown += 1,
        }
    }
    (errors, worst_s, unknown)
}

/// Records that did not come once and in order, by class.
pub fn missing(desk: &Desk) -> u32 {
    let mut wrong = 0;
    for class in 0..CLASSES {
        let mut numbers: Vec<u32> =
            desk.records.iter().filter(|r| r.class as usize == class).map(|r| r.number).collect();
        numbers.sort_unstable();
        wrong += numbers.iter().zip(0u32..).filter(|(number, wanted)| *number != wanted).count() as u32;
    }
    wrong
}
