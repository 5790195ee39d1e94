//! Axes: where the ticks of a linear, logarithmic or angular axis go and what stands beside them.

use super::{clock, text};
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use std::ops::Range;

/// How an axis runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Scale {
    /// Evenly.
    #[default]
    Linear,
    /// By decades; values at or below zero are not drawn.
    Log,
    /// Degrees: ticks at divisors of 360.
    Degrees,
    /// Metres, written in kilometres.
    Kilometres,
    /// Seconds since 1970 (UTC), from left to right: ticks at whole steps of clock and calendar.
    Utc,
}

/// One axis: ends and scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Value at the left or lower end.
    pub from: f64,
    /// Value at the right or upper end (may be below `from`: the axis then runs backwards).
    pub to: f64,
    /// How it runs.
    pub scale: Scale,
}

impl Axis {
    /// An axis that shows all finite `values`, with a little room (none if `tight`).
    pub fn around(values: impl Iterator<Item = f64>, scale: Scale, tight: bool) -> Self {
        let usable = values.filter(|x| x.is_finite() && (scale != Scale::Log || *x > 0.0));
        let (mut lo, mut hi) =
            usable.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
        if lo > hi {
            (lo, hi) = (if scale == Scale::Log { 0.1 } else { 0.0 }, 1.0);
        }
        if scale == Scale::Log {
            if hi < lo * 1.5 {
                (lo, hi) = (lo / 3.0, hi * 3.0);
            }
            let room = if tight { 1.0 } else { (hi / lo).powf(0.05) };
            return Self { from: lo / room, to: hi * room, scale };
        }
        if hi - lo < 1e-12 * hi.abs().max(1e-3) {
            let half = if hi == 0.0 { 1.0 } else { 0.05 * hi.abs() };
            (lo, hi) = (lo - half, hi + half);
        }
        let room = if tight { 0.0 } else { 0.04 * (hi - lo) };
        Self { from: lo - room, to: hi + room, scale }
    }

    /// Where a value lies, 0 at `from` and 1 at `to`; `None` where it cannot be shown.
    pub fn share(&self, x: f64) -> Option<f64> {
        let share = match self.scale {
            Scale::Log if x > 0.0 => (x / self.from).ln() / (self.to / self.from).ln(),
            Scale::Log => return None,
            _ => (x - self.from) / (self.to - self.from),
        };
        share.is_finite().then_some(share)
    }

    /// Whether a value lies on the axis.
    pub fn holds(&self, x: f64) -> bool {
        self.share(x).is_some_and(|s| (-1e-9..=1.0 + 1e-9).contains(&s))
    }

    /// Ticks, at most about `most`.
    pub fn ticks(&self, most: usize) -> Vec<f64> {
        let (lo, hi) = if self.from <= self.to { (self.from, self.to) } else { (self.to, self.from) };
        let most = most.max(2);
        if self.scale == Scale::Log {
            return log_ticks(lo, hi, most);
        }
        let rough = (hi - lo) / most as f64;
        let step = if self.scale == Scale::Degrees && rough > 1.0 {
            [2.0, 5.0, 10.0, 15.0, 30.0, 45.0, 90.0, 180.0]
                .into_iter()
                .find(|s| *s >= rough)
                .unwrap_or_else(|| 360.0 * (rough / 360.0).ceil())
        } else {
            let decade = 10f64.powf(rough.log10().floor());
            [1.0, 2.0, 5.0, 10.0]
                .into_iter()
                .map(|m| m * decade)
                .find(|s| *s >= rough * 0.999)
                .unwrap_or(rough)
        };
        let first = (lo / step - 1e-9).ceil() as i64;
        let last = (hi / step + 1e-9).floor() as i64;
        (first..=last).take(200).map(|i| i as f64 * step).collect()
    }

    /// The text at a tick.
    pub fn label(&self, x: f64) -> String {
        if self.scale == Scale::Kilometres {
            return Self { from: self.from / 1e3, to: self.to / 1e3, scale: Scale::Linear }.label(x / 1e3);
        }
        let span = if self.scale == Scale::Log { x.abs() } else { (self.to - self.from).abs() };
        let decimals = if span > 0.0 { (1.3 - span.log10()).ceil().clamp(0.0, 9.0) as usize } else { 0 };
        if x != 0.0 && (x.abs() >= 1e6 || x.abs() < 1e-4) {
            return trim(&format!("{x:.2e}"));
        }
        let text = format!("{x:.decimals$}");
        let text = if text.contains('.') {
            text.trim_end_matches('0').trim_end_matches('.').to_owned()
        } else {
            text
        };
        if text == "-0" { "0".to_owned() } else { text.replace('-', "\u{2212}") }
    }
}

/// `2.00e5` without its idle zeros.
fn trim(text: &str) -> String {
    match text.split_once('e') {
        Some((m, e)) => {
            let m = if m.contains('.') { m.trim_end_matches('0').trim_end_matches('.') } else { m };
            format!("{m}e{e}").replace('-', "\u{2212}")
        }
        None => text.to_owned(),
    }
}

