//! Areas on the sea, and the probability that a vessel is inside.

use crate::report::Covariance;
use seabearing_host::geodesy::LocalFrame;

/// Corners of an area lie no further than this from its first one, m: its sides are straight on a plane map.
const WIDEST_M: f64 = 300_000.0;
/// Rings and points on a ring by which a probability is counted: equal shares of it.
const RINGS: usize = 16;
const ON_RING: usize = 16;

/// A polygon by its corners: latitude and longitude, degrees. It may lie across the date line or about a pole.
#[derive(Clone, Debug, PartialEq)]
pub struct Area {
    corners_deg: Vec<(f64, f64)>,
}

impl Area {
    /// From the corners in order; the last one joins the first. One that is given several times in a row counts once.
    ///
    /// # Errors
    /// What is wrong, in a few words.
    pub fn new(mut corners_deg: Vec<(f64, f64)>) -> Result<Self, String> {
        corners_deg.dedup();
        if corners_deg.len() > 1 && corners_deg.first() == corners_deg.last() {
            corners_deg.pop();
        }
        if let Some((lat, lon)) =
            corners_deg.iter().find(|(lat, lon)| !(lat.abs() <= 90.0 && (-180.0..=360.0).contains(lon)))
        {
            return Err(format!("[{lat}, {lon}] is no latitude and longitude in degrees"));
        }
        let [first, _, _, ..] = corners_deg.as_slice() else {
            return Err(format!("{} corners are no area", corners_deg.len()));
        };
        let frame = LocalFrame::new(first.0, first.1);
        let area = Self { corners_deg: corners_deg.clone() };
        let corners = area.corners_m(&frame);
        if let Some(far) = corners.iter().position(|(x, y)| x.hypot(*y) > WIDEST_M) {
            let (lat, lon) = corners_deg[far];
            return Err(format!(
                "[{lat}, {lon}] is more than {} km from the first corner",
                WIDEST_M / 1000.0
            ));
        }
        for a in 0..corners.len() {
            for b in a + 2..corners.len() {
                let joined = a == 0 && b + 1 == corners.len();
                if !joined && cross(side(&corners, a), side(&corners, b)) {
                    return Err(format!("it crosses itself: its sides {} and {}", a + 1, b + 1));
                }
            }
        }
        let twice: f64 =
            (0..corners.len()).map(|k| side(&corners, k)).map(|(p, q)| p.0 * q.1 - q.0 * p.1).sum();
        if !(twice.abs() > 1.0) {
            return Err("its corners lie on a line".to_owned());
        }
        Ok(area)
    }

    /// The corners in a frame, m.
    pub fn corners_m(&self, frame: &LocalFrame) -> Vec<(f64, f64)> {
        self.corners_deg.iter().map(|(lat, lon)| frame.east_north_m(*lat, *lon)).collect()
    }
}

/// A side of a polygon.
fn side(corners: &[(f64, f64)], k: usize) -> ((f64, f64), (f64, f64)) {
    (corners[k], corners[(k + 1) % corners.len()])
}

type Side = ((f64, f64), (f64, f64));

/// Whether two sides have a point in common.
fn cross((a, b): Side, (c, d): Side) -> bool {
    let turn =
        |p: (f64, f64), q: (f64, f64), r: (f64, f64)| (q.0 - p.0) * (r.1 - p.1) - (q.1 - p.1) * (r.0 - p.0);
    // Of sides on one line all turns are none: whether they reach each other is another matter.
    let reach = |a: f64, b: f64, c: f64, d: f64| a.max(b) >= c.min(d) && c.max(d) >= a.min(b);
    let near = reach(a.0, b.0, c.0, d.0) && reach(a.1, b.1, c.1, d.1);
    near && turn(a, b, c) * turn(a, b, d) <= 0.0 && turn(c, d, a) * turn(c, d, b) <= 0.0
}

/// Whether a place lies inside: a ray to the East crosses an odd number of sides.
pub fn is_inside(corners: &[(f64, f64)], (x, y): (f64, f64)) -> bool {
    (0..corners.len()).fold(false, |inside, k| {
        let ((ax, ay), (bx, by)) = side(corners, k);
        let crosses = (ay > y) != (by > y) && x < ax + (y - ay) / (by - ay) * (bx - ax);
        inside != crosses
    })
}

