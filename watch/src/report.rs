//! A track's report, as a record tells it, dated and placed.

use serde_json::Value;
use std::time::{SystemTime, UNIX_EPOCH};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

/// Which track: its station, its session and its number; `None` where the record does not tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TrackId {
    /// Number of the station.
    pub station: Option<u16>,
    /// Session of that station.
    pub session: Option<u32>,
    /// Number of the track in that session.
    pub id: u16,
}

impl TrackId {
    /// That of a record, or of a member of a network track.
    pub fn of(record: &Value) -> Option<Self> {
        Some(Self {
            station: record["station"].as_u64().and_then(|n| n.try_into().ok()),
            session: record["session"].as_u64().and_then(|n| n.try_into().ok()),
            id: record["id"].as_u64()?.try_into().ok()?,
        })
    }
}

impl std::fmt::Display for TrackId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let number = |n: Option<u32>| n.map_or_else(|| "?".to_owned(), |n| n.to_string());
        write!(f, "{}.{}.{}", number(self.station.map(u32::from)), number(self.session), self.id)
    }
}

/// Which vessel, as far as it is told from others: a track of one station, or the tracks of several stations that are one vessel's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum VesselId {
    /// A station's track.
    Track(TrackId),
    /// The network track with this number.
    Network(u32),
}

impl std::fmt::Display for VesselId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Track(track) => track.fmt(f),
            Self::Network(id) => write!(f, "N{id}"),
        }
    }
}

/// Variances of East and North and their covariance, square metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariance {
    /// Variance of East.
    pub xx: f64,
    /// Variance of North.
    pub yy: f64,
    /// Covariance.
    pub xy: f64,
}

impl Covariance {
    /// Variances `along` a direction (unit vector East, North) and `across` it.
    pub fn along_across(direction: (f64, f64), along: f64, across: f64) -> Self {
        let (e, n) = direction;
        Self {
            xx: along * e * e + across * n * n,
            yy: along * n * n + across * e * e,
            xy: (along - across) * e * n,
        }
    }

    /// The sum: that of a difference of independent places.
    pub fn plus(self, other: Self) -> Self {
        Self { xx: self.xx + other.xx, yy: self.yy + other.yy, xy: self.xy + other.xy }
    }

    /// The same along axes of which the North is turned clockwise by an angle, radians, from the North of these.
    pub fn turned(self, by: f64) -> Self {
        let (s, c) = by.sin_cos();
        Self {
            xx: c * c * self.xx - 2.0 * s * c * self.xy + s * s * self.yy,
            yy: s * s * self.xx + 2.0 * s * c * self.xy + c * c * self.yy,
            xy: s * c * (self.xx - self.yy) + (c * c - s * s) * self.xy,
        }
    }

    /// Determinant; not above 0 where it is no covariance.
    pub fn determinant(&self) -> f64 {
        self.xx * self.yy - self.xy * self.xy
    }

    /// Squared distance of a difference in its standard deviations; `None` where it is no covariance.
    pub fn distance2(&self, (x, y): (f64, f64)) -> Option<f64> {
        let det = self.determinant();
        let d2 = (self.yy * x * x - 2.0 * self.xy * x * y + self.xx * y * y) / det;
        (det > 0.0 && self.xx > 0.0 && d2.is_finite()).then_some(d2)
    }
}

/// A value and its standard deviation.
pub type WithSd = (f64, f64);

/// What one record says of a vessel's motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrackReport {
    /// The vessel.
    pub vessel: VesselId,
    /// The station whose East and North `place` is in, and that the closest point is of.
    pub station: Option<u16>,
    /// It is the last word on it.
    pub is_final: bool,
    /// What was said of it is no vessel's course.
    pub is_withdrawn: bool,
    /// UTC, seconds since 1970, and standard deviation where told.
    pub utc_s: Option<(f64, Option<f64>)>,
    /// East and North of that station, metres, with covariance; `None` where the range is not observable.
    pub place: Option<((f64, f64), Covariance)>,
    /// Heading, radians clockwise from true North.
    pub heading_rad: Option<WithSd>,
    /// Speed, m/s.
    pub speed_m_s: Option<WithSd>,
    /// UTC of the closest point, seconds since 1970.
    pub cpa_utc_s: Option<WithSd>,
    /// Range there, metres; `None` where not observable.
    pub cpa_range_m: Option<WithSd>,
}

