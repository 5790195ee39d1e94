//! `base send … snippet` and `… spectrum`: what a recorder hears, put together from its pieces.

use super::base_tokens::{order, who};
use super::mistake;
use crate::record::calibrate;
use crate::recording::write;
use crate::station::{Calibration, Station};
use anyhow::{Context, Result, bail};
use seabearing_core::keeper::{DONE, REFUSED};
use seabearing_core::snippet::MOST_CODES;
use seabearing_core::wire::guard::COMMAND_BYTES;
use seabearing_core::wire::{Command, bytes_of};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How long a snippet is.
#[derive(Clone, Copy, Debug)]
pub enum Length {
    /// So many instants.
    Instants(u32),
    /// So many seconds.
    Seconds(f64),
    /// As many as fit.
    Most,
}

/// A snippet on its way.
pub struct Snippet {
    channels: Vec<u8>,
    length: Length,
    out: Option<PathBuf>,
    /// Samples a second, once the recorder has said it.
    rate_hz: Option<f64>,
    /// The recorder has answered who it is.
    known: bool,
    given: bool,
    /// Index of the first instant and how many there are, once they were taken.
    taken: Option<(u64, usize)>,
    codes: Vec<Option<i32>>,
    done: bool,
}

/// Bits of channels, each of which must be 0 to 3.
fn bits(channels: &[u8]) -> u8 {
    channels.iter().fold(0, |bits, c| bits | 1 << (c & 3))
}

impl Snippet {
    /// Of these channels, from 0.
    ///
    /// # Errors
    /// The length is none, or the file's folder is not there.
    pub fn new(channels: &[u8], length: Length, out: Option<PathBuf>) -> Result<Self> {
        match length {
            Length::Instants(0) => mistake!("--samples 0: none"),
            Length::Seconds(s) if !(s.is_finite() && s > 0.0) => mistake!("--seconds {s}: no length of time"),
            _ => {}
        }
        if let Some(out) = &out {
            let folder = out.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
            if out.is_dir() {
                bail!("cannot write {}: it is a folder", out.display());
            }
            if !folder.is_dir() {
                bail!("cannot write {}: there is no folder {}", out.display(), folder.display());
            }
        }
        let channels: Vec<u8> = (0..4).filter(|c| channels.contains(c)).collect();
        let codes = Vec::new();
        Ok(Self {
            channels,
            length,
            out,
            rate_hz: None,
            known: false,
            given: false,
            taken: None,
            codes,
            done: false,
        })
    }

    /// Instants to ask for.
    fn instants(&self) -> u32 {
        match self.length {
            Length::Instants(n) => n,
            Length::Seconds(s) => (s * self.rate_hz.unwrap_or(0.0)).round() as u32,
            Length::Most => (MOST_CODES / self.channels.len().max(1)) as u32,
        }
    }

    /// The next command, if one is due now.
    pub fn due(&self) -> Option<Vec<u8>> {
        let command = match (self.known, self.given) {
            (_, true) => return None,
            (false, _) => Command::Identify { token: who() },
            (true, _) => Command::SendSnippet {
                token: order(),
                channels: bits(&self.channels),
                instants: self.instants(),
            },
        };
        Some(bytes_of(&command, &mut [0; COMMAND_BYTES]).to_vec())
    }

    /// What was due was given.
    pub fn given(&mut self) {
        self.given = true;
    }

