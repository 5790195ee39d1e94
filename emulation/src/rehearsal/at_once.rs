//! Things that go wrong at once, or before anything was measured: each is rehearsed alone too.

use super::AT_S;
use super::cases::{Case, SOFTWARE, case, wrong_clocks};
use super::judge::Wanted;
use crate::board::{InjectedFault, Setup};
use seabearing_core::wire::FaultCode;

/// Two things at once, and one before anything was measured; clocks as wrong as they may be.
pub(super) fn cases() -> impl Iterator<Item = Case> {
    let fault = |code| Wanted::Fault(code, None);
    let restarted = fault(FaultCode::ConverterRestarted);
    [
        case(
            "converter without supply for a second, 60 ms after power, clocks 1 % off",
            &[InjectedFault::ConverterDead(0.06, 1.0)],
            1.06,
            2.5,
            &[restarted],
        ),
        case(
            "converter without supply for 20 ms of 50 ms in which the core is held",
            &[InjectedFault::CoreHeld(AT_S, 0.05), InjectedFault::ConverterDead(AT_S + 0.01, 0.02)],
            AT_S,
            AT_S + 1.0,
            &[restarted],
        ),
        case(
            "line cut for 0.5 s, and the core held for 0.1 s of it",
            &[InjectedFault::ConverterMute(AT_S, 0.5), InjectedFault::CoreHeld(AT_S + 0.2, 0.1)],
            AT_S,
            AT_S + 1.5,
            &[fault(FaultCode::Gap), fault(FaultCode::Invalid)],
        ),
        case(
            "hard fault while the line to the converter is cut",
            &[InjectedFault::ConverterMute(AT_S, 0.5), InjectedFault::HardFault(AT_S + 0.2)],
            AT_S,
            AT_S + 2.0,
            &[
                // Missing samples are told when there are good ones again, which this session does not live to see.
                Wanted::Start(SOFTWARE),
                fault(FaultCode::HardFault),
                fault(FaultCode::NoSamples),
            ],
        ),
        case(
            "supply low for a second, and the converter without it",
            &[InjectedFault::SupplyLow(AT_S, 1.0), InjectedFault::ConverterDead(AT_S, 1.0)],
            AT_S,
            AT_S + 7.5,
            &[fault(FaultCode::SupplyLow), Wanted::End, Wanted::Waits, Wanted::Start(SOFTWARE)],
        ),
    ]
    .into_iter()
    .map(|case| Case { setup: Setup { parameters: wrong_clocks(), ..case.setup }, ..case })
}
