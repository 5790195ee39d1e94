//! What is to be expected, drawn: a network's map of accuracies, and an array's passages against their range.

use super::network::{Bearings, Passage, at, centre, passage};
use super::passage::StraightPass;
use crate::orientation::network_file::Network;
use crate::plot::contour::contour;
use crate::plot::{ColourMap, HeatMap, Plot, RGBColor, write_panels};
use anyhow::Result;
use rayon::prelude::*;
use std::path::Path;

/// Cells of a map, each way.
const CELLS: usize = 61;
/// Arrays on the colours, and lines of equal value.
const ARRAYS: RGBColor = RGBColor(213, 94, 0);
const LINES: RGBColor = RGBColor(255, 255, 255);
/// Least distance of the words beside them, share of the width.
const WORDS_APART: f64 = 0.06;
/// Standard deviations at the ends of the colours, and of the lines of equal value, metres and degrees.
const ENDS_M: (f64, f64) = (1.0, 1000.0);
const LINES_M: [f64; 6] = [5.0, 10.0, 20.0, 50.0, 100.0, 200.0];
const ENDS_DEG: (f64, f64) = (0.1, 30.0);
const LINES_DEG: [f64; 6] = [0.2, 0.5, 1.0, 2.0, 5.0, 10.0];

/// The six panels of a network's map, to ± `half_m` about its centre: position with the depth known, by azimuths alone, and
/// without the depth; range, azimuth, and the heading of a passage. What `locate` would refuse to tell is blank.
///
/// # Errors
/// The file cannot be written.
pub fn map(network: &Network, of: &Bearings, pass: &Passage, half_m: f64, path: &Path) -> Result<()> {
    let [x0, y0] = centre(network);
    let place = |n: usize| {
        let middle = |k: usize| half_m * ((2 * k + 1) as f64 / CELLS as f64 - 1.0);
        [x0 + middle(n % CELLS), y0 + middle(n / CELLS)]
    };
    let told = |n: usize| {
        let here = at(network, of, pass.speed_m_s, place(n));
        let way = passage(network, of, pass, true, place(n));
        [
            here.position_m,
            here.azimuths_m,
            here.free_m,
            here.polar.map(|p| p.1),
            here.polar.map(|p| p.0.to_degrees()),
            way.map(|w| w.heading.to_degrees()),
        ]
        .map(|x| x.unwrap_or(f64::NAN))
    };
    let all: Vec<[f64; 6]> = (0..CELLS * CELLS).into_par_iter().map(told).collect();
    let titles = [
        "Position, depth known",
        "Position, depth known, azimuths alone",
        "Position, depth unknown",
        "Range from the centre, depth known",
        "Azimuth from the centre, depth known",
        "Heading of a straight passage",
    ];
    let panels: Vec<Plot> = titles
        .iter()
        .enumerate()
        .map(|(k, title)| {
            let metres = k < 4;
            let heat = HeatMap {
                x: (x0 - half_m, x0 + half_m),
                y: (y0 - half_m, y0 + half_m),
                columns: CELLS,
                values: all.iter().map(|of| of[k]).collect(),
                strength: Vec::new(),
                range: Some(if metres { ENDS_M } else { ENDS_DEG }),
                map: ColourMap::Decades,
                label: if metres { "standard deviation (m)" } else { "standard deviation (°)" }.to_owned(),
            };
            panel(
                network,
                title,
                heat,
                if metres { LINES_M } else { LINES_DEG },
                if metres { " m" } else { "°" },
            )
        })
        .collect();
    write_panels(path, &panels.iter().collect::<Vec<_>>(), 3)
}