    /// The recorder says something; whether that brings it on.
    ///
    /// # Errors
    /// It refuses, it was interrupted, or the file cannot be written.
    pub fn heard(&mut self, record: &Value) -> Result<bool> {
        let ours = self.known && record["token"] == u64::from(order());
        match record["type"].as_str() {
            Some("hello") if self.known => bail!(
                "the recorder has started again, and has forgotten what it had not sent: {} of {} samples came",
                self.came(),
                self.taken.map_or(self.instants() as usize, |(_, n)| n)
            ),
            Some("hello") => self.rate_hz = record["rate_hz"].as_f64().filter(|rate| *rate > 0.0),
            Some("reply") if record["token"] == u64::from(who()) => {
                let rate_hz = self.rate_hz.context("the recorder does not record now")?;
                (self.known, self.given) = (true, false);
                let codes = u64::from(self.instants()) * self.channels.len() as u64;
                if codes == 0 || codes > MOST_CODES as u64 {
                    let most = MOST_CODES / self.channels.len().max(1);
                    bail!(
                        "{} samples of {} channels are {}: a recorder has memory for {most} of each, {:.3} s at {rate_hz} Hz",
                        self.instants(),
                        self.channels.len(),
                        if codes == 0 { "none" } else { "too many" },
                        most as f64 / rate_hz
                    );
                }
            }
            Some("reply") if ours => return self.answered(record["status"].as_u64()).map(|()| true),
            Some("end") if self.known && self.taken.is_none() => {
                bail!("the recording has ended before the samples were taken")
            }
            Some("snippet") if ours => {
                let number = |key: &str| record[key].as_u64().context("a snippet has no place");
                self.taken = Some((number("index")?, number("instants")? as usize));
                self.codes.clear();
            }
            Some("samples") if ours => return self.piece(record),
            Some("lost") if self.known && record["class"] == "spectrum" => {
                bail!("{} pieces were lost on the recorder: ask again", record["frames"])
            }
            // What it has to send first is life, too.
            _ => return Ok(self.known && self.taken.is_none()),
        }
        Ok(true)
    }

    /// Instants that have come.
    fn came(&self) -> usize {
        self.codes.len() / self.channels.len().max(1)
    }

    fn answered(&self, status: Option<u64>) -> Result<()> {
        match status.and_then(|s| u8::try_from(s).ok()) {
            Some(DONE) => Ok(()),
            Some(REFUSED) => bail!(
                "the recorder does not take {} samples of {} channels: it has not so much memory, or does not record now",
                self.instants(),
                self.channels.len()
            ),
            _ => bail!("the recorder has no memory for snippets: only one with a link has"),
        }
    }

    fn piece(&mut self, record: &Value) -> Result<bool> {
        let Some((first, instants)) = self.taken else { return Ok(false) };
        let index = record["index"].as_u64().context("a piece has no place")?;
        let next = first + self.came() as u64;
        // Of a snippet before this one, not sent to its end.
        if index < first || record["channels"] != json!(self.channels) {
            return Ok(false);
        }
        if index != next {
            bail!("samples {next} to {index} have not come: ask again");
        }
        let codes = record["codes"].as_array().context("a piece has no codes")?;
        self.codes.extend(codes.iter().map(|code| code.as_i64().and_then(|code| i32::try_from(code).ok())));
        if self.came() >= instants {
            self.write()?;
            self.done = true;
        }
        Ok(true)
    }

    /// Writes the file that was asked for.
    fn write(&self) -> Result<()> {
        let (Some(out), Some(rate_hz)) = (&self.out, self.rate_hz) else { return Ok(()) };
        let whole_hz = rate_hz.round().max(1.0);
        write::codes(out, whole_hz as u32, self.channels.len() as u16, &self.codes)?;
        let missing = self.codes.iter().filter(|code| code.is_none()).count();
        let first = self.taken.map_or(0, |(first, _)| first);
        log::info!(
            "{}: {} samples of channels {:?} at {rate_hz} Hz, from sample {first} on{}{}",
            out.display(),
            self.came(),
            self.channels,
            if missing > 0 { format!("; {missing} missing ones are zeros") } else { String::new() },
            if whole_hz == rate_hz { String::new() } else { format!("; the file says {whole_hz} Hz") },
        );
        Ok(())
    }

    /// Whether the record is to be shown: pieces that go into a file are not.
    pub fn shows(&self, record: &Value) -> bool {
        self.out.is_none() || record["type"] != "samples"
    }

