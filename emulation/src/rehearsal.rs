//! The hardware image rehearsed: every way of going wrong that the modelled board can play, and what came of it.

use crate::board::{self, BoardRun, InjectedFault, Setup};
use anyhow::{Context, Result, bail};
use seabearing_board_model::Costs;
use seabearing_board_model::ads131m04::Codes;
use seabearing_board_model::stm32h743::Parameters;
use seabearing_core::wait::WAITING;
use seabearing_core::wire::{Command, Decoder, Encoder, FaultCode, Message};
use std::path::Path;

/// One thing rehearsed.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// What was done to the board.
    pub case: String,
    /// What came of it.
    pub outcome: String,
    /// Whether that is what must be.
    pub right: bool,
}

impl std::fmt::Display for Row {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let verdict = if self.right { "ok" } else { "MISSED" };
        write!(f, "{:<6} {:<58} {}", verdict, self.case, self.outcome)
    }
}

/// Cycles an instruction and more for a register access, at which the board must keep up.
pub const COST: (f64, f64) = (2.5, 30.0);
/// Interrupts a second allowed.
const MOST_INTERRUPTS: f64 = 500.0;
/// Share of the time asleep that must be left.
const LEAST_IDLE: f64 = 0.6;
/// Cycles an instruction at which the board must still keep up.
const LEAST_BREAKING: f64 = 4.0;
/// Costs tried one after the other.
const COSTS: [f64; 8] = [4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 20.0];
/// Within so many seconds what went wrong must be named.
const NAMED_S: f64 = 10.0;
/// When something goes wrong, s.
const AT_S: f64 = 0.5;

/// What is rehearsed with: the image, the configuration it holds, its rate.
pub struct Stage<'a> {
    /// The image.
    pub image: &'a Path,
    /// The configuration in it.
    pub blob: &'a [u8],
    /// Samples a second.
    pub rate_hz: f64,
}

/// Noise from a direction: four channels of the same numbers a few instants apart, for so many instants.
fn noise(instants: u64) -> impl FnMut() -> Option<Codes> + Send + 'static {
    let code = |n: u64| {
        let mut x = n.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        x = (x ^ x >> 31).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (x >> 46) as i32 - (1 << 17)
    };
    let mut n = 0;
    move || {
        n += 1;
        (n <= instants).then(|| [code(n + 3), code(n + 2), code(n + 1), code(n)])
    }
}

fn costs(cycles: f64) -> Costs {
    Costs { instruction: cycles, register: COST.1, ..Costs::IDEAL }
}

