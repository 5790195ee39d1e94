//! Loads and stores (A7.7): plain memory at once, registers of the core and of the board by the way round.

use super::{Machine, Trouble, exception::fault, reason};
use crate::board::{Board, Refusal, Width, Wish};
use crate::instruction::{Instruction, access};

impl<B: Board> Machine<B> {
    #[inline(always)]
    pub(super) fn load32(&mut self, address: u32) -> u32 {
        self.work.loads += 1;
        match self.memory.load::<4>(address) {
            Some((bytes, cost)) => {
                self.now += cost;
                u32::from_le_bytes(bytes)
            }
            None => self.load_register(address, Width::Word),
        }
    }

    #[inline(always)]
    pub(super) fn load16(&mut self, address: u32) -> u32 {
        self.work.loads += 1;
        match self.memory.load::<2>(address) {
            Some((bytes, cost)) => {
                self.now += cost;
                u32::from(u16::from_le_bytes(bytes))
            }
            None => self.load_register(address, Width::Half) & 0xffff,
        }
    }

    #[inline(always)]
    pub(super) fn load8(&mut self, address: u32) -> u32 {
        self.work.loads += 1;
        match self.memory.load::<1>(address) {
            Some(([byte], cost)) => {
                self.now += cost;
                u32::from(byte)
            }
            None => self.load_register(address, Width::Byte) & 0xff,
        }
    }

    #[inline(always)]
    pub(super) fn store32(&mut self, address: u32, value: u32) {
        self.work.stores += 1;
        match self.memory.store(address, value.to_le_bytes()) {
            Some(cost) => self.now += cost,
            None => self.store_guarded(address, value, Width::Word),
        }
    }

    #[inline(always)]
    pub(super) fn store16(&mut self, address: u32, value: u32) {
        self.work.stores += 1;
        match self.memory.store(address, (value as u16).to_le_bytes()) {
            Some(cost) => self.now += cost,
            None => self.store_guarded(address, value & 0xffff, Width::Half),
        }
    }

    #[inline(always)]
    pub(super) fn store8(&mut self, address: u32, value: u32) {
        self.work.stores += 1;
        match self.memory.store(address, [value as u8]) {
            Some(cost) => self.now += cost,
            None => self.store_guarded(address, value & 0xff, Width::Byte),
        }
    }

    #[inline(never)]
    fn load_register(&mut self, address: u32, width: Width) -> u32 {
        self.work.loads -= 1;
        self.look_up();
        let read = if address >> 20 == 0xe00 {
            self.now += self.system.costs.system_register;
            self.read_system(address, width)
        } else {
            self.work.register_reads += 1;
            self.now += self.system.costs.register;
            if self.catch_up() {
                let (board, mut bus) = self.bus();
                board.read(&mut bus, address, width)
            } else {
                Ok(0)
            }
        };
        read.unwrap_or_else(|refusal| {
            self.refuse(address, false, refusal);
            0
        })
    }

    #[inline(never)]
    fn store_guarded(&mut self, address: u32, value: u32, width: Width) {
        let bytes = value.to_le_bytes();
        let bytes = &bytes[..width.bytes() as usize];
        if let Some(cost) = self.memory.store_guarded(address, bytes) {
            self.now += cost;
            self.forget_code(address, width.bytes());
            return;
        }
        self.work.stores -= 1;
        self.look_up();
        let written = if address >> 20 == 0xe00 {
            self.now += self.system.costs.system_register;
            self.write_system(address, value, width)
        } else {
            self.work.register_writes += 1;
            self.now += self.system.costs.register;
            if self.catch_up() {
                let (board, mut bus) = self.bus();
                board.write(&mut bus, address, value, width)
            } else {
                Ok(())
            }
        };
        if let Err(refusal) = written {
            self.refuse(address, true, refusal);
        }
    }

    /// A register is seen as it is now, not as it was at the last look at events; whether it is there: where power fails or the watchdog ends
    /// at this very access, there is no core that it comes back to.
    fn catch_up(&mut self) -> bool {
        if let Err(line) = self.advance() {
            self.fail(Trouble::Stop(line));
        }
        !self.wishes.iter().any(|wish| matches!(wish, Wish::Reset))
    }

    fn refuse(&mut self, address: u32, write: bool, refusal: Refusal) {
        let trouble = match refusal {
            Refusal::BusFault => Trouble::Bus { address, write },
            stop @ Refusal::Stop(_) => Trouble::Stop(self.line(self.pc, &reason(stop))),
        };
        self.fail(trouble);
    }

    /// Accesses of several words must be aligned.
    #[inline(always)]
    fn aligned(&mut self, address: u32) -> bool {
        if address & 3 != 0 {
            self.fail(Trouble::Usage(fault::UNALIGNED));
        }
        address & 3 == 0
    }

