//! Recordings of a rate far above the recorder's: what is done with them, in words.

/// Up to so many times the recorder's rate a file is of a converter like the recorder's own, whose spikes would be as high there.
pub(super) const ALIKE: f64 = 4.0;

/// Share of half the lower rate that passes a change of rate unchanged.
pub(super) const PASS: f64 = 0.88;

/// What is to be said of a change of rate; `None` where a station's files may well be so.
pub(super) fn said(from_hz: f64, to_hz: f64) -> Option<String> {
    (from_hz > ALIKE * to_hz).then(|| {
        format!(
            "the recording has {from_hz} samples a second, the station file says {to_hz} (rate_hz): it is brought to {to_hz}, without what \
             is above {:.0} Hz",
            PASS * 0.5 * to_hz
        )
    })
}
