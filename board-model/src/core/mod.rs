//! The core: registers, the loop that carries instructions out, and time.

mod code;
mod data;
mod exception;
mod execute;
mod float;
pub mod nvic;
mod system;
mod systick;
#[cfg(test)]
mod tests;
mod transfer;

use crate::board::{Board, Bus, Wish};
use crate::costs::Costs;
use crate::elf::Image;
use crate::instruction::Instruction;
use crate::memory::{Kind, Memory};
use crate::time::{NEVER, PER_SECOND, Ticks};
use code::Code;
use nvic::Nvic;

/// Work done in one mode.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Work {
    /// Instructions, those skipped in IT blocks included.
    pub instructions: u64,
    /// Loads of memory (of several registers: one each).
    pub loads: u64,
    /// Stores to memory.
    pub stores: u64,
    /// Reads of peripherals' registers.
    pub register_reads: u64,
    /// Writes of peripherals' registers.
    pub register_writes: u64,
    /// Time it took.
    pub ticks: Ticks,
}

impl Work {
    fn add(&mut self, other: Self) {
        self.instructions += other.instructions;
        self.loads += other.loads;
        self.stores += other.stores;
        self.register_reads += other.register_reads;
        self.register_writes += other.register_writes;
        self.ticks += other.ticks;
    }

    /// What was done since an earlier moment.
    pub fn since(&self, earlier: &Self) -> Self {
        Self {
            instructions: self.instructions - earlier.instructions,
            loads: self.loads - earlier.loads,
            stores: self.stores - earlier.stores,
            register_reads: self.register_reads - earlier.register_reads,
            register_writes: self.register_writes - earlier.register_writes,
            ticks: self.ticks - earlier.ticks,
        }
    }
}

/// What a run has cost so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// In interrupts and other exceptions.
    pub handlers: Work,
    /// Outside of them.
    pub thread: Work,
    /// Time asleep.
    pub asleep: Ticks,
    /// Interrupts taken.
    pub interrupts: u64,
    /// Resets of the core since power-on.
    pub resets: u32,
}

/// How a run came to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The time was up.
    Time,
    /// The software left with a status (semihosting).
    Exit(u32),
}

/// Something an instruction could not do.
#[derive(Clone, Debug)]
enum Trouble {
    Stop(String),
    Bus { address: u32, write: bool },
    Usage(u32),
    Supervisor,
}

/// A core and its board.
#[derive(Debug)]
pub struct Machine<B> {
    /// The board.
    pub board: B,
    /// Its memories.
    pub memory: Memory,
    /// Its interrupt controller.
    pub nvic: Nvic,
    image: Image,
    vectors: u32,
    costs: Costs,

    r: [u32; 16],
    pc: u32,
    next: u32,
    negative: bool,
    zero: bool,
    carry: bool,
    overflow: bool,
    saturated: bool,
    ge: u8,
    it: u8,
    /// The stack pointer that is not in use.
    other_sp: u32,
    /// Thread mode uses the process stack.
    process_stack: bool,
    unprivileged: bool,
    /// The active exception; 0 in thread mode.
    ipsr: u16,
    exclusive: Option<u32>,

    s: [u32; 32],
    fpscr: u32,
    /// Floating-point instructions need no look at the context.
    fp_ready: bool,
    /// The floating-point context is in use (CONTROL.FPCA).
    fp_active: bool,
    /// Registers are still to be saved for an interrupted context (FPCCR.LSPACT).
    lazy: bool,
    system: system::System,

    code: Code,
    other_code: Vec<Code>,

    now: Ticks,
    deadline: Ticks,
    instruction_ticks: Ticks,
    /// Ticks of a cycle.
    cycle: Ticks,
    sleeping: Option<Sleep>,
    trouble: Option<(u32, Trouble)>,
    wishes: Vec<Wish>,
    counts_asleep: bool,

