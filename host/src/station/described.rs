//! What metadata of data centres tell of ocean-bottom stations, whatever their format: chosen, checked and written as station files.
//!
//! Enters: what a file tells of stations and channels (`xml`, `dataless`). Leaves: for each ocean-bottom station
//! in it, one with a hydrophone and three components of motion at one rate, the text of a station file. Conventions, of both
//! formats: azimuth clockwise from North, dip down from the horizontal (a vertical that is positive up has −90), elevation up
//! from sea level, sensitivity in counts for the input unit. Components are renamed, not turned: "north" is the horizontal whose
//! other one lies 90° clockwise, and its azimuth the station's orientation.

use super::response::Response;
use crate::angle::wrap_deg;
use anyhow::{Context, Result, anyhow, bail};
use std::fmt::Write as _;
use time::OffsetDateTime;

/// The recorder's rate where the files have as many samples a second, Hz: that which the methods were made for [O, L].
const RECORDER_HZ: f64 = 50.0;

/// By how much horizontals may fail to be level and square to each other, degrees.
const SQUARE_DEG: f64 = 5.0;

/// Which of the stations in a file are meant; what is not said is any.
#[derive(Clone, Debug, Default)]
pub struct Wanted {
    /// Network code.
    pub network: Option<String>,
    /// Station code.
    pub station: Option<String>,
    /// Location code; `--` or nothing for the empty one.
    pub location: Option<String>,
    /// A moment at which it recorded; where none is said, the latest epoch counts.
    pub at: Option<OffsetDateTime>,
}

/// A station as a file tells it, all its channels and epochs.
#[derive(Clone, Debug, Default)]
pub(super) struct Told {
    /// Network and station code.
    pub codes: [String; 2],
    /// Latitude and longitude, degrees.
    pub lat_lon_deg: (Option<f64>, Option<f64>),
    /// Above sea level, metres.
    pub elevation_m: Option<f64>,
    /// Channels, each epoch of each.
    pub channels: Vec<Channel>,
}

/// A beginning and an end, where they are told.
pub type Epoch = (Option<OffsetDateTime>, Option<OffsetDateTime>);

/// A station that can be used.
#[derive(Clone, Debug, PartialEq)]
pub struct Described {
    /// Network and station code, `7D.FN01A`.
    pub code: String,
    /// The same with the location where all components have one.
    pub seed_id: String,
    /// Latitude and longitude, degrees.
    pub lat_lon_deg: (f64, f64),
    /// Depth below sea level, metres.
    pub depth_m: f64,
    /// Samples a second in the files.
    pub rate_hz: f64,
    /// When all of its channels began to be so, and when the first of them ceased, where that is told.
    pub epoch: Epoch,
    /// Pressure, north, east and vertical.
    pub channels: [Channel; 4],
    /// Azimuth of the component called north, degrees.
    pub orientation_of_north_deg: f64,
}

/// A channel as a file tells it, in one epoch.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Channel {
    /// Its code.
    pub code: String,
    /// Its location code.
    pub location: String,
    /// Where it points, degrees clockwise from North.
    pub azimuth_deg: Option<f64>,
    /// Down from the horizontal, degrees.
    pub dip_deg: Option<f64>,
    /// Above sea level, metres.
    pub elevation_m: Option<f64>,
    /// Samples a second.
    pub rate_hz: f64,
    /// When it began to be so.
    pub start: Option<OffsetDateTime>,
    /// When it ceased to be so.
    pub end: Option<OffsetDateTime>,
    /// Counts for a pascal or for a metre a second, where told.
    pub sensitivity: Option<f64>,
    /// What it measures.
    pub unit: String,
    /// How that depends on frequency, where told.
    pub response: Option<Response>,
}

