//! What came of a rehearsed case: what was told and how soon, and whether the records are those of the samples.

use crate::board::{BoardRun, InjectedFault, Said, host, utc_us as utc_us_of};
use anyhow::{Result, bail};
use seabearing_board_model::stm32h743::Analog;
use seabearing_core::config_blob;
use seabearing_core::utc::Times;
use seabearing_core::wait::WAITING;
use seabearing_core::wire::{Decoder, FaultCode, Hello, Message};
use seabearing_firmware::seismic::Conversion;

/// Something the board must say within the time allowed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Wanted {
    /// This fault, with this number where one is given.
    Fault(FaultCode, Option<i64>),
    /// That the card takes no sound, for this reason.
    Card(i64),
    /// A start for this reason (as in `Hello`).
    Start(u8),
    /// A start with the configuration of this hash.
    Runs(u64),
    /// A start for this reason with the configuration of this hash.
    Resumes(u8, u64),
    /// That it waits for commands.
    Waits,
    /// An answer to the command with this token.
    Reply(u8),
    /// The end of the recording.
    End,
    /// When a sample was.
    Time,
    /// The board's margins, its supply between these, mV.
    Margins(u16, u16),
    /// No such fault at all.
    Never(FaultCode),
}

impl Wanted {
    fn is(self, message: &Message) -> bool {
        match (self, message) {
            (Self::Fault(code, value), Message::Fault(f)) => {
                f.code == code && value.is_none_or(|value| f.value & i64::from(u32::MAX) == value)
            }
            (Self::Card(why), Message::Fault(f)) => f.code == FaultCode::CardFailed && f.value & 0xff == why,
            (Self::Start(cause), Message::Hello(h)) => h.reset_cause == cause && h.kind != WAITING,
            (Self::Runs(hash), Message::Hello(h)) => h.config_hash == hash && h.kind != WAITING,
            (Self::Resumes(cause, hash), Message::Hello(h)) => {
                (h.reset_cause, h.config_hash) == (cause, hash) && h.kind != WAITING
            }
            (Self::Waits, Message::Hello(h)) => h.kind == WAITING,
            (Self::Reply(token), Message::Reply(r)) => r.token == token,
            (Self::Margins(least, most), Message::Margins(m)) => {
                let near = |told: Option<u16>, mv: u16| told.is_some_and(|told| told.abs_diff(mv) <= 5);
                let analog = Analog::default();
                m.supply_mv.is_some_and(|mv| (least..=most).contains(&mv))
                    && near(m.battery_mv, (1000.0 * analog.cell_v) as u16)
                    && m.temperature_c == Some(analog.temperature_c as i8)
                    && (1..m.memory).contains(&m.memory_free)
            }
            (Self::Never(code), Message::Fault(f)) => f.code == code,
            (Self::End, Message::End(_)) | (Self::Time, Message::Time(_)) => true,
            _ => false,
        }
    }

    fn name(self) -> String {
        match self {
            Self::Fault(code, _) => format!("{code:?}"),
            Self::Card(why) => {
                let reasons = ["?", "none", "not prepared", "errors", "slow"];
                format!("CardFailed ({})", reasons.get(why as usize).unwrap_or(&"?"))
            }
            Self::Start(cause) | Self::Resumes(cause, _) => {
                let names = ["power", "watchdog", "software", "pin", "brown-out"];
                format!("starts ({})", names.get(usize::from(cause)).unwrap_or(&"?"))
            }
            Self::Runs(_) => "runs with it".to_owned(),
            Self::Waits => "waits".to_owned(),
            Self::Reply(token) => format!("answer {token}"),
            Self::End => "End".to_owned(),
            Self::Time => "Time".to_owned(),
            Self::Margins(..) => "Margins".to_owned(),
            Self::Never(code) => format!("no {code:?}"),
        }
    }
}

/// The wanted messages, each after the one before, and the seconds from the event to each; `None` where one is not there.
pub fn told(said: &[Said], wanted: &[Wanted], event_s: f64) -> Vec<(String, Option<f64>)> {
    let mut rest = said.iter().filter(|s| s.at_s >= event_s);
    let mut after_s = |w: &Wanted| match w {
        Wanted::Never(_) => (!said.iter().any(|s| w.is(&s.message))).then_some(0.0),
        _ => rest.find(|s| w.is(&s.message)).map(|s| s.at_s - event_s),
    };
    wanted.iter().map(|w| (w.name(), after_s(w))).collect()
}

