//! Where a vessel is, and when it made the sound that arrives now.
//!
//! Places are metres East and North of the station. A sound received at `t` by a hydrophone at `h` was emitted at
//! `t_e` with `t_e + ‖r(t_e) − h‖/c = t`; the fixed-point iteration for it contracts by `v/c` (0.005 at 7 m/s) a step.

use crate::csv::CsvTable;
use crate::geodesy::LocalFrame;
use crate::scenario::{Side, Straight};
use anyhow::{Context, Result, bail};
use seabearing_core::angle::wrap_tau;
use seabearing_core::kit::straight_line::through;
use seabearing_core::kit::{closest, golden};
use seabearing_locate::between::between;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::Path;

/// East and North of the station, metres.
pub type EastNorth = (f64, f64);

/// Time and place.
pub type Fix = (f64, EastNorth);

/// A steady motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Steady {
    /// A time, s.
    pub at_s: f64,
    /// The place then, m.
    pub place_m: EastNorth,
    /// East and North speed, m/s.
    pub velocity_m_s: (f64, f64),
}

impl Steady {
    fn at(&self, t_s: f64) -> Self {
        let dt = t_s - self.at_s;
        let ((x, y), (vx, vy)) = (self.place_m, self.velocity_m_s);
        Self { at_s: t_s, place_m: (x + vx * dt, y + vy * dt), ..*self }
    }

    /// From one fix to another.
    fn leg(a: &Fix, b: &Fix) -> Self {
        let dt = b.0 - a.0;
        let velocity_m_s = ((b.1.0 - a.1.0) / dt, (b.1.1 - a.1.1) / dt);
        Self { at_s: a.0, place_m: a.1, velocity_m_s }
    }
}

/// How a vessel moves.
#[derive(Clone, Debug, PartialEq)]
pub enum VesselCourse {
    /// Straight and steady, told by its closest point.
    Straight(Steady),
    /// Two fixes or more in order of time, joined by straight legs; outside them the vessel is not there.
    Fixes(Vec<Fix>),
    /// Moments in order of time, joined by cubics with continuous velocity; straight on outside.
    Smooth(Vec<Steady>),
}

/// Closest point of approach, horizontally.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cpa {
    /// Its time, s.
    pub time_s: f64,
    /// Its range, m.
    pub range_m: f64,
}

impl VesselCourse {
    /// The straight course of a scenario.
    pub fn straight(s: &Straight) -> Self {
        let starboard = s.side == Side::Starboard;
        Self::by_cpa(s.cpa_time_s, s.cpa_range_m, s.heading_deg.to_radians(), s.speed_m_s, starboard)
    }

    /// A straight course by its closest point; `starboard` if the station lies on the vessel's starboard side.
    pub fn by_cpa(
        cpa_time_s: f64,
        cpa_range_m: f64,
        heading_rad: f64,
        speed_m_s: f64,
        starboard: bool,
    ) -> Self {
        let (s, c) = heading_rad.sin_cos();
        // To starboard of heading (s, c) lies (c, −s): a station there sees the vessel on the other side.
        let side = if starboard { -cpa_range_m } else { cpa_range_m };
        let velocity_m_s = (speed_m_s * s, speed_m_s * c);
        Self::Straight(Steady { at_s: cpa_time_s, place_m: (side * c, -side * s), velocity_m_s })
    }

    /// A smooth course through fixes in order of time.
    ///
    /// # Errors
    /// Fewer than two, or times that do not rise.
    pub fn smooth(fixes: &[Fix]) -> Result<Self> {
        if fixes.len() < 2 {
            bail!("a track needs at least two points");
        }
        if let Some(w) = fixes.windows(2).find(|w| w[1].0 <= w[0].0) {
            bail!("times must rise: {} s is followed by {} s", w[0].0, w[1].0);
        }
        let last = fixes.len() - 1;
        let moments = fixes.iter().enumerate().map(|(i, (at_s, place_m))| {
            let along = Steady::leg(&fixes[i.saturating_sub(1)], &fixes[(i + 1).min(last)]);
            Steady { at_s: *at_s, place_m: *place_m, ..along }
        });
        Ok(Self::Smooth(moments.collect()))
    }

