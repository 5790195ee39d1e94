//! Which tracks of several stations are one vessel.
//!
//! In: the stations' tracks with their averages. A *group* is tracks of two or more stations that overlap in time and have
//! one straight motion ([`joint::fit`], no speed assumed). It is tested by its excess: the misfit of the common motion less
//! the misfits that the stations' own courses leave. Each lone course has three parameters, a motion four, so that the
//! excess of k tracks of one vessel is chi-squared of 3k − 4, whatever errors the bearings claim too large. Among all sets of
//! groups of which no two share a track, that which explains most tracks is taken, and of those the one with the least
//! excess; a group without which as many tracks are explained nearly as well is *doubtful*.

use super::heard::{Average, TrackNumber};
use super::sites::Sites;
use seabearing_core::angle::{RAD_PER_DEG, wrap_pi};
use seabearing_host::station::CLOCK_SD_S;
use seabearing_locate::network::joint::{
    self, DatedSighting, JointSettings, JointTrack, Scatter, SharedError,
};
use seabearing_locate::network::locate::misfit_limit;
use seabearing_locate::network::{MAX_ARRAYS, NetworkError, Sighting};
use std::collections::{HashMap, HashSet};

/// Height of a vessel's sound source, metres.
const SOURCE_Z_M: f64 = -5.0;
/// Tracks this far apart in time may still be one vessel, s.
const APART_S: f64 = 60.0;
/// Overlap of one station's tracks that are one vessel's, s.
const AGAIN_S: f64 = 2.0;
/// Fastest vessel, m/s.
const FASTEST_M_S: f64 = 30.0;
/// A set of groups must be better than another by so much (odds of 20 to 1).
const CLEAR: f64 = 6.0;
/// Excess a degree of freedom beyond which a covariance grows: one motion of seven of two tracks is beyond by chance.
const BY_CHANCE: f64 = 2.0;
/// Freedom of the averages about their courses from which their scatter is known, and the least share of what they state
/// that is believed.
const LEAST_FREEDOM: f64 = 12.0;
const LEAST_SCALE: f64 = 0.01;
/// A pair whose excess is so many times its bar is no vessel for good.
const HOPELESS: f64 = 10.0;
/// Directions that differ by no more are the same, radians.
const ALIKE_RAD: f64 = 2.0 * RAD_PER_DEG;
/// Tracks in a group, groups that are weighed, and sets of them that are looked at.
const LARGEST: usize = 8;
const WEIGHED: usize = 48;
const LOOKED_AT: u32 = 20_000;

/// A track: the place of its station among the sites, its session and number.
pub type Key = (usize, TrackNumber);

/// A track to be grouped.
#[derive(Clone, Debug)]
pub struct Node {
    /// Which.
    pub key: Key,
    /// Its state of knowledge; equal ones need no second fit.
    pub version: u32,
    /// Its bearings.
    pub averages: Vec<Average>,
    /// Misfit of its own course.
    pub own: f64,
    /// Time of its first and last bearing.
    pub span: (f64, f64),
    /// Standard deviation of its clock, s.
    pub sd_clock_s: f64,
}

impl Node {
    /// Whether two may be one vessel as far as time tells.
    fn goes_with(&self, other: &Self) -> bool {
        let overlap = self.span.1.min(other.span.1) - self.span.0.max(other.span.0);
        overlap > -APART_S && (self.key.0 != other.key.0 || overlap < AGAIN_S)
    }
}

/// Tracks of one vessel.
#[derive(Clone, Debug)]
pub struct Group {
    /// Places of its tracks among the nodes, in order.
    pub nodes: Vec<usize>,
    /// Its motion; none where the bearings do not determine one.
    pub motion: Option<JointTrack>,
    excess: f64,
    /// Its tracks contradict each other.
    pub consistent: bool,
}

type Known = HashMap<Vec<(Key, u32)>, Result<JointTrack, NetworkError>>;