    work: Work,
    work_began: Ticks,
    counts: Counts,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sleep {
    Interrupt,
    Event,
}

impl<B: Board> Machine<B> {
    /// A board with an image in its memory, at power-on. `cached` are stretches of memory whose instructions are kept
    /// decoded (start and length).
    ///
    /// # Errors
    /// The image does not fit the board.
    pub fn new(
        board: B,
        mut memory: Memory,
        image: Image,
        costs: Costs,
        cached: &[(u32, u32)],
    ) -> Result<Self, String> {
        image.load(&mut memory)?;
        let vectors = image.start();
        let mut code: Vec<Code> = cached
            .iter()
            .map(|&(base, size)| Code { base, slots: vec![Instruction::UNDECODED; size as usize / 2] })
            .collect();
        for area in &code {
            memory.guard(area.base);
        }
        let first = code.pop().unwrap_or_default();
        let hz = board.reset_hz();
        let mut machine = Self {
            board,
            memory,
            nvic: Nvic::default(),
            image,
            vectors,
            costs,
            r: [0; 16],
            pc: 0,
            next: 0,
            negative: false,
            zero: false,
            carry: false,
            overflow: false,
            saturated: false,
            ge: 0,
            it: 0,
            other_sp: 0,
            process_stack: false,
            unprivileged: false,
            ipsr: 0,
            exclusive: None,
            s: [0; 32],
            fpscr: 0,
            fp_ready: false,
            fp_active: false,
            lazy: false,
            system: system::System::default(),
            code: first,
            other_code: code,
            now: 0,
            deadline: 0,
            instruction_ticks: 0,
            cycle: 1,
            sleeping: None,
            trouble: None,
            wishes: Vec::new(),
            counts_asleep: true,
            work: Work::default(),
            work_began: 0,
            counts: Counts::default(),
        };
        machine.set_hz(hz);
        machine.reset_core();
        Ok(machine)
    }

    /// The time.
    pub fn now(&self) -> Ticks {
        self.now
    }

    /// The instruction to come.
    pub fn pc(&self) -> u32 {
        self.pc
    }

    /// The image that runs.
    pub fn image(&self) -> &Image {
        &self.image
    }

    /// What the run has cost so far.
    pub fn counts(&mut self) -> Counts {
        self.attribute();
        Counts { interrupts: self.nvic.interrupts(), ..self.counts }
    }

    /// The board as it is now, without its core.
    pub fn into_board(self) -> B {
        self.board
    }

    /// Resets the core and, by `board`, what is around it.
    pub fn reset(&mut self, board: impl FnOnce(&mut B)) {
        board(&mut self.board);
        self.reset_core();
    }

    /// Goes on at a function with these first arguments, wherever the software is.
    pub fn call(&mut self, address: u32, arguments: [u32; 4]) {
        self.r[..4].copy_from_slice(&arguments);
        (self.pc, self.it, self.sleeping) = (address & !1, 0, None);
    }

    /// Changes the frequency of the core.
    fn set_hz(&mut self, hz: u64) {
        let cycles = self.cycles();
        self.cycle = crate::time::period(hz);
        self.system.rebase_systick(self.now, self.cycle * self.board.systick_cycles());
        self.system.set_cycles(cycles, self.now);
        let ticks = |cycles: f64| (cycles * PER_SECOND as f64 / hz as f64).round() as Ticks;
        let costs = self.costs;
        self.instruction_ticks = ticks(costs.instruction).max(1);
        self.memory.set_costs(|kind| {
            ticks(match kind {
                Kind::TightlyCoupled => costs.tightly_coupled,
                Kind::Axi => costs.axi,
                Kind::Sram => costs.sram,
                Kind::Flash => costs.flash,
            })
        });
        self.system.costs = system::Ticked {
            register: ticks(costs.register),
            system_register: ticks(costs.system_register),
            entry: ticks(costs.interrupt_entry),
            tail_chain: ticks(costs.tail_chain),
            exit: ticks(costs.interrupt_exit),
        };
    }

    /// Cycles of the core since its counter was zero.
    fn cycles(&self) -> u64 {
        self.system.cycles(self.now, self.cycle)
    }

    /// Runs up to a moment.
    ///
    /// # Errors
    /// One line: the software did what the model or the manual does not allow; where, and in which function.
    pub fn run(&mut self, until: Ticks) -> Result<Ending, String> {
        loop {
            if let Some((pc, trouble)) = self.trouble.take() {
                self.resolve(pc, trouble)?;
            }
            self.advance()?;
            let mut reset = false;
            while let Some(wish) = self.wishes.pop() {
                match wish {
                    Wish::Reset => {
                        self.reset_core();
                        reset = true;
                    }
                    Wish::CoreHz(hz) => self.set_hz(hz),
                    Wish::Exit(status) => return Ok(Ending::Exit(status)),
                }
            }
            if reset {
                // What else was due at that moment is still to be done.
                continue;
            }
            if self.now >= until {
                return Ok(Ending::Time);
            }
            if let Some(number) = self.nvic.next() {
                self.sleeping = None;
                self.enter(number, self.pc);
                continue;
            }
            let event = self.board.next_event().min(self.system.next_event());
            if event <= self.now {
                return Err(self.line(self.pc, "an event of the board is due and is not carried out"));
            }
            if let Some(sleep) = self.sleeping {
                if self.nvic.wakes() || (sleep == Sleep::Event && self.nvic.event) {
                    self.nvic.event &= sleep == Sleep::Interrupt;
                    self.sleeping = None;
                } else {
                    let to = event.min(until).max(self.now);
                    if event == NEVER && until == NEVER {
                        return Err(self.line(self.pc, "the core sleeps and nothing will wake it"));
                    }
                    self.sleep_until(to);
                    continue;
                }
            }
            self.deadline = event.min(until);
            while self.now < self.deadline {
                self.step();
            }
        }
    }

