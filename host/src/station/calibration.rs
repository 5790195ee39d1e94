//! What turns full scale into micropascals and nanometres a second.
//!
//! Of an array: level = 20 lg(rms code / full scale) + 20 lg(volts at full scale) − gain − sensitivity − response. Of an
//! ocean-bottom station, whose sensitivity is in counts: level = 20 lg(rms counts / sensitivity) − response, in pascals and
//! metres a second brought to the reference values of ISO 18405:2017: 1 µPa and 1 nm/s.

use super::response::Response;
use super::tables::{CalibrationTable, Sensitivity};
use crate::record::calibrate;
use crate::recording::WATER_LEVEL;
use crate::toml_file::TomlFile;
use anyhow::{Result, bail};
use seabearing_core::block::CHANNELS;
use seabearing_core::config::{Kind, StationConfig};
use serde_json::Value;
use std::collections::BTreeMap;

/// What levels of a channel are levels of.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// `pressure`, `velocity_north`, `velocity_east`, `velocity_vertical`.
    pub quantity: &'static str,
    /// The reference value of its levels: `1 µPa`, `1 nm/s`, or `full scale` where no sensitivity is known.
    pub reference: &'static str,
    /// Level of a root mean square of full scale, dB re the reference, where the response is flat.
    full_scale_db: f64,
    /// Frequency, Hz, and by how many decibels the channel is more sensitive there; rising. Empty: flat.
    response_db: Vec<(f64, f64)>,
    /// Below this, Hz, nothing is told: there is less in the recording than was taken out of it.
    from_hz: f64,
}

impl Default for Calibration {
    /// Pressure, of which nothing is known.
    fn default() -> Self {
        Self {
            quantity: "pressure",
            reference: "full scale",
            full_scale_db: 0.0,
            response_db: Vec::new(),
            from_hz: 0.0,
        }
    }
}

impl Calibration {
    /// What is to be added to a level re full scale where the response is flat, dB.
    pub fn flat_db(&self) -> f64 {
        self.full_scale_db
    }

    /// What is to be added to a level re full scale at a frequency, dB; `None` where the response is not known.
    pub fn db(&self, f_hz: f64) -> Option<f64> {
        if f_hz < self.from_hz {
            return None;
        }
        if self.response_db.is_empty() {
            return Some(self.full_scale_db);
        }
        let above = self.response_db.iter().position(|(f, _)| *f >= f_hz)?;
        let (f1, r1) = *self.response_db.get(above)?;
        let response = match above.checked_sub(1).and_then(|i| self.response_db.get(i)) {
            Some((f0, r0)) => r0 + (f_hz / f0).ln() / (f1 / f0).ln() * (r1 - r0),
            None if f1 == f_hz => r1,
            None => return None,
        };
        Some(self.full_scale_db - response)
    }
}

/// Calibrations of stations whose records come together.
#[derive(Clone, Debug, Default)]
pub struct Calibrations {
    /// By the station's number.
    pub of_station: BTreeMap<u64, [Calibration; CHANNELS]>,
    /// Of any other, and of records that do not tell their station.
    pub otherwise: Option<[Calibration; CHANNELS]>,
}

impl Calibrations {
    /// Of stations by their numbers, and of any other.
    pub fn new(
        listed: impl Iterator<Item = (u16, Option<[Calibration; CHANNELS]>)>,
        otherwise: Option<[Calibration; CHANNELS]>,
    ) -> Self {
        let of_station = listed.filter_map(|(station, of)| Some((u64::from(station), of?))).collect();
        Self { of_station, otherwise }
    }

    /// Brings a record's levels to the reference of its station ([`calibrate`]).
    pub fn apply(&self, record: &mut Value) {
        let station = record["station"].as_u64();
        if let Some(of) = station.and_then(|s| self.of_station.get(&s)).or(self.otherwise.as_ref()) {
            calibrate(record, of);
        }
    }
}

/// The calibration of each of a station's channels; `sensitive`: whether an array's file states its sensitivities; `responses`: what is
/// taken out of its recordings.
pub(super) fn of_channels(
    table: Option<&CalibrationTable>,
    config: &StationConfig,
    sensitive: bool,
    sensitivity: Option<Sensitivity>,
    responses: &[Option<Response>; CHANNELS],
    source: &TomlFile,
) -> Result<[Calibration; CHANNELS]> {
    let mut out = flat(table, config, sensitive, sensitivity, source)?;
    for (c, response) in out.iter_mut().zip(responses) {
        c.from_hz = response.as_ref().map_or(0.0, |r| r.falls_below(WATER_LEVEL));
    }
    Ok(out)
}