/// Share of a normal distribution for which a condition holds, to 1/256: it is tried at points that stand for equal shares.
pub fn share(mean: (f64, f64), covariance: &Covariance, holds: impl Fn((f64, f64)) -> bool) -> f64 {
    // The root: East from one draw, North from that and another.
    let east = covariance.xx.max(0.0).sqrt();
    let mixed = if east > 0.0 { covariance.xy / east } else { 0.0 };
    let north = (covariance.yy - mixed * mixed).max(0.0).sqrt();
    let mut inside = 0usize;
    for ring in 0..RINGS {
        let radius = (-2.0 * (1.0 - (ring as f64 + 0.5) / RINGS as f64).ln()).sqrt();
        for k in 0..ON_RING {
            // Every other ring is turned by half a step.
            let step = k as f64 + 0.5 * (ring % 2) as f64;
            let (s, c) = (std::f64::consts::TAU * step / ON_RING as f64).sin_cos();
            let at = (mean.0 + east * radius * c, mean.1 + mixed * radius * c + north * radius * s);
            inside += usize::from(holds(at));
        }
    }
    inside as f64 / (RINGS * ON_RING) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn areas_that_are_none_are_refused_and_why() {
        let wrong = |corners: &[(f64, f64)]| Area::new(corners.to_vec()).unwrap_err();
        assert!(wrong(&[(50.0, 0.0), (50.1, 0.0)]).contains("2 corners"));
        assert!(
            wrong(&[(50.0, 0.0), (50.1, 0.1), (50.0, 0.1), (50.1, 0.0)])
                .starts_with("it crosses itself: its sides 1 and 3")
        );
        assert!(wrong(&[(50.0, 0.0), (91.0, 0.1), (50.0, 0.1)]).starts_with("[91, 0.1] is no latitude"));
        assert!(wrong(&[(50.0, 0.0), (0.0, 0.1), (50.0, 0.1)]).contains("more than 300 km"));
        assert!(wrong(&[(50.0, 0.0), (50.1, 0.0), (50.2, 0.0)]).contains("on a line"));
    }

    #[test]
    fn a_corner_given_several_times_in_a_row_is_one() {
        let (a, b, c) = ((49.0, -123.4), (49.0, -123.3), (49.1, -123.3));
        let plain = Area::new(vec![a, b, c]).unwrap();
        for doubled in [vec![a, b, b, b, c], vec![a, a, b, c, c], vec![a, b, c, c, a, a]] {
            assert_eq!(Area::new(doubled), Ok(plain.clone()));
        }
        assert!(Area::new(vec![a, b, b, a]).unwrap_err().contains("2 corners"));
    }

    #[test]
    fn an_area_may_have_sides_on_one_line() {
        let east =
            [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.2, 0.1), (0.2, 0.0), (0.3, 0.0), (0.3, 0.2), (0.0, 0.2)];
        assert!(Area::new(east.to_vec()).is_ok());
        // One that comes back onto its own side.
        let back = [(0.0, 0.0), (0.2, 0.0), (0.2, 0.1), (0.1, 0.0), (0.3, 0.0), (0.3, 0.2), (0.0, 0.2)];
        assert!(Area::new(back.to_vec()).unwrap_err().contains("crosses itself"));
    }

    #[test]
    fn an_area_may_lie_across_the_date_line_or_about_a_pole() {
        let area = Area::new(vec![(-17.0, 179.9), (-17.0, -179.9), (-16.8, -179.9), (-16.8, 179.9)]).unwrap();
        let frame = LocalFrame::new(-16.9, 179.95);
        let inside = |lat, lon| is_inside(&area.corners_m(&frame), frame.east_north_m(lat, lon));
        assert!(inside(-16.9, 180.0) && inside(-16.9, -179.95) && inside(-16.9, 179.95));
        assert!(!inside(-16.9, 179.8) && !inside(-16.9, 0.0) && !inside(-16.7, 180.0));
        let pole = Area::new(vec![(89.0, 0.0), (89.0, 120.0), (89.0, -120.0)]).unwrap();
        let frame = LocalFrame::new(89.5, 10.0);
        assert!(is_inside(&pole.corners_m(&frame), frame.east_north_m(90.0, 0.0)));
        assert!(!is_inside(&pole.corners_m(&frame), frame.east_north_m(88.0, 60.0)));
    }

    #[test]
    fn a_share_is_that_of_the_normal_distribution() {
        let covariance = Covariance { xx: 400.0, yy: 100.0, xy: 150.0 };
        assert_eq!(share((0.0, 0.0), &covariance, |(x, _)| x < 0.0), 0.5);
        // Φ(1) and Φ(2) along each axis.
        for (limit, want) in [(20.0, 0.8413), (40.0, 0.9772)] {
            let x = share((0.0, 0.0), &covariance, |(x, _)| x < limit);
            let y = share((0.0, 0.0), &covariance, |(_, y)| y < limit / 2.0);
            assert!((x - want).abs() < 0.02 && (y - want).abs() < 0.02, "{x} {y}");
        }
        // 1 − exp(−1/2) within one standard deviation.
        let round = Covariance { xx: 1.0, yy: 1.0, xy: 0.0 };
        assert!((share((0.0, 0.0), &round, |(x, y)| x.hypot(y) < 1.0) - 0.3935).abs() < 0.04);
    }
}
