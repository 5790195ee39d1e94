//! Directions against time, a colour for each track, with the band that the recorder states about each.

use super::heard::Belonging;
use super::times::Times;
use super::{Plot, Scale};
use plotters::style::RGBColor;
use seabearing_core::kit::median;
use seabearing_core::wire::Bearing;

/// Half the width of a 95 % interval of a Gaussian, in standard deviations.
pub(crate) const Z95: f64 = 1.959_964;

/// The colour of what belongs to no track.
pub(super) const NOBODY: RGBColor = RGBColor(165, 165, 165);

/// Gaps beyond so many usual steps, and at least so many seconds, interrupt a band.
const GAP_STEPS: f64 = 4.0;
const LEAST_GAP_S: f64 = 4.0;

/// Share of its own colour that another track keeps on a track's page.
const FADED: f64 = 0.45;

/// Room above and below values, degrees.
const ROOM_DEG: f64 = 5.0;

/// A colour nearer to the page's.
pub(super) fn faded(colour: RGBColor) -> RGBColor {
    let mix = |c: u8| (255.0 + FADED * (f64::from(c) - 255.0)).round() as u8;
    RGBColor(mix(colour.0), mix(colour.1), mix(colour.2))
}

/// One direction: where its time lies on the axis, its time, value and half of its band (degrees, or both a sine).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Direction {
    pub(crate) at: f64,
    pub(crate) t_s: f64,
    pub(crate) value: f64,
    pub(crate) half: f64,
}

/// Which angle of a bearing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Angle {
    Azimuth,
    Elevation,
}

impl Angle {
    fn of(self, b: &Bearing) -> (f64, f64) {
        let (value, variance) = match self {
            Self::Azimuth => (b.azimuth, b.var_azimuth),
            Self::Elevation => (b.elevation, b.var_elevation),
        };
        (f64::from(value).to_degrees(), f64::from(variance.max(0.0).sqrt()).to_degrees())
    }

    fn name(self) -> (&'static str, &'static str) {
        match self {
            Self::Azimuth => ("Azimuth", "azimuth (°)"),
            Self::Elevation => ("Elevation", "elevation (°)"),
        }
    }
}

/// The angle of all bearings between two times (s): of no track grey, others than `alone` (the place of a passage) faded.
pub(super) fn panel(
    angle: Angle,
    bearings: &[Bearing],
    found: &Belonging,
    rate_hz: f64,
    times: &Times,
    shown_s: (f64, f64),
    alone: Option<usize>,
) -> Plot {
    let (title, label) = angle.name();
    let mut figure = Plot::new(title, "", label);
    times.along(&mut figure);
    let mut own: Vec<Vec<Direction>> = vec![Vec::new(); found.passages.len()];
    let mut nobody: Vec<(f64, f64)> = Vec::new();
    let shown = |b: &Bearing| (shown_s.0..=shown_s.1).contains(&(b.index as f64 / rate_hz));
    for (b, whose) in bearings.iter().zip(&found.whose).filter(|(b, _)| shown(b)) {
        let t_s = b.index as f64 / rate_hz;
        let (deg, sd_deg) = angle.of(b);
        match whose.and_then(|k| own.get_mut(k)) {
            Some(of) => of.push(Direction { at: times.at(t_s), t_s, value: deg, half: Z95 * sd_deg }),
            None => nobody.push((times.at(t_s), deg)),
        }
    }
    let values = own.iter().flatten().map(|d| d.value).chain(nobody.iter().map(|p| p.1));
    let (from, to) = limits(angle, values);
    figure.y_range(from, to);
    if !nobody.is_empty() {
        figure.points("of no track", &nobody).coloured(NOBODY).sized(1.4);
    }
    let order = |k: &usize| alone == Some(*k);
    let mut drawn: Vec<usize> =
        (0..own.len()).filter(|k| own.get(*k).is_some_and(|d| !d.is_empty())).collect();
    drawn.sort_by_key(order);
    for k in drawn {
        let (Some(passage), Some(directions)) = (found.passages.get(k), own.get(k)) else { continue };
        let points: Vec<(f64, f64)> = directions.iter().map(|d| (d.at, d.value)).collect();
        if alone.is_some_and(|alone| alone != k) {
            figure
                .points(&format!("{} (another)", passage.name()), &points)
                .coloured(faded(passage.colour()))
                .sized(1.4);
            continue;
        }
        figure.band("", &band(directions, angle == Angle::Azimuth)).coloured(passage.look());
        figure.points(&passage.name(), &points).coloured(passage.look()).sized(1.7);
    }
    if angle == Angle::Azimuth {
        figure.y_scale(Scale::Degrees);
    }
    figure
}

