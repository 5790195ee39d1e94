//! Programs that this one starts and folders it needs for a while: both are gone when it ends, interrupted or not.

use crate::interrupt::{self, Guard};
use anyhow::{Context, Result, bail};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, ChildStderr, ChildStdout, Command, ExitStatus};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// How often an end is looked for.
const LOOK: Duration = Duration::from_millis(2);
/// Time in which a program that is asked to end undoes what it has not finished.
const GRACE: Duration = Duration::from_secs(2);

/// What a program's page answers to a request for a path (`http://ADDRESS/` and HTTP/1.1, for checks of our own).
///
/// # Errors
/// It does not answer, or with an error.
pub fn ask(page: &str, path: &str) -> Result<Vec<u8>> {
    let host = page.trim_start_matches("http://").trim_end_matches('/');
    let mut stream = TcpStream::connect(host).with_context(|| format!("{page} does not answer"))?;
    stream.set_read_timeout(Some(Duration::from_secs(30)))?;
    write!(stream, "GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n")?;
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer)?;
    let body = answer.windows(4).position(|w| w == b"\r\n\r\n").map_or(answer.len(), |at| at + 4);
    if !answer.starts_with(b"HTTP/1.1 200") {
        bail!("{page} {path}: {}", String::from_utf8_lossy(&answer).lines().next().unwrap_or("no answer"));
    }
    Ok(answer.split_off(body))
}

/// A program that runs beside this one; it is ended when this is dropped, and when this program is interrupted.
#[derive(Debug)]
pub struct Beside {
    child: Arc<Mutex<Child>>,
    _listed: Guard,
}

impl Beside {
    /// Starts a program.
    ///
    /// # Errors
    /// It cannot be started.
    pub fn start(command: &mut Command) -> std::io::Result<Self> {
        let (child, _listed) = interrupt::listing(|| {
            let child = Arc::new(Mutex::new(command.spawn()?));
            let other = Arc::clone(&child);
            Ok::<_, std::io::Error>((child, Box::new(move || end(&other)) as _))
        })?;
        Ok(Self { child, _listed })
    }

    /// Its number.
    pub fn id(&self) -> u32 {
        locked(&self.child).id()
    }

    /// What it prints, once, where that was asked for.
    pub fn stdout(&self) -> Option<ChildStdout> {
        locked(&self.child).stdout.take()
    }

    /// What it complains of, once, where that was asked for.
    pub fn stderr(&self) -> Option<ChildStderr> {
        locked(&self.child).stderr.take()
    }

    /// Ends it outright, as a loss of power would.
    pub fn kill(&self) {
        let mut child = locked(&self.child);
        // Nothing to do where it has ended.
        let _ = child.kill();
        let _ = child.wait();
    }

    /// Asks it to end, so that it puts in order what it has at hand; ends it outright where it takes too long.
    pub fn stop(&self) {
        end(&self.child);
    }

    /// How it ended, if it has.
    ///
    /// # Errors
    /// The system does not tell.
    pub fn ended(&self) -> std::io::Result<Option<ExitStatus>> {
        locked(&self.child).try_wait()
    }

    /// Waits for its end, without keeping an interruption from ending it.
    ///
    /// # Errors
    /// The system does not tell.
    pub fn wait(&self) -> std::io::Result<ExitStatus> {
        loop {
            if let Some(status) = self.ended()? {
                return Ok(status);
            }
            std::thread::sleep(LOOK);
        }
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        self.kill();
    }
}

fn locked(child: &Mutex<Child>) -> MutexGuard<'_, Child> {
    child.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Asks a program to end, so that it ends in its turn what it has started; then ends it.
fn end(child: &Mutex<Child>) {
    let mut child = locked(child);
    let begun = Instant::now();
    #[cfg(unix)]
    if let Some(pid) = rustix::process::Pid::from_raw(child.id().cast_signed())
        && matches!(child.try_wait(), Ok(None))
        && rustix::process::kill_process(pid, rustix::process::Signal::TERM).is_ok()
    {
        while begun.elapsed() < GRACE && matches!(child.try_wait(), Ok(None)) {
            std::thread::sleep(LOOK);
        }
    }
    let _ = child.kill();
    let _ = child.wait();
}

/// A folder for a while: removed when it is dropped, and when this program is interrupted.
#[derive(Debug)]
pub struct Folder {
    folder: TempDir,
    _listed: Guard,
}

impl Folder {
    /// An empty folder where the system keeps temporary ones.
    ///
    /// # Errors
    /// It cannot be made.
    pub fn new() -> Result<Self> {
        let make = || {
            let folder = tempfile::Builder::new().prefix("seabearing-").tempdir()?;
            let path = folder.path().to_owned();
            Ok::<_, std::io::Error>((folder, Box::new(move || drop(std::fs::remove_dir_all(&path))) as _))
        };
        let (folder, _listed) = interrupt::listing(make).context("a temporary folder")?;
        Ok(Self { folder, _listed })
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        self.folder.path()
    }
}
