//! An SD card on SDMMC1, four bits at 24 MHz, moved by the controller's own DMA and never waited for.
//!
//! Every call looks at the status register and, where something is done, begins the next: there is no interrupt. The
//! hardware library's driver waits in loops for commands and for the card's programming, which would hold the recorder for
//! as long as a card stalls. Commands and their order are those of the SD Physical Layer Simplified Specification (4.2 for
//! the start, 4.3.4 for writing); registers those of RM0433, chapter 55, from memory and from the library's driver, to be
//! checked on silicon.
//!
//! Wiring: data PC8 to PC11, clock PC12, command PD2; the lines are pulled up here. SDMMC1's DMA reaches AXI SRAM only.

use super::clock::now_us;
use crate::card::{Drive, Progress, SECTOR, Trouble};
use embassy_stm32::Peri;
use embassy_stm32::pac::{self, gpio, sdmmc::regs};
use embassy_stm32::peripherals::{PC8, PC9, PC10, PC11, PC12, PD2, SDMMC1};

/// What the card's hardware occupies.
pub type Claimed = (
    Peri<'static, SDMMC1>,
    (Peri<'static, PC8>, Peri<'static, PC9>, Peri<'static, PC10>, Peri<'static, PC11>),
    (Peri<'static, PC12>, Peri<'static, PD2>),
);

/// Twice these divide the kernel clock of 96 MHz: 400 kHz to find the card, 24 MHz afterwards.
const SLOW: u16 = 120;
const FAST: u16 = 2;
/// All flags that stay.
const FLAGS: u32 = 0x1fe0_0fff;
/// The clock runs for so long before the first command: at least 74 of its periods, and a millisecond.
const POWER_UP_US: u64 = 2_000;
/// Longest start of a card (4.2.3), and longest wait for its programming: twice what the specification allows a write.
const START_US: u64 = 1_000_000;
const BUSY_US: u64 = 1_000_000;
/// Data must move within so many periods of the clock, more than [`BUSY_US`].
const DATA_PERIODS: u32 = 48_000_000;
/// Steps that one call may make.
const MOST_STEPS: u8 = 4;
/// Bits of a card's status (R1) that are errors, and its state with the values "transfer", "receive" and "programming".
const ERRORS: u32 = 0xfdf9_8008;
const TRANSFER: u32 = 4;
/// Of the operating conditions: high capacity, ready, 3.2 to 3.4 V.
const HIGH_CAPACITY: u32 = 1 << 30;
const READY: u32 = 1 << 31;
const VOLTAGE: u32 = 3 << 20;
/// 3.3 V and a pattern that must come back.
const CONDITION: u32 = 0x1aa;

/// What kind of answer a command has.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Answer {
    None = 0,
    /// 48 bits with a checksum.
    Short = 1,
    /// Without.
    Unchecked = 2,
    Long = 3,
}

/// The command that is under way, or what else is.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Step {
    Off,
    PowerUp,
    Idle,
    Condition,
    /// An application's command is to come: the operating conditions, or the width of the bus.
    Application {
        width: bool,
    },
    Operate,
    Identify,
    Address,
    Select,
    Width,
    Data,
    Moving,
    Stop,
    Busy,
    Status,
    Rests,
    Failed(Trouble),
}

/// The card.
pub struct SdCard {
    _claimed: Claimed,
    step: Step,
    /// The card's address, in the upper half.
    rca: u32,
    /// When what is under way has taken too long, or may go on.
    due_us: u64,
    writes: bool,
}

fn bus() -> pac::sdmmc::Sdmmc {
    pac::SDMMC1
}

