//! What can be made to go wrong on the modelled board, and when.

use super::ticks;
use anyhow::{Context, Result};
use seabearing_board_model::Machine;
use seabearing_board_model::ads1282::Ads1282s;
use seabearing_board_model::core::nvic::number::HARD_FAULT;
use seabearing_board_model::sd_card::Cut;
use seabearing_board_model::stm32h743::{Stm32h743, cause};
use seabearing_board_model::time::Ticks;

/// Something that goes wrong while the board runs. What a satellite receiver does wrong is rehearsed only: the host, with
/// which `twin` compares, hears none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum InjectedFault {
    /// The converter resets itself at this second.
    ConverterReset(f64),
    /// A bit of the converter's clock register flips at this second: half the samples a second.
    ConverterUpset(f64),
    /// A bit of the converter's gain flips at this second: one channel twice as loud; a bit of chip 0's on the ocean-bottom board.
    ConverterGain(f64),
    /// The converter's filters begin afresh at this second, as by a pulse on SYNC; so long after a conversion as this is after a whole
    /// number of them.
    ConverterResync(f64),
    /// The converter's clock stops at this second for so many conversions; nothing is reset.
    ConverterStops(f64, f64),
    /// Something else than the converter turns its data-ready line round at this second, for so many seconds.
    ConverterGlitch(f64, f64),
    /// The converter is dead from this second on, for so many seconds.
    ConverterDead(f64, f64),
    /// One chip of the ocean-bottom board is dead from this second on, for so many seconds.
    ChipDead(u8, f64, f64),
    /// One chip of the ocean-bottom board resets itself at this second.
    ChipReset(u8, f64),
    /// A bit of that chip's gain flips at this second.
    ChipUpset(u8, f64),
    /// Every so many bytes one bit is wrong on the way from the converter.
    SpiBits(u64),
    /// The line from the converter is cut at this second, for so many seconds; it goes on converting.
    ConverterMute(f64, f64),
    /// The core is held at this second, for so many seconds; everything else goes on.
    CoreHeld(f64, f64),
    /// The core takes a hard fault at this second.
    HardFault(f64),
    /// The software panics at this second, in line [`PANIC_LINE`].
    Panic(f64),
    /// At this second a bit changes in what the recorder worked out of its configuration: this one of those that a fixed seed chooses.
    SettingsBit(f64, u64),
    /// At this second one bit of a word of memory is wrong, and is corrected: this one of those that a fixed seed chooses.
    MemoryBit(f64, u64),
    /// At this second two bits of a word of what changes while it records are wrong, which cannot be corrected.
    MemoryBits(f64, u64),
    /// No phase-locked loop locks that is switched on from this second on, for so many seconds.
    ClocksFail(f64, f64),
    /// The reset pin is pulled at this second.
    PinReset(f64),
    /// The supply sags at this second.
    BrownOut(f64),
    /// The supply is low from this second on, for so many seconds, but not so low that the core is reset.
    SupplyLow(f64, f64),
    /// The telemetry line brings noise from this second on, for so many seconds: bytes, half of them broken, without a pause.
    LineNoise(f64, f64),
    /// Power fails in the middle of this programming or erasing of the flash, counted from the first, and comes back at once.
    FlashCut(u32),
    /// One bit goes wrong in every flash word that was written by this second.
    FlashBits(f64),
    /// From this second on whoever reads the second bank of the flash takes a hard fault.
    FlashCrash(f64),
    /// The satellite receiver gives no pulses from this second on, for so many seconds; its sentences go on.
    PulseLost(f64, f64),
    /// A pulse that is none, at this second.
    PulseGlitch(f64),
    /// The sentence at this second names the one after it.
    SecondWrong(f64),
    /// Sentences are damaged from this second on, for so many seconds.
    SentenceNoise(f64, f64),
    /// The receiver's clock is a second further from this second on.
    ClockStep(f64),
    /// The card is busy at this second, for so many seconds.
    CardStall(f64, f64),
    /// The card is not in its holder from this second on, for so many seconds.
    CardPulled(f64, f64),
    /// The card refuses what it is sent from this second on, for so many seconds.
    CardErrors(f64, f64),
    /// Power fails in the middle of the writing of this sector of the card, counted from the first, and comes back at once.
    CardCut(u64),
}

