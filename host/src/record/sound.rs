//! The records of the sound itself: raw samples and spectra, as commands ask for them, and directions by frequency.

use crate::station::Calibration;
use seabearing_core::block::MISSING;
use seabearing_core::wire::{self, AZIGRAM_BANDS, EDGES};
use serde::Serialize;
use serde_json::{Value, json};

/// Raw samples were taken as a command asked, and follow as `samples`.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Snippet {
    /// Number of the command.
    pub token: u8,
    /// Sample index of the first instant.
    pub index: u64,
    /// Instants: so many samples of each channel.
    pub instants: u32,
    /// Recorder channels, from 0.
    pub channels: Vec<u8>,
}

/// A piece of a `snippet`: codes of the converter as they are.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Samples {
    /// Number of the command.
    pub token: u8,
    /// Sample index of the first instant.
    pub index: u64,
    /// Recorder channels, from 0.
    pub channels: Vec<u8>,
    /// Codes, instant after instant, in each the channels in order; null where the converter gave none.
    pub codes: Vec<Option<i32>>,
}

/// Power spectral density of one channel, averaged over frames and the bins of each band.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Spectrum {
    /// Number of the command; 0 where the recorder sends it of itself (`[levels]` of the station file).
    pub token: u8,
    /// Sample index of the middle of the data used.
    pub index: u64,
    /// Recorder channel, from 0.
    pub channel: u8,
    /// Channels that the answer to the command holds; none where no command asked.
    pub channels: Vec<u8>,
    /// Frames averaged; 65535 also where they were more.
    pub frames: u16,
    /// What the levels are of: `full scale`, or the unit in which a station file calibrates the channel.
    pub reference: String,
    /// Edges of the bands, Hz: one more than there are bands.
    pub edges_hz: Vec<f64>,
    /// Level of the one-sided density in each band, dB re the reference squared in a hertz; null where it was not measured.
    pub density_db: Vec<Option<f64>>,
    /// Level of each band, dB re the reference: of the density times the band's width.
    pub band_db: Vec<Option<f64>>,
}

/// Where the sound comes from at an ocean-bottom station, by frequency, over the minute about `t_s`.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Azigram {
    /// Frames of the minute.
    pub frames: u8,
    /// Edges of the bands, Hz: one more than there are bands.
    pub edges_hz: Vec<f64>,
    /// Direction of the active intensity in which the bins of each band agree best, clockwise from true North; null where there is none.
    pub azimuth_deg: Vec<Option<f64>>,
    /// How far they agree: 1 where all point to one side all the time, √(m/n) where m bins of n do, about 0.25 where they point
    /// anywhere.
    pub coherence: Vec<f64>,
}

/// The channels of bits.
pub(super) fn channels(bits: u8) -> Vec<u8> {
    (0..4).filter(|c| bits >> c & 1 == 1).collect()
}

impl From<&wire::Snippet> for Snippet {
    fn from(s: &wire::Snippet) -> Self {
        Self { token: s.token, index: s.index, instants: s.instants, channels: channels(s.channels) }
    }
}

impl From<&wire::Samples> for Samples {
    fn from(s: &wire::Samples) -> Self {
        let codes = s.codes().map(|code| (code != MISSING).then_some(code)).collect();
        Self { token: s.token, index: s.index, channels: channels(s.channels), codes }
    }
}

impl From<&wire::Spectrum> for Spectrum {
    fn from(s: &wire::Spectrum) -> Self {
        // A bin stands for half a distance on either side.
        let edge_hz = |edge: &u16| (f64::from(*edge) - 0.5) * f64::from(s.bin_hz);
        let level = |tenth: &i16| (*tenth != wire::Spectrum::NOTHING).then_some(f64::from(*tenth) / 10.0);
        let bins = EDGES.iter().zip(EDGES.iter().skip(1)).map(|(from, to)| to - from);
        let band = |(tenth, bins): (&i16, u16)| {
            let width_db = 10.0 * (f64::from(bins) * f64::from(s.bin_hz)).log10();
            level(tenth).map(|level| rounded(level + width_db, 100.0))
        };
        Self {
            token: s.token,
            index: s.index,
            channel: s.channel,
            channels: channels(s.of),
            frames: s.frames,
            reference: "full scale".to_owned(),
            edges_hz: EDGES.iter().map(edge_hz).collect(),
            density_db: s.tenth_db.iter().map(level).collect(),
            band_db: s.tenth_db.iter().zip(bins).map(band).collect(),
        }
    }
}

/// Brings the levels of a record `spectrum` or `transient` to the reference of its channel; any other record stays as it is. A
/// band has the response at its middle, and is null where that is not known.
pub fn calibrate(record: &mut Value, of: &[Calibration]) {
    let channel = record["channel"].as_u64().and_then(|c| usize::try_from(c).ok());
    let Some(calibration) = channel.and_then(|c| of.get(c)) else { return };
    match record["type"].as_str() {
        Some("spectrum") => {}
        Some("transient") => return super::transient::calibrate(record, calibration),
        _ => return,
    }
    let edge_hz = |n: usize| record["edges_hz"][n].as_f64();
    let bands = record["edges_hz"].as_array().map_or(0, Vec::len).saturating_sub(1);
    let middle_hz = |n| Some((edge_hz(n)? * edge_hz(n + 1)?).sqrt());
    let more: Vec<Option<f64>> = (0..bands).map(|n| calibration.db(middle_hz(n)?)).collect();
    for key in ["density_db", "band_db"] {
        for (level, more) in record[key].as_array_mut().into_iter().flatten().zip(&more) {
            *level =
                level.as_f64().zip(*more).map_or(Value::Null, |(l, more)| json!(rounded(l + more, 100.0)));
        }
    }
    record["reference"] = calibration.reference.into();
}

impl From<&wire::Azigram> for Azigram {
    fn from(a: &wire::Azigram) -> Self {
        let edge = |band| usize::from(a.first_bin) + wire::Azigram::edge(a.bins.into(), band);
        // A bin stands for half a distance on either side.
        let edge_hz = |band| rounded((edge(band) as f64 - 0.5) * f64::from(a.bin_hz), 1e3);
        let azimuth = |(turn, coherence): (&u8, &u8)| {
            (*coherence > 0).then(|| rounded(f64::from(*turn) * 360.0 / 256.0, 10.0))
        };
        Self {
            frames: a.frames,
            edges_hz: (0..=AZIGRAM_BANDS).map(edge_hz).collect(),
            azimuth_deg: a.azimuth.iter().zip(&a.coherence).map(azimuth).collect(),
            coherence: a.coherence.iter().map(|c| rounded(f64::from(*c) / 255.0, 1e3)).collect(),
        }
    }
}

/// Rounded to parts of one: steps are coarser, and digits cost.
pub(super) fn rounded(x: f64, parts: f64) -> f64 {
    (x * parts).round() / parts
}
