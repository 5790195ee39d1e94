//! As much of an ELF file as the checks need: sections, symbols, and who calls whom in Thumb code.

use crate::thumb::{self, Step};
use anyhow::{Context, Result, bail};
use std::path::Path;

/// A section that occupies memory or not.
pub struct Section {
    /// Its name.
    pub name: String,
    /// Loaded or cleared at start.
    pub allocated: bool,
    /// Has bytes in the file.
    pub in_file: bool,
    /// Its address.
    pub address: u32,
    /// Its size in bytes.
    pub size: u32,
    offset: usize,
    kind: u32,
    link: usize,
}

/// A function or object.
pub struct Symbol {
    /// Its mangled name.
    pub name: String,
    /// Its address; of a function without the Thumb bit.
    pub address: u32,
    /// Its size in bytes.
    pub size: u32,
    /// Whether it is a function.
    pub function: bool,
}

/// A call or jump.
pub struct Call {
    /// Address of the instruction.
    pub from: u32,
    /// Address it goes to.
    pub to: u32,
}

/// A little-endian 32-bit image.
pub struct Elf {
    bytes: Vec<u8>,
    /// Its sections.
    pub sections: Vec<Section>,
}

impl Elf {
    /// Reads the headers.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?;
        if !bytes.starts_with(b"\x7fELF\x01\x01") {
            bail!("{} is no 32-bit little-endian ELF file", path.display());
        }
        let mut elf = Self { bytes, sections: Vec::new() };
        let table = elf.word(0x20) as usize;
        let (entry, count, names) =
            (elf.half(0x2e) as usize, elf.half(0x30) as usize, elf.half(0x32) as usize);
        let names = elf.word(table + names * entry + 16) as usize;
        for at in (0..count).map(|i| table + i * entry) {
            let kind = elf.word(at + 4);
            let section = Section {
                name: elf.text(names + elf.word(at) as usize),
                allocated: elf.word(at + 8) & 2 != 0,
                in_file: kind != 8,
                address: elf.word(at + 12),
                size: elf.word(at + 20),
                offset: elf.word(at + 16) as usize,
                kind,
                link: elf.word(at + 24) as usize,
            };
            elf.sections.push(section);
        }
        Ok(elf)
    }

    /// Bytes of flash: everything with content, initial values of statics included.
    pub fn flash(&self) -> u32 {
        self.sections.iter().filter(|s| s.allocated && s.in_file).map(|s| s.size).sum()
    }

    /// Bytes of statics: the allocated sections at RAM addresses.
    pub fn statics(&self) -> u32 {
        const RAM: u32 = 0x2000_0000;
        self.sections.iter().filter(|s| s.allocated && s.address >= RAM).map(|s| s.size).sum()
    }

    /// Bytes of statics in the memory that begins at this address and ends before the next whose lowest 24 bits are zeros.
    pub fn statics_from(&self, memory: u32) -> u32 {
        self.sections.iter().filter(|s| s.allocated && s.address >> 24 == memory >> 24).map(|s| s.size).sum()
    }

    /// The symbol table.
    pub fn symbols(&self) -> Vec<Symbol> {
        const SYMBOL_TABLE: u32 = 2;
        let Some(table) = self.sections.iter().find(|s| s.kind == SYMBOL_TABLE) else { return Vec::new() };
        let names = self.sections.get(table.link).map_or(0, |s| s.offset);
        let entries = (0..table.size as usize / 16).map(|i| table.offset + i * 16);
        entries
            .map(|at| {
                let function = self.bytes.get(at + 12).is_some_and(|info| info & 15 == 2);
                let address = self.word(at + 4);
                Symbol {
                    name: self.text(names + self.word(at) as usize),
                    address: if function { address & !1 } else { address },
                    size: self.word(at + 8),
                    function,
                }
            })
            .collect()
    }

    /// Every `BL` and `B.W` of the code. Data between functions may look like one: check the destination.
    pub fn calls(&self) -> Vec<Call> {
        let (address, code) = self.code();
        let pairs = code.windows(2).zip((address..).step_by(2)).filter(|(pair, _)| thumb::is_wide(pair[0]));
        pairs
            .filter_map(|(pair, from)| match thumb::step(from, pair[0], pair[1]) {
                Step::Calls(to) | Step::Goes(to) => Some(Call { from, to }),
                _ => None,
            })
            .collect()
    }

    /// The code's address and its half words.
    pub fn code(&self) -> (u32, Vec<u16>) {
        let Some(text) = self.sections.iter().find(|s| s.name == ".text") else { return (0, Vec::new()) };
        let halves = (0..text.size as usize / 2).map(|i| self.half(text.offset + 2 * i)).collect();
        (text.address, halves)
    }

    /// The words of the vector table: the first value of the stack pointer, then what is called at reset, faults and interrupts.
    pub fn vectors(&self) -> Vec<u32> {
        let Some(table) = self.sections.iter().find(|s| s.name == ".vector_table") else { return Vec::new() };
        (0..table.size as usize / 4).map(|i| self.word(table.offset + 4 * i)).collect()
    }

    fn half(&self, at: usize) -> u16 {
        self.bytes.get(at..at + 2).map_or(0, |b| u16::from_le_bytes([b[0], b[1]]))
    }

    fn word(&self, at: usize) -> u32 {
        u32::from(self.half(at)) | u32::from(self.half(at + 2)) << 16
    }

    fn text(&self, at: usize) -> String {
        let bytes = self.bytes.get(at..).unwrap_or_default();
        let end = bytes.iter().position(|b| *b == 0).unwrap_or(bytes.len());
        String::from_utf8_lossy(&bytes[..end]).into_owned()
    }
}
