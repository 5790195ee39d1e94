//! The recorder's main loop: samples to messages to frames, commands back; the same code on the target and on the host.
//!
//! Enters: a [`SampleSource`], a [`Link`], a [`Clock`] and a [`Supervisor`]. Leaves: frames on the link. What the loop
//! adds to the recorder's own messages is the count of frames the link refused ([`frames_dropped`](seabearing_wire::message::Health::frames_dropped)) and the
//! closing [`End`]; after each `Health` come the board's margins, where it measures them. While no samples come it tells the recorder the seconds by the board's clock, so
//! that a dead converter is reported and `Health` goes on; otherwise the clock measures work and influences nothing but
//! when a link ([`crate::outlet::Reliable`]) sends.

mod rhythm;

use crate::block::{Block, Frame};
use crate::config::Schedule;
use crate::keeper::{DONE, REFUSED};
use crate::outlet::{Heard, Outlet, Plain};
use crate::port::{Chunk, Clock, Link, Load, SampleSource, Supervisor};
use crate::utc::Pair;
use crate::wire::{Command, End, Fault, FaultCode, Message, Reply, Time};
use rhythm::Rhythm;

/// Sample instants handled at a time: 1 ms at 64 kHz, which costs 1 KiB and is long against the loop's own work.
pub const BLOCK_FRAMES: usize = 64;

/// Seconds of silence told at once: more is a clock that jumped.
const MOST_AT_ONCE_S: u32 = 60;

/// A converter's rate is its nominal one to a part in so many (100 ppm), one standard deviation.
const STEADY: u64 = 10_000;

/// Seconds after the end in which a base station may still take what waits.
const LINGER_S: u32 = 60;

/// What the loop drives: blocks and commands in, messages out.
pub trait Application {
    /// Called once before the first block, with the reason of the start.
    fn start(&mut self, reset_cause: u8, sink: &mut impl FnMut(&Message));

    /// Takes consecutive samples.
    fn push(&mut self, block: Block<'_>, sink: &mut impl FnMut(&Message));

    /// Carries out a command; the loop itself stops on [`Command::Stop`] and answers [`Command::SendSnippet`].
    fn command(&mut self, command: Command, sink: &mut impl FnMut(&Message));

    /// Sample instants that end a silence; fewer do not interrupt it.
    fn enough(&self) -> u32 {
        1
    }

    /// Fewer samples than [`Self::enough`] have come for so many seconds; called once for each, from the first on.
    fn silent(&mut self, seconds: u32, sink: &mut impl FnMut(&Message));

    /// When it listens, and its samples a second.
    fn schedule(&self) -> (Schedule, f64) {
        (Schedule::default(), 0.0)
    }

    /// Samples from here up to this index are left out on purpose; said again where the pause becomes longer or shorter.
    fn pause(&mut self, _until: u64, _sink: &mut impl FnMut(&Message)) {}

    /// So many seconds of them have gone by; called once for each, from the first on.
    fn paused(&mut self, _seconds: u32, _sink: &mut impl FnMut(&Message)) {}

    /// Something went wrong outside: said as other faults are.
    fn fault(&mut self, code: FaultCode, value: u64, sink: &mut impl FnMut(&Message));

    /// A sample's index and its UTC are known.
    fn pair(&mut self, pair: Pair, sink: &mut impl FnMut(&Message));

    /// The input has ended: everything still held is said.
    fn finish(&mut self, sink: &mut impl FnMut(&Message));
}

/// Work done, in the clock's ticks, and what the link did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Sample index after the last sample seen.
    pub index: u64,
    /// Sample instants seen.
    pub instants: u64,
    /// Ticks spent in the application and in framing.
    pub busy_ticks: u64,
    /// Most ticks one block took.
    pub worst_block_ticks: u32,
    /// Frames the link took.
    pub frames: u32,
    /// Frames the link refused.
    pub frames_dropped: u32,
}

/// Seconds without samples, or with hardly any.
struct Silence {
    since_s: u32,
    told_s: u32,
    /// Instants that have come in it.
    came: u32,
}

impl Silence {
    /// None yet.
    fn since(now_s: u32) -> Self {
        Self { since_s: now_s, told_s: 0, came: 0 }
    }

