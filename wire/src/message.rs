//! The messages of the recorder. One `enum`, append-only: a variant keeps its number and its fields for ever.
//!
//! Angles are radians, times are sample indices or seconds since sample 0, lengths metres, speeds m/s.
//! A standard deviation of infinity means "not observable". No NaN is ever sent.

use crate::health::LOSS_CAUSES;
pub use crate::margins::Margins;
pub use crate::sound::*;
pub use crate::transient::Transient;
use serde::{Deserialize, Serialize};

/// Version of the framing and of this enum's meaning; goes up only when old decoders would misread.
pub const WIRE_VERSION: u8 = 1;

/// The schema as text: the same lines stand in `docs/wire.md`. Its hash travels in [`Hello`].
pub const SCHEMA: &str = include_str!("schema.txt");

/// Identifies [`SCHEMA`].
pub const SCHEMA_HASH: u64 = crate::hash::fnv1a(SCHEMA.as_bytes());

/// The bytes of a message without a frame; none if they do not fit.
pub fn bytes_of<'a, T: Serialize>(message: &T, into: &'a mut [u8]) -> &'a [u8] {
    crate::room::written(message, into).unwrap_or(&[])
}

/// The message of a recorder that these bytes are.
pub fn message_of(bytes: &[u8]) -> Option<Message> {
    whole(bytes)
}

/// The command that these bytes are.
pub fn command_of(bytes: &[u8]) -> Option<Command> {
    whole(bytes)
}

fn whole<T: serde::de::DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    match postcard::take_from_bytes(bytes) {
        Ok((message, [])) => Some(message),
        _ => None,
    }
}

/// Everything a recorder says.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Message {
    /// Who is speaking; the first frame of every session, repeated on request.
    Hello(Hello),
    /// A direction from the compact array.
    Bearing(Bearing),
    /// A vessel's motion.
    Track(Track),
    /// Counters and margins.
    Health(Health),
    /// A direction from the ocean-bottom station.
    Azimuth(Azimuth),
    /// A range from the ocean-bottom station.
    Range(Range),
    /// A vessel's presence as an interval of time.
    Segment(Segment),
    /// Something went wrong, and when.
    Fault(Fault),
    /// Answer to a command.
    Reply(Reply),
    /// The end of the input: final totals follow in a `Health` before it.
    End(End),
    /// The rate at which a propeller turns.
    ShaftRate(ShaftRate),
    /// Faults of one kind that were not sent one by one.
    FaultsHeld(FaultsHeld),
    /// When a sample was.
    Time(Time),
    /// Raw samples were taken and follow.
    Snippet(Snippet),
    /// A piece of them.
    Samples(Samples),
    /// The spectrum of one channel.
    Spectrum(Spectrum),
    /// Directions of a minute by frequency.
    Azigram(Azigram),
    /// What the board has left.
    Margins(Margins),
    /// A sound that is no vessel.
    Transient(Transient),
}

/// Identity of recorder, software and configuration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// [`WIRE_VERSION`].
    pub wire_version: u8,
    /// [`SCHEMA_HASH`].
    pub schema_hash: u64,
    /// Hash of the station's configuration, which names what the recorder runs with.
    pub config_hash: u64,
    /// Software version: major, minor, patch.
    pub version: (u8, u8, u8),
    /// Number of the station.
    pub station: u16,
    /// 0 array, 1 ocean bottom, 255 none: the recorder waits for commands.
    pub kind: u8,
    /// Samples a second.
    pub rate_hz: f32,
    /// Why the recorder last started: 0 power, 1 watchdog, 2 software, 3 pin, 4 brown-out, 255 unknown.
    pub reset_cause: u8,
}

