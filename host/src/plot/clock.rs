//! Ticks of an axis of UTC: at whole steps of clock and calendar, with labels that differ from each other and have room.
//!
//! The finest step is taken at which that holds. Labels are clock times where they stand within a day, dates with clock times
//! where they reach beyond one, dates where steps are days, months or years where steps are. The axis is called by its dates,
//! once ([`dates`]).

use super::text;
use time::{Date, Month, OffsetDateTime};

/// Least room between labels, points.
const GAP: f64 = 10.0;

/// Most ticks.
const MOST: usize = 14;

const DAY_S: f64 = 86_400.0;

/// What lies between ticks.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Step {
    Seconds(f64),
    Days(f64),
    Months(i32),
}

/// Steps from the finest to the coarsest.
fn steps() -> impl Iterator<Item = Step> {
    let parts =
        (-6..0).flat_map(|decade| [1.0, 2.0, 5.0].map(|k: f64| Step::Seconds(k * 10f64.powi(decade))));
    let seconds = [
        1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 900.0, 1800.0, 3600.0, 7200.0, 10_800.0,
        21_600.0, 43_200.0,
    ];
    let months = [1, 2, 3, 6, 12, 24, 60, 120, 240, 600, 1200];
    parts
        .chain(seconds.map(Step::Seconds))
        .chain([1.0, 2.0, 7.0, 14.0].map(Step::Days))
        .chain(months.map(Step::Months))
}

/// A time to the microsecond.
fn moment(t_s: f64) -> Option<OffsetDateTime> {
    OffsetDateTime::from_unix_timestamp_nanos(((t_s * 1e6).round() as i128).saturating_mul(1000)).ok()
}

/// Ticks between two times (seconds since 1970), with their labels of a size, on an axis so long (points).
pub(super) fn ticks((from, to): (f64, f64), length: f64, size: i32) -> Vec<(f64, String)> {
    if !(to > from && moment(from).is_some() && moment(to).is_some()) {
        return Vec::new();
    }
    let fitting = steps().find_map(|step| {
        let at = places(step, from, to)?;
        let labelled: Vec<(f64, String)> = at.iter().map(|t| (*t, label(step, *t, &at))).collect();
        fits(&labelled, (from, to), length, size).then_some(labelled)
    });
    fitting.unwrap_or_default()
}

/// Where the ticks of a step are; nothing where they are too many.
fn places(step: Step, from: f64, to: f64) -> Option<Vec<f64>> {
    let even = |step: f64| {
        let (first, last) = ((from / step - 1e-6).ceil(), (to / step + 1e-6).floor());
        (last - first < MOST as f64)
            .then(|| (0..=(last - first) as i64).map(|k| (first + k as f64) * step).collect())
    };
    match step {
        Step::Seconds(s) => even(s),
        Step::Days(days) => even(days * DAY_S),
        Step::Months(months) => {
            let year = moment(from)?.year();
            let begins = (0..).map(|k| {
                let month = k * months;
                let date = Date::from_calendar_date(
                    year + month / 12,
                    Month::try_from((month % 12) as u8 + 1).ok()?,
                    1,
                );
                Some(date.ok()?.midnight().assume_utc().unix_timestamp() as f64)
            });
            let begins: Vec<f64> =
                begins.map_while(|t| t.filter(|t| *t <= to)).filter(|t| *t >= from).take(MOST + 1).collect();
            (begins.len() <= MOST).then_some(begins)
        }
    }
}

/// What stands at a tick, one of `all`.
fn label(step: Step, t_s: f64, all: &[f64]) -> String {
    let Some(at) = moment(t_s) else { return String::new() };
    let reach = all.last().zip(all.first()).map_or(0.0, |(b, a)| b - a);
    let month = &at.month().to_string()[..3];
    let (h, m, s) = at.to_hms();
    match step {
        Step::Seconds(step) => {
            let clock = if step >= 60.0 {
                format!("{h:02}:{m:02}")
            } else if step >= 1.0 {
                format!("{h:02}:{m:02}:{s:02}")
            } else {
                let decimals = (-step.log10() - 1e-9).ceil() as usize;
                format!(
                    "{h:02}:{m:02}:{s:02}.{:0decimals$}",
                    at.nanosecond() / 10u32.pow(9 - decimals as u32)
                )
            };
            if reach >= DAY_S { format!("{} {month} {clock}", at.day()) } else { clock }
        }
        Step::Days(_) => format!("{} {month}", at.day()),
        Step::Months(step) if step % 12 == 0 => at.year().to_string(),
        Step::Months(_) if reach >= 365.0 * DAY_S => format!("{month} {}", at.year()),
        Step::Months(_) => month.to_owned(),
    }
}

