//! The ocean-bottom board's line, receiver, supply and flash rehearsed: as the array's, at its own pace, and a configuration with a
//! propagation table sent to it.

use super::cases::{
    BROWN_OUT, Case, POWER, ReceiverTimes, SOFTWARE, case, line, linked, receiver, with_store,
};
use super::judge::Wanted;
use super::{cuts, ocean_bottom};
use crate::board::{InjectedFault, Setup};
use anyhow::{Result, anyhow};
use seabearing_board_model::stm32h743::Parameters;
use seabearing_core::config::{Schedule, StationConfig};
use seabearing_core::config_blob::{self, CRC, PROPAGATION, Writer};
use seabearing_core::wire::configure::{self, Configure};
use seabearing_core::wire::guard::COMMAND_BYTES;
use seabearing_core::wire::{Command, Encoder, FaultCode};

/// When commands come and what else is done to the board.
const AT_S: f64 = 2.0;
/// From one order of a new configuration to the next: nobody here waits for answers.
const ORDER_S: f64 = 0.15;
/// Its place is erased first.
const ERASED_S: f64 = 0.5;
/// From the last order to the reset that shows what was kept.
const KEPT_S: f64 = 6.0;

/// A case as this board plays it.
fn here(case: Case) -> Case {
    let of = case.setup.parameters;
    let here = ocean_bottom::parameters();
    let parameters = Parameters { seismic: here.seismic, baud: here.baud, ..of };
    linked("ocean bottom", Case { setup: Setup { parameters, ..case.setup }, ..case })
}

/// Everything about how it is reached; in short what no other board has.
pub(super) fn reach(blob: &[u8], most_cuts: u32, short: bool) -> Result<Vec<Case>> {
    let times = ReceiverTimes { at_s: 5.9, rest_s: 9.0, step_s: 5.7, loses: false };
    let mut cases = receiver(&times);
    if short {
        cases.truncate(1);
    } else {
        cases.extend(commands());
    }
    cases.extend(with_store(&cuts(Some(most_cuts))));
    let mut cases: Vec<Case> = cases.into_iter().map(here).collect();
    cases.push(here(reconfigured(blob)?));
    cases.push(here(scheduled(blob)?));
    if !short {
        cases.extend(cut_while_reconfigured(blob)?.map(here));
    }
    Ok(cases)
}

/// The line in both directions, and the supply.
fn commands() -> Vec<Case> {
    let with = |case: Case, commands: &[(f64, Command)]| Case {
        setup: Setup { commands: line(commands), ..case.setup },
        ..case
    };
    let told = [
        Wanted::Reply(1),
        Wanted::End,
        Wanted::Waits,
        Wanted::Waits,
        Wanted::Reply(2),
        Wanted::Reply(3),
        Wanted::Start(SOFTWARE),
    ];
    let low = [
        Wanted::Fault(FaultCode::SupplyLow, None),
        Wanted::End,
        Wanted::Waits,
        Wanted::Margins(2790, 2810),
        Wanted::Start(SOFTWARE),
    ];
    let noise = InjectedFault::LineNoise(AT_S, 0.5);
    let sags = InjectedFault::BrownOut(AT_S);
    vec![
        with(
            case("Stop, Identify, Start", &[], AT_S, 6.0, &told),
            &[
                (AT_S, Command::Stop { token: 1 }),
                (AT_S + 1.0, Command::Identify { token: 2 }),
                (AT_S + 2.0, Command::Start { token: 3 }),
            ],
        ),
        with(
            case("noise on the line for 0.5 s, then a command", &[noise], AT_S, 4.0, &[Wanted::Reply(1)]),
            &[(AT_S + 1.0, Command::Start { token: 1 })],
        ),
        case("supply low for a second", &[InjectedFault::SupplyLow(AT_S, 1.0)], AT_S, AT_S + 9.0, &low),
        case("supply sags", &[sags], AT_S, 4.0, &[Wanted::Start(BROWN_OUT)]),
    ]
}

