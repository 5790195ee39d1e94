//! When an ocean-bottom station heard a vessel: detections, evidence of presence and segments against time.

use crate::angle::wrap_deg;
use crate::plot::times::Times;
use crate::plot::{Plot, Scale};
use seabearing_core::kit::median;
use seabearing_core::wire::Message;

/// Kinds of azimuths, as the wire numbers them.
pub(super) const TONAL: u8 = 0;
pub(super) const IMPULSIVE: u8 = 1;

/// Silences beyond so many usual steps interrupt a line.
const GAP_STEPS: f64 = 2.5;

/// Azimuths of the detections of a kind, against time, degrees.
pub(super) fn azimuths(messages: &[Message], rate: f64, times: &Times, kind: u8) -> Vec<(f64, f64)> {
    let one = |m: &Message| match m {
        Message::Azimuth(a) if a.detected && a.kind == kind => {
            Some((times.at(a.index as f64 / rate), wrap_deg(f64::from(a.azimuth).to_degrees())))
        }
        _ => None,
    };
    messages.iter().filter_map(one).collect()
}

/// Ranges of the detections, against time, km.
pub(super) fn ranges(messages: &[Message], rate: f64, times: &Times) -> Vec<(f64, f64)> {
    let one = |m: &Message| match m {
        Message::Range(r) if r.detected => {
            Some((times.at(r.index as f64 / rate), f64::from(r.range_m) / 1e3))
        }
        _ => None,
    };
    messages.iter().filter_map(one).collect()
}

/// Presence of azimuth and range, and the segments (figure 7).
pub(super) fn presence(
    messages: &[Message],
    rate: f64,
    times: &Times,
    shown: (f64, f64),
    source: &str,
) -> Vec<Plot> {
    let at = |index: u64| times.at(index as f64 / rate);
    let mut evidence = Plot::new("Presence and segments", "", "ln ratio of presence");
    let mut tops = [Vec::<(f64, f64)>::new(), Vec::new()];
    for m in messages {
        let (slot, index, value) = match m {
            Message::Azimuth(a) => (0, a.index, a.log_presence),
            Message::Range(r) => (1, r.index, r.log_presence),
            _ => continue,
        };
        let point = (at(index), f64::from(value).clamp(-20.0, 60.0));
        match tops[slot].last_mut().filter(|l| l.0 == point.0) {
            Some(l) => l.1 = l.1.max(point.1),
            None => tops[slot].push(point),
        }
    }
    let tops = tops.map(|line| interrupted(&line));
    // The last word on each segment counts.
    let mut segments = std::collections::BTreeMap::new();
    for m in messages {
        if let Message::Segment(s) = m {
            segments.insert((s.id, s.kind), *s);
        }
    }
    for kind in 0..3u8 {
        let name = ["segment", "approaching", "leaving"][usize::from(kind)];
        let height = [(-20.0, -16.0), (-16.0, -13.0), (-16.0, -13.0)][usize::from(kind)];
        for (n, s) in segments.values().filter(|s| s.kind == kind).enumerate() {
            let band = [(at(s.start), height.0, height.1), (at(s.end), height.0, height.1)];
            evidence.band(if n == 0 { name } else { "" }, &band);
            if n > 0 {
                evidence.same_colour();
            }
        }
    }
    evidence.line("azimuth (drawn up to 60)", &tops[0]).line("range (posterior odds)", &tops[1]);
    evidence.x_range(shown.0, shown.1).y_range(-21.0, 62.0);
    let mut azimuth = Plot::new("Azimuth detections", "", "azimuth (°)");
    azimuth
        .points("tonal", &azimuths(messages, rate, times, TONAL))
        .x_range(shown.0, shown.1)
        .y_range(0.0, 360.0);
    let calls = azimuths(messages, rate, times, IMPULSIVE);
    if !calls.is_empty() {
        azimuth.points("impulsive (calls)", &calls);
    }
    azimuth.y_scale(Scale::Degrees);
    let mut range = Plot::new("Range detections", "", "range (km)");
    range.points("range", &ranges(messages, rate, times)).x_range(shown.0, shown.1).y_range(0.0, 50.0);
    azimuth.caption("Azimuth of each detection, degrees clockwise from true North.");
    evidence.caption(
        "Lines: natural logarithm of the ratio of probabilities that a vessel is there to that none is, by azimuth and by range; interrupted where the \
         station said nothing. Bars below: segments in which a vessel was present, and its parts approaching and leaving.",
    );
    range.caption(&format!("Horizontal range of each detection. {source}"));
    for f in [&mut evidence, &mut azimuth, &mut range] {
        f.size(900, 300);
        times.along(f);
    }
    vec![azimuth, evidence, range]
}

/// A line that ends where nothing was said for longer than usual, and begins again.
fn interrupted(line: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let mut steps: Vec<f64> = line.windows(2).map(|w| w[1].0 - w[0].0).collect();
    let longest = GAP_STEPS * median(&mut steps).unwrap_or(f64::INFINITY);
    let mut out: Vec<(f64, f64)> = Vec::with_capacity(line.len());
    for point in line {
        if out.last().is_some_and(|last| point.0 - last.0 > longest) {
            out.push((point.0, f64::NAN));
        }
        out.push(*point);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_not_drawn_through_a_silence() {
        let line = [(0.0, 1.0), (1.0, 1.0), (2.0, 1.0), (3.0, 1.0), (60.0, 2.0), (61.0, 2.0)];
        let out = interrupted(&line);
        assert_eq!(out.len(), 7);
        assert!(out[4].1.is_nan() && out[5] == (60.0, 2.0));
        assert!(interrupted(&[]).is_empty());
    }
}
