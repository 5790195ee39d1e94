//! DMA1, DMA2 and their request multiplexer (RM0433, chapters 15 and 17). A transfer takes no time.

use super::clocks::unknown;
use crate::board::{Bus, Refusal, Width};

/// Requests of peripherals in DMAMUX1.
pub(super) mod request {
    pub const TIM1_CH1: u8 = 11;
    pub const TIM1_UP: u8 = 15;
    pub const TIM2_CH1: u8 = 18;
    pub const TIM2_UP: u8 = 22;
    pub const TIM3_CH1: u8 = 23;
    pub const TIM3_UP: u8 = 27;
    pub const TIM4_CH1: u8 = 29;
    pub const TIM4_UP: u8 = 32;
    pub const SPI1_RX: u8 = 37;
    pub const SPI1_TX: u8 = 38;
    pub const SPI2_RX: u8 = 39;
    pub const SPI3_RX: u8 = 61;
    pub const SPI4_RX: u8 = 83;
    pub const USART2_RX: u8 = 43;
    pub const USART3_RX: u8 = 45;
    pub const USART3_TX: u8 = 46;
    pub const TIM8_CH1: u8 = 47;
    pub const TIM8_UP: u8 = 51;
    pub const TIM5_CH1: u8 = 55;
    pub const TIM5_UP: u8 = 59;
}

const STREAMS: usize = 16;
const INTERRUPTS: [u16; STREAMS] = [11, 12, 13, 14, 15, 16, 17, 47, 56, 57, 58, 59, 60, 68, 69, 70];
/// Request generators of DMAMUX1, whose requests are the first numbers.
const GENERATORS: usize = 8;
/// Channels of DMAMUX1 whose events reach the generators.
const EVENTS: usize = 3;
const COMPLETE: u32 = 1 << 5;
const HALF: u32 = 1 << 4;

#[derive(Clone, Copy, Debug, Default)]
struct Stream {
    control: u32,
    /// Items left, and items at the start.
    left: u32,
    items: u32,
    peripheral: u32,
    memory: [u32; 2],
    fifo: u32,
    /// Bytes moved since the start or the wrap.
    moved: u32,
    flags: u32,
}

impl Stream {
    fn on(&self) -> bool {
        self.control & 1 != 0
    }
    fn sends(&self) -> bool {
        self.control >> 6 & 3 == 1
    }
    fn width(field: u32) -> Width {
        match field & 3 {
            0 => Width::Byte,
            1 => Width::Half,
            _ => Width::Word,
        }
    }
    fn item(&self) -> Width {
        Self::width(self.control >> 11)
    }
    fn interrupting(&self) -> bool {
        let enabled = (self.control >> 1 & 7) << 2 | (self.control >> 4 & 1) << 5;
        self.flags & enabled != 0
    }
}

/// Both controllers: streams 0 to 7 are of the first.
#[derive(Debug)]
pub(super) struct Dma {
    streams: [Stream; STREAMS],
    mux: [u32; STREAMS],
    generators: [u32; GENERATORS],
    /// Requests a generator has still to make, and whether it was triggered while it made them.
    generated: [u32; GENERATORS],
    overrun: u32,
    /// The stream that serves each request, [`NOBODY`] where none does.
    servants: [u8; 128],
    /// Whether any generator has requests to make.
    generating: bool,
    /// Items moved since the start, by stream.
    pub moved: [u64; STREAMS],
}

const NOBODY: u8 = u8::MAX;

/// One item to move.
#[derive(Clone, Copy, Debug)]
pub(super) struct Item {
    pub peripheral: u32,
    pub memory: u32,
    pub width: Width,
    pub to_peripheral: bool,
}

impl Dma {
    pub fn new() -> Self {
        Self {
            streams: [Stream::default(); STREAMS],
            mux: [0; STREAMS],
            generators: [0; GENERATORS],
            generated: [0; GENERATORS],
            overrun: 0,
            servants: [NOBODY; 128],
            generating: false,
            moved: [0; STREAMS],
        }
    }

    /// The stream that would serve a request: the first enabled one.
    pub fn serving(&self, request: u8) -> Option<usize> {
        let stream = self.servants[usize::from(request) & 127];
        (stream != NOBODY).then_some(usize::from(stream))
    }

    /// Finds anew which stream serves which request.
    fn assign(&mut self) {
        self.servants = [NOBODY; 128];
        for stream in (0..STREAMS).rev().filter(|s| self.streams[*s].on()) {
            self.servants[self.mux[stream] as usize & 127] = stream as u8;
        }
    }

