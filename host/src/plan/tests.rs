use super::*;
use std::path::Path;

const ARRAY: &str = r#"
[station]
id = 1
name = "east"
kind = "array"
[sampling]
rate_hz = 64000
[array]
hydrophones_m = [[0.0, 1.07, -0.38], [0.93, -0.53, -0.38], [-0.93, -0.53, -0.38], [0.0, 0.0, 1.13]]
"#;

fn station(text: &str) -> Station {
    Station::parse(text, "s.toml", Path::new(".")).unwrap()
}

fn usual() -> Deployment {
    Deployment {
        vessels_a_day: 20.0,
        minutes_each: 30.0,
        at_once: 8,
        health_s: 60.0,
        baud: 921_600.0,
        link_bytes_a_day: None,
        card_bytes: None,
        sample_bytes: 3.0,
        days: None,
        duty: 1.0,
        ram_bytes: None,
        flash_bytes: None,
        cycles: None,
        power: Power::default(),
    }
}

fn planned(deployment: &Deployment) -> Plan {
    of(&station(ARRAY), deployment).unwrap()
}

/// The one thing that does not fit.
fn misfit(deployment: &Deployment) -> String {
    let plan = planned(deployment);
    assert_eq!(plan.misfits.len(), 1, "{:?}", plan.misfits);
    plan.misfits[0].clone()
}

#[test]
fn the_usual_fits_and_is_what_was_measured() {
    let plan = planned(&usual());
    assert_eq!(plan.misfits, Vec::<String>::new());
    let snapshot = include_str!("../../../docs/budget.txt");
    let row = |name: &str| {
        let line = snapshot.lines().find(|line| line.starts_with(name)).unwrap();
        line[name.len()..].split_whitespace().next().unwrap().parse::<f64>().unwrap()
    };
    assert!((plan.instructions_per_s / 1e6 - row("array work, million instructions/s")).abs() < 1e-6);
    // The model's own count of sleep, but for the interrupts' entries and what the board sends.
    let asleep = row("stm32h743 store asleep, %");
    assert!((100.0 * (1.0 - plan.awake) - asleep).abs() < 0.5, "{} {asleep}", plan.awake);
    assert_eq!((plan.ram_bytes.1, plan.flash_bytes.1), (524_288.0, 1_048_576.0));
    assert_eq!(plan.card_bytes_a_day, 64_000.0 * 12.0 * 86_400.0);
    assert!(plan.link_bytes_a_day < plan.worst_bytes_a_day);
}

#[test]
fn clips_take_whole_files_and_a_card_has_only_so_many() {
    let text = format!("{ARRAY}\n[card]\nrecord = \"events\"\nbefore_s = 20\nafter_s = 40\napart_s = 600\n");
    let clips = |deployment: &Deployment| of(&station(&text), deployment).unwrap();
    // 20 vessels with 3 clips each, and 12 false alarms, of two minutes each: two files of a minute.
    let plan = clips(&Deployment { card_bytes: Some(64e9), ..usual() });
    assert!((plan.card_bytes_a_day - 72.0 * 120.0 * 768e3).abs() < 1.0, "{}", plan.card_bytes_a_day);
    assert!((plan.card_days.unwrap() - 1000.0 / 144.0).abs() < 1e-9);
    let small = clips(&Deployment { card_bytes: Some(8e9), ..usual() });
    assert!((small.card_days.unwrap() - 8e9 / small.card_bytes_a_day).abs() < 1e-9);
    // However many vessels come, a day has only so many clips.
    let busy = clips(&Deployment { vessels_a_day: 1e4, minutes_each: 1.0, ..usual() });
    assert!((busy.card_bytes_a_day - 144.0 * 120.0 * 768e3).abs() < 1.0);
}

#[test]
fn every_thing_that_does_not_fit_is_told_by_name() {
    let slow = misfit(&Deployment { baud: 1200.0, ..usual() });
    assert!(
        slow.contains("120 bytes/s") && slow.contains("8 vessels") && slow.contains("baud at least"),
        "{slow}"
    );
    assert!(of(&station(ARRAY), &Deployment { vessels_a_day: 1e4, ..usual() }).is_err());
    assert!(misfit(&Deployment { ram_bytes: Some(65_536.0), ..usual() }).contains("RAM"));
    assert!(misfit(&Deployment { flash_bytes: Some(65_536.0), ..usual() }).contains("flash"));
    assert!(misfit(&Deployment { link_bytes_a_day: Some(1000.0), ..usual() }).contains("1000 bytes a day"));
    let card = Deployment { card_bytes: Some(1e12), days: Some(100.0), ..usual() };
    // The image that writes a card takes more of everything.
    assert!(planned(&card).image == "stm32h743-card" && planned(&card).ram_bytes.0 > 500_000.0);
    assert!(planned(&card).awake > planned(&usual()).awake);
    assert!(misfit(&card).contains("the card holds 15.1 of 100 days"), "{}", misfit(&card));
    assert_eq!(planned(&Deployment { duty: 0.1, ..card }).misfits, Vec::<String>::new());
    // Too slow a core misses the samples' queue as well.
    let busy = planned(&Deployment { cycles: Some(30.0), ..usual() });
    assert!(busy.misfits.iter().any(|m| m.contains("busy")) && busy.awake > 1.0, "{:?}", busy.misfits);
    let rate = of(&station(&ARRAY.replace("64000", "48000")), &usual()).unwrap();
    assert!(rate.misfits[0].contains("48000 Hz"), "{:?}", rate.misfits);
}

