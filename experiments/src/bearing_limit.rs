//! `reproduce bearing-limit`: how near the array chain comes to the physical limit, whether its stated uncertainty is
//! honest, and how often noise alone makes a bearing.
//!
//! Static sources at random azimuths and elevations, 500 m away (spherical delays, exact), source and ambient noise of
//! one falling spectrum. Everything is measured on what the recorder's own code emits for converter codes.

use super::bearing_limit_source::{AmbientField, Desk, Sounder, exact_arrivals, surfaced};
use super::figure::Bar;
use super::report::CsvReport;
use super::{Experiment, Options};
use crate::plot::{Plot, Scale};
use crate::progress;
use anyhow::Result;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rayon::prelude::*;
use seabearing_core::angle::wrap_pi;
use seabearing_core::array::{self, Plan, Scratch, State, limit};
use seabearing_core::block::{Block, Frame};
use seabearing_core::config::{ArrayConfig, Clips, Kind, Levels, Schedule, StationConfig, Tracking};
use seabearing_core::wire::{Bearing, Message};

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "bearing-limit",
    about: "bearing errors against the physical limit, honesty of the ellipses, false alarms",
    run,
};

/// Signal-to-noise ratios of the table, dB.
const SNR_DB: [f64; 4] = [20.0, 10.0, 0.0, -10.0];
/// Range of the sources, metres.
const RANGE_M: f64 = 500.0;
/// False alarms an hour allowed in the row that checks the stated rate.
const OFTEN_PER_HOUR: f64 = 400.0;
/// Samples of one record: 8.2 s.
const RECORD: usize = 1 << 19;
/// Noise level in codes: far above quantisation, far below clipping of 24 bits.
const NOISE_CODES: f64 = 2e4;

/// The station of the experiments: a tetrahedron of 1.85 m edges at 64 kHz.
pub fn station() -> StationConfig {
    let (r, h) = (1.85 / 3f64.sqrt(), 1.85 * (2f64 / 3.0).sqrt());
    let side = r * 0.75f64.sqrt();
    StationConfig {
        id: 1,
        name: Default::default(),
        lat_lon_deg: None,
        local_east_north_m: None,
        depth_m: 168.0,
        orientation_deg: 0.0,
        sound_speed_m_s: 1484.0,
        rate_hz: 64_000.0,
        full_scale: 1 << 23,
        kind: Kind::Array(ArrayConfig {
            hydrophones_m: [
                [0.0, r, -0.25 * h],
                [side, -0.5 * r, -0.25 * h],
                [-side, -0.5 * r, -0.25 * h],
                [0.0, 0.0, 0.75 * h],
            ],
            channels: [0, 1, 2, 3],
            sensitivity_db_re_1v_upa: [-165.0; 4],
            reference_range_m: RANGE_M,
            band_hz: (50.0, 25_000.0),
            segment_s: 1.0,
            step_s: 0.5,
            elevation_deg: (-90.0, 90.0),
            false_alarms_per_hour: 0.5,
            vessel_depth_m: 0.0,
            position_sd_m: 0.0,
            sound_speed_sd_m_s: 0.0,
        }),
        tracking: Tracking::default(),
        levels: Levels::default(),
        schedule: Schedule::default(),
        doubts: Default::default(),
        clips: Clips::default(),
    }
}

/// All bearings the chain emits for a record.
pub fn bearings(plan: &Plan, frames: &[Frame]) -> Vec<Bearing> {
    bearings_from(plan, None, frames)
}

/// The same where a vessel's place is known: azimuth (radians), distance and its standard deviation (metres).
fn bearings_from(plan: &Plan, place: Option<(f32, f32, f32)>, frames: &[Frame]) -> Vec<Bearing> {
    let mut state = State::new();
    state.set_places(place.into_iter());
    let mut scratch = Scratch::new();
    let mut out = Vec::new();
    let mut sink = |m: Message| {
        if let Message::Bearing(b) = m {
            out.push(b);
        }
    };
    for (n, part) in frames.chunks(4096).enumerate() {
        let block = Block { first_index: (n * 4096) as u64, frames: part };
        array::push(plan, &mut state, &mut scratch, block, &mut sink);
    }
    array::finish(plan, &mut state, &mut scratch, &mut sink);
    out
}

