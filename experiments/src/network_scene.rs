//! Paper N, figures 1, 4 and 5: where arrays and simulated sources are, one vessel's bearings beside those of its antenna
//! as reported and put back, and where 204 vessels were heard.
//!
//! Figure 1 is drawn from the paper's own coordinates. The recordings and AIS behind figures 4 and 5 are not at hand: the
//! vessel of figure 4 passes at 7 m/s with its propeller 7 s behind its antenna (a way of 49 m), heard by the first
//! array as [N 21] would, 1.5° and 1.6°; where the vessels of figure 5 were is part of `network-vessels`, whose tracks
//! its cells count. The paper prints no number of either.

use super::network::{SIGMA, THREE, TWO, sight};
use super::{Experiment, Options};
use crate::plot::{Plot, write_panels};
use anyhow::{Result, anyhow};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_locate::network::align::{AlignSettings, TimedBearing, align};
use seabearing_locate::network::known_track::{TrackPoint, position_at};
use seabearing_locate::network::model::bearing;

/// The experiment.
pub const EXPERIMENT: Experiment = Experiment {
    name: "network-scene",
    about: "paper N, figures 1 and 4: arrays and simulated sources; a vessel's bearings, its antenna's, the shift found",
    run,
};

/// How far the propeller is behind the antenna, s; the paper's figure 4 tells no value.
const SHIFT_S: f64 = 7.0;
const SPEED_M_S: f64 = 7.0;
const SOURCE_M: f64 = -5.0;
/// Half a passage, s.
const HALF_S: i32 = 60;
const VESSELS: usize = 200;

fn run(options: &Options) -> Result<()> {
    scene(options)?;
    let vessels = options.runs.unwrap_or(VESSELS);
    let (mut squares, mut standard) = (0.0, 0.0);
    for vessel in 0..vessels {
        let passage = Passage::hear(options.seed, vessel)?;
        squares += (passage.found_s - SHIFT_S).powi(2) / vessels as f64;
        standard += ((passage.found_s - SHIFT_S) / passage.sd_s).powi(2) / vessels as f64;
        if vessel == 0 {
            passage.draw(options)?;
            let figures = &options.figures;
            let [reported, corrected] = passage.apart_deg();
            figures.state("figure 4: shift found, s (truth 7)", passage.found_s);
            figures.state("azimuths off those of the antenna as reported, RMS, deg", reported);
            figures.at_most(
                "azimuths off those of the antenna put back, RMS, deg (the paper's σ 1.5)",
                corrected,
                1.8,
            );
        }
    }
    options.figures.at_most(format!("RMSE of the shift of {vessels} vessels, s"), squares.sqrt(), 1.0);
    options.figures.state("mean squared standardised error of the shift", standard);
    Ok(())
}

/// One vessel past the first array.
struct Passage {
    heard: Vec<TimedBearing>,
    track: Vec<TrackPoint>,
    found_s: f64,
    sd_s: f64,
}

