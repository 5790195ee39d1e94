//! The station file (TOML): unknown or wrong keys are errors that name the key and the line.

use crate::toml_file::TomlFile;
use anyhow::{Result, anyhow, bail};
use seabearing_core::array::{self, PlanError};
use seabearing_core::config::{
    ArrayConfig, ConfigError, Kind, LineConfig, ObsConfig, StationConfig, Tracking,
};
use seabearing_core::demon::{SpeedCurve, VESSEL_SPEEDS_M_S};
use serde::Deserialize;
use std::path::{Path, PathBuf};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    station: StationTable,
    sampling: Option<Sampling>,
    array: Option<Array>,
    obs: Option<Obs>,
    line: Option<Line>,
    tracking: Option<TrackingTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NetworkFile {
    stations: Vec<StationTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct StationTable {
    id: Option<u16>,
    name: Option<String>,
    kind: Option<String>,
    position: Option<Position>,
    #[serde(default)]
    orientation_deg: f64,
    #[serde(default = "default_sound_speed")]
    sound_speed_m_s: f64,
    // Of a base station's list only.
    line: Option<String>,
    key_file: Option<PathBuf>,
    utc_of_sample_0: Option<String>,
}

impl StationTable {
    /// A key that is there and has its place in a list only.
    fn listed_key(&self) -> Option<&'static str> {
        let keys = [
            ("line", self.line.is_some()),
            ("key_file", self.key_file.is_some()),
            ("utc_of_sample_0", self.utc_of_sample_0.is_some()),
        ];
        keys.into_iter().find(|(_, there)| *there).map(|(key, _)| key)
    }
}

fn default_sound_speed() -> f64 {
    1484.0
}

