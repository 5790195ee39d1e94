//! Where files lie on the time axis: each one's first index, by its time and by the samples counted before it.
//!
//! In: start times, as finely as they are written, and lengths. A recorder's clock runs beside its converter's, and times in names are cut
//! off: what a file's time says beyond the samples counted is a gap (or an overlap) only where neither explains it.
//!
//! * Files whose times all are finer than the drift allowed show the drift itself: the median over all that follow each other, and how these
//!   scatter about it. What leaves it by more than that scatter is a gap, down to two samples.
//! * Of coarser times, files that follow each other never differ by as much as the resolution, but for the drift: until that has had the time
//!   to carry a start over to the next second, a whole second is a gap. Later on it cannot be told from the drift, nor is it one the other
//!   way: recorders begin on the second, and a clock that is slow has the next file begin in the second before.

use super::written_time::WrittenTime;
use seabearing_core::kit::{MAD_TO_SD, median};
use time::OffsetDateTime;

/// Drift of a recorder's clock against the times in file names that is not taken for a gap: 50 parts in a million,
/// the tolerance of an ordinary crystal over temperature.
const DRIFT: f64 = 50e-6;
/// Rounding of a time and of a length, samples.
const ROUNDING: f64 = 1.5;
/// Files that follow each other, from how many on their drift is known.
const LEAST_FOLLOWING: usize = 3;
/// Deviations of times about the drift that are none of it.
const STRAY: f64 = 5.0;
/// Share of the resolution that the clock may have drifted by where a whole step of it is a gap: so often is it wrong, at most.
const DRIFTED: f64 = 0.01;

/// One file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stretch {
    /// When it began.
    pub stamp: Option<WrittenTime>,
    /// Its length, samples.
    pub samples: u64,
}

/// What a file's time says against the samples counted.
#[derive(Clone, Copy)]
struct Mark {
    /// The time, in samples since the first file that has one.
    at: f64,
    /// By how much it is ahead of the file's first index.
    ahead: f64,
    resolution_s: f64,
}

impl Mark {
    /// Samples missing (negative: doubled) between this file and a later one, where they are more than the times'
    /// resolution and the clock's drift from one to the other explain.
    fn jump(self, later: Self, rate_hz: f64) -> Option<f64> {
        let jump = later.ahead - self.ahead;
        (jump.abs() > self.resolution(later, rate_hz) + self.drift(later) + ROUNDING).then_some(jump)
    }

    /// The same where those missing are the resolution itself, and the clock has hardly had the time to drift by any of it.
    fn step(self, later: Self, rate_hz: f64) -> Option<f64> {
        let (jump, resolution) = (later.ahead - self.ahead, self.resolution(later, rate_hz));
        let whole = jump > resolution - 1e-3 && jump > ROUNDING;
        (whole && self.drift(later) <= DRIFTED * resolution).then_some(jump)
    }

    /// The coarser of both times' resolutions, samples.
    fn resolution(self, later: Self, rate_hz: f64) -> f64 {
        self.resolution_s.max(later.resolution_s) * rate_hz
    }

    /// By how much the clock may have drifted from this file to a later one, samples.
    fn drift(self, later: Self) -> f64 {
        DRIFT * (later.at - self.at).abs()
    }
}

/// How a file follows the one before it.
#[derive(Clone, Copy)]
struct Following {
    /// Samples between the end of the one before and its own start.
    between: f64,
    /// Length of the one before, and the resolution of both, samples.
    length: f64,
    resolution: f64,
}

impl Following {
    fn all(stretches: &[Stretch], rate_hz: f64) -> Vec<Option<Self>> {
        let of = |pair: &[Stretch]| {
            let [before, this] = pair else { return None };
            let (a, b) = (before.stamp?, this.stamp?);
            let length = before.samples as f64;
            Some(Self {
                between: (b.at - a.at).as_seconds_f64() * rate_hz - length,
                length,
                resolution: a.resolution_s.max(b.resolution_s) * rate_hz,
            })
        };
        std::iter::once(None).chain(stretches.windows(2).map(of)).collect()
    }

    /// Whether the times are finer than the drift allowed, and what is between no more than it.
    fn shows_drift(&self) -> bool {
        let allowed = DRIFT * self.length;
        self.resolution < allowed && self.between.abs() <= allowed + self.resolution + ROUNDING
    }