/// The ocean-bottom stations among those told.
///
/// # Errors
/// One line: none has a hydrophone and three components of motion, and why.
pub(super) fn choose(told: Vec<Told>, wanted: &Wanted) -> Result<Vec<Described>> {
    let (mut out, mut refused) = (Vec::new(), Vec::new());
    if told.is_empty() {
        bail!("no station in it");
    }
    for station in told {
        let [n, s] = &station.codes;
        let meant = |wanted: &Option<String>, code: &str| wanted.as_deref().is_none_or(|w| w == code);
        if !meant(&wanted.network, n) || !meant(&wanted.station, s) {
            continue;
        }
        let code = format!("{n}.{s}");
        match described(&code, &station, wanted) {
            // A station told twice is one, in its latest epoch.
            Ok(d) => match out.iter_mut().find(|o: &&mut Described| o.code == d.code) {
                Some(other) if other.epoch.0 <= d.epoch.0 => *other = d,
                Some(_) => {}
                None => out.push(d),
            },
            Err(e) => refused.push(format!("{code}: {e:#}")),
        }
    }
    refused.retain(|r| !out.iter().any(|o| r.starts_with(&format!("{}:", o.code))));
    if out.is_empty() {
        match refused.len() {
            0 => bail!("no such station"),
            1 => bail!("{}", refused.remove(0)),
            n => bail!("{} ({} more stations cannot be used either)", refused.remove(0), n - 1),
        }
    }
    Ok(out)
}

fn described(code: &str, station: &Told, wanted: &Wanted) -> Result<Described> {
    let location = wanted.location.as_deref().map(|l| l.trim_matches(['-', ' ']));
    let open = |c: &Channel| {
        wanted.at.is_none_or(|at| c.start.is_none_or(|s| s <= at) && c.end.is_none_or(|e| at < e))
    };
    let meant = |c: &&Channel| location.is_none_or(|l| l == c.location) && open(c);
    let mut channels: Vec<Channel> = station.channels.iter().filter(meant).cloned().collect();
    if let (Some(at), true) = (wanted.at, channels.is_empty()) {
        let day = |t: Option<OffsetDateTime>| t.map_or("…".to_owned(), |t| t.date().to_string());
        let mut epochs: Vec<String> =
            station.channels.iter().map(|c| format!("{} to {}", day(c.start), day(c.end))).collect();
        epochs.sort_unstable();
        epochs.dedup();
        bail!("nothing is told of {}; epochs: {}", at.date(), epochs.join(", "));
    }
    // Of epochs of one channel the latest.
    channels.sort_by_key(|c| c.start);
    let mut latest: Vec<Channel> = Vec::new();
    for c in channels {
        latest.retain(|l| (&l.code, &l.location) != (&c.code, &c.location));
        latest.push(c);
    }
    let is = |c: &Channel, instrument: &str, ends: &str| {
        let mut letters = c.code.chars().skip(1);
        letters.next().is_some_and(|l| instrument.contains(l))
            && letters.next().is_some_and(|l| ends.contains(l))
    };
    let motion = |ends: &'static str| latest.iter().filter(move |c| is(c, "HL", ends));
    // Of several rates the lowest that is enough, else the highest.
    let mut verticals: Vec<&Channel> = motion("Z").collect();
    verticals.sort_by(|a, b| {
        let enough = |c: &Channel| c.rate_hz >= RECORDER_HZ;
        let rate = if enough(a) { a.rate_hz.total_cmp(&b.rate_hz) } else { b.rate_hz.total_cmp(&a.rate_hz) };
        enough(b).cmp(&enough(a)).then(rate)
    });
    let mut why = anyhow!("no vertical component (a code like BHZ)");
    for vertical in verticals {
        let beside = |c: &&Channel| {
            c.location == vertical.location
                && c.rate_hz == vertical.rate_hz
                && c.code.get(..2) == vertical.code.get(..2)
        };
        let mut first = motion("1N").filter(beside);
        let mut second = motion("2E").filter(beside);
        let pressure = latest.iter().find(|c| is(c, "D", "HFGO") && c.rate_hz == vertical.rate_hz);
        let (Some(a), Some(b)) = (first.next(), second.next()) else {
            why = anyhow!("{} has no two horizontal components beside it", vertical.code);
            continue;
        };
        let Some(pressure) = pressure else {
            why = anyhow!("no hydrophone (a code like BDH) at {} samples a second", vertical.rate_hz);
            continue;
        };
        return put_together(code, station, pressure, (a, b), vertical);
    }
    Err(why)
}

