//! Which vessel of AIS each track is, if any.
//!
//! In: reports of tracks ([`heard`]), a [`Fleet`], where stations are. Out: a [`Verdict`] a track.
//!
//! A track is compared with a vessel at up to nine of its reports. Their differences share most of their error, so that
//! the squared distances (in standard deviations of track and AIS together) are averaged, weighted by how sharp each report
//! is, and not added; to this come heading and speed, likewise. Beyond the 99.9 % point of χ² with four degrees of freedom the
//! vessel is out of the question. What reports share of their error stays what it is: the less the difference from a vessel
//! changes along and across the line of sight while that turns, the more it is the vessel's. What remains is weighed by its
//! likelihood against a vessel that does not report and might be anywhere about the station, or beside one that does: a vessel
//! for a track is accepted, and its absence believed, with a probability of 97.5 %, of a minute or more. One vessel has at most one of the tracks
//! that a station has at one time, for which the most probable choice of all tracks together is found.

mod drift;

use crate::ais::{Fleet, Placed};
use crate::report::{Covariance, TrackReport, VesselId, WithSd};
use drift::Drift;
use seabearing_core::angle::wrap_pi;
use seabearing_host::geodesy::LocalFrame;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// Reports of a track that are compared.
const COMPARED: usize = 9;
/// 99.9 % point of χ² with two and four degrees of freedom: beyond it a vessel is out of the question.
const GATE_2: f64 = 13.816;
const GATE_4: f64 = 18.467;
/// Beyond these no vessel is accepted: the 99 % point for two, and for four degrees of freedom that of 90 %, because a mean over
/// reports that do not share all of their error scatters less; two of a thousand tracks are further from their own vessel.
const ACCEPTED_2: f64 = 9.210;
const ACCEPTED_4: f64 = 7.779;
/// Tracks of one station that share less time may be one vessel's, s.
const SHARED_S: f64 = 30.0;
/// Places of a track that lie in less time tell nothing for certain, s: one moment fits whoever was there.
const LEAST_S: f64 = 60.0;
/// A vessel that leaves its reports out for so long is not thought of, s.
pub const HIDDEN_S: f64 = 7200.0;
/// Speed of a vessel that does not tell where it is, m/s.
const HIDDEN_M_S: f64 = 15.0;
/// A vessel whose own reports nowhere tell its place to so much, or as well as the track, is not accepted, m.
const TOLD_M: f64 = 50.0;
/// A track whose place is known no better tells no vessel from another, m.
const WIDEST_M: f64 = 5000.0;
/// Traffic is counted within so far of a track, m, and as such what goes so fast, m/s.
const TRAFFIC_M: f64 = 1000.0;
const UNDER_WAY_M_S: f64 = 1.0;
/// Greatest distance of a vessel that does not report, for comparison, m: not less than this.
const ABOUT_M: f64 = 2000.0;
/// Share of the vessels that do not report that go along with one that does, within so far, so different in heading and
/// speed: tugs, pilots, pairs of trawlers, neighbours in a fairway.
const COMPANIONS: f64 = 0.02;
const COMPANION_M: f64 = 500.0;
const COMPANION_RAD: f64 = 0.26;
const COMPANION_M_S: f64 = 1.5;
/// Usual speeds of vessels, m/s: mean and standard deviation [M, §V-A].
const USUAL_SPEED_M_S: (f64, f64) = (7.3, 2.3);
/// Choices that are looked at for tracks that are connected; then the best so far is taken.
const CHOICES: usize = 200_000;

/// What matching is told.
#[derive(Clone, Copy, Debug)]
pub struct Rules {
    /// Longest gap between reports of a vessel that is bridged, s.
    pub gap_s: f64,
    /// Share of vessels that do not report, before anything is known.
    pub dark_share: f64,
    /// Probability with which a vessel, or that there is none, is believed.
    pub sure: f64,
}

impl Default for Rules {
    fn default() -> Self {
        Self { gap_s: 900.0, dark_share: 0.1, sure: 0.975 }
    }
}

