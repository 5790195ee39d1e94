//! The terminal taken over, and given back whatever ends the program: its end, a signal, a panic.
//!
//! While it is taken, what any part of the program writes to standard error becomes lines of the event log; where standard
//! error is no terminal it is written there, too. Where it is one, the newest of these lines are said once more at the end.

use anyhow::{Context, Result};
use ratatui::crossterm::terminal::{EnterAlternateScreen, disable_raw_mode, enable_raw_mode};
use ratatui::crossterm::{cursor, execute};
use seabearing_host::interrupt::{self, Guard};
use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Ends whatever sequence was begun, leaves the second screen, shows the cursor, forgets colours.
const GIVE_BACK: &[u8] = b"\x18\x1b[?1049l\x1b[?25h\x1b[0m";
/// A terminal that takes nothing is not waited for longer than this.
const PATIENCE: Duration = Duration::from_millis(500);

/// A terminal that is taken over.
pub struct Tty {
    state: Arc<State>,
    /// Lines that were written to standard error.
    pub lines: Receiver<String>,
    _guard: Guard,
}

/// What giving back needs.
struct State {
    given_back: AtomicBool,
    stderr: Mutex<Option<stderr::Taken>>,
}

impl Tty {
    /// Takes the terminal of standard output over.
    ///
    /// # Errors
    /// Standard output takes nothing.
    pub fn take() -> Result<Self> {
        let (tell, lines) = std::sync::mpsc::sync_channel(1000);
        let state = Arc::new(State { given_back: AtomicBool::new(false), stderr: Mutex::new(None) });
        let (mine, undone) = (Arc::clone(&state), Arc::clone(&state));
        let ((), guard) = interrupt::listing(|| {
            // Without keys (no terminal to read from) the view is still one.
            let _ = enable_raw_mode();
            let mut to = out()?;
            execute!(to, EnterAlternateScreen, cursor::Hide)?;
            *mine.stderr.lock().unwrap_or_else(PoisonError::into_inner) = stderr::Taken::take(tell);
            Ok::<_, std::io::Error>(((), Box::new(move || undone.give_back()) as Box<dyn FnMut() + Send>))
        })
        .context("cannot draw on the terminal")?;
        let (usual, panicked) = (std::panic::take_hook(), Arc::downgrade(&state));
        std::panic::set_hook(Box::new(move |info| {
            if let Some(state) = panicked.upgrade() {
                state.give_back();
            }
            usual(info);
        }));
        Ok(Self { state, lines, _guard: guard })
    }

    /// Whether the terminal is somebody else's again.
    pub fn is_given_back(&self) -> bool {
        self.state.given_back.load(Ordering::SeqCst)
    }
}

impl Drop for Tty {
    fn drop(&mut self) {
        self.state.give_back();
    }
}

impl State {
    fn give_back(&self) {
        if self.given_back.swap(true, Ordering::SeqCst) {
            return;
        }
        let (told, done) = std::sync::mpsc::channel();
        // A terminal may take nothing (its flow stopped, its line dead): the program ends nevertheless.
        std::thread::spawn(move || {
            let _ = out().and_then(|mut to| to.write_all(GIVE_BACK).and_then(|()| to.flush()));
            let _ = told.send(());
        });
        let _ = done.recv_timeout(PATIENCE);
        let _ = disable_raw_mode();
        if let Some(taken) = self.stderr.lock().unwrap_or_else(PoisonError::into_inner).take() {
            for line in taken.give_back() {
                let _ = writeln!(std::io::stderr(), "{line}");
            }
        }
    }
}

/// A way to standard output of its own: no lock that somebody who waits for a slow terminal may hold.
#[cfg(unix)]
pub fn out() -> std::io::Result<std::fs::File> {
    use std::os::fd::AsFd;
    Ok(std::fs::File::from(std::io::stdout().as_fd().try_clone_to_owned()?))
}

/// Standard output.
#[cfg(not(unix))]
pub fn out() -> std::io::Result<std::io::Stdout> {
    Ok(std::io::stdout())
}

/// Waits until a terminal on a line has been sent everything.
pub fn drain() {
    #[cfg(unix)]
    let _ = rustix::termios::tcdrain(std::io::stdout());
}

/// Whether this terminal can be drawn on.
pub fn can_draw() -> bool {
    let usable = std::env::var("TERM").is_ok_and(|term| !term.is_empty() && term != "dumb");
    std::io::stdout().is_terminal() && (usable || cfg!(windows))
}

#[cfg(unix)]
mod stderr {
    //! Standard error as lines.

    use std::collections::VecDeque;
    use std::fs::File;
    use std::io::{BufRead, BufReader, IsTerminal, Write};
    use std::os::fd::{AsFd, OwnedFd};
    use std::sync::mpsc::SyncSender;
    use std::sync::{Arc, Mutex, PoisonError};

    /// Lines that are said once more.
    const AGAIN: usize = 20;

    /// Standard error, taken.
    pub struct Taken {
        own: OwnedFd,
        again: Arc<Mutex<VecDeque<String>>>,
    }

    impl Taken {
        /// Takes it; `None` where it cannot be.
        pub fn take(tell: SyncSender<String>) -> Option<Self> {
            let own = std::io::stderr().as_fd().try_clone_to_owned().ok()?;
            let mut beside =
                (!std::io::stderr().is_terminal()).then(|| own.try_clone().map(File::from).ok()).flatten();
            let (read, write) = rustix::pipe::pipe_with(rustix::pipe::PipeFlags::CLOEXEC).ok()?;
            let again = Arc::new(Mutex::new(VecDeque::new()));
            let kept = Arc::clone(&again);
            rustix::stdio::dup2_stderr(&write).ok()?;
            std::thread::spawn(move || {
                for line in BufReader::new(File::from(read)).split(b'\n').map_while(Result::ok) {
                    let line = String::from_utf8_lossy(&line).into_owned();
                    match &mut beside {
                        Some(beside) => drop(writeln!(beside, "{line}")),
                        None => {
                            let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
                            kept.push_back(line.clone());
                            if kept.len() > AGAIN {
                                kept.pop_front();
                            }
                        }
                    }
                    // Of more lines than the view takes, some are not in it.
                    let _ = tell.try_send(line);
                }
            });
            Some(Self { own, again })
        }

        /// Gives it back; the newest lines, where nobody has seen them outside the view.
        pub fn give_back(self) -> Vec<String> {
            let _ = rustix::stdio::dup2_stderr(&self.own);
            // What was written last may still be on its way; its end has been closed, and the thread reads on.
            std::thread::sleep(std::time::Duration::from_millis(20));
            self.again.lock().unwrap_or_else(PoisonError::into_inner).drain(..).collect()
        }
    }
}

#[cfg(not(unix))]
mod stderr {
    //! Standard error stays as it is.

    /// Nothing.
    pub struct Taken;

    impl Taken {
        /// Nothing is taken.
        pub fn take(_: std::sync::mpsc::SyncSender<String>) -> Option<Self> {
            None
        }

        /// Nothing is given back.
        pub fn give_back(self) -> Vec<String> {
            Vec::new()
        }
    }
}