impl TrackReport {
    /// From a record; `None` if it is none of a station's track.
    pub fn of(record: &Value) -> Option<Self> {
        if record["type"] != "track" {
            return None;
        }
        let number = |key: &str| record[key].as_f64().filter(|x| x.is_finite());
        let with_sd = |key: &str| Some((number(key)?, number(&format!("sd_{key}"))?));
        let observable = record["range_observable"] == true;
        let utc_s = utc(&record["utc"]).map(|t_s| (t_s, number("sd_utc_s")));
        let place = || {
            let covariance =
                Covariance { xx: number("var_x_m2")?, yy: number("var_y_m2")?, xy: number("cov_xy_m2")? };
            Some(((number("x_m")?, number("y_m")?), covariance))
        };
        let ahead = |t_s: f64| Some(number("cpa_time_s")? - number("t_s")? + t_s);
        let degrees = |(value, sd): WithSd| (value.to_radians(), sd.to_radians());
        let track = TrackId::of(record)?;
        Some(Self {
            vessel: VesselId::Track(track),
            station: track.station,
            is_final: record["stage"] == "final",
            is_withdrawn: record["stage"] == "withdrawn",
            utc_s,
            place: if observable { place() } else { None },
            heading_rad: with_sd("heading_deg").map(degrees),
            speed_m_s: with_sd("speed_m_s"),
            cpa_utc_s: utc_s.and_then(|(t_s, _)| ahead(t_s)).zip(number("sd_cpa_time_s")),
            cpa_range_m: with_sd("cpa_range_m").filter(|_| observable),
        })
    }

    /// East and North speed, m/s.
    pub fn velocity_m_s(&self) -> Option<(f64, f64)> {
        let ((heading, _), (speed, _)) = (self.heading_rad?, self.speed_m_s?);
        Some((speed * heading.sin(), speed * heading.cos()))
    }
}

/// A time of a record, seconds since 1970.
pub fn utc(text: &Value) -> Option<f64> {
    let at = OffsetDateTime::parse(text.as_str()?, &Rfc3339).ok()?;
    Some(at.unix_timestamp_nanos() as f64 * 1e-9)
}

/// Records that a base station makes itself.
const OF_BASE: [&str; 12] = [
    "acknowledge",
    "ais_fleet",
    "ais_match",
    "alarm",
    "base",
    "line",
    "lost",
    "network_track",
    "not_shown",
    "note",
    "store",
    "warning",
];

/// Whether a recorder is heard by a record of this `type`: not by what the base station finds itself.
pub fn is_of_recorder(kind: &str) -> bool {
    !OF_BASE.contains(&kind)
}

/// Seconds since 1970 by this computer's clock.
pub fn unix_now_s() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64())
}

/// Seconds since 1970 as a record tells a time.
pub fn rfc3339(utc_s: f64) -> Value {
    seabearing_base::record::rfc3339((utc_s * 1e6) as i64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_record_is_read_with_its_units_and_what_is_not_observable_is_none() {
        let mut record = json!({
            "type": "track", "station": 7, "session": 2, "id": 5, "stage": "final", "t_s": 100.0, "utc": "1970-01-01T00:01:40Z",
            "sd_utc_s": 0.25, "x_m": 3.0, "y_m": 4.0, "var_x_m2": 4.0, "var_y_m2": 9.0, "cov_xy_m2": 0.0,
            "range_observable": true, "heading_deg": 180.0, "sd_heading_deg": 1.0, "speed_m_s": 5.0, "sd_speed_m_s": 0.5,
            "cpa_time_s": 90.0, "sd_cpa_time_s": 1.0, "cpa_range_m": 5.0, "sd_cpa_range_m": 1.0,
        });
        let report = TrackReport::of(&record).unwrap();
        assert_eq!(report.vessel.to_string(), "7.2.5");
        assert_eq!(report.utc_s, Some((100.0, Some(0.25))));
        assert_eq!(report.cpa_utc_s, Some((90.0, 1.0)));
        let (place, covariance) = report.place.unwrap();
        assert_eq!(place, (3.0, 4.0));
        assert_eq!(covariance.distance2((2.0, 3.0)), Some(2.0));
        let (vx, vy) = report.velocity_m_s().unwrap();
        assert!(vx.abs() < 1e-9 && (vy + 5.0).abs() < 1e-9);
        record["range_observable"] = false.into();
        let report = TrackReport::of(&record).unwrap();
        assert_eq!((report.place, report.cpa_range_m), (None, None));
        assert_eq!(TrackReport::of(&json!({ "type": "bearing" })), None);
    }

    #[test]
    fn a_covariance_along_a_direction_turns_with_it() {
        let north = Covariance::along_across((0.0, 1.0), 9.0, 1.0);
        assert_eq!(north, Covariance { xx: 1.0, yy: 9.0, xy: 0.0 });
        let (s, c) = 0.7f64.sin_cos();
        let turned = Covariance::along_across((s, c), 9.0, 1.0);
        assert!((turned.determinant() - 9.0).abs() < 1e-9);
        assert!((turned.distance2((3.0 * s, 3.0 * c)).unwrap() - 1.0).abs() < 1e-9);
        // Along axes that are turned likewise it is the first again.
        let back = turned.turned(0.7);
        assert!(
            (back.xx - 1.0).abs() < 1e-9 && (back.yy - 9.0).abs() < 1e-9 && back.xy.abs() < 1e-9,
            "{back:?}"
        );
    }
}
