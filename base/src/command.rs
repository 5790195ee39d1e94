//! Commands to a recorder: signed, over its link; unsigned only where that is asked for.

use super::Base;
use anyhow::{Context, Result, bail};
use seabearing_core::wire::guard::{COMMAND_BYTES, Key, Recipient, SIGNED_BYTES, sign_bytes};
use seabearing_core::wire::link::Class;
use seabearing_core::wire::{Command, bytes_of};
use std::path::Path;

/// Reads a key: 64 hexadecimal digits, whatever white space is around them.
///
/// # Errors
/// The file cannot be read or is none.
pub fn key(path: &Path) -> Result<Key> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let wrong = || format!("{}: 64 hexadecimal digits expected (32 random bytes)", path.display());
    let text = text.trim().as_bytes();
    let (pairs, []) = text.as_chunks::<2>() else { bail!(wrong()) };
    let digit = |c: u8| char::from(c).to_digit(16).map(|d| d as u8);
    let byte = |[high, low]: &[u8; 2]| Some(digit(*high)? << 4 | digit(*low)?);
    let bytes: Vec<u8> = pairs.iter().map(byte).collect::<Option<_>>().with_context(wrong)?;
    bytes.try_into().ok().with_context(wrong)
}

impl Base {
    /// Gives a command to the recorder that has opened its link on a connection; `false` while none has. It is signed with
    /// the key for the recorder's present boot; its counter is the time in microseconds, which goes on over restarts. A
    /// recorder that speaks without a link takes commands that are not signed.
    pub fn command(&mut self, stream: u32, key: Option<&Key>, command: &Command) -> bool {
        let mut buffer = [0; COMMAND_BYTES];
        let bytes = bytes_of(command, &mut buffer).to_vec();
        self.order(stream, key, &bytes)
    }

    /// The same of the bytes of a command.
    pub fn order(&mut self, stream: u32, key: Option<&Key>, command: &[u8]) -> bool {
        let Some(live) = self.streams.get_mut(&stream) else { return false };
        if live.stream.unlinked && key.is_none() {
            live.stream.order(command);
            return true;
        }
        let Some(session) = live.stream.peer() else { return false };
        let mut buffer = [0; SIGNED_BYTES];
        let bytes = match key {
            Some(key) => {
                let now = (time::OffsetDateTime::now_utc().unix_timestamp_nanos() / 1000) as u64;
                self.counter = now.max(self.counter + 1);
                let recipient = Recipient { station: session.station, boot: session.boot };
                sign_bytes(key, &recipient, self.counter, command, &mut buffer)
            }
            None => command,
        };
        live.stream.link().offer(Class::Health, bytes);
        true
    }

    /// Whether a recorder has been heard that speaks without a link: nothing signed reaches it.
    pub fn hears_without_link(&self) -> bool {
        self.streams.values().any(|live| live.stream.unlinked)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_64_digits_and_nothing_else() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("key");
        let digits = "0123456789abcdefFEDCBA9876543210".repeat(2);
        std::fs::write(&path, format!("{digits}\n")).unwrap();
        assert_eq!(key(&path).unwrap()[..9], [1, 0x23, 0x45, 0x67, 0x89, 0xab, 0xcd, 0xef, 0xfe]);
        for wrong in
            ["", &digits[1..], &format!("{digits}00"), &digits.replace('a', "g"), &digits.replace("01", "+1")]
        {
            std::fs::write(&path, wrong).unwrap();
            let said = format!("{:#}", key(&path).unwrap_err());
            assert!(said.contains("64 hexadecimal digits"), "{wrong}: {said}");
        }
        assert!(format!("{:#}", key(&dir.path().join("none")).unwrap_err()).contains("cannot read"));
    }
}
