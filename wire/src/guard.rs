//! Commands that only the holder of a key can give, each of them once.
//!
//! A signed command is `04 counter:u64le tag:[u8;16] command`, and the tag the first 16 bytes of HMAC-SHA-256 (RFC 2104)
//! over the words `seabearing command`, the station's number, the boot, the counter and the command. A recorder takes it if
//! the tag is right for its own number and boot and the counter is above all it has taken in this boot: so what was
//! recorded on the line is worth nothing, in this boot or a later one. `docs/threat-model.md` says what that leaves open.

use crate::message::{Command, command_of};
use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;

/// A key of base station and recorder.
pub type Key = [u8; 32];

/// Number that a signed command has among commands.
pub const SIGNED: u8 = 4;
/// Longest signed command.
pub const SIGNED_BYTES: usize = HEAD + COMMAND_BYTES;

const TAG: usize = 16;
const HEAD: usize = 1 + 8 + TAG;
/// Kind, token, 16 bits as postcard writes them, and a piece of a configuration: the longest command.
pub const COMMAND_BYTES: usize = 1 + 1 + 3 + crate::configure::PIECE_BYTES;

/// Whom a command is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recipient {
    /// Number of the station.
    pub station: u16,
    /// Its boot, as its link's opening says it.
    pub boot: u32,
}

/// Decides which commands a recorder carries out.
#[derive(Clone, Debug)]
pub struct Guard {
    key: Option<Key>,
    recipient: Recipient,
    /// Counter of the newest command taken.
    newest: u64,
}

impl Guard {
    /// Takes every command: who can write on the line commands the recorder.
    pub const fn open() -> Self {
        Self { key: None, recipient: Recipient { station: 0, boot: 0 }, newest: 0 }
    }

    /// Takes what is signed with the key for this recorder in this boot.
    pub const fn keyed(key: Key, recipient: Recipient) -> Self {
        Self { key: Some(key), recipient, newest: 0 }
    }

    /// The command that these bytes are, if it is to be carried out.
    pub fn admit(&mut self, bytes: &[u8]) -> Option<Command> {
        command_of(self.open_up(bytes)?)
    }

    /// The bytes of the command that these are, if it is to be carried out.
    pub fn open_up<'a>(&mut self, bytes: &'a [u8]) -> Option<&'a [u8]> {
        let Some(key) = &self.key else { return Some(bytes) };
        let (head, command) = bytes.split_first_chunk::<HEAD>()?;
        let (kind, rest) = head.split_first()?;
        let (counter, tag) = rest.split_first_chunk::<8>()?;
        let counter = u64::from_le_bytes(*counter);
        if *kind != SIGNED || counter <= self.newest || command.len() > COMMAND_BYTES {
            return None;
        }
        mac(key, &self.recipient, counter, command)?.verify_truncated_left(tag).ok()?;
        // Of a command that nobody knows the counter is used up all the same.
        self.newest = counter;
        Some(command)
    }
}

/// The bytes of a signed command; none if the buffer is shorter than [`SIGNED_BYTES`].
pub fn sign<'a>(
    key: &Key,
    recipient: &Recipient,
    counter: u64,
    command: &Command,
    into: &'a mut [u8; SIGNED_BYTES],
) -> &'a [u8] {
    let mut buffer = [0; COMMAND_BYTES];
    sign_bytes(key, recipient, counter, crate::message::bytes_of(command, &mut buffer), into)
}

/// The same of the bytes of a command.
pub fn sign_bytes<'a>(
    key: &Key,
    recipient: &Recipient,
    counter: u64,
    command: &[u8],
    into: &'a mut [u8; SIGNED_BYTES],
) -> &'a [u8] {
    let Some(mac) = mac(key, recipient, counter, command) else { return &[] };
    let tag = mac.finalize().into_bytes();
    let from = [SIGNED].into_iter().chain(counter.to_le_bytes());
    let from = from.chain(tag.into_iter().take(TAG)).chain(command.iter().copied());
    for (to, from) in into.iter_mut().zip(from) {
        *to = from;
    }
    into.get(..HEAD + command.len()).unwrap_or(&[])
}