    /// The same way, later by a time and with all places farther by a factor.
    pub fn moved(&self, later_s: f64, scale: f64) -> Self {
        let place = |(x, y): EastNorth| (scale * x, scale * y);
        let steady = |s: &Steady| Steady {
            at_s: s.at_s + later_s,
            place_m: place(s.place_m),
            velocity_m_s: place(s.velocity_m_s),
        };
        match self {
            Self::Straight(s) => Self::Straight(steady(s)),
            Self::Fixes(fixes) => Self::Fixes(fixes.iter().map(|f| (f.0 + later_s, place(f.1))).collect()),
            Self::Smooth(moments) => Self::Smooth(moments.iter().map(steady).collect()),
        }
    }

    /// The vessel's place; `None` where fixes do not tell.
    pub fn at(&self, t_s: f64) -> Option<EastNorth> {
        match self {
            Self::Fixes(fixes) => {
                between(fixes, |f| f.0, t_s).map(|(a, b, _)| Steady::leg(a, b).at(t_s).place_m)
            }
            _ => Some(self.position(t_s)),
        }
    }

    /// The place, taken straight on beyond the first and the last fix.
    pub fn position(&self, t_s: f64) -> EastNorth {
        self.motion(t_s).place_m
    }

    /// East and North speed, m/s.
    pub fn velocity(&self, t_s: f64) -> (f64, f64) {
        self.motion(t_s).velocity_m_s
    }

    fn motion(&self, t_s: f64) -> Steady {
        match self {
            Self::Straight(steady) => steady.at(t_s),
            Self::Fixes(fixes) => {
                let (a, b) = match between(fixes, |f| f.0, t_s) {
                    Some((a, b, _)) => (a, b),
                    None if t_s < fixes[0].0 => (&fixes[0], &fixes[1]),
                    None => (&fixes[fixes.len() - 2], &fixes[fixes.len() - 1]),
                };
                Steady::leg(a, b).at(t_s)
            }
            Self::Smooth(moments) => match between(moments, |m| m.at_s, t_s) {
                Some((a, b, share)) => cubic(a, b, share),
                None if t_s < moments[0].at_s => moments[0].at(t_s),
                None => moments[moments.len() - 1].at(t_s),
            },
        }
    }

    /// When the sound that reaches `receiver` (East, North, Up) at `t_s` left a source at height `z_m`, and how far it
    /// travelled: (emission time, distance).
    pub fn emission(
        &self,
        t_s: f64,
        receiver: [f64; 3],
        z_m: f64,
        sound_speed_m_s: f64,
        guess_s: f64,
    ) -> (f64, f64) {
        let mut t_e = guess_s;
        let mut distance = 0.0;
        for _ in 0..50 {
            let (x, y) = self.position(t_e);
            let d = [x - receiver[0], y - receiver[1], z_m - receiver[2]];
            distance = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
            let next = t_s - distance / sound_speed_m_s;
            let step = next - t_e;
            t_e = next;
            // A tenth of a picosecond: far below what 24 bits resolve at any sample rate.
            if step.abs() < 1e-13 {
                break;
            }
        }
        (t_e, distance)
    }

    /// The closest point within a span of time.
    pub fn cpa(&self, from_s: f64, to_s: f64) -> Cpa {
        let range = |t: f64| polar(self.position(t)).0;
        if let Self::Straight(Steady { at_s, .. }) = self {
            return Cpa { time_s: *at_s, range_m: range(*at_s) };
        }
        const STEPS: usize = 2000;
        let at = |i: usize| from_s + (to_s - from_s) * i as f64 / STEPS as f64;
        let best = (0..=STEPS).min_by(|a, b| range(at(*a)).total_cmp(&range(at(*b)))).unwrap_or(0);
        let time_s = golden(at(best.saturating_sub(1)), at((best + 1).min(STEPS)), 50, range);
        Cpa { time_s, range_m: range(time_s) }
    }

