//! What a deployment costs and whether it fits: work, memory, sleep, line, card and battery, from measured budgets.
//!
//! Enters: a station and what a person would vary ([`Deployment`]). Leaves: figures, and what does not fit. What nobody has
//! measured (what a board draws) is asked for, never assumed.

mod budget;
pub mod telemetry;

use crate::blob;
use crate::station::Station;
use anyhow::{Result, anyhow, bail};
use budget::Budget;
use seabearing_core::config::{ArrayConfig, Kind, StationConfig};
use seabearing_core::recorder::Memory;
use seabearing_firmware::card::search::MOST_FILES;
use seabearing_firmware::converter::RING_FRAMES;
use seabearing_firmware::converter::Rate;
use seabearing_firmware::seismic::Conversion;

/// Seconds, minutes and hours of a day.
const DAY_S: f64 = 86_400.0;
const DAY_MIN: f64 = 1440.0;
const DAY_H: f64 = 24.0;
/// Bits of a byte on a serial line, start and stop included.
const LINE_BITS: f64 = 10.0;
/// The memory of the boards.
const MEMORY: &str = include_str!("../../../memory.x");

/// What a person would vary.
#[derive(Clone, Debug, PartialEq)]
pub struct Deployment {
    /// Vessels a day, and minutes for which each is heard.
    pub vessels_a_day: f64,
    /// Minutes for which each is heard.
    pub minutes_each: f64,
    /// Vessels at once, in the worst case.
    pub at_once: u32,
    /// Seconds between health reports; 0: only on request.
    pub health_s: f64,
    /// Bits a second of the telemetry's line.
    pub baud: f64,
    /// Bytes a day that the line may carry, where that is limited.
    pub link_bytes_a_day: Option<f64>,
    /// Size of the card, bytes.
    pub card_bytes: Option<f64>,
    /// Bytes of one sample of one channel on the card.
    pub sample_bytes: f64,
    /// Length of the deployment, days.
    pub days: Option<f64>,
    /// Share of the time in which the recorder is switched on; when it listens then its schedule says.
    pub duty: f64,
    /// RAM of the microcontroller, bytes; the board's unless given.
    pub ram_bytes: Option<f64>,
    /// Its flash.
    pub flash_bytes: Option<f64>,
    /// Cycles an instruction takes; as where the board was measured unless given.
    pub cycles: Option<f64>,
    /// What the hardware draws.
    pub power: Power,
}

/// What the hardware draws: measured by whoever built it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Power {
    /// Energy of the battery that can be used, Wh.
    pub battery_wh: Option<f64>,
    /// Supply, V.
    pub supply_v: Option<f64>,
    /// Current of the microcontroller awake, mA.
    pub awake_ma: Option<f64>,
    /// The same asleep.
    pub asleep_ma: Option<f64>,
    /// Current of everything else while the recorder is on, mA.
    pub other_ma: Option<f64>,
    /// Current of all while it is off, mA.
    pub off_ma: Option<f64>,
}

/// What it costs.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Instructions a second of the recorder.
    pub instructions_per_s: f64,
    /// The image for hardware that is planned: the one with a card where one was asked for, else that with a link.
    pub image: &'static str,
    /// Share of the time the core is awake while the recorder listens.
    pub awake: f64,
    /// The same while it pauses by its schedule.
    pub awake_in_pauses: f64,
    /// Share of the time for which it listens while it is on, by its schedule.
    pub listens: f64,
    /// RAM taken and there, bytes.
    pub ram_bytes: (f64, f64),
    /// Flash taken and there, bytes.
    pub flash_bytes: (f64, f64),
    /// Bytes on the line: of an expected day, of the worst day, and of the worst second.
    pub link_bytes_a_day: f64,
    /// Of the worst day.
    pub worst_bytes_a_day: f64,
    /// Of the worst second.
    pub worst_bytes_per_s: f64,
    /// What the line carries in a second.
    pub line_bytes_per_s: f64,
    /// Bytes of sound a day.
    pub card_bytes_a_day: f64,
    /// Days until the card is full.
    pub card_days: Option<f64>,
    /// Mean current, mA.
    pub mean_ma: Option<f64>,
    /// Days until the battery is empty.
    pub battery_days: Option<f64>,
    /// What is true besides.
    pub notes: Vec<&'static str>,
    /// What does not fit, each with what to do.
    pub misfits: Vec<String>,
}

