//! `seabearing propagation`: the interference table of an ocean-bottom station.

use super::mistake;
use crate::progress;
use crate::propagation::bottom::Bottom;
use crate::propagation::profile::SpeedProfile;
use crate::propagation::{Propagation, convert, file, strength, trace};
use anyhow::{Result, bail};
use std::path::PathBuf;

/// Arguments of `seabearing propagation`.
#[derive(clap::Args)]
#[command(
    args_conflicts_with_subcommands = true,
    after_help = "Examples:\n  seabearing propagation --ray-table rays.csv --depth-m 4340 --out rr03.toml\n  \
                  seabearing propagation --profile profile.csv --depth-m 4340 --out table.toml\n\
                  PROFILE.csv has the columns depth_m,speed_m_s; a ray table has distance_m and, for n = 1, 3, 5, ...\n\
                  crossings, toa_s_n, amp_re_n, amp_im_n (metres, seconds, convention exp(-i w t))."
)]
pub struct Args {
    #[command(subcommand)]
    fit: Option<Tool>,
    /// Ray-trace through this sound-speed profile (CSV: depth_m,speed_m_s).
    #[arg(long, conflicts_with = "ray_table", requires = "depth_m", value_parser = super::input())]
    profile: Option<PathBuf>,
    /// Convert this ready ray table (CSV).
    #[arg(long, value_parser = super::input())]
    ray_table: Option<PathBuf>,
    /// Depth of the flat floor, m (estimated from a ray table where not given).
    #[arg(long)]
    depth_m: Option<f64>,
    /// The table to write (TOML).
    #[arg(long, value_parser = super::output())]
    out: Option<PathBuf>,
    /// Name written into the table; the input's name where not given.
    #[arg(long)]
    name: Option<String>,
    /// The farthest range the table must cover, m.
    #[arg(long, default_value_t = 50_050.0)]
    range_m: f64,
    /// Rows traced, the first at range 0.
    #[arg(long, default_value_t = 1429)]
    rows: usize,
    /// Distance between traced rows, m.
    #[arg(long, default_value_t = 70.0)]
    step_m: f64,
    /// Speed of compressional waves in the floor, m/s.
    #[arg(long, default_value_t = Bottom::default().compressional_m_s)]
    compressional_m_s: f64,
    /// Speed of shear waves in the floor, m/s.
    #[arg(long, default_value_t = Bottom::default().shear_m_s)]
    shear_m_s: f64,
    /// Density of the floor, kg/m³.
    #[arg(long, default_value_t = Bottom::default().density_kg_m3)]
    density_kg_m3: f64,
    /// The ray table's amplitudes are for exp(+i w t): take their conjugates.
    #[arg(long, requires = "ray_table")]
    conjugate: bool,
    /// Centre frequency of vessels' wideband noise, Hz.
    #[arg(long, default_value_t = crate::propagation::F0_HZ)]
    f0_hz: f64,
    /// Print the summary as one JSON record.
    #[arg(long)]
    json: bool,
}

/// Tools beside making a table.
#[derive(clap::Subcommand)]
enum Tool {
    /// Measure the strengths of interferences from vessels of known track
    Fit(super::propagation_fit::Args),
}

/// Runs the command.
///
/// # Errors
/// One line: which file or option, and what is wrong with it.
pub fn run(args: Args) -> Result<()> {
    if let Some(Tool::Fit(fit)) = args.fit {
        return super::propagation_fit::run(fit);
    }
    let Some(out) = &args.out else { mistake!("--out TABLE is missing: where should the table be written?") };
    if !(0.0..=1e6).contains(&args.range_m) {
        mistake!("--range-m is {}; allowed 0 to 1000000", args.range_m);
    }
    let mut table = match (&args.profile, &args.ray_table) {
        (Some(profile), None) => traced(&args, profile)?,
        (None, Some(csv)) => convert::read(csv, args.depth_m, args.conjugate)?,
        _ => bail!("give --profile PROFILE.csv to ray-trace or --ray-table CSV to convert"),
    };
    if let Some(name) = &args.name {
        table.name.clone_from(name);
    }
    table.f0_hz = args.f0_hz;
    file::check(&table, &out.display().to_string())?;
    file::covers(&table, args.range_m, &out.display().to_string())?;
    file::write(&table, out)?;
    summary(&table, &args);
    Ok(())
}

