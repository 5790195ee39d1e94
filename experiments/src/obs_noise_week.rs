//! A week without vessels: whales, earthquakes, T phases, strumming and directional ambient noise.
//!
//! Counts tracks and faults of the set-up (there must be none), windows with a range, and azimuth detections, each attributed to the sound that was there (in its
//! time, nearest in direction and within 30°; strumming either way along its axis) or to nothing. A tonal azimuth is told as a vessel's: those of earthquakes, T phases and strumming count as of
//! nothing as well. `--runs` is the number of days.

use super::obs_world::{Case, print, quiet, station_table};
use super::{Experiment, Options};
use crate::csv::CsvText;
use crate::ocean_bottom::event::HeardEvent;
use crate::ocean_bottom::scenario::{Burst, DirectionalTable, ObsScenario, Strumming, Whale};
use anyhow::Result;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use seabearing_core::angle::wrap_pi;
use seabearing_core::wire::Message;
use std::f64::consts::PI;

/// The experiment.
pub const NOISE_WEEK: Experiment = Experiment {
    name: "obs-noise-week",
    about: "a week of whales, earthquakes, T phases, strumming and directional noise without a vessel: false detections",
    run,
};

const DAY_S: f64 = 86_400.0;

/// A window reaches 90 s to either side; arrivals over late paths trail for about a minute.
const SLACK_S: f64 = 180.0;

/// Days without a vessel.
pub fn scenario(seed: u64, days: usize) -> ObsScenario {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut s = quiet(seed, days as f64 * DAY_S);
    s.ambient.directional = vec![
        DirectionalTable { azimuth_deg: 90.0, level_db: -3.0 },
        DirectionalTable { azimuth_deg: 215.0, level_db: -6.0 },
    ];
    for day in 0..days {
        let day_s = day as f64 * DAY_S;
        for _ in 0..3 {
            s.fin_whale.push(Whale {
                azimuth_deg: rng.random_range(0.0..360.0),
                range_m: rng.random_range(1_000.0..25_000.0),
                start_s: day_s + rng.random_range(0.0..DAY_S),
                duration_s: rng.random_range(1_800.0..14_400.0),
                interval_s: rng.random_range(11.0..16.0),
                level_db: rng.random_range(6.0..24.0),
            });
        }
        s.blue_whale.push(Whale {
            azimuth_deg: rng.random_range(0.0..360.0),
            range_m: rng.random_range(3_000.0..40_000.0),
            start_s: day_s + rng.random_range(0.0..DAY_S),
            duration_s: rng.random_range(3_600.0..14_400.0),
            interval_s: rng.random_range(60.0..70.0),
            level_db: rng.random_range(0.0..12.0),
        });
        let bursts =
            [(&mut s.earthquake, 6, 30.0..240.0, 6.0..40.0), (&mut s.t_phase, 3, 60.0..400.0, 0.0..15.0)];
        for (list, count, duration_s, level_db) in bursts {
            list.extend((0..count).map(|_| Burst {
                azimuth_deg: rng.random_range(0.0..360.0),
                start_s: day_s + rng.random_range(0.0..DAY_S),
                duration_s: rng.random_range(duration_s.clone()),
                level_db: rng.random_range(level_db.clone()),
            }));
        }
        // Twice a day the tide runs.
        for tide in 0..2 {
            s.strumming.push(Strumming {
                azimuth_deg: rng.random_range(0.0..180.0),
                start_s: day_s + 44_700.0 * f64::from(tide) + rng.random_range(0.0..3_600.0),
                duration_s: rng.random_range(5_400.0..14_400.0),
                fundamental_hz: rng.random_range(1.2..4.0),
                level_db: rng.random_range(10.0..30.0),
                pressure_db: -30.0,
            });
        }
    }
    s
}

/// The kind of sound a detection belongs to: of those there at that time the one nearest in direction, if within 30°.
fn attribute(heard: &[HeardEvent], t_s: f64, azimuth: f64) -> Option<&'static str> {
    let then = heard.iter().filter(|h| (h.from_s - SLACK_S..h.to_s + SLACK_S).contains(&t_s));
    let off = |h: &HeardEvent| {
        let off = wrap_pi(azimuth - h.azimuth).abs();
        if h.kind == "strumming" { off.min(PI - off) } else { off }
    };
    let nearest = then.map(|h| (off(h), h.kind)).min_by(|a, b| a.0.total_cmp(&b.0));
    nearest.filter(|(off, _)| *off < PI / 6.0).map(|(_, kind)| kind)
}

fn run(options: &Options) -> Result<()> {
    let days = options.runs.unwrap_or(7);
    let case = Case::run(scenario(options.seed, days), &station_table(options)?, Vec::new())?;
    let kinds = ["fin_whale", "blue_whale", "earthquake", "t_phase", "strumming", "nothing"];
    let (mut tonal, mut impulsive) = ([0usize; 6], [0usize; 6]);
    let (mut windows, mut ranges, mut tracks, mut segments) = (0usize, 0usize, 0usize, 0usize);
    let mut last = None;
    let mut last_range = None;
    for m in &case.messages {
        match m {
            Message::Azimuth(a) => {
                windows += usize::from(last.replace(a.index) != Some(a.index));
                let kind =
                    attribute(&case.heard, a.index as f64 / 50.0, f64::from(a.azimuth)).unwrap_or("nothing");
                let slot = kinds.iter().position(|k| *k == kind).unwrap_or(5);
                if a.detected && a.kind == 0 {
                    tonal[slot] += 1;
                } else if a.detected {
                    impulsive[slot] += 1;
                }
            }
            Message::Range(r) if r.detected => {
                ranges += usize::from(last_range.replace(r.index) != Some(r.index));
            }
            Message::Track(_) => tracks += 1,
            Message::Segment(_) => segments += 1,
            _ => {}
        }
    }
    let mut csv = CsvText::new("cause,tonal_azimuths,impulsive_azimuths");
    for ((kind, t), i) in kinds.iter().zip(tonal).zip(impulsive) {
        csv.row(&[kind, &t, &i]);
    }
    print(options, "obs-noise-week", csv)?;
    // What is told as a vessel's is of nothing whatever sound it came from: calls have a bar of their own.
    let share = |n: usize| 1e4 * n as f64 / windows.max(1) as f64;
    let of_nothing = tonal[2..].iter().sum::<usize>() + impulsive[5];
    let figures = &options.figures;
    figures.at_most("tracks", tracks as f64, 0.0);
    figures.at_most("azimuths of nothing, of 10 000 windows", share(of_nothing), 1.0);
    figures.at_most("windows with a range of nothing, of 10 000", share(ranges), 1.0);
    figures.at_most("calls of whales taken for tones", (tonal[0] + tonal[1]) as f64, 0.0);
    figures.at_most("faults named of a set-up that is as told", case.set_up_faults().len() as f64, 0.0);
    figures.state("windows", windows as f64);
    for (kind, n) in kinds.iter().zip(tonal).skip(2) {
        figures.state(format!("tonal azimuths of {}", kind.replace('_', " ")), n as f64);
    }
    figures.state("segments", segments as f64);
    Ok(())
}
