//! The reliable link over a line that fails: nothing lost, nothing twice, everything in order, and at what price.
//!
//! The 24 hours: 9600 baud, an array's records, 20 % of the frames dropped, one bit error in 1000 bytes, doubled and
//! overtaken frames in both directions; a minute without a line every half hour or so, the recorder reset (its store
//! survives) and the base station killed, before or after a frame was on its disk, as often.

use super::link_ends::{ARRAY, BaseStation, Recorder, Talk};
use super::link_line::{Faults, Line};
use super::report::CsvReport;
use super::{Experiment, Options};
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use seabearing_core::wire::guard::{Guard, Recipient, SIGNED_BYTES, sign};
use seabearing_core::wire::link::{
    Arrival, Class, Inbox, Link, MemoryStore, Progress, Session, Settings, Store,
};
use seabearing_core::wire::{Command, Decoder, Encoder, End, Message};
use std::collections::VecDeque;

/// `seabearing reproduce link`.
pub const EXPERIMENT: Experiment = Experiment {
    name: "link",
    about: "the reliable link on a line that fails: losses, order, catching up, goodput; commands by intruders",
    run,
};

/// Bytes of the store of a recorder with flash, and of one with memory only.
const FLASH: usize = 1 << 16;
/// With this store a link takes 8 KiB.
const MEMORY: usize = 6400;

/// All that is asked of a line.
const FAULTS: Faults = Faults { dropped: 0.2, damaged: 0.001, doubled: 0.02, held: 0.02 };

/// A budget far below what the array says.
const HOUR_BYTES: u32 = 30_000;

/// Seconds by which a record may be late without being behind.
const PROMPT_S: u64 = 15;

/// What happens in a run.
#[derive(Clone, Copy)]
struct Scenario {
    name: &'static str,
    settings: Settings,
    faults: Faults,
    hours: f64,
    /// Factor on the intervals of the array's talk.
    slower: u64,
    /// Mean seconds between outages, their length, resets and kills; 0: none.
    outage_every_s: f64,
    outage_s: u64,
    upset_every_s: f64,
    step_us: u64,
}

/// What came of it.
#[derive(Default)]
struct Outcome {
    written: usize,
    missing: usize,
    twice: u64,
    disordered: usize,
    told_lost: u32,
    truly_lost: usize,
    worst_catch_up_s: f64,
    outages: usize,
    resets: usize,
    kills: usize,
    share_of_line: f64,
    /// Most bytes the recorder sent in any hour.
    worst_hour: u64,
    /// Records lost of the classes before bearings.
    urgent_lost: u32,
}

/// Moments of a Poisson process.
struct Moments {
    mean_s: f64,
    next_us: u64,
}

impl Moments {
    fn new(mean_s: f64, rng: &mut ChaCha8Rng) -> Self {
        let mut moments = Self { mean_s, next_us: 0 };
        moments.go_on(0, rng);
        moments
    }

    fn go_on(&mut self, from_us: u64, rng: &mut ChaCha8Rng) {
        let wait_s = -(1.0 - rng.random::<f64>()).ln() * self.mean_s;
        self.next_us = if self.mean_s > 0.0 { from_us + (wait_s * 1e6) as u64 } else { u64::MAX };
    }

    fn due(&mut self, now: u64, rng: &mut ChaCha8Rng) -> bool {
        let due = now >= self.next_us;
        if due {
            self.go_on(now, rng);
        }
        due
    }
}