impl Passage {
    fn hear(seed: u64, vessel: usize) -> Result<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(vessel as u64);
        let (s, c) = (120.0 * RAD_PER_DEG).sin_cos();
        let along = |t_s: f64| [SPEED_M_S * t_s * s + 80.0 * c, SPEED_M_S * t_s * c - 80.0 * s, SOURCE_M];
        let track: Vec<TrackPoint> = (-HALF_S / 5 - 4..=HALF_S / 5 + 4)
            .map(|k| TrackPoint { t_s: 5.0 * f64::from(k), position_m: along(5.0 * f64::from(k)) })
            .collect();
        let heard: Vec<TimedBearing> = (-HALF_S..=HALF_S)
            .map(|k| {
                let t_s = f64::from(k);
                let seen = sight(&TWO[..1], &along(t_s - SHIFT_S), &mut rng)[0];
                TimedBearing { t_s, azimuth: Some(seen.azimuth), elevation: seen.elevation }
            })
            .collect();
        let settings =
            AlignSettings { array_m: TWO[0], sd: [SIGMA.0, SIGMA.1], largest_shift_s: 20.0, gap_s: 60.0 };
        let found = align(&heard, &track, &settings).map_err(|e| anyhow!("{e}"))?;
        Ok(Self { heard, track, found_s: found.shift_s, sd_s: found.sd_s })
    }

    /// Direction of the antenna so much earlier, radians.
    fn antenna(&self, t_s: f64) -> Option<(f64, f64)> {
        Some(bearing(&TWO[0], &position_at(&self.track, t_s, 60.0)?))
    }

    /// Root-mean-square difference of azimuths from the antenna's as reported and as put back by the shift, degrees.
    fn apart_deg(&self) -> [f64; 2] {
        [0.0, self.found_s].map(|shift_s| {
            let apart = self
                .heard
                .iter()
                .filter_map(|h| Some(wrap_pi(h.azimuth? - self.antenna(h.t_s - shift_s)?.0) / RAD_PER_DEG));
            super::score::rms(apart)
        })
    }

    fn draw(&self, options: &Options) -> Result<()> {
        type Angle = fn((f64, f64)) -> f64;
        type Measured = fn(&TimedBearing) -> Option<f64>;
        let angles: [(&str, Angle, Measured); 2] =
            [("azimuth (°)", |b| b.0, |h| h.azimuth), ("elevation (°)", |b| b.1, |h| h.elevation)];
        let mut panels = Vec::new();
        for (label, of, measured) in angles {
            let degrees = |x: f64| {
                if label.starts_with('a') { (x / RAD_PER_DEG).rem_euclid(360.0) } else { x / RAD_PER_DEG }
            };
            let curve = |shift_s: f64| -> Vec<(f64, f64)> {
                let at = |h: &TimedBearing| Some((h.t_s, degrees(of(self.antenna(h.t_s - shift_s)?))));
                self.heard.iter().filter_map(at).collect()
            };
            let mut figure = Plot::new("Bearings and the antenna (paper N, figure 4)", "time (s)", label);
            figure.size(520, 360);
            let points =
                self.heard.iter().filter_map(|h| Some((h.t_s, degrees(measured(h)?)))).collect::<Vec<_>>();
            figure.points("measured", &points);
            figure.dashed("antenna as reported", &curve(0.0));
            figure.truth("antenna put back", &curve(self.found_s));
            panels.push(figure);
        }
        write_panels(&options.out.join("network-scene-bearings.svg"), &panels.iter().collect::<Vec<_>>(), 2)
    }
}

/// Figure 1: the arrays of both networks and the eleven sources.
fn scene(options: &Options) -> Result<()> {
    let flat = |places: &[[f64; 3]]| places.iter().map(|p| (p[0], p[1])).collect::<Vec<_>>();
    let (s, c) = (-5.0 * RAD_PER_DEG).sin_cos();
    let sources: Vec<(f64, f64)> = (0..=10).map(|k| 100.0 * f64::from(k)).map(|r| (r * s, r * c)).collect();
    let mut figure = Plot::map("Arrays and simulated sources (paper N, figure 1)");
    figure.points("network of two arrays", &flat(&TWO));
    figure.points("hypothetical network of three", &flat(&THREE));
    figure.points("simulated sources", &sources);
    figure.write(&options.out.join("network-scene.svg"))?;
    let widest = |places: &[[f64; 3]]| {
        let apart = |a: &[f64; 3], b: &[f64; 3]| (a[0] - b[0]).hypot(a[1] - b[1]);
        places.iter().flat_map(|a| places.iter().map(move |b| apart(a, b))).fold(0.0, f64::max)
    };
    options.figures.state("figure 1: aperture of two arrays, m (the paper's 43)", widest(&TWO));
    options.figures.state("figure 1: aperture of three arrays, m (the paper's 173)", widest(&THREE));
    Ok(())
}
