// The page: what comes is taken into the model, and shown once a frame; the time slider looks back into the store.

import { coastline } from '/coast.js';
import { ChartMap } from '/map.js';
import { Model, when } from '/model.js';
import { Plots } from '/plots.js';
import { fillHealth, healthInAWord } from '/health.js';
import { ago, bearing, clock, element, event, moment, vessel, withSd } from '/words.js';

const $ = (id) => document.getElementById(id);
const asked = new URLSearchParams(location.search);
const model = new Model();
const map = new ChartMap($('map'), model, choose);
const plots = new Plots($('plots'));
// Live, or at a moment of the store; what came while the picture was fetched.
const state = { at: null, waiting: null, span: null, ahead: 0, connected: false, tables: true, playing: null, error: '', said: '' };

async function fetched(path, options) {
  const answer = await fetch(path, options);
  const body = await answer.json().catch(() => ({}));
  if (!answer.ok) throw new Error(body.error ?? `the base station answers ${answer.status}`);
  return body;
}

// The time that is shown, ms since 1970.
const shownAt = () => state.at ?? Date.now() + state.ahead;

// ---- what is live ----

function listen() {
  const source = new EventSource('/api/live');
  source.onopen = () => { [state.connected, state.ended] = [true, false]; if (state.at === null) showNow(); };
  // A base station that has ended may be started again: it is called until it is.
  source.onerror = () => { state.connected = false; mode(); };
  source.onmessage = (message) => {
    const said = JSON.parse(message.data);
    if (said.ended) { state.ended = true; return mode(); }
    if (said.behind) return state.at === null && showNow();
    model.missed += said.missed;
    if (state.waiting) state.waiting.push(...said.records);
    else if (state.at === null) said.records.forEach(take);
    state.tables = map.dirty = true;
  };
}

function take(r) {
  model.take(r);
  const [text, grave] = event(r);
  if (['line', 'fault', 'lost', 'warning', 'alarm'].includes(r.type) && grave) say(text);
}

async function showNow() {
  state.waiting = [];
  try {
    const now = await fetched('/api/moment');
    state.ahead = now.now - Date.now();
    state.error = '';
    if (state.at === null) {
      model.load(now);
      slider(now.span);
      // Plots follow; nobody waits for them to see who is heard.
      shown();
      await chosenSeries();
      state.waiting?.forEach((r) => model.take(r));
    }
  } catch (e) { state.error = e.message; }
  state.waiting = null;
  shown();
}

// ---- replay ----

function slider(span) {
  if (!span) return;
  const time = $('time');
  [time.min, time.max, time.step] = [span[0], Math.max(span[1], span[0] + 1), 1000];
  time.disabled = $('play').disabled = false;
  state.span = span;
  if (state.at === null) time.value = span[1];
}

let looking = null;
let next = null;

// Looks at a moment; of several asked for meanwhile only the last is looked at.
async function look(at) {
  state.at = Math.min(Math.max(at, state.span[0]), state.span[1]);
  $('time').value = state.at;
  [next, state.tables] = [state.at, true];
  if (looking) return;
  while (next !== null && state.at !== null) {
    [looking, next] = [next, null];
    try {
      const then = await fetched(`/api/moment?at=${looking}&window=${windowMs()}`);
      if (state.at !== null) { model.load(then); await chosenSeries(); state.error = ''; }
    } catch (e) { state.error = e.message; }
    shown();
  }
  looking = null;
}

function goLive() {
  play(false);
  [state.at, next] = [null, null];
  showNow();
}

function play(on) {
  clearInterval(state.playing);
  state.playing = on ? setInterval(() => {
    const to = state.at + 250 * Number($('speed').value);
    if (to >= state.span[1]) play(false);
    if (!looking) look(to);
  }, 250) : null;
  $('play').textContent = on ? 'Pause' : 'Play';
}

// ---- the chosen station ----

const windowMs = () => Number($('window').value) * 1000;

async function chosenSeries() {
  const number = model.chosen ?? '';
  const to = shownAt();
  const from = to - windowMs();
  const ask = (interval) => fetched(`/api/series?station=${number === '' ? -1 : number}${interval}`);
  const found = state.span ? await ask(`&from=${Math.round(from)}&to=${Math.round(to)}`) : {};
  // Without a store, or of a recorder without a clock, there is what the base station has in its memory.
  const none = Object.values(found).every((list) => !list.length);
  model.series = none && state.at === null ? await ask('') : found;
  map.dirty = true;
}

function choose(number) {
  model.chosen = number;
  model.series = {};
  chosenSeries().then(shown).catch((e) => { state.error = e.message; });
  [state.tables, map.dirty] = [true, true];
}

// ---- what is shown ----

