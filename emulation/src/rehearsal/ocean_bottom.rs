//! The ocean-bottom board rehearsed: four chips of a channel each, a minute's records, hours between.

use super::cases::{Case, PIN, SOFTWARE, WATCHDOG, linked};
use super::judge::Wanted;
use super::ocean_bottom_reach::reach;
use super::{COST, Row, Stage, all, costs};
use crate::board::{InjectedFault, PANIC_LINE, SEISMIC_BAUD, Setup, mix};
use anyhow::Result;
use seabearing_board_model::ads131m04::Codes;
use seabearing_board_model::stm32h743::Parameters;
use seabearing_core::wire::FaultCode;

/// When something goes wrong, s.
const AT_S: f64 = 20.0;
/// Before the first sample is given: the chips convert, and were not looked at again.
const EARLY_S: f64 = 0.7;
/// Sound after which the first records of directions have come, and a health report.
const RECORDS_S: f64 = 200.0;
const HEALTH_S: f64 = 70.0;
/// Share of the time asleep that must be left.
const LEAST_IDLE: f64 = 0.95;
/// The chip that is taken for one of those whose edges nobody counts.
const THIRD: u8 = 2;

/// Of the chips' cases those that are always played: what no other board has.
const SHORT: usize = 6;

/// How much of it is rehearsed.
#[derive(Debug, Clone)]
pub struct OceanBottom {
    /// Seconds over which lost conversions are counted.
    pub pace_s: f64,
    /// Lengths of outages, s.
    pub outages_s: Vec<f64>,
    /// Only what no other board has.
    pub short: bool,
    /// Of the works of the flash in a short run, how many power is cut at.
    pub cuts: u32,
}

/// Noise that a hydrophone and three components hear alike, with a sixteenth of each channel's own, for so many instants.
pub(super) fn noise(instants: u64) -> impl FnMut() -> Option<Codes> + Send + 'static {
    const HEARD: [f64; 4] = [1.0, 0.8, 0.5, 0.3];
    let code = |n: u64| (mix(n) >> 46) as i32 - (1 << 17);
    let mut n = 0;
    move || {
        n += 1;
        let own = |channel: usize| code(!(4 * n + channel as u64)) / 16;
        let heard = |channel: usize| (HEARD[channel] * f64::from(code(n))) as i32 + own(channel);
        (n <= instants).then(|| std::array::from_fn(heard))
    }
}

pub(super) fn parameters() -> Parameters {
    Parameters { seismic: true, baud: SEISMIC_BAUD, ..Parameters::default() }
}

fn case(name: &str, faults: &[InjectedFault], event_s: f64, seconds: f64, wanted: &[Wanted]) -> Case {
    let setup =
        Setup { costs: costs(COST.0), parameters: parameters(), faults: faults.to_vec(), ..Setup::default() };
    let (name, wanted) = (name.to_owned(), wanted.to_vec());
    linked("ocean bottom", Case { name, setup, event_s, seconds, wanted, sent: None })
}

/// Clocks as wrong as they may be, in opposite senses.
fn outage(what: &str, length_s: f64, fault: InjectedFault, event_s: f64, wanted: &[Wanted]) -> Case {
    let name = format!("{what} for {length_s} s, clocks 1 % off");
    let case = case(&name, &[fault], event_s, RECORDS_S + length_s, wanted);
    let parameters =
        Parameters { board_clock_error: 0.01, converter_clock_error: -0.01, ..case.setup.parameters };
    Case { setup: Setup { parameters, ..case.setup }, ..case }
}

