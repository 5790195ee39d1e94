//! What instructions and accesses take.

/// Cycles of the core beyond what is said elsewhere; the defaults are those of an ideal machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Costs {
    /// Every instruction, fetched from wherever.
    pub instruction: f64,
    /// A load or store of tightly coupled memory, in addition.
    pub tightly_coupled: f64,
    /// A load or store of AXI SRAM, in addition.
    pub axi: f64,
    /// A load or store of SRAM 1 to 4, in addition.
    pub sram: f64,
    /// A load of flash, in addition.
    pub flash: f64,
    /// A read or write of a peripheral's register, in addition.
    pub register: f64,
    /// A read or write of the core's own registers (interrupt controller, SysTick), in addition.
    pub system_register: f64,
    /// From an interrupt taken to its first instruction.
    pub interrupt_entry: f64,
    /// From one interrupt's end to the first instruction of the next without leaving.
    pub tail_chain: f64,
    /// From an interrupt's last instruction to the code interrupted.
    pub interrupt_exit: f64,
}

impl Costs {
    /// One cycle an instruction and nothing else.
    pub const IDEAL: Self = Self {
        instruction: 1.0,
        tightly_coupled: 0.0,
        axi: 0.0,
        sram: 0.0,
        flash: 0.0,
        register: 0.0,
        system_register: 0.0,
        interrupt_entry: 12.0,
        tail_chain: 6.0,
        interrupt_exit: 12.0,
    };
}

impl Default for Costs {
    fn default() -> Self {
        Self::IDEAL
    }
}
