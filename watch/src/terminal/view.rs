//! The picture: header, alarms, stations, events, keys.
//!
//! No frames are drawn and ages are coarse, so that little changes from one picture to the next: on a slow line only that is sent.

use super::board::{Alarm, Board, Event, Station, Weight, age};
use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};
use ratatui::text::{Line, Span};

/// Alarms shown at once.
const ALARMS: usize = 4;
/// A bearing of so long ago is old, s.
const OLD_S: f64 = 60.0;

/// The parts between which a person goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Part {
    /// Stations.
    #[default]
    Stations,
    /// Alarms not cleared.
    Alarms,
    /// Event log.
    Events,
}

/// What a person has chosen.
#[derive(Clone, Debug, Default)]
pub struct Choice {
    /// Where the keys go.
    pub part: Part,
    /// First station shown.
    pub station: usize,
    /// The alarm chosen.
    pub alarm: usize,
    /// Events left out at the end.
    pub back: usize,
    /// Stations that the last picture had room for.
    pub room: usize,
}

/// What is shown at a time.
pub struct Shown<'a> {
    /// The state of things.
    pub board: &'a Board,
    /// Seconds of the steady clock.
    pub now_s: f64,
    /// Date and time of day, UTC.
    pub utc: &'a str,
    /// Whether colours may be used.
    pub colour: bool,
}

