//! The published schema of the records (JSON Schema 2020-12), made of the types that write them.
//!
//! Out: one object with a description for each kind of record; a record is valid if it is one of them. Names are for ever,
//! and kinds may get new fields. `docs/records.schema.json` holds it.

use super::kinds;
use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, SchemaGenerator};
use serde::Serialize;
use serde_json::{Map, Value, json};

/// When a record's sample was.
#[derive(Serialize, JsonSchema)]
struct Moment {
    /// Seconds since sample 0 of the session; null where the sample rate is unknown.
    t_s: Option<f64>,
}

/// What a record has where it is known.
#[derive(Serialize, JsonSchema)]
struct WhereKnown {
    /// UTC of `t_s` (of a base station's own record: when it was made), RFC 3339; null or absent where no clock is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    utc: Option<String>,
    /// Standard deviation of `utc`, seconds; null or absent where none is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    sd_utc_s: Option<f64>,
    /// When the base station received it, RFC 3339; only in its records.
    #[serde(skip_serializing_if = "Option::is_none")]
    received_utc: Option<String>,
    /// Number of the recorder's station; only in a base station's records.
    #[serde(skip_serializing_if = "Option::is_none")]
    station: Option<u16>,
    /// Session of that recorder, counted by the base station.
    #[serde(skip_serializing_if = "Option::is_none")]
    session: Option<u32>,
    /// Sequence number of its frame, or its place in the log of a link; only in a base station's records.
    #[serde(skip_serializing_if = "Option::is_none")]
    sequence: Option<u32>,
    /// Only where it is published over MQTT (docs/fleet.md): `base` that publishes it, `log` (the number of its store), `number`
    /// of the record there, `packed`, what another base station needs to keep it, and `origin` (`log` and `number`) if it was made elsewhere.
    #[serde(skip_serializing_if = "Option::is_none")]
    relay: Option<Map<String, Value>>,
}

/// A base station is at its broker, or is there no more; only on a broker, where it is retained (docs/fleet.md).
#[derive(Serialize, JsonSchema)]
struct AtBroker {
    /// What it is called.
    base: String,
    /// Number of its store, 16 hexadecimal digits.
    log: String,
    /// `online` or `offline`.
    state: String,
}

/// Records that a recorder made and that never came.
#[derive(Serialize, JsonSchema)]
struct Lost {
    /// How many.
    frames: u32,
    /// Of which class of importance, where a link tells it.
    #[serde(skip_serializing_if = "Option::is_none")]
    class: Option<String>,
    /// Why, where a link tells it.
    #[serde(skip_serializing_if = "Option::is_none")]
    cause: Option<String>,
    /// How many of the class the recorder says it has dropped unsent in all, where a link tells it.
    #[serde(skip_serializing_if = "Option::is_none")]
    dropped_by_recorder: Option<u32>,
}

/// The state of a line has changed.
#[derive(Serialize, JsonSchema)]
struct Line {
    /// `up`, `down` or `silent`.
    state: String,
    /// The line, as the base station was told of it.
    line: String,
    /// Who is at the other end, where that is known.
    peer: Option<String>,
    /// Why, where something failed.
    #[serde(skip_serializing_if = "Option::is_none")]
    cause: Option<String>,
}

/// Something that somebody should look after, raised once, acknowledged by a person, cleared once (docs/alarms.md).
#[derive(Serialize, JsonSchema)]
struct Alarm {
    /// Number of the alarm, never used again; the same in all its states.
    id: u64,
    /// What, by name.
    code: String,
    /// The name of its rule.
    name: String,
    /// `raised`, `acknowledged` or `cleared`.
    state: String,
    /// Number of the station's track that it is about.
    track: Option<u32>,
    /// Session of that track.
    of_session: Option<u32>,
    /// Number of the network track that it is about; `station` is then the first of its members' that the rule is about.
    network: Option<u32>,
    /// Channel that it is about, from 0.
    channel: Option<u8>,
    /// How likely it is true, 0 to 1, where the rule asks for a probability.
    probability: Option<f64>,
    /// The same in words, as when it was raised.
    text: String,
}

