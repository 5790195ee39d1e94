//! What a year does to a recorder: true time, the clocks that tell it wrongly, converters, lines, supply, and what goes wrong
//! when. Nothing of it knows what the recorder makes of it.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use seabearing_core::wire::link::flash::{Cut, ModelFlash};
use seabearing_core::wire::{Command, FaultCode};
use seabearing_firmware::fault::Record;
use seabearing_firmware::receiver::Pulse;
use seabearing_firmware::starts::{self, Starts};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::panic::resume_unwind;
use std::rc::Rc;

/// Conversions a second, nominally, and microseconds of a day.
pub const RATE_HZ: f64 = 250.0;
pub const DAY_US: u64 = 86_400_000_000;
/// The first moment, UTC.
pub const BEGIN_S: i64 = 1_790_000_000;
/// Parts of each day that are computed, how many and how long.
pub const PARTS: u64 = 8;
pub const PART_US: u64 = 180_000_000;
/// From SYNC to the first conversion.
const SETTLES_US: u64 = 252_000;

/// Reasons of a start.
pub mod cause {
    pub const POWER: u8 = 0;
    pub const WATCHDOG: u8 = 1;
    pub const SOFTWARE: u8 = 2;
    pub const PIN: u8 = 3;
    pub const BROWN_OUT: u8 = 4;
}

/// How a boot ends, thrown through the software as a reset goes through a processor.
pub struct Reset;

/// Something that happens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// A start for this reason; what the software leaves behind, where it ends by itself.
    Restart(u8, Option<FaultCode>),
    /// Power is cut in the midst of the flash's next writing or erasing.
    PowerCut,
    /// Hard faults after each other's starts, so many.
    CrashLoop(u32),
    /// The converters stand still, or convert again.
    Converters(bool),
    /// The converters have reset themselves.
    ConverterReset,
    /// The line to the base station is up.
    Line(bool),
    /// The satellite receiver is heard.
    Receiver(bool),
    /// The supply is low.
    SupplyLow(bool),
    /// The base station commands this.
    Command(Command),
    /// The base station sends another configuration.
    Configure,
}

/// The flash's two parts: records and configurations.
pub type Records = ModelFlash<6, 4096>;
pub type Places = ModelFlash<2, 4096>;

/// What is known of a boot afterwards.
#[derive(Debug, Default)]
pub struct Boot {
    /// Its number on the link.
    pub number: u32,
    /// Edges, and when they were, µs.
    pub moments: Vec<(f64, f64)>,
    /// From which conversion's number on which edge it was.
    pub shifts: Vec<(u64, u64)>,
}

impl Boot {
    /// When the conversion of a number was, µs; `None` where there was none, because the converters stood still.
    pub fn at_us(&self, number: u64) -> Option<f64> {
        let at = self.shifts.partition_point(|(from, _)| *from <= number);
        let (from, edge) = *self.shifts.get(at.checked_sub(1)?)?;
        let edge = edge + (number - from);
        if self.shifts.get(at).is_some_and(|(_, next)| edge >= *next) {
            return None;
        }
        // An edge's number is the count before it.
        let edge = (edge + 1) as f64;
        let at = self.moments.partition_point(|(e, _)| *e < edge);
        let (a, b) = (self.moments.get(at.checked_sub(1)?)?, self.moments.get(at)?);
        Some(a.1 + (edge - a.0) / (b.0 - a.0) * (b.1 - a.1))
    }
}

/// Everything around the software.
pub struct World {
    rng: ChaCha8Rng,
    /// True time since the beginning, µs, and the end.
    pub now_us: u64,
    pub end_us: u64,
    /// Time in which something was computed, of all boots.
    pub computed_us: u64,
    /// The board's clock, µs, and how fast it is.
    board_us: f64,
    board_error: f64,
    board_walk: f64,
    /// Conversions since power-on, whole and begun; the relative error of their clock.
    edges: f64,
    pub drift: f64,
    walk: f64,
    converts: bool,
    /// Conversions begin at this moment.
    settled_us: u64,
    /// The converters are set as they were set up.
    pub set: bool,
    pub receiver: bool,
    pub line: bool,
    pub supply_low: bool,
    pub pulse: Option<Pulse>,
    pub sentences: VecDeque<u8>,
    pub to_base: VecDeque<u8>,
    pub to_board: VecDeque<u8>,
    /// What the base station is to send.
    pub orders: VecDeque<Event>,
    events: VecDeque<(u64, Event)>,
    crashes: u32,
    /// Kept across a reset: why, what the software left, and what was counted of its starts.
    pub cause: u8,
    pub fault: Option<Record>,
    pub starts: starts::Counts,
    pub records: Rc<RefCell<Box<Records>>>,
    pub places: Rc<RefCell<Box<Places>>>,
    /// Boots so far.
    pub boots: Vec<Boot>,
    /// Samples given since the part of the day began.
    pub given: u64,
    /// When something last happened, and parts of days of which the last minute and more was undisturbed and nothing was recorded.
    disturbed_us: u64,
    pub idle: u32,
    pub counts: Counts,
}

