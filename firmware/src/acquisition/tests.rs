use super::*;
use crate::converter::{self, Bus, FRAME_BYTES, RING_BYTES, RING_FRAMES, Rate};
use std::vec::Vec;

/// Registers and output of a converter, a counter and a ring, as a board has them. Time goes on by `run`.
struct Bench {
    edges: u64,
    armed: Option<u64>,
    received: usize,
    ring: Vec<[u8; FRAME_BYTES]>,
    /// Results nobody has read: two at most.
    output: Vec<u64>,
    /// Conversions the source has had, whether they were done or not: the true number.
    instants: u64,
    now_us: u64,
    /// A conversion by the board's clock, and what it has added up to.
    period_ns: u64,
    ns: u64,
    alive: bool,
    awake: bool,
    was_reset: bool,
    resynchronised: bool,
    deaf: bool,
    loses_a_transfer: bool,
    answer: u16,
    registers: [u16; 64],
    noted: Stamp,
    offset: u64,
    /// Conversions that are wanting, as the converter's clock stands still.
    stops: u64,
    looks: u32,
    looks_at: Option<u64>,
}

const PERIOD_NS: u64 = 15_625;
/// A code is the number of its conversion, as far as it goes.
const CODES: u32 = 0x7f_ffff;

impl Bench {
    fn new() -> Self {
        Self {
            edges: 0,
            armed: None,
            received: 0,
            ring: std::vec![[0; FRAME_BYTES]; RING_FRAMES],
            output: Vec::new(),
            instants: 0,
            now_us: 0,
            period_ns: PERIOD_NS,
            ns: 0,
            alive: true,
            awake: false,
            was_reset: true,
            resynchronised: false,
            deaf: false,
            loses_a_transfer: false,
            answer: 0,
            registers: [0; 64],
            noted: Stamp::default(),
            offset: 0,
            stops: 0,
            looks: 0,
            looks_at: None,
        }
    }

    /// A transfer as the hardware does it: the older of the results that wait.
    fn transfer(&mut self) {
        let new = !self.output.is_empty();
        let number = if new { self.output.remove(0) } else { 0 };
        let mut bytes = [0; FRAME_BYTES];
        let begun =
            u16::from(self.was_reset) << 10 | u16::from(std::mem::take(&mut self.resynchronised)) << 14;
        let status: u16 = 0x0100 | begun | if new { 0xf } else { 0 };
        bytes[..2].copy_from_slice(&status.to_be_bytes());
        for word in bytes[3..15].chunks_mut(3) {
            word.copy_from_slice(&(number as u32 & CODES).to_be_bytes()[1..]);
        }
        let crc = converter::crc16(&bytes[..15]);
        bytes[15..17].copy_from_slice(&crc.to_be_bytes());
        bytes[1] ^= u8::from(self.deaf);
        self.ring[self.received / FRAME_BYTES % RING_FRAMES] = bytes;
        self.received = (self.received + FRAME_BYTES) % RING_BYTES;
    }

    /// Something else than the converter makes an edge; with a transfer of its own, or while one is under way, which that cuts short.
    fn false_edge(&mut self, cuts: bool) {
        self.edges += 1;
        if self.armed.is_some() {
            if cuts {
                self.received = (self.received + RING_BYTES - FRAME_BYTES / 2) % RING_BYTES;
            } else {
                self.transfer();
            }
        }
    }

    /// So many periods go by.
    fn run(&mut self, periods: u64) {
        for _ in 0..periods {
            self.now_us = (self.ns + self.offset * self.period_ns) / 1000;
            self.ns += self.period_ns;
            self.instants += 1;
            if self.stops > 0 {
                self.stops -= 1;
                continue;
            }
            // Half the rate where the clock register says so.
            let slow = self.registers[3] & 0x20 == 0 && self.instants.is_multiple_of(2);
            if !(self.alive && self.awake) || slow {
                continue;
            }
            self.edges += 1;
            if self.edges.is_multiple_of(256) {
                self.noted = Stamp { edges: self.edges, at_us: self.now_us };
            }
            if self.output.len() == 2 {
                self.output.remove(0);
            }
            self.output.push(self.instants - 1);
            if self.armed.is_some() && !std::mem::take(&mut self.loses_a_transfer) {
                self.transfer();
            }
        }
    }
}

