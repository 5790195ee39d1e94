//! `reproduce orient-geometry`: hydrophones 1 and 3 cm from where they are said to be, and one pass of a vessel of known track: how well
//! does `orient --geometry` mend them, and does what it states hold?
//!
//! Every trial has an array of its own, turned and leaning, with displaced hydrophones, another speed of sound, a clock that is off
//! and a track that lies beside the vessel's, each by a normal number of the standard deviation that is told. The vessel, 2 to 8 m deep, is
//! heard with its image in the surface, 10 dB above the noise at its closest, at 16 kHz; delays are measured in what the hydrophones record.
//! It passes 60 to 200 m away and then turns by a right angle; in the second half of the table it goes straight on. A position's error is
//! that of the shape: the true positions are brought to the configured ones by a rigid motion first, because a turn of all hydrophones is the
//! orientation, which is judged by itself.

use super::figure::{Bar, Figures};
use super::report::CsvReport;
use super::sea::{Held, RATE_HZ, ferry, scenario, station};
use super::sea_moving::MovingSea;
use super::{Experiment, Options};
use crate::course::VesselCourse;
use crate::orientation::measured_delays::Measurer;
use crate::orientation::mend::{WANTED_M, image_m2, mend, untold};
use crate::progress;
use crate::scenario::{Side, Straight};
use crate::world::scenario::{AmbientSpectrum, ArrayVessel, Water};
use anyhow::{Result, bail};
use nalgebra::{Rotation3, SMatrix, SVector, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use seabearing_core::block::Block;
use seabearing_core::config::{Kind, StationConfig};
use seabearing_locate::network::known_track::TrackPoint;
use seabearing_locate::orient::geometry::{Doubts, Mended, aligned};
use std::path::Path;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "orient-geometry",
    about: "positions 1 and 3 cm off, mended from one pass of a known vessel: to 2 mm, and as well as stated",
    run,
};

const DURATION_S: f64 = 240.0;
const SNR_DB: f64 = 10.0;
const SPEED_M_S: f64 = 5.0;
/// Radius of the turn, metres.
const TURN_M: f64 = 60.0;
/// What the trials draw by, and tell: speed of sound, track, clock; and what is told of the height.
const DOUBTS: Doubts = Doubts {
    position_m: 0.0,
    sound_speed_m_s: 1.0,
    track_m: 1.0,
    height_m: 3.0,
    clock_s: 0.3,
    image_m2: 0.0,
};
/// A chi-square of six that 95 % stay below.
const ELLIPSOID: f64 = 12.592;

/// What one trial came to.
struct Trial {
    /// Root mean squares of the coordinates' errors and of their stated deviations, metres.
    rms_m: f64,
    stated_m: f64,
    /// Error before, metres.
    before_m: f64,
    /// Coordinates within 1.96 of their deviations, and whether the ellipsoid holds the truth.
    coordinates: Held,
    inside: bool,
    untold: f64,
    /// Whether a line says that the pass does not tell 2 mm.
    said: bool,
    /// The turn's error (absolute, about East, North and Up) within 1.96 of its deviations.
    turn: Held,
}

/// The course, and what is told of it.
struct Known {
    vessel: ArrayVessel,
    track: Vec<TrackPoint>,
}

/// A course past the array that turns, or not; its file in a folder where it turns.
fn course(rng: &mut ChaCha8Rng, turns: bool, folder: &Path, name: &str) -> Result<ArrayVessel> {
    let straight = Straight {
        cpa_time_s: 0.5 * DURATION_S,
        cpa_range_m: rng.random_range(60.0..200.0),
        heading_deg: rng.random_range(0.0..360.0),
        speed_m_s: SPEED_M_S,
        side: if rng.random() { Side::Port } else { Side::Starboard },
    };
    let vessel = ArrayVessel { depth_m: rng.random_range(2.0..8.0), ..ferry(straight) };
    if !turns {
        return Ok(vessel);
    }
    let begins_s = straight.cpa_time_s + rng.random_range(0.0..20.0);
    let hand = if rng.random() { 1.0 } else { -1.0 };
    let (mut x, mut y) = VesselCourse::straight(&straight).position(0.0);
    let mut heading = straight.heading_deg.to_radians();
    let ends = heading + hand * std::f64::consts::FRAC_PI_2;
    let mut text = String::from("t_s,x_m,y_m\n");
    const STEP_S: f64 = 0.5;
    for k in 0..=(DURATION_S / STEP_S) as usize {
        let t_s = k as f64 * STEP_S;
        text += &format!("{t_s},{x:.4},{y:.4}\n");
        if t_s >= begins_s && hand * (ends - heading) > 0.0 {
            heading += hand * SPEED_M_S * STEP_S / TURN_M;
        }
        x += SPEED_M_S * STEP_S * heading.sin();
        y += SPEED_M_S * STEP_S * heading.cos();
    }
    let path = folder.join(format!("{name}.csv"));
    crate::atomic::write(&path, text.as_bytes())?;
    Ok(ArrayVessel { straight: None, track: Some(path), ..vessel })
}

