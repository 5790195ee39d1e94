//! What records take on the line: counted in a run, and the most there can be.

use seabearing_core::array::{BEARINGS_A_STEP, ONE_TRANSIENT_IN_S, SHAFT_RATE_EVERY_S};
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::intake::faults::A_MINUTE;
use seabearing_core::obs::limits::{AZIMUTH_MODES, RANGE_MODES, VESSELS};
use seabearing_core::obs::plan::STEP_S;
use seabearing_core::recorder::TIME_EVERY_S;
use seabearing_core::traffic;
use seabearing_core::wire::{
    AZIGRAM_BANDS, Azigram, Azimuth, BANDS, Bearing, Encoder, Fault, FaultCode, FaultsHeld, Health, Margins,
    Message, Range, ShaftRate, Spectrum, Time, Track, Transient,
};

/// Bytes of a message's frame.
pub fn frame_bytes(message: &Message) -> u64 {
    Encoder::default().frame(message).len() as u64
}

/// Records of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Bearings.
    pub bearings: u64,
    /// Bytes of their frames.
    pub bearing_bytes: u64,
    /// Bytes of what else is found or goes wrong: greeting, health, answers, what was asked for and the end are not in it.
    pub other_bytes: u64,
}

impl Tally {
    /// Counts.
    pub fn of(messages: &[Message]) -> Self {
        let mut tally = Self::default();
        for message in messages {
            match message {
                Message::Bearing(_) => {
                    tally.bearings += 1;
                    tally.bearing_bytes += frame_bytes(message);
                }
                Message::Spectrum(spectrum) if spectrum.is_unasked() => {
                    tally.other_bytes += frame_bytes(message);
                }
                Message::Hello(_)
                | Message::Health(_)
                | Message::Reply(_)
                | Message::End(_)
                | Message::Time(_)
                | Message::Snippet(_)
                | Message::Samples(_)
                | Message::Spectrum(_) => {}
                _ => tally.other_bytes += frame_bytes(message),
            }
        }
        tally
    }
}

/// Years after which numbers are as long as they get in these figures.
const YEARS: f64 = 10.0;

fn after_years(rate_hz: f64) -> u64 {
    (YEARS * 365.25 * 86_400.0 * rate_hz) as u64
}

/// A health report as long as it gets, and what a board tells of itself after it, in bytes.
pub fn report_bytes(rate_hz: f64) -> u64 {
    frame_bytes(&health(rate_hz)) + frame_bytes(&margins(after_years(rate_hz)))
}

/// What is said of a pause by the schedule when it begins, in bytes.
pub fn pause_bytes(rate_hz: f64) -> u64 {
    let index = after_years(rate_hz);
    frame_bytes(&Message::Fault(Fault { code: FaultCode::Paused, index, value: index as i64 }))
}

fn health(rate_hz: f64) -> Message {
    let most = after_years(rate_hz);
    Message::Health(Health {
        index: most,
        processed: most,
        lost: [most; 6],
        channels: u8::MAX,
        level_half_db: [i8::MIN; 4],
        records: u32::MAX,
        frames_dropped: u32::MAX,
    })
}

fn margins(index: u64) -> Message {
    let most = u32::MAX;
    let (voltage, temperature_c) = (Some(u16::MAX), Some(i8::MIN));
    Message::Margins(Margins {
        index,
        memory: most,
        memory_free: most,
        longest_us: most,
        waiting: most,
        room: most,
        supply_mv: voltage,
        battery_mv: voltage,
        temperature_c,
    })
}