function mode() {
  const badge = $('mode');
  const is = state.at !== null ? 'replay' : state.connected ? 'live' : 'lost';
  const wrong = state.said || state.error;
  const text = wrong || { replay: 'replay', live: state.ended ? 'input ended' : 'live', lost: 'no answer' }[is];
  if (badge.textContent !== text) badge.textContent = text;
  badge.dataset.is = wrong ? 'lost' : is;
}

const rows = new Map();

function stationRow(number) {
  if (!rows.has(number)) {
    const swatch = element('span', { class: 'swatch', 'aria-hidden': 'true' });
    const name = element('span', {});
    const button = element('button', { type: 'button', on: { click: () => choose(number) } }, swatch, name);
    const cells = Array.from({ length: 4 }, () => element('td', {}));
    rows.set(number, { swatch, name, button, cells, row: element('tr', {}, element('th', { scope: 'row' }, button), ...cells) });
  }
  return rows.get(number);
}

function put(cell, text, grave = '') {
  if (cell.textContent !== text) cell.textContent = text;
  if (cell.className !== grave) cell.className = grave;
}

function fillStations(at) {
  const numbers = model.numbers();
  for (const number of numbers) {
    const { swatch, name, button, cells, row } = stationRow(number);
    const s = model.stations.get(number);
    swatch.style.background = map.colour(number);
    put(name, model.place(number).name || (number === null ? 'unknown' : String(number)));
    button.setAttribute('aria-pressed', String(number === model.chosen));
    const line = s?.states.line?.state ?? (s ? 'file' : 'never heard');
    put(cells[0], s?.states.end ? `${line}, ended` : line, { up: 'good', silent: 'warn', down: 'bad', 'never heard': 'warn' }[line] ?? '');
    const last = Date.parse((state.at === null ? s?.last_received_utc : s?.last_utc) ?? '');
    put(cells[1], s ? ago(at - last) : '–', at - last > 180e3 ? 'warn' : '');
    const r = s?.newest.bearing?.at(-1) ?? s?.newest.azimuth?.findLast((a) => a.detected);
    put(cells[2], r ? `${bearing(r.azimuth_deg)} ± ${(r.sd_azimuth_deg ?? r.sd_deg ?? NaN).toFixed(1)}°` : '–');
    put(cells[3], ...(s ? healthInAWord(s) : ['–', '']));
    row.setAttribute('aria-current', String(number === model.chosen));
  }
  const wanted = numbers.map((n) => stationRow(n).row);
  const body = $('station-rows');
  if (wanted.length !== body.children.length || wanted.some((r, n) => body.children[n] !== r)) body.replaceChildren(...wanted);
  $('no-stations').hidden = numbers.length > 0;
}

function fillTracks(at) {
  const all = [...model.stations.values()].flatMap((s) => [...s.tracks.values()].map((t) => [s.station, t.report, t.ais]));
  all.sort(([, a], [, b]) => when(b) - when(a));
  // Without AIS there is no column of it.
  const beside = all.some(([, , ais]) => ais) || [...model.networks.values()].some((t) => t.ais);
  $('ais-head').hidden = !beside;
  const of = (text, grave) => (beside ? [element('td', { class: grave ?? false }, text)] : []);
  const made = all.slice(0, 30).map(([number, r, ais]) => {
    const ms = when(r) + (r.cpa_time_s - r.t_s) * 1000;
    const swatch = element('span', { class: 'swatch', 'aria-hidden': 'true' });
    swatch.style.background = map.colour(number);
    const closest = Number.isFinite(ms) && Number.isFinite(r.cpa_time_s) ? `${moment(ms, at)} ± ${(r.sd_cpa_time_s ?? NaN).toFixed(0)} s, ${ago(at - ms)}` : 'unknown';
    return element('tr', {},
      element('th', { scope: 'row' }, swatch, `${number ?? '?'}.${r.session}.${r.id}${r.stage === 'final' ? ' final' : ''}`),
      ...of(vessel(ais), ais?.verdict === 'dark' && 'warn'),
      element('td', {}, r.range_observable ? withSd(r.cpa_range_m, r.sd_cpa_range_m, 'm') : 'not observable'),
      element('td', {}, closest),
      element('td', {}, withSd(r.heading_deg, r.sd_heading_deg, '°').replace(' °', '°')),
      element('td', {}, withSd(r.speed_m_s, r.sd_speed_m_s, '').trim()));
  });
  const networks = [...model.networks.values()].sort((a, b) => when(b.report) - when(a.report)).slice(0, 30);
  const fused = networks.map(({ report: r, ais }) => element('tr', {},
    element('th', { scope: 'row' }, `network ${r.id}${r.state === 'final' ? ' final' : ''}`),
    ...of(vessel(ais), ais?.verdict === 'dark' && 'warn'),
    element('td', {}, r.consistent === false ? 'stations disagree' : r.x_m === null ? 'not observable' : ''),
    element('td', {}, `stations ${r.members.map((m) => m.station).join(', ')}`),
    element('td', {}, withSd(r.heading_deg, r.sd_heading_deg, '°').replace(' °', '°')),
    element('td', {}, withSd(r.speed_m_s, r.sd_speed_m_s, '').trim())));
  made.unshift(...fused);
  $('track-rows').replaceChildren(...made);
  $('no-tracks').hidden = made.length > 0;
}