/// How often what happened.
#[derive(Debug, Default)]
pub struct Counts {
    pub resets: u32,
    pub watchdog: u32,
    pub faults: u32,
    pub cuts: u32,
    pub outages: u32,
    pub configurations: u32,
    pub commands: u32,
}

impl World {
    /// So many days from a seed.
    pub fn new(seed: u64, days: usize) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut events = Vec::new();
        plan(&mut rng, days as u64, &mut events);
        events.sort_by_key(|(at, _)| *at);
        Self {
            rng,
            now_us: 0,
            end_us: days as u64 * DAY_US,
            computed_us: 0,
            board_us: 0.0,
            board_error: 0.004,
            board_walk: 0.0,
            edges: 0.0,
            drift: 0.0,
            walk: 3e-6,
            converts: true,
            settled_us: u64::MAX,
            set: false,
            receiver: true,
            line: true,
            supply_low: false,
            pulse: None,
            sentences: VecDeque::new(),
            to_base: VecDeque::new(),
            to_board: VecDeque::new(),
            orders: VecDeque::new(),
            events: events.into(),
            crashes: 0,
            cause: cause::POWER,
            fault: None,
            starts: starts::Counts::default(),
            records: Rc::default(),
            places: Rc::default(),
            boots: Vec::new(),
            given: 0,
            disturbed_us: 0,
            idle: 0,
            counts: Counts::default(),
        }
    }

    /// Whether the year is over.
    pub fn over(&self) -> bool {
        self.now_us >= self.end_us
    }

    /// Whole conversions since power-on.
    pub fn edges(&self) -> u64 {
        self.edges as u64
    }

    /// The board's clock.
    pub fn board_us(&self) -> u64 {
        self.board_us as u64
    }

    /// The board's clock at the newest edge.
    pub fn edge_board_us(&self) -> u64 {
        let since_us = self.edges.fract() / (RATE_HZ * (1.0 + self.drift)) * 1e6;
        (self.board_us - since_us).max(0.0) as u64
    }

    /// Whether the converters convert.
    pub fn converts(&self) -> bool {
        self.converts
    }

    /// The converters are set up, if they answer.
    pub fn set_up(&mut self) -> bool {
        if self.converts {
            self.settled_us = self.now_us + SETTLES_US;
            self.set = true;
        }
        self.converts
    }

    /// The last moment of a boot.
    fn leave(&mut self, cause: u8, fault: Option<Record>) -> ! {
        (self.cause, self.fault) = (cause, fault.or(self.fault.filter(|_| cause != cause::POWER)));
        self.counts.resets += 1;
        resume_unwind(Box::new(Reset))
    }

    /// The flash has been written or erased: the power may have gone with that.
    pub fn written(&mut self, off: bool) {
        if off {
            self.records.borrow_mut().switch_on();
            self.places.borrow_mut().switch_on();
            self.counts.cuts += 1;
            self.power_lost();
            self.leave(cause::POWER, None);
        }
    }

    /// The board's memory and the converters' registers are empty.
    fn power_lost(&mut self) {
        (self.set, self.settled_us, self.fault) = (false, u64::MAX, None);
        self.starts = starts::Counts::default();
    }

    /// The software has ended by itself and starts again.
    pub fn start_again(&mut self) {
        self.cause = cause::SOFTWARE;
    }

    /// A start, with what was counted before.
    pub fn start(&mut self) -> Starts {
        let starts = Starts::new(self.cause, self.starts);
        self.starts = starts.counts();
        // The counter and the board's clock begin anew.
        (self.board_us, self.edges) = (0.0, self.edges.fract());
        self.boots.push(Boot {
            number: 0,
            moments: vec![(self.edges, self.now_us as f64)],
            shifts: Vec::new(),
        });
        self.to_board.clear();
        starts
    }

    /// The software sleeps: until something may have happened; at the end of a part of the day over what is not computed.
    pub fn sleep(&mut self) {
        const STEP_US: u64 = 64_000;
        let part = DAY_US / PARTS;
        if self.now_us % part >= PART_US {
            let undisturbed =
                self.converts && !self.supply_low && self.now_us > self.disturbed_us + PART_US / 2;
            self.idle += u32::from(undisturbed && self.given == 0);
            self.pulse = None;
            let mut left = part - self.now_us % part;
            while left > 0 {
                let step_us = left.min(60_000_000);
                self.go_on(step_us);
                left -= step_us;
            }
            self.given = 0;
        } else {
            let to_second = 1_000_000 - self.now_us % 1_000_000;
            let step_us = STEP_US.min(to_second);
            self.go_on(step_us);
            self.computed_us += step_us;
            if to_second == step_us {
                self.second();
            }
        }
        while self.events.front().is_some_and(|(at, _)| *at <= self.now_us) {
            if let Some((_, event)) = self.events.pop_front() {
                self.happen(event);
            }
        }
    }

    /// Time goes on.
    fn go_on(&mut self, us: u64) {
        let (from, to) = (self.now_us, self.now_us + us);
        let normal = |rng: &mut ChaCha8Rng| (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        // The crystal: aged, walking, and following the water's temperature, which changes over days.
        self.walk += 3e-10 * (us as f64 * 1e-6).sqrt() * normal(&mut self.rng);
        self.board_walk += 1e-7 * (us as f64 * 1e-6).sqrt() * normal(&mut self.rng);
        let days = from as f64 / DAY_US as f64;
        let warm = 0.6 * (std::f64::consts::TAU * days / 23.0).sin()
            + 1.0 * (std::f64::consts::TAU * days / 365.0).sin();
        self.drift = self.walk + 1e-7 * warm + 1e-9 * days;
        self.board_us += us as f64 * (1.0 + self.board_error + self.board_walk);
        let begin = from.max(self.settled_us).min(to);
        if self.converts {
            if begin > from && begin < to {
                self.note(begin);
            }
            self.edges += (to - begin) as f64 * 1e-6 * RATE_HZ * (1.0 + self.drift);
        }
        self.now_us = to;
        self.note(to);
    }

    /// The edges at a moment; of several without any between them the first and the last count.
    fn note(&mut self, at_us: u64) {
        let Some(moments) = self.boots.last_mut().map(|boot| &mut boot.moments) else { return };
        if let [.., before, last] = &mut moments[..]
            && before.0 == self.edges
            && last.0 == self.edges
        {
            last.1 = at_us as f64;
        } else {
            moments.push((self.edges, at_us as f64));
        }
    }

    /// A second of UTC begins: the receiver's pulse, and its sentence at once.
    fn second(&mut self) {
        let converts = self.converts && self.now_us > self.settled_us;
        if !(self.receiver && converts) {
            return;
        }
        let left = 1.0 - self.edges.fract();
        let late_s = left / (RATE_HZ * (1.0 + self.drift));
        self.pulse = Some(Pulse {
            edge: self.edges.floor() as u64,
            late_ns: (late_s * 1e9 * (1.0 + self.board_error + self.board_walk)).round() as i32,
            at_us: self.board_us(),
        });
        let utc_s = BEGIN_S + (self.now_us / 1_000_000) as i64;
        let body = match time::OffsetDateTime::from_unix_timestamp(utc_s) {
            Ok(t) => format!(
                "GPRMC,{:02}{:02}{:02}.00,A,,,,,,,{:02}{:02}{:02},,,A",
                t.hour(),
                t.minute(),
                t.second(),
                t.day(),
                u8::from(t.month()),
                t.year() % 100
            ),
            Err(_) => return,
        };
        let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
        self.sentences.extend(format!("${body}*{sum:02X}\r\n").bytes());
    }

    fn happen(&mut self, event: Event) {
        // A supply that has failed before is waited for, an hour at most.
        const WAITED_US: u64 = 3_600_000_000;
        let waited_us = if matches!(event, Event::SupplyLow(_)) { WAITED_US } else { 0 };
        self.disturbed_us = self.disturbed_us.max(self.now_us + waited_us);
        match event {
            Event::Restart(cause, fault) => {
                self.counts.watchdog += u32::from(cause == cause::WATCHDOG);
                self.counts.faults += u32::from(fault.is_some());
                let record = fault.map(|code| match code {
                    FaultCode::HardFault => Record::processor(0x0800_1234, 0x8200),
                    _ => Record::panic("year.rs", 77),
                });
                if matches!(cause, cause::POWER | cause::BROWN_OUT) {
                    self.power_lost();
                }
                self.leave(cause, record);
            }
            Event::PowerCut => {
                let next = self.records.borrow().operations();
                self.records.borrow_mut().cut_at(next, Cut::During);
            }
            Event::CrashLoop(count) => self.crashes = count,
            Event::Converters(on) => {
                self.counts.outages += u32::from(!on);
                (self.converts, self.set, self.settled_us) = (on, false, u64::MAX);
            }
            Event::ConverterReset => {
                self.counts.outages += 1;
                self.set = false;
            }
            Event::Line(up) => self.line = up,
            Event::Receiver(on) => self.receiver = on,
            Event::SupplyLow(low) => self.supply_low = low,
            Event::Command(_) | Event::Configure => self.orders.push_back(event),
        }
    }

    /// Whether the software crashes now, some seconds after its start.
    pub fn crash(&mut self) {
        if self.crashes > 0 && self.board_us > 5e6 {
            self.crashes -= 1;
            self.counts.faults += 1;
            self.leave(cause::SOFTWARE, Some(Record::processor(0x0800_4321, 1)));
        }
    }
}

