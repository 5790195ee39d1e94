//! Azimuths of a minute joined along smooth curves, one a vessel.
//!
//! Each curve is a filter of azimuth and its rate. How much the rate may change follows from what vessels do: beyond 50 km its greatest rate
//! is v/r and it takes r/v to change; nearer, a rate that is larger changes faster, in proportion to itself.
//! A minute's azimuths go to the curves they are nearest to, in units of what each expects, none twice; what is left begins a new curve.

use super::heard::Direction;
use seabearing_core::angle::wrap_pi;

/// Standard deviation of a first azimuth's unknown rate, rad/s: a vessel of 9 m/s that passes at 30 km.
const FIRST_RATE: f64 = 3e-4;
/// Change of the rate, rad²/s³: by 1.3e-4 rad/s, the rate of 7 m/s at 55 km, within an hour.
const RESTLESS: f64 = 5e-12;
/// The same in proportion to the squared rate, 1/s: a vessel of 8 m/s at 16 km.
const RESTLESS_SHARE: f64 = 1e-3;
/// Windows of three minutes begin each minute: three azimuths say as much as one.
const OVERLAP: f64 = 3.0;
/// Least standard deviation of an azimuth, rad.
const LEAST_SD: f64 = 0.01;
/// Farthest from what is expected, standard deviations.
const GATE: f64 = 3.5;
/// And rad.
const FARTHEST: f64 = 0.35;
/// Longest silence, s.
const SILENCE_S: f64 = 2_700.0;
/// Greatest standard deviation of what is expected after it, rad.
const LOST: f64 = 0.17;
/// Two curves nearer to each other than this are heard as one direction between them, rad: what is within it of either is neither's.
const ONE_DIRECTION: f64 = 0.35;
/// Azimuths from which on a curve counts as a vessel's there.
const SETTLED: usize = 20;
/// A beginning is none without so many azimuths within so long, s.
const BEGINNING: (usize, f64) = (5, 900.0);
/// Fewest azimuths of a curve, and its shortest span, s.
const LEAST: (usize, f64) = (20, 2_400.0);

/// A vessel's azimuths.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curve {
    /// In order of time.
    pub directions: Vec<Direction>,
}

impl Curve {
    /// First and last time, s.
    pub fn span_s(&self) -> (f64, f64) {
        let t = |d: Option<&Direction>| d.map_or(0.0, |d| d.t_s);
        (t(self.directions.first()), t(self.directions.last()))
    }

    /// The azimuth nearest in time, if it is within so long.
    pub fn near(&self, t_s: f64, within_s: f64) -> Option<&Direction> {
        let k = self.directions.partition_point(|d| d.t_s < t_s);
        let about = self.directions.get(k.saturating_sub(1)..(k + 1).min(self.directions.len()))?;
        let off = |d: &&Direction| (d.t_s - t_s).abs();
        about.iter().min_by(|a, b| off(a).total_cmp(&off(b))).filter(|d| off(d) <= within_s)
    }
}

/// A curve that is still followed.
struct Followed {
    curve: Curve,
    /// When it was heard last, alone or with another, s.
    heard_s: f64,
    at_s: f64,
    azimuth: f64,
    rate: f64,
    /// Variances of azimuth, of both, of rate.
    variance: [f64; 3],
}

impl Followed {
    fn new(d: Direction) -> Self {
        let azimuth = variance(&d);
        Self {
            curve: Curve { directions: vec![d] },
            heard_s: d.t_s,
            at_s: d.t_s,
            azimuth: d.azimuth,
            rate: 0.0,
            variance: [azimuth, 0.0, FIRST_RATE * FIRST_RATE],
        }
    }

    /// Azimuth expected at a time, and the filter's variances then.
    fn expected(&self, t_s: f64) -> (f64, [f64; 3]) {
        let dt = t_s - self.at_s;
        let [a, c, r] = self.variance;
        let restless = RESTLESS + RESTLESS_SHARE * self.rate * self.rate;
        let a = a + 2.0 * dt * c + dt * dt * r + restless * dt.powi(3) / 3.0;
        (self.azimuth + self.rate * dt, [a, c + dt * r + restless * dt * dt / 2.0, r + restless * dt])
    }

    /// How far an azimuth is from what is expected, as a squared distance that also counts how wide it is; `None` beyond the gate.
    fn off(&self, d: &Direction) -> Option<f64> {
        let (azimuth, [a, ..]) = self.expected(d.t_s);
        let (e, all) = (wrap_pi(d.azimuth - azimuth), a + variance(d));
        let square = e * e / all;
        (square < GATE * GATE && e.abs() < FARTHEST).then(|| square + (all / variance(d)).ln())
    }

    fn take(&mut self, d: Direction) {
        let (azimuth, [a, c, r]) = self.expected(d.t_s);
        let all = a + variance(&d);
        let e = wrap_pi(d.azimuth - azimuth);
        self.azimuth = azimuth + a / all * e;
        self.rate += c / all * e;
        self.variance = [a - a * a / all, c - a * c / all, r - c * c / all];
        (self.at_s, self.heard_s) = (d.t_s, d.t_s);
        self.curve.directions.push(d);
    }