/// Fits made before, by tracks and their versions; and pairs of tracks that no further bearing makes one vessel's.
#[derive(Debug, Default)]
pub struct Fits {
    known: Known,
    hopeless: HashSet<[Key; 2]>,
}

/// The groups that are believed in. `before`: groups as they were, which stay where others are no better.
pub fn groups(sites: &Sites, nodes: &[Node], before: &[Vec<Key>], fits: &mut Fits) -> Vec<Group> {
    let mut search = Search { sites, nodes, used: Known::new(), fits };
    let (possible, contradicted) = search.all();
    let held = |g: &Group| {
        let keys: Vec<Key> = g.nodes.iter().map(|n| nodes[*n].key).collect();
        before.iter().any(|b| b.iter().filter(|k| keys.contains(k)).count() >= 2)
    };
    let mut seen: Vec<Group> = possible.iter().filter(|g| g.motion.is_some()).cloned().collect();
    for g in seen.iter_mut().filter(|g| held(g)) {
        g.excess -= CLEAR;
    }
    seen.sort_by(|a, b| b.nodes.len().cmp(&a.nodes.len()).then(a.excess.total_cmp(&b.excess)));
    seen.truncate(WEIGHED);
    let best = Packing::best(&seen, None);
    let mut out: Vec<Group> = Vec::new();
    for n in &best.groups {
        let other = Packing::best(&seen, Some(*n));
        if other.explained < best.explained || other.excess > best.excess + CLEAR {
            let mut group = seen[*n].clone();
            group.excess += if held(&group) { CLEAR } else { 0.0 };
            // A further station agrees with each of them, and not with both.
            group.consistent &= !contradicted.iter().any(|c| group.nodes.iter().all(|n| c.nodes.contains(n)));
            out.push(group);
        }
    }
    let taken = |out: &[Group], g: &Group| out.iter().any(|o| g.nodes.iter().any(|n| o.nodes.contains(n)));
    // What contradicts itself, and what no geometry tells, where nothing else is said of its tracks.
    for g in contradicted.into_iter().chain(possible.into_iter().filter(|g| g.motion.is_none())) {
        let alone = |n: &usize| {
            let rival =
                |m: &Node| m.key.0 == nodes[*n].key.0 && m.key != nodes[*n].key && m.goes_in_time(&nodes[*n]);
            !nodes.iter().any(rival)
        };
        if !taken(&out, &g) && g.nodes.iter().all(alone) {
            out.push(g);
        }
    }
    for g in &mut out {
        if let Some(motion) = search.refined(g) {
            g.motion = Some(motion);
        }
    }
    fits.known = std::mem::take(&mut search.used);
    out
}

impl Node {
    fn goes_in_time(&self, other: &Self) -> bool {
        self.span.1.min(other.span.1) > self.span.0.max(other.span.0)
    }
}

struct Search<'a> {
    sites: &'a Sites,
    nodes: &'a [Node],
    fits: &'a mut Fits,
    used: Known,
}

