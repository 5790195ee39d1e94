//! The station's configuration: what a person writes (through the host's TOML reader), validated once.
//!
//! The same structure reaches the recorder as a postcard blob; [`StationConfig::hash`] identifies it in telemetry.

use crate::block::CHANNELS;
use crate::demon::SpeedCurve;
use crate::geometry::{Geometry, GeometryError};
use serde::{Deserialize, Serialize};

/// Longest station name, in bytes.
pub const NAME_BYTES: usize = 24;

/// One recorder, as configured. Angles in degrees here because this is the person's side; plans hold radians.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StationConfig {
    /// Number of the station, reported in telemetry.
    pub id: u16,
    /// Name of the station.
    pub name: heapless::String<NAME_BYTES>,
    /// Latitude and longitude in degrees, where known.
    pub lat_lon_deg: Option<(f64, f64)>,
    /// Local East and North in metres, where given.
    pub local_east_north_m: Option<(f64, f64)>,
    /// Depth of the station below the surface in metres.
    pub depth_m: f64,
    /// Azimuth of the array's own "North", clockwise from true North, degrees.
    pub orientation_deg: f64,
    /// Speed of sound at the station, m/s.
    pub sound_speed_m_s: f64,
    /// Samples a second of every channel.
    pub rate_hz: f64,
    /// Full scale of the converter as a code (2^23 for 24 bits); codes at or beyond ±(full_scale − 1) are clipped.
    pub full_scale: i32,
    /// What kind of recorder.
    pub kind: Kind,
    /// Tracker settings.
    pub tracking: Tracking,
    /// Levels sent unasked. In a section of their own of the blob, so that blobs without it stay as they are.
    #[serde(skip)]
    pub levels: Levels,
    /// When the recorder listens. In a section of its own too.
    #[serde(skip)]
    pub schedule: Schedule,
    /// What a recorder with a card keeps of its sound. In a section of its own too.
    #[serde(skip)]
    pub clips: Clips,
    /// What is not known of an ocean-bottom station. In a section of its own too.
    #[serde(skip)]
    pub doubts: Doubts,
}

/// What is not known of an ocean-bottom station: standard deviations of errors that last. 0: exact.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Doubts {
    /// Of the azimuth of the north component, degrees.
    pub orientation_deg: f32,
    /// Of the gain of north over that of east, dB.
    pub gain_db: f32,
    /// Of the depth for which the propagation table was made, metres.
    pub table_depth_m: f32,
}

impl Doubts {
    /// The bytes that a blob holds.
    pub const fn bytes(self) -> [u8; 12] {
        let [a, b, c, d] = self.orientation_deg.to_le_bytes();
        let [e, f, g, h] = self.gain_db.to_le_bytes();
        let [i, j, k, l] = self.table_depth_m.to_le_bytes();
        [a, b, c, d, e, f, g, h, i, j, k, l]
    }

    /// The same back.
    pub const fn of([a, b, c, d, e, f, g, h, i, j, k, l]: [u8; 12]) -> Self {
        Self {
            orientation_deg: f32::from_le_bytes([a, b, c, d]),
            gain_db: f32::from_le_bytes([e, f, g, h]),
            table_depth_m: f32::from_le_bytes([i, j, k, l]),
        }
    }

    /// Whether there are any.
    pub fn are_any(self) -> bool {
        self != Self::default()
    }
}

/// Which sound a recorder with a card keeps: all of it, or what is around its detections, at most one clip in so long.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Clips {
    /// Seconds kept before a detection.
    pub before_s: u16,
    /// Seconds kept after it; 0: all sound is kept.
    pub after_s: u16,
    /// Seconds from a detection that is kept to the next one that is.
    pub apart_s: u32,
}

impl Clips {
    /// The bytes that a blob holds.
    pub const fn bytes(self) -> [u8; 8] {
        let ([a, b], [c, d]) = (self.before_s.to_le_bytes(), self.after_s.to_le_bytes());
        let [e, f, g, h] = self.apart_s.to_le_bytes();
        [a, b, c, d, e, f, g, h]
    }