/// A track, of one station or of several, and a station that hears it.
#[derive(Clone, Debug)]
pub struct Heard {
    /// Which.
    pub vessel: VesselId,
    /// The stations that hear it; in the plane of the first its places are.
    pub stations: Vec<Option<u16>>,
    /// East and North of the station.
    pub frame: LocalFrame,
    /// Its reports with a time, in order.
    pub reports: Vec<TrackReport>,
}

/// What is said of a track.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// It is this vessel.
    Vessel {
        /// Its place in the fleet.
        vessel: usize,
        /// With this probability.
        probability: f64,
        /// Squared distance, as in the gate.
        distance2: f64,
    },
    /// No vessel of AIS is it.
    Dark {
        /// With this probability.
        probability: f64,
    },
    /// Nobody can say.
    Unmatched(String),
}

/// The tracks of some reports, without those that were withdrawn; and how many reports had no time or no known station.
pub fn heard(
    reports: impl IntoIterator<Item = TrackReport>,
    stations: &BTreeMap<Option<u16>, (f64, f64)>,
) -> (Vec<Heard>, usize) {
    let mut tracks: BTreeMap<VesselId, Heard> = BTreeMap::new();
    let (mut withdrawn, mut left_out) = (Vec::new(), 0);
    for report in reports {
        if report.is_withdrawn {
            withdrawn.push(report.vessel);
        }
        match stations.get(&report.station).filter(|_| report.utc_s.is_some()) {
            Some((lat, lon)) => {
                let new = || Heard {
                    vessel: report.vessel,
                    stations: vec![report.station],
                    frame: LocalFrame::new(*lat, *lon),
                    reports: Vec::new(),
                };
                tracks.entry(report.vessel).or_insert_with(new).reports.push(report);
            }
            None => left_out += 1,
        }
    }
    withdrawn.iter().for_each(|track| drop(tracks.remove(track)));
    let time = |r: &TrackReport| r.utc_s.map_or(f64::NAN, |(t_s, _)| t_s);
    for heard in tracks.values_mut() {
        heard.reports.sort_by(|a, b| time(a).total_cmp(&time(b)));
    }
    (tracks.into_values().collect(), left_out)
}

impl Heard {
    /// First and last report, seconds since 1970.
    pub fn span_s(&self) -> (f64, f64) {
        let at = |r: Option<&TrackReport>| r.and_then(|r| r.utc_s).map_or(f64::NAN, |(t_s, _)| t_s);
        (at(self.reports.first()), at(self.reports.last()))
    }

    /// The reports that are compared: with a place, spread over the track.
    fn compared(&self) -> Vec<&TrackReport> {
        let placed: Vec<_> =
            self.reports.iter().filter(|r| r.place.is_some_and(|(_, c)| c.determinant() > 0.0)).collect();
        let n = placed.len();
        let picked = (0..n.min(COMPARED)).map(|k| k * (n - 1) / (n.min(COMPARED) - 1).max(1));
        picked.filter_map(|k| placed.get(k).copied()).collect()
    }
}

/// How well a vessel fits a track.
#[derive(Clone, Copy, Debug)]
struct Fit {
    vessel: usize,
    /// Squared distance with that of heading and speed.
    distance2: f64,
    /// Within the gate for acceptance, and its reports tell where it was.
    accepted: bool,
    /// Likelihood times prior.
    weight: f64,
    /// Density of places beside this vessel, 1/m², and of motions like its own, of another that does not report.
    beside: f64,
    motion: f64,
}

/// The difference of a report and a vessel, with its covariance.
pub fn difference(report: &TrackReport, placed: &Placed, time_sd_s: f64) -> Option<((f64, f64), Covariance)> {
    let ((x, y), covariance) = report.place?;
    let (vx, vy) = placed.velocity_m_s;
    // The recorder's clock; that of the reports is in `placed`.
    let late = report.utc_s?.1.unwrap_or(time_sd_s).powi(2);
    let clock = Covariance { xx: vx * vx * late, yy: vy * vy * late, xy: vx * vy * late };
    let (px, py) = placed.place_m;
    Some(((x - px, y - py), covariance.plus(placed.covariance).plus(clock)))
}

