//! Appendix B of \[O\] by Monte Carlo: the law of azimuths of a strong source, and the law of the cepstrum's bins.
//!
//! Azimuths: a Gaussian source and independent Gaussian noise on pressure and both velocities; the paper takes a
//! wrapped Cauchy law with circular variance 1 − R = 1/√SNR. Here R is fitted by maximum likelihood and both the fit
//! and Student's law with two degrees of freedom (which a ratio of complex normals follows exactly at high SNR: the
//! error is Re(N/P), N normal, |P|² exponential) are held against the samples by their largest distance in
//! distribution. Cepstra: noise, and a source with one echo of half its amplitude at 2.56 s; standard deviation
//! against [O 15], distance from the normal law, mean at the echo and its first rahmonic.
//!
//! The source is the paper's, coloured (Gaussian about 15 Hz, −6 dB at 5 and 25 Hz), and, beside it, white. With a coloured one
//! the signal-to-noise ratio named is that at 15 Hz; errors are taken within 1 Hz of it, and each bin's expected share of the echo follows
//! its own ratio.

use super::obs_world::print;
use super::{Experiment, Options};
use crate::csv::{CsvText, Fixed};
use crate::ocean_bottom::source::NoiseShape;
use crate::plot::Plot;
use anyhow::Result;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use seabearing_core::kit::golden;
use seabearing_signal::{Complex, Precision};
use std::f64::consts::{PI, TAU};

/// The experiment.
pub const APPENDIX_B: Experiment = Experiment {
    name: "obs-appendix-b",
    about: "appendix B of the ocean-bottom paper: the laws of azimuths and of cepstra by Monte Carlo",
    run,
};

const N: usize = 1024;
const HOP: usize = 512;
const RATE_HZ: f64 = 50.0;

/// Frames where the command line names no number (the paper's week of test data has about as many a day).
const FRAMES: usize = 7811;

/// Echo of the paper's cepstral trial: amplitude and delay in samples.
const ECHO: (f64, usize) = (0.5, 128);

fn run(options: &Options) -> Result<()> {
    let frames = options.runs.unwrap_or(FRAMES).max(16);
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    for colour in [Colour::Coloured, Colour::White] {
        azimuths(options, colour, (frames / 8).max(16), &mut rng)?;
        cepstra(options, colour, frames, &mut rng)?;
    }
    Ok(())
}

/// Spectrum of the source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Colour {
    /// The paper's.
    Coloured,
    /// The same at all frequencies.
    White,
}

impl Colour {
    fn name(self) -> &'static str {
        if self == Self::Coloured { "coloured" } else { "white" }
    }

    /// Amplitude at a frequency, 1 at the greatest.
    fn at(self, hz: f64) -> f64 {
        if self == Self::Coloured { NoiseShape::default().at(hz) } else { 1.0 }
    }

    /// The bins in which errors of azimuth are taken.
    fn bins(self) -> std::ops::Range<usize> {
        let bin = |hz: f64| (hz / RATE_HZ * N as f64) as usize;
        if self == Self::Coloured { bin(14.0)..bin(16.0) } else { 8..N / 2 - 8 }
    }

    /// A Gaussian source whose density at its greatest is that of unit white noise.
    fn source(self, n: usize, rng: &mut ChaCha8Rng) -> Vec<f64> {
        let mut x = normals(n.next_power_of_two(), 1.0, rng);
        if self == Self::White {
            x.truncate(n);
            return x;
        }
        let m = x.len();
        let forward = f64::real_to_complex(m);
        let mut bins = forward.make_output_vec();
        if forward.process(&mut x, &mut bins).is_err() {
            return Vec::new();
        }
        for (k, b) in bins.iter_mut().enumerate() {
            *b *= self.at(k as f64 * RATE_HZ / m as f64) / m as f64;
        }
        let inverse = f64::complex_to_real(m);
        let mut out = inverse.make_output_vec();
        if inverse.process(&mut bins, &mut out).is_err() {
            return Vec::new();
        }
        out.truncate(n);
        out
    }
}

/// Spectra of overlapped frames of a series.
fn spectra(x: &[f64]) -> Vec<Vec<Complex<f64>>> {
    let fft = f64::real_to_complex(N);
    let window: Vec<f64> = (0..N).map(|i| 0.5 - 0.5 * (TAU * i as f64 / N as f64).cos()).collect();
    (0..x.len().saturating_sub(N - 1))
        .step_by(HOP)
        .filter_map(|at| {
            let mut frame: Vec<f64> = x[at..at + N].iter().zip(&window).map(|(x, w)| x * w).collect();
            let mut out = fft.make_output_vec();
            fft.process(&mut frame, &mut out).ok()?;
            Some(out)
        })
        .collect()
}