fn put_together(
    code: &str,
    station: &Told,
    pressure: &Channel,
    (a, b): (&Channel, &Channel),
    vertical: &Channel,
) -> Result<Described> {
    let azimuth = |c: &Channel| c.azimuth_deg.with_context(|| format!("{} has no azimuth", c.code));
    let (azimuth_a, azimuth_b) = (azimuth(a)?, azimuth(b)?);
    let up = match vertical.dip_deg {
        None => true,
        Some(d) if 90.0 - d.abs() <= SQUARE_DEG => d < 0.0,
        Some(d) => bail!("{} is not vertical: its dip is {d}°", vertical.code),
    };
    if !up && [a, b, vertical, pressure].iter().any(|c| c.sensitivity.is_none()) {
        bail!(
            "{} points down, and without the sensitivities of all channels it cannot be turned",
            vertical.code
        );
    }
    // Counts for upward motion: a component that points down counts it as negative.
    let vertical =
        &Channel { sensitivity: vertical.sensitivity.map(|s| if up { s } else { -s }), ..vertical.clone() };
    for c in [a, b] {
        if c.dip_deg.is_some_and(|d| d.abs() > SQUARE_DEG) {
            bail!("{} is not horizontal: its dip is {}°", c.code, c.dip_deg.unwrap_or(f64::NAN));
        }
    }
    let pressure = &in_pascals(pressure)?;
    let [a, b, vertical] = [&in_metres(a)?, &in_metres(b)?, &in_metres(vertical)?];
    // From the one to the other, clockwise.
    let between = wrap_deg(azimuth_b - azimuth_a);
    let between = if between > 180.0 { between - 360.0 } else { between };
    let (north, east, of_north) = if (between - 90.0).abs() <= SQUARE_DEG {
        (a, b, azimuth_a + 0.5 * (between - 90.0))
    } else if (between + 90.0).abs() <= SQUARE_DEG {
        (b, a, azimuth_b - 0.5 * (between + 90.0))
    } else {
        bail!("{} ({azimuth_a}°) and {} ({azimuth_b}°) are not square to each other", a.code, b.code);
    };
    let told = |number: Option<f64>, name: &str| number.with_context(|| format!("no {name}"));
    let elevation_m = told(pressure.elevation_m.or(station.elevation_m), "elevation")?;
    let (lat_deg, lon_deg) = station.lat_lon_deg;
    let one = [a, b, vertical].iter().all(|c| c.location == pressure.location);
    Ok(Described {
        seed_id: if one { format!("{code}.{}", pressure.location) } else { code.to_owned() },
        code: code.to_owned(),
        lat_lon_deg: (told(lat_deg, "latitude")?, told(lon_deg, "longitude")?),
        depth_m: -elevation_m,
        rate_hz: pressure.rate_hz,
        epoch: (
            [pressure, north, east, vertical].iter().filter_map(|c| c.start).max(),
            [pressure, north, east, vertical].iter().filter_map(|c| c.end).min(),
        ),
        channels: [pressure, north, east, vertical].map(Channel::clone),
        orientation_of_north_deg: wrap_deg(of_north),
    })
}

/// A channel of motion with its counts for a metre a second.
fn in_metres(c: &Channel) -> Result<Channel> {
    let unit = c.unit.to_ascii_lowercase().replace(' ', "");
    let metres = match unit.as_str() {
        "" | "m/s" | "m/sec" => 1.0,
        "mm/s" => 1e-3,
        "um/s" | "µm/s" => 1e-6,
        "nm/s" | "nm/sec" => 1e-9,
        _ => bail!("{} measures {}; velocity (m/s) is needed", c.code, c.unit),
    };
    Ok(Channel { sensitivity: c.sensitivity.map(|s| s / metres), ..c.clone() })
}

