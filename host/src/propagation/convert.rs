//! From a ready ray table (CSV) to a propagation table.
//!
//! Columns: `distance_m`, then `toa_s_n`, `amp_re_n`, `amp_im_n` for n = 1, 3, 5, … crossings; an empty cell means
//! that the path does not exist at that range. Ranges start at 0 and grow in equal steps. A path that misses only its
//! row at range 0 gets it from its neighbours: travel time is an even function of range.

use super::{Complex, F0_HZ, Propagation, RayArrival, RayPath, WIDTH_S, strength};
use crate::csv::CsvTable;
use anyhow::{Result, bail};

/// Reads a ray table. Without a depth it is estimated from the path of three crossings (to about one percent);
/// `conjugate` takes amplitudes written for `exp(+iωt)`.
///
/// # Errors
/// Missing columns, ranges that do not start at 0 or are uneven, a path with a hole, values of a wrong unit.
pub fn read(path: &std::path::Path, depth_m: Option<f64>, conjugate: bool) -> Result<Propagation> {
    let name = path.display().to_string();
    convert(&CsvTable::read(path)?, &name, depth_m, conjugate)
}

fn convert(table: &CsvTable, name: &str, depth_m: Option<f64>, conjugate: bool) -> Result<Propagation> {
    let distances: Vec<f64> =
        table.numbers(["distance_m"])?.into_iter().map(|(_, r)| r.map(|[x]| x)).collect::<Result<_>>()?;
    let rows = distances.len();
    if rows < 3 {
        bail!("{name}: {rows} rows, a ray table needs three or more");
    }
    let step_m = distances[1] - distances[0];
    if distances[0] != 0.0 {
        bail!("{name}: the first range is {} m, ranges must start at 0", distances[0]);
    }
    if let Some(j) = (1..rows)
        .find(|j| (distances[*j] - step_m * *j as f64).abs() > 1e-6 * step_m * *j as f64 || step_m <= 0.0)
    {
        bail!("{name}: ranges must grow in equal steps of {step_m} m, row {} has {}", j + 1, distances[j]);
    }
    let crossings: Vec<u32> =
        (0..20).map(|i| 2 * i + 1).take_while(|n| table.has(&format!("toa_s_{n}"))).collect();
    if crossings.len() < 2 {
        bail!("{name}: columns toa_s_1 and toa_s_3 are needed: an interference takes two paths");
    }
    let mut paths = Vec::new();
    for &n in &crossings {
        let columns = [format!("toa_s_{n}"), format!("amp_re_{n}"), format!("amp_im_{n}")];
        let mut index = [0; 3];
        for (slot, c) in index.iter_mut().zip(&columns) {
            *slot = table.column(c)?;
        }
        let mut arrivals = Vec::with_capacity(rows);
        for row in 0..rows {
            let cells = index.map(|i| table.text(row, i).unwrap_or(""));
            if cells.iter().all(|c| c.is_empty()) {
                arrivals.push(None);
                continue;
            }
            let mut x = [0.0; 3];
            for ((slot, cell), column) in x.iter_mut().zip(cells).zip(&columns) {
                match cell.parse::<f64>() {
                    Ok(v) if v.is_finite() => *slot = v,
                    _ => bail!(
                        "{name}, range {} m: `{column}` is `{cell}`, a number was expected",
                        distances[row]
                    ),
                }
            }
            let im = if conjugate { -x[2] } else { x[2] };
            arrivals.push(Some(RayArrival { toa_s: x[0], amplitude: Complex::new(x[1], im) }));
        }
        if let [None, Some(a), Some(b), ..] = arrivals[..] {
            let amplitude = a.amplitude - (b.amplitude - a.amplitude) / 3.0;
            arrivals[0] = Some(RayArrival { toa_s: a.toa_s - (b.toa_s - a.toa_s) / 3.0, amplitude });
        }
        paths.push(RayPath { crossings: n, arrivals });
    }
    let mut out = Propagation {
        name: std::path::Path::new(name)
            .file_stem()
            .map_or_else(String::new, |s| s.to_string_lossy().into_owned()),
        depth_m: 0.0,
        step_m,
        f0_hz: F0_HZ,
        width_s: WIDTH_S,
        strengths: strength::RR03[..(paths.len() - 1).min(4)].to_vec(),
        paths,
    };
    let estimate_m = super::file::depth_of(&out, name)?;
    out.depth_m = depth_m.unwrap_or(estimate_m);
    out.strengths = strength::of_depth(out.depth_m)[..out.strengths.len()].to_vec();
    super::file::check(&out, name)?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn csv(scale_m: f64, scale_s: f64) -> String {
        let mut text =
            String::from("distance_m,toa_s_1,amp_re_1,amp_im_1,toa_s_3,amp_re_3,amp_im_3\n0,,,,,,\n");
        for j in 1..400 {
            let r = 70.0 * f64::from(j);
            let t = |n: f64| r.hypot(n * 4340.0) / 1500.0 * scale_s;
            text += &format!("{},{},1e-4,0,{},1e-4,1e-5\n", r * scale_m, t(1.0), t(3.0));
        }
        text
    }

    fn parse(text: &str) -> Result<Propagation> {
        convert(&CsvTable::parse(text, "t.csv").unwrap(), "t.csv", None, false)
    }

    #[test]
    fn reads_and_fills_range_zero() {
        let p = parse(&csv(1.0, 1.0)).unwrap();
        let zero = p.paths[0].arrivals[0].unwrap();
        assert!((zero.toa_s - 4340.0 / 1500.0).abs() < 1e-6);
        assert!((p.depth_m - 4340.0).abs() < 60.0, "{}", p.depth_m);
        assert_eq!(p.strengths.len(), 1);
    }

    #[test]
    fn wrong_units_and_columns_are_named() {
        let e = parse(&csv(1e-3, 1.0)).unwrap_err().to_string();
        assert!(e.contains("km"), "{e}");
        let e = parse(&csv(1.0, 1e3)).unwrap_err().to_string();
        assert!(e.contains("ms"), "{e}");
        let e = parse(&csv(1.0, 1.0).replace("amp_im_3", "imag_3")).unwrap_err().to_string();
        assert!(e.contains("amp_im_3"), "{e}");
        let e = parse(&csv(1.0, 1.0).replacen("\n140,", "\n150,", 1)).unwrap_err().to_string();
        assert!(e.contains("equal steps"), "{e}");
    }
}