fn mac(key: &Key, recipient: &Recipient, counter: u64, command: &[u8]) -> Option<Hmac<Sha256>> {
    let mut mac = Hmac::<Sha256>::new_from_slice(key).ok()?;
    mac.update(b"seabearing command");
    mac.update(&recipient.station.to_le_bytes());
    mac.update(&recipient.boot.to_le_bytes());
    mac.update(&counter.to_le_bytes());
    mac.update(command);
    Some(mac)
}

#[cfg(test)]
mod tests {
    use super::*;

    const KEY: Key = [7; 32];
    const EAST: Recipient = Recipient { station: 300, boot: 5 };

    fn signed(counter: u64, command: Command) -> std::vec::Vec<u8> {
        sign(&KEY, &EAST, counter, &command, &mut [0; SIGNED_BYTES]).to_vec()
    }

    #[test]
    fn the_bytes_are_those_of_an_independent_implementation() {
        // Python: hmac.new(bytes([7]*32), b"seabearing command" + (300).to_bytes(2, "little")
        //   + (5).to_bytes(4, "little") + (9).to_bytes(8, "little") + bytes([2, 3]), "sha256").digest()[:16]
        let tag = [139, 215, 248, 0, 102, 208, 244, 233, 239, 240, 206, 25, 76, 93, 61, 115];
        let mut want = std::vec![4, 9, 0, 0, 0, 0, 0, 0, 0];
        want.extend(tag);
        want.extend([2, 3]);
        assert_eq!(signed(9, Command::Stop { token: 3 }), want);
    }

    #[test]
    fn each_command_is_taken_once_by_the_one_it_is_for_and_in_order() {
        let mut guard = Guard::keyed(KEY, EAST);
        let (first, second) = (signed(1, Command::Stop { token: 1 }), signed(2, Command::Start { token: 2 }));
        let utc = Command::Utc { token: 255, utc_us: i64::MIN, sd_us: u32::MAX };
        let longest = signed(u64::MAX, utc);
        assert!(longest.len() <= SIGNED_BYTES && SIGNED_BYTES <= crate::link::RECORD_BYTES);
        assert!(guard.admit(&[2, 1]).is_none(), "not signed");
        assert_eq!(guard.admit(&second), Some(Command::Start { token: 2 }));
        assert!(guard.admit(&second).is_none(), "replayed");
        assert!(guard.admit(&first).is_none(), "overtaken");
        for other in [Recipient { station: 301, ..EAST }, Recipient { boot: 6, ..EAST }] {
            assert!(Guard::keyed(KEY, other).admit(&longest).is_none(), "for another");
        }
        assert!(Guard::keyed([8; 32], EAST).admit(&longest).is_none(), "by another");
        assert_eq!(guard.admit(&longest), Some(utc));
        assert_eq!(Guard::open().admit(&[2, 1]), Some(Command::Stop { token: 1 }));
    }

    #[test]
    fn pieces_of_a_configuration_are_taken_once_and_never_from_an_outsider() {
        use crate::configure::Configure;
        let piece = Configure::Piece { token: 1, number: 2, bytes: [[9; 32]; 3] };
        let mut buffer = [0; COMMAND_BYTES];
        let plain = piece.encode(&mut buffer).to_vec();
        let signed = sign_bytes(&KEY, &EAST, 5, &plain, &mut [0; SIGNED_BYTES]).to_vec();
        let mut guard = Guard::keyed(KEY, EAST);
        assert_eq!(guard.open_up(&plain), None, "not signed");
        assert_eq!(guard.open_up(&signed).and_then(Configure::decode), Some(piece));
        assert_eq!(guard.open_up(&signed), None, "replayed");
        for at in 0..signed.len() {
            let mut forged = signed.clone();
            forged[at] ^= 1;
            assert_eq!(Guard::keyed(KEY, EAST).open_up(&forged), None, "{at}");
        }
    }

    #[test]
    fn a_signed_command_with_any_bit_wrong_or_cut_anywhere_is_none() {
        let good = signed(77, Command::HealthEvery { token: 3, seconds: 600 });
        for bit in 0..good.len() * 8 {
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            assert!(Guard::keyed(KEY, EAST).admit(&bad).is_none(), "bit {bit}");
        }
        for n in 0..good.len() {
            assert!(Guard::keyed(KEY, EAST).admit(&good[..n]).is_none(), "{n} bytes");
        }
        assert!(Guard::keyed(KEY, EAST).admit(&good).is_some());
    }
}
