//! Semihosting: files of the host, and leaving the emulator.

use cortex_m_semihosting::{nr, syscall, syscall1};
use seabearing_core::run::Summary;
use seabearing_core::sbraw::ReadBytes;

/// An open file or FIFO of the host.
pub struct File(usize);

impl File {
    fn open(name: &core::ffi::CStr, mode: usize) -> Option<Self> {
        let arguments = [name.as_ptr() as usize, mode, name.count_bytes()];
        // SAFETY: SYS_OPEN takes name, mode and length of the name; the name ends in a zero and outlives the call.
        let handle = unsafe { syscall(nr::OPEN, &arguments) };
        (handle != usize::MAX).then_some(Self(handle))
    }

    /// Opens for reading; waits for the writer where it is a FIFO.
    pub fn read_from(name: &core::ffi::CStr) -> Option<Self> {
        Self::open(name, nr::open::R_BINARY)
    }

    /// Opens for writing, emptying it.
    pub fn write_to(name: &core::ffi::CStr) -> Option<Self> {
        Self::open(name, nr::open::RW_TRUNC_BINARY)
    }

    /// Writes all of `bytes`; whether the host took them.
    pub fn write(&mut self, bytes: &[u8]) -> bool {
        let arguments = [self.0, bytes.as_ptr() as usize, bytes.len()];
        // SAFETY: SYS_WRITE reads `bytes.len()` bytes from a live buffer; it returns how many were not written.
        unsafe { syscall(nr::WRITE, &arguments) == 0 }
    }
}

impl ReadBytes for File {
    fn read(&mut self, bytes: &mut [u8]) -> usize {
        let mut got = 0;
        while let Some(free) = bytes.get_mut(got..).filter(|f| !f.is_empty()) {
            let arguments = [self.0, free.as_mut_ptr() as usize, free.len()];
            // SAFETY: SYS_READ fills at most `free.len()` bytes of a live buffer and returns how many it did not.
            let missing = unsafe { syscall(nr::READ, &arguments) };
            if missing >= free.len() {
                break;
            }
            got += free.len() - missing;
        }
        got
    }
}

/// The command line that the emulator was given for the firmware; zeros where there is none or a longer one.
pub fn command_line() -> [u8; 32] {
    const GET_COMMAND_LINE: usize = 0x15;
    let mut line = [0u8; 32];
    let mut arguments = [line.as_mut_ptr() as usize, line.len()];
    // SAFETY: SYS_GET_CMDLINE writes at most that many bytes, its zero included, and their number into the argument.
    unsafe { syscall1(GET_COMMAND_LINE, (&raw mut arguments) as usize) };
    core::hint::black_box(&mut line);
    line
}

/// The key of signed commands, of the file `key.bin`, where there is one.
pub fn key() -> Option<[u8; 32]> {
    let mut key = [0u8; 32];
    (File::read_from(c"key.bin")?.read(&mut key) == key.len()).then_some(key)
}

/// Leaves what the run cost in `summary.bin`: ten words `u64le` as `docs/firmware.md` lists them.
pub fn leave_summary(summary: &Summary, stack: (u32, u32), line: (u64, u64)) -> bool {
    let words = [
        summary.index,
        summary.instants,
        summary.busy_ticks,
        u64::from(summary.worst_block_ticks),
        u64::from(summary.frames),
        u64::from(summary.frames_dropped),
        u64::from(stack.0),
        u64::from(stack.1),
        line.0,
        line.1,
    ];
    leave(&words)
}

/// Leaves words in `summary.bin`; whether the host took them.
pub fn leave(words: &[u64]) -> bool {
    let Some(mut file) = File::write_to(c"summary.bin") else { return false };
    words.iter().all(|w| file.write(&w.to_le_bytes()))
}

/// One line on the host's console.
pub fn say(line: &core::ffi::CStr) {
    // SAFETY: SYS_WRITE0 reads a string up to its zero.
    unsafe { syscall1(nr::WRITE0, line.as_ptr() as usize) };
}

/// Ends the emulation as failed, with the reason on the console.
pub fn fail(line: &core::ffi::CStr) -> ! {
    say(line);
    exit(1)
}

/// Ends the emulation with a status for the host's shell.
pub fn exit(status: u32) -> ! {
    /// The reason "the application ended" of SYS_EXIT_EXTENDED.
    const APPLICATION_EXIT: usize = 0x2_0026;
    const EXIT_EXTENDED: usize = 0x20;
    let arguments = [APPLICATION_EXIT, status as usize];
    loop {
        // SAFETY: SYS_EXIT_EXTENDED takes a reason and a status, and does not return in the emulator.
        unsafe { syscall(EXIT_EXTENDED, &arguments) };
    }
}
