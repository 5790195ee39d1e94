//! Pins and their interrupts: GPIO and EXTI with SYSCFG's selection (RM0433, chapters 11, 12 and 20).

use super::clocks::unknown;
use crate::board::{Bus, Refusal};

const PORTS: usize = 11;

/// A pin: its port (0 is A) and number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pin {
    /// 0 is port A.
    pub port: usize,
    /// 0 to 15.
    pub number: u32,
}

impl Pin {
    /// Pin `number` of a port named by its letter.
    pub const fn new(port: char, number: u32) -> Self {
        Self { port: port as usize - 'A' as usize, number }
    }
}

/// What a pin is used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    Input,
    Output,
    Alternate(u32),
    Analog,
}

#[derive(Clone, Copy, Debug, Default)]
struct Port {
    mode: u32,
    kind: u32,
    speed: u32,
    pull: u32,
    output: u32,
    alternate: [u32; 2],
    /// Levels that the board puts on inputs.
    input: u32,
}

/// All ports and the external interrupts.
#[derive(Debug)]
pub(super) struct Pins {
    ports: [Port; PORTS],
    rising: u32,
    falling: u32,
    mask: u32,
    events: u32,
    pending: u32,
    sources: [u32; 4],
}

impl Pins {
    pub fn new() -> Self {
        let mut ports = [Port { mode: u32::MAX, ..Port::default() }; PORTS];
        ports[0].mode = 0xabff_ffff;
        ports[1].mode = 0xffff_febf;
        Self { ports, rising: 0, falling: 0, mask: 0, events: 0, pending: 0, sources: [0; 4] }
    }

    pub fn mode(&self, pin: Pin) -> Mode {
        let port = &self.ports[pin.port];
        match port.mode >> (2 * pin.number) & 3 {
            0 => Mode::Input,
            1 => Mode::Output,
            2 => Mode::Alternate(port.alternate[(pin.number / 8) as usize] >> (4 * (pin.number % 8)) & 15),
            _ => Mode::Analog,
        }
    }

    /// Level of an output.
    pub fn output(&self, pin: Pin) -> bool {
        self.ports[pin.port].output >> pin.number & 1 != 0
    }

    pub fn input(&self, pin: Pin) -> bool {
        self.ports[pin.port].input >> pin.number & 1 != 0
    }

    /// The board drives a pin; edges may interrupt.
    pub fn drive(&mut self, bus: &mut Bus<'_>, pin: Pin, high: bool) {
        let was = self.input(pin);
        let bit = 1u32 << pin.number;
        let input = &mut self.ports[pin.port].input;
        *input = if high { *input | bit } else { *input & !bit };
        let source = self.sources[(pin.number / 4) as usize] >> (4 * (pin.number % 4)) & 15;
        let wanted = if high { self.rising } else { self.falling };
        // An analog pin's digital input is off.
        if was != high && source as usize == pin.port && wanted & bit != 0 && self.mode(pin) != Mode::Analog {
            self.pending |= bit & self.mask;
            self.lines(bus);
        }
    }

    fn lines(&self, bus: &mut Bus<'_>) {
        let live = self.pending & self.mask;
        for line in 0..5 {
            bus.nvic.set_level(6 + line as u16, live >> line & 1 != 0);
        }
        bus.nvic.set_level(23, live & 0x03e0 != 0);
        bus.nvic.set_level(40, live & 0xfc00 != 0);
    }

    pub fn read_gpio(&self, port: usize, offset: usize) -> Result<u32, Refusal> {
        let p = self.ports.get(port).ok_or_else(|| unknown("GPIO", offset))?;
        Ok(match offset {
            0x00 => p.mode,
            0x04 => p.kind,
            0x08 => p.speed,
            0x0c => p.pull,
            0x10 => {
                let outputs: u32 = (0..16).filter(|i| p.mode >> (2 * i) & 3 == 1).map(|i| 1 << i).sum();
                p.output & outputs | p.input & !outputs
            }
            0x14 => p.output,
            0x18 | 0x1c => 0,
            0x20 | 0x24 => p.alternate[(offset - 0x20) / 4],
            _ => return Err(unknown("GPIO", offset)),
        })
    }

    pub fn write_gpio(&mut self, port: usize, offset: usize, value: u32) -> Result<(), Refusal> {
        let p = self.ports.get_mut(port).ok_or_else(|| unknown("GPIO", offset))?;
        match offset {
            0x00 => p.mode = value,
            0x04 => p.kind = value,
            0x08 => p.speed = value,
            0x0c => p.pull = value,
            0x14 => p.output = value & 0xffff,
            0x18 => p.output = p.output & !(value >> 16) | value & 0xffff,
            0x20 | 0x24 => p.alternate[(offset - 0x20) / 4] = value,
            _ => return Err(unknown("GPIO", offset)),
        }
        Ok(())
    }

    pub fn read_exti(&self, offset: usize) -> Result<u32, Refusal> {
        Ok(match offset {
            0x00 => self.rising,
            0x04 => self.falling,
            0x80 => self.mask,
            0x84 => self.events,
            0x88 => self.pending,
            0x08 | 0x0c..=0x5c | 0x90..=0xa8 => 0,
            _ => return Err(unknown("EXTI", offset)),
        })
    }

    pub fn write_exti(&mut self, bus: &mut Bus<'_>, offset: usize, value: u32) -> Result<(), Refusal> {
        match offset {
            0x00 => self.rising = value,
            0x04 => self.falling = value,
            0x08 => self.pending |= value & self.mask,
            0x80 => self.mask = value,
            0x84 => self.events = value,
            0x88 => self.pending &= !value,
            _ => return Err(unknown("EXTI", offset)),
        }
        self.lines(bus);
        Ok(())
    }

    /// SYSCFG_EXTICR1 to 4.
    pub fn source(&mut self, index: usize) -> &mut u32 {
        &mut self.sources[index & 3]
    }
}