fn known(vessel: ArrayVessel, up_m: f64, off: [f64; 2], late_s: f64) -> Result<Known> {
    let course = vessel.course(None)?;
    let track = (0..=(DURATION_S * 2.0) as usize)
        .map(|k| {
            let t_s = 0.5 * k as f64;
            let (x, y) = course.position(t_s + late_s);
            TrackPoint { t_s, position_m: [x - off[0], y - off[1], up_m] }
        })
        .collect();
    Ok(Known { vessel, track })
}

fn trial(sd_m: f64, turns: bool, seed: u64, folder: &Path) -> Result<Trial> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let normal = |rng: &mut ChaCha8Rng| -> f64 { StandardNormal.sample(rng) };
    let depth_m = rng.random_range(60.0..168.0);
    let said = station(RATE_HZ, depth_m, |array| {
        array.position_sd_m = sd_m;
        array.sound_speed_sd_m_s = DOUBTS.sound_speed_m_s;
    });
    let Kind::Array(array) = &said.kind else { bail!("an array") };
    let mut displaced = array.hydrophones_m;
    displaced.iter_mut().flatten().for_each(|x| *x += sd_m * normal(&mut rng));
    // The array leans, and looks anywhere.
    let lean = [normal(&mut rng), normal(&mut rng)].map(|x| 0.05 * x);
    let heading = rng.random_range(0.0..std::f64::consts::TAU);
    let turn = Rotation3::new(Vector3::new(lean[0], lean[1], 0.0))
        * Rotation3::from_axis_angle(&Vector3::z_axis(), -heading);
    let placed = displaced.map(|h| (turn * Vector3::from(h)).into());
    let mut built: StationConfig = station(RATE_HZ, depth_m, |array| array.hydrophones_m = placed);
    built.sound_speed_m_s = said.sound_speed_m_s + DOUBTS.sound_speed_m_s * normal(&mut rng);
    let off = [normal(&mut rng), normal(&mut rng)].map(|x| DOUBTS.track_m * x);
    let late_s = DOUBTS.clock_s * normal(&mut rng);
    // Vessel and image are heard from the surface between them.
    let vessel = course(&mut rng, turns, folder, &format!("course-{seed}"))?;
    let Known { vessel, track } = known(vessel, depth_m, off, late_s)?;
    let file = vessel.track.clone();
    let mut scene = scenario(built, Water::default(), vec![vessel], DURATION_S, seed);
    scene.scene.ambient =
        AmbientSpectrum { snr_at_cpa_db: Some(SNR_DB), diffuse_share: 0.5, ..AmbientSpectrum::default() };
    let frames: Vec<_> = MovingSea::new(&scene)?.collect();
    let doubts = Doubts { image_m2: image_m2(array), ..DOUBTS };
    let mut measurer = Measurer::new(&said, array);
    measurer.take(&Block { first_index: 0, frames: &frames });
    let (found, _) = mend(&said, &measurer.finish(), &track, 10.0, &doubts)?;
    if let Some(file) = file {
        std::fs::remove_file(file)?;
    }
    Ok(judge(&found, &displaced, &array.hydrophones_m, &turn))
}

fn judge(found: &Mended, displaced: &[[f64; 3]; 4], said: &[[f64; 3]; 4], turn: &Rotation3<f64>) -> Trial {
    let (truth, before) = (aligned(displaced, said), aligned(said, said));
    let flat = |h: &[[f64; 3]; 4]| SVector::<f64, 12>::from_iterator(h.iter().flatten().copied());
    let error = flat(&found.position_m) - flat(&truth);
    let covariance = SMatrix::<f64, 12, 12>::from(found.covariance_m2);
    let mut coordinates = Held::default();
    for k in 0..12 {
        coordinates.take(error[k].abs() <= 1.96 * covariance[(k, k)].sqrt());
    }
    // A rigid motion has no variance: six of the twelve.
    let eigen = covariance.symmetric_eigen();
    let mut order: Vec<usize> = (0..12).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let chi2: f64 = order[..6]
        .iter()
        .map(|k| eigen.eigenvectors.column(*k).dot(&error).powi(2) / eigen.eigenvalues[*k])
        .sum();
    // The turn that brings the configured frame to where the displaced hydrophones are.
    let rms = |v: &SVector<f64, 12>| (v.norm_squared() / 12.0).sqrt();
    let absolute = displaced.map(|h| (turn * Vector3::from(h)).into());
    let place = truth.map(|h| {
        let row = |r: &[f64; 3]| r.iter().zip(&h).map(|(a, b)| a * b).sum::<f64>();
        [row(&found.matrix[0]), row(&found.matrix[1]), row(&found.matrix[2])]
    });
    let mut turned = Held::default();
    for (error, sd) in turn_between(&place, &about(&absolute)).iter().zip(&found.sd_turn) {
        turned.take(error.abs() <= 1.96 * sd);
    }
    Trial {
        rms_m: rms(&error),
        stated_m: found.sd_m.0,
        before_m: rms(&(flat(&before) - flat(&truth))),
        coordinates,
        inside: chi2 <= ELLIPSOID,
        untold: found.untold,
        said: untold(found).is_some(),
        turn: turned,
    }
}