impl Search<'_> {
    /// Every group, those of which the geometry tells no motion among them; and those of which every pair agrees, and not
    /// all together.
    fn all(&mut self) -> (Vec<Group>, Vec<Group>) {
        let n = self.nodes.len();
        let (mut possible, mut contradicted) = (Vec::new(), Vec::new());
        let mut level: Vec<Vec<usize>> = Vec::new();
        let mut agree = vec![vec![false; n]; n];
        for a in 0..n {
            for b in a + 1..n {
                let (one, other) = (&self.nodes[a], &self.nodes[b]);
                let keys = [one.key, other.key];
                if !one.goes_with(other) || self.fits.hopeless.contains(&keys) {
                    continue;
                }
                let pair = vec![a, b];
                let together = one.key.0 == other.key.0 || {
                    let group = self.group(&pair);
                    let agrees = group.as_ref().is_some_and(|g| g.consistent);
                    if group.as_ref().is_some_and(|g| g.excess > HOPELESS * misfit_limit(2)) {
                        self.fits.hopeless.insert(keys);
                    }
                    possible.extend(group.filter(|_| agrees));
                    agrees
                };
                agree[a][b] = together;
                if together {
                    level.push(pair);
                }
            }
        }
        for _ in 2..LARGEST {
            let mut next = Vec::new();
            for set in &level {
                let last = set.last().copied().unwrap_or(0);
                for m in last + 1..n {
                    if !set.iter().all(|k| agree[*k][m]) {
                        continue;
                    }
                    let wider: Vec<usize> = set.iter().copied().chain([m]).collect();
                    match self.group(&wider) {
                        Some(g) if g.consistent => {
                            possible.push(g);
                            next.push(wider);
                        }
                        Some(g) => contradicted.extend(Some(g).filter(|g| g.motion.is_some())),
                        // One station's alone.
                        None => next.push(wider),
                    }
                }
            }
            level = next;
            if level.is_empty() || possible.len() > 4 * WEIGHED {
                break;
            }
        }
        contradicted.sort_by_key(|g| std::cmp::Reverse(g.nodes.len()));
        (possible, contradicted)
    }

    /// Tracks as a group; none where they are of one station, or of no vessel.
    fn group(&mut self, nodes: &[usize]) -> Option<Group> {
        let first = self.nodes[*nodes.first()?].key.0;
        if nodes.iter().all(|n| self.nodes[*n].key.0 == first) {
            return None;
        }
        let name: Vec<(Key, u32)> =
            nodes.iter().map(|n| (self.nodes[*n].key, self.nodes[*n].version)).collect();
        let fitted = match self.used.get(&name).or_else(|| self.fits.known.get(&name)) {
            Some(known) => *known,
            None => self.fit(nodes, 1.0),
        };
        self.used.insert(name, fitted);
        let nodes = nodes.to_vec();
        match fitted {
            Ok(motion) => {
                let own: f64 = nodes.iter().map(|n| self.nodes[*n].own).sum();
                let excess = motion.misfit - own;
                let freedom = freedom_of(&nodes);
                let consistent = excess <= misfit_limit(freedom) && motion.speed_m_s().0 <= FASTEST_M_S;
                Some(Group { nodes, motion: Some(grown(motion, excess, freedom)), excess, consistent })
            }
            Err(NetworkError::NotObservable) => {
                let consistent = self.alike(&nodes);
                Some(Group { nodes, motion: None, excess: 0.0, consistent })
            }
            Err(_) => None,
        }
    }

    /// Whether tracks without a common motion are heard in the same direction all the time: then there is no parallax, and
    /// they may be one vessel's. Others contradict each other.
    fn alike(&self, nodes: &[usize]) -> bool {
        let azimuths = |n: &usize| {
            let node = &self.nodes[*n];
            let north = self.sites.sites[node.key.0].north;
            node.averages.iter().map(move |a| (a.t_s, a.azimuth + north, a.variance))
        };
        let Some((first, others)) = nodes.split_first() else { return false };
        others.iter().flat_map(azimuths).all(|(t_s, azimuth, variance)| {
            let near = azimuths(first).min_by(|a, b| (a.0 - t_s).abs().total_cmp(&(b.0 - t_s).abs()));
            near.is_some_and(|(_, of_first, v)| {
                wrap_pi(azimuth - of_first).abs() < ALIKE_RAD + 3.0 * (variance + v).sqrt()
            })
        })
    }

    /// The motion with the variance that the averages show about the stations' own courses, where that is less than they
    /// state: of errors that do not last. By that measure, too, its covariance counts what the stations contradict each other by.
    fn refined(&self, group: &Group) -> Option<JointTrack> {
        let motion = group.motion.filter(|_| group.consistent && group.excess <= self.by_chance(group))?;
        let freedom = |n: &usize| self.nodes[*n].averages.len() as f64 - 3.0;
        let (own, free) = group
            .nodes
            .iter()
            .fold((0.0, 0.0), |(own, free), n| (own + self.nodes[*n].own, free + freedom(n).max(0.0)));
        if free < LEAST_FREEDOM {
            return Some(motion);
        }
        let scale = (own / free).clamp(LEAST_SCALE, 1.0);
        let Ok(finer) = self.fit(&group.nodes, scale) else { return Some(motion) };
        Some(grown(finer, finer.misfit - own / scale, freedom_of(&group.nodes)))
    }

    fn by_chance(&self, group: &Group) -> f64 {
        BY_CHANCE * f64::from(freedom_of(&group.nodes))
    }

    /// The motion of tracks, the variances of whose averages are so many times what they state.
    fn fit(&self, nodes: &[usize], scale: f64) -> Result<JointTrack, NetworkError> {
        let mut shared = [SharedError::default(); MAX_ARRAYS];
        let mut bearings = Vec::new();
        let mut sound = 0.0;
        for n in nodes {
            let node = &self.nodes[*n];
            let site = self.sites.sites[node.key.0];
            sound += site.sound_speed_m_s / nodes.len() as f64;
            let stated_s = if node.sd_clock_s.is_finite() { node.sd_clock_s } else { CLOCK_SD_S };
            let clock_s = site.sd_clock_s.unwrap_or(stated_s);
            shared[node.key.0] = SharedError { azimuth: site.sd_orientation, clock_s };
            bearings.extend(node.averages.iter().map(|a| DatedSighting {
                t_s: a.t_s,
                array: node.key.0,
                sighting: Sighting {
                    array_m: site.at_m,
                    azimuth: a.azimuth + site.north,
                    elevation: None,
                    sd_azimuth: (a.variance * scale).sqrt(),
                    sd_elevation: 1.0,
                },
            }));
        }
        let scatter = Scatter::Told;
        let alike = [1.0; MAX_ARRAYS];
        let settings =
            JointSettings { z_m: SOURCE_Z_M, sound_speed_m_s: sound, robust: false, scatter, shared, alike };
        joint::fit(&bearings, &settings)
    }
}

