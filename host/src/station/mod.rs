//! The station file (TOML): unknown or wrong keys are errors that name the key and the line.

mod calibration;
mod dataless;
pub mod described;
pub mod import;
pub mod response;
#[cfg(feature = "schema")]
pub mod schema;
mod table_sound;
mod tables;
mod xml;

pub use calibration::{Calibration, Calibrations};
pub use tables::Components;

use crate::line::Analysis;
use crate::recording::written_time;
use crate::toml_file::TomlFile;
use anyhow::{Result, anyhow, bail};
use response::Response;
use seabearing_core::array::{self, PlanError};
use seabearing_core::config::{
    ArrayConfig, Clips, Compatibility, ConfigError, Doubts, Kind, Levels, LineConfig, ObsConfig, Schedule,
    StationConfig, Tracking,
};
use seabearing_core::demon::{SpeedCurve, VESSEL_SPEEDS_M_S};
use seabearing_locate::line::{MAX_FREQUENCIES, MusicMethod};
use std::path::{Path, PathBuf};
use tables::{CardTable, File, NetworkFile, RecordTable, StationTable, default_full_scale};
use time::UtcOffset;

/// A station of a list, and how a base station reaches it.
#[derive(Debug, Clone)]
pub struct ListedStation {
    /// What the keys of `[station]` say; the kind is a placeholder.
    pub config: StationConfig,
    /// `line`: `listen:ADDR:PORT`, `tcp:HOST:PORT`, `serial:DEVICE:BAUD` or `file:PATH`.
    pub line: Option<String>,
    /// `key_file`: the key that commands are signed with.
    pub key_file: Option<PathBuf>,
    /// `utc_of_sample_0`, for a recorder without a clock, RFC 3339.
    pub utc_of_sample_0: Option<String>,
    /// `orientation_sd_deg`: standard deviation of the orientation, degrees, where it is said; else [`ORIENTATION_SD_DEG`].
    pub orientation_sd_deg: Option<f64>,
    /// `clock_sd_s`: standard deviation of the clock against those of the others, seconds.
    pub clock_sd_s: Option<f64>,
    /// What levels of each recorder channel are levels of, as its `station_file` says.
    pub calibration: Option<[Calibration; 4]>,
}

/// Standard deviation of an orientation of which none is stated, degrees: what passes of known vessels give.
pub const ORIENTATION_SD_DEG: f64 = 0.5;
/// Standard deviation of a clock of which neither the list nor the recorder states one, seconds: that of a part in a million,
/// three weeks after it was set.
pub const CLOCK_SD_S: f64 = 2.0;

/// A station file as read.
#[derive(Debug, Clone)]
pub struct Station {
    /// How a line's recordings are analysed.
    pub line: Analysis,
    /// The validated configuration.
    pub config: StationConfig,
    /// Channel codes of an ocean-bottom station.
    pub components: Components,
    /// The propagation table of an ocean-bottom station, resolved against the station file's folder.
    pub propagation: Option<PathBuf>,
    /// Network, station and location (`7D.FN01A.00`) whose records are an ocean-bottom station's; all where it names none.
    pub seed_id: Option<String>,
    /// What the codes of pressure, north, east and vertical in miniSEED and SAC files are multiplied by.
    pub gains: [f64; 4],
    /// What of pressure, north, east and vertical is not flat, and taken out of recordings.
    pub responses: [Option<Response>; 4],
    /// Channels of the recordings that are the recorder's 0 to 3, where the station file names them.
    pub file_channels: Option<[u8; 4]>,
    /// Offset from UTC of the times in names of recordings, where the station file tells it.
    pub name_offset: Option<UtcOffset>,
    /// What levels of each recorder channel are levels of.
    pub calibration: [Calibration; 4],
}

impl Station {
    /// Reads and validates a station file.
    ///
    /// # Errors
    /// One line: file, line, key, and what is allowed.
    pub fn read(path: &Path) -> Result<Self> {
        let folder = path.parent().unwrap_or(Path::new("."));
        Self::of(&TomlFile::read(path, "station file")?, folder)
    }

    /// As [`Station::read`], for what the recorder is to run: an array that its chain cannot take is refused as well.
    ///
    /// # Errors
    /// As [`Station::read`].
    pub fn of_recorder(path: &Path) -> Result<Self> {
        let folder = path.parent().unwrap_or(Path::new("."));
        Self::recordable(&TomlFile::read(path, "station file")?, folder)
    }

    fn recordable(source: &TomlFile, folder: &Path) -> Result<Self> {
        let station = Self::of(source, folder)?;
        station.refused(source).map_or(Ok(station), Err)
    }

