//! How wide words are on the page, and where a line of them ends.

/// Widths of the characters from the space to the tilde in DejaVu Sans, thousandths of the size: the widest of the usual
/// sans-serif faces, so that what fits by it fits everywhere.
const WIDTHS: [u16; 95] = [
    318, 401, 460, 838, 636, 950, 780, 275, 390, 390, 500, 838, 318, 361, 318, 337, 636, 636, 636, 636, 636,
    636, 636, 636, 636, 636, 337, 337, 838, 838, 838, 531, 1000, 684, 686, 698, 770, 632, 575, 775, 752, 295,
    295, 656, 557, 863, 748, 787, 603, 787, 695, 635, 611, 732, 684, 989, 685, 611, 685, 390, 337, 390, 838,
    500, 500, 613, 635, 550, 635, 615, 352, 635, 634, 278, 278, 579, 278, 974, 634, 612, 635, 635, 411, 521,
    392, 634, 592, 818, 592, 592, 525, 636, 337, 636, 838,
];

/// Width of what is not among them.
const OTHER: u16 = 838;

/// Width of a text of a size, both in points.
pub(super) fn width(text: &str, size: i32) -> f64 {
    let one = |c: char| (c as usize).checked_sub(32).and_then(|k| WIDTHS.get(k)).copied().unwrap_or(OTHER);
    text.chars().map(|c| f64::from(one(c))).sum::<f64>() * 1e-3 * f64::from(size)
}

/// A text in lines of at most a width, points; a word that is wider has a line of its own.
pub(super) fn wrapped(text: &str, size: i32, most: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if width(line, size) + width(" ", size) + width(word, size) <= most => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_as_wide_as_there_is_room() {
        assert!((width("00:00", 10) - (4.0 * 6.36 + 3.37)).abs() < 1e-9);
        let text = "a band of 95 % about each bearing, as the recorder states it";
        let lines = wrapped(text, 11, 120.0);
        assert!(lines.len() > 2 && lines.iter().all(|line| width(line, 11) <= 120.0), "{lines:?}");
        assert_eq!(lines.join(" "), text);
        assert_eq!(wrapped("inseparable", 11, 10.0), ["inseparable"]);
    }
}