/// A direction of arrival with its uncertainty.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bearing {
    /// Sample index of the middle of the data used.
    pub index: u64,
    /// Azimuth, radians clockwise from true North, [0, 2π).
    pub azimuth: f32,
    /// Elevation, radians.
    pub elevation: f32,
    /// Variance of azimuth, rad².
    pub var_azimuth: f32,
    /// Variance of elevation, rad².
    pub var_elevation: f32,
    /// Covariance of both, rad².
    pub cov: f32,
    /// Signal-to-noise ratio of the directional part in the band, dB.
    pub snr_db: f32,
    /// 0 (useless) to 1 (delays agree with one direction as well as noise allows).
    pub quality: f32,
    /// Root-mean-square closure of the pair delays, seconds.
    pub closure_s: f32,
    /// Detection statistic in units of its threshold (1 = at the stated false-alarm rate).
    pub statistic: f32,
    /// 0 the strongest source in the band; 1 a second one, found in what the first leaves; 2 + n another source that
    /// stands out in the octave from 125 Hz · 2ⁿ up.
    pub band: u8,
    /// Bit 0 clipping in the segment, bit 1 a gap in the segment or samples bridged, bit 2 shortened segment, bit 3 one
    /// hydrophone left out, the sign of the elevation (or the side of the others' plane) assumed: above the horizon; bit 4 channels
    /// may be exchanged: that was noticed before, and nobody heard it end.
    pub flags: u8,
}

/// The closest point of approach and motion of a vessel, as known at `index`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Track {
    /// Number of the track; one vessel keeps its number.
    pub id: u16,
    /// 0 running estimate, 1 end-of-passage solution, 2 withdrawn: what was reported of this track is no vessel's course.
    pub stage: u8,
    /// Sample index of the newest data used.
    pub index: u64,
    /// Time of the closest point of approach, seconds since sample 0 (may lie ahead).
    pub cpa_time_s: f64,
    /// Its range, metres.
    pub cpa_range_m: f32,
    /// Azimuth of the closest point, radians.
    pub cpa_azimuth: f32,
    /// Heading, radians clockwise from true North.
    pub heading: f32,
    /// Speed, m/s.
    pub speed_m_s: f32,
    /// True if the array lies on the vessel's starboard side.
    pub starboard: bool,
    /// Standard deviation of the time of closest approach, s.
    pub sd_cpa_time_s: f32,
    /// Standard deviation of its range, m.
    pub sd_cpa_range_m: f32,
    /// Standard deviation of heading, rad.
    pub sd_heading: f32,
    /// Standard deviation of speed, m/s.
    pub sd_speed_m_s: f32,
    /// East of the station at `index`, metres.
    pub x_m: f32,
    /// North of the station at `index`, metres.
    pub y_m: f32,
    /// Variance of `x_m`, m².
    pub var_x_m2: f32,
    /// Variance of `y_m`, m².
    pub var_y_m2: f32,
    /// Covariance of both, m².
    pub cov_xy_m2: f32,
    /// Whether the data say anything about range.
    pub range_observable: bool,
    /// Measurements used.
    pub n: u16,
}

impl Track {
    /// Stage of a running estimate.
    pub const RUNNING: u8 = 0;
    /// Stage of the solution at the passage's end.
    pub const FINAL: u8 = 1;
    /// Stage of a track that is no vessel's course.
    pub const WITHDRAWN: u8 = 2;

    /// What its stage is called in records: `running`, `final` or `withdrawn`.
    pub fn stage_name(&self) -> &'static str {
        match self.stage {
            Self::RUNNING => "running",
            Self::FINAL => "final",
            _ => "withdrawn",
        }
    }
}

/// Counters since start and margins.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Health {
    /// Sample index this report is about.
    pub index: u64,
    /// Sample instants used.
    pub processed: u64,
    /// Sample instants lost, by [`crate::health::LossCause`].
    pub lost: [u64; LOSS_CAUSES],
    /// Bit c: channel c dead or stuck now; bit 4+c: channel c clipping now.
    pub channels: u8,
    /// Level of each hydrophone, dB re full scale, in half decibels (0 = full scale).
    pub level_half_db: [i8; 4],
    /// Records sent so far (bearings or azimuths and ranges).
    pub records: u32,
    /// Telemetry frames the recorder had to drop because the link was full.
    pub frames_dropped: u32,
}