impl Bus for Bench {
    fn exchange(&mut self, frame: &mut [u8; FRAME_BYTES]) {
        let command = u16::from_be_bytes([frame[0], frame[1]]);
        let argument = u16::from_be_bytes([frame[3], frame[4]]);
        frame[..2].copy_from_slice(&if self.alive { self.answer } else { 0xffff }.to_be_bytes());
        let register = usize::from(command >> 7 & 63);
        match command {
            0x11 => {
                (self.answer, self.awake, self.was_reset) = (0xff24, false, true);
                self.output.clear();
            }
            0x33 => (self.awake, self.was_reset) = (true, false),
            _ if command & 0xe000 == 0x6000 => self.registers[register] = argument,
            _ if command & 0xe000 == 0xa000 => self.answer = self.registers[register],
            _ => {}
        }
    }

    fn wait_us(&mut self, _: u32) {}
}

impl Board for Bench {
    const RING_FRAMES: usize = RING_FRAMES;
    const FRAME_BYTES: usize = FRAME_BYTES;
    const LEAST_TIMED: u64 = 200;
    fn hz(&self) -> u32 {
        Rate::Hz64000.hz()
    }
    fn begins_us(&self) -> u64 {
        0
    }
    fn set_up(&mut self) -> bool {
        let set = converter::set_up(self, Rate::Hz64000, 0).is_ok();
        converter::wake_up(self);
        set
    }
    fn look_every_us(&self) -> Option<u64> {
        self.looks_at
    }
    fn is_as_set(&mut self) -> bool {
        self.looks += 1;
        self.registers[4] == 0
    }
    fn edges(&mut self) -> u64 {
        self.edges
    }
    fn stamp(&mut self) -> Stamp {
        self.noted
    }
    fn now_us(&mut self) -> u64 {
        self.now_us
    }
    fn arm(&mut self, behind: bool) -> Option<u64> {
        self.received = 0;
        if behind {
            self.run(2);
            if self.output.len() < 2 {
                return None;
            }
            self.transfer();
            self.transfer();
        }
        self.armed = Some(self.edges);
        Some(self.edges - 2 * u64::from(behind))
    }
    fn disarm(&mut self) {
        self.armed = None;
    }
    fn received(&mut self) -> usize {
        self.received
    }
    fn frame(&mut self, slot: usize) -> Read {
        converter::parse(&self.ring[slot])
    }
}

/// Everything that can be taken now: index and first code of each frame; `None` where it is missing.
fn drain(acquisition: &mut Acquisition<Bench>) -> Vec<(u64, Option<i32>)> {
    let mut frames = [[0; CHANNELS]; 64];
    let mut taken = Vec::new();
    let mut idle = 0;
    while idle < 3 {
        match acquisition.read(&mut frames) {
            Chunk::Frames { first_index, count } => {
                let code = |f: &Frame| (f[0] != MISSING).then_some(f[0]);
                taken.extend((first_index..).zip(frames[..count].iter().map(code)));
            }
            _ => idle += 1,
        }
    }
    taken
}

/// How far the numbers are from those that the frames carry.
fn error(taken: &[(u64, Option<i32>)]) -> u32 {
    let off =
        |(index, code): &(u64, Option<i32>)| code.map(|code| (*index as u32 & CODES).abs_diff(code as u32));
    taken.iter().filter_map(off).max().unwrap_or(0)
}

fn started() -> Acquisition<Bench> {
    let mut acquisition = Acquisition::new(Bench::new());
    assert!(drain(&mut acquisition).is_empty());
    acquisition.board.run(10_000);
    acquisition
}

#[test]
fn frames_have_the_numbers_of_their_conversions_through_outages_of_any_length() {
    let mut acquisition = started();
    let mut all = drain(&mut acquisition);
    // Nobody comes for longer than the ring lasts, for longer than 16 bits count, and for a minute.
    for outage in [64, 4000, 4096, 70_000, 65_536, 3_840_000] {
        acquisition.board.run(outage);
        let taken = drain(&mut acquisition);
        assert!(taken.len() as u64 > outage.min(2000) - 64, "{outage}: {}", taken.len());
        all.extend(taken);
    }
    assert_eq!(error(&all), 0);
    assert!(all.windows(2).all(|w| w[0].0 < w[1].0));
    assert_eq!(acquisition.fault(), None);
}

