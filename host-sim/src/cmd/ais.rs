//! `seabearing ais`: statistics of vessel traffic from AIS files.

use super::mistake;
use crate::ais::{Pass, Selection, passes, read};
use crate::csv::{CsvText, Fixed};
use crate::plot::{ColourMap, HeatMap, Plot, write_panels};
use anyhow::{Result, bail};
use seabearing_core::kit::quantile;
use serde_json::json;
use std::path::PathBuf;

/// Arguments of `seabearing ais`.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    /// Speeds of passing vessels: mean, spread, and histograms of speed and heading against CPA distance
    Speeds(Speeds),
    /// Which vessel each track is, if any, and the errors of the tracks against AIS
    #[cfg(feature = "base")]
    Match(super::ais_match::Args),
}

/// Arguments of `seabearing ais speeds`.
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  seabearing ais speeds traffic.csv --lat-deg 50.75 --lon-deg -1.25 --out out/ais\n\n\
    Writes passes.csv, speed_cpa.csv, heading_cpa.csv and fleet.svg. The mean and spread printed are what\n\
    `seabearing track --speed MEAN --speed-sd SPREAD` and the station file's [tracking] want."
)]
struct Speeds {
    /// AIS files (MarineTraffic, CLS or plain layout), packed with xz or not.
    #[arg(required = true, value_parser = super::input())]
    files: Vec<PathBuf>,
    /// Latitude of the station, degrees.
    #[arg(long, allow_negative_numbers = true)]
    lat_deg: f64,
    /// Longitude of the station, degrees.
    #[arg(long, allow_negative_numbers = true)]
    lon_deg: f64,
    /// Farthest closest point that counts, metres.
    #[arg(long, default_value_t = 3000.0)]
    max_range_m: f64,
    /// Least speed that counts, m/s.
    #[arg(long, default_value_t = 1.0)]
    min_speed: f64,
    /// Longest gap between reports bridged by a straight leg, seconds.
    #[arg(long, default_value_t = 900.0)]
    max_gap_s: f64,
    /// Folder for tables and plot (default: none written).
    #[arg(long)]
    out: Option<PathBuf>,
    /// Result as a JSON line.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(args: Args) -> Result<()> {
    match args.what {
        What::Speeds(args) => speeds(&args),
        #[cfg(feature = "base")]
        What::Match(args) => super::ais_match::run(&args),
    }
}

