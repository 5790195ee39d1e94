//! A recording of more channels than a recorder has: read four at a time, side by side.

use crate::interrupt;
use crate::recording::{Asked, BlockSource, Recording};
use crate::station::Station;
use anyhow::{Context, Result, bail};
use seabearing_core::block::{CHANNELS, Frame, MISSING};
use std::path::PathBuf;
use time::OffsetDateTime;

/// Samples of all sensors, in their order; `None` where one is missing.
pub(super) struct Wide {
    groups: Vec<Box<dyn BlockSource>>,
    sensors: usize,
}

impl Wide {
    /// Looks for a line's recordings: WAV or FLAC files that hold all sensors together, sensor i where `channels` says.
    ///
    /// # Errors
    /// Nothing usable was found; the line names the file and what to do.
    pub(super) fn find(paths: &[PathBuf], station: &Station, asked: &Asked, channels: &[u8]) -> Result<Self> {
        let of_group = |group: &[u8]| {
            let last = group.last().copied().unwrap_or(0);
            let mut four = [last; CHANNELS];
            for (to, from) in four.iter_mut().zip(group) {
                *to = *from;
            }
            let station = Station { file_channels: Some(four), ..station.clone() };
            Recording::find(paths, &station, asked)?.source(asked.span)
        };
        let groups = channels.chunks(CHANNELS).map(of_group).collect::<Result<_>>()?;
        Ok(Self { groups, sensors: channels.len() })
    }

    /// UTC of sample 0, where the recording has a clock.
    pub(super) fn start(&self) -> Option<OffsetDateTime> {
        self.groups.first()?.start()
    }

    /// Index after the last sample that is promised.
    pub(super) fn expected_end(&self) -> Option<u64> {
        self.groups.first()?.expected_end()
    }

    /// The next block: index of its first instant, and its instants one after another, `sensors` values each (NaN: missing).
    /// `None` at the end, or where an interruption was asked for.
    ///
    /// # Errors
    /// The recording is lost, or its channels come apart.
    pub(super) fn next_block(&mut self, out: &mut Vec<f64>) -> Result<Option<u64>> {
        out.clear();
        if interrupt::asked() {
            return Ok(None);
        }
        let mut first: Option<(u64, usize)> = None;
        let sensors = self.sensors;
        for (g, source) in self.groups.iter_mut().enumerate() {
            let block = source.next_block()?;
            let here = block.as_ref().map(|b| (b.first_index, b.frames.len()));
            if g > 0 && here != first {
                bail!(
                    "the channels of the recording do not hold the same instants: give files that hold all sensors"
                );
            }
            let (Some(block), Some((_, n))) = (block, here) else { return Ok(None) };
            first = here;
            out.resize(n * sensors, 0.0);
            let from = CHANNELS * g;
            for (instant, frame) in out.chunks_exact_mut(sensors).zip(block.frames) {
                place(instant.get_mut(from..).context("more groups than sensors")?, frame);
            }
        }
        Ok(first.map(|(index, _)| index))
    }
}

fn place(to: &mut [f64], frame: &Frame) {
    for (to, code) in to.iter_mut().zip(frame) {
        *to = if *code == MISSING { f64::NAN } else { f64::from(*code) };
    }
}