#[test]
fn a_lost_transfer_leaves_a_gap_and_reading_is_in_step_again_with_the_two_that_wait() {
    let mut acquisition = started();
    drain(&mut acquisition);
    acquisition.board.loses_a_transfer = true;
    acquisition.board.run(500);
    let lost = drain(&mut acquisition);
    acquisition.board.run(500);
    let after = drain(&mut acquisition);
    assert!(lost.is_empty(), "what cannot be numbered is not given");
    assert_eq!((error(&after), after.len()), (0, 448));
}

#[test]
fn a_line_that_is_cut_gives_missing_samples_with_the_right_numbers() {
    let mut acquisition = started();
    let mut all = drain(&mut acquisition);
    acquisition.board.deaf = true;
    for _ in 0..100 {
        acquisition.board.run(1000);
        all.extend(drain(&mut acquisition));
    }
    acquisition.board.deaf = false;
    for _ in 0..10 {
        acquisition.board.run(1000);
        all.extend(drain(&mut acquisition));
    }
    assert_eq!(error(&all), 0);
    let missing = all.iter().filter(|(_, code)| code.is_none()).count();
    assert!(missing > 99_000 && missing <= 100_000, "{missing}");
    assert!(all.len() > 111_900, "{}", all.len());
}

/// Runs as a main loop does, every millisecond.
fn loop_for(acquisition: &mut Acquisition<Bench>, instants: u64) -> Vec<(u64, Option<i32>)> {
    let mut taken = Vec::new();
    for _ in 0..instants / 64 {
        acquisition.board.run(64);
        taken.extend(drain(acquisition));
    }
    taken
}

#[test]
fn a_converter_that_reset_itself_is_set_up_again_and_the_time_it_took_is_told() {
    let mut acquisition = started();
    let mut all = loop_for(&mut acquisition, 100_000);
    acquisition.board.was_reset = true;
    acquisition.board.registers = [0; 64];
    all.extend(loop_for(&mut acquisition, 100_000));
    let fault = acquisition.fault();
    assert!(matches!(fault, Some((FaultCode::ConverterRestarted, 1..4096))), "{fault:?}");
    assert_eq!(acquisition.board.registers[3], 0x0f22);
    assert!(error(&all) <= 1);
}

#[test]
fn a_converter_whose_rate_changes_unasked_is_set_up_again() {
    let mut acquisition = started();
    let before = loop_for(&mut acquisition, 100_000);
    assert_eq!((error(&before), acquisition.fault()), (0, None));
    acquisition.board.registers[3] ^= 0x20;
    let wrong = loop_for(&mut acquisition, 2048);
    let fault = acquisition.fault();
    assert!(matches!(fault, Some((FaultCode::ConverterRestarted, 1..2048))), "{fault:?}");
    assert_eq!(acquisition.board.registers[3], 0x0f22);
    // Two wake-ups' worth of frames had been given before it was noticed.
    let late = wrong.iter().filter(|(index, code)| code.is_some_and(|c| c as u64 != *index)).count();
    assert!(late <= 512, "{late}");
    let after = loop_for(&mut acquisition, 10_000);
    assert!(after.len() > 9000 && error(&after) <= 1, "{} off by {}", after.len(), error(&after));
}

#[test]
fn a_converter_that_was_dead_for_a_minute_goes_on_at_its_own_time_within_an_instant() {
    let mut acquisition = started();
    loop_for(&mut acquisition, 1_000_000);
    acquisition.board.alive = false;
    let dead = loop_for(&mut acquisition, 3_840_000);
    assert!(dead.len() < 64, "{}", dead.len());
    acquisition.board.alive = true;
    let after = loop_for(&mut acquisition, 100_000);
    assert!(after.len() > 90_000 && error(&after) <= 1, "{} off by {}", after.len(), error(&after));
    assert!(matches!(acquisition.fault(), Some((FaultCode::ConverterRestarted, 3_830_000..3_860_000))));
}

