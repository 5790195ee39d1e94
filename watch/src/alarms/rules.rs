//! The file of alarms (TOML): when they are raised, and who is told.

use super::area::Area;
use anyhow::{Result, bail};
use seabearing_host::toml_file::TomlFile;
use serde::Deserialize;
use std::collections::BTreeSet;
use std::path::Path;

/// When a recorder's clock raises an alarm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockRule {
    /// Greatest standard deviation of UTC, s.
    pub sd_s: f64,
    /// Longest time in which its records have no UTC, s.
    pub without_s: f64,
    /// Most that its UTC may be behind this computer's, s: as long as records may wait on a recorder.
    pub off_s: f64,
}

/// What raises an alarm.
#[derive(Clone, Debug, PartialEq)]
pub enum Condition {
    /// A vessel is inside an area with a probability.
    Inside(Area),
    /// A vessel is within a range of a station, m, with a probability.
    Range(f64),
    /// A vessel's closest point of approach to a station, m, will be within a time, s, with a probability.
    Approach {
        /// Range of the closest point, m.
        distance_m: f64,
        /// Time until then, s.
        within_s: f64,
    },
    /// A station of the list has not been heard for so long, s.
    Silent(f64),
    /// A channel is dead, deaf, reversed or leaking.
    Channel,
    /// UTC is not known, not well, or not this computer's; or it has stepped.
    Clock(ClockRule),
    /// The supply is low.
    Supply,
    /// A recorder's store is full and drops records.
    Storage,
    /// A recorder is nearer to a limit than that.
    Margin(Limits),
    /// A recorder's card takes no sound, or is full.
    Card {
        /// Whether it is about full cards.
        full: bool,
    },
    /// The disk of this base station's store has less free room than that, or the store takes nothing.
    Disk {
        /// Least free room, million bytes.
        free_mb: Option<f64>,
        /// Least free room, percent of the disk.
        free_percent: Option<f64>,
    },
}

/// How near to its limits a recorder may come; `None`: not looked at.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Limits {
    /// Least supply of the processor, V.
    pub supply_v: Option<f64>,
    /// Least voltage of the clock's cell, V.
    pub cell_v: Option<f64>,
    /// Least memory that the stack never used, bytes.
    pub memory_bytes: Option<f64>,
    /// Most of its store that waits for the base station, percent.
    pub full_percent: Option<f64>,
    /// Highest temperature of the processor, °C.
    pub temperature_c: Option<f64>,
}

impl Limits {
    /// Each alone, with a word for it.
    fn each(&self) -> impl Iterator<Item = (&'static str, Self)> {
        let none = Self::default();
        let all = [
            ("supply", self.supply_v, Self { supply_v: self.supply_v, ..none }),
            ("cell", self.cell_v, Self { cell_v: self.cell_v, ..none }),
            ("memory", self.memory_bytes, Self { memory_bytes: self.memory_bytes, ..none }),
            ("store", self.full_percent, Self { full_percent: self.full_percent, ..none }),
            ("temperature", self.temperature_c, Self { temperature_c: self.temperature_c, ..none }),
        ];
        all.into_iter().filter(|(_, limit, _)| limit.is_some()).map(|(name, _, limits)| (name, limits))
    }

    /// What is watched where a rule names none. The recording ends at 2.85 V; a lithium cell of 3 V is empty below 2.4 V; the
    /// processor bears 85 °C.
    const USUAL: Self = Self {
        supply_v: Some(3.0),
        cell_v: Some(2.4),
        memory_bytes: Some(4096.0),
        full_percent: Some(80.0),
        temperature_c: Some(75.0),
    };
}

impl Condition {
    /// The codes of its alarms.
    pub fn codes(&self) -> &'static [&'static str] {
        match self {
            Self::Inside(_) => &["VesselInside"],
            Self::Range(_) => &["VesselNear"],
            Self::Approach { .. } => &["VesselApproaches"],
            Self::Silent(_) => &["RecorderSilent"],
            Self::Channel => &["ChannelSick"],
            Self::Clock(_) => &["ClockUnsure", "ClockMissing", "ClockWrong"],
            Self::Supply => &["SupplyLow"],
            Self::Storage => &["StorageFull"],
            Self::Margin(_) => &["MarginSmall"],
            Self::Card { full: false } => &["CardFailed"],
            Self::Card { full: true } => &["CardFull"],
            Self::Disk { .. } => &["DiskLow", "StoreFails"],
        }
    }

    /// Whether it is about vessels.
    pub fn is_of_vessels(&self) -> bool {
        matches!(self, Self::Inside(_) | Self::Range(_) | Self::Approach { .. })
    }
}