#[test]
fn what_nobody_measured_is_asked_for() {
    let ask = |power, duty| of(&station(ARRAY), &Deployment { power, duty, ..usual() });
    let battery = Power { battery_wh: Some(1000.0), ..Power::default() };
    let e = ask(battery, 0.5).unwrap_err().to_string();
    for option in ["--supply-v", "--awake-ma", "--asleep-ma", "--other-ma", "--off-ma"] {
        assert!(e.contains(option), "{e}");
    }
    assert!(!ask(battery, 1.0).unwrap_err().to_string().contains("--off-ma"));
    let known = Power {
        supply_v: Some(10.0),
        awake_ma: Some(100.0),
        asleep_ma: Some(100.0),
        other_ma: Some(100.0),
        off_ma: Some(0.0),
        ..battery
    };
    let plan = ask(known, 0.5).unwrap();
    assert_eq!(plan.mean_ma, Some(100.0));
    // A pause by the schedule is not off: converters, clock and line stay on.
    let text = format!("{ARRAY}\n[schedule]\nevery_s = 3600\non_s = 360\n");
    let known = Power { awake_ma: Some(150.0), asleep_ma: Some(40.0), other_ma: Some(60.0), ..known };
    let pauses = of(&station(&text), &Deployment { power: known, ..usual() }).unwrap();
    let awake = 0.1 * pauses.awake + 0.9 * pauses.awake_in_pauses;
    assert!((pauses.mean_ma.unwrap() - (60.0 + 40.0 + 110.0 * awake)).abs() < 1e-9);
    assert!((0.04..0.09).contains(&pauses.awake_in_pauses), "{}", pauses.awake_in_pauses);
    // Health goes on in it, and each is told.
    let quiet = Deployment { vessels_a_day: 0.0, ..usual() };
    let always = of(&station(ARRAY), &quiet).unwrap().link_bytes_a_day;
    assert!(of(&station(&text), &quiet).unwrap().link_bytes_a_day > 0.9 * always);
    assert!((plan.battery_days.unwrap() - 1000.0 / 24.0).abs() < 1e-9);
}

#[test]
fn values_that_cannot_be_are_refused_by_name() {
    for (deployment, option) in [
        (Deployment { duty: 0.0, ..usual() }, "--duty"),
        (Deployment { duty: f64::NAN, ..usual() }, "--duty"),
        (Deployment { baud: f64::INFINITY, ..usual() }, "--baud"),
        (Deployment { vessels_a_day: -1.0, ..usual() }, "--vessels-a-day"),
        (Deployment { card_bytes: Some(0.0), ..usual() }, "--card-gb"),
        (Deployment { at_once: 9, ..usual() }, "--at-once"),
    ] {
        let e = of(&station(ARRAY), &deployment).unwrap_err().to_string();
        assert!(e.contains(option) && e.contains("allowed"), "{e}");
    }
    let line = "[station]\nid = 1\nname = \"l\"\nkind = \"line\"\n[line]\nsensors = 23\nspacing_m = 0.75\n";
    assert!(of(&station(line), &usual()).unwrap_err().to_string().contains("no recorder"));
}

#[test]
fn slower_stations_cost_less_and_longer_steps_too() {
    let cost = |from: &str, to: &str| of(&station(&ARRAY.replace(from, to)), &usual()).unwrap();
    let (full, slow, sparse) =
        (cost("x", "x"), cost("64000", "16000"), cost("[array]", "[array]\nstep_s = 1.0\n"));
    assert!(slow.instructions_per_s < 0.6 * full.instructions_per_s && slow.awake < 0.6 * full.awake);
    assert!(sparse.instructions_per_s < full.instructions_per_s);
    assert!(sparse.link_bytes_a_day < full.link_bytes_a_day);
    assert!(sparse.worst_bytes_per_s < full.worst_bytes_per_s);
}
