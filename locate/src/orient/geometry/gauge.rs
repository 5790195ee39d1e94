//! A shape without its place and turn, which are the track's and the orientation's.

use super::model::{COORDINATES, Model, TURN, UNKNOWNS, centroid, cross, minus, plus};
use crate::block::CHANNELS;
use crate::kit::{Square, spd};
use crate::math::f64 as m;
use nalgebra::{Rotation3, Vector3};

/// Displacements of the hydrophones.
type Moves = [[f64; 3]; CHANNELS];

/// The positions nearest to `reference_m` into which a rigid motion brings `position_m`, about the reference's centroid, metres: how two
/// arrays are compared by their shapes.
pub fn aligned(position_m: &Moves, reference_m: &Moves) -> Moves {
    let about = |h: &Moves| {
        let centre = centroid(h);
        h.map(|h| minus(&h, &centre))
    };
    let (mut h, to) = (about(position_m), about(reference_m));
    for _ in 0..20 {
        let mut moves = h;
        moves.iter_mut().zip(&to).for_each(|(x, to)| *x = minus(x, to));
        let rho = turn_of(&moves, &h);
        let back = Rotation3::new(-Vector3::from(rho)).into_inner();
        h = h.map(|h| (back * Vector3::from(h)).into());
    }
    h
}

/// The small rotation that explains most of some displacements of places about their centroid: `I⁻¹ Σ h × δ`.
fn turn_of(moves: &Moves, places: &Moves) -> [f64; 3] {
    let (mut inertia, mut moment) = ([[0.0; 3]; 3], [0.0; 3]);
    for (by, h) in moves.iter().zip(places) {
        moment = plus(&moment, &cross(h, by));
        let square = spd::dot(h, h);
        for (k, row) in inertia.iter_mut().enumerate() {
            row[k] += square;
        }
        spd::add_outer(&mut inertia, h, -1.0);
    }
    spd::solve(&inertia, &moment).unwrap_or([0.0; 3])
}

/// What displacements and a turn are of the shape, and of the orientation.
fn split(model: &Model<'_>, change: &[f64; UNKNOWNS]) -> (Moves, [f64; 3]) {
    let mut moves = [[0.0; 3]; CHANNELS];
    moves.iter_mut().flatten().zip(change).for_each(|(x, by)| *x = *by);
    let middle = centroid(&moves);
    let places = model.position_m;
    let rho = turn_of(&moves.map(|x| minus(&x, &middle)), &places);
    for (x, h) in moves.iter_mut().zip(&places) {
        *x = minus(&minus(x, &middle), &cross(&rho, h));
    }
    let own = [change[TURN], change[TURN + 1], change[TURN + 2]];
    (moves, plus(&own, &spd::times(&model.matrix, &rho)))
}

/// Rows of a linear function of the unknowns.
fn rows<const N: usize>(of: impl Fn(&[f64; UNKNOWNS]) -> [f64; N]) -> [[f64; UNKNOWNS]; N] {
    let mut out = [[0.0; UNKNOWNS]; N];
    for k in 0..UNKNOWNS {
        let mut unit = [0.0; UNKNOWNS];
        unit[k] = 1.0;
        out.iter_mut().zip(of(&unit)).for_each(|(row, x)| row[k] = x);
    }
    out
}

fn flat(moves: &Moves) -> [f64; COORDINATES] {
    let mut out = [0.0; COORDINATES];
    out.iter_mut().zip(moves.iter().flatten()).for_each(|(x, y)| *x = *y);
    out
}

/// Covariances of the shape (array's frame, m²) and of the turn about East, North, Up (rad²).
pub(super) fn told(model: &Model<'_>, covariance: &Square<UNKNOWNS>) -> (Square<COORDINATES>, Square<3>) {
    let shape = rows(|change| flat(&split(model, change).0));
    let turn = rows(|change| split(model, change).1);
    (spd::propagated(&shape, covariance), spd::propagated(&turn, covariance))
}

/// Adds a variance (m²) in every direction that is of the shape.
pub(super) fn blur(model: &Model<'_>, shape: &mut Square<COORDINATES>, variance_m2: f64) {
    let all = rows(|change| flat(&split(model, change).0));
    for (row, a) in shape.iter_mut().zip(&all) {
        for (x, b) in row.iter_mut().zip(&all) {
            // The columns of the turn are no displacements.
            let product: f64 = a.iter().zip(b).take(COORDINATES).map(|(a, b)| a * b).sum();
            *x += variance_m2 * product;
        }
    }
}

/// Standard deviations of the positions in a frame turned by the heading alone, metres: of shape and tilt together, with a variance (m²) that
/// comes to each coordinate.
pub(super) fn level(
    model: &Model<'_>,
    covariance: &Square<UNKNOWNS>,
    heading: f64,
    variance_m2: f64,
) -> Moves {
    let (s, c) = m::sin_cos(heading);
    let of = rows(|change| {
        let (shape, [about_east, about_north, _]) = split(model, change);
        let mut moves = [[0.0; 3]; CHANNELS];
        for ((out, by), h) in moves.iter_mut().zip(&shape).zip(&model.position_m) {
            let place = spd::times(&model.matrix, h);
            let tilt = cross(&[about_east, about_north, 0.0], &place);
            let [x, y, z] = plus(&spd::times(&model.matrix, by), &tilt);
            *out = [x * c - y * s, x * s + y * c, z];
        }
        flat(&moves)
    });
    let mut out = [[0.0; 3]; CHANNELS];
    for (x, row) in out.iter_mut().flatten().zip(&of) {
        *x = m::sqrt(spd::quadratic(row, covariance, row).max(0.0) + variance_m2);
    }
    out
}
