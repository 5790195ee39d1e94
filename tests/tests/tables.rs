//! Tables of seeded scenarios: what an ocean-bottom station says of a day, and what an array says of faulty records.
//!
//! A difference is an error. Where it is meant, `INSTA_UPDATE=always cargo test -p seabearing-tests --test tables` keeps
//! the new table. Errors are rounded to two digits, so that another compiler's rounding does not change them.

use seabearing::ocean_bottom::scenario::{Burst, ObsScenario, ObsVessel, Side, Straight, Whale};
use seabearing::propagation::{Propagation, bottom::Bottom, profile::SpeedProfile, trace};
use seabearing::reproduce::bearing_limit::station;
use seabearing::reproduce::bearing_limit_source::{AmbientField, Sounder, exact_arrivals};
use seabearing::reproduce::obs_world::{Case, quiet};
use seabearing::reproduce::score::{median, owner, smad, track};
use seabearing_core::angle::wrap_pi;
use seabearing_core::array::{Plan, Scratch, State, finish, push};
use seabearing_core::block::{Block, Frame, MISSING};
use seabearing_core::wire::{Bearing, Message};
use std::fmt::Write;

const DAY_S: f64 = 86_400.0;
const HOUR_S: f64 = 3_600.0;

/// Two digits, as people write them; a dash for what is not there.
fn two(x: f64) -> String {
    if !x.is_finite() {
        return "-".into();
    }
    let step = 10f64.powf(x.abs().max(1e-9).log10().floor() - 1.0);
    let places = (-step.log10().round()).max(0.0) as usize;
    format!("{:.places$}", (x / step).round() * step + 0.0)
}

fn traced() -> Propagation {
    let profile = SpeedProfile::subtropical(4340.0).unwrap();
    trace::trace("subtropical", &profile, &Bottom::default(), 140.0, 715, || ())
}

fn vessel(name: &str, hour: f64, cpa_range_m: f64, heading_deg: f64, speed_m_s: f64) -> ObsVessel {
    let cpa_time_s = hour * HOUR_S;
    let side = if heading_deg > 180.0 { Side::Starboard } else { Side::Port };
    ObsVessel {
        name: name.into(),
        straight: Straight { cpa_time_s, cpa_range_m, heading_deg, speed_m_s, side },
        active_s: [cpa_time_s - 2.5 * HOUR_S, cpa_time_s + 2.5 * HOUR_S],
        radiation: Default::default(),
    }
}

/// A day: three vessels, one whale, one earthquake.
fn day() -> ObsScenario {
    ObsScenario {
        vessels: vec![
            vessel("near", 3.5, 6_000.0, 60.0, 7.0),
            vessel("middle", 11.0, 11_000.0, 200.0, 9.0),
            vessel("far", 19.0, 18_000.0, 310.0, 6.0),
        ],
        fin_whale: vec![Whale {
            azimuth_deg: 40.0,
            range_m: 9_000.0,
            start_s: 6.5 * HOUR_S,
            duration_s: HOUR_S,
            interval_s: 13.0,
            level_db: 15.0,
        }],
        earthquake: vec![Burst {
            azimuth_deg: 150.0,
            start_s: 15.0 * HOUR_S,
            duration_s: 90.0,
            level_db: 30.0,
        }],
        ..quiet(8, DAY_S)
    }
}

#[test]
fn a_day_at_the_bottom_of_the_ocean() {
    let case = Case::run(day(), &traced(), Vec::new()).unwrap();
    let mut table = String::from(
        "ship    azimuths  wrong  SMAD deg  ranges  wrong  SMAD m  tracks  CPA s  CPA m  heading deg  speed m/s\n",
    );
    let last: Vec<_> = case
        .messages
        .iter()
        .filter_map(|m| if let Message::Track(t) = m { Some(*t) } else { None })
        .filter(|t| t.stage == 1)
        .collect();
    for (i, (vessel, d)) in case.vessels.iter().zip(case.detections()).enumerate() {
        let own: Vec<_> = last.iter().filter(|t| owner(t, &case.vessels) == Some(i)).collect();
        let e = own.last().and_then(|t| track(t, &vessel.course));
        let cells =
            e.map_or([f64::NAN; 4], |e| [e.cpa_time_s, e.cpa_range_m, e.heading.to_degrees(), e.speed_m_s]);
        let [time, range, heading, speed] = cells.map(two);
        writeln!(
            table,
            "{:<7} {:>8}  {:>5}  {:>8}  {:>6}  {:>5}  {:>6}  {:>6}  {time:>5}  {range:>5}  {heading:>11}  {speed:>9}",
            vessel.name,
            d.azimuth.len(),
            d.azimuth_wrong,
            two(smad(&d.azimuth).to_degrees()),
            d.range_m.len() + d.range_wrong,
            d.range_wrong,
            two(smad(&d.range_m)),
            own.len(),
        )
        .unwrap();
    }
    // While no vessel sounds; a window reaches 90 s to either side.
    let ships = day().vessels;
    let quiet = |index: u64| {
        let t = index as f64 / 50.0;
        ships.iter().all(|s| t < s.active_s[0] - 120.0 || t > s.active_s[1] + 120.0)
    };
    let count = |f: &dyn Fn(&Message) -> bool| case.messages.iter().filter(|m| f(m)).count();
    let tones = count(&|m| matches!(m, Message::Azimuth(a) if a.detected && a.kind == 0 && quiet(a.index)));
    let calls = count(&|m| matches!(m, Message::Azimuth(a) if a.detected && a.kind == 1 && quiet(a.index)));
    let ranges = count(&|m| matches!(m, Message::Range(r) if r.detected && quiet(r.index)));
    let segments = count(&|m| matches!(m, Message::Segment(_)));
    let nobody = last.iter().filter(|t| owner(t, &case.vessels).is_none()).count();
    writeln!(table, "\nwithout a vessel: {tones} tonal azimuths, {calls} calls, {ranges} ranges").unwrap();
    writeln!(table, "tracks of nobody: {nobody}; segments: {segments}").unwrap();
    insta::assert_snapshot!(table);
}

