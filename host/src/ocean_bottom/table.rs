//! From a propagation table to the bytes the core reads ([`seabearing_core::obs::table`]).

use crate::propagation::{F0_HZ, Propagation, WIDTH_S, file};
use crate::station::Station;
use anyhow::{Context, Result, bail};
use seabearing_core::config::{Compatibility, Kind, StationConfig};
use seabearing_core::obs::decimate::inner_rate_hz;
use seabearing_core::obs::table::{MAX_BRANCHES, blob_bytes};
use seabearing_core::obs::table_encode::{BranchColumns, Header, encode};
use std::f64::consts::SQRT_2;

/// The farthest range the core's radial detector looks at, m [O 18, 19].
const NEEDED_M: f64 = 50_050.0;

/// The greatest strength a table may hold: a pulse cannot be higher than the cepstrum of two equal paths.
const STRONGEST: f64 = 1.0;

/// The propagation table a station names as the bytes the recorder takes; `None` where it names none.
///
/// # Errors
/// The table cannot be read or used.
pub fn of_station(station: &Station) -> Result<Option<Vec<u8>>> {
    let Some(path) = &station.propagation else { return Ok(None) };
    of(&station.config, &file::read(path)?, &path.display().to_string()).map(Some)
}

/// The same of a table at hand; `name` stands in messages.
///
/// # Errors
/// As [`blob`].
pub fn of(config: &StationConfig, table: &Propagation, name: &str) -> Result<Vec<u8>> {
    let model = match &config.kind {
        Kind::Obs(obs) if obs.compatibility == Compatibility::Paper => Model::PAPER,
        Kind::Obs(obs) if obs.compatibility == Compatibility::Programme => Model::PROGRAMME,
        _ => Model::of(table),
    };
    bytes(table, name, config.rate_hz, &model)
}

/// The core's bytes of a table for a recording at `rate_hz`; `name` stands in messages. Branches beyond the core's
/// number are left out.
///
/// # Errors
/// The table does not cover `NEEDED_M`, its f0 is beyond half the recorder's rate, or it holds what the core refuses.
pub fn blob(table: &Propagation, name: &str, rate_hz: f64) -> Result<Vec<u8>> {
    bytes(table, name, rate_hz, &Model::of(table))
}

/// What vessels draw in the cepstrum at quefrency q: `cos(2π f₀ (q − τ) − φ) exp(−(q − τ)²/Δτ²)` of each branch.
struct Model {
    f0_hz: f64,
    width_s: f64,
    branches: usize,
}

impl Model {
    /// Of the authors' programme; three branches [O Table II].
    const PROGRAMME: Self = Self { f0_hz: F0_HZ, width_s: WIDTH_S, branches: 3 };

    /// As paper O prints it: `cos(2π q f₀ − φ) exp(−(q − τ)²/2Δτ²)`, f₀ 15 Hz [O 17]. φ is read as all by which the two paths differ in phase at
    /// f₀, the delay's own part with it: `2π f₀ τ` more than the table's.
    const PAPER: Self = Self { f0_hz: 15.0, width_s: SQRT_2 * WIDTH_S, branches: 3 };

    /// As many branches as the core holds.
    fn of(table: &Propagation) -> Self {
        Self { f0_hz: table.f0_hz, width_s: table.width_s, branches: MAX_BRANCHES }
    }
}

fn bytes(table: &Propagation, name: &str, rate_hz: f64, model: &Model) -> Result<Vec<u8>> {
    file::covers(table, NEEDED_M, name)?;
    let nyquist_hz = 0.5 * inner_rate_hz(rate_hz);
    let Model { f0_hz, width_s, branches } = *model;
    if f0_hz >= nyquist_hz {
        bail!(
            "{name}: f0_hz is {}; the station works at {} samples a second, which hold frequencies below {nyquist_hz} Hz",
            f0_hz,
            2.0 * nyquist_hz
        );
    }
    let rows = table.rows();
    let branches = table.strengths.len().min(branches);
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
    let header = Header { step_m: table.step_m as f32, f0_hz: f0_hz as f32, width_s: width_s as f32 };
    let mut out = vec![0; blob_bytes(branches)];
    let n = encode(&header, inner_rate_hz(rate_hz) as f32, &travel, &views, &mut out)
        .map_err(|e| anyhow::anyhow!("{e}"))
        .with_context(|| name.to_owned())?;
    out.truncate(n);
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::propagation::{bottom::Bottom, profile::SpeedProfile, trace};
    use seabearing_core::obs::table::Table;

    #[test]
    fn the_core_reads_what_was_traced() {
        let profile =
            SpeedProfile::new(vec![(0.0, 1540.0), (1000.0, 1486.0), (4340.0, 1528.0)], 4340.0).unwrap();
        let table = trace::trace("t", &profile, &Bottom::default(), 700.0, 100, || ());
        let bytes = blob(&table, "t", 200.0).unwrap();
        let core = Table::parse(&bytes).unwrap();
        assert_eq!((core.branches(), core.rate_hz()), (4, 50.0));
        let (d, _) = table.branch(1, 30).unwrap();
        assert!((f64::from(core.delay_s(1, 21_000.0).unwrap()) - d).abs() < 1e-4);
        let pulse = core.pulses(1).nth(300).unwrap();
        assert!((f64::from(pulse.centre()) - 50.0 * d).abs() < 1.0 / 128.0);
        let strength = f64::from(pulse.re).hypot(f64::from(pulse.im)) / 32_768.0;
        assert!((strength - table.strengths[1].at(21_000.0)).abs() < 1e-4);
        assert!(core.delay_s(0, 49_000.0).is_none(), "the direct path does not reach so far");
        let high = Propagation { f0_hz: 30.0, ..table.clone() };
        let said = blob(&high, "t.toml", 200.0).unwrap_err().to_string();
        assert!(said.contains("f0_hz") && said.contains("25 Hz"), "{said}");
        // Whatever the table's own pulse is.
        const STATION: &str =
            "[station]\nid = 1\nname = \"t\"\nkind = \"obs\"\n[sampling]\nrate_hz = 50.0\n[obs]\n";
        let mut config = Station::parse(STATION, "t", std::path::Path::new(".")).unwrap().config;
        assert_eq!(of(&config, &table, "t").unwrap(), blob(&table, "t", 50.0).unwrap());
        let others =
            [(Compatibility::Programme, F0_HZ, WIDTH_S), (Compatibility::Paper, 15.0, WIDTH_S * SQRT_2)];
        for (compatibility, f0_hz, width_s) in others {
            if let Kind::Obs(obs) = &mut config.kind {
                obs.compatibility = compatibility;
            }
            let strengths = table.strengths[..3].to_vec();
            let theirs = Propagation { f0_hz, width_s, strengths, ..table.clone() };
            let fitted = Propagation { f0_hz: 14.0, width_s: 0.03, ..table.clone() };
            assert_eq!(of(&config, &fitted, "t").unwrap(), blob(&theirs, "t", 50.0).unwrap());
        }
        let short = trace::trace("t", &profile, &Bottom::default(), 700.0, 50, || ());
        assert!(blob(&short, "t.toml", 50.0).unwrap_err().to_string().contains("t.toml"));
    }
}