    pub(super) fn indexed(&mut self, i: Instruction) {
        let n = usize::from(i.n & 15);
        let moved = self.r[n].wrapping_add(i.imm);
        let address = if i.s { moved } else { self.r[n] };
        let value = self.r[usize::from(i.d & 15)];
        self.r[n] = moved;
        let loaded = match i.a {
            access::BYTE => self.load8(address),
            access::HALF => self.load16(address),
            access::WORD => self.load32(address),
            access::SIGNED_BYTE => i32::from(self.load8(address) as i8) as u32,
            access::SIGNED_HALF => i32::from(self.load16(address) as i16) as u32,
            stored => {
                match stored - access::STORE {
                    access::BYTE => self.store8(address, value),
                    access::HALF => self.store16(address, value),
                    _ => self.store32(address, value),
                }
                return;
            }
        };
        self.set_or_branch(i.d, loaded);
    }

    /// Address of a pair of words, with the base written back.
    #[inline(always)]
    fn pair_address(&mut self, i: Instruction) -> u32 {
        let n = usize::from(i.n & 15);
        let base = if n == 15 { 0 } else { self.r[n] };
        let moved = base.wrapping_add(i.imm);
        if i.s {
            self.r[n] = moved;
        }
        if i.a != 0 { moved } else { base }
    }

    pub(super) fn load_pair(&mut self, i: Instruction) {
        let address = self.pair_address(i);
        if self.aligned(address) {
            self.r[usize::from(i.d & 15)] = self.load32(address);
            self.r[usize::from(i.m & 15)] = self.load32(address.wrapping_add(4));
        }
    }

    pub(super) fn store_pair(&mut self, i: Instruction) {
        let (first, second) = (self.r[usize::from(i.d & 15)], self.r[usize::from(i.m & 15)]);
        let address = self.pair_address(i);
        if self.aligned(address) {
            self.store32(address, first);
            self.store32(address.wrapping_add(4), second);
        }
    }

    pub(super) fn load_multiple(&mut self, i: Instruction) {
        let n = usize::from(i.n & 15);
        let bytes = i.imm.count_ones() * 4;
        let (mut address, moved) = if i.a != 0 {
            let low = self.r[n].wrapping_sub(bytes);
            (low, low)
        } else {
            (self.r[n], self.r[n].wrapping_add(bytes))
        };
        if !self.aligned(address) {
            return;
        }
        if i.s {
            self.r[n] = moved;
        }
        let mut list = i.imm & 0x7fff;
        while list != 0 {
            self.r[list.trailing_zeros() as usize & 15] = self.load32(address);
            address = address.wrapping_add(4);
            list &= list - 1;
        }
        if i.imm & 0x8000 != 0 {
            let target = self.load32(address);
            self.branch_exchange(target);
        }
    }

    pub(super) fn store_multiple(&mut self, i: Instruction) {
        let n = usize::from(i.n & 15);
        let bytes = i.imm.count_ones() * 4;
        let (mut address, moved) = if i.a != 0 {
            let low = self.r[n].wrapping_sub(bytes);
            (low, low)
        } else {
            (self.r[n], self.r[n].wrapping_add(bytes))
        };
        if !self.aligned(address) {
            return;
        }
        let mut list = i.imm;
        while list != 0 {
            let value = self.r[list.trailing_zeros() as usize & 15];
            self.store32(address, value);
            address = address.wrapping_add(4);
            list &= list - 1;
        }
        if i.s {
            self.r[n] = moved;
        }
    }

    pub(super) fn float_multiple(&mut self, i: Instruction, load: bool) {
        let n = usize::from(i.n & 15);
        let bytes = i.imm * 4;
        let (address, moved) = if i.a != 0 {
            let low = self.r[n].wrapping_sub(bytes);
            (low, low)
        } else {
            (self.r[n], self.r[n].wrapping_add(bytes))
        };
        if !self.aligned(address) {
            return;
        }
        for k in 0..i.imm {
            let register = (u32::from(i.d) + k) as usize & 31;
            let at = address.wrapping_add(4 * k);
            if load {
                self.s[register] = self.load32(at);
            } else {
                let value = self.s[register];
                self.store32(at, value);
            }
        }
        if i.s {
            self.r[n] = moved;
        }
    }

    pub(super) fn load_exclusive(&mut self, i: Instruction, short: bool) {
        let address = self.r[usize::from(i.n & 15)].wrapping_add(i.imm);
        self.exclusive = Some(address);
        let value = match (short, i.a) {
            (false, _) => self.load32(address),
            (true, 0) => self.load8(address),
            (true, _) => self.load16(address),
        };
        self.r[usize::from(i.d & 15)] = value;
    }

    pub(super) fn store_exclusive(&mut self, i: Instruction, short: bool) {
        let address = self.r[usize::from(i.n & 15)].wrapping_add(i.imm);
        let held = self.exclusive.take() == Some(address);
        if held {
            let value = self.r[usize::from(i.d & 15)];
            match (short, i.a) {
                (false, _) => self.store32(address, value),
                (true, 0) => self.store8(address, value),
                (true, _) => self.store16(address, value),
            }
        }
        self.r[usize::from(i.m & 15)] = u32::from(!held);
    }
}
