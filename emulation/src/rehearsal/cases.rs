//! What is rehearsed beside the pace: each case with what is done, when, and what must be said of it.

use super::judge::Wanted;
use super::{AT_S, COST, LATER_S, at_once, costs};
use crate::board::{InjectedFault, PANIC_LINE, Setup, utc_us};
use seabearing_board_model::stm32h743::Parameters;
use seabearing_board_model::stm32h743::flash::FlashTimes;
use seabearing_core::wire::{Command, Encoder, FaultCode};

/// One thing done to the board.
#[derive(Clone)]
pub struct Case {
    /// In words.
    pub name: String,
    /// What is done.
    pub setup: Setup,
    /// When it has happened, s: what must be said is counted from here.
    pub event_s: f64,
    /// Seconds of sound.
    pub seconds: f64,
    /// What must be said, in this order.
    pub wanted: Vec<Wanted>,
    /// Another configuration that the board comes to run with.
    pub sent: Option<Vec<u8>>,
}

/// Reasons of a start as `Hello` tells them.
pub(super) const POWER: u8 = 0;
pub(super) const WATCHDOG: u8 = 1;
pub(super) const SOFTWARE: u8 = 2;
pub(super) const PIN: u8 = 3;
pub(super) const BROWN_OUT: u8 = 4;

pub(super) fn case(
    name: &str,
    faults: &[InjectedFault],
    event_s: f64,
    seconds: f64,
    wanted: &[Wanted],
) -> Case {
    let setup = Setup { costs: costs(COST.0), faults: faults.to_vec(), ..Setup::default() };
    Case { name: name.to_owned(), setup, event_s, seconds, wanted: wanted.to_vec(), sent: None }
}

/// Clocks as wrong as they may be, in opposite senses.
pub(super) fn wrong_clocks() -> Parameters {
    Parameters { board_clock_error: 0.01, converter_clock_error: -0.01, ..Parameters::default() }
}

/// Commands framed, each at its second; a delimiter before each ends what noise had begun (docs/wire.md).
pub(super) fn line(commands: &[(f64, Command)]) -> Vec<(f64, Vec<u8>)> {
    let mut encoder = Encoder::default();
    let mut frame = |command| [&[0], encoder.frame(command)].concat();
    commands.iter().map(|(at, command)| (*at, frame(command))).collect()
}

/// Everything; outages of these lengths, s.
pub fn all(outages_s: &[f64]) -> Vec<Case> {
    let mut cases = failures();
    cases.extend(settings());
    cases.extend(memory());
    cases.extend(reach());
    cases.extend(receiver(&ARRAYS));
    for &s in outages_s {
        let cut = InjectedFault::ConverterMute(AT_S, s);
        cases.push(outage("line cut", s, cut, AT_S, &[Wanted::Fault(FaultCode::Invalid, None)]));
    }
    // Longer and the watchdog resets, as it must. The ring holds 64 ms: nothing is told of a shorter time.
    for s in [0.001, 0.1, 1.0] {
        let gap = [Wanted::Fault(FaultCode::Gap, None)];
        let wanted = if s > 0.064 { &gap[..] } else { &[] };
        cases.push(outage("core held", s, InjectedFault::CoreHeld(AT_S, s), AT_S + s, wanted));
    }
    for &s in outages_s {
        let dead = InjectedFault::ConverterDead(AT_S, s);
        let wanted = [Wanted::Fault(FaultCode::ConverterRestarted, None)];
        cases.push(outage("converter without supply", s, dead, AT_S + s, &wanted));
    }
    // A supply that bounces: the second outage comes before the first has been measured anew.
    let bounce = [InjectedFault::ConverterDead(AT_S, 0.5), InjectedFault::ConverterDead(AT_S + 0.6, 2.0)];
    let name = "converter without supply for 0.5 s and, 0.1 s later, for 2 s, clocks 1 % off";
    let restarted = Wanted::Fault(FaultCode::ConverterRestarted, None);
    let bounces = case(name, &bounce, AT_S, AT_S + 3.6, &[restarted; 2]);
    cases.push(Case { setup: Setup { parameters: wrong_clocks(), ..bounces.setup }, ..bounces });
    cases.extend(at_once::cases());
    cases
}

