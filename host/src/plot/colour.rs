//! Colours: a palette for series, a map from dark to light for amounts, and a cyclic one for angles.
//!
//! All are computed in OKLCH (lightness, chroma, hue; B. Ottosson, 2020), so that equal steps look equal. The
//! cyclic map goes once round the hues at constant lightness: 0° and 360° meet without an edge.

use plotters::style::RGBColor;

/// Colours of the first series of a figure, told apart also with common colour-vision deficiencies
/// (Okabe and Ito, 2008); the list repeats.
pub const PALETTE: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
    RGBColor(130, 90, 44),
];

/// The colour of the truth in every figure.
pub const TRUTH: RGBColor = RGBColor(40, 40, 40);

/// How numbers become colours in a heat map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColourMap {
    /// From dark blue to light yellow, for amounts.
    Amount,
    /// Round the hues, for angles: least and greatest value have the same colour.
    Cyclic,
}

impl ColourMap {
    /// The colour of a share 0..1 of the range; outside it the nearest end.
    pub fn colour(self, share: f64) -> RGBColor {
        let t = share.clamp(0.0, 1.0);
        match self {
            Self::Amount => {
                let (lightness, hue_deg) = (0.20 + 0.76 * t, 285.0 - 185.0 * t);
                oklch(lightness, (0.8 * greatest_chroma(lightness, hue_deg)).min(0.12), hue_deg)
            }
            // Full chroma that every hue of this lightness can show in sRGB.
            Self::Cyclic => oklch(0.74, 0.125, 25.0 + 360.0 * t),
        }
    }
}

/// The greatest chroma of a lightness and hue (degrees) that sRGB can show: clipping would draw edges into a map.
fn greatest_chroma(lightness: f64, hue_deg: f64) -> f64 {
    let (mut shown, mut not) = (0.0, 0.4);
    for _ in 0..20 {
        let middle = 0.5 * (shown + not);
        let inside = linear_rgb(lightness, middle, hue_deg).iter().all(|x| (0.0..=1.0).contains(x));
        *(if inside { &mut shown } else { &mut not }) = middle;
    }
    shown
}

/// OKLCH (hue in degrees) to linear RGB; outside 0 to 1 where sRGB cannot show it.
fn linear_rgb(lightness: f64, chroma: f64, hue_deg: f64) -> [f64; 3] {
    let (s, c) = hue_deg.to_radians().sin_cos();
    let (a, b) = (chroma * c, chroma * s);
    let l = (lightness + 0.396_337_777_4 * a + 0.215_803_757_3 * b).powi(3);
    let m = (lightness - 0.105_561_345_8 * a - 0.063_854_172_8 * b).powi(3);
    let s = (lightness - 0.089_484_177_5 * a - 1.291_485_548_0 * b).powi(3);
    [
        4.076_741_662_1 * l - 3.307_711_591_3 * m + 0.230_969_929_2 * s,
        -1.268_438_004_6 * l + 2.609_757_401_1 * m - 0.341_319_396_5 * s,
        -0.004_196_086_3 * l - 0.703_418_614_7 * m + 1.707_614_701_0 * s,
    ]
}

/// OKLCH (hue in degrees) to sRGB; what sRGB cannot show is clipped.
fn oklch(lightness: f64, chroma: f64, hue_deg: f64) -> RGBColor {
    let linear = linear_rgb(lightness, chroma, hue_deg);
    let [r, g, b] = linear.map(|x| {
        let x = x.clamp(0.0, 1.0);
        let x = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
        (255.0 * x).round() as u8
    });
    RGBColor(r, g, b)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cyclic_map_closes_and_the_amount_map_brightens() {
        assert_eq!(ColourMap::Cyclic.colour(0.0), ColourMap::Cyclic.colour(1.0));
        let bright = |c: RGBColor| 0.3 * f64::from(c.0) + 0.59 * f64::from(c.1) + 0.11 * f64::from(c.2);
        let steps: Vec<f64> =
            (0..=20).map(|i| bright(ColourMap::Amount.colour(f64::from(i) / 20.0))).collect();
        assert!(steps.windows(2).all(|w| w[1] > w[0]), "{steps:?}");
    }

    #[test]
    fn white_is_white() {
        assert_eq!(oklch(1.0, 0.0, 0.0), RGBColor(255, 255, 255));
    }
}
