//! AIS sentences (NMEA 0183 `!AIVDM`, `!AIVDO`): positions of classes A and B (messages 1 to 3, 18, 19), names and
//! lengths (5, 19, 24).
//!
//! The messages are decoded by the crate `ais`. What stands for "not available" (position 181°/91°, speed 102.3 knots)
//! is none; sentences that are broken, out of sequence or of other messages give nothing.

use super::AisFile;
use ais::messages::static_data_report::MessagePart;
use ais::messages::{AisMessage, parse, unarmor};
use ais::{AisFragments, AisParser};
use anyhow::{Result, bail};
use seabearing_host::ais::AisReport;
use seabearing_host::csv::shown;
use std::collections::{BTreeMap, VecDeque};

/// Metres a second in a knot.
const KNOT_M_S: f64 = 1852.0 / 3600.0;
/// Messages of which some sentences have come, at most.
const PENDING: usize = 8;
/// Messages that tell something of vessels.
const WANTED: [u8; 7] = [1, 2, 3, 5, 18, 19, 24];

/// What a sentence tells.
#[derive(Clone, Debug, PartialEq)]
pub enum Told {
    /// Where a vessel is.
    Position(AisReport),
    /// What a vessel is.
    Particulars {
        /// Its number.
        mmsi: u64,
        /// Its name.
        name: Option<String>,
        /// Its length, m.
        length_m: Option<f64>,
    },
}

/// The way from sentences to what they tell.
#[derive(Debug, Default)]
pub struct Decoder {
    /// Messages of several sentences, by their number and channel: the next sentence expected.
    pending: VecDeque<((u8, char), AisParser, u8)>,
}

/// Sentences of a message, this one's number among them, the message's number, its channel.
fn place(sentence: &str) -> Option<(u8, u8, u8, char)> {
    let mut fields = sentence.split(',').skip(1);
    let (count, number) = (fields.next()?.parse().ok()?, fields.next()?.parse().ok()?);
    let id = fields.next()?.parse().unwrap_or(0);
    Some((count, number, id, fields.next()?.chars().next().unwrap_or(' ')))
}

impl Decoder {
    /// Takes a sentence, received at `t_s` (seconds since 1970 UTC).
    ///
    /// # Errors
    /// What is broken about it, in a few words.
    pub fn take(&mut self, line: &str, t_s: f64) -> Result<Vec<Told>, String> {
        let line = line.trim();
        let sentence = line.find(['!', '$']).map_or(line, |at| &line[at..]);
        if !sentence.is_ascii() || sentence.len() > 200 {
            return Err("no sentence".to_owned());
        }
        // Receivers say other things, too, as where they are.
        let kind = sentence.get(3..6).unwrap_or("");
        if sentence.starts_with('$') || !matches!(kind, "VDM" | "VDO") {
            return if sentence.starts_with(['!', '$']) {
                Ok(Vec::new())
            } else {
                Err("no sentence".to_owned())
            };
        }
        let (count, number, id, channel) = place(sentence).ok_or("fields are missing")?;
        if number == 0 || number > count {
            return Err(format!("sentence {number} of {count}"));
        }
        let key = (id, channel);
        let known = self.pending.iter().position(|(k, ..)| *k == key).filter(|_| count > 1);
        let (mut parser, next) = match known.and_then(|at| self.pending.remove(at)) {
            Some((_, parser, next)) if number == next => (parser, next),
            _ if number == 1 => (AisParser::new(), 1),
            _ => return Err(format!("sentence {number} of {count} without the one before")),
        };
        match parser.parse(sentence.as_bytes(), false) {
            Ok(AisFragments::Incomplete(_)) => {
                self.pending.push_back((key, parser, next + 1));
                if self.pending.len() > PENDING {
                    self.pending.pop_front();
                }
                Ok(Vec::new())
            }
            Ok(AisFragments::Complete(whole)) => {
                let of = |e: ais::errors::Error| e.to_string();
                let bits = unarmor(&whole.data, whole.fill_bit_count.into()).map_err(of)?;
                if !WANTED.contains(&(bits.first().copied().unwrap_or(0) >> 2)) {
                    return Ok(Vec::new());
                }
                Ok(told(parse(&bits).map_err(of)?, t_s))
            }
            Err(e) => Err(e.to_string()),
        }
    }
}