fn outage(what: &str, length_s: f64, fault: InjectedFault, event_s: f64, wanted: &[Wanted]) -> Case {
    let name = format!("{what} for {length_s} s, clocks 1 % off");
    let case = case(&name, &[fault], event_s, AT_S + length_s + 1.0, wanted);
    Case { setup: Setup { parameters: wrong_clocks(), ..case.setup }, ..case }
}

/// How long the flash takes in a rehearsal: to program the longest that the data sheet gives, to erase a fortieth of it.
const FLASH: FlashTimes = FlashTimes { program_us: 200.0, erase_s: 0.05 };
/// Programmings and erasings of a short run: a second, and twenty commands.
pub const SHORT_RUN: u32 = 32;

/// A case of the image whose records wait in flash.
pub(super) fn linked(what: &str, case: Case) -> Case {
    let parameters = Parameters { flash: FLASH, ..case.setup.parameters };
    Case {
        name: format!("{what}: {}", case.name),
        setup: Setup { link: true, parameters, ..case.setup },
        ..case
    }
}

/// With records that wait in flash: power cut in the middle of these programmings and erasings, and other ends.
pub fn with_store(cuts: &[u32]) -> Vec<Case> {
    let cut = |n: &u32| {
        let name = format!("power cut in the middle of work {n} of the flash");
        let case = case(&name, &[InjectedFault::FlashCut(*n)], 0.0, 1.0, &[Wanted::Start(POWER)]);
        // Refused while it records, which is a record each.
        let asked = |n: u8| (0.2 + 0.03 * f64::from(n), Command::Start { token: n });
        let commands = line(&(0..20).map(asked).collect::<Vec<_>>());
        Case { setup: Setup { commands, ..case.setup }, ..case }
    };
    let mut cases: Vec<Case> = cuts.iter().map(cut).collect();
    let ends = [
        ("reset pin", InjectedFault::PinReset(AT_S), Wanted::Start(PIN)),
        ("panic", InjectedFault::Panic(AT_S), Wanted::Start(SOFTWARE)),
    ];
    cases.extend(ends.map(|(name, fault, wanted)| case(name, &[fault], AT_S, 1.2, &[wanted])));
    let bits = [InjectedFault::FlashBits(AT_S), InjectedFault::PinReset(AT_S)];
    cases.push(case("one wrong bit in every word, reset pin", &bits, AT_S, 1.2, &[Wanted::Start(PIN)]));
    let stop = case(
        "Stop, Start",
        &[],
        AT_S,
        1.5,
        &[Wanted::Reply(1), Wanted::End, Wanted::Waits, Wanted::Reply(2)],
    );
    let commands = line(&[(AT_S, Command::Stop { token: 1 }), (AT_S + 0.5, Command::Start { token: 2 })]);
    cases.push(Case { setup: Setup { commands, ..stop.setup }, ..stop });
    let crash = [InjectedFault::FlashCrash(AT_S), InjectedFault::PinReset(AT_S)];
    let crashed = Wanted::Fault(FaultCode::HardFault, None);
    let many = Wanted::Fault(FaultCode::ManyResets, None);
    cases.push(case(
        "every start crashes as it opens the flash",
        &crash,
        AT_S,
        1.5,
        &[Wanted::Waits, crashed, many],
    ));
    cases.into_iter().map(|case| linked("store", case)).collect()
}

