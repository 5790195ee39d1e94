//! Dataless SEED, the older form of what data centres keep of seismic stations (SEED 2.4: control headers without data).
//!
//! Enters: the bytes. A volume is records of equal length, each with six digits of sequence number, a letter and a sign; blockettes
//! (three digits of type, four of length) run on from one to the next (SEED 2.4, chapter 3). Leaves: stations and channels as
//! StationXML tells them. Read are volume (010), units (034), station (050), channel (052), poles and zeros (053) and
//! sensitivities (058); what a dictionary holds of responses (041 to 048) is not looked up.

use super::described::{Channel, Told};
use super::response::Response;
use anyhow::{Context, Result, bail};
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::path::Path;
use time::{Date, OffsetDateTime, Time};

/// Longest volume taken, bytes.
const LONGEST: u64 = 64 << 20;
/// Length of a record where the volume does not say it, and the shortest and longest that the format knows, bytes.
const RECORD: usize = 4096;
const RECORDS: std::ops::RangeInclusive<u32> = 8..=15;

/// Whether bytes begin as a volume does.
pub(super) fn begins(head: &[u8]) -> bool {
    head.len() >= 11 && head[..6].iter().all(u8::is_ascii_digit) && head.get(6..11) == Some(b"V 010")
}

/// What a volume tells.
///
/// # Errors
/// One line: it cannot be read, or is damaged.
pub(super) fn read(path: &Path) -> Result<Vec<Told>> {
    let name = path.display();
    let length = std::fs::metadata(path).with_context(|| format!("cannot read {name}"))?.len();
    if length > LONGEST {
        bail!("{name}: longer than {} MiB: ask the data centre for one network alone", LONGEST >> 20);
    }
    parse(&std::fs::read(path).with_context(|| format!("cannot read {name}"))?)
        .with_context(|| name.to_string())
}

/// As [`read()`], of bytes at hand.
pub(super) fn parse(bytes: &[u8]) -> Result<Vec<Told>> {
    let mut told: Vec<Told> = Vec::new();
    let mut units = BTreeMap::new();
    for (kind, fields) in blockettes(bytes)? {
        let mut fields = Fields(&fields);
        let station = told.last_mut();
        let understood = match (kind, station) {
            (34, _) => fields.unit().map(|(code, name)| drop(units.insert(code, name))),
            (50, _) => fields.station().map(|station| told.push(station)),
            (52, Some(station)) => fields.channel(&units).map(|channel| station.channels.push(channel)),
            (53, Some(station)) => station.channels.last_mut().and_then(|c| fields.poles(c)),
            (58, Some(station)) => station.channels.last_mut().and_then(|c| fields.sensitivity(c)),
            _ => Some(()),
        };
        if understood.is_none() {
            bail!(
                "damaged: a blockette {kind:03} ends before its fields do, or holds no number where one belongs"
            );
        }
    }
    for channel in told.iter_mut().flat_map(|s| &mut s.channels) {
        channel.response = channel.response.take().filter(|r| !(r.poles.is_empty() && r.zeros.is_empty()));
    }
    Ok(told)
}

/// Types and fields of all blockettes, in order.
fn blockettes(bytes: &[u8]) -> Result<Vec<(u16, Vec<u8>)>> {
    let digits =
        |part: Option<&[u8]>| -> Option<u32> { std::str::from_utf8(part?).ok()?.trim().parse().ok() };
    // Type, length and version of the volume's blockette, then the exponent of the record's length.
    let exponent = digits(bytes.get(19..21)).filter(|e| RECORDS.contains(e));
    let length = exponent.map_or(RECORD, |e| 1usize << e);
    let mut out = Vec::new();
    // What is not whole yet: it goes on in the next record of its kind.
    let mut open: Vec<u8> = Vec::new();
    for record in bytes.chunks(length) {
        let (Some(letter), Some(goes_on), Some(mut rest)) = (record.get(6), record.get(7), record.get(8..))
        else {
            break;
        };
        if !matches!(letter, b'V' | b'A' | b'S') {
            continue;
        }
        if *goes_on != b'*' {
            open.clear();
        }
        loop {
            if open.is_empty() {
                // Some programs break lines between blockettes.
                rest = rest.trim_ascii_start();
            }
            let wanted = match open.len() {
                0..7 => 7,
                _ => digits(open.get(3..7))
                    .filter(|n| *n >= 7)
                    .context("damaged: a blockette without its length")? as usize,
            };
            let more = (wanted - open.len()).min(rest.len());
            if more == 0 && open.len() < wanted {
                break;
            }
            let (taken, left) = rest.split_at(more);
            open.extend_from_slice(taken);
            rest = left;
            if wanted > 7 && open.len() == wanted || wanted == 7 && open.len() == 7 && open.ends_with(b"0007")
            {
                let kind = digits(open.get(..3)).context("damaged: a blockette without its type")?;
                out.push((kind as u16, open.split_off(7)));
                open.clear();
            }
        }
    }
    Ok(out)
}