    /// The same back.
    pub const fn of([a, b, c, d, e, f, g, h]: [u8; 8]) -> Self {
        let (before_s, after_s) = (u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d]));
        Self { before_s, after_s, apart_s: u32::from_le_bytes([e, f, g, h]) }
    }

    /// Whether sound away from detections is given up.
    pub const fn are_kept(self) -> bool {
        self.after_s > 0
    }

    /// Seconds of sound that a clip asks for.
    pub fn seconds(self) -> f64 {
        f64::from(self.before_s) + f64::from(self.after_s)
    }
}

/// When a recorder listens: for the first `on_s` seconds of every `every_s`, counted from midnight of 1970-01-01 UTC where it
/// knows UTC, and from sample 0 where it does not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Schedule {
    /// Seconds from one beginning to the next; 0: it always listens.
    pub every_s: u32,
    /// Seconds for which it listens then.
    pub on_s: u32,
}

impl Schedule {
    /// The bytes that a blob holds.
    pub const fn bytes(self) -> [u8; 8] {
        let ([a, b, c, d], [e, f, g, h]) = (self.every_s.to_le_bytes(), self.on_s.to_le_bytes());
        [a, b, c, d, e, f, g, h]
    }

    /// The same back.
    pub const fn of([a, b, c, d, e, f, g, h]: [u8; 8]) -> Self {
        Self { every_s: u32::from_le_bytes([a, b, c, d]), on_s: u32::from_le_bytes([e, f, g, h]) }
    }

    /// Share of the time for which it listens.
    pub fn share(self) -> f64 {
        if self.every_s == 0 { 1.0 } else { f64::from(self.on_s) / f64::from(self.every_s) }
    }
}

/// Levels that a recorder sends of itself: a spectrum of one channel, averaged over so long.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Levels {
    /// Seconds of each; 0: none are sent.
    pub every_s: u16,
    /// Recorder channel.
    pub channel: u8,
}

impl Levels {
    /// The bytes that a blob holds.
    pub const fn bytes(self) -> [u8; 3] {
        let [low, high] = self.every_s.to_le_bytes();
        [low, high, self.channel]
    }

    /// The same back.
    pub const fn of([low, high, channel]: [u8; 3]) -> Self {
        Self { every_s: u16::from_le_bytes([low, high]), channel }
    }
}

/// The kinds of recorder.
#[expect(clippy::large_enum_variant, reason = "there is one, and nothing to allocate a box from")]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Kind {
    /// Four hydrophones, compact array.
    Array(ArrayConfig),
    /// Hydrophone and three-component seismometer.
    Obs(ObsConfig),
    /// A uniform line of sensors (host only).
    Line(LineConfig),
}

/// The compact array.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ArrayConfig {
    /// East, North, Up of each hydrophone in metres, before orientation.
    pub hydrophones_m: [[f64; 3]; CHANNELS],
    /// Recorder channel of each hydrophone.
    pub channels: [u8; CHANNELS],
    /// Sensitivity of each hydrophone, dB re 1 V/µPa.
    pub sensitivity_db_re_1v_upa: [f64; CHANNELS],
    /// Range for which delays are expected where no surface tells it (`vessel_depth_m` 0 or an array no deeper than that; from below the horizon), metres;
    /// infinite means a plane wave.
    pub reference_range_m: f64,
    /// Band used for bearings, Hz.
    pub band_hz: (f64, f64),
    /// Length of one bearing's data, seconds.
    pub segment_s: f64,
    /// Time from one bearing to the next, seconds.
    pub step_s: f64,
    /// Lowest and highest elevation searched, degrees.
    pub elevation_deg: (f64, f64),
    /// Bearings allowed from noise alone, per hour (sets the detection threshold).
    pub false_alarms_per_hour: f64,
    /// Depth of the vessels listened to, metres: how far their image in the surface lies above them. 0: no image.
    pub vessel_depth_m: f64,
    /// Standard deviation of each coordinate of each hydrophone, metres: an error that lasts. 0: exact.
    pub position_sd_m: f64,
    /// Standard deviation of the speed of sound, m/s: an error that lasts. 0: exact.
    pub sound_speed_sd_m_s: f64,
}

/// Whose choices an ocean-bottom station makes: its own, or for comparison those of paper O.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Compatibility {
    /// Ours.
    #[default]
    None,
    /// Those of the programme by which the paper's authors made their figures.
    Programme,
    /// Those of the paper's text.
    Paper,
}

