//! A recorder that does not record: it answers on its link, says why, and waits to be told to start.
//!
//! A board comes here after a `Stop`, with a configuration it cannot use, or after too many starts in a row: it can always
//! be reached.

use crate::keeper::{DONE, REFUSED};
use crate::outlet::{Heard, Outlet};
use crate::port::{Clock, Load, Supervisor};
use crate::wire::{Command, Fault, FaultCode, Hello, Message, Reply, SCHEMA_HASH, WIRE_VERSION};

/// [`Hello::kind`] of a recorder that waits.
pub const WAITING: u8 = 255;

/// Seconds from one telling of the reason to the next.
const TELL_EVERY_S: u32 = 10;

/// Why a recorder waits, and the number that goes with it.
pub type Reason = (FaultCode, i64);

/// Waits until [`Command::Start`] comes, until the board says that the reason is over, or until there is another configuration;
/// then the board begins a new session. `station` is its number, 0 where unknown.
pub fn wait(
    station: u16,
    reason: Option<Reason>,
    outlet: &mut impl Outlet,
    clock: &mut impl Clock,
    supervisor: &mut impl Supervisor,
) {
    let hello = Message::Hello(Hello {
        wire_version: WIRE_VERSION,
        schema_hash: SCHEMA_HASH,
        config_hash: 0,
        version: crate::version::VERSION,
        station,
        kind: WAITING,
        rate_hz: 0.0,
        reset_cause: supervisor.reset_cause(),
    });
    let fault = |(code, value): Reason| Message::Fault(Fault { code, index: 0, value });
    // What finds no room on a line without a link is told again.
    outlet.say(&hello);
    if let Some(earlier) = supervisor.last_fault() {
        outlet.say(&fault(earlier));
    }
    let mut told_s = clock.seconds().wrapping_sub(TELL_EVERY_S);
    loop {
        supervisor.feed();
        outlet.work(clock);
        if reason.is_some() && supervisor.over() {
            return;
        }
        supervisor.fault().into_iter().for_each(|told| outlet.say(&fault(told)));
        let now_s = clock.seconds();
        if let Some(reason) = reason
            && now_s.wrapping_sub(told_s) >= TELL_EVERY_S
        {
            told_s = now_s;
            outlet.say(&fault(reason));
            if let Some(margins) = supervisor.margins(&Load { waiting: outlet.kept(), ..Load::default() }) {
                outlet.say(&Message::Margins(margins));
            }
        }
        while let Some(heard) = outlet.hear() {
            let command = match heard {
                Heard::Command(command) => command,
                Heard::Bad(_) => continue,
                Heard::Restart(token) => {
                    token
                        .into_iter()
                        .for_each(|token| outlet.say(&Message::Reply(Reply { token, status: DONE })));
                    return;
                }
            };
            let here = matches!(command, Command::Start { .. } | Command::Identify { .. });
            let (token, status) = (command.token(), if here { DONE } else { REFUSED });
            if matches!(command, Command::Identify { .. }) {
                outlet.say(&hello);
                reason.into_iter().for_each(|reason| outlet.say(&fault(reason)));
            }
            outlet.say(&Message::Reply(Reply { token, status }));
            if matches!(command, Command::Start { .. }) {
                return;
            }
        }
        supervisor.idle();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outlet::Plain;
    use crate::port::Link;
    use crate::wire::{Decoder, Encoder};
    use std::vec::Vec;

    /// Commands by the second in which they come, and what was said by then.
    struct Line {
        second: u32,
        commands: Vec<(u32, Vec<u8>)>,
        heard: Vec<(u32, Message)>,
        decoder: Decoder,
    }

    struct Seconds(core::cell::Cell<u32>);

    impl Link for (&mut Line, &Seconds) {
        fn send(&mut self, frame: &[u8]) -> bool {
            let line = &mut *self.0;
            let now = self.1.0.get();
            line.heard.extend(frame.iter().filter_map(|b| line.decoder.push(*b)).map(|r| (now, r.message)));
            true
        }
        fn receive(&mut self) -> Option<u8> {
            self.0.second = self.1.0.get();
            let due =
                self.0.commands.iter_mut().find(|(at, bytes)| *at <= self.0.second && !bytes.is_empty());
            due.map(|(_, bytes)| bytes.remove(0))
        }
    }

    impl Clock for &Seconds {
        fn ticks(&mut self) -> u32 {
            0
        }
        fn seconds(&mut self) -> u32 {
            self.0.get()
        }
    }

    impl Supervisor for &Seconds {
        fn feed(&mut self) {}
        fn idle(&mut self) {
            self.0.set(self.0.get().wrapping_add(1));
        }
        fn reset_cause(&self) -> u8 {
            1
        }
        fn last_fault(&mut self) -> Option<Reason> {
            Some((FaultCode::Panicked, 7))
        }
    }

    #[test]
    fn it_says_why_every_ten_seconds_answers_and_leaves_only_when_told_to() {
        let mut encoder = Encoder::default();
        let commands = [
            (12, Command::Stop { token: 1 }),
            (13, Command::Identify { token: 2 }),
            (25, Command::Start { token: 3 }),
        ];
        let commands = commands.map(|(at, c)| (at, encoder.frame(&c).to_vec())).into();
        let mut line = Line { second: 0, commands, heard: Vec::new(), decoder: Decoder::default() };
        let seconds = Seconds(core::cell::Cell::new(0));
        let reason = Some((FaultCode::BadConfiguration, 2));
        let mut ends = (&mut line, &seconds);
        wait(7, reason, &mut Plain::new(&mut ends), &mut &seconds, &mut &seconds);
        let fault = |code, value| Message::Fault(Fault { code, index: 0, value });
        let bad = fault(FaultCode::BadConfiguration, 2);
        let reply = |token, status| Message::Reply(Reply { token, status });
        assert!(matches!(line.heard[0], (0, Message::Hello(Hello { station: 7, kind: WAITING, .. }))));
        assert_eq!(line.heard[1], (0, fault(FaultCode::Panicked, 7)));
        let rest: Vec<(u32, Message)> =
            line.heard[2..].iter().copied().filter(|(_, m)| !matches!(m, Message::Hello(_))).collect();
        assert_eq!(
            rest,
            [
                (0, bad),
                (10, bad),
                (12, reply(1, 1)),
                (13, bad),
                (13, reply(2, 0)),
                (20, bad),
                (25, reply(3, 0))
            ]
        );
    }
}