/// A rule.
#[derive(Clone, Debug, PartialEq)]
pub struct Rule {
    /// Its name.
    pub name: String,
    /// The stations it is about; all if empty.
    pub stations: Vec<u16>,
    /// What raises it.
    pub condition: Condition,
    /// Probability from which it is raised.
    pub probability: f64,
    /// Probability below which it is cleared.
    pub clear_probability: f64,
    /// Time for which it must not be true before it is cleared, s.
    pub clear_after_s: f64,
}

/// Who is told.
#[derive(Clone, Debug, PartialEq)]
pub enum Delivery {
    /// A POST of the record to this address.
    Webhook(String),
    /// A program with its arguments; the record comes on its standard input.
    Command(Vec<String>),
}

impl std::fmt::Display for Delivery {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Webhook(url) => write!(f, "{url}"),
            Self::Command(command) => write!(f, "{}", command.join(" ")),
        }
    }
}

/// The file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Alarms {
    /// Rules.
    pub rules: Vec<Rule>,
    /// Deliveries.
    pub deliveries: Vec<Delivery>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    alarms: Vec<Table>,
    #[serde(default)]
    deliver: Vec<DeliverTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    kind: String,
    name: Option<String>,
    #[serde(default)]
    stations: Vec<u16>,
    polygon: Option<Vec<(f64, f64)>>,
    range_m: Option<f64>,
    distance_m: Option<f64>,
    within_s: Option<f64>,
    after_s: Option<f64>,
    sd_s: Option<f64>,
    without_s: Option<f64>,
    off_s: Option<f64>,
    free_mb: Option<f64>,
    free_percent: Option<f64>,
    supply_v: Option<f64>,
    cell_v: Option<f64>,
    memory_bytes: Option<f64>,
    full_percent: Option<f64>,
    temperature_c: Option<f64>,
    probability: Option<f64>,
    clear_probability: Option<f64>,
    clear_after_s: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct DeliverTable {
    webhook: Option<String>,
    command: Option<Vec<String>>,
}

/// Kinds, for messages.
const KINDS: &str = "inside, range, approach, silent, channel, clock, supply, storage, margin, card or disk";
/// Kinds that are about vessels, and those that are about stations.
const OF_VESSELS: [&str; 3] = ["inside", "range", "approach"];
const NOT_DISK: [&str; 10] =
    ["inside", "range", "approach", "silent", "channel", "clock", "supply", "storage", "margin", "card"];

impl Alarms {
    /// Reads a file, where there is one of stations for these stations.
    ///
    /// # Errors
    /// One line: file, line, key, and what is allowed.
    pub fn read(path: &Path, stations: Option<&BTreeSet<u16>>) -> Result<Self> {
        let source = TomlFile::read(path, "file of alarms")?;
        let alarms = Self::of(&source)?;
        stations.map_or(Ok(()), |listed| alarms.are_of(listed, &source))?;
        Ok(alarms)
    }

    /// Refuses rules about a station that is not listed: nothing would ever raise them.
    fn are_of(&self, listed: &BTreeSet<u16>, source: &TomlFile) -> Result<()> {
        for (n, rule) in self.rules.iter().enumerate() {
            if let Some(other) = rule.stations.iter().find(|of| !listed.contains(of)) {
                let what =
                    format!("rule `{}`: stations: the stations file lists no station {other}", rule.name);
                return Err(source.wrong(&format!("alarms.{n}.stations"), what));
            }
        }
        Ok(())
    }