/// What is left of a blockette's fields; each is `None` where it is not there.
struct Fields<'a>(&'a [u8]);

impl Fields<'_> {
    /// Of so many bytes.
    fn text(&mut self, length: usize) -> Option<String> {
        let (field, rest) = self.0.split_at_checked(length)?;
        self.0 = rest;
        Some(String::from_utf8_lossy(field).trim().to_owned())
    }

    /// Up to a tilde.
    fn variable(&mut self) -> Option<String> {
        let end = self.0.iter().position(|b| *b == b'~')?;
        let text = self.text(end);
        self.0 = &self.0[1..];
        text
    }

    /// A number; blanks are none.
    fn number(&mut self, length: usize) -> Option<Option<f64>> {
        match self.text(length)?.replace(['D', 'd'], "e") {
            blank if blank.is_empty() => Some(None),
            text => text.parse().ok().filter(|x: &f64| x.is_finite()).map(Some),
        }
    }

    fn moment(&mut self) -> Option<Option<OffsetDateTime>> {
        Some(moment(&self.variable()?))
    }

    /// Blockette 034: number and name.
    fn unit(&mut self) -> Option<(u32, String)> {
        let code = self.number(3)??;
        Some((code as u32, self.variable()?))
    }

    /// Blockette 050.
    fn station(&mut self) -> Option<Told> {
        let station = self.text(5)?;
        let lat_lon_deg = (self.number(10)?, self.number(11)?);
        let elevation_m = self.number(7)?;
        // Counts of channels and comments, the place's name, its network by number, the order of bytes.
        self.text(4 + 3)?;
        self.variable()?;
        self.text(3 + 4 + 2)?;
        self.moment()?;
        self.moment()?;
        self.text(1)?;
        let network = self.text(2).unwrap_or_default();
        Some(Told { codes: [network, station], lat_lon_deg, elevation_m, channels: Vec::new() })
    }

    /// Blockette 052.
    fn channel(&mut self, units: &BTreeMap<u32, String>) -> Option<Channel> {
        let (location, code) = (self.text(2)?, self.text(3)?);
        self.text(4 + 3)?;
        self.variable()?;
        let unit = self.number(3)?.and_then(|code| units.get(&(code as u32)).cloned()).unwrap_or_default();
        self.text(3 + 10 + 11)?;
        let (elevation_m, _depth_m) = (self.number(7)?, self.number(5)?);
        let (azimuth_deg, dip_deg) = (self.number(5)?, self.number(5)?);
        self.text(4 + 2)?;
        let rate_hz = self.number(10)?.unwrap_or(0.0);
        self.text(10 + 4)?;
        self.variable()?;
        let (start, end) = (self.moment()?, self.moment()?);
        Some(Channel {
            code,
            location,
            azimuth_deg,
            dip_deg,
            elevation_m,
            rate_hz,
            start,
            end,
            unit,
            ..Channel::default()
        })
    }

    /// Blockette 053: analogue stages add to the channel's response; digital filters are flat where they are used.
    fn poles(&mut self, channel: &mut Channel) -> Option<()> {
        let per_unit = match self.text(1)?.as_str() {
            "A" => 1.0,
            "B" => TAU,
            _ => return Some(()),
        };
        // Stage and units, then the factor of normalisation and its frequency.
        self.text(2 + 3 + 3)?;
        let reversed = self.number(12)?.is_some_and(|factor| factor < 0.0);
        let at_hz = self.number(12)?.filter(|hz| *hz > 0.0).unwrap_or(0.0);
        let response = channel.response.get_or_insert_with(|| Response { at_hz, ..Response::default() });
        response.reversed ^= reversed;
        for roots in [&mut response.zeros, &mut response.poles] {
            for _ in 0..self.number(3)?? as usize {
                let root = [self.number(12)?? * per_unit, self.number(12)?? * per_unit];
                self.text(12 + 12)?;
                roots.push(root);
            }
        }
        Some(())
    }

    /// Blockette 058 of stage 0: of the whole channel.
    fn sensitivity(&mut self, channel: &mut Channel) -> Option<()> {
        if self.number(2)? != Some(0.0) {
            return Some(());
        }
        channel.sensitivity = self.number(12)?.filter(|s| *s != 0.0);
        let at_hz = self.number(12)?.filter(|hz| *hz > 0.0);
        // Sensitivities come after the stages.
        if let (Some(response), Some(at_hz)) = (&mut channel.response, at_hz) {
            response.at_hz = at_hz;
        }
        Some(())
    }
}

/// `2012,275,00:00:00.0000`, of which what is behind the day may be missing; UTC.
fn moment(text: &str) -> Option<OffsetDateTime> {
    let mut parts = text.split(',');
    let date =
        Date::from_ordinal_date(parts.next()?.trim().parse().ok()?, parts.next()?.trim().parse().ok()?)
            .ok()?;
    let clock = parts.next().unwrap_or("").trim();
    let mut of_clock = clock.split([':', '.']).map(|p| p.parse::<u8>().unwrap_or(0));
    let mut next = || of_clock.next().unwrap_or(0);
    let time = Time::from_hms(next(), next(), next().min(59)).ok()?;
    Some(date.with_time(time).assume_utc())
}