    /// Why no recorder's chain can take what its hydrophones hear at its rate, as said of the station file; `None` where one can.
    pub fn refused(&self, source: &TomlFile) -> Option<anyhow::Error> {
        match &self.config.kind {
            Kind::Array(_) => array::Plan::new(&self.config).err().map(|e| unplanned(&e, source)),
            _ => None,
        }
    }

    /// Parses and validates text; `name` stands in messages, `folder` resolves relative paths.
    ///
    /// # Errors
    /// As [`Station::read`].
    pub fn parse(text: &str, name: &str, folder: &Path) -> Result<Self> {
        Self::of(&TomlFile::of(text, name), folder)
    }

    /// Validates a file as read; `folder` resolves relative paths.
    ///
    /// # Errors
    /// As [`Station::read`].
    pub fn of(source: &TomlFile, folder: &Path) -> Result<Self> {
        let file: File = source.parse()?;
        let name = source.name();
        let here = |key: &str| source.at(key);
        if let Some(key) = file.station.listed_key() {
            bail!("{}: `{key}` belongs into a list of [[stations]]", here(&format!("station.{key}")));
        }
        let kind = match file.station.kind.as_deref() {
            Some(k) => k.to_owned(),
            None => bail!("{}: missing key `kind` in [station]: array, obs or line", here("station")),
        };
        let sampling = file.sampling;
        let rate_hz = match (&sampling, kind.as_str()) {
            (Some(s), _) => s.rate_hz,
            (None, "line") => 0.0,
            (None, _) => bail!("{name}: missing table [sampling] with `rate_hz`"),
        };
        let mut components = Components::default();
        let mut propagation = None;
        let mut seed_id = None;
        let mut doubts = Doubts::default();
        let mut table_sound_sd_m_s = 0.0;
        let mut gains = [1.0; 4];
        let mut responses = [const { None }; 4];
        let mut sensitivity = None;
        let mut file_channels = None;
        let mut line = Analysis::default();
        let kind = match kind.as_str() {
            "array" => {
                let Some(a) = file.array else { bail!("{name}: kind = \"array\" needs a table [array]") };
                let usual = [0, 1, 2, 3];
                let named = a.channels.map(|c| four(&c, &here("array.channels"), "channels")).transpose()?;
                // Channels beyond the recorder's four are chosen while reading; then hydrophone i is on channel i.
                let chosen = named.is_some_and(|c| c.iter().any(|c| *c > 3));
                file_channels = named.map(|c| if chosen { c } else { usual });
                let channels = if chosen { usual } else { named.unwrap_or(usual) };
                if let Some(c) = named.filter(|c| chosen && (0..4).any(|i| c[..i].contains(&c[i]))) {
                    bail!("{}: {c:?}: `channels` must be four different ones", here("array.channels"));
                }
                Kind::Array(ArrayConfig {
                    hydrophones_m: four(&a.hydrophones_m, &here("array.hydrophones_m"), "hydrophones_m")?,
                    channels,
                    sensitivity_db_re_1v_upa: four(
                        &a.sensitivity_db_re_1v_upa,
                        &here("array.sensitivity_db_re_1v_upa"),
                        "sensitivity_db_re_1v_upa",
                    )?,
                    reference_range_m: a.reference_range_m,
                    band_hz: (a.band_hz[0], a.band_hz[1].min(rate_hz / 2.0)),
                    segment_s: a.segment_s,
                    step_s: a.step_s,
                    elevation_deg: (a.elevation_deg[0], a.elevation_deg[1]),
                    false_alarms_per_hour: a.false_alarms_per_hour,
                    vessel_depth_m: a.vessel_depth_m,
                    position_sd_m: a.position_sd_m,
                    sound_speed_sd_m_s: a.sound_speed_sd_m_s,
                })
            }
            "obs" => {
                let Some(o) = file.obs else { bail!("{name}: kind = \"obs\" needs a table [obs]") };
                components = o.components.unwrap_or_default();
                if let Some([a, b]) = components.alike() {
                    bail!(
                        "{}: `{a}` and `{b}` name the same channel; each component is a channel of its own",
                        here("obs.components")
                    );
                }
                propagation = o.propagation.map(|p| folder.join(p));
                seed_id = o.seed_id;
                sensitivity = o.sensitivity;
                doubts = Doubts {
                    orientation_deg: o.orientation_sd_deg,
                    gain_db: o.gain_sd_db,
                    table_depth_m: o.table_depth_sd_m,
                };
                table_sound_sd_m_s = o.table_sound_speed_sd_m_s;
                gains = o.sensitivity.map_or(gains, |s| s.gains());
                if !gains.iter().all(|g| g.is_finite() && *g != 0.0) {
                    bail!("{}: each sensitivity must be a number other than 0", here("obs.sensitivity"));
                }
                let r = o.responses;
                responses = [r.pressure, r.north, r.east, r.vertical];
                let named = ["pressure", "north", "east", "vertical"].into_iter().zip(&responses);
                let mut unsound = named.filter(|(_, r)| r.as_ref().is_some_and(|r| !r.is_sound()));
                if let Some((component, _)) = unsound.next() {
                    bail!(
                        "{}: at most 64 poles, all of negative real part, and 64 zeros, rad/s, and `at_hz` above 0 where the \
                         response is not 0",
                        here(&format!("obs.responses.{component}"))
                    );
                }
                Kind::Obs(ObsConfig {
                    orientation_of_north_deg: o.orientation_of_north_deg,
                    intensity_towards: match o.intensity.as_str() {
                        "away" => false,
                        "towards" => true,
                        other => bail!("{}: intensity = \"{other}\"; away or towards", here("obs.intensity")),
                    },
                    compatibility: match o.compatibility.as_deref() {
                        None => Compatibility::None,
                        Some("paper") => Compatibility::Paper,
                        Some("programme") => Compatibility::Programme,
                        Some(other) => {
                            bail!(
                                "{}: compatibility = \"{other}\"; paper or programme",
                                here("obs.compatibility")
                            )
                        }
                    },
                    azigram: o.azigram,
                })
            }
            "line" => {
                let Some(l) = file.line else { bail!("{name}: kind = \"line\" needs a table [line]") };
                line = line_analysis(&l, source)?;
                Kind::Line(LineConfig { sensors: l.sensors, spacing_m: l.spacing_m })
            }
            other => bail!("{}: kind = \"{other}\"; array, obs or line", here("station.kind")),
        };
        let tracking = file.tracking.unwrap_or_default();
        let of_all = base(&file.station, "station", source)?;
        table_sound::count(&mut doubts, table_sound_sd_m_s, (of_all.depth_m, of_all.sound_speed_m_s))
            .map_err(|what| source.wrong("obs.table_sound_speed_sd_m_s", what))?;
        let config = StationConfig {
            rate_hz,
            full_scale: sampling.as_ref().map_or(default_full_scale(), |s| s.full_scale),
            kind,
            tracking: Tracking {
                speed_m_s: tracking.speed_m_s,
                speed_sd_m_s: tracking.speed_sd_m_s,
                bearing_sd_deg: tracking.bearing_sd_deg,
                bearing_tau_s: tracking.bearing_tau_s,
                course_sd_deg: tracking.course_sd_deg,
                range_m: (tracking.range_m[0], tracking.range_m[1]),
                shaft_speed: tracking.speed_from_shaft.map(|s| SpeedCurve {
                    intercept_m_s: s.at_zero_m_s,
                    slope_m: s.metres_a_turn,
                    sd_m_s: s.sd_m_s,
                    blades: s.blades,
                    valid_m_s: VESSEL_SPEEDS_M_S,
                }),
            },
            levels: file
                .levels
                .map_or_else(Levels::default, |l| Levels { every_s: l.every_s, channel: l.channel }),
            schedule: file
                .schedule
                .map_or_else(Schedule::default, |s| Schedule { every_s: s.every_s, on_s: s.on_s }),
            clips: clips_of(file.card.as_ref(), source)?,
            doubts,
            ..of_all
        };
        config.validate().map_err(|e| explain(&e, source))?;
        let name_offset = sampling.as_ref().and_then(|s| s.name_offset.as_deref());
        let name_offset = name_offset.map(|text| {
            let what =
                || format!("name_offset = \"{text}\"; an offset from UTC like \"+10:00\" was expected");
            written_time::offset(text).ok_or_else(|| source.wrong("sampling.name_offset", what()))
        });
        let name_offset = name_offset.transpose()?;
        let sensitive = source.has("array.sensitivity_db_re_1v_upa");
        let calibration = calibration::of_channels(
            file.calibration.as_ref(),
            &config,
            sensitive,
            sensitivity,
            &responses,
            source,
        )?;
        Ok(Self {
            config,
            components,
            propagation,
            seed_id,
            gains,
            responses,
            file_channels,
            name_offset,
            calibration,
            line,
        })
    }