    /// Whether it is whole.
    pub fn done(&self) -> bool {
        self.done
    }

    /// How long the recorder may be silent while it takes samples.
    pub fn patience(&self) -> Duration {
        match self.rate_hz {
            Some(rate_hz) if self.taken.is_none() => {
                Duration::from_secs_f64((f64::from(self.instants()) / rate_hz).min(1e6))
            }
            _ => Duration::ZERO,
        }
    }

    /// What is to be said when it was silent for longer; nothing where it has never answered.
    pub fn silence(&self) -> Option<String> {
        match (self.known, self.taken) {
            (false, _) => None,
            (true, None) => Some(
                "the recorder has said who it is, and has sent no samples: none come without a gap, its records stand before them \
                 (--store DIR takes those into the base station's store), or its software does not know snippets (it says \
                 BadCommand then)"
                    .to_owned(),
            ),
            (true, Some((_, instants))) => Some(format!(
                "the recorder fell silent after {} of {instants} samples",
                self.came()
            )),
        }
    }
}

/// Spectra on their way.
pub struct Spectrum {
    channels: u8,
    /// Of each channel.
    calibration: Option<Box<[Calibration; 4]>>,
    given: bool,
    answered: bool,
    /// Bits of the channels that came, and of those that are to come.
    came: u8,
    of: Option<u8>,
}

impl Spectrum {
    /// Of these channels, from 0; levels by the calibration in a station file, where there is one.
    ///
    /// # Errors
    /// The file is no station's, or knows no sensitivity.
    pub fn new(channels: &[u8], station: Option<&PathBuf>) -> Result<Self> {
        let read = |file: &PathBuf| {
            let station = Station::read(file)?;
            if station.calibration.iter().all(|c| c.reference == "full scale") {
                bail!("{}: no sensitivity and full scale that levels could be made with", file.display());
            }
            Ok(Box::new(station.calibration))
        };
        let calibration = station.map(read).transpose()?;
        Ok(Self { channels: bits(channels), calibration, given: false, answered: false, came: 0, of: None })
    }

    /// The command, if it is due now.
    pub fn due(&self) -> Option<Vec<u8>> {
        let command = Command::SendSpectrum { token: order(), channels: self.channels };
        (!self.given).then(|| bytes_of(&command, &mut [0; COMMAND_BYTES]).to_vec())
    }

    /// What was due was given.
    pub fn given(&mut self) {
        self.given = true;
    }

    /// The recorder says something; whether that brings it on.
    ///
    /// # Errors
    /// It refuses.
    pub fn heard(&mut self, record: &Value) -> Result<bool> {
        if record["token"] != u64::from(order()) {
            return Ok(false);
        }
        match (record["type"].as_str(), record["status"].as_u64()) {
            (Some("reply"), Some(0)) => self.answered = true,
            (Some("reply"), Some(1)) => bail!(
                "the recorder has no spectrum of these channels: it has analysed nothing yet, or does not analyse them"
            ),
            (Some("reply"), _) => bail!("the recorder does not know the command"),
            (Some("spectrum"), _) => {
                let bit = |channel: &Value| channel.as_u64().map_or(0, |c| 1 << (c & 3));
                self.came |= bit(&record["channel"]);
                self.of = record["channels"].as_array().map(|of| of.iter().map(bit).fold(0, |a, b| a | b));
            }
            _ => return Ok(false),
        }
        Ok(true)
    }

    /// The record as it is shown: levels by the calibration.
    pub fn shown(&self, record: &Value) -> Value {
        let mut shown = record.clone();
        if let Some(calibration) = &self.calibration {
            calibrate(&mut shown, calibration.as_ref());
        }
        shown
    }

