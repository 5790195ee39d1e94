//! `seabearing card`: SD cards of recorders, prepared before a deployment and looked at after it.

use crate::card::blank::{self, Blank};
use crate::card::{self, CardFile, Content};
use crate::progress;
use crate::record::utc as utc_text;
use crate::station::Station;
use anyhow::{Context, Result, bail};
use seabearing_core::config::Clips;
use seabearing_firmware::card::{PAGE, PAGE_SECTORS, SECTOR, layout};
use serde_json::json;
use std::fs::{File, OpenOptions};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use time::{Duration, OffsetDateTime};

/// Arguments of `seabearing card`.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Subcommand,
}

#[derive(clap::Subcommand)]
enum Subcommand {
    /// Lay out the files that a recorder will fill
    Prepare(PrepareArgs),
    /// What is on a card
    Check(CheckArgs),
}

#[derive(clap::Args)]
#[command(after_help = "Examples:\n  \
    seabearing card prepare card.img --size-gb 1\n  \
    seabearing card prepare /media/card --files 60 --station east.toml")]
struct PrepareArgs {
    /// A folder of a card that is empty and formatted as FAT32, or an image: a file, or the card's device, which is formatted
    #[arg(value_name = "FOLDER|IMAGE")]
    card: PathBuf,
    /// Length of a new image, GB
    #[arg(long, value_name = "GB")]
    size_gb: Option<f64>,
    /// How many files; in an image as many as fit [default there]
    #[arg(long, value_name = "N")]
    files: Option<u32>,
    /// Minutes of sound that a file holds; a recorder begins a new one at each start [default: 10, or a clip's where the station
    /// keeps clips]
    #[arg(long, value_name = "MINUTES")]
    minutes: Option<f64>,
    /// Station whose sampling rate and clips it is for [default: 64 kHz, all sound]
    #[arg(long, value_name = "STATION.toml", value_parser = super::input())]
    station: Option<PathBuf>,
    /// Write over a device or an image that is there: all that is on it is lost
    #[arg(long)]
    erase: bool,
}

#[derive(clap::Args)]
#[command(after_help = "Example:\n  seabearing card check card.img")]
struct CheckArgs {
    /// Folder where the card is mounted, or its image
    #[arg(value_name = "FOLDER|IMAGE")]
    card: PathBuf,
    /// One JSON record for each file that is used
    #[arg(long)]
    json: bool,
}

/// Runs the command.
///
/// # Errors
/// One line for a person.
pub fn run(args: Args) -> Result<()> {
    match args.command {
        Subcommand::Prepare(args) => prepare(&args),
        Subcommand::Check(args) => check(&args),
    }
}

fn prepare(args: &PrepareArgs) -> Result<()> {
    let (rate_hz, clips) = match &args.station {
        Some(path) => {
            let config = Station::of_recorder(path)?.config;
            (config.rate_hz.round() as u32, config.clips)
        }
        None => (64_000, Clips::default()),
    };
    let minutes = args.minutes.unwrap_or(card::file_s(clips) / 60.0);
    let bytes = minutes * 60.0 * f64::from(rate_hz) * layout::FRAME_BYTES as f64 + SECTOR as f64;
    if !(bytes > 0.0 && bytes < f64::from(layout::MOST_PAGES - 2) * PAGE as f64) {
        bail!("--minutes {minutes}: a file of a card is shorter than 4 GB");
    }
    let pages = ((bytes / PAGE as f64).ceil() as u32 + 1).max(layout::LEAST_PAGES);
    if args.card.is_dir() {
        let Some(files) = args.files else {
            super::mistake!("--files says how many are to be made in a folder")
        };
        return in_folder(&args.card, files, pages, rate_hz);
    }
    in_image(args, pages, rate_hz)
}

fn in_folder(folder: &Path, files: u32, pages: u32, rate_hz: u32) -> Result<()> {
    let most = seabearing_firmware::card::search::MOST_FILES as u32;
    if files == 0 || files > most {
        super::mistake!("--files {files}: a recorder looks at {most}");
    }
    let bar = progress::bar(u64::from(files) * u64::from(pages), "pages");
    for number in 1..=files {
        let path = folder.join(card::name(number));
        let cannot = || format!("cannot write {}", path.display());
        let mut file = OpenOptions::new()
            .write(true)
            .create_new(true)
            .open(&path)
            .with_context(|| format!("{}: there already? prepare an empty card", path.display()))?;
        // Written, not left out: what is not written is not sure to be zeros, and may be in pieces.
        for _ in 0..pages {
            file.write_all(&[0; PAGE]).with_context(cannot)?;
            bar.inc(1);
        }
        for (sector, bytes) in blank::unused(number, pages, rate_hz) {
            put(&mut file, sector, &bytes).with_context(cannot)?;
        }
        file.sync_all().with_context(cannot)?;
    }
    bar.finish_and_clear();
    said(files, pages, rate_hz)
}

