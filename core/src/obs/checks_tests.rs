//! Tests of what a station finds doubtful about its own set-up.

use super::super::mend::tests::gaussian;
use super::super::misplaced::tests::{order, sound};
use super::*;
use std::vec::Vec;

/// Moments of a minute with a vessel: products of north, east, vertical with pressure, all powers 1.
fn vessel(products: [f32; 3]) -> Moments {
    let [north, east, vertical] = products;
    Moments { power: [1.0; 4], with_pressure: [1.0, north, east, vertical], instants: 3000, ..Moments::NONE }
}

/// Minute `n`, of a station whose vertical motion should go against pressure.
fn minute(n: usize, heard: Heard) -> Minute {
    Minute {
        index: n as u64,
        heard,
        several: false,
        speed_m_s: None,
        towards: false,
        from_below: None,
        whole: 3000,
    }
}

/// What is said in so many minutes.
fn said(minutes: usize, heard: Heard, moments: impl Fn(usize) -> Moments) -> Vec<(FaultCode, i64)> {
    let (mut checks, mut faults, mut said) = (Checks::new(), Faults::new(), Vec::new());
    for n in 0..minutes {
        checks.hop(Some(&moments(n)));
        let minute = minute(n, heard);
        checks.minute(&minute, &mut faults, &mut |m| {
            if let Message::Fault(f) = m {
                said.push((f.code, f.value));
            }
        });
    }
    said
}

/// It is known that something is wrong, and then what.
const DOUBT: (FaultCode, i64) = (FaultCode::SignInDoubt, 3);
const OVER: (FaultCode, i64) = (FaultCode::SetUpGood, FaultCode::SignInDoubt as i64);

/// A vessel every two hours, on the other side of each component than the one before; `order` puts its components, of sound
/// from above, in their places.
fn traffic(order: impl Fn([f32; 3]) -> [f32; 3]) -> Vec<(FaultCode, i64)> {
    said(1200, Heard::Vessel, |n| {
        let (s, c) = math::f32::sin_cos(n as f32 / 60.0);
        vessel(order([0.5 * c, 0.5 * s, -0.4]))
    })
}

#[test]
fn a_sign_turned_round_and_components_exchanged_are_named_once() {
    assert_eq!(traffic(|v| v), []);
    assert_eq!(traffic(|v| v.map(|x| -x)), [DOUBT, OVER, (FaultCode::Reversed, 3)]);
    assert_eq!(traffic(|[n, e, z]| [z, e, n]), [DOUBT, OVER, (FaultCode::Exchanged, 1)]);
    assert_eq!(traffic(|[n, e, z]| [n, z, e]), [DOUBT, OVER, (FaultCode::Exchanged, 2)]);
    // What cannot be told: a mirrored world.
    assert_eq!(traffic(|[n, e, z]| [e, n, z]), []);
    assert_eq!(traffic(|[n, e, z]| [-n, e, z]), []);
}

#[test]
fn a_doubt_is_over_where_vessels_have_the_right_sign_for_long_again() {
    // Something shakes for three hours as no sound does, from the first minute on; then vessels pass.
    let doubted = |order: fn([f32; 3]) -> [f32; 3]| {
        said(1200, Heard::Vessel, |n| {
            let (s, c) = math::f32::sin_cos(n as f32 / 60.0);
            vessel(if n < 180 { [0.5, 0.1, 0.4] } else { order([0.5 * c, 0.5 * s, -0.4]) })
        })
    };
    assert_eq!(doubted(|v| v), [DOUBT, OVER]);
    // Not where they pass on one side of north, nor where it was north that is no north.
    let (mut signs, mut sides) = (AllSigns::NONE, AllSigns::NONE);
    signs.doubt(false);
    sides.doubt(false);
    for n in 0..5000 {
        let (s, c) = math::f32::sin_cos(n as f32 / 60.0);
        signs.take(&[0.5 * math::f32::abs(c), 0.5 * s, -0.4], 1.0, false);
        sides.take(&[0.5 * c, 0.5 * s, -0.4], 1.0, false);
    }
    assert!(sides.are_right_after_all() && !signs.are_right_after_all());
    assert_eq!(doubted(|[n, e, z]| [z, e, n]), [DOUBT, OVER, (FaultCode::Exchanged, 1)]);
}

#[test]
fn a_noisy_hydrophone_hides_no_sign_that_is_wrong() {
    // Ten times the noise of the others: vessels are louder in motion than the sea is.
    let (mut checks, mut faults, mut told) = (Checks::new(), Faults::new(), Vec::new());
    for n in 0..1200usize {
        let heard = if n < 60 { Heard::Nothing } else { Heard::Vessel };
        let (s, c) = math::f32::sin_cos(n as f32 / 60.0);
        let power = if n < 60 { 0.0 } else { 4.0 };
        checks.hop(Some(&Moments {
            power: [power + 10.0, power * c * c + 1.0, power * s * s + 1.0, 0.1 * power + 1.0],
            with_pressure: [power + 10.0, power * c, power * s, 0.3 * power],
            north_east: power * c * s,
            with_vertical: [0.3 * power * c, 0.3 * power * s],
            instants: 3000,
        }));
        checks.minute(&minute(n, heard), &mut faults, &mut |m| {
            if let Message::Fault(f) = m {
                told.push((f.code, f.value));
            }
        });
    }
    assert_eq!(told, [DOUBT, OVER, (FaultCode::Reversed, 3)]);
}