    /// Holds the core, as a debugger does, while everything else goes on.
    ///
    /// # Errors
    /// As [`Machine::run`].
    pub fn hold(&mut self, until: Ticks) -> Result<(), String> {
        self.attribute();
        while self.now < until {
            let event = self.board.next_event().min(self.system.next_event());
            self.now = event.clamp(self.now, until);
            self.work_began = self.now;
            self.advance()?;
            while let Some(wish) = self.wishes.pop() {
                match wish {
                    Wish::Reset => self.reset_core(),
                    Wish::CoreHz(hz) => self.set_hz(hz),
                    Wish::Exit(_) => {}
                }
            }
        }
        Ok(())
    }

    /// What peripherals and SysTick have to do by now.
    fn advance(&mut self) -> Result<(), String> {
        if self.system.next_event() <= self.now {
            self.system.systick_wraps(self.now);
            self.nvic.pend(nvic::number::SYSTICK);
        }
        if self.board.next_event() <= self.now {
            let pc = self.pc;
            let (board, mut bus) = self.bus();
            let done = board.advance(&mut bus);
            if let Err(refusal) = done {
                return Err(self.line(pc, &reason(refusal)));
            }
        }
        Ok(())
    }

    fn sleep_until(&mut self, to: Ticks) {
        let slept = to - self.now;
        self.counts.asleep += slept;
        if !self.counts_asleep {
            self.system.skip(slept);
        }
        self.work_began += slept;
        self.now = to;
    }

    fn bus(&mut self) -> (&mut B, Bus<'_>) {
        let bus = Bus {
            memory: &mut self.memory,
            nvic: &mut self.nvic,
            now: self.now,
            counts_asleep: &mut self.counts_asleep,
            wishes: &mut self.wishes,
        };
        (&mut self.board, bus)
    }

    #[inline(always)]
    fn step(&mut self) {
        let pc = self.pc;
        let i = self.fetch(pc);
        self.next = pc.wrapping_add(u32::from(i.len));
        self.r[15] = pc.wrapping_add(4);
        self.now += self.instruction_ticks;
        self.work.instructions += 1;
        if self.it == 0 {
            self.execute(i);
        } else {
            self.in_it_block(i);
        }
        self.pc = self.next;
    }

    fn in_it_block(&mut self, i: Instruction) {
        let condition = self.it >> 4;
        self.it = if self.it & 7 == 0 { 0 } else { self.it & 0xe0 | self.it << 1 & 0x1f };
        if self.condition(condition) {
            self.execute(if i.flags_outside_it() { i.without_flags() } else { i });
        }
    }

    #[cold]
    fn fail(&mut self, trouble: Trouble) {
        if self.trouble.is_none() {
            self.trouble = Some((self.pc, trouble));
        }
        self.deadline = 0;
    }

    /// Leaves the inner loop after this instruction, to look at events and interrupts.
    #[inline(always)]
    fn look_up(&mut self) {
        self.deadline = 0;
    }

    /// One line about a place in the software.
    fn line(&self, pc: u32, reason: &str) -> String {
        let name = self.image.function(pc).unwrap_or("?");
        format!("{reason} (pc {pc:#010x} in {name}, after {:.6} s)", self.now as f64 / PER_SECOND as f64)
    }

    /// Books what was done since the last change of mode.
    fn attribute(&mut self) {
        let mut work = std::mem::take(&mut self.work);
        work.ticks = self.now - self.work_began;
        self.work_began = self.now;
        if self.ipsr == 0 { self.counts.thread.add(work) } else { self.counts.handlers.add(work) }
    }
}

fn reason(refusal: crate::board::Refusal) -> String {
    match refusal {
        crate::board::Refusal::Stop(reason) => reason,
        crate::board::Refusal::BusFault => "a transfer that the bus refuses".to_owned(),
    }
}