/// Whether every label has room beside its neighbours.
fn fits(labelled: &[(f64, String)], (from, to): (f64, f64), length: f64, size: i32) -> bool {
    labelled.windows(2).all(|pair| {
        let [(a, first), (b, second)] = pair else { return true };
        let room = (b - a) / (to - from) * length;
        room >= 0.5 * (text::width(first, size) + text::width(second, size)) + GAP
    })
}

/// The dates of an axis, for its name.
pub(super) fn dates((from, to): (f64, f64)) -> String {
    let (Some(from), Some(to)) = (moment(from), moment(to)) else { return "UTC".to_owned() };
    if from.date() == to.date() {
        format!("UTC, {}", from.date())
    } else {
        format!("UTC, {} to {}", from.date(), to.date())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Width of a text by the font that pictures have, points.
    #[cfg(feature = "pictures")]
    fn measured(text: &str, size: i32) -> f64 {
        let face = ttf_parser::Face::parse(dejavu::sans::regular(), 0).unwrap();
        let advance = |c| f64::from(face.glyph_index(c).and_then(|g| face.glyph_hor_advance(g)).unwrap());
        text.chars().map(advance).sum::<f64>() / f64::from(face.units_per_em()) * f64::from(size)
    }

    #[cfg(not(feature = "pictures"))]
    use text::width as measured;

    proptest! {
        #![proptest_config(seabearing_testkit::property(2000))]

        #[test]
        fn labels_differ_and_do_not_touch_at_any_span(
            begins in 0.0..4e9,
            log_span in 0.0..7.51f64, // a second to a year
            length in 150.0..900.0f64,
        ) {
            let ends = begins + 10f64.powf(log_span);
            let all = ticks((begins, ends), length, 13);
            let at = |t: f64| (t - begins) / (ends - begins) * length;
            for pair in all.windows(2) {
                let half = |text: &str| 0.5 * measured(text, 13);
                let room = at(pair[1].0) - half(&pair[1].1) - at(pair[0].0) - half(&pair[0].1);
                prop_assert!(room > 3.0, "{all:?}");
            }
            let different: std::collections::BTreeSet<_> = all.iter().map(|(_, label)| label).collect();
            prop_assert_eq!(different.len(), all.len(), "{:?}", all);
            prop_assert!(all.iter().all(|(t, _)| *t >= begins - 1e-3 && *t <= ends + 1e-3));
            // There is something to read, and not only the odd one.
            prop_assert!(all.len() >= if length > 300.0 { 2 } else { 1 }, "{all:?}");
        }
    }

    #[test]
    fn times_are_written_as_clock_and_calendar_have_them() {
        let begins = 1_369_098_000.0; // 2013-05-21T01:00:00Z
        let labels = |from: f64, to: f64| -> Vec<String> {
            ticks((from, to), 700.0, 13).into_iter().map(|(_, label)| label).collect()
        };
        let hour = labels(begins, begins + 3600.0);
        assert_eq!((hour[0].as_str(), hour[1].as_str(), hour.len()), ("01:00", "01:05", 13));
        assert_eq!(labels(begins, begins + 90.0)[1], "01:00:10");
        assert_eq!(labels(begins + 0.5, begins + 1.5)[0], "01:00:00.6");
        let night = labels(begins + 21.0 * 3600.0, begins + 25.0 * 3600.0);
        assert!(night.contains(&"00:00".to_owned()) && night[0] == "22:00", "{night:?}");
        let days = labels(begins, begins + 2.0 * DAY_S);
        assert!(days.contains(&"22 May 00:00".to_owned()), "{days:?}");
        assert_eq!(labels(begins, begins + 7.0 * DAY_S)[0], "22 May");
        assert_eq!(labels(begins, begins + 300.0 * DAY_S)[0], "Jun");
        assert_eq!(labels(begins, begins + 3000.0 * DAY_S)[0], "2014");
        assert_eq!(dates((begins, begins + 60.0)), "UTC, 2013-05-21");
        assert_eq!(dates((begins, begins + DAY_S)), "UTC, 2013-05-21 to 2013-05-22");
        assert!(ticks((f64::NAN, 1.0), 700.0, 13).is_empty() && ticks((0.0, 1e30), 700.0, 13).is_empty());
    }
}
