//! When a sample was: UTC as a line over the sample index, learnt from moments at which both were known.
//!
//! Enters: pairs of a sample's index and the UTC at which it was, each with its standard deviation ([`UtcClock::note`]).
//! Leaves: [`Time`] records, from which UTC and its uncertainty follow for every index ([`Times::utc`]), at the recorder and
//! at a base station alike.
//!
//! The sample clock's relative error wanders as a random walk of variance [`WANDER`]² a second, so its time error is an
//! integrated one. With τ nominal seconds between two indices, time T and relative error y follow
//!
//! ```text
//! T' = T + τ (1 + y)          Q = q [τ³/3  τ²/2]      q = WANDER²
//! y' = y                           [τ²/2  τ   ]
//! ```
//!
//! and a pair is a measurement of T: a Kalman filter of two states, a few dozen multiplications a pair, 80 bytes.

mod times;

pub use times::{Times, along};

use crate::math::f64::sqrt;
use crate::wire::Time;

/// Change of the sample clock's relative error in a second, one standard deviation: a crystal whose temperature changes
/// slowly (3e-7 in a day).
pub const WANDER: f64 = 1e-9;
/// Relative error of the sample clock before anything is known, one standard deviation.
const UNKNOWN_DRIFT: f64 = 1e-4;
/// Pairs further from the line than so many standard deviations are refused.
const GATE: f64 = 6.0;
/// Refused pairs in a row that agree with each other: then the clock that tells UTC has stepped.
const STEP_AFTER: u8 = 3;

/// A sample's index and the UTC at which it was.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// The sample.
    pub index: u64,
    /// Microseconds since 1970-01-01, leap seconds not counted.
    pub utc_us: i64,
    /// Standard deviation of that, s.
    pub sd_s: f64,
}

/// What became of a pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Noted {
    /// It is part of the line, which now is this.
    Taken(Time),
    /// It does not fit the line: a wrong second, or the first of a step.
    Refused,
    /// The clock that tells UTC has stepped by so many microseconds; the line starts again.
    Stepped(Time, i64),
}

/// Time and relative error of the sample clock at an index.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Line {
    index: u64,
    /// Where it began, and how far it is from there: microseconds since 1970 are not exact to one in 64 bits of floating point,
    /// and what is left out each second would add up.
    origin_us: i64,
    since_us: f64,
    drift: f64,
    /// Variance of the time, s²; covariance, s; variance of the drift.
    tt: f64,
    ty: f64,
    yy: f64,
}

/// Nominal seconds from one index to another, negative where that is before.
fn seconds(from: u64, to: u64, rate_hz: f64) -> f64 {
    to.wrapping_sub(from) as i64 as f64 / rate_hz
}

/// Variance that the wandering alone gives the time in τ seconds.
fn wandered(tau: f64) -> f64 {
    let tau = tau.abs();
    WANDER * WANDER * tau * tau * tau / 3.0
}

impl Line {
    /// Begins at a pair; the drift stays what it was.
    fn begin(pair: &Pair, drift: f64, yy: f64) -> Self {
        let tt = pair.sd_s * pair.sd_s;
        Self { index: pair.index, origin_us: pair.utc_us, since_us: 0.0, drift, tt, ty: 0.0, yy }
    }

    /// How far a pair is from it, s, at the pair's index.
    fn miss_s(&self, pair: &Pair) -> f64 {
        (pair.utc_us.wrapping_sub(self.origin_us) as f64 - self.since_us) * 1e-6
    }

    fn predicted(&self, index: u64, rate_hz: f64) -> Self {
        let tau = seconds(self.index, index, rate_hz);
        let q = WANDER * WANDER;
        Self {
            index,
            origin_us: self.origin_us,
            since_us: self.since_us + 1e6 * tau * (1.0 + self.drift),
            drift: self.drift,
            tt: self.tt + tau * (2.0 * self.ty + tau * self.yy) + wandered(tau),
            ty: self.ty + tau * self.yy + q * tau * tau.abs() / 2.0,
            yy: self.yy + q * tau.abs(),
        }
    }

