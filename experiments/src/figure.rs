//! The one way an experiment reports a figure: its value beside its bar.

use serde_json::{Value, json};
use std::fmt::Write as _;
use std::sync::{Mutex, PoisonError};

/// What a figure is held against.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Bar {
    /// It must not be above.
    AtMost(f64),
    /// It must not be below.
    AtLeast(f64),
    /// It must lie between, limits included.
    Within(f64, f64),
    /// It is stated only.
    None,
}

impl Bar {
    /// As the records name it.
    fn relation(self) -> &'static str {
        match self {
            Self::AtMost(_) => "<=",
            Self::AtLeast(_) => ">=",
            Self::Within(..) => "within",
            Self::None => "none",
        }
    }

    fn holds(self, value: f64) -> bool {
        match self {
            Self::AtMost(bar) => value <= bar,
            Self::AtLeast(bar) => value >= bar,
            Self::Within(low, high) => (low..=high).contains(&value),
            Self::None => true,
        }
    }
}

/// A figure of an experiment.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    /// Name of the experiment on the command line.
    pub experiment: &'static str,
    /// What it is, with its unit.
    pub name: String,
    /// The value; `None` where the data for it are absent. One that is no finite number was not reached: it is missed.
    pub value: Option<f64>,
    /// The bar.
    pub bar: Bar,
}

impl Figure {
    /// Whether the bar is met; `None` where there is no bar, or no data.
    pub fn met(&self) -> Option<bool> {
        if self.bar == Bar::None { None } else { Some(self.bar.holds(self.value?)) }
    }

    /// Its record.
    pub fn json(&self) -> Value {
        let number = |x: f64| if x.is_finite() { json!(x) } else { Value::Null };
        let bar = match self.bar {
            Bar::AtMost(bar) | Bar::AtLeast(bar) => number(bar),
            Bar::Within(low, high) => json!([low, high]),
            Bar::None => Value::Null,
        };
        json!({
            "type": "figure", "experiment": self.experiment, "name": self.name,
            "value": self.value.map_or(Value::Null, number), "bar": bar,
            "relation": self.bar.relation(), "met": self.met(),
        })
    }
}

/// Figures for people, a line each, aligned.
pub fn text(figures: &[Figure]) -> String {
    let width = figures.iter().map(|f| f.name.chars().count()).max().unwrap_or(0);
    let mut out = String::new();
    for f in figures {
        let value = f.value.map_or_else(|| "no data".to_owned(), short);
        let bar = match f.bar {
            Bar::AtMost(bar) => format!("at most {}", short(bar)),
            Bar::AtLeast(bar) => format!("at least {}", short(bar)),
            Bar::Within(low, high) => format!("{} to {}", short(low), short(high)),
            Bar::None => String::new(),
        };
        let verdict = f.met().map_or("", |met| if met { "met" } else { "MISSED" });
        let line = format!("  {:width$}  {value:>9}   {bar:16} {verdict}", f.name);
        let _ = writeln!(out, "{}", line.trim_end());
    }
    out
}

/// Four significant digits; whole numbers as they are.
pub(crate) fn short(x: f64) -> String {
    if !x.is_finite() {
        return "-".into();
    }
    if x == x.trunc() && x.abs() < 1e7 {
        return format!("{x}");
    }
    let digits = (3 - x.abs().log10().floor() as i32).clamp(0, 6) as usize;
    format!("{x:.digits$}")
}

/// The figures of one run of one experiment, in the order in which they were reported.
#[derive(Debug)]
pub struct Figures {
    experiment: &'static str,
    reported: Mutex<Vec<Figure>>,
}

impl Figures {
    /// None yet.
    pub fn new(experiment: &'static str) -> Self {
        Self { experiment, reported: Mutex::default() }
    }

    /// Reports a figure with its unit in its name; `None`: the data for it are absent.
    pub fn report(&self, name: impl Into<String>, value: impl Into<Option<f64>>, bar: Bar) {
        let figure = Figure { experiment: self.experiment, name: name.into(), value: value.into(), bar };
        self.reported.lock().unwrap_or_else(PoisonError::into_inner).push(figure);
    }

    /// A figure that must not be above its bar.
    pub fn at_most(&self, name: impl Into<String>, value: impl Into<Option<f64>>, bar: f64) {
        self.report(name, value, Bar::AtMost(bar));
    }

    /// A figure that must not be below its bar.
    pub fn at_least(&self, name: impl Into<String>, value: impl Into<Option<f64>>, bar: f64) {
        self.report(name, value, Bar::AtLeast(bar));
    }

    /// A figure that is stated only.
    pub fn state(&self, name: impl Into<String>, value: impl Into<Option<f64>>) {
        self.report(name, value, Bar::None);
    }

    /// Says on standard error that data are absent; the figures that need them are reported without a value.
    pub fn no_data(&self, path: &std::path::Path) {
        eprintln!(
            "seabearing: {}: no data at {}; --data says where they are",
            self.experiment,
            path.display()
        );
    }

    /// What was reported.
    pub fn into_reported(self) -> Vec<Figure> {
        self.reported.into_inner().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_figure_is_met_missed_or_neither() {
        let figures = Figures::new("x");
        figures.at_most("a, m", 1.5, 2.0);
        figures.at_least("b, %", 1.5, 2.0);
        figures.report("c", f64::NAN, Bar::Within(0.0, 1.0));
        figures.at_most("d", None, 1.0);
        figures.state("e", 0.25);
        let reported = figures.into_reported();
        let met: Vec<_> = reported.iter().map(Figure::met).collect();
        assert_eq!(met, [Some(true), Some(false), Some(false), None, None]);
        assert_eq!(
            reported[0].json().to_string(),
            r#"{"type":"figure","experiment":"x","name":"a, m","value":1.5,"bar":2.0,"relation":"<=","met":true}"#
        );
        assert_eq!(
            reported[2].json().to_string(),
            r#"{"type":"figure","experiment":"x","name":"c","value":null,"bar":[0.0,1.0],"relation":"within","met":false}"#
        );
        assert_eq!(
            reported[3].json().to_string(),
            r#"{"type":"figure","experiment":"x","name":"d","value":null,"bar":1.0,"relation":"<=","met":null}"#
        );
        let text = text(&reported);
        assert!(text.contains("at least 2") && text.contains("MISSED") && text.contains("no data"), "{text}");
        assert_eq!(text.lines().count(), 5);
    }

    #[test]
    fn numbers_keep_four_digits() {
        assert_eq!([0.012345, 1234.5, 1000.0, f64::NAN].map(short), ["0.01235", "1234", "1000", "-"]);
    }
}
