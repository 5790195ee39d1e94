//! `seabearing base send`: one command to a recorder, and its answer.

use crate::base::Base;
use crate::base::command;
use crate::base::link::{LineEvent, LineLink, Origin};
use anyhow::{Context, Result, bail};
use seabearing_core::wire::Command;
use seabearing_core::wire::link::Settings;
use serde_json::Value;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Arguments of `seabearing base send`.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  seabearing base send --serial /dev/ttyACM0 --key east.key identify\n  \
    seabearing base send --tcp 10.0.0.7:4500 --key east.key health-every 600")]
#[command(group(clap::ArgGroup::new("to").required(true).args(["serial", "tcp", "listen"])))]
#[command(group(clap::ArgGroup::new("signature").required(true).args(["key", "unsigned"])))]
pub struct Args {
    /// Serial device
    #[arg(long, value_name = "DEVICE")]
    serial: Option<String>,
    /// Speed of the serial device
    #[arg(long, default_value_t = crate::base::LINE_BAUD)]
    baud: u32,
    /// Only one end of the line can speak at a time
    #[arg(long)]
    half_duplex: bool,
    /// Connect to a recorder or a serial server
    #[arg(long, value_name = "HOST:PORT")]
    tcp: Option<String>,
    /// Wait for the recorder's connection
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<String>,
    /// File with the recorder's key: 64 hexadecimal digits
    #[arg(long, value_name = "FILE")]
    key: Option<PathBuf>,
    /// Do not sign: for a recorder without a key, which whoever reaches the line commands
    #[arg(long)]
    unsigned: bool,
    /// Seconds to wait for the recorder and for its answer
    #[arg(long, default_value_t = 60)]
    wait: u64,
    /// What the recorder is to do
    #[command(subcommand)]
    order: Order,
}

/// Commands.
#[derive(clap::Subcommand)]
enum Order {
    /// Say who it is, and how it is
    Identify,
    /// Send `Health` every so many seconds of samples; 0: only on request
    HealthEvery {
        /// Seconds
        seconds: u16,
    },
    /// Stop after the current block
    Stop,
    /// Begin a new session, where it has stopped
    Start,
}

/// Number by which the answer is known.
const TOKEN: u8 = 0x5b;

impl Order {
    fn command(&self) -> Command {
        match *self {
            Self::Identify => Command::Identify { token: TOKEN },
            Self::HealthEvery { seconds } => Command::HealthEvery { token: TOKEN, seconds },
            Self::Stop => Command::Stop { token: TOKEN },
            Self::Start => Command::Start { token: TOKEN },
        }
    }
}

/// Runs the command; what the recorder says until it has answered is printed as JSON Lines.
///
/// # Errors
/// One line for a person: the line or the key cannot be used, no recorder with a link was heard, or it did not answer.
pub fn run(args: &Args) -> Result<()> {
    let key = args.key.as_deref().map(command::key).transpose()?;
    if key.is_none() {
        eprintln!(
            "seabearing: \x1b[31mthe command is not signed: anyone who reaches the line could give it\x1b[0m"
        );
    }
    let origin = match (&args.serial, &args.tcp, &args.listen) {
        (Some(device), ..) => Origin::Serial { device: device.clone(), baud: args.baud },
        (_, Some(to), _) => Origin::Connect(to.clone()),
        (_, _, at) => Origin::Listen(at.clone().context("--listen needs an address")?),
    };
    let mut link = LineLink::open(origin.clone(), true)?;
    let mut base = Base::new(None, None);
    base.line(Settings { half_duplex: args.half_duplex, ..Settings::serial(args.baud) });
    let (begun, wait) = (Instant::now(), Duration::from_secs(args.wait));
    let (mut buffer, mut records) = (vec![0u8; 1 << 14], Vec::new());
    let mut given = false;
    while begun.elapsed() < wait {
        let event = link.read(&mut buffer)?;
        let bytes = if let LineEvent::Bytes(n) = event { &buffer[..n] } else { &[] };
        let now_us = begun.elapsed().as_micros() as u64;
        base.push_at(now_us, bytes, &mut records);
        for record in records.drain(..).filter(|_| given) {
            println!("{record}");
            if record["token"] == u64::from(TOKEN) {
                // The recorder may forget the answer now.
                send(&mut base, &mut link, now_us);
                return done(&record);
            }
        }
        given = given || base.command(key.as_ref(), &args.order.command());
        send(&mut base, &mut link, now_us);
        if event == LineEvent::End {
            bail!("{origin}: the line was closed before the recorder answered");
        }
    }
    match given {
        false => bail!("{origin}: no recorder with a link was heard in {} s", args.wait),
        true => bail!(
            "{origin}: the recorder has not answered in {} s: is this its key? (it says BadCommand where it is not)",
            args.wait
        ),
    }
}

fn send(base: &mut Base, link: &mut LineLink, now_us: u64) {
    while let Some(frame) = base.answer(now_us) {
        link.send(frame);
    }
}

fn done(reply: &Value) -> Result<()> {
    match reply["status"].as_u64() {
        Some(0) => Ok(()),
        Some(1) => bail!("the recorder has refused the command"),
        _ => bail!("the recorder does not know the command"),
    }
}