/// The ocean-bottom station.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObsConfig {
    /// True azimuth of the "north" component, degrees.
    pub orientation_of_north_deg: f64,
    /// Whether active intensity points away from the source (the physical sign) or towards it.
    pub intensity_towards: bool,
    /// Whose choices.
    pub compatibility: Compatibility,
    /// Whether directions by frequency are said once a minute.
    pub azigram: bool,
}

/// The uniform line array.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LineConfig {
    /// Number of sensors.
    pub sensors: u8,
    /// Distance between neighbours, metres.
    pub spacing_m: f64,
}

/// What the track fit may assume.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tracking {
    /// Mean speed of vessels here, m/s (training fleet of paper M: 7.3).
    pub speed_m_s: f64,
    /// Standard deviation of that speed, m/s (paper M: 2.3); 0 means known.
    pub speed_sd_m_s: f64,
    /// Standard deviation of a bearing's error beyond what the estimator reports, degrees (propagation, model).
    pub bearing_sd_deg: f64,
    /// Correlation time of that error, seconds (first-order Gauss-Markov).
    pub bearing_tau_s: f64,
    /// Standard deviation of what a vessel's own way, never quite straight, adds to the heading of its track and to the direction of its place,
    /// degrees. Half of all windows of 200 s of vessels in the Solent lie 14 m, root mean square, and more off a straight line: 0.8° at 1 km
    /// (`seabearing reproduce ais-kinematics`).
    pub course_sd_deg: f64,
    /// Nearest and farthest closest-point range considered, metres.
    pub range_m: (f64, f64),
    /// Speed of the vessels here from the rate of their shafts, where known.
    pub shaft_speed: Option<SpeedCurve>,
}

impl Default for Tracking {
    fn default() -> Self {
        Self {
            speed_m_s: 7.3,
            speed_sd_m_s: 2.3,
            bearing_sd_deg: 0.5,
            bearing_tau_s: 5.0,
            course_sd_deg: 0.5,
            range_m: (20.0, 5000.0),
            shaft_speed: None,
        }
    }
}

/// What is wrong with a configuration; the host adds file and line.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// A value outside its range: name of the key, what was given, least and greatest allowed.
    #[error("`{0}` is {1}; allowed {2} to {3}")]
    OutOfRange(&'static str, f64, f64, f64),
    /// The hydrophones make bearings impossible.
    #[error(transparent)]
    Geometry(GeometryError),
    /// `channels` is not a permutation of 0, 1, 2, 3.
    #[error("`channels` must name each of 0, 1, 2, 3 once")]
    Channels,
}

impl ArrayConfig {
    /// Hydrophones (East, North, Up in metres) on channels 0 to 3, and what a station file means where it says nothing.
    pub const fn new(hydrophones_m: [[f64; 3]; CHANNELS]) -> Self {
        Self {
            hydrophones_m,
            channels: [0, 1, 2, 3],
            sensitivity_db_re_1v_upa: [-165.0; CHANNELS],
            reference_range_m: 500.0,
            band_hz: (50.0, 25_000.0), // paper M, section IV-B
            segment_s: 1.0,
            step_s: 0.5,
            elevation_deg: (-90.0, 90.0),
            false_alarms_per_hour: 0.5,
            vessel_depth_m: 4.0, // a propeller's
            position_sd_m: 0.0,
            sound_speed_sd_m_s: 0.0,
        }
    }
}

impl StationConfig {
    /// A station of some kind at a sampling rate, and what a station file means where it says nothing: 24-bit codes,
    /// 1484 m/s, no position. Change fields as needed, then plan it (planning checks it).
    pub fn new(kind: Kind, rate_hz: f64) -> Self {
        Self {
            id: 0,
            name: heapless::String::new(),
            lat_lon_deg: None,
            local_east_north_m: None,
            depth_m: 0.0,
            orientation_deg: 0.0,
            sound_speed_m_s: 1484.0,
            rate_hz,
            full_scale: 1 << 23,
            kind,
            tracking: Tracking::default(),
            levels: Levels::default(),
            schedule: Schedule::default(),
            clips: Clips::default(),
            doubts: Doubts::default(),
        }
    }