impl Stage<'_> {
    fn play(&self, seconds: f64, setup: Setup) -> Result<BoardRun> {
        let instants = (seconds * self.rate_hz).round() as u64;
        board::twin(self.image, self.blob, self.rate_hz, &setup, noise(instants))
    }

    fn setup(&self, faults: &[InjectedFault]) -> Setup {
        Setup { costs: costs(COST.0), faults: faults.to_vec(), ..Setup::default() }
    }

    /// Keeps up at the cost that is asked for, and where it breaks.
    fn pace(&self, seconds: f64) -> Result<Vec<Row>> {
        let report = self.play(seconds, self.setup(&[]))?;
        let (cycles, register) = COST;
        let case = |what: &str| format!("{what}, {cycles} cycles an instruction, {register} an access");
        let row = |case, outcome, right| Row { case, outcome, right };
        let mut rows = vec![
            row(
                case("conversions lost"),
                format!("{} of {} in {seconds} s", report.lost, report.converted),
                report.lost == 0 && report.delivered == report.converted,
            ),
            row(
                case("telemetry against the host's"),
                if report.identical() { "the same bytes" } else { "different" }.to_owned(),
                report.identical(),
            ),
            row(
                case("interrupts a second"),
                format!("{:.0}", report.interrupts_per_s),
                report.interrupts_per_s <= MOST_INTERRUPTS,
            ),
            row(case("asleep"), format!("{:.0} %", report.idle * 100.0), report.idle >= LEAST_IDLE),
        ];
        let mut holds = 0.0;
        let mut breaks = None;
        for cycles in COSTS {
            let report = self.play(1.0, Setup { costs: costs(cycles), ..Setup::default() })?;
            if report.identical() && report.lost == 0 {
                holds = cycles;
            } else {
                breaks = Some(cycles);
                break;
            }
        }
        let outcome = match breaks {
            Some(cycles) => format!("holds at {holds}, not at {cycles}"),
            None => format!("holds at {holds}"),
        };
        rows.push(row(
            "cycles an instruction at which it breaks".to_owned(),
            outcome,
            holds >= LEAST_BREAKING,
        ));
        Ok(rows)
    }

    /// An outage through which the converter goes on: the host, told only which samples the board gave up, must say the same.
    fn outage(&self, case: String, fault: InjectedFault, length_s: f64) -> Result<Row> {
        let parameters =
            Parameters { board_clock_error: 0.01, converter_clock_error: -0.01, ..Parameters::default() };
        let report = self.play(AT_S + length_s + 1.0, Setup { parameters, ..self.setup(&[fault]) })?;
        let gaps: Vec<(u64, u64)> = messages(&report.firmware)
            .filter_map(|m| match m {
                Message::Fault(f) if f.code == FaultCode::Gap => Some((f.index - f.value as u64, f.index)),
                _ => None,
            })
            .collect();
        let given_up: u64 = gaps.iter().map(|(from, to)| to - from).sum();
        let host = report.host_without(self.blob, &gaps)?;
        let right = host == report.firmware;
        let numbers = if right { "exact" } else { "WRONG" };
        Ok(Row { case, outcome: format!("numbers {numbers}; {given_up} instants given up, as told"), right })
    }

    /// The converter stands still: how long that was is an estimate, and told as one.
    fn standstill(&self, case: String, fault: InjectedFault, length_s: f64) -> Result<Row> {
        let parameters =
            Parameters { board_clock_error: 0.01, converter_clock_error: -0.01, ..Parameters::default() };
        let report = self.play(AT_S + length_s + 1.0, Setup { parameters, ..self.setup(&[fault]) })?;
        let told = messages(&report.firmware).find_map(|m| match m {
            Message::Fault(f) if f.code == FaultCode::ConverterRestarted => Some(f.value as u64),
            _ => None,
        });
        Ok(match told {
            Some(told) => Row {
                case,
                outcome: format!("told {told} instants by the clock, {} in truth", report.lost),
                right: told.abs_diff(report.lost) <= 1,
            },
            None => Row { case, outcome: "not told".to_owned(), right: false },
        })
    }

    /// Something is named within the time allowed.
    fn named(&self, case: &str, setup: Setup, is: impl Fn(&Message) -> Option<String>) -> Result<Row> {
        let report = self.play(3600.0, Setup { most_s: Some(NAMED_S), ..setup })?;
        let named = messages(&report.firmware).find_map(|m| is(&m));
        let right = named.is_some();
        Ok(Row { case: case.to_owned(), outcome: named.unwrap_or_else(|| "not named".to_owned()), right })
    }

    /// What cannot record must say so and stay reachable.
    fn names(&self) -> Result<Vec<Row>> {
        let fault = |wanted: FaultCode| {
            move |m: &Message| match m {
                Message::Fault(f) if f.code == wanted => Some(format!("{:?} {}", f.code, f.value)),
                _ => None,
            }
        };
        let ideal = |faults: &[InjectedFault]| Setup { faults: faults.to_vec(), ..Setup::default() };
        let dead = InjectedFault::ConverterDead(0.0, f64::INFINITY);
        let dies = InjectedFault::ConverterDead(AT_S, f64::INFINITY);
        let hard = InjectedFault::HardFault(AT_S);
        let again: Vec<InjectedFault> = (1..8).map(|n| InjectedFault::HardFault(f64::from(n))).collect();
        let mut encoder = Encoder::default();
        let mut command = |c: Command| encoder.frame(&c).to_vec();
        let commands = vec![
            (AT_S, command(Command::Stop { token: 1 })),
            (2.0, command(Command::Identify { token: 2 })),
            (3.0, command(Command::Start { token: 3 })),
        ];
        let mut rows = vec![
            self.named("converter dead from the start", ideal(&[dead]), fault(FaultCode::NoSamples))?,
            self.named("converter dies", ideal(&[dies]), fault(FaultCode::NoSamples))?,
            self.named("hard fault", ideal(&[hard]), fault(FaultCode::HardFault))?,
            self.named("hard faults again and again", ideal(&again), fault(FaultCode::ManyResets))?,
            self.named(
                "configuration damaged in flash",
                Setup { damaged_configuration: true, ..ideal(&[]) },
                fault(FaultCode::BadConfiguration),
            )?,
        ];
        let stopped = self.play(3600.0, Setup { most_s: Some(5.0), commands, ..ideal(&[]) })?;
        let heard: Vec<&str> = messages(&stopped.firmware)
            .filter_map(|m| match m {
                Message::Hello(h) if h.kind == WAITING => Some("waits"),
                Message::Hello(_) => Some("records"),
                Message::End(_) => Some("ends"),
                Message::Reply(r) if r.status == 0 => Some("answers"),
                _ => None,
            })
            .collect();
        // Stop, the wait, its answer to Identify, Start, and a new session.
        let wanted = ["records", "answers", "ends", "waits", "waits", "answers", "answers", "records"];
        rows.push(Row {
            case: "Stop, Identify, Start".to_owned(),
            outcome: heard.join(", "),
            right: heard == wanted,
        });
        Ok(rows)
    }

    /// Everything; outages of so many seconds.
    ///
    /// # Errors
    /// The image is not there or not the station's, or the board did what no board allows.
    pub fn rehearse(&self, pace_s: f64, outages_s: &[f64], mut say: impl FnMut(&Row)) -> Result<Vec<Row>> {
        let mut rows = Vec::new();
        let mut add = |more: Vec<Row>| {
            more.iter().for_each(&mut say);
            rows.extend(more);
        };
        add(self.pace(pace_s)?);
        for &s in outages_s {
            let cut = format!("line cut for {s} s, clocks 1 % off each way");
            add(vec![self.outage(cut, InjectedFault::ConverterMute(AT_S, s), s)?]);
        }
        // Longer and the watchdog resets, as it must.
        for s in [0.001, 0.1, 1.0] {
            let held = format!("core held for {s} s, clocks 1 % off each way");
            add(vec![self.outage(held, InjectedFault::CoreHeld(AT_S, s), s)?]);
        }
        for &s in outages_s {
            let dead = format!("converter without supply for {s} s, clocks 1 % off each way");
            add(vec![self.standstill(dead, InjectedFault::ConverterDead(AT_S, s), s)?]);
        }
        add(vec![self.standstill(
            "converter resets itself".to_owned(),
            InjectedFault::ConverterReset(AT_S),
            0.1,
        )?]);
        add(self.names()?);
        Ok(rows)
    }
}

fn messages(bytes: &[u8]) -> impl Iterator<Item = Message> + '_ {
    let mut decoder = Decoder::default();
    bytes.iter().filter_map(move |byte| decoder.push(*byte)).map(|received| received.message)
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