/// Differences of heading (rad) and speed (m/s) from a vessel's, each with its standard deviation.
pub fn motion_difference(report: &TrackReport, placed: &Placed) -> (Option<WithSd>, Option<WithSd>) {
    let (vx, vy) = placed.velocity_m_s;
    let (speed, (along, across)) = (vx.hypot(vy), placed.sd_velocity_m_s);
    let turns = report.heading_rad.filter(|_| speed > 2.0 * across);
    let heading = turns.map(|(h, sd_h)| (wrap_pi(h - vx.atan2(vy)), sd_h.hypot(across / speed)));
    (heading, report.speed_m_s.map(|(v, sd_v)| (v - speed, sd_v.hypot(along))))
}

/// Differences of a track from a vessel at several reports, which share most of their error: averaged, weighted by their
/// sharpness.
#[derive(Clone, Copy, Debug, Default)]
struct Shared {
    weights: f64,
    squares: f64,
    logs: f64,
    /// The same about a companion, whose motion differs by more.
    wide: [f64; 3],
}

impl Shared {
    fn add(&mut self, difference: Option<WithSd>, beside: f64) {
        let Some((x, sd)) = difference else { return };
        let wide = sd.hypot(beside);
        self.weights += 1.0 / sd;
        self.squares += (x / sd).powi(2) / sd;
        self.logs += (TAU.sqrt() * sd).ln() / sd;
        let [weights, squares, logs] = self.wide;
        self.wide = [
            weights + 1.0 / wide,
            squares + (x / wide).powi(2) / wide,
            logs + (TAU.sqrt() * wide).ln() / wide,
        ];
    }

    /// Squared distance in standard deviations.
    fn distance2(&self) -> f64 {
        if self.weights > 0.0 { self.squares / self.weights } else { 0.0 }
    }

    fn density(&self) -> f64 {
        if self.weights > 0.0 { ((-0.5 * self.squares - self.logs) / self.weights).exp() } else { 1.0 }
    }

    fn density_beside(&self) -> f64 {
        let [weights, squares, logs] = self.wide;
        if weights > 0.0 { ((-0.5 * squares - logs) / weights).exp() } else { 1.0 }
    }
}

fn fit(heard: &Heard, compared: &[&TrackReport], vessel: usize, fleet: &Fleet, rules: &Rules) -> Option<Fit> {
    let of = fleet.vessels.get(vessel)?;
    let (mut sum, mut weights, mut sharpest, mut last, mut least) =
        (0.0, 0.0, f64::INFINITY, None, f64::INFINITY);
    let (mut heading, mut speed, mut drift) = (Shared::default(), Shared::default(), Drift::default());
    let (mut found, mut logs, mut told) = (0, 0.0, false);
    for report in compared {
        let Some(placed) = of.at(report.utc_s?.0, &heard.frame, rules.gap_s, fleet.time_sd_s) else {
            continue;
        };
        let (apart, covariance) = difference(report, &placed, fleet.time_sd_s)?;
        let spread = covariance.determinant().sqrt();
        let d2 = covariance.distance2(apart)?;
        found += 1;
        drift.add(apart, covariance, placed.place_m);
        let own = report.place.map_or(0.0, |(_, c)| c.determinant().sqrt().sqrt());
        told |= placed.wander_m <= own.max(TOLD_M);
        sum += d2 / spread;
        logs += (TAU * spread).ln() / spread;
        weights += 1.0 / spread;
        sharpest = f64::min(sharpest, spread);
        least = f64::min(least, d2);
        let (turned, faster) = motion_difference(report, &placed);
        heading.add(turned, COMPANION_RAD);
        speed.add(faster, COMPANION_M_S);
        last = Some(());
    }
    // Of a vessel that reports during less than half of the track nothing can be said.
    last.filter(|()| 2 * found >= compared.len() && least < 4.0 * GATE_2)?;
    let place2 = sum / weights;
    let distance2 = place2 + heading.distance2() + speed.distance2();
    if !(place2 <= GATE_2 && distance2 <= GATE_4) {
        return None;
    }
    let motion = heading.density() * speed.density();
    let weight =
        (1.0 - rules.dark_share) * (-0.5 * place2 - logs / weights).exp() * motion * drift.likelihood();
    let motion = heading.density_beside() * speed.density_beside();
    let beside = 1.0 / (0.5 * TAU * (COMPANION_M * COMPANION_M + sharpest));
    let accepted = told && place2 <= ACCEPTED_2 && distance2 <= ACCEPTED_4;
    Some(Fit { vessel, distance2, accepted, weight, beside, motion })
}