/// What fails, and is to be named.
fn failures() -> Vec<Case> {
    let fault = |code| Wanted::Fault(code, None);
    let panicked = Wanted::Fault(FaultCode::Panicked, Some(i64::from(PANIC_LINE)));
    let (silent, restarted) = (fault(FaultCode::NoSamples), fault(FaultCode::ConverterRestarted));
    let forever = f64::INFINITY;
    let none = [FaultCode::FalseEdge, FaultCode::ConverterRestarted, FaultCode::Gap].map(Wanted::Never);
    let again: Vec<InjectedFault> =
        (0..5).map(|n| InjectedFault::HardFault(AT_S + 0.1 * f64::from(n))).collect();
    let damaged = |case: Case| Case { setup: Setup { damaged_configuration: true, ..case.setup }, ..case };
    let listening = |case: Case| Case { setup: Setup { receiver_s: 3.0, ..case.setup }, ..case };
    let bad = fault(FaultCode::BadConfiguration);
    let with = |case: Case, commands: &[(f64, Command)]| Case {
        setup: Setup { commands: line(commands), ..case.setup },
        ..case
    };
    let end_s = AT_S + 0.4;
    vec![
        case(
            "converter dead from power on",
            &[InjectedFault::ConverterDead(0.0, forever)],
            0.0,
            1.0,
            &[silent],
        ),
        case("converter dies", &[InjectedFault::ConverterDead(AT_S, forever)], AT_S, 1.0, &[silent]),
        case("converter resets itself", &[InjectedFault::ConverterReset(AT_S)], AT_S, 1.5, &[restarted]),
        case("converter's rate flips", &[InjectedFault::ConverterUpset(AT_S)], AT_S, 1.5, &[restarted]),
        case("converter's gain flips", &[InjectedFault::ConverterGain(AT_S)], AT_S, 1.5, &[restarted]),
        // While a frame is clocked out, and between two.
        afresh(1),
        afresh(3),
        stops(1.0),
        stops(3.0),
        stops(10.0),
        glitch(0, 0.1, &none),
        glitch(3, 0.1, &none),
        // It cuts a transfer short, or its own is cut by the next, and what is counted too much is found by the converter's pace.
        glitch(0, 0.4, &[restarted]),
        glitch(3, 0.4, &[restarted]),
        // Between two transfers: its frame says that it is none.
        glitch(2, 0.4, &[fault(FaultCode::FalseEdge), none[1], none[2]]),
        case(
            "one bit in 80 000 wrong on SPI",
            &[InjectedFault::SpiBits(10_000)],
            0.0,
            1.5,
            &[fault(FaultCode::Invalid)],
        ),
        case(
            "a wrong bit in every frame on SPI",
            &[InjectedFault::SpiBits(17)],
            0.0,
            1.0,
            &[fault(FaultCode::Invalid)],
        ),
        damaged(with(
            case(
                "configuration damaged in flash; asked again",
                &[],
                0.0,
                1.0,
                &[Wanted::Waits, bad, Wanted::Waits, bad, Wanted::Reply(1)],
            ),
            &[(0.5, Command::Identify { token: 1 })],
        )),
        // Its converter's edges are not counted then, and a pulse is of none.
        listening(damaged(case(
            "configuration damaged in flash, beside a receiver",
            &[],
            0.0,
            2.5,
            &[Wanted::Waits, bad],
        ))),
        case(
            "hard fault",
            &[InjectedFault::HardFault(LATER_S)],
            LATER_S,
            LATER_S + 1.0,
            &[Wanted::Start(SOFTWARE), fault(FaultCode::HardFault)],
        ),
        case(
            "panic",
            &[InjectedFault::Panic(LATER_S)],
            LATER_S,
            LATER_S + 1.0,
            &[Wanted::Start(SOFTWARE), panicked],
        ),
        with(
            case(
                "five hard faults in half a second, then Start",
                &again,
                end_s,
                2.5,
                &[
                    Wanted::Waits,
                    fault(FaultCode::HardFault),
                    fault(FaultCode::ManyResets),
                    Wanted::Reply(1),
                    Wanted::Start(SOFTWARE),
                ],
            ),
            &[(end_s + 0.5, Command::Start { token: 1 })],
        ),
        // A cell that is broken does not keep a board that waits from being reached.
        with(
            case(
                "five hard faults in half a second, then two wrong bits twice, then Start",
                &[
                    &again[..],
                    &[InjectedFault::MemoryBits(end_s + 0.2, 0), InjectedFault::MemoryBits(end_s + 0.4, 1)],
                ]
                .concat(),
                end_s,
                2.5,
                &[
                    Wanted::Waits,
                    fault(FaultCode::ManyResets),
                    fault(FaultCode::MemoryError),
                    Wanted::Reply(1),
                    Wanted::Start(SOFTWARE),
                ],
            ),
            &[(end_s + 0.8, Command::Start { token: 1 })],
        ),
        with(
            case(
                "Stop, then the supply low for a second",
                &[InjectedFault::SupplyLow(AT_S + 0.4, 1.0)],
                AT_S,
                2.0,
                &[Wanted::Reply(1), Wanted::End, Wanted::Waits, fault(FaultCode::SupplyLow)],
            ),
            &[(AT_S, Command::Stop { token: 1 })],
        ),
        case(
            "core held for 2.5 s",
            &[InjectedFault::CoreHeld(LATER_S, 2.5)],
            LATER_S,
            LATER_S + 3.5,
            &[Wanted::Start(WATCHDOG)],
        ),
        case(
            "supply low for a second, not too low to work",
            &[InjectedFault::SupplyLow(AT_S, 1.0)],
            AT_S,
            AT_S + 7.5,
            &[
                fault(FaultCode::SupplyLow),
                Wanted::End,
                Wanted::Waits,
                Wanted::Margins(2790, 2810),
                Wanted::Start(SOFTWARE),
            ],
        ),
        // While its clocks do not start only the watchdog works.
        case(
            "reset pin, and the clocks do not start for 3 s",
            &[InjectedFault::ClocksFail(AT_S, 3.0), InjectedFault::PinReset(AT_S)],
            AT_S,
            5.5,
            &[Wanted::Start(WATCHDOG)],
        ),
        case("supply low for 10 ms", &[InjectedFault::SupplyLow(AT_S, 0.01)], AT_S, 1.5, &[]),
        case("reset pin", &[InjectedFault::PinReset(LATER_S)], LATER_S, LATER_S + 1.0, &[Wanted::Start(PIN)]),
        case(
            "supply sags",
            &[InjectedFault::BrownOut(LATER_S)],
            LATER_S,
            LATER_S + 1.0,
            &[Wanted::Start(BROWN_OUT)],
        ),
        // From the second on it is waited out, ever longer; sags are no starts of the software, however many.
        case(
            "supply sags seven times",
            &std::array::from_fn::<_, 7, _>(|n| InjectedFault::BrownOut(AT_S + 0.1 * n as f64)),
            AT_S,
            2.5,
            &[Wanted::Start(BROWN_OUT), Wanted::Waits, fault(FaultCode::SupplyLow)],
        ),
        case(
            "supply sags twice",
            &[InjectedFault::BrownOut(AT_S), InjectedFault::BrownOut(AT_S + 0.2)],
            AT_S + 1.0,
            AT_S + 11.5,
            &[Wanted::Start(SOFTWARE)],
        ),
    ]
}