    /// A compact array of four hydrophones (East, North, Up in metres); the band ends at half the rate.
    pub fn array(rate_hz: f64, hydrophones_m: [[f64; 3]; CHANNELS]) -> Self {
        let mut array = ArrayConfig::new(hydrophones_m);
        array.band_hz.1 = array.band_hz.1.min(rate_hz / 2.0);
        Self::new(Kind::Array(array), rate_hz)
    }

    /// Checks every value on its own; whether they go together (steps of a segment, size of an array, table of an ocean
    /// bottom) planning says.
    ///
    /// # Errors
    /// The first key found wrong.
    pub fn validate(&self) -> Result<(), ConfigError> {
        // Apart, because there are many of them.
        #[inline(never)]
        fn within(key: &'static str, x: f64, lo: f64, hi: f64) -> Result<(), ConfigError> {
            if x >= lo && x <= hi { Ok(()) } else { Err(ConfigError::OutOfRange(key, x, lo, hi)) }
        }
        within("sound_speed_m_s", self.sound_speed_m_s, 1300.0, 1700.0)?;
        within("orientation_deg", self.orientation_deg, -360.0, 360.0)?;
        within("depth_m", self.depth_m, -1.0, 12_000.0)?;
        if let Some((lat, lon)) = self.lat_lon_deg {
            within("lat_deg", lat, -90.0, 90.0)?;
            within("lon_deg", lon, -180.0, 360.0)?;
        }
        within("full_scale", f64::from(self.full_scale), 128.0, 2_147_483_647.0)?;
        let t = &self.tracking;
        let (slowest, fastest) = crate::motion::model::SPEEDS_M_S;
        within("speed_m_s", t.speed_m_s, slowest, fastest)?;
        within("speed_sd_m_s", t.speed_sd_m_s, 0.0, 20.0)?;
        within("bearing_sd_deg", t.bearing_sd_deg, 0.0, 45.0)?;
        within("bearing_tau_s", t.bearing_tau_s, 0.0, 3600.0)?;
        within("course_sd_deg", t.course_sd_deg, 0.0, 45.0)?;
        within("range_min_m", t.range_m.0, 1.0, 1e5)?;
        within("range_max_m", t.range_m.1, t.range_m.0 * 1.5, 2e5)?;
        if let Some(curve) = &t.shaft_speed {
            within("at_zero_m_s", curve.intercept_m_s, -20.0, 20.0)?;
            within("metres_a_turn", curve.slope_m, 0.01, 100.0)?;
            within("sd_m_s", curve.sd_m_s, 0.01, 20.0)?;
            within("valid_m_s[0]", curve.valid_m_s.0, slowest, fastest)?;
            within("valid_m_s[1]", curve.valid_m_s.1, curve.valid_m_s.0, fastest)?;
            within("blades", f64::from(curve.blades.unwrap_or(2)), 2.0, 7.0)?;
        }
        if self.levels.every_s > 0 {
            // An interval holds several steps of an array, several frames of an ocean bottom, which is asked for pressure.
            let (least, most, channel) = match &self.kind {
                Kind::Array(_) => (10.0, 3600.0, 3.0),
                Kind::Obs(_) => (60.0, 3600.0, 0.0),
                Kind::Line(_) => (0.0, 0.0, 0.0),
            };
            within("levels.every_s", f64::from(self.levels.every_s), least, most)?;
            within("levels.channel", f64::from(self.levels.channel), 0.0, channel)?;
        }
        if self.schedule.every_s > 0 {
            let Schedule { every_s, on_s } = self.schedule;
            within("schedule.every_s", f64::from(every_s), 20.0, 604_800.0)?;
            within("schedule.on_s", f64::from(on_s), 10.0, f64::from(every_s) - 10.0)?;
        }
        if self.clips.are_kept() {
            // No other recorder has a card.
            let most = if matches!(self.kind, Kind::Array(_)) { 3600.0 } else { 0.0 };
            within("card.after_s", f64::from(self.clips.after_s), 0.0, most)?;
            within("card.before_s", f64::from(self.clips.before_s), 0.0, 300.0)?;
            within("card.apart_s", f64::from(self.clips.apart_s), 1.0, 86_400.0)?;
        }
        match &self.kind {
            Kind::Array(a) => {
                within("rate_hz", self.rate_hz, 4000.0, 200_000.0)?;
                within("band_hz[0]", a.band_hz.0, 0.0, self.rate_hz / 2.0)?;
                within("band_hz[1]", a.band_hz.1, a.band_hz.0 + 100.0, self.rate_hz / 2.0)?;
                within("segment_s", a.segment_s, 0.1, 10.0)?;
                within("step_s", a.step_s, 0.05, a.segment_s)?;
                within("elevation_deg[0]", a.elevation_deg.0, -90.0, 89.0)?;
                within("elevation_deg[1]", a.elevation_deg.1, a.elevation_deg.0 + 1.0, 90.0)?;
                within("false_alarms_per_hour", a.false_alarms_per_hour, 1e-6, 1000.0)?;
                within("vessel_depth_m", a.vessel_depth_m, 0.0, 100.0)?;
                within("position_sd_m", a.position_sd_m, 0.0, 1.0)?;
                within("sound_speed_sd_m_s", a.sound_speed_sd_m_s, 0.0, 100.0)?;
                if a.reference_range_m.is_nan() || a.reference_range_m < 5.0 {
                    return Err(ConfigError::OutOfRange(
                        "reference_range_m",
                        a.reference_range_m,
                        5.0,
                        f64::INFINITY,
                    ));
                }
                for s in a.sensitivity_db_re_1v_upa {
                    within("sensitivity_db_re_1v_upa", s, -260.0, -60.0)?;
                }
                let mut seen = [false; CHANNELS];
                for c in a.channels {
                    match seen.get_mut(usize::from(c)) {
                        Some(s) if !*s => *s = true,
                        _ => return Err(ConfigError::Channels),
                    }
                }
                self.geometry().map(|_| ()).map_err(ConfigError::Geometry)
            }
            Kind::Obs(o) => {
                within("rate_hz", self.rate_hz, 20.0, 500.0)?;
                within("orientation_sd_deg", f64::from(self.doubts.orientation_deg), 0.0, 90.0)?;
                within("gain_sd_db", f64::from(self.doubts.gain_db), 0.0, 20.0)?;
                within("table_depth_sd_m", f64::from(self.doubts.table_depth_m), 0.0, 1000.0)?;
                within("orientation_of_north_deg", o.orientation_of_north_deg, -360.0, 360.0)
            }
            Kind::Line(l) => {
                within("sensors", f64::from(l.sensors), 3.0, 32.0)?;
                within("spacing_m", l.spacing_m, 0.001, 1000.0)
            }
        }
    }

