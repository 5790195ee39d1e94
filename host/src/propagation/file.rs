//! The propagation table's file (TOML): what `seabearing propagation` writes and a station file names.
//!
//! ```toml
//! format = "seabearing-propagation-1"
//! name = "rr03"
//! depth_m = 4340.0
//! step_m = 70.0          # row j is range j * step_m
//! f0_hz = 16.5
//! width_s = 0.05
//! [[strength]]           # branch 13, then 35, 57, 79
//! k_m = 890.0
//! shape = 4.0
//! location_m = 8000.0
//! scale_m = 7500.0
//! [[path]]               # 1 crossing, then 3, 5, ...
//! crossings = 1
//! first_row = 0          # the path exists from here on, for as many rows as are listed
//! toa_s = [2.885, 2.886]
//! amplitude_re = [-6.8e-4, -6.8e-4]   # convention exp(-i w t)
//! amplitude_im = [0.0, 0.0]
//! ```

use super::strength::SkewNormal;
use super::{Complex, Propagation, RayArrival, RayPath};
use crate::toml_file::TomlFile;
use anyhow::{Result, bail};
use serde::Deserialize;
use std::fmt::Write as _;

const FORMAT: &str = "seabearing-propagation-1";

/// Speeds a path's length over its travel time may have, m/s.
const SPEEDS_M_S: (f64, f64) = (1350.0, 1650.0);

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    format: String,
    name: String,
    depth_m: f64,
    step_m: f64,
    f0_hz: f64,
    width_s: f64,
    strength: Vec<SkewNormal>,
    path: Vec<PathTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PathTable {
    crossings: u32,
    first_row: usize,
    toa_s: Vec<f64>,
    amplitude_re: Vec<f64>,
    amplitude_im: Vec<f64>,
}

/// Reads and checks a table.
///
/// # Errors
/// One line: the file, and what is wrong in it.
pub fn read(path: &std::path::Path) -> Result<Propagation> {
    let source = TomlFile::read(path, "propagation table (`seabearing propagation` makes one)")?;
    of(&source)
}

/// Parses and checks a table; `name` stands in messages.
///
/// # Errors
/// As [`read`].
pub fn parse(text: &str, name: &str) -> Result<Propagation> {
    of(&TomlFile::of(text, name))
}

fn of(source: &TomlFile) -> Result<Propagation> {
    let file: File = source.parse()?;
    if file.format != FORMAT {
        bail!("{}: format is `{}`, only `{FORMAT}` is understood", source.at("format"), file.format);
    }
    let rows = file.path.iter().map(|p| p.first_row + p.toa_s.len()).max().unwrap_or(0);
    let mut paths = Vec::new();
    for (i, p) in file.path.into_iter().enumerate() {
        if p.crossings != 2 * i as u32 + 1 {
            let at = source.at(&format!("path.{i}.crossings"));
            bail!("{at}: path {} has {} crossings, {} expected", i + 1, p.crossings, 2 * i + 1);
        }
        if p.toa_s.len() != p.amplitude_re.len() || p.toa_s.len() != p.amplitude_im.len() {
            let at = source.at(&format!("path.{i}"));
            bail!("{at}: path of {} crossings has columns of unlike length", p.crossings);
        }
        let mut arrivals = vec![None; rows];
        let values = p.toa_s.iter().zip(&p.amplitude_re).zip(&p.amplitude_im);
        for (slot, ((&toa_s, &re), &im)) in arrivals.iter_mut().skip(p.first_row).zip(values) {
            *slot = Some(RayArrival { toa_s, amplitude: Complex::new(re, im) });
        }
        paths.push(RayPath { crossings: p.crossings, arrivals });
    }
    let out = Propagation {
        name: file.name,
        depth_m: file.depth_m,
        step_m: file.step_m,
        f0_hz: file.f0_hz,
        width_s: file.width_s,
        paths,
        strengths: file.strength,
    };
    check(&out, source.name())?;
    Ok(out)
}

