//! The image that records sound rehearsed: its card slow, full, broken, gone, and cut from its power.

use super::cases::{Case, case, linked};
use super::judge::Wanted;
use super::{COST, Row, Stage, all, costs};
use crate::board::{InjectedFault, Setup, blank, mix, sound};
use anyhow::Result;
use seabearing_core::wire::{FaultCode, Message};

/// Files of a card, and pages of each: 5.4 s of sound at 64 kHz.
const CARD: (u32, u32) = (6, 256);
/// The same of one that is full after 1.4 s.
const SMALL: (u32, u32) = (1, 64);
/// When sound is on its way to the card, whose start takes 0.2 s.
const SOUND_S: f64 = 0.8;
/// Sound that may wait for the card when everything ends: the ring, s.
const UNTAKEN_S: f64 = 0.6;
/// Sectors written in a second and a half.
const SHORT_RUN: u64 = 1800;

/// One thing done to the board, and what card is in its holder.
struct CardCase {
    case: Case,
    card: Option<(u32, u32)>,
    /// Sound may be missing, as it was told.
    misses: bool,
}

fn cases(cuts: u64) -> Vec<CardCase> {
    let [absent, errors, slow] = [1, 3, 4].map(Wanted::Card);
    let (back, full) = (Wanted::Fault(FaultCode::CardBack, None), Wanted::Fault(FaultCode::CardFull, None));
    let of = |name: &str, faults: &[InjectedFault], event_s, seconds, wanted: &[Wanted]| CardCase {
        case: linked("card", case(name, faults, event_s, seconds, wanted)),
        card: Some(CARD),
        misses: false,
    };
    let misses = |case: CardCase| CardCase { misses: true, ..case };
    let stall = |s| InjectedFault::CardStall(SOUND_S, s);
    let pulled = InjectedFault::CardPulled(SOUND_S, 0.5);
    let broken = InjectedFault::CardErrors(SOUND_S, 0.5);
    let none = of("none in its holder", &[], 0.0, 1.0, &[absent]);
    let small = of("full after 1.4 s", &[], 0.0, 2.2, &[full]);
    let mut cases = vec![
        of("well", &[], 0.0, 2.2, &[]),
        of("busy for 0.5 s", &[stall(0.5)], SOUND_S, 2.2, &[]),
        misses(of("busy for 0.8 s", &[stall(0.8)], SOUND_S, 2.5, &[slow, back])),
        misses(of(
            "busy for 0.4 s, the converter without supply for 0.1 s of it",
            &[stall(0.4), InjectedFault::ConverterDead(SOUND_S + 0.1, 0.1)],
            SOUND_S,
            2.2,
            &[Wanted::Fault(FaultCode::ConverterRestarted, None)],
        )),
        of(
            "busy for 0.4 s, reset pin in its midst",
            &[stall(0.4), InjectedFault::PinReset(SOUND_S + 0.2)],
            SOUND_S,
            2.5,
            &[Wanted::Start(3)],
        ),
        // Between two writes it does not answer, within one it makes errors.
        misses(of(
            "pulled for 0.5 s",
            &[pulled],
            SOUND_S,
            3.2,
            &[Wanted::Fault(FaultCode::CardFailed, None), back],
        )),
        misses(of("errors for 0.5 s", &[broken], SOUND_S, 3.2, &[errors, back])),
        CardCase { card: None, ..none },
        CardCase { card: Some(SMALL), ..small },
        of("reset pin", &[InjectedFault::PinReset(SOUND_S)], SOUND_S, 2.2, &[Wanted::Start(3)]),
    ];
    cases.extend((0..cuts).map(|n| {
        let (from, to) = (n * SHORT_RUN / cuts, (n + 1) * SHORT_RUN / cuts);
        let sector = from + mix(n) % (to - from).max(1);
        let name = format!("power cut in the middle of sector {sector} written");
        of(&name, &[InjectedFault::CardCut(sector)], 0.0, 2.2, &[Wanted::Start(0)])
    }));
    cases
}

impl Stage<'_> {
    /// Everything about the card; power is cut in the middle of so many sectors. The image whose records wait is one that
    /// records sound.
    ///
    /// # Errors
    /// As of [`Stage::rehearse`].
    pub fn rehearse_card(&self, cuts: u64, say: impl FnMut(&Row)) -> Result<Vec<Row>> {
        let cases = cases(cuts);
        let play = |n: usize| match cases.get(n) {
            Some(case) => self.judge_card(case).map(|row| vec![row]),
            None => self.card_pace().map(|row| vec![row]),
        };
        all(cases.len() + 1, play, say)
    }

    fn with_card(&self, setup: &Setup, card: Option<(u32, u32)>) -> Result<Setup> {
        let card = card.map(|(files, pages)| blank(files, pages, self.rate_hz)).transpose()?;
        Ok(Setup { card, ..setup.clone() })
    }

    fn judge_card(&self, case: &CardCase) -> Result<Row> {
        let setup = self.with_card(&case.case.setup, case.card)?;
        let (mut row, report, off) = self.judge_with(&Case { setup, ..case.case.clone() })?;
        if report.card.is_none() {
            return Ok(row);
        }
        let sound = sound(&report, self.blob, off)?;
        let told: u64 = report
            .said
            .iter()
            .filter_map(|said| match said.message {
                // What the card did not take, what there was none of, and what came damaged.
                Message::Fault(f)
                    if matches!(
                        f.code,
                        FaultCode::CardBack | FaultCode::ConverterRestarted | FaultCode::Invalid
                    ) =>
                {
                    u64::try_from(f.value).ok()
                }
                _ => None,
            })
            .sum();
        let full = case.card == Some(SMALL);
        let late = !full && sound.untaken > (UNTAKEN_S * self.rate_hz) as u64;
        let words = match (sound.wrong, sound.missing) {
            (0, _) if late => "SOUND NOT TAKEN".to_owned(),
            (0, 0) => "sound whole".to_owned(),
            (0, missing) if case.misses && missing <= told => "sound whole but for what was told".to_owned(),
            (0, missing) => format!("SOUND MISSING ({missing} instants, {told} told)"),
            (wrong, _) => format!("WRONG SOUND ({wrong} instants)"),
        };
        row.right &= words.starts_with("sound whole") && sound.instants > 0;
        row.outcome = [row.outcome.as_str(), &words]
            .iter()
            .filter(|w| !w.is_empty())
            .copied()
            .collect::<Vec<_>>()
            .join("; ");
        Ok(row)
    }

    /// With the flash as slow as it may be, at the cost that is asked for: nothing is lost, and most of the time it sleeps.
    fn card_pace(&self) -> Result<Row> {
        const SECONDS: f64 = 4.6;
        let setup = Setup { costs: costs(COST.0), link: true, ..Setup::default() };
        let report = self.play(SECONDS, &self.with_card(&setup, Some(CARD))?)?;
        let difference = report.difference(self.blob)?;
        let sound = sound(&report, self.blob, 0)?;
        let right = report.lost == 0
            && report.delivered == report.converted
            && report.idle >= super::LEAST_IDLE
            && difference.is_none()
            && (sound.missing, sound.wrong) == (0, 0);
        let same = difference.unwrap_or("the host's records".to_owned());
        let (lost, idle) = (report.lost, report.idle * 100.0);
        let outcome = format!(
            "{lost} of {} lost; asleep {idle:.0} %; {same}; of the sound {} missing, {} wrong",
            report.converted, sound.missing, sound.wrong
        );
        let case = format!("card: {SECONDS} s at {} cycles, two sectors erased meanwhile", COST.0);
        Ok(Row { case, told: String::new(), outcome, right })
    }
}