/// A hydrophone's channel with its counts for a pascal.
fn in_pascals(c: &Channel) -> Result<Channel> {
    let unit = c.unit.to_ascii_lowercase();
    let pascals = match unit.trim() {
        "" | "pa" | "pascal" | "pascals" => 1.0,
        "hpa" | "mbar" => 100.0,
        "kpa" => 1e3,
        "upa" | "µpa" | "micropascal" => 1e-6,
        _ => bail!("{} measures {}; pressure (Pa) is needed", c.code, c.unit),
    };
    Ok(Channel { sensitivity: c.sensitivity.map(|s| s / pascals), ..c.clone() })
}

impl Described {
    /// Codes of the channels of which no sensitivity is told, though one is of others: levels have no unit then.
    pub fn without_sensitivity(&self) -> Vec<&str> {
        let missing: Vec<&str> =
            self.channels.iter().filter(|c| c.sensitivity.is_none()).map(|c| c.code.as_str()).collect();
        if missing.len() < self.channels.len() { missing } else { Vec::new() }
    }

    /// The recorder's rate for it, Hz.
    pub(super) fn recorder_hz(&self) -> f64 {
        self.rate_hz.clamp(20.0, RECORDER_HZ)
    }

    /// The text of its station file; `propagation` is the name of its table.
    pub fn station_file(&self, id: u16, propagation: &str) -> String {
        let [pressure, north, east, vertical] = self.channels.each_ref().map(|c| c.code.as_str());
        let mut out = format!(
            "# From a data centre's metadata. Azimuths are as told there; `seabearing orient` measures them.\n[station]\nid = {id}\n\
             name = {:?}\nkind = \"obs\"\nposition = {{ lat_deg = {:?}, lon_deg = {:?}, depth_m = {:?} }}\n\
             sound_speed_m_s = 1500.0\n\n[sampling]\nrate_hz = {:?}\n\n[obs]\nseed_id = {:?}\n\
             components = {{ pressure = {pressure:?}, north = {north:?}, east = {east:?}, vertical = {vertical:?} }}\n\
             orientation_of_north_deg = {:?}\npropagation = {propagation:?}\n",
            self.code.chars().take(24).collect::<String>(),
            self.lat_lon_deg.0,
            self.lat_lon_deg.1,
            self.depth_m,
            self.recorder_hz(),
            self.seed_id,
            self.orientation_of_north_deg,
        );
        let sensitivity = self.channels.each_ref().map(|c| c.sensitivity);
        if let [Some(p), Some(n), Some(e), Some(v)] = sensitivity {
            let _ = writeln!(
                out,
                "sensitivity = {{ pressure = {p:?}, north = {n:?}, east = {e:?}, vertical = {v:?} }}"
            );
        }
        let mut heading = "\n[obs.responses]\n";
        for (component, response) in COMPONENTS.into_iter().zip(self.departing()) {
            if let Some((_, Response { poles, zeros, at_hz, reversed }, ..)) = response {
                let reversed = if *reversed { ", reversed = true" } else { "" };
                let _ = writeln!(
                    out,
                    "{heading}{component} = {{ poles = {poles:?}, zeros = {zeros:?}, at_hz = {at_hz:?}{reversed} }}"
                );
                heading = "";
            }
        }
        out
    }

    /// Of pressure, north, east and vertical those whose responses are not flat: code, response, and by how many dB and degrees
    /// it departs where ships are heard.
    pub fn departing(&self) -> [Option<(&str, &Response, f64, f64)>; 4] {
        self.channels.each_ref().map(|c| {
            let response = c.response.as_ref().filter(|r| r.is_sound())?;
            let (db, deg, departs) = response.departs(0.5 * self.recorder_hz());
            departs.then_some((c.code.as_str(), response, db, deg))
        })
    }
}

/// Components as a station file calls them.
const COMPONENTS: [&str; 4] = ["pressure", "north", "east", "vertical"];