/// How the numbers of the records stand to the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct Numbers {
    /// In words.
    pub outcome: String,
    /// Whether every record is of the samples it says it is of.
    pub right: bool,
    /// What the numbers after a gap are off by where the board told them to be an estimate, of the last session with such a gap.
    pub off: i64,
}

/// A stretch of telemetry from one `Hello` to the next that began a count of frames, and the conversions since that start.
#[derive(Clone)]
struct Session<'a> {
    hello: Hello,
    said: &'a [Said],
    numbers: &'a [u64],
    codes: &'a [seabearing_board_model::ads131m04::Codes],
    seismic: Option<Conversion>,
    last: bool,
}

fn sessions(run: &BoardRun) -> Vec<Session<'_>> {
    let first = |s: &Said| match s.message {
        Message::Hello(hello) if s.sequence == 0 => Some(hello),
        _ => None,
    };
    let begins: Vec<(usize, Hello)> =
        run.said.iter().enumerate().filter_map(|(i, s)| Some((i, first(s)?))).collect();
    let starts = |at_s: f64| run.starts.iter().rposition(|(start_s, _)| *start_s <= at_s).unwrap_or(0);
    // Records of a boot may come in a later one; every start is a boot.
    let newest = run.said.iter().map(|s| s.boot).max().unwrap_or(0);
    let start_of = |said: &Said| match said.boot {
        0 => starts(said.at_s),
        boot => (run.starts.len() - 1).saturating_sub((newest - boot) as usize),
    };
    let session = |(n, (from, hello)): (usize, &(usize, Hello))| {
        let to = begins.get(n + 1).map_or(run.said.len(), |next| next.0);
        let start = start_of(&run.said[*from]);
        let end = run.starts.get(start + 1).map_or(run.numbers.len(), |next| next.1);
        let conversions = run.starts[start].1..end;
        Session {
            hello: *hello,
            said: &run.said[*from..to],
            numbers: &run.numbers[conversions.clone()],
            codes: &run.codes[conversions],
            seismic: run.seismic,
            last: n + 1 == begins.len(),
        }
    };
    begins.iter().enumerate().map(session).collect()
}

/// What is known of a case beside the run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Known {
    /// When the first thing goes wrong, s: until then nothing may be wanting of what the host says.
    pub undisturbed_s: f64,
    /// From this moment to the next start the board itself tells its records to be doubtful, s.
    pub doubtful_s: Option<f64>,
}

impl Known {
    /// Of a case in which these go wrong.
    pub fn of(faults: &[InjectedFault]) -> Self {
        let doubtful =
            |f: &&InjectedFault| matches!(f, InjectedFault::SettingsBit(..) | InjectedFault::MemoryBits(..));
        Self {
            undisturbed_s: faults.iter().filter_map(InjectedFault::begins_s).fold(f64::INFINITY, f64::min),
            doubtful_s: faults.iter().find(doubtful).and_then(InjectedFault::begins_s),
        }
    }
}

