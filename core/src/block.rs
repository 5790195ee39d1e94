//! What enters the core: blocks of four-channel samples, each with the index of its first sample.
//!
//! Samples are the converter's integer codes, right-justified in `i32`; a floating-point recording is scaled to
//! 24-bit codes before it comes here. Time is the sample index and nothing else: a jump of the index is a gap.

/// Number of channels of every recorder this core knows.
pub const CHANNELS: usize = 4;

/// The code that stands for "no valid sample here" (a NaN in a recording, a converter frame whose CRC failed).
pub const MISSING: i32 = i32::MIN;

/// One instant of all channels, in recorder channel order.
pub type Frame = [i32; CHANNELS];

/// A run of consecutive samples.
#[derive(Clone, Copy, Debug)]
pub struct Block<'a> {
    /// Index of the first sample since the recording (or the recorder) started.
    pub first_index: u64,
    /// The samples; may be of any length, also empty.
    pub frames: &'a [Frame],
}
