//! What Thumb code does to the stack and where it goes: as much of the encoding as that needs.
//!
//! Encodings: ARMv7-M Architecture Reference Manual (ARM DDI 0403), A5 and A7.7.

/// What one instruction does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Neither of what follows.
    Other,
    /// Takes so many bytes of stack.
    Takes(u32),
    /// Clears a register's lowest bits, or makes it less than the stack pointer: the stack takes up to so many bytes where the
    /// register becomes its pointer.
    Aligns(u32),
    /// Sets a register by the frame pointer, to which the stack is brought back.
    FromFrame(u8),
    /// Moves this register to the stack pointer.
    Moves(u8),
    /// Takes stack of an amount that stands in a register or in memory.
    TakesUnknown,
    /// Writes the stack pointer of an exception's level, as a reset does.
    Sets,
    /// Calls this address.
    Calls(u32),
    /// Goes to this address.
    Goes(u32),
    /// Goes where a register says, which is not the caller.
    GoesByPointer,
}

/// Whether the instruction that begins so has a second half (A5.1).
pub fn is_wide(first: u16) -> bool {
    first >> 11 >= 0b11101
}

/// The instruction at an address; the second half counts for a wide one alone.
pub fn step(address: u32, first: u16, second: u16) -> Step {
    if is_wide(first) { wide(address, first, second) } else { narrow(address, first) }
}

fn narrow(address: u32, first: u16) -> Step {
    let relative = |offset: i32| Step::Goes(address.wrapping_add(4).wrapping_add_signed(offset));
    match first {
        // PUSH T1, SUB (SP minus immediate) T1.
        _ if first & 0xfe00 == 0xb400 => Step::Takes(4 * (first & 0x01ff).count_ones()),
        _ if first & 0xff80 == 0xb080 => Step::Takes(4 * u32::from(first & 0x7f)),
        // B T1, whose conditions 14 and 15 are other instructions, and B T2.
        _ if first & 0xf000 == 0xd000 && first & 0x0e00 != 0x0e00 => {
            relative(i32::from(first as u8 as i8) * 2)
        }
        _ if first & 0xf800 == 0xe000 => relative(i32::from((first << 5) as i16 >> 5) * 2),
        // MOV (register) T1 to the stack pointer, ADD (SP plus register) T2.
        _ if first & 0xff87 == 0x4685 => Step::Moves((first >> 3 & 15) as u8),
        _ if first & 0xff87 == 0x4485 => Step::TakesUnknown,
        // MOV (register) T1 to the program counter, unless it returns, and ADD to it.
        _ if first & 0xff87 == 0x4687 && first >> 3 & 15 != 14 => Step::GoesByPointer,
        _ if first & 0xff87 == 0x4487 => Step::GoesByPointer,
        // BLX, and BX unless it returns.
        _ if first & 0xff87 == 0x4780 => Step::GoesByPointer,
        _ if first & 0xff87 == 0x4700 && first >> 3 & 15 != 14 => Step::GoesByPointer,
        _ => Step::Other,
    }
}