/// The table as text.
pub fn format(table: &Propagation) -> String {
    let mut out = String::new();
    let numbers = |key: &str, values: &mut dyn Iterator<Item = f64>| {
        let cells: Vec<String> = values.map(|x| format!("{x:.9e}")).collect();
        let lines: Vec<String> = cells.chunks(8).map(|c| c.join(", ")).collect();
        format!("{key} = [\n  {},\n]\n", lines.join(",\n  "))
    };
    let _ = writeln!(
        out,
        "# Delays, phases and strengths of interferences against range. Amplitudes follow exp(-i w t).\n\
         format = \"{FORMAT}\"\nname = {:?}\ndepth_m = {:?}\nstep_m = {:?}\nf0_hz = {:?}\nwidth_s = {:?}",
        table.name, table.depth_m, table.step_m, table.f0_hz, table.width_s
    );
    for s in &table.strengths {
        let _ = writeln!(
            out,
            "\n[[strength]]\nk_m = {:?}\nshape = {:?}\nlocation_m = {:?}\nscale_m = {:?}",
            s.k_m, s.shape, s.location_m, s.scale_m
        );
    }
    for p in &table.paths {
        let (first, last) = p.span().unwrap_or((0, 0));
        let held: Vec<RayArrival> = p.arrivals[first..=last].iter().flatten().copied().collect();
        let _ = writeln!(out, "\n[[path]]\ncrossings = {}\nfirst_row = {first}", p.crossings);
        out += &numbers("toa_s", &mut held.iter().map(|a| a.toa_s));
        out += &numbers("amplitude_re", &mut held.iter().map(|a| a.amplitude.re));
        out += &numbers("amplitude_im", &mut held.iter().map(|a| a.amplitude.im));
    }
    out
}

/// Writes a table, whole or not at all.
///
/// # Errors
/// The folder cannot be written.
pub fn write(table: &Propagation, path: &std::path::Path) -> Result<()> {
    crate::atomic::write(path, format(table).as_bytes())
}

/// Water depth from a table itself: with two paths of n₁ < n₂ crossings at range 0 the times differ by
/// (n₂ − n₁) depth / speed; with one speed the range dependence gives the rest: T² = (r² + n² D²) / c².
///
/// # Errors
/// The table has no two rows with the third path, or its unit is wrong.
pub fn depth_of(table: &Propagation, name: &str) -> Result<f64> {
    let Some(path) = table.paths.get(1) else { bail!("{name}: the path of three crossings is missing") };
    let Some((first, last)) = path.span() else {
        bail!("{name}: the path of three crossings has no arrival")
    };
    let at = |j: usize| path.arrivals[j].map(|a| (table.step_m * j as f64, a.toa_s));
    let middle = first + (last - first) / 4;
    let (Some((r1, t1)), Some((r2, t2))) = (at(first), at(middle)) else {
        bail!("{name}: the path of three crossings has holes")
    };
    let speed = ((r2 * r2 - r1 * r1) / (t2 * t2 - t1 * t1)).sqrt();
    unit_of_speed(speed, name)?;
    Ok(((t1 * speed).powi(2) - r1 * r1).max(0.0).sqrt() / f64::from(path.crossings))
}

fn unit_of_speed(speed_m_s: f64, name: &str) -> Result<()> {
    let within = |x: f64| (SPEEDS_M_S.0 * 0.9..=SPEEDS_M_S.1 * 1.1).contains(&x);
    if within(speed_m_s) {
        Ok(())
    } else if within(speed_m_s * 1e3) && speed_m_s < 10.0 {
        bail!("{name}: ranges and times give {speed_m_s:.3} m/s: ranges look like km, or times like ms")
    } else {
        bail!(
            "{name}: ranges and times give {speed_m_s:.3} m/s, sound in water has 1350 to 1650: check units"
        )
    }
}

/// Highest centre frequency, Hz: stations work at 62.5 samples a second at most.
const HIGHEST_F0_HZ: f64 = 31.25;

