//! `seabearing config check` of a list of stations: what accuracy to expect of positions and passages, printed and drawn.

use super::config::{CheckArgs, print};
use super::mistake;
use crate::bounds::network::{Bearings, Passage, at, centre, passage};
use crate::bounds::picture;
use crate::orientation::network_file::Network;
use crate::orientation::over_time::SOURCE_DEPTH_M;
use crate::orientation::unchecked;
use anyhow::{Context, Result, bail};
use seabearing_core::angle::RAD_PER_DEG;
use seabearing_core::kit::median;
use serde_json::{Value, json};

/// Directions from the centre over which accuracies are stated.
const DIRECTIONS: usize = 36;
/// Ranges from the centre at which they are, shares of the largest.
const SHARES: [f64; 5] = [0.1, 0.25, 0.5, 0.75, 1.0];

/// Largest standard deviation of an angle that still is a bearing, degrees.
const LARGEST_SIGMA_DEG: f64 = 60.0;
/// Stations nearer to each other than this are at the same place, metres.
const SAME_PLACE_M: f64 = 0.5;

/// Refuses what no network can be: one number for two stations, two at one place, a source not above them.
fn sound(network: &Network, depth_m: f64) -> Result<()> {
    let Network { stations, arrays_m, .. } = network;
    for (i, s) in stations.iter().enumerate() {
        for (j, other) in stations.iter().enumerate().skip(i + 1) {
            // Stations without a number go by their names.
            if s.id == other.id && s.id != 0 {
                bail!(
                    "stations {} and {} of the list both have the number {}: give each `id` once",
                    i + 1,
                    j + 1,
                    s.id
                );
            }
            let apart_m =
                arrays_m[i].iter().zip(&arrays_m[j]).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
            if apart_m < SAME_PLACE_M {
                bail!(
                    "stations {} and {} are at the same place: two bearings from one place do not cross; mend a `position`",
                    s.id,
                    other.id
                );
            }
        }
        if depth_m >= -arrays_m[i][2] {
            bail!(
                "--depth-m {depth_m} is not above station {}, which is {:.1} m deep: expected is what is heard of a source above the arrays",
                s.id,
                -arrays_m[i][2]
            );
        }
    }
    Ok(())
}

/// Checks the list and says what to expect.
///
/// # Errors
/// One line for a person.
pub fn run(args: &CheckArgs) -> Result<()> {
    let sigma_azimuth_deg = args.sigma_azimuth_deg.unwrap_or(1.5);
    let sigma_elevation_deg = args.sigma_elevation_deg.unwrap_or(1.6);
    let depth_m = args.depth_m.unwrap_or(SOURCE_DEPTH_M);
    let max_range_m = args.max_range_m.unwrap_or(2000.0);
    let every_s = args.every_s.unwrap_or(10.0);
    for (key, x) in [
        ("sigma-azimuth-deg", sigma_azimuth_deg),
        ("sigma-elevation-deg", sigma_elevation_deg),
        ("max-range-m", max_range_m),
        ("speed", args.speed_m_s()),
        ("minutes", args.minutes()),
        ("every-s", every_s),
    ] {
        if !(x > 0.0 && x.is_finite()) {
            mistake!("--{key} is {x}; a positive number is needed");
        }
    }
    if !(depth_m >= 0.0 && depth_m.is_finite()) {
        mistake!("--depth-m is {depth_m}; 0 (the surface) or a depth below it is needed");
    }
    for (key, sigma_deg) in [("azimuth", sigma_azimuth_deg), ("elevation", sigma_elevation_deg)] {
        if sigma_deg > LARGEST_SIGMA_DEG {
            mistake!("--sigma-{key}-deg is {sigma_deg}; at most {LARGEST_SIGMA_DEG} degrees are a bearing");
        }
    }
    let pass = Passage { speed_m_s: args.speed_m_s(), duration_s: 60.0 * args.minutes(), every_s };
    if !(pass.duration_s / pass.every_s <= 1000.0) {
        mistake!(
            "--minutes {} with --every-s {}: at most 1000 bearings of a passage",
            args.minutes(),
            every_s
        );
    }
    let network = Network::read(&args.station)?;
    sound(&network, depth_m).with_context(|| format!("{}", args.station.display()))?;
    let of = Bearings {
        sd_azimuth: sigma_azimuth_deg * RAD_PER_DEG,
        sd_elevation: sigma_elevation_deg * RAD_PER_DEG,
        depth_m,
    };
    let record = record(&network, &of, &pass, max_range_m);
    if let Some(said) = unchecked::of_stations(network.stations.len()) {
        log::warn!("{said}");
    }
    if let Some(folder) = &args.plots {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot make folder {}", folder.display()))?;
        picture::map(&network, &of, &pass, max_range_m, &folder.join("accuracy.svg"))?;
    }
    if args.json {
        println!("{record}");
    } else {
        print(&record);
        println!("the list of stations is valid");
    }
    Ok(())
}