/// Every recording session against the host's over the same conversions. What only the board knows (its line, its clock,
/// its converter) is not compared, counters not where the clock made reports or the converter stood still.
/// `sent`: another configuration that the board may run with.
pub fn numbers(run: &BoardRun, blob: &[u8], sent: Option<&[u8]>, known: Known) -> Result<Numbers> {
    let hash = |blob: &[u8]| config_blob::station(blob).map_or(0, |config| config.hash());
    let sent = sent.map(|blob| (hash(blob), blob));
    let mut outcome = Vec::new();
    let (mut right, mut off) = (true, 0);
    let sessions = sessions(run);
    let restarted_s = run.starts.get(1).map_or(f64::INFINITY, |start| start.0);
    let recording: Vec<&Session<'_>> = sessions.iter().filter(|s| s.hello.kind != WAITING).collect();
    for (n, session) in recording.iter().enumerate() {
        let blob = sent.filter(|sent| sent.0 == session.hello.config_hash).map_or(blob, |sent| sent.1);
        // Only of the first is it known how far its conversions were heard before anything went wrong.
        let until_s = known.undisturbed_s.min(restarted_s) - AGE_S[usize::from(run.seismic.is_some())];
        let base = session.numbers.first().copied().unwrap_or(0) as usize;
        let at_least = run.moments_s.iter().skip(base).take_while(|s| **s < until_s).count();
        // What was said from then on to the next start is told as doubtful; all before it must be right.
        let sure = match known.doubtful_s {
            Some(at_s) if n == 0 => session.said.partition_point(|s| s.at_s < at_s),
            _ => session.said.len(),
        };
        let doubtful = sure < session.said.len();
        let session =
            Session { said: &session.said[..sure], last: session.last && !doubtful, ..(*session).clone() };
        match compare(&session, blob, if n == 0 { at_least as u64 } else { 0 }) {
            Ok(Some((words, by))) => {
                outcome.push(words);
                off = if by == 0 { off } else { by };
            }
            Ok(None) => {}
            Err(reason) => {
                right = false;
                outcome.push(format!("WRONG ({reason})"));
            }
        }
        if doubtful {
            outcome.push("then told as doubtful".to_owned());
        }
    }
    outcome.dedup();
    if recording.len() > 1 {
        outcome.push(format!("{} sessions", recording.len()));
    }
    Ok(Numbers { outcome: outcome.join("; "), right, off })
}

/// How old a sample is, at most, when what it brings is said, s: ring, block, line and flash; at the ocean bottom looks and filters.
const AGE_S: [f64; 2] = [0.3, 3.0];

/// How far an estimated number may be off, in instants: a moment is noted within two microseconds, an eighth of a conversion at
/// 64 kHz, the converter's pace so measured from what came before the gap or, where that was little, over half a ring; and one for
/// the rounding.
fn most_off(gap: u64, before: u64) -> i64 {
    const HALF_A_RING: u64 = 2048;
    (1 + gap / (8 * before.max(HALF_A_RING))) as i64
}

/// Conversions that may have had a wrong number before that was told: two windows of four wake-ups and one for their frames, 36 ms
/// at 64 kHz, and what was on its way. At the ocean bottom none: they are held back.
const MOST_EARLY: u64 = 2560;

/// What is assumed of the numbers that the board gave.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Assumed {
    /// They are off by so much from the first conversion on that is wanting to the second: before the board told of it.
    early: Option<i64>,
    /// They are off by so much afterwards.
    off: i64,
    /// So many gaps were estimated exactly before: of several estimates each errs by itself.
    after: usize,
}

