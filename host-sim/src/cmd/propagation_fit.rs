//! `seabearing propagation fit`: strengths of interferences and the form of their pulse, from vessels of known track.

use crate::course::of_file;
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::pulse::{Pieces, PulseFit};
use crate::ocean_bottom::stages::frames;
use crate::ocean_bottom::strengths::{Branch, Cell, fit};
use crate::plot::{Plot, write_panels};
use crate::propagation::{Propagation, file};
use crate::station::Station;
use crate::{atomic, recording};
use anyhow::{Result, bail};
use std::path::{Path, PathBuf};

/// Arguments of `seabearing propagation fit`.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  seabearing propagation fit --station station.toml --tracks truth.csv --out fitted.toml *.mseed\n\
                        TRACKS.csv has the columns t_s,x_m,y_m (East and North of the station) and, for several\n\
                        vessels, source. Beside TABLE, TABLE.csv and TABLE.svg show measured and fitted strengths."
)]
pub struct Args {
    /// Station file; its propagation table gives the delays.
    #[arg(long, value_parser = super::input())]
    station: PathBuf,
    /// Where the vessels were (CSV).
    #[arg(long, value_parser = super::input())]
    tracks: PathBuf,
    /// The table to write: the station's with the fitted pulse and strengths.
    #[arg(long, value_parser = super::output())]
    out: PathBuf,
    /// Recordings (miniSEED or WAV) or folders of them.
    #[arg(required = true, value_parser = super::input())]
    input: Vec<PathBuf>,
    /// Keep the table's centre frequency and pulse width; fit strengths alone.
    #[arg(long)]
    keep_pulse: bool,
    /// Print one JSON record for the pulse and one a branch.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// One line: what is missing, or that nothing could be fitted.
pub fn run(args: Args) -> Result<()> {
    let station = Station::read(&args.station)?;
    let Some(path) = &station.propagation else {
        bail!("{}: no `propagation` in [obs]: the fit needs a table for the delays", args.station.display());
    };
    let mut table = file::read(path)?;
    let courses = of_file(&args.tracks)?;
    let mut source = recording::open(&args.input, &station, None)?;
    let frames = frames(source.as_mut(), &station.config)?;
    let fitted = fit(&frames, &courses, &table);
    if fitted.iter().all(|b| b.law.is_none()) {
        bail!(
            "{} frames and {} tracks gave no strength of any branch: do recording and tracks cover the same time?",
            frames.len(),
            courses.len()
        );
    }
    if !args.keep_pulse {
        let pulse = Pieces::collect(&frames, &courses, &table).fit();
        report_pulse(&args, &table, pulse.as_ref());
        if let Some(PulseFit { form, .. }) = pulse {
            (table.f0_hz, table.width_s) = (form.f0_hz, form.width_s);
        }
    }
    report(&args, &fitted);
    let csv = csv(&fitted);
    for (slot, branch) in table.strengths.iter_mut().zip(&fitted) {
        if let Some(law) = branch.law {
            *slot = law;
        }
    }
    file::write(&table, &args.out)?;
    atomic::write(&args.out.with_extension("csv"), csv.as_bytes())?;
    draw(&args.out.with_extension("svg"), &fitted, &table)
}

fn report_pulse(args: &Args, table: &Propagation, pulse: Option<&PulseFit>) {
    if args.json {
        println!(
            "{}",
            serde_json::json!({"type": "pulse", "cepstra": pulse.map(|p| p.pieces),
                "f0_hz": pulse.map(|p| p.form.f0_hz), "f0_sd_hz": pulse.map(|p| p.f0_sd_hz),
                "width_s": pulse.map(|p| p.form.width_s), "width_sd_s": pulse.map(|p| p.width_sd_s)})
        );
    } else if let Some(p) = pulse {
        println!(
            "pulse: f0 {:.2} ± {:.2} Hz (was {:.2}), width {:.4} ± {:.4} s (was {:.4}); {} cepstra",
            p.form.f0_hz, p.f0_sd_hz, table.f0_hz, p.form.width_s, p.width_sd_s, table.width_s, p.pieces
        );
    } else {
        println!("pulse: not measured, kept as it was");
    }
}

const NAMES: [&str; 6] = ["13", "35", "57", "79", "9-11", "11-13"];

fn report(args: &Args, fitted: &[Branch]) {
    for (name, b) in NAMES.iter().zip(fitted) {
        let residual = b.law.map(|l| {
            let sum: f64 = b.cells.iter().map(|c| (c.envelope - l.at(c.range_m)).powi(2)).sum();
            (sum / b.cells.len().max(1) as f64).sqrt()
        });
        if args.json {
            println!(
                "{}",
                serde_json::json!({"type": "strength", "branch": name, "cells": b.cells.len(),
                    "k_m": b.law.map(|l| l.k_m), "shape": b.law.map(|l| l.shape),
                    "location_m": b.law.map(|l| l.location_m), "scale_m": b.law.map(|l| l.scale_m),
                    "rms_residual": residual})
            );
        } else if let (Some(l), Some(r)) = (b.law, residual) {
            println!(
                "branch {name}: k {:.0} m, shape {:.1}, location {:.1} km, scale {:.1} km; {} cells, rms residual {r:.4}",
                l.k_m,
                l.shape,
                l.location_m / 1e3,
                l.scale_m / 1e3,
                b.cells.len()
            );
        } else {
            println!("branch {name}: not measured ({} cells with data), kept as it was", b.cells.len());
        }
    }
}

fn csv(fitted: &[Branch]) -> String {
    let mut out = CsvText::new("branch,range_m,frames,strength,sd,fitted,residual");
    for (name, b) in NAMES.iter().zip(fitted) {
        for c in &b.cells {
            let law = b.law.map_or(f64::NAN, |l| l.at(c.range_m));
            out.row(&[
                name,
                &Fixed(c.range_m, 0),
                &c.frames,
                &Fixed(c.envelope, 5),
                &Fixed(c.sd, 5),
                &Fixed(law, 5),
                &Fixed(c.envelope - law, 5),
            ]);
        }
    }
    out.finish()
}

fn draw(path: &Path, fitted: &[Branch], table: &Propagation) -> Result<()> {
    let mut top = Plot::new("Strength of interferences", "range (km)", "envelope of the cepstrum");
    let mut bottom = Plot::new("Residuals", "range (km)", "measured − fitted");
    for ((name, b), law) in NAMES.iter().zip(fitted).zip(&table.strengths) {
        if b.law.is_none() {
            continue;
        }
        let points = |f: &dyn Fn(&Cell) -> f64| -> Vec<(f64, f64)> {
            b.cells.iter().map(|c| (c.range_m / 1e3, f(c))).collect()
        };
        top.points(&format!("{name} measured"), &points(&|c| c.envelope));
        let curve: Vec<(f64, f64)> =
            (0..=200).map(|i| 0.25 * f64::from(i)).map(|km| (km, law.at(1e3 * km))).collect();
        top.line(&format!("{name} fitted"), &curve).same_colour();
        bottom.line(name, &points(&|c| c.envelope - law.at(c.range_m)));
    }
    top.caption(
        "Points: envelope of the cepstrum at the delays of each pair of paths, means over cells of range. Lines: the law fitted to them.",
    );
    bottom.caption("What the laws leave of the measured envelopes.");
    write_panels(path, &[&top, &bottom], 1)
}
