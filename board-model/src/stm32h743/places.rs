//! Where peripherals stand and which bit enables their clock (RM0433, chapters 2 and 8).

use super::timer::Place;

/// A peripheral of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Peripheral {
    Rcc,
    Power,
    Flash,
    SystemConfiguration,
    Exti,
    Gpio(usize),
    Dma(usize),
    DmaMux,
    Spi1,
    /// SPI2 to 4.
    Slave(usize),
    Sdmmc1,
    Usart2,
    Usart3,
    Timer(usize),
    Watchdog,
    Debug,
    Rtc,
    Adc,
    /// Error correction of D1's and D2's memories.
    Ecc(usize),
}

/// What was found at an address.
pub(super) struct Found {
    pub peripheral: Peripheral,
    pub name: &'static str,
    pub base: u32,
    /// Offset of the enable register in RCC, and the bit.
    pub enable: Option<(usize, u32)>,
}

const AHB1: usize = 0xd8;
const AHB3: usize = 0xd4;
const AHB4: usize = 0xe0;
const APB1L: usize = 0xe8;
const APB2: usize = 0xf0;
const APB4: usize = 0xf4;

const fn timer(
    name: &'static str,
    base: u32,
    bus: u32,
    bit: u32,
    interrupts: (u16, u16),
    channels: usize,
    requests: (u8, u8),
) -> Place {
    let enable = (if bus == 1 { APB1L } else { APB2 }, bit);
    let wide = matches!(base, 0x4000_0000 | 0x4000_0c00);
    Place { name, base, bus, enable, wide, channels, interrupts, requests }
}

use super::dma::request::*;

/// The timers, in order of their number.
pub(super) const TIMERS: [Place; 13] = [
    timer("TIM1", 0x4001_0000, 2, 0, (25, 27), 4, (TIM1_CH1, TIM1_UP)),
    timer("TIM2", 0x4000_0000, 1, 0, (28, 28), 4, (TIM2_CH1, TIM2_UP)),
    timer("TIM3", 0x4000_0400, 1, 1, (29, 29), 4, (TIM3_CH1, TIM3_UP)),
    timer("TIM4", 0x4000_0800, 1, 2, (30, 30), 4, (TIM4_CH1, TIM4_UP)),
    timer("TIM5", 0x4000_0c00, 1, 3, (50, 50), 4, (TIM5_CH1, TIM5_UP)),
    timer("TIM8", 0x4001_0400, 2, 1, (44, 46), 4, (TIM8_CH1, TIM8_UP)),
    timer("TIM12", 0x4000_1800, 1, 6, (43, 43), 2, (0, 0)),
    timer("TIM13", 0x4000_1c00, 1, 7, (44, 44), 1, (0, 0)),
    timer("TIM14", 0x4000_2000, 1, 8, (45, 45), 1, (0, 0)),
    timer("TIM15", 0x4001_4000, 2, 16, (116, 116), 2, (0, 0)),
    timer("TIM16", 0x4001_4400, 2, 17, (117, 117), 1, (0, 0)),
    timer("TIM17", 0x4001_4800, 2, 18, (118, 118), 1, (0, 0)),
    timer("TIM6", 0x4000_1000, 1, 4, (54, 54), 0, (0, 0)),
];

/// The peripheral at an address.
pub(super) fn place(address: u32) -> Option<Found> {
    let found = |peripheral, name, base, enable| Some(Found { peripheral, name, base, enable });
    let block = address & !0x3ff;
    match block {
        0x5802_4400 => found(Peripheral::Rcc, "RCC", block, None),
        0x5802_4800 => found(Peripheral::Power, "PWR", block, None),
        0x5200_2000 => found(Peripheral::Flash, "FLASH", block, None),
        0x5800_0400 => found(Peripheral::SystemConfiguration, "SYSCFG", block, Some((APB4, 1))),
        0x5800_0000 => found(Peripheral::Exti, "EXTI", block, None),
        0x5802_0000..0x5802_2c00 => {
            let port = (address - 0x5802_0000) >> 10;
            found(Peripheral::Gpio(port as usize), "GPIO", block, Some((AHB4, port)))
        }
        0x4002_0000 => found(Peripheral::Dma(0), "DMA1", block, Some((AHB1, 0))),
        0x4002_0400 => found(Peripheral::Dma(1), "DMA2", block, Some((AHB1, 1))),
        0x4002_0800 => found(Peripheral::DmaMux, "DMAMUX1", block, None),
        0x4001_3000 => found(Peripheral::Spi1, "SPI1", block, Some((APB2, 12))),
        0x4000_3800 => found(Peripheral::Slave(0), "SPI2", block, Some((APB1L, 14))),
        0x4000_3c00 => found(Peripheral::Slave(1), "SPI3", block, Some((APB1L, 15))),
        0x4001_3400 => found(Peripheral::Slave(2), "SPI4", block, Some((APB2, 13))),
        0x5200_7000 => found(Peripheral::Sdmmc1, "SDMMC1", block, Some((AHB3, 16))),
        0x4000_4400 => found(Peripheral::Usart2, "USART2", block, Some((APB1L, 17))),
        0x4000_4800 => found(Peripheral::Usart3, "USART3", block, Some((APB1L, 18))),
        0x5800_4800 => found(Peripheral::Watchdog, "IWDG1", block, None),
        0x5800_4000 => found(Peripheral::Rtc, "RTC", block, Some((APB4, 16))),
        0x5802_6000 => found(Peripheral::Adc, "ADC3", block, Some((AHB4, 24))),
        0x5200_9000 => found(Peripheral::Ecc(0), "RAMECC1", block, None),
        0x4802_3000 => found(Peripheral::Ecc(1), "RAMECC2", block, None),
        0x5c00_1000 => found(Peripheral::Debug, "DBGMCU", block, None),
        _ => {
            let index = TIMERS.iter().position(|timer| timer.base == block)?;
            let timer = &TIMERS[index];
            found(Peripheral::Timer(index), timer.name, block, Some(timer.enable))
        }
    }
}