/// What became of all tracks beside AIS that have ended, every hour and at the end (`base --ais`), or of all tracks (`ais match`;
/// docs/ais.md).
#[derive(Serialize, JsonSchema)]
struct AisFleet {
    /// Tracks.
    tracks: u64,
    /// Those that are a vessel of AIS.
    vessels: u64,
    /// Those that are none.
    dark: u64,
    /// Those of which nobody can say.
    unmatched: u64,
    /// Median distance of places from AIS, metres.
    median_position_error_m: Option<f64>,
    /// Mean squared distance in standard deviations: 2 where covariances are honest.
    mean_distance2: Option<f64>,
    /// Places within the 95 % ellipse, percent.
    within_95_percent: Option<f64>,
    /// Errors of heading: `n`, `rms`, `median`, `rms_sd` (in standard deviations), and `histogram_sd`: `counts` a standard deviation
    /// wide each from `from` on, the first and the last with all beyond.
    heading_deg: Map<String, Value>,
    /// The same of speed.
    speed_m_s: Map<String, Value>,
    /// The same of the time of the closest point.
    cpa_time_s: Map<String, Value>,
    /// The same of its range.
    cpa_range_m: Map<String, Value>,
    /// Ranges to which vessels are heard, by speed: `from`, `to`, `tracks`, `median_heard_to_m`, `heard_to_90_percent_m`.
    heard_by_speed_m_s: Vec<Map<String, Value>>,
    /// The same by length.
    heard_by_length_m: Vec<Map<String, Value>>,
}

/// Which vessel of AIS a track is, when that is first known, when it changes, and with all errors at the track's end
/// (`base --ais`, `ais match`; docs/ais.md).
#[derive(Serialize, JsonSchema)]
struct AisMatch {
    /// Number of the station's track; null where it is of a network track.
    id: Option<u32>,
    /// Number of the network track that it is of.
    #[serde(skip_serializing_if = "Option::is_none")]
    network: Option<u32>,
    /// Session of that track; `session` where it is absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    of_session: Option<u32>,
    /// `running`, or `final` once the track has ended; only of a base station.
    #[serde(skip_serializing_if = "Option::is_none")]
    stage: Option<String>,
    /// `vessel`, `dark` (no vessel of AIS is it) or `unmatched` (nobody can say).
    verdict: String,
    /// Why nobody can say.
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
    /// Probability of the verdict, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    probability: Option<f64>,
    /// First report of the track, RFC 3339.
    from_utc: String,
    /// Last report of the track, RFC 3339.
    to_utc: String,
    /// Number of the vessel.
    #[serde(skip_serializing_if = "Option::is_none")]
    mmsi: Option<u64>,
    /// Which of several vessels with that number, from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    twin: Option<u8>,
    /// Its name; null where AIS does not tell it.
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<String>,
    /// Its length, metres; null where AIS does not tell it.
    #[serde(skip_serializing_if = "Option::is_none")]
    length_m: Option<f64>,
    /// Its distance from the track in standard deviations, heading and speed with it.
    #[serde(skip_serializing_if = "Option::is_none")]
    distance_sd: Option<f64>,
    /// Reports compared; errors follow where there are any.
    #[serde(skip_serializing_if = "Option::is_none")]
    n: Option<u32>,
    /// Root mean square of the distances from AIS, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    rms_position_error_m: Option<f64>,
    /// Mean squared distance in standard deviations; 2 where covariances are honest.
    #[serde(skip_serializing_if = "Option::is_none")]
    mean_distance2: Option<f64>,
    /// Error of the last heading, degrees.
    #[serde(skip_serializing_if = "Option::is_none")]
    heading_error_deg: Option<f64>,
    /// The same in standard deviations.
    #[serde(skip_serializing_if = "Option::is_none")]
    heading_error_sd: Option<f64>,
    /// Error of the last speed, metres a second.
    #[serde(skip_serializing_if = "Option::is_none")]
    speed_error_m_s: Option<f64>,
    /// The same in standard deviations.
    #[serde(skip_serializing_if = "Option::is_none")]
    speed_error_sd: Option<f64>,
    /// Error of the time of the closest point, seconds.
    #[serde(skip_serializing_if = "Option::is_none")]
    cpa_time_error_s: Option<f64>,
    /// The same in standard deviations.
    #[serde(skip_serializing_if = "Option::is_none")]
    cpa_time_error_sd: Option<f64>,
    /// Error of the range of the closest point, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    cpa_range_error_m: Option<f64>,
    /// The same in standard deviations.
    #[serde(skip_serializing_if = "Option::is_none")]
    cpa_range_error_sd: Option<f64>,
    /// Greatest range of the vessel at a report, metres.
    #[serde(skip_serializing_if = "Option::is_none")]
    heard_to_m: Option<f64>,
    /// Its speed by AIS at the last report, metres a second.
    #[serde(skip_serializing_if = "Option::is_none")]
    vessel_speed_m_s: Option<f64>,
}