/// What a run has that faults may befall.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Has {
    /// It is of the ocean-bottom board.
    pub seismic: bool,
    /// Records wait in flash.
    pub link: bool,
    /// There is a holder for a card.
    pub card: bool,
}

impl InjectedFault {
    /// Whether it can happen in such a run.
    pub fn can_happen(&self, has: &Has) -> bool {
        match self {
            Self::ChipDead(..) | Self::ChipReset(..) | Self::ChipUpset(..) => has.seismic,
            Self::FlashCut(_) | Self::FlashBits(_) | Self::FlashCrash(_) => has.link,
            Self::ClocksFail(..) | Self::ConverterResync(_) => !has.seismic,
            Self::CardStall(..) | Self::CardPulled(..) | Self::CardErrors(..) | Self::CardCut(_) => has.card,
            _ => true,
        }
    }
}

impl InjectedFault {
    /// When it begins, s; `None` where that follows from what the board does.
    pub fn begins_s(&self) -> Option<f64> {
        match *self {
            Self::SpiBits(_) => Some(0.0),
            Self::FlashCut(_) | Self::CardCut(_) => None,
            Self::ConverterReset(at)
            | Self::ConverterUpset(at)
            | Self::ConverterGain(at)
            | Self::ConverterResync(at)
            | Self::ConverterStops(at, _)
            | Self::ConverterGlitch(at, _)
            | Self::ConverterDead(at, _)
            | Self::ChipDead(_, at, _)
            | Self::ChipReset(_, at)
            | Self::ChipUpset(_, at)
            | Self::ConverterMute(at, _)
            | Self::CoreHeld(at, _)
            | Self::HardFault(at)
            | Self::Panic(at)
            | Self::SettingsBit(at, _)
            | Self::MemoryBit(at, _)
            | Self::MemoryBits(at, _)
            | Self::ClocksFail(at, _)
            | Self::PinReset(at)
            | Self::BrownOut(at)
            | Self::SupplyLow(at, _)
            | Self::LineNoise(at, _)
            | Self::FlashBits(at)
            | Self::FlashCrash(at)
            | Self::PulseLost(at, _)
            | Self::PulseGlitch(at)
            | Self::SecondWrong(at)
            | Self::SentenceNoise(at, _)
            | Self::ClockStep(at)
            | Self::CardStall(at, _)
            | Self::CardPulled(at, _)
            | Self::CardErrors(at, _) => Some(at),
        }
    }
}

/// The line in the source that an injected panic names.
pub const PANIC_LINE: u32 = 4711;

/// What [`InjectedFault`] is read from.
const KINDS: &str = "converter-reset@S, converter-upset@S, converter-gain@S, converter-resync@S, converter-stops@S:CONVERSIONS, \
                     converter-glitch@S:LENGTH, converter-dead@S or @S:LENGTH, converter-mute@S:LENGTH, \
                     core-held@S:LENGTH, line-noise@S:LENGTH, supply-low@S:LENGTH, hard-fault@S, panic@S, settings-bit@S:N, memory-bit@S:N, memory-bits@S:N, clocks-fail@S:LENGTH, pin-reset@S, brown-out@S, \
                     flash-cut@WORK, flash-bits@S, flash-crash@S, card-stall@S:LENGTH, card-pulled@S or @S:LENGTH, \
                     card-errors@S:LENGTH, card-cut@SECTOR, spi-bits@BYTES, or of the ocean-bottom board's chips N, 0 to 3, \
                     chipN-dead@S or @S:LENGTH, chipN-reset@S, chipN-upset@S";

