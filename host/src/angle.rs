//! Degrees at a person's side; inside, angles are radians (`seabearing_core::angle`).

/// An angle brought into [0, 360).
pub fn wrap_deg(deg: f64) -> f64 {
    // The remainder of a hair below zero rounds to the whole turn.
    let turned = deg.rem_euclid(360.0);
    if turned < 360.0 { turned } else { 0.0 }
}

/// Azimuth of a direction East and North, in [0, 360).
pub fn azimuth_deg(east: f64, north: f64) -> f64 {
    wrap_deg(east.atan2(north).to_degrees())
}

/// The shorter way from one azimuth to another, in [−180, 180), clockwise positive.
pub fn turn_deg(from: f64, to: f64) -> f64 {
    wrap_deg(to - from + 540.0) - 180.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shorter_way_goes_over_north() {
        assert_eq!(
            (turn_deg(350.0, 10.0), turn_deg(10.0, 350.0), turn_deg(0.0, 180.0)),
            (20.0, -20.0, -180.0)
        );
        assert_eq!((azimuth_deg(-1.0, 0.0), azimuth_deg(0.0, -2.0), wrap_deg(-30.0)), (270.0, 180.0, 330.0));
        assert_eq!((wrap_deg(-1e-17), wrap_deg(720.0)), (0.0, 0.0));
    }
}
