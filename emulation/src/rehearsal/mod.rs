//! The hardware image rehearsed: every way of going wrong that the modelled board can play, and what came of it.

mod at_once;
mod card;
mod cases;
mod full_store;
mod judge;
mod ocean_bottom;
mod ocean_bottom_reach;

use crate::board::{self, BoardRun, InjectedFault, Setup, mix};
use anyhow::{Context, Result, bail};
use cases::Case;
pub use ocean_bottom::OceanBottom;
use seabearing_board_model::Costs;
use seabearing_board_model::ads131m04::Codes;
use seabearing_board_model::stm32h743::Parameters;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc;

/// One thing rehearsed.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// What was done to the board.
    pub case: String,
    /// What it told of that, each with the seconds it took (rounded up to tenths).
    pub told: String,
    /// What else came of it: how records and numbers stand to the truth.
    pub outcome: String,
    /// Whether that is what must be.
    pub right: bool,
}

impl std::fmt::Display for Row {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let verdict = if self.right { "ok" } else { "MISSED" };
        let text = format!("{verdict:<6} {:<58} {:<42} {}", self.case, self.told, self.outcome);
        f.write_str(text.trim_end())
    }
}

/// Cycles an instruction and more for a register access, at which the board must keep up.
pub const COST: (f64, f64) = (2.5, 30.0);
/// Interrupts a second allowed.
const MOST_INTERRUPTS: f64 = 500.0;
/// Share of the time asleep that must be left.
const LEAST_IDLE: f64 = 0.6;
/// Cycles an instruction at which the board must still keep up.
pub const LEAST_BREAKING: f64 = 4.0;
/// Costs tried one after the other to see where it breaks.
pub const COSTS: [f64; 8] = [LEAST_BREAKING, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 20.0];
/// Within so many seconds what went wrong must be named.
const NAMED_S: f64 = 10.0;
/// When something goes wrong, s.
const AT_S: f64 = 0.5;
/// The same where a session is cut off by it that must have said something before, s.
const LATER_S: f64 = 1.2;
/// Longer than a case's sound, where the converter gives none; of the ocean-bottom board.
const PATIENCE_S: [f64; 2] = [0.5, 2.5];

/// What is rehearsed with: the image, the configuration it holds, its rate.
pub struct Stage<'a> {
    /// The image.
    pub image: &'a Path,
    /// The image whose records wait in flash.
    pub link_image: &'a Path,
    /// The configuration in it.
    pub blob: &'a [u8],
    /// Samples a second.
    pub rate_hz: f64,
}

/// How much is rehearsed.
#[derive(Debug, Clone)]
pub struct Length {
    /// Seconds over which lost conversions are counted.
    pub pace_s: f64,
    /// Cycles an instruction that are tried until one is too many.
    pub costs: Vec<f64>,
    /// Lengths of outages, s.
    pub outages_s: Vec<f64>,
    /// Of the works of the flash in a short run, how many power is cut at; all where that is `None`.
    pub cuts: Option<u32>,
}

/// So many works of the flash at which power is cut, in their order: one of each stretch of them, as a fixed seed has it.
fn cuts(count: Option<u32>) -> Vec<u32> {
    let all = cases::SHORT_RUN;
    let count = count.unwrap_or(all).clamp(1, all);
    let one = |n: u32| {
        let (from, to) = (n * all / count, (n + 1) * all / count);
        from + (mix(u64::from(n)) % u64::from(to - from)) as u32
    };
    (0..count).map(one).collect()
}

/// By how many instants each hydrophone hears a wave before the last of them: from azimuth 149°, elevation 31°, at 1484 m/s
/// and 64 kHz, for the array of `scenarios/demo-station.toml`, to 0.03 instants.
const EARLIER: [u64; 4] = [0, 68, 33, 67];

/// Noise from that direction, for so many instants, with a sixteenth of each channel's own.
fn noise(instants: u64) -> impl FnMut() -> Option<Codes> + Send + 'static {
    let code = |n: u64| (mix(n) >> 46) as i32 - (1 << 17);
    let mut n = 0;
    move || {
        n += 1;
        let own = |channel: u64| code(!(4 * n + channel)) / 16;
        let heard = |channel: usize| code(n + EARLIER[channel]) + own(channel as u64);
        (n <= instants).then(|| core::array::from_fn(heard))
    }
}