    /// So many instants have come; whether they are enough.
    fn interrupt(&mut self, count: usize, enough: u32, now_s: u32) -> bool {
        self.came = self.came.saturating_add(count as u32);
        let interrupted = self.came >= enough;
        if interrupted {
            *self = Self::since(now_s);
        }
        interrupted
    }

    /// The next second that has gone by and was not told.
    fn next(&mut self, now_s: u32) -> Option<u32> {
        let silent_s = now_s.wrapping_sub(self.since_s);
        // A clock that jumps is no long silence.
        self.told_s = self.told_s.max(silent_s.saturating_sub(MOST_AT_ONCE_S));
        (self.told_s < silent_s).then(|| {
            self.told_s += 1;
            self.told_s
        })
    }
}

/// What was said that concerns the board.
#[derive(Default)]
struct Told {
    /// Its margins follow.
    health: bool,
    /// Its clock may learn from it.
    time: Option<Time>,
    /// Sample about which a vessel was heard.
    heard: Option<u64>,
}

/// Where messages go; notes what concerns the board. One type of sink for all calls: each other would be another copy of the
/// recorder in flash.
fn said(outlet: &mut impl Outlet, told: &mut Told) -> impl FnMut(&Message) {
    move |message| {
        match message {
            Message::Health(_) => told.health = true,
            Message::Time(time) => told.time = Some(*time),
            Message::Bearing(bearing) => told.heard = Some(bearing.index),
            _ => {}
        }
        outlet.say(message);
    }
}

/// A command as the application takes it: that tells UTC when its next sample was heard, not when the command came. The age of one before a
/// pause is by the converter's nominal rate. The token of one that cannot be carried out: no sample can be said to be of then.
fn of_sample(command: Command, age_us: impl FnOnce() -> Option<u64>) -> Result<Command, u8> {
    Ok(match command {
        Command::Utc { token, utc_us, sd_us } => {
            let age_us = age_us().ok_or(token)?;
            let utc_us = utc_us.saturating_sub_unsigned(age_us);
            let sd_us = sd_us.saturating_add(u32::try_from(age_us / STEADY).unwrap_or(u32::MAX));
            Command::Utc { token, utc_us, sd_us }
        }
        other => other,
    })
}

/// Runs until the input ends or a stop is commanded; frames are sent once.
pub fn run(
    application: &mut impl Application,
    source: &mut impl SampleSource,
    link: &mut impl Link,
    clock: &mut impl Clock,
    supervisor: &mut impl Supervisor,
    frames: &mut [Frame; BLOCK_FRAMES],
) -> Summary {
    run_over(application, source, &mut Plain::new(link), clock, supervisor, frames)
}

