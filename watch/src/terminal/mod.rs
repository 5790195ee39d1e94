//! The view of a base station on a terminal: all stations, alarms, events, in a thread of its own.
//!
//! In: records of the feed, keys. Out: the picture, drawn at most once a second by itself and at once after a key; only
//! what has changed is sent, and a terminal that takes its time gets pictures more rarely. On a terminal that cannot be
//! drawn on (`TERM=dumb`) events are printed, a line each.

pub mod board;
mod tty;
pub mod view;

use anyhow::Result;
use board::{Board, day_clock};
use ratatui::Terminal;
use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use seabearing_base::feed::{Feed, Subscription};
use seabearing_host::interrupt;
use serde_json::json;
use std::io::{BufWriter, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};
use tty::Tty;
use view::{Choice, Part, Shown};

pub use tty::can_draw;

/// Records that wait for the view.
const WAITING: usize = 20_000;
/// How often keys and records are looked at.
const TICK: Duration = Duration::from_millis(50);
/// How often the picture is drawn by itself: at most, and on the slowest line.
const DRAW: (Duration, Duration) = (Duration::from_secs(1), Duration::from_secs(30));
/// Of the time of a slow terminal so much is left to others.
const SHARE: u32 = 4;

/// A view at work.
pub struct View {
    stop: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<Result<()>>>,
}

impl View {
    /// Begins to show what a feed brings, after what is known already.
    pub fn start(board: Board, feed: &Feed) -> Self {
        let (records, feed) = (feed.subscribe(WAITING), feed.clone());
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::spawn(move || match can_draw() {
            true => show(board, &records, &feed, &stopped),
            false => print(board, &records, &stopped),
        });
        Self { stop, thread: Some(thread) }
    }

    /// Whether it has ended by itself.
    pub fn is_finished(&self) -> bool {
        self.thread.as_ref().is_some_and(std::thread::JoinHandle::is_finished)
    }

    /// Ends it and gives the terminal back; a second time does nothing.
    ///
    /// # Errors
    /// Standard output took nothing any more.
    pub fn end(&mut self) -> Result<()> {
        self.stop.store(true, Ordering::SeqCst);
        let ended = self.thread.take().map_or(Ok(Ok(())), std::thread::JoinHandle::join);
        ended.unwrap_or_else(|_| Err(anyhow::anyhow!("the view has failed")))
    }
}

impl Drop for View {
    fn drop(&mut self) {
        let _ = self.end();
    }
}

/// Date and time of day, UTC.
fn utc_now() -> String {
    let s = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64());
    let text = crate::report::rfc3339(s);
    text.as_str().and_then(|t| t.get(..19)).unwrap_or("").replace('T', " ")
}

/// Time of day, UTC.
fn clock_now() -> String {
    day_clock(SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |d| d.as_secs_f64()))
}

/// Takes what waits; `false` once the feed has ended.
fn take(
    records: &Subscription,
    board: &mut Board,
    begun: Instant,
    mut tell: impl FnMut(&board::Event),
) -> bool {
    // No more at once than fits between two looks at the keys.
    for _ in 0..200 {
        let Some(taken) = records.take_within(Duration::ZERO) else { return false };
        board.missed += taken.missed as u64;
        if taken.records.is_empty() {
            break;
        }
        let now_s = begun.elapsed().as_secs_f64();
        for record in taken.records.iter() {
            if let Some(event) = board.take(record, now_s) {
                tell(&event);
            }
        }
    }
    true
}

/// Events as lines.
fn print(mut board: Board, records: &Subscription, stop: &AtomicBool) -> Result<()> {
    let begun = Instant::now();
    loop {
        let mut lines = String::new();
        let goes_on = take(records, &mut board, begun, |event| {
            lines += &format!("{}{}\n", view::other_day(&event.day, &utc_now()), event.text);
        });
        let mut out = tty::out()?;
        out.write_all(lines.as_bytes())?;
        if !goes_on || stop.load(Ordering::SeqCst) {
            return Ok(());
        }
        std::thread::sleep(TICK);
    }
}

