//! A vessel whose track is known (GPS or AIS): its position at any time between the given ones.

use crate::between::{between, mixed};

/// One known position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackPoint {
    /// Time, seconds.
    pub t_s: f64,
    /// East, North, Up, metres, in the frame of the station.
    pub position_m: [f64; 3],
}

/// Why a track cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum KnownTrackError {
    /// Fewer than two positions.
    #[error("a track needs two positions")]
    TooShort,
    /// A time or coordinate is not a finite number.
    #[error("a time or coordinate of the track is not a number")]
    NotFinite,
    /// Times do not increase at this index.
    #[error("the track's time does not increase at position {n}", n = .0 + 1)]
    NotIncreasing(usize),
}

/// Checks a track.
///
/// # Errors
/// [`KnownTrackError`] says what is wrong.
pub fn check(track: &[TrackPoint]) -> Result<(), KnownTrackError> {
    if track.len() < 2 {
        return Err(KnownTrackError::TooShort);
    }
    let finite = |p: &TrackPoint| p.t_s.is_finite() && p.position_m.iter().all(|x| x.is_finite());
    if !track.iter().all(finite) {
        return Err(KnownTrackError::NotFinite);
    }
    for (i, (a, b)) in track.iter().zip(track.iter().skip(1)).enumerate() {
        if b.t_s <= a.t_s {
            return Err(KnownTrackError::NotIncreasing(i + 1));
        }
    }
    Ok(())
}

/// Position at a time by straight interpolation; `None` outside the track or across a gap longer than `gap_s`.
pub fn position_at(track: &[TrackPoint], t_s: f64, gap_s: f64) -> Option<[f64; 3]> {
    let (a, b, share) = between(track, |p| p.t_s, t_s)?;
    // At a given position itself no gap matters.
    let known = share == 0.0 || share == 1.0 || b.t_s - a.t_s <= gap_s;
    known
        .then(|| mixed(&a.position_m, &b.position_m, share))
        .filter(|place| place.iter().all(|x| x.is_finite()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn track() -> [TrackPoint; 3] {
        [(0.0, 0.0), (10.0, 100.0), (100.0, 1000.0)]
            .map(|(t_s, x)| TrackPoint { t_s, position_m: [x, -x, 0.0] })
    }

    #[test]
    fn positions_between_and_outside() {
        let t = track();
        assert_eq!(check(&t), Ok(()));
        assert_eq!(position_at(&t, 5.0, 60.0), Some([50.0, -50.0, 0.0]));
        assert_eq!(position_at(&t, 10.0, 60.0), Some([100.0, -100.0, 0.0]));
        assert_eq!(position_at(&t, 50.0, 60.0), None);
        assert_eq!(position_at(&t, -0.1, 60.0), None);
        assert_eq!(position_at(&t, 100.1, 600.0), None);
        assert_eq!(position_at(&t, f64::NAN, 600.0), None);
    }

    #[test]
    fn bad_tracks_are_named() {
        let mut t = track();
        t[2].t_s = 5.0;
        assert_eq!(check(&t), Err(KnownTrackError::NotIncreasing(2)));
        assert_eq!(check(&t[..1]), Err(KnownTrackError::TooShort));
    }
}