    /// The straight course that fits best in the least-squares sense: itself, or a line through the places of every minute
    /// within `HEARD_M`, since fixes come at odd times and a real vessel bends its way farther out. Through all fixes
    /// where it is hardly ever that near.
    pub fn straightened(&self) -> Option<Steady> {
        if let Self::Straight(steady) = self {
            return Some(*steady);
        }
        let fixes = self.fixes();
        let (first, last) = (fixes.first()?.0, fixes.last()?.0);
        let minutes = (0..=((last - first) / 60.0) as usize).map(|m| first + 60.0 * m as f64);
        let near: Vec<Fix> =
            minutes.filter_map(|t| Some((t, self.at(t)?))).filter(|f| polar(f.1).0 <= HEARD_M).collect();
        line(if near.len() >= 30 { &near } else { &fixes })
    }

    /// The times and places it is told by; none of a straight one.
    fn fixes(&self) -> Cow<'_, [Fix]> {
        match self {
            Self::Straight(_) => Cow::default(),
            Self::Fixes(fixes) => fixes.into(),
            Self::Smooth(moments) => moments.iter().map(|m| (m.at_s, m.place_m)).collect(),
        }
    }

    /// Greatest distance between the course within `HEARD_M` and its straightened form, m.
    pub fn bend_m(&self) -> Option<f64> {
        let (fixes, straight) = (self.fixes(), self.straightened()?);
        let apart = |(t, p): &Fix| {
            let q = straight.at(*t).place_m;
            (polar(*p).0 <= HEARD_M).then(|| (p.0 - q.0).hypot(p.1 - q.1))
        };
        Some(fixes.iter().filter_map(apart).fold(0.0, f64::max))
    }
}

/// Range within which a vessel is heard well, m.
const HEARD_M: f64 = 50_000.0;

/// The straight course through places in the least-squares sense.
fn line(fixes: &[Fix]) -> Option<Steady> {
    // About the mean time, where rounding matters least.
    let mean_s = fixes.iter().map(|f| f.0).sum::<f64>() / fixes.len() as f64;
    let x = through(fixes.iter().map(|(t, at)| (t - mean_s, at.0)))?;
    let y = through(fixes.iter().map(|(t, at)| (t - mean_s, at.1)))?;
    let after_s = closest([x.value, y.value, x.slope, y.slope])?.after_s;
    Some(Steady {
        at_s: mean_s + after_s,
        place_m: (x.at(after_s), y.at(after_s)),
        velocity_m_s: (x.slope, y.slope),
    })
}

/// Cubic Hermite between two moments.
fn cubic(a: &Steady, b: &Steady, u: f64) -> Steady {
    let h = b.at_s - a.at_s;
    let (u2, u3) = (u * u, u * u * u);
    let one = |p: f64, q: f64, v: f64, w: f64| {
        let (v, w) = (h * v, h * w);
        let place = p * (2.0 * u3 - 3.0 * u2 + 1.0)
            + v * (u3 - 2.0 * u2 + u)
            + q * (3.0 * u2 - 2.0 * u3)
            + w * (u3 - u2);
        let speed = p * (6.0 * u2 - 6.0 * u)
            + v * (3.0 * u2 - 4.0 * u + 1.0)
            + q * (6.0 * u - 6.0 * u2)
            + w * (3.0 * u2 - 2.0 * u);
        (place, speed / h)
    };
    let (x, vx) = one(a.place_m.0, b.place_m.0, a.velocity_m_s.0, b.velocity_m_s.0);
    let (y, vy) = one(a.place_m.1, b.place_m.1, a.velocity_m_s.1, b.velocity_m_s.1);
    Steady { at_s: a.at_s + u * h, place_m: (x, y), velocity_m_s: (vx, vy) }
}

/// The point of a straight leg that is nearest to the station: share of the way, and range.
pub fn nearest(a: EastNorth, b: EastNorth) -> (f64, f64) {
    let (dx, dy) = (b.0 - a.0, b.1 - a.1);
    // As a motion from one end to the other in a second.
    let share = closest([a.0, a.1, dx, dy]).map_or(0.0, |point| point.after_s.clamp(0.0, 1.0));
    (share, (a.0 + share * dx).hypot(a.1 + share * dy))
}