    /// What a stream moves next.
    pub fn item(&self, bus: &Bus<'_>, stream: usize) -> Result<Item, Refusal> {
        let s = &self.streams[stream];
        let width = s.item();
        let target = s.memory[(s.control >> 19 & 1) as usize];
        let memory = target + if s.control & 0x400 != 0 { s.moved } else { 0 };
        if s.control & 0x200 != 0 {
            return Refusal::stop(format!(
                "DMA stream {stream} counts the peripheral's address up, which is not modelled"
            ));
        }
        check_reach(bus, memory, stream)?;
        Ok(Item { peripheral: s.peripheral, memory, width, to_peripheral: s.sends() })
    }

    /// The first request that a generator makes and a stream serves: that stream, and the generator to be told.
    pub fn generated(&self) -> Option<(usize, usize)> {
        if !self.generating {
            return None;
        }
        let makes = |g: &usize| self.generated[*g] > 0;
        (0..GENERATORS).filter(makes).find_map(|g| Some((self.serving(g as u8 + 1)?, g)))
    }

    /// A generator's request is served.
    pub fn one_generated(&mut self, generator: usize) {
        self.generated[generator] -= 1;
        self.generating = self.generated.iter().any(|n| *n > 0);
    }

    /// A channel of DMAMUX1 has passed a request on and says so, if it is to.
    fn event(&mut self, channel: usize) {
        if channel >= EVENTS || self.mux[channel] & 1 << 9 == 0 {
            return;
        }
        for g in 0..GENERATORS {
            let control = self.generators[g];
            let (signal, on, rising) =
                (control as usize & 31, control >> 16 & 1 != 0, control >> 17 & 1 != 0);
            if !on || !rising || signal != channel {
                continue;
            }
            if self.generated[g] > 0 {
                self.overrun |= 1 << g;
            } else {
                self.generated[g] = (control >> 19 & 31) + 1;
                self.generating = true;
            }
        }
    }

    /// One item of a stream has been moved.
    pub fn done(&mut self, bus: &mut Bus<'_>, stream: usize) {
        let s = &mut self.streams[stream];
        self.moved[stream] += 1;
        s.moved += s.item().bytes();
        s.left -= 1;
        if s.left == s.items / 2 {
            s.flags |= HALF;
        }
        if s.left == 0 {
            s.flags |= COMPLETE;
            s.moved = 0;
            s.left = s.items;
            if s.control & 1 << 18 != 0 {
                s.control ^= 1 << 19;
            } else if s.control & 1 << 8 == 0 {
                s.control &= !1;
                s.left = 0;
                self.assign();
            }
        }
        bus.nvic.set_level(INTERRUPTS[stream], self.streams[stream].interrupting());
        self.event(stream);
    }

    fn lines(&self, bus: &mut Bus<'_>) {
        for (stream, interrupt) in self.streams.iter().zip(INTERRUPTS) {
            bus.nvic.set_level(interrupt, stream.interrupting());
        }
    }

    pub fn read(&self, controller: usize, offset: usize) -> Result<u32, Refusal> {
        let first = controller * 8;
        Ok(match offset {
            0 | 4 => {
                let group = first + offset;
                let flags = |i: usize| self.streams[group + i].flags << [0, 6, 16, 22][i];
                (0..4).map(flags).sum()
            }
            0x10..0xd0 => {
                let s = &self.streams[first + (offset - 0x10) / 0x18];
                match (offset - 0x10) % 0x18 {
                    0x00 => s.control,
                    0x04 => s.left,
                    0x08 => s.peripheral,
                    0x0c => s.memory[0],
                    0x10 => s.memory[1],
                    _ => s.fifo,
                }
            }
            _ => return Err(unknown("DMA", offset)),
        })
    }

    pub fn write(
        &mut self,
        bus: &mut Bus<'_>,
        controller: usize,
        offset: usize,
        value: u32,
    ) -> Result<(), Refusal> {
        let first = controller * 8;
        match offset {
            8 | 0xc => {
                for i in 0..4 {
                    self.streams[first + offset - 8 + i].flags &= !(value >> [0, 6, 16, 22][i] & 0x3d);
                }
            }
            0x10..0xd0 => {
                let stream = first + (offset - 0x10) / 0x18;
                let register = (offset - 0x10) % 0x18;
                self.write_stream(stream, register, value)?;
                self.assign();
            }
            _ => return Err(unknown("DMA", offset)),
        }
        self.lines(bus);
        Ok(())
    }