    /// The array's geometry in the true frame.
    ///
    /// # Errors
    /// As [`Geometry::new`]; a station that is no array has [`GeometryError::NotFinite`].
    pub fn geometry(&self) -> Result<Geometry, GeometryError> {
        match &self.kind {
            Kind::Array(a) => Geometry::new(
                &a.hydrophones_m,
                self.orientation_deg * crate::angle::RAD_PER_DEG,
                self.sound_speed_m_s,
            ),
            _ => Err(GeometryError::NotFinite),
        }
    }

    /// Identifies the configuration: FNV-1a (64 bits) of its postcard bytes, of the levels' where any are sent, of the
    /// schedule's where there is one, of the clips' where not all sound is kept, and of the doubts' where there are any. Equal configurations have equal hashes.
    pub fn hash(&self) -> u64 {
        let mut buffer = [0u8; 1024];
        let Ok(length) = postcard::to_slice(self, &mut buffer).map(|bytes| bytes.len()) else { return 0 };
        let (levels, schedule, clips) = (self.levels.bytes(), self.schedule.bytes(), self.clips.bytes());
        let levels = levels.iter().filter(|_| self.levels.every_s > 0);
        let schedule = schedule.iter().filter(|_| self.schedule.every_s > 0);
        let doubts = self.doubts.bytes();
        let doubts = doubts.iter().filter(|_| self.doubts.are_any());
        let clips = clips.iter().filter(|_| self.clips.are_kept());
        let behind = levels.chain(schedule).chain(clips).chain(doubts);
        let mut end = length;
        for (to, from) in buffer.iter_mut().skip(length).zip(behind) {
            *to = *from;
            end += 1;
        }
        crate::wire::hash::fnv1a(buffer.get(..end).unwrap_or_default())
    }
}