    /// Whether all have come.
    pub fn done(&self) -> bool {
        self.answered && self.of.is_some_and(|of| of & self.came == of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn talk(out: Option<PathBuf>) -> Snippet {
        let mut talk = Snippet::new(&[2, 0], Length::Seconds(0.04), out).unwrap();
        talk.given();
        assert!(talk.heard(&json!({"type": "hello", "rate_hz": 100.0})).unwrap());
        assert!(talk.due().is_none());
        assert!(talk.heard(&json!({"type": "reply", "token": who(), "status": 0})).unwrap());
        let asked = Command::SendSnippet { token: order(), channels: 0b101, instants: 4 };
        assert_eq!(talk.due().unwrap(), bytes_of(&asked, &mut [0; COMMAND_BYTES]));
        talk.given();
        talk
    }

    fn piece(index: u64, codes: &[i32]) -> Value {
        json!({"type": "samples", "token": order(), "index": index, "channels": [0, 2], "codes": codes})
    }

    #[test]
    fn pieces_become_a_file_once_all_have_come_and_not_before() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("sea.wav");
        let mut talk = talk(Some(out.clone()));
        // What is left of a snippet before.
        assert!(!talk.heard(&piece(7, &[9, 9])).unwrap());
        let taken =
            json!({"type": "snippet", "token": order(), "index": 10, "instants": 4, "channels": [0, 2]});
        assert!(talk.heard(&taken).unwrap());
        assert!(!talk.heard(&piece(8, &[9, 9])).unwrap());
        assert!(talk.heard(&piece(10, &[1, -2, 3, -4])).unwrap());
        assert!(!talk.done() && !out.exists());
        assert!(talk.heard(&piece(12, &[5, -6, 7, -8_388_608])).unwrap());
        assert!(talk.done());
        let wav = std::fs::read(&out).unwrap();
        let (channels, rate_hz) = (u16::from_le_bytes([wav[22], wav[23]]), &wav[24..28]);
        assert_eq!((channels, rate_hz), (2, &100u32.to_le_bytes()[..]));
        let codes = wav[wav.len() - 24..].chunks_exact(3);
        let codes: Vec<i32> = codes.map(|c| i32::from_le_bytes([0, c[0], c[1], c[2]]) >> 8).collect();
        assert_eq!(codes, [1, -2, 3, -4, 5, -6, 7, -8_388_608]);
    }

    #[test]
    fn what_is_missing_or_interrupted_is_said_and_no_file_is_written() {
        let taken =
            json!({"type": "snippet", "token": order(), "index": 10, "instants": 4, "channels": [0, 2]});
        for (last, words) in [
            (piece(12, &[5, 6]), "samples 11 to 12 have not come"),
            (
                json!({"type": "hello", "rate_hz": 100.0}),
                "started again, and has forgotten what it had not sent: 1 of 4",
            ),
            (json!({"type": "lost", "class": "spectrum", "frames": 3}), "3 pieces were lost"),
        ] {
            let dir = tempfile::tempdir().unwrap();
            let mut talk = talk(Some(dir.path().join("sea.wav")));
            assert!(talk.heard(&taken).unwrap());
            assert!(talk.heard(&piece(10, &[1, 2])).unwrap());
            let said = talk.heard(&last).unwrap_err().to_string();
            assert!(said.contains(words), "{said}");
            assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
        }
        let refused = talk(None).heard(&json!({"type": "reply", "token": order(), "status": 1})).unwrap_err();
        assert!(refused.to_string().contains("does not take 4 samples of 2 channels"), "{refused}");
    }

    #[test]
    fn spectra_are_whole_once_the_reply_and_all_channels_have_come() {
        let mut talk = Spectrum::new(&[0, 1, 3], None).unwrap();
        let of = |channel: u8| json!({"type": "spectrum", "token": order(), "channel": channel, "channels": [0, 1]});
        assert!(talk.heard(&of(1)).unwrap());
        assert!(talk.heard(&json!({"type": "reply", "token": order(), "status": 0})).unwrap());
        assert!(!talk.done());
        assert!(talk.heard(&of(0)).unwrap());
        assert!(talk.done());
    }
}