    fn write_stream(&mut self, stream: usize, register: usize, value: u32) -> Result<(), Refusal> {
        let s = &mut self.streams[stream];
        let on = s.on();
        if on && matches!(register, 4 | 8) || on && register == 0xc && s.control & 1 << 18 == 0 {
            return Refusal::stop(format!(
                "register {register:#x} of DMA stream {stream} is written while it is on"
            ));
        }
        match register {
            0 => {
                let starts = value & 1 != 0 && !on;
                if on && value & 1 != 0 && (value ^ s.control) & !0x1f != 0 {
                    return Refusal::stop(format!("DMA stream {stream} is configured while it is on"));
                }
                if starts && s.flags & (COMPLETE | HALF | 8) != 0 {
                    return Refusal::stop(format!(
                        "DMA stream {stream} is enabled with flags left from before"
                    ));
                }
                if on && value & 1 == 0 {
                    // Disabled by software: what was on its way is complete.
                    s.flags |= COMPLETE;
                }
                s.control = value;
                if starts {
                    if value >> 6 & 3 == 2 || value & 0x20 != 0 {
                        return Refusal::stop(
                            "DMA from memory to memory, or flow by the peripheral, is not modelled",
                        );
                    }
                    if value >> 11 & 3 != value >> 13 & 3 && s.fifo & 4 == 0 {
                        return Refusal::stop(format!("DMA stream {stream} changes widths without its FIFO"));
                    }
                    s.moved = 0;
                    s.items = s.left;
                    if s.items == 0 {
                        s.control &= !1;
                    }
                }
            }
            0x04 => s.left = value & 0xffff,
            0x08 => s.peripheral = value,
            0x0c => s.memory[0] = value,
            0x10 => s.memory[1] = value,
            _ => s.fifo = value,
        }
        Ok(())
    }

    pub fn read_mux(&self, offset: usize) -> Result<u32, Refusal> {
        match offset {
            0..0x40 => Ok(self.mux[offset / 4]),
            0x100..0x120 => Ok(self.generators[(offset - 0x100) / 4]),
            0x80 => Ok(0),
            0x140 => Ok(self.overrun),
            _ => Err(unknown("DMAMUX1", offset)),
        }
    }

    pub fn write_mux(&mut self, offset: usize, value: u32) -> Result<(), Refusal> {
        match offset {
            0..0x40 if value & 0x0101_0000 != 0 => Refusal::stop("synchronisation of DMAMUX is not modelled"),
            0..0x40 if value & 0x200 != 0 && value >> 19 & 31 != 0 => {
                Refusal::stop("events of DMAMUX after several requests are not modelled")
            }
            0..0x40 => {
                self.mux[offset / 4] = value;
                self.assign();
                Ok(())
            }
            0x100..0x120 => {
                let g = (offset - 0x100) / 4;
                let before = self.generators[g];
                if (before | value) & 1 << 16 != 0
                    && (before ^ value) & 0x00f8_0000 != 0
                    && value >> 16 & 1 != 0
                {
                    return Refusal::stop(
                        "the number of requests of a generator of DMAMUX is changed while it is on",
                    );
                }
                if value & 1 << 16 == 0 {
                    self.generated[g] = 0;
                }
                self.generators[g] = value;
                Ok(())
            }
            0x144 => {
                self.overrun &= !value;
                Ok(())
            }
            0x84 => Ok(()),
            _ => Err(unknown("DMAMUX1", offset)),
        }
    }
}

/// DMA1 and DMA2 do not reach tightly coupled memory, and what the core caches they would not see.
fn check_reach(bus: &Bus<'_>, address: u32, stream: usize) -> Result<(), Refusal> {
    use crate::memory::Kind;
    match bus.memory.extent(address) {
        None => Refusal::stop(format!("DMA stream {stream} has no memory at {address:#010x}")),
        Some((_, _, Kind::TightlyCoupled)) => Refusal::stop(format!(
            "DMA stream {stream} does not reach tightly coupled memory at {address:#010x}"
        )),
        Some((_, _, Kind::Flash)) => Ok(()),
        _ if bus.memory.may_be_cached(address) => {
            Refusal::stop(format!("DMA stream {stream} uses {address:#010x}, which the data cache may hold"))
        }
        _ => Ok(()),
    }
}