/// A quarter of a conversion.
const QUARTER_S: f64 = 0.25 / 64e3;

/// The converter's clock stops for so many conversions, and nothing is reset.
fn stops(conversions: f64) -> Case {
    let name = format!("converter's clock stops for {conversions} conversions");
    let wanted = [Wanted::Fault(FaultCode::ConverterRestarted, None)];
    case(&name, &[InjectedFault::ConverterStops(AT_S, conversions)], AT_S, 1.5, &wanted)
}

/// The converter's filters begin afresh, so many quarters of a conversion after one is ready.
fn afresh(quarter: u8) -> Case {
    let name = format!("converter begins to convert afresh, phase {quarter}");
    let resync = InjectedFault::ConverterResync(AT_S + QUARTER_S * f64::from(quarter));
    case(&name, &[resync], AT_S, 1.5, &[Wanted::Fault(FaultCode::ConverterRestarted, None)])
}

/// A pulse on data ready that is none of the converter's, so many quarters of a conversion after one is ready.
fn glitch(quarter: u8, length_us: f64, wanted: &[Wanted]) -> Case {
    let name = format!("a pulse of {length_us} us on data ready, phase {quarter}");
    let pulse = InjectedFault::ConverterGlitch(AT_S + QUARTER_S * f64::from(quarter), length_us * 1e-6);
    case(&name, &[pulse], AT_S, 1.5, wanted)
}