/// A person has acknowledged an alarm on the page; not stored: what is stored is the `alarm` in its new state.
#[derive(Serialize, JsonSchema)]
struct Acknowledge {
    /// Number of the alarm.
    id: u64,
}

/// A line for a person on the page and the terminal, not stored.
#[derive(Serialize, JsonSchema)]
struct Note {
    /// What, by name, where it has one: `StoreFails`, `StoreTakes`.
    #[serde(skip_serializing_if = "Option::is_none")]
    code: Option<String>,
    /// What it says.
    text: String,
}

/// The reader of standard output was too slow; these are stored, and not shown.
#[derive(Serialize, JsonSchema)]
struct NotShown {
    /// How many records.
    records: u64,
}

/// The properties of an object's type, and which of them are always there.
fn fields<T: JsonSchema>(generator: &mut SchemaGenerator) -> (Map<String, Value>, Vec<Value>, Value) {
    let schema = T::json_schema(generator).to_value();
    let properties = schema["properties"].as_object().cloned().unwrap_or_default();
    let required = schema["required"].as_array().cloned().unwrap_or_default();
    (properties, required, schema["description"].clone())
}

/// A kind of record; `timed`: whether it is about a sample.
fn kind<T: JsonSchema>(generator: &mut SchemaGenerator, name: &str, timed: bool) -> Value {
    let (own, own_required, description) = fields::<T>(generator);
    let mut properties = Map::new();
    properties.insert("type".into(), json!({ "const": name, "description": "The kind of record." }));
    let mut required = vec![json!("type")];
    if timed {
        let (moment, always, _) = fields::<Moment>(generator);
        properties.extend(moment);
        required.extend(always);
    }
    let (known, ..) = fields::<WhereKnown>(generator);
    properties.extend(known);
    properties.extend(own);
    required.extend(own_required);
    json!({
        "title": name, "description": description, "type": "object",
        "properties": properties, "required": required,
    })
}

/// The schema of everything that `process` and `base` print.
pub fn schema() -> Value {
    let mut settings = SchemaSettings::draft2020_12().for_serialize();
    settings.inline_subschemas = true;
    let g = &mut settings.into_generator();
    let kinds = [
        kind::<kinds::Hello>(g, "hello", false),
        kind::<kinds::Bearing>(g, "bearing", true),
        kind::<kinds::Track>(g, "track", true),
        kind::<kinds::Health>(g, "health", true),
        kind::<kinds::Azimuth>(g, "azimuth", true),
        kind::<kinds::Range>(g, "range", true),
        kind::<kinds::Segment>(g, "segment", true),
        kind::<kinds::Fault>(g, "fault", true),
        kind::<kinds::FaultsHeld>(g, "faults_held", true),
        kind::<kinds::Reply>(g, "reply", false),
        kind::<kinds::ShaftRate>(g, "shaft_rate", true),
        kind::<kinds::Time>(g, "time", true),
        kind::<kinds::Level>(g, "level", true),
        kind::<kinds::NetworkTrack>(g, "network_track", false),
        kind::<super::sound::Snippet>(g, "snippet", true),
        kind::<super::sound::Samples>(g, "samples", true),
        kind::<super::sound::Spectrum>(g, "spectrum", true),
        kind::<super::sound::Azigram>(g, "azigram", true),
        kind::<super::margins::Margins>(g, "margins", true),
        kind::<super::transient::Transient>(g, "transient", true),
        kind::<kinds::End>(g, "end", true),
        kind::<Lost>(g, "lost", false),
        kind::<Line>(g, "line", false),
        kind::<super::warning::Warning>(g, "warning", false),
        kind::<Alarm>(g, "alarm", false),
        kind::<AisMatch>(g, "ais_match", false),
        kind::<AisFleet>(g, "ais_fleet", false),
        kind::<Acknowledge>(g, "acknowledge", false),
        kind::<Note>(g, "note", false),
        kind::<NotShown>(g, "not_shown", false),
        kind::<AtBroker>(g, "base", false),
    ];
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Records of seabearing",
        "description": "One JSON object a line, as `process` and `base` print them. Null means: not detected, not \
            observable, or not known. Angles are degrees, lengths metres.",
        "oneOf": kinds,
    })
}
