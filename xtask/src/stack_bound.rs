//! The most stack an image can need, from its code: what each function takes, and the deepest way from the reset and from
//! each interrupt.
//!
//! Every `push` and `sub sp` of a function counts, whichever way it goes; a jump to another function counts as a call.
//! Calls through pointers go to what [`BY_POINTER`] says; one from elsewhere is an error. A function that can come to
//! itself again counts once, and only those of [`ONCE`] may. What interrupts can add is each priority's deepest handler,
//! and a fault on top of them.

use crate::elf::{Elf, Symbol};
use crate::thumb::{self, Step};
use anyhow::{Context, Result, bail};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// A name's parts: it holds the first and ends with the second.
type Name = (&'static str, &'static str);

/// Who calls through pointers, and what these may point at. The first that fits counts.
const BY_POINTER: &[(&str, &[Name])] = &[
    // A square root's three steps, where they are too long to be written out thrice.
    ("libm::math::sqrt::sqrt", &[("libm::math::generic::sqrt::goldschmidt", "")]),
    // Which values a band sums; where finished records go; what of a store is a configuration;
    // what wakes the line.
    ("seabearing_core::density::add", &[("::density::", "}"), ("::add_bands::", "}")]),
    ("seabearing_core::intake", RECORDS),
    ("seabearing_core::slow_levels", RECORDS),
    ("seabearing_core::outlet", OUTLET),
    ("stm32h743::__cortex_m_rt_main", OUTLET),
    // The executor's interrupt, which polls its tasks; wakers.
    ("UART4", &[("TaskStorage<", "::poll")]),
    ("TIM8_BRK_TIM12", WAKERS),
    ("_embassy_time_schedule_wake", WAKERS),
    ("embassy_executor::raw::TaskStorage<", WAKERS),
    ("embassy_sync::waitqueue::", WAKERS),
    ("embassy_time_queue_utils::Queue::", WAKERS),
    ("embassy_stm32::dma::", WAKERS),
    ("embassy_stm32::usart::", WAKERS),
    ("stm32h743::link::", WAKERS),
    ("core::fmt", &[("core::fmt::", "::fmt"), ("", "::write_str"), ("", "::write_char")]),
];
const RECORDS: &[Name] =
    &[("seabearing_core::recorder::array::outlet::", "}"), ("seabearing_core::recorder::obs::", "}")];
const OUTLET: &[Name] = &[("stm32h743::usable", ""), ("embassy_executor::raw::waker::", "")];
const WAKERS: &[Name] = &[("embassy_executor::raw::waker::", "")];
/// Parts of the names of functions that may come to themselves again: what formats a panic's words does, once.
const ONCE: [&str; 2] = ["core::fmt", "fmt::"];
/// Exceptions in front of the interrupts in the vector table, reset included (ARMv7-M, B1.5.2); the faults among them.
const EXCEPTIONS: usize = 16;
const FAULTS: std::ops::RangeInclusive<usize> = 2..=6;
/// What an exception saves: eight registers, eighteen of the floating-point unit, a word of alignment (B1.5.7), bytes.
const FRAME: u32 = 4 * (8 + 18 + 1);

/// Priorities that interrupts have: the one at reset, and two that the hardware's image gives (`firmware/src/bin/stm32h743.rs`,
/// `counter.rs`): so many can be one in another.
const LEVELS: usize = 3;

/// What an image can need at most.
pub struct Bound {
    /// Of the thread, bytes.
    pub thread: u32,
    /// Of the interrupts that can be one in another, and a fault, bytes; their frames are in it.
    pub interrupts: u32,
    /// The stack the image has, bytes.
    pub size: u32,
    /// The thread's deepest way: bytes a function takes, and its name.
    pub way: Vec<(u32, String)>,
}

