//! Where the hydrophones are, what delays a direction gives, and what the geometry can and cannot resolve.

use crate::block::CHANNELS;
use crate::math::f64 as m;

/// The six pairs (i, j), i < j, in the order every table of pairs follows.
pub const PAIRS: [(usize, usize); 6] = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];

/// Positions of the hydrophones, East-North-Up in metres, about their centroid and turned to true North.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// One row a hydrophone.
    pub position_m: [[f32; 3]; CHANNELS],
    /// The speed of sound, metres a second.
    pub sound_speed_m_s: f32,
}

/// What is wrong with a set of hydrophones.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GeometryError {
    /// A coordinate is not a finite number.
    #[error("a coordinate is not a number")]
    NotFinite,
    /// Two hydrophones are at the same place (closer than 1 cm): their indices.
    #[error("hydrophones {0} and {1} are at the same place: check for a copied row")]
    Coincident(usize, usize),
    /// All four lie in one plane: elevation cannot be told from its mirror image.
    #[error("the four hydrophones lie in one plane: elevation would be ambiguous")]
    Coplanar,
}

impl Geometry {
    /// Checks positions and turns them clockwise by `orientation_rad` into the true frame.
    ///
    /// # Errors
    /// [`GeometryError`] names what makes bearings impossible.
    pub fn new(
        hydrophones_m: &[[f64; 3]; CHANNELS],
        orientation_rad: f64,
        sound_speed_m_s: f64,
    ) -> Result<Self, GeometryError> {
        if hydrophones_m.iter().flatten().any(|x| !x.is_finite()) {
            return Err(GeometryError::NotFinite);
        }
        // Masked: whether the compiler sees that the pairs are of four depends on how it writes out the loop.
        let apart = |(i, j)| distance(&hydrophones_m[i & (CHANNELS - 1)], &hydrophones_m[j & (CHANNELS - 1)]);
        for (i, j) in PAIRS {
            if apart((i, j)) < 0.01 {
                return Err(GeometryError::Coincident(i, j));
            }
        }
        // Height of the fourth above the plane of the first three, against the array's size.
        let a = sub(&hydrophones_m[1], &hydrophones_m[0]);
        let b = sub(&hydrophones_m[2], &hydrophones_m[0]);
        let c = sub(&hydrophones_m[3], &hydrophones_m[0]);
        let volume = m::abs(
            a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
                + a[2] * (b[0] * c[1] - b[1] * c[0]),
        );
        let mut size = 0.0f64;
        for pair in PAIRS {
            size = size.max(apart(pair));
        }
        // A regular tetrahedron has volume/size³ = 0.707; a hundredth of that leaves elevation to rounding errors.
        if volume < 0.007 * size * size * size {
            return Err(GeometryError::Coplanar);
        }
        let mut centre = [0.0f64; 3];
        for h in hydrophones_m {
            for k in 0..3 {
                centre[k] += h[k] / CHANNELS as f64;
            }
        }
        let (s, c) = m::sin_cos(orientation_rad);
        let mut position_m = [[0.0f32; 3]; CHANNELS];
        for (row, h) in position_m.iter_mut().zip(hydrophones_m) {
            let d = sub(h, &centre);
            *row = [(d[0] * c + d[1] * s) as f32, (d[1] * c - d[0] * s) as f32, d[2] as f32];
        }
        Ok(Self { position_m, sound_speed_m_s: sound_speed_m_s as f32 })
    }

    /// Distance between the hydrophones of pair `p` (order of [`PAIRS`]) in metres.
    pub fn separation_m(&self, p: usize) -> f32 {
        let (i, j) = PAIRS[p % PAIRS.len()];
        let (a, b) = (&self.position_m[i], &self.position_m[j]);
        let d = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
        crate::math::f32::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    }
}

fn sub(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    let d = sub(a, b);
    m::sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    const TETRA: [[f64; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.8, 0.0], [0.5, 0.3, 0.8]];

    #[test]
    fn orientation_turns_clockwise() {
        let g = Geometry::new(&TETRA, core::f64::consts::FRAC_PI_2, 1484.0).unwrap();
        let g0 = Geometry::new(&TETRA, 0.0, 1484.0).unwrap();
        // What pointed North in the array's frame points East once the array is turned by 90°.
        assert!((g.position_m[2][0] - g0.position_m[2][1]).abs() < 1e-6);
    }

    #[test]
    fn impossible_arrays_are_named() {
        let mut flat = TETRA;
        flat[3][2] = 0.0;
        assert_eq!(Geometry::new(&flat, 0.0, 1484.0), Err(GeometryError::Coplanar));
        let mut twin = TETRA;
        twin[3] = twin[1];
        assert_eq!(Geometry::new(&twin, 0.0, 1484.0), Err(GeometryError::Coincident(1, 3)));
        twin[3][0] = f64::NAN;
        assert_eq!(Geometry::new(&twin, 0.0, 1484.0), Err(GeometryError::NotFinite));
    }
}
