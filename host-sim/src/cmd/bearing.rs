//! `seabearing bearing`: bearings from measured arrival-time differences.

use super::mistake;
use crate::delays::{SetResult, Solved, check_above, solve};
use crate::station::Station;
use anyhow::{Context, Result, bail};
use seabearing_core::geometry::PAIRS;
use seabearing_locate::delays::tdoa::DelaySolution;
use serde_json::{Value, json};
use std::io::Write;
use std::path::PathBuf;

/// Arguments of `seabearing bearing`.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  \
    seabearing bearing --station east.toml tdoa.csv --json\n\n\
    TDOA.csv has the header t_s,tdoa01_s,tdoa02_s,tdoa03_s,tdoa12_s,tdoa13_s,tdoa23_s; tdoaIJ is the arrival time at \
    hydrophone J minus that at hydrophone I, in seconds. `accepted` is the outlier test: residual, length of the \
    solved direction, and continuity with the bearings before; one or two wrong pairs are left out (`dropped`). \
    A hydrophone that is late in all sets is named where their directions tell it, and the errors stated hold what it does. \
    A pair that is wrong all through a file, around which delays do not close, is named. \
    Where most sets contradict the array and nothing tells why, or hardly any is accepted, the accepted ones are marked `suspect`. \
    A file of which more than a quarter of the bearings point below the horizon is refused: signs or pairs are mirrored; single sets that do are not \
    accepted where the station lies 25 m deep or more. Nor are sets that point the way of those about them at another elevation, as echoes do.")]
pub struct Args {
    /// Arrival-time differences: t_s,tdoa01_s,...,tdoa23_s.
    #[arg(value_parser = super::input())]
    tdoa: PathBuf,
    /// Station file (kind = "array").
    #[arg(long, value_parser = super::input())]
    station: PathBuf,
    /// Greatest root-mean-square residual of an accepted set, microseconds; default 2.25 % of the time sound takes
    /// across the array.
    #[arg(long)]
    tolerance_us: Option<f64>,
    /// Print accepted sets only.
    #[arg(long)]
    accepted_only: bool,
    /// Results as JSON Lines.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(args: Args) -> Result<()> {
    if let Some(t) = args.tolerance_us
        && (t <= 0.0 || !t.is_finite())
    {
        mistake!("--tolerance-us is {t}; a number above zero was expected");
    }
    let station = Station::read(&args.station)?;
    let solved = solve(&station.config, &args.tdoa, args.tolerance_us.map(|t| t * 1e-6))?;
    let suspect = solved.suspect();
    let Solved { sets: results, lateness, unclosed, .. } = solved;
    // What is mirrored contradicts nothing else.
    check_above(&results).with_context(|| args.tdoa.display().to_string())?;
    if let Some(said) = lateness.and_then(|l| l.said()) {
        log::warn!("{}: {said}", args.tdoa.display());
    }
    if let Some(unclosed) = unclosed {
        log::warn!("{}: {}", args.tdoa.display(), unclosed.said());
    }
    if let Some(said) = &suspect {
        log::warn!("{}: {said}", args.tdoa.display());
    }
    let mut out = std::io::stdout().lock();
    if !args.json {
        writeln!(
            out,
            "{:>12} {:>9} {:>9} {:>7} {:>7} {:>8} accepted dropped",
            "t_s", "azimuth", "elevation", "sd_az", "sd_el", "quality"
        )?;
    }
    let mut accepted = 0usize;
    for r in &results {
        let ok = r.accepted();
        accepted += usize::from(ok);
        if args.accepted_only && !ok {
            continue;
        }
        if args.json {
            let mut record = record(r);
            if ok && suspect.is_some() {
                record["suspect"] = true.into();
            }
            writeln!(out, "{record}")?;
        } else {
            writeln!(out, "{}{}", line(r), if ok && suspect.is_some() { " suspect" } else { "" })?;
        }
    }
    if !args.json {
        eprintln!("{accepted} of {} sets accepted", results.len());
    }
    let count = |of: fn(&SetResult) -> bool| results.iter().filter(|r| of(r)).count();
    for (n, what) in [
        (count(|r| r.below), "point below the horizon, where no vessel of this station is"),
        (count(|r| r.echo), "point the way of those about them at another elevation, as an echo does"),
    ] {
        if n > 0 {
            log::warn!("{}: {n} of {} sets {what}, and are not accepted", args.tdoa.display(), results.len());
        }
    }
    if accepted == 0 {
        bail!(
            "{}: none of {} sets gives a consistent bearing; check signs, pair order and the hydrophone positions",
            args.tdoa.display(),
            results.len()
        );
    }
    Ok(())
}

/// Names of the pairs left out.
fn dropped(s: &DelaySolution) -> Vec<String> {
    PAIRS
        .iter()
        .enumerate()
        .filter(|(p, _)| s.dropped >> p & 1 == 1)
        .map(|(_, (i, j))| format!("{i}{j}"))
        .collect()
}

/// Of a direction in which no vessel is, none.
fn quality(r: &SetResult, s: &DelaySolution) -> f64 {
    if r.below || r.echo { 0.0 } else { f64::from(s.quality) }
}

fn degrees(x: f32) -> f64 {
    f64::from(x).to_degrees()
}

/// The record of one set, as `process` gives bearings; `null` directions where there is none.
pub fn record(r: &SetResult) -> Value {
    match &r.solution {
        Some(s) => json!({
            "type": "bearing", "t_s": r.t_s,
            "azimuth_deg": degrees(s.azimuth), "elevation_deg": degrees(s.elevation),
            "sd_azimuth_deg": degrees(s.var_azimuth.sqrt()), "sd_elevation_deg": degrees(s.var_elevation.sqrt()),
            "cov_deg2": f64::from(s.cov) * 1f64.to_degrees().powi(2), "snr_db": null,
            "quality": quality(r, s), "accepted": r.accepted(), "closure_s": f64::from(s.closure_s),
            "residual_s": f64::from(s.residual_s), "dropped": dropped(s),
        }),
        None => json!({
            "type": "bearing", "t_s": r.t_s, "azimuth_deg": null, "elevation_deg": null,
            "quality": 0.0, "accepted": false,
        }),
    }
}

fn line(r: &SetResult) -> String {
    match &r.solution {
        Some(s) => format!(
            "{:12.3} {:9.3} {:9.3} {:7.3} {:7.3} {:8.3} {:>8} {}",
            r.t_s,
            degrees(s.azimuth),
            degrees(s.elevation),
            degrees(s.var_azimuth.sqrt()),
            degrees(s.var_elevation.sqrt()),
            quality(r, s),
            if r.accepted() { "yes" } else { "no" },
            dropped(s).join("+")
        ),
        None => format!("{:12.3} {:>9} {:>9} {:>7} {:>7} {:>8} {:>8}", r.t_s, "-", "-", "-", "-", "0", "no"),
    }
}
