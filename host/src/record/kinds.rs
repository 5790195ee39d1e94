//! The records by their kinds: what stands in each field, in which unit. The published schema is made of these types.

use super::margins::Margins;
use super::sound::{Azigram, Samples, Snippet, Spectrum};
use super::transient::Transient;
use super::warning::Warning;
use seabearing_core::wire::{self, Message};
use serde::Serialize;

#[cfg(feature = "schema")]
use schemars::JsonSchema;

/// A type of records: written as JSON, and described.
macro_rules! record {
    ($(#[$about:meta])* $name:ident { $($(#[$of:meta])* $field:ident: $kind:ty,)* }) => {
        $(#[$about])*
        #[derive(Clone, Debug, Serialize)]
        #[cfg_attr(feature = "schema", derive(JsonSchema))]
        pub struct $name {
            $($(#[$of])* pub $field: $kind,)*
        }
    };
}

record! {
    /// The first record of a session: who speaks.
    Hello {
        /// Version of the wire format.
        wire_version: u8,
        /// Hash of the messages' schema, hexadecimal.
        schema_hash: String,
        /// Hash of the station's configuration, hexadecimal.
        config_hash: String,
        /// Version of the software: major, minor, patch.
        version: String,
        /// Number of the station.
        station: u16,
        /// Kind of recorder: `array`, `obs`, or `waiting` for commands only.
        kind: &'static str,
        /// Samples a second.
        rate_hz: Option<f64>,
        /// Why it started: 0 power, 1 watchdog, 2 software, 3 pin, 4 brown-out, 255 unknown.
        reset_cause: u8,
    }
}

record! {
    /// A direction from the compact array.
    Bearing {
        /// Azimuth, degrees clockwise from true North, 0 to 360.
        azimuth_deg: Option<f64>,
        /// Elevation, degrees up from the horizontal.
        elevation_deg: Option<f64>,
        /// Standard deviation of the azimuth, degrees.
        sd_azimuth_deg: Option<f64>,
        /// Standard deviation of the elevation, degrees.
        sd_elevation_deg: Option<f64>,
        /// Covariance of both, square degrees.
        cov_deg2: Option<f64>,
        /// Signal-to-noise ratio of the directional part in the band, dB.
        snr_db: Option<f64>,
        /// 0 (useless) to 1 (the pairs' delays agree with one direction as well as noise allows).
        quality: Option<f64>,
        /// Root mean square by which the pairs' delays fail to close, seconds.
        closure_s: Option<f64>,
        /// Detection statistic in units of its threshold.
        statistic: Option<f64>,
        /// 0 the strongest source of the band, 1 a second one beside it, 2 + n another source in the octave from 125 Hz · 2ⁿ up.
        band: u8,
        /// Bit 0 clipping, bit 1 a gap or samples bridged, bit 2 a shortened segment, bit 3 one hydrophone left out, bit 4 channels may be exchanged: that was noticed before, and nobody heard it end.
        flags: u8,
    }
}

record! {
    /// A vessel's motion as known at `t_s`; the closest point of approach is that of horizontal range.
    Track {
        /// Number of the track; one vessel keeps its number.
        id: u16,
        /// `running` estimate, `final` solution at the passage's end, or `withdrawn`: what was reported of it is no vessel's course.
        stage: &'static str,
        /// Time of the closest point of approach, seconds since sample 0 (may lie ahead).
        cpa_time_s: Option<f64>,
        /// Range there, metres.
        cpa_range_m: Option<f64>,
        /// Azimuth there, degrees clockwise from true North.
        cpa_azimuth_deg: Option<f64>,
        /// Heading, degrees clockwise from true North.
        heading_deg: Option<f64>,
        /// Speed, metres a second.
        speed_m_s: Option<f64>,
        /// The vessel's side on which the array lies: `port` or `starboard`.
        side: &'static str,
        /// Standard deviation of the time of the closest point, seconds.
        sd_cpa_time_s: Option<f64>,
        /// Standard deviation of the range there, metres.
        sd_cpa_range_m: Option<f64>,
        /// Standard deviation of the heading, degrees.
        sd_heading_deg: Option<f64>,
        /// Standard deviation of the speed, metres a second.
        sd_speed_m_s: Option<f64>,
        /// Position East of the station at `t_s`, metres.
        x_m: Option<f64>,
        /// Position North of the station at `t_s`, metres.
        y_m: Option<f64>,
        /// Variance of `x_m`, square metres.
        var_x_m2: Option<f64>,
        /// Variance of `y_m`, square metres.
        var_y_m2: Option<f64>,
        /// Covariance of both, square metres.
        cov_xy_m2: Option<f64>,
        /// Whether the data say anything about range; if not, ranges and positions are no estimates.
        range_observable: bool,
        /// Measurements used.
        n: u16,
    }
}

record! {
    /// Counters since the start, in sample instants (one instant is all channels), and levels.
    Health {
        /// Instants used.
        processed: u64,
        /// Instants missing.
        lost_gap: u64,
        /// Instants that came twice or with time gone back.
        lost_overlap: u64,
        /// Instants without a code on a needed channel.
        lost_invalid: u64,
        /// Instants lost to clipping.
        lost_clipped: u64,
        /// Instants lost to dead channels.
        lost_dead_channel: u64,
        /// Instants that filled no frame before a break.
        lost_remainder: u64,
        /// Channels that are dead, stuck or left out now, from 0.
        dead_channels: Vec<u8>,
        /// Channels that clip now, from 0.
        clipping_channels: Vec<u8>,
        /// Level of each channel, dB re full scale squared; −128 where nothing was heard.
        level_db_full_scale: [f64; 4],
        /// Records sent so far.
        records: u32,
        /// Records dropped because the line was full.
        frames_dropped: u32,
    }
}

record! {
    /// A direction from the ocean-bottom station; several weighted modes of one window are several records.
    Azimuth {
        /// Azimuth, degrees clockwise from true North; null where nothing was detected.
        azimuth_deg: Option<f64>,
        /// Its standard deviation, degrees.
        sd_deg: Option<f64>,
        /// Natural logarithm of the presence ratio.
        log_presence: Option<f64>,
        /// Share of the posterior that is this mode's, 0 to 1.
        weight: Option<f64>,
        /// Whether presence is above its threshold.
        detected: bool,
        /// What sounded: `tonal` or `impulsive`.
        source: &'static str,
    }
}

record! {
    /// A range from the ocean-bottom station; several weighted modes of one window are several records.
    Range {
        /// Horizontal range, metres; null where nothing was detected.
        range_m: Option<f64>,
        /// Its standard deviation, metres.
        sd_range_m: Option<f64>,
        /// Radial speed, metres a second, positive when the vessel leaves.
        speed_m_s: Option<f64>,
        /// Its standard deviation, metres a second.
        sd_speed_m_s: Option<f64>,
        /// Natural logarithm of the presence ratio.
        log_presence: Option<f64>,
        /// Share of the posterior that is this mode's, 0 to 1.
        weight: Option<f64>,
        /// Whether presence is above its threshold.
        detected: bool,
    }
}

record! {
    /// An interval in which a vessel is present, at the ocean bottom.
    Segment {
        /// Number of the segment.
        id: u16,
        /// Its start, seconds since sample 0.
        start_s: Option<f64>,
        /// Its end, seconds since sample 0.
        end_s: Option<f64>,
        /// The turn from approaching to leaving, seconds since sample 0; null where there was none.
        turn_s: Option<f64>,
        /// `general`, `approaching` or `leaving`.
        kind: &'static str,
        /// Mean natural logarithm of the evidence, a minute.
        log_evidence: Option<f64>,
    }
}

record! {
    /// Trouble, by name (docs/wire.md).
    Fault {
        /// What.
        code: String,
        /// The number that goes with it: length of a gap in instants, channel, count, or several in one (docs/wire.md).
        value: i64,
    }
}

record! {
    /// Faults of one kind that were not sent one by one, because many came in one minute.
    FaultsHeld {
        /// What.
        code: String,
        /// How many.
        count: u32,
        /// Sum of their numbers, bits of the channels, or the newest number (docs/wire.md).
        value: i64,
    }
}

record! {
    /// Answer to a command.
    Reply {
        /// The number that the command carried.
        token: u8,
        /// 0 done, 1 refused, 2 unknown.
        status: u8,
    }
}

record! {
    /// The rate of a propeller over the 30 s before `t_s`.
    ShaftRate {
        /// The rate, Hz.
        rate_hz: Option<f64>,
        /// Its standard deviation, Hz.
        sd_hz: Option<f64>,
        /// One minus the bound on the probability that noise alone gives such a rate in one window.
        confidence: Option<f64>,
        /// Natural logarithm of that bound.
        ln_false_alarm: Option<f64>,
        /// Harmonics of the comb found.
        harmonics: u8,
        /// Blades of the propeller; null where the rate may be the shaft's or the blades'.
        blades: Option<u8>,
        /// Speed by the station's curve, metres a second; null where it has none, or leaves two speeds.
        speed_m_s: Option<f64>,
        /// Its standard deviation, metres a second.
        sd_speed_m_s: Option<f64>,
        /// The track that took the speed as measured; null where none did.
        track: Option<u16>,
    }
}

record! {
    /// When the sample at `t_s` was, by a clock that knows UTC.
    Time {
        /// Standard deviation of `utc`, seconds.
        sd_utc_s: Option<f64>,
        /// By how much samples come further apart than their nominal rate says, parts in a million.
        drift_ppm: Option<f64>,
        /// Its standard deviation, parts in a million.
        sd_drift_ppm: Option<f64>,
    }
}

record! {
    /// Levels of one channel over the interval that begins at `t_s` (`process --levels`; docs/levels.md). Decibels are re
    /// `reference`, spectral densities re its square in a hertz. Null: the interval has no whole data for it, the band is
    /// narrower than what can be resolved, or the response is not known there.
    Level {
        /// Channel of the recorder, from 0.
        channel: u8,
        /// What was measured: `pressure`, `velocity_north`, `velocity_east`, `velocity_vertical`.
        quantity: &'static str,
        /// Reference value: `1 µPa`, `1 nm/s`, or `full scale` where the station file states no sensitivity.
        reference: &'static str,
        /// Length of the interval, seconds.
        duration_s: f64,
        /// Share of it, 0 to 1, that the levels are of: what neither misses a sample nor is clipped.
        used: f64,
        /// Samples missing.
        missing: u64,
        /// Samples clipped.
        clipped: u64,
        /// Lower edge of the band of `broadband_db`, Hz.
        from_hz: f64,
        /// Its upper edge, Hz.
        to_hz: f64,
        /// Level of that band.
        broadband_db: Option<f64>,
        /// Lower edges of the decades that lie within that band, Hz; the upper ones are ten times as high.
        decade_from_hz: Vec<f64>,
        /// Their levels.
        decade_db: Vec<Option<f64>>,
        /// Midband frequencies of the decidecades (base-ten third octaves), Hz.
        decidecade_hz: Vec<f64>,
        /// Their levels.
        decidecade_db: Vec<Option<f64>>,
        /// Standard deviation of those in Gaussian noise, dB.
        decidecade_sd_db: Vec<Option<f64>>,
        /// Levels that 5 % of the snapshots (a second, or a window where that is longer) are below.
        decidecade_p5_db: Vec<Option<f64>>,
        /// Levels that half of the snapshots are below.
        decidecade_p50_db: Vec<Option<f64>>,
        /// Levels that 95 % of the snapshots are below.
        decidecade_p95_db: Vec<Option<f64>>,
        /// Frequencies of the spectral densities, forty a decade, Hz.
        psd_hz: Vec<f64>,
        /// Spectral density, mean of the interval.
        psd_db: Vec<Option<f64>>,
        /// Spectral density that 5 % of the snapshots are below.
        psd_p5_db: Vec<Option<f64>>,
        /// Spectral density that half of the snapshots are below.
        psd_p50_db: Vec<Option<f64>>,
        /// Spectral density that 95 % of the snapshots are below.
        psd_p95_db: Vec<Option<f64>>,
    }
}

record! {
    /// A track of a station that takes part in a vessel's network track.
    Member {
        /// Number of the station.
        station: u16,
        /// Session of that station, counted by the base station.
        session: u32,
        /// Number of its track there.
        id: u16,
    }
}

record! {
    /// A vessel's closest point of approach to a station that takes part in its network track, along its straight motion.
    Closest {
        /// Number of the station.
        station: u16,
        /// UTC of the closest point, RFC 3339.
        utc: Option<String>,
        /// Its standard deviation, seconds.
        sd_s: Option<f64>,
        /// Horizontal range there, metres.
        range_m: Option<f64>,
        /// Its standard deviation, metres.
        sd_range_m: Option<f64>,
    }
}

record! {
    /// A vessel's straight motion from the bearings of several stations, as the base station fits it without any assumption of
    /// its speed (docs/network.md). Its `utc` is that of the newest bearing used. Null: the geometry does not tell it.
    NetworkTrack {
        /// Number of the network track; one vessel keeps its number.
        id: u32,
        /// `live`; `final` where the tracks of all members have ended; `withdrawn` where its members are one vessel's no more.
        state: &'static str,
        /// The tracks of stations that it is made of.
        members: Vec<Member>,
        /// UTC of the first bearing used, RFC 3339.
        from_utc: Option<String>,
        /// UTC of the last one, RFC 3339.
        to_utc: Option<String>,
        /// Latitude of the vessel at `utc`, degrees; null also where stations are in a plane of their own.
        lat_deg: Option<f64>,
        /// Longitude then, degrees.
        lon_deg: Option<f64>,
        /// East of the first station of the region in the stations file (or of its plane's origin) then, metres.
        x_m: Option<f64>,
        /// North of it, metres.
        y_m: Option<f64>,
        /// Variance of the place towards the East at the vessel, square metres.
        var_x_m2: Option<f64>,
        /// Variance towards the North there, square metres.
        var_y_m2: Option<f64>,
        /// Covariance of both, square metres.
        cov_xy_m2: Option<f64>,
        /// Heading, degrees clockwise from true North at the vessel.
        heading_deg: Option<f64>,
        /// Its standard deviation, degrees.
        sd_heading_deg: Option<f64>,
        /// Speed, metres a second.
        speed_m_s: Option<f64>,
        /// Its standard deviation, metres a second.
        sd_speed_m_s: Option<f64>,
        /// Covariance of `x_m`, `y_m` and the velocity along both (m/s) at `utc`: 16 numbers, row by row.
        covariance: Option<Vec<f64>>,
        /// Closest points of approach to the stations of the members.
        closest: Option<Vec<Closest>>,
        /// Whether the stations agree within their stated errors (99.9 %); where they do not, the covariance has grown and may
        /// still be too small.
        consistent: Option<bool>,
        /// Bearings used.
        n: usize,
    }
}

record! {
    /// The input has ended.
    End {
        /// Records sent before this one.
        frames: u32,
    }
}

/// A finite number; not finite is "not observable".
fn number(x: impl Into<f64>) -> Option<f64> {
    Some(x.into()).filter(|x| x.is_finite())
}

/// The same of an angle in radians, in degrees.
fn degrees(x: f32) -> Option<f64> {
    number(f64::from(x).to_degrees())
}

/// A record's own fields; each variant is the type of its name.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
#[allow(missing_docs)]
pub enum Kind {
    Hello(Hello),
    Bearing(Bearing),
    Track(Track),
    Health(Health),
    Azimuth(Azimuth),
    Range(Range),
    Segment(Segment),
    Fault(Fault),
    FaultsHeld(FaultsHeld),
    Warning(Warning),
    Reply(Reply),
    ShaftRate(ShaftRate),
    Time(Time),
    Level(Level),
    NetworkTrack(NetworkTrack),
    Snippet(Snippet),
    Samples(Samples),
    Spectrum(Spectrum),
    Azigram(Azigram),
    Margins(Margins),
    Transient(Transient),
    End(End),
}

impl Kind {
    /// A message's record and the index of the sample it is about. `t_s`: seconds since sample 0 of an index.
    pub fn of(message: &Message, t_s: impl Fn(u64) -> f64) -> (Option<u64>, Self) {
        match message {
            Message::Hello(h) => (None, Self::Hello(Hello::from(h))),
            Message::Bearing(b) => (Some(b.index), Self::Bearing(Bearing::from(b))),
            Message::Track(t) => (Some(t.index), Self::Track(Track::from(t))),
            Message::Health(h) => (Some(h.index), Self::Health(Health::from(h))),
            Message::Azimuth(a) => (Some(a.index), Self::Azimuth(Azimuth::from(a))),
            Message::Range(r) => (Some(r.index), Self::Range(Range::from(r))),
            Message::Segment(s) => {
                let segment = Segment {
                    id: s.id,
                    start_s: number(t_s(s.start)),
                    end_s: number(t_s(s.end)),
                    turn_s: s.turn.and_then(|turn| number(t_s(turn))),
                    kind: match s.kind {
                        1 => "approaching",
                        2 => "leaving",
                        _ => "general",
                    },
                    log_evidence: number(s.log_evidence),
                };
                (Some(s.end), Self::Segment(segment))
            }
            Message::Fault(f) => {
                let fault = || Self::Fault(Fault { code: format!("{:?}", f.code), value: f.value });
                (Some(f.index), Warning::of(f).map_or_else(fault, Self::Warning))
            }
            Message::FaultsHeld(f) => {
                let held = FaultsHeld { code: format!("{:?}", f.code), count: f.count, value: f.value };
                (Some(f.index), Self::FaultsHeld(held))
            }
            Message::Reply(r) => (None, Self::Reply(Reply { token: r.token, status: r.status })),
            Message::ShaftRate(s) => (Some(s.index), Self::ShaftRate(ShaftRate::from(s))),
            Message::Time(t) => {
                let time = Time {
                    sd_utc_s: number(t.sd_s),
                    drift_ppm: number(f64::from(t.drift) * 1e6),
                    sd_drift_ppm: number(f64::from(t.sd_drift) * 1e6),
                };
                (Some(t.index), Self::Time(time))
            }
            Message::Snippet(s) => (Some(s.index), Self::Snippet(Snippet::from(s))),
            Message::Samples(s) => (Some(s.index), Self::Samples(Samples::from(s))),
            Message::Spectrum(s) => (Some(s.index), Self::Spectrum(Spectrum::from(s))),
            Message::Azigram(a) => (Some(a.index), Self::Azigram(Azigram::from(a))),
            Message::Margins(m) => (Some(m.index), Self::Margins(Margins::from(m))),
            Message::Transient(t) => (Some(t.index), Self::Transient(Transient::of(t, t_s))),
            Message::End(e) => (Some(e.index), Self::End(End { frames: e.frames })),
        }
    }
}

impl From<&wire::Hello> for Hello {
    fn from(h: &wire::Hello) -> Self {
        Self {
            wire_version: h.wire_version,
            schema_hash: format!("{:016x}", h.schema_hash),
            config_hash: format!("{:016x}", h.config_hash),
            version: format!("{}.{}.{}", h.version.0, h.version.1, h.version.2),
            station: h.station,
            kind: match h.kind {
                0 => "array",
                1 => "obs",
                _ => "waiting",
            },
            rate_hz: number(h.rate_hz),
            reset_cause: h.reset_cause,
        }
    }
}

impl From<&wire::Bearing> for Bearing {
    fn from(b: &wire::Bearing) -> Self {
        Self {
            azimuth_deg: degrees(b.azimuth),
            elevation_deg: degrees(b.elevation),
            sd_azimuth_deg: degrees(b.var_azimuth.sqrt()),
            sd_elevation_deg: degrees(b.var_elevation.sqrt()),
            cov_deg2: number(f64::from(b.cov) * 1f64.to_degrees().powi(2)),
            snr_db: number(b.snr_db),
            quality: number(b.quality),
            closure_s: number(b.closure_s),
            statistic: number(b.statistic),
            band: b.band,
            flags: b.flags,
        }
    }
}

impl From<&wire::Track> for Track {
    fn from(t: &wire::Track) -> Self {
        Self {
            id: t.id,
            stage: t.stage_name(),
            cpa_time_s: number(t.cpa_time_s),
            cpa_range_m: number(t.cpa_range_m),
            cpa_azimuth_deg: degrees(t.cpa_azimuth),
            heading_deg: degrees(t.heading),
            speed_m_s: number(t.speed_m_s),
            side: if t.starboard { "starboard" } else { "port" },
            sd_cpa_time_s: number(t.sd_cpa_time_s),
            sd_cpa_range_m: number(t.sd_cpa_range_m),
            sd_heading_deg: degrees(t.sd_heading),
            sd_speed_m_s: number(t.sd_speed_m_s),
            x_m: number(t.x_m),
            y_m: number(t.y_m),
            var_x_m2: number(t.var_x_m2),
            var_y_m2: number(t.var_y_m2),
            cov_xy_m2: number(t.cov_xy_m2),
            range_observable: t.range_observable,
            n: t.n,
        }
    }
}

impl From<&wire::Health> for Health {
    fn from(h: &wire::Health) -> Self {
        let [lost_gap, lost_overlap, lost_invalid, lost_clipped, lost_dead_channel, lost_remainder] = h.lost;
        let channels = |first: u8| (0..4).filter(|c| h.channels >> (first + c) & 1 == 1).collect();
        Self {
            processed: h.processed,
            lost_gap,
            lost_overlap,
            lost_invalid,
            lost_clipped,
            lost_dead_channel,
            lost_remainder,
            dead_channels: channels(0),
            clipping_channels: channels(4),
            level_db_full_scale: h.level_half_db.map(|l| f64::from(l) / 2.0),
            records: h.records,
            frames_dropped: h.frames_dropped,
        }
    }
}

impl From<&wire::Azimuth> for Azimuth {
    fn from(a: &wire::Azimuth) -> Self {
        Self {
            // Without a spread there is no azimuth: a minute in which nothing was detected.
            azimuth_deg: degrees(a.azimuth).filter(|_| a.sd.is_finite()),
            sd_deg: degrees(a.sd),
            log_presence: number(a.log_presence),
            weight: number(a.weight),
            detected: a.detected,
            source: if a.kind == 0 { "tonal" } else { "impulsive" },
        }
    }
}

impl From<&wire::Range> for Range {
    fn from(r: &wire::Range) -> Self {
        Self {
            range_m: number(r.range_m).filter(|_| r.sd_range_m.is_finite()),
            sd_range_m: number(r.sd_range_m),
            speed_m_s: number(r.speed_m_s).filter(|_| r.sd_speed_m_s.is_finite()),
            sd_speed_m_s: number(r.sd_speed_m_s),
            log_presence: number(r.log_presence),
            weight: number(r.weight),
            detected: r.detected,
        }
    }
}

impl From<&wire::ShaftRate> for ShaftRate {
    fn from(s: &wire::ShaftRate) -> Self {
        Self {
            rate_hz: number(s.rate_hz),
            sd_hz: number(s.sd_hz),
            confidence: number(s.confidence),
            ln_false_alarm: number(s.ln_false_alarm),
            harmonics: s.harmonics,
            blades: (s.blades > 0).then_some(s.blades),
            speed_m_s: number(s.speed_m_s),
            sd_speed_m_s: number(s.sd_speed_m_s),
            track: (s.track > 0).then_some(s.track),
        }
    }
}
