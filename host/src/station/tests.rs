use super::*;

const GOOD: &str = r#"
[station]
id = 1
name = "east"
kind = "array"
position = { lat_deg = 49.04, lon_deg = -123.32, depth_m = 168.0 }

[sampling]
rate_hz = 64000

[array]
hydrophones_m = [[0.0, 1.07, -0.38], [0.93, -0.53, -0.38], [-0.93, -0.53, -0.38], [0.0, 0.0, 1.13]]
"#;

fn parse(text: &str) -> Result<Station> {
    Station::parse(text, "s.toml", Path::new("."))
}

#[test]
fn a_good_file_reads_and_hashes_stably() {
    let a = parse(GOOD).unwrap().config;
    let b = parse(GOOD).unwrap().config;
    assert_eq!(a.hash(), b.hash());
    assert_ne!(a.hash(), parse(&GOOD.replace("168", "169")).unwrap().config.hash());
}

#[test]
fn a_speed_curve_is_read_and_checked() {
    let with = |curve: &str| parse(&format!("{GOOD}\n[tracking]\nspeed_from_shaft = {{ {curve} }}\n"));
    let curve = with("at_zero_m_s = 0.5, metres_a_turn = 3.1, sd_m_s = 0.6, blades = 4").unwrap();
    let curve = curve.config.tracking.shaft_speed.unwrap();
    assert_eq!((curve.slope_m, curve.blades), (3.1, Some(4)));
    let e = with("at_zero_m_s = 0.5, metres_a_turn = 0.0, sd_m_s = 0.6").unwrap_err().to_string();
    assert!(e.contains("metres_a_turn") && e.contains("line 15"), "{e}");
}

#[test]
fn a_schedule_is_read_and_its_limits_are_named() {
    let with = |every_s: u32, on_s: u32| {
        parse(&format!("{GOOD}\n[schedule]\nevery_s = {every_s}\non_s = {on_s}\n")).map(|s| s.config)
    };
    let config = with(3600, 600).unwrap();
    assert!((config.schedule.share() - 1.0 / 6.0).abs() < 1e-12);
    let always = parse(GOOD).unwrap().config;
    assert_eq!((always.schedule.share(), with(0, 0).unwrap().hash()), (1.0, always.hash()));
    assert!(config.hash() != always.hash() && config.hash() != with(3600, 601).unwrap().hash());
    for (every_s, on_s, key, line) in
        [(3600, 5, "on_s", 16), (3600, 3595, "on_s", 16), (19, 10, "every_s", 15)]
    {
        let e = with(every_s, on_s).unwrap_err().to_string();
        assert!(e.contains(key) && e.contains(&format!("line {line}")), "{e}");
    }
}

#[test]
fn what_a_card_keeps_is_read_and_its_limits_are_named() {
    let with = |text: &str| parse(&format!("{GOOD}\n[card]\n{text}\n")).map(|s| s.config);
    let config = with("record = \"events\"\nbefore_s = 20").unwrap();
    assert_eq!(config.clips, Clips { before_s: 20, after_s: 30, apart_s: 600 });
    let all = parse(GOOD).unwrap().config;
    assert_eq!(with("record = \"all\"\nbefore_s = 20").unwrap().hash(), all.hash());
    assert!(config.hash() != all.hash() && config.hash() != with("record = \"events\"").unwrap().hash());
    for (key, value) in [("before_s", 301), ("after_s", 0), ("after_s", 3601), ("apart_s", 0)] {
        let e = with(&format!("record = \"events\"\n{key} = {value}")).unwrap_err().to_string();
        assert!(e.contains(key) && e.contains("line 16"), "{e}");
    }
}

#[test]
fn speeds_no_fit_considers_are_refused() {
    let with = |speed: &str| parse(&format!("{GOOD}\n[tracking]\nspeed_m_s = {speed}\n"));
    assert!(with("0.2").is_ok() && with("40.0").is_ok());
    let e = with("0.15").unwrap_err().to_string();
    assert!(e.contains("`speed_m_s` is 0.15; allowed 0.2 to 40") && e.contains("line 15"), "{e}");
    let mut config = with("7.0").unwrap().config;
    let curve =
        |valid_m_s| SpeedCurve { intercept_m_s: 0.5, slope_m: 3.1, sd_m_s: 0.6, blades: None, valid_m_s };
    for (valid_m_s, good) in
        [((0.2, 30.0), true), ((0.0, 30.0), false), ((5.0, 1.0), false), ((1.0, f64::NAN), false)]
    {
        config.tracking.shaft_speed = Some(curve(valid_m_s));
        assert_eq!(config.validate().is_ok(), good, "{valid_m_s:?}");
    }
}

#[test]
fn the_vessels_depth_is_one_value() {
    let motion = |depth: &str| {
        let text = GOOD.replace("[array]\n", &format!("[array]\nvessel_depth_m = {depth}\n"));
        seabearing_core::passage::Config::of_station(&parse(&text).unwrap().config)
    };
    assert_eq!((motion("4.0").medium.height_m, motion("9.0").medium.height_m), (166.0, 163.5));
}

#[test]
fn what_the_chain_cannot_run_names_key_line_and_remedy() {
    let refused = |change: (&str, &str)| {
        let source = TomlFile::of(&GOOD.replace(change.0, change.1), "s.toml");
        Station::recordable(&source, Path::new(".")).unwrap_err().to_string()
    };
    let e = refused(("64000", "4000"));
    assert!(e.contains("s.toml, line 9") && e.contains("step_s") && e.contains("higher rate"), "{e}");
    let e = refused(("1.07", "9.07"));
    assert!(e.contains("line 9") && e.contains("samples across") && e.contains("nearer"), "{e}");
    let e = refused(("[array]", "[array]\nband_hz = [100.0, 210.0]"));
    assert!(e.contains("line 12") && e.contains("wider"), "{e}");
    assert!(Station::recordable(&TomlFile::of(GOOD, "s.toml"), Path::new(".")).is_ok());
}

#[test]
fn wrong_files_name_key_and_line() {
    let e = parse(&GOOD.replace("rate_hz", "rate_khz")).unwrap_err().to_string();
    assert!(e.contains("rate_khz") && e.contains("line 9"), "{e}");
    let e = parse(&GOOD.replace("1.13", "-0.38")).unwrap_err().to_string();
    assert!(e.contains("one plane") && e.contains("line 12"), "{e}");
    let e = parse(&GOOD.replace("64000", "64")).unwrap_err().to_string();
    assert!(e.contains("rate_hz") && e.contains("line 9"), "{e}");
    let e = parse(&GOOD.replace("kind = \"array\"\n", "")).unwrap_err().to_string();
    assert!(e.contains("kind"), "{e}");
}

#[test]
fn components_are_channels_of_their_own() {
    let of = |north: &str, east: &str| {
        parse(&format!(
            "[station]\nid = 1\nkind = \"obs\"\n[sampling]\nrate_hz = 50\n[obs]\n\
             components = {{ pressure = \"BDH\", north = \"{north}\", east = \"{east}\", vertical = \"BHZ\" }}\n"
        ))
    };
    assert!(of("BH1", "BH2").is_ok());
    let e = of("BH1", "BH1").unwrap_err().to_string();
    assert!(e.contains("`north` and `east`") && e.contains("line 7"), "{e}");
    assert!(of("BHZ", "BH2").unwrap_err().to_string().contains("`north` and `vertical`"));
}