/// Likelihood times prior of a vessel that does not report. Such vessels are anywhere about the station, where there is
/// traffic (`near` vessels go within `about_m` of the track, by AIS), half of them the same way, and beside a vessel.
fn dark_weight(
    heard: &Heard,
    compared: &[&TrackReport],
    best: Option<&Fit>,
    (near, about_m): (usize, f64),
    rules: &Rules,
) -> f64 {
    let range = |r: &&TrackReport| r.place.map_or(0.0, |((x, y), _)| x.hypot(y));
    let area = |radius_m: f64| 0.5 * TAU * radius_m * radius_m;
    let reach_m = compared.iter().map(range).fold(0.0, f64::max).max(ABOUT_M / 3.0) * 3.0;
    let Some(last) = heard.reports.last() else { return 0.0 };
    let heading = if last.heading_rad.is_some() { 1.0 / TAU } else { 1.0 };
    let speed = last.speed_m_s.map_or(1.0, |(v, sd_v)| {
        let (mean, sd) = (USUAL_SPEED_M_S.0, USUAL_SPEED_M_S.1.hypot(sd_v));
        // Slow and fast ones there are, too.
        (-0.5 * ((v - mean) / sd).powi(2)).exp().max(0.1) / (TAU.sqrt() * sd)
    });
    let any = heading * speed;
    let (beside, alike) = best.map_or((0.0, any), |f| (f.beside, f.motion));
    // The vessel in question is no traffic about itself.
    let others = near.saturating_sub(usize::from(best.is_some())) as f64 / area(about_m);
    let elsewhere = any / area(reach_m) + others * 0.5 * (any + alike);
    rules.dark_share * ((1.0 - COMPANIONS) * elsewhere + COMPANIONS * beside * alike)
}

/// A track with what it may be.
struct Open {
    span_s: (f64, f64),
    fits: Vec<Fit>,
    dark: f64,
    /// Why nothing can be said, where that is known beforehand.
    reason: Option<String>,
    /// Vessels that may have been there without a report.
    hidden: Option<String>,
}

/// Says of each track what it is, in their order.
pub fn judge(tracks: &[Heard], fleet: &Fleet, rules: &Rules) -> Vec<Verdict> {
    let open: Vec<Open> = tracks.iter().map(|heard| open(heard, fleet, rules)).collect();
    let rivals: Vec<Vec<usize>> = (0..tracks.len()).map(|a| rivals(a, tracks, &open)).collect();
    let chosen = choose(&open, &rivals);
    (0..open.len()).map(|k| verdict(k, &open, &rivals, &chosen, fleet, rules)).collect()
}