const RATE_HZ: f64 = 64_000.0;
/// Samples of a record, and records of a passage.
const RECORD: usize = 1 << 17;
const RECORDS: u64 = 8;
/// A passage's records, each with the vessel standing still; so much time between two.
const BETWEEN: u64 = 2 * RECORD as u64;

/// Direction of the vessel in one record: it passes at 300 m, 60 m above the array.
fn direction(record: u64) -> (f64, f64) {
    let along = 100.0 * (record as f64 - 3.5);
    (along.atan2(300.0), (60.0f64).atan2(along.hypot(300.0)))
}

/// What a fault does to a record.
type Fault = fn(u64, &mut [Frame]);

/// Amplified until the converter clips: 1 sample in 100 of a channel in even records, 3 in odd ones (2 are bridged).
fn clipped(record: u64, frames: &mut [Frame]) {
    let most = f64::from(station().full_scale - 1);
    // Standard deviations that still fit; vessel and noise are equally strong.
    let fit = if record.is_multiple_of(2) { 2.6 } else { 2.2 };
    let gain = most / (fit * 2e4 * 2f64.sqrt());
    for x in frames.as_flattened_mut() {
        *x = (f64::from(*x) * gain).clamp(-most - 1.0, most) as i32;
    }
}

/// Bearings of a passage whose records a fault has been at, each record with its number.
fn passage(fault: Fault, cut: Option<[usize; 2]>) -> Vec<(u64, Bearing)> {
    let plan = Plan::new(&station()).unwrap();
    let sounder = Sounder::new(plan.geometry(), RATE_HZ, RECORD, AmbientField::Independent);
    let (mut state, mut scratch) = (Box::new(State::new()), Box::new(Scratch::new()));
    let mut out = Vec::new();
    let mut sink = |m: Message| {
        if let Message::Bearing(b) = m
            && b.band == 0
        {
            out.push((b.index / BETWEEN, b));
        }
    };
    for record in 0..RECORDS {
        let (azimuth, elevation) = direction(record);
        let arrivals = exact_arrivals(plan.geometry(), azimuth, elevation, 500.0);
        let mut frames = sounder.record(100 + record, 2e4, Some((0.0, arrivals)));
        fault(record, &mut frames);
        let first = record * BETWEEN;
        let [from, to] = cut.unwrap_or([RECORD, RECORD]);
        for (at, part) in [(0, &frames[..from]), (to, &frames[to..])] {
            let block = Block { first_index: first + at as u64, frames: part };
            push(&plan, &mut state, &mut scratch, block, &mut sink);
        }
    }
    finish(&plan, &mut state, &mut scratch, &mut sink);
    out
}

#[test]
fn passages_of_an_array_with_faults() {
    let scenes: [(&str, Fault, Option<[usize; 2]>); 5] = [
        ("clean", |_, _| {}, None),
        ("gaps", |_, _| {}, Some([RECORD / 3, RECORD / 2])),
        (
            "dead channel",
            |record, f| {
                if record % 2 == 1 {
                    f.iter_mut().for_each(|f| f[2] = 0)
                }
            },
            None,
        ),
        ("clipped", clipped, None),
        ("invalid samples", |_, f| f.iter_mut().step_by(500).for_each(|f| f[1] = MISSING), None),
    ];
    let mut table = String::from("scene            bearings  within 95 %  median error deg\n");
    for (name, fault, cut) in scenes {
        let bearings = passage(fault, cut);
        let (mut inside, mut errors) = (0, Vec::new());
        for (record, b) in &bearings {
            let (azimuth, elevation) = direction(*record);
            let da = wrap_pi(f64::from(b.azimuth) - azimuth);
            let de = f64::from(b.elevation) - elevation;
            let (va, ve, c) = (f64::from(b.var_azimuth), f64::from(b.var_elevation), f64::from(b.cov));
            let square = (ve * da * da - 2.0 * c * da * de + va * de * de) / (va * ve - c * c);
            // 95 % of a two-dimensional normal lie within −2 ln 0.05 = 5.991.
            inside += usize::from(square <= 5.991);
            errors.push((da * elevation.cos()).hypot(de).to_degrees());
        }
        let share = 100.0 * f64::from(inside as u32) / bearings.len().max(1) as f64;
        let (n, error) = (bearings.len(), two(median(errors)));
        writeln!(table, "{name:<15}  {n:>8}  {share:>11.0}  {error:>16}").unwrap();
    }
    insta::assert_snapshot!(table);
}
