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