/// Time and place of every row of a track: `t_s` with `x_m`, `y_m` (in a frame in which the station is at `station_m`), or with
/// `lat`, `lon` in degrees, which need the station's own; each row with its line.
///
/// # Errors
/// There are neither pair of columns, or latitudes and the station has none.
pub fn fixes(
    table: &CsvTable,
    lat_lon_deg: Option<(f64, f64)>,
    station_m: EastNorth,
) -> Result<Vec<(usize, Result<Fix>)>> {
    let name = table.name();
    let pairs = [("x_m", "y_m"), ("lat_deg", "lon_deg"), ("lat", "lon")];
    let Some((first, second)) = pairs.into_iter().find(|(first, _)| table.has(first)) else {
        bail!("{name}: the header needs t_s,x_m,y_m or t_s,lat,lon")
    };
    let frame = match (first, lat_lon_deg) {
        ("x_m", _) => None,
        (_, Some((lat, lon))) => Some(LocalFrame::new(lat, lon)),
        (_, None) => {
            bail!("{name} has latitudes, but the station file no lat_deg and lon_deg of the station")
        }
    };
    let place = |a: f64, b: f64| match &frame {
        Some(frame) => frame.east_north_m(a, b),
        None => (a - station_m.0, b - station_m.1),
    };
    let rows = table.numbers(["t_s", first, second])?.into_iter();
    Ok(rows.map(|(line, row)| (line, row.map(|[t_s, a, b]| (t_s, place(a, b))))).collect())
}

/// Courses of a track file: one a `source`, or one in all. Rows of other kinds of source (no x, y) are passed over.
///
/// # Errors
/// The file cannot be read, or no vessel has two rows.
pub fn of_file(path: &Path) -> Result<Vec<VesselCourse>> {
    let table = CsvTable::read(path)?;
    let source = table.has("source").then(|| table.column("source")).transpose()?;
    let mut by_vessel: BTreeMap<String, Vec<Fix>> = BTreeMap::new();
    for (row, (_, fix)) in fixes(&table, None, (0.0, 0.0))?.into_iter().enumerate() {
        let name = source.and_then(|c| table.text(row, c)).unwrap_or("").to_owned();
        if let Ok(fix) = fix {
            by_vessel.entry(name).or_default().push(fix);
        }
    }
    by_vessel.values_mut().for_each(in_order);
    let courses: Vec<VesselCourse> =
        by_vessel.into_values().filter(|f| f.len() >= 2).map(VesselCourse::Fixes).collect();
    (!courses.is_empty())
        .then_some(courses)
        .with_context(|| format!("{}: no vessel with two or more rows of t_s, x_m, y_m", path.display()))
}

/// Brings fixes into the order of time; of those at one time the first stays.
pub fn in_order(fixes: &mut Vec<Fix>) {
    fixes.sort_by(|a, b| a.0.total_cmp(&b.0));
    fixes.dedup_by_key(|fix| fix.0);
}

