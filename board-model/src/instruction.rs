//! Decoded instructions.

/// What an instruction does. Fields of [`Instruction`] that matter stand behind each group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Op {
    /// Not looked at yet.
    Undecoded,
    /// No instruction this model knows.
    Unknown,
    // d, n, imm
    AddImm,
    AddImmS,
    SubImm,
    SubImmS,
    CmpImm,
    MovImm,
    MovImmS,
    // d, n, m
    AddReg,
    AddRegS,
    SubReg,
    SubRegS,
    CmpReg,
    MovReg,
    // d, n, m; imm: amount of a left shift
    AddLsl,
    /// d, n, imm; a: `Alu`; s; k: the immediate was rotated, so carry is its bit 31
    DpImm,
    /// d, n, m; a; s
    DpReg,
    /// d, n, m; a; s; k: [`shift`] kind, imm: its amount
    DpShift,
    /// d, n, m; s; k: kind of shift of n by m
    ShiftReg,
    // d, imm
    MovT,
    // d, n, m, a: accumulator; s
    Mul,
    Mla,
    Mls,
    // d: low, a: high, n, m
    Umull,
    Smull,
    Umlal,
    Smlal,
    Umaal,
    Sdiv,
    Udiv,
    /// d, n, m, a: accumulator or 15; imm: `Dsp` kind and halves
    DspMul,
    /// d: low, a: high, n, m; imm: kind and halves
    DspLong,
    // d, n, imm: lsb, k: width
    Bfi,
    Sbfx,
    Ubfx,
    /// d, n; imm: amount of shift, k: 0 left or 2 right, a: bits; s: signed
    Sat,
    /// d, n; a: bits; s: signed
    Sat16,
    // d, n (15: none), m, imm: rotation; a: kind
    Extend,
    Sxtb,
    Sxth,
    Uxtb,
    Uxth,
    // d, m
    Rev,
    Rev16,
    Revsh,
    Rbit,
    Clz,
    Sel,
    /// d, m, n; a: 0 add, 1 double and add, 2 subtract, 3 double and subtract
    Qadd,
    /// d, n, m, k: kind of shift, imm: amount; s: top
    Pkh,
    /// d, n, m; a: operation, k: prefix
    Parallel,
    // imm: target
    B,
    /// a: condition
    BCond,
    Bl,
    // m
    Bx,
    Blx,
    /// n, imm: target; s: on not zero
    Cbz,
    /// n, m; s: halves
    TableBranch,
    // d: register, n: base, imm: offset
    Ldr,
    Ldrb,
    Ldrh,
    Ldrsb,
    Ldrsh,
    Str,
    Strb,
    Strh,
    // d, imm: address
    LdrLiteral,
    // d, n, m, imm: left shift of m
    LdrReg,
    LdrbReg,
    LdrhReg,
    LdrsbReg,
    LdrshReg,
    StrReg,
    StrbReg,
    StrhReg,
    /// d, n, imm; a: `Access`; s: add the offset before; always writes the base back
    Indexed,
    /// d, m: registers, n: base, imm: offset; a: 1 offset before, s: write back
    Ldrd,
    Strd,
    /// n: base, imm: list; s: write back; a: decrement before
    Ldm,
    Stm,
    // d: register, m: status or second register, n, imm
    Ldrex,
    Strex,
    /// a: 0 byte, 1 half
    LdrexShort,
    StrexShort,
    Clrex,
    /// imm: state
    It,
    Nop,
    Wfi,
    Wfe,
    Sev,
    /// imm: 1 PRIMASK, 2 FAULTMASK; s: disable
    Cps,
    /// d, imm: special register
    Mrs,
    /// n, imm: special register, a: mask
    Msr,
    Svc,
    Bkpt,
    /// Permanently undefined: a usage fault.
    Udf,
    // Floating point. Single registers are numbered 0 to 31, double ones 0 to 15.
    // d, n, imm: offset
    VldrS,
    VldrD,
    VstrS,
    VstrD,
    /// n: base, d: first, imm: words; s: write back; a: decrement before
    Vldm,
    Vstm,
    /// d: core register, n: single register
    VmovToCore,
    VmovFromCore,
    /// d, m: core registers, n: first single register
    VmovTwoToCore,
    VmovTwoFromCore,
    /// d: core register or 15 for flags
    Vmrs,
    Vmsr,
    // d, n, m
    VaddS,
    VsubS,
    VmulS,
    VdivS,
    VaddD,
    VsubD,
    VmulD,
    VdivD,
    /// a: 1 negate product, 2 negate accumulator
    VmlaS,
    VmlaD,
    VfmaS,
    VfmaD,
    VnmulS,
    VnmulD,
    // d, m
    VmovS,
    VmovD,
    VabsS,
    VabsD,
    VnegS,
    VnegD,
    VsqrtS,
    VsqrtD,
    // d, imm: bits of the value, of a double its high word
    VmovImmS,
    VmovImmD,
    /// d, m; a: 1 against zero
    VcmpS,
    VcmpD,
    VcvtDS,
    VcvtSD,
    /// d, m: integer register to float; a: signed
    VcvtIntToS,
    VcvtIntToD,
    /// a: signed; k: `Rounding`
    VcvtSToInt,
    VcvtDToInt,
    /// d in place; imm: fraction bits, a: bit 0 signed, bit 1 16 bits, bit 2 to fixed
    VcvtFixedS,
    VcvtFixedD,
    /// d, m; a: bit 0 top, bit 1 to half; k: 1 double
    VcvtHalf,
    /// d, m; k: rounding
    VrintS,
    VrintD,
    /// a: condition 0 EQ, 1 VS, 2 GE, 3 GT
    VselS,
    VselD,
    /// a: 1 minimum
    VmaxnmS,
    VmaxnmD,
}