/// What every table must satisfy.
///
/// # Errors
/// What is wrong first.
pub fn check(table: &Propagation, name: &str) -> Result<()> {
    let positive = [
        ("depth_m", table.depth_m, 50.0, 12_000.0),
        ("step_m", table.step_m, 1.0, 2000.0),
        ("f0_hz", table.f0_hz, 0.5, HIGHEST_F0_HZ),
        ("width_s", table.width_s, 0.001, 1.0),
    ];
    for (key, x, lo, hi) in positive {
        if !(lo..=hi).contains(&x) {
            bail!("{name}: {key} is {x}; allowed {lo} to {hi}");
        }
    }
    if table.paths.len() < 2 || table.rows() < 3 {
        bail!("{name}: two paths and three rows are the least a table may have");
    }
    if table.strengths.is_empty() || table.strengths.len() >= table.paths.len() {
        bail!(
            "{name}: {} strengths for {} paths: one for each pair of neighbours at most",
            table.strengths.len(),
            table.paths.len()
        );
    }
    for s in &table.strengths {
        if !(s.scale_m > 0.0 && s.k_m >= 0.0 && s.shape.is_finite() && s.location_m.is_finite()) {
            bail!("{name}: a strength needs k_m of 0 or more and scale_m above 0, {s:?} was given");
        }
        if !s.is_one() {
            bail!(
                "{name}: the strength of k_m {:.3e} is {:.3e} high: a pulse in the cepstrum is at most 1",
                s.k_m,
                s.peak()
            );
        }
    }
    for p in &table.paths {
        let n = p.crossings;
        let Some((first, last)) = p.span() else { bail!("{name}: the path of {n} crossings has no arrival") };
        for j in first..=last {
            let Some(a) = p.arrivals[j] else {
                bail!("{name}: the path of {n} crossings has a hole at row {j}")
            };
            if a.toa_s <= 0.0 || !a.toa_s.is_finite() || !a.amplitude.is_finite() {
                bail!("{name}: the path of {n} crossings has an impossible value at row {j}");
            }
            let speed = (table.step_m * j as f64).hypot(f64::from(n) * table.depth_m) / a.toa_s;
            if !(0.85 * SPEEDS_M_S.0..=1.15 * SPEEDS_M_S.1).contains(&speed) {
                unit_of_speed(speed, name)?;
                bail!(
                    "{name}: the path of {n} crossings runs at {speed:.0} m/s at row {j}: check units and depth"
                );
            }
        }
    }
    Ok(())
}

/// Checks that every branch asked for covers a span of ranges with at least one branch everywhere.
///
/// # Errors
/// The table ends too early, or no branch exists somewhere on the way.
pub fn covers(table: &Propagation, max_range_m: f64, name: &str) -> Result<()> {
    if table.max_range_m() < max_range_m {
        bail!(
            "{name}: the table ends at {:.1} km, {:.1} km are needed",
            table.max_range_m() / 1e3,
            max_range_m / 1e3
        );
    }
    let last = (max_range_m / table.step_m) as usize;
    let hole = (1..=last).find(|&j| (0..table.strengths.len()).all(|b| table.branch(b, j).is_none()));
    match hole {
        Some(j) => {
            bail!("{name}: no interference at {:.1} km, where one is needed", table.step_m * j as f64 / 1e3)
        }
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{bottom::Bottom, profile::SpeedProfile, trace};
    use super::*;

    #[test]
    fn text_and_back() {
        let profile =
            SpeedProfile::new(vec![(0.0, 1540.0), (1000.0, 1486.0), (4340.0, 1528.0)], 4340.0).unwrap();
        let table = trace::trace("t", &profile, &Bottom::default(), 500.0, 60, || ());
        let back = parse(&format(&table), "t.toml").unwrap();
        assert_eq!(back.rows(), table.rows());
        assert_eq!(back.strengths, table.strengths);
        for (p, q) in table.paths.iter().zip(&back.paths) {
            assert_eq!(p.span(), q.span());
            for (a, b) in p.arrivals.iter().flatten().zip(q.arrivals.iter().flatten()) {
                assert!((a.toa_s - b.toa_s).abs() < 1e-8 && (a.amplitude - b.amplitude).norm() < 1e-12);
            }
        }
        assert!(covers(&back, 29_000.0, "t").is_ok());
        let e = covers(&back, 50_000.0, "t").unwrap_err().to_string();
        assert!(e.contains("29.5 km") && e.contains("50.0"), "{e}");
        let e = parse(&format(&table).replace("width_s", "width_ms"), "t.toml").unwrap_err().to_string();
        assert!(e.contains("width_ms") && e.contains("line"), "{e}");
        let mut high = table.clone();
        high.strengths[0].k_m = 5.8e21;
        let e = check(&high, "t").unwrap_err().to_string();
        assert!(e.contains("at most 1"), "{e}");
        let e = check(&Propagation { f0_hz: 200.0, ..table }, "t").unwrap_err().to_string();
        assert!(e.contains("f0_hz is 200"), "{e}");
    }
}
