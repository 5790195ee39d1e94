//! `seabearing levels`: levels that recorders sent of themselves, as percentiles over time and as a picture.

use super::mistake;
use crate::levels::told::{Percentiles, Told, sorted};
use crate::levels::told_picture::{draw, length};
use crate::record::utc;
use anyhow::{Context, Result, bail};
use serde_json::Value;
use std::io::BufRead;
use std::path::PathBuf;
use time::OffsetDateTime;

/// Arguments of `seabearing levels`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  seabearing levels records.jsonl --plot levels.svg\n  \
    seabearing levels records.jsonl --period 600 --json > percentiles.jsonl\n\n\
    A recorder sends its levels where its station file says so ([levels], docs/levels.md): records `spectrum` of `process` and `base`. \
    L5, L50 and L95 are the levels exceeded for 5, 50 and 95 % of its intervals (ISO 1996-1:2016). Finer and standard bands come of \
    the recording itself: `seabearing process --levels`.")]
pub struct Args {
    /// Records of `process` or `base`, or of a store by `export` (JSON Lines)
    #[arg(required = true, value_name = "RECORDS.jsonl", value_parser = super::input())]
    records: Vec<PathBuf>,
    /// Length of the periods of the percentiles, seconds (default: the shortest usual one of 20 intervals or more)
    #[arg(long, value_name = "SECONDS", value_parser = super::seconds)]
    period: Option<f64>,
    /// Draw spectra and percentiles against time into this SVG file
    #[arg(long, value_name = "FILE.svg")]
    plot: Option<PathBuf>,
    /// JSON Lines: a record for each period, and one for each band
    #[arg(long)]
    json: bool,
}

/// The longest period of percentiles, seconds.
const LONGEST_S: f64 = 366.0 * 86_400.0;

/// Runs the command.
///
/// # Errors
/// A file that cannot be read or written, or no levels in it.
pub fn run(args: Args) -> Result<()> {
    let mut records: Vec<Value> = Vec::new();
    for path in &args.records {
        let name = path.display();
        let file = std::fs::File::open(path).with_context(|| format!("cannot read {name}"))?;
        for (line, n) in std::io::BufReader::new(file).lines().zip(1..) {
            let line = line.with_context(|| format!("cannot read {name}"))?;
            match serde_json::from_str(&line) {
                // Only these are looked at, and a file may hold a year's bearings.
                Ok(record @ Value::Object(_)) => {
                    if record["type"] == "spectrum" || record["type"] == "hello" {
                        records.push(record);
                    }
                }
                _ if line.trim().is_empty() => {}
                _ => bail!("{name}, line {n}: no record; JSON Lines of `process` or `base` were expected"),
            }
        }
    }
    let (told, left_out) = sorted(records.iter());
    if left_out > 0 {
        log::warn!("{left_out} levels without UTC are left out beside those that have it");
    }
    if told.is_empty() {
        bail!(
            "no levels of a recorder among the records: it sends them where its station file has `[levels]` with `every_s`; \
             `seabearing process --levels` measures a recording's"
        );
    }
    let too_short = |one: &&Told| args.period.is_some_and(|period| period < one.every_s());
    if let Some(one) = told.iter().find(too_short) {
        mistake!("--period must be at least the recorder's interval, {:.0} s", one.every_s());
    }
    if args.period.is_some_and(|period| period > LONGEST_S) {
        mistake!("--period must be at most {LONGEST_S} s, a year");
    }
    let period_s = |one: &Told| args.period.unwrap_or_else(|| one.period_s());
    if let Some(path) = &args.plot {
        draw(path, &told, period_s)?;
    }
    if args.json {
        let lines: Vec<Value> = told.iter().flat_map(|one| one.records(period_s(one))).collect();
        return super::print_records(&lines, true);
    }
    for one in &told {
        print!("{}", table(one, period_s(one)));
    }
    Ok(())
}

/// The percentiles of a channel for people.
fn table(told: &Told, period_s: f64) -> String {
    let station = told.station.map_or(String::new(), |s| format!("station {s}, "));
    let (from, to) = told.span_s();
    let mut out = format!(
        "{station}channel {}: {} levels of {:.0} s each, {} to {}, dB re {}\n\
         L5, L50, L95: exceeded for 5, 50, 95 % of them (ISO 1996-1:2016); mean: of the power\n\n",
        told.channel,
        told.rows.len(),
        told.every_s(),
        when(told, from),
        when(told, to),
        told.reference,
    );
    out += &heading(&format!("all bands, {}", length(period_s)));
    for (begins, p) in told.over_time(period_s) {
        out += &row(&when(told, begins), &p);
    }
    if let Some(p) = told.broad() {
        out += &row("the whole time", &p);
    }
    out += "\n";
    out += &heading("band, Hz");
    for (edges, p) in told.edges_hz.windows(2).zip(told.by_band(|row| &row.band_db)) {
        let name = format!("{} to {}", edges[0], edges[1]);
        out += &p.map_or_else(|| format!("{name:<24}      0\n"), |p| row(&name, &p));
    }
    out + "\n"
}

fn heading(first: &str) -> String {
    format!("{first:<24} {:>6} {:>7} {:>7} {:>7} {:>7}\n", "n", "L5", "L50", "L95", "mean")
}

fn row(name: &str, p: &Percentiles) -> String {
    let [loud, median, quiet] = p.exceeded_db;
    format!("{name:<24} {:>6} {loud:>7.1} {median:>7.1} {quiet:>7.1} {:>7.1}\n", p.n, p.mean_db)
}

/// A time of a channel's levels: UTC, or seconds after sample 0.
fn when(told: &Told, at_s: f64) -> String {
    let at = OffsetDateTime::from_unix_timestamp(at_s.round() as i64).ok().filter(|_| told.is_utc);
    at.map_or_else(|| format!("{at_s:.0} s"), utc)
}
