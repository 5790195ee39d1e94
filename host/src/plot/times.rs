//! Where the times of a recording lie on an axis: UTC where it has a clock, else seconds, minutes or hours from its start.

use super::{Plot, Scale};
use time::OffsetDateTime;

/// The times of a recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Times {
    start: Option<OffsetDateTime>,
    /// Seconds of a unit, and its name.
    unit: (f64, &'static str),
}

impl Times {
    /// Of a recording that began then, about `longest_s` of which is drawn.
    pub fn new(start: Option<OffsetDateTime>, longest_s: f64) -> Self {
        let unit = match longest_s {
            s if s > 3.0 * 3600.0 => (3600.0, "h"),
            s if s > 600.0 => (60.0, "min"),
            _ => (1.0, "s"),
        };
        Self { start, unit }
    }

    /// The place of a time, seconds after sample 0.
    pub fn at(&self, t_s: f64) -> f64 {
        match self.start {
            Some(start) => start.unix_timestamp_nanos() as f64 * 1e-9 + t_s,
            None => t_s / self.unit.0,
        }
    }

    /// What the axis is called; one of UTC gets its dates where it is drawn.
    fn label(&self) -> String {
        match self.start {
            Some(_) => "time".to_owned(),
            None => format!("time ({})", self.unit.1),
        }
    }

    /// Makes the horizontal axis of a figure one of these times.
    pub fn along(&self, figure: &mut Plot) {
        figure.x_label = self.label();
        if self.start.is_some() {
            figure.x_scale(Scale::Utc);
        }
    }

    /// Where the data of a picture are from, in words.
    pub fn source(&self, station: &str) -> String {
        let station =
            if station.is_empty() { "the recorder".to_owned() } else { format!("station {station}") };
        match self.start {
            Some(start) => {
                let (h, m, s) = start.to_hms();
                format!("Data: {station}, recorded from {} {h:02}:{m:02}:{s:02} UTC.", start.date())
            }
            None => format!("Data: {station}; times count from the first sample, for no clock is known."),
        }
    }

    /// A time with its date, to be read alone.
    pub fn moment(&self, t_s: f64) -> String {
        let Some(start) = self.start else { return format!("{t_s:.2} s after the first sample") };
        let at = start + time::Duration::seconds_f64(t_s);
        format!("{} {} UTC", at.date(), self.clock(t_s))
    }

    /// A time as a clock shows it, to be written beside something.
    pub fn clock(&self, t_s: f64) -> String {
        let Some(start) = self.start else { return format!("{:.1} {}", t_s / self.unit.0, self.unit.1) };
        let at = start + time::Duration::seconds_f64(t_s);
        let (h, m, s) = at.to_hms();
        format!("{h:02}:{m:02}:{s:02}")
    }

    /// A time with its day and month, to be read beside others of a week.
    pub fn dated(&self, t_s: f64) -> String {
        self.day(t_s).map_or_else(|| self.clock(t_s), |day| format!("{day} {}", self.clock(t_s)))
    }

    /// The same with as many digits as its standard deviation is worth, where it counts from the first sample.
    pub fn to_within(&self, t_s: f64, sd_s: f64) -> String {
        if self.start.is_some() {
            return self.dated(t_s);
        }
        let digits = (self.unit.0 / sd_s.max(0.5)).log10().ceil().clamp(1.0, 4.0) as usize;
        format!("{:.digits$} {}", t_s / self.unit.0, self.unit.1)
    }

    /// The same to the minute.
    pub fn minute(&self, t_s: f64) -> String {
        self.day(t_s).map_or_else(|| self.clock(t_s), |day| format!("{day} {}", self.hour_minute(t_s)))
    }

    /// The end of a span to the minute, with its date where that is another than the beginning's.
    pub fn minute_after(&self, (from_s, to_s): (f64, f64)) -> String {
        match self.day(from_s) {
            Some(day) if self.day(to_s).as_ref() == Some(&day) => self.hour_minute(to_s),
            _ => self.minute(to_s),
        }
    }

    /// Day and month in UTC.
    fn day(&self, t_s: f64) -> Option<String> {
        let at = self.start?.checked_add(time::Duration::checked_seconds_f64(t_s)?)?;
        Some(format!("{} {}", at.day(), at.month().to_string().get(..3).unwrap_or_default()))
    }

    fn hour_minute(&self, t_s: f64) -> String {
        self.clock(t_s).chars().take(5).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_time_without_a_clock_has_the_digits_that_its_deviation_is_worth() {
        let times = Times::new(None, 90_000.0);
        assert_eq!(times.to_within(17_653.0, 7.0), "4.904 h");
        assert_eq!(times.to_within(17_653.0, 900.0), "4.9 h");
        let start = OffsetDateTime::from_unix_timestamp(1_369_094_400).ok();
        assert_eq!(Times::new(start, 90_000.0).to_within(3600.0, 7.0), "21 May 01:00:00");
    }
}