/// The same station with something else, propagation table and all: its blob and its hash.
fn changed(blob: &[u8], change: impl FnOnce(&mut StationConfig)) -> Result<(Vec<u8>, u64)> {
    let wrong = |e| anyhow!("configuration blob: {e}");
    let mut config = config_blob::station(blob).map_err(wrong)?;
    change(&mut config);
    let table = config_blob::section(blob, PROPAGATION).map_err(wrong)?;
    let mut bytes = vec![0; blob.len() + 128];
    let mut writer = Writer::new(&mut bytes).map_err(wrong)?;
    writer.station(&config).map_err(wrong)?;
    let copy = |body: &mut [u8]| {
        body.get_mut(..table.len())?.copy_from_slice(table);
        Some(table.len())
    };
    writer.section(PROPAGATION, copy).map_err(wrong)?;
    let length = writer.finish();
    bytes.truncate(length);
    Ok((bytes, config.hash()))
}

/// What a base station sends: when, s, and the bytes.
type Orders = Vec<(f64, Vec<u8>)>;

/// The orders that bring a configuration, and when the last of them goes, s.
fn orders(blob: &[u8]) -> Result<(Orders, f64)> {
    let mut encoder = Encoder::default();
    let mut frame = |order: Configure| {
        let mut buffer = [0; COMMAND_BYTES];
        [&[0], encoder.frame_of(order.encode(&mut buffer))].concat()
    };
    let length = u32::try_from(blob.len())?;
    let mut commands = vec![(AT_S, frame(Configure::Begin { token: 1, length, crc: CRC.checksum(blob) }))];
    let mut at_s = AT_S + ERASED_S;
    for (number, bytes) in (0..).zip(configure::pieces(blob)) {
        commands.push((at_s, frame(Configure::Piece { token: 2, number, bytes })));
        at_s += ORDER_S;
    }
    commands.push((at_s, frame(Configure::Take { token: 3 })));
    Ok((commands, at_s))
}

/// Another configuration comes over the line, is tried, and is still there after a reset.
fn reconfigured(blob: &[u8]) -> Result<Case> {
    let name = "sent over the link".try_into().map_err(|_| anyhow!("the name is too long"))?;
    let (blob, hash) = changed(blob, |config| config.name = name)?;
    let (commands, last_s) = orders(&blob)?;
    let reset_s = last_s + KEPT_S;
    // Of the start with it, and of that after the reset.
    let wanted = [Wanted::Reply(3), Wanted::Runs(hash), Wanted::Runs(hash)];
    let name = format!("{} bytes of configuration sent, then reset pin", blob.len());
    let case = case(&name, &[InjectedFault::PinReset(reset_s)], last_s, reset_s + 3.0, &wanted);
    Ok(Case { setup: Setup { commands, ..case.setup }, sent: Some(blob), ..case })
}

/// Power is cut in the midst of another configuration's coming, and what comes of it afterwards is no configuration.
fn cut_while_reconfigured(blob: &[u8]) -> Result<[Case; 2]> {
    /// Of some 900 words, and a while before it, s.
    const WORK: u32 = 500;
    const BEFORE_S: f64 = 10.0;
    let name = "never whole".try_into().map_err(|_| anyhow!("the name is too long"))?;
    let (other, _) = changed(blob, |config| config.name = name)?;
    let (commands, last_s) = orders(&other)?;
    let own = config_blob::station(blob).map_err(|e| anyhow!("configuration blob: {e}"))?.hash();
    let name = "power cut in the midst of a configuration that is sent";
    let cut = InjectedFault::FlashCut(WORK);
    let case = case(name, &[cut], BEFORE_S, last_s + KEPT_S, &[Wanted::Resumes(POWER, own)]);
    let case = Case { setup: Setup { commands, ..case.setup }, sent: Some(other), ..case };
    // The order to take what is not whole is answered.
    let name = format!("{}: the order to take it", case.name);
    Ok([case.clone(), Case { name, event_s: last_s, wanted: vec![Wanted::Reply(3)], ..case }])
}

/// Another configuration by which it listens for ten seconds of every twenty.
fn scheduled(blob: &[u8]) -> Result<Case> {
    let (blob, _) = changed(blob, |config| config.schedule = Schedule { every_s: 20, on_s: 10 })?;
    let (commands, last_s) = orders(&blob)?;
    let wanted = [Wanted::Fault(FaultCode::Paused, Some(500))];
    let case = case("a schedule sent: 10 s of every 20", &[], last_s + 5.0, last_s + 90.0, &wanted);
    Ok(Case { setup: Setup { commands, ..case.setup }, sent: Some(blob), ..case })
}