/// Errors of one direction's bearings.
#[derive(Default, Clone)]
struct Errors {
    n: usize,
    expected: usize,
    azimuth2: f64,
    elevation2: f64,
    limit_azimuth2: f64,
    limit_elevation2: f64,
    stated_azimuth2: f64,
    stated_elevation2: f64,
    beyond_5_deg: usize,
    within_ellipse: usize,
}

impl Errors {
    /// Takes a bearing of a source in this direction (radians).
    fn take(&mut self, b: &Bearing, azimuth: f64, elevation: f64) {
        let da = wrap_pi(f64::from(b.azimuth) - azimuth);
        let de = f64::from(b.elevation) - elevation;
        let (va, ve, c) = (f64::from(b.var_azimuth), f64::from(b.var_elevation), f64::from(b.cov));
        let chi2 = (ve * da * da - 2.0 * c * da * de + va * de * de) / (va * ve - c * c);
        self.n += 1;
        self.azimuth2 += da * da;
        self.elevation2 += de * de;
        self.stated_azimuth2 += va;
        self.stated_elevation2 += ve;
        self.beyond_5_deg += usize::from((da * elevation.cos()).hypot(de) > 5f64.to_radians());
        // 95 % of a two-dimensional normal lie within −2 ln 0.05 = 5.991.
        self.within_ellipse += usize::from(chi2 <= 5.991);
    }

    fn add(mut self, o: Self) -> Self {
        self.n += o.n;
        self.expected += o.expected;
        self.azimuth2 += o.azimuth2;
        self.elevation2 += o.elevation2;
        self.limit_azimuth2 += o.limit_azimuth2;
        self.limit_elevation2 += o.limit_elevation2;
        self.stated_azimuth2 += o.stated_azimuth2;
        self.stated_elevation2 += o.stated_elevation2;
        self.beyond_5_deg += o.beyond_5_deg;
        self.within_ellipse += o.within_ellipse;
        self
    }
}

/// Runs the experiment.
///
/// # Errors
/// The configuration cannot be planned, or an output cannot be written.
pub fn run(options: &Options) -> Result<()> {
    let config = station();
    let plan = Plan::new(&config)?;
    let directions = options.runs.unwrap_or(40);
    accuracy(options, &plan, directions)?;
    let mut surfaced = config;
    if let Kind::Array(array) = &mut surfaced.kind {
        array.vessel_depth_m = 4.0;
    }
    multipath(options, &Plan::new(&surfaced)?, directions)?;
    // An hour of noise for each kind, or a share of it where fewer runs are asked for.
    let seconds = if options.runs.is_some_and(|n| n < 10) { 300.0 } else { 3600.0 };
    false_alarms(options, seconds)
}

/// The table of errors against the limit.
fn accuracy(options: &Options, plan: &Plan, directions: usize) -> Result<()> {
    let sounder = Sounder::new(plan.geometry(), f64::from(plan.rate_hz()), RECORD, AmbientField::Independent);
    let mut report = CsvReport::new(
        "bearing_limit",
        "snr_db,segments,az_deg,az_limit,az_ratio,el_deg,el_limit,el_ratio,beyond_5,ellipse_%",
    );
    let mut rows = Vec::new();
    let bar = progress::bar((SNR_DB.len() * directions) as u64, "directions");
    for snr_db in SNR_DB {
        let errors = (0..directions)
            .into_par_iter()
            .map_init(
                || sounder.desk(),
                |desk, n| {
                    let seed = options.seed.wrapping_mul(1_000_003).wrapping_add(n as u64);
                    let errors = one_direction(plan, &sounder, desk, seed, snr_db);
                    bar.inc(1);
                    errors
                },
            )
            .reduce(Errors::default, Errors::add);
        let n = errors.n.max(1) as f64;
        let deg = |x: f64| (x / n).sqrt().to_degrees();
        report.row(&[
            snr_db,
            errors.n as f64,
            deg(errors.azimuth2),
            deg(errors.limit_azimuth2),
            (errors.azimuth2 / errors.limit_azimuth2).sqrt(),
            deg(errors.elevation2),
            deg(errors.limit_elevation2),
            (errors.elevation2 / errors.limit_elevation2).sqrt(),
            (errors.beyond_5_deg + errors.expected.saturating_sub(errors.n)) as f64,
            100.0 * errors.within_ellipse as f64 / n,
        ]);
        judge(options, snr_db, &errors);
        rows.push((
            snr_db,
            deg(errors.azimuth2),
            deg(errors.limit_azimuth2),
            deg(errors.elevation2),
            deg(errors.limit_elevation2),
        ));
    }
    bar.finish_and_clear();
    report.finish(options)?;
    let series =
        |pick: fn(&(f64, f64, f64, f64, f64)) -> f64| rows.iter().map(|r| (r.0, pick(r))).collect::<Vec<_>>();
    let mut figure =
        Plot::new("Bearing error against the physical limit", "signal-to-noise ratio (dB)", "RMSE (°)");
    figure.y_scale(Scale::Log);
    figure.line("limit, azimuth", &series(|r| r.2)).line("limit, elevation", &series(|r| r.4));
    figure.points("azimuth", &series(|r| r.1)).points("elevation", &series(|r| r.3));
    figure.write(&options.out.join("bearing_limit.svg"))
}

