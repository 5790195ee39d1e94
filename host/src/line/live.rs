//! Which of a line's sensors record anything.
//!
//! In: of each step the sensors whose samples never change in it. Out: the longest run of the others, which is a line by itself, and what
//! is to be said at the end. A dead sensor is sound of no direction, loud in one sensor: MUSIC makes a second source of it.

use super::frames::Held;

/// Sensors of one step or more that are taken as the line: the first, and how many.
pub(super) type Run = (usize, usize);

/// The longest run of sensors that record; the first of those as long.
pub(super) fn longest(flat: u32, sensors: usize) -> Run {
    let (mut best, mut run) = ((0, 0), (0, 0));
    for k in 0..sensors {
        run = if flat >> k & 1 == 1 { (k + 1, 0) } else { (run.0, run.1 + 1) };
        if run.1 > best.1 {
            best = run;
        }
    }
    best
}

/// Only these sensors of a step's transforms, from the first value on.
pub(super) fn only(held: &mut Held, (first, length): Run) {
    if first == 0 {
        return;
    }
    for band in &mut held.bands {
        for snapshot in band.values.iter_mut().chain(&mut band.slopes) {
            snapshot.copy_within(first..first + length, 0);
        }
    }
}

/// What was found over a recording.
pub(super) struct Tally {
    sensors: usize,
    spacing_m: f64,
    /// Steps in which each recorded nothing, and those from which no line could be made of the rest.
    dead: Vec<u64>,
    too_few: u64,
    steps: u64,
    /// The shortest run.
    run: Run,
}

impl Tally {
    pub(super) fn new(sensors: usize, spacing_m: f64) -> Self {
        Self { sensors, spacing_m, dead: vec![0; sensors], too_few: 0, steps: 0, run: (0, sensors) }
    }

    pub(super) fn sensors(&self) -> usize {
        self.sensors
    }

    /// Counts a step, and how it can be used.
    pub(super) fn take(&mut self, flat: u32, run: Run, usable: bool) {
        self.steps += 1;
        for (k, n) in self.dead.iter_mut().enumerate() {
            *n += u64::from(flat >> k & 1);
        }
        self.too_few += u64::from(!usable);
        if run.1 < self.run.1 {
            self.run = run;
        }
    }

    /// The line for a person; `None` where all sensors record.
    pub(super) fn said(&self) -> Option<String> {
        let dead: Vec<String> =
            self.dead.iter().enumerate().filter(|(_, n)| **n > 0).map(|(k, _)| k.to_string()).collect();
        let most = self.dead.iter().max().copied().unwrap_or(0);
        if dead.is_empty() {
            return None;
        }
        let (first, length) = self.run;
        let left = if self.too_few > 0 {
            format!("{} steps have too few others side by side and no bearing", self.too_few)
        } else {
            let middle = first as f64 + 0.5 * (length as f64 - 1.0) - 0.5 * (self.sensors as f64 - 1.0);
            format!(
                "left out; bearings are those of sensors {first} to {}, from a place {:.1} m along the line",
                first + length - 1,
                middle * self.spacing_m
            )
        };
        Some(format!(
            "sensor{} {} (from 0) record{} nothing in {most} of {} steps: {left}",
            if dead.len() > 1 { "s" } else { "" },
            dead.join(", "),
            if dead.len() > 1 { "" } else { "s" },
            self.steps
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_run_is_the_line() {
        assert_eq!(longest(0, 23), (0, 23));
        assert_eq!(longest(0b1110_0000, 23), (8, 15));
        assert_eq!(longest(1 << 22 | 1 << 10, 23), (11, 11));
        assert_eq!(longest(u32::MAX, 23).1, 0);
    }
}