    /// What is between, beyond a drift (samples for a sample).
    fn beyond(&self, drift: f64) -> f64 {
        self.between - drift * self.length
    }
}

/// What the files that follow each other show of the clock: drift, and scatter about it, samples.
fn drift(following: &[Option<Following>]) -> Option<(f64, f64)> {
    let shown = || following.iter().flatten().filter(|f| f.shows_drift());
    let mut rates: Vec<f64> = shown().map(|f| f.between / f.length).collect();
    if rates.len() < LEAST_FOLLOWING {
        return None;
    }
    let drift = median(&mut rates)?;
    let mut beside: Vec<f64> = shown().map(|f| f.beyond(drift).abs()).collect();
    Some((drift, MAD_TO_SD * median(&mut beside)?))
}

/// The first index of every file, and the index after the last sample. Each time is held against that of the file
/// before, so that drift over days hides no gap, and against the last file after a gap, so that many small gaps show.
pub(super) fn place(stretches: &[Stretch], rate_hz: f64) -> (Vec<u64>, u64) {
    let following = Following::all(stretches, rate_hz);
    let shown = drift(&following);
    let mut next = 0u64;
    let mut origin: Option<OffsetDateTime> = None;
    let (mut before, mut set): (Option<Mark>, Option<Mark>) = (None, None);
    let mut first = Vec::with_capacity(stretches.len());
    for (stretch, following) in stretches.iter().zip(&following) {
        let mut index = next;
        if let Some(stamp) = stretch.stamp {
            let at = (stamp.at - *origin.get_or_insert(stamp.at)).as_seconds_f64() * rate_hz;
            let mut mark = Mark { at, ahead: at - next as f64, resolution_s: stamp.resolution_s };
            let fine =
                shown.zip(following.filter(Following::shows_drift)).and_then(|((drift, scatter), f)| {
                    (f.beyond(drift).abs() > f.resolution + STRAY * scatter + ROUNDING).then_some(f.between)
                });
            let found = fine
                .or_else(|| before.and_then(|m| m.jump(mark, rate_hz)))
                .or_else(|| set.and_then(|m| m.jump(mark, rate_hz).or_else(|| m.step(mark, rate_hz))));
            // Its size is measured from the last file after a gap, so that coarse times do not add up, until the clock may
            // have drifted by more than the times resolve.
            let anchor = set.filter(|set| set.drift(mark) <= set.resolution(mark, rate_hz));
            let jump = found.map(|jump| anchor.map_or(jump, |anchor| mark.ahead - anchor.ahead));
            if let Some(jump) = jump.filter(|jump| next as f64 + jump >= 0.0) {
                index = (next as f64 + jump).round() as u64;
                mark.ahead = at - index as f64;
                set = Some(mark);
            }
            set = set.or(Some(mark));
            before = Some(mark);
        }
        first.push(index);
        next = index.saturating_add(stretch.samples);
    }
    (first, next)
}