/// Ends of the axis that shows values: a whole circle where azimuths go round or far.
fn limits(angle: Angle, values: impl Iterator<Item = f64>) -> (f64, f64) {
    let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
    match angle {
        Angle::Azimuth if high - low > 120.0 || low > high => (0.0, 360.0),
        Angle::Azimuth => ((low - ROOM_DEG).max(0.0), (high + ROOM_DEG).min(360.0)),
        Angle::Elevation if low > high => (-90.0, 90.0),
        Angle::Elevation => ((low - ROOM_DEG).max(-90.0), (high + ROOM_DEG).min(90.0)),
    }
}

/// The band of directions of one source: interrupted where it was not heard and where an azimuth goes over North, beyond which the
/// band is drawn on the other side.
pub(crate) fn band(directions: &[Direction], circle: bool) -> Vec<(f64, f64, f64)> {
    let mut steps: Vec<f64> = directions.windows(2).map(|w| w[1].t_s - w[0].t_s).collect();
    let gap_s = (GAP_STEPS * median(&mut steps).unwrap_or(0.0)).max(LEAST_GAP_S);
    let shifts: &[f64] = if circle { &[0.0, 360.0, -360.0] } else { &[0.0] };
    let mut out = Vec::new();
    for shift in shifts {
        let mut last: Option<&Direction> = None;
        for d in directions {
            let half = d.half.min(180.0);
            let (low, high) = (d.value - half + shift, d.value + half + shift);
            if *shift != 0.0 && (high < 0.0 || low > 360.0) {
                last = None;
                continue;
            }
            let jumps = |l: &Direction| d.t_s - l.t_s > gap_s || circle && (d.value - l.value).abs() > 90.0;
            if last.is_none_or(jumps) {
                out.push((d.at, f64::NAN, f64::NAN));
            }
            out.push((d.at, low, high));
            last = Some(d);
        }
    }
    let mut apart: Vec<f64> =
        directions.windows(2).map(|w| w[1].at - w[0].at).filter(|step| *step > 0.0).collect();
    widened(&out, 0.5 * median(&mut apart).unwrap_or(0.0))
}

/// A band in which a direction that stands alone is so wide to both sides, or nothing would be seen of it.
fn widened(band: &[(f64, f64, f64)], half: f64) -> Vec<(f64, f64, f64)> {
    let mut out = Vec::with_capacity(band.len());
    for run in band.chunk_by(|_, next| next.1.is_finite()) {
        match run {
            [gap, (at, low, high)] if gap.1.is_nan() => {
                out.extend([*gap, (at - half, *low, *high), (at + half, *low, *high)]);
            }
            _ => out.extend_from_slice(run),
        }
    }
    out
}

/// What the panel of an angle shows, in words.
pub(super) fn words(angle: Angle, alone: bool) -> String {
    let what = match angle {
        Angle::Azimuth => "Azimuth of each bearing, degrees clockwise from true North",
        Angle::Elevation => "Elevation of each bearing, degrees up from the horizontal",
    };
    let others = if alone {
        "This track in full colour, others faded; grey: bearings of no track."
    } else {
        "A colour for each track; grey: bearings of no track."
    };
    format!(
        "{what}. {others} Shaded: the 95 % interval that the recorder states about each bearing of a track."
    )
}

