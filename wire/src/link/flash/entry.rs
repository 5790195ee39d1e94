//! What stands in the words of a sector: entries of a head word and as many more as they need.

use super::{Flash, WORD_BYTES, Word};
use crate::link::store::{CLASSES, Class, Ledger, PerClass, RECORD_BYTES};

/// Bytes of an entry's text that stand in its head word, after the head itself.
const IN_HEAD: usize = WORD_BYTES - HEAD;
const HEAD: usize = 20;
/// Bytes of a ledger as text: log, boots, ordinal, and three numbers of each class.
const LEDGER: usize = 16 + 12 * CLASSES;

/// What an entry says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Kind {
    /// The sector was erased after the sector of this sequence number was opened.
    Blank = 0xb1,
    /// The sector was opened with this sequence number; text: the ledger of that moment.
    Opened = 0x0e,
    /// A record: number, ordinal, boot; text: the record.
    Record = 0x5c,
    /// The same, brought here from a sector that was erased.
    Moved = 0x3d,
    /// A class's next number, its oldest kept, its losses; text: the next ordinal.
    Mark = 0x96,
    /// The software has started for this time, with this log, if there is one.
    Start = 0x69,
}

impl Kind {
    fn of(byte: u8) -> Option<Self> {
        let all = [Self::Blank, Self::Opened, Self::Record, Self::Moved, Self::Mark, Self::Start];
        all.into_iter().find(|kind| *kind as u8 == byte)
    }
}

/// The head of an entry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Head {
    pub kind: Kind,
    pub class: u8,
    /// Bytes of its text.
    pub length: u8,
    pub numbers: [u32; 3],
}

/// What is found at a place in a sector.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Found {
    /// Nothing was written from here on.
    End,
    /// Something cut off, of so many words.
    Broken(u16),
    /// A head, of an entry of so many words; whether its text is whole is not known yet.
    Entry(Head, u16),
}

/// Words of an entry with a text of so many bytes.
pub(super) const fn words(length: usize) -> u16 {
    1 + length.saturating_sub(IN_HEAD).div_ceil(WORD_BYTES) as u16
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    bytes.get(at..).and_then(|b| b.first_chunk()).map_or(0, |b| u32::from_le_bytes(*b))
}

fn put(bytes: &mut [u8], at: usize, from: &[u8]) {
    for (to, from) in bytes.iter_mut().skip(at).zip(from) {
        *to = *from;
    }
}

/// Checks head and text together.
fn checksum(head: &[u8], text: &[u8]) -> u32 {
    let mut digest = crate::frame::CRC.digest();
    digest.update(head);
    digest.update(text);
    digest.finalize()
}

/// The head at a place.
pub(super) fn look<F: Flash>(flash: &F, sector: u8, at: u16) -> Found {
    if at >= F::WORDS {
        return Found::End;
    }
    let Some(word) = flash.read(sector, at) else { return Found::Broken(1) };
    if word == super::ERASED {
        return Found::End;
    }
    let [kind, class, length, _, ..] = word;
    let fits = usize::from(length) <= RECORD_BYTES && words(usize::from(length)) <= F::WORDS - at;
    let Some(kind) = Kind::of(kind).filter(|_| fits) else { return Found::Broken(1) };
    let numbers = [u32_at(&word, 4), u32_at(&word, 8), u32_at(&word, 12)];
    Found::Entry(Head { kind, class, length, numbers }, words(usize::from(length)))
}

/// The text of the entry with this head at this place, if all of it is as it was written.
pub(super) fn text<F: Flash>(
    flash: &F,
    sector: u8,
    at: u16,
    head: &Head,
    into: &mut [u8; RECORD_BYTES],
) -> bool {
    let Some(first) = flash.read(sector, at) else { return false };
    put(into, 0, first.get(HEAD..).unwrap_or_default());
    for n in 1..words(usize::from(head.length)) {
        let Some(word) = flash.read(sector, at.saturating_add(n)) else { return false };
        put(into, IN_HEAD + usize::from(n - 1) * WORD_BYTES, &word);
    }
    let (begin, text) = (first.get(..16).unwrap_or_default(), into.get(..usize::from(head.length)));
    text.is_some_and(|text| checksum(begin, text) == u32_at(&first, 16))
}

/// Writes an entry from a place on; the caller has seen that it fits.
pub(super) fn write<F: Flash>(flash: &mut F, sector: u8, at: u16, head: &Head, text: &[u8]) {
    let mut word: Word = [0; WORD_BYTES];
    put(&mut word, 0, &[head.kind as u8, head.class, head.length, 0]);
    for (at, number) in (4..).step_by(4).zip(head.numbers) {
        put(&mut word, at, &number.to_le_bytes());
    }
    let check = checksum(word.get(..16).unwrap_or_default(), text);
    put(&mut word, 16, &check.to_le_bytes());
    put(&mut word, HEAD, text);
    flash.write(sector, at, &word);
    let rest = text.get(IN_HEAD..).unwrap_or_default();
    for (n, part) in (1u16..).zip(rest.chunks(WORD_BYTES)) {
        let mut word: Word = [0; WORD_BYTES];
        put(&mut word, 0, part);
        flash.write(sector, at.saturating_add(n), &word);
    }
}

/// A ledger as text, with how often the software has started.
pub(super) fn of_ledger(ledger: &Ledger, starts: u32) -> [u8; LEDGER] {
    let mut text = [0; LEDGER];
    let head = [ledger.log.is_some().into(), ledger.log.unwrap_or(0), starts, ledger.ordinal];
    let classes = ledger.next.iter().chain(&ledger.oldest).chain(&ledger.lost);
    for (at, number) in (0..).step_by(4).zip(head.iter().chain(classes)) {
        put(&mut text, at, &number.to_le_bytes());
    }
    text
}

/// The ledger that a text holds, and the starts.
pub(super) fn ledger(text: &[u8]) -> (Ledger, u32) {
    let class = |n: usize| -> PerClass {
        let mut of = PerClass::default();
        for (i, to) in of.iter_mut().enumerate() {
            *to = u32_at(text, 16 + 4 * (n * CLASSES + i));
        }
        of
    };
    let log = (u32_at(text, 0) != 0).then(|| u32_at(text, 4));
    let ledger = Ledger { log, ordinal: u32_at(text, 12), next: class(0), oldest: class(1), lost: class(2) };
    (ledger, u32_at(text, 8))
}

/// The class of a head, where it names one.
pub(super) fn class(head: &Head) -> Option<Class> {
    Class::from_number(head.class)
}
