//! Station files from StationXML (FDSN StationXML 1.0 to 1.2), the metadata that data centres keep of seismic stations.
//!
//! Enters: the XML. Leaves: for each ocean-bottom station in it, one with a hydrophone and three components of motion at one
//! rate, the text of a station file. Conventions, of the schema's documentation: azimuth clockwise from North, dip down
//! from the horizontal (a vertical that is positive up has −90), elevation up from sea level, sensitivity in counts for the
//! input unit. Components are renamed, not turned: "north" is the horizontal whose other one lies 90° clockwise, and its
//! azimuth the station's orientation.

use crate::angle::wrap_deg;
use anyhow::{Context, Result, anyhow, bail};
use roxmltree::{Document, Node};
use std::fmt::Write as _;
use std::path::Path;
use time::OffsetDateTime;

/// Longest text taken, bytes: a network of a hundred stations with full responses has some 20 MB.
const LONGEST: u64 = 128 << 20;

/// The recorder's rate where the files have as many samples a second, Hz: that which the methods were made for [O, L].
const RECORDER_HZ: f64 = 50.0;

/// By how much horizontals may fail to be level and square to each other, degrees.
const SQUARE_DEG: f64 = 5.0;

/// Which of the stations in the XML are meant; what is not said is any.
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

/// A station as the XML tells it.
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
    /// Pressure, north, east and vertical.
    pub channels: [Channel; 4],
    /// Azimuth of the component called north, degrees.
    pub orientation_of_north_deg: f64,
}

/// A channel as the XML tells it.
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    /// Its code.
    pub code: String,
    location: String,
    azimuth_deg: Option<f64>,
    dip_deg: Option<f64>,
    elevation_m: Option<f64>,
    rate_hz: f64,
    start: Option<OffsetDateTime>,
    /// Counts for a pascal or for a metre a second, where told.
    pub sensitivity: Option<f64>,
    unit: String,
}

/// Whether a file is XML, by its first bytes.
pub fn is_xml(path: &Path) -> bool {
    use std::io::Read;
    let mut head = [0u8; 64];
    let read = std::fs::File::open(path).and_then(|mut f| f.read(&mut head));
    let text = head[..read.unwrap_or(0)].strip_prefix(b"\xef\xbb\xbf").unwrap_or(&head).trim_ascii_start();
    text.starts_with(b"<")
}

/// Reads the ocean-bottom stations of a StationXML file.
///
/// # Errors
/// One line: not StationXML, or no station with a hydrophone and three components of motion, and why.
pub fn read(path: &Path, wanted: &Wanted) -> Result<Vec<Described>> {
    use std::io::Read;
    let name = path.display();
    let mut text = String::new();
    let file = std::fs::File::open(path).with_context(|| format!("cannot read {name}"))?;
    file.take(LONGEST + 1).read_to_string(&mut text).with_context(|| format!("cannot read {name}"))?;
    if text.len() as u64 > LONGEST {
        bail!("{name}: longer than {} MiB: ask the data centre for one network alone", LONGEST >> 20);
    }
    parse(&text, wanted).with_context(|| name.to_string())
}