/// Bits that change in what was worked out of the configuration.
fn settings() -> impl Iterator<Item = Case> {
    (0..4).map(|n| {
        let changed = Wanted::Fault(FaultCode::BadConfiguration, Some(3));
        let name = format!("bit {n} changed in the recorder's settings");
        let flip = InjectedFault::SettingsBit(LATER_S, n);
        case(&name, &[flip], LATER_S, LATER_S + 4.0, &[Wanted::Start(SOFTWARE), changed])
    })
}

/// Wrong bits in memory: one is corrected, more are not.
fn memory() -> impl Iterator<Item = Case> {
    let told = Wanted::Fault(FaultCode::MemoryError, None);
    let one =
        case("one wrong bit in a word of memory", &[InjectedFault::MemoryBit(AT_S, 0)], AT_S, 1.5, &[told]);
    let more = move |n: u64| {
        let name = format!("two wrong bits in word {n} of memory");
        let flip = InjectedFault::MemoryBits(LATER_S, n);
        case(&name, &[flip], LATER_S, LATER_S + 1.0, &[Wanted::Start(SOFTWARE), told])
    };
    std::iter::once(one).chain((0..6).map(more))
}

/// The line in both directions.
fn reach() -> Vec<Case> {
    let with = |case: Case, commands: &[(f64, Command)]| Case {
        setup: Setup { commands: line(commands), ..case.setup },
        ..case
    };
    let burst: Vec<(f64, Command)> = (1..=60).map(|token| (AT_S, Command::Start { token })).collect();
    vec![
        with(
            case(
                "Stop, Identify, Start",
                &[],
                AT_S,
                2.5,
                &[
                    Wanted::Reply(1),
                    Wanted::End,
                    Wanted::Waits,
                    Wanted::Waits,
                    Wanted::Reply(2),
                    Wanted::Reply(3),
                    Wanted::Start(SOFTWARE),
                ],
            ),
            &[
                (AT_S, Command::Stop { token: 1 }),
                (AT_S + 0.3, Command::Identify { token: 2 }),
                (AT_S + 0.5, Command::Start { token: 3 }),
            ],
        ),
        with(
            case(
                "noise on the line for 0.5 s, then a command",
                &[InjectedFault::LineNoise(AT_S, 0.5)],
                AT_S,
                1.5,
                &[Wanted::Fault(FaultCode::BadCommand, None), Wanted::Reply(1)],
            ),
            &[(AT_S + 0.55, Command::Start { token: 1 })],
        ),
        with(case("60 commands without a pause", &[], AT_S, 1.5, &burst_answers(&burst)), &burst),
    ]
}

/// When something happens to the receiver, and for how long a case goes on then, s.
pub(super) struct ReceiverTimes {
    /// Of a board that has known UTC for a while.
    pub at_s: f64,
    /// Until it knows it again.
    pub rest_s: f64,
    /// Until a step of the receiver's clock is known.
    pub step_s: f64,
    /// Whether a core held for 0.1 s loses samples.
    pub loses: bool,
}