fn wide(address: u32, first: u16, second: u16) -> Step {
    let immediate =
        || (u32::from(first) >> 10 & 1) << 11 | (u32::from(second) >> 12 & 7) << 8 | u32::from(second & 0xff);
    let to_stack = second & 0x8f00 == 0x0d00;
    let register = (second >> 8 & 15) as u8;
    match (first, second) {
        // PUSH T2; PUSH T3 and its kin, a store before the lowered stack pointer; STRD (immediate) with write-back; VPUSH.
        (0xe92d, _) => Step::Takes(4 * second.count_ones()),
        (0xf84d, _) if second & 0x0f00 == 0x0d00 => Step::Takes(u32::from(second & 0xff)),
        (0xe96d, _) => Step::Takes(4 * u32::from(second & 0xff)),
        (0xed2d | 0xed6d, _) if second & 0x0e00 == 0x0a00 => Step::Takes(4 * u32::from(second & 0xff)),
        // SUB (SP minus immediate) T2 and T3, SUB (SP minus register).
        (0xf1ad | 0xf5ad, _) if to_stack => Step::Takes(expanded(immediate())),
        (0xf2ad | 0xf6ad, _) if to_stack => Step::Takes(immediate()),
        (0xebad, _) if second & 0x0f00 == 0x0d00 => Step::TakesUnknown,
        // The same to another register; SUB (immediate) from the frame pointer, R7.
        (0xf1ad | 0xf5ad, _) if second & 0x8000 == 0 => Step::Aligns(expanded(immediate())),
        (0xf2ad | 0xf6ad, _) if second & 0x8000 == 0 => Step::Aligns(immediate()),
        (0xf1a7 | 0xf5a7 | 0xf2a7 | 0xf6a7, _) if second & 0x8000 == 0 => Step::FromFrame(register),
        // ADD (SP plus register) T3, MOV (register) T3, LDR, each to the stack pointer; MSR.
        (0xeb0d, _) if second & 0x0f00 == 0x0d00 => Step::TakesUnknown,
        (0xea4f | 0xea5f, _) if second & 0xfff0 == 0x0d00 => Step::Moves((second & 15) as u8),
        _ if first & 0xff70 == 0xf850 && second >> 12 == 13 => Step::TakesUnknown,
        _ if first & 0xfff0 == 0xf380 && second & 0xff00 == 0x8800 && matches!(second & 0xff, 8 | 9) => {
            Step::Sets
        }
        // BFC from bit 0, with which a frame is aligned.
        (0xf36f, _) if second & 0xf0c0 == 0 => Step::Aligns((2 << (second & 31)) - 1),
        // BL, B T4, B T3.
        _ if first & 0xf800 == 0xf000 && second & 0xd000 == 0xd000 => {
            Step::Calls(far(address, first, second))
        }
        _ if first & 0xf800 == 0xf000 && second & 0xd000 == 0x9000 => Step::Goes(far(address, first, second)),
        _ if first & 0xf800 == 0xf000 && second & 0xd000 == 0x8000 && first & 0x0380 != 0x0380 => {
            let (first, second) = (u32::from(first), u32::from(second));
            let bits = (first >> 10 & 1) << 20
                | (second >> 11 & 1) << 19
                | (second >> 13 & 1) << 18
                | (first & 0x3f) << 12
                | (second & 0x7ff) << 1;
            Step::Goes(address.wrapping_add(4).wrapping_add_signed((bits as i32) << 11 >> 11))
        }
        // LDR, LDM and LDMDB to the program counter, but not from the stack, from which it returns.
        _ if first & 0xffd0 == 0xe890 && second >> 15 == 1 && first & 15 != 13 => Step::GoesByPointer,
        _ if first & 0xffd0 == 0xe910 && second >> 15 == 1 => Step::GoesByPointer,
        _ if first & 0xff70 == 0xf850 && second >> 12 == 15 && first & 15 != 13 => Step::GoesByPointer,
        _ => Step::Other,
    }
}

/// Where `BL` and `B` T4 go.
fn far(address: u32, first: u16, second: u16) -> u32 {
    let (first, second) = (u32::from(first), u32::from(second));
    let sign = first >> 10 & 1;
    let high = !(second >> 13 ^ sign) & 1;
    let low = !(second >> 11 ^ sign) & 1;
    let offset = sign << 24 | high << 23 | low << 22 | (first & 0x3ff) << 12 | (second & 0x7ff) << 1;
    address.wrapping_add(4).wrapping_add_signed((offset as i32) << 7 >> 7)
}