fn costs(cycles: f64) -> Costs {
    Costs { instruction: cycles, register: COST.1, ..Costs::IDEAL }
}

impl Stage<'_> {
    fn play(&self, seconds: f64, setup: &Setup) -> Result<BoardRun> {
        let instants = (seconds * self.rate_hz).round() as u64;
        let image = if setup.link { self.link_image } else { self.image };
        match setup.parameters.seismic {
            true => board::play(image, self.blob, self.rate_hz, setup, ocean_bottom::noise(instants)),
            false => board::play(image, self.blob, self.rate_hz, setup, noise(instants)),
        }
    }

    /// Keeps up at the cost that is asked for, and sleeps this share of the time at least.
    fn pace(&self, seconds: f64, parameters: Parameters, least_idle: f64) -> Result<Vec<Row>> {
        let setup = Setup { costs: costs(COST.0), parameters, link: parameters.seismic, ..Setup::default() };
        let report = self.play(seconds, &setup)?;
        let (cycles, register) = COST;
        let row = |what: &str, outcome, right| {
            let case = format!("{what}, {cycles} cycles an instruction, {register} an access");
            Row { case, told: String::new(), outcome, right }
        };
        let difference = report.difference(self.blob)?;
        let identical = difference.is_none();
        let words = if report.linked { "the same records, each once" } else { "the same bytes" };
        let same = difference.unwrap_or(words.to_owned());
        let kept = report.lost == 0 && report.delivered == report.converted;
        let idle = report.idle * 100.0;
        Ok(vec![
            row("lost", format!("{} of {} in {seconds} s", report.lost, report.converted), kept),
            row("telemetry against the host's", same, identical),
            row(
                "interrupts a second",
                format!("{:.0}", report.interrupts_per_s),
                report.interrupts_per_s <= MOST_INTERRUPTS,
            ),
            row("asleep", format!("{idle:.0} %"), report.idle >= least_idle),
        ])
    }

    /// The store's first start with erasures as slow as the data sheet allows: nothing is lost meanwhile.
    fn erasing(&self) -> Result<Vec<Row>> {
        const SECONDS: f64 = 4.6;
        let report = self.play(SECONDS, &Setup { costs: costs(COST.0), link: true, ..Setup::default() })?;
        let difference = report.difference(self.blob)?;
        let sectors = report.flash.1;
        let right = report.lost == 0
            && report.delivered == report.converted
            && sectors == 2
            && report.idle >= LEAST_IDLE
            && difference.is_none();
        let same = difference.unwrap_or("the host's records".to_owned());
        let (lost, converted, idle) = (report.lost, report.converted, report.idle * 100.0);
        let outcome = format!("{lost} of {converted} lost; asleep {idle:.0} %; {same}, each once");
        let case = "store: first start, two sectors erased, 2 s each".to_owned();
        Ok(vec![Row { case, told: String::new(), outcome, right }])
    }

    /// The cost at which it breaks.
    fn breaking(&self, tried: &[f64]) -> Result<Vec<Row>> {
        let (mut holds, mut breaks) = (0.0, None);
        for &cycles in tried {
            let report = self.play(1.0, &Setup { costs: costs(cycles), ..Setup::default() })?;
            if report.lost > 0 || report.difference(self.blob)?.is_some() {
                breaks = Some(cycles);
                break;
            }
            holds = cycles;
        }
        let outcome = match breaks {
            Some(cycles) => format!("holds at {holds}, not at {cycles}"),
            None => format!("holds at {holds}"),
        };
        let case = "cycles an instruction at which it breaks".to_owned();
        Ok(vec![Row { case, told: String::new(), outcome, right: holds >= LEAST_BREAKING }])
    }

    /// Plays a case and judges what came of it.
    fn judge(&self, case: &Case) -> Result<Row> {
        Ok(self.judge_with(case)?.0)
    }

    /// The same, and the run.
    fn judge_with(&self, case: &Case) -> Result<(Row, BoardRun, i64)> {
        let patience_s = PATIENCE_S[usize::from(case.setup.parameters.seismic)];
        let most_s = Some(case.seconds.max(case.event_s) + patience_s);
        let report = self
            .play(case.seconds, &Setup { most_s, ..case.setup.clone() })
            .with_context(|| case.name.clone())?;
        let told = judge::told(&report.said, &case.wanted, case.event_s);
        let known = judge::Known::of(&case.setup.faults);
        let mut numbers = judge::numbers(&report, self.blob, case.sent.as_deref(), known)?;
        if case.setup.link {
            let uncut = |f: &InjectedFault| matches!(f, InjectedFault::FlashCut(_)) && report.resets == 0;
            if case.setup.faults.iter().any(uncut) {
                bail!("{}: the run has fewer works of the flash", case.name);
            }
            numbers.right &= report.missing == 0;
            let records = if report.missing == 0 { "each record once" } else { "RECORDS MISSING" };
            let both = [numbers.outcome.as_str(), records];
            numbers.outcome =
                both.into_iter().filter(|words| !words.is_empty()).collect::<Vec<_>>().join("; ");
        }
        if let Some(clock) = judge::clock(&report, &case.setup.faults, self.rate_hz) {
            let both = [numbers.outcome, clock.outcome];
            numbers.outcome =
                both.iter().filter(|words| !words.is_empty()).cloned().collect::<Vec<_>>().join("; ");
            numbers.right &= clock.right;
        }
        let named = told.iter().all(|(_, after_s)| after_s.is_some_and(|s| s <= NAMED_S));
        let tenths = |s: f64| format!("{:.1} s", (s * 10.0).ceil() / 10.0);
        let words: Vec<String> = told
            .iter()
            .map(|(name, after_s)| format!("{name} {}", after_s.map_or("NEVER".to_owned(), tenths)))
            .collect();
        let row = Row {
            case: case.name.clone(),
            told: words.join(", "),
            outcome: numbers.outcome,
            right: named && numbers.right,
        };
        Ok((row, report, numbers.off))
    }

    /// Everything, as many cases at a time as there are processors; rows are said in their order.
    ///
    /// # Errors
    /// The image is not there or not the station's, or the board did what no board allows.
    pub fn rehearse(&self, length: &Length, say: impl FnMut(&Row)) -> Result<Vec<Row>> {
        let mut cases = cases::all(&length.outages_s);
        cases.extend(cases::with_store(&cuts(length.cuts)));
        let play = |n: usize| match n {
            0 => self.pace(length.pace_s, Parameters::default(), LEAST_IDLE),
            1 => self.breaking(&length.costs),
            2 => self.erasing(),
            3 => self.full_store(),
            n => self.judge(&cases[n - 4]).map(|row| vec![row]),
        };
        all(cases.len() + 4, play, say)
    }
}