/// The time at which the second of the minute was last `second`, or will be within half a minute.
fn at_second(t_s: f64, second: u8) -> f64 {
    if second > 59 {
        return t_s;
    }
    let after = (f64::from(second) - t_s).rem_euclid(60.0);
    t_s + if after > 30.0 { after - 60.0 } else { after }
}

fn told(message: AisMessage, t_s: f64) -> Vec<Told> {
    let name = |text: &str| Some(text.trim().to_owned()).filter(|n| !n.is_empty());
    let length = |bow: u16, stern: u16| Some(f64::from(bow) + f64::from(stern)).filter(|l| *l >= 1.0);
    let position = |mmsi: u32, lat: Option<f32>, lon: Option<f32>, knots: Option<f32>, second: u8| {
        let (lat, lon) = (f64::from(lat?), f64::from(lon?));
        let real = (-90.0..=90.0).contains(&lat) && (-180.0..=180.0).contains(&lon) && mmsi > 0;
        let speed_m_s = knots.map(f64::from).filter(|k| (0.0..=102.15).contains(k)).map(|k| k * KNOT_M_S);
        real.then_some(Told::Position(AisReport {
            mmsi: mmsi.into(),
            t_s: at_second(t_s, second),
            lat_lon_deg: (lat, lon),
            speed_m_s,
            status: None,
            ship_type: None,
            terrestrial: None,
            length_m: None,
        }))
    };
    match message {
        AisMessage::PositionReport(p) => {
            position(p.mmsi, p.latitude, p.longitude, p.speed_over_ground, p.timestamp).into_iter().collect()
        }
        AisMessage::StandardClassBPositionReport(p) => {
            position(p.mmsi, p.latitude, p.longitude, p.speed_over_ground, p.timestamp).into_iter().collect()
        }
        AisMessage::ExtendedClassBPositionReport(p) => {
            let what = Told::Particulars {
                mmsi: p.mmsi.into(),
                name: name(&p.name),
                length_m: length(p.dimension_to_bow, p.dimension_to_stern),
            };
            let place = position(p.mmsi, p.latitude, p.longitude, p.speed_over_ground, p.timestamp);
            place.into_iter().chain([what]).collect()
        }
        AisMessage::StaticAndVoyageRelatedData(s) => vec![Told::Particulars {
            mmsi: s.mmsi.into(),
            name: name(&s.vessel_name),
            length_m: length(s.dimension_to_bow, s.dimension_to_stern),
        }],
        AisMessage::StaticDataReport(s) => match s.message_part {
            MessagePart::PartA { vessel_name } => {
                vec![Told::Particulars { mmsi: s.mmsi.into(), name: name(&vessel_name), length_m: None }]
            }
            // The boats of a ship (98…) give their ship's number in place of their measures.
            MessagePart::PartB { dimension_to_bow, dimension_to_stern, .. } if s.mmsi / 10_000_000 != 98 => {
                let length_m = length(dimension_to_bow, dimension_to_stern);
                vec![Told::Particulars { mmsi: s.mmsi.into(), name: None, length_m }]
            }
            _ => Vec::new(),
        },
        _ => Vec::new(),
    }
}

/// The time of a line, seconds since 1970: `c:` of a tag block before the sentence, or a number behind it.
pub fn time_of(line: &str) -> Option<f64> {
    let tag = line.strip_prefix('\\').and_then(|l| l.split_once('\\')).map(|(tag, _)| tag);
    let of_tag = tag.and_then(|t| t.split([',', '*']).find_map(|f| f.strip_prefix("c:")));
    let behind =
        || line.rsplit_once('*').and_then(|(_, end)| end.rsplit_once(',')).map(|(_, last)| last.trim());
    let t_s: f64 = of_tag.or_else(behind)?.parse().ok()?;
    // Some write milliseconds.
    let t_s = if t_s > 1e11 { t_s * 1e-3 } else { t_s };
    (1e8..1e10).contains(&t_s).then_some(t_s)
}