/// An instruction as it is carried out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Instruction {
    pub op: Op,
    /// Bytes: 2 or 4.
    pub len: u8,
    pub d: u8,
    pub n: u8,
    pub m: u8,
    pub a: u8,
    pub k: u8,
    pub s: bool,
    pub imm: u32,
}

impl Instruction {
    pub const UNDECODED: Self = Self::new(Op::Undecoded, 2);

    pub const fn new(op: Op, len: u8) -> Self {
        Self { op, len, d: 0, n: 0, m: 0, a: 0, k: 0, s: false, imm: 0 }
    }

    /// The same without setting flags: what a short instruction within an IT block does.
    pub fn without_flags(self) -> Self {
        let op = match self.op {
            Op::AddImmS => Op::AddImm,
            Op::SubImmS => Op::SubImm,
            Op::MovImmS => Op::MovImm,
            Op::AddRegS => Op::AddReg,
            Op::SubRegS => Op::SubReg,
            Op::DpImm | Op::DpReg | Op::DpShift if self.a >= alu::TST => return self,
            op => op,
        };
        Self { op, s: false, ..self }
    }

    /// Whether a short instruction sets flags only outside IT blocks.
    pub fn flags_outside_it(&self) -> bool {
        self.len == 2
            && matches!(
                self.op,
                Op::AddImmS
                    | Op::SubImmS
                    | Op::MovImmS
                    | Op::AddRegS
                    | Op::SubRegS
                    | Op::DpImm
                    | Op::DpReg
                    | Op::DpShift
                    | Op::ShiftReg
                    | Op::Mul
            )
    }
}

/// Operations of data processing; the last four only set flags.
pub(crate) mod alu {
    pub const AND: u8 = 0;
    pub const BIC: u8 = 1;
    pub const ORR: u8 = 2;
    pub const ORN: u8 = 3;
    pub const EOR: u8 = 4;
    pub const MOV: u8 = 5;
    pub const MVN: u8 = 6;
    pub const ADD: u8 = 7;
    pub const ADC: u8 = 8;
    pub const SBC: u8 = 9;
    pub const SUB: u8 = 10;
    pub const RSB: u8 = 11;
    pub const TST: u8 = 12;
    pub const TEQ: u8 = 13;
    pub const CMN: u8 = 14;
    pub const CMP: u8 = 15;
}

/// Kinds of shift.
pub(crate) mod shift {
    pub const LSL: u8 = 0;
    pub const LSR: u8 = 1;
    pub const ASR: u8 = 2;
    pub const ROR: u8 = 3;
    pub const RRX: u8 = 4;
}

/// Kinds of an indexed access.
pub(crate) mod access {
    pub const BYTE: u8 = 0;
    pub const HALF: u8 = 1;
    pub const WORD: u8 = 2;
    pub const SIGNED_BYTE: u8 = 3;
    pub const SIGNED_HALF: u8 = 4;
    /// Added for stores.
    pub const STORE: u8 = 8;
}

/// Rounding of conversions.
pub(crate) mod rounding {
    pub const TIES_AWAY: u8 = 0;
    pub const TIES_EVEN: u8 = 1;
    pub const UP: u8 = 2;
    pub const DOWN: u8 = 3;
    pub const ZERO: u8 = 4;
    /// As FPSCR says, which is to even.
    pub const CURRENT: u8 = 1;
}
