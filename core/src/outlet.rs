//! How messages leave and commands come: in frames that are sent once ([`Plain`]), or over a link that keeps them until
//! the base station has them ([`Reliable`]).

use crate::port::{Clock, Link};
use crate::wire::guard::Guard;
use crate::wire::link::{self, Arrival, Class, Inbox, Progress, RECORD_BYTES, Session, Store};
use crate::wire::{Command, Decoder, Encoder, Health, Message};
use heapless::Deque;

/// What came over the line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Heard {
    /// A command.
    Command(Command),
    /// Something that is none: how many so far.
    Bad(u32),
}

/// The way out of the recorder's loop.
pub trait Outlet {
    /// Takes a message.
    fn say(&mut self, message: &Message);

    /// What has come, one at a time.
    fn hear(&mut self) -> Option<Heard>;

    /// Does what is due.
    fn work(&mut self, clock: &mut impl Clock);

    /// Messages taken so far.
    fn said(&self) -> u32;

    /// Messages lost so far because they found no room.
    fn dropped(&self) -> u32;

    /// Whether so much waits that a source of samples that can wait should.
    fn crowded(&self) -> bool {
        false
    }

    /// Whether messages wait for a base station that answers.
    fn waiting(&self) -> bool {
        false
    }
}

/// Health with what only the outlet knows.
fn completed(message: &Message, dropped: u32) -> Message {
    match *message {
        Message::Health(health) => Message::Health(Health { frames_dropped: dropped, ..health }),
        other => other,
    }
}

/// Frames sent once; counts those the line refuses.
pub struct Plain<'a, L> {
    line: &'a mut L,
    encoder: Encoder,
    decoder: Decoder,
    dropped: u32,
    bad: u32,
}

impl<'a, L: Link> Plain<'a, L> {
    /// A new session on a line.
    pub fn new(line: &'a mut L) -> Self {
        Self { line, encoder: Encoder::default(), decoder: Decoder::default(), dropped: 0, bad: 0 }
    }
}

impl<'a, L> Plain<'a, L> {
    /// The line.
    pub fn line(&self) -> &L {
        self.line
    }

    /// The line, for a session that begins anew.
    pub fn into_line(self) -> &'a mut L {
        self.line
    }
}

impl<L: Link> Outlet for Plain<'_, L> {
    fn say(&mut self, message: &Message) {
        let frame = self.encoder.frame(&completed(message, self.dropped));
        if !self.line.send(frame) {
            self.dropped = self.dropped.saturating_add(1);
        }
    }

    fn hear(&mut self) -> Option<Heard> {
        while let Some(byte) = self.line.receive() {
            if let Some(received) = self.decoder.push::<Command>(byte) {
                return Some(Heard::Command(received.message));
            }
            if byte == 0 && self.bad != self.decoder.bad() {
                self.bad = self.decoder.bad();
                return Some(Heard::Bad(self.bad));
            }
        }
        None
    }

    fn work(&mut self, _: &mut impl Clock) {}

    fn said(&self) -> u32 {
        self.encoder.frames()
    }

    fn dropped(&self) -> u32 {
        self.dropped
    }
}

/// Messages as records of a link; commands as the peer's records, or as an old base station's frames.
pub struct Reliable<'a, L, S> {
    line: &'a mut L,
    link: &'a mut link::Link<S>,
    now_us: u64,
    said: u32,
    desk: Desk,
}

impl<'a, L: Link, S: Store> Reliable<'a, L, S> {
    /// A link on a line; `guard` says which commands are carried out.
    pub fn new(line: &'a mut L, link: &'a mut link::Link<S>, guard: Guard) -> Self {
        Self { line, link, now_us: 0, said: 0, desk: Desk { guard, heard: Deque::new(), bad: 0 } }
    }
}

impl<L, S> Reliable<'_, L, S> {
    /// The line.
    pub fn line(&self) -> &L {
        self.line
    }

    /// The link, to look at.
    pub fn link(&self) -> &link::Link<S> {
        self.link
    }
}

/// Commands that have come and were not carried out yet.
struct Desk {
    guard: Guard,
    heard: Deque<Heard, 8>,
    bad: u32,
}

impl Inbox for Desk {
    fn recall(&mut self, _: &Session) -> Option<Progress> {
        None
    }

    fn take(&mut self, arrival: Arrival<'_>) {
        let bytes = match arrival {
            Arrival::Record(record) => record.bytes,
            Arrival::Plain { message, .. } => message,
            Arrival::Opened(_) | Arrival::Lost(_) => return,
        };
        // Where too many came at once, the next look tells of those that found no room.
        if self.heard.is_full() {
            self.bad = self.bad.saturating_add(1);
            return;
        }
        let heard = match self.guard.admit(bytes) {
            Some(command) => Heard::Command(command),
            None => {
                self.bad = self.bad.saturating_add(1);
                Heard::Bad(self.bad)
            }
        };
        let _ = self.heard.push_back(heard);
    }
}

