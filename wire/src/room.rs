//! Where postcard writes: a slice, byte by byte through two functions that are not inlined. A message's fields are pushed at two
//! hundred places, at which postcard's own slice would take a quarter of the code again.

use postcard::ser_flavors::Flavor;
use postcard::{Error, Result};
use serde::Serialize;

struct Room<'a> {
    into: &'a mut [u8],
    used: usize,
}

impl Flavor for Room<'_> {
    type Output = usize;

    #[inline(never)]
    fn try_push(&mut self, byte: u8) -> Result<()> {
        *self.into.get_mut(self.used).ok_or(Error::SerializeBufferFull)? = byte;
        self.used += 1;
        Ok(())
    }

    #[inline(never)]
    fn try_extend(&mut self, bytes: &[u8]) -> Result<()> {
        bytes.iter().try_for_each(|byte| self.try_push(*byte))
    }

    fn finalize(self) -> Result<usize> {
        Ok(self.used)
    }
}

/// The bytes of a message, in the memory given; `None` where they do not fit.
pub(crate) fn written<'a, T: Serialize>(message: &T, into: &'a mut [u8]) -> Option<&'a [u8]> {
    let used = postcard::serialize_with_flavor(message, Room { into: &mut *into, used: 0 }).ok()?;
    into.get(..used)
}
