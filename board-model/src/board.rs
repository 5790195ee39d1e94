//! What the core asks of a board, and what a board may do to the core.

use crate::core::nvic::Nvic;
use crate::memory::Memory;
use crate::time::Ticks;

/// Width of an access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    /// 8 bits.
    Byte,
    /// 16 bits.
    Half,
    /// 32 bits.
    Word,
}

impl Width {
    /// Bytes of it.
    pub fn bytes(self) -> u32 {
        match self {
            Self::Byte => 1,
            Self::Half => 2,
            Self::Word => 4,
        }
    }
}

/// Why an access was not carried out.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The hardware answers with a bus fault.
    BusFault,
    /// The model does not know what the hardware would do, or the software did what a manual forbids.
    Stop(String),
}

impl Refusal {
    /// A refusal that ends the run with this reason.
    pub fn stop<T>(reason: impl Into<String>) -> Result<T, Self> {
        Err(Self::Stop(reason.into()))
    }
}

/// What a board may want of the machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Wish {
    /// Start again: the core is reset, memories keep what they hold.
    Reset,
    /// The core's clock now has this frequency.
    CoreHz(u64),
    /// The run has ended with this status.
    Exit(u32),
}

/// What a board reaches while it is asked something.
pub struct Bus<'a> {
    /// All memories.
    pub memory: &'a mut Memory,
    /// The interrupt controller.
    pub nvic: &'a mut Nvic,
    /// The time.
    pub now: Ticks,
    /// Whether the core runs from its clock while it sleeps, which keeps the cycle counter going.
    pub counts_asleep: &'a mut bool,
    /// What the board wants done after this instruction.
    pub wishes: &'a mut Vec<Wish>,
}

/// A board around the core.
pub trait Board {
    /// Reads a register.
    ///
    /// # Errors
    /// There is none, or it cannot be read now.
    fn read(&mut self, bus: &mut Bus<'_>, address: u32, width: Width) -> Result<u32, Refusal>;

    /// Writes a register.
    ///
    /// # Errors
    /// There is none, or it cannot be written now.
    fn write(&mut self, bus: &mut Bus<'_>, address: u32, value: u32, width: Width) -> Result<(), Refusal>;

    /// Does everything that is due by `bus.now`.
    ///
    /// # Errors
    /// Something happened that the software must not let happen.
    fn advance(&mut self, bus: &mut Bus<'_>) -> Result<(), Refusal>;

    /// When the board next wants to be advanced.
    fn next_event(&self) -> Ticks;

    /// Answers a semihosting call; `None` where the board has no host.
    fn semihosting(&mut self, _bus: &mut Bus<'_>, _operation: u32, _argument: u32) -> Option<u32> {
        None
    }

    /// The core's reset came from the software (`SYSRESETREQ`).
    fn software_reset(&mut self, bus: &mut Bus<'_>);

    /// The core's frequency after a reset.
    fn reset_hz(&self) -> u64;

    /// Instruction time in ticks of SysTick's clock: core cycles of one SysTick count.
    fn systick_cycles(&self) -> u64 {
        1
    }
}