/// What is said of vessels all around, with channels in another order.
fn in_order(places: [usize; 4]) -> Vec<(FaultCode, i64)> {
    said(1200, Heard::Vessel, |n| order(&sound(n as f32 / 60.0, 4.0, [0.3, 0.8]), places))
}

#[test]
fn pressure_exchanged_with_a_component_is_named_once() {
    assert_eq!(in_order([0, 1, 2, 3]), []);
    assert_eq!(in_order([1, 0, 2, 3]), [(FaultCode::Exchanged, 5)]);
    assert_eq!(in_order([2, 1, 0, 3]), [(FaultCode::Exchanged, 6)]);
    assert_eq!(in_order([3, 1, 2, 0]), [(FaultCode::Exchanged, 7)]);
    assert_eq!(in_order([0, 3, 2, 1]), [DOUBT, OVER, (FaultCode::Exchanged, 1)]);
    // Where vertical motion goes with pressure in all that it does, the two cannot be told apart, and nothing wrong is said.
    let soft =
        |places| said(1200, Heard::Vessel, |n| order(&sound(n as f32 / 60.0, 4.0, [1.0, 0.8]), places));
    assert_eq!((soft([0, 1, 2, 3]), soft([3, 1, 2, 0])), (Vec::new(), Vec::new()));
}

/// What is said in a day of which minute `n` knows this of sounds from below, and of which a vessel, from minute 700 on, says that all is well.
fn of_earthquakes(towards: bool, from_below: impl Fn(usize) -> Option<bool>) -> Vec<(FaultCode, i64, u64)> {
    let (mut checks, mut faults, mut said) = (Checks::new(), Faults::new(), Vec::new());
    for n in 0..1440 {
        let (s, c) = math::f32::sin_cos(n as f32 / 60.0);
        let up = if towards { 0.4 } else { -0.4 };
        let heard = if n < 700 { Heard::Nothing } else { Heard::Vessel };
        checks.hop(Some(&vessel(if n < 700 { [0.0; 3] } else { [0.5 * c, 0.5 * s, up] })));
        let minute = Minute { towards, from_below: from_below(n), ..minute(n, heard) };
        checks.minute(&minute, &mut faults, &mut |m| {
            if let Message::Fault(f) = m {
                said.push((f.code, f.value, f.index));
            }
        });
    }
    said
}

#[test]
fn what_earthquakes_told_before_does_not_overrule_vessels() {
    // Vessels of other strength and from elsewhere every ninety minutes, ten days; north and vertical stand for each other from minute 700 on.
    for seed in 1..12 {
        let (mut checks, mut faults, mut noise) = (Checks::new(), Faults::new(), Noise(seed));
        let mut random = |sd: f32| sd * noise.next() / 0.03;
        let (mut azimuth, mut power, mut named, mut cleared) = (0.0, 0.2, false, 0);
        for n in 0..14_400 {
            if n % 90 == 0 {
                (azimuth, power) = (random(3.0), (0.12 + random(0.06)).max(0.03));
            }
            let (s, c) = math::f32::sin_cos(azimuth + (n % 90) as f32 / 30.0);
            let [north, east, up] = [0.4 * c + random(0.03), 0.4 * s + random(0.03), random(0.06) - power];
            let is_vessel = n % 90 < 60;
            let heard = match (is_vessel, n < 700) {
                (false, _) => [(); 3].map(|()| random(0.03)),
                (true, true) => [north, east, up],
                (true, false) => [up, east, north],
            };
            checks.hop(Some(&vessel(heard)));
            let heard = if is_vessel { Heard::Vessel } else { Heard::Nothing };
            let minute = Minute { from_below: (n > 500).then_some(true), ..minute(n, heard) };
            checks.minute(&minute, &mut faults, &mut |_| {});
            named |= usize::from(checks.said_component) == 1;
            cleared += usize::from(named && !checks.are_misplaced());
        }
        assert!(named && cleared == 0, "{seed}: {named} {cleared}");
    }
}

#[test]
fn earthquakes_tell_a_sign_until_vessels_do() {
    let over = (FaultCode::SetUpGood, FaultCode::Reversed as i64);
    for towards in [false, true] {
        assert_eq!(of_earthquakes(towards, |n| (n > 300).then_some(!towards)), []);
        let wrong = of_earthquakes(towards, |n| (n > 300).then_some(towards));
        let [named, overruled] = wrong[..] else { panic!("{wrong:?}") };
        assert_eq!(named, (FaultCode::Reversed, 3, 301));
        assert!((overruled.0, overruled.1) == over && overruled.2 > 700, "{overruled:?}");
        let back = of_earthquakes(towards, |n| (n > 300).then_some(towards == (n < 500)));
        assert_eq!(back, [(FaultCode::Reversed, 3, 301), (over.0, over.1, 500)]);
    }
}