fn in_image(args: &PrepareArgs, pages: u32, rate_hz: u32) -> Result<()> {
    let path = &args.card;
    let cannot = || format!("cannot write {}", path.display());
    let there = path.exists();
    if there && !args.erase {
        bail!("{}: is there already; --erase writes over all that is on it", path.display());
    }
    let length = match args.size_gb {
        Some(gb) if gb > 0.0 && gb <= 2000.0 => (gb * 1e9) as u64,
        Some(gb) => super::mistake!("--size-gb {gb}: 0.3 to 2000 were expected"),
        None if there => {
            let mut old = File::open(path).with_context(cannot)?;
            old.seek(SeekFrom::End(0)).with_context(cannot)?
        }
        None => bail!("{}: no folder, image or device is there; --size-gb makes a new image", path.display()),
    };
    let sectors = u32::try_from(length / SECTOR as u64).context("a card has less than 2 TB")?;
    let blank = Blank::new(sectors, args.files, pages, rate_hz)?;
    let mut file =
        OpenOptions::new().write(true).create(true).truncate(false).open(path).with_context(cannot)?;
    if there {
        erase(&mut file, length).with_context(cannot)?;
    } else {
        file.set_len(u64::from(blank.sectors) * SECTOR as u64).with_context(cannot)?;
    }
    blank.write(|sector, bytes| put(&mut file, sector, bytes).with_context(cannot))?;
    file.sync_all().with_context(cannot)?;
    said(blank.files, pages, rate_hz)
}

/// Writes zeros all over.
fn erase(file: &mut File, length: u64) -> std::io::Result<()> {
    const CHUNK: usize = 1 << 20;
    let zeros = vec![0; CHUNK];
    let bar = progress::bar(length / CHUNK as u64, "MiB");
    file.seek(SeekFrom::Start(0))?;
    let mut left = length;
    while left > 0 {
        let now = left.min(CHUNK as u64);
        file.write_all(zeros.get(..now as usize).unwrap_or_default())?;
        left -= now;
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(())
}

fn put(file: &mut File, sector: u32, bytes: &[u8; SECTOR]) -> std::io::Result<()> {
    file.seek(SeekFrom::Start(u64::from(sector) * SECTOR as u64))?;
    file.write_all(bytes)
}

fn said(files: u32, pages: u32, rate_hz: u32) -> Result<()> {
    let extent = layout::Extent { first: 0, pages };
    let seconds = f64::from(files) * f64::from(extent.frames()) / f64::from(rate_hz);
    writeln!(
        std::io::stdout(),
        "{files} files of {:.1} MB: {:.1} hours of sound at {rate_hz} Hz",
        f64::from(pages * PAGE_SECTORS) * SECTOR as f64 / 1e6,
        seconds / 3600.0
    )?;
    Ok(())
}

fn check(args: &CheckArgs) -> Result<()> {
    let files = card::files(&args.card)?;
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    let mut unused = 0;
    let mut damaged = 0;
    for file in &files {
        match &file.content {
            Content::Unused => unused += 1,
            Content::Damaged(why) => {
                damaged += 1;
                log::warn!("{}: {why}", card::name(file.number));
            }
            Content::Sound(kept) if args.json => writeln!(out, "{}", record(file, kept))?,
            Content::Sound(kept) => writeln!(out, "{}", line(file, kept))?,
        }
    }
    if !args.json {
        writeln!(out, "{} files, {unused} unused", files.len())?;
    }
    out.flush()?;
    if damaged > 0 { bail!("{damaged} of {} files cannot be read", files.len()) } else { Ok(()) }
}

/// When a sample was, RFC 3339.
fn utc(kept: &card::kept::Kept, index: u64) -> Option<String> {
    let us = kept.utc_us(index as i64)?;
    OffsetDateTime::UNIX_EPOCH.checked_add(Duration::microseconds(us.round() as i64)).map(utc_text)
}

fn missing(kept: &card::kept::Kept) -> u64 {
    kept.gaps.iter().map(|gap| gap.count).sum()
}

fn record(file: &CardFile, kept: &card::kept::Kept) -> serde_json::Value {
    let label = &kept.label;
    json!({
        "type": "card_file", "file": card::name(file.number), "station": label.station, "start": label.session,
        "rate_hz": label.rate_hz, "first_index": label.first_index, "end_index": kept.end_index(),
        "instants": kept.frames, "missing": missing(kept), "gaps": kept.gaps.len(), "complete": kept.closed,
        "untold": kept.untold, "lost": kept.lost, "clips": kept.clips, "detections": kept.detections,
        "first_detection_index": kept.first_detection,
        "utc_first_detection": kept.first_detection.and_then(|index| utc(kept, index)),
        "utc": utc(kept, label.first_index), "utc_end": utc(kept, kept.end_index()),
    })
}

fn line(file: &CardFile, kept: &card::kept::Kept) -> String {
    let label = &kept.label;
    let when = utc(kept, label.first_index).unwrap_or_else(|| "time unknown".to_owned());
    let end = if kept.closed { "ended" } else { "cut off" };
    let holes = match kept.gaps.len() {
        0 => "nothing missing".to_owned(),
        n => format!("{} instants missing in {n} places", missing(kept)),
    };
    let heard = match kept.first_detection {
        Some(index) => format!("; {} detections, the first at sample {index}", kept.detections),
        None => String::new(),
    };
    format!(
        "{}  station {} start {}  samples {} to {}  {when}, {:.1} s, {end}; {holes}{heard}",
        card::name(file.number),
        label.station,
        label.session,
        label.first_index,
        kept.end_index(),
        f64::from(kept.frames) / f64::from(label.rate_hz.max(1)),
    )
}
