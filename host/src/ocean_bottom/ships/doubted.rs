//! When a station doubted its own set-up, and of what.
//!
//! Enters: the faults among a chain's messages. Leaves: spans, each of one kind, until the station says that it is over.

use crate::plot::times::Times;
use crate::record::Warning;
use seabearing_core::wire::{Fault, FaultCode, Message};

/// A time in which a station doubted its set-up.
#[derive(Clone, Debug, PartialEq)]
pub struct Doubted {
    /// What was doubted: the last that was said of it.
    pub fault: Fault,
    /// From its naming on, s.
    pub from_s: f64,
    /// To where it was taken back, s; `None`: to the end.
    pub to_s: Option<f64>,
}

impl Doubted {
    /// Whether it stood at some time of a span, s.
    pub fn within(&self, (from_s, to_s): (f64, f64)) -> bool {
        self.from_s <= to_s && self.to_s.is_none_or(|end| end >= from_s)
    }

    /// By name.
    pub fn name(&self) -> String {
        format!("{:?}", self.fault.code)
    }

    /// In a line: when, what, and what to do.
    pub fn words(&self, times: &Times) -> String {
        let from = times.minute(self.from_s);
        let to = self.to_s.map_or("the end".to_owned(), |to_s| times.minute_after((self.from_s, to_s)));
        let text = Warning::of(&self.fault).map_or_else(
            || {
                let component = match self.fault.value {
                    0 => "pressure",
                    1 => "north",
                    2 => "east",
                    _ => "the vertical component",
                };
                format!("{component} has noise of its own and tells no direction")
            },
            |warning| warning.text,
        );
        format!("{from} to {to}, {}: {text}", self.name())
    }
}

/// The doubts of a recording, in order of their beginning.
pub fn doubted(messages: &[Message], rate_hz: f64) -> Vec<Doubted> {
    let mut out: Vec<Doubted> = Vec::new();
    for m in messages {
        let Message::Fault(f) = m else { continue };
        let t_s = f.index as f64 / rate_hz;
        let is_open = |d: &&mut Doubted, code: FaultCode| d.to_s.is_none() && d.fault.code == code;
        match f.code {
            FaultCode::SignInDoubt
            | FaultCode::Reversed
            | FaultCode::Exchanged
            | FaultCode::Unequal
            | FaultCode::GainInDoubt
            | FaultCode::TableOff => match out.iter_mut().find(|d| is_open(d, f.code)) {
                Some(d) => d.fault = *f,
                None => out.push(Doubted { fault: *f, from_s: t_s, to_s: None }),
            },
            FaultCode::OwnNoise => out.push(Doubted { fault: *f, from_s: t_s, to_s: None }),
            FaultCode::SetUpGood => {
                let over = FaultCode::ALL.iter().find(|code| **code as i64 == f.value);
                let open = out.iter_mut().filter(|d| over.is_some_and(|code| is_open(d, *code)));
                open.for_each(|d| d.to_s = Some(t_s));
            }
            FaultCode::ChannelBack => {
                let open =
                    out.iter_mut().filter(|d| is_open(d, FaultCode::OwnNoise) && d.fault.value == f.value);
                open.for_each(|d| d.to_s = Some(t_s));
            }
            _ => {}
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_doubt_about_the_set_up_stands_until_it_is_over() {
        let fault = |code, t_s: u64, value: i64| Message::Fault(Fault { code, index: 50 * t_s, value });
        let told = [
            fault(FaultCode::Unequal, 100, 31),
            fault(FaultCode::Exchanged, 120, 2),
            fault(FaultCode::SetUpGood, 200, FaultCode::Unequal as i64),
            // Another channel's end is none of it.
            fault(FaultCode::OwnNoise, 400, 2),
            fault(FaultCode::ChannelBack, 450, 0),
            fault(FaultCode::ChannelBack, 550, 2),
            fault(FaultCode::Exchanged, 560, 1),
        ];
        let all = doubted(&told, 50.0);
        let spans: Vec<_> = all.iter().map(|d| (d.name(), d.fault.value, d.from_s, d.to_s)).collect();
        assert_eq!(
            spans,
            [
                ("Unequal".into(), 31, 100.0, Some(200.0)),
                ("Exchanged".into(), 1, 120.0, None),
                ("OwnNoise".into(), 2, 400.0, Some(550.0))
            ]
        );
        assert!(
            all[0].within((150.0, 160.0)) && !all[0].within((250.0, 300.0)) && !all[0].within((0.0, 50.0))
        );
        assert!(all[1].within((1e6, 2e6)));
        let words = all[1].words(&Times::new(None, 1000.0));
        assert!(
            words.contains("to the end, Exchanged: the vertical component and north stand for each other"),
            "{words}"
        );
    }
}
