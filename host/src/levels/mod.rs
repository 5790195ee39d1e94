//! Levels of a recording in physical units: the core's cells, calibrated and summed into records.
//!
//! In: the blocks that the recorder gets, and the station's calibration. Out, for each interval and channel: a [`Level`];
//! and for pictures everything over the whole recording. docs/levels.md has the definitions.

mod beside;
pub mod picture;
pub mod told;
pub mod told_picture;

pub use beside::Beside;

use crate::record::Level;
use crate::station::{Calibration, Station};
use anyhow::{Result, anyhow};
use seabearing_core::block::{Block, CHANNELS};
use seabearing_core::levels::bands::{decidecade_hz, edge_hz, middle_hz, of_decade, of_decidecade};
use seabearing_core::levels::{
    self, EMPTY_ROW, Plan, ROWS, Report, Row, Scratch, State, percentiles_db, row_of_decidecade,
};
use std::ops::Range;

/// Measures the levels of a recording.
pub struct Meter {
    plan: Plan,
    state: Box<State>,
    scratch: Box<Scratch>,
    counts: Vec<Row>,
    maker: Maker,
    out: Vec<(u64, Level)>,
    /// Counts of the whole recording, where pictures are wanted.
    whole: Vec<Row>,
}

/// What makes records of reports.
struct Maker {
    rate_hz: f64,
    calibration: [Calibration; CHANNELS],
}

impl Meter {
    /// Levels of a station's recording over every so many seconds; `pictures`: what [`picture`] draws is kept as well.
    ///
    /// # Errors
    /// The interval is too short for the rate, or too long.
    pub fn new(station: &Station, seconds: f64, pictures: bool) -> Result<Self> {
        let config = &station.config;
        let plan = Plan::new(config.rate_hz, config.full_scale, seconds)
            .map_err(|e| anyhow!("--levels {seconds}: {e}"))?;
        Ok(Self {
            plan,
            state: Box::new(State::new()),
            scratch: Box::new(Scratch::new()),
            counts: vec![EMPTY_ROW; ROWS],
            maker: Maker { rate_hz: config.rate_hz, calibration: station.calibration.clone() },
            out: Vec::new(),
            whole: if pictures { vec![EMPTY_ROW; ROWS] } else { Vec::new() },
        })
    }

    /// Takes a block.
    pub fn push(&mut self, block: Block<'_>) {
        self.with(|plan, state, scratch, counts, mut sink| {
            levels::push(plan, state, scratch, counts, block, &mut sink)
        });
    }

    /// Ends the recording: the interval that has begun is reported as far as it went.
    pub fn finish(&mut self) {
        self.with(|plan, state, scratch, counts, mut sink| {
            levels::finish(plan, state, scratch, counts, &mut sink)
        });
    }

    /// What was measured since the last time: the index at which each interval begins, and its levels.
    pub fn take(&mut self) -> Vec<(u64, Level)> {
        std::mem::take(&mut self.out)
    }

    fn with(
        &mut self,
        work: impl FnOnce(&Plan, &mut State, &mut Scratch, &mut [Row], &mut dyn FnMut(&Report, &[Row])),
    ) {
        let Self { plan, state, scratch, counts, maker, out, whole } = self;
        let mut sink = |report: &Report, counts: &[Row]| {
            for (all, row) in whole.iter_mut().zip(counts) {
                for (all, n) in all.as_flattened_mut().iter_mut().zip(row.as_flattened()) {
                    *all += n;
                }
            }
            let made = (0..CHANNELS).map(|c| (report.first_index, maker.level(plan, report, counts, c)));
            out.extend(made);
        };
        work(plan, state, scratch, counts, &mut sink);
    }
}

/// Two decimals: a hundredth of a decibel.
fn rounded(db: f64) -> Option<f64> {
    db.is_finite().then(|| (db * 100.0).round() / 100.0)
}

/// Rows of three as three columns.
fn columns(rows: impl Iterator<Item = [Option<f64>; 3]>) -> [Vec<Option<f64>>; 3] {
    let mut out = [Vec::new(), Vec::new(), Vec::new()];
    rows.for_each(|row| out.iter_mut().zip(row).for_each(|(column, level)| column.push(level)));
    out
}

fn db(power: f64) -> f64 {
    10.0 * power.log10()
}