/// What a file of sentences holds.
///
/// # Errors
/// No report in it can be read, or no line says when it was.
pub fn file(text: &str, name: &str) -> Result<AisFile> {
    let (mut decoder, mut now) = (Decoder::default(), None);
    let (mut reports, mut bad) = (Vec::new(), Vec::new());
    let (mut names, mut lengths) = (BTreeMap::new(), BTreeMap::new());
    for (n, line) in text.lines().enumerate().filter(|(_, l)| !l.trim().is_empty()) {
        now = time_of(line).or(now);
        match decoder.take(line, now.unwrap_or(0.0)) {
            Ok(told) => {
                for told in told {
                    match told {
                        Told::Position(report) => reports.push(report),
                        Told::Particulars { mmsi, name, length_m } => {
                            names.extend(name.map(|name| (mmsi, name)));
                            lengths.extend(length_m.map(|l| (mmsi, l)));
                        }
                    }
                }
            }
            Err(e) => bad.push(format!("{name}, line {}: {e}: `{}`", n + 1, shown(line))),
        }
    }
    if reports.is_empty() {
        bail!(
            "{name}: no position report in {} broken sentences and {} good ones",
            bad.len(),
            text.lines().count() - bad.len()
        );
    }
    if now.is_none() {
        bail!(
            "{name}: no sentence says when it was received: a tag block `\\c:1696241893*5F\\` before it or `,1696241893` \
             behind it is needed"
        );
    }
    for report in &mut reports {
        report.length_m = lengths.get(&report.mmsi).copied();
    }
    Ok(AisFile { reports, names, bad })
}

#[cfg(test)]
mod tests {
    use super::*;

    // Published examples of the messages.
    const CLASS_A: &str = "!AIVDM,1,1,,B,177KQJ5000G?tO`K>RA1wUbN0TKH,0*5C";
    const CLASS_B: &str = "!AIVDM,1,1,,A,B52K>;h00Fc>jpUlNV@ikwpUoP06,0*4C";
    const FIRST: &str = "!AIVDM,2,1,3,B,55P5TL01VIaAL@7WKO@mBplU@<PDhh000000001S;AJ::4A80?4i@E53,0*3E";
    const SECOND: &str = "!AIVDM,2,2,3,B,1@0000000000000,2*55";

    fn one(line: &str) -> AisReport {
        match Decoder::default().take(line, 1_700_000_000.0).unwrap().as_slice() {
            [Told::Position(report)] => *report,
            other => panic!("{other:?}"),
        }
    }

    /// A position report of class A with these codes, as a sentence.
    fn sentence(speed: u64, lon: i64, lat: i64) -> String {
        let mut bits = String::new();
        let mut put = |value: i64, width: usize| {
            bits.push_str(&format!("{:0width$b}", (value as u64) & ((1 << width) - 1)));
        };
        for (value, width) in
            [(1, 6), (0, 2), (123_456_789, 30), (0, 4), (128, 8), (speed as i64, 10), (0, 1)]
        {
            put(value, width);
        }
        for (value, width) in
            [(lon, 28), (lat, 27), (3600, 12), (511, 9), (60, 6), (0, 2), (0, 3), (0, 1), (0, 19)]
        {
            put(value, width);
        }
        let six = |chunk: &[u8]| u8::from_str_radix(std::str::from_utf8(chunk).unwrap(), 2).unwrap();
        let armor = |v: u8| char::from(if v < 40 { v + 48 } else { v + 56 });
        let payload: String = bits.as_bytes().chunks(6).map(|c| armor(six(c))).collect();
        let body = format!("AIVDM,1,1,,A,{payload},0");
        format!("!{body}*{:02X}", body.bytes().fold(0, |a, b| a ^ b))
    }