impl std::str::FromStr for InjectedFault {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let read = || {
            let (kind, at) = text.split_once('@')?;
            if kind == "spi-bits" {
                return at.parse().ok().filter(|n| *n > 0).map(Self::SpiBits);
            }
            if kind == "flash-cut" {
                return at.parse().ok().map(Self::FlashCut);
            }
            if kind == "card-cut" {
                return at.parse().ok().map(Self::CardCut);
            }
            let seconds = |text: &str| text.parse().ok().filter(|s: &f64| *s >= 0.0 && s.is_finite());
            let (at, length) = match at.split_once(':') {
                Some((at, length)) => (seconds(at)?, Some(seconds(length)?)),
                None => (seconds(at)?, None),
            };
            if let Some((chip, what)) = kind.strip_prefix("chip").and_then(|rest| rest.split_once('-')) {
                let chip = chip.parse().ok().filter(|chip| *chip < 4)?;
                return match (what, length) {
                    ("dead", length) => Some(Self::ChipDead(chip, at, length.unwrap_or(f64::INFINITY))),
                    ("reset", None) => Some(Self::ChipReset(chip, at)),
                    ("upset", None) => Some(Self::ChipUpset(chip, at)),
                    _ => None,
                };
            }
            Some(match (kind, length) {
                ("converter-reset", None) => Self::ConverterReset(at),
                ("converter-upset", None) => Self::ConverterUpset(at),
                ("converter-gain", None) => Self::ConverterGain(at),
                ("converter-resync", None) => Self::ConverterResync(at),
                ("converter-stops", Some(conversions)) => Self::ConverterStops(at, conversions),
                ("converter-glitch", Some(length)) => Self::ConverterGlitch(at, length),
                ("converter-dead", length) => Self::ConverterDead(at, length.unwrap_or(f64::INFINITY)),
                ("converter-mute", length) => Self::ConverterMute(at, length.unwrap_or(f64::INFINITY)),
                ("supply-low", Some(length)) => Self::SupplyLow(at, length),
                ("core-held", Some(length)) => Self::CoreHeld(at, length),
                ("card-stall", Some(length)) => Self::CardStall(at, length),
                ("card-pulled", length) => Self::CardPulled(at, length.unwrap_or(f64::INFINITY)),
                ("card-errors", Some(length)) => Self::CardErrors(at, length),
                ("line-noise", Some(length)) => Self::LineNoise(at, length),
                ("hard-fault", None) => Self::HardFault(at),
                ("panic", None) => Self::Panic(at),
                ("settings-bit", Some(n)) if n.fract() == 0.0 => Self::SettingsBit(at, n as u64),
                ("memory-bit", Some(n)) if n.fract() == 0.0 => Self::MemoryBit(at, n as u64),
                ("memory-bits", Some(n)) if n.fract() == 0.0 => Self::MemoryBits(at, n as u64),
                ("clocks-fail", Some(length)) => Self::ClocksFail(at, length),
                ("pin-reset", None) => Self::PinReset(at),
                ("brown-out", None) => Self::BrownOut(at),
                ("flash-bits", None) => Self::FlashBits(at),
                ("flash-crash", None) => Self::FlashCrash(at),
                _ => return None,
            })
        };
        read().ok_or_else(|| format!("`{text}`: {KINDS}"))
    }
}

/// A [`InjectedFault`] that has a beginning and an end in the machine's time.
pub(super) struct Due {
    pub at: Ticks,
    fault: InjectedFault,
    ends: bool,
}