/// Runs until the input ends or a stop is commanded, and then for a minute at most until a base station that answers has
/// everything.
pub fn run_over(
    application: &mut impl Application,
    source: &mut impl SampleSource,
    outlet: &mut impl Outlet,
    clock: &mut impl Clock,
    supervisor: &mut impl Supervisor,
    frames: &mut [Frame; BLOCK_FRAMES],
) -> Summary {
    let (mut summary, mut told) = (Summary::default(), Told::default());
    application.start(supervisor.reset_cause(), &mut said(outlet, &mut told));
    if let Some((code, value)) = supervisor.last_fault() {
        outlet.say(&Message::Fault(Fault { code, index: 0, value }));
    }
    let mut silence = Silence::since(clock.seconds());
    let mut rhythm = Rhythm::new(application.schedule());
    let mut running = true;
    while running {
        supervisor.feed();
        outlet.work(clock);
        while let Some(heard) = outlet.hear() {
            match heard {
                Heard::Command(Command::SendSnippet { token, channels, instants }) => {
                    let status = outlet.snippet(token, channels, instants);
                    outlet.say(&Message::Reply(Reply { token, status }));
                }
                Heard::Command(command) => {
                    running &= !matches!(command, Command::Stop { .. });
                    match of_sample(command, || source.age_us(summary.index)) {
                        Ok(command) => application.command(command, &mut said(outlet, &mut told)),
                        Err(token) => outlet.say(&Message::Reply(Reply { token, status: REFUSED })),
                    }
                }
                Heard::Bad(n) => {
                    application.fault(FaultCode::BadCommand, u64::from(n), &mut said(outlet, &mut told));
                }
                Heard::Restart(token) => {
                    running = false;
                    token
                        .into_iter()
                        .for_each(|token| outlet.say(&Message::Reply(Reply { token, status: DONE })));
                }
            }
        }
        if source.waits() && outlet.crowded() {
            supervisor.idle();
            continue;
        }
        match source.read(frames) {
            Chunk::Frames { first_index, count } => {
                if silence.interrupt(count, application.enough(), clock.seconds()) {
                    outlet.sampled();
                }
                let begun = clock.ticks();
                let mut block = Block { first_index, frames: frames.get(..count).unwrap_or(frames) };
                outlet.block(&block);
                while !block.frames.is_empty() {
                    let (heard, rest) = rhythm.part(block);
                    block = rest;
                    rhythm.tell(application, source, &mut said(outlet, &mut told));
                    if let Some(heard) = heard {
                        summary.index = heard.first_index.saturating_add(heard.frames.len() as u64);
                        application.push(heard, &mut said(outlet, &mut told));
                    }
                    while let Some(seconds) = rhythm.second(block.first_index) {
                        application.paused(seconds, &mut said(outlet, &mut told));
                    }
                }
                let ticks = clock.ticks().wrapping_sub(begun);
                summary.busy_ticks = summary.busy_ticks.saturating_add(u64::from(ticks));
                summary.worst_block_ticks = summary.worst_block_ticks.max(ticks);
                summary.instants = summary.instants.saturating_add(count as u64);
            }
            Chunk::Idle => {
                supervisor.idle();
                while let Some(seconds) = silence.next(clock.seconds()) {
                    application.silent(seconds, &mut said(outlet, &mut told));
                }
            }
            Chunk::End => running = false,
        }
        if let Some((code, value)) = source.fault() {
            application.fault(code, value, &mut said(outlet, &mut told));
        }
        if let Some((code, value)) = supervisor.fault() {
            application.fault(code, value as u64, &mut said(outlet, &mut told));
        }
        if let Some(pair) = source.pair() {
            application.pair(pair, &mut said(outlet, &mut told));
        }
        if let Some(index) = told.heard.take() {
            source.heard(index);
        }
        if let Some(time) = told.time.take() {
            source.told(&time);
            rhythm.stretches.told(&time, rhythm.index);
            rhythm.tell(application, source, &mut said(outlet, &mut told));
        }
        if core::mem::take(&mut told.health) {
            let load = Load {
                index: rhythm.index,
                longest_ticks: summary.worst_block_ticks,
                waiting: outlet.kept(),
            };
            if let Some(margins) = supervisor.margins(&load) {
                outlet.say(&Message::Margins(margins));
            }
        }
    }
    application.finish(&mut said(outlet, &mut told));
    outlet.say(&Message::End(End { index: rhythm.index, frames: outlet.said() }));
    let ended_s = clock.seconds();
    while outlet.waiting() && clock.seconds().wrapping_sub(ended_s) < LINGER_S {
        supervisor.feed();
        outlet.work(clock);
        while let Some(heard) = outlet.hear() {
            // This session is over, and the next has not begun.
            if let Heard::Command(command) = heard {
                outlet.say(&Message::Reply(Reply { token: command.token(), status: REFUSED }));
            }
        }
    }
    summary.frames_dropped = outlet.dropped();
    summary.frames = outlet.said().saturating_sub(outlet.dropped());
    summary
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::port::NoClock;
    use crate::wire::{Decoder, Encoder, Health};
    use std::vec::Vec;

    struct Counting(u64);

    impl Application for Counting {
        fn start(&mut self, reset_cause: u8, sink: &mut impl FnMut(&Message)) {
            sink(&Message::Reply(Reply { token: reset_cause, status: 0 }));
        }
        fn push(&mut self, block: Block<'_>, sink: &mut impl FnMut(&Message)) {
            self.0 += block.frames.len() as u64;
            sink(&Message::Health(Health {
                index: block.first_index,
                processed: self.0,
                ..Health::default()
            }));
        }
        fn command(&mut self, command: Command, sink: &mut impl FnMut(&Message)) {
            if let Command::Stop { token } = command {
                sink(&Message::Reply(Reply { token, status: 0 }));
            }
        }
        fn silent(&mut self, seconds: u32, sink: &mut impl FnMut(&Message)) {
            sink(&Message::Fault(Fault { code: FaultCode::NoSamples, index: 0, value: i64::from(seconds) }));
        }
        fn fault(&mut self, code: FaultCode, value: u64, sink: &mut impl FnMut(&Message)) {
            sink(&Message::Fault(Fault { code, index: 0, value: value as i64 }));
        }
        fn pair(&mut self, _: Pair, _: &mut impl FnMut(&Message)) {}
        fn finish(&mut self, sink: &mut impl FnMut(&Message)) {
            sink(&Message::Health(Health { processed: self.0, ..Health::default() }));
        }
    }

    struct Ramp {
        next: u64,
        end: u64,
        idle: bool,
    }

    impl SampleSource for Ramp {
        fn read(&mut self, frames: &mut [Frame]) -> Chunk {
            self.idle = !self.idle;
            let count = frames.len().min((self.end - self.next) as usize);
            match (count, self.idle) {
                (0, _) => Chunk::End,
                (_, true) => Chunk::Idle,
                _ => {
                    self.next += count as u64;
                    Chunk::Frames { first_index: self.next - count as u64, count }
                }
            }
        }
    }

    #[derive(Default)]
    struct Line {
        sent: Vec<u8>,
        offered: u32,
        refuse: Option<u32>,
        to_receive: Vec<u8>,
    }

    impl Link for Line {
        fn send(&mut self, frame: &[u8]) -> bool {
            self.offered += 1;
            if self.refuse == Some(self.offered) {
                return false;
            }
            self.sent.extend_from_slice(frame);
            true
        }
        fn receive(&mut self) -> Option<u8> {
            if self.to_receive.is_empty() { None } else { Some(self.to_receive.remove(0)) }
        }
    }

    /// Watches over nothing.
    pub(crate) struct Idle;

    impl Supervisor for Idle {
        fn feed(&mut self) {}
        fn idle(&mut self) {}
        fn reset_cause(&self) -> u8 {
            3
        }
        fn last_fault(&mut self) -> Option<(FaultCode, i64)> {
            None
        }
    }

    /// Two whole blocks and a part of one.
    const INSTANTS: u64 = 2 * BLOCK_FRAMES as u64 + 20;

    fn go(link: &mut Line) -> (Summary, Vec<Message>) {
        let mut source = Ramp { next: 0, end: INSTANTS, idle: false };
        let mut frames = [[0; 4]; BLOCK_FRAMES];
        let summary = run(&mut Counting(0), &mut source, link, &mut NoClock, &mut Idle, &mut frames);
        let mut decoder = Decoder::default();
        (summary, link.sent.iter().filter_map(|b| decoder.push(*b).map(|r| r.message)).collect())
    }

    #[test]
    fn every_sample_is_pushed_and_the_end_closes_the_session() {
        let (summary, messages) = go(&mut Line::default());
        assert_eq!((summary.instants, summary.index, summary.frames), (INSTANTS, INSTANTS, 6));
        assert!(matches!(messages[0], Message::Reply(Reply { token: 3, .. })));
        assert!(matches!(messages[4], Message::Health(Health { processed: INSTANTS, .. })));
        assert_eq!(messages[5], Message::End(End { index: INSTANTS, frames: 5 }));
    }

    #[test]
    fn a_refused_frame_is_counted_in_the_next_health() {
        let (summary, messages) = go(&mut Line { refuse: Some(2), ..Line::default() });
        assert_eq!(summary.frames_dropped, 1);
        let dropped = |m: &Message| matches!(m, Message::Health(h) if h.frames_dropped == 1);
        assert_eq!(messages.iter().filter(|m| dropped(m)).count(), 3);
    }

    #[test]
    fn a_command_that_cannot_be_decoded_is_said_and_the_next_is_carried_out() {
        let mut encoder = Encoder::default();
        let mut to_receive = std::vec![0, 0];
        to_receive.extend_from_slice(encoder.frame(&77u8));
        let at = to_receive.len() + 3;
        to_receive.extend_from_slice(encoder.frame(&Command::Stop { token: 8 }));
        to_receive[at] ^= 0x40;
        to_receive.extend_from_slice(encoder.frame(&Command::Stop { token: 9 }));
        let (_, messages) = go(&mut Line { to_receive, ..Line::default() });
        let bad = |m: &Message| match m {
            Message::Fault(Fault { code: FaultCode::BadCommand, value, .. }) => Some(*value),
            _ => None,
        };
        assert!(messages.iter().filter_map(bad).eq([1, 2]), "{messages:?}");
        assert!(messages.contains(&Message::Reply(Reply { token: 9, status: 0 })));
        assert!(!messages.contains(&Message::Reply(Reply { token: 8, status: 0 })));
    }

    /// Idle for a while, the clock going on by `step_s` at each look; then a block and the end.
    struct Dead {
        idle: u32,
        block: bool,
    }

    impl SampleSource for Dead {
        fn read(&mut self, _: &mut [Frame]) -> Chunk {
            match self.idle.checked_sub(1) {
                Some(left) => {
                    self.idle = left;
                    Chunk::Idle
                }
                None if self.block => {
                    (self.block, self.idle) = (false, 3);
                    Chunk::Frames { first_index: 0, count: 1 }
                }
                None => Chunk::End,
            }
        }
    }

    struct Quarters(u32);

    impl Clock for Quarters {
        fn ticks(&mut self) -> u32 {
            0
        }
        fn seconds(&mut self) -> u32 {
            self.0 = self.0.wrapping_add(1);
            self.0 / 4
        }
    }

    #[test]
    fn silence_is_told_second_by_second_until_samples_come() {
        let (mut link, mut frames) = (Line::default(), [[0; 4]; BLOCK_FRAMES]);
        let mut source = Dead { idle: 20, block: true };
        run(&mut Counting(0), &mut source, &mut link, &mut Quarters(7), &mut Idle, &mut frames);
        let mut decoder = Decoder::default();
        let messages = link.sent.iter().filter_map(|b| decoder.push::<Message>(*b).map(|r| r.message));
        let told: Vec<i64> =
            messages.filter_map(|m| if let Message::Fault(f) = m { Some(f.value) } else { None }).collect();
        assert!(told.starts_with(&[1, 2, 3, 4, 5]) && told.len() <= 8, "{told:?}");
        // A clock that jumps, here backwards over its wrap, tells no more than a minute.
        let mut silence = Silence::since(5);
        let mut n = 0;
        while silence.next(4).is_some() {
            n += 1;
        }
        assert_eq!(n, MOST_AT_ONCE_S);
    }

    #[test]
    fn utc_told_now_is_that_of_the_sample_named_as_much_earlier_as_it_was_heard() {
        let told = Command::Utc { token: 3, utc_us: 1_000_000, sd_us: 5 };
        let earlier = Command::Utc { token: 3, utc_us: 998_500, sd_us: 5 };
        assert_eq!(of_sample(told, || Some(1500)), Ok(earlier));
        // Nor can anybody say of which sample while there are none.
        assert_eq!(of_sample(told, || None), Err(3));
        // By how long ten hours were nobody knows to better than a part in ten thousand.
        let long_ago = of_sample(told, || Some(36_000_000_000));
        assert!(matches!(long_ago, Ok(Command::Utc { sd_us: 3_600_005, .. })), "{long_ago:?}");
        let other = Command::Stop { token: 3 };
        assert_eq!(of_sample(other, || None), Ok(other));
    }

    #[test]
    fn a_stop_ends_the_run() {
        let to_receive = Encoder::default().frame(&Command::Stop { token: 9 }).to_vec();
        let (summary, messages) = go(&mut Line { to_receive, ..Line::default() });
        assert_eq!(summary.instants, 0);
        assert!(messages.contains(&Message::Reply(Reply { token: 9, status: 0 })));
        assert!(matches!(messages.last(), Some(Message::End(_))));
    }
}