/// Draws until there is nothing more to show.
fn show(mut board: Board, records: &Subscription, feed: &Feed, stop: &AtomicBool) -> Result<()> {
    let begun = Instant::now();
    let tty = Tty::take()?;
    let mut terminal = Terminal::new(CrosstermBackend::new(BufWriter::new(tty::out()?)))?;
    let colour = std::env::var_os("NO_COLOR").is_none_or(|v| v.is_empty());
    let (mut choice, mut keys, mut due, mut wait) = (Choice::default(), true, begun, DRAW.0);
    while take(records, &mut board, begun, |_| {}) && !stop.load(Ordering::SeqCst) && !tty.is_given_back() {
        tty.lines
            .try_iter()
            .for_each(|line| board.note(&clock_now(), line.trim_start_matches("seabearing: ")));
        let mut touched = false;
        // A terminal without keys can still be looked at.
        keys = keys && event::poll(TICK).is_ok();
        while keys && event::poll(Duration::ZERO).unwrap_or(false) {
            match event::read() {
                Ok(Event::Key(key)) if key.kind != KeyEventKind::Release => {
                    touched = true;
                    if act(key, &mut choice, &mut board, feed) == Act::Anew {
                        terminal.clear()?;
                    }
                }
                Ok(Event::Resize(..)) => touched = true,
                Ok(_) => {}
                Err(_) => keys = false,
            }
        }
        if !keys {
            std::thread::sleep(TICK);
        }
        // On a line that is slow keys wait as well.
        if Instant::now() < due && !(touched && wait == DRAW.0) {
            continue;
        }
        let before = Instant::now();
        let shown = Shown { board: &board, now_s: begun.elapsed().as_secs_f64(), utc: &utc_now(), colour };
        terminal.draw(|frame| shown.draw(frame, &mut choice))?;
        tty::drain();
        wait = (before.elapsed() * SHARE).clamp(DRAW.0, DRAW.1);
        due = before + wait;
    }
    Ok(())
}

/// What a key asks for beyond what it chooses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Act {
    Nothing,
    /// All is drawn anew.
    Anew,
}

/// Does what a key says.
fn act(key: KeyEvent, choice: &mut Choice, board: &mut Board, feed: &Feed) -> Act {
    let page = choice.room.max(2) - 1;
    match (key.code, key.modifiers.contains(KeyModifiers::CONTROL)) {
        (KeyCode::Char('c'), true) => interrupt::raise(),
        (KeyCode::Char('l'), true) => return Act::Anew,
        (KeyCode::Tab, _) => {
            choice.part = match choice.part {
                Part::Stations if !board.alarms.is_empty() => Part::Alarms,
                Part::Stations | Part::Alarms => Part::Events,
                Part::Events => Part::Stations,
            }
        }
        (KeyCode::Char('a'), false) => acknowledge(choice, board, feed),
        (KeyCode::Char('A'), false) => {
            (0..board.alarms.len()).for_each(|_| acknowledge(&Choice::default(), board, feed));
        }
        (KeyCode::Up, _) => scroll(choice, -1),
        (KeyCode::Down, _) => scroll(choice, 1),
        (KeyCode::PageUp, _) => scroll(choice, -(page as isize)),
        (KeyCode::PageDown, _) => scroll(choice, page as isize),
        (KeyCode::Home, _) => scroll(choice, isize::MIN / 2),
        (KeyCode::End, _) => scroll(choice, isize::MAX / 2),
        _ => {}
    }
    Act::Nothing
}

/// Moves within a part; what goes too far is brought back when it is drawn.
fn scroll(choice: &mut Choice, by: isize) {
    match choice.part {
        Part::Stations => choice.station = choice.station.saturating_add_signed(by),
        Part::Alarms => choice.alarm = choice.alarm.saturating_add_signed(by),
        Part::Events => choice.back = choice.back.saturating_add_signed(-by),
    }
}

/// A person has seen the alarm chosen, or else the oldest that nobody has seen.
fn acknowledge(choice: &Choice, board: &mut Board, feed: &Feed) {
    let open = |a: &board::Alarm| !a.acknowledged && !a.asked;
    let chosen = (choice.part == Part::Alarms).then_some(choice.alarm);
    let chosen = chosen.filter(|n| board.alarms.get(*n).is_some_and(open));
    let seen = chosen.or_else(|| board.alarms.iter().position(open));
    if let Some(alarm) = seen.and_then(|n| board.alarms.get_mut(n)) {
        alarm.asked = true;
        feed.publish(vec![json!({ "type": "acknowledge", "id": alarm.id })]);
    }
}

#[cfg(test)]
mod tests;
