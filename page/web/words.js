// Numbers and times as people read them: UTC throughout, a value never without its deviation.

const two = (n) => String(n).padStart(2, '0');

// 12:34:56 of a time in ms since 1970; with the day where `day` is asked for.
export function clock(ms, day) {
  const at = new Date(ms);
  if (ms === null || ms === undefined || Number.isNaN(at.getTime())) return 'unknown';
  const time = `${two(at.getUTCHours())}:${two(at.getUTCMinutes())}:${two(at.getUTCSeconds())}`;
  return day ? `${at.toISOString().slice(0, 10)} ${time}` : time;
}

// The same as of another time: with its day where that is another.
export const moment = (ms, at) => clock(ms, Number.isFinite(ms) && Number.isFinite(at) && Math.floor(ms / 864e5) !== Math.floor(at / 864e5));

// How long ago, in words.
export function ago(ms) {
  if (!Number.isFinite(ms)) return 'unknown';
  const [past, s] = [ms >= 0, Math.abs(ms) / 1000];
  const text = s < 90 ? `${Math.round(s)} s` : s < 5400 ? `${Math.round(s / 60)} min` : s < 172800 ? `${Math.round(s / 3600)} h` : `${Math.round(s / 86400)} d`;
  return past ? `${text} ago` : `in ${text}`;
}

// A value and its deviation, to the digits that mean something.
export function withSd(x, sd, unit) {
  if (!Number.isFinite(x)) return 'not observable';
  if (!Number.isFinite(sd)) return `${x.toFixed(1)} ± ? ${unit}`;
  const digits = sd > 0 ? Math.min(4, Math.max(0, 1 - Math.floor(Math.log10(sd)))) : 1;
  return `${x.toFixed(digits)} ± ${sd.toFixed(digits)} ${unit}`;
}

// Degrees as three digits, as bearings are spoken.
export const bearing = (deg) => (Number.isFinite(deg) ? `${String(Math.round(deg) % 360).padStart(3, '0')}°` : '–');

export const metres = (m) => (m >= 10000 ? `${(m / 1000).toFixed(0)} km` : m >= 1000 ? `${(m / 1000).toFixed(1)} km` : `${Math.round(m)} m`);

// Which vessel of AIS a track is, as the newest verdict on it says; '–' where there is none.
export function vessel(r) {
  const sure = Number.isFinite(r?.probability) ? ` (${(100 * r.probability).toFixed(1)} %)` : '';
  switch (r?.verdict) {
    case 'vessel': return `${r.name ? `${r.name} ` : ''}${r.mmsi}${sure}`;
    case 'dark': return `dark${sure}`;
    case 'unmatched': return `unknown: ${r.reason}`;
    default: return '–';
  }
}

// An event in one line, and how grave it is.
export function event(r) {
  const who = r.station === null || r.station === undefined ? '' : `station ${r.station}: `;
  switch (r.type) {
    case 'line': {
      const grave = { up: 'good', silent: 'warn', down: 'bad' }[r.state] ?? '';
      return [`${who}line ${r.state}${r.cause ? `, ${r.cause}` : ''} (${r.peer ?? r.line ?? '?'})`, grave];
    }
    case 'fault': return [`${who}fault ${r.code}, ${r.value}`, 'warn'];
    case 'faults_held': return [`${who}${r.count} faults ${r.code} more`, 'warn'];
    case 'lost': return [`${who}${r.frames} records lost${r.cause ? `: ${r.cause}` : ''}`, 'bad'];
    case 'warning': return [`${who}${r.text ?? r.code}`, 'warn'];
    // Most texts say themselves whose alarm it is.
    case 'alarm': return [`${r.text?.startsWith('station ') ? '' : who}alarm ${r.state}: ${r.text ?? r.code}`, r.state === 'cleared' ? 'good' : 'bad'];
    case 'end': return [`${who}its input has ended`, ''];
    default: return [`${who}${r.text ?? r.type}`, ''];
  }
}

// An element with attributes and children.
export function element(name, attributes, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes ?? {})) {
    if (key === 'on') Object.entries(value).forEach(([what, run]) => made.addEventListener(what, run));
    else if (value !== false && value !== undefined) made.setAttribute(key, value === true ? '' : value);
  }
  made.append(...children);
  return made;
}
