//! A new configuration for a recorder, in pieces: begun, sent, taken. As records of the base station's link only.

use serde::{Deserialize, Serialize};

/// Number of the first of these among commands (`docs/wire.md`, section 2).
pub const FIRST: u8 = 5;
const LAST: u8 = FIRST + 2;
/// Bytes of the configuration in one piece: three flash words.
pub const PIECE_BYTES: usize = 96;

/// What a base station says of a new configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Configure {
    /// One of so many bytes follows; what was sent of another is forgotten.
    Begin {
        /// Returned in the reply.
        token: u8,
        /// Bytes of the blob.
        length: u32,
        /// Their CRC-32/ISO-HDLC.
        crc: u32,
    },
    /// The piece of this number, from 0 and in order; what is behind the blob's end is zero.
    Piece {
        /// Returned in the reply.
        token: u8,
        /// Its number.
        number: u16,
        /// Its bytes.
        bytes: [[u8; 32]; 3],
    },
    /// All pieces were sent: it is checked, and the recorder starts again with it.
    Take {
        /// Returned in the reply.
        token: u8,
    },
}

impl Configure {
    /// The token.
    pub fn token(&self) -> u8 {
        match *self {
            Self::Begin { token, .. } | Self::Piece { token, .. } | Self::Take { token } => token,
        }
    }

    /// The same with another token.
    pub fn with_token(self, token: u8) -> Self {
        match self {
            Self::Begin { length, crc, .. } => Self::Begin { token, length, crc },
            Self::Piece { number, bytes, .. } => Self::Piece { token, number, bytes },
            Self::Take { .. } => Self::Take { token },
        }
    }

    /// Its bytes as a command; none if they do not fit.
    pub fn encode<'a>(&self, into: &'a mut [u8]) -> &'a [u8] {
        let Ok(bytes) = postcard::to_slice(self, into) else { return &[] };
        if let Some(kind) = bytes.first_mut() {
            *kind = kind.saturating_add(FIRST);
        }
        bytes
    }

    /// What these bytes of a command say, if they are one of these.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let mut buffer = [0; crate::guard::COMMAND_BYTES];
        let (to, (kind, rest)) = (buffer.get_mut(..bytes.len())?, bytes.split_first()?);
        let (first, others) = to.split_first_mut()?;
        *first = kind.checked_sub(FIRST)?;
        others.iter_mut().zip(rest).for_each(|(to, from)| *to = *from);
        match postcard::take_from_bytes(to) {
            Ok((configure, [])) => Some(configure),
            _ => None,
        }
    }
}

/// The token of these bytes of a command, if they are one of these, for who only refuses them.
pub fn token_of(bytes: &[u8]) -> Option<u8> {
    match *bytes {
        [FIRST..=LAST, token, ..] => Some(token),
        _ => None,
    }
}

/// The pieces of a blob.
pub fn pieces(blob: &[u8]) -> impl Iterator<Item = [[u8; 32]; 3]> + '_ {
    blob.chunks(PIECE_BYTES).map(|chunk| {
        let mut bytes = [[0; 32]; 3];
        bytes.iter_mut().flatten().zip(chunk).for_each(|(to, from)| *to = *from);
        bytes
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_said_is_what_is_heard_and_nothing_else_is() {
        let longest = Configure::Piece { token: 255, number: u16::MAX, bytes: [[255; 32]; 3] };
        for said in
            [Configure::Begin { token: 1, length: 300, crc: u32::MAX }, longest, Configure::Take { token: 3 }]
        {
            let mut buffer = [0; crate::guard::COMMAND_BYTES];
            let bytes = said.encode(&mut buffer);
            assert_eq!(Configure::decode(bytes), Some(said));
            assert_eq!(token_of(bytes), Some(said.token()));
            assert!(crate::message::command_of(bytes).is_none());
            assert_eq!(Configure::decode(&bytes[..bytes.len() - 1]), None);
        }
        assert_eq!(Configure::decode(&[2, 3]), None);
        assert_eq!(Configure::decode(&[8, 3]), None);
        assert_eq!([&[4, 3][..], &[8, 3], &[5], &[]].map(token_of), [None; 4]);
        assert_eq!(pieces(&[7; 200]).count(), 3);
    }
}