fn normals(n: usize, level: f64, rng: &mut ChaCha8Rng) -> Vec<f64> {
    (0..n)
        .map(|_| {
            let x: f64 = StandardNormal.sample(rng);
            level * x
        })
        .collect()
}

fn azimuths(options: &Options, colour: Colour, frames: usize, rng: &mut ChaCha8Rng) -> Result<()> {
    let n = HOP * (frames + 1);
    let mut csv =
        CsvText::new("snr_db,variance_fitted,variance_paper,distance_cauchy,distance_student,samples");
    let mut lines = Vec::new();
    for snr_db in [10.0, 20.0, 30.0, 40.0, 50.0] {
        let level = 10f64.powf(-snr_db / 20.0);
        let source = colour.source(n, rng);
        let mut channel = |factor: f64| -> Vec<Vec<Complex<f64>>> {
            let noise = normals(n, level, rng);
            spectra(&source.iter().zip(noise).map(|(s, w)| factor * s + w).collect::<Vec<_>>())
        };
        let true_azimuth = 0.7f64;
        let (p, e, north) = (channel(1.0), channel(true_azimuth.sin()), channel(true_azimuth.cos()));
        let mut errors = Vec::new();
        for ((p, e), v) in p.iter().zip(&e).zip(&north) {
            for k in colour.bins() {
                let (ie, iv) = ((p[k].conj() * e[k]).re, (p[k].conj() * v[k]).re);
                errors.push(seabearing_core::angle::wrap_pi(ie.atan2(iv) - true_azimuth));
            }
        }
        errors.sort_by(f64::total_cmp);
        let r = fitted(&errors);
        let cauchy = |x: f64| 0.5 + ((1.0 + r) / (1.0 - r) * (0.5 * x).tan()).atan() / PI;
        // P and N have equal windows: the error is Re(N/P) with |N|²/|P|² of mean 1/SNR.
        let student = |x: f64| {
            let t = x / level * 2f64.sqrt();
            0.5 + 0.5 * t / (2.0 + t * t).sqrt()
        };
        let (dc, ds) = (distance(&errors, cauchy), distance(&errors, student));
        let (snr, r5, level5) = (Fixed(snr_db, 0), Fixed(1.0 - r, 5), Fixed(level, 5));
        csv.row(&[&snr, &r5, &level5, &Fixed(dc, 4), &Fixed(ds, 4), &errors.len()]);
        lines.push((snr_db, 1.0 - r, level));
    }
    let name = format!("obs-appendix-b-azimuth-{}", colour.name());
    print(options, &name, csv)?;
    let mut f = Plot::new(
        &format!("Circular variance of azimuths, {} source", colour.name()),
        "signal-to-noise ratio (dB)",
        "1 − R",
    );
    f.y_scale(crate::plot::Scale::Log);
    f.points("fitted", &lines.iter().map(|l| (l.0, l.1)).collect::<Vec<_>>());
    f.line("1/√SNR (paper)", &lines.iter().map(|l| (l.0, l.2)).collect::<Vec<_>>());
    f.write(&options.out.join(format!("{name}.svg")))
}

/// Greatest difference between the samples' distribution and a law.
fn distance(sorted: &[f64], law: impl Fn(f64) -> f64) -> f64 {
    let n = sorted.len() as f64;
    sorted.iter().enumerate().fold(0.0, |d: f64, (i, x)| {
        let y = law(*x);
        d.max((y - i as f64 / n).abs()).max((y - (i + 1) as f64 / n).abs())
    })
}

/// Maximum-likelihood mean resultant length of a wrapped Cauchy law about zero (golden section in log(1 − R)).
fn fitted(errors: &[f64]) -> f64 {
    let likelihood = |u: f64| -> f64 {
        let r = 1.0 - u.exp();
        errors.iter().map(|x| ((1.0 - r * r) / (1.0 - 2.0 * r * x.cos() + r * r)).ln()).sum::<f64>()
    };
    1.0 - golden(-9.0, -0.01, 40, |u| -likelihood(u)).exp()
}