#[cfg(test)]
mod tests {
    use super::super::described::{Wanted, choose};
    use super::*;

    fn blockette(kind: u16, fields: &str) -> String {
        format!("{kind:03}{:04}{fields}", fields.len() + 7)
    }

    /// A volume of a station with four channels, in records of so many bytes.
    fn volume(exponent: u32) -> Vec<u8> {
        let length = 1usize << exponent;
        let records = |letter: char, text: &str, from: usize| {
            let chunks = text.as_bytes().chunks(length - 8).enumerate();
            chunks
                .flat_map(move |(i, part)| {
                    let mut record =
                        format!("{:06}{letter}{}", from + i, if i == 0 { ' ' } else { '*' }).into_bytes();
                    record.extend_from_slice(part);
                    record.resize(length, b' ');
                    record
                })
                .collect::<Vec<u8>>()
        };
        let channel = |code: &str, unit: u32, azimuth: f64, dip: f64, gain: f64, poles: &str| {
            let zeros = "  1 0.00000E+00 0.00000E+00 0.00000E+00 0.00000E+00";
            blockette(
                52,
                &format!(
                    "00{code}   0  1~{unit:03}  0-24.900000  62.500000-4340.0  0.0{azimuth:5.1}{dip:5.1}000112{:10.4E}0.0000E+00   0CG~\
                 2012,275,00:00:00.0000~2013,300~N",
                    100.0
                ),
            ) + &blockette(
                53,
                &format!(
                    "A 1{unit:03}  3 1.00000E+00 1.00000E+00{zeros}  1{poles} 0.00000E+00 0.00000E+00 0.00000E+00"
                ),
            ) + &blockette(58, &format!(" 0{gain:12.5E} 5.00000E+00 0"))
        };
        let station =
            blockette(50, "RR03 -24.900000  62.500000-4300.0  4  0A place in the sea~  13210102012,275~~NYV")
                + &channel("BH1", 1, 77.0, 0.0, 5e8, "-6.28319E+00")
                + &channel("BH2", 1, 167.0, 0.0, 5e8, "-6.28319E+00")
                + &channel("BHZ", 1, 0.0, -90.0, 5e8, "-6.28319E+00")
                + &channel("BDH", 2, 0.0, 90.0, 1600.0, "-1.25664E+01");
        let units = blockette(34, "001M/S~Velocity~") + &blockette(34, "002PA~Pressure~");
        let volume = blockette(10, &format!("02.4{exponent:02}2012,275~2013,300~2014,001~Somewhere~~"));
        [records('V', &volume, 1), records('A', &units, 2), records('S', &station, 3)].concat()
    }

    #[test]
    fn a_volume_tells_what_stationxml_would() {
        for exponent in [8, 9, 12] {
            let bytes = volume(exponent);
            assert!(begins(&bytes));
            let told = parse(&bytes).unwrap();
            let found = choose(told, &Wanted::default()).unwrap();
            let [station] = &found[..] else { panic!("{found:?}") };
            assert_eq!((station.code.as_str(), station.seed_id.as_str()), ("YV.RR03", "YV.RR03.00"));
            assert_eq!(
                (station.lat_lon_deg, station.depth_m, station.rate_hz),
                ((-24.9, 62.5), 4340.0, 100.0)
            );
            assert_eq!(station.orientation_of_north_deg, 77.0);
            assert_eq!(station.channels.each_ref().map(|c| c.sensitivity.unwrap()), [1600.0, 5e8, 5e8, 5e8]);
            assert_eq!(station.channels.each_ref().map(|c| c.code.as_str()), ["BDH", "BH1", "BH2", "BHZ"]);
            let response = station.channels[0].response.as_ref().unwrap();
            assert_eq!((response.at_hz, &response.zeros[..]), (5.0, &[[0.0, 0.0]][..]));
            assert!((response.poles[0][0] + 12.5664).abs() < 1e-9);
            let early = Wanted { at: moment("2012,001"), ..Wanted::default() };
            assert!(choose(parse(&bytes).unwrap(), &early).is_err());
        }
    }

    #[test]
    fn what_is_cut_or_garbled_is_said_or_left_out_and_never_ends_the_program() {
        let bytes = volume(9);
        for cut in (0..bytes.len()).step_by(7) {
            let _ = parse(&bytes[..cut]);
        }
        for at in 0..bytes.len() {
            for with in [b'9', b' ', b'~', 0xff] {
                let mut garbled = bytes.clone();
                garbled[at] = with;
                let _ = parse(&garbled).map(|told| choose(told, &Wanted::default()));
            }
        }
        let wrong = String::from_utf8(bytes).unwrap().replace("-4300.0", "-43x0.0");
        assert!(parse(wrong.as_bytes()).unwrap_err().to_string().contains("blockette 050"));
    }
}