/// Files that are joined to the one before though their times, fine enough to tell, say otherwise, where too few follow each other to know
/// the clock's drift: which, and by how many samples they begin late (negative: early).
pub(super) fn doubtful(stretches: &[Stretch], rate_hz: f64) -> Vec<(usize, f64)> {
    let following = Following::all(stretches, rate_hz);
    if drift(&following).is_some() {
        return Vec::new();
    }
    let told = |(k, f): (usize, &Option<Following>)| {
        let f = f.as_ref().filter(|f| f.shows_drift())?;
        (f.between.abs() > f.resolution + ROUNDING).then_some((k, f.between))
    };
    following.iter().enumerate().filter_map(told).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use time::Duration;
    use time::macros::datetime;

    const RATE_HZ: f64 = 1000.0;
    const HOUR: u64 = 3_600_000;

    /// Files of so many samples whose k-th starts so many seconds after the first, by times of so many digits after the second.
    fn files(samples: u64, digits: i32, starts_s: impl IntoIterator<Item = f64>) -> Vec<Stretch> {
        let first = datetime!(2024-01-31 12:00:00 UTC);
        let resolution_s = 10f64.powi(-digits);
        let stamp = |s: f64| WrittenTime {
            at: first
                + Duration::nanoseconds(
                    ((s / resolution_s + 1e-6).floor() * resolution_s * 1e9).round() as i64
                ),
            resolution_s,
        };
        starts_s.into_iter().map(|s| Stretch { stamp: Some(stamp(s)), samples }).collect()
    }

    /// Samples between the files as they are placed.
    fn between(stretches: &[Stretch]) -> Vec<i64> {
        let (first, _) = place(stretches, RATE_HZ);
        first.windows(2).zip(stretches).map(|(w, s)| w[1] as i64 - w[0] as i64 - s.samples as i64).collect()
    }

    #[test]
    fn a_gap_of_half_a_minute_on_day_ten_is_seen_through_the_drift_of_the_clock() {
        // The clock is 30 parts in a million slow: by then 26 s of drift, which are no gap.
        let start = |k: u64| 3600.0 * k as f64 * (1.0 + 30e-6) + if k < 240 { 0.0 } else { 30.0 };
        let found = between(&files(HOUR, 0, (0..260).map(start)));
        for (k, gap) in found.iter().enumerate() {
            let expected = if k == 239 { 30_000..31_001 } else { 0..1 };
            assert!(expected.contains(gap), "{k}: {gap}");
        }
    }

    #[test]
    fn gaps_each_below_the_resolution_show_when_they_add_up() {
        let (first, _) = place(&files(HOUR, 0, (0..40).map(|k| 3600.6 * f64::from(k))), RATE_HZ);
        let lost_s = (first[39] - HOUR * 39) as f64 / RATE_HZ;
        assert!((lost_s - 0.6 * 39.0).abs() < 4.0, "{lost_s}");
    }

    #[test]
    fn a_second_and_a_half_shows_in_names_of_whole_seconds_and_rounding_does_not() {
        for begins in [0.0, 0.2, 0.45, 0.55, 0.8, 0.98] {
            for gap in [1.5, 1.9, 2.5, -2.5] {
                let found = between(&files(10_000, 0, [begins, begins + 10.0, begins + 20.0 + gap]));
                assert!(
                    found[0] == 0 && (found[1] as f64 - 1000.0 * gap).abs() < 1000.0,
                    "{begins} {gap} {found:?}"
                );
            }
            for length in [9_000, 10_001, 10_500, 12_345, 59_999] {
                let start = |k: i32| begins + f64::from(k) * length as f64 / RATE_HZ;
                assert!(between(&files(length, 0, (0..40).map(start))).iter().all(|gap| *gap == 0));
            }
            // A minute each for a day, and a clock that is off.
            for ppm in [-40.0, -8.0, 8.0, 40.0] {
                let start = |k: i32| 5.0 + begins + 60.0 * f64::from(k) * (1.0 + ppm * 1e-6);
                let found = between(&files(60_000, 0, (0..1440).map(start)));
                assert!(found.iter().all(|gap| *gap == 0), "{begins} {ppm}");
            }
        }
    }

    #[test]
    fn two_samples_show_where_times_are_exact_and_the_drift_is_known() {
        for (ppm, gap) in [(0.0, 2), (30.0, 3), (-30.0, -3), (12.0, 40), (0.0, -2)] {
            let start = |k: i32| {
                60.0 * f64::from(k) * (1.0 + ppm * 1e-6) + if k < 4 { 0.0 } else { f64::from(gap) / RATE_HZ }
            };
            let found = between(&files(60_000, 6, (0..9).map(start)));
            for (k, found) in found.into_iter().enumerate() {
                // The clock's own drift over a file may come to it.
                let least = if k == 3 { (gap - 2)..=(gap + 2) } else { 0..=0 };
                assert!(
                    least.contains(&(found as i32)) && (found != 0) == (k == 3),
                    "{ppm} {gap} {k} {found}"
                );
            }
        }
        // Times that scatter by a millisecond show no gap of a few.
        let jitter = |k: i32| 60.0 * f64::from(k) + 1e-3 * (f64::from(k) * 2.3).sin();
        assert!(between(&files(60_000, 6, (0..30).map(jitter))).iter().all(|gap| *gap == 0));
    }

    #[test]
    fn two_files_alone_are_joined_and_it_is_said() {
        let two = files(60_000, 6, [0.0, 60.002]);
        assert_eq!((between(&two), doubtful(&two, RATE_HZ)), (vec![0], vec![(1, 2.0)]));
        assert!(doubtful(&files(60_000, 6, [0.0, 60.0]), RATE_HZ).is_empty());
        assert!(doubtful(&files(60_000, 0, [0.0, 61.0]), RATE_HZ).is_empty());
    }
}
