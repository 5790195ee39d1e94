// How a recorder is: what it reports, and how far each is from what it must not reach.

import { ago, element } from '/words.js';

const LOST = ['lost_gap', 'lost_overlap', 'lost_invalid', 'lost_clipped', 'lost_dead_channel', 'lost_remainder'];
// Deviation of UTC beyond which times are doubtful, s; how far ahead of its coming a record's time may be, ms.
const [UNSURE, AHEAD] = [1, 60e3];

const ahead = (s) => Date.parse(s.last_utc ?? '') - Date.parse(s.last_received_utc ?? '') > AHEAD;

// One word and how grave it is.
export function healthInAWord(s) {
  const h = s.states.health;
  if (h?.dead_channels.length) return [`channel ${h.dead_channels.join(', ')} dead`, 'bad'];
  if (h?.frames_dropped) return [`${h.frames_dropped} dropped`, 'bad'];
  const near = s.states.margins && passed(s.states.margins);
  if (near) return [near, 'bad'];
  if (h?.clipping_channels.length) return [`channel ${h.clipping_channels.join(', ')} clips`, 'warn'];
  if (ahead(s)) return ['clock ahead', 'bad'];
  if ((s.states.time?.sd_utc_s ?? 0) > UNSURE) return ['clock unsure', 'warn'];
  return h ? ['well', 'good'] : ['not told', ''];
}

// Where these are passed the text warns, as the alarm `margin` does that names no limits: V of the supply, whose recording ends
// at 2.85 V, and of the clock's cell; bytes of memory; share of the room for records; degrees.
const LIMITS = { supply_v: 3.0, battery_v: 2.4, memory: 4096, full: 0.8, temperature_c: 75 };

const passed = (m) => [
  [m.supply_v !== null && m.supply_v < LIMITS.supply_v, 'supply low'],
  [m.memory_free_bytes < LIMITS.memory, 'memory low'],
  [m.room !== null && m.waiting > LIMITS.full * m.room, 'store full'],
  [m.temperature_c !== null && m.temperature_c > LIMITS.temperature_c, 'hot'],
  [m.battery_v !== null && m.battery_v < LIMITS.battery_v, 'cell empty'],
].find(([is]) => is)?.[1];

// What the board has left.
function margins(m, add) {
  add('Memory', `${(m.memory_free_bytes / 1024).toFixed(1)} of ${(m.memory_bytes / 1024).toFixed(1)} KiB for the stack never used`, m.memory_free_bytes < LIMITS.memory ? 'bad' : 'good');
  add('Longest work', `${(1000 * m.longest_s).toFixed(1)} ms on a block`);
  if (m.room !== null) add('Waiting', `${m.waiting} records, room for about ${m.room}`, m.waiting > LIMITS.full * m.room ? 'bad' : 'good');
  const volts = (name, v, least) => add(name, v === null ? 'not measured' : `${v.toFixed(3)} V`, v === null ? '' : v < least ? 'bad' : 'good');
  volts('Supply', m.supply_v, LIMITS.supply_v);
  volts("Clock's cell", m.battery_v, LIMITS.battery_v);
  if (m.temperature_c !== null) add('Temperature', `${m.temperature_c} °C in the processor`, m.temperature_c > LIMITS.temperature_c ? 'bad' : 'good');
}

// Terms and what is said of them.
function told(s, at) {
  const { hello, health: h, margins: m, time, line, transient: heard } = s.states;
  const said = [];
  const add = (name, text, grave = '') => said.push([name, text, grave]);
  if (hello) add('Recorder', `${{ array: 'array', obs: 'ocean bottom' }[hello.kind] ?? 'waits for commands'}, ${hello.rate_hz} Hz, firmware ${hello.version}`);
  if (line) add('Line', `${line.state}${line.cause ? `, ${line.cause}` : ''} since ${ago(at - Date.parse(line.utc ?? ''))}, ${line.peer ?? line.line}`, line.state === 'up' ? 'good' : 'warn');
  if (h) {
    const levels = h.level_db_full_scale.filter((l) => l > -128);
    const margin = -Math.max(...levels);
    add('Room to clipping', levels.length ? `${margin.toFixed(1)} dB on the loudest channel` : 'nothing was heard', margin < 6 ? 'warn' : '');
    const dead = h.dead_channels.length;
    add('Channels', dead ? `dead: ${h.dead_channels.join(', ')}` : h.clipping_channels.length ? `clip: ${h.clipping_channels.join(', ')}` : 'all work', dead ? 'bad' : h.clipping_channels.length ? 'warn' : 'good');
    const lost = LOST.reduce((sum, key) => sum + h[key], 0);
    const share = (100 * lost) / (h.processed + lost || 1);
    add('Samples lost', `${share.toFixed(share < 0.1 ? 3 : 1)} %${lost ? `: ${LOST.filter((k) => h[k]).map((k) => k.slice(5).replace('_', ' ')).join(', ')}` : ''}`, share > 1 ? 'warn' : '');
    add('Queue', h.frames_dropped ? `${h.frames_dropped} of ${h.records} records dropped` : `none of ${h.records} records dropped`, h.frames_dropped ? 'bad' : 'good');
  }
  if (time) {
    add('Clock', `± ${time.sd_utc_s === null ? 'unknown' : `${time.sd_utc_s.toPrecision(2)} s`}${time.drift_ppm === null ? '' : `, drifts ${time.drift_ppm.toFixed(2)} ppm`}`, time.sd_utc_s > UNSURE ? 'warn' : 'good');
  } else {
    add('Clock', s.last_utc ? 'as a person said' : 'none: times are those of arrival', 'warn');
  }
  if (heard) {
    const from = heard.azimuth_deg === null ? 'of no known direction' : `from ${heard.azimuth_deg.toFixed(1)}°`;
    const others = heard.count > 1 ? `, strongest of ${heard.count}` : '';
    add('Newest transient', `${heard.kind} ${from}, ${heard.peak_db.toFixed(1)} dB re ${heard.reference}, ${ago(at - Date.parse(heard.utc ?? heard.received_utc ?? ''))}${others}`);
  }
  if (ahead(s)) add('Clock', `its records are ${ago(Date.parse(s.last_received_utc) - Date.parse(s.last_utc))} of their arrival: it has jumped`, 'bad');
  if (m) margins(m, add);
  // What the recorder's records do not hold is not guessed.
  else add('Memory, supply', 'none was reported');
  return said;
}

// Fills a list of terms.
export function fillHealth(list, s, at) {
  const said = s ? told(s, at) : [];
  const key = JSON.stringify(said);
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  if (!said.length) return list.replaceChildren(element('dt', {}, 'Station'), element('dd', {}, 'none was heard'));
  list.replaceChildren(...said.flatMap(([name, text, grave]) => [element('dt', {}, name), element('dd', { class: grave }, text)]));
}