/// Plans a deployment.
///
/// # Errors
/// The station has no recorder or cannot be run, a value makes no sense, or a number that is needed was not given.
pub fn of(station: &Station, deployment: &Deployment) -> Result<Plan> {
    let config = &station.config;
    if matches!(config.kind, Kind::Line(_)) {
        bail!("{}: kind = \"line\" has no recorder, so there is nothing to deploy", config.name);
    }
    blob::of(station)?;
    let table = crate::ocean_bottom::table::of_station(station)?;
    let mut memory: Box<Memory<'_>> = Box::default();
    memory.configure(config, table.as_deref()).map_err(|e| anyhow!("{}: {e}", config.name))?;
    deployment.check()?;
    let budget = Budget::measured()?;
    let cycles = deployment.cycles.unwrap_or(budget.cycles);
    let cost = match &config.kind {
        Kind::Array(array) => Cost::of_array(&budget, array, config.rate_hz, cycles, deployment),
        _ => Cost::of_obs(&budget, config.rate_hz, cycles, deployment),
    };
    let listens = config.schedule.share();
    let health = if deployment.health_s > 0.0 {
        telemetry::report_bytes(config.rate_hz) as f64 * DAY_S / deployment.health_s
    } else {
        0.0
    };
    let worst = telemetry::most_per_s(config, deployment.at_once, deployment.health_s);
    let card = OnCard::of(config, deployment);
    // In a pause converters, clock and line stay on.
    let awake = listens * cost.awake.min(1.0) + (1.0 - listens) * cost.awake_in_pauses.min(1.0);
    let mean_ma = deployment.power.mean_ma(awake, deployment.duty)?;
    let pauses = match config.schedule.every_s {
        0 => 0.0,
        every_s => telemetry::pause_bytes(config.rate_hz) as f64 * DAY_S / f64::from(every_s),
    };
    let mut plan = Plan {
        instructions_per_s: cost.instructions_per_s,
        image: cost.image,
        awake: cost.awake,
        awake_in_pauses: cost.awake_in_pauses,
        listens,
        ram_bytes: (cost.ram, deployment.ram_bytes.map_or_else(|| region("H743_AXI"), Ok)?),
        flash_bytes: (cost.flash, deployment.flash_bytes.map_or_else(|| region("H743_FLASH"), Ok)?),
        link_bytes_a_day: (cost.found_a_day * listens + health + pauses) * deployment.duty,
        worst_bytes_a_day: worst * DAY_S * deployment.duty,
        worst_bytes_per_s: worst,
        line_bytes_per_s: deployment.baud / LINE_BITS,
        card_bytes_a_day: card.bytes_a_day,
        card_days: deployment.card_bytes.map(|bytes| card.days(bytes)),
        mean_ma,
        battery_days: deployment.power.days(mean_ma),
        notes: cost.notes,
        misfits: cost.misfits,
    };
    plan.judge(deployment);
    Ok(plan)
}

/// Sound on the card.
struct OnCard {
    bytes_a_day: f64,
    /// Files that are used a day; where all is kept they are as long as the card needs.
    files_a_day: Option<f64>,
}

impl OnCard {
    fn of(config: &StationConfig, deployment: &Deployment) -> Self {
        let bytes_per_s = config.rate_hz * 4.0 * deployment.sample_bytes;
        let share = deployment.duty * config.schedule.share();
        let clips = config.clips;
        if !clips.are_kept() {
            return Self { bytes_a_day: bytes_per_s * DAY_S * share, files_a_day: None };
        }
        let apart_s = f64::from(clips.apart_s);
        let false_alarms = match &config.kind {
            Kind::Array(array) => array.false_alarms_per_hour * DAY_H,
            _ => 0.0,
        };
        let each = (deployment.minutes_each * 60.0 / apart_s).max(1.0).ceil();
        let a_day = (deployment.vessels_a_day * each + false_alarms).min(DAY_S / apart_s) * share;
        // A clip begins and ends anywhere in a file, and whole files are kept.
        let file_s = crate::card::file_s(clips);
        let files_a_day = a_day * (clips.seconds() / file_s + 1.0);
        Self { bytes_a_day: files_a_day * file_s * bytes_per_s, files_a_day: Some(files_a_day) }
    }

    /// Days until a card of so many bytes is full, or has no more files.
    fn days(&self, bytes: f64) -> f64 {
        let files = self.files_a_day.map_or(f64::INFINITY, |files| MOST_FILES as f64 / files);
        (bytes / self.bytes_a_day).min(files)
    }
}

/// What the two kinds cost each in its own way.
struct Cost {
    image: &'static str,
    instructions_per_s: f64,
    awake: f64,
    awake_in_pauses: f64,
    ram: f64,
    flash: f64,
    /// Bytes a day of what is found.
    found_a_day: f64,
    notes: Vec<&'static str>,
    misfits: Vec<String>,
}