function fillEvents(at) {
  const made = [...model.events].reverse().slice(0, 100).map((r) => {
    const [text, grave] = event(r);
    const ms = when(r);
    return element('li', {}, element('time', { datetime: Number.isFinite(ms) ? new Date(ms).toISOString() : false }, moment(ms, at)), element('span', { class: grave }, text));
  });
  $('events').replaceChildren(...made);
  $('no-events').hidden = made.length > 0;
}

// Alarms in the banner, unless all are to be seen.
const FEW = 5;

function fillAlarms(at) {
  // The newest that nobody has seen, then the newest of the others.
  const active = [...model.alarms.values()].filter((a) => a.state !== 'cleared').sort((a, b) => (a.state === 'raised') - (b.state === 'raised'));
  const section = $('alarms');
  if (active.length <= FEW) state.all = false;
  const live = state.at === null;
  const key = JSON.stringify([active.map((a) => [a.id, a.state]), Math.floor(at / 864e5), live, state.all]);
  if (section.dataset.key === key) return;
  section.dataset.key = key;
  section.hidden = active.length === 0;
  const seen = state.all ? active : active.slice(-FEW);
  const more = active.slice(0, active.length - seen.length);
  const unseen = more.filter((a) => a.state === 'raised').length;
  const raised = seen.filter((a) => a.state === 'raised');
  const button = (text, click, named, label) => element('button', { type: 'button', 'data-is': named, 'aria-label': label, on: { click } }, text);
  const tools = [];
  if (more.length) tools.push(element('span', {}, `${more.length} more alarms stand, ${unseen} of them not acknowledged`));
  if (active.length > FEW) tools.push(button(state.all ? 'Show fewer' : 'Show all alarms', () => { state.all = !state.all; state.tables = true; }, 'show'));
  if (live && raised.length > 1) tools.push(button(`Acknowledge all ${raised.length} shown`, () => raised.forEach((a) => acknowledge(a.id)), 'all'));
  const held = section.contains(document.activeElement) && (document.activeElement.dataset.is ?? 'one');
  const line = (a) => element('p', {}, element('span', {}, `${moment(when(a), at)} ${event(a)[0]}`),
    live && a.state === 'raised' ? button('Acknowledge', () => acknowledge(a.id), 'one', `Acknowledge alarm ${a.id}`) : '');
  const list = element('div', { class: 'list', tabindex: state.all ? '0' : false, role: state.all ? 'region' : false, 'aria-label': state.all ? 'List of alarms' : false }, ...seen.map(line));
  section.replaceChildren(...(tools.length ? [element('p', {}, ...tools)] : []), list);
  // The keyboard goes on with the same button, or the next.
  if (held) (section.querySelector(`button[data-is="${held}"]`) ?? section.querySelector('button') ?? $('live')).focus();
}

function acknowledge(id) {
  fetched(`/api/alarms/${encodeURIComponent(id)}/acknowledge`, { method: 'POST' }).catch((e) => say(e.message));
}

const toSay = [];

// For screen readers: what happened, several lines together.
function say(text) {
  toSay.push(text);
  if (toSay.length === 1) setTimeout(() => { $('says').textContent = toSay.splice(0).slice(-4).join('. '); }, 500);
}

function shown() {
  state.tables = map.dirty = true;
  document.documentElement.dataset.pictures = String(Number(document.documentElement.dataset.pictures ?? 0) + 1);
}

let second = 0;