    /// Takes in a pair at this index.
    fn updated(&self, pair: &Pair) -> Self {
        let innovation = self.miss_s(pair);
        let (k_t, k_y) = {
            let s = self.tt + pair.sd_s * pair.sd_s;
            (self.tt / s, self.ty / s)
        };
        Self {
            index: self.index,
            origin_us: self.origin_us,
            since_us: self.since_us + 1e6 * k_t * innovation,
            drift: self.drift + k_y * innovation,
            tt: (1.0 - k_t) * self.tt,
            ty: (1.0 - k_t) * self.ty,
            yy: (self.yy - k_y * self.ty).max(0.0),
        }
    }

    fn told(&self) -> Time {
        let (sd, sd_drift) = (sqrt(self.tt), sqrt(self.yy));
        let product = sd * sd_drift;
        Time {
            index: self.index,
            utc_us: self.origin_us.saturating_add((self.since_us + 0.5) as i64),
            sd_s: sd as f32,
            drift: self.drift as f32,
            sd_drift: sd_drift as f32,
            correlation: if product > 0.0 { (self.ty / product) as f32 } else { 0.0 },
        }
    }
}

/// Learns UTC; knows nothing at first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UtcClock {
    line: Option<Line>,
    /// The newest refused pair, and how many before it agreed with each other.
    doubt: Option<(Pair, u8)>,
}

impl UtcClock {
    /// Nothing known.
    pub const fn new() -> Self {
        Self { line: None, doubt: None }
    }

    /// Goes on with a line that was told before.
    pub fn resumed(line: &Time) -> Self {
        let (sd, sd_drift) = (f64::from(line.sd_s), f64::from(line.sd_drift));
        let line = Line {
            index: line.index,
            origin_us: line.utc_us,
            since_us: 0.0,
            drift: line.drift.into(),
            tt: sd * sd,
            ty: f64::from(line.correlation) * sd * sd_drift,
            yy: sd_drift * sd_drift,
        };
        Self { line: Some(line), doubt: None }
    }

    /// From here on samples have numbers that are estimates, with this standard deviation in seconds: what was known of their UTC is known
    /// no better. The line as it is then.
    pub fn loosen(&mut self, index: u64, sd_s: f64, rate_hz: f64) -> Option<Time> {
        let mut line = self.line?.predicted(index, rate_hz);
        line.tt += sd_s * sd_s;
        self.line = Some(line);
        Some(line.told())
    }

