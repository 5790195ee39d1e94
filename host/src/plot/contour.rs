//! Lines of equal value over the cells of a heat map, by marching squares over the cells' middles.

use super::HeatMap;

/// The line of a value: pieces of two points each, an interruption (NaN) after each. What is not finite has no line beside it.
/// On a map of decades the line runs where the logarithms say.
pub fn contour(heat: &HeatMap, value: f64) -> Vec<(f64, f64)> {
    let columns = heat.columns.max(1);
    let rows = heat.values.len() / columns;
    let height = |v: f64| if heat.map == super::ColourMap::Decades { v.ln() } else { v };
    let level = height(value);
    let at = |(from, to): (f64, f64), k: f64, n: usize| from + (to - from) * (k + 0.5) / n as f64;
    let mut out = Vec::new();
    for r in 1..rows {
        for c in 1..columns {
            // The corners of a square, in order round it.
            let corners = [(c - 1, r - 1), (c, r - 1), (c, r), (c - 1, r)];
            let above = corners.map(|(c, r)| height(heat.values[r * columns + c]) - level);
            if !above.iter().all(|a| a.is_finite()) {
                continue;
            }
            let mut crossings = Vec::new();
            for k in 0..4 {
                let (a, b) = (above[k], above[(k + 1) % 4]);
                if (a < 0.0) != (b < 0.0) {
                    let share = a / (a - b);
                    let ((c0, r0), (c1, r1)) = (corners[k], corners[(k + 1) % 4]);
                    let between = |from: usize, to: usize| from as f64 + share * (to as f64 - from as f64);
                    crossings.push((at(heat.x, between(c0, c1), columns), at(heat.y, between(r0, r1), rows)));
                }
            }
            for piece in crossings.chunks_exact(2) {
                out.extend([piece[0], piece[1], (f64::NAN, f64::NAN)]);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::ColourMap;
    use super::*;

    #[test]
    fn the_line_of_a_cone_is_a_circle() {
        let middle = |k: usize| -1.0 + 2.0 * (k as f64 + 0.5) / 80.0;
        let values = (0..80 * 80).map(|n| middle(n % 80).hypot(middle(n / 80))).collect();
        let (x, y) = ((-1.0, 1.0), (-1.0, 1.0));
        let (strength, label) = (Vec::new(), String::new());
        let mut heat =
            HeatMap { x, y, columns: 80, values, strength, range: None, map: ColourMap::Amount, label };
        for map in [ColourMap::Amount, ColourMap::Decades] {
            heat.map = map;
            let line = contour(&heat, 0.5);
            let points: Vec<_> = line.iter().filter(|p| p.0.is_finite()).collect();
            assert!(points.len() > 100);
            assert!(points.iter().all(|(x, y)| (x.hypot(*y) - 0.5).abs() < 0.01));
        }
        assert!(contour(&heat, 3.0).is_empty());
    }
}
