// What is known, as the server's picture says it and the records that follow change it.

const STATES = ['hello', 'health', 'margins', 'time', 'line', 'end', 'shaft_rate', 'segment', 'transient'];
const TOLD = ['fault', 'faults_held', 'line', 'lost', 'warning', 'note', 'end', 'alarm'];
const [AT_ONCE, TRACKS, PLACES, POINTS, AZIGRAMS, EVENTS] = [6, 40, 400, 1500, 400, 300];

// When a record was true, ms since 1970; when it came if that is unknown.
export const when = (r) => Date.parse(r.utc ?? r.received_utc ?? '');

const bounded = (list, item, most) => {
  list.push(item);
  if (list.length > most) list.shift();
};

// A record as a point of a plot: the name of the series, and its columns.
function point(r) {
  const at = when(r);
  switch (r.type) {
    case 'bearing': return ['bearings', [at, r.azimuth_deg, r.sd_azimuth_deg, r.elevation_deg, r.snr_db, r.band]];
    case 'azimuth': return ['azimuths', [at, r.azimuth_deg, r.sd_deg, r.log_presence, r.detected]];
    case 'transient': return ['transients', [at, r.azimuth_deg, r.sd_azimuth_deg, r.peak_db, r.count]];
    case 'range': return ['ranges', [at, r.range_m, r.sd_range_m, r.detected]];
    case 'azigram': return ['azigrams', [at, r.edges_hz, r.azimuth_deg, r.coherence]];
    case 'health': return ['levels', [at, ...r.level_db_full_scale]];
    default: return null;
  }
}

export class Model {
  constructor() {
    this.stations = new Map();
    this.places = [];
    this.events = [];
    this.alarms = new Map();
    // Network tracks by their number, with their places as [ms, lat, lon].
    this.networks = new Map();
    this.records = 0;
    this.missed = 0;
    // The station whose series are kept.
    this.chosen = null;
    this.series = {};
  }

  // The server's picture of now or of a moment.
  load(picture) {
    this.places = picture.places ?? this.places;
    this.stations = new Map();
    for (const s of picture.stations) {
      const tracks = new Map(s.tracks.map((t) => [`${t.report.session}.${t.report.id}`, t]));
      this.stations.set(s.station, { ...s, tracks });
    }
    this.events = picture.events;
    this.networks = new Map((picture.networks ?? []).map((t) => [t.report.id, t]));
    this.alarms = new Map(picture.alarms.map((a) => [String(a.id), a]));
    if (!this.stations.has(this.chosen)) this.chosen = this.numbers()[0] ?? null;
  }

  numbers() {
    const said = this.places.filter((p) => p.station !== null).map((p) => p.station);
    const all = new Set([...this.stations.keys(), ...said]);
    return [...all].sort((a, b) => (a === null) - (b === null) || a - b);
  }

  // What was said of where a station is and how it is called.
  place(number) {
    return this.places.find((p) => p.station === number) ?? this.places.find((p) => p.station === null) ?? {};
  }

  take(r) {
    this.records += 1;
    if (r.type === 'alarm') this.alarms[r.state === 'cleared' ? 'delete' : 'set'](String(r.id), r);
    // What the picture already had comes once more where both overlap.
    const known = TOLD.includes(r.type) && this.events.slice(-50).some((e) => JSON.stringify(e) === JSON.stringify(r));
    if (TOLD.includes(r.type) && !known) bounded(this.events, r, EVENTS);
    if (r.type === 'network_track') return void this.network(r);
    if (r.type === 'ais_match') {
      const track = this.networks.get(r.network) ?? this.stations.get(r.station)?.tracks.get(`${r.of_session ?? r.session}.${r.id}`);
      if (track) track.ais = r;
      return;
    }
    if (r.type === 'alarm' || r.type === 'acknowledge' || r.type === 'note') return;
    const number = r.station ?? null;
    if (number === null && (r.session ?? null) === null) return;
    if (!this.stations.has(number)) {
      this.stations.set(number, { station: number, states: {}, newest: {}, tracks: new Map() });
      if (this.chosen === null) this.chosen = number;
    }
    const s = this.stations.get(number);
    [s.last_utc, s.last_received_utc] = [r.utc, r.received_utc];
    if (STATES.includes(r.type)) s.states[r.type] = r;
    if (r.type === 'hello') delete s.states.end;
    const made = point(r);
    if (made && number === this.chosen) bounded((this.series[made[0]] ??= []), made[1], r.type === 'azigram' ? AZIGRAMS : POINTS);
    if (made && !['health', 'azigram', 'transient'].includes(r.type)) bounded((s.newest[r.type] ??= []), r, AT_ONCE);
    if (r.type === 'track') this.report(s, r);
  }

  network(r) {
    if (r.state === 'withdrawn') return void this.networks.delete(r.id);
    if (!this.networks.has(r.id)) this.networks.set(r.id, { path: [] });
    const track = this.networks.get(r.id);
    track.report = r;
    if (Number.isFinite(r.lat_deg) && when(r) !== track.path.at(-1)?.[0]) track.path.push([when(r), r.lat_deg, r.lon_deg]);
    if (track.path.length > PLACES) track.path = track.path.filter((_, n) => n % 2 === 0);
    if (this.networks.size > TRACKS) this.networks.delete(this.networks.keys().next().value);
  }

  report(s, r) {
    const key = `${r.session}.${r.id}`;
    if (r.stage === 'withdrawn') return void s.tracks.delete(key);
    if (!s.tracks.has(key)) s.tracks.set(key, { path: [] });
    const track = s.tracks.get(key);
    track.report = r;
    const at = when(r);
    if (r.range_observable && Number.isFinite(r.x_m) && Number.isFinite(r.y_m) && at !== track.path.at(-1)?.[0]) {
      track.path.push([at, r.x_m, r.y_m]);
      track.drawn = null;
      if (track.path.length > PLACES) track.path = track.path.filter((_, n) => n % 2 === 0);
    }
    if (s.tracks.size > TRACKS) s.tracks.delete(s.tracks.keys().next().value);
  }
}
