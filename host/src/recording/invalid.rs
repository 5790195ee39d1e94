//! Samples of a file that are no numbers (NaN, infinite), channel by channel, and what to say of them.

use seabearing_core::block::{CHANNELS, Frame, MISSING};

/// Counts of one file's, or of several that hold its channels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Invalid {
    frames: u64,
    missing: [u64; CHANNELS],
    /// The first of them.
    first: [u64; CHANNELS],
}

impl Invalid {
    /// Takes the next frames.
    pub(super) fn take(&mut self, frames: &[Frame]) {
        for c in 0..CHANNELS {
            let missing = frames.iter().filter(|f| f[c] == MISSING).count() as u64;
            if missing > 0 && self.missing[c] == 0 {
                self.first[c] = self.frames + frames.iter().take_while(|f| f[c] != MISSING).count() as u64;
            }
            self.missing[c] += missing;
        }
        self.frames += frames.len() as u64;
    }

    /// What to say of a channel, where there is anything.
    pub(super) fn said(&self, channel: usize, rate_hz: f64) -> Option<String> {
        let first = *self.first.get(channel)?;
        said(self.missing[channel], self.frames, Some(first as f64 / rate_hz))
    }
}

/// What to say of so many samples that are no numbers, of so many in all, the first at a time (seconds) where that is known.
pub(super) fn said(missing: u64, all: u64, first_s: Option<f64>) -> Option<String> {
    if missing == 0 {
        return None;
    }
    if missing == all {
        return Some(
            "holds no number at all (NaN or infinite throughout) and counts as dead: write the file again from what was recorded"
                .to_owned(),
        );
    }
    let first = first_s.map_or_else(String::new, |t| format!(", the first at {t:.3} s,"));
    Some(format!(
        "{missing} of {all} samples{first} are no numbers (NaN or infinite) and count as lost: look at what wrote the file"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_channel_without_numbers_and_single_samples_are_told_apart() {
        let mut invalid = Invalid::default();
        invalid.take(&[[1, 2, MISSING, 3]; 100]);
        assert_eq!(invalid.said(0, 100.0), None);
        invalid.take(&[[1, MISSING, MISSING, MISSING], [1, 2, MISSING, MISSING]]);
        assert_eq!(invalid.said(0, 100.0), None);
        assert!(invalid.said(1, 100.0).unwrap().starts_with("1 of 102 samples, the first at 1.000 s,"));
        assert!(invalid.said(2, 100.0).unwrap().contains("no number at all"));
        assert!(invalid.said(3, 100.0).unwrap().starts_with("2 of 102 samples"));
    }
}