/// Plays so many things, as many at a time as there are processors; their rows in order.
fn all(
    count: usize,
    play: impl Fn(usize) -> Result<Vec<Row>> + Sync,
    mut say: impl FnMut(&Row),
) -> Result<Vec<Row>> {
    let next = AtomicUsize::new(0);
    let workers = std::thread::available_parallelism().map_or(1, |n| n.get());
    let (send, receive) = mpsc::channel();
    std::thread::scope(|scope| {
        for _ in 0..workers {
            let (send, next, play) = (send.clone(), &next, &play);
            scope.spawn(move || {
                loop {
                    let n = next.fetch_add(1, Ordering::Relaxed);
                    // Where nobody listens any more an error has ended it.
                    if n >= count || send.send((n, play(n))).is_err() {
                        break;
                    }
                }
            });
        }
        drop(send);
        let mut waiting: Vec<Option<Vec<Row>>> = vec![None; count];
        let mut rows = Vec::new();
        let mut done = 0;
        for (n, played) in receive {
            waiting[n] = Some(played?);
            while let Some(more) = waiting.get_mut(done).and_then(Option::take) {
                more.iter().for_each(&mut say);
                rows.extend(more);
                done += 1;
            }
        }
        Ok(rows)
    })
}

/// Whether all is as it must be.
///
/// # Errors
/// What is not.
pub fn verdict(rows: &[Row]) -> Result<()> {
    let missed = rows.iter().filter(|row| !row.right).count();
    rows.first().context("nothing was rehearsed")?;
    if missed > 0 { bail!("{missed} of {} missed", rows.len()) } else { Ok(()) }
}