#[test]
fn a_converter_that_stands_still_before_its_rate_was_measured_is_numbered_by_its_rate_afterwards() {
    // Converter and board's clock are 2 % apart. From no moment noted yet to one short of what is measured.
    for lived in [27, 200, 300, 700, 2000, 4000] {
        let mut acquisition = Acquisition::new(Bench { period_ns: PERIOD_NS * 98 / 100, ..Bench::new() });
        drain(&mut acquisition);
        loop_for(&mut acquisition, lived / 64 * 64);
        acquisition.board.run(lived % 64);
        acquisition.board.alive = false;
        // The loop sleeps until something wakes it.
        acquisition.board.run(1000);
        loop_for(&mut acquisition, 3_840_000);
        acquisition.board.alive = true;
        let after = loop_for(&mut acquisition, 100_000);
        // A part in ten thousand of the gap is what is stated, one standard deviation.
        let off = error(&after);
        assert!(after.len() > 90_000 && off <= 2 * 384, "{lived}: {} off by {off}", after.len());
        // The next is measured by more.
        acquisition.board.alive = false;
        loop_for(&mut acquisition, 64_000);
        acquisition.board.alive = true;
        let more = error(&loop_for(&mut acquisition, 10_000)).abs_diff(off);
        assert!(more <= 2, "{lived}: {more} more");
    }
}

#[test]
fn a_short_standstill_soon_after_the_first_sample_is_in_the_numbers() {
    for (lived, dead) in
        [27, 200, 300, 500, 700, 2000].into_iter().flat_map(|l| [200, 320, 1280, 3000].map(|d| (l, d)))
    {
        let mut acquisition = Acquisition::new(Bench::new());
        drain(&mut acquisition);
        loop_for(&mut acquisition, lived / 64 * 64);
        acquisition.board.run(lived % 64);
        acquisition.board.alive = false;
        acquisition.board.run(dead);
        (acquisition.board.alive, acquisition.board.was_reset) = (true, true);
        let after = loop_for(&mut acquisition, 100_000);
        let off = error(&after);
        assert!(after.len() > 90_000 && off <= 8, "{lived}, {dead}: {} off by {off}", after.len());
    }
}

#[test]
fn what_comes_between_two_standstills_and_is_too_short_to_be_numbered_is_not_given() {
    let mut acquisition = started();
    loop_for(&mut acquisition, 1_000_000);
    for lived in [64, 128] {
        acquisition.board.alive = false;
        loop_for(&mut acquisition, 64_000);
        acquisition.board.alive = true;
        while acquisition.board.armed.is_none() {
            loop_for(&mut acquisition, 64);
        }
        // No moment is noted in it.
        acquisition.board.edges = acquisition.board.edges.next_multiple_of(256);
        acquisition.resume(acquisition.board.now_us);
        let between = loop_for(&mut acquisition, lived);
        acquisition.board.alive = false;
        let late = loop_for(&mut acquisition, 64_000);
        assert_eq!((between, late), (Vec::new(), Vec::new()), "{lived}");
    }
    acquisition.board.alive = true;
    let after = loop_for(&mut acquisition, 100_000);
    assert!(after.len() > 90_000 && error(&after) <= 1, "{} off by {}", after.len(), error(&after));
}

#[test]
fn a_converter_that_stood_still_while_nobody_came_is_noticed() {
    for (before, still, after) in [(60_000, 6400, 60_000), (1000, 100, 1000), (100_000, 300, 20_000)] {
        let mut acquisition = Acquisition::new(Bench { period_ns: PERIOD_NS * 98 / 100, ..Bench::new() });
        drain(&mut acquisition);
        let mut all = loop_for(&mut acquisition, 1_000_000);
        assert_eq!((error(&all), acquisition.fault()), (0, None));
        acquisition.board.run(before);
        acquisition.board.alive = false;
        acquisition.board.run(still);
        acquisition.board.alive = true;
        acquisition.board.run(after);
        all = loop_for(&mut acquisition, 100_000);
        assert!(matches!(acquisition.fault(), Some((FaultCode::ConverterRestarted, _))), "{still}");
        assert!(all.len() > 90_000 && error(&all) <= 16, "{still}: {} off by {}", all.len(), error(&all));
    }
}