/// What chance makes of a minute's coherence.
struct Noise(u32);

impl Noise {
    fn next(&mut self) -> f32 {
        0.03e-3 * gaussian(&mut self.0)
    }
}

/// The same where so much of the vertical motion goes with pressure, and by chance as much in a minute as of 1000 products.
fn over_a_floor(share: f32, sides: f32, order: impl Fn([f32; 3]) -> [f32; 3]) -> Vec<(FaultCode, i64)> {
    let mut chance = Noise(3);
    let noise: Vec<f32> = (0..1200).map(|_| chance.next()).collect();
    said(1200, Heard::Vessel, |n| {
        let (s, c) = math::f32::sin_cos(n as f32 / 60.0);
        vessel(order([0.5 * (c + sides), 0.5 * s, noise[n] - share]))
    })
}

#[test]
fn a_floor_that_reflects_all_hides_no_sign() {
    assert_eq!(over_a_floor(0.04, 0.0, |v| v), []);
    assert_eq!(over_a_floor(0.04, 0.0, |v| v.map(|x| -x)), [DOUBT, OVER, (FaultCode::Reversed, 3)]);
    assert_eq!(over_a_floor(0.04, 0.0, |[n, e, z]| [z, e, n]), [DOUBT, OVER, (FaultCode::Exchanged, 1)]);
    // One that is not heard at all is nothing, not even where all vessels pass north.
    assert_eq!(over_a_floor(0.0, 0.0, |v| v), []);
    assert_eq!(over_a_floor(0.0, 1.2, |v| v), []);
}

#[test]
fn a_vessel_of_one_line_exchanges_nothing() {
    // It passes north of the station; the sign of its vertical motion turns as its paths interfere, slowest at the closest point.
    let passage = |order: fn([f32; 3]) -> [f32; 3]| {
        said(1200, Heard::Vessel, |n| {
            let minutes = (n % 400) as f32 - 200.0;
            let range_m = math::f32::hypot(4000.0, 270.0 * minutes);
            let (north, east) = (4000.0 / range_m, 270.0 * minutes / range_m);
            let vertical = 0.3 * math::f32::cos(math::f32::TAU * range_m / 1000.0) - 0.1;
            vessel(order([0.5 * north + 0.2, 0.5 * east, vertical]))
        })
    };
    assert_eq!(passage(|v| v), []);
    assert_eq!(passage(|[n, e, z]| [-n, e, z]), []);
}

/// Of 1200 minutes of traffic whose components are so from minute `from` on: the first after which no direction is one, and how many.
fn withheld(from: usize, order: impl Fn([f32; 3]) -> [f32; 3]) -> (Option<usize>, usize) {
    let (mut checks, mut faults, mut minutes) = (Checks::new(), Faults::new(), Vec::new());
    for n in 0..1200 {
        let (s, c) = math::f32::sin_cos(n as f32 / 60.0);
        let products = [0.5 * c, 0.5 * s, -0.1];
        checks.hop(Some(&vessel(if n < from { products } else { order(products) })));
        let minute = minute(n, Heard::Vessel);
        checks.minute(&minute, &mut faults, &mut |_| {});
        if checks.are_misplaced() {
            minutes.push(n);
        }
    }
    (minutes.first().copied(), minutes.len())
}

#[test]
fn no_direction_is_told_while_a_sign_is_wrong_and_it_is_not_known_which() {
    assert_eq!(withheld(0, |v| v), (None, 0));
    for from in [0, 300, 600] {
        let reversed = withheld(from, |v| v.map(|x| -x));
        assert!(reversed.0.is_some_and(|first| (from..from + 20).contains(&first)), "{reversed:?}");
        // Named, it is not known whether pressure or the vertical component is: directions may be half a turn off.
        assert_eq!(reversed.0.unwrap() + reversed.1, 1200, "{from} {reversed:?}");
        let (first, minutes) = withheld(from, |[n, e, z]| [z, e, n]);
        let first = first.expect("some");
        assert!((from..from + 250).contains(&first) && first + minutes == 1200, "{from} {first} {minutes}");
    }
}

#[test]
fn a_vertical_component_that_hears_little_or_nothing_withholds_no_direction() {
    for seed in 1..=20 {
        let mut noise = Noise(seed);
        let (mut signs, mut doubted) = (AllSigns::NONE, 0);
        for n in 0..100_000 {
            signs.take(&[0.5, -0.5, noise.next()], 1.0, n % 2000 < 1000);
            doubted += usize::from(signs.are_contrary());
        }
        assert_eq!(doubted, 0, "{seed}");
    }
}

#[test]
fn what_is_right_again_is_told() {
    let turned = said(2400, Heard::Vessel, |n| {
        let (s, c) = math::f32::sin_cos(n as f32 / 60.0);
        vessel([0.5 * c, 0.5 * s, if n < 600 { 0.4 } else { -0.4 }])
    });
    assert_eq!(
        turned,
        [DOUBT, OVER, (FaultCode::Reversed, 3), (FaultCode::SetUpGood, FaultCode::Reversed as i64)]
    );
}