/// Several weighted directions of one window are sent as several of these with the same index.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Azimuth {
    /// Sample index of the window's centre.
    pub index: u64,
    /// Azimuth, radians clockwise from true North.
    pub azimuth: f32,
    /// Spread of the posterior about it, rad.
    pub sd: f32,
    /// Natural logarithm of the presence ratio.
    pub log_presence: f32,
    /// Share of the posterior in this mode, 0 to 1.
    pub weight: f32,
    /// Presence ratio above its threshold.
    pub detected: bool,
    /// 0 tonal, 1 impulsive.
    pub kind: u8,
}

/// Several weighted modes of one window are sent as several of these with the same index.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Range {
    /// Sample index of the window's centre.
    pub index: u64,
    /// Range, metres.
    pub range_m: f32,
    /// Spread of the mode, m.
    pub sd_range_m: f32,
    /// Radial speed, m/s, positive when leaving.
    pub speed_m_s: f32,
    /// Spread of the radial speed, m/s.
    pub sd_speed_m_s: f32,
    /// Natural logarithm of the presence ratio.
    pub log_presence: f32,
    /// Share of the posterior in this mode, 0 to 1.
    pub weight: f32,
    /// Presence ratio above its threshold.
    pub detected: bool,
}

/// An interval in which a vessel is present.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Segment {
    /// Number of the segment.
    pub id: u16,
    /// Sample index of its start.
    pub start: u64,
    /// Sample index of its end.
    pub end: u64,
    /// Sample index of the change from approaching to leaving, where there was one.
    pub turn: Option<u64>,
    /// 0 general, 1 approaching, 2 leaving.
    pub kind: u8,
    /// Mean log evidence a minute.
    pub log_evidence: f32,
}

/// A fault or a notable event.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fault {
    /// What.
    pub code: FaultCode,
    /// Sample index where it was noticed.
    pub index: u64,
    /// Number that goes with the code (length of a gap, channel, count).
    pub value: i64,
}

