//! Greeting, health reports and answers to commands, the same for every kind of recorder.

use crate::config::{Schedule, StationConfig};
use crate::health::Accounting;
use crate::intake::{Faults, GRID};
use crate::math;
use crate::utc::{Noted, Pair, UtcClock};
use crate::version::VERSION;
use crate::wire::{
    Command, Fault, FaultCode, Health, Hello, Message, Reply, SCHEMA_HASH, Time, WIRE_VERSION,
};

/// How old the newest sample may be when a command is carried out, s: a block of work.
const SAMPLE_AGE_S: f64 = 0.02;
/// Seconds of samples between health reports unless a command says otherwise.
pub const HEALTH_EVERY_S: u16 = 60;

/// Seconds of samples between two reports of the time by a clock that is heard all the time.
pub const TIME_EVERY_S: u64 = 60;

/// Part of a stretch that the board's clock has measured by which that may be wrong, one standard deviation: its oscillator drifts with the
/// temperature after it was last compared with the converter's.
const ESTIMATED: f64 = 1e-4;

/// An index that leaps brings a report no earlier than this part of the time between two.
const EARLY: u64 = 8;

/// What a chain reports about itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Condition {
    /// Where every sample went.
    pub accounting: Accounting,
    /// Bit c: channel c dead or stuck; bit 4+c: channel c clipping.
    pub channels: u8,
    /// Level of each hydrophone or component, half decibels re full scale.
    pub level_half_db: [i8; 4],
}

/// Decides when to report and what to answer.
#[derive(Clone, Debug)]
pub struct Reporter {
    rate_hz: f64,
    config_hash: u64,
    station: u16,
    kind: u8,
    every_s: u16,
    /// Index from which a report is due, and how many instants may come until one is, wherever the index goes.
    next: u64,
    latest: u64,
    /// How many must have come before one is, so that an index that leaps again and again does not fill the line.
    earliest: u64,
    /// Instants that had come at the last look.
    arrived: u64,
    records: u32,
    schedule: Schedule,
    utc: UtcClock,
    /// Samples at which the line of UTC was told: the first since it began, and the newest.
    told: Option<(u64, u64)>,
}

impl Reporter {
    /// A reporter that has nothing to report yet.
    pub const fn new() -> Self {
        Self {
            rate_hz: 0.0,
            config_hash: 0,
            station: 0,
            kind: 0,
            every_s: 0,
            next: 0,
            latest: 0,
            earliest: 0,
            arrived: 0,
            records: 0,
            schedule: Schedule { every_s: 0, on_s: 0 },
            utc: UtcClock::new(),
            told: None,
        }
    }

    /// Takes the identity of the station; `kind` is 0 for an array, 1 for an ocean-bottom station.
    pub fn configure(&mut self, config: &StationConfig, kind: u8) {
        *self = Self {
            rate_hz: config.rate_hz,
            config_hash: config.hash(),
            station: config.id,
            kind,
            every_s: HEALTH_EVERY_S,
            schedule: config.schedule,
            ..Self::new()
        };
        self.schedule(0);
        self.earliest = 0;
    }

    /// Who is speaking.
    pub fn hello(&self, reset_cause: u8) -> Message {
        Message::Hello(Hello {
            wire_version: WIRE_VERSION,
            schema_hash: SCHEMA_HASH,
            config_hash: self.config_hash,
            version: VERSION,
            station: self.station,
            kind: self.kind,
            rate_hz: self.rate_hz as f32,
            reset_cause,
        })
    }

    /// Counts a record on its way out.
    pub fn count(&mut self, message: &Message) {
        if matches!(message, Message::Bearing(_) | Message::Azimuth(_) | Message::Range(_)) {
            self.records = self.records.saturating_add(1);
        }
    }

    /// A health report, if one is due at `index` or after as many instants as have `arrived` by now.
    pub fn due(&mut self, index: u64, arrived: u64, condition: &Condition) -> Option<Message> {
        self.arrived = arrived;
        if (index < self.next || arrived < self.earliest) && arrived < self.latest {
            return None;
        }
        self.schedule(index);
        Some(self.health(index, condition))
    }

    /// Time starts again at `index`; UTC is not known of it.
    pub fn restart(&mut self, index: u64) {
        self.next = self.whole_period_after(index);
        (self.utc, self.told) = (UtcClock::new(), None);
    }