/// What the chips can do.
fn chips() -> Vec<Case> {
    let fault = |code| Wanted::Fault(code, None);
    let dead = |chip: u8| Wanted::Fault(FaultCode::DeadChannel, Some(chip.into()));
    let back = |chip: u8| Wanted::Fault(FaultCode::ChannelBack, Some(chip.into()));
    let restarted = fault(FaultCode::ConverterRestarted);
    let forever = f64::INFINITY;
    vec![
        case(
            "converters reset themselves before the first sample was given",
            &[InjectedFault::ConverterReset(EARLY_S)],
            EARLY_S,
            RECORDS_S,
            &[restarted],
        ),
        case(
            "the chips' clock stops for a conversion",
            &[InjectedFault::ConverterStops(AT_S, 1.0)],
            AT_S,
            RECORDS_S,
            &[restarted],
        ),
        case(
            "one chip of four dies",
            &[InjectedFault::ChipDead(THIRD, AT_S, forever)],
            AT_S,
            RECORDS_S,
            &[dead(THIRD)],
        ),
        case(
            "one chip of four without supply for 20 s",
            &[InjectedFault::ChipDead(THIRD, AT_S, 20.0)],
            AT_S + 20.0,
            RECORDS_S,
            &[restarted, back(THIRD)],
        ),
        case(
            "the chip whose edges are counted dies",
            &[InjectedFault::ChipDead(0, AT_S, forever)],
            AT_S,
            RECORDS_S,
            &[restarted, dead(0)],
        ),
        case(
            "one chip resets itself",
            &[InjectedFault::ChipReset(THIRD, AT_S)],
            AT_S,
            RECORDS_S,
            &[restarted],
        ),
        case("one chip's gain flips", &[InjectedFault::ChipUpset(1, AT_S)], AT_S, RECORDS_S, &[restarted]),
        case(
            "converters reset themselves",
            &[InjectedFault::ConverterReset(AT_S)],
            AT_S,
            RECORDS_S,
            &[restarted],
        ),
        case(
            "a pulse of 0.2 us on data ready",
            &[InjectedFault::ConverterGlitch(AT_S, 2e-7)],
            AT_S,
            RECORDS_S,
            &[Wanted::Never(FaultCode::ConverterRestarted), Wanted::Never(FaultCode::Gap)],
        ),
        case(
            "a pulse of 1 us on data ready",
            &[InjectedFault::ConverterGlitch(AT_S, 1e-6)],
            AT_S,
            RECORDS_S,
            &[restarted],
        ),
        case(
            "the rate of the first chip flips",
            &[InjectedFault::ConverterUpset(AT_S)],
            AT_S,
            RECORDS_S,
            &[restarted],
        ),
        case(
            "converters dead from power on",
            &[InjectedFault::ConverterDead(0.0, forever)],
            0.0,
            10.0,
            &[fault(FaultCode::NoSamples)],
        ),
        case(
            "converters die",
            &[InjectedFault::ConverterDead(AT_S, forever)],
            AT_S,
            AT_S + 10.0,
            &[fault(FaultCode::NoSamples)],
        ),
        case(
            "one bit in 80 000 wrong on SPI",
            &[InjectedFault::SpiBits(10_000)],
            // The first that stands out of the signal, of a channel without which nothing can be said.
            22.0,
            RECORDS_S,
            &[fault(FaultCode::Invalid)],
        ),
    ]
}

/// What every board must stand.
fn ends() -> Vec<Case> {
    let panicked = Wanted::Fault(FaultCode::Panicked, Some(i64::from(PANIC_LINE)));
    let hard_fault = Wanted::Fault(FaultCode::HardFault, None);
    let whole_s = AT_S + HEALTH_S;
    let mut cases = vec![
        case(
            "hard fault",
            &[InjectedFault::HardFault(AT_S)],
            AT_S,
            whole_s,
            &[Wanted::Start(SOFTWARE), hard_fault],
        ),
        case("panic", &[InjectedFault::Panic(AT_S)], AT_S, whole_s, &[Wanted::Start(SOFTWARE), panicked]),
        case("reset pin", &[InjectedFault::PinReset(AT_S)], AT_S, whole_s, &[Wanted::Start(PIN)]),
        case(
            "core held for 2.5 s",
            &[InjectedFault::CoreHeld(AT_S, 2.5)],
            AT_S,
            whole_s,
            &[Wanted::Start(WATCHDOG)],
        ),
    ];
    let bad = Wanted::Fault(FaultCode::BadConfiguration, None);
    let damaged = case("configuration damaged in flash", &[], 0.0, 12.0, &[Wanted::Waits, bad]);
    cases.push(Case { setup: Setup { damaged_configuration: true, ..damaged.setup }, ..damaged });
    cases
}

fn outages(lengths_s: &[f64], short: bool) -> Vec<Case> {
    let mut cases = Vec::new();
    for &s in lengths_s {
        // Eight codes alike are noticed: 32 ms.
        let silent = [Wanted::Fault(FaultCode::DeadChannel, None)];
        let wanted = if s > 0.05 { &silent[..] } else { &[] };
        cases.push(outage("lines cut", s, InjectedFault::ConverterMute(AT_S, s), AT_S, wanted));
    }
    // The rings hold 4 s, the watchdog waits for 2: nothing is lost.
    for s in [0.1, 1.5].into_iter().filter(|_| !short) {
        cases.push(outage("core held", s, InjectedFault::CoreHeld(AT_S, s), AT_S + s, &[]));
    }
    for &s in lengths_s {
        let dead = InjectedFault::ConverterDead(AT_S, s);
        let wanted = [Wanted::Fault(FaultCode::ConverterRestarted, None)];
        cases.push(outage("converters without supply", s, dead, AT_S + s, &wanted));
    }
    cases
}

impl Stage<'_> {
    /// The same for the ocean-bottom board's image.
    ///
    /// # Errors
    /// As [`Stage::rehearse`].
    pub fn rehearse_ocean_bottom(&self, length: &OceanBottom, say: impl FnMut(&Row)) -> Result<Vec<Row>> {
        let mut cases = chips();
        if length.short {
            cases.truncate(SHORT);
        } else {
            cases.extend(ends());
        }
        cases.extend(outages(&length.outages_s, length.short));
        cases.extend(reach(self.blob, length.cuts, length.short)?);
        let play = |n: usize| match n {
            0 => self.pace(length.pace_s, parameters(), LEAST_IDLE),
            n => self.judge(&cases[n - 1]).map(|row| vec![row]),
        };
        all(cases.len() + 1, play, say)
    }
}