/// Range (m) and azimuth (rad, clockwise from North, 0 to 2π) of a place.
pub fn polar(place: EastNorth) -> (f64, f64) {
    (place.0.hypot(place.1), wrap_tau(place.0.atan2(place.1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn closest_point_side_and_heading() {
        // Heading East with the station to starboard (south of the vessel): the vessel passes to the north.
        let c = VesselCourse::by_cpa(100.0, 5000.0, std::f64::consts::FRAC_PI_2, 7.0, true);
        let (x, y) = c.at(100.0).unwrap();
        assert!(x.abs() < 1e-9 && (y - 5000.0).abs() < 1e-9);
        let (x, y) = c.at(110.0).unwrap();
        assert!((x - 70.0).abs() < 1e-9 && (y - 5000.0).abs() < 1e-9);
    }

    #[test]
    fn fixes_join_and_straighten() {
        let truth = VesselCourse::by_cpa(500.0, 8000.0, 1.0, 6.0, false);
        let fixes = (0..20).map(|i| 100.0 * f64::from(i)).map(|t| (t, truth.at(t).unwrap())).collect();
        let c = VesselCourse::Fixes(fixes);
        let (a, b) = (c.at(650.0).unwrap(), truth.at(650.0).unwrap());
        assert!((a.0 - b.0).hypot(a.1 - b.1) < 1e-6);
        assert_eq!(c.at(-1.0), None);
        let Steady { at_s, place_m, .. } = c.straightened().unwrap();
        assert!((at_s - 500.0).abs() < 1e-6 && (polar(place_m).0 - 8000.0).abs() < 1e-6);
        assert!(c.bend_m().unwrap() < 1e-6);
    }

    #[test]
    fn a_bend_far_out_does_not_turn_the_straightened_course() {
        let truth = VesselCourse::by_cpa(9000.0, 8000.0, 1.0, 6.0, false);
        let mut fixes: Vec<_> =
            (0..180).map(|i| 100.0 * f64::from(i)).map(|t| (t, truth.at(t).unwrap())).collect();
        let last = fixes[179].1;
        fixes.push((30_000.0, (last.0, last.1 + 80_000.0)));
        let v = VesselCourse::Fixes(fixes.clone()).straightened().unwrap().velocity_m_s;
        assert!((v.0.atan2(v.1) - 1.0).abs() < 1e-3, "{v:?}");
        fixes[90].1.0 += 3000.0;
        assert!((VesselCourse::Fixes(fixes).bend_m().unwrap() - 3000.0).abs() < 200.0);
    }

    const PASS: Straight = Straight {
        cpa_time_s: 100.0,
        cpa_range_m: 500.0,
        heading_deg: 90.0,
        speed_m_s: 7.0,
        side: Side::Starboard,
    };

    #[test]
    fn a_straight_pass_has_its_closest_point_where_it_says() {
        let m = VesselCourse::straight(&PASS);
        assert_eq!(m.cpa(0.0, 1.0), Cpa { time_s: 100.0, range_m: 500.0 });
        let port = VesselCourse::straight(&Straight { side: Side::Port, ..PASS });
        assert!((port.position(100.0).1 + 500.0).abs() < 1e-9);
    }

    #[test]
    fn the_emission_solves_its_equation() {
        let m = VesselCourse::straight(&PASS);
        let h = [0.5, -0.3, 0.9];
        for t in [0.0, 77.7, 100.0, 200.0] {
            let (te, d) = m.emission(t, h, 164.0, 1484.0, t);
            let (x, y) = m.position(te);
            let want = ((x - h[0]).powi(2) + (y - h[1]).powi(2) + (164.0 - h[2]).powi(2)).sqrt();
            assert!((te + want / 1484.0 - t).abs() < 1e-12 && (d - want).abs() < 1e-8);
        }
    }

    #[test]
    fn tracks_through_points_of_a_line_are_that_line() {
        let s = VesselCourse::straight(&PASS);
        let fixes: Vec<Fix> = (0..=20).map(|i| f64::from(i) * 10.0).map(|t| (t, s.position(t))).collect();
        for m in [VesselCourse::smooth(&fixes).unwrap(), VesselCourse::Fixes(fixes)] {
            for t in [-5.0, 0.0, 33.3, 100.0, 199.9, 230.0] {
                let (a, b) = (m.position(t), s.position(t));
                assert!((a.0 - b.0).hypot(a.1 - b.1) < 1e-6, "{t}");
                let v = m.velocity(t);
                assert!((v.0 - 7.0).abs() < 1e-9 && v.1.abs() < 1e-9);
            }
            let cpa = m.cpa(0.0, 200.0);
            assert!((cpa.time_s - 100.0).abs() < 1e-3 && (cpa.range_m - 500.0).abs() < 1e-6);
        }
        assert!(VesselCourse::smooth(&[(0.0, (0.0, 0.0)); 2]).is_err());
    }

    #[test]
    fn the_nearest_point_of_a_leg_lies_on_it() {
        assert_eq!(nearest((-30.0, 40.0), (70.0, 40.0)), (0.3, 40.0));
        assert_eq!(nearest((30.0, 40.0), (70.0, 40.0)), (0.0, 50.0));
        assert_eq!(nearest((30.0, 40.0), (30.0, 40.0)), (0.0, 50.0));
    }
}
