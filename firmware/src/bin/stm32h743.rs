//! The recorder on the STM32H743: it runs with its real drivers in an emulator; not yet on silicon. With the feature `link` its
//! records wait in flash until the base station has them, with `card` its sound is recorded too, with `seismic` its converters are an ocean-bottom recorder's, which has the link too.
#![no_std]
#![no_main]
#![allow(unsafe_code)]

#[cfg(feature = "defmt")]
use defmt_rtt as _;

use core::mem::MaybeUninit;
use cortex_m_rt::{ExceptionFrame, entry, exception};
use embassy_executor::InterruptExecutor;
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_stm32::usart::{Uart, UartRx};
use embassy_stm32::wdg::IndependentWatchdog;
use embassy_stm32::{bind_interrupts, dma, peripherals, usart};
use seabearing_core::block::Frame;
use seabearing_core::config_blob::{self, PROPAGATION};
use seabearing_core::outlet::Plain;
#[cfg(feature = "card")]
use seabearing_core::port::Clock;
use seabearing_core::recorder::Memory;
#[cfg(feature = "link")]
use seabearing_core::recorder::configuration;
use seabearing_core::run::{BLOCK_FRAMES, run_over};
use seabearing_core::wait::wait;
use seabearing_core::wire::FaultCode;
use seabearing_firmware::acquisition::Acquisition;
use seabearing_firmware::battery::BatteryClock;
#[cfg(feature = "card")]
use seabearing_firmware::card::{
    PAGE,
    clips::Clips,
    search::STAGE_BYTES,
    source::Recorded,
    writer::{About, Tables, Writer},
};
#[cfg(not(feature = "seismic"))]
use seabearing_firmware::converter::Rate as Conversion;
use seabearing_firmware::fault;
use seabearing_firmware::receiver::Timed;
#[cfg(feature = "seismic")]
use seabearing_firmware::seismic::{Conversion, Seismic, chips::Settings};
use seabearing_firmware::stm32h743::battery::CellClock;
use seabearing_firmware::stm32h743::clock::Time;
use seabearing_firmware::stm32h743::gauges::Gauges;
#[cfg(feature = "link")]
use seabearing_firmware::stm32h743::kept;
use seabearing_firmware::stm32h743::link::{Incoming, RING_BYTES, Serial, transmit};
use seabearing_firmware::stm32h743::memory;
use seabearing_firmware::stm32h743::pulse::{self, Satellites, on_pulse};
#[cfg(not(feature = "seismic"))]
use seabearing_firmware::stm32h743::sampling as converters;
#[cfg(feature = "seismic")]
use seabearing_firmware::stm32h743::seismic as converters;
use seabearing_firmware::stm32h743::{
    BAUD, Board, VoltageDetector, WATCHDOG_US, clocks, counter::on_wake, wake, watch_the_start,
};
#[cfg(feature = "card")]
use seabearing_firmware::stm32h743::{sd::SdCard, sram};
use seabearing_firmware::supply::Supplied;

/// The station, as `seabearing blob` wrote it when the image was built.
static BLOB: &[u8] = include_bytes!(env!("SEABEARING_STATION_BLOB"));

/// The key of signed commands: 32 bytes, or none.
#[cfg(feature = "link")]
static KEY: &[u8] = include_bytes!(env!("SEABEARING_KEY"));

/// Whether the recorder could run with a configuration: it is this station's, of a kind that is here, at a rate that the
/// converter has.
#[cfg(feature = "link")]
fn usable(blob: &[u8]) -> bool {
    // Where what was built in is damaged, another that is whole is as good.
    let own = config_blob::station(BLOB).or_else(|_| config_blob::station(blob));
    let config = own.ok().and_then(|own| configuration(blob, own.id));
    config.is_some_and(|config| Conversion::of(config.rate_hz).is_some())
}

/// Pages of sound that wait for the card: 533 ms at 64 kHz.
#[cfg(feature = "card")]
const WAITING_PAGES: usize = 25;

/// What stands in the D2 domain's SRAM, so that AXI SRAM has room for sound.
#[cfg(feature = "card")]
struct InSram {
    samples: converters::Ring,
    kept: kept::Memory,
    tables: MaybeUninit<Tables>,
}

#[cfg(feature = "card")]
#[unsafe(link_section = ".sram")]
static mut IN_SRAM: InSram =
    InSram { samples: converters::EMPTY, kept: kept::Memory::new(), tables: MaybeUninit::uninit() };

bind_interrupts!(struct Interrupts {
    DMA2_STREAM0 => dma::InterruptHandler<peripherals::DMA2_CH0>;
    DMA2_STREAM1 => dma::InterruptHandler<peripherals::DMA2_CH1>;
    DMA2_STREAM2 => dma::InterruptHandler<peripherals::DMA2_CH2>;
    USART2 => usart::InterruptHandler<peripherals::USART2>;
    USART3 => usart::InterruptHandler<peripherals::USART3>;
});