/// What happens when; what is so from the start happens now.
pub(super) fn schedule(machine: &mut Machine<Stm32h743>, faults: &[InjectedFault]) -> Vec<Due> {
    let mut due = Vec::new();
    for &fault in faults {
        let (at, length) = match fault {
            InjectedFault::SpiBits(every) => {
                machine.board.converter.bit_errors_every = every;
                machine.board.seismic.iter_mut().for_each(|chips| chips.bit_errors_every = every);
                continue;
            }
            InjectedFault::FlashCut(number) => {
                machine.board.flash.cut_at = Some(number);
                continue;
            }
            InjectedFault::CardCut(sector) => {
                let bytes = (mix(sector) % 512) as usize;
                machine.board.card.cut = Some(Cut { sector, bytes });
                continue;
            }
            InjectedFault::CardStall(at, length) => {
                machine.board.card.stalls.push((ticks(at), ticks(length)));
                continue;
            }
            InjectedFault::ConverterGlitch(at, length) => {
                let board = &mut machine.board;
                let chips = board.seismic.as_mut().map(|chips| &mut chips.glitches);
                chips.unwrap_or(&mut board.converter.glitches).push_back((ticks(at), ticks(length)));
                continue;
            }
            InjectedFault::LineNoise(..)
            | InjectedFault::PulseLost(..)
            | InjectedFault::PulseGlitch(_)
            | InjectedFault::SecondWrong(_)
            | InjectedFault::SentenceNoise(..)
            | InjectedFault::ClockStep(_) => continue,
            InjectedFault::CardPulled(at, length)
            | InjectedFault::CardErrors(at, length)
            | InjectedFault::ConverterDead(at, length)
            | InjectedFault::ChipDead(_, at, length)
            | InjectedFault::ConverterMute(at, length)
            | InjectedFault::ClocksFail(at, length)
            | InjectedFault::SupplyLow(at, length) => (at, length),
            InjectedFault::ConverterReset(at)
            | InjectedFault::ConverterUpset(at)
            | InjectedFault::ConverterGain(at)
            | InjectedFault::ConverterResync(at)
            | InjectedFault::ConverterStops(at, _)
            | InjectedFault::ChipReset(_, at)
            | InjectedFault::ChipUpset(_, at)
            | InjectedFault::CoreHeld(at, _)
            | InjectedFault::HardFault(at)
            | InjectedFault::Panic(at)
            | InjectedFault::SettingsBit(at, _)
            | InjectedFault::MemoryBit(at, _)
            | InjectedFault::MemoryBits(at, _)
            | InjectedFault::PinReset(at)
            | InjectedFault::FlashBits(at)
            | InjectedFault::FlashCrash(at)
            | InjectedFault::BrownOut(at) => (at, f64::INFINITY),
        };
        due.push(Due { at: ticks(at), fault, ends: false });
        if length.is_finite() {
            due.push(Due { at: ticks(at + length), fault, ends: true });
        }
    }
    due
}

/// Bytes for the board, some of which are broken, and when the first of them comes.
pub(super) type Sent = (Ticks, Vec<(u8, bool)>);

/// Everything on the line to the board, in order: commands, and noise at `baud` bits a second.
pub(super) fn to_the_board(commands: &[(f64, Vec<u8>)], faults: &[InjectedFault], baud: u32) -> Vec<Sent> {
    let mut all: Vec<(f64, Vec<(u8, bool)>)> =
        commands.iter().map(|(at, bytes)| (*at, bytes.iter().map(|b| (*b, false)).collect())).collect();
    all.extend(faults.iter().filter_map(|fault| match *fault {
        InjectedFault::LineNoise(at, length) => {
            let bytes = (length * f64::from(baud) / 10.0) as u64;
            Some((at, (0..bytes).map(|n| (mix(n) as u8, mix(n) & 0x100 != 0)).collect()))
        }
        _ => None,
    }));
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all.into_iter().map(|(at, bytes)| (ticks(at), bytes)).collect()
}

/// A number that has nothing to do with its neighbours' (the finaliser of SplitMix64).
pub(crate) fn mix(n: u64) -> u64 {
    let x = n.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}