/// Faults, append-only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum FaultCode {
    /// Samples missing: how many.
    Gap,
    /// Samples repeated or time gone back: how many.
    Overlap,
    /// Invalid samples: how many.
    Invalid,
    /// A channel does not move: which.
    DeadChannel,
    /// A channel lives again: which.
    ChannelBack,
    /// A channel is at the converter's limit: which.
    Clipping,
    /// Delays do not close to a direction (swapped channels, wrong geometry): segments so far.
    Inconsistent,
    /// The sample index fell far back, and time starts again: by how many instants.
    Restarted,
    /// A command could not be decoded: how many so far.
    BadCommand,
    /// The software had panicked before this start: low 32 bits the line, high 31 bits of a hash of the file.
    Panicked,
    /// The source of samples is silent: for how many seconds of the board's clock, 0 where the converter does not answer.
    NoSamples,
    /// The converter stood still or reset itself and was set up again: how many instants that took by the board's clock.
    ConverterRestarted,
    /// The configuration cannot be used, and the recorder waits for commands: 0 unreadable, 1 no recorder for it, 2 no
    /// such sample rate.
    BadConfiguration,
    /// The processor had faulted before this start: low 32 bits the program counter, above them the fault status.
    HardFault,
    /// The software was started again and again without a minute's work between, and waits for commands: how often.
    ManyResets,
    /// The clock that tells UTC has stepped: by how many microseconds.
    ClockStepped,
    /// A hydrophone does not hear what the others hear (deaf, or loud with its own noise), and is left out: which channel. Of an
    /// ocean bottom a horizontal component that hears noise alone (1 north, 2 east); azimuths are withheld.
    OwnNoise,
    /// A channel has the sign of the others turned round, and is left out: which.
    Inverted,
    /// A channel holds some of another's signal, and is left out: which.
    Leaking,
    /// Snaps, clicks and bursts were kept out of the bearings: of how many frames of 8 ms (at 64 kHz) since the last time.
    Impulses,
    /// The supply is low, the recording has ended, and the recorder waits until it is good: the threshold, mV.
    SupplyLow,
    /// A new configuration was given up, and the recorder is back at the one before. Low 8 bits why: 1 it started again before
    /// the new one was kept, 2 no samples in time, 3 no recorder could be set up, 4 it cannot be read any more, 5 no base
    /// station was heard in time; above them its number.
    RolledBack,
    /// The card takes no sound: low 8 bits why (1 no card, 2 not prepared for this, 3 it answers with errors, 4 it was slower
    /// than its buffer is long); above them how many instants were not recorded since it last took any.
    CardFailed,
    /// The card takes sound again: how many instants it has missed.
    CardBack,
    /// The card is full: how many instants it holds of this start.
    CardFull,
    /// No fault: the recorder pauses as its schedule says. For how many instants.
    Paused,
    /// Vertical motion goes with pressure as it cannot for sound from above: pressure, or the motion, has its sign turned
    /// round, or the station file's `intensity` is wrong. Which component tells it (3, the vertical one).
    Reversed,
    /// The vertical component behaves as a horizontal one, and a horizontal one as the vertical: which (1 north, 2 east). Or what is called
    /// pressure behaves as a component of motion, and one of those as pressure: which, and 4 (5 north, 6 east, 7 vertical).
    Exchanged,
    /// The horizontal components are of unequal gain: north over east, tenths of a decibel.
    Unequal,
    /// The propagation table does not fit: two pairs of paths put vessels at ranges that differ by so many metres.
    TableOff,
    /// What was told of the set-up is so no longer: the number of that code.
    SetUpGood,
    /// Wrong bits in the processor's memory: low 32 bits where, bits 32 to 39 in which memory (0 AXI SRAM, 1 to 3 tightly
    /// coupled, 4 to 7 SRAM 1 and 2); bit 40: they could not be corrected, and the recorder has started again.
    MemoryError,
    /// Nothing is broken: a vessel's elevations, or its shaft rate, contradict the speed that the station file declares. What they
    /// tell of it, cm/s.
    SpeedContradicted,
    /// Edges of the converter's line that were no conversions, and were not numbered: how many since the start.
    FalseEdge,
    /// The vertical motion has the wrong sign beside pressure: something is turned round or exchanged, and it is not known yet what. The component.
    SignInDoubt,
    /// One horizontal component is louder than the other where no vessel is heard, and it is not known yet whether it is its gain or noise of
    /// its own: north over east, tenths of a decibel.
    GainInDoubt,
}

impl FaultCode {
    /// All, in the order of their numbers.
    pub const ALL: [Self; 36] = [
        Self::Gap,
        Self::Overlap,
        Self::Invalid,
        Self::DeadChannel,
        Self::ChannelBack,
        Self::Clipping,
        Self::Inconsistent,
        Self::Restarted,
        Self::BadCommand,
        Self::Panicked,
        Self::NoSamples,
        Self::ConverterRestarted,
        Self::BadConfiguration,
        Self::HardFault,
        Self::ManyResets,
        Self::ClockStepped,
        Self::OwnNoise,
        Self::Inverted,
        Self::Leaking,
        Self::Impulses,
        Self::SupplyLow,
        Self::RolledBack,
        Self::CardFailed,
        Self::CardBack,
        Self::CardFull,
        Self::Paused,
        Self::Reversed,
        Self::Exchanged,
        Self::Unequal,
        Self::TableOff,
        Self::SetUpGood,
        Self::MemoryError,
        Self::SpeedContradicted,
        Self::FalseEdge,
        Self::SignInDoubt,
        Self::GainInDoubt,
    ];
}

/// Faults of one kind that were not sent one by one, because three of the kind had been sent in that minute of samples.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FaultsHeld {
    /// What.
    pub code: FaultCode,
    /// Sample index at which the minute ended.
    pub index: u64,
    /// How many.
    pub count: u32,
    /// Of gaps, overlaps and invalid samples the sum of their numbers; of faults of channels bit c for channel c; else
    /// the number of the newest.
    pub value: i64,
}

/// Answer to a command.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reply {
    /// Number the command carried.
    pub token: u8,
    /// 0 done, 1 refused, 2 unknown.
    pub status: u8,
}