/// ThumbExpandImm (A5.3.2) of `i:imm3:imm8`.
fn expanded(immediate: u32) -> u32 {
    let byte = immediate & 0xff;
    match immediate >> 8 {
        0 => byte,
        1 => byte << 16 | byte,
        2 => byte << 24 | byte << 8,
        3 => byte * 0x0101_0101,
        _ => (0x80 | immediate & 0x7f).rotate_right(immediate >> 7),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_prologue_takes() {
        // push {r4, r5, r6, r7, lr}; push.w {r4..r11, lr}; str lr, [sp, #-4]!; vpush {d8, d9}.
        assert_eq!(step(0, 0xb5f0, 0), Step::Takes(20));
        assert_eq!(step(0, 0xe92d, 0x4ff0), Step::Takes(36));
        assert_eq!(step(0, 0xf84d, 0xed04), Step::Takes(4));
        assert_eq!(step(0, 0xed2d, 0x8b04), Step::Takes(16));
        // sub sp, #24; sub.w sp, sp, #512; sub.w sp, sp, #1016; subw sp, sp, #4092; sub sp, sp, r4.
        assert_eq!(step(0, 0xb086, 0), Step::Takes(24));
        assert_eq!(step(0, 0xf5ad, 0x7d00), Step::Takes(512));
        assert_eq!(step(0, 0xf5ad, 0x7d7e), Step::Takes(1016));
        assert_eq!(step(0, 0xf6ad, 0x7dfc), Step::Takes(4092));
        assert_eq!(step(0, 0xebad, 0x0d04), Step::TakesUnknown);
        // bfc r4, #0, #4; mov sp, r4.
        assert_eq!(step(0, 0xf36f, 0x0403), Step::Aligns(15));
        assert_eq!(step(0, 0x46a5, 0), Step::Moves(4));
        // sub.w r4, sp, #64; sub.w r4, r7, #24; mov.w sp, r4.
        assert_eq!(step(0, 0xf1ad, 0x0440), Step::Aligns(64));
        assert_eq!(step(0, 0xf1a7, 0x0418), Step::FromFrame(4));
        assert_eq!(step(0, 0xea4f, 0x0d04), Step::Moves(4));
        // add sp, r4; add.w sp, sp, r4; ldr.w sp, [r0]; msr msp, r0.
        assert_eq!(step(0, 0x44a5, 0), Step::TakesUnknown);
        assert_eq!(step(0, 0xeb0d, 0x0d04), Step::TakesUnknown);
        assert_eq!(step(0, 0xf8d0, 0xd000), Step::TakesUnknown);
        assert_eq!(step(0, 0xf380, 0x8808), Step::Sets);
        // add sp, #24; pop {r4, pc}; mov r0, r1.
        assert_eq!(step(0, 0xb006, 0), Step::Other);
        assert_eq!(step(0, 0xbd10, 0), Step::Other);
        assert_eq!(step(0, 0x4608, 0), Step::Other);
    }

    #[test]
    fn where_branches_go() {
        // bl of itself, b.n of itself, beq.n of the one after, bx lr, bx r3, blx r2.
        assert_eq!(step(0x100, 0xf7ff, 0xfffe), Step::Calls(0x100));
        assert_eq!(step(0x100, 0xe7fe, 0), Step::Goes(0x100));
        assert_eq!(step(0x100, 0xd0ff, 0), Step::Goes(0x102));
        assert_eq!(step(0x100, 0x4770, 0), Step::Other);
        assert_eq!(step(0x100, 0x4718, 0), Step::GoesByPointer);
        assert_eq!(step(0x100, 0x4790, 0), Step::GoesByPointer);
        // beq.w of itself; ldr pc, [r0]; ldr pc, [sp], #4.
        assert_eq!(step(0x100, 0xf43f, 0xaffe), Step::Goes(0x100));
        assert_eq!(step(0x100, 0xf8d0, 0xf000), Step::GoesByPointer);
        assert_eq!(step(0x100, 0xf85d, 0xfb04), Step::Other);
        // b.w of itself; mov pc, r3; mov pc, lr; ldm.w r0, {r4, pc}; pop.w {r4, pc}.
        assert_eq!(step(0x100, 0xf7ff, 0xbffe), Step::Goes(0x100));
        assert_eq!(step(0x100, 0x469f, 0), Step::GoesByPointer);
        assert_eq!(step(0x100, 0x46f7, 0), Step::Other);
        assert_eq!(step(0x100, 0xe890, 0x8010), Step::GoesByPointer);
        assert_eq!(step(0x100, 0xe8bd, 0x8010), Step::Other);
    }
}