/// Runs a scenario, and then a while without outages, resets and kills, until everything has come.
fn play<const STORE: usize>(s: &Scenario, seed: u64) -> Outcome {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let rate = f64::from(s.settings.bytes_per_second);
    let mut up = Line::new(s.faults, rate, 20_000, seed ^ 1);
    let mut down = Line::new(s.faults, rate, 20_000, seed ^ 2);
    let mut recorder = Recorder::new(s.settings, MemoryStore::<STORE>::new(), &ARRAY, s.slower);
    let mut base = BaseStation::new(s.settings);
    let mut outages = Moments::new(s.outage_every_s, &mut rng);
    let mut resets = Moments::new(s.upset_every_s, &mut rng);
    let mut kills = Moments::new(s.upset_every_s, &mut rng);
    let (mut cut_until, mut off_until, mut dead_until) = (0u64, 0u64, 0u64);
    let mut behind_since: Option<u64> = None;
    // Records written by each second.
    let mut written_by: Vec<u32> = Vec::new();
    let mut kill = None;
    let mut outcome = Outcome::default();
    let mut hour: VecDeque<(u64, u64)> = VecDeque::new();
    let end = (s.hours * 3.6e9) as u64;
    let mut now = 0u64;
    // At the end all records must come, in four hours at most.
    while now < end || (now < end + 14_400_000_000 && recorder.link.as_ref().is_none_or(|l| l.waiting() > 0))
    {
        now += s.step_us;
        let going_on = now < end;
        if going_on && now >= cut_until && outages.due(now, &mut rng) {
            outcome.outages += 1;
            cut_until = now + s.outage_s * 1_000_000;
            // The next one finds the recorder caught up, or else it is not told from this one.
            outages.go_on(cut_until + 3 * s.outage_s * 1_000_000, &mut rng);
            up.cut();
            down.cut();
        }
        if going_on && recorder.link.is_some() && resets.due(now, &mut rng) {
            outcome.resets += 1;
            recorder.reset();
            off_until = now + rng.random_range(500_000..5_000_000);
        }
        if going_on && base.link.is_some() && kill.is_none() && kills.due(now, &mut rng) {
            kill = Some(rng.random_bool(0.5));
        }
        if recorder.link.is_none() && now >= off_until {
            recorder.start(now / 1000);
        }
        if base.link.is_none() && now >= dead_until {
            base.start();
        }
        if going_on {
            recorder.speak(now / 1000);
        }
        while let Some(frame) = up.take(now) {
            if base.link.is_some() && kill.is_some() {
                outcome.kills += 1;
                dead_until = now + rng.random_range(500_000..10_000_000);
            }
            base.take(now, &frame, kill.take());
        }
        while let Some(frame) = down.take(now) {
            if let Some(link) = &mut recorder.link {
                frame.iter().for_each(|b| link.receive(now, *b, &mut Nothing));
            }
        }
        let cut = now < cut_until;
        if let Some(frame) = recorder.link.as_mut().and_then(|l| l.send(now)) {
            up.put(now, frame, cut);
            hour.push_back((now, up.bytes));
            while hour.front().is_some_and(|(t, _)| now - t >= 3_600_000_000) {
                hour.pop_front();
            }
            let first = hour.front().map_or(0, |(_, bytes)| *bytes);
            outcome.worst_hour = outcome.worst_hour.max(up.bytes - first);
        }
        if let Some(frame) = base.link.as_mut().and_then(|l| l.send(now)) {
            down.put(now, frame, cut);
        }
        let second = (now / 1_000_000) as usize;
        if second >= written_by.len() {
            written_by.resize(second + 1, recorder.written.len() as u32);
            if cut_until > 0 && !cut && behind_since.is_none() {
                behind_since = Some(cut_until);
            }
            if let Some(since) = behind_since
                && base.disk.complete >= written_by[second.saturating_sub(PROMPT_S as usize)]
            {
                outcome.worst_catch_up_s = outcome.worst_catch_up_s.max((now - since) as f64 / 1e6);
                (behind_since, cut_until) = (None, 0);
            }
        }
    }
    if let Some(since) = behind_since {
        outcome.worst_catch_up_s = outcome.worst_catch_up_s.max((now - since) as f64 / 1e6);
    }
    outcome.share_of_line = up.bytes as f64 / (rate * now as f64 / 1e6);
    settle(&recorder, &base, &mut outcome);
    outcome
}

/// Compares what was written with what is on the base station's disk.
fn settle<S: Store>(recorder: &Recorder<S>, base: &BaseStation, outcome: &mut Outcome) {
    let disk = &base.disk;
    outcome.written = recorder.written.len();
    outcome.told_lost = disk.lost.iter().sum();
    outcome.urgent_lost = disk.lost[..Class::Bearing as usize].iter().sum();
    outcome.twice = disk.twice;
    outcome.truly_lost = outcome.written - disk.records.len().min(outcome.written);
    outcome.missing = outcome.truly_lost.abs_diff(outcome.told_lost as usize);
    // A record under its ordinal is the record written in that place, and in each class losses are where they were told.
    for (ordinal, record) in &disk.records {
        outcome.disordered += usize::from(recorder.written.get(*ordinal as usize) != Some(record));
    }
    let mut numbers = [0u32; 5];
    for (ordinal, (class, ..)) in (0u32..).zip(&recorder.written) {
        let number = numbers[*class as usize];
        numbers[*class as usize] += 1;
        let told = disk.losses.iter().any(|l| l.class == *class && (l.first..l.end).contains(&number));
        outcome.missing += usize::from(!disk.records.contains_key(&ordinal) && !told);
    }
}

/// A recorder's end that takes no commands.
struct Nothing;

impl Inbox for Nothing {
    fn recall(&mut self, _: &Session) -> Option<Progress> {
        None
    }