/// The recorder has stopped.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct End {
    /// Sample index after the last sample seen.
    pub index: u64,
    /// Frames sent before this one.
    pub frames: u32,
}

/// A shaft or blade rate found in the envelope of the noise, and what it says about a vessel's speed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ShaftRate {
    /// Sample index after the newest sample used; the rate is that of the 30 s before.
    pub index: u64,
    /// The rate, Hz.
    pub rate_hz: f32,
    /// Its standard deviation, Hz.
    pub sd_hz: f32,
    /// One minus the bound on the probability that noise alone gives such a rate in one window.
    pub confidence: f32,
    /// Natural logarithm of that bound.
    pub ln_false_alarm: f32,
    /// Harmonics of the comb found.
    pub harmonics: u8,
    /// Blades of the propeller, the rate being the shaft's; 0 where the rate may be the shaft's or the blades'.
    pub blades: u8,
    /// Speed by the station's curve, m/s; infinite where there is none or the rate can be read as two speeds.
    pub speed_m_s: f32,
    /// Its standard deviation, m/s.
    pub sd_speed_m_s: f32,
    /// Number of the track it was given to; 0 where no vessel or more than one was heard.
    pub track: u16,
}

/// When a sample was, by a clock that knows UTC, and what its uncertainty grows from; `docs/wire.md` says what follows for
/// other samples.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Time {
    /// Sample index this is about.
    pub index: u64,
    /// Its UTC: microseconds since 1970-01-01, leap seconds not counted.
    pub utc_us: i64,
    /// Standard deviation of that, s.
    pub sd_s: f32,
    /// By how much, relatively, samples come further apart than their nominal rate says.
    pub drift: f32,
    /// Standard deviation of the drift.
    pub sd_drift: f32,
    /// Correlation of the errors of time and drift, −1 to 1.
    pub correlation: f32,
}

/// What a base station may ask.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Command {
    /// Send `Hello` and `Health`.
    Identify {
        /// Returned in the reply.
        token: u8,
    },
    /// Send health every so many seconds of samples (0: only on request).
    HealthEvery {
        /// Returned in the reply.
        token: u8,
        /// Seconds.
        seconds: u16,
    },
    /// Stop after the current block.
    Stop {
        /// Returned in the reply.
        token: u8,
    },
    /// Start again: a recorder that has stopped or waits for commands begins a new session.
    Start {
        /// Returned in the reply.
        token: u8,
    },
    /// It is now this time, as far as the base station knows; refused where it does not fit what is known.
    Utc {
        /// Returned in the reply.
        token: u8,
        /// Microseconds since 1970-01-01, leap seconds not counted.
        utc_us: i64,
        /// Standard deviation of that on arrival, the line's delay included, µs.
        sd_us: u32,
    },
    /// Number of `Begin` of [`crate::configure::Configure`]; there is none here.
    Begin(Elsewhere),
    /// Number of `Piece`.
    Piece(Elsewhere),
    /// Number of `Take`.
    Take(Elsewhere),
    /// Send raw samples of the moment: the next so many instants that follow each other without a gap.
    SendSnippet {
        /// Returned in the reply, and in what is sent.
        token: u8,
        /// Bit c: channel c.
        channels: u8,
        /// How many.
        instants: u32,
    },
    /// Send the spectra of the last data that were analysed.
    SendSpectrum {
        /// Returned in the reply, and in what is sent.
        token: u8,
        /// Bit c: channel c.
        channels: u8,
    },
}

impl Command {
    /// What its reply returns.
    pub fn token(&self) -> u8 {
        match *self {
            Self::Identify { token }
            | Self::HealthEvery { token, .. }
            | Self::Stop { token }
            | Self::Start { token }
            | Self::Utc { token, .. }
            | Self::SendSnippet { token, .. }
            | Self::SendSpectrum { token, .. } => token,
            Self::Begin(elsewhere) | Self::Piece(elsewhere) | Self::Take(elsewhere) => match elsewhere {},
        }
    }
}

/// A command whose number is taken, and that only [`crate::configure::Configure`] holds, because it is long. There is no value of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Elsewhere {}
