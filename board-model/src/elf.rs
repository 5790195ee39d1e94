//! Images: what is loaded, and the names of functions.

use crate::memory::Memory;

/// A piece of an image with the address it is loaded at.
#[derive(Debug, Clone)]
struct Segment {
    address: u32,
    bytes: Vec<u8>,
}

/// A firmware image.
#[derive(Debug, Clone)]
pub struct Image {
    segments: Vec<Segment>,
    /// Functions by address: address, size, name.
    functions: Vec<(u32, u32, String)>,
    objects: Vec<(String, u32)>,
}

struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn half(&self, at: usize) -> Option<usize> {
        self.0.get(at..at + 2).map(|b| usize::from(u16::from_le_bytes([b[0], b[1]])))
    }
    fn word(&self, at: usize) -> Option<u32> {
        self.0.get(at..at + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
    }
    fn text(&self, at: usize) -> String {
        let bytes = self.0.get(at..).unwrap_or_default();
        String::from_utf8_lossy(bytes.split(|b| *b == 0).next().unwrap_or_default()).into_owned()
    }
}

impl Image {
    /// Reads a 32-bit little-endian ELF file for ARM.
    ///
    /// # Errors
    /// One line that says what is wrong with it.
    pub fn parse(file: &[u8]) -> Result<Self, String> {
        const ARM: usize = 40;
        let bytes = Bytes(file);
        if !file.starts_with(b"\x7fELF\x01\x01") || bytes.half(18) != Some(ARM) {
            return Err("no 32-bit little-endian ELF file for ARM".to_owned());
        }
        let mut image = Self { segments: Vec::new(), functions: Vec::new(), objects: Vec::new() };
        image.read(&bytes).ok_or("the ELF file ends within its tables")?;
        if image.segments.is_empty() {
            return Err("the ELF file holds nothing to load".to_owned());
        }
        Ok(image)
    }

    /// Bytes at an address, without names.
    pub fn raw(address: u32, bytes: Vec<u8>) -> Self {
        Self { segments: vec![Segment { address, bytes }], functions: Vec::new(), objects: Vec::new() }
    }

    fn read(&mut self, bytes: &Bytes<'_>) -> Option<()> {
        const LOAD: u32 = 1;
        const SYMBOLS: u32 = 2;
        let (programs, size, count) = (bytes.word(28)? as usize, bytes.half(42)?, bytes.half(44)?);
        for at in (0..count).map(|i| programs + i * size) {
            let (offset, address, length) =
                (bytes.word(at + 4)? as usize, bytes.word(at + 12)?, bytes.word(at + 16)? as usize);
            if bytes.word(at)? == LOAD && length > 0 {
                let content = bytes.0.get(offset..offset + length)?.to_vec();
                self.segments.push(Segment { address, bytes: content });
            }
        }
        let (sections, size, count) = (bytes.word(32)? as usize, bytes.half(46)?, bytes.half(48)?);
        for at in (0..count).map(|i| sections + i * size) {
            if bytes.word(at + 4)? != SYMBOLS {
                continue;
            }
            let strings = bytes.word(sections + bytes.word(at + 24)? as usize * size + 16)? as usize;
            let (table, length) = (bytes.word(at + 16)? as usize, bytes.word(at + 20)? as usize);
            for symbol in (0..length / 16).map(|i| table + i * 16) {
                let name = || Some(bytes.text(strings + bytes.word(symbol)? as usize));
                match bytes.0.get(symbol + 12)? & 15 {
                    2 => {
                        self.functions.push((bytes.word(symbol + 4)? & !1, bytes.word(symbol + 8)?, name()?))
                    }
                    0 | 1 => self.objects.push((name()?, bytes.word(symbol + 4)?)),
                    _ => {}
                }
            }
        }
        self.functions.sort();
        Some(())
    }

    /// Puts the image into memory.
    ///
    /// # Errors
    /// There is no memory where a part of it belongs.
    pub fn load(&self, memory: &mut Memory) -> Result<(), String> {
        for segment in &self.segments {
            let to = memory.bytes_mut(segment.address, segment.bytes.len() as u32).ok_or_else(|| {
                format!("the board has no memory at {:#010x}, where the image belongs", segment.address)
            })?;
            to.copy_from_slice(&segment.bytes);
        }
        Ok(())
    }

    /// The lowest address: where the vector table stands.
    pub fn start(&self) -> u32 {
        self.segments.iter().map(|s| s.address).min().unwrap_or(0)
    }

    /// The function at an address.
    pub fn function(&self, address: u32) -> Option<&str> {
        let after = self.functions.partition_point(|f| f.0 <= address);
        let (start, size, name) = self.functions.get(after.checked_sub(1)?)?;
        (address - start < (*size).max(2)).then_some(name)
    }

    /// Address of the first function in whose name this stands.
    pub fn address_of(&self, part: &str) -> Option<u32> {
        self.functions.iter().find(|f| f.2.contains(part)).map(|f| f.0)
    }

    /// Address of the first object whose name contains this.
    pub fn object(&self, part: &str) -> Option<u32> {
        self.objects.iter().find(|o| o.0.contains(part)).map(|o| o.1)
    }

    /// Value of an object's symbol.
    pub fn symbol(&self, name: &str) -> Option<u32> {
        self.objects.iter().find(|o| o.0 == name).map(|o| o.1)
    }
}
