//! How messages leave and commands come: in frames that are sent once ([`Plain`]), or over a link that keeps them until
//! the base station has them ([`Reliable`]).

use crate::block::Block;
use crate::keeper::{BuiltIn, Done, Keeper, UNKNOWN};
use crate::port::{Clock, Link};
use crate::snippet::Snippets;
use crate::wire::configure::{self, Configure};
use crate::wire::guard::Guard;
use crate::wire::link::{self, Arrival, Class, Inbox, Progress, RECORD_BYTES, Session, Store};
use crate::wire::{Command, Decoder, Encoder, Health, Message, Reply, command_of};
use heapless::Deque;

/// What came over the line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Heard {
    /// A command.
    Command(Command),
    /// Something that is none: how many so far.
    Bad(u32),
    /// The recorder is to start again with another configuration; the command with this token, if there is one, is answered.
    Restart(Option<u8>),
}

/// The way out of the recorder's loop.
pub trait Outlet {
    /// Takes a message.
    fn say(&mut self, message: &Message);

    /// What has come, one at a time.
    fn hear(&mut self) -> Option<Heard>;

    /// Does what is due.
    fn work(&mut self, clock: &mut impl Clock);

    /// As many samples have come as end a silence.
    fn sampled(&mut self) {}

    /// Samples have come.
    fn block(&mut self, _: &Block<'_>) {}

    /// A snippet of so many instants of these channels (bit c: channel c) is asked for; the status of the reply. On a line
    /// without a link it would come in place of what was found.
    fn snippet(&mut self, _token: u8, _channels: u8, _instants: u32) -> u8 {
        UNKNOWN
    }

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

    /// Records that wait for the base station, and about how many there is room for; 0 where none ever wait.
    fn kept(&self) -> (u32, u32) {
        (0, 0)
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
    deaf: bool,
}

impl<'a, L: Link> Plain<'a, L> {
    /// A new session on a line.
    pub fn new(line: &'a mut L) -> Self {
        Self {
            line,
            encoder: Encoder::default(),
            decoder: Decoder::default(),
            dropped: 0,
            bad: 0,
            deaf: false,
        }
    }

    /// The same that takes no commands where it is `deaf`: of a recorder that takes signed ones only.
    pub fn deaf(line: &'a mut L, deaf: bool) -> Self {
        Self { deaf, ..Self::new(line) }
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
            if self.deaf {
                continue;
            }
            if self.decoder.push_frame(byte).is_some() {
                let message = self.decoder.message();
                if let Some(command) = command_of(message) {
                    return Some(Heard::Command(command));
                }
                match configure::token_of(message) {
                    Some(token) => self.say(&Message::Reply(Reply { token, status: UNKNOWN })),
                    None => self.decoder.unknown(),
                }
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

/// Pieces of a snippet that the store holds at most: a few frames, so that the line never waits for one, and a full store
/// never lets go of anything for them.
const PIECES_AHEAD: u32 = 24;

/// Messages as records of a link; commands as the peer's records, or as an old base station's frames. `K` keeps the station's
/// configurations.
pub struct Reliable<'a, L, S, K = BuiltIn> {
    line: &'a mut L,
    link: &'a mut link::Link<S>,
    /// It is to start again; the token of the order that is answered so.
    restart: Option<Option<u8>>,
    restarts: bool,
    now_us: u64,
    said: u32,
    desk: Desk<K>,
    snippets: Snippets<'a>,
}

impl<'a, L: Link, S: Store> Reliable<'a, L, S> {
    /// A link on a line; `guard` says which commands are carried out.
    pub fn new(line: &'a mut L, link: &'a mut link::Link<S>, guard: Guard) -> Self {
        Self::with(line, link, guard, BuiltIn)
    }
}

impl<'a, L: Link, S: Store, K: Keeper> Reliable<'a, L, S, K> {
    /// The same with a keeper of configurations.
    pub fn with(line: &'a mut L, link: &'a mut link::Link<S>, guard: Guard, keeper: K) -> Self {
        let desk = Desk { guard, keeper, heard: Deque::new(), bad: 0, reached: false };
        let snippets = Snippets::new(&mut []);
        Self { line, link, restart: None, restarts: false, now_us: 0, said: 0, desk, snippets }
    }

    /// The same with memory for a snippet of as many codes.
    pub fn with_snippets(self, memory: &'a mut [i32]) -> Self {
        Self { snippets: Snippets::new(memory), ..self }
    }

    /// The keeper.
    pub fn keeper(&mut self) -> &mut K {
        &mut self.desk.keeper
    }

    fn put(&mut self, message: &Message) {
        let mut buffer = [0; RECORD_BYTES];
        let message = completed(message, self.dropped());
        let bytes = crate::wire::bytes_of(&message, &mut buffer);
        self.link.offer(Class::of(&message), bytes);
        self.said = self.said.saturating_add(1);
    }

    /// An order is done.
    fn finish(&mut self, done: Done) {
        match done {
            Done::Reply(token, status) => self.put(&Message::Reply(Reply { token, status })),
            Done::Restart(token) => self.restart = Some(token),
        }
    }
}

impl<L, S, K> Reliable<'_, L, S, K> {
    /// The line.
    pub fn line(&self) -> &L {
        self.line
    }

    /// Whether the recorder is to start again.
    pub fn restarts(&self) -> bool {
        self.restarts
    }

    /// The link, to look at.
    pub fn link(&self) -> &link::Link<S> {
        self.link
    }
}

/// Commands that have come and were not carried out yet.
struct Desk<K> {
    guard: Guard,
    keeper: K,
    heard: Deque<Order, 8>,
    bad: u32,
    /// A command has come that is carried out.
    reached: bool,
}

/// What a base station wants, or what it is to be told.
#[derive(Clone, Copy, Debug)]
enum Order {
    Heard(Heard),
    Done(Done),
}

impl<K> Desk<K> {
    /// What has come is no command, or not for this recorder.
    fn refuse(&mut self) -> Option<Order> {
        self.bad = self.bad.saturating_add(1);
        Some(Order::Heard(Heard::Bad(self.bad)))
    }
}

impl<K: Keeper> Inbox for Desk<K> {
    fn recall(&mut self, _: &Session) -> Option<Progress> {
        None
    }

    fn take(&mut self, arrival: Arrival<'_>) {
        let bytes = match arrival {
            Arrival::Record(record) => record.bytes,
            Arrival::Plain { message, .. } => message,
            Arrival::Opened(_) | Arrival::Lost(_) => return,
        };
        // More commands than fit between two looks: the base station asks again for what is not answered.
        if self.heard.is_full() {
            self.bad = self.bad.saturating_add(1);
            return;
        }
        let order = match self.guard.open_up(bytes) {
            Some(bytes) => match Configure::decode(bytes) {
                Some(order) => {
                    self.reached = true;
                    self.keeper.take(&order).map(Order::Done)
                }
                None => command_of(bytes).map(Heard::Command).map(Order::Heard).or_else(|| self.refuse()),
            },
            None => self.refuse(),
        };
        if let Some(order) = order {
            let _ = self.heard.push_back(order);
        }
    }
}

impl<L: Link, S: Store, K: Keeper> Outlet for Reliable<'_, L, S, K> {
    fn say(&mut self, message: &Message) {
        self.put(message);
        if matches!(message, Message::Hello(_))
            && let Some(fault) = self.desk.keeper.news()
        {
            self.put(&Message::Fault(fault));
        }
    }

    fn hear(&mut self) -> Option<Heard> {
        loop {
            if let Some(token) = self.restart.take() {
                self.restarts = true;
                return Some(Heard::Restart(token));
            }
            while self.desk.heard.is_empty() {
                let byte = self.line.receive()?;
                self.link.receive(self.now_us, byte, &mut self.desk);
            }
            match self.desk.heard.pop_front()? {
                Order::Heard(heard) => {
                    self.desk.reached |= matches!(heard, Heard::Command(_));
                    return Some(heard);
                }
                Order::Done(done) => self.finish(done),
            }
        }
    }

    fn work(&mut self, clock: &mut impl Clock) {
        self.now_us = clock.micros();
        let reached = self.desk.reached || self.link.up();
        if let Some(done) = self.desk.keeper.work((self.now_us / 1_000_000) as u32, reached) {
            self.finish(done);
        }
        while !self.crowded()
            && self.link.store().ledger().kept(Class::Spectrum) < PIECES_AHEAD
            && let Some(message) = self.snippets.next_message()
        {
            self.put(&message);
        }
        while let Some(frame) = self.link.send(self.now_us) {
            // A frame for which the line has no room is one that is lost: it comes again.
            self.line.send(frame);
        }
    }

    fn sampled(&mut self) {
        self.desk.keeper.sampled();
    }

    fn block(&mut self, block: &Block<'_>) {
        self.snippets.take(block);
    }

    fn snippet(&mut self, token: u8, channels: u8, instants: u32) -> u8 {
        self.snippets.order(token, channels, instants)
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

    fn kept(&self) -> (u32, u32) {
        (self.link.waiting(), 2 * self.link.store().half())
    }

    fn waiting(&self) -> bool {
        (self.link.waiting() > 0 || self.snippets.sends()) && self.link.reachable()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::End;
    use crate::wire::link::{MemoryStore, Settings};
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

    /// A line that ends in two lists of bytes.
    #[derive(Default)]
    struct Ends(Vec<u8>, Vec<u8>);

    impl Link for Ends {
        fn send(&mut self, frame: &[u8]) -> bool {
            self.0.extend_from_slice(frame);
            true
        }

        fn receive(&mut self) -> Option<u8> {
            (!self.1.is_empty()).then(|| self.1.remove(0))
        }
    }

    #[test]
    fn a_recorder_without_places_answers_a_new_configuration_with_or_without_a_link() {
        let mut orders = Encoder::default();
        let mut buffer = [0; crate::wire::guard::COMMAND_BYTES];
        let begin = orders.frame_of(Configure::Begin { token: 9, length: 5, crc: 1 }.encode(&mut buffer));
        let mut line = Ends(Vec::new(), begin.to_vec());
        line.1.extend_from_slice(orders.frame(&Command::Stop { token: 4 }));
        let stop = Some(Heard::Command(Command::Stop { token: 4 }));
        let refused = Message::Reply(Reply { token: 9, status: UNKNOWN });
        let mut plain = Ends(Vec::new(), line.1.clone());
        let mut outlet = Plain::new(&mut plain);
        assert_eq!([outlet.hear(), outlet.hear()], [stop, None]);
        let mut decoder = Decoder::default();
        let said = plain.0.iter().find_map(|byte| decoder.push::<Message>(*byte));
        assert_eq!(said.map(|said| said.message), Some(refused));
        let mut link = End2::new(Settings::serial(921_600), 7, 1, 5, MemoryStore::new());
        let mut outlet = Reliable::new(&mut line, &mut link, Guard::open());
        assert_eq!([outlet.hear(), outlet.hear()], [stop, None]);
        let kept = link.store().ledger();
        let number = kept.oldest[Class::Health as usize];
        let mut record = [0; RECORD_BYTES];
        let of = link.store().read(Class::Health, number, &mut record).unwrap();
        assert_eq!(crate::wire::message_of(&record[..of.bytes]), Some(refused));
    }
}