/// The figures at the ratios that have bars.
fn judge(options: &Options, snr_db: f64, errors: &Errors) {
    let Some((_, ratio)) = [(10.0, 1.2), (0.0, 1.2), (-10.0, 2.0)].into_iter().find(|b| b.0 == snr_db) else {
        return;
    };
    let figures = &options.figures;
    let azimuth = (errors.azimuth2 / errors.limit_azimuth2).sqrt();
    figures.at_most(format!("azimuth RMSE over the limit at {snr_db:+} dB"), azimuth, ratio);
    let elevation = (errors.elevation2 / errors.limit_elevation2).sqrt();
    figures.at_most(format!("elevation RMSE over the limit at {snr_db:+} dB"), elevation, ratio);
    let far = errors.beyond_5_deg + errors.expected.saturating_sub(errors.n);
    figures.at_most(format!("bearings beyond 5° or absent at {snr_db:+} dB"), far as f64, 0.0);
    let inside = 100.0 * errors.within_ellipse as f64 / errors.n as f64;
    figures.report(format!("truth in the 95 % ellipse at {snr_db:+} dB, %"), inside, Bar::Within(92.0, 98.0));
}

/// The table of stated and actual errors where the surface's image comes beside the vessel.
fn multipath(options: &Options, plan: &Plan, directions: usize) -> Result<()> {
    let sounder = Sounder::new(plan.geometry(), f64::from(plan.rate_hz()), RECORD, AmbientField::Independent);
    let header = "snr_db,segments,az_deg,az_stated,el_deg,el_stated,ellipse_%";
    let mut report = CsvReport::new("bearing_multipath", header);
    if !options.json {
        println!("with the surface's image: vessels 4 m deep, 200 to 1000 m away, array 168 m deep");
    }
    for snr_db in SNR_DB {
        let trial = |n| {
            let seed = options.seed.wrapping_mul(2_000_003).wrapping_add(n as u64);
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let azimuth = rng.random_range(0.0..std::f64::consts::TAU);
            let range_m = rng.random_range(200.0..1000.0);
            let (elevation, paths) = surfaced(plan.geometry(), azimuth, range_m);
            let mut desk = sounder.desk();
            let frames = sounder.record_paths(&mut desk, seed ^ 0x5eab_0000, NOISE_CODES, &[(snr_db, paths)]);
            let mut errors = Errors::default();
            for b in bearings(plan, frames).iter().filter(|b| b.flags & 2 == 0 && b.band == 0) {
                errors.take(b, azimuth, elevation);
            }
            errors
        };
        let e = (0..directions).into_par_iter().map(trial).reduce(Errors::default, Errors::add);
        let n = e.n.max(1) as f64;
        let deg = |x: f64| (x / n).sqrt().to_degrees();
        report.row(&[
            snr_db,
            e.n as f64,
            deg(e.azimuth2),
            deg(e.stated_azimuth2),
            deg(e.elevation2),
            deg(e.stated_elevation2),
            100.0 * e.within_ellipse as f64 / n,
        ]);
    }
    report.finish(options)
}