impl SdCard {
    /// Takes the pins; the card is started by [`Drive::restart`].
    pub fn new(claimed: Claimed) -> Self {
        pac::RCC.ahb4enr().modify(|w| {
            w.set_gpiocen(true);
            w.set_gpioden(true);
        });
        let data = [8, 9, 10, 11].map(|pin| (pac::GPIOC, pin, true));
        for (port, pin, pulled) in data.into_iter().chain([(pac::GPIOC, 12, false), (pac::GPIOD, 2, true)]) {
            let pull = if pulled { gpio::vals::Pupdr::PULL_UP } else { gpio::vals::Pupdr::FLOATING };
            port.pupdr().modify(|w| w.set_pupdr(pin, pull));
            port.afr(pin / 8).modify(|w| w.set_afr(pin % 8, 12));
            port.ospeedr().modify(|w| w.set_ospeedr(pin, gpio::vals::Ospeedr::VERY_HIGH_SPEED));
            port.moder().modify(|w| w.set_moder(pin, gpio::vals::Moder::ALTERNATE));
        }
        Self { _claimed: claimed, step: Step::Off, rca: 0, due_us: 0, writes: false }
    }

    /// Sends a command; `moves`: data follow its answer.
    fn command(&mut self, step: Step, index: u8, argument: u32, answer: Answer, moves: bool) {
        bus().icr().write_value(regs::Icr(FLAGS));
        bus().argr().write_value(regs::Argr(argument));
        bus().cmdr().write(|w| {
            w.set_cmdindex(index);
            w.set_waitresp(answer as u8);
            w.set_cmdtrans(moves);
            w.set_cmdstop(step == Step::Stop);
            w.set_cpsmen(true);
        });
        self.step = step;
    }

    /// Begins to move sectors between memory and the card.
    fn transfer(&mut self, sector: u32, memory: u32, bytes: usize, writes: bool) {
        self.writes = writes;
        self.due_us = now_us() + BUSY_US;
        bus().dtimer().write_value(regs::Dtimer(DATA_PERIODS));
        bus().dlenr().write(|w| w.set_datalength(bytes as u32));
        bus().dctrl().write(|w| {
            w.set_dblocksize(SECTOR.ilog2() as u8);
            w.set_dtdir(!writes);
        });
        bus().idmabase0r().write_value(regs::Idmabase0r(memory));
        bus().idmactrlr().write(|w| w.set_idmaen(true));
        // What was put into memory is there before the controller fetches it.
        cortex_m::asm::dsb();
        self.command(Step::Data, if writes { 25 } else { 18 }, sector, Answer::Short, true);
    }

    fn fail(&mut self, trouble: Trouble) -> Option<Progress> {
        self.step = Step::Failed(trouble);
        Some(Progress::Failed(trouble))
    }

    /// One step; what there is to say where nothing more can be done now.
    fn step(&mut self) -> Option<Progress> {
        match self.step {
            Step::Rests => return Some(Progress::Rests),
            Step::Failed(trouble) => return Some(Progress::Failed(trouble)),
            Step::Off => return self.fail(Trouble::NoCard),
            _ => {}
        }
        let status = bus().star().read();
        let late = now_us() >= self.due_us;
        match self.step {
            Step::PowerUp if late => {
                self.due_us = now_us() + START_US;
                self.command(Step::Idle, 0, 0, Answer::None, false);
                None
            }
            Step::PowerUp => Some(Progress::Working),
            Step::Moving => {
                let broken = [
                    status.dcrcfail(),
                    status.dtimeout(),
                    status.txunderr(),
                    status.rxoverr(),
                    status.idmate(),
                ];
                if broken.contains(&true) {
                    return self.fail(Trouble::Errors);
                }
                if status.dataend() {
                    self.command(Step::Stop, 12, 0, Answer::Short, false);
                    return None;
                }
                if late { self.fail(Trouble::Stalled) } else { Some(Progress::Working) }
            }
            Step::Busy => {
                if status.busyd0() {
                    return if late { self.fail(Trouble::Stalled) } else { Some(Progress::Working) };
                }
                self.command(Step::Status, 13, self.rca, Answer::Short, false);
                None
            }
            _ if status.cmdrend() || status.cmdsent() => {
                self.answered(bus().respr(0).read().cardstatus(), late)
            }
            // Conditions have no checksum: that it is none is no error.
            Step::Operate if status.ccrcfail() => self.answered(bus().respr(0).read().cardstatus(), late),
            _ if status.ctimeout() => self.fail(Trouble::NoCard),
            _ if status.ccrcfail() => self.fail(Trouble::Errors),
            _ => Some(Progress::Working),
        }
    }