/// Freedom of the excess of tracks as one motion.
fn freedom_of(nodes: &[usize]) -> u32 {
    (3 * nodes.len() as u32).saturating_sub(4)
}

/// A motion whose covariance counts what the stations contradict each other by, where that is more than chance.
fn grown(motion: JointTrack, excess: f64, freedom: u32) -> JointTrack {
    let ratio = excess / f64::from(freedom);
    let growth = if ratio > BY_CHANCE { ratio } else { 1.0 };
    JointTrack { covariance: motion.covariance.map(|row| row.map(|x| x * growth)), ..motion }
}

/// Groups of which no two share a track.
#[derive(Clone, Debug, Default)]
struct Packing {
    groups: Vec<usize>,
    explained: usize,
    excess: f64,
}

impl Packing {
    /// The best of all, without one group.
    fn best(all: &[Group], without: Option<usize>) -> Self {
        let (mut best, mut looks) = (Self::default(), LOOKED_AT);
        Self::default().extend(all, without, 0, &mut best, &mut looks);
        best
    }

    fn extend(self, all: &[Group], without: Option<usize>, from: usize, best: &mut Self, looks: &mut u32) {
        *looks = looks.saturating_sub(1);
        let better = self.explained > best.explained
            || (self.explained == best.explained && self.excess < best.excess);
        if better {
            *best = self.clone();
        }
        for (n, group) in all.iter().enumerate().skip(from) {
            let shares = self.groups.iter().any(|g| all[*g].nodes.iter().any(|x| group.nodes.contains(x)));
            if *looks == 0 || shares || without == Some(n) {
                continue;
            }
            let mut wider = self.clone();
            wider.groups.push(n);
            wider.explained += group.nodes.len();
            wider.excess += group.excess;
            wider.extend(all, without, n + 1, best, looks);
        }
    }
}