fn compare(session: &Session<'_>, blob: &[u8], at_least: u64) -> Result<Option<(String, i64)>> {
    let faults = |code: FaultCode| {
        session.said.iter().filter_map(move |s| match s.message {
            Message::Fault(f) if f.code == code => Some(f),
            _ => None,
        })
    };
    let restarts = faults(FaultCode::ConverterRestarted).filter(|f| f.value > 0).count();
    // Of a converter that began again before anything was given: the numbers begin with it.
    let again = faults(FaultCode::ConverterRestarted).count() - restarts;
    let jumped = |w: &(usize, &[u64])| w.1[1] > w.1[0] + 1;
    let from = match again {
        0 => Some(0),
        again => session.numbers.windows(2).enumerate().filter(jumped).nth(again - 1).map(|w| w.0 + 1),
    };
    let Some(from) = from else { bail!("a start that was told and was none") };
    let session =
        &Session { numbers: &session.numbers[from..], codes: &session.codes[from..], ..session.clone() };
    let Some(base) = session.numbers.first() else { return Ok(None) };
    let gaps: Vec<(u64, u64)> =
        faults(FaultCode::Gap).map(|f| (f.index.saturating_sub(f.value as u64), f.index)).collect();
    // Of conversions, where several make a sample.
    let conversions =
        |(from, to): &(u64, u64)| session.seismic.map_or(*from..*to, |made| made.needed(*from, *to));
    // Where a command ended it.
    let end = session.said.iter().find_map(|s| match s.message {
        Message::End(end) => Some(end.index),
        _ => None,
    });
    let silent = faults(FaultCode::NoSamples).next().is_some();
    let counters = restarts == 0 && !silent;
    // Told by the board's own look at its chips, when that is.
    let of_chips = |m: &Message| {
        let code = FaultCode::DeadChannel;
        session.seismic.is_some()
            && matches!(m, Message::Fault(f) if f.code == code || f.code == FaultCode::ChannelBack)
    };
    let of_samples = |m: &Message| is_of_samples(m, counters) && !of_chips(m);
    let board: Vec<Message> = session.said.iter().map(|s| s.message).filter(of_samples).collect();
    // Where a command or the run's end cut it off there is nothing more to come; else what was under way is lost.
    let whole = session.last || end.is_some();
    // Of conversions that are wanting, how many and which was the last before.
    let jumps: Vec<(u64, u64)> = session
        .numbers
        .windows(2)
        .filter(|w| w[1] > w[0] + 1)
        .map(|w| (w[1] - w[0] - 1, w[0] - base + 1))
        .collect();
    // `to_end`: even where it says something else than the board. `most`: of the conversions so many.
    let host_with = |assumed: Assumed, most: u64, to_end: bool| -> Result<(Vec<Message>, u64, u64)> {
        let (mut shift, mut before, mut given_up, mut wrong, mut seen) = (0, *base, 0u64, 0u64, 0);
        let (mut indices, mut codes) = (Vec::new(), Vec::new());
        for (number, code) in session.numbers.iter().zip(session.codes) {
            if *number - base >= most {
                break;
            }
            if *number > before + 1 && restarts > 0 {
                seen += 1;
                let off = if seen > assumed.after { assumed.off } else { 0 };
                shift = assumed.early.filter(|_| seen == 1).unwrap_or(off);
            }
            before = *number;
            let index = (number - base).saturating_add_signed(shift);
            if end.is_some_and(|end| index >= session.seismic.map_or(end, |made| made.until(end))) {
                break;
            }
            if gaps.iter().any(|gap| conversions(gap).contains(&index)) {
                given_up += 1;
            } else if indices.last().is_none_or(|last| *last < index) {
                wrong += u64::from(assumed.early.is_some() && seen == 1);
                indices.push(index);
                codes.push(*code);
            }
        }
        let (mut decoder, mut heard) = (Decoder::default(), Vec::new());
        let mut take = |frame: &[u8]| {
            let messages = frame.iter().filter_map(|b| decoder.push::<Message>(*b)).map(|r| r.message);
            heard.extend(messages.filter(of_samples));
            to_end || heard.iter().zip(&board).all(|(host, board)| host == board)
        };
        host(
            blob,
            session.seismic,
            (session.hello.reset_cause, &[]),
            &indices,
            &codes,
            end.is_some(),
            &mut take,
        )?;
        Ok((heard, given_up, wrong))
    };
    let least = if whole { 0 } else { host_with(Assumed::default(), at_least, true)?.0.len() };
    let agree = |host: &[Message]| match whole {
        true => host == board,
        false => host.starts_with(&board) && board.len() >= least,
    };
    let records = board.iter().any(|m| session.seismic.is_some() || matches!(m, Message::Bearing(_)));
    let (true_host, given_up, _) = host_with(Assumed::default(), u64::MAX, true)?;
    let most =
        |after: usize| jumps.iter().skip(after).map(|(gap, before)| most_off(*gap, *before)).sum::<i64>();
    // What an estimate is off by within its bound is a matter of when an image's instructions run: no part of the table.
    let within = format!("estimate, within {}", most(0).max(1));
    if agree(&true_host) {
        let mut words = if restarts > 0 { within } else { "exact".to_owned() };
        if given_up > 0 {
            words += &format!(", {} given up as told", two_digits(given_up));
        }
        return Ok(Some((words, 0)).filter(|_| records || given_up > 0));
    }
    if restarts > 0 {
        // Wanting without being counted, or counted once too often.
        let early = [None, jumps.first().map(|jump| -(jump.0 as i64)), Some(1)];
        let offs = (0..jumps.len().max(1))
            .flat_map(|after| (0..=most(after).max(1)).flat_map(move |n| [(after, n), (after, -n)]));
        for (after, off) in offs {
            for early in early {
                let (heard, _, wrong) = host_with(Assumed { early, off, after }, u64::MAX, false)?;
                let most_early = if session.seismic.is_some() { 0 } else { MOST_EARLY };
                if agree(&heard) && wrong <= most_early {
                    let mut words = within;
                    if let Some(early) = early.filter(|_| wrong > 0) {
                        words += &format!("; {} {} off before it was told", two_digits(wrong), early.abs());
                    }
                    return Ok(Some((words, off)));
                }
            }
        }
    }
    let at = true_host.iter().zip(&board).take_while(|(a, b)| a == b).count();
    let one = |m: Option<&Message>| m.map_or("nothing".to_owned(), |m| format!("{m:?}"));
    let so_many = if whole { String::new() } else { format!(" of {least} at least") };
    bail!("{at}{so_many}: host {} | board {}", one(true_host.get(at)), one(board.get(at)))
}

