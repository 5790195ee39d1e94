//! Bearings and the track fitted to them.

use crate::plot::{Plot, Scale, cut_at_wraps, write_panels};
use anyhow::Result;
use seabearing_core::angle::wrap_tau;
use seabearing_core::motion::{Medium, Solution, solution::position};
use seabearing_locate::motion::ml::Sample;
use std::path::Path;

/// Bearings with the fit above, the track with its 95 % ellipses below.
///
/// # Errors
/// The file cannot be written.
pub fn draw(samples: &[Sample], medium: &Medium, s: &Solution, path: &Path) -> Result<()> {
    let mut angles = Plot::new("Bearings and fitted track", "time (s)", "azimuth (°)");
    let measured: Vec<_> = samples.iter().map(|b| (b.t_s, b.azimuth_rad.to_degrees())).collect();
    let times: Vec<f64> = (0..=300).map(|k| s.t0_s + (s.t1_s - s.t0_s) * f64::from(k) / 300.0).collect();
    let fitted: Vec<_> =
        times.iter().map(|t| (*t, wrap_tau(s.line.azimuth(medium, *t)).to_degrees())).collect();
    angles.y_scale(Scale::Degrees).points("measured", &measured).line("fit", &cut_at_wraps(&fitted));
    if !s.range_observable {
        return angles.write(path);
    }
    let mut map = Plot::map("Track about the array");
    let at = |t: f64| position(&s.line, &s.covariance, t);
    let track: Vec<_> = times.iter().map(|t| at(*t).0).map(|[x, y]| (x, y)).collect();
    map.line("track", &track);
    for (i, t) in [s.t0_s, s.cpa_time_s, s.t1_s].into_iter().enumerate() {
        let ([x, y], [xx, yy, xy]) = at(t);
        map.ellipse(if i == 0 { "95 % of position" } else { "" }, (x, y), (xx, yy, xy), 0.95);
        if i > 0 {
            map.same_colour();
        }
    }
    write_panels(path, &[&angles, &map], 1)
}
