//! StationXML (FDSN StationXML 1.0 to 1.2), the metadata that data centres keep of seismic stations.

use super::described::{Channel, Told};
use super::response::Response;
use anyhow::{Context, Result, anyhow, bail};
use roxmltree::{Document, Node};
use std::path::Path;
use time::OffsetDateTime;

/// Longest text taken, bytes: a network of a hundred stations with full responses has some 20 MB.
const LONGEST: u64 = 128 << 20;

/// Whether bytes begin as XML does.
pub(super) fn begins(head: &[u8]) -> bool {
    head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head).trim_ascii_start().starts_with(b"<")
}

/// What a StationXML file tells.
///
/// # Errors
/// One line: it cannot be read, or is not StationXML.
pub(super) fn read(path: &Path) -> Result<Vec<Told>> {
    let name = path.display();
    let length = std::fs::metadata(path).with_context(|| format!("cannot read {name}"))?.len();
    if length > LONGEST {
        bail!("{name}: longer than {} MiB: ask the data centre for one network alone", LONGEST >> 20);
    }
    let bytes = std::fs::read(path).with_context(|| format!("cannot read {name}"))?;
    let text = match bytes[..] {
        [0x1f, 0x8b, ..] => bail!("{name}: packed by gzip: unpack it"),
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => bail!("{name}: UTF-16: save it as UTF-8"),
        _ => String::from_utf8(bytes).map_err(|e| anyhow!("{name}: no text in UTF-8: {}", e.utf8_error()))?,
    };
    parse(&text).with_context(|| name.to_string())
}

/// As [`read()`], of text at hand.
///
/// # Errors
/// As [`read()`].
pub(super) fn parse(text: &str) -> Result<Vec<Told>> {
    let document = Document::parse(text.trim_start_matches('\u{feff}')).map_err(|e| anyhow!("{e}"))?;
    if document.root_element().tag_name().name() != "FDSNStationXML" {
        bail!("no StationXML: the outermost element is <{}>", document.root_element().tag_name().name());
    }
    let stations = children(document.root_element(), "Network")
        .flat_map(|network| children(network, "Station").map(move |station| (network, station)));
    let told = stations.map(|(network, station)| Told {
        codes: [network, station].map(|node| attribute(node, "code").to_owned()),
        lat_lon_deg: (number(station, "Latitude"), number(station, "Longitude")),
        elevation_m: number(station, "Elevation"),
        channels: children(station, "Channel").map(channel).collect(),
    });
    Ok(told.collect())
}

fn channel(node: Node<'_, '_>) -> Channel {
    let response = children(node, "Response").next();
    let sensitivity = response.and_then(|r| children(r, "InstrumentSensitivity").next());
    let unit = sensitivity.and_then(|s| children(s, "InputUnits").next()).and_then(|u| text(u, "Name"));
    Channel {
        code: attribute(node, "code").to_owned(),
        location: attribute(node, "locationCode").trim().to_owned(),
        azimuth_deg: number(node, "Azimuth"),
        dip_deg: number(node, "Dip"),
        elevation_m: number(node, "Elevation"),
        rate_hz: number(node, "SampleRate").unwrap_or(0.0),
        start: moment(attribute(node, "startDate")),
        end: moment(attribute(node, "endDate")),
        sensitivity: sensitivity.and_then(|s| number(s, "Value")).filter(|v| *v != 0.0),
        unit: unit.unwrap_or("").to_owned(),
        response: response.and_then(|r| poles(r, sensitivity.and_then(|s| number(s, "Frequency")))),
    }
}

/// The analogue poles and zeros of a response, flat at the sensitivity's frequency.
fn poles(response: Node<'_, '_>, sensitivity_hz: Option<f64>) -> Option<Response> {
    let stages = children(response, "Stage").flat_map(|stage| children(stage, "PolesZeros"));
    let mut out = Response::default();
    // The sensitivity's frequency goes before that of a stage.
    let mut at_hz = sensitivity_hz.filter(|hz| *hz > 0.0);
    for stage in stages {
        let per_unit = match text(stage, "PzTransferFunctionType")? {
            "LAPLACE (RADIANS/SECOND)" => 1.0,
            "LAPLACE (HERTZ)" => std::f64::consts::TAU,
            // Digital filters are flat where they are used.
            _ => continue,
        };
        out.reversed ^= number(stage, "NormalizationFactor").is_some_and(|factor| factor < 0.0);
        at_hz = at_hz.or(number(stage, "NormalizationFrequency").filter(|hz| *hz > 0.0));
        let roots = |name| {
            let parts =
                |root| Some([number(root, "Real")? * per_unit, number(root, "Imaginary")? * per_unit]);
            children(stage, name).map(parts).collect::<Option<Vec<_>>>()
        };
        out.zeros.extend(roots("Zero")?);
        out.poles.extend(roots("Pole")?);
    }
    out.at_hz = at_hz.unwrap_or(0.0);
    (!out.poles.is_empty() || !out.zeros.is_empty()).then_some(out)
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
    use super::super::described::{Described, Wanted, choose};
    use super::*;
    use crate::station::Station;
    use seabearing_core::config::Kind;

    /// What is chosen of a text.
    fn parse(text: &str, wanted: &Wanted) -> Result<Vec<Described>> {
        choose(super::parse(text)?, wanted)
    }

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
        let at = moment("2011-06-01T00:00:00Z");
        // In whichever order, and as stations of their own.
        let two = document(&channels[..4]).replace("</Network></FDSNStationXML>", "") + "<Station";
        let second = document(&channels[4..]);
        let second = second.split_once("<Station").unwrap().1;
        let split = parse(&(two + second), &Wanted::default()).unwrap();
        assert_eq!((split.len(), split[0].orientation_of_north_deg), (1, 88.0));
        let before = parse(&document(&channels), &Wanted { at, ..Wanted::default() }).unwrap_err();
        let epochs = "YV.RR03: nothing is told of 2011-06-01; epochs: 2012-01-01 to …, 2013-01-01 to …";
        assert_eq!(before.to_string(), epochs);
    }
}