/// What a board's converters say to a rate, samples a second, that they do not have.
pub(crate) fn no_such_rate(ocean_bottom: bool, rate_hz: f64) -> Option<String> {
    match ocean_bottom {
        true if Conversion::of(rate_hz).is_none() => {
            Some(format!("the converters make no {rate_hz} Hz: 50, 100, 200, 250 or 500"))
        }
        false if Rate::of(rate_hz).is_none() => {
            Some(format!("the converter has no {rate_hz} Hz: 64000, 32000, 16000 or 8000"))
        }
        _ => None,
    }
}

impl Cost {
    fn of_array(
        budget: &Budget,
        array: &ArrayConfig,
        rate_hz: f64,
        cycles: f64,
        deployment: &Deployment,
    ) -> Self {
        let vessel_min = deployment.vessels_a_day * deployment.minutes_each;
        // Bearings come by the step; a minute in which two vessels are heard has no more of them.
        let bearings = budget.bearings_per_min * vessel_min.min(DAY_MIN) * 0.5 / array.step_s
            + array.false_alarms_per_hour * DAY_H;
        let mut misfits = Vec::new();
        misfits.extend(no_such_rate(false, rate_hz));
        let block_s = budget.worst_block * cycles / budget.core_hz;
        let ring_s = RING_FRAMES as f64 / rate_hz;
        if block_s > ring_s / 2.0 {
            misfits.push(format!(
                "the longest work after a block takes {:.0} ms, and may take {:.0} ms, half of the time for which samples are kept: a lower rate",
                block_s * 1e3,
                ring_s / 2.0 * 1e3
            ));
        }
        let (image, of) = match deployment.card_bytes {
            Some(_) => ("stm32h743-card", budget.card),
            None => ("stm32h743-link", budget.link),
        };
        Self {
            image,
            instructions_per_s: budget.array_work(rate_hz, array.step_s),
            awake: of.more * budget.array_awake(rate_hz, array.step_s, cycles),
            awake_in_pauses: of.more * budget.array_pause(rate_hz, cycles),
            ram: of.ram,
            flash: of.flash,
            found_a_day: bearings * budget.bearing_bytes + budget.array_other_per_min * vessel_min,
            notes: Vec::new(),
            misfits,
        }
    }

    fn of_obs(budget: &Budget, rate_hz: f64, cycles: f64, deployment: &Deployment) -> Self {
        let conversion = Conversion::of(rate_hz);
        let mut misfits = Vec::new();
        if deployment.card_bytes.is_some() {
            misfits.push("no image of an ocean-bottom board writes a card: leave out --card-gb".to_owned());
        }
        misfits.extend(no_such_rate(true, rate_hz));
        let converted_hz = conversion.map_or(rate_hz, |made| f64::from(made.rate.hz()));
        Self {
            image: "stm32h743-obs",
            instructions_per_s: budget.obs_work(rate_hz),
            awake: budget.obs_awake(rate_hz, converted_hz, cycles),
            awake_in_pauses: budget.obs_pause(converted_hz, cycles),
            ram: budget.obs_ram,
            flash: budget.obs_flash,
            found_a_day: budget.obs_per_min * DAY_MIN,
            notes: vec!["the ocean-bottom board's core runs at 64 MHz, its line at 115200 baud"],
            misfits,
        }
    }
}

/// Bytes of a region of the boards' memory.
fn region(name: &str) -> Result<f64> {
    let line = MEMORY.lines().find(|line| line.trim_start().starts_with(name));
    let length = line.and_then(|line| line.split("LENGTH =").nth(1)).map(str::trim);
    let bytes = length.and_then(|length| {
        let (number, unit) = length.split_at(length.find(|c: char| !c.is_ascii_digit())?);
        let unit = match unit {
            "K" => 1024.0,
            "M" => 1_048_576.0,
            _ => return None,
        };
        Some(number.parse::<f64>().ok()? * unit)
    });
    bytes.ok_or_else(|| anyhow!("memory.x: no length of {name}"))
}