/// Noise alone: how many bearings?
fn false_alarms(options: &Options, seconds: f64) -> Result<()> {
    let mut report =
        CsvReport::new("false_alarms", "ambient,allowed_per_hour,hours,segments,bearings,greatest");
    if !options.json {
        println!(
            "false alarms; ambient noise: 0 independent, 1 isotropic, 2 surface-generated (both coherent)"
        );
    }
    // The last row allows many, so that the stated rate itself can be seen to hold (it is an upper bound: segments
    // overlap by half, and the expected Euler characteristic is above the probability where that is not small).
    let cases = [
        (0u8, AmbientField::Independent, 0.5, seconds),
        (1, AmbientField::Isotropic, 0.5, seconds),
        (2, AmbientField::Surface, 0.5, seconds),
        (0, AmbientField::Independent, OFTEN_PER_HOUR, seconds / 4.0),
    ];
    for (kind, ambient, allowed, seconds) in cases {
        let mut config = station();
        if let Kind::Array(array) = &mut config.kind {
            array.false_alarms_per_hour = allowed;
        }
        let plan = &Plan::new(&config)?;
        let sounder = Sounder::new(plan.geometry(), f64::from(plan.rate_hz()), RECORD, ambient);
        let records = (seconds / sounder.seconds()).ceil() as usize;
        let bar = progress::bar(records as u64, "noise records");
        let found: Vec<f32> = (0..records)
            .into_par_iter()
            .map_init(
                || sounder.desk(),
                |desk, n| {
                    let seed = options
                        .seed
                        .wrapping_mul(7_368_787)
                        .wrapping_add((kind as usize * records + n) as u64);
                    let frames = sounder.record_on(desk, seed, NOISE_CODES, None);
                    bar.inc(1);
                    bearings(plan, frames).into_iter().map(|b| b.statistic).collect::<Vec<_>>()
                },
            )
            .flatten_iter()
            .collect();
        bar.finish_and_clear();
        let hours = records as f64 * sounder.seconds() / 3600.0;
        if allowed < 1.0 {
            let name = ["independent", "isotropic", "surface-generated"][usize::from(kind)];
            options.figures.at_most(
                format!("bearings an hour in {name} noise"),
                found.len() as f64 / hours,
                1.0,
            );
        }
        report.row(&[
            f64::from(kind),
            allowed,
            hours,
            hours * 7200.0,
            found.len() as f64,
            f64::from(found.iter().copied().fold(0.0, f32::max)),
        ]);
    }
    report.finish(options)
}

fn one_direction(plan: &Plan, sounder: &Sounder, desk: &mut Desk, seed: u64, snr_db: f64) -> Errors {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let azimuth = rng.random_range(0.0..std::f64::consts::TAU);
    let elevation = rng.random_range(-20f64..70.0).to_radians();
    let arrivals = exact_arrivals(plan.geometry(), azimuth, elevation, RANGE_M);
    let frames = sounder.record_on(desk, seed ^ 0x5eab_0000, NOISE_CODES, Some((snr_db, arrivals)));
    let band = plan.band_hz();
    let band = (f64::from(band.0), f64::from(band.1));
    let snr = 10f64.powf(snr_db / 10.0);
    let information = limit::arrival_information(4, band, 1.0, |_| snr, 400);
    let mut errors = Errors { expected: (sounder.seconds() / 0.5) as usize - 1, ..Errors::default() };
    let Some(bound) = limit::angle_limit(plan.geometry(), azimuth, elevation, 1.0 / RANGE_M, information)
    else {
        return errors;
    };
    // Whole segments only: the limit is for one second.
    // The limit is that of a known distance.
    let place = Some((azimuth as f32, RANGE_M as f32, 0.0));
    for b in bearings_from(plan, place, frames).iter().filter(|b| b.flags & 2 == 0 && b.band == 0) {
        errors.take(b, azimuth, elevation);
        errors.limit_azimuth2 += bound.var_azimuth;
        errors.limit_elevation2 += bound.var_elevation;
    }
    errors
}