const ARRAYS: ReceiverTimes = ReceiverTimes { at_s: 2.9, rest_s: 2.9, step_s: 3.7, loses: true };

/// The satellite receiver, well and unwell; both clocks 50 ppm off in opposite senses.
pub(super) fn receiver(times: &ReceiverTimes) -> Vec<Case> {
    let clocks =
        Parameters { board_clock_error: 5e-5, converter_clock_error: -5e-5, ..Parameters::default() };
    let with = |name: &str, faults: &[InjectedFault], event_s: f64, seconds: f64, wanted: &[Wanted]| {
        let case = case(&format!("receiver: {name}"), faults, event_s, seconds, wanted);
        Case { setup: Setup { parameters: clocks, receiver_s: seconds + 1.0, ..case.setup }, ..case }
    };
    let time = Wanted::Time;
    let &ReceiverTimes { at_s: at, rest_s, step_s, loses } = times;
    let end = at + rest_s;
    let gap = [Wanted::Fault(FaultCode::Gap, None), time];
    vec![
        with("well", &[], 0.0, at + 2.1, &[time, time, time]),
        with("no pulse for 2 s", &[InjectedFault::PulseLost(at, 2.0)], at, end + 1.0, &[time]),
        with("a false pulse before the sentence", &[InjectedFault::PulseGlitch(at + 0.32)], at, end, &[time]),
        with("a wrong second", &[InjectedFault::SecondWrong(at)], at, end, &[time]),
        with("noise in its sentences for 2 s", &[InjectedFault::SentenceNoise(at, 2.0)], at, end, &[time]),
        with(
            "its clock steps by a second",
            &[InjectedFault::ClockStep(at)],
            at,
            end + 1.0,
            &[Wanted::Fault(FaultCode::ClockStepped, None), time],
        ),
        with(
            "core held for 0.1 s",
            &[InjectedFault::CoreHeld(at, 0.1)],
            at,
            end,
            if loses { &gap } else { &gap[1..] },
        ),
        with(
            "its clock steps by a second, and reset pin once that is known",
            &[InjectedFault::ClockStep(at), InjectedFault::PinReset(at + step_s)],
            at,
            end + 2.0,
            &[Wanted::Fault(FaultCode::ClockStepped, None), time, Wanted::Start(PIN), time],
        ),
        with("reset pin", &[InjectedFault::PinReset(at)], at, end, &[Wanted::Start(PIN), time]),
        without_crystal(with(
            "reset pin, and no crystal for the clock on its cell",
            &[InjectedFault::PinReset(at)],
            at,
            end,
            &[Wanted::Start(PIN), time],
        )),
        // No receiver: the cell's clock alone goes on.
        told_once(case(
            "UTC told, reset pin, supply sags",
            &[InjectedFault::PinReset(2.0), InjectedFault::BrownOut(at + 0.1)],
            1.0,
            1.1 + rest_s,
            &[Wanted::Reply(1), Wanted::Start(PIN), time, Wanted::Start(BROWN_OUT), time],
        )),
    ]
}

fn without_crystal(case: Case) -> Case {
    let parameters = Parameters { crystal: false, ..case.setup.parameters };
    Case { setup: Setup { parameters, ..case.setup }, ..case }
}

/// UTC is told a second after power, to a tenth of a second; the crystal of the clock on its cell is wrong.
fn told_once(case: Case) -> Case {
    let parameters = Parameters { cell_clock_error: 1e-4, ..case.setup.parameters };
    let utc = Command::Utc { token: 1, utc_us: utc_us(1.0, &[]) as i64, sd_us: 100_000 };
    Case { setup: Setup { commands: line(&[(1.0, utc)]), parameters, ..case.setup }, ..case }
}

fn burst_answers(commands: &[(f64, Command)]) -> Vec<Wanted> {
    let last = match commands.last() {
        Some((_, Command::Start { token })) => *token,
        _ => 0,
    };
    vec![Wanted::Reply(1), Wanted::Reply(last)]
}