pub(super) fn inject(machine: &mut Machine<Stm32h743>, due: &Due) -> Result<()> {
    /// Most significant bit of the oversampling in the converter's clock register: 64 becomes ... of the next kind.
    const OVERSAMPLING_BIT: u32 = 5;
    const CLOCK: usize = 3;
    const GAIN: usize = 4;
    let now = machine.now();
    if let Some(chips) = &mut machine.board.seismic
        && disturb(chips, due, now)
    {
        return Ok(());
    }
    let converter = &mut machine.board.converter;
    match due.fault {
        InjectedFault::ConverterReset(_) => converter.reset(now),
        InjectedFault::ConverterUpset(_) => converter.upset(CLOCK, OVERSAMPLING_BIT, now),
        InjectedFault::ConverterGain(_) => converter.upset(GAIN, 0, now),
        InjectedFault::ConverterResync(at) => converter.resynchronise_in_phase(ticks(at)),
        InjectedFault::ConverterStops(_, conversions) => converter.stop_clock(conversions),
        InjectedFault::ConverterDead(..) => converter.set_dead(!due.ends, now),
        InjectedFault::ConverterMute(..) => converter.mute = !due.ends,
        InjectedFault::CoreHeld(_, length) => {
            machine.hold(now + ticks(length)).map_err(anyhow::Error::msg)?
        }
        InjectedFault::CardPulled(..) => {
            machine.board.card.present = due.ends;
            machine.board.card.power();
        }
        InjectedFault::CardErrors(..) => machine.board.card.errs = !due.ends,
        InjectedFault::SupplyLow(..) => machine.board.set_supply_low(!due.ends),
        InjectedFault::HardFault(_) => machine.nvic.pend(HARD_FAULT),
        InjectedFault::Panic(_) => panic(machine)?,
        InjectedFault::SettingsBit(_, n) => settings_bit(machine, n)?,
        InjectedFault::MemoryBit(_, n) => memory_bits(machine, n, true)?,
        InjectedFault::MemoryBits(_, n) => memory_bits(machine, n, false)?,
        InjectedFault::ClocksFail(..) => machine.board.set_loops_lock(due.ends),
        InjectedFault::FlashCrash(_) => machine.board.flash.crashes = true,
        InjectedFault::PinReset(_) => machine.reset(|board| board.reset(cause::PIN)),
        InjectedFault::BrownOut(_) => machine.reset(|board| board.reset(cause::BROWN_OUT)),
        InjectedFault::FlashBits(_) => {
            let words: Vec<usize> = machine.board.flash.written().collect();
            words.into_iter().for_each(|word| machine.board.flash.upset(word, 1));
        }
        // There from the start, or another board's.
        InjectedFault::ChipDead(..)
        | InjectedFault::ChipReset(..)
        | InjectedFault::ChipUpset(..)
        | InjectedFault::SpiBits(_)
        | InjectedFault::ConverterGlitch(..)
        | InjectedFault::FlashCut(_)
        | InjectedFault::LineNoise(..)
        | InjectedFault::PulseLost(..)
        | InjectedFault::PulseGlitch(_)
        | InjectedFault::SecondWrong(_)
        | InjectedFault::SentenceNoise(..)
        | InjectedFault::ClockStep(_)
        | InjectedFault::CardStall(..)
        | InjectedFault::CardCut(_) => {}
    }
    Ok(())
}

/// What happens to seismic converters; whether it is of their kind.
fn disturb(chips: &mut Ads1282s, due: &Due, now: Ticks) -> bool {
    const CONFIG0: usize = 1;
    const CONFIG1: usize = 2;
    /// Lowest bit of the rate.
    const RATE_BIT: u32 = 3;
    match due.fault {
        InjectedFault::ConverterReset(_) => chips.reset_chips(None, now),
        InjectedFault::ConverterUpset(_) => chips.upset(0, CONFIG0, RATE_BIT, now),
        InjectedFault::ConverterDead(..) => chips.set_dead(None, !due.ends, now),
        InjectedFault::ConverterMute(..) => chips.mute = !due.ends,
        InjectedFault::ConverterStops(_, conversions) => chips.stop_clock(conversions),
        InjectedFault::ChipDead(chip, ..) => chips.set_dead(Some(chip.into()), !due.ends, now),
        InjectedFault::ChipReset(chip, _) => chips.reset_chips(Some(chip.into()), now),
        InjectedFault::ConverterGain(_) => chips.upset(0, CONFIG1, 1, now),
        InjectedFault::ChipUpset(chip, _) => chips.upset(chip.into(), CONFIG1, 1, now),
        _ => return false,
    }
    true
}