    /// Reads a network file: a list of `[[stations]]`.
    ///
    /// # Errors
    /// As [`Station::read`].
    pub fn read_network(path: &Path) -> Result<Vec<StationConfig>> {
        Ok(Self::read_listed(path)?.1.into_iter().map(|listed| listed.config).collect())
    }

    /// Reads a list of `[[stations]]` with what a base station needs besides; and gives the file, to say what is wrong.
    ///
    /// # Errors
    /// As [`Station::read`].
    pub fn read_listed(path: &Path) -> Result<(TomlFile, Vec<ListedStation>)> {
        let source = TomlFile::read(path, "network file")?;
        let file: NetworkFile = source.parse()?;
        if file.stations.is_empty() {
            bail!("{}: no [[stations]]", source.name());
        }
        let folder = path.parent().unwrap_or(Path::new("."));
        let listed = |(i, s): (usize, StationTable)| {
            let config = base(&s, &format!("stations.{i}"), &source)?;
            if !(-360.0..=360.0).contains(&config.orientation_deg) {
                let what = format!("orientation_deg = {}; -360 to 360 was expected", config.orientation_deg);
                return Err(source.wrong(&format!("stations.{i}.orientation_deg"), what));
            }
            for (key, sd, most) in
                [("orientation_sd_deg", s.orientation_sd_deg, 180.0), ("clock_sd_s", s.clock_sd_s, 86_400.0)]
            {
                if let Some(sd) = sd.filter(|sd| !(0.0..=most).contains(sd)) {
                    let what = format!("{key} = {sd}; 0 to {most} was expected");
                    return Err(source.wrong(&format!("stations.{i}.{key}"), what));
                }
            }
            let own = s.station_file.map(|file| Self::read(&folder.join(file))).transpose();
            let own =
                own.map_err(|e| source.wrong(&format!("stations.{i}.station_file"), format!("{e:#}")))?;
            Ok(ListedStation {
                config,
                calibration: own.map(|own| own.calibration),
                line: s.line,
                key_file: s.key_file,
                utc_of_sample_0: s.utc_of_sample_0,
                orientation_sd_deg: s.orientation_sd_deg,
                clock_sd_s: s.clock_sd_s,
            })
        };
        let stations = file.stations.into_iter().enumerate().map(listed).collect::<Result<_>>()?;
        Ok((source, stations))
    }
}