/// The same where nothing is taken out.
fn flat(
    table: Option<&CalibrationTable>,
    config: &StationConfig,
    sensitive: bool,
    sensitivity: Option<Sensitivity>,
    source: &TomlFile,
) -> Result<[Calibration; CHANNELS]> {
    let (response, motion) = match table {
        Some(t) => (
            response(&t.response_db, "response_db", source)?,
            response(&t.motion_response_db, "motion_response_db", source)?,
        ),
        None => Default::default(),
    };
    let volts = table.and_then(|t| t.full_scale_v);
    if let Some(v) = volts.filter(|v| !(1e-6..=1e3).contains(v)) {
        bail!("{}: full_scale_v = {v}; allowed 0.000001 to 1000", source.at("calibration.full_scale_v"));
    }
    let gain_db = table.map_or(0.0, |t| t.gain_db);
    if !(-120.0..=120.0).contains(&gain_db) {
        bail!("{}: gain_db = {gain_db}; allowed -120 to 120", source.at("calibration.gain_db"));
    }
    let pressure = Calibration { response_db: response, ..Calibration::default() };
    let mut out = [(); CHANNELS].map(|()| pressure.clone());
    match &config.kind {
        Kind::Array(array) => {
            let Some(volts) = volts.filter(|_| sensitive) else { return Ok(out) };
            for (channel, sensitivity_db) in array.channels.iter().zip(array.sensitivity_db_re_1v_upa) {
                if let Some(c) = out.get_mut(usize::from(*channel)) {
                    c.reference = "1 µPa";
                    c.full_scale_db = 20.0 * volts.log10() - gain_db - sensitivity_db;
                }
            }
        }
        Kind::Obs(_) => {
            let names = ["velocity_north", "velocity_east", "velocity_vertical"];
            for (c, name) in out.iter_mut().skip(1).zip(names) {
                *c = Calibration { quantity: name, response_db: motion.clone(), ..Calibration::default() };
            }
            let Some(s) = sensitivity else { return Ok(out) };
            let counts = [s.pressure, s.north, s.east, s.vertical];
            for (((i, c), counts), gain) in out.iter_mut().enumerate().zip(counts).zip(s.gains()) {
                // Codes of motion have been brought to north's sensitivity while reading.
                let full_scale = f64::from(config.full_scale) / (counts * gain).abs();
                (c.reference, c.full_scale_db) = match i {
                    0 => ("1 µPa", 20.0 * (full_scale * 1e6).log10()),
                    _ => ("1 nm/s", 20.0 * (full_scale * 1e9).log10()),
                };
            }
        }
        Kind::Line(_) => {}
    }
    Ok(out)
}

/// A table of frequencies and decibels, which must rise in frequency.
fn response(rows: &[[f64; 2]], key: &str, source: &TomlFile) -> Result<Vec<(f64, f64)>> {
    let at = || source.at(&format!("calibration.{key}"));
    for [f, db] in rows {
        if !(*f > 0.0 && f.is_finite() && (-200.0..=200.0).contains(db)) {
            bail!(
                "{}: `{key}` has [{f}, {db}]; a frequency above 0 Hz and -200 to 200 dB were expected",
                at()
            );
        }
    }
    if let Some(([f, _], [next, _])) = rows.iter().zip(rows.iter().skip(1)).find(|(a, b)| a[0] >= b[0]) {
        bail!("{}: `{key}` has {next} Hz after {f} Hz; frequencies must rise", at());
    }
    Ok(rows.iter().map(|[f, db]| (*f, *db)).collect())
}

#[cfg(test)]
mod tests {
    use super::super::Station;
    use super::*;
    use std::path::Path;

    const ARRAY: &str = "[station]\nkind = \"array\"\n[sampling]\nrate_hz = 64000\n[array]\n\
        hydrophones_m = [[0.0, 1.07, -0.38], [0.93, -0.53, -0.38], [-0.93, -0.53, -0.38], [0.0, 0.0, 1.13]]\n\
        channels = [1, 0, 2, 3]\nsensitivity_db_re_1v_upa = [-165.0, -170.0, -165.0, -165.0]\n";
    const OBS: &str = "[station]\nkind = \"obs\"\n[sampling]\nrate_hz = 50\n[obs]\n\
        sensitivity = { pressure = -4.0e3, north = 2.0e9, east = 1.0e9, vertical = 2.001e9 }\n";

