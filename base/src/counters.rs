//! What was received and what was not, of all connections together.

use super::stream::Stream;
use seabearing_core::wire::DecoderCounters;

/// What was received and what was not.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Bytes received.
    pub bytes: u64,
    /// Frames decoded, lost (within sessions) and damaged, as the decoders count them.
    pub stream: DecoderCounters,
    /// Records that came over links, each once.
    pub records: u64,
    /// Records that a recorder's full store dropped before they could come.
    pub records_lost: u64,
}

impl std::fmt::Display for Counters {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let DecoderCounters { frames, lost, damaged, unknown, bytes_discarded, .. } = self.stream;
        // Over a link what is lost comes again.
        let lost = match self.records + self.records_lost {
            0 => format!("{lost} lost"),
            _ => format!("{lost} sent again, {} records, {} lost for good", self.records, self.records_lost),
        };
        write!(
            f,
            "{frames} frames, {lost}, {damaged} damaged, {unknown} unknown; {} bytes, {bytes_discarded} discarded",
            self.bytes
        )
    }
}

impl Counters {
    /// Takes in what a connection has counted.
    pub(crate) fn add(&mut self, stream: &Stream) {
        let (line, total) = (stream.line(), &mut self.stream);
        self.bytes += stream.bytes;
        total.frames += line.frames;
        total.lost += line.lost;
        total.repeated += line.repeated;
        total.damaged += line.damaged;
        total.unknown += line.unknown;
        total.bytes_discarded += line.bytes_discarded;
    }
}