/// Reads it from an image.
pub fn of(elf: &Elf) -> Result<Bound> {
    let graph = Graph::read(elf)?;
    let vectors = elf.vectors();
    let handler = |vector: &u32| graph.deepest_at(vector & !1);
    let reset = vectors.get(1).context("the image has no vector table")?;
    let thread = handler(reset)?;
    let of = |some: &[u32]| some.iter().filter(|v| **v != 0).map(handler).collect::<Result<Vec<_>>>();
    let faults = of(vectors.get(FAULTS).unwrap_or_default())?;
    let handlers: BTreeSet<u32> = vectors.iter().skip(EXCEPTIONS - 2).copied().collect();
    let mut interrupts = of(&handlers.into_iter().collect::<Vec<_>>())?;
    interrupts.sort_unstable_by(|a, b| b.cmp(a));
    let fault = faults.into_iter().max().unwrap_or_default();
    let symbol = |name: &str| {
        let found = graph.symbols.iter().find(|s| s.name == name).map(|s| s.address);
        found.with_context(|| format!("the image has no symbol {name}"))
    };
    Ok(Bound {
        thread,
        interrupts: interrupts.iter().take(LEVELS).chain([&fault]).map(|deep| deep + FRAME).sum(),
        size: symbol("_stack_start")? - symbol("_stack_end")?,
        way: graph.way(reset & !1),
    })
}

/// `cargo xtask stack`: prints what an image can need and the thread's deepest way.
pub fn command(image: &Path) -> Result<()> {
    let bound = of(&Elf::read(image)?)?;
    for (takes, name) in &bound.way {
        println!("{takes:6}  {name}");
    }
    println!(
        "{} bytes in the thread, {} in interrupts, {} there",
        bound.thread, bound.interrupts, bound.size
    );
    Ok(())
}

/// One function.
struct Function {
    name: String,
    takes: u32,
    calls: BTreeSet<u32>,
    by_pointer: bool,
}

/// Who calls whom, by address.
struct Graph {
    symbols: Vec<Symbol>,
    functions: BTreeMap<u32, Function>,
    deepest: BTreeMap<u32, u32>,
}

impl Bound {
    /// The thread's and the interrupts' together, bytes.
    pub fn all(&self) -> u32 {
        self.thread + self.interrupts
    }
}

impl Graph {
    fn read(elf: &Elf) -> Result<Self> {
        let symbols = elf.symbols();
        let functions = functions(elf, &symbols)?;
        Self::of(symbols, functions)
    }

    fn of(symbols: Vec<Symbol>, functions: BTreeMap<u32, Function>) -> Result<Self> {
        let mut graph = Self { symbols, functions, deepest: BTreeMap::new() };
        graph.point()?;
        let reach: BTreeMap<u32, BTreeSet<u32>> =
            graph.functions.keys().map(|at| (*at, graph.reached(*at))).collect();
        for at in reach.keys() {
            graph.sink(*at, &reach)?;
        }
        Ok(graph)
    }

    /// Gives each call through a pointer what it may go to.
    fn point(&mut self) -> Result<()> {
        let names: Vec<(u32, String)> = self.functions.iter().map(|(at, f)| (*at, f.name.clone())).collect();
        let mut unknown = Vec::new();
        for function in self.functions.values_mut().filter(|f| f.by_pointer) {
            let known = BY_POINTER.iter().find(|(caller, _)| function.name.contains(caller));
            let may = known.map_or(&[][..], |(_, may)| may);
            let goes = names
                .iter()
                .filter(|(_, name)| may.iter().any(|(part, end)| name.contains(part) && name.ends_with(end)));
            let before = function.calls.len();
            function.calls.extend(goes.map(|(at, _)| at));
            if function.calls.len() == before {
                unknown.push(function.name.clone());
            }
        }
        if !unknown.is_empty() {
            bail!(
                "stack: calls through pointers that go to nothing known; say in BY_POINTER what they may call: {}",
                unknown.join(", ")
            );
        }
        Ok(())
    }