impl Shown<'_> {
    fn style(&self, weight: Weight) -> Style {
        let (colour, marked) = match weight {
            Weight::Usual => return Style::new(),
            Weight::Doubtful => (Color::Yellow, Modifier::empty()),
            Weight::Bad => (Color::Red, Modifier::BOLD),
        };
        self.coloured(colour).add_modifier(marked)
    }

    fn coloured(&self, colour: Color) -> Style {
        if self.colour { Style::new().fg(colour) } else { Style::new() }
    }

    /// Draws the picture. What was chosen and is there no more is brought back to what is there.
    pub fn draw(&self, frame: &mut Frame<'_>, choice: &mut Choice) {
        let height = usize::from(frame.area().height);
        let alarms = self.board.alarms.len().min(ALARMS).min(height.saturating_sub(6));
        let alarms = if alarms > 0 { alarms + 1 } else { 0 };
        let events = if height >= 12 { (height / 4).max(4) } else { 0 };
        let rows = |n: usize| Constraint::Length(u16::try_from(n).unwrap_or(u16::MAX));
        let [head, alarm, station, event, keys] =
            Layout::vertical([rows(1), rows(alarms), Constraint::Min(2), rows(events), rows(1)])
                .areas(frame.area());
        frame.render_widget(self.head(), head);
        self.alarms(frame, alarm, choice);
        self.stations(frame, station, choice);
        self.events(frame, event, choice);
        let words = " Ctrl-C ends the base station | Tab next part | arrows, PgUp, PgDn, Home, End scroll | a acknowledge, A all | Ctrl-L anew";
        frame.render_widget(Line::styled(words, self.coloured(Color::DarkGray)), keys);
    }

    fn head(&self) -> Line<'_> {
        let b = self.board;
        let mut spans = vec![
            Span::styled(
                format!(" seabearing base  {} UTC ", self.utc),
                Style::new().add_modifier(Modifier::BOLD),
            ),
            Span::raw(format!(" {} stations: {} up", b.stations.len(), b.lines("up"))),
        ];
        for state in ["silent", "down"] {
            let n = b.lines(state);
            if n > 0 {
                spans.push(Span::styled(format!(", {n} {state}"), self.style(Weight::Bad)));
            }
        }
        let open = b.alarms.iter().filter(|a| !a.acknowledged).count();
        if !b.alarms.is_empty() {
            let text = format!("  {} alarms, {open} not acknowledged", b.alarms.len());
            spans.push(Span::styled(text, self.style(if open > 0 { Weight::Bad } else { Weight::Doubtful })));
        }
        if b.missed > 0 {
            spans.push(Span::styled(
                format!("  {} records not shown", b.missed),
                self.style(Weight::Doubtful),
            ));
        }
        Line::from(spans)
    }

    /// The heading of a part; marked where the keys go.
    fn heading(&self, part: Part, choice: &Choice, text: String) -> Line<'_> {
        let mark = if choice.part == part { ">" } else { " " };
        let style = self.coloured(Color::Cyan).add_modifier(Modifier::UNDERLINED);
        Line::styled(format!("{mark}{text}"), style)
    }

    fn alarms(&self, frame: &mut Frame<'_>, area: Rect, choice: &mut Choice) {
        choice.alarm = choice.alarm.min(self.board.alarms.len().saturating_sub(1));
        let Some((heading, rows)) = split(area) else { return };
        frame.render_widget(self.heading(Part::Alarms, choice, "alarms".to_owned()), heading);
        let first = (choice.alarm + 1).saturating_sub(rows.len());
        for (row, (n, alarm)) in rows.into_iter().zip(self.board.alarms.iter().enumerate().skip(first)) {
            let chosen = choice.part == Part::Alarms && n == choice.alarm;
            frame.render_widget(self.alarm(alarm, chosen), row);
        }
    }

    fn alarm(&self, alarm: &Alarm, chosen: bool) -> Line<'_> {
        let (mark, weight) =
            if alarm.acknowledged { ("  seen ", Weight::Doubtful) } else { (" !     ", Weight::Bad) };
        let style = self.style(weight);
        let style = if chosen { style.add_modifier(Modifier::REVERSED) } else { style };
        Line::styled(format!("{mark}{}{}", other_day(&alarm.day, self.utc), alarm.text), style)
    }

    fn stations(&self, frame: &mut Frame<'_>, area: Rect, choice: &mut Choice) {
        let Some((heading, rows)) = split(area) else { return };
        let all = self.board.stations.len();
        choice.room = rows.len();
        choice.station = choice.station.min(all.saturating_sub(rows.len()));
        let last = (choice.station + rows.len()).min(all);
        let columns = format!(
            "{:>6} {:<12} {:<7} {:>6} {:>9} {:<20} newest track: closest at, heading, speed",
            "number",
            format!("{}-{last} of {all}", (choice.station + 1).min(all)),
            "line",
            "age",
            "UTC sd",
            "bearing"
        );
        frame.render_widget(self.heading(Part::Stations, choice, columns), heading);
        for (row, (number, station)) in rows.into_iter().zip(self.board.stations.iter().skip(choice.station))
        {
            frame.render_widget(self.station(*number, station), row);
        }
    }

    fn station(&self, number: Option<u64>, of: &Station) -> Line<'_> {
        let number = number.map_or_else(|| "?".to_owned(), |n| n.to_string());
        let (link, weight) = match of.link.as_str() {
            "up" if of.ended => ("ended", Weight::Doubtful),
            "" if of.ended => ("ended", Weight::Usual),
            "up" => ("up", Weight::Usual),
            "" => ("-", Weight::Usual),
            other => (other, Weight::Bad),
        };
        let link_style = if link == "up" { self.coloured(Color::Green) } else { self.style(weight) };
        let utc = match of.sd_utc_s {
            Some(sd) if sd < 0.001 => format!("{:.0} us", sd * 1e6),
            Some(sd) if sd < 1.0 => format!("{:.0} ms", sd * 1e3),
            Some(sd) => format!("{sd:.1} s"),
            None => "-".to_owned(),
        };
        let name: String = of.name.chars().take(12).collect();
        let mut spans = vec![
            Span::raw(format!(" {number:>6} {name:<12} ")),
            Span::styled(format!("{link:<7} "), link_style),
            Span::raw(format!("{:>6} {utc:>9} ", age(of.heard_s, self.now_s))),
        ];
        let (bearing, style) = match &of.bearing {
            Some((at_s, text)) if self.now_s - at_s > OLD_S => {
                (text.as_str(), self.coloured(Color::DarkGray))
            }
            Some((_, text)) => (text.as_str(), Style::new()),
            None => ("-", Style::new()),
        };
        spans.push(Span::styled(format!("{bearing:<20} "), style));
        if of.dead_channels > 0 {
            spans.push(Span::styled(format!("{} channels dead ", of.dead_channels), self.style(Weight::Bad)));
        }
        if let Some((text, goes_on, others)) = of.track(self.now_s) {
            let style = if goes_on { self.coloured(Color::Cyan) } else { self.coloured(Color::DarkGray) };
            spans.push(Span::styled(text, style));
            if others > 0 {
                spans.push(Span::raw(format!(" +{others}")));
            }
        }
        Line::from(spans)
    }

    fn events(&self, frame: &mut Frame<'_>, area: Rect, choice: &mut Choice) {
        let Some((heading, rows)) = split(area) else { return };
        let all = self.board.events.len();
        choice.back = choice.back.min(all.saturating_sub(rows.len()));
        let back = if choice.back > 0 { format!(" ({} newer)", choice.back) } else { String::new() };
        frame.render_widget(self.heading(Part::Events, choice, format!("events{back}")), heading);
        let first = all.saturating_sub(choice.back + rows.len());
        for (row, event) in rows.into_iter().zip(self.board.events.iter().skip(first)) {
            frame.render_widget(self.event(event), row);
        }
    }

    fn event(&self, event: &Event) -> Line<'_> {
        Line::styled(format!(" {}{}", other_day(&event.day, self.utc), event.text), self.style(event.weight))
    }
}

/// What is of another day than now says of which.
pub fn other_day(day: &str, utc: &str) -> String {
    if day.is_empty() || utc.starts_with(day) { String::new() } else { format!("{day} ") }
}

/// The first row of an area, and the others; `None` where it has none.
fn split(area: Rect) -> Option<(Rect, Vec<Rect>)> {
    let mut rows = area.rows();
    Some((rows.next()?, rows.collect()))
}