#[test]
fn the_converters_rate_is_measured_whatever_the_phase_of_loop_and_stamps() {
    // The board's clock is 1 % slow; every new stamp (of each 256th edge) is first seen at a turn that finds too few frames.
    let mut acquisition = Acquisition::new(Bench { period_ns: PERIOD_NS * 99 / 100, ..Bench::new() });
    drain(&mut acquisition);
    acquisition.board.run(100);
    let taken = |chunk| matches!(chunk, Chunk::Frames { .. });
    assert!(taken(acquisition.read(&mut [[0; CHANNELS]; 100])));
    for _ in 0..1000 {
        acquisition.board.run(158);
        assert!(!taken(acquisition.read(&mut [[0; CHANNELS]; 256])));
        acquisition.board.run(98);
        assert!(taken(acquisition.read(&mut [[0; CHANNELS]; 256])));
    }
    acquisition.board.alive = false;
    loop_for(&mut acquisition, 640_000);
    acquisition.board.alive = true;
    let after = loop_for(&mut acquisition, 100_000);
    assert!(after.len() > 90_000 && error(&after) <= 1, "{} off by {}", after.len(), error(&after));
}

#[test]
fn nobody_knows_the_moment_of_the_next_sample_while_the_converter_stands_still() {
    let mut acquisition = Acquisition::new(Bench::new());
    assert_eq!(acquisition.age_us(0), None, "it is not set up yet");
    drain(&mut acquisition);
    let all = loop_for(&mut acquisition, 10_000);
    let next = all.last().unwrap().0 + 1;
    assert!(acquisition.age_us(next).is_some_and(|us| us <= 1000));
    acquisition.board.alive = false;
    loop_for(&mut acquisition, 64_000);
    assert_eq!(acquisition.age_us(next), None);
    acquisition.board.alive = true;
    let all = loop_for(&mut acquisition, 10_000);
    assert!(acquisition.age_us(all.last().unwrap().0 + 1).is_some());
}

#[test]
fn what_came_since_the_settings_were_right_is_not_given_where_they_are_not_any_more() {
    let mut acquisition = started();
    acquisition.board.looks_at = Some(20_000);
    let mut all = loop_for(&mut acquisition, 192_000);
    assert!((100..=150).contains(&acquisition.board.looks), "{}", acquisition.board.looks);
    acquisition.board.registers[4] = 0x0100;
    let changed = acquisition.board.instants;
    all.extend(loop_for(&mut acquisition, 192_000));
    assert_eq!(acquisition.board.registers[4], 0);
    let Some((FaultCode::ConverterRestarted, lost)) = acquisition.fault() else {
        panic!("no restart was told")
    };
    assert!(error(&all) <= 1 && all.windows(2).all(|w| w[0].0 < w[1].0));
    // Nothing is given from the look before the change to the one after it.
    let gap = all.windows(2).find(|w| w[1].0 - w[0].0 > 1).map(|w| (w[0].0 + 1, w[1].0)).unwrap();
    assert!(gap.0 <= changed && changed < gap.1 && gap.1 - gap.0 == lost, "{gap:?} {changed} {lost}");
}

#[test]
fn an_edge_that_is_none_of_the_converters_is_not_numbered_and_is_told() {
    let mut acquisition = Acquisition::new(Bench { period_ns: PERIOD_NS * 99 / 100, ..Bench::new() });
    drain(&mut acquisition);
    let mut all = loop_for(&mut acquisition, 300_000);
    for n in 1..=300 {
        acquisition.board.run(n % 64);
        acquisition.board.false_edge(false);
        all.extend(loop_for(&mut acquisition, 1000));
        assert_eq!(acquisition.fault(), Some((FaultCode::FalseEdge, n)));
    }
    assert_eq!(error(&all), 0);
    assert!(all.windows(2).all(|w| w[0].0 + 1 == w[1].0), "nothing is missing");
}

#[test]
fn an_edge_that_cuts_a_transfer_short_is_told_and_put_right() {
    let mut acquisition = started();
    loop_for(&mut acquisition, 300_000);
    acquisition.board.false_edge(true);
    let off = loop_for(&mut acquisition, 2560);
    assert!(error(&off) <= 1);
    assert!(matches!(acquisition.fault(), Some((FaultCode::ConverterRestarted, 1..1000))));
    let after = loop_for(&mut acquisition, 100_000);
    assert_eq!((error(&after), acquisition.fault()), (0, None));
}