    fn take(&mut self, _: Arrival<'_>) {}
}

/// Share of a line's bytes that are records' bytes at the base, with a store that never gets empty, %.
fn goodput(settings: Settings, dropped: f64, seed: u64) -> f64 {
    const BEARING: Talk = Talk { class: Class::Bearing, every_ms: 0, bytes: 43 };
    const SECONDS: u64 = 1800;
    let rate = f64::from(settings.bytes_per_second);
    let faults = Faults { dropped, ..Faults::default() };
    let mut up = Line::new(faults, rate, 5000, seed ^ 1);
    let mut down = Line::new(faults, rate, 5000, seed ^ 2);
    let mut recorder = Recorder::new(settings, MemoryStore::<FLASH>::new(), &[], 1);
    let mut base = BaseStation::new(settings);
    for now in (0..SECONDS * 1000).map(|ms| ms * 1000) {
        while recorder.link.as_ref().is_some_and(|l| l.waiting() < 200) {
            recorder.say(BEARING);
        }
        while let Some(frame) = up.take(now) {
            base.take(now, &frame, None);
        }
        let Some(link) = &mut recorder.link else { continue };
        while let Some(frame) = down.take(now) {
            frame.iter().for_each(|b| link.receive(now, *b, &mut Nothing));
        }
        if let Some(frame) = link.send(now) {
            up.put(now, frame, false);
        }
        if let Some(frame) = base.link.as_mut().and_then(|l| l.send(now)) {
            down.put(now, frame, false);
        }
    }
    let bytes: usize = base.disk.records.values().map(|r| r.2.len()).sum();
    100.0 * bytes as f64 / (rate * SECONDS as f64)
}

/// Frames that a decoder of messages counts lost of five, one of which came twice, late or not at all.
fn counted_loss(order: &[usize]) -> u64 {
    let mut encoder = Encoder::default();
    let message = |n| Message::End(End { index: n, frames: 0 });
    let frames: Vec<Vec<u8>> = (0..5).map(|n| encoder.frame(&message(n)).to_vec()).collect();
    let mut decoder = Decoder::default();
    for byte in order.iter().flat_map(|n| &frames[*n]) {
        decoder.push::<Message>(*byte);
    }
    decoder.counters().lost
}

/// Commands forged, replayed or overtaken that a recorder carries out, of so many, while every hundredth is a good one.
fn intruded(commands: u64, seed: u64) -> (u64, u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let recipient = Recipient { station: 7, boot: 3 };
    let key: [u8; 32] = rng.random();
    let mut guard = Guard::keyed(key, recipient);
    let mut heard: Vec<Vec<u8>> = Vec::new();
    let (mut carried_out, mut refused) = (0, 0);
    for n in 0..commands {
        if n % 100 == 0 {
            // Two good ones, of which the second comes first: the first is overtaken.
            let token = n as u8;
            let [early, late] = [n + 1, n + 2].map(|counter| {
                let mut buffer = [0; SIGNED_BYTES];
                sign(
                    &key,
                    &recipient,
                    counter,
                    &Command::HealthEvery { token, seconds: n as u16 },
                    &mut buffer,
                )
                .to_vec()
            });
            refused += u64::from(guard.admit(&late).is_none());
            carried_out += u64::from(guard.admit(&early).is_some());
            heard.extend([early, late]);
        }
        let mut forged = heard[rng.random_range(0..heard.len())].clone();
        match n % 4 {
            0 => {}
            // Of another counter, of another command, and of a tag that is guessed.
            1 => forged[1..9].copy_from_slice(&(n + 1000).to_le_bytes()),
            2 => {
                forged[1..9].copy_from_slice(&(n + 1000).to_le_bytes());
                let last = forged.len() - 1;
                forged[last] ^= 1 << rng.random_range(0..8);
            }
            _ => {
                forged[1..9].copy_from_slice(&(n + 1000).to_le_bytes());
                rng.fill(&mut forged[9..25]);
            }
        }
        carried_out += u64::from(guard.admit(&forged).is_some());
    }
    (carried_out, refused)
}

fn run(options: &Options) -> Result<()> {
    let baud = Settings::serial;
    let half = |s: Settings| Settings { half_duplex: true, ..s };
    let hours = options.runs.unwrap_or(24) as f64;
    let day = Scenario {
        name: "day",
        settings: baud(9600),
        faults: FAULTS,
        hours,
        slower: 1,
        outage_every_s: 1800.0,
        outage_s: 60,
        upset_every_s: 1800.0,
        step_us: 5000,
    };
    let short = Scenario { hours: 3.0, ..day };
    let scenarios = [
        day,
        Scenario { name: "half duplex", settings: half(baud(9600)), slower: 2, ..short },
        Scenario { name: "300 baud", settings: baud(300), slower: 60, step_us: 50_000, hours: 24.0, ..day },
        Scenario {
            name: "300 baud, half duplex",
            settings: half(baud(300)),
            slower: 90,
            step_us: 50_000,
            hours: 24.0,
            ..day
        },
        Scenario { name: "921 600 baud", settings: baud(921_600), step_us: 1000, ..short },
        Scenario { name: "921 600 baud, half duplex", settings: half(baud(921_600)), step_us: 1000, ..short },
    ];
    let figures = &options.figures;
    let mut table = CsvReport::new(
        "link",
        "baud,half,written,missing,twice,disordered,outages,resets,kills,catch_up_s,line_pct",
    );
    for (n, scenario) in (0u64..).zip(&scenarios) {
        let o = play::<FLASH>(scenario, options.seed + n);
        let name = scenario.name;
        figures.at_most(format!("{name}: records missing"), o.missing as f64 + o.truly_lost as f64, 0.0);
        figures.at_most(format!("{name}: records twice"), o.twice as f64, 0.0);
        figures.at_most(format!("{name}: records out of order or changed"), o.disordered as f64, 0.0);
        if n == 0 {
            figures.at_most("day: longest until caught up after 60 s, s", o.worst_catch_up_s, 120.0);
        } else {
            figures.state(format!("{name}: longest until caught up after 60 s, s"), o.worst_catch_up_s);
        }
        table.row(&[
            f64::from(scenario.settings.bytes_per_second) * 10.0,
            f64::from(u8::from(scenario.settings.half_duplex)),
            o.written as f64,
            o.missing as f64,
            o.twice as f64,
            o.disordered as f64,
            o.outages as f64,
            o.resets as f64,
            o.kills as f64,
            o.worst_catch_up_s,
            100.0 * o.share_of_line,
        ]);
    }
    let full =
        Scenario { name: "", outage_every_s: 3600.0, outage_s: 600, upset_every_s: 0.0, hours: 6.0, ..day };
    let o = play::<MEMORY>(&full, options.seed);
    figures.state("8 KiB, outages of 600 s: records lost", o.truly_lost as f64);
    figures.at_most(
        "8 KiB, outages of 600 s: records lost but not told, or told but not lost",
        o.missing as f64,
        0.0,
    );
    figures.at_most(
        "8 KiB, outages of 600 s: twice, out of order or changed",
        o.twice as f64 + o.disordered as f64,
        0.0,
    );
    let thrifty = Settings { bytes_an_hour: Some(HOUR_BYTES), ..baud(9600) };
    let o = play::<MEMORY>(&Scenario { settings: thrifty, ..short }, options.seed);
    let name = format!("{HOUR_BYTES} bytes an hour");
    figures.at_most(format!("{name}: most in an hour"), o.worst_hour as f64, f64::from(HOUR_BYTES));
    figures.at_most(format!("{name}: faults, final tracks and health lost"), f64::from(o.urgent_lost), 0.0);
    figures.state(format!("{name}: other records lost, of {}", o.written), o.truly_lost as f64);
    let wrong = o.missing as f64 + o.twice as f64 + o.disordered as f64;
    figures.at_most(format!("{name}: lost but not told, twice, out of order"), wrong, 0.0);
    figures.at_most(
        "memory of a link on the target, bytes",
        size_of::<Link<MemoryStore<MEMORY>>>() as f64,
        8192.0,
    );
    for (line, settings) in [("", baud(9600)), (", half duplex", half(baud(9600)))] {
        figures.at_least(
            format!("goodput at 9600 baud{line}, %"),
            goodput(settings, 0.0, options.seed),
            85.0,
        );
        let lossy = goodput(settings, 0.05, options.seed);
        figures.at_least(format!("goodput at 9600 baud{line}, 5 % of the frames lost, %"), lossy, 60.0);
    }
    let (carried_out, refused) = intruded(1_000_000, options.seed);
    figures.at_most(
        "forged, replayed and overtaken commands carried out, of 1 000 000",
        carried_out as f64,
        0.0,
    );
    figures.at_most("good commands among them refused, of 10 000", refused as f64, 0.0);
    for (name, order, loss) in [
        ("doubled", [0, 1, 1, 2, 3], 0.0),
        ("overtaken", [0, 2, 1, 3, 4], 0.0),
        ("dropped", [0, 1, 3, 4, 4], 1.0),
    ] {
        let counted = counted_loss(&order) as f64;
        figures.report(
            format!("a {name} frame: counted loss"),
            counted,
            super::figure::Bar::Within(loss, loss),
        );
    }
    table.finish(options)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_hour_of_all_faults_loses_and_doubles_nothing() {
        for half_duplex in [false, true] {
            let scenario = Scenario {
                name: "",
                settings: Settings { half_duplex, ..Settings::serial(9600) },
                faults: FAULTS,
                hours: 1.0,
                slower: 2,
                outage_every_s: 300.0,
                outage_s: 60,
                upset_every_s: 120.0,
                step_us: 5000,
            };
            let o = play::<FLASH>(&scenario, 5);
            assert!(o.outages > 2 && o.resets > 10 && o.kills > 5 && o.written > 3000, "{}", o.written);
            assert_eq!((o.missing, o.truly_lost, o.twice, o.disordered), (0, 0, 0, 0));
        }
    }
}
