//! Bearings and the track fitted to them.

use crate::plot::times::Times;
use crate::plot::{Plot, Scale, cut_at_wraps, write_panels};
use anyhow::Result;
use seabearing_core::angle::wrap_tau;
use seabearing_core::motion::{Medium, Solution, solution::position};
use seabearing_locate::motion::ml::Sample;
use std::path::Path;
use time::OffsetDateTime;

/// Bearings with the fit above, the track with its 95 % ellipses below. `start`: UTC of time 0, where it is known.
///
/// # Errors
/// The file cannot be written.
pub fn draw(
    samples: &[Sample],
    medium: &Medium,
    s: &Solution,
    start: Option<OffsetDateTime>,
    path: &Path,
) -> Result<()> {
    let axis = Times::new(start, s.t1_s - s.t0_s);
    let mut angles = Plot::new("Bearings and fitted track", "", "azimuth (°)");
    axis.along(&mut angles);
    let measured: Vec<_> = samples.iter().map(|b| (axis.at(b.t_s), b.azimuth_rad.to_degrees())).collect();
    let times: Vec<f64> = (0..=300).map(|k| s.t0_s + (s.t1_s - s.t0_s) * f64::from(k) / 300.0).collect();
    let fitted: Vec<_> =
        times.iter().map(|t| (axis.at(*t), wrap_tau(s.line.azimuth(medium, *t)).to_degrees())).collect();
    angles.y_scale(Scale::Degrees).points("measured", &measured).line("fit", &cut_at_wraps(&fitted));
    angles.caption("Points: azimuths as measured, degrees clockwise from true North. Line: azimuth of the fitted straight course.");
    if !s.range_observable {
        return angles.write(path);
    }
    let mut map = Plot::map("Track about the array");
    let at = |t: f64| position(&s.line, &s.covariance, t);
    let track: Vec<_> = times.iter().map(|t| at(*t).0).map(|[x, y]| (x, y)).collect();
    map.line("track", &track);
    for (i, t) in [s.t0_s, s.cpa_time_s, s.t1_s].into_iter().enumerate() {
        let ([x, y], [xx, yy, xy]) = at(t);
        map.ellipse(if i == 0 { "95 % of position" } else { "" }, (x, y), (xx, yy, xy), 0.95).same_colour();
    }
    // The way it goes: a head at the end.
    let ([x0, y0], [x1, y1]) = (at(s.t0_s).0, at(s.t1_s).0);
    let (length, heading) = (0.05 * (x1 - x0).hypot(y1 - y0), (x1 - x0).atan2(y1 - y0));
    let barb = |turn: f64| (x1 - length * (heading + turn).sin(), y1 - length * (heading + turn).cos());
    map.line("", &[barb(0.4), (x1, y1), barb(-0.4)]).same_colour();
    map.notes(vec![((x0, y0), axis.clock(s.t0_s)), ((x1, y1), axis.clock(s.t1_s))]);
    map.caption(
        "Straight course fitted to the bearings, with the times of the first and last; the arrow shows the way it goes. Ellipses hold the place with 95 % at the \
         first bearing, at the closest point and at the last. Black triangle: the array.",
    );
    write_panels(path, &[&angles, &map], 1)
}
