//! The recorder on the STM32H743: built and linked, never run on silicon.
#![no_std]
#![no_main]
#![allow(unsafe_code)]

#[cfg(feature = "defmt")]
use defmt_rtt as _;

use cortex_m_rt::entry;
use embassy_executor::InterruptExecutor;
use embassy_stm32::exti::{self, ExtiInput};
use embassy_stm32::gpio::{Level, Output, Pull, Speed};
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::time::Hertz;
use embassy_stm32::usart::Uart;
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{bind_interrupts, dma, peripherals, spi, usart};
use heapless::spsc::Queue;
use seabearing_core::block::Frame;
use seabearing_core::config_blob::{self, PROPAGATION};
use seabearing_core::recorder::Memory;
use seabearing_core::run::{BLOCK_FRAMES, run};
use seabearing_firmware::acquisition::{Inlet, Numbered, Outlet, QUEUE_FRAMES};
use seabearing_firmware::converter::Rate;
use seabearing_firmware::stm32h743::link::{RING_BYTES, Serial, transmit};
use seabearing_firmware::stm32h743::sampling::{Selected, pacer, sample};
use seabearing_firmware::stm32h743::{Board, Cycles, WATCHDOG_US, clocks, wake};

/// The station, as `seabearing blob` wrote it when the image was built.
static BLOB: &[u8] = include_bytes!(env!("SEABEARING_STATION_BLOB"));

bind_interrupts!(struct Interrupts {
    DMA1_STREAM0 => dma::InterruptHandler<peripherals::DMA1_CH0>;
    DMA1_STREAM1 => dma::InterruptHandler<peripherals::DMA1_CH1>;
    DMA1_STREAM2 => dma::InterruptHandler<peripherals::DMA1_CH2>;
    DMA1_STREAM3 => dma::InterruptHandler<peripherals::DMA1_CH3>;
    EXTI9_5 => exti::InterruptHandler<interrupt::typelevel::EXTI9_5>;
    USART3 => usart::InterruptHandler<peripherals::USART3>;
});

/// Runs the tasks that wait for interrupts, above the recorder's loop.
static TASKS: InterruptExecutor = InterruptExecutor::new();

#[interrupt]
unsafe fn UART4() {
    // SAFETY: this is the interrupt the executor was started with.
    unsafe { TASKS.on_interrupt() }
}

#[entry]
fn main() -> ! {
    static mut FRAMES: [Frame; BLOCK_FRAMES] = [[0; 4]; BLOCK_FRAMES];
    static mut MEMORY: Memory<'static> = Memory::new();
    static mut QUEUE: Queue<Numbered, QUEUE_FRAMES> = Queue::new();
    static mut RING: [u8; RING_BYTES] = [0; RING_BYTES];

    let p = embassy_stm32::init(clocks());
    let mut board = Board::new(IndependentWatchdog::new(p.IWDG1, WATCHDOG_US));
    let Some(mut core) = cortex_m::Peripherals::take() else { cortex_m::peripheral::SCB::sys_reset() };
    core.SCB.enable_icache();
    let mut cycles = Cycles::start(&mut core.DCB, &mut core.DWT);

    let Ok(config) = config_blob::station(BLOB) else { panic!("no valid configuration in this image") };
    let table = config_blob::section(BLOB, PROPAGATION).ok();
    let Ok(mut recorder) = MEMORY.configure(&config, table) else {
        panic!("no recorder for this configuration")
    };
    let Some(rate) = Rate::of(config.rate_hz) else { panic!("the converter has no such sample rate") };

    let mut serial = usart::Config::default();
    serial.baudrate = 921_600;
    let Ok(uart) = Uart::new(p.USART3, p.PD9, p.PD8, p.DMA1_CH0, p.DMA1_CH1, Interrupts, serial) else {
        panic!("the serial port does not take its configuration")
    };
    let (tx, rx) = uart.split();
    let mut link = Serial::new(rx.into_ring_buffered(RING));

    let mut bus = spi::Config::default();
    bus.mode = spi::MODE_1;
    bus.frequency = Hertz(20_000_000);
    let bus = spi::Spi::new(p.SPI1, p.PA5, p.PB5, p.PA6, p.DMA1_CH2, p.DMA1_CH3, Interrupts, bus);
    let device = Selected::new(bus, Output::new(p.PD14, Level::High, Speed::VeryHigh));
    let ready = ExtiInput::new(p.PE9, p.EXTI9, Pull::None, Interrupts);
    let (producer, consumer) = QUEUE.split();

    interrupt::UART4.set_priority(Priority::P6);
    let spawner = TASKS.start(interrupt::UART4);
    let inlet = Inlet::new(producer, pacer(config.rate_hz));
    let (Ok(transmit), Ok(sample), Ok(wake)) = (transmit(tx), sample(device, ready, rate, inlet), wake())
    else {
        panic!("a task was started twice")
    };
    spawner.spawn(wake);
    spawner.spawn(transmit);
    spawner.spawn(sample);

    let mut samples = Outlet::new(consumer);
    run(&mut recorder, &mut samples, &mut link, &mut cycles, &mut board, FRAMES);
    // Stopped by command: the watchdog starts everything again.
    loop {
        cortex_m::asm::wfi();
    }
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    seabearing_firmware::fault::record_and_reset(info)
}
