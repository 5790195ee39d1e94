//! `seabearing propagation fit`: strengths of interferences and the form of their pulse, from vessels of known track.

use crate::course::{VesselCourse, of_file};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::echoes_along::Along;
use crate::ocean_bottom::pulse::{Pieces, PulseFit};
use crate::ocean_bottom::stages::frames;
use crate::ocean_bottom::strengths::{Branch, Cell, Envelopes, fit};
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
    let envelopes = Envelopes::of(&frames);
    let fitted = fit(&envelopes, &courses, &table);
    if fitted.iter().all(|b| b.law.is_none()) {
        bail!(
            "{} frames and {} tracks gave no strength of any branch: do recording and tracks cover the same time?",
            frames.len(),
            courses.len()
        );
    }
    look_along(&args, &envelopes, &courses, &table)?;
    for (name, law) in NAMES.iter().zip(&fitted).filter_map(|(name, b)| Some((name, b.law?))) {
        if !law.is_one() {
            bail!(
                "branch {name}: the law that fits best is {:.1e} high, and a pulse in the cepstrum at most 1: what was measured is no \
                 strength along these tracks. Nothing was written",
                law.peak()
            );
        }
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

/// Refuses tracks along which the recording holds no echoes, and says where it holds more.
fn look_along(
    args: &Args,
    envelopes: &Envelopes,
    courses: &[VesselCourse],
    table: &Propagation,
) -> Result<()> {
    let Some(along) = Along::of(envelopes, courses, table) else { return Ok(()) };
    let elsewhere = along.elsewhere.map(|e| match (e.later_s, e.scale) {
        (0.0, scale) => format!("{scale:.2} times as far from the station"),
        (s, _) => format!("{:.0} s {}", s.abs(), if s < 0.0 { "earlier" } else { "later" }),
    });
    let tracks = args.tracks.display();
    match (along.echoes(), elsewhere) {
        (true, None) => Ok(()),
        (true, Some(there)) => bail!(
            "{tracks}: the recording holds clearly more echoes along the same tracks {there}: are times and places right, and is the \
             table that of this water? Nothing was written"
        ),
        (false, Some(there)) => bail!(
            "{tracks}: the recording holds no echoes along these tracks, but along the same tracks {there}: are times and places \
             right? Nothing was written"
        ),
        (false, None) => bail!(
            "{tracks}: the recording holds no more echoes along these tracks than along the same ones ten minutes and more earlier or \
             later: are they the vessels', and is the table that of this water? Nothing was written"
        ),
    }
}

fn report_pulse(args: &Args, table: &Propagation, pulse: Option<&PulseFit>) {
    let f0_sd = pulse.filter(|p| !p.f0_at_limit()).and_then(|p| p.f0_sd_hz);
    let width_sd = pulse.filter(|p| !p.width_at_limit()).and_then(|p| p.width_sd_s);
    let at_limit = [
        ("centre frequency", PulseFit::f0_at_limit as fn(&PulseFit) -> bool),
        ("width", PulseFit::width_at_limit),
    ];
    for (name, _) in at_limit.iter().filter(|(_, at)| pulse.is_some_and(at)) {
        log::warn!(
            "the pulse's {name} is at the limit of the search: it is not determined, and its deviation is not known"
        );
    }
    if pulse.is_some_and(|p| p.f0_sd_hz.is_none()) {
        log::warn!(
            "too little of the recording shows the pulse: how far parts of it differ, and so its deviation, is not known"
        );
    }
    if args.json {
        println!(
            "{}",
            serde_json::json!({"type": "pulse", "cepstra": pulse.map(|p| p.pieces),
                "f0_hz": pulse.map(|p| p.form.f0_hz), "f0_sd_hz": f0_sd,
                "width_s": pulse.map(|p| p.form.width_s), "width_sd_s": width_sd})
        );
    } else if let Some(p) = pulse {
        let or_none = |sd: Option<f64>, digits| sd.map_or(String::new(), |sd| format!(" ± {sd:.digits$}"));
        println!(
            "pulse: f0 {:.2}{} Hz (was {:.2}), width {:.4}{} s (was {:.4}); {} cepstra",
            p.form.f0_hz,
            or_none(f0_sd, 2),
            table.f0_hz,
            p.form.width_s,
            or_none(width_sd, 4),
            table.width_s,
            p.pieces
        );
    } else {
        println!("pulse: not measured, kept as it was");
    }
}

const NAMES: [&str; 6] = ["13", "35", "57", "79", "9-11", "11-13"];

fn report(args: &Args, fitted: &[Branch]) {
    for (name, b) in NAMES.iter().zip(fitted) {
        for parameter in b.at_limit() {
            log::warn!(
                "branch {name}: the {parameter} of its law is at the limit of the search and is not determined"
            );
        }
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
