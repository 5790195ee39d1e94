//! Cross-correlations of the six pairs of hydrophones over one segment, for pictures.
//!
//! The Welch-averaged cross-spectra of half-overlapping Hann frames, whitened (PHAT) within the station's band, at lags
//! up to the pair's separation over the speed of sound and a fifth more: `R(τ) = Σ_f G/|G| e^{i2πfτ}`, evaluated four
//! times as finely as the samples and scaled so that perfect agreement is one.

use anyhow::{Result, anyhow, bail};
use seabearing_core::block::{CHANNELS, Frame, MISSING};
use seabearing_core::config::{Kind, StationConfig};
use seabearing_core::geometry::PAIRS;
use seabearing_signal::{Complex, Precision};

/// Samples of one transform.
const FRAME: usize = 2048;
/// Points a sample.
const FINE: usize = 4;

/// Lags in seconds and the correlation of every pair (order of [`PAIRS`]) at them.
#[derive(Clone, Debug)]
pub struct Correlations {
    /// Lags, s: positive where the second of the pair hears later.
    pub lags_s: Vec<f64>,
    /// One curve a pair.
    pub curves: [Vec<f64>; 6],
}

/// Correlates a segment, given as frames in recorder channel order.
///
/// # Errors
/// The station is no array, or the segment is shorter than one transform.
pub fn correlations(frames: &[Frame], config: &StationConfig) -> Result<Correlations> {
    let Kind::Array(array) = &config.kind else { bail!("correlations need a station of kind array") };
    let geometry = config.geometry().map_err(|e| anyhow!("{e:?}"))?;
    if frames.len() < FRAME {
        bail!("a segment of {} samples is shorter than one transform", frames.len());
    }
    let forward = f64::real_to_complex(FRAME);
    let window: Vec<f64> =
        (0..FRAME).map(|i| 0.5 - 0.5 * (std::f64::consts::TAU * i as f64 / FRAME as f64).cos()).collect();
    let bins = FRAME / 2 + 1;
    let mut cross = vec![[Complex::<f64>::default(); 6]; bins];
    for start in (0..=frames.len() - FRAME).step_by(FRAME / 2) {
        let segment = &frames[start..start + FRAME];
        let mut spectra: [Vec<Complex<f64>>; CHANNELS] = std::array::from_fn(|_| forward.make_output_vec());
        for (spectrum, channel) in spectra.iter_mut().zip(array.channels) {
            let sample = |f: &Frame| {
                f.get(usize::from(channel)).filter(|x| **x != MISSING).map_or(0.0, |x| f64::from(*x))
            };
            let mut block: Vec<f64> = segment.iter().zip(&window).map(|(f, w)| sample(f) * w).collect();
            forward.process(&mut block, spectrum).map_err(|e| anyhow!("{e}"))?;
        }
        for (k, bin) in cross.iter_mut().enumerate() {
            for (g, (i, j)) in bin.iter_mut().zip(PAIRS) {
                *g += spectra[i][k].conj() * spectra[j][k];
            }
        }
    }
    let size = FRAME * FINE;
    let inverse = f64::complex_to_real(size);
    let hz = config.rate_hz / FRAME as f64;
    let within = |k: usize| (array.band_hz.0..=array.band_hz.1).contains(&(k as f64 * hz)) && k > 0;
    let used = (0..bins).filter(|k| within(*k)).count().max(1);
    let longest = (0..6).map(|p| f64::from(geometry.separation_m(p))).fold(0.0, f64::max);
    let step_s = 1.0 / (config.rate_hz * FINE as f64);
    let reach = (1.2 * longest / config.sound_speed_m_s / step_s).ceil().min(size as f64 / 2.0 - 1.0) as i64;
    let mut curves: [Vec<f64>; 6] = Default::default();
    for (p, curve) in curves.iter_mut().enumerate() {
        let mut spectrum = inverse.make_input_vec();
        for (k, (to, g)) in spectrum.iter_mut().zip(&cross).enumerate() {
            let size = g[p].norm();
            if within(k) && size > 0.0 && k + 1 < bins {
                // X_i* X_j of a later j turns by -2πfτ: the inverse transform peaks at +τ.
                *to = g[p] / size;
            }
        }
        let mut out = inverse.make_output_vec();
        inverse.process(&mut spectrum, &mut out).map_err(|e| anyhow!("{e}"))?;
        let at = |lag: i64| out[lag.rem_euclid(size as i64) as usize] / (2.0 * used as f64);
        *curve = (-reach..=reach).map(at).collect();
    }
    Ok(Correlations { lags_s: (-reach..=reach).map(|l| l as f64 * step_s).collect(), curves })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_delayed_copy_peaks_at_its_delay() {
        let mut config = crate::station::Station::parse(
            "[station]\nid = 1\nkind = \"array\"\n[sampling]\nrate_hz = 16000\n[array]\nhydrophones_m = \
             [[0.0,1.06,-0.38],[0.92,-0.53,-0.38],[-0.92,-0.53,-0.38],[0.0,0.0,1.13]]",
            "s",
            std::path::Path::new("."),
        )
        .unwrap()
        .config;
        let noise: Vec<i32> = (0..20_000u64)
            .map(|i| {
                (i.wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29).wrapping_mul(0xbf58_476d_1ce4_e5b9)
                    >> 44) as i32
            })
            .collect();
        // Channel c hears the same, 3 c samples later.
        let frames: Vec<Frame> = (100..19_000).map(|i| std::array::from_fn(|c| noise[i - 3 * c])).collect();
        let mut peak = |channels: [u8; 4], pair: usize| {
            if let Kind::Array(a) = &mut config.kind {
                a.channels = channels;
            }
            let c = correlations(&frames, &config).unwrap();
            let (i, v) = c.curves[pair].iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)).unwrap();
            assert!(*v > 0.9, "{v}");
            (c.lags_s[i] * 16_000.0).round()
        };
        assert_eq!((peak([0, 1, 2, 3], 0), peak([0, 1, 2, 3], 2)), (3.0, 9.0));
        assert_eq!(peak([3, 1, 2, 0], 2), -9.0);
    }
}
