use super::*;

fn plan(sources: usize) -> LinePlan {
    LinePlan::new(23, 0.75, 702.0, 1484.0, 5, 0.4, sources).unwrap()
}

/// Snapshots of plane waves with unit power each and pseudo-random phases, and weak noise.
fn snapshots(sines: &[f64], coherent: bool, noise: f64) -> std::vec::Vec<[Complex; MAX_SENSORS]> {
    let mut seed = 12345u32;
    let mut random = move || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(seed >> 8) / f64::from(1u32 << 24)
    };
    (0..40)
        .map(|_| {
            let common = random() * m::TAU;
            let mut x = [Complex::ZERO; MAX_SENSORS];
            for s in sines {
                let phase = if coherent { common + s } else { random() * m::TAU };
                for (k, v) in x.iter_mut().enumerate().take(23) {
                    *v += unit(phase + plan(1).phase * s * k as f64);
                }
            }
            for v in x.iter_mut().take(23) {
                *v += unit(random() * m::TAU).scale(noise);
            }
            x
        })
        .collect()
}

fn find(sines: &[f64], coherent: bool, noise: f64, method: MusicMethod) -> std::vec::Vec<LineArrival> {
    let mut arrivals = [LineArrival::default(); MAX_SOURCES];
    let n = plan(sines.len())
        .step(
            &mut State::new(),
            &mut Scratch::new(),
            &snapshots(sines, coherent, noise),
            method,
            &mut arrivals,
        )
        .unwrap();
    let mut out = arrivals[..n].to_vec();
    out.sort_by(|a, b| a.sine.total_cmp(&b.sine));
    out
}

#[test]
fn one_wave_without_noise_is_found_exactly() {
    for method in [MusicMethod::Spectrum, MusicMethod::Root] {
        for sine in [-0.93, -0.2, 0.0, 0.573] {
            let found = find(&[sine], false, 0.0, method);
            assert!((found[0].sine - sine).abs() < 1e-6, "{method:?} {sine} {found:?}");
        }
    }
}

#[test]
fn two_waves_are_told_apart_even_if_coherent() {
    for method in [MusicMethod::Spectrum, MusicMethod::Root] {
        for coherent in [false, true] {
            let found = find(&[0.1, 0.25], coherent, 0.1, method);
            assert_eq!(found.len(), 2);
            assert!((found[0].sine - 0.1).abs() < 0.01, "{method:?} {coherent} {found:?}");
            assert!((found[1].sine - 0.25).abs() < 0.01, "{method:?} {coherent} {found:?}");
            assert!(found[0].sd > 0.0 && found[0].sd < 0.01);
        }
    }
}

#[test]
fn sources_are_counted() {
    for method in [MusicMethod::Spectrum, MusicMethod::Root] {
        for (sines, expected) in [(&[][..], 0), (&[0.4][..], 1), (&[0.1, 0.3][..], 2), (&[0.1, 0.11][..], 1)]
        {
            let mut arrivals = [LineArrival::default(); MAX_SOURCES];
            let (mut state, mut scratch) = (State::new(), Scratch::new());
            let heard = snapshots(sines, false, 0.5);
            let n = plan(4).counting().step(&mut state, &mut scratch, &heard, method, &mut arrivals);
            assert_eq!(n, Ok(expected), "{method:?} {sines:?} {arrivals:?}");
        }
    }
}

/// Of a source that moves the eigenvalues show two, which the spectrum does not tell apart.
#[test]
fn one_that_moves_is_not_two() {
    for (n, sine) in [-0.7, -0.2, 0.1, 0.6].into_iter().enumerate() {
        // Loud, in 40 places, each phase its own.
        let sines: std::vec::Vec<f64> = (0..40).map(|k| sine + 0.0005 * f64::from(k)).collect();
        let each: std::vec::Vec<_> = sines.iter().map(|s| snapshots(&[*s], false, 0.1)[n]).collect();
        for method in [MusicMethod::Spectrum, MusicMethod::Root] {
            let mut arrivals = [LineArrival::default(); MAX_SOURCES];
            let (mut state, mut scratch) = (State::new(), Scratch::new());
            let plan = plan(2).counting();
            plan.take(&mut state, 0.0, &each);
            let length = smooth(&state.covariance, plan.sensors, plan.subarrays, &mut scratch.matrix);
            assert!(eigen(&mut scratch.matrix, length, &mut scratch.vectors));
            assert_eq!(plan.count(&scratch.matrix, length, state.snapshots), 2);
            let found = plan.find(&state, &mut scratch, &each, method, &mut arrivals);
            assert_eq!(found, Ok(1), "{method:?} {sine} {arrivals:?}");
            assert!((arrivals[0].sine - sine - 0.01).abs() < 0.005, "{method:?} {sine} {arrivals:?}");
        }
    }
}

/// A source whose loudness wanders and which turns meanwhile is found where it was loud; what is stated says so.
#[test]
fn what_a_source_turns_while_it_is_averaged_is_in_the_deviation() {
    let mut seed = 99u32;
    let mut normal = || {
        let mut sum = -6.0;
        for _ in 0..12 {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            sum += f64::from(seed >> 8) / f64::from(1u32 << 24);
        }
        sum
    };
    for span in [0.0, 0.03] {
        let (mut squares, mut stated, runs) = (0.0, 0.0, 200);
        for _ in 0..runs {
            let heard: std::vec::Vec<_> = (0..32)
                .map(|n| {
                    let sine = 0.3 + span * (f64::from(n) / 31.0 - 0.5);
                    let loud = Complex::new(normal(), normal());
                    let mut x = [Complex::ZERO; MAX_SENSORS];
                    for (k, v) in x.iter_mut().enumerate().take(23) {
                        let noise = Complex::new(normal(), normal()).scale(0.1);
                        *v = loud * unit(plan(1).phase * sine * k as f64) + noise;
                    }
                    x
                })
                .collect();
            let mut arrivals = [LineArrival::default(); MAX_SOURCES];
            let (mut state, mut scratch) = (State::new(), Scratch::new());
            let n =
                plan(2).counting().step(&mut state, &mut scratch, &heard, MusicMethod::Root, &mut arrivals);
            assert_eq!(n, Ok(1));
            squares += (arrivals[0].sine - 0.3) * (arrivals[0].sine - 0.3) / f64::from(runs);
            stated += arrivals[0].sd * arrivals[0].sd / f64::from(runs);
        }
        // Loudness is new in each snapshot here and taken to last for two: √2 at most.
        let ratio = m::sqrt(stated / squares);
        assert!((0.8..1.6).contains(&ratio), "{span}: {ratio}, error {}", m::sqrt(squares));
    }
}

#[test]
fn the_signal_to_noise_ratio_is_seen() {
    let found = find(&[0.3], false, 10f64.powf(-0.5), MusicMethod::Root);
    assert!((10.0 * found[0].snr.log10() - 10.0).abs() < 0.7, "{found:?}");
}

#[test]
fn settings_are_checked() {
    let new = |sensors, spacing, subarrays| LinePlan::new(sensors, spacing, 702.0, 1484.0, subarrays, 0.4, 1);
    assert_eq!(new(23, 1.2, 5), Err(LineError::Aliased));
    assert_eq!(new(33, 0.75, 5), Err(LineError::Settings));
    assert_eq!(new(5, 0.75, 4), Err(LineError::Settings));
    let mut arrivals = [LineArrival::default(); MAX_SOURCES];
    let none = plan(1).step(&mut State::new(), &mut Scratch::new(), &[], MusicMethod::Root, &mut arrivals);
    assert_eq!(none, Err(LineError::NoSnapshot));
}