/// As [`read()`], of text at hand.
///
/// # Errors
/// As [`read()`].
pub fn parse(text: &str, wanted: &Wanted) -> Result<Vec<Described>> {
    let document = Document::parse(text.trim_start_matches('\u{feff}')).map_err(|e| anyhow!("{e}"))?;
    if document.root_element().tag_name().name() != "FDSNStationXML" {
        bail!("no StationXML: the outermost element is <{}>", document.root_element().tag_name().name());
    }
    let (mut out, mut refused) = (Vec::new(), Vec::new());
    for network in children(document.root_element(), "Network") {
        for station in children(network, "Station") {
            let (n, s) = (attribute(network, "code"), attribute(station, "code"));
            let meant = |wanted: &Option<String>, code: &str| wanted.as_deref().is_none_or(|w| w == code);
            if !meant(&wanted.network, n) || !meant(&wanted.station, s) {
                continue;
            }
            match described(format!("{n}.{s}"), station, wanted) {
                // An epoch told twice is one station.
                Ok(d) => {
                    out.retain(|o: &Described| o.code != d.code);
                    out.push(d);
                }
                Err(e) => refused.push(format!("{n}.{s}: {e:#}")),
            }
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

fn described(code: String, station: Node<'_, '_>, wanted: &Wanted) -> Result<Described> {
    let mut channels = Vec::new();
    for node in children(station, "Channel") {
        let location = attribute(node, "locationCode").trim();
        let meant = wanted.location.as_deref().map(|l| l.trim_matches(['-', ' ']));
        if meant.is_some_and(|l| l != location) || !is_open(node, wanted.at) {
            continue;
        }
        channels.push(channel(node, location));
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
                && c.code[..2] == vertical.code[..2]
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
    code: String,
    station: Node<'_, '_>,
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
    for c in [a, b, vertical] {
        let unit = c.unit.to_ascii_lowercase().replace(' ', "");
        if !unit.is_empty() && unit != "m/s" {
            bail!("{} measures {}; velocity (m/s) is needed", c.code, c.unit);
        }
    }
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
    let number =
        |name: &'static str| -> Result<f64> { number(station, name).with_context(|| format!("no {name}")) };
    let elevation_m = pressure.elevation_m.map_or_else(|| number("Elevation"), Ok)?;
    let one = [a, b, vertical].iter().all(|c| c.location == pressure.location);
    Ok(Described {
        seed_id: if one { format!("{code}.{}", pressure.location) } else { code.clone() },
        code,
        lat_lon_deg: (number("Latitude")?, number("Longitude")?),
        depth_m: -elevation_m,
        rate_hz: pressure.rate_hz,
        channels: [pressure, north, east, vertical].map(Channel::clone),
        orientation_of_north_deg: wrap_deg(of_north),
    })
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
            "# From StationXML. Azimuths are as told there; `seabearing orient` measures them.\n[station]\nid = {id}\n\
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
        out
    }
}

fn channel(node: Node<'_, '_>, location: &str) -> Channel {
    let response = children(node, "Response").next();
    let sensitivity = response.and_then(|r| children(r, "InstrumentSensitivity").next());
    let unit = sensitivity.and_then(|s| children(s, "InputUnits").next()).and_then(|u| text(u, "Name"));
    Channel {
        code: attribute(node, "code").to_owned(),
        location: location.to_owned(),
        azimuth_deg: number(node, "Azimuth"),
        dip_deg: number(node, "Dip"),
        elevation_m: number(node, "Elevation"),
        rate_hz: number(node, "SampleRate").unwrap_or(0.0),
        start: moment(attribute(node, "startDate")),
        sensitivity: sensitivity.and_then(|s| number(s, "Value")).filter(|v| *v != 0.0),
        unit: unit.unwrap_or("").to_owned(),
    }
}

/// Whether a channel's epoch holds a moment.
fn is_open(node: Node<'_, '_>, at: Option<OffsetDateTime>) -> bool {
    let Some(at) = at else { return true };
    let (start, end) = (moment(attribute(node, "startDate")), moment(attribute(node, "endDate")));
    start.is_none_or(|s| s <= at) && end.is_none_or(|e| at < e)
}

/// A date of the schema, whose zone may be left out: UTC.
fn moment(text: &str) -> Option<OffsetDateTime> {
    let rfc3339 = &time::format_description::well_known::Rfc3339;
    let parsed = OffsetDateTime::parse(text, rfc3339);
    parsed.or_else(|_| OffsetDateTime::parse(&format!("{text}Z"), rfc3339)).ok()
}

fn children<'a, 'b>(node: Node<'a, 'b>, name: &'static str) -> impl Iterator<Item = Node<'a, 'b>> {
    node.children().filter(move |c| c.is_element() && c.tag_name().name() == name)
}

fn attribute<'a>(node: Node<'a, '_>, name: &str) -> &'a str {
    node.attribute(name).unwrap_or("")
}

fn text<'a>(node: Node<'a, '_>, name: &'static str) -> Option<&'a str> {
    children(node, name).next()?.text().map(str::trim)
}

fn number(node: Node<'_, '_>, name: &'static str) -> Option<f64> {
    text(node, name)?.parse().ok().filter(|x: &f64| x.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::station::Station;
    use seabearing_core::config::Kind;

    /// A channel of a test's XML.
    fn xml(code: &str, more: &str) -> String {
        format!(
            "<Channel code=\"{code}\" locationCode=\"00\" startDate=\"2012-01-01T00:00:00\"><Latitude>-24.9</Latitude>\
             <Longitude>62.5</Longitude><Elevation>-4340.0</Elevation><Depth>0</Depth>{more}</Channel>"
        )
    }

    fn motion(azimuth: f64, dip: f64, rate: f64, sensitivity: f64) -> String {
        format!(
            "<Azimuth unit=\"DEGREES\">{azimuth}</Azimuth><Dip>{dip}</Dip><SampleRate>{rate}</SampleRate><Response>\
             <InstrumentSensitivity><Value>{sensitivity}</Value><Frequency>1</Frequency><InputUnits><Name>M/S</Name>\
             </InputUnits></InstrumentSensitivity></Response>"
        )
    }

    fn document(channels: &[String]) -> String {
        format!(
            "<?xml version=\"1.0\"?>\n<FDSNStationXML xmlns=\"http://www.fdsn.org/xml/station/1\" schemaVersion=\"1.1\">\
             <Network code=\"YV\"><Station code=\"RR03\"><Latitude>-24.9</Latitude><Longitude>62.5</Longitude>\
             <Elevation>-4300</Elevation>{}</Station></Network></FDSNStationXML>",
            channels.concat()
        )
    }

    fn usual(azimuths: [f64; 2]) -> Vec<String> {
        let pressure = motion(0.0, -90.0, 100.0, 1600.0).replace("M/S", "PA");
        vec![
            xml("BH1", &motion(azimuths[0], 0.0, 100.0, 5e8)),
            xml("BH2", &motion(azimuths[1], 0.0, 100.0, -2.5e8)),
            xml("BHZ", &motion(0.0, -90.0, 100.0, 5e8)),
            xml("BDH", &pressure),
        ]
    }

    #[test]
    fn a_station_file_of_stationxml_says_what_the_xml_says() {
        let found = parse(&document(&usual([77.0, 167.0])), &Wanted::default()).unwrap();
        let [station] = &found[..] else { panic!("{found:?}") };
        let text = station.station_file(3, "t.toml");
        let read = Station::parse(&text, "s.toml", Path::new("/x")).unwrap();
        assert_eq!((read.config.id, read.config.name.as_str(), read.config.rate_hz), (3, "YV.RR03", 50.0));
        assert_eq!((read.config.lat_lon_deg, read.config.depth_m), (Some((-24.9, 62.5)), 4340.0));
        assert_eq!(read.seed_id.as_deref(), Some("YV.RR03.00"));
        assert_eq!((read.components.north.as_str(), read.components.east.as_str()), ("BH1", "BH2"));
        let Kind::Obs(obs) = &read.config.kind else { panic!() };
        assert_eq!(obs.orientation_of_north_deg, 77.0);
        // Motion is brought to north's counts; the reversed east is turned.
        assert_eq!(read.gains, [1.0, 1.0, -2.0, 1.0]);
    }

    #[test]
    fn horizontals_are_named_by_their_azimuths_and_what_does_not_fit_is_said() {
        let swapped = parse(&document(&usual([10.0, 280.5])), &Wanted::default()).unwrap();
        assert_eq!(swapped[0].channels[1].code, "BH2");
        assert!((swapped[0].orientation_of_north_deg - 280.25).abs() < 1e-9, "{swapped:?}");
        let error = |channels: &[String]| {
            format!("{:#}", parse(&document(channels), &Wanted::default()).unwrap_err())
        };
        let text = error(&usual([10.0, 130.0]));
        assert!(text.starts_with("YV.RR03: BH1 (10°) and BH2 (130°) are not square"), "{text}");
        assert!(error(&usual([0.0, 90.0])[..3]).contains("no hydrophone"));
        assert!(error(&usual([0.0, 90.0])[1..]).contains("no two horizontal"));
        let far = Wanted { station: Some("RR04".into()), ..Wanted::default() };
        assert!(
            parse(&document(&usual([0.0, 90.0])), &far).unwrap_err().to_string().contains("no such station")
        );
        assert!(parse("<html/>", &Wanted::default()).unwrap_err().to_string().contains("no StationXML"));
        assert!(parse("<a", &Wanted::default()).is_err());
    }

    #[test]
    fn a_vertical_that_points_down_is_turned_and_pressure_is_brought_to_pascals() {
        let of = |vertical: String, pressure: String| {
            let mut channels = usual([77.0, 167.0]);
            channels.truncate(2);
            channels.extend([xml("BHZ", &vertical), xml("BDH", &pressure)]);
            parse(&document(&channels), &Wanted::default()).map(|mut all| all.remove(0))
        };
        let pa = |unit: &str| motion(0.0, -90.0, 100.0, 1600.0).replace("M/S", unit);
        let down = of(motion(0.0, 90.0, 100.0, 5e8), pa("PA")).unwrap();
        assert_eq!(down.channels.each_ref().map(|c| c.sensitivity.unwrap()), [1600.0, 5e8, -2.5e8, -5e8]);
        let read = Station::parse(&down.station_file(3, "t.toml"), "s.toml", Path::new("/x")).unwrap();
        assert_eq!(read.gains, [1.0, 1.0, -2.0, -1.0]);
        let hecto = of(motion(0.0, -90.0, 100.0, 5e8), pa("hPa")).unwrap();
        assert_eq!(hecto.channels[0].sensitivity, Some(16.0));
        assert!(hecto.without_sensitivity().is_empty());
        let why = |vertical, pressure| format!("{:#}", of(vertical, pressure).unwrap_err());
        assert!(
            why(motion(0.0, -90.0, 100.0, 5e8), pa("V")).contains("BDH measures V; pressure (Pa) is needed")
        );
        assert!(
            why(motion(0.0, -10.0, 100.0, 5e8), pa("PA")).contains("BHZ is not vertical: its dip is -10°")
        );
        let unknown = pa("PA").replace("1600", "0");
        assert!(why(motion(0.0, 90.0, 100.0, 5e8), unknown.clone()).contains("BHZ points down"));
        let quiet = of(motion(0.0, -90.0, 100.0, 5e8), unknown).unwrap();
        assert_eq!(quiet.without_sensitivity(), ["BDH"]);
    }

    #[test]
    fn of_epochs_the_latest_or_that_of_a_moment_counts() {
        let mut channels = usual([77.0, 167.0]);
        let later = usual([88.0, 178.0]).into_iter().map(|c| c.replace("2012-01-01", "2013-01-01"));
        channels.splice(0..0, later);
        let of = |at: &str| {
            let at = moment(at);
            parse(&document(&channels), &Wanted { at, ..Wanted::default() }).unwrap()[0]
                .orientation_of_north_deg
        };
        assert_eq!((of(""), of("2012-06-01T00:00:00Z")), (88.0, 77.0));
    }
}