    fn read(text: &str) -> Result<[Calibration; CHANNELS]> {
        Ok(Station::parse(text, "s.toml", Path::new("."))?.calibration)
    }

    #[test]
    fn full_scale_has_the_level_that_sensitivity_and_converter_say() {
        let got = read(&format!("{ARRAY}[calibration]\nfull_scale_v = 2.5\ngain_db = 20.0\n")).unwrap();
        let level = |c: usize| got[c].db(1000.0).unwrap();
        let volts_db = 20.0 * 2.5f64.log10();
        // Hydrophone 0 is on channel 1.
        assert!((level(1) - (volts_db - 20.0 + 165.0)).abs() < 1e-9, "{}", level(1));
        assert!((level(0) - (volts_db - 20.0 + 170.0)).abs() < 1e-9);
        assert_eq!((got[0].quantity, got[0].reference), ("pressure", "1 µPa"));
        let got = read(OBS).unwrap();
        let full = f64::from(1 << 23);
        let want = [full / 4e3 * 1e6, full / 2e9 * 1e9, full / 2e9 * 1e9, full / 2.001e9 * 1e9];
        for (c, want) in got.iter().zip(want) {
            assert!((c.db(10.0).unwrap() - 20.0 * want.log10()).abs() < 1e-9, "{c:?}");
        }
        assert_eq!(
            (got[0].reference, got[3].quantity, got[3].reference),
            ("1 µPa", "velocity_vertical", "1 nm/s")
        );
    }

    #[test]
    fn without_a_sensitivity_levels_are_of_full_scale() {
        let stated = format!("{ARRAY}[calibration]\nfull_scale_v = 2.5\n");
        let silent = stated.replace("sensitivity_db_re_1v_upa = [-165.0, -170.0, -165.0, -165.0]\n", "");
        for text in [ARRAY, &silent] {
            let got = read(text).unwrap();
            assert_eq!((got[2].reference, got[2].db(99.0)), ("full scale", Some(0.0)));
        }
        assert_eq!(read(&stated).unwrap()[2].reference, "1 µPa");
    }

    #[test]
    fn nothing_is_told_where_a_response_was_taken_out_of_nothing() {
        // A geophone of 4.5 Hz, in rad/s.
        let responses = "\n[obs.responses]\nnorth = { poles = [[-15.8, 23.4], [-15.8, -23.4]], zeros = [[0.0, 0.0], [0.0, 0.0]], at_hz = 20.0 }\n";
        let got = read(&format!("{OBS}{responses}")).unwrap();
        assert_eq!((got[1].db(1.0), got[1].db(2.0).is_some(), got[0].db(0.1).is_some()), (None, true, true));
    }

    #[test]
    fn a_response_is_taken_off_and_not_guessed_beyond_its_ends() {
        let table = "[calibration]\nresponse_db = [[10.0, -6.0], [1000.0, 0.0], [4000.0, 2.0]]\n";
        let got = read(&format!("{ARRAY}{table}")).unwrap();
        let at = |f: f64| got[0].db(f);
        assert_eq!((at(10.0), at(1000.0), at(9.9), at(4001.0)), (Some(6.0), Some(0.0), None, None));
        assert!((at(100.0).unwrap() - 3.0).abs() < 1e-9 && (at(2000.0).unwrap() + 1.0).abs() < 1e-9);
        let wrong = |change: (&str, &str)| {
            read(&format!("{ARRAY}{}", table.replace(change.0, change.1))).unwrap_err().to_string()
        };
        let e = wrong(("1000.0", "5.0"));
        assert!(e.contains("line 10") && e.contains("5 Hz after 10 Hz"), "{e}");
        let e = wrong(("[10.0", "[-1.0"));
        assert!(e.contains("above 0 Hz"), "{e}");
        let e = read(&format!("{ARRAY}[calibration]\nfull_scale_v = 0.0\n")).unwrap_err().to_string();
        assert!(e.contains("line 10") && e.contains("full_scale_v"), "{e}");
    }
}
