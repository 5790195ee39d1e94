//! The satellite receiver of the modelled board: a pulse each second and a sentence after it, and what may go wrong with both.

use super::{InjectedFault, ticks};
use seabearing_board_model::Machine;
use seabearing_board_model::stm32h743::Stm32h743;
use time::OffsetDateTime;

/// UTC at power-on, seconds since 1970: 2026-09-21 14:13:20.
const START_UTC_S: i64 = 1_790_000_000;
/// The first pulse after power-on, s.
const FIRST_S: f64 = 0.1;
/// Length of a pulse, and from its beginning to that of the sentence.
const PULSE_S: f64 = 0.1;
const SENTENCE_S: f64 = 0.15;

/// What the receiver would say of a second of the run, µs since 1970: its clock is the truth, and it may step.
pub fn utc_us(at_s: f64, faults: &[InjectedFault]) -> f64 {
    (START_UTC_S + stepped_s(at_s, faults)) as f64 * 1e6 + (at_s - FIRST_S) * 1e6
}

/// Seconds by which its clock has stepped.
fn stepped_s(at_s: f64, faults: &[InjectedFault]) -> i64 {
    faults.iter().filter(|f| matches!(**f, InjectedFault::ClockStep(from) if from <= at_s)).count() as i64
}

/// Puts pulses and sentences of so many seconds on the board's pins.
pub(super) fn fill(
    machine: &mut Machine<Stm32h743>,
    faults: &[InjectedFault],
    board_clock_error: f64,
    most_s: f64,
) {
    // The machine's time is the board's.
    let board = |s: f64| ticks(s * (1.0 + board_clock_error));
    let within = |at: f64, from: f64, length: f64| (from..from + length).contains(&at);
    let mut pulses: Vec<(f64, f64)> = Vec::new();
    for second in 0..most_s as i64 {
        let at = FIRST_S + second as f64;
        let lost = |f: &InjectedFault| matches!(*f, InjectedFault::PulseLost(from, length) if within(at, from, length));
        if !faults.iter().any(lost) {
            pulses.push((at, PULSE_S));
        }
        let wrong =
            faults.iter().any(|f| matches!(*f, InjectedFault::SecondWrong(from) if within(at, from, 1.0)));
        let utc_s = START_UTC_S + second + i64::from(wrong) + stepped_s(at, faults);
        let mut sentence = rmc(utc_s);
        for fault in faults {
            if let InjectedFault::SentenceNoise(from, length) = *fault
                && within(at, from, length)
            {
                // One bit in some forty is wrong.
                for (n, byte) in sentence.iter_mut().enumerate() {
                    let mixed = super::mix(second as u64 * 1000 + n as u64);
                    *byte ^= u8::from(mixed.is_multiple_of(5)) << ((mixed >> 32) % 8);
                }
            }
        }
        machine.board.sentence(board(at + SENTENCE_S), &sentence);
    }
    for fault in faults {
        if let InjectedFault::PulseGlitch(at) = *fault {
            pulses.push((at, 1e-6));
        }
    }
    pulses.sort_by(|a, b| a.0.total_cmp(&b.0));
    for (at, length) in pulses {
        machine.board.pulse(board(at), board(at + length));
    }
}

/// The sentence of a second.
fn rmc(utc_s: i64) -> Vec<u8> {
    let utc = OffsetDateTime::from_unix_timestamp(utc_s).unwrap_or(OffsetDateTime::UNIX_EPOCH);
    let (hour, minute, second) = utc.to_hms();
    let (year, month, day) = (utc.year() % 100, u8::from(utc.month()), utc.day());
    let body = format!(
        "GNRMC,{hour:02}{minute:02}{second:02}.00,A,4902.4,N,12319.2,W,0.0,0.0,{day:02}{month:02}{year:02},,,A"
    );
    let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
    format!("${body}*{sum:02X}\r\n").into_bytes()
}