    /// Takes a pair; samples come at `rate_hz` nominally. One of an earlier sample than the line's is judged like any other; where the
    /// count of samples begins anew, this must too ([`Self::new`]).
    pub fn note(&mut self, pair: Pair, rate_hz: f64) -> Noted {
        let pair = Pair { sd_s: pair.sd_s.max(1e-6), ..pair };
        let Some(line) = self.line else {
            let line = Line::begin(&pair, 0.0, UNKNOWN_DRIFT * UNKNOWN_DRIFT);
            (self.line, self.doubt) = (Some(line), None);
            return Noted::Taken(line.told());
        };
        let predicted = line.predicted(pair.index, rate_hz);
        let off_s = predicted.miss_s(&pair);
        if off_s * off_s <= GATE * GATE * (predicted.tt + pair.sd_s * pair.sd_s) {
            // An earlier pair that is no better than what the line says of its moment tells nothing.
            let tells = line.index <= pair.index || pair.sd_s * pair.sd_s < predicted.tt;
            let line = if tells { predicted.updated(&pair) } else { line };
            (self.line, self.doubt) = (Some(line), None);
            return Noted::Taken(line.told());
        }
        let agreeing = self.doubt.filter(|(before, _)| {
            let tau = seconds(before.index, pair.index, rate_hz);
            let off_s = (pair.utc_us.wrapping_sub(before.utc_us)) as f64 * 1e-6 - tau * (1.0 + line.drift);
            let drifted = tau * tau * predicted.yy;
            off_s * off_s <= GATE * GATE * (before.sd_s * before.sd_s + pair.sd_s * pair.sd_s + drifted)
        });
        let count = agreeing.map_or(0, |(_, count)| count).saturating_add(1);
        self.doubt = Some((pair, count));
        if count < STEP_AFTER {
            return Noted::Refused;
        }
        let line = Line::begin(&pair, predicted.drift, predicted.yy);
        (self.line, self.doubt) = (Some(line), None);
        Noted::Stepped(line.told(), (off_s * 1e6) as i64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE_HZ: f64 = 100.0;
    const START_US: i64 = 1_790_000_000_000_000;

    /// Normally distributed numbers, the same every time (twelve uniform ones, less six).
    struct Normal(u64);

    impl Normal {
        fn next(&mut self) -> f64 {
            let mut uniform = || {
                self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
                let x = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
                let x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
                (x >> 11) as f64 / (1u64 << 53) as f64
            };
            (0..12).map(|_| uniform()).sum::<f64>() - 6.0
        }
    }

    /// A sample clock that wanders as assumed: true microseconds at every `every`-th of a second's samples.
    struct Crystal {
        normal: Normal,
        drift: f64,
        late_s: f64,
        index: u64,
    }

    impl Crystal {
        fn new(seed: u64) -> Self {
            Self { normal: Normal(seed), drift: 40e-6, late_s: 0.0, index: 0 }
        }

        fn go(&mut self, seconds: f64) {
            // The two correlated parts of the noise over the step.
            let (a, b) = (self.normal.next(), self.normal.next());
            let wander = WANDER * seconds.sqrt();
            self.late_s += seconds * self.drift + wander * seconds * (a / 2.0 + b / 12f64.sqrt());
            self.drift += wander * a;
            self.index += (seconds * RATE_HZ) as u64;
        }

        fn utc_us(&self) -> f64 {
            START_US as f64 + self.index as f64 / RATE_HZ * 1e6 + self.late_s * 1e6
        }

        fn pair(&mut self, sd_s: f64) -> Pair {
            let noise_us = sd_s * 1e6 * self.normal.next();
            Pair { index: self.index, utc_us: (self.utc_us() + noise_us).round() as i64, sd_s }
        }
    }

    /// Root mean square of errors in units of their stated deviation, and the share within two.
    fn score(errors: &[f64]) -> (f64, f64) {
        let n = errors.len() as f64;
        let inside = errors.iter().filter(|e| e.abs() <= 2.0).count() as f64;
        ((errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt(), inside / n)
    }

    #[test]
    fn a_year_with_outages_and_wrong_seconds_stays_inside_its_stated_uncertainty() {
        let (mut after, mut inside) = (std::vec::Vec::new(), std::vec::Vec::new());
        let mut refused = 0;
        for seed in 0..20 {
            let mut crystal = Crystal::new(1000 + seed);
            let (mut clock, mut times) = (UtcClock::new(), Times::default());
            let mut passed: std::vec::Vec<(u64, f64)> = std::vec::Vec::new();
            for hour in 0..365 * 24 {
                crystal.go(3600.0);
                // Pulses for a week, then none for up to three.
                let heard = hour % (24 * 28) < 24 * 7;
                if heard {
                    let mut pair = crystal.pair(20e-6);
                    if hour % 97 == 5 && hour % (24 * 28) > 24 {
                        pair.utc_us += 1_000_000;
                    }
                    match clock.note(pair, RATE_HZ) {
                        Noted::Taken(time) => times.note(time, false, RATE_HZ),
                        Noted::Refused => refused += 1,
                        Noted::Stepped(..) => panic!("no clock stepped"),
                    }
                    for (index, utc_us) in passed.drain(..) {
                        let (told_us, sd_s) = times.utc(index, RATE_HZ).unwrap();
                        inside.push((told_us as f64 - utc_us) * 1e-6 / sd_s);
                    }
                }
                let (told_us, sd_s) = times.utc(crystal.index, RATE_HZ).unwrap();
                if !heard {
                    after.push((told_us as f64 - crystal.utc_us()) * 1e-6 / sd_s);
                    passed.push((crystal.index, crystal.utc_us()));
                }
            }
        }
        assert!(refused > 300, "{refused}");
        // Errors of one outage belong together: the numbers scatter as 260 outages do.
        for (name, errors) in [("before the pulse is back", after), ("looking back", inside)] {
            let (rms, share) = score(&errors);
            assert!((0.5..1.2).contains(&rms) && share > 0.92, "{name}: {rms} {share}");
        }
    }

    #[test]
    fn a_pulse_a_second_for_an_hour_leaves_no_bias() {
        // 2.88 ppm fast, told to the microsecond: what each second rounds away must not add up.
        let mut clock = UtcClock::new();
        let us = |second: u64| START_US + second as i64 * 1_000_000 - (second as f64 * 2.88) as i64;
        let mut worst = 0;
        for second in 0..3600 {
            let pair = Pair { index: second * RATE_HZ as u64, utc_us: us(second), sd_s: 2e-6 };
            let Noted::Taken(time) = clock.note(pair, RATE_HZ) else { panic!("{second} was refused") };
            worst = worst.max(time.utc_us.abs_diff(pair.utc_us));
        }
        assert!(worst <= 1, "{worst}");
    }

    #[test]
    fn a_step_is_believed_the_third_time_and_lost_pulses_are_none() {
        let mut crystal = Crystal::new(7);
        let mut clock = UtcClock::new();
        for second in 0..600 {
            crystal.go(1.0);
            if second % 5 == 0 {
                assert!(matches!(clock.note(crystal.pair(1e-5), RATE_HZ), Noted::Taken(_)));
            }
        }
        let mut step = |clock: &mut UtcClock, by_us: i64| {
            crystal.go(1.0);
            let pair = crystal.pair(1e-5);
            clock.note(Pair { utc_us: pair.utc_us + by_us, ..pair }, RATE_HZ)
        };
        assert_eq!(step(&mut clock, 500_000), Noted::Refused);
        assert_eq!(step(&mut clock, 500_000), Noted::Refused);
        let stepped = step(&mut clock, 500_000);
        assert!(matches!(stepped, Noted::Stepped(_, us) if (us - 500_000).abs() < 100), "{stepped:?}");
        assert!(matches!(step(&mut clock, 500_000), Noted::Taken(_)));
        // Wrong seconds that do not agree with each other are no step.
        for us in [1_000_000, -1_000_000, 2_000_000, 5_000_000] {
            assert_eq!(step(&mut clock, us), Noted::Refused);
        }
        assert!(matches!(step(&mut clock, 500_000), Noted::Taken(_)));
    }

    #[test]
    fn estimated_numbers_are_known_no_better_than_the_estimate_and_the_next_pulse_mends_them() {
        let mut clock = UtcClock::new();
        let pair = |second: u64, off_us: i64| {
            let utc_us = START_US + 1_000_000 * second as i64 + off_us;
            Pair { index: second * RATE_HZ as u64, utc_us, sd_s: 2e-6 }
        };
        assert_eq!(clock.loosen(5, 0.1, RATE_HZ), None);
        for second in 0..60 {
            clock.note(pair(second, 0), RATE_HZ);
        }
        let told = clock.loosen(6000, 0.5, RATE_HZ).unwrap();
        assert!((told.sd_s - 0.5).abs() < 1e-3 && told.index == 6000, "{told:?}");
        // The estimate was 0.7 s wrong: no step, and right at once.
        let mended = clock.note(pair(61, 700_000), RATE_HZ);
        let Noted::Taken(time) = mended else { panic!("{mended:?}") };
        assert!((time.utc_us - pair(61, 700_000).utc_us).abs() < 10 && time.sd_s < 1e-5, "{time:?}");
    }

    #[test]
    fn a_late_record_of_before_an_estimate_or_a_step_has_the_time_of_the_line_of_before() {
        let utc_us = |second: u64| START_US + 1_000_000 * second as i64;
        let pair = |second: u64, off_us: i64| Pair {
            index: second * RATE_HZ as u64,
            utc_us: utc_us(second) + off_us,
            sd_s: 2e-6,
        };
        let noted = |clock: &mut UtcClock, times: &mut Times, pair: Pair| match clock.note(pair, RATE_HZ) {
            Noted::Taken(time) => times.note(time, false, RATE_HZ),
            Noted::Stepped(time, _) => times.note(time, true, RATE_HZ),
            Noted::Refused => {}
        };
        let (mut clock, mut times) = (UtcClock::new(), Times::default());
        (0..60).for_each(|second| noted(&mut clock, &mut times, pair(second, 0)));
        let (mut estimated, mut after) = (clock, times);
        after.note(estimated.loosen(6000, 0.5, RATE_HZ).unwrap(), false, RATE_HZ);
        (61..70).for_each(|second| noted(&mut estimated, &mut after, pair(second, 700_000)));
        let off_s = |times: &Times, second: u64| {
            let (told_us, sd_s) = times.utc(second * RATE_HZ as u64, RATE_HZ).unwrap();
            (1e-6 * (told_us - utc_us(second)) as f64, sd_s)
        };
        let near = |(off_s, sd_s): (f64, f64)| off_s.abs() < 1e-5 && sd_s < 1e-4;
        assert!([3, 40, 59].iter().all(|second| near(off_s(&after, *second))), "{:?}", off_s(&after, 40));
        let (late, sd_s) = off_s(&after, 65);
        assert!((late - 0.7).abs() < 1e-5 && sd_s < 1e-5);
        // A step: nothing between the lines.
        (60..70).for_each(|second| noted(&mut clock, &mut times, pair(second, 3_000_000)));
        assert!([3, 40, 59].iter().all(|second| near(off_s(&times, *second))), "{:?}", off_s(&times, 40));
        assert!((off_s(&times, 65).0 - 3.0).abs() < 1e-5);
    }

    #[test]
    fn a_pair_of_an_earlier_sample_is_judged_like_any_other() {
        let pair = |second: u64, off_s: f64, sd_s: f64| {
            let index = second * RATE_HZ as u64;
            Pair { index, utc_us: ((second as f64 + off_s) * 1e6) as i64 + 1_790_000_000_000_000, sd_s }
        };
        let mut clock = UtcClock::new();
        for second in 0..60 {
            clock.note(pair(second, 0.0, 2e-6), RATE_HZ);
        }
        let line = clock;
        // An hour wrong, by command, of a sample before the newest pulse.
        for second in [58, 30] {
            assert_eq!(clock.note(pair(second, 3600.0, 0.25), RATE_HZ), Noted::Refused);
        }
        let taken = clock.note(pair(58, 0.2, 0.25), RATE_HZ);
        assert!(matches!(taken, Noted::Taken(time) if time.sd_s < 1e-5 && time.index == 5900), "{taken:?}");
        assert_eq!(clock, line);
        assert!(matches!(clock.note(pair(60, 0.0, 2e-6), RATE_HZ), Noted::Taken(_)));
    }

    #[test]
    fn one_moment_alone_gives_a_time_that_gets_less_certain() {
        let mut clock = UtcClock::new();
        assert_eq!(Times::default().utc(0, RATE_HZ), None);
        let Noted::Taken(time) = clock.note(Pair { index: 1000, utc_us: START_US, sd_s: 0.1 }, RATE_HZ)
        else {
            panic!("the first pair is taken")
        };
        let mut times = Times::default();
        times.note(time, false, RATE_HZ);
        let (utc_us, sd_s) = times.utc(1000 + 360_000, RATE_HZ).unwrap();
        assert_eq!(utc_us, START_US + 3_600_000_000);
        // 0.1 s, and 100 ppm of an hour.
        assert!((sd_s - (0.1f64 * 0.1 + 0.36 * 0.36).sqrt()).abs() < 1e-3, "{sd_s}");
        let (utc_us, sd_s) = times.utc(0, RATE_HZ).unwrap();
        assert_eq!(utc_us, START_US - 10_000_000);
        assert!(sd_s > 0.1);
        // An earlier sample that was at no earlier time is doubted.
        let again = clock.note(Pair { index: 5, utc_us: START_US + 7, sd_s: 0.1 }, RATE_HZ);
        assert_eq!(again, Noted::Refused);
    }

    #[test]
    fn samples_from_before_what_is_remembered_have_no_time() {
        let mut times = Times::default();
        let told = |index: u64, steps: i64| Time {
            index,
            utc_us: START_US + (1e6 * index as f64 / RATE_HZ) as i64 + steps * 3_000_000,
            sd_s: 1e-3,
            drift: 0.0,
            sd_drift: 1e-7,
            correlation: 0.0,
        };
        let hour = (3600.0 * RATE_HZ) as u64;
        times.note(told(0, 0), false, RATE_HZ);
        for step in 1..=4u64 {
            assert!(times.utc(10, RATE_HZ).is_some(), "{step}");
            times.note(told(step * hour, step as i64), true, RATE_HZ);
        }
        // The fourth step puts the first out of mind: which line ran before it nobody knows any more.
        assert_eq!(times.utc(10, RATE_HZ), None);
        assert_eq!(times.utc(hour - 1, RATE_HZ), None);
        let (utc_us, _) = times.utc(hour + 5, RATE_HZ).unwrap();
        assert!((utc_us - told(hour + 5, 1).utc_us).abs() <= 1);
    }
}
