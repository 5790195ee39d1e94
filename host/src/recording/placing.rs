//! Where files lie on the time axis: each one's first index, by its time and by the samples counted before it.
//!
//! In: start times, as finely as they are written, and lengths. A recorder's clock runs beside its converter's, and times in names are cut
//! off: what a file's time says beyond the samples counted is a gap (or an overlap) only where neither explains it.
//!
//! * Files whose times all are finer than the drift allowed show the drift itself: the median over all that follow each other, and how these
//!   scatter about it. What leaves it by more than that scatter is a gap, down to two samples.
//! * Of coarser times, files that follow each other never differ by as much as the resolution, but for the drift: until that has had the time
//!   to carry a start over to the next second, a whole second is doubtful ([`Placed::doubtful`]). Later on it cannot be told from the drift, nor is it
//!   doubtful the other way: recorders begin on the second, and a clock that is slow has the next file begin in the second before.

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
/// Share of the resolution that the clock may have drifted by where a whole step of it is doubtful: so often is that the drift's, at most.
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

    /// The same where those missing are the resolution itself.
    fn step(self, later: Self, rate_hz: f64) -> Option<f64> {
        let (jump, resolution) = (later.ahead - self.ahead, self.resolution(later, rate_hz));
        (jump > resolution - 1e-3 && jump > ROUNDING).then_some(jump)
    }

    /// Whether the clock has hardly had the time to drift by any of the resolution until a later file.
    fn is_fresh(self, later: Self, rate_hz: f64) -> bool {
        self.drift(later) <= DRIFTED * self.resolution(later, rate_hz)
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

/// Where files lie.
pub(super) struct Placed {
    /// The first index of every one.
    pub first: Vec<u64>,
    /// The index after the last sample.
    pub end: u64,
    /// Those that may follow a gap and are joined.
    pub doubtful: Vec<Doubtful>,
}

/// A file that is joined to the one before and begins, by its time, somewhere else.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Doubtful {
    /// Which.
    pub file: usize,
    /// By how many samples it begins late; negative: early.
    pub samples: f64,
    /// Whether that is a step of the resolution, and not what a clock drifts.
    pub step: bool,
}

impl Doubtful {
    /// What to say of it.
    pub(super) fn said(&self, rate_hz: f64) -> String {
        let s = self.samples.abs() / rate_hz;
        if self.step {
            return format!(
                "begins {s} s after the end of the file before it, by times in steps of that: joined, and up to {} s may be missing; \
                 finer times (FILE.start) would tell",
                2.0 * s
            );
        }
        let way = if self.samples > 0.0 { "after" } else { "before" };
        format!(
            "begins {:.3} ms {way} the end of the file before it, which a clock may drift by: joined; more files would tell",
            1e3 * s
        )
    }
}

/// Places files. Each time is held against that of the file
/// before, so that drift over days hides no gap, and against the last file after a gap, so that many small gaps show.
pub(super) fn place(stretches: &[Stretch], rate_hz: f64) -> Placed {
    let following = Following::all(stretches, rate_hz);
    let shown = drift(&following);
    let mut next = 0u64;
    let mut origin: Option<OffsetDateTime> = None;
    let (mut before, mut set): (Option<Mark>, Option<Mark>) = (None, None);
    let mut first = Vec::with_capacity(stretches.len());
    let mut doubtful = Vec::new();
    for (k, (stretch, following)) in stretches.iter().zip(&following).enumerate() {
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
                .or_else(|| set.and_then(|m| m.jump(mark, rate_hz)));
            if found.is_none() {
                let fine = following.filter(|f| shown.is_none() && f.shows_drift());
                let fine = fine.filter(|f| f.between.abs() > f.resolution + ROUNDING).map(|f| f.between);
                let fresh = set.is_some_and(|m| m.is_fresh(mark, rate_hz));
                let step = before.filter(|_| fresh).and_then(|m| m.step(mark, rate_hz));
                let one = |samples| Doubtful { file: k, samples, step: fine.is_none() };
                doubtful.extend(fine.or(step).map(one));
            }
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
    Placed { first, end: next, doubtful }
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
        let first = place(stretches, RATE_HZ).first;
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
        let first = place(&files(HOUR, 0, (0..40).map(|k| 3600.6 * f64::from(k))), RATE_HZ).first;
        let lost_s = (first[39] - HOUR * 39) as f64 / RATE_HZ;
        assert!((lost_s - 0.6 * 39.0).abs() < 4.0, "{lost_s}");
    }

    #[test]
    fn a_second_and_a_half_shows_in_names_of_whole_seconds_and_rounding_does_not() {
        for begins in [0.0, 0.2, 0.45, 0.55, 0.8, 0.98] {
            for gap in [1.5, 1.9, 2.5, -2.5] {
                let placed = place(&files(10_000, 0, [begins, begins + 10.0, begins + 20.0 + gap]), RATE_HZ);
                let found = placed.first[2] as f64 - 20_000.0;
                // Where the names are but a second apart it is joined and said.
                let told = match placed.doubtful[..] {
                    [] => (found - 1000.0 * gap).abs() < 1000.0 && found != 0.0,
                    [one] => {
                        found == 0.0 && gap < 2.0 && one == Doubtful { file: 2, samples: 1000.0, step: true }
                    }
                    _ => false,
                };
                assert!(told && placed.first[1] == 10_000, "{begins} {gap} {found} {:?}", placed.doubtful);
            }
            let silent = |length: u64, n: i32, period_s: f64, from_s: f64| {
                let files = files(length, 0, (0..n).map(|k| from_s + period_s * f64::from(k)));
                place(&files, RATE_HZ).doubtful.is_empty() && between(&files).iter().all(|gap| *gap == 0)
            };
            for length in [9_000, 10_001, 10_500, 12_345, 59_999] {
                assert!(silent(length, 40, length as f64 / RATE_HZ, begins), "{begins} {length}");
            }
            // A minute each for a day, and a clock that is off.
            for ppm in [-40.0, -8.0, 8.0, 40.0] {
                assert!(silent(60_000, 1440, 60.0 * (1.0 + ppm * 1e-6), 5.0 + begins), "{begins} {ppm}");
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
        let said = |digits, end_s| {
            let two = files(60_000, digits, [0.0, end_s]);
            (between(&two), place(&two, RATE_HZ).doubtful.first().map(|d| d.said(RATE_HZ)))
        };
        let (found, line) = said(6, 60.002);
        assert!(found == [0] && line.unwrap().starts_with("begins 2.000 ms after"));
        assert_eq!(said(6, 60.0), (vec![0], None));
        let (found, line) = said(0, 61.2);
        assert!(found == [0] && line.unwrap().starts_with("begins 1 s after"));
    }
}
