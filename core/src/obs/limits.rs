//! Capacities of the ocean-bottom chain, each with its reason. Everything is sized for 62.5 Hz after decimation.

/// Samples in a transform frame: 20.48 s at 50 Hz, long against the delays between paths (at most 5.8 s).
pub const FRAME: usize = 1024;

/// Samples from one frame to the next.
pub const HOP: usize = FRAME / 2;

/// Channels the estimators use: pressure, north, east.
pub const USED_CHANNELS: usize = 3;

/// Highest rate the transforms run at, Hz; faster recordings are decimated by a whole number.
pub const MAX_INNER_RATE_HZ: f64 = 62.5;

/// Largest decimation: 500 Hz to 62.5 Hz.
pub const MAX_DECIMATION: usize = 8;

/// Frames in a three-minute window: 180 s / 8.192 s + 2 at 62.5 Hz (17 or 18 at 50 Hz).
pub const WINDOW_FRAMES: usize = 24;

/// Frames in one minute's range: 60 s / 8.192 s + 1 at 62.5 Hz.
pub const MINUTE_FRAMES: usize = 9;

/// Bins between 11 and 24 Hz: 266 at 50 Hz, never more at another rate.
pub const AZIMUTH_BINS: usize = 266;

/// Steps of a stored azimuth in a full circle (0.35 degrees).
pub const CIRCLE: usize = 1024;

/// Azimuths searched (1.4 degrees; the estimate is refined between them).
pub const AZIMUTHS: usize = 256;

/// Azimuths of a profile, a quarter of the circle about where most frames point: the peak and all that counts beside it.
pub const SPAN: usize = AZIMUTHS / 4;

/// Quefrencies kept: the longest delay (5.77 s at RR03) and the pulse's flank, at 62.5 Hz.
pub const QUEFRENCIES: usize = 384;

/// Delays between two quefrencies at which the envelope is computed: the envelope then bends so little between
/// them that a straight line errs by less than 0.5 %.
pub const FINE: usize = 4;

/// Delays of the envelope.
pub const DELAYS: usize = FINE * QUEFRENCIES;

/// Ranges of the interference model: 0 to 50 km in steps of [`RANGE_STEP_M`].
pub const MODEL_RANGES: usize = 716;

/// Step of the interference model, m (a quarter of its shortest period in range).
pub const RANGE_STEP_M: f32 = 70.0;

/// Range cells of the recursive posterior: two model steps each.
pub const RANGE_CELLS: usize = MODEL_RANGES / 2;

/// Width of a range cell, m.
pub const CELL_M: f32 = 2.0 * RANGE_STEP_M;

/// Radial speeds of the posterior: −13 to 13 m/s (25 knots) in steps of 1 m/s.
pub const SPEEDS: usize = 27;

/// Step of radial speed, m/s.
pub const SPEED_STEP_M_S: f32 = 1.0;

/// Greatest radial speed, m/s.
pub const MAX_SPEED_M_S: f32 = 13.0;

/// Directions reported for one window.
pub const AZIMUTH_MODES: usize = 3;

/// Ranges reported for one minute.
pub const RANGE_MODES: usize = 4;

/// Vessels followed at once.
pub const VESSELS: usize = 4;

/// Strengths that a vessel's echoes may have against the table's.
pub const CLASSES: usize = 3;