/// How a line's recordings are analysed.
fn line_analysis(l: &tables::Line, source: &TomlFile) -> Result<Analysis> {
    let usual = Analysis::default();
    let here = |key: &str| source.at(&format!("line.{key}"));
    let number = |key: &str, given: Option<f64>, usual: f64, possible: std::ops::Range<f64>| match given {
        Some(x) if !possible.contains(&x) => {
            bail!("{}: {key} = {x}; {} to below {} is possible", here(key), possible.start, possible.end)
        }
        given => Ok(given.unwrap_or(usual)),
    };
    let frequencies_hz = l.frequencies_hz.clone().unwrap_or_default();
    if frequencies_hz.len() > MAX_FREQUENCIES || !frequencies_hz.iter().all(|f| *f > 0.0 && f.is_finite()) {
        bail!(
            "{}: `frequencies_hz`: up to {MAX_FREQUENCIES} positive numbers are possible",
            here("frequencies_hz")
        );
    }
    let frame_s = number("frame_s", l.frame_s, usual.frame_s, 1e-4..60.0)?;
    // A Hann window is four bins wide at its foot: what is nearer together than two is heard by the same bins, and would count twice.
    let mut sorted = frequencies_hz.clone();
    sorted.sort_by(f64::total_cmp);
    let near = sorted.iter().zip(sorted.iter().skip(1)).find(|(a, b)| *b - *a < (2.0 - 1e-9) / frame_s);
    if let Some((a, b)) = near {
        bail!(
            "{}: `frequencies_hz` has {a} and {b}: nearer than {} Hz (two over `frame_s`) they hear the same, and each would count as \
             independent: leave one out, or lengthen `frame_s`",
            here("frequencies_hz"),
            2.0 / frame_s
        );
    }
    let channels = l.channels.clone().unwrap_or_default();
    let distinct = channels.iter().enumerate().all(|(i, c)| !channels.iter().take(i).any(|d| d == c));
    if !(channels.is_empty() || channels.len() == usize::from(l.sensors)) || !distinct {
        bail!("{}: `channels` must be {} different ones, one a sensor", here("channels"), l.sensors);
    }
    let method = match l.method.as_deref() {
        None | Some("root") => MusicMethod::Root,
        Some("spectrum") => MusicMethod::Spectrum,
        Some(other) => bail!("{}: method = \"{other}\"; root or spectrum", here("method")),
    };
    // Three sensors tell one source.
    let few = usize::from(l.sensors).saturating_sub(2).max(1);
    let sources = l.sources.map_or(usual.sources.min(few), usize::from);
    // A subarray needs more sensors than there are sources.
    let most = usize::from(l.sensors).saturating_sub(sources + 1).max(1);
    Ok(Analysis {
        frequencies_hz,
        frame_s,
        step_s: number("step_s", l.step_s, usual.step_s, 1e-3..3600.0)?,
        forgetting: number("forgetting", l.forgetting, usual.forgetting, 0.0..1.0)?,
        subarrays: l.subarrays.map_or(usual.subarrays.min(most), usize::from),
        sources,
        method,
        channels,
    })
}