/// Decades, with 2 and 5 between them where there is room.
fn log_ticks(lo: f64, hi: f64, most: usize) -> Vec<f64> {
    let (first, last) = (lo.log10().floor() as i32, hi.log10().ceil() as i32);
    let decades = (hi / lo).log10().max(1e-6);
    let within = |x: &f64| *x >= lo * (1.0 - 1e-9) && *x <= hi * (1.0 + 1e-9);
    let factors: &[f64] = if decades * 2.2 <= most as f64 { &[1.0, 2.0, 5.0] } else { &[1.0] };
    let stride = ((decades / most as f64).ceil() as i32).max(1);
    (first..=last)
        .filter(|d| d % stride == 0)
        .flat_map(|d| factors.iter().map(move |f| f * 10f64.powi(d)))
        .filter(within)
        .collect()
}

/// An axis on the page, with its length there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ruler {
    pub(super) axis: Axis,
    /// Points.
    pub(super) length: f64,
    /// From left to right, not up.
    pub(super) across: bool,
}

/// Size of the labels at ticks, points.
pub(super) const LABEL: i32 = 13;

impl Ruler {
    /// Ticks and their labels: all different, none over another.
    pub(super) fn ticks(&self) -> Vec<(f64, String)> {
        let Axis { from, to, scale } = self.axis;
        if scale == Scale::Utc && self.across {
            return clock::ticks((from, to), self.length, LABEL);
        }
        let labelled = |most| -> Vec<(f64, String)> {
            self.axis.ticks(most).into_iter().map(|x| (x, self.axis.label(x))).collect()
        };
        if !self.across {
            return labelled(((self.length / 30.0) as usize).clamp(2, 12));
        }
        let most = ((self.length / 50.0) as usize).clamp(2, 14);
        let tries = (2..=most).rev().map(labelled).find(|ticks| self.have_room(ticks));
        tries.unwrap_or_else(|| labelled(2))
    }

    fn have_room(&self, ticks: &[(f64, String)]) -> bool {
        let at = |x: f64| self.axis.share(x).unwrap_or(0.0) * self.length;
        let half = |label: &str| 0.5 * text::width(label, LABEL);
        ticks.windows(2).all(|pair| match pair {
            [(a, first), (b, second)] => (at(*b) - at(*a)).abs() >= half(first) + half(second) + 8.0,
            _ => true,
        })
    }
}

impl Ranged for Ruler {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, limit: (i32, i32)) -> i32 {
        let share = self.axis.share(*value).unwrap_or(0.0).clamp(-10.0, 10.0);
        limit.0 + (share * f64::from(limit.1 - limit.0)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, _: Hint) -> Vec<f64> {
        self.ticks().into_iter().map(|(x, _)| x).collect()
    }

    fn range(&self) -> Range<f64> {
        self.axis.from..self.axis.to
    }
}

impl ValueFormatter<f64> for Ruler {
    fn format_ext(&self, value: &f64) -> String {
        let own = self.ticks().into_iter().find(|(x, _)| x == value);
        own.map_or_else(|| self.axis.label(*value), |(_, label)| label)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let a = Axis { from: 0.0, to: 200.0, scale: Scale::Linear };
        assert_eq!(a.ticks(10), (0..=10).map(|i| f64::from(i) * 20.0).collect::<Vec<_>>());
        let a = Axis { from: 0.0, to: 360.0, scale: Scale::Degrees };
        assert_eq!(a.ticks(8), (0..=8).map(|i| f64::from(i) * 45.0).collect::<Vec<_>>());
        let a = Axis { from: 0.01, to: 10.0, scale: Scale::Log };
        assert_eq!(a.ticks(6), [0.01, 0.1, 1.0, 10.0]);
        assert_eq!(a.label(0.01), "0.01");
        let a = Axis { from: -2.0e-4, to: 3.0e-4, scale: Scale::Linear };
        assert_eq!(a.label(-1.0e-4), "\u{2212}0.0001");
    }

    #[test]
    fn long_ways_are_written_in_kilometres_and_labels_have_room() {
        let a = Axis { from: -20_000.0, to: 20_000.0, scale: Scale::Kilometres };
        assert_eq!((a.ticks(4).len(), a.label(-10_000.0).as_str()), (5, "\u{2212}10"));
        let axis = Axis { from: 1000.0, to: 1000.07, scale: Scale::Linear };
        let ruler = Ruler { axis, length: 300.0, across: true };
        let ticks = ruler.ticks();
        assert!(
            ticks.len() >= 2
                && ruler.have_room(&ticks)
                && !ruler.have_room(&axis.ticks(8).iter().map(|x| (*x, axis.label(*x))).collect::<Vec<_>>()),
            "{ticks:?}"
        );
    }

    #[test]
    fn odd_data_still_give_an_axis() {
        for values in [vec![], vec![f64::NAN], vec![5.0], vec![0.0, 0.0], vec![-1.0, -1.0]] {
            for scale in [Scale::Linear, Scale::Log, Scale::Degrees] {
                let a = Axis::around(values.iter().copied(), scale, false);
                assert!(a.from.is_finite() && a.to > a.from, "{values:?} {a:?}");
                assert!(a.ticks(8).len() < 200);
            }
        }
    }
}
