//! A real MQTT broker on this machine: mosquitto, where it is installed.

use anyhow::{Context, Result, bail};
use seabearing_host::beside::Beside;
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Time in which a broker must listen.
const PATIENCE: Duration = Duration::from_secs(20);

/// A broker; ended when it is dropped.
pub struct Mosquitto {
    child: Option<Beside>,
    program: PathBuf,
    folder: PathBuf,
    /// Where it listens on the loopback interface.
    pub port: u16,
}

impl Mosquitto {
    /// Where the program is.
    pub fn program() -> Option<PathBuf> {
        let path = std::env::var_os("PATH").unwrap_or_default();
        // Debian has it where only the administrator looks.
        let folders = std::env::split_paths(&path).chain(["/usr/sbin", "/usr/local/sbin"].map(PathBuf::from));
        folders.map(|folder| folder.join("mosquitto")).find(|program| program.is_file())
    }

    /// The same; where there is none, one line on standard error says what is left out.
    pub fn program_or_say(what: &str) -> Option<PathBuf> {
        let program = Self::program();
        if program.is_none() {
            eprintln!(
                "seabearing: {what}: left out, there is no mosquitto (on Debian: apt-get install --no-install-recommends mosquitto)"
            );
        }
        program
    }

    /// Starts a broker whose files are in a folder. `more`: lines of its configuration, in place of a door that is open to
    /// everybody.
    ///
    /// # Errors
    /// It cannot be started, or does not listen.
    pub fn start(program: PathBuf, folder: &Path, more: Option<&str>) -> Result<Self> {
        let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
        let kept = folder.join("kept");
        std::fs::create_dir_all(&kept)?;
        // As administrator it would become another user, whom the folder is closed to.
        let text = format!(
            "listener {port} 127.0.0.1\n{}\nuser root\nmax_inflight_messages 0\nmax_queued_messages 0\npersistence true\n\
             persistence_location {}/\n",
            more.unwrap_or("allow_anonymous true"),
            kept.display()
        );
        std::fs::write(folder.join("mosquitto.conf"), text)?;
        let mut broker = Self { child: None, program, folder: folder.to_owned(), port };
        broker.again()?;
        Ok(broker)
    }

    /// Starts it again where it was, with what it has kept.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn again(&mut self) -> Result<()> {
        let mut command = Command::new(&self.program);
        command.arg("-c").arg(self.folder.join("mosquitto.conf"));
        let log = std::fs::File::options().create(true).append(true).open(self.log())?;
        command.stdin(Stdio::null()).stdout(log.try_clone()?).stderr(log);
        let child = Beside::start(&mut command).context("cannot start mosquitto")?;
        let begun = Instant::now();
        while TcpStream::connect(("127.0.0.1", self.port)).is_err() {
            if child.ended()?.is_some() || begun.elapsed() > PATIENCE {
                bail!(
                    "mosquitto does not listen: {}",
                    std::fs::read_to_string(self.log()).unwrap_or_default()
                );
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        self.child = Some(child);
        Ok(())
    }

    /// Stops it; what it has is kept.
    pub fn stop(&mut self) {
        if let Some(child) = self.child.take() {
            child.stop();
        }
    }

    /// The file with what it says.
    pub fn log(&self) -> PathBuf {
        self.folder.join("mosquitto.log")
    }

    /// Its address with a prefix of topics.
    pub fn url(&self, prefix: &str) -> String {
        format!("mqtt://127.0.0.1:{}/{prefix}", self.port)
    }
}
