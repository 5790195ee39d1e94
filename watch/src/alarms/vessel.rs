//! Rules about vessels: what is so of one.

use super::Watcher;
use super::area::{is_inside, share};
use super::rules::Condition;
use super::truth::Truth;
use crate::report::{Covariance, TrackReport, VesselId, rfc3339};

impl Watcher {
    /// What the reports of a vessel, as seen from some stations, say of a rule about vessels: the likeliest of what is so of one of
    /// them, and that one. None where the rule is not about these stations.
    pub(super) fn vessel(&self, n: usize, seen: &[TrackReport], now_s: f64) -> Option<(Truth, TrackReport)> {
        let of = &self.rules[n].stations;
        let meant =
            |r: &&TrackReport| r.station.is_some_and(|station| of.is_empty() || of.contains(&station));
        let truths = seen.iter().filter(meant).map(|report| (self.vessel_from(n, report, now_s), *report));
        // True before unknown before over.
        truths.max_by(|(a, _), (b, _)| {
            let rank = |t: &Truth| match t.is {
                Some(true) => 2,
                None => 1,
                Some(false) => 0,
            };
            rank(a).cmp(&rank(b)).then(a.probability.unwrap_or(0.0).total_cmp(&b.probability.unwrap_or(0.0)))
        })
    }

    /// The same as seen from one station.
    fn vessel_from(&self, n: usize, report: &TrackReport, now_s: f64) -> Truth {
        if report.is_withdrawn || report.is_final {
            return Truth::over(super::ENDED);
        }
        let rule = &self.rules[n];
        let (probability, what, code) = match &rule.condition {
            Condition::Inside(_) => {
                let corners = report.station.and_then(|station| self.corners.get(&(n, station)));
                let Some(((place, covariance), corners)) = report.place.zip(corners) else {
                    return Truth::unknown();
                };
                let p = share(place, &covariance, |at| is_inside(corners, at));
                (p, format!("is inside {}", rule.name), "VesselInside")
            }
            Condition::Range(range_m) => {
                let Some((place, covariance)) = report.place else { return Truth::unknown() };
                let p = share(place, &covariance, |(x, y)| x.hypot(y) <= *range_m);
                (p, format!("is within {range_m:.0} m"), "VesselNear")
            }
            Condition::Approach { distance_m, within_s } => {
                let (Some((cpa_s, _)), Some((range_m, sd_m))) = (report.cpa_utc_s, report.cpa_range_m) else {
                    return Truth::unknown();
                };
                let ahead = cpa_s - report.utc_s.map_or(now_s, |(t_s, _)| t_s);
                if !(0.0..=*within_s).contains(&ahead) {
                    return Truth::over("its closest point has passed, or is further off");
                }
                let spread = Covariance { xx: sd_m * sd_m, yy: 0.0, xy: 0.0 };
                let p = share((range_m, 0.0), &spread, |(r, _)| r <= *distance_m);
                let at = rfc3339(cpa_s.round());
                let what = format!("will pass at {range_m:.0} m at {}", at.as_str().unwrap_or("?"));
                (p, what, "VesselApproaches")
            }
            _ => return Truth::unknown(),
        };
        if probability >= rule.probability {
            let of = match (report.vessel, report.station) {
                (VesselId::Network(_), Some(station)) => format!(" (station {station})"),
                _ => String::new(),
            };
            let text = format!("vessel {}{of}: it {what}, with probability {probability:.2}", report.vessel);
            Truth { is: Some(true), code, text, probability: Some(probability) }
        } else if probability < rule.clear_probability {
            Truth::over("it is outside")
        } else {
            Truth::unknown()
        }
    }
}
