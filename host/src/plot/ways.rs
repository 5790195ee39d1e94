//! Courses on a map: where a vessel went while it was heard, with times, the way it goes and the ellipse of its last place.

use super::heard::{Belonging, Passage};
use super::times::Times;
use super::{Look, Plot};

/// Length of an arrow's head, as a share of the longest course.
const HEAD: f64 = 0.05;

/// Tracks above which only their numbers stand beside them.
const FEW: usize = 6;

/// Draws the courses of passages whose place is known; what of the others is said below the map.
pub(crate) fn courses(figure: &mut Plot, found: &Belonging, times: &Times) {
    let placed: Vec<&Passage> = found.passages.iter().filter(|p| p.is_placed()).collect();
    let length = |p: &&Passage| ends(p).map_or(0.0, |(a, b)| (b.0 - a.0).hypot(b.1 - a.1));
    let head_m = HEAD * placed.iter().map(length).fold(0.0, f64::max);
    let mut notes = Vec::new();
    for passage in &placed {
        course(figure, passage, head_m);
        let Some((from, to)) = ends(passage) else { continue };
        let (from_s, to_s) = passage.heard_s;
        if placed.len() <= FEW {
            notes.push((from, times.clock(from_s)));
            notes.push((to, format!("{} at {}", passage.last.id, times.clock(to_s))));
        } else {
            notes.push((to, passage.last.id.to_string()));
        }
    }
    figure.notes(notes);
}

/// The two ends of a course, m.
fn ends(passage: &Passage) -> Option<((f64, f64), (f64, f64))> {
    let (from, to) = passage.heard_s;
    passage.is_placed().then(|| (passage.place(from), passage.place(to)))
}

/// Draws one course with its arrow and ellipse.
fn course(figure: &mut Plot, passage: &Passage, head_m: f64) {
    let Some((from, to)) = ends(passage) else { return };
    let t = &passage.last;
    figure.line(&passage.name(), &[from, to]).coloured(passage.look());
    let barb = |turn: f64| {
        let (s, c) = (f64::from(t.heading) + turn).sin_cos();
        (to.0 - head_m * s, to.1 - head_m * c)
    };
    figure.line("", &[barb(0.4), to, barb(-0.4)]).same_colour();
    let centre = (f64::from(t.x_m), f64::from(t.y_m));
    let variances = (t.var_x_m2.into(), t.var_y_m2.into(), t.cov_xy_m2.into());
    figure.ellipse("", centre, variances, 0.95).same_colour();
}

/// One course alone, with the times of its beginning, closest point and end.
pub(super) fn alone(figure: &mut Plot, passage: &Passage, times: &Times) {
    let Some((from, to)) = ends(passage) else { return };
    course(figure, passage, HEAD * (to.0 - from.0).hypot(to.1 - from.1));
    let (from_s, to_s) = passage.heard_s;
    let mut marked = vec![from_s, to_s];
    let cpa_s = passage.last.cpa_time_s;
    // Not where its words would lie on those of an end.
    if cpa_s - from_s > 0.1 * (to_s - from_s) && to_s - cpa_s > 0.1 * (to_s - from_s) {
        marked.push(cpa_s);
    }
    let at = |t_s: f64| passage.place(t_s);
    figure.points("", &marked.iter().map(|t_s| at(*t_s)).collect::<Vec<_>>()).coloured(passage.look());
    figure.notes(marked.into_iter().map(|t_s| (at(t_s), times.clock(t_s))).collect());
}

/// What a map of courses shows, in words.
pub(crate) fn words(found: &Belonging) -> String {
    let without: Vec<String> =
        found.passages.iter().filter(|p| !p.is_placed()).map(|p| p.last.id.to_string()).collect();
    let without = match without.as_slice() {
        [] => String::new(),
        [one] => format!(" Track {one} is not drawn: nothing is known of its range."),
        several => format!(" Tracks {} are not drawn: nothing is known of their ranges.", several.join(", ")),
    };
    let placed = found.passages.len() - found.passages.iter().filter(|p| !p.is_placed()).count();
    let beside = if placed <= FEW {
        "its number and UTC"
    } else if placed <= Look::MOST {
        "its number (from the eighth on lines are dashed, for colours return)"
    } else {
        "its number (colours return after seven)"
    };
    format!(
        "Straight course of each track through the closest point of its last solution, while it was heard, with {beside}; the arrow shows the \
         way it goes, the ellipse holds its last place with 95 %. Black triangle: the station, about which circles show \
         the range.{without}"
    )
}

#[cfg(test)]
mod tests {
    use super::super::Shape;
    use super::super::heard::tests::{RATE_HZ, track};
    use super::*;
    use time::OffsetDateTime;

    #[test]
    fn a_map_has_times_arrows_and_ellipses_and_the_station_once() {
        let reports: Vec<_> = [(1, (600.0, 500.0)), (2, (900.0, -400.0))]
            .into_iter()
            .flat_map(|(id, way)| [track(id, 0, 300.0, way), track(id, 1, 1200.0, way)])
            .collect();
        let found = Belonging::of_array(&reports, &[], RATE_HZ);
        let times = Times::new(OffsetDateTime::from_unix_timestamp(1_714_521_600).ok(), 1200.0);
        let mut figure = Plot::map("Tracks");
        courses(&mut figure, &found, &times);
        for passage in &found.passages {
            let own = figure.series.iter().filter(|s| s.look.colour == passage.colour());
            let shapes: Vec<(usize, bool)> = own
                .map(|s| match &s.shape {
                    Shape::Line(points) => (points.len(), false),
                    Shape::Outline(_) => (0, true),
                    other => panic!("{other:?}"),
                })
                .collect();
            // The course, its arrow's head, the ellipse: all in the track's colour.
            assert_eq!(shapes, [(2, false), (3, false), (0, true)]);
        }
        let notes: Vec<&str> = (figure.series.iter())
            .filter_map(|s| if let Shape::Notes(notes) = &s.shape { Some(notes) } else { None })
            .flatten()
            .map(|(_, text)| text.as_str())
            .collect();
        assert_eq!(notes, ["00:05:00", "1 at 00:20:00", "00:05:00", "2 at 00:20:00"]);
        let svg = figure.svg().unwrap();
        // The station is the only filled shape: a triangle.
        assert_eq!((svg.matches("<polygon").count(), svg.matches("<circle").count()), (1, 0));
    }

    #[test]
    fn of_a_track_without_a_range_it_is_said_that_it_is_not_drawn() {
        let mut report = track(4, 1, 300.0, (600.0, 500.0));
        report.range_observable = false;
        let found = Belonging::of_array(&[report], &[], RATE_HZ);
        let mut figure = Plot::map("Tracks");
        courses(&mut figure, &found, &Times::new(None, 300.0));
        assert!(figure.series.iter().all(|s| matches!(&s.shape, Shape::Notes(n) if n.is_empty())));
        assert!(words(&found).contains("Track 4 is not drawn"));
    }
}