/// Six digits.
fn short(hz: f64) -> f64 {
    format!("{hz:.5e}").parse().unwrap_or(hz)
}

impl Maker {
    /// The record of one channel.
    fn level(&self, plan: &Plan, report: &Report, counts: &[Row], channel: usize) -> Level {
        let calibration = &self.calibration[channel];
        let power = |cell: i32| -> f64 {
            let measured =
                plan.place(cell).and_then(|place| report.mean_square.get(place)).map(|p| p[channel]);
            let more = calibration.db(middle_hz(cell));
            measured.zip(more).map_or(f64::NAN, |(p, more)| f64::from(p) * 10f64.powf(more / 10.0))
        };
        let band = |cells: Range<i32>| db(cells.map(power).sum());
        // The response need not be known everywhere: the broad band is as wide as it is.
        let known = |cell: &i32| calibration.db(middle_hz(*cell)).is_some();
        let first = plan.cells().find(known).unwrap_or(plan.cells().start);
        let last = plan.cells().rev().find(known).unwrap_or(first);
        let wide = first..last + 1;
        let decades: Vec<i32> =
            (-2..6).filter(|n| of_decade(*n).start >= wide.start && of_decade(*n).end <= wide.end).collect();
        let decidecades: Vec<i32> = plan.decidecades().collect();
        let cells: Vec<i32> = plan.cells().collect();
        let width_db = |cell: i32| db(edge_hz(cell + 1) - edge_hz(cell));
        let resolved = |cell: &i32| if plan.is_resolved(*cell) { 0.0 } else { f64::NAN };
        // Percentiles are of what the converter saw; a band's correction is that of its mean.
        let below = |row: usize, more: f64| {
            percentiles_db(counts, row, channel).map(|level| level.and_then(|x| rounded(f64::from(x) + more)))
        };
        let of_decidecades = decidecades.iter().map(|number| {
            let cells = of_decidecade(*number);
            let Some(place) = plan.place(cells.start) else { return [None; 3] };
            let seen = cells.clone().filter_map(|c| report.mean_square.get(plan.place(c)?));
            let seen = db(seen.map(|p| f64::from(p[channel])).sum());
            below(row_of_decidecade(place), band(cells) - seen)
        });
        let of_cells = cells.iter().map(|cell| {
            let more = calibration.db(middle_hz(*cell)).map(|more| more - width_db(*cell) + resolved(cell));
            plan.place(*cell).zip(more).map_or([None; 3], |(place, more)| below(place, more))
        });
        let [decidecade_p5_db, decidecade_p50_db, decidecade_p95_db] = columns(of_decidecades);
        let [psd_p5_db, psd_p50_db, psd_p95_db] = columns(of_cells);
        let sd = |number: &i32| {
            let cells = of_decidecade(*number);
            rounded(plan.sd_db(edge_hz(cells.start)..edge_hz(cells.end), &report.transforms[channel]))
        };
        let (good, clipped) = (report.good[channel], report.clipped[channel]);
        Level {
            channel: channel as u8,
            quantity: calibration.quantity,
            reference: calibration.reference,
            duration_s: report.instants as f64 / self.rate_hz,
            used: (f64::from(report.used[channel]) * 1e4).round() / 1e4,
            missing: report.instants.saturating_sub(good + clipped),
            clipped,
            from_hz: short(edge_hz(wide.start)),
            to_hz: short(edge_hz(wide.end)),
            broadband_db: rounded(band(wide)),
            decade_from_hz: decades.iter().map(|n| short(edge_hz(of_decade(*n).start))).collect(),
            decade_db: decades.iter().map(|n| rounded(band(of_decade(*n)))).collect(),
            decidecade_hz: decidecades.iter().map(|n| short(decidecade_hz(*n))).collect(),
            decidecade_db: decidecades.iter().map(|n| rounded(band(of_decidecade(*n)))).collect(),
            decidecade_sd_db: decidecades.iter().map(sd).collect(),
            decidecade_p5_db,
            decidecade_p50_db,
            decidecade_p95_db,
            psd_hz: cells.iter().map(|c| short(middle_hz(*c))).collect(),
            psd_db: cells.iter().map(|c| rounded(db(power(*c)) - width_db(*c) + resolved(c))).collect(),
            psd_p5_db,
            psd_p50_db,
            psd_p95_db,
        }
    }
}
