//! What the tracks of eight vessels cost on the emulated board: the worst work between two looks at the time.
//!
//! Eight vessels 45° apart pass 164 m above the array at 500 m and more, heard twice a second, elevations included, for
//! 150 s; after 60 s all turn by 60° at once, and then all fall silent in the same instant, so that eight passages end together. Leaves in `summary.bin` six words `u64le`:
//! ticks of the worst step of 512 instants while they are heard, of the worst while they end, of everything, bytes of the
//! tracks, bytes of stack there were, most used. Fails if not every vessel was tracked to its end.
#![no_std]
#![no_main]
#![allow(unsafe_code)]

use cortex_m_rt::entry;
use seabearing_core::angle::wrap_tau;
use seabearing_core::config::Tracking;
use seabearing_core::intake::GRID;
use seabearing_core::math::f64 as m;
use seabearing_core::passage;
use seabearing_core::port::Clock;
use seabearing_core::traffic::{self, Config, State, VESSELS};
use seabearing_core::wire::{Bearing, Message};
use seabearing_firmware::mps2_an500::measurement::{Impulses, end};
use seabearing_firmware::mps2_an500::{clock::BoardClock, host::fail};
use seabearing_firmware::stack;

/// Sample instants a second, and between two bearings.
const RATE_HZ: f64 = 64_000.0;
const BETWEEN: u64 = 32_000;
/// Seconds until the turn, and until nothing is heard.
const TURN_S: f64 = 60.0;
const HEARD_S: f64 = 150.0;
/// Standard deviation of the bearings, radians.
const SD_RAD: f64 = 0.01;
const SPEED_M_S: f64 = 7.0;
const HEIGHT_M: f64 = 164.0;

/// Azimuth and elevation at which a vessel is seen at a time of reception, travel time left out.
fn direction(vessel: usize, t_s: f64) -> (f64, f64) {
    let range_m = 500.0 + 40.0 * vessel as f64;
    let along = SPEED_M_S * (t_s.min(TURN_S) - 70.0);
    let beyond = SPEED_M_S * (t_s - TURN_S).max(0.0);
    let (x, y) = (along + 0.5 * beyond, range_m + 0.866 * beyond);
    let azimuth = wrap_tau(m::atan2(x, y) + m::TAU * vessel as f64 / VESSELS as f64);
    (azimuth, m::atan2(HEIGHT_M, m::hypot(x, y)))
}

fn heard(index: u64, azimuth: f64, elevation: f64) -> Bearing {
    let variance = (SD_RAD * SD_RAD) as f32;
    Bearing {
        index,
        azimuth: azimuth as f32,
        elevation: elevation as f32,
        var_azimuth: variance,
        var_elevation: variance,
        cov: 0.0,
        snr_db: 10.0,
        quality: 1.0,
        closure_s: 0.0,
        statistic: 2.0,
        band: 0,
        flags: 0,
    }
}

#[entry]
fn main() -> ! {
    static mut STATE: State = State::new();

    let Some(peripherals) = cortex_m::Peripherals::take() else { fail(c"started twice\n") };
    let mut clock = BoardClock::new(peripherals.SYST);
    let mut motion = passage::Config::new(&Tracking::default(), 1484.0);
    motion.medium.height_m = HEIGHT_M;
    let config = Config::with(motion, RATE_HZ);
    let mut random = Impulses(1);
    let (mut ended, mut worst, mut total) = (0usize, [0u64; 2], 0u64);
    let last = (HEARD_S * RATE_HZ) as u64;
    let mut index = 0u64;
    while index < last + (50.0 * RATE_HZ) as u64 {
        let mut sink = |message| {
            if let Message::Track(track) = message {
                ended += usize::from(track.stage == 1);
            }
        };
        let before = clock.ticks();
        if index < last && index % BETWEEN < GRID {
            let at = index / BETWEEN * BETWEEN;
            for vessel in 0..VESSELS {
                let (azimuth, elevation) = direction(vessel, at as f64 / RATE_HZ);
                let (azimuth, elevation) =
                    (azimuth + SD_RAD * random.draw(), elevation + SD_RAD * random.draw());
                traffic::bearing(&config, STATE, &heard(at.max(1), azimuth, elevation), &mut sink);
            }
        }
        index += GRID;
        traffic::advance(&config, STATE, index, &mut sink);
        let spent = u64::from(clock.ticks().wrapping_sub(before));
        total += spent;
        let phase = &mut worst[usize::from(index > last)];
        *phase = (*phase).max(spent);
    }
    if STATE.vessels() != 0 || ended < VESSELS {
        fail(c"not every vessel was tracked to its end\n");
    }
    let (stack, used) = stack::used();
    let bytes = size_of::<State>() as u64;
    let words = [worst[0], worst[1], total, bytes, u64::from(stack), u64::from(used)];
    end(&words)
}

seabearing_firmware::fail_on_faults!();