#[cfg(test)]
mod tests {
    use super::super::heard::Heard;
    use super::super::heard::tests::{RATE_HZ, bearing, track};
    use super::super::{Series, Shape};
    use super::*;

    fn two_vessels() -> (Vec<Bearing>, Belonging) {
        let ways = [(50.0, 500.0), (60.0, -400.0)];
        let bearings: Vec<Bearing> =
            (0..100).flat_map(|t| ways.map(|way| bearing(f64::from(t), way))).collect();
        let heard: Vec<Heard> = bearings.iter().map(|b| Heard::of(b, RATE_HZ)).collect();
        let reports: Vec<_> = (0..20)
            .flat_map(|k| {
                [track(1, 0, 5.0 * f64::from(k), ways[0]), track(2, 0, 5.0 * f64::from(k), ways[1])]
            })
            .collect();
        let found = Belonging::of_array(&reports, &heard, RATE_HZ);
        (bearings, found)
    }

    type Corners = Vec<(f64, f64, f64)>;

    fn bands(figure: &Plot) -> Vec<(RGBColor, Corners)> {
        let band =
            |s: &Series| if let Shape::Band(b) = &s.shape { Some((s.look.colour, b.clone())) } else { None };
        figure.series.iter().filter_map(band).collect()
    }

    #[test]
    fn each_track_has_its_own_band_in_its_colour() {
        let (bearings, found) = two_vessels();
        let figure =
            panel(Angle::Azimuth, &bearings, &found, RATE_HZ, &Times::new(None, 100.0), (0.0, 100.0), None);
        let bands = bands(&figure);
        assert_eq!(bands.len(), 2);
        assert_ne!(bands[0].0, bands[1].0);
        for (colour, corners) in &bands {
            // No band spans two vessels: each step is small, and there is one corner a bearing.
            let steps = corners.windows(2).filter(|w| w[0].1.is_finite() && w[1].1.is_finite());
            assert!(steps.clone().count() > 90 && steps.clone().all(|w| (w[0].1 - w[1].1).abs() < 5.0));
            assert!(corners.iter().filter(|c| c.1.is_finite()).all(|c| (c.2 - c.1) < 3.0));
            let points = figure
                .series
                .iter()
                .find(|s| s.look.colour == *colour && matches!(s.shape, Shape::Points(_)));
            assert!(points.is_some_and(|s| s.name.starts_with("track ")));
        }
    }

    #[test]
    fn on_its_own_page_a_track_stands_out_and_the_others_are_named() {
        let (bearings, found) = two_vessels();
        let times = Times::new(None, 100.0);
        let figure = panel(Angle::Azimuth, &bearings, &found, RATE_HZ, &times, (0.0, 100.0), Some(1));
        assert_eq!(bands(&figure).len(), 1);
        let last = figure.series.last().unwrap();
        assert_eq!((last.name.as_str(), last.look.colour), ("track 2", found.passages[1].colour()));
        let other = figure.series.iter().find(|s| s.name == "track 1 (another)").unwrap();
        assert_eq!(other.look.colour, faded(found.passages[0].colour()));
    }

    #[test]
    fn bands_are_interrupted_by_silence_and_go_on_beyond_north() {
        let one = |t_s: f64, value: f64| Direction { at: t_s, t_s, value, half: 5.0 };
        let mut heard: Vec<Direction> = (0..9).map(|k| one(f64::from(k), 100.0)).collect();
        heard.push(one(30.0, 120.0));
        let corners = band(&heard, true);
        assert_eq!(corners.iter().filter(|c| c.1.is_nan()).count(), 2);
        // What stands alone is as wide as the time between others.
        assert_eq!(&corners[11..], [(29.5, 115.0, 125.0), (30.5, 115.0, 125.0)].as_slice());
        let corners = band(&[one(0.0, 357.0), one(1.0, 359.0), one(2.0, 1.0)], true);
        assert!(corners.contains(&(1.0, -6.0, 4.0)) && corners.contains(&(1.5, 356.0, 366.0)), "{corners:?}");
    }
}
