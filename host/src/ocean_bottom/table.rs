//! From a propagation table to the bytes the core reads ([`seabearing_core::obs::table`]).

use crate::propagation::{Propagation, file};
use anyhow::{Context, Result};
use seabearing_core::obs::table::{BranchColumns, Header, MAX_BRANCHES, MAX_RANGES, blob_bytes, encode};

/// The farthest range the core's radial detector looks at, m [METHODS-OBS 6].
pub const NEEDED_M: f64 = 50_050.0;

/// The greatest strength a table may hold: a pulse cannot be higher than the cepstrum of two equal paths.
const STRONGEST: f64 = 1.0;

/// The core's bytes of a table; `name` stands in messages. Rows beyond the core's capacity are cut, branches beyond
/// its number are left out.
///
/// # Errors
/// The table does not cover [`NEEDED_M`], or holds what the core refuses.
pub fn blob(table: &Propagation, name: &str) -> Result<Vec<u8>> {
    file::covers(table, NEEDED_M, name)?;
    encode_rows(table, name)
}

fn encode_rows(table: &Propagation, name: &str) -> Result<Vec<u8>> {
    let rows = table.rows().min(MAX_RANGES);
    let branches = table.strengths.len().min(MAX_BRANCHES);
    let travel: Vec<f32> = (0..rows).map(|j| table.travel_time_s(j).map_or(f32::NAN, |t| t as f32)).collect();
    let columns: Vec<[Vec<f32>; 3]> = (0..branches)
        .map(|b| {
            let mut c = [Vec::with_capacity(rows), Vec::with_capacity(rows), Vec::with_capacity(rows)];
            for j in 0..rows {
                let (delay, phase) = table.branch(b, j).unwrap_or((f64::NAN, f64::NAN));
                let strength = table.strengths[b].at(table.step_m * j as f64).clamp(0.0, STRONGEST);
                for (column, x) in c.iter_mut().zip([delay, phase, strength]) {
                    column.push(x as f32);
                }
            }
            c
        })
        .collect();
    let views: Vec<BranchColumns<'_>> =
        columns.iter().map(|[d, p, s]| BranchColumns { delay_s: d, phase_rad: p, strength: s }).collect();
    let header =
        Header { step_m: table.step_m as f32, f0_hz: table.f0_hz as f32, width_s: table.width_s as f32 };
    let mut out = vec![0; blob_bytes(branches, rows)];
    let n = encode(&header, &travel, &views, &mut out)
        .map_err(|e| anyhow::anyhow!("{e}"))
        .with_context(|| name.to_owned())?;
    out.truncate(n);
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::propagation::{bottom::Bottom, profile::Profile, trace};
    use seabearing_core::obs::table::Table;

    #[test]
    fn the_core_reads_what_was_traced() {
        let profile = Profile::new(vec![(0.0, 1540.0), (1000.0, 1486.0), (4340.0, 1528.0)], 4340.0).unwrap();
        let table = trace::trace("t", &profile, &Bottom::default(), 700.0, 100, || ());
        let bytes = blob(&table, "t").unwrap();
        let core = Table::parse(&bytes).unwrap();
        assert_eq!((core.branches(), core.ranges()), (4, 100));
        let (delay, phase, strength) = core.branch(1, 21_000.0).unwrap();
        let (d, p) = table.branch(1, 30).unwrap();
        assert!((f64::from(delay) - d).abs() < 1e-5 && (f64::from(phase) - p).abs() < 1e-4);
        assert!((f64::from(strength) - table.strengths[1].at(21_000.0)).abs() < 1e-6);
        assert!(core.branch(0, 49_000.0).is_none(), "the direct path does not reach so far");
        let short = trace::trace("t", &profile, &Bottom::default(), 700.0, 50, || ());
        assert!(blob(&short, "t.toml").unwrap_err().to_string().contains("t.toml"));
    }
}