fn open(heard: &Heard, fleet: &Fleet, rules: &Rules) -> Open {
    let compared = heard.compared();
    let mut open = Open { span_s: heard.span_s(), fits: Vec::new(), dark: 0.0, reason: None, hidden: None };
    let middle = compared.get(compared.len() / 2).and_then(|r| Some((r.utc_s?.0, r.place?)));
    let Some((t_s, ((x, y), covariance))) = middle else {
        open.reason = Some("its range is not observable".to_owned());
        return open;
    };
    let spread = |r: &&TrackReport| r.place.map_or(f64::INFINITY, |(_, c)| c.determinant().sqrt().sqrt());
    let sharpest = compared.iter().map(spread).fold(f64::INFINITY, f64::min);
    if sharpest > WIDEST_M {
        open.reason = Some(format!("too uncertain: its place is known to {:.0} m", sharpest));
        return open;
    }
    if !fleet.covers(t_s, rules.gap_s) {
        open.reason = Some("no vessel reported at that time".to_owned());
        return open;
    }
    let at = |r: Option<&&TrackReport>| r.and_then(|r| r.utc_s).map_or(f64::NAN, |(t_s, _)| t_s);
    let told_s = at(compared.last()) - at(compared.first());
    if told_s < LEAST_S {
        open.reason = Some(format!("too short: its places are those of {told_s:.0} s"));
        return open;
    }
    open.fits = (0..fleet.vessels.len()).filter_map(|v| fit(heard, &compared, v, fleet, rules)).collect();
    open.fits.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    let about_m = TRAFFIC_M.max(3.0 * (covariance.xx + covariance.yy).sqrt());
    let goes_near = |v: &&crate::ais::Vessel| {
        let placed = v.at(t_s, &heard.frame, rules.gap_s, fleet.time_sd_s);
        placed.is_some_and(|p| {
            let ((px, py), (vx, vy)) = (p.place_m, p.velocity_m_s);
            (px - x).hypot(py - y) <= about_m && vx.hypot(vy) >= UNDER_WAY_M_S
        })
    };
    let traffic = (fleet.vessels.iter().filter(goes_near).count(), about_m);
    open.dark = dark_weight(heard, &compared, open.fits.first(), traffic, rules);
    let reach_m = 3.0 * (covariance.xx + covariance.yy).sqrt();
    let (lat, lon) = heard.frame.lat_lon_deg(x, y);
    let there = LocalFrame::new(lat, lon);
    let hides =
        fleet.vessels.iter().find(|v| v.may_hide(t_s, &there, reach_m, rules.gap_s, HIDDEN_S, HIDDEN_M_S));
    open.hidden = hides.map(|v| format!("{} may have been there, without a report", v.mmsi));
    open
}

/// The tracks of the same station at the same time that may be the same vessels.
fn rivals(a: usize, tracks: &[Heard], open: &[Open]) -> Vec<usize> {
    let Some((track, mine)) = tracks.get(a).zip(open.get(a)) else { return Vec::new() };
    let (from, to) = mine.span_s;
    let of = |(b, (other, its)): (usize, (&Heard, &Open))| {
        let shared = to.min(its.span_s.1) - from.max(its.span_s.0);
        let same = mine.fits.iter().any(|f| its.fits.iter().any(|g| g.vessel == f.vessel));
        let heard_by_one = other.stations.iter().any(|of| track.stations.contains(of));
        (b != a && heard_by_one && shared > SHARED_S && same).then_some(b)
    };
    tracks.iter().zip(open).enumerate().filter_map(of).collect()
}

/// The vessels of all tracks together, or none of them, by the greatest product of weights.
fn choose(open: &[Open], rivals: &[Vec<usize>]) -> Vec<Option<usize>> {
    let mut chosen: Vec<Option<usize>> = vec![None; open.len()];
    let mut done = vec![false; open.len()];
    for start in 0..open.len() {
        // The tracks connected with this one.
        let (mut group, mut next) = (Vec::new(), vec![start]);
        while let Some(k) = next.pop() {
            if !std::mem::replace(&mut done[k], true) {
                group.push(k);
                next.extend(&rivals[k]);
            }
        }
        // The clearest first: what they take is taken from the others.
        let clear = |k: &usize| open[*k].fits.first().map_or(0.0, |f| f.weight / open[*k].dark);
        group.sort_by(|a, b| clear(b).total_cmp(&clear(a)));
        let best = |k: usize| open[k].fits.first().map_or(open[k].dark, |f| f.weight.max(open[k].dark)).ln();
        let mut bounds = vec![0.0; group.len() + 1];
        for (place, k) in group.iter().enumerate().rev() {
            bounds[place] = bounds[place + 1] + best(*k);
        }
        let mut search =
            Search { open, rivals, group: &group, bounds: &bounds, left: CHOICES, best: f64::NEG_INFINITY };
        let (mut now, mut taken) = (vec![None; open.len()], Vec::new());
        search.go(0, 0.0, &mut now, &mut taken);
        for (k, vessel) in group.iter().zip(taken) {
            chosen[*k] = vessel;
        }
    }
    chosen
}

