//! Instructions against vectors worked out from the architecture's rules; exceptions against its frames.

use super::Machine;
use crate::board::{Board, Bus, Refusal, Width, Wish};
use crate::costs::Costs;
use crate::elf::Image;
use crate::memory::{Kind, Memory};
use crate::time::{NEVER, PER_SECOND, Ticks};

/// A core with memory and nothing else.
#[derive(Debug)]
struct Bare;

impl Board for Bare {
    fn read(&mut self, _: &mut Bus<'_>, _: u32, _: Width) -> Result<u32, Refusal> {
        Err(Refusal::BusFault)
    }
    fn write(&mut self, _: &mut Bus<'_>, _: u32, _: u32, _: Width) -> Result<(), Refusal> {
        Err(Refusal::BusFault)
    }
    fn advance(&mut self, _: &mut Bus<'_>) -> Result<(), Refusal> {
        Ok(())
    }
    fn next_event(&self) -> Ticks {
        NEVER
    }
    fn software_reset(&mut self, _: &mut Bus<'_>) {}
    fn reset_hz(&self) -> u64 {
        480_000_000
    }
}

/// A board whose power fails once, and whose registers are off at that moment.
#[derive(Debug)]
struct Failing {
    at: Ticks,
    failed: Ticks,
    reads: u32,
}

impl Board for Failing {
    fn read(&mut self, bus: &mut Bus<'_>, _: u32, _: Width) -> Result<u32, Refusal> {
        self.reads += 1;
        if bus.now == self.failed { Refusal::stop("off") } else { Ok(7) }
    }
    fn write(&mut self, bus: &mut Bus<'_>, address: u32, _: u32, width: Width) -> Result<(), Refusal> {
        self.read(bus, address, width).map(|_| ())
    }
    fn advance(&mut self, bus: &mut Bus<'_>) -> Result<(), Refusal> {
        (self.at, self.failed) = (NEVER, bus.now);
        bus.wishes.push(Wish::Reset);
        Ok(())
    }
    fn next_event(&self) -> Ticks {
        self.at
    }
    fn software_reset(&mut self, _: &mut Bus<'_>) {}
    fn reset_hz(&self) -> u64 {
        480_000_000
    }
}

const STACK: u32 = 0x2000_1000;

/// Code at 0x100, a handler of every exception at 0x200.
fn machine(code: &[u16], handler: &[u16]) -> Machine<Bare> {
    machine_of(Bare, Costs::IDEAL, code, handler)
}

/// The same of a board.
fn machine_of<B: Board>(board: B, costs: Costs, code: &[u16], handler: &[u16]) -> Machine<B> {
    let mut flash = vec![0u8; 0x400];
    let mut put = |at: usize, bytes: &[u8]| flash[at..at + bytes.len()].copy_from_slice(bytes);
    put(0, &STACK.to_le_bytes());
    put(4, &0x101u32.to_le_bytes());
    (2..64).for_each(|vector| put(4 * vector, &0x201u32.to_le_bytes()));
    for (at, code) in [(0x100, code), (0x200, handler)] {
        code.iter().enumerate().for_each(|(i, half)| put(at + 2 * i, &half.to_le_bytes()));
    }
    let mut memory = Memory::default();
    memory.add(0, 1 << 16, Kind::Flash, 0xff);
    memory.add(0x2000_0000, 1 << 16, Kind::TightlyCoupled, 0);
    Machine::new(board, memory, Image::raw(0, flash), costs, &[(0, 0x400)]).expect("it fits")
}

/// Carries out so many instructions and takes the exceptions between them.
fn go(machine: &mut Machine<Bare>, instructions: usize) {
    for _ in 0..instructions {
        machine.run(machine.now() + 1).expect("nothing here stops the run");
    }
}

/// Halfwords; r0 to r3 before; r0, flags (N, Z, C, V, Q) and r3 after. Carry is clear before.
type Vector = (&'static str, &'static [u16], [u32; 4], u32, u32, u32);

#[rustfmt::skip]
const DATA: [Vector; 38] = [
    ("adds r0, r1, r2", &[0x1888], [0x0, 0x7fffffff, 0x1, 0x0], 0x80000000, 0x90000000, 0x0),
    ("subs r0, r1, r2", &[0x1a88], [0x0, 0x5, 0x5, 0x0], 0x0, 0x60000000, 0x0),
    ("sbcs r0, r1", &[0x4188], [0x7, 0x3, 0x0, 0x0], 0x3, 0x20000000, 0x0),
    ("adcs r0, r1", &[0x4148], [0xffffffff, 0x1, 0x0, 0x0], 0x0, 0x60000000, 0x0),
    ("lsrs r0, r1, #32", &[0x0808], [0x0, 0x80000000, 0x0, 0x0], 0x0, 0x60000000, 0x0),
    ("asrs r0, r1", &[0x4108], [0x80000000, 0x28, 0x0, 0x0], 0xffffffff, 0xa0000000, 0x0),
    ("ror r0, r1, #4", &[0xea4f, 0x1031], [0x0, 0x1234567f, 0x0, 0x0], 0xf1234567, 0x00000000, 0x0),
    ("rrxs r0, r1", &[0xea5f, 0x0031], [0x0, 0x3, 0x0, 0x0], 0x1, 0x20000000, 0x0),
    ("movs.w r0, #0xff000000", &[0xf05f, 0x407f], [0x0, 0x0, 0x0, 0x0], 0xff000000, 0xa0000000, 0x0),
    ("mvn r0, #0x00ab00ab", &[0xf06f, 0x10ab], [0x0, 0x0, 0x0, 0x0], 0xff54ff54, 0x00000000, 0x0),
    ("ssat r0, #8, r1", &[0xf301, 0x0007], [0x0, 0xffffff00, 0x0, 0x0], 0xffffff80, 0x08000000, 0x0),
    ("usat r0, #8, r1, asr #4", &[0xf3a1, 0x1008], [0x0, 0x1000, 0x0, 0x0], 0xff, 0x08000000, 0x0),
    ("qadd r0, r1, r2", &[0xfa82, 0xf081], [0x0, 0x7fffffff, 0x1, 0x0], 0x7fffffff, 0x08000000, 0x0),
    ("qdsub r0, r1, r2", &[0xfa82, 0xf0b1], [0x0, 0xa, 0x3, 0x0], 0x4, 0x00000000, 0x0),
    ("sadd16 r0, r1, r2", &[0xfa91, 0xf002], [0x0, 0x7fff8000, 0x18000, 0x0], 0x80000000, 0x00000000, 0x0),
    ("uqsub8 r0, r1, r2", &[0xfac1, 0xf052], [0x0, 0x10203040, 0x20102050, 0x0], 0x101000, 0x00000000, 0x0),
    ("shasx r0, r1, r2", &[0xfaa1, 0xf022], [0x0, 0x40002, 0x60008, 0x0], 0x6fffe, 0x00000000, 0x0),
    ("smlad r0, r1, r2, r3", &[0xfb21, 0x3002], [0x0, 0x20003, 0x40005, 0x7], 0x1e, 0x00000000, 0x7),
    ("smlsdx r0, r1, r2, r3", &[0xfb41, 0x3012], [0x0, 0x20003, 0x40005, 0x1], 0x3, 0x00000000, 0x1),
    ("smulbt r0, r1, r2", &[0xfb11, 0xf012], [0x0, 0xffff, 0x50000, 0x0], 0xfffffffb, 0x00000000, 0x0),
    ("smlawb r0, r1, r2, r3", &[0xfb31, 0x3002], [0x0, 0x20000, 0xfffffffe, 0x1], 0xfffffffd, 0x00000000, 0x1),
    ("smmulr r0, r1, r2", &[0xfb51, 0xf012], [0x0, 0x40000000, 0x6, 0x0], 0x2, 0x00000000, 0x0),
    ("smmls r0, r1, r2, r3", &[0xfb61, 0x3002], [0x0, 0x40000000, 0x4, 0x5], 0x4, 0x00000000, 0x5),
    ("usada8 r0, r1, r2, r3", &[0xfb71, 0x3002], [0x0, 0x1020304, 0x4030201, 0xa], 0x12, 0x00000000, 0xa),
    ("smull r0, r3, r1, r2", &[0xfb81, 0x0302], [0x0, 0xffffffff, 0x2, 0x0], 0xfffffffe, 0x00000000, 0xffffffff),
    ("umaal r0, r3, r1, r2", &[0xfbe1, 0x0362], [0xffffffff, 0xffffffff, 0xffffffff, 0xffffffff], 0xffffffff, 0x00000000, 0xffffffff),
    ("smlaltb r0, r3, r1, r2", &[0xfbc1, 0x03a2], [0xffffffff, 0x30000, 0x2, 0x0], 0x5, 0x00000000, 0x1),
    ("sdiv r0, r1, r2", &[0xfb91, 0xf0f2], [0x0, 0xfffffff9, 0x2, 0x0], 0xfffffffd, 0x00000000, 0x0),
    ("sdiv r0, r1, r2", &[0xfb91, 0xf0f2], [0x0, 0x80000000, 0xffffffff, 0x0], 0x80000000, 0x00000000, 0x0),
    ("udiv r0, r1, r2", &[0xfbb1, 0xf0f2], [0x0, 0x7, 0x0, 0x0], 0x0, 0x00000000, 0x0),
    ("bfi r0, r1, #4, #8", &[0xf361, 0x100b], [0xffffffff, 0x12, 0x0, 0x0], 0xfffff12f, 0x00000000, 0x0),
    ("sbfx r0, r1, #4, #8", &[0xf341, 0x1007], [0x0, 0xf80, 0x0, 0x0], 0xfffffff8, 0x00000000, 0x0),
    ("pkhtb r0, r1, r2, asr #8", &[0xeac1, 0x2022], [0x0, 0xabcd1234, 0x80ff4321, 0x0], 0xabcdff43, 0x00000000, 0x0),
    ("uxtab16 r0, r1, r2, ror #8", &[0xfa31, 0xf092], [0x0, 0x10002, 0x12345678, 0x0], 0x130058, 0x00000000, 0x0),
    ("rbit r0, r1", &[0xfa91, 0xf0a1], [0x0, 0x1, 0x0, 0x0], 0x80000000, 0x00000000, 0x0),
    ("revsh r0, r1", &[0xbac8], [0x0, 0x80, 0x0, 0x0], 0xffff8000, 0x00000000, 0x0),
    ("clz r0, r1", &[0xfab1, 0xf081], [0x0, 0x10000, 0x0, 0x0], 0xf, 0x00000000, 0x0),
    ("mls r0, r1, r2, r3", &[0xfb01, 0x3012], [0x0, 0x3, 0x4, 0x14], 0x8, 0x00000000, 0x14),
];

#[test]
fn data_processing_gives_the_architectures_results_and_flags() {
    for (name, code, registers, r0, flags, r3) in DATA {
        let mut machine = machine(code, &[]);
        machine.r[..4].copy_from_slice(&registers);
        go(&mut machine, 1);
        assert_eq!((machine.r[0], machine.xpsr() & 0xf800_0000, machine.r[3]), (r0, flags, r3), "{name}");
    }
}

/// Name, code, words in and words out.
type FloatVector = (&'static str, &'static [u16], &'static [u32], &'static [u32]);

/// Halfwords; the first single registers before and after.
#[rustfmt::skip]
const FLOAT: [FloatVector; 27] = [
    ("vfma.f32 s0, s1, s2", &[0xeea0, 0x0a81], &[0x322bcc77, 0x3f800800, 0x3f800800], &[0x3f801001]),
    ("vmla.f32 s0, s1, s2", &[0xee00, 0x0a81], &[0xbf800000, 0x3f800800, 0x3f800800], &[0x3a000000]),
    ("vnmls.f32 s0, s1, s2", &[0xee10, 0x0a81], &[0x40400000, 0x40000000, 0x40a00000], &[0x40e00000]),
    ("vdiv.f64 d0, d1, d2", &[0xee81, 0x0b02], &[0x0, 0x0, 0x0, 0x3ff00000, 0x0, 0x40080000], &[0x55555555, 0x3fd55555]),
    ("vsqrt.f32 s0, s1", &[0xeeb1, 0x0ae0], &[0x0, 0xbf800000], &[0x7fc00000]),
    ("vsqrt.f32 s0, s1", &[0xeeb1, 0x0ae0], &[0x0, 0x80000000], &[0x80000000]),
    ("vadd.f32 s0, s1, s2", &[0xee30, 0x0a81], &[0x0, 0x7fc00123, 0xffa00001], &[0xffe00001]),
    ("vsub.f32 s0, s1, s2", &[0xee30, 0x0ac1], &[0x0, 0x7f800000, 0x7f800000], &[0x7fc00000]),
    ("vcvt.s32.f32 s0, s1", &[0xeebd, 0x0ae0], &[0x0, 0xc02ccccd], &[0xfffffffe]),
    ("vcvt.s32.f32 s0, s1", &[0xeebd, 0x0ae0], &[0x0, 0x4f32d05e], &[0x7fffffff]),
    ("vcvt.u32.f32 s0, s1", &[0xeebc, 0x0ae0], &[0x0, 0x7fc00000], &[0x0]),
    ("vcvtr.s32.f32 s0, s1", &[0xeebd, 0x0a60], &[0x0, 0x40200000], &[0x2]),
    ("vcvt.f32.s32 s0, s0, #8", &[0xeeba, 0x0acc], &[0xffffff80], &[0xbf000000]),
    ("vcvtb.f16.f32 s0, s1", &[0xeeb3, 0x0a60], &[0xabcd0000, 0x3f800000], &[0xabcd3c00]),
    ("vcvtb.f16.f32 s0, s1", &[0xeeb3, 0x0a60], &[0x0, 0x477fefff], &[0x7bff]),
    ("vcvtb.f16.f32 s0, s1", &[0xeeb3, 0x0a60], &[0x0, 0x477ff000], &[0x7c00]),
    ("vcvtb.f16.f32 s0, s1", &[0xeeb3, 0x0a60], &[0x0, 0x33400000], &[0x1]),
    ("vcvtb.f32.f16 s0, s1", &[0xeeb2, 0x0a60], &[0x0, 0x1], &[0x33800000]),
    ("vcvt.f64.f32 d0, s2", &[0xeeb7, 0x0ac1], &[0x0, 0x0, 0x3dcccccd], &[0xa0000000, 0x3fb99999]),
    ("vcvt.f32.f64 s0, d1", &[0xeeb7, 0x0bc1], &[0x0, 0x0, 0x9999999a, 0x3fb99999], &[0x3dcccccd]),
    ("vrintn.f64 d0, d1", &[0xfeb9, 0x0b41], &[0x0, 0x0, 0x0, 0xc0040000], &[0x0, 0xc0000000]),
    ("vmaxnm.f32 s0, s1, s2", &[0xfe80, 0x0a81], &[0x0, 0x7fc00000, 0x40800000], &[0x40800000]),
    ("vminnm.f32 s0, s1, s2", &[0xfe80, 0x0ac1], &[0x0, 0x0, 0x80000000], &[0x80000000]),
    ("vmov.f32 s0, #-1.5", &[0xeebf, 0x0a08], &[], &[0xbfc00000]),
    ("vmov.f64 d0, #0.125", &[0xeeb4, 0x0b00], &[], &[0x0, 0x3fc00000]),
    ("vcvta.u32.f64 s0, d1", &[0xfebc, 0x0b41], &[0x0, 0x0, 0x0, 0x40040000], &[0x3]),
    ("vmul.f32 s0, s1, s2", &[0xee20, 0x0a81], &[0x0, 0xda24260, 0x2b8cbccc], &[0x2ca]),
];

#[test]
fn floating_point_rounds_once_and_makes_the_architectures_nans() {
    for (name, code, before, after) in FLOAT {
        let mut machine = machine(code, &[]);
        machine.write_system(0xe000_ed88, 0xf << 20, Width::Word).expect("CPACR");
        machine.s[..before.len()].copy_from_slice(before);
        go(&mut machine, 1);
        assert_eq!(&machine.s[..after.len()], after, "{name}");
    }
}

#[test]
fn a_block_of_conditional_instructions_sets_no_flags() {
    let mut machine = machine(&[0x2000, 0xbf06, 0x2001, 0x1c80, 0x2005], &[]);
    go(&mut machine, 5);
    assert_eq!((machine.r[0], machine.pc), (3, 0x10a));
}

/// Floating point on, 1.5 in s0, interrupt 0 enabled and made pending; s0 to r5 afterwards.
const INTERRUPTED: &[u16] = &[
    0xf64e, 0x5088, 0xf2ce, 0x0000, 0xf44f, 0x0170, 0x6001, 0xeeb7, 0x0a08, 0xf24e, 0x1200, 0xf2ce, 0x0200,
    0x2301, 0x6013, 0xf8c2, 0x3100, 0xbf00, 0xee10, 0x5a10, 0xbf00,
];
/// 2.0 in s0, the return value to r6, s0 to r4, return.
const HANDLER: &[u16] = &[0xeeb0, 0x0a00, 0x4676, 0xee10, 0x4a10, 0x4770];

#[test]
fn an_interrupt_saves_floating_point_late_and_gives_it_back() {
    let mut machine = machine(INTERRUPTED, HANDLER);
    go(&mut machine, 10);
    assert_eq!(machine.ipsr, 0);
    go(&mut machine, 1);
    assert_eq!((machine.ipsr, machine.r[13], machine.lazy), (16, STACK - 104, true));
    let context = |machine: &Machine<Bare>| machine.memory.bytes(STACK - 104 + 32, 4).map(<[u8]>::to_vec);
    assert_eq!(context(&machine), Some(vec![0; 4]), "room only");
    go(&mut machine, 3);
    assert!(!machine.lazy);
    assert_eq!(context(&machine), Some(1.5f32.to_bits().to_le_bytes().to_vec()));
    go(&mut machine, 3);
    assert_eq!((machine.r[6], machine.r[4], machine.r[5]), (0xffff_ffe9, 2f32.to_bits(), 1.5f32.to_bits()));
    assert_eq!((machine.ipsr, machine.r[13], machine.nvic.interrupts()), (0, STACK, 1));
}

#[test]
fn a_load_of_nothing_is_a_hard_fault_that_knows_where() {
    let mut machine = machine(&[0xf04f, 0x4120, 0xbf00, 0x6808], &[0xf3ef, 0x8605, 0x9d06, 0xbf00]);
    go(&mut machine, 6);
    assert_eq!((machine.r[6], machine.r[5]), (3, 0x106), "HardFault, and the load's address");
    assert_eq!((machine.system.bfar, machine.system.hfsr), (0xa000_0000, 1 << 30));
    assert_eq!(machine.system.cfsr, 1 << 9 | 1 << 15);
}

#[test]
fn an_instruction_that_is_not_known_stops_in_one_line() {
    let mut machine = machine(&[0xbf00, 0xec00, 0x0000], &[]);
    machine.pc = 0x102;
    let line = machine.run(Ticks::MAX).expect_err("coprocessor 0 is not there");
    assert!(line.contains("ec00 0000") && line.contains("pc 0x00000102"), "{line}");
}

#[test]
fn a_register_that_is_read_or_written_as_power_fails_is_not_there() {
    let costs = Costs { register: 30.0, ..Costs::IDEAL };
    // A load, and a store, of a register, again and again; at each instant of the costly access power fails.
    let cycle = PER_SECOND / 480_000_000;
    for code in [[0x6808, 0xe7fd], [0x6008, 0xe7fd]] {
        for at in (300..340).map(|cycles| cycles * cycle) {
            let mut machine = machine_of(Failing { at, failed: NEVER, reads: 0 }, costs, &code, &[]);
            machine.r[1] = 0x4000_0000;
            let ended = machine.run(at + 100 * cycle);
            assert!(ended.is_ok() && machine.board.reads > 0, "{at}: {ended:?}");
        }
    }
}
