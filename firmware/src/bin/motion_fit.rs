//! What one batch motion fit costs on the emulated board: 401 bearings of a 200 s passage, linear error model.
//!
//! Fitted twice: with a correlation interval of whole steps, which has a short way through the whitening, and with one
//! between two steps, which takes the Levinson recursion. Leaves in `summary.bin` four words `u64le`: ticks of the first
//! fit, ticks of the second, bytes of stack there were, most used. Fails if a fit is not near the truth.
#![no_std]
#![no_main]
#![allow(unsafe_code)]

use cortex_m_rt::entry;
use seabearing_core::math::f64 as m;
use seabearing_core::motion::{Line, Medium};
use seabearing_core::port::Clock;
use seabearing_firmware::mps2_an500::measurement::{Impulses, end};
use seabearing_firmware::mps2_an500::{clock::BoardClock, host::fail};
use seabearing_firmware::stack;
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::ml::{self, Config, Sample};
use seabearing_locate::motion::whiten::{WhitenMethod, Workspace};

/// Bearings: two a second for 200 s.
const BEARINGS: usize = 401;
/// Standard deviation of their errors, radians (2°), and its correlation interval in steps.
const SD_RAD: f64 = 0.034_9;
const STEPS: u32 = 100;
/// The vessel: closest 500 m away in the middle of the passage, 7 m/s.
const RANGE_M: f64 = 500.0;
const SPEED_M_S: f64 = 7.0;

/// Bearings whose errors are the running sums of equal impulses, which makes the linear model exact.
fn observe(samples: &mut [Sample; BEARINGS], medium: &Medium) {
    let line = Line { p: [-0.7, 100.0, m::ln(SPEED_M_S / RANGE_M), m::ln(SPEED_M_S), 0.0], sense: 1.0 };
    let (mut first, mut last) = (Impulses(1), Impulses(1));
    let mut sum: f64 = (0..STEPS).map(|_| last.draw()).sum();
    for (k, sample) in samples.iter_mut().enumerate() {
        let t_s = 0.5 * k as f64;
        let error = SD_RAD * sum / m::sqrt(f64::from(STEPS));
        *sample = Sample::azimuth(t_s, line.azimuth(medium, t_s) + error, SD_RAD);
        sum += last.draw() - first.draw();
    }
}

#[entry]
fn main() -> ! {
    static mut WORK: Workspace<BEARINGS> = Workspace::new();
    static mut SAMPLES: [Sample; BEARINGS] =
        [const { Sample { t_s: 0.0, azimuth_rad: 0.0, sd_rad: 0.0, elevation_rad: (0.0, 0.0) } }; BEARINGS];

    let Some(peripherals) = cortex_m::Peripherals::take() else { fail(c"started twice\n") };
    let mut clock = BoardClock::new(peripherals.SYST);
    let medium = Medium::of_sound_speed(1484.0);
    observe(SAMPLES, &medium);
    let mut ticks = [0u64; 2];
    let intervals_s = [0.5 * f64::from(STEPS), 0.5 * f64::from(STEPS) + 0.3];
    for (tau_s, ticks) in intervals_s.into_iter().zip(&mut ticks) {
        let config = Config {
            model: Model::Linear,
            tau_s,
            white_share: 0.0,
            speed_m_s: SPEED_M_S,
            speed_sd_m_s: 0.0,
            range_m: (20.0, 20_000.0),
            medium,
            elevation_bias_sd_rad: 0.0,
            acceleration_sd_m_s2: 0.0,
        };
        let before = clock.ticks();
        let fit = ml::fit(&config, SAMPLES, WORK, &mut []);
        *ticks = u64::from(clock.ticks().wrapping_sub(before));
        let Ok(fit) = fit else { fail(c"no fit\n") };
        let short = fit.factorisation.method == WhitenMethod::Differences;
        let error = (fit.solution.cpa_range_m - RANGE_M) / fit.solution.sd_cpa_range_m;
        if !(m::abs(error) < 4.0) || short != (tau_s == intervals_s[0]) {
            fail(c"the fit is wrong\n");
        }
    }
    let (stack, used) = stack::used();
    let words = [ticks[0], ticks[1], u64::from(stack), u64::from(used)];
    end(&words)
}

seabearing_firmware::fail_on_faults!();