/// Runs the tasks that wait for interrupts, above the recorder's loop.
static TASKS: InterruptExecutor = InterruptExecutor::new();

#[interrupt]
unsafe fn UART4() {
    // SAFETY: this is the interrupt the executor was started with.
    unsafe { TASKS.on_interrupt() }
}

#[interrupt]
fn TIM1_CC() {
    on_wake();
}

#[interrupt]
fn TIM5() {
    on_pulse();
}

#[cfg(feature = "seismic")]
#[interrupt]
fn FLASH() {
    seabearing_firmware::stm32h743::flash::on_end();
}

#[entry]
fn main() -> ! {
    static mut FRAMES: [Frame; BLOCK_FRAMES] = [[0; 4]; BLOCK_FRAMES];
    static mut MEMORY: Memory<'static> = Memory::new();
    #[cfg(not(feature = "card"))]
    static mut SAMPLES: converters::Ring = converters::EMPTY;
    #[cfg(all(feature = "link", not(feature = "card")))]
    static mut KEPT: kept::Memory = kept::Memory::new();
    #[cfg(feature = "card")]
    static mut SOUND: [[u8; PAGE]; WAITING_PAGES] = [[0; PAGE]; WAITING_PAGES];
    #[cfg(feature = "card")]
    static mut STAGE: [u8; STAGE_BYTES] = [0; STAGE_BYTES];
    static mut LINE: MaybeUninit<Serial> = MaybeUninit::uninit();
    static mut RING: [u8; RING_BYTES] = [0; RING_BYTES];
    static mut SENTENCES: [u8; pulse::RING_BYTES] = [0; pulse::RING_BYTES];

    // The watchdog first: what follows waits for hardware.
    watch_the_start();
    let p = embassy_stm32::init(clocks());
    // SAFETY: all of it is valid as zeros, none of it was touched, and here alone is it taken.
    #[cfg(feature = "card")]
    #[allow(non_snake_case)]
    let (SAMPLES, KEPT, TABLES) = unsafe {
        sram::open();
        let at = &raw mut IN_SRAM;
        (&mut (*at).samples, &mut (*at).kept, &mut (*at).tables)
    };
    let mut watchdog = IndependentWatchdog::new(p.IWDG1, WATCHDOG_US);
    watchdog.unleash();
    let mut board = Board::new(watchdog);
    let Some(mut core) = cortex_m::Peripherals::take() else { cortex_m::peripheral::SCB::sys_reset() };
    core.SCB.enable_icache();
    let mut time = Time::start(p.TIM5, &mut core.DCB, &mut core.DWT);

    let mut serial = usart::Config::default();
    serial.baudrate = BAUD;
    let Ok(uart) = Uart::new(p.USART3, p.PD9, p.PD8, p.DMA2_CH0, p.DMA2_CH1, Interrupts, serial) else {
        panic!("the serial port does not take its configuration")
    };
    let (tx, rx) = uart.split();
    let line = LINE.write(Serial::new(Incoming::new(rx.into_ring_buffered(RING), 1, RING_BYTES)));
    let mut serial = usart::Config::default();
    serial.baudrate = 9600;
    let Ok(sentences) = UartRx::new(p.USART2, p.PD6, p.DMA2_CH2, Interrupts, serial) else {
        panic!("the receiver's port does not take its configuration")
    };
    let satellites =
        Satellites::new(p.PA0, Incoming::new(sentences.into_ring_buffered(SENTENCES), 2, pulse::RING_BYTES));

    interrupt::UART4.set_priority(Priority::P6);
    let spawner = TASKS.start(interrupt::UART4);
    let (Ok(transmit), Ok(wake)) = (transmit(tx), wake()) else { panic!("a task was started twice") };
    spawner.spawn(wake);
    spawner.spawn(transmit);

    // Before all that earlier starts may have crashed on: gauges, configuration and records in flash.
    let too_many = board.must_wait();
    if too_many.is_some() && board.crashed_waiting() {
        let station = config_blob::station(BLOB).map_or(0, |config| config.id);
        #[cfg(feature = "link")]
        let mut outlet = Plain::deaf(line, !KEY.is_empty());
        #[cfg(not(feature = "link"))]
        let mut outlet = Plain::new(line);
        wait(station, too_many, &mut outlet, &mut time, &mut board);
        outlet.line().flush(&mut board);
        board.start_again()
    }
    board.gauge(Gauges::start(p.ADC3));
    #[cfg(feature = "link")]
    let kept = KEPT.open(p.FLASH, &mut core.MPU, usable);
    #[cfg(feature = "link")]
    let blob = kept.blob().unwrap_or(BLOB);
    #[cfg(not(feature = "link"))]
    let blob = BLOB;
    let (config, table) = (config_blob::station(blob), config_blob::section(blob, PROPAGATION).ok());
    let station = config.as_ref().map_or(0, |config| config.id);
    let rate = config.as_ref().ok().and_then(|config| Conversion::of(config.rate_hz));
    // Why there is nothing to record, where that is so.
    let bad = |number| Err((FaultCode::BadConfiguration, number));
    let recorder = match (&config, too_many) {
        (_, Some(reason)) => Err(reason),
        (Err(_), _) => bad(0),
        (Ok(config), _) => match (MEMORY.configure(config, table), rate) {
            (Ok(recorder), Some(rate)) => Ok((recorder, rate)),
            (Err(_), _) => bad(1),
            (Ok(_), None) => bad(2),
        },
    };

    #[cfg(feature = "link")]
    let mut outlet = {
        let who = (station, config.as_ref().map_or(0, |config| config.hash()));
        kept.over(line, BAUD, who, KEY, &mut board)
    };
    #[cfg(not(feature = "link"))]
    let mut outlet = Plain::new(line);
    let reason = match recorder {
        Ok((mut recorder, rate)) => {
            board.watch(recorder.settings());
            let cell = BatteryClock::new(CellClock::start(p.RTC));
            #[cfg(not(feature = "seismic"))]
            let samples = {
                let claimed = ((p.SPI1, p.TIM1, p.TIM2), (p.PA4, p.PA5, p.PA6, p.PB5, p.PE9));
                let converter = converters::Sampling::new(claimed, SAMPLES, rate, 0);
                Timed::with_cell(Acquisition::new(converter), satellites, cell)
            };
            #[cfg(feature = "seismic")]
            let samples = {
                let claimed = (
                    (p.SPI1, p.SPI2, p.SPI3, p.SPI4),
                    (p.TIM1, p.TIM2),
                    (p.PA5, p.PA6, p.PB5, p.PB13, p.PB15),
                    (p.PC10, p.PC12, p.PE12, p.PE14),
                    (p.PD14, p.PD15, p.PE9, p.PE11),
                );
                let settings = Settings { rate: rate.rate, gain_log2: 0 };
                let chips = converters::Chips::new(claimed, SAMPLES, settings);
                Seismic::new(Timed::with_cell(Acquisition::new(chips), satellites, cell), rate)
            };
            let samples = Supplied::new(samples, VoltageDetector::start());
            #[cfg(not(feature = "card"))]
            let mut samples = samples;
            #[cfg(feature = "card")]
            let mut samples = {
                let about = About {
                    session: outlet.link().store().starts(),
                    station,
                    rate_hz: rate.hz(),
                    config_hash: config.as_ref().map_or(0, |config| config.hash()),
                    clips: config
                        .as_ref()
                        .map_or(Clips::default(), |config| Clips::new(config.clips, rate.hz())),
                };
                let card = SdCard::new((p.SDMMC1, (p.PC8, p.PC9, p.PC10, p.PC11), (p.PC12, p.PD2)));
                Recorded::new(
                    samples,
                    Writer::new(card, SOUND, STAGE, TABLES.write(const { Tables::new() }), about),
                )
            };
            run_over(&mut recorder, &mut samples, &mut outlet, &mut time, &mut board, FRAMES);
            board.rest();
            #[cfg(feature = "card")]
            samples.settle(&mut board, || time.micros());
            #[cfg(feature = "card")]
            let samples = samples.source();
            samples.has_failed().then(|| board.supply_failed())
        }
        Err(reason) => Some(reason),
    };
    // Stopped by command or by low supply, or nothing to record: the link lives.
    #[cfg(not(feature = "link"))]
    let mut outlet = Plain::new(outlet.into_line());
    #[cfg(feature = "link")]
    if matches!(reason, Some((FaultCode::BadConfiguration, _))) {
        outlet.keeper().give_up();
    }
    #[cfg(feature = "link")]
    let waits = !outlet.restarts();
    #[cfg(not(feature = "link"))]
    let waits = true;
    if waits {
        wait(station, reason, &mut outlet, &mut time, &mut board);
    }
    #[cfg(feature = "link")]
    kept::settle(&mut outlet, &mut time, &mut board);
    outlet.line().flush(&mut board);
    board.start_again()
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    // SAFETY: nothing else runs any more.
    let status = unsafe { (*cortex_m::peripheral::SCB::PTR).cfsr.read() };
    let record = memory::not_corrected().unwrap_or(fault::Record::processor(frame.pc(), status));
    fault::keep_and_reset(record)
}

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    if let Some(record) = memory::not_corrected() {
        fault::keep_and_reset(record);
    }
    fault::record_and_reset(info)
}