/// `seabearing ais speeds`.
fn speeds(args: &Speeds) -> Result<()> {
    if !(-90.0..=90.0).contains(&args.lat_deg) || !(-180.0..=360.0).contains(&args.lon_deg) {
        mistake!("--lat-deg {} --lon-deg {}: no place on Earth", args.lat_deg, args.lon_deg);
    }
    if !(args.max_range_m > 0.0 && args.max_range_m.is_finite()) {
        mistake!("--max-range-m is {}, it must be above 0", args.max_range_m);
    }
    if !(args.min_speed >= 0.0 && args.min_speed.is_finite()) {
        mistake!("--min-speed is {}, it must be a number that is not negative", args.min_speed);
    }
    if !(args.max_gap_s > 0.0 && args.max_gap_s.is_finite()) {
        mistake!("--max-gap-s is {}, it must be a number above 0", args.max_gap_s);
    }
    let mut reports = Vec::new();
    for file in &args.files {
        let (good, bad) = read(file)?;
        for line in bad.iter().take(5) {
            log::warn!("skipped {line}");
        }
        if bad.len() > 5 {
            log::warn!("skipped {} more bad rows of {}", bad.len() - 5, file.display());
        }
        reports.extend(good);
    }
    let selection = Selection {
        lat_lon_deg: (args.lat_deg, args.lon_deg),
        max_range_m: args.max_range_m,
        min_speed_m_s: args.min_speed,
        max_gap_s: args.max_gap_s,
    };
    let found = passes(&reports, &selection);
    if found.len() < 2 {
        bail!(
            "{} pass(es) within {} m in {} reports; a wider --max-range-m or --max-gap-s may find more",
            found.len(),
            args.max_range_m,
            reports.len()
        );
    }
    let n = found.len() as f64;
    let mean = found.iter().map(|p| p.speed_m_s).sum::<f64>() / n;
    let sd = (found.iter().map(|p| (p.speed_m_s - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
    // Where the mean is assumed, a range is wrong by the factor v̄/v: its mean less one [M 18] and the root of its mean square
    // about one [M 22]. (The 0.315 printed with equation 22 is the spread of the speeds over their mean.)
    let ratio = |p: &Pass| mean / p.speed_m_s - 1.0;
    let bias = found.iter().map(ratio).sum::<f64>() / n;
    let rms = (found.iter().map(|p| ratio(p).powi(2)).sum::<f64>() / n).sqrt();
    let mut speeds: Vec<f64> = found.iter().map(|p| p.speed_m_s).collect();
    let mut quantile = |f: f64| quantile(&mut speeds, f).unwrap_or(f64::NAN);
    let mut vessels: Vec<u64> = found.iter().map(|p| p.mmsi).collect();
    vessels.dedup();
    if args.json {
        println!(
            "{}",
            json!({
                "type": "fleet", "passes": found.len(), "vessels": vessels.len(), "mean_speed_m_s": mean,
                "sd_speed_m_s": sd, "median_speed_m_s": quantile(0.5), "speed_05_m_s": quantile(0.05),
                "speed_95_m_s": quantile(0.95), "max_range_m": args.max_range_m, "range_bias": bias, "range_rms": rms,
            })
        );
    } else {
        println!(
            "passes           {} of {} vessels within {} m",
            found.len(),
            vessels.len(),
            args.max_range_m
        );
        println!("speed            {mean:.2} ± {sd:.2} m/s (mean, standard deviation)");
        println!("median, 5..95 %  {:.2}, {:.2} to {:.2} m/s", quantile(0.5), quantile(0.05), quantile(0.95));
        println!(
            "range, if the mean is assumed: {:+.1} % on average, {:.1} % root mean square",
            100.0 * bias,
            100.0 * rms
        );
    }
    match &args.out {
        Some(out) => write(&found, args.max_range_m, out),
        None => Ok(()),
    }
}

/// Distance bins, speed bins (1 m/s) and heading bins (30°).
const DISTANCES: usize = 12;
const HEADINGS: usize = 12;

fn write(found: &[Pass], max_range_m: f64, out: &std::path::Path) -> Result<()> {
    let mut text = CsvText::new("mmsi,unix_s,cpa_m,speed_m_s,heading_deg");
    for p in found {
        let (t, cpa, speed) = (Fixed(p.t_s, 1), Fixed(p.cpa_m, 1), Fixed(p.speed_m_s, 3));
        text.row(&[&p.mmsi, &t, &cpa, &speed, &Fixed(p.heading_deg, 1)]);
    }
    crate::atomic::write(&out.join("passes.csv"), text.finish().as_bytes())?;
    let fastest = found.iter().map(|p| p.speed_m_s).fold(1.0, f64::max).ceil();
    let mut figures = Vec::new();
    for (file, column, label, top, rows, value) in [
        (
            "speed_cpa.csv",
            "speed_m_s",
            "speed (m/s)",
            fastest,
            fastest as usize,
            (|p| p.speed_m_s) as fn(&Pass) -> f64,
        ),
        ("heading_cpa.csv", "heading_deg", "heading (°)", 360.0, HEADINGS, |p| p.heading_deg),
    ] {
        let mut counts = vec![0.0f64; DISTANCES * rows];
        for p in found {
            let bin = |x: f64, end: f64, bins: usize| ((x / end * bins as f64) as usize).min(bins - 1);
            counts[bin(value(p), top, rows) * DISTANCES + bin(p.cpa_m, max_range_m, DISTANCES)] += 1.0;
        }
        let mut text = CsvText::new(&format!("cpa_from_m,cpa_to_m,{column}_from,{column}_to,passes"));
        for (i, count) in counts.iter().enumerate() {
            let (d, r) = ((i % DISTANCES) as f64, (i / DISTANCES) as f64);
            let (w, h) = (max_range_m / DISTANCES as f64, top / rows as f64);
            text.row(&[&(d * w), &((d + 1.0) * w), &(r * h), &((r + 1.0) * h), count]);
        }
        crate::atomic::write(&out.join(file), text.finish().as_bytes())?;
        let mut figure = Plot::new(&format!("{} passes", found.len()), "CPA distance (m)", label);
        figure.heat(HeatMap {
            x: (0.0, max_range_m),
            y: (0.0, top),
            columns: DISTANCES,
            values: counts.into_iter().map(|c| if c > 0.0 { c } else { f64::NAN }).collect(),
            strength: Vec::new(),
            range: None,
            map: ColourMap::Amount,
            label: "passes".into(),
        });
        figure.caption(&format!(
            "Passages of vessels in the AIS files within {max_range_m} m of the station, counted by the distance of their closest point of approach (CPA)."
        ));
        figures.push(figure);
    }
    write_panels(&out.join("fleet.svg"), &figures.iter().collect::<Vec<_>>(), 1)
}