    /// The same of text at hand.
    ///
    /// # Errors
    /// As [`Alarms::read`].
    pub fn of(source: &TomlFile) -> Result<Self> {
        let file: File = source.parse()?;
        if file.alarms.is_empty() {
            bail!("{}: no [[alarms]]", source.name());
        }
        let rules = file.alarms.into_iter().enumerate().map(|(n, table)| rule(source, n, table));
        let deliveries = file.deliver.into_iter().enumerate().map(|(n, table)| match (table.webhook, table.command) {
            (Some(url), None) if url.starts_with("http://") => Ok(Delivery::Webhook(url)),
            (Some(url), None) => Err(source.wrong(
                &format!("deliver.{n}.webhook"),
                format!("`{url}`: an address that begins with http:// (for TLS, a command like curl, or a proxy beside)"),
            )),
            (None, Some(command)) if !command.is_empty() => Ok(Delivery::Command(command)),
            _ => Err(source.wrong(&format!("deliver.{n}"), "either `webhook` or `command = [\"PROGRAM\", ..]`")),
        });
        let rules = apart(rules.collect::<Result<_>>()?);
        let deliveries = deliveries.collect::<Result<Vec<_>>>()?;
        let mut named = BTreeSet::new();
        for (n, delivery) in deliveries.iter().enumerate() {
            // What waits for it is kept under its text.
            if !named.insert(delivery.to_string()) {
                let what =
                    format!("`{delivery}` is told already: a [[deliver]] of the same text stands above");
                return Err(source.wrong(&format!("deliver.{n}"), what));
            }
        }
        Ok(Self { rules, deliveries })
    }
}

/// Gives rules of one name names of their own: what stands is found again by them after a restart.
fn apart(mut rules: Vec<Rule>) -> Vec<Rule> {
    let mut taken = BTreeSet::new();
    for rule in &mut rules {
        let first = rule.name.clone();
        for n in 2.. {
            if taken.insert(rule.name.clone()) {
                break;
            }
            rule.name = format!("{first} {n}");
        }
    }
    rules
}

/// Rules of which each is about one thing, so that one that stands hides no other: a margin for each limit, cards that fail and
/// cards that are full.
pub(super) fn single(rules: Vec<Rule>) -> Vec<Rule> {
    let each = |rule: Rule| {
        let named = |name: &str, condition: Condition| {
            let name = format!("{} {name}", rule.name);
            Rule { name, condition, ..rule.clone() }
        };
        match &rule.condition {
            Condition::Margin(limits) => {
                limits.each().map(|(name, limit)| named(name, Condition::Margin(limit))).collect()
            }
            Condition::Card { .. } => vec![rule.clone(), named("full", Condition::Card { full: true })],
            _ => vec![rule],
        }
    };
    apart(rules.into_iter().flat_map(each).collect())
}