impl<L: Link, S: Store> Outlet for Reliable<'_, L, S> {
    fn say(&mut self, message: &Message) {
        let mut buffer = [0; RECORD_BYTES];
        let message = completed(message, self.dropped());
        let bytes = crate::wire::bytes_of(&message, &mut buffer);
        self.link.offer(Class::of(&message), bytes);
        self.said = self.said.saturating_add(1);
    }

    fn hear(&mut self) -> Option<Heard> {
        while self.desk.heard.is_empty() {
            let byte = self.line.receive()?;
            self.link.receive(self.now_us, byte, &mut self.desk);
        }
        self.desk.heard.pop_front()
    }

    fn work(&mut self, clock: &mut impl Clock) {
        self.now_us = clock.micros();
        while let Some(frame) = self.link.send(self.now_us) {
            // A frame for which the line has no room is one that is lost: it comes again.
            self.line.send(frame);
        }
    }

    fn said(&self) -> u32 {
        self.said
    }

    fn dropped(&self) -> u32 {
        self.link.store().ledger().lost.iter().fold(self.link.refused(), |sum, n| sum.saturating_add(*n))
    }

    fn crowded(&self) -> bool {
        self.link.waiting() > self.link.store().half()
    }

    fn waiting(&self) -> bool {
        self.link.waiting() > 0 && self.link.up()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::link::{MemoryStore, Settings};
    use crate::wire::{End, Reply};
    use std::vec::Vec;

    type End2 = link::Link<MemoryStore<2000>>;

    /// A base station at the other end of a line that drops every fourth frame.
    struct Far {
        base: End2,
        came: Came,
        answers: Vec<u8>,
        frames: u32,
        now_us: u64,
    }

    #[derive(Default)]
    struct Came(Vec<(u32, Message)>);

    impl Inbox for Came {
        fn recall(&mut self, _: &Session) -> Option<Progress> {
            None
        }

        fn take(&mut self, arrival: Arrival<'_>) {
            if let Arrival::Record(r) = arrival {
                self.0.push((r.ordinal, crate::wire::message_of(r.bytes).unwrap()));
            }
        }
    }

    impl Link for Far {
        fn send(&mut self, frame: &[u8]) -> bool {
            self.frames += 1;
            if self.frames % 4 != 2 {
                frame.iter().for_each(|b| self.base.receive(self.now_us, *b, &mut self.came));
            }
            true
        }

        fn receive(&mut self) -> Option<u8> {
            self.now_us += 100;
            if self.answers.is_empty() {
                self.answers.extend_from_slice(self.base.send(self.now_us).unwrap_or(&[]));
            }
            if self.answers.is_empty() { None } else { Some(self.answers.remove(0)) }
        }
    }

    struct Millis(u64);

    impl Clock for Millis {
        fn ticks(&mut self) -> u32 {
            0
        }
        fn seconds(&mut self) -> u32 {
            (self.micros() / 1_000_000) as u32
        }
        fn micros(&mut self) -> u64 {
            self.0 += 1;
            self.0 * 1000
        }
    }

    #[test]
    fn messages_and_commands_come_over_a_line_that_drops_frames() {
        let settings = Settings::serial(921_600);
        let mut recorder = End2::new(settings, 7, 1, 5, MemoryStore::new());
        let base = End2::new(Settings { leads: false, ..settings }, 0, 1, 0, MemoryStore::new());
        let mut far = Far { base, came: Came::default(), answers: Vec::new(), frames: 0, now_us: 0 };
        // As record of the link, and in a frame as an old base station sends it.
        let mut buffer = [0; RECORD_BYTES];
        far.base.offer(Class::Health, crate::wire::bytes_of(&Command::Identify { token: 3 }, &mut buffer));
        far.base.offer(Class::Health, b"\x77no command");
        far.answers = Encoder::default().frame(&Command::Stop { token: 4 }).to_vec();
        let mut outlet = Reliable::new(&mut far, &mut recorder, Guard::open());
        let (mut clock, mut heard) = (Millis(0), Vec::new());
        for n in 0..5000u32 {
            if n < 1000 && n % 50 == 0 {
                outlet.say(&Message::Reply(Reply { token: n as u8, status: 0 }));
            }
            if n == 1000 {
                outlet.say(&Message::Health(Health::default()));
                outlet.say(&Message::End(End { index: 7, frames: outlet.said() }));
            }
            outlet.work(&mut clock);
            heard.extend(core::iter::from_fn(|| outlet.hear()));
        }
        assert!(!outlet.waiting() && outlet.dropped() == 0 && outlet.said() == 22);
        let stop = Heard::Command(Command::Stop { token: 4 });
        assert_eq!(heard, [stop, Heard::Command(Command::Identify { token: 3 }), Heard::Bad(1)]);
        let mut came = far.came.0;
        came.sort_by_key(|(ordinal, _)| *ordinal);
        assert!(came.iter().map(|c| c.0).eq(0..22), "{came:?}");
        assert_eq!(came[21].1, Message::End(End { index: 7, frames: 21 }));
    }
}
