//! What a minute may cost on the line: with several vessels present for hours, what can wait does.
//!
//! Enters: what was sent. Leaves: whether there is room for a running track, and for what is worth less: an azigram, a second mode of the
//! range. Azimuths, the first mode, the first record of a track and its last one are always sent; running tracks come next. Bytes are those of a frame, about; the
//! health record of each minute is counted, what a configuration asks for besides (levels, spectra, health more often) is not. Cost: none.

/// Bytes a minute, health included, that are sent in the long run, and how many more may be for a while: a vessel that passes alone takes
/// more for an hour.
const MINUTE: u32 = 200;
const AT_ONCE: u32 = 2_400;

/// Bytes of frames, about, of a recorder that has run for a year: the health of a minute, one of its azimuths and ranges (32 and 39), a
/// record of a track, an azigram. In the first days each is two less.
const HEALTH: u32 = 31;
const OF_A_MINUTE: u32 = 35;
const TRACK: u32 = 79;
const AZIGRAM: u32 = 71;

/// What azigrams and second modes leave to tracks, bytes.
const FOR_TRACKS: u32 = 800;

/// What was sent beyond what the line has carried since.
#[derive(Clone, Copy, Debug)]
pub(super) struct Allowance {
    /// Bytes. Of all zeros at first, as the whole station is.
    ahead: u32,
}

impl Allowance {
    /// Nothing sent.
    pub(super) const fn new() -> Self {
        Self { ahead: 0 }
    }

    /// A minute passes, with so many azimuths and ranges.
    pub(super) fn minute(&mut self, records: u32) {
        self.ahead = (self.ahead + records * OF_A_MINUTE).saturating_sub(MINUTE - HEALTH);
    }

    /// A record of a track goes in any case.
    pub(super) fn track(&mut self) {
        self.ahead += TRACK;
    }

    /// Whether there is room for one record of each of so many tracks.
    pub(super) fn has_room_for(&self, tracks: usize) -> bool {
        self.ahead + TRACK * tracks as u32 <= AT_ONCE
    }

    /// Whether there is room for what is worth less than a track.
    pub(super) fn has_room_for_more(&self) -> bool {
        self.ahead + AZIGRAM + FOR_TRACKS <= AT_ONCE
    }

    /// Whether there is room for an azigram, which then is counted.
    pub(super) fn azigram(&mut self) -> bool {
        let room = self.has_room_for_more();
        self.ahead += if room { AZIGRAM } else { 0 };
        room
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bytes a minute over six hours with so many azimuths and ranges a minute and so many tracks, azigrams and running tracks sent.
    fn of_six_hours(records: u32, tracks: usize) -> (f64, u32, u32) {
        let mut allowance = Allowance::new();
        let (mut bytes, mut azigrams, mut running) = (0, 0, 0);
        for minute in 0..360_u32 {
            allowance.minute(records);
            bytes += HEALTH + records * OF_A_MINUTE;
            if allowance.azigram() {
                bytes += AZIGRAM;
                azigrams += 1;
            }
            if minute.is_multiple_of(5) {
                for k in 0..tracks {
                    let turn = minute as usize / 5 % tracks == k;
                    if allowance.has_room_for(if turn { 1 } else { tracks }) {
                        allowance.track();
                        bytes += TRACK;
                        running += 1;
                    }
                }
            }
        }
        (f64::from(bytes) / 360.0, azigrams, running)
    }

    #[test]
    fn all_goes_while_little_goes_on() {
        assert_eq!(of_six_hours(2, 0).1, 360);
        let (_, azigrams, running) = of_six_hours(2, 1);
        assert_eq!((azigrams, running), (360, 72));
    }

    #[test]
    fn with_several_vessels_tracks_go_before_azigrams_and_the_line_carries_what_is_promised() {
        let (bytes, azigrams, running) = of_six_hours(4, 4);
        assert!(bytes <= 200.0 + f64::from(AT_ONCE) / 360.0, "{bytes}");
        assert!(azigrams < 60, "{azigrams}");
        // Each every twenty minutes at least.
        assert!(running >= 18 * 4, "{running}");
    }

    #[test]
    fn what_must_go_is_counted_and_paid_back() {
        let mut allowance = Allowance::new();
        (0..100).for_each(|_| allowance.track());
        assert!(!allowance.has_room_for(1) && !allowance.azigram());
        (0..100).for_each(|_| allowance.minute(2));
        assert!(allowance.has_room_for(4) && allowance.azigram());
    }
}