impl Deployment {
    /// Values that can be.
    fn check(&self) -> Result<()> {
        let Power { battery_wh, supply_v, awake_ma, asleep_ma, other_ma, off_ma } = self.power;
        let (least, most) = (Some(f64::MIN_POSITIVE), 1e15);
        for (option, value, from, to) in [
            ("vessels-a-day", Some(self.vessels_a_day), Some(0.0), 1e5),
            ("minutes-each", Some(self.minutes_each), Some(0.0), DAY_MIN),
            ("at-once", Some(f64::from(self.at_once)), Some(0.0), seabearing_core::traffic::VESSELS as f64),
            ("health-s", Some(self.health_s), Some(0.0), 65_535.0),
            ("baud", Some(self.baud), Some(1.0), 1e8),
            ("link-bytes-a-day", self.link_bytes_a_day, Some(0.0), most),
            ("card-gb", self.card_bytes, least, most),
            ("bytes-a-sample", Some(self.sample_bytes), least, 16.0),
            ("days", self.days, least, 1e5),
            ("duty", Some(self.duty), least, 1.0),
            ("ram-kb", self.ram_bytes, Some(0.0), most),
            ("flash-kb", self.flash_bytes, Some(0.0), most),
            ("cycles", self.cycles, least, 1e4),
            ("battery-wh", battery_wh, least, most),
            ("supply-v", supply_v, least, 1e4),
            ("awake-ma", awake_ma, Some(0.0), 1e6),
            ("asleep-ma", asleep_ma, Some(0.0), 1e6),
            ("other-ma", other_ma, Some(0.0), 1e6),
            ("off-ma", off_ma, Some(0.0), 1e6),
        ] {
            let from = from.unwrap_or(0.0);
            if value.is_some_and(|value| !(value >= from && value <= to)) {
                let from =
                    if from == f64::MIN_POSITIVE { "more than 0".to_owned() } else { format!("{from}") };
                bail!("--{option} is {}; allowed {from} to {to}", value.unwrap_or(f64::NAN));
            }
        }
        // As many on average are at least as many at one time.
        let mean = self.vessels_a_day * self.minutes_each / DAY_MIN;
        if mean > f64::from(self.at_once) {
            bail!(
                "--vessels-a-day {} and --minutes-each {} are {mean:.1} vessels at any time: more than --at-once {}",
                self.vessels_a_day,
                self.minutes_each,
                self.at_once
            );
        }
        Ok(())
    }
}

impl Power {
    /// Mean current, mA; `None` where nobody asked.
    fn mean_ma(&self, awake: f64, duty: f64) -> Result<Option<f64>> {
        let off_ma = if duty < 1.0 { self.off_ma } else { Some(0.0) };
        let all = [
            ("--awake-ma", self.awake_ma),
            ("--asleep-ma", self.asleep_ma),
            ("--other-ma", self.other_ma),
            ("--off-ma", off_ma),
            ("--supply-v", if self.battery_wh.is_some() { self.supply_v } else { Some(0.0) }),
        ];
        let Self { awake_ma, asleep_ma, other_ma, .. } = *self;
        if *self == Self::default() {
            return Ok(None);
        }
        let (Some(awake_ma), Some(asleep_ma), Some(other_ma), Some(off_ma), true) =
            (awake_ma, asleep_ma, other_ma, off_ma, all.iter().all(|(_, value)| value.is_some()))
        else {
            let missing: Vec<&str> = all.iter().filter(|(_, v)| v.is_none()).map(|(name, _)| *name).collect();
            bail!(
                "what the hardware draws must be measured, it is not assumed: give {} as well",
                missing.join(", ")
            )
        };
        let on = awake * awake_ma + (1.0 - awake) * asleep_ma + other_ma;
        Ok(Some(duty * on + (1.0 - duty) * off_ma))
    }

    fn days(&self, mean_ma: Option<f64>) -> Option<f64> {
        let power_w = mean_ma? * 1e-3 * self.supply_v?;
        Some(self.battery_wh? / power_w / DAY_H)
    }
}

impl Plan {
    /// Adds what does not fit.
    fn judge(&mut self, deployment: &Deployment) {
        let mut no = |unfit: bool, why: String| {
            if unfit {
                self.misfits.push(why);
            }
        };
        no(
            self.awake > 1.0,
            format!(
                "the core would be busy {:.0} % of the time: a lower rate, a longer step_s",
                self.awake * 100.0
            ),
        );
        for (what, (taken, there)) in [("RAM", self.ram_bytes), ("flash", self.flash_bytes)] {
            no(taken > there, format!("{what}: {taken:.0} bytes are needed, {there:.0} are there"));
        }
        let (worst, line) = (self.worst_bytes_per_s, self.line_bytes_per_s);
        no(
            worst > line,
            format!(
                "the line carries {line:.0} bytes/s, telemetry takes up to {worst:.0} with {} vessels at once: {:.0} baud at least, or a longer step_s",
                deployment.at_once,
                (worst * LINE_BITS).ceil()
            ),
        );
        if let Some(most) = deployment.link_bytes_a_day {
            let day = self.link_bytes_a_day;
            no(
                day > most,
                format!(
                    "the link may carry {most:.0} bytes a day, {day:.0} are expected: longer --health-s or step_s"
                ),
            );
        }
        for (what, holds) in [("the card", self.card_days), ("the battery", self.battery_days)] {
            if let (Some(holds), Some(days)) = (holds, deployment.days) {
                no(holds < days, format!("{what} holds {holds:.1} of {days} days"));
            }
        }
    }
}

#[cfg(test)]
mod tests;