/// Depth first, with what the rest can reach at best as the bound.
struct Search<'a> {
    open: &'a [Open],
    rivals: &'a [Vec<usize>],
    group: &'a [usize],
    bounds: &'a [f64],
    left: usize,
    best: f64,
}

impl Search<'_> {
    fn go(&mut self, place: usize, sum: f64, now: &mut Vec<Option<usize>>, taken: &mut Vec<Option<usize>>) {
        if sum + self.bounds[place] <= self.best || self.left == 0 {
            return;
        }
        self.left -= 1;
        let Some(&k) = self.group.get(place) else {
            self.best = sum;
            *taken = self.group.iter().map(|k| now[*k]).collect();
            return;
        };
        let mut choices: Vec<(f64, Option<usize>)> =
            self.open[k].fits.iter().map(|f| (f.weight.ln(), Some(f.vessel))).collect();
        choices.push((self.open[k].dark.max(f64::MIN_POSITIVE).ln(), None));
        choices.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (gain, vessel) in choices {
            if vessel.is_some() && self.rivals[k].iter().any(|r| now[*r] == vessel) {
                continue;
            }
            now[k] = vessel;
            self.go(place + 1, sum + gain, now, taken);
            now[k] = None;
        }
    }
}

fn verdict(
    k: usize,
    open: &[Open],
    rivals: &[Vec<usize>],
    chosen: &[Option<usize>],
    fleet: &Fleet,
    rules: &Rules,
) -> Verdict {
    let of = &open[k];
    if let Some(reason) = &of.reason {
        return Verdict::Unmatched(reason.clone());
    }
    // What another track has for certain this one has not.
    let gone = |vessel: usize| {
        rivals[k].iter().any(|r| {
            let its = &open[*r];
            let all = its.dark + its.fits.iter().map(|f| f.weight).sum::<f64>();
            let own = its.fits.iter().find(|f| f.vessel == vessel).map_or(0.0, |f| f.weight);
            chosen[*r] == Some(vessel) && own >= rules.sure * all
        })
    };
    let left: Vec<&Fit> = of.fits.iter().filter(|f| !gone(f.vessel)).collect();
    let all = of.dark + left.iter().map(|f| f.weight).sum::<f64>();
    let name = |f: &Fit| fleet.vessels.get(f.vessel).map_or(0, |v| v.mmsi);
    match left.iter().find(|f| Some(f.vessel) == chosen[k]) {
        Some(f) if f.accepted && f.weight >= rules.sure * all => {
            Verdict::Vessel { vessel: f.vessel, probability: f.weight / all, distance2: f.distance2 }
        }
        _ if of.dark >= rules.sure * all => match &of.hidden {
            Some(hidden) => Verdict::Unmatched(hidden.clone()),
            None => Verdict::Dark { probability: of.dark / all },
        },
        _ => Verdict::Unmatched(match left.as_slice() {
            [a, b, ..] if b.weight > 0.2 * a.weight => {
                format!("ambiguous: {} or {}", name(a).min(name(b)), name(a).max(name(b)))
            }
            [a, ..] => format!("uncertain: {} or a vessel that does not report", name(a)),
            [] => "its vessel has another track".to_owned(),
        }),
    }
}

#[cfg(test)]
mod tests;