/// The part every station has, from the table at a path; the kind is a placeholder for the caller to replace.
fn base(s: &StationTable, path: &str, source: &TomlFile) -> Result<StationConfig> {
    let station_name = s.name.clone().unwrap_or_else(|| format!("station-{}", s.id.unwrap_or(0)));
    let position = s.position.clone();
    let (lat_lon_deg, local, depth_m) = match position {
        None => (None, None, 0.0),
        Some(p) => {
            let lat_lon = match (p.lat_deg, p.lon_deg) {
                (Some(a), Some(b)) => Some((a, b)),
                (None, None) => None,
                _ => {
                    let at = source.at(&format!("{path}.position"));
                    bail!("{at}: position needs both `lat_deg` and `lon_deg`")
                }
            };
            let depth = p.depth_m.or(p.local_m.map(|l| -l[2])).unwrap_or(0.0);
            (lat_lon, p.local_m.map(|l| (l[0], l[1])), depth)
        }
    };
    Ok(StationConfig {
        id: s.id.unwrap_or(0),
        name: heapless::String::try_from(station_name.as_str()).map_err(|_| {
            let what = format!("station name `{station_name}` is longer than 24 bytes");
            source.wrong(&format!("{path}.name"), what)
        })?,
        lat_lon_deg,
        local_east_north_m: local,
        depth_m,
        orientation_deg: s.orientation_deg,
        sound_speed_m_s: s.sound_speed_m_s,
        rate_hz: 0.0,
        full_scale: default_full_scale(),
        kind: Kind::Line(LineConfig { sensors: 3, spacing_m: 1.0 }),
        tracking: Tracking::default(),
        levels: Levels::default(),
        schedule: Schedule::default(),
        clips: Clips::default(),
        doubts: Doubts::default(),
    })
}

/// Which sound a card keeps.
fn clips_of(card: Option<&CardTable>, source: &TomlFile) -> Result<Clips> {
    let Some(card) = card.filter(|card| card.record == RecordTable::Events) else {
        return Ok(Clips::default());
    };
    let clips = Clips { before_s: card.before_s, after_s: card.after_s, apart_s: card.apart_s };
    if clips.are_kept() {
        Ok(clips)
    } else {
        Err(source.wrong("card.after_s", "`card.after_s` is 0; allowed 1 to 3600"))
    }
}

fn four<T: Copy>(values: &[T], here: &str, key: &str) -> Result<[T; 4]> {
    if values.is_empty() {
        bail!("{here}: missing field `{key}`, four entries");
    }
    <[T; 4]>::try_from(values)
        .map_err(|_| anyhow!("{here}: `{key}` has {} entries, four are needed", values.len()))
}

/// What the core refuses, at the key it names.
fn explain(e: &ConfigError, source: &TomlFile) -> anyhow::Error {
    let key = match *e {
        ConfigError::OutOfRange(key, ..) => key.split('[').next().unwrap_or(key),
        ConfigError::Channels => "array.channels",
        ConfigError::Geometry(_) => "array.hydrophones_m",
    };
    source.wrong(key, e)
}

/// Why the array's chain cannot run a configuration, at the key to change.
fn unplanned(e: &PlanError, source: &TomlFile) -> anyhow::Error {
    let (key, remedy) = match e {
        PlanError::Steps => ("sampling.rate_hz", ": a longer step_s and segment_s, or a higher rate"),
        PlanError::TooLarge(..) => ("sampling.rate_hz", ": a lower rate, or hydrophones nearer together"),
        PlanError::Band => ("array.band_hz", ": a wider band, or a lower rate"),
        PlanError::Config(e) => return explain(e, source),
        PlanError::NotAnArray => ("station.kind", ""),
    };
    source.wrong(key, format!("{e}{remedy}"))
}

#[cfg(test)]
mod tests;
