//! Peripherals together, driven by their registers: conversions move without an instruction.

use super::*;
use crate::board::Refusal;
use crate::core::nvic::Nvic;
use crate::time::PER_SECOND;

/// A board and what it reaches.
struct Bench {
    board: Stm32h743,
    memory: Memory,
    nvic: Nvic,
    now: Ticks,
}

const BUFFER: u32 = 0x3000_0000;
const START_WORD: u32 = 0x3000_1000;
const FRAME: u32 = 18;
const FRAMES: u32 = 8;

impl Bench {
    fn new(conversions: i32) -> Self {
        let mut next = 0;
        let source = move || {
            next += 1;
            (next <= conversions).then_some([next, -next, next << 8, 7])
        };
        let mut memory = Memory::default();
        memory.add(0x2000_0000, 128 << 10, Kind::TightlyCoupled, 0);
        memory.add(0x3000_0000, 288 << 10, Kind::Sram, 0);
        let board = Stm32h743::new(&Parameters::default(), Box::new(source), 64_000.0);
        Self { board, memory, nvic: Nvic::default(), now: 0 }
    }

    fn with<R>(&mut self, f: impl FnOnce(&mut Stm32h743, &mut Bus<'_>) -> R) -> R {
        let mut bus = Bus {
            memory: &mut self.memory,
            nvic: &mut self.nvic,
            now: self.now,
            counts_asleep: &mut true,
            wishes: &mut Vec::new(),
        };
        f(&mut self.board, &mut bus)
    }

    fn write(&mut self, address: u32, value: u32) -> Result<(), Refusal> {
        self.with(|board, bus| board.write(bus, address, value, Width::Word))
    }

    fn read(&mut self, address: u32) -> u32 {
        self.with(|board, bus| board.read(bus, address, Width::Word)).expect("a register that can be read")
    }

    fn all(&mut self, writes: &[(u32, u32)]) {
        for (address, value) in writes {
            self.write(*address, *value).unwrap_or_else(|e| panic!("{address:#x}: {e:?}"));
        }
    }

    /// Writes a register of the converter, past the bus.
    fn converter_register(&mut self, register: u16, value: u16) {
        let mut frame = [0u8; FRAME as usize];
        frame[..2].copy_from_slice(&(0x6000 | register << 7).to_be_bytes());
        frame[3..5].copy_from_slice(&value.to_be_bytes());
        self.board.converter.select(true, self.now);
        frame.iter().for_each(|byte| {
            self.board.converter.exchange(*byte, self.now);
        });
        self.board.converter.select(false, self.now);
    }

    fn run(&mut self, until: Ticks) {
        while self.board.next_event() <= until {
            self.now = self.board.next_event();
            self.with(|board, bus| board.advance(bus)).expect("nothing is wrong");
        }
        self.now = until;
    }
}

/// Clocks of what is used, and the pins: PE9 to TIM1, PA4 to PA6 to SPI1.
const CLOCKS_AND_PINS: [(u32, u32); 8] = [
    (0x5802_44d8, 1),
    (0x5802_44e0, 0x19),
    (0x5802_44f0, 1 << 12 | 1),
    (0x5802_4450, 4 << 12),
    (0x5802_0000, 0xabff_eaff & !0x3f00 | 0x2a00),
    (0x5802_0020, 0x0555_0000),
    (0x5802_1000, 0xfff3_ffff | 0x0008_0000),
    (0x5802_1024, 0x10),
];

#[test]
fn edges_count_in_hardware_and_start_transfers_that_dma_takes_away() {
    let mut bench = Bench::new(20);
    bench.all(&CLOCKS_AND_PINS);
    bench.memory.bytes_mut(START_WORD, 4).expect("memory").copy_from_slice(&0x201u32.to_le_bytes());
    bench.now = PER_SECOND / 1000;
    bench.converter_register(3, 0x0f22);
    bench.all(&[
        // SPI1: 16 MHz, bytes, receive only, own chip select, frames of 18 bytes.
        (0x4001_3008, 1 << 28 | 1 << 14 | 7),
        (0x4001_300c, 1 << 29 | 1 << 24 | 1 << 22 | 2 << 17),
        (0x4001_3004, FRAME),
        // DMA1 stream 0 takes bytes to a ring, stream 1 writes SPI_CR1 on each capture of TIM1.
        (0x4002_0800, 37),
        (0x4002_0804, 11),
        (0x4002_0014, FRAME * FRAMES),
        (0x4002_0018, 0x4001_3030),
        (0x4002_001c, BUFFER),
        (0x4002_0010, 1 << 10 | 1 << 8 | 3 << 3 | 1),
        (0x4002_002c, 1),
        (0x4002_0030, 0x4001_3000),
        (0x4002_0034, START_WORD),
        (0x4002_0028, 2 << 13 | 2 << 11 | 1 << 8 | 1 << 6 | 1),
        (0x4001_3000, 1),
        // TIM1 counts falling edges of PE9, and each asks for DMA.
        (0x4001_0018, 1),
        (0x4001_0020, 3),
        (0x4001_0008, 5 << 4 | 7),
        (0x4001_000c, 1 << 9),
        (0x4001_0000, 1),
    ]);
    bench.run(PER_SECOND / 100);
    assert_eq!(bench.read(0x4001_0024), 20, "every edge was counted");
    assert_eq!(bench.board.converter.delivered, (0..20).collect::<Vec<_>>());
    // The ring holds the last eight: 17 to 20 at its front, 13 to 16 behind.
    for (slot, number) in [(0, 17u8), (3, 20), (4, 13), (7, 16)] {
        let frame = bench.memory.bytes(BUFFER + slot * FRAME, FRAME).expect("memory");
        assert_eq!(frame[..6], [0x05, 0x0f, 0, 0, 0, number], "slot {slot}: {frame:02x?}");
    }
    assert!(bench.nvic.pending().get(16 + 11), "half and whole buffers interrupt");
}

#[test]
fn what_the_manual_forbids_is_refused() {
    let mut bench = Bench::new(0);
    let refused = |bench: &mut Bench, address, value, words: &str| match bench.write(address, value) {
        Err(Refusal::Stop(line)) => assert!(line.contains(words), "{line}"),
        other => panic!("{address:#x} was {other:?}, not refused for {words}"),
    };
    refused(&mut bench, 0x4001_3000, 1, "SPI1 is used at 0x40013000 while its clock is off");
    bench.all(&CLOCKS_AND_PINS);
    refused(&mut bench, 0x4001_3000, 1 << 9, "started while SPI1 is off");
    refused(&mut bench, 0x4001_3098, 0, "unknown register of SPI1");
    refused(&mut bench, 0x5800_4808, 5, "key");
    refused(&mut bench, 0x5800_4050, 5, "clock is off");
    refused(&mut bench, 0x4007_0000, 5, "nothing is modelled");
    assert_eq!(bench.write(0x9000_0000, 5), Err(Refusal::BusFault));
    // Tightly coupled memory is out of DMA's reach.
    bench.all(&[(0x4002_0800, 11), (0x4002_0014, 1), (0x4002_0018, 0x4001_3000), (0x4002_001c, 0x2000_0000)]);
    bench.all(&[(0x4002_0010, 2 << 13 | 2 << 11 | 1 << 6 | 1), (0x4001_000c, 1 << 9)]);
    refused(&mut bench, 0x4001_0014, 2, "does not reach tightly coupled memory");
}

#[test]
fn the_converters_output_is_two_deep_and_its_reset_shows() {
    let mut bench = Bench::new(100);
    bench.now = PER_SECOND / 1000;
    bench.converter_register(3, 0x0f22);
    let read = |bench: &mut Bench| {
        bench.board.converter.select(true, bench.now);
        let bytes: Vec<u8> = (0..FRAME).map(|_| bench.board.converter.exchange(0, bench.now)).collect();
        bench.board.converter.select(false, bench.now);
        (u16::from_be_bytes([bytes[0], bytes[1]]), bytes[5])
    };
    let period = PER_SECOND / 64_000;
    let begin = bench.board.converter.next_event();
    bench.run(begin);
    assert_eq!(read(&mut bench), (0x4180, 1), "the answer to the register's write, and the first conversion");
    bench.run(begin + 3 * period);
    assert_eq!(read(&mut bench), (0x050f, 3), "of three conversions the latest two are there");
    assert_eq!(read(&mut bench), (0x050f, 4));
    assert_eq!(read(&mut bench).0, 0x0500, "nothing new");
    bench.converter_register(2, 0x0110);
    bench.run(begin + 4 * period);
    assert_eq!(read(&mut bench).0, 0x4100);
    bench.board.converter.reset(bench.now);
    bench.now += PER_SECOND / 1000;
    assert_eq!(read(&mut bench).0, 0xff24);
    assert_eq!(read(&mut bench).0 & 0x0500, 0x0500, "the reset is told until it is taken note of");
}