    /// So many instants before this index were counted by the board's clock, which is no better known than so.
    pub fn estimated(&mut self, index: u64, instants: u64, sink: &mut impl FnMut(&Message)) {
        let sd_s = (ESTIMATED * instants as f64 + 1.0) / self.rate_hz;
        if let Some(time) = self.utc.loosen(index, sd_s, self.rate_hz) {
            // The next pair is told at once.
            self.told = None;
            sink(&Message::Time(time));
        }
    }

    /// Whether a health report is due after so many seconds of silence.
    pub fn due_in_silence(&self, seconds: u32) -> bool {
        seconds.checked_rem(u32::from(self.every_s)) == Some(0)
    }

    /// When the recorder listens, and its sample rate, Hz.
    pub(super) fn listens(&self) -> (Schedule, f64) {
        (self.schedule, self.rate_hz)
    }

    /// Nominal sample rate, Hz.
    pub(super) fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// A health report now.
    pub fn health(&self, index: u64, condition: &Condition) -> Message {
        Message::Health(Health {
            index,
            processed: condition.accounting.processed,
            lost: condition.accounting.lost,
            channels: condition.channels,
            level_half_db: condition.level_half_db,
            records: self.records,
            frames_dropped: 0, // counted and filled in by the loop that owns the link
        })
    }

    /// Carries out a command.
    pub fn command(
        &mut self,
        command: Command,
        index: u64,
        condition: &Condition,
        faults: &mut Faults,
        sink: &mut impl FnMut(&Message),
    ) {
        let token = match command {
            Command::Identify { token } => {
                sink(&self.hello(RESET_UNKNOWN));
                sink(&self.health(index, condition));
                token
            }
            Command::HealthEvery { token, seconds } => {
                self.every_s = seconds;
                self.schedule(index);
                token
            }
            Command::Stop { token } => token, // the loop stops
            Command::Start { token }
            | Command::SendSnippet { token, .. }
            | Command::SendSpectrum { token, .. } => {
                return sink(&Message::Reply(Reply { token, status: 1 }));
            }
            Command::Utc { token, utc_us, sd_us } => {
                let now = Pair { index, utc_us, sd_s: f64::from(sd_us) * 1e-6 };
                let status = self.time(now, faults, sink);
                return sink(&Message::Reply(Reply { token, status }));
            }
        };
        sink(&Message::Reply(Reply { token, status: 0 }));
    }

    /// It is this time now, a little after the newest sample; the status of the answer.
    fn time(&mut self, now: Pair, faults: &mut Faults, sink: &mut impl FnMut(&Message)) -> u8 {
        let sd_s = math::f64::sqrt(now.sd_s * now.sd_s + SAMPLE_AGE_S * SAMPLE_AGE_S);
        match self.utc.note(Pair { sd_s, ..now }, self.rate_hz) {
            Noted::Taken(time) => sink(&Message::Time(time)),
            Noted::Refused => return 1,
            Noted::Stepped(time, value) => self.stepped(&time, value, faults, sink),
        }
        0
    }

    /// A sample's UTC from a clock that is heard all the time. The line is told when it begins, then after a second, two, four
    /// and so on, and once a minute in the end.
    pub fn pair(&mut self, pair: Pair, faults: &mut Faults, sink: &mut impl FnMut(&Message)) {
        match self.utc.note(pair, self.rate_hz) {
            Noted::Taken(time) => {
                let first = match self.told {
                    Some((first, newest)) if newest <= time.index => {
                        let (least, most) = (self.rate_hz as u64, TIME_EVERY_S * self.rate_hz as u64);
                        // A pulse is a little more or less than a second's samples after the one before.
                        if time.index - newest + least / 2 < (newest - first).max(least).min(most) {
                            return;
                        }
                        first
                    }
                    _ => time.index,
                };
                self.told = Some((first, time.index));
                sink(&Message::Time(time));
            }
            Noted::Refused => {}
            Noted::Stepped(time, value) => self.stepped(&time, value, faults, sink),
        }
    }

    fn stepped(&mut self, time: &Time, value: i64, faults: &mut Faults, sink: &mut impl FnMut(&Message)) {
        self.told = Some((time.index, time.index));
        let fault = Fault { code: FaultCode::ClockStepped, index: time.index, value };
        faults.gather(fault, &mut |message| sink(&message));
        sink(&Message::Time(*time));
    }

    fn schedule(&mut self, index: u64) {
        self.next = self.whole_period_after(index);
        self.earliest = self.arrived.saturating_add(self.period() / EARLY);
        // By the index, where it goes on as it should, at most this long after the last.
        self.latest = match self.period() {
            0 => u64::MAX,
            period => self.arrived.saturating_add(period).saturating_add(GRID),
        };
    }