/// The most bytes a second that a recorder says: so many vessels at once, all that one minute may hold of faults of every
/// kind, health every so many seconds.
pub fn most_per_s(config: &StationConfig, vessels: u32, health_s: f64) -> f64 {
    let index = after_years(config.rate_hz);
    let bytes = |message| frame_bytes(&message) as f64;
    let track = bytes(track(index));
    let found = match &config.kind {
        Kind::Array(array) => {
            f64::from(BEARINGS_A_STEP) * bytes(bearing(index)) / array.step_s
                + f64::from(vessels) * track / traffic::Config::new(config).report_s
                + bytes(shaft_rate(index)) / SHAFT_RATE_EVERY_S
                // Told by themselves, and the strongest of the others each minute.
                + bytes(transient(index)) * (1.0 / f64::from(ONE_TRANSIENT_IN_S) + 1.0 / 60.0)
        }
        // Azimuths of tones and one of calls, ranges, an azigram, and at most a track of each vessel.
        Kind::Obs(obs) => {
            ((AZIMUTH_MODES + 1) as f64 * bytes(azimuth(index))
                + RANGE_MODES as f64 * bytes(range(index))
                + f64::from(u8::from(obs.azigram)) * bytes(azigram(index))
                + f64::from(vessels.min(VESSELS as u32)) * track)
                / STEP_S
        }
        Kind::Line(_) => 0.0,
    };
    let held = FaultsHeld { code: FaultCode::Gap, index, count: u32::MAX, value: i64::MAX };
    let faults = FaultCode::ALL.len() as f64 * (f64::from(A_MINUTE) + 1.0) * bytes(Message::FaultsHeld(held));
    let report = report_bytes(config.rate_hz) as f64;
    let health = if health_s > 0.0 { report / health_s } else { 0.0 };
    // Of a recorder that hears a satellite receiver.
    let time = bytes(time(index)) / TIME_EVERY_S as f64;
    let levels = match config.levels.every_s {
        0 => 0.0,
        every_s => bytes(spectrum(index)) / f64::from(every_s),
    };
    found + faults / 60.0 + health + time + levels
}

fn bearing(index: u64) -> Message {
    let x = 0.0;
    Message::Bearing(Bearing {
        index,
        azimuth: x,
        elevation: x,
        var_azimuth: x,
        var_elevation: x,
        cov: x,
        snr_db: x,
        quality: x,
        closure_s: x,
        statistic: x,
        band: 0,
        flags: 0,
    })
}

fn track(index: u64) -> Message {
    let x = 0.0;
    Message::Track(Track {
        id: u16::MAX,
        stage: 0,
        index,
        cpa_time_s: 0.0,
        cpa_range_m: x,
        cpa_azimuth: x,
        heading: x,
        speed_m_s: x,
        starboard: false,
        sd_cpa_time_s: x,
        sd_cpa_range_m: x,
        sd_heading: x,
        sd_speed_m_s: x,
        x_m: x,
        y_m: x,
        var_x_m2: x,
        var_y_m2: x,
        cov_xy_m2: x,
        range_observable: false,
        n: u16::MAX,
    })
}

fn shaft_rate(index: u64) -> Message {
    let x = 0.0;
    Message::ShaftRate(ShaftRate {
        index,
        rate_hz: x,
        sd_hz: x,
        confidence: x,
        ln_false_alarm: x,
        harmonics: 0,
        blades: 0,
        speed_m_s: x,
        sd_speed_m_s: x,
        track: u16::MAX,
    })
}

fn transient(index: u64) -> Message {
    let x = 0.0;
    Message::Transient(Transient {
        index,
        duration: u32::MAX,
        count: u32::MAX,
        peak_tenth_db: i16::MIN,
        azimuth: x,
        elevation: x,
        var_azimuth: x,
        var_elevation: x,
        cov: x,
        channel: 0,
        channels: u8::MAX,
        kind: 0,
    })
}

fn time(index: u64) -> Message {
    let x = 0.0;
    Message::Time(Time { index, utc_us: i64::MAX, sd_s: x, drift: x, sd_drift: x, correlation: x })
}

fn azimuth(index: u64) -> Message {
    let x = 0.0;
    Message::Azimuth(Azimuth {
        index,
        azimuth: x,
        sd: x,
        log_presence: x,
        weight: x,
        detected: false,
        kind: 0,
    })
}

fn range(index: u64) -> Message {
    let x = 0.0;
    Message::Range(Range {
        index,
        range_m: x,
        sd_range_m: x,
        speed_m_s: x,
        sd_speed_m_s: x,
        log_presence: x,
        weight: x,
        detected: false,
    })
}

fn spectrum(index: u64) -> Message {
    let (token, channel, of, frames) = (Spectrum::UNASKED, u8::MAX, 0, u16::MAX);
    let tenth_db = [Spectrum::NOTHING; BANDS];
    Message::Spectrum(Spectrum { token, index, channel, of, frames, bin_hz: 0.0, tenth_db })
}

fn azigram(index: u64) -> Message {
    let most = [u8::MAX; AZIGRAM_BANDS];
    Message::Azigram(Azigram {
        index,
        frames: u8::MAX,
        bin_hz: 0.0,
        first_bin: u16::MAX,
        bins: u16::MAX,
        azimuth: most,
        coherence: most,
    })
}