fn record(network: &Network, of: &Bearings, pass: &Passage, half_m: f64) -> Value {
    let stations: Vec<Value> = network
        .stations
        .iter()
        .enumerate()
        .map(|(i, s)| {
            let [x, y, _] = network.arrays_m[i];
            json!({
                "station": s.id, "name": s.name.as_str(), "x_m": x, "y_m": y, "depth_m": s.depth_m,
                "orientation_deg": s.orientation_deg, "orientation_sd_deg": network.sd_orientation[i] / RAD_PER_DEG,
                "clock_sd_s": network.shared(&[])[i].clock_s,
            })
        })
        .collect();
    let places = &network.arrays_m;
    let apart = |i: usize, j: usize| (places[i][0] - places[j][0]).hypot(places[i][1] - places[j][1]);
    let pairs: Vec<Value> = (0..places.len())
        .flat_map(|i| (i + 1..places.len()).map(move |j| (i, j)))
        .map(|(i, j)| {
            json!({"pair": format!("{} {}", network.stations[i].id, network.stations[j].id), "separation_m": apart(i, j)})
        })
        .collect();
    let [x0, y0] = centre(network);
    let rows: Vec<Value> = SHARES.iter().map(|share| row(network, of, pass, share * half_m)).collect();
    json!({
        "type": "network", "stations": stations, "pairs": pairs, "centre_m": [x0, y0],
        "azimuths_alone_checked": unchecked::of_stations(network.stations.len()).is_none(),
        "sigma_azimuth_deg": of.sd_azimuth / RAD_PER_DEG, "sigma_elevation_deg": of.sd_elevation / RAD_PER_DEG,
        "source_depth_m": of.depth_m, "speed_m_s": pass.speed_m_s, "passage_s": pass.duration_s, "every_s": pass.every_s,
        "expected_accuracy": rows,
    })
}

/// Medians over the directions from the centre; null where more than half of them tell nothing.
fn row(network: &Network, of: &Bearings, pass: &Passage, range_m: f64) -> Value {
    let [x0, y0] = centre(network);
    let places: Vec<[f64; 2]> = (0..DIRECTIONS)
        .map(|k| {
            let (s, c) = (std::f64::consts::TAU * (k as f64 + 0.5) / DIRECTIONS as f64).sin_cos();
            [x0 + range_m * s, y0 + range_m * c]
        })
        .collect();
    let positions: Vec<_> = places.iter().map(|p| at(network, of, pass.speed_m_s, *p)).collect();
    let [ways, alone] = [true, false].map(|elevations| -> Vec<_> {
        places.iter().map(|p| passage(network, of, pass, elevations, *p)).collect()
    });
    let middle = |of: Vec<Option<f64>>, unit: f64| -> Value {
        let mut all: Vec<f64> = of.into_iter().map(|x| x.unwrap_or(f64::INFINITY)).collect();
        crate::record::finite(median(&mut all).unwrap_or(f64::INFINITY) / unit)
    };
    let angles = RAD_PER_DEG;
    json!({
        "range_m": range_m,
        "sd_position_m": middle(positions.iter().map(|p| p.position_m).collect(), 1.0),
        "sd_azimuths_alone_m": middle(positions.iter().map(|p| p.azimuths_m).collect(), 1.0),
        "sd_depth_unknown_m": middle(positions.iter().map(|p| p.free_m).collect(), 1.0),
        "sd_range_m": middle(positions.iter().map(|p| p.polar.map(|p| p.1)).collect(), 1.0),
        "sd_azimuth_deg": middle(positions.iter().map(|p| p.polar.map(|p| p.0)).collect(), angles),
        "sd_passage_m": middle(ways.iter().map(|w| w.map(|w| w.position_m)).collect(), 1.0),
        "sd_heading_deg": middle(ways.iter().map(|w| w.map(|w| w.heading)).collect(), angles),
        "sd_passage_azimuths_alone_m": middle(alone.iter().map(|w| w.map(|w| w.position_m)).collect(), 1.0),
        "sd_heading_azimuths_alone_deg": middle(alone.iter().map(|w| w.map(|w| w.heading)).collect(), angles),
        "sd_speed_m_s": middle(ways.iter().map(|w| w.map(|w| w.speed_m_s)).collect(), 1.0),
    })
}