    /// A command was carried out.
    fn answered(&mut self, answer: u32, late: bool) -> Option<Progress> {
        let is_status = matches!(
            self.step,
            Step::Application { .. } | Step::Select | Step::Width | Step::Data | Step::Stop | Step::Status
        );
        if is_status && answer & ERRORS != 0 {
            return self.fail(Trouble::Errors);
        }
        match self.step {
            Step::Idle => self.command(Step::Condition, 8, CONDITION, Answer::Short, false),
            Step::Condition if answer & 0xfff != CONDITION => return self.fail(Trouble::NotPrepared),
            Step::Condition => self.command(Step::Application { width: false }, 55, 0, Answer::Short, false),
            Step::Application { width: false } => {
                self.command(Step::Operate, 41, HIGH_CAPACITY | VOLTAGE, Answer::Unchecked, false);
            }
            Step::Operate if answer & READY == 0 => {
                if late {
                    return self.fail(Trouble::NotPrepared);
                }
                // Asked again at the next call.
                self.command(Step::Application { width: false }, 55, 0, Answer::Short, false);
                return Some(Progress::Working);
            }
            Step::Operate if answer & HIGH_CAPACITY == 0 => return self.fail(Trouble::NotPrepared),
            Step::Operate => self.command(Step::Identify, 2, 0, Answer::Long, false),
            Step::Identify => self.command(Step::Address, 3, 0, Answer::Short, false),
            Step::Address => {
                self.rca = answer & 0xffff_0000;
                self.command(Step::Select, 7, self.rca, Answer::Short, false);
            }
            Step::Select => {
                self.command(Step::Application { width: true }, 55, self.rca, Answer::Short, false)
            }
            Step::Application { width: true } => self.command(Step::Width, 6, 2, Answer::Short, false),
            Step::Width => {
                bus().clkcr().write(|w| {
                    w.set_clkdiv(FAST);
                    w.set_widbus(1);
                    w.set_hwfc_en(true);
                });
                self.step = Step::Rests;
            }
            Step::Data => self.step = Step::Moving,
            Step::Stop => self.step = Step::Busy,
            Step::Status if answer >> 9 & 15 == TRANSFER => {
                bus().idmactrlr().write(|_| {});
                bus().icr().write_value(regs::Icr(FLAGS));
                self.step = Step::Rests;
            }
            // Still programming: asked again at the next call.
            _ => {
                if late {
                    return self.fail(Trouble::Stalled);
                }
                self.command(Step::Status, 13, self.rca, Answer::Short, false);
                return Some(Progress::Working);
            }
        }
        None
    }
}

impl Drive for SdCard {
    fn poll(&mut self) -> Progress {
        for _ in 0..MOST_STEPS {
            if let Some(progress) = self.step() {
                return progress;
            }
        }
        Progress::Working
    }

    fn begin_write(&mut self, sector: u32, bytes: &[u8]) {
        self.transfer(sector, bytes.as_ptr() as u32, bytes.len(), true);
    }

    fn begin_read(&mut self, sector: u32, into: &mut [u8]) {
        self.transfer(sector, into.as_mut_ptr() as u32, into.len(), false);
    }

    fn restart(&mut self) {
        // A reset ends whatever was under way.
        pac::RCC.ahb3enr().modify(|w| w.set_sdmmc1en(true));
        pac::RCC.ahb3rstr().modify(|w| w.set_sdmmc1rst(true));
        pac::RCC.ahb3rstr().modify(|w| w.set_sdmmc1rst(false));
        bus().clkcr().write(|w| {
            w.set_clkdiv(SLOW);
            w.set_hwfc_en(true);
        });
        bus().power().write(|w| w.set_pwrctrl(3));
        self.step = Step::PowerUp;
        self.due_us = now_us() + POWER_UP_US;
    }

    fn now_us(&mut self) -> u64 {
        now_us()
    }
}
