//! What is undone when the command is interrupted: unfinished files, temporary folders, programs it started.
//!
//! Whoever makes such a thing registers how to undo it; the guard that comes back takes it off the list. On SIGINT,
//! SIGTERM or SIGHUP (where there is one, and unless the command was started with the signal ignored, as `nohup` does) everything listed is
//! undone, one line says so, and the command ends by that signal, as a shell expects. Work that is worth keeping as far
//! as it got asks to be told instead ([`Keeping`]): it is left to end by itself, and a second signal ends it at once.

use signal_hook::consts::{SIGINT, SIGTERM};
use std::collections::BTreeMap;
use std::io::Write;
use std::sync::atomic::{AtomicI32, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// How to undo something.
type Undo = Box<dyn FnMut() + Send>;

/// What is listed, by number.
static LISTED: Mutex<(u64, BTreeMap<u64, Undo>)> = Mutex::new((0, BTreeMap::new()));

fn listed() -> MutexGuard<'static, (u64, BTreeMap<u64, Undo>)> {
    LISTED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Something is listed as long as this lives.
#[must_use]
#[derive(Debug)]
pub struct Guard(u64);

impl Drop for Guard {
    fn drop(&mut self) {
        let undo = listed().1.remove(&self.0);
        // Dropped after the list is free again: it may own what lists or waits itself.
        drop(undo);
    }
}

/// Makes something and lists how to undo it, without an interruption in between.
///
/// # Errors
/// It cannot be made.
pub fn listing<T, E>(make: impl FnOnce() -> Result<(T, Undo), E>) -> Result<(T, Guard), E> {
    let mut list = listed();
    let (made, undo) = make()?;
    list.0 += 1;
    let number = list.0;
    list.1.insert(number, undo);
    Ok((made, Guard(number)))
}

/// How many want to end by themselves, and the signal that asks them to.
static KEEPING: AtomicUsize = AtomicUsize::new(0);
static ASKED: AtomicI32 = AtomicI32::new(0);

/// While this lives the first interruption is only told, by [`asked()`].
#[must_use]
#[derive(Debug)]
pub struct Keeping(());

impl Keeping {
    /// From now on.
    pub fn begin() -> Self {
        KEEPING.fetch_add(1, Ordering::SeqCst);
        Self(())
    }

    /// What was asked to be kept is kept. If an interruption came, says what in one line and ends the command by that signal.
    pub fn end(self, what: impl FnOnce() -> String) {
        let signal = ASKED.load(Ordering::SeqCst);
        if signal == 0 {
            return;
        }
        let mut list = listed();
        list.1.values_mut().rev().for_each(|undo| undo());
        let _ = writeln!(std::io::stderr(), "seabearing: interrupted: {}", what());
        let _ = signal_hook::low_level::emulate_default_handler(signal);
        std::process::exit(128 + signal)
    }
}

impl Drop for Keeping {
    fn drop(&mut self) {
        KEEPING.fetch_sub(1, Ordering::SeqCst);
    }
}

/// Whether the command was asked to end.
pub fn asked() -> bool {
    ASKED.load(Ordering::SeqCst) != 0
}

/// Waits for interruptions from now on, in a thread of its own.
pub fn watch() {
    // Without handlers an interruption still ends the command, and the next run clears up after it.
    let Some(mut interruption) = interruption() else { return };
    std::thread::spawn(move || {
        while let Some(signal) = interruption() {
            if KEEPING.load(Ordering::SeqCst) > 0 && ASKED.swap(signal, Ordering::SeqCst) == 0 {
                continue;
            }
            let mut list = listed();
            let unfinished = list.1.len();
            list.1.values_mut().rev().for_each(|undo| undo());
            let line = match unfinished {
                0 => "seabearing: interrupted\n",
                _ => "seabearing: interrupted; what was unfinished is removed\n",
            };
            let _ = std::io::stderr().write_all(line.as_bytes());
            // The list stays locked: nothing new is begun on the way out.
            let _ = signal_hook::low_level::emulate_default_handler(signal);
            std::process::exit(128 + signal);
        }
    });
}

/// What waits for an interruption and says which signal it was.
#[cfg(unix)]
fn interruption() -> Option<impl FnMut() -> Option<i32> + Send> {
    let ignored = ignored_signals();
    let all = [SIGINT, SIGTERM, signal_hook::consts::SIGHUP];
    let wanted = all.into_iter().filter(|s| ignored >> (s - 1) & 1 == 0);
    let mut signals = signal_hook::iterator::Signals::new(wanted).ok()?;
    Some(move || signals.forever().next())
}

/// The same where signals only raise flags: these are looked at ten times a second.
#[cfg(not(unix))]
fn interruption() -> Option<impl FnMut() -> Option<i32> + Send> {
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;
    let flags = [SIGINT, SIGTERM].map(|signal| {
        let came = Arc::new(AtomicBool::new(false));
        signal_hook::flag::register(signal, Arc::clone(&came)).ok().map(|_| (signal, came))
    });
    Some(move || {
        loop {
            let raised = flags.iter().flatten().find(|(_, came)| came.swap(false, Ordering::Relaxed));
            if let Some((signal, _)) = raised {
                return Some(*signal);
            }
            std::thread::sleep(std::time::Duration::from_millis(100));
        }
    })
}

/// Interrupts this command as Ctrl-C does, for a terminal whose keys make no signals; also where it was started to ignore
/// that of Ctrl-C, as a shell does with what it starts in the background.
pub fn raise() {
    #[cfg(unix)]
    let signal = if ignored_signals() >> (SIGINT - 1) & 1 == 1 { SIGTERM } else { SIGINT };
    #[cfg(not(unix))]
    let signal = SIGINT;
    // Without a handler the signal does what it does.
    let _ = signal_hook::low_level::raise(signal);
}

/// Ends the command early with a status, everything listed undone.
pub fn leave(status: i32) -> ! {
    let mut list = listed();
    list.1.values_mut().rev().for_each(|undo| undo());
    std::process::exit(status)
}

/// The signals this process was started to ignore, a bit each from 1 up; none where that cannot be known.
#[cfg(unix)]
fn ignored_signals() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|l| l.strip_prefix("SigIgn:"));
    mask.and_then(|m| u64::from_str_radix(m.trim(), 16).ok()).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicU32;

    #[test]
    fn what_is_finished_is_no_longer_listed() {
        static UNDONE: AtomicU32 = AtomicU32::new(0);
        let undo = || {
            Box::new(|| {
                UNDONE.fetch_add(1, Ordering::Relaxed);
            }) as Undo
        };
        let (value, guard) = listing(|| Ok::<_, ()>((7, undo()))).unwrap();
        assert_eq!(value, 7);
        assert!(listed().1.contains_key(&guard.0));
        let number = guard.0;
        drop(guard);
        assert!(!listed().1.contains_key(&number));
        assert!(listing(|| Err::<((), Undo), _>("no")).is_err());
        assert_eq!(UNDONE.load(Ordering::Relaxed), 0);
    }
}