/// Goes on in the function that ends a failed `Option::unwrap`, whose one argument is where in the source that was: four
/// words (file, its length, line, column) in memory that the image does not use.
fn panic(machine: &mut Machine<Stm32h743>) -> Result<()> {
    const FREE: u32 = 0x3004_0000;
    const FILE: &[u8] = b"injected";
    let place = [FREE + 16, FILE.len() as u32, PANIC_LINE, 1];
    let bytes: Vec<u8> = place.iter().flat_map(|w| w.to_le_bytes()).chain(FILE.iter().copied()).collect();
    let to = machine.memory.bytes_mut(FREE, bytes.len() as u32).context("no memory for a panic's place")?;
    to.copy_from_slice(&bytes);
    let function =
        machine.image().address_of("unwrap_failed").context("the image has no `unwrap` that could panic")?;
    machine.call(function, [FREE, 0, 0, 0]);
    Ok(())
}

/// Flips a bit of the recorder's settings, whose place the image tells.
fn settings_bit(machine: &mut Machine<Stm32h743>, n: u64) -> Result<()> {
    let place =
        machine.image().object("SETTLED_PLACE").context("the image does not tell its settings' place")?;
    let words = machine.memory.bytes(place, 8).context("no memory there")?.as_chunks::<4>().0;
    let (at, length) = (u32::from_le_bytes(words[0]), u32::from_le_bytes(words[1]));
    if length == 0 {
        anyhow::bail!("the recorder has no settings yet");
    }
    let bit = mix(n) % (8 * u64::from(length));
    let byte = machine.memory.bytes_mut(at + (bit / 8) as u32, 1).context("no memory there")?;
    byte.iter_mut().for_each(|byte| *byte ^= 1 << (bit % 8));
    Ok(())
}

/// One wrong bit in a word of the image's statics, which is read as if it were right, or two.
fn memory_bits(machine: &mut Machine<Stm32h743>, n: u64, corrected: bool) -> Result<()> {
    let symbol = |name| machine.image().symbol(name).with_context(|| format!("the image has no {name}"));
    let (from, to) = (symbol("__sbss")?, symbol("__ebss")?);
    let words = u64::from(to.saturating_sub(from) / 8).max(1);
    let at = (from & !7) + 8 * (mix(n) % words) as u32;
    if !corrected {
        let word = machine.memory.bytes_mut(at, 8).context("no memory there")?;
        let bits = mix(!n);
        word[0] ^= 1 << (bits % 8);
        word[4] ^= 1 << (bits / 8 % 8);
    }
    anyhow::ensure!(machine.board.wrong_bits(at, corrected), "no error correction at {at:#010x}");
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_read_as_the_help_says() {
        let read = |text: &str| text.parse::<InjectedFault>();
        assert_eq!(read("converter-dead@2"), Ok(InjectedFault::ConverterDead(2.0, f64::INFINITY)));
        assert_eq!(read("core-held@2:0.5"), Ok(InjectedFault::CoreHeld(2.0, 0.5)));
        assert_eq!(read("memory-bits@2:7"), Ok(InjectedFault::MemoryBits(2.0, 7)));
        assert_eq!(read("spi-bits@90"), Ok(InjectedFault::SpiBits(90)));
        assert_eq!(read("chip3-dead@2:1"), Ok(InjectedFault::ChipDead(3, 2.0, 1.0)));
        assert_eq!(read("chip0-upset@2"), Ok(InjectedFault::ChipUpset(0, 2.0)));
        for bad in [
            "converter-dead",
            "core-held@2",
            "panic@1:2",
            "spi-bits@0",
            "panic@-1",
            "panic@nan",
            "x@1",
            "chip4-dead@1",
        ] {
            assert!(read(bad).unwrap_err().contains("line-noise@S:LENGTH"), "{bad}");
        }
    }
}