fn cepstra(options: &Options, colour: Colour, frames: usize, rng: &mut ChaCha8Rng) -> Result<()> {
    let n = HOP * (frames + 1);
    let noise = normals(n, 1.0, rng);
    let source = colour.source(n + ECHO.1, rng);
    let ambient = normals(n, 1.0, rng);
    let both: Vec<f64> = (0..n).map(|i| source[i + ECHO.1] + ECHO.0 * source[i] + ambient[i]).collect();
    let silent = columns(&noise);
    let echo = columns(&both);
    let sigma = |q: f64| (0.625 + 0.2 * (PI * q / 10.24).cos()) / (N as f64).sqrt();
    let stats = |c: &[f64]| {
        let m = c.iter().sum::<f64>() / c.len() as f64;
        (m, (c.iter().map(|x| (x - m).powi(2)).sum::<f64>() / c.len() as f64).sqrt())
    };
    let inside = |k: usize| (0.2..=10.0).contains(&(k as f64 / RATE_HZ));
    let (mut worst, mut sum, mut count, mut far) = (0.0f64, 0.0, 0, 0.0f64);
    let mut points = Vec::new();
    for (k, c) in silent.iter().enumerate().filter(|(k, _)| inside(*k)) {
        let (m, sd) = stats(c);
        let off = sd / sigma(k as f64 / RATE_HZ) - 1.0;
        worst = worst.max(off.abs());
        sum += off;
        count += 1;
        let mut z: Vec<f64> = c.iter().map(|x| (x - m) / sd).collect();
        z.sort_by(f64::total_cmp);
        let normal = |x: f64| 0.5 * seabearing_core::math::f64::erfc(-x / 2f64.sqrt());
        far = far.max(distance(&z, normal));
        points.push((k as f64 / RATE_HZ, sd));
    }
    let at = |k: usize| {
        let (m, sd) = stats(&echo[k]);
        (m, m / (sd / (frames as f64).sqrt()))
    };
    let (first, rahmonic) = (at(ECHO.1), at(2 * ECHO.1));
    // E ln|X| is half the logarithm of the power c + 2 a cos ωτ, whose series is Σ (−1)^(k+1) ρ^k / k cos kωτ with
    // ρ / (1 + ρ²) = a / c; half of each cosine falls on its positive quefrency. The echo's share a shrinks with the
    // overlap of the Hann window with itself, shifted by the delay.
    let x = ECHO.1 as f64 / N as f64;
    let overlap = (1.0 - x) * (2.0 + (TAU * x).cos()) / 3.0 + (TAU * x).sin() / TAU;
    let (half_rho, quarter_square) = (0..N / 2).fold((0.0, 0.0), |(one, two), k| {
        let density = colour.at((k as f64 + 0.5) * RATE_HZ / N as f64).powi(2);
        let share = ECHO.0 * overlap * density / ((1.0 + ECHO.0 * ECHO.0) * density + 1.0);
        let rho = if share > 0.0 { (1.0 - (1.0 - 4.0 * share * share).sqrt()) / (2.0 * share) } else { 0.0 };
        (one + rho / N as f64, two + 0.5 * rho * rho / N as f64)
    });
    let mut csv = CsvText::new("quantity,value,expected");
    csv.row(&[&"sd against eq 15 mean %", &Fixed(100.0 * sum / f64::from(count), 3), &0]);
    csv.row(&[&"sd against eq 15 worst %", &Fixed(100.0 * worst, 2), &3.8]);
    let normal = 1.6 / (frames as f64).sqrt();
    csv.row(&[&"largest distance from a normal law", &Fixed(far, 4), &Fixed(normal, 4)]);
    csv.row(&[&"mean at the echo", &Fixed(first.0, 4), &Fixed(half_rho, 4)]);
    csv.row(&[&"mean at twice the echo", &Fixed(rahmonic.0, 4), &Fixed(-quarter_square, 4)]);
    print(options, &format!("obs-appendix-b-cepstrum-{}", colour.name()), csv)?;
    let mut f =
        Plot::new("Standard deviation of the cepstrum of noise", "quefrency (s)", "standard deviation");
    f.points("Monte Carlo", &points);
    f.line("equation 15", &points.iter().map(|p| (p.0, sigma(p.0))).collect::<Vec<_>>());
    f.write(&options.out.join("obs-appendix-b-cepstrum.svg"))?;
    let means: Vec<(f64, f64)> = echo
        .iter()
        .enumerate()
        .filter(|(k, _)| inside(*k))
        .map(|(k, c)| (k as f64 / RATE_HZ, stats(c).0))
        .collect();
    let mut f = Plot::new(
        &format!("Mean cepstrum with an echo at 2.56 s, {} source", colour.name()),
        "quefrency (s)",
        "mean",
    );
    f.line("Monte Carlo", &means);
    f.write(&options.out.join(format!("obs-appendix-b-echo-{}.svg", colour.name())))
}

/// Cepstra of a series, by quefrency.
fn columns(x: &[f64]) -> Vec<Vec<f64>> {
    let inverse = f64::complex_to_real(N);
    let mut out = vec![Vec::new(); N / 2 + 1];
    for s in spectra(x) {
        let mut log: Vec<Complex<f64>> =
            s.iter().map(|c| Complex::new(c.norm().max(1e-300).ln() / N as f64, 0.0)).collect();
        let mut time = inverse.make_output_vec();
        if inverse.process(&mut log, &mut time).is_ok() {
            for (column, x) in out.iter_mut().zip(&time) {
                column.push(*x);
            }
        }
    }
    out
}