/// Whether samples alone decide this message.
fn is_of_samples(message: &Message, counters: bool) -> bool {
    let code = match message {
        Message::Bearing(_) | Message::Track(_) | Message::ShaftRate(_) => return true,
        Message::Azimuth(_) | Message::Range(_) | Message::Segment(_) | Message::Azigram(_) => return true,
        Message::Health(_) => return counters,
        Message::Fault(f) => f.code,
        Message::FaultsHeld(f) => f.code,
        _ => return false,
    };
    match code {
        FaultCode::Gap | FaultCode::Invalid => counters,
        FaultCode::Overlap
        | FaultCode::DeadChannel
        | FaultCode::ChannelBack
        | FaultCode::Clipping
        | FaultCode::Inconsistent
        | FaultCode::Restarted
        | FaultCode::Paused => true,
        _ => false,
    }
}

/// Every time told, and what follows from it for the samples up to the next, against the truth: `None` where none was told.
/// A told time is right if it is within three of its standard deviations.
pub fn clock(run: &BoardRun, faults: &[InjectedFault], rate_hz: f64) -> Option<Numbers> {
    const MOST_SD: f64 = 3.0;
    let (mut told, mut worst_sd, mut worst_s) = (0, 0f64, 0f64);
    for session in sessions(run) {
        let Some(base) = session.numbers.first() else { continue };
        let mut times = Times::default();
        let mut stepped = false;
        let mut look = |times: &Times, index: u64| {
            let conversion = run.seismic.map_or(index, |made| made.middle(index));
            let at_s = run.moments_s.get((base + conversion) as usize).copied().filter(|s| s.is_finite());
            if let (Some(at_s), Some((utc_us, sd_s))) = (at_s, times.utc(index, rate_hz)) {
                let off_s = (utc_us as f64 - utc_us_of(at_s, faults)).abs() * 1e-6;
                worst_sd = worst_sd.max(off_s / sd_s);
                worst_s = worst_s.max(off_s);
            }
        };
        for said in session.said {
            match said.message {
                Message::Time(time) => {
                    if !stepped && told > 0 {
                        // What the line before it said of this moment, and of one between.
                        look(&times, time.index);
                        look(&times, time.index.saturating_sub(rate_hz as u64 / 2));
                    }
                    times.note(time, std::mem::take(&mut stepped), rate_hz);
                    look(&times, time.index);
                    told += 1;
                }
                Message::Fault(fault) if fault.code == FaultCode::ClockStepped => stepped = true,
                _ => {}
            }
        }
    }
    (told > 0).then(|| Numbers {
        outcome: format!(
            "{told} times, within {} sd, {} us",
            worst_sd.max(1.0).ceil(),
            // To the next of 1, 10, 100 and so on: it depends on the compiler.
            10f64.powf((worst_s * 1e6).max(1.0).log10().ceil())
        ),
        right: worst_sd <= MOST_SD,
        off: 0,
    })
}

/// Instants to two digits: how many a held core costs depends on the compiler.
fn two_digits(n: u64) -> u64 {
    let mut step = 1;
    while n / step >= 100 {
        step *= 10;
    }
    (n + step / 2) / step * step
}

#[cfg(test)]
mod tests;