    /// Whether it is still followed at a time.
    fn lives(&self, t_s: f64) -> bool {
        let first = self.curve.span_s().0;
        let began = self.curve.directions.len() >= BEGINNING.0 || t_s - first < BEGINNING.1;
        let (_, [a, ..]) = self.expected(t_s);
        began && t_s - self.heard_s <= SILENCE_S && a.sqrt() < LOST
    }

    /// What it has become, if that is a curve.
    fn finished(self) -> Option<Curve> {
        let (first, last) = self.curve.span_s();
        (self.curve.directions.len() >= LEAST.0 && last - first >= LEAST.1).then_some(self.curve)
    }
}

fn variance(d: &Direction) -> f64 {
    OVERLAP * d.sd.max(LEAST_SD).powi(2)
}

/// Which of the curves are too near to another to be told from it at a time.
fn together(live: &[Followed], t_s: f64) -> Vec<bool> {
    let settled = |f: &Followed| f.curve.directions.len() >= SETTLED;
    let at: Vec<Option<f64>> = live.iter().map(|f| settled(f).then(|| f.expected(t_s).0)).collect();
    let near = |i: usize, j: usize| match (at[i], at[j]) {
        (Some(a), Some(b)) => i != j && wrap_pi(a - b).abs() < ONE_DIRECTION,
        _ => false,
    };
    (0..live.len()).map(|i| (0..live.len()).any(|j| near(i, j))).collect()
}

/// Joins azimuths, given in order of time.
pub fn curves(directions: &[Direction]) -> Vec<Curve> {
    let mut live: Vec<Followed> = Vec::new();
    let mut out = Vec::new();
    for minute in directions.chunk_by(|a, b| a.t_s == b.t_s) {
        let t_s = minute[0].t_s;
        let (still, ended): (Vec<_>, Vec<_>) = live.into_iter().partition(|f| f.lives(t_s));
        live = still;
        out.extend(ended.into_iter().filter_map(Followed::finished));
        let together = together(&live, t_s);
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        for (i, f) in live.iter().enumerate().filter(|(i, _)| !together[*i]) {
            pairs.extend(minute.iter().enumerate().filter_map(|(k, d)| Some((f.off(d)?, i, k))));
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (mut used, mut taken) = (vec![false; live.len()], vec![false; minute.len()]);
        for (_, i, k) in pairs {
            if !used[i] && !taken[k] {
                (used[i], taken[k]) = (true, true);
                live[i].take(minute[k]);
            }
        }
        let of_both = |d: &Direction| {
            let near = |f: &Followed| wrap_pi(d.azimuth - f.expected(t_s).0).abs() < ONE_DIRECTION;
            live.iter().zip(&together).any(|(f, together)| *together && near(f))
        };
        let left = minute.iter().zip(taken).filter(|(d, taken)| !taken && !of_both(d));
        let begun: Vec<Followed> = left.map(|(d, _)| Followed::new(*d)).collect();
        live.iter_mut().zip(&together).filter(|(_, t)| **t).for_each(|(f, _)| f.heard_s = t_s);
        live.extend(begun);
    }
    out.extend(live.into_iter().filter_map(Followed::finished));
    out.sort_by(|a, b| a.span_s().0.total_cmp(&b.span_s().0));
    out
}

#[cfg(test)]
mod tests {
    use super::super::Place;
    use super::super::course::joined;
    use super::*;

    /// Azimuths of a vessel that passes at a range, every minute, with errors of a degree or so.
    pub(crate) fn passing(
        cpa_s: f64,
        range_m: f64,
        speed: f64,
        azimuth: f64,
        span_s: (f64, f64),
    ) -> Vec<Direction> {
        let mut seed = 7u64;
        let mut normal = move || {
            (0..12).fold(-6.0, |sum, _| {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                sum + (seed >> 11) as f64 / (1u64 << 53) as f64
            })
        };
        let minutes = (span_s.0 / 60.0) as i32..(span_s.1 / 60.0) as i32;
        minutes
            .map(|m| {
                let t_s = 60.0 * f64::from(m);
                let azimuth = azimuth + (speed * (t_s - cpa_s) / range_m).atan() + 0.015 * normal();
                Direction { t_s, azimuth: azimuth.rem_euclid(std::f64::consts::TAU), sd: 0.015 }
            })
            .collect()
    }

    #[test]
    fn two_vessels_that_cross_are_two_curves_and_stray_azimuths_none() {
        let mut all = passing(9_000.0, 60_000.0, 8.0, 1.0, (0.0, 18_000.0));
        all.extend(passing(9_000.0, 70_000.0, -7.0, 1.0, (0.0, 18_000.0)));
        all.extend((0..30).map(|k| Direction {
            t_s: 600.0 * f64::from(k),
            azimuth: 1.7 * f64::from(k) % 6.0,
            sd: 0.02,
        }));
        all.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
        let place = Place { sound_speed_m_s: 1_500.0, depth_m: None, orientation_sd: 0.0, table: None };
        let found = joined(curves(&all), &place);
        assert_eq!(
            found.len(),
            2,
            "{:?}",
            found.iter().map(|c| (c.span_s(), c.directions.len())).collect::<Vec<_>>()
        );
        assert!(found.iter().all(|c| c.directions.len() > 150));
    }

    #[test]
    fn half_an_hour_of_one_direction_is_no_vessel() {
        let all = passing(0.0, 1e9, 0.0, 2.0, (0.0, 1_800.0));
        assert!(curves(&all).is_empty());
    }
}