impl Table {
    /// Keys that only some kinds have: whether they are given, and which kinds.
    fn own_keys(&self) -> [(&'static str, bool, &'static [&'static str]); 18] {
        [
            ("stations", !self.stations.is_empty(), &NOT_DISK),
            ("polygon", self.polygon.is_some(), &["inside"]),
            ("range_m", self.range_m.is_some(), &["range"]),
            ("distance_m", self.distance_m.is_some(), &["approach"]),
            ("within_s", self.within_s.is_some(), &["approach"]),
            ("after_s", self.after_s.is_some(), &["silent"]),
            ("sd_s", self.sd_s.is_some(), &["clock"]),
            ("without_s", self.without_s.is_some(), &["clock"]),
            ("off_s", self.off_s.is_some(), &["clock"]),
            ("free_mb", self.free_mb.is_some(), &["disk"]),
            ("free_percent", self.free_percent.is_some(), &["disk"]),
            ("supply_v", self.supply_v.is_some(), &["margin"]),
            ("cell_v", self.cell_v.is_some(), &["margin"]),
            ("memory_bytes", self.memory_bytes.is_some(), &["margin"]),
            ("full_percent", self.full_percent.is_some(), &["margin"]),
            ("temperature_c", self.temperature_c.is_some(), &["margin"]),
            ("probability", self.probability.is_some(), &OF_VESSELS),
            ("clear_probability", self.clear_probability.is_some(), &OF_VESSELS),
        ]
    }
}

fn rule(source: &TomlFile, n: usize, table: Table) -> Result<Rule> {
    let own_keys = table.own_keys();
    let at = |key: &str| format!("alarms.{n}.{key}");
    let needed = |key: &str, value: Option<f64>| match value {
        Some(x) if x > 0.0 && x.is_finite() => Ok(x),
        Some(x) => Err(source.wrong(&at(key), format!("{key} is {x}; above 0"))),
        None => Err(source.wrong(&at("kind"), format!("kind = \"{}\" needs `{key}`", table.kind))),
    };
    let or = |key: &str, value: Option<f64>, usual: f64| needed(key, Some(value.unwrap_or(usual)));
    let condition = match table.kind.as_str() {
        "inside" => {
            let Some(corners) = table.polygon else {
                return Err(source.wrong(&at("kind"), "kind = \"inside\" needs `polygon = [[LAT, LON], ..]`"));
            };
            Condition::Inside(
                Area::new(corners).map_err(|e| source.wrong(&at("polygon"), format!("polygon: {e}")))?,
            )
        }
        "range" => Condition::Range(needed("range_m", table.range_m)?),
        "approach" => Condition::Approach {
            distance_m: needed("distance_m", table.distance_m)?,
            within_s: needed("within_s", table.within_s)?,
        },
        "silent" => Condition::Silent(or("after_s", table.after_s, 180.0)?),
        "channel" => Condition::Channel,
        "clock" => Condition::Clock(ClockRule {
            sd_s: or("sd_s", table.sd_s, 1.0)?,
            without_s: or("without_s", table.without_s, 600.0)?,
            off_s: or("off_s", table.off_s, 2_592_000.0)?,
        }),
        "supply" => Condition::Supply,
        "storage" => Condition::Storage,
        "card" => Condition::Card { full: false },
        "margin" => {
            // Beyond these a recorder cannot tell any number.
            let within = |key: &str, value: Option<f64>, least: f64, most: f64| match value {
                Some(x) if !(x > least && x < most) => {
                    Err(source.wrong(&at(key), format!("{key} is {x}; above {least} and below {most}")))
                }
                value => Ok(value),
            };
            let limits = Limits {
                supply_v: within("supply_v", table.supply_v, 0.0, 4.0)?,
                cell_v: within("cell_v", table.cell_v, 0.0, 4.0)?,
                memory_bytes: within("memory_bytes", table.memory_bytes, 0.0, 1e9)?,
                full_percent: within("full_percent", table.full_percent, 0.0, 100.0)?,
                temperature_c: within("temperature_c", table.temperature_c, -40.0, 125.0)?,
            };
            Condition::Margin(if limits == Limits::default() { Limits::USUAL } else { limits })
        }
        "disk" => {
            let given = |key: &str, value: Option<f64>| value.map(|x| needed(key, Some(x))).transpose();
            let (free_mb, free_percent) =
                (given("free_mb", table.free_mb)?, given("free_percent", table.free_percent)?);
            if let Some(x) = free_percent.filter(|x| *x >= 100.0) {
                return Err(source.wrong(&at("free_percent"), format!("free_percent is {x}; below 100")));
            }
            let usual = free_mb.is_none() && free_percent.is_none();
            Condition::Disk { free_mb, free_percent: if usual { Some(5.0) } else { free_percent } }
        }
        other => return Err(source.wrong(&at("kind"), format!("kind = \"{other}\"; {KINDS}"))),
    };
    let name = table.name.unwrap_or_else(|| table.kind.clone());
    let foreign =
        own_keys.into_iter().find(|(_, given, kinds)| *given && !kinds.contains(&table.kind.as_str()));
    if let Some((key, _, kinds)) = foreign {
        let (kind, of) = (&table.kind, kinds.join(", "));
        return Err(source
            .wrong(&at(key), format!("rule `{name}`: kind = \"{kind}\" has no `{key}` (that is of {of})")));
    }
    let probability = or("probability", table.probability, 0.8)?;
    let clear_probability = or("clear_probability", table.clear_probability, 0.5 * probability)?;
    if !(probability <= 1.0 && clear_probability <= probability) {
        return Err(source.wrong(&at("probability"), "clear_probability <= probability <= 1 is needed"));
    }
    let usual = match condition {
        _ if condition.is_of_vessels() => 30.0,
        Condition::Storage => 600.0,
        _ => 0.001,
    };
    Ok(Rule {
        name,
        stations: table.stations,
        condition,
        probability,
        clear_probability,
        clear_after_s: or("clear_after_s", table.clear_after_s, usual)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wrong(text: &str) -> String {
        Alarms::of(&TomlFile::of(text, "alarms.toml")).unwrap_err().to_string()
    }

    #[test]
    fn a_key_of_another_kind_is_refused_with_its_rule_and_line() {
        for (kind, key, value) in [
            ("silent", "within_s", "4"),
            ("range", "polygon", "[[50.0, 0.0], [50.1, 0.1], [50.0, 0.1]]"),
            ("clock", "after_s", "5"),
            ("storage", "probability", "0.5"),
            ("disk", "stations", "[1]"),
        ] {
            let needed = if kind == "range" { "range_m = 5\n" } else { "" };
            let said =
                wrong(&format!("[[alarms]]\nkind = \"{kind}\"\nname = \"x\"\n{key} = {value}\n{needed}"));
            let words = format!("alarms.toml, line 4, column 1: rule `x`: kind = \"{kind}\" has no `{key}`");
            assert!(said.starts_with(&words), "{said}");
        }
        // A kind that nobody knows comes first.
        assert!(wrong("[[alarms]]\nkind = \"loud\"\nafter_s = 3\n").contains("kind = \"loud\""));
    }

    #[test]
    fn a_file_is_read_and_what_is_wrong_is_said_with_its_line() {
        let text = "[[alarms]]\nkind = \"inside\"\nname = \"port\"\npolygon = [[50.0, -1.0], [50.1, -1.0], [50.1, -0.9]]\n\
            [[alarms]]\nkind = \"silent\"\nafter_s = 20\n[[deliver]]\nwebhook = \"http://127.0.0.1:9/x\"\n";
        let alarms = Alarms::of(&TomlFile::of(text, "alarms.toml")).unwrap();
        assert_eq!((alarms.rules[0].name.as_str(), alarms.rules[0].clear_probability), ("port", 0.4));
        assert_eq!(alarms.rules[1].condition, Condition::Silent(20.0));
        assert_eq!(alarms.deliveries, [Delivery::Webhook("http://127.0.0.1:9/x".into())]);
        let silent = "[[alarms]]\nkind = \"silent\"\n";
        let twice = Alarms::of(&TomlFile::of(
            &format!("{silent}{silent}{silent}name = \"silent 2\"\n"),
            "alarms.toml",
        ))
        .unwrap();
        let names: Vec<_> = twice.rules.iter().map(|r| r.name.as_str()).collect();
        assert_eq!(names, ["silent", "silent 2", "silent 2 2"]);
        let crossed = wrong(
            "[[alarms]]\nkind = \"inside\"\npolygon = [[50.0, 0.0], [50.1, 0.1], [50.0, 0.1], [50.1, 0.0]]\n",
        );
        assert!(
            crossed.starts_with("alarms.toml, line 3, column 1: polygon: it crosses itself"),
            "{crossed}"
        );
        assert!(wrong("[[alarms]]\nkind = \"loud\"\n").contains("inside, range, approach"));
        assert!(wrong("[[alarms]]\nkind = \"range\"\n").contains("needs `range_m`"));
        assert!(
            wrong("[[alarms]]\nkind = \"range\"\nrange_m = -1\n").contains("line 3, column 1: range_m is -1")
        );
        assert!(
            wrong("[[alarms]]\nkind = \"silent\"\n[[deliver]]\nwebhook = \"https://x\"\n")
                .contains("http://")
        );
        assert!(wrong("deliver = []\n").contains("no [[alarms]]"));
        for (one, other) in [
            ("command = [\"tell\", \"a b\"]", "command = [\"tell a\", \"b\"]"),
            ("webhook = \"http://x\"", "webhook = \"http://x\""),
        ] {
            let twice =
                wrong(&format!("[[alarms]]\nkind = \"silent\"\n[[deliver]]\n{one}\n[[deliver]]\n{other}\n"));
            assert!(
                twice.starts_with("alarms.toml, line 5, column 1: `") && twice.contains("is told already"),
                "{twice}"
            );
        }
    }
}
