//! The pulse that interferences draw in the cepstrum: fitted from passages, and the ways formula 17 of the ocean-bottom paper is written.
//!
//! Vessels of three spectra pass at 4 to 30 km, without lines; `propagation fit`'s estimator gets their recordings and their
//! courses and must find the pulse. What it must find follows from the simulated spectra alone: a pair of paths modulates ln|X| in
//! proportion to W(f) = R/(1 + R), R the ratio of a vessel's density to the sea's, and the pulse is W's transform. The form of
//! formula 17 nearest to that, at 20 km, is the truth.
//!
//! Beside it, of the paper's own spectrum: the correlation with the mean cepstrum about the delays of formula 17 as the authors' programme
//! and this project write it, with the printed envelope, and as printed.

use super::obs_world::{print, quiet, station_table};
use super::{Experiment, Options};
use crate::course::VesselCourse;
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::passage::gain;
use crate::ocean_bottom::pulse::{Pieces, PulseForm, WIDEST_S, Written};
use crate::ocean_bottom::scenario::{ObsScenario, ObsVessel, Radiation, Side, Straight};
use crate::ocean_bottom::simulate::Simulator;
use crate::ocean_bottom::source::NoiseShape;
use crate::ocean_bottom::stages::{SpectralFrame, frames};
use crate::ocean_bottom::station;
use crate::propagation::Propagation;
use anyhow::Result;
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_2, TAU};

/// The experiment.
pub const PULSE: Experiment = Experiment {
    name: "obs-pulse",
    about: "the cepstral pulse fitted from simulated passages of three spectra, and the ways formula 17 is written",
    run,
};

/// Passages of each spectrum where the command line names no number.
const PASSAGES: usize = 4;

/// Length of a passage's record, s.
const RECORD_S: f64 = 10_800.0;

/// Range for which the truth is stated, m.
const AT_M: f64 = 20_000.0;

/// Spectra: greatest density and half width to −6 dB, Hz. The second is the paper's.
const SPECTRA: [(f64, f64); 3] = [(11.0, 6.0), (15.0, 10.0), (19.0, 7.0)];

fn radiation((centre_hz, half_width_hz): (f64, f64)) -> Radiation {
    Radiation { centre_hz, half_width_hz, tones_hz: Vec::new(), ..Radiation::default() }
}

/// The form of formula 17 nearest to what a vessel of a spectrum draws at a range.
fn expected(table: &Propagation, r: &Radiation, range_m: f64) -> PulseForm {
    const STEP_HZ: f64 = 0.1;
    let shape = NoiseShape { centre_hz: r.centre_hz, half_width_hz: r.half_width_hz };
    let bins = || (1..250).map(|k| STEP_HZ * f64::from(k));
    // Level in 5 to 25 Hz against a white sea, both over all paths, at the range levels are stated for, carried to this one.
    let inside: f64 = bins().filter(|f| *f >= 5.0).map(|f| shape.at(f).powi(2)).sum::<f64>() * STEP_HZ;
    let there = gain(table, 5, range_m) / gain(table, 5, 20_000.0);
    let level = 10f64.powf(r.wideband_db / 10.0) * 20.0 / inside * there;
    let weights: Vec<(f64, f64)> = bins()
        .map(|f| {
            let ratio = level * shape.at(f).powi(2);
            (f, ratio / (1.0 + ratio))
        })
        .collect();
    let offs: Vec<f64> = (-32..=32).map(|k| 0.005 * f64::from(k)).collect();
    let drawn: Vec<[f64; 2]> = offs
        .iter()
        .map(|d| {
            [0.0, FRAC_PI_2].map(|phase| weights.iter().map(|(f, w)| w * (TAU * f * d - phase).cos()).sum())
        })
        .collect();
    let likeness = |form: &PulseForm| {
        let (mut xy, mut xx) = (0.0, 0.0);
        for (d, y) in offs.iter().zip(&drawn) {
            for (phase, y) in [0.0, FRAC_PI_2].iter().zip(y) {
                let m = form.at(*d, 0.0, *phase);
                (xy, xx) = (xy + m * y, xx + m * m);
            }
        }
        xy / xx.sqrt()
    };
    let mut best = (PulseForm { f0_hz: 0.0, width_s: 0.05, written: Written::Own }, f64::NEG_INFINITY);
    for f in 0..200 {
        for w in 15..=(1e3 * WIDEST_S) as u32 {
            let form = PulseForm {
                f0_hz: 4.0 + 0.1 * f64::from(f),
                width_s: 1e-3 * f64::from(w),
                written: Written::Own,
            };
            let score = likeness(&form);
            if score > best.1 {
                best = (form, score);
            }
        }
    }
    best.0
}

