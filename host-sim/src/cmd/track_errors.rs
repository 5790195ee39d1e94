//! `seabearing track --known-track`: the error model of bearings, from a vessel of known track.

use super::track::{Args, DENSE, POSITIONS};
use crate::csv::{Table, good_rows};
use crate::record::finite;
use anyhow::{Result, bail};
use seabearing_core::angle::wrap_pi;
use seabearing_locate::motion::covariance::Model;
use seabearing_locate::motion::errors;
use seabearing_locate::motion::ml::Sample;
use seabearing_locate::motion::whiten::{WhitenError, Workspace};
use serde_json::json;
use std::path::Path;

/// Estimates the error model from a known track.
///
/// # Errors
/// The track file cannot be used, or too few bearings lie within it.
pub(super) fn error_model(args: &Args, samples: &[Sample], track: &Path) -> Result<()> {
    let name = track.display().to_string();
    let mut known = good_rows(&name, Table::read(track)?.numbers(["t_s", "x_m", "y_m"])?)?;
    known.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let at = |t: f64| -> Option<(f64, f64)> {
        let k = known.partition_point(|r| r[0] < t);
        let (b, a) = (known.get(k)?, known.get(k.saturating_sub(1))?);
        let f = if b[0] > a[0] { (t - a[0]) / (b[0] - a[0]) } else { 0.0 };
        ((0.0..=1.0).contains(&f)).then(|| (a[1] + f * (b[1] - a[1]), a[2] + f * (b[2] - a[2])))
    };
    let differences: Vec<(f64, f64)> = samples
        .iter()
        .filter_map(|s| {
            // The bearing received now left the vessel a travel time ago.
            let (x, y) = at(s.t_s)?;
            let (x, y) = at(s.t_s - x.hypot(y) / args.sound_speed)?;
            Some((s.t_s, wrap_pi(s.azimuth_rad - x.atan2(y))))
        })
        .collect();
    let model = if args.model.is_none() { Model::Markov } else { args.model() };
    let mut work = Box::new(Workspace::<POSITIONS>::new());
    let mut dense = Vec::new();
    let mut found = errors::estimate(model, &differences, &mut work, &mut dense);
    if let Err(WhitenError::Memory(needed)) = found
        && needed <= DENSE
    {
        dense.resize(needed, 0.0);
        found = errors::estimate(model, &differences, &mut work, &mut dense);
    }
    let Ok(e) = found else {
        bail!(
            "{name}: {} bearings within the known track do not give an error model (8 are needed)",
            differences.len()
        );
    };
    let (sd, offset) = (e.sd_rad.to_degrees(), e.offset_rad.0.to_degrees());
    if args.json {
        println!(
            "{}",
            json!({
                "type": "error_model", "model": format!("{model:?}").to_lowercase(), "sigma_deg": sd,
                "sd_sigma_deg": sd * e.sd_relative, "tau_s": e.tau_s, "sd_tau_s": finite(e.tau_s * e.sd_ln_tau),
                "offset_deg": offset, "sd_offset_deg": e.offset_rad.1.to_degrees(),
                "log_likelihood": e.ln_likelihood, "n": differences.len(),
            })
        );
    } else {
        println!("error model          {model:?}, {} bearings", differences.len());
        println!("standard deviation   {sd:.3}° ± {:.3}°", sd * e.sd_relative);
        println!("correlation interval {:.2} s ± {:.2} s", e.tau_s, e.tau_s * e.sd_ln_tau);
        println!("offset               {offset:.3}° ± {:.3}°", e.offset_rad.1.to_degrees());
        println!("log likelihood       {:.2}", e.ln_likelihood);
    }
    Ok(())
}