function frame() {
  requestAnimationFrame(frame);
  const at = shownAt();
  map.now = at;
  if (map.dirty) map.draw();
  if (Math.floor(at / 1000) !== second) { second = Math.floor(at / 1000); state.tables = true; }
  if (!state.tables || performance.now() < (state.after ?? 0)) return;
  // Tables and plots need not follow every batch.
  state.after = performance.now() + 200;
  state.tables = false;
  $('utc').textContent = clock(at);
  $('utc').setAttribute('datetime', new Date(at).toISOString());
  $('at').textContent = !state.span ? 'no store: nothing to replay' : state.at === null ? 'now' : `${clock(state.at, true)} UTC`;
  $('time').setAttribute('aria-valuetext', `${clock(at, true)} UTC`);
  if (state.at === null && state.span) { $('time').max = Math.max(state.span[1], at); $('time').value = $('time').max; state.span[1] = Number($('time').max); }
  $('live').setAttribute('aria-pressed', String(state.at === null));
  mode();
  const up = [...model.stations.values()].filter((s) => s.states.line?.state === 'up').length;
  $('summary').textContent = `${up} of ${model.numbers().length} lines up${model.missed ? `, ${model.missed} records not shown` : ''}`;
  fillStations(at);
  fillTracks(at);
  fillEvents(at);
  fillAlarms(at);
  const s = model.stations.get(model.chosen);
  $('plots-title').textContent = model.chosen === null ? 'Station' : `Station ${model.place(model.chosen).name || model.chosen}`;
  fillHealth($('health'), s, at);
  // A recorder whose clock is elsewhere, or a file of long ago, is shown at its own time.
  const newest = Math.max(...Object.values(model.series).flatMap((list) => list.slice(-3).map((p) => p[0])), -Infinity);
  const to = state.at === null && Number.isFinite(newest) && Math.abs(at - newest) > windowMs() ? newest : at;
  plots.draw(model.series, to - windowMs(), to, map);
  const words = map.words();
  if ($('map-words').textContent !== words) $('map-words').textContent = words;
  document.documentElement.dataset.records = model.records;
}

// ---- settings ----

function theme(name) {
  document.documentElement.dataset.theme = name;
  $('theme').textContent = name === 'dark' ? 'Light' : 'Dark';
  map.theme();
  state.tables = true;
}

function size(n) {
  document.documentElement.dataset.size = n;
  $('larger').textContent = n === '2' ? 'Smaller text' : 'Larger text';
  map.theme();
}

function kept(key, value) {
  // A browser may refuse to keep anything.
  try {
    if (value === undefined) return localStorage.getItem(key);
    localStorage.setItem(key, value);
  } catch { /* then it is forgotten */ }
  return null;
}

// Says for a while what was wrong with what was asked, whatever comes meanwhile.
function complain(text) {
  state.said = text;
  setTimeout(() => { if (state.said === text) state.said = ''; state.tables = true; }, 8000);
}

async function dropped(file) {
  if (!file) return;
  try {
    if (file.size > 30e6) throw new Error('more than 30 MB');
    const text = await file.text();
    map.coast = coastline(text);
    kept('coast', text);
    say(`coastline ${file.name}`);
  } catch (e) {
    complain(`${file.name}: no coastline in GeoJSON: ${e.message}`);
  }
  map.dirty = state.tables = true;
}

$('theme').addEventListener('click', () => { const to = document.documentElement.dataset.theme === 'dark' ? 'light' : 'dark'; kept('theme', to); theme(to); });
$('larger').addEventListener('click', () => { const to = String((Number(document.documentElement.dataset.size ?? 0) + 1) % 3); kept('size', to); size(to); });
$('zoom-in').addEventListener('click', () => map.zoom(1.5));
$('zoom-out').addEventListener('click', () => map.zoom(1 / 1.5));
$('fit').addEventListener('click', () => map.fit());
$('coast').addEventListener('change', (e) => dropped(e.target.files[0]));
document.addEventListener('dragover', (e) => e.preventDefault());
document.addEventListener('drop', (e) => { e.preventDefault(); dropped(e.dataTransfer.files[0]); });
$('live').addEventListener('click', goLive);
$('play').addEventListener('click', () => { if (state.at === null) look(state.span[0]); play(state.playing === null); });
$('time').addEventListener('input', (e) => look(Number(e.target.value)));
$('time').addEventListener('keydown', (e) => {
  // A second is no step of a day.
  const minutes = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -60, PageUp: 60 }[e.key];
  if (minutes) { e.preventDefault(); look((state.at ?? state.span[1]) + minutes * 60e3); }
});
$('window').addEventListener('change', () => (state.at === null ? choose(model.chosen) : look(state.at)));
const resized = new ResizeObserver((entries) => {
  if (entries.some((e) => e.target === $('map'))) map.resized();
  map.dirty = state.tables = true;
});
[$('map'), $('plots')].forEach((e) => resized.observe(e));

theme(asked.get('theme') ?? kept('theme') ?? (matchMedia('(prefers-color-scheme: dark)').matches ? 'dark' : 'light'));
size(asked.get('size') ?? kept('size') ?? '0');
if (asked.get('window')) $('window').value = asked.get('window');
if (asked.get('station')) model.chosen = Number(asked.get('station'));
try { if (kept('coast')) map.coast = coastline(kept('coast')); } catch { /* as good as none */ }
listen();
frame();
showNow().then(() => {
  const text = asked.get('at');
  const at = Date.parse(text ?? '');
  if (Number.isFinite(at)) { if (state.span) look(at); }
  else if (text) complain(`at=${text}: no time (2026-06-01T12:00:00Z was expected)`);
});
// For measurements from outside.
window.seabearing = { model, map, look, goLive, state };
