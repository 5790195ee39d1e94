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
        let missing = *self.missing.get(channel).filter(|n| **n > 0)?;
        if missing == self.frames {
            return Some(
                "holds no number at all (NaN or infinite throughout) and counts as dead: write the file again from what was recorded"
                    .to_owned(),
            );
        }
        let at_s = self.first[channel] as f64 / rate_hz;
        Some(if missing == 1 {
            format!("one sample, at {at_s:.3} s, is no number (NaN or infinite) and counts as lost")
        } else {
            format!(
                "{missing} of {} samples, the first at {at_s:.3} s, are no numbers (NaN or infinite) and count as lost: look at what wrote the file",
                self.frames
            )
        })
    }
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
        assert!(invalid.said(1, 100.0).unwrap().contains("one sample, at 1.000 s, is no number"));
        assert!(invalid.said(2, 100.0).unwrap().contains("no number at all"));
        assert!(invalid.said(3, 100.0).unwrap().starts_with("2 of 102 samples"));
    }
}