/// One map with its arrays and lines of equal value.
fn panel(network: &Network, title: &str, heat: HeatMap, lines: [f64; 6], unit: &str) -> Plot {
    let mut figure = Plot::new(title, "East (m)", "North (m)");
    figure.size(520, 480).equal().x_range(heat.x.0, heat.x.1).y_range(heat.y.0, heat.y.1);
    let arrays: Vec<(f64, f64)> = network.arrays_m.iter().map(|a| (a[0], a[1])).collect();
    let mut notes: Vec<((f64, f64), String)> = Vec::new();
    let apart_m = WORDS_APART * (heat.x.1 - heat.x.0);
    for value in lines.into_iter().rev() {
        let line = contour(&heat, value);
        figure.line("", &line).coloured(LINES);
        // Beside the line's northernmost place, unless there stands another.
        let north = line.iter().filter(|p| p.1.is_finite()).max_by(|a, b| a.1.total_cmp(&b.1));
        let free = |at: &&(f64, f64)| notes.iter().all(|(n, _)| (n.0 - at.0).hypot(n.1 - at.1) > apart_m);
        let word = north.filter(free).map(|at| (*at, format!("{value}{unit}")));
        notes.extend(word);
    }
    figure.heat(heat);
    figure.notes(notes).coloured(LINES);
    figure.points("arrays", &arrays).coloured(ARRAYS);
    figure.caption(
        "Colour and white lines: standard deviation to expect there, from the bounds of the stations file's errors; blank: nothing would be told.",
    );
    figure
}

/// One curve of an array's passages: name, and at each range the range of the closest point, its standard deviation (m) and that
/// of the heading (degrees).
pub type Curve = (String, Vec<(f64, f64, f64)>);

/// Range of the closest point and heading of passages against that range; and `positions`, of one bearing with elevation against
/// its range, where there are any.
///
/// # Errors
/// The file cannot be written.
pub fn passages(pass: &StraightPass, curves: &[Curve], positions: &[(f64, f64)], path: &Path) -> Result<()> {
    let about = format!("{:.0} s, {:.1} m/s", pass.window_s, pass.speed_m_s);
    let panel = |title: &str, label: &str, of: fn(&(f64, f64, f64)) -> f64| {
        let mut figure = Plot::new(&format!("{title}, {about}"), "range of the closest point (m)", label);
        figure.size(520, 400).x_scale(crate::plot::Scale::Log).y_scale(crate::plot::Scale::Log);
        for (name, points) in curves {
            figure.line(name, &points.iter().map(|p| (p.0, of(p))).collect::<Vec<_>>());
        }
        figure.caption(
            "Standard deviation to expect at the end of a straight passage against the range of its closest point, from the bound of the station file's [tracking]. As the recorder: with course_sd_deg for a way that is not quite straight.",
        );
        figure
    };
    let range = panel("Range of the closest point", "standard deviation (m)", |p| p.1);
    let heading = panel("Heading", "standard deviation (°)", |p| p.2);
    if positions.is_empty() {
        return write_panels(path, &[&range, &heading], 2);
    }
    let mut place = Plot::new("Position by one bearing", "horizontal range (m)", "standard deviation (m)");
    place.size(520, 400).x_scale(crate::plot::Scale::Log).y_scale(crate::plot::Scale::Log);
    place.line("azimuth and elevation, depth known", positions);
    place
        .caption("Standard deviation of the position that one bearing gives, the depth of the source known.");
    write_panels(path, &[&range, &heading, &place], 3)
}

/// A line's bearings against direction, for each signal-to-noise ratio (dB), and its orientation from a pass of a vessel of known track
/// against the range of its closest point; `about` says which passes.
///
/// # Errors
/// The file cannot be written.
pub fn line(
    bearings: &[(f64, Vec<(f64, f64)>)],
    orientation: &[(f64, Vec<(f64, f64)>)],
    about: &str,
    path: &Path,
) -> Result<()> {
    let panel = |title: &str, along: &str, curves: &[(f64, Vec<(f64, f64)>)]| {
        let mut figure = Plot::new(title, along, "standard deviation (°)");
        figure.size(520, 400).y_scale(crate::plot::Scale::Log);
        for (snr_db, points) in curves {
            figure.line(&format!("{snr_db:.0} dB"), points);
        }
        figure
    };
    let mut azimuth = panel("Azimuth", "angle from broadside (°)", bearings);
    azimuth.caption(
        "Standard deviation of the azimuth at the horizon to expect of each bearing, for signal-to-noise ratios of one sensor and transform.",
    );
    let mut own =
        panel(&format!("Orientation of the line, {about}"), "range of the closest point (m)", orientation);
    own.x_scale(crate::plot::Scale::Log).caption(
        "Bound of the line's orientation from one straight pass of known track, clock shift and eta unknown: median over its directions.",
    );
    write_panels(path, &[&azimuth, &own], 2)
}
