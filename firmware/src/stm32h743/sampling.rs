//! The converter's data-ready interrupt to the queue of numbered frames.

use crate::acquisition::{Inlet, Pacer};
use crate::converter::{Converter, Rate};
use cortex_m::peripheral::DWT;
use embassy_stm32::exti::ExtiInput;
use embassy_stm32::gpio::Output;
use embassy_stm32::mode::Async;
use embassy_stm32::spi::{Spi, mode::Master};
use embedded_hal_async::spi::{ErrorType, Operation, SpiBus, SpiDevice};

/// The converter alone on its bus: selected for the length of one transaction.
pub struct Selected {
    bus: Spi<'static, Async, Master>,
    select: Output<'static>,
}

impl Selected {
    /// A bus and its chip select (active low).
    pub fn new(bus: Spi<'static, Async, Master>, select: Output<'static>) -> Self {
        Self { bus, select }
    }
}

impl ErrorType for Selected {
    type Error = embassy_stm32::spi::Error;
}

impl SpiDevice for Selected {
    async fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Self::Error> {
        self.select.set_low();
        let mut result = Ok(());
        for operation in operations {
            result = match operation {
                Operation::Read(bytes) => SpiBus::read(&mut self.bus, bytes).await,
                Operation::Write(bytes) => SpiBus::write(&mut self.bus, bytes).await,
                Operation::Transfer(read, write) => SpiBus::transfer(&mut self.bus, read, write).await,
                Operation::TransferInPlace(bytes) => SpiBus::transfer_in_place(&mut self.bus, bytes).await,
                // The converter needs no pauses within a frame.
                Operation::DelayNs(_) => Ok(()),
            };
            if result.is_err() {
                break;
            }
        }
        self.select.set_high();
        result
    }
}

/// Sets the converter up and reads every conversion, for ever. A converter that does not answer is tried again: the
/// recorder's loop sees no samples and says so by the board's clock.
#[embassy_executor::task]
pub async fn sample(
    mut device: Selected,
    mut ready: ExtiInput<'static, Async>,
    rate: Rate,
    mut inlet: Inlet<'static>,
) -> ! {
    let mut converter = loop {
        match Converter::new(&mut device, rate, 0).await {
            Ok(converter) => break converter,
            Err(_) => embassy_time::Timer::after_millis(100).await,
        }
    };
    loop {
        ready.wait_for_falling_edge().await;
        let ticks = DWT::cycle_count();
        inlet.push(ticks, converter.read_or_missing().await);
    }
}

/// A pacer in cycles of the core.
pub fn pacer(rate_hz: f64) -> Pacer {
    Pacer::new((f64::from(super::CORE_HZ) / rate_hz) as u32)
}