/// A passage's course and what is heard of it, at times of its own.
fn passage(
    seed: u64,
    k: usize,
    of: usize,
    table: &Propagation,
    radiation: &Radiation,
) -> Result<(VesselCourse, Vec<SpectralFrame>)> {
    let straight = Straight {
        cpa_time_s: 0.5 * RECORD_S,
        cpa_range_m: 4_000.0 + 26_000.0 * k as f64 / of.max(2) as f64,
        heading_deg: 47.0 * k as f64,
        speed_m_s: 7.5,
        side: if k.is_multiple_of(2) { Side::Port } else { Side::Starboard },
    };
    let vessel =
        ObsVessel { name: format!("{k}"), straight, active_s: [-1e9, 1e9], radiation: radiation.clone() };
    let scenario =
        ObsScenario { vessels: vec![vessel], ..quiet(seed.wrapping_mul(101) + k as u64, RECORD_S) };
    let config = station::config(&scenario)?;
    let mut simulator = Simulator::new(scenario, table.clone(), Vec::new())?;
    let mut heard = frames(&mut simulator, &config)?;
    let late_s = 86_400.0 * k as f64;
    heard.iter_mut().for_each(|f| f.t_s += late_s);
    let later = Straight { cpa_time_s: straight.cpa_time_s + late_s, ..straight };
    Ok((VesselCourse::straight(&later), heard))
}

fn run(options: &Options) -> Result<()> {
    let table = station_table(options)?;
    let passages = options.runs.unwrap_or(PASSAGES);
    let mut fits = CsvText::new(
        "centre_hz,half_width_hz,f0_hz,f0_sd_hz,f0_expected_hz,width_s,width_sd_s,width_expected_s,cepstra",
    );
    let mut forms = CsvText::new("form,f0_hz,width_s,correlation");
    let (mut f0_off, mut width_off) = (0.0f64, 0.0f64);
    for spectrum in SPECTRA {
        let radiation = radiation(spectrum);
        let heard: Vec<(VesselCourse, Vec<SpectralFrame>)> = (0..passages)
            .into_par_iter()
            .map(|k| passage(options.seed, k, passages, &table, &radiation))
            .collect::<Result<_>>()?;
        let (mut courses, mut all) = (Vec::new(), Vec::new());
        for (course, frames) in heard {
            courses.push(course);
            all.extend(frames);
        }
        let pieces = Pieces::collect(&all, &courses, &table);
        let truth = expected(&table, &radiation, AT_M);
        let Some(fit) = pieces.fit() else {
            (f0_off, width_off) = (f64::INFINITY, f64::INFINITY);
            continue;
        };
        fits.row(&[
            &Fixed(spectrum.0, 1),
            &Fixed(spectrum.1, 1),
            &Fixed(fit.form.f0_hz, 2),
            &Fixed(fit.f0_sd_hz.unwrap_or(f64::NAN), 2),
            &Fixed(truth.f0_hz, 2),
            &Fixed(fit.form.width_s, 4),
            &Fixed(fit.width_sd_s.unwrap_or(f64::NAN), 4),
            &Fixed(truth.width_s, 4),
            &fit.pieces,
        ]);
        f0_off = f0_off.max((fit.form.f0_hz - truth.f0_hz).abs());
        width_off = width_off.max((fit.form.width_s / truth.width_s - 1.0).abs());
        if spectrum != SPECTRA[1] {
            continue;
        }
        let own = PulseForm { f0_hz: 16.5, width_s: 0.05, written: Written::Own };
        let written = [
            ("fitted here", fit.form),
            ("this project and the authors' programme", own),
            (
                "printed envelope at 15 Hz",
                PulseForm { f0_hz: 15.0, written: Written::PrintedEnvelope, ..own },
            ),
            ("as printed", PulseForm { f0_hz: 15.0, written: Written::AsPrinted, ..own }),
        ];
        for (name, form) in written {
            let correlation = pieces.correlation(&form, &fit.form);
            forms.row(&[
                &name,
                &Fixed(form.f0_hz, 2),
                &Fixed(form.width_s, 4),
                &Fixed(correlation.unwrap_or(f64::NAN), 3),
            ]);
            options
                .figures
                .state(format!("formula 17, {name}: correlation with the mean cepstrum"), correlation);
        }
    }
    print(options, "obs-pulse", fits)?;
    print(options, "obs-pulse-forms", forms)?;
    options.figures.at_most("fitted f0, worst error, Hz", f0_off, 0.5);
    options.figures.at_most("fitted width, worst error, %", 100.0 * width_off, 10.0);
    Ok(())
}
