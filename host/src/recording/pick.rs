//! Which files and channels hold the recorder's four: those of one file, or of several files that begin together.
//!
//! A file of four channels is one recording as it is. Of more, the station file chooses (`channels` in `[array]`). Files of
//! fewer are parts of one recording where they begin at the same time by their names; without times, where their names
//! differ by the last number or their folders alone. They are taken in the order of their names, numbers by value.

use super::Container;
use super::flac::Flac;
use super::wav::{Info, Wav};
use anyhow::Result;
use seabearing_core::block::{CHANNELS, Frame, MISSING};
use std::path::{Path, PathBuf};

/// The first four channels.
pub(super) const FIRST: [usize; CHANNELS] = [0, 1, 2, 3];

/// An open WAV or FLAC file.
pub(super) enum Audio {
    /// WAV.
    Wav(Wav),
    /// FLAC.
    Flac(Flac),
}

impl Audio {
    /// Reads a header.
    ///
    /// # Errors
    /// It is damaged.
    pub(super) fn open(path: &Path, container: Container) -> Result<(Self, Info)> {
        if container == Container::Flac {
            Flac::open(path).map(|(f, i)| (Self::Flac(f), i))
        } else {
            Wav::open(path).map(|(f, i)| (Self::Wav(f), i))
        }
    }

    /// Frames that can be read from here on.
    pub(super) fn count(&mut self) -> u64 {
        let (mut frames, mut count) = (Vec::new(), 0);
        while self.read(&mut frames).is_ok() && !frames.is_empty() {
            count += frames.len() as u64;
        }
        count
    }

    fn pick(&mut self, pick: [usize; CHANNELS]) {
        match self {
            Self::Wav(wav) => wav.pick(pick),
            Self::Flac(flac) => flac.pick(pick),
        }
    }

    fn read(&mut self, out: &mut Vec<Frame>) -> Result<()> {
        match self {
            Self::Wav(wav) => wav.read(out),
            Self::Flac(flac) => flac.read(out),
        }
    }
}

/// The files of one part of a recording, and where the recorder's channels are in them: file and channel.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Source {
    /// The files.
    pub files: Vec<(PathBuf, Container)>,
    /// File and its channel, of each of the recorder's.
    pub pick: [(usize, usize); CHANNELS],
}

/// A part of a recording being read.
pub(super) struct Joined {
    files: Vec<(Audio, Vec<Frame>, usize)>,
    pick: [(usize, usize); CHANNELS],
    /// Frames still to pass over.
    skip: u64,
}

impl Joined {
    /// Opens the files of a part, so many frames after its start.
    ///
    /// # Errors
    /// One of them cannot be read.
    pub(super) fn open(source: &Source, skip: u64) -> Result<Self> {
        // FLAC has no places to go to: it is decoded from its start, and so are files beside it.
        let seekable = source.files.iter().all(|(_, container)| *container == Container::Wav);
        let mut files = Vec::new();
        for (number, (path, container)) in source.files.iter().enumerate() {
            let (mut audio, _) = Audio::open(path, *container)?;
            // Channels of other files are not looked at.
            audio.pick(source.pick.map(|(file, channel)| if file == number { channel } else { 0 }));
            if let (Audio::Wav(wav), true) = (&mut audio, seekable) {
                wav.skip(skip)?;
            }
            files.push((audio, Vec::new(), 0));
        }
        Ok(Self { files, pick: source.pick, skip: if seekable { 0 } else { skip } })
    }

    /// The next frames into `out` (emptied first); none at the end, which is that of the shortest file.
    ///
    /// # Errors
    /// The data are damaged or cut short from here on.
    pub(super) fn read(&mut self, out: &mut Vec<Frame>) -> Result<()> {
        loop {
            self.next(out)?;
            let skipped = self.skip.min(out.len() as u64) as usize;
            self.skip -= skipped as u64;
            let more = skipped > 0 && skipped == out.len();
            out.drain(..skipped);
            if !more {
                return Ok(());
            }
        }
    }

    fn next(&mut self, out: &mut Vec<Frame>) -> Result<()> {
        if let [(audio, ..)] = &mut self.files[..] {
            return audio.read(out);
        }
        out.clear();
        for (audio, held, used) in &mut self.files {
            if *used >= held.len() {
                audio.read(held)?;
                *used = 0;
            }
        }
        let n = self.files.iter().map(|(_, held, used)| held.len() - used).min().unwrap_or(0);
        let files = &self.files;
        out.extend((0..n).map(|i| {
            std::array::from_fn(|c| {
                let frame = files.get(self.pick[c].0).and_then(|(_, held, used)| held.get(used + i));
                frame.map_or(MISSING, |f| f[c])
            })
        }));
        self.files.iter_mut().for_each(|(.., used)| *used += n);
        Ok(())
    }
}

/// A name in the order people give: numbers by their value.
pub(super) fn natural(name: &str) -> Vec<(String, u128)> {
    let mut out: Vec<(String, u128)> = Vec::new();
    let mut digits = false;
    for c in name.chars() {
        match c.to_digit(10) {
            Some(d) => {
                if out.is_empty() {
                    out.push(Default::default());
                }
                if let Some((_, number)) = out.last_mut() {
                    *number = number.saturating_mul(10).saturating_add(u128::from(d));
                }
                digits = true;
            }
            None => {
                if digits || out.is_empty() {
                    out.push(Default::default());
                }
                if let Some((text, _)) = out.last_mut() {
                    text.push(c);
                }
                digits = false;
            }
        }
    }
    out
}

/// A file's name without its last number: what files of one recording without times have in common.
pub(super) fn without_last_number(path: &Path) -> String {
    let name = path.file_stem().and_then(|n| n.to_str()).unwrap_or("");
    let end = name.rfind(|c: char| c.is_ascii_digit()).map_or(0, |at| at + 1);
    let begin = name[..end]
        .rfind(|c: char| !c.is_ascii_digit())
        .map_or(0, |at| at + name[at..].chars().next().map_or(1, char::len_utf8));
    format!("{}{}", &name[..begin], &name[end..])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_ordered_by_their_numbers() {
        let mut names = ["ch10_a.wav", "ch9_a.wav", "ch1_b.wav", "ch1_a.wav", "7.wav"];
        names.sort_by_key(|n| natural(n));
        assert_eq!(names, ["7.wav", "ch1_a.wav", "ch1_b.wav", "ch9_a.wav", "ch10_a.wav"]);
        for (name, rest) in
            [("a/dive3_ch12.wav", "dive3_ch"), ("left.wav", "left"), ("4.wav", ""), ("ü7x.wav", "üx")]
        {
            assert_eq!(without_last_number(Path::new(name)), rest);
        }
    }
}