fn traced(args: &Args, path: &std::path::Path) -> Result<Propagation> {
    let depth_m = args.depth_m.unwrap_or_default();
    let within = [
        ("--depth-m", depth_m, 50.0, 12_000.0),
        ("--step-m", args.step_m, 1.0, 2000.0),
        ("--rows", args.rows as f64, 3.0, 100_000.0),
        ("--compressional-m-s", args.compressional_m_s, 1000.0, 9000.0),
        ("--shear-m-s", args.shear_m_s, 0.0, 0.86 * args.compressional_m_s),
        ("--density-kg-m3", args.density_kg_m3, 1000.0, 5000.0),
    ];
    for (option, x, lo, hi) in within {
        if !(lo..=hi).contains(&x) {
            bail!("{option} is {x}; allowed {lo} to {hi}");
        }
    }
    let profile = SpeedProfile::read(path, depth_m)?;
    let bottom = Bottom {
        compressional_m_s: args.compressional_m_s,
        shear_m_s: args.shear_m_s,
        density_kg_m3: args.density_kg_m3,
    };
    let name = path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    let bar = progress::bar(args.rows as u64, "rays");
    let table = trace::trace(&name, &profile, &bottom, args.step_m, args.rows, || bar.inc(1));
    bar.finish_and_clear();
    Ok(table)
}

fn summary(table: &Propagation, args: &Args) {
    if !args.json {
        println!(
            "{}: depth {:.0} m, {} ranges to {:.2} km, {} paths, {} branches",
            table.name,
            table.depth_m,
            table.rows(),
            table.max_range_m() / 1e3,
            table.paths.len(),
            table.strengths.len()
        );
    }
    for p in &table.paths {
        let (first, last) = p.span().unwrap_or_default();
        let km = |j: usize| table.step_m * j as f64 / 1e3;
        let at = |j: usize| p.arrivals[j].map_or(f64::NAN, |a| a.toa_s);
        if args.json {
            println!(
                "{}",
                serde_json::json!({"type": "path", "crossings": p.crossings, "first_m": km(first) * 1e3,
                    "last_m": km(last) * 1e3, "toa_first_s": at(first), "toa_last_s": at(last)})
            );
        } else {
            println!(
                "  {:2} crossings: {:6.2} to {:6.2} km, {:7.3} to {:7.3} s",
                p.crossings,
                km(first),
                km(last),
                at(first),
                at(last)
            );
        }
    }
    if !args.json {
        let ratio = table.depth_m / strength::RR03_DEPTH_M;
        let floor = table.strengths.iter().zip(strength::of_depth(table.depth_m));
        let by_floor: Vec<String> =
            floor.map(|(s, usual)| format!("{:.2}", s.scale_m / usual.scale_m)).collect();
        let floor = if by_floor.iter().all(|x| x == "1.00") {
            String::new()
        } else {
            format!(
                ", and {} by branch for a floor that is not RR03's, which is modelled: until they are measured a track may be told at a wrong pair of paths, half as far",
                by_floor.join(", ")
            )
        };
        let pulse = if table.f0_hz == crate::propagation::F0_HZ {
            "RR03's".to_owned()
        } else {
            format!("about {} Hz as told, as wide as RR03's", table.f0_hz)
        };
        println!(
            "strengths: those of RR03 (paper O, Table II), ranges times {ratio:.3} for the depth{floor}; pulse: {pulse}; measure this \
             station's with `propagation fit`"
        );
    }
}