/// Places about their centroid.
fn about(h: &[[f64; 3]; 4]) -> [[f64; 3]; 4] {
    let mean = |k: usize| h.iter().map(|h| h[k]).sum::<f64>() / 4.0;
    let centre = [mean(0), mean(1), mean(2)];
    h.map(|h| [h[0] - centre[0], h[1] - centre[1], h[2] - centre[2]])
}

/// The small turn (radians about East, North, Up) that brings places to others of the same shape.
fn turn_between(from: &[[f64; 3]; 4], to: &[[f64; 3]; 4]) -> [f64; 3] {
    let mut cross = nalgebra::Matrix3::zeros();
    for (a, b) in from.iter().zip(to) {
        cross += Vector3::from(*b) * Vector3::from(*a).transpose();
    }
    let turn = Rotation3::from_matrix(&cross);
    turn.scaled_axis().into()
}

fn run(options: &Options) -> Result<()> {
    let runs = options.runs.unwrap_or(30);
    let mut report = CsvReport::new(
        "orient_geometry",
        "sd_m,turns,trials,before_mm,rms_mm,worst_mm,stated_mm,untold,coordinates_%,ellipsoid_%,turn_%",
    );
    let bar = progress::bar(4 * runs as u64, "passes");
    for (turns, way) in [(true, "turning"), (false, "straight")] {
        for (sd_m, name) in [(0.01, "1 cm"), (0.03, "3 cm")] {
            let trials = (0..runs as u64)
                .into_par_iter()
                .map(|n| {
                    bar.inc(1);
                    let seed = options.seed.wrapping_mul(31_000_003) + 4 * n + 2 * u64::from(turns);
                    trial(sd_m, turns, seed + u64::from(sd_m > 0.02), &options.out)
                })
                .collect::<Result<Vec<_>>>()?;
            let n = trials.len() as f64;
            let (mut inside, mut coordinates, mut turned) =
                (Held::default(), Held::default(), Held::default());
            for t in &trials {
                inside.take(t.inside);
                coordinates.join(t.coordinates);
                turned.join(t.turn);
            }
            let rms_mm =
                |of: fn(&Trial) -> f64| 1e3 * (trials.iter().map(|t| of(t).powi(2)).sum::<f64>() / n).sqrt();
            let worst_mm = 1e3 * trials.iter().fold(0.0f64, |a, t| a.max(t.rms_m));
            let untold = trials.iter().map(|t| t.untold).sum::<f64>() / n;
            report.row(&[
                sd_m,
                f64::from(u8::from(turns)),
                n,
                rms_mm(|t| t.before_m),
                rms_mm(|t| t.rms_m),
                worst_mm,
                rms_mm(|t| t.stated_m),
                untold,
                coordinates.percent(),
                inside.percent(),
                turned.percent(),
            ]);
            let figures: &Figures = &options.figures;
            let what = format!("{way}, {name}");
            figures.report(
                format!("{what}: rms of position errors, mm"),
                rms_mm(|t| t.rms_m),
                if turns { Bar::AtMost(1e3 * WANTED_M) } else { Bar::None },
            );
            if !turns {
                let said = trials.iter().filter(|t| t.said).count() as f64;
                figures.at_least(format!("{what}: said not to be told, %"), 100.0 * said / n, 100.0);
            }
            inside.report(figures, &format!("{what}: shape in its 95 % ellipsoid"));
            figures.report(
                format!("{what}: coordinates in their 95 %, % of {}", coordinates.of),
                coordinates.percent(),
                Bar::Within(92.0, 97.0),
            );
            figures.state(format!("{what}: turns in their 95 %, % of {}", turned.of), turned.percent());
        }
    }
    bar.finish_and_clear();
    report.finish(options)
}