    /// Instants between reports; 0 if only on request.
    fn period(&self) -> u64 {
        (self.rate_hz * f64::from(self.every_s)) as u64
    }

    fn whole_period_after(&self, index: u64) -> u64 {
        index.checked_div(self.period()).map_or(u64::MAX, |n| (n + 1).saturating_mul(self.period()))
    }
}

/// `Hello::reset_cause` when only the board would know.
const RESET_UNKNOWN: u8 = 255;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_fall_on_whole_periods_whatever_the_blocks() {
        let mut r = Reporter { rate_hz: 100.0, every_s: HEALTH_EVERY_S, ..Reporter::new() };
        r.schedule(0);
        let c = Condition::default();
        assert!(r.due(5999, 5999, &c).is_none());
        assert!(r.due(6007, 6007, &c).is_some());
        assert!(r.due(11_999, 11_999, &c).is_none());
        assert!(r.due(12_000, 12_000, &c).is_some());
        // The index starts again before each report by it: the next comes by what has arrived.
        let latest = 18_000 + GRID;
        for arrived in (12_512..latest).step_by(512) {
            r.restart(0);
            assert!(r.due(512, arrived, &c).is_none());
        }
        assert!(r.due(512, latest, &c).is_some() && r.due(512, latest + 512, &c).is_none());
    }

    #[test]
    fn commands_are_answered_with_their_token() {
        let mut r = Reporter::new();
        let mut out = std::vec::Vec::new();
        r.command(Command::Identify { token: 9 }, 0, &Condition::default(), &mut Faults::new(), &mut |m| {
            out.push(*m)
        });
        assert!(matches!(out[0], Message::Hello(_)) && matches!(out[1], Message::Health(_)));
        assert_eq!(out[2], Message::Reply(Reply { token: 9, status: 0 }));
    }

    #[test]
    fn a_pulse_each_second_is_told_ever_more_rarely_and_a_step_at_once() {
        let mut r = Reporter { rate_hz: 100.0, ..Reporter::new() };
        let start_us = 1_790_000_000_000_000;
        let mut told = std::vec::Vec::new();
        let mut hear = |r: &mut Reporter, index: u64, second: i64| {
            let pair = Pair { index, utc_us: start_us + second * 1_000_000, sd_s: 2e-6 };
            let mut faults = 0;
            r.pair(pair, &mut Faults::new(), &mut |m| match m {
                Message::Time(time) => told.push(time.index / 100),
                Message::Fault(f) => faults += i64::from(f.code == FaultCode::ClockStepped) * f.value,
                _ => {}
            });
            faults
        };
        for second in 0..300u64 {
            assert_eq!(hear(&mut r, 100 * second, second as i64), 0);
        }
        // One wrong second is nothing; from the third on it is a step.
        assert_eq!(hear(&mut r, 30_000, 301), 0);
        assert_eq!(hear(&mut r, 30_100, 301), 0);
        let steps: std::vec::Vec<i64> = (302..306).map(|s| hear(&mut r, 100 * s, s as i64 + 5)).collect();
        assert_eq!(steps, [0, 0, 5_000_000, 0]);
        // The index starts again.
        r.restart(0);
        assert_eq!(hear(&mut r, 0, 310), 0);
        assert_eq!(told, [0, 1, 2, 4, 8, 16, 32, 64, 124, 184, 244, 304, 305, 0]);
    }

    #[test]
    fn a_time_is_taken_and_told_and_a_wrong_one_refused_until_it_comes_three_times() {
        let mut r = Reporter { rate_hz: 100.0, ..Reporter::new() };
        let mut tell = |index: u64, utc_us: i64| {
            let mut out = std::vec::Vec::new();
            let command = Command::Utc { token: 4, utc_us, sd_us: 1000 };
            r.command(command, index, &Condition::default(), &mut Faults::new(), &mut |m| out.push(*m));
            out
        };
        let reply = |status| Message::Reply(Reply { token: 4, status });
        let start_us = 1_790_000_000_000_000;
        let first = tell(100, start_us);
        assert!(matches!(first[0], Message::Time(t) if t.index == 100 && t.utc_us == start_us), "{first:?}");
        assert_eq!(first[1], reply(0));
        assert_eq!(tell(200, start_us + 9_000_000), [reply(1)]);
        assert_eq!(tell(300, start_us + 10_000_000), [reply(1)]);
        let stepped = tell(400, start_us + 11_000_000);
        let step = Fault { code: FaultCode::ClockStepped, index: 400, value: 8_000_000 };
        assert_eq!((stepped[0], stepped[2]), (Message::Fault(step), reply(0)));
    }
}