/// What happens when: everything in the parts of the days that are computed, its effects go on between them.
fn plan(rng: &mut ChaCha8Rng, days: u64, events: &mut Vec<(u64, Event)>) {
    let mut moment = |day: u64| {
        let (part, within) = (rng.random_range(0..PARTS), rng.random_range(20_000_000..PART_US - 30_000_000));
        day * DAY_US + part * (DAY_US / PARTS) + within
    };
    // An interval in days, a first day, what happens then.
    let single: [(u64, u64, Event); 10] = [
        (3, 1, Event::Restart(cause::PIN, None)),
        (5, 2, Event::Restart(cause::WATCHDOG, None)),
        (6, 3, Event::Restart(cause::BROWN_OUT, None)),
        (7, 4, Event::Restart(cause::SOFTWARE, Some(FaultCode::HardFault))),
        (8, 5, Event::Restart(cause::SOFTWARE, Some(FaultCode::Panicked))),
        (2, 1, Event::PowerCut),
        (41, 9, Event::CrashLoop(6)),
        (4, 2, Event::ConverterReset),
        (3, 0, Event::Command(Command::Identify { token: 1 })),
        (61, 6, Event::Configure),
    ];
    for (every, first, event) in single {
        for day in (first..days).step_by(every as usize) {
            events.push((moment(day), event));
        }
    }
    // Those with an end: an interval, a first day, a length in days, begin and end.
    let lasting: [(u64, u64, f64, Event, Event); 6] = [
        (9, 3, 0.0002, Event::Converters(false), Event::Converters(true)),
        (33, 7, 0.25, Event::Converters(false), Event::Converters(true)),
        (29, 10, 15.0, Event::Line(false), Event::Line(true)),
        (37, 2, 18.0, Event::Receiver(false), Event::Receiver(true)),
        (5, 1, 0.13, Event::Receiver(false), Event::Receiver(true)),
        (47, 8, 0.5, Event::SupplyLow(true), Event::SupplyLow(false)),
    ];
    for (every, first, length, begin, end) in lasting {
        for day in (first..days).step_by(every as usize) {
            let at = moment(day);
            let until = at + (length * DAY_US as f64) as u64;
            // Everything is well in the last two days, so that nothing is under way at the end.
            let part = DAY_US / PARTS;
            let computed = if until % part > PART_US { until + part - until % part } else { until };
            events.push((at, begin));
            events.push((computed.min((days.max(3) - 2) * DAY_US), end));
        }
    }
    events.retain(|(at, _)| *at <= (days.max(3) - 2) * DAY_US);
}