#[derive(Deserialize, Clone)]
#[serde(deny_unknown_fields)]
struct Position {
    lat_deg: Option<f64>,
    lon_deg: Option<f64>,
    depth_m: Option<f64>,
    local_m: Option<[f64; 3]>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Sampling {
    rate_hz: f64,
    #[serde(default = "default_full_scale")]
    full_scale: i32,
}

fn default_full_scale() -> i32 {
    1 << 23
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Array {
    hydrophones_m: Vec<[f64; 3]>,
    channels: Vec<u8>,
    sensitivity_db_re_1v_upa: Vec<f64>,
    reference_range_m: f64,
    band_hz: [f64; 2],
    segment_s: f64,
    step_s: f64,
    elevation_deg: [f64; 2],
    false_alarms_per_hour: f64,
    vessel_depth_m: f64,
    position_sd_m: f64,
    sound_speed_sd_m_s: f64,
}

impl Default for Array {
    /// What a file means where it says nothing; hydrophones it must state.
    fn default() -> Self {
        let usual = ArrayConfig::new([[0.0; 3]; 4]);
        Self {
            hydrophones_m: Vec::new(),
            channels: usual.channels.to_vec(),
            sensitivity_db_re_1v_upa: usual.sensitivity_db_re_1v_upa.to_vec(),
            reference_range_m: usual.reference_range_m,
            band_hz: usual.band_hz.into(),
            segment_s: usual.segment_s,
            step_s: usual.step_s,
            elevation_deg: usual.elevation_deg.into(),
            false_alarms_per_hour: usual.false_alarms_per_hour,
            vessel_depth_m: usual.vessel_depth_m,
            position_sd_m: usual.position_sd_m,
            sound_speed_sd_m_s: usual.sound_speed_sd_m_s,
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Obs {
    components: Option<Components>,
    #[serde(default)]
    orientation_of_north_deg: f64,
    #[serde(default = "default_intensity")]
    intensity: String,
    propagation: Option<PathBuf>,
    compatibility: Option<String>,
}

fn default_intensity() -> String {
    "away".into()
}

/// Channel code of each component of an ocean-bottom station.
#[derive(Deserialize, Clone, Debug, PartialEq, Eq)]
#[serde(deny_unknown_fields)]
pub struct Components {
    /// The hydrophone.
    pub pressure: String,
    /// First horizontal.
    pub north: String,
    /// Second horizontal, 90° clockwise of the first.
    pub east: String,
    /// Vertical, positive up.
    pub vertical: String,
}

impl Default for Components {
    fn default() -> Self {
        Self { pressure: "BDH".into(), north: "BH1".into(), east: "BH2".into(), vertical: "BHZ".into() }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    sensors: u8,
    spacing_m: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct TrackingTable {
    speed_m_s: f64,
    speed_sd_m_s: f64,
    bearing_sd_deg: f64,
    bearing_tau_s: f64,
    range_m: [f64; 2],
    speed_from_shaft: Option<ShaftTable>,
}

/// Speed of the vessels here from the rate of their shafts.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ShaftTable {
    at_zero_m_s: f64,
    metres_a_turn: f64,
    sd_m_s: f64,
    blades: Option<u8>,
}

impl Default for TrackingTable {
    fn default() -> Self {
        let d = Tracking::default();
        Self {
            speed_m_s: d.speed_m_s,
            speed_sd_m_s: d.speed_sd_m_s,
            bearing_sd_deg: d.bearing_sd_deg,
            bearing_tau_s: d.bearing_tau_s,
            range_m: [d.range_m.0, d.range_m.1],
            speed_from_shaft: None,
        }
    }
}

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
}

/// A station file as read.
#[derive(Debug, Clone)]
pub struct Station {
    /// The validated configuration.
    pub config: StationConfig,
    /// Channel codes of an ocean-bottom station.
    pub components: Components,
    /// The propagation table of an ocean-bottom station, resolved against the station file's folder.
    pub propagation: Option<PathBuf>,
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
        let error = match &station.config.kind {
            Kind::Array(_) => array::Plan::new(&station.config).err(),
            _ => None,
        };
        error.map_or(Ok(station), |e| Err(unplanned(&e, source)))
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
        let kind = match kind.as_str() {
            "array" => {
                let Some(a) = file.array else { bail!("{name}: kind = \"array\" needs a table [array]") };
                Kind::Array(ArrayConfig {
                    hydrophones_m: four(&a.hydrophones_m, &here("array.hydrophones_m"), "hydrophones_m")?,
                    channels: four(&a.channels, &here("array.channels"), "channels")?,
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
                propagation = o.propagation.map(|p| folder.join(p));
                Kind::Obs(ObsConfig {
                    orientation_of_north_deg: o.orientation_of_north_deg,
                    intensity_towards: match o.intensity.as_str() {
                        "away" => false,
                        "towards" => true,
                        other => bail!("{}: intensity = \"{other}\"; away or towards", here("obs.intensity")),
                    },
                    paper_compatibility: match o.compatibility.as_deref() {
                        None => false,
                        Some("paper") => true,
                        Some(other) => {
                            bail!(
                                "{}: compatibility = \"{other}\"; only \"paper\"",
                                here("obs.compatibility")
                            )
                        }
                    },
                })
            }
            "line" => {
                let Some(l) = file.line else { bail!("{name}: kind = \"line\" needs a table [line]") };
                Kind::Line(LineConfig { sensors: l.sensors, spacing_m: l.spacing_m })
            }
            other => bail!("{}: kind = \"{other}\"; array, obs or line", here("station.kind")),
        };
        let tracking = file.tracking.unwrap_or_default();
        let config = StationConfig {
            rate_hz,
            full_scale: sampling.as_ref().map_or(default_full_scale(), |s| s.full_scale),
            kind,
            tracking: Tracking {
                speed_m_s: tracking.speed_m_s,
                speed_sd_m_s: tracking.speed_sd_m_s,
                bearing_sd_deg: tracking.bearing_sd_deg,
                bearing_tau_s: tracking.bearing_tau_s,
                range_m: (tracking.range_m[0], tracking.range_m[1]),
                shaft_speed: tracking.speed_from_shaft.map(|s| SpeedCurve {
                    intercept_m_s: s.at_zero_m_s,
                    slope_m: s.metres_a_turn,
                    sd_m_s: s.sd_m_s,
                    blades: s.blades,
                    valid_m_s: VESSEL_SPEEDS_M_S,
                }),
            },
            ..base(&file.station, "station", source)?
        };
        config.validate().map_err(|e| explain(&e, source))?;
        Ok(Self { config, components, propagation })
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
        let listed = |(i, s): (usize, StationTable)| {
            let config = base(&s, &format!("stations.{i}"), &source)?;
            Ok(ListedStation {
                config,
                line: s.line,
                key_file: s.key_file,
                utc_of_sample_0: s.utc_of_sample_0,
            })
        };
        let stations = file.stations.into_iter().enumerate().map(listed).collect::<Result<_>>()?;
        Ok((source, stations))
    }
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
    })
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
mod tests {
    use super::*;

    const GOOD: &str = r#"
[station]
id = 1
name = "east"
kind = "array"
position = { lat_deg = 49.04, lon_deg = -123.32, depth_m = 168.0 }

[sampling]
rate_hz = 64000

[array]
hydrophones_m = [[0.0, 1.07, -0.38], [0.93, -0.53, -0.38], [-0.93, -0.53, -0.38], [0.0, 0.0, 1.13]]
"#;

    fn parse(text: &str) -> Result<Station> {
        Station::parse(text, "s.toml", Path::new("."))
    }

    #[test]
    fn a_good_file_reads_and_hashes_stably() {
        let a = parse(GOOD).unwrap().config;
        let b = parse(GOOD).unwrap().config;
        assert_eq!(a.hash(), b.hash());
        assert_ne!(a.hash(), parse(&GOOD.replace("168", "169")).unwrap().config.hash());
    }

    #[test]
    fn a_speed_curve_is_read_and_checked() {
        let with = |curve: &str| parse(&format!("{GOOD}\n[tracking]\nspeed_from_shaft = {{ {curve} }}\n"));
        let curve = with("at_zero_m_s = 0.5, metres_a_turn = 3.1, sd_m_s = 0.6, blades = 4").unwrap();
        let curve = curve.config.tracking.shaft_speed.unwrap();
        assert_eq!((curve.slope_m, curve.blades), (3.1, Some(4)));
        let e = with("at_zero_m_s = 0.5, metres_a_turn = 0.0, sd_m_s = 0.6").unwrap_err().to_string();
        assert!(e.contains("metres_a_turn") && e.contains("line 15"), "{e}");
    }

    #[test]
    fn speeds_no_fit_considers_are_refused() {
        let with = |speed: &str| parse(&format!("{GOOD}\n[tracking]\nspeed_m_s = {speed}\n"));
        assert!(with("0.2").is_ok() && with("40.0").is_ok());
        let e = with("0.15").unwrap_err().to_string();
        assert!(e.contains("`speed_m_s` is 0.15; allowed 0.2 to 40") && e.contains("line 15"), "{e}");
        let mut config = with("7.0").unwrap().config;
        let curve =
            |valid_m_s| SpeedCurve { intercept_m_s: 0.5, slope_m: 3.1, sd_m_s: 0.6, blades: None, valid_m_s };
        for (valid_m_s, good) in
            [((0.2, 30.0), true), ((0.0, 30.0), false), ((5.0, 1.0), false), ((1.0, f64::NAN), false)]
        {
            config.tracking.shaft_speed = Some(curve(valid_m_s));
            assert_eq!(config.validate().is_ok(), good, "{valid_m_s:?}");
        }
    }

    #[test]
    fn the_vessels_depth_is_one_value() {
        let motion = |depth: &str| {
            let text = GOOD.replace("[array]\n", &format!("[array]\nvessel_depth_m = {depth}\n"));
            seabearing_core::passage::Config::of_station(&parse(&text).unwrap().config)
        };
        assert_eq!((motion("4.0").medium.height_m, motion("9.0").medium.height_m), (164.0, 159.0));
    }

    #[test]
    fn what_the_chain_cannot_run_names_key_line_and_remedy() {
        let refused = |change: (&str, &str)| {
            let source = TomlFile::of(&GOOD.replace(change.0, change.1), "s.toml");
            Station::recordable(&source, Path::new(".")).unwrap_err().to_string()
        };
        let e = refused(("64000", "4000"));
        assert!(e.contains("s.toml, line 9") && e.contains("step_s") && e.contains("higher rate"), "{e}");
        let e = refused(("1.07", "9.07"));
        assert!(e.contains("line 9") && e.contains("samples across") && e.contains("nearer"), "{e}");
        let e = refused(("[array]", "[array]\nband_hz = [100.0, 210.0]"));
        assert!(e.contains("line 12") && e.contains("wider"), "{e}");
        assert!(Station::recordable(&TomlFile::of(GOOD, "s.toml"), Path::new(".")).is_ok());
    }

    #[test]
    fn wrong_files_name_key_and_line() {
        let e = parse(&GOOD.replace("rate_hz", "rate_khz")).unwrap_err().to_string();
        assert!(e.contains("rate_khz") && e.contains("line 9"), "{e}");
        let e = parse(&GOOD.replace("1.13", "-0.38")).unwrap_err().to_string();
        assert!(e.contains("one plane") && e.contains("line 12"), "{e}");
        let e = parse(&GOOD.replace("64000", "64")).unwrap_err().to_string();
        assert!(e.contains("rate_hz") && e.contains("line 9"), "{e}");
        let e = parse(&GOOD.replace("kind = \"array\"\n", "")).unwrap_err().to_string();
        assert!(e.contains("kind"), "{e}");
    }
}