#[test]
fn conversions_that_are_wanting_without_a_reset_are_told_and_put_right_however_few() {
    for stops in [1, 2, 3, 4, 8, 16, 100] {
        let mut acquisition = Acquisition::new(Bench { period_ns: PERIOD_NS * 101 / 100, ..Bench::new() });
        drain(&mut acquisition);
        loop_for(&mut acquisition, 300_000);
        acquisition.board.stops = stops;
        // Two windows of four wake-ups, and one until a moment's frames were taken.
        let off = loop_for(&mut acquisition, 2560);
        assert!(u64::from(error(&off)) <= stops, "{stops}");
        let fault = acquisition.fault();
        assert!(matches!(fault, Some((FaultCode::ConverterRestarted, 1..4000))), "{stops}: {fault:?}");
        let after = loop_for(&mut acquisition, 100_000);
        assert_eq!((error(&after), acquisition.fault()), (0, None), "{stops}");
    }
}

#[test]
fn a_converter_that_began_to_convert_afresh_is_set_up_again() {
    let mut acquisition = started();
    loop_for(&mut acquisition, 300_000);
    acquisition.board.stops = 3;
    acquisition.board.resynchronised = true;
    let given = loop_for(&mut acquisition, 640);
    assert_eq!(error(&given), 0, "no frame of it is given");
    assert!(matches!(acquisition.fault(), Some((FaultCode::ConverterRestarted, 1..400))));
}

#[test]
fn a_converter_that_begins_again_before_its_first_sample_was_given_is_told() {
    let mut acquisition = Acquisition::new(Bench { looks_at: Some(20_000), ..Bench::new() });
    assert!(drain(&mut acquisition).is_empty());
    assert!(loop_for(&mut acquisition, 640).is_empty(), "held back until it was looked at");
    assert_eq!(acquisition.fault(), None);
    acquisition.board.registers[4] = 0x0100;
    assert!(loop_for(&mut acquisition, 1280).is_empty());
    assert_eq!(acquisition.fault(), Some((FaultCode::ConverterRestarted, 0)));
    let all = loop_for(&mut acquisition, 6400);
    assert!(all.first().is_some_and(|first| first.0 == 0) && acquisition.fault().is_none());
}

#[test]
fn a_clock_that_is_another_after_an_outage_is_no_fault_of_the_converter() {
    // Nanoseconds of a conversion: 64 millionths each.
    for off in [-64i64, -32, -8, 8, 32, 64] {
        let mut acquisition = started();
        loop_for(&mut acquisition, 300_000);
        acquisition.board.alive = false;
        loop_for(&mut acquisition, 64_000);
        acquisition.board.period_ns = PERIOD_NS.saturating_add_signed(off);
        (acquisition.board.alive, acquisition.board.registers) = (true, [0; 64]);
        let faults = |acquisition: &mut Acquisition<Bench>, instants: u64| {
            let mut told = 0;
            for _ in 0..instants / 640 {
                loop_for(acquisition, 640);
                told += usize::from(matches!(acquisition.fault(), Some((FaultCode::ConverterRestarted, _))));
            }
            told
        };
        assert_eq!(faults(&mut acquisition, 300_000), 1, "{off}");
    }
}

#[test]
fn a_clock_that_drifts_by_a_thousandth_a_minute_is_no_fault_of_the_converter() {
    let mut acquisition = started();
    loop_for(&mut acquisition, 300_000);
    // A nanosecond, 64 millionths, each 4 s, for three minutes, and then steady.
    for second in 0..240 {
        let gone = loop_for(&mut acquisition, 64_000);
        assert_eq!((error(&gone), acquisition.fault()), (0, None), "{second}");
        acquisition.board.period_ns += u64::from(second % 4 == 0 && second < 180);
    }
    // What the converter's clock misses is noticed as before.
    acquisition.board.stops = 2;
    loop_for(&mut acquisition, 2560);
    assert!(matches!(acquisition.fault(), Some((FaultCode::ConverterRestarted, 1..4000))));
}