    /// Every function that one can come to, itself only where it can come to itself again.
    fn reached(&self, from: u32) -> BTreeSet<u32> {
        let mut reached = BTreeSet::new();
        let mut open = vec![from];
        while let Some(function) = open.pop().and_then(|at| self.functions.get(&at)) {
            open.extend(function.calls.iter().filter(|call| reached.insert(**call)));
        }
        reached
    }

    /// The most that a function and what it calls take. Functions that can come to each other count together, once.
    fn sink(&mut self, at: u32, reach: &BTreeMap<u32, BTreeSet<u32>>) -> Result<u32> {
        if let Some(known) = self.deepest.get(&at) {
            return Ok(*known);
        }
        let comes_to = |from: u32, to: u32| reach.get(&from).is_some_and(|r| r.contains(&to));
        let mut round: Vec<u32> =
            reach.keys().copied().filter(|other| comes_to(at, *other) && comes_to(*other, at)).collect();
        let function =
            |at: &u32| self.functions.get(at).with_context(|| format!("stack: no function at {at:#x}"));
        for one in &round {
            let name = &function(one)?.name;
            if !ONCE.iter().any(|part| name.contains(part)) {
                bail!("stack: {name} can come to itself again, so that its stack has no bound");
            }
        }
        if round.is_empty() {
            round.push(at);
        }
        let (mut takes, mut calls) = (0, BTreeSet::new());
        for one in &round {
            let function = function(one)?;
            takes += function.takes;
            calls.extend(function.calls.iter().copied().filter(|call| !round.contains(call)));
        }
        let mut below = 0;
        for call in calls {
            below = below.max(self.sink(call, reach)?);
        }
        self.deepest.extend(round.into_iter().map(|one| (one, takes + below)));
        Ok(takes + below)
    }

    fn deepest_at(&self, at: u32) -> Result<u32> {
        self.deepest.get(&at).copied().with_context(|| format!("stack: no function at {at:#x}"))
    }

    /// The deepest way from here.
    fn way(&self, from: u32) -> Vec<(u32, String)> {
        let mut way = Vec::new();
        let (mut at, mut seen) = (Some(from), BTreeSet::new());
        while let Some((here, function)) = at.and_then(|here| Some((here, self.functions.get(&here)?))) {
            seen.insert(here);
            way.push((function.takes, function.name.clone()));
            let next = function.calls.iter().copied().filter(|call| !seen.contains(call));
            at = next.max_by_key(|call| self.deepest.get(call).copied().unwrap_or(0));
        }
        way
    }
}