    #[test]
    fn positions_of_both_classes_and_names_in_two_sentences() {
        let a = one(CLASS_A);
        assert_eq!(a.mmsi, 477_553_000);
        assert!((a.lat_lon_deg.0 - 47.5828).abs() < 1e-3 && (a.lat_lon_deg.1 + 122.3458).abs() < 1e-3);
        assert!((a.t_s - 1_700_000_000.0).abs() <= 30.0 && a.t_s.rem_euclid(60.0) == 15.0);
        assert_eq!(one(CLASS_B).mmsi, 338_087_471);
        let mut decoder = Decoder::default();
        assert_eq!(decoder.take(FIRST, 0.0).unwrap(), []);
        // Another vessel's report in between changes nothing.
        assert_eq!(decoder.take(CLASS_A, 0.0).unwrap().len(), 1);
        match decoder.take(SECOND, 0.0).unwrap().as_slice() {
            [Told::Particulars { mmsi: 369_190_000, name: Some(name), length_m }] => {
                assert_eq!((name.as_str(), *length_m), ("MT.MITCHELL", Some(180.0)));
            }
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn what_is_not_available_is_none() {
        let here = |speed| sentence(speed, -600_000, 30_000_000);
        assert_eq!(one(&here(1023)).speed_m_s, None);
        assert_eq!(one(&here(1022)).speed_m_s, None);
        assert!((one(&here(100)).speed_m_s.unwrap() - 5.144).abs() < 0.01);
        assert_eq!(one(&here(0)).lat_lon_deg, (50.0, -1.0));
        for (lon, lat) in [(108_600_000, 30_000_000), (0, 54_600_000), (120_000_000, 0), (0, 60_000_000)] {
            assert_eq!(Decoder::default().take(&sentence(0, lon, lat), 0.0).unwrap(), [], "{lon} {lat}");
        }
    }

    #[test]
    fn broken_sentences_give_an_error_and_never_a_panic() {
        let mut decoder = Decoder::default();
        assert!(decoder.take(&CLASS_A.replace("5C", "5D"), 0.0).unwrap_err().contains("hecksum"));
        assert!(decoder.take(SECOND, 0.0).unwrap_err().contains("without the one before"));
        assert!(decoder.take("hello", 0.0).is_err());
        assert_eq!(decoder.take("$GPZDA,1,2*00", 0.0).unwrap(), []);
        let with_sum = |body: &str| format!("!{body}*{:02X}", body.bytes().fold(0, |a, b| a ^ b));
        for line in [CLASS_A, CLASS_B, FIRST, SECOND] {
            let body = &line[1..line.len() - 3];
            for at in 0..body.len() {
                for new in ["", "0", "9", ",", "w", "~"] {
                    let mut broken = body.to_owned();
                    broken.replace_range(at..=at, new);
                    // With a checksum that holds: a faulty transmitter.
                    let _ = decoder.take(&with_sum(&broken), 0.0);
                }
                let _ = decoder.take(&with_sum(&body[..at]), 0.0);
            }
        }
    }

    #[test]
    fn a_file_tells_when_and_names_its_broken_lines() {
        let text =
            format!("\\s:x,c:1700000000*00\\{CLASS_A}\n{FIRST}\n{SECOND}\nrubbish\n{CLASS_B},1700000100\n");
        let AisFile { reports, names, bad } = file(&text, "x.nmea").unwrap();
        assert_eq!((reports.len(), names.len(), bad.len()), (2, 1, 1));
        assert!((reports[1].t_s - 1_700_000_100.0).abs() <= 30.0);
        assert!(bad[0].starts_with("x.nmea, line 4: no sentence"), "{bad:?}");
        assert!(file(CLASS_A, "x").unwrap_err().to_string().contains("when it was received"));
        // No time that there is.
        assert_eq!(
            ["inf", "NaN", "1e300", "-5"].map(|c| time_of(&format!("\\c:{c}*00\\{CLASS_A}"))),
            [None; 4]
        );
        assert!(file("!AIVDM,x", "x").unwrap_err().to_string().contains("no position report"));
    }
}
