//! Colours: a palette for series, a map from dark to light for amounts, and a cyclic one for angles.
//!
//! All are computed in OKLCH (lightness, chroma, hue; B. Ottosson, 2020), so that equal steps look equal. The cyclic map goes once
//! round the hues, from light through yellow to dark and through blue back, so that who sees no difference of red and green
//! sees a circle of lightness and yellow against blue: directions a quarter turn apart differ for all. Its lightest direction
//! lies 30° from North, so that North, East, South and West differ in grey as well. (No cyclic map can tell *all* directions a quarter turn apart in
//! grey: four differences sum to zero.)

use super::Scale;
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

/// How one of many series is drawn: its colour and, from the eighth on, which have the colours of the first again, its dash and its marker.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Look {
    /// Its colour.
    pub colour: RGBColor,
    /// How often the palette was used up before it.
    pub(super) round: usize,
}

impl Look {
    /// So many look otherwise each; of more none is dashed, for no dash would tell which it is, and pages would be long.
    pub const MOST: usize = 4 * PALETTE.len();

    /// The look of a series by its number, from 0.
    pub fn of(number: usize) -> Self {
        Self { colour: PALETTE[number % PALETTE.len()], round: number / PALETTE.len() }
    }

    /// Whether it is one of the first [`Look::MOST`].
    pub(super) fn is_own(self) -> bool {
        self.round * PALETTE.len() < Self::MOST
    }

    /// Length of a dash and of the gap after it, points; `None`: the line is whole.
    pub(super) fn dash(self) -> Option<(i32, i32)> {
        [None, Some((10, 5)), Some((3, 4)), Some((18, 3))][self.round % 4]
    }

    /// Where its dashes begin and end along so many points.
    pub(super) fn dashes(self, length: i32) -> Vec<(i32, i32)> {
        let Some((dash, gap)) = self.dash() else { return vec![(0, length)] };
        (0..length).step_by((dash + gap) as usize).map(|from| (from, (from + dash).min(length))).collect()
    }
}

impl From<RGBColor> for Look {
    fn from(colour: RGBColor) -> Self {
        Self { colour, round: 0 }
    }
}

/// The colour of the truth in every figure.
pub const TRUTH: RGBColor = RGBColor(40, 40, 40);

/// How numbers become colours in a heat map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColourMap {
    /// From dark blue to light yellow, for amounts.
    Amount,
    /// The same by decades: equal colours for equal ratios; what is not above zero stays blank.
    Decades,
    /// From the page's white to grey, for amounts that series in colours are drawn over.
    Under,
    /// Round the hues, for angles: least and greatest value have the same colour.
    Cyclic,
}

/// The share of a circle, degrees, at which the cyclic map is lightest.
const LIGHTEST_DEG: f64 = 30.0;

impl ColourMap {
    /// How the values of its colours run.
    pub(super) fn scale(self) -> Scale {
        match self {
            Self::Amount | Self::Under => Scale::Linear,
            Self::Decades => Scale::Log,
            Self::Cyclic => Scale::Degrees,
        }
    }

    /// The colour of a share 0..1 of the range; outside it the nearest end.
    pub fn colour(self, share: f64) -> RGBColor {
        let t = share.clamp(0.0, 1.0);
        match self {
            Self::Amount | Self::Decades => {
                let (lightness, hue_deg) = (0.20 + 0.76 * t, 285.0 - 185.0 * t);
                oklch(lightness, (0.8 * greatest_chroma(lightness, hue_deg)).min(0.12), hue_deg)
            }
            Self::Under => oklch(1.0 - 0.58 * t, 0.0, 0.0),
            Self::Cyclic => {
                let turn = (360.0 * t - LIGHTEST_DEG).rem_euclid(360.0);
                let lightness = 0.60 + 0.30 * turn.to_radians().cos();
                // Yellow (100) a quarter turn from the lightest, blue (265) at the opposite side.
                let hue_deg = if (90.0..270.0).contains(&turn) {
                    100.0 - (turn - 90.0) * 195.0 / 180.0
                } else {
                    265.0 - (turn + 90.0).rem_euclid(360.0) * 165.0 / 180.0
                };
                oklch(lightness, (0.9 * greatest_chroma(lightness, hue_deg)).min(0.16), hue_deg)
            }
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

    /// CIE L*a*b* (D65) of linear RGB.
    fn lab(rgb: [f64; 3]) -> [f64; 3] {
        let f = |t: f64| if t > 0.008_856 { t.cbrt() } else { 7.787 * t + 16.0 / 116.0 };
        let [r, g, b] = rgb;
        let x = f((0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505);
        let y = f(0.2126 * r + 0.7152 * g + 0.0722 * b);
        let z = f((0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.089);
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    }

    fn linear(c: RGBColor) -> [f64; 3] {
        [c.0, c.1, c.2].map(|x| {
            let x = f64::from(x) / 255.0;
            if x <= 0.04045 { x / 12.92 } else { ((x + 0.055) / 1.055).powf(2.4) }
        })
    }

    /// Without the middle cones (Machado, Oliveira and Fernandes, 2009, severity 1).
    fn deuteranope(c: RGBColor) -> [f64; 3] {
        let [r, g, b] = linear(c);
        [
            0.367_322 * r + 0.860_646 * g - 0.227_968 * b,
            0.280_085 * r + 0.672_501 * g + 0.047_413 * b,
            -0.011_820 * r + 0.042_940 * g + 0.968_881 * b,
        ]
    }

    fn difference(a: [f64; 3], b: [f64; 3]) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
    }

    #[test]
    fn directions_a_quarter_turn_apart_differ_for_the_colour_blind_and_in_grey() {
        let at = |deg: f64| ColourMap::Cyclic.colour(deg.rem_euclid(360.0) / 360.0);
        let seen = |deg: f64| lab(deuteranope(at(deg)));
        let all = (0..360).map(f64::from).map(|deg| difference(seen(deg), seen(deg + 90.0)));
        let least = all.fold(f64::INFINITY, f64::min);
        assert!(least > 10.0, "{least}");
        let grey = |deg: f64| lab(linear(at(deg)))[0];
        let winds = [0.0, 90.0, 180.0, 270.0].map(|deg| (grey(deg) - grey(deg + 90.0)).abs());
        assert!(winds.iter().all(|d| *d > 10.0), "{winds:?}");
    }

    #[test]
    fn no_two_of_four_palettes_look_alike() {
        let looks: Vec<_> = (0..4 * PALETTE.len()).map(Look::of).map(|l| (l.colour, l.dash())).collect();
        for (k, look) in looks.iter().enumerate() {
            assert!(!looks[..k].contains(look), "{k}");
        }
        assert_eq!(Look::of(3).dashes(26), [(0, 26)]);
        assert_eq!(Look::of(8).dashes(26), [(0, 10), (15, 25)]);
    }

    #[test]
    fn white_is_white() {
        assert_eq!(oklch(1.0, 0.0, 0.0), RGBColor(255, 255, 255));
    }
}