/// What each function takes and where it goes.
fn functions(elf: &Elf, symbols: &[Symbol]) -> Result<BTreeMap<u32, Function>> {
    let (base, code) = elf.code();
    let end = base + 2 * code.len() as u32;
    let inside = |s: &&Symbol| (base..end).contains(&s.address);
    let mut starts: BTreeMap<u32, (String, u32)> = BTreeMap::new();
    for symbol in symbols.iter().filter(|s| s.function).filter(inside) {
        let entry = starts.entry(symbol.address).or_insert_with(|| (plain(&symbol.name), 0));
        entry.1 = entry.1.max(symbol.size);
    }
    // Where code becomes data and data code (ELF for the ARM Architecture, mapping symbols).
    let maps: BTreeMap<u32, bool> = symbols
        .iter()
        .filter(inside)
        .filter(|s| s.name.starts_with("$d") || s.name.starts_with("$t"))
        .map(|s| (s.address, s.name.starts_with("$t")))
        .collect();
    let is_code = |at: u32| maps.range(..=at).next_back().is_none_or(|(_, code)| *code);
    let addresses: Vec<u32> = starts.keys().copied().collect();
    let mut functions = BTreeMap::new();
    for (number, (&start, (name, size))) in starts.iter().enumerate() {
        let next = addresses.get(number + 1).copied().unwrap_or(end);
        // Hand-written ones tell no size.
        let stop = if *size == 0 { next } else { start + size };
        let mut function =
            Function { name: name.clone(), takes: 0, calls: BTreeSet::new(), by_pointer: false };
        let (mut aligned, mut moved, mut from_frame) = (0, false, 7);
        let mut at = start;
        while at < stop {
            if !is_code(at) {
                at += 2;
                continue;
            }
            let half = |at: u32| code.get((at - base) as usize / 2).copied().unwrap_or(0);
            let (first, second) = (half(at), half(at + 2));
            match thumb::step(at, first, second) {
                Step::Other => {}
                Step::Takes(bytes) => function.takes += bytes,
                Step::Aligns(bytes) => aligned += bytes,
                // Back to a frame's beginning; what was taken since has been counted.
                Step::FromFrame(register) => from_frame = register,
                Step::Moves(7) => {}
                Step::Moves(register) if register == from_frame => {}
                Step::Moves(_) if aligned > 0 => moved = true,
                Step::Sets if name == "Reset" => {}
                Step::Moves(_) | Step::TakesUnknown | Step::Sets => {
                    bail!("stack: {name} takes an amount that its code does not tell")
                }
                Step::Goes(to) if (start..stop).contains(&to) => {}
                Step::Calls(to) | Step::Goes(to) => {
                    let Some(into) = addresses.iter().rev().find(|a| **a <= to) else {
                        bail!("stack: {name} goes to {to:#x}, where no function is")
                    };
                    function.calls.insert(*into);
                }
                Step::GoesByPointer => function.by_pointer = true,
            }
            at += if thumb::is_wide(first) { 4 } else { 2 };
        }
        if moved {
            function.takes += aligned;
        }
        functions.insert(start, function);
    }
    Ok(functions)
}

/// A name without its hashes.
fn plain(name: &str) -> String {
    format!("{:#}", rustc_demangle::demangle(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn graph(functions: &[(u32, &str, u32, &[u32], bool)]) -> Result<Graph> {
        let function = |(at, name, takes, calls, by_pointer): &(u32, &str, u32, &[u32], bool)| {
            let calls = calls.iter().copied().collect();
            (*at, Function { name: (*name).into(), takes: *takes, calls, by_pointer: *by_pointer })
        };
        Graph::of(Vec::new(), functions.iter().map(function).collect())
    }

    #[test]
    fn the_deepest_way_is_not_the_longest() {
        let functions: [(u32, &str, u32, &[u32], bool); 4] = [
            (2, "main", 8, &[4, 6], false),
            (4, "step", 16, &[8], false),
            (6, "deep", 64, &[], false),
            (8, "leaf", 24, &[], false),
        ];
        let graph = graph(&functions).unwrap();
        assert_eq!(graph.deepest_at(2).unwrap(), 72);
        assert_eq!(graph.way(2), [(8, "main".into()), (64, "deep".into())]);
    }

    #[test]
    fn what_can_come_to_itself_has_no_bound_but_where_it_is_named() {
        let round = |name| {
            graph(&[
                (2, "main", 8, &[4], false),
                (4, name, 16, &[6], false),
                (6, "core::fmt::b", 4, &[4], false),
            ])
        };
        let said = round("step").err().unwrap().to_string();
        assert!(said.contains("step can come to itself again"), "{said}");
        assert!(graph(&[(2, "step", 8, &[2], false)]).is_err());
        assert_eq!(round("core::fmt::a").unwrap().deepest_at(2).unwrap(), 28);
    }

    #[test]
    fn a_call_through_a_pointer_goes_to_the_deepest_it_may_or_is_an_error() {
        let adds = "seabearing_core::density::add";
        let known = [(2, adds, 8, &[][..], true), (4, "a::density::{{closure}}", 40, &[][..], false)];
        assert_eq!(graph(&known).unwrap().deepest_at(2).unwrap(), 48);
        let said = graph(&known[..1]).err().unwrap().to_string();
        assert!(said.contains(adds) && said.contains("BY_POINTER"), "{said}");
    }
}
