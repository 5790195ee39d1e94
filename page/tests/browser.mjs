// The page in a real browser: how soon it shows, how smooth it is, whether everyone can use it, and its pictures.
//
// node browser.mjs --url http://.. [--line HOST:PORT --frames HEX,HEX,..] [--pictures DIR] [--chromium PATH]
//
// puppeteer-core and axe-core are looked for beside the current folder. Out: one JSON object a line, a name and a value.

import { createRequire } from 'node:module';
import { connect } from 'node:net';
import { join } from 'node:path';

const require = createRequire(join(process.cwd(), 'here.js'));
const puppeteer = require('puppeteer-core').default ?? require('puppeteer-core');
const axe = require('axe-core').source;

const given = Object.fromEntries(process.argv.slice(2).map((a, n, all) => (a.startsWith('--') ? [a.slice(2), all[n + 1]] : [])).filter((p) => p.length));
const tell = (name, value, more) => console.log(JSON.stringify({ name, value, ...more }));
const pause = (ms) => new Promise((done) => { setTimeout(done, ms); });

const browser = await puppeteer.launch({
  executablePath: given.chromium ?? '/usr/bin/chromium', headless: true,
  args: ['--no-sandbox', '--disable-dev-shm-usage', '--hide-scrollbars'],
});
const page = await browser.newPage();
const complaints = [];
page.on('pageerror', (e) => complaints.push(String(e)));
page.on('console', (m) => { if (m.type() === 'error') complaints.push(m.text()); });
await page.setViewport({ width: 1600, height: 1000 });

const shown = () => page.waitForFunction('Number(document.documentElement.dataset.pictures) > 0 && document.querySelectorAll("#station-rows tr").length + !document.querySelector("#no-stations").hidden > 0', { polling: 'raf', timeout: 30000 });

try {
  await firstView();
  if (given.line) await update();
  await access('live');
  await places();
  await coast();
  if (given.pictures) await pictures();
  await banner();
  await narrow();
  await azigram();
  await pan();
  await replay();
  await nonsense();
  tell('complaints of the browser', complaints.length, { said: complaints });
} finally {
  await browser.close();
}

// A moment that is none: said, and live.
async function nonsense() {
  await page.goto(`${new URL(given.url)}?at=garbage`, { waitUntil: 'domcontentloaded' });
  await shown();
  await page.waitForFunction(() => document.body.textContent.includes('at=garbage: no time'), { timeout: 5000 })
    .catch(() => complaints.push('at=garbage is not said'));
}

// From asking for the page to stations in its tables and on its map.
async function firstView() {
  await page.goto(given.url, { waitUntil: 'commit' }).catch(() => page.goto(given.url));
  await shown();
  tell('first view, s', (await page.evaluate('performance.now()')) / 1000);
}

// From a recorder's bytes on the line to the record in the page's tables.
async function update() {
  const socket = connect(Number(given.line.split(':').at(-1)), '127.0.0.1');
  const [hello, ...frames] = given.frames.split(',').map((hex) => Buffer.from(hex, 'hex'));
  const count = () => page.evaluate('Number(document.documentElement.dataset.records ?? 0)');
  socket.write(hello);
  await pause(1500);
  let worst = 0;
  for (const frame of frames) {
    const before = await count();
    const sent = performance.now();
    socket.write(frame);
    await page.waitForFunction((n) => Number(document.documentElement.dataset.records) > n, { polling: 'raf', timeout: 20000 }, before);
    worst = Math.max(worst, performance.now() - sent);
    await pause(300);
  }
  tell('update after a record arrives, s', worst / 1000);
  socket.destroy();
}

// Stations at the poles and across the date line stand where they are: how many lengths and places come out wrong.
async function places() {
  const wrong = await page.evaluate(async () => {
    const { Plane, middle } = await import('/sphere.js');
    const rad = Math.PI / 180;
    const apart = ([a, b], [c, d]) => 2 * Math.asin(Math.sqrt(Math.sin(((c - a) * rad) / 2) ** 2 + Math.cos(a * rad) * Math.cos(c * rad) * Math.sin(((d - b) * rad) / 2) ** 2));
    let bad = 0;
    for (const pair of [[[89.99, 10], [89.98, -170]], [[90, 0], [89.9, 77]], [[-17, 179.99], [-17.02, -179.99]], [[-89.999, 0], [-89.99, 120]], [[49, -123], [49.1, -123.2]]]) {
      const plane = new Plane(middle(pair));
      const [p, q] = pair.map((at) => plane.xy(...at));
      const length = apart(...pair) * plane.radius;
      bad += Math.abs(Math.hypot(p[0] - q[0], p[1] - q[1]) - length) > 0.001 * length;
      for (const at of pair) bad += !(apart(plane.place(...plane.xy(...at)), at) < 1e-9);
      const [x, y] = plane.near(pair[0], 300, -400);
      bad += !(Math.abs(Math.hypot(x - p[0], y - p[1]) - 500) < 0.5);
    }
    return bad;
  });
  tell('places and lengths that the map puts wrong', wrong);
}

// A banner of alarms opens: everything is in view again, what somebody has moved into view still is, other days are named, and
// all that are shown are acknowledged by one key. How much of that is wrong.
async function banner() {
  const alarm = (id, ago) => ({ type: 'alarm', id, station: 1, code: 'RecorderSilent', name: 'silent', state: 'raised', text: 'station 1 has not been heard since 2026-05-01T00:00:00Z', utc: new Date(Date.now() - ago).toISOString() });
  const inView = () => page.evaluate(() => {
    const { map } = window.seabearing;
    const [w, h] = [map.canvas.clientWidth, map.canvas.clientHeight];
    return [...map.at.values()].every((at) => { const [x, y] = map.pixels(at); return x > 0 && y > 0 && x < w && y < h; });
  });
  const open = (alarms) => page.evaluate((all) => { all.forEach((a) => window.seabearing.model.take(a)); window.seabearing.state.tables = true; }, alarms);
  const close = () => page.evaluate(() => { window.seabearing.model.alarms.clear(); window.seabearing.model.events.length = 0; window.seabearing.state.tables = true; });
  const wrong = [];
  const expect = (what, is) => { if (!is) wrong.push(what); };
  const day = 864e5;
  const all = Array.from({ length: 9 }, (_, n) => alarm(1000 + n, n < 4 ? 0 : 3 * day));
  await page.evaluate(() => window.seabearing.map.fit());
  const high = await page.evaluate('window.seabearing.map.canvas.clientHeight');
  await open(all);
  await page.waitForFunction('!document.getElementById("alarms").hidden', { timeout: 5000 });
  await pause(500);
  expect('the banner takes no room', (await page.evaluate('window.seabearing.map.canvas.clientHeight')) < high);
  expect('stations are out of view', await inView());
  (await overlapping()).forEach((what) => expect(what, false));
  if (given.pictures) await page.screenshot({ path: join(given.pictures, 'page-alarms.png') });
  const text = await page.evaluate('document.getElementById("alarms").textContent + document.getElementById("events").textContent');
  const then = new Date(Date.now() - 3 * day).toISOString().slice(0, 10);
  expect('the day of what was days ago is not named', text.split(then).length > 6);
  expect('the day of today is named', !text.includes(new Date().toISOString().slice(0, 10)));
  // By the keyboard alone: all of them are shown, and acknowledged.
  await page.evaluate(() => { window.asked = []; window.fetch = async (path) => { window.asked.push(path); return new Response('{}'); }; });
  await page.focus('#alarms button[data-is="show"]');
  await page.keyboard.press('Enter');
  await pause(500);
  await page.focus('#alarms button[data-is="all"]');
  await page.keyboard.press('Enter');
  await pause(300);
  const asked = await page.evaluate('window.asked');
  expect(`${asked.length} are acknowledged`, asked.filter((path) => /^\/api\/alarms\/100\d\/acknowledge$/.test(path)).length === all.length);
  await access('alarms');
  await close();
  await pause(500);
  // Moved, the middle stays where it is, and what is about it in view.
  const found = await page.evaluate(() => { const { map } = window.seabearing; map.zoom(3); map.move(500, 300); return [map.x, map.y, map.scale]; });
  await open(all);
  await pause(700);
  const [x, y, scale] = await page.evaluate(() => { const { map } = window.seabearing; return [map.x, map.y, map.scale]; });
  expect('a view that was moved has gone', x === found[0] && y === found[1] && scale < found[2]);
  await close();
  await pause(700);
  expect('a view that was moved does not come back', Math.abs((await page.evaluate('window.seabearing.map.scale')) / found[2] - 1) < 1e-6);
  tell('alarms that shift the map, hide their day or cannot be acknowledged together', wrong.length, { said: wrong });
  await page.goto(given.url);
  await shown();
}

// On a telephone: nothing is wider than the screen, or lies over something else.
async function narrow() {
  const text = 'station 1: channel 2 does not hear what the others hear';
  const alarms = Array.from({ length: 7 }, (_, n) => ({ type: 'alarm', id: 1795443352084393 + n, station: 1, state: 'raised', text, utc: new Date().toISOString() }));
  await page.setViewport({ width: 360, height: 740 });
  const wrong = [];
  for (const all of [[], alarms]) {
    await page.evaluate((a) => { a.forEach((r) => window.seabearing.model.take(r)); window.seabearing.state.tables = true; }, all);
    await pause(1000);
    wrong.push(...await overlapping());
    if (given.pictures) await page.screenshot({ path: join(given.pictures, `page-narrow${all.length ? '-alarms' : ''}.png`), fullPage: !all.length });
  }
  tell('parts of a narrow page that overlap or do not fit', wrong.length, { said: wrong });
  await page.setViewport({ width: 1600, height: 1000 });
  await page.goto(given.url);
  await shown();
}

async function overlapping() {
  return page.evaluate(() => {
    const out = [];
    const wide = document.documentElement.clientWidth;
    if (document.documentElement.scrollWidth > wide) out.push(`${document.documentElement.scrollWidth} pixels wide`);
    const boxes = [...document.querySelectorAll('header > *, #alarms p > *, main > section > *, figure, figure > *, .over > *, #stations-title, footer > *')];
    const name = (e) => e.id || e.className || e.parentElement.id || e.tagName;
    // What is scrolled out of a list is not seen.
    const seen = (e) => {
      const [p, list] = [e.getBoundingClientRect(), e.closest('.list')?.getBoundingClientRect()];
      return list ? new DOMRect(p.x, Math.max(p.y, list.y), p.width, Math.min(p.bottom, list.bottom) - Math.max(p.y, list.y)) : p;
    };
    const box = new Map(boxes.map((e) => [e, seen(e)]).filter(([, p]) => p.width > 0 && p.height > 0));
    for (const [n, a] of [...box.keys()].entries()) {
      const p = box.get(a);
      if (p.right > wide + 0.5) out.push(`${name(a)} ends at ${Math.round(p.right)}`);
      if (a.scrollWidth > a.clientWidth + 1 && getComputedStyle(a).overflowX === 'visible' && a.clientWidth) out.push(`${name(a)} holds ${a.scrollWidth} in ${a.clientWidth}`);
      for (const b of [...box.keys()].slice(n + 1)) {
        const q = box.get(b);
        if (a.contains(b) || b.contains(a) || a.closest('footer') || b.closest('footer')) continue;
        const [w, h] = [Math.min(p.right, q.right) - Math.max(p.left, q.left), Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top)];
        if (w > 1 && h > 1) out.push(`${name(a)} lies over ${name(b)}`);
      }
    }
    return out;
  });
}

// A coastline is taken; a file that is none is refused in one line, and nothing stops.
async function coast() {
  const drop = (name, text) => page.evaluate((n, t) => {
    const files = new DataTransfer();
    files.items.add(new File([t], n));
    document.dispatchEvent(new DragEvent('drop', { dataTransfer: files, cancelable: true }));
  }, name, text);
  let wrong = 0;
  await drop('broken.geojson', '{"type":"FeatureCollection"');
  await page.waitForFunction('document.getElementById("mode").textContent.includes("broken.geojson")', { timeout: 5000 }).catch(() => { wrong += 1; });
  const land = [[-123.75, 48.8], [-123.6, 49.0], [-123.66, 49.2], [-123.8, 49.4], [-124.2, 49.4], [-124.2, 48.8], [-123.75, 48.8]];
  await drop('coast.geojson', JSON.stringify({ type: 'Feature', properties: {}, geometry: { type: 'Polygon', coordinates: [land] } }));
  await page.waitForFunction('window.seabearing.map.coast?.rings.length === 1', { timeout: 5000 }).catch(() => { wrong += 1; });
  tell('coastlines taken or refused wrongly', wrong);
  await page.waitForFunction('!window.seabearing.state.said', { timeout: 15000 });
}

// Findings of axe in both themes.
async function access(where) {
  for (const theme of ['light', 'dark']) {
    await page.evaluate((t) => { if (document.documentElement.dataset.theme !== t) document.getElementById('theme').click(); }, theme);
    await pause(500);
    await page.evaluate(axe);
    const { violations } = await page.evaluate('axe.run(document, { runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"] })');
    const grave = violations.filter((v) => ['serious', 'critical'].includes(v.impact));
    const said = violations.map((v) => `${v.impact} ${v.id}: ${v.nodes.slice(0, 3).map((n) => n.target.join(' ')).join('; ')}`);
    tell(`serious findings of axe, ${where}, ${theme}`, grave.length, { said });
    tell(`findings of contrast, ${where}, ${theme}`, violations.filter((v) => v.id.startsWith('color-contrast')).length);
  }
}

async function pictures() {
  for (const theme of ['light', 'dark']) {
    await page.evaluate((t) => { if (document.documentElement.dataset.theme !== t) document.getElementById('theme').click(); }, theme);
    await pause(800);
    await page.screenshot({ path: join(given.pictures, `page-${theme}.png`) });
  }
}

// The azigram of the first station at the ocean bottom: its plot has colours, and everyone can use what surrounds it.
async function azigram() {
  const chosen = await page.evaluate(async () => {
    for (const button of document.querySelectorAll('#station-rows button')) {
      button.click();
      await new Promise((done) => { setTimeout(done, 700); });
      if (window.seabearing.model.series.azigrams?.length) return true;
    }
    return false;
  });
  if (!chosen) return;
  const found = await page.evaluate(() => {
    const figure = [...document.querySelectorAll('figure')].find((f) => f.textContent.startsWith('Azigram'));
    const canvas = figure.querySelector('canvas');
    const { data } = canvas.getContext('2d').getImageData(0, canvas.height * 0.25, canvas.width, canvas.height * 0.5);
    let coloured = 0;
    for (let k = 0; k < data.length; k += 4) coloured += data[k + 3] > 60 && Math.max(data[k], data[k + 1], data[k + 2]) - Math.min(data[k], data[k + 1], data[k + 2]) > 40;
    return [coloured / (data.length / 4), canvas.getAttribute('aria-label')];
  });
  tell('azigrams without colours or words', Number(found[0] < 0.1) + Number(!/^Azigram: (clearest|none)/.test(found[1])), { said: found[1] });
  if (!given.pictures) return;
  for (const theme of ['light', 'dark']) {
    await page.evaluate((t) => { if (document.documentElement.dataset.theme !== t) document.getElementById('theme').click(); }, theme);
    await pause(800);
    await page.screenshot({ path: join(given.pictures, `page-bottom-${theme}.png`) });
  }
}

// Three seconds of panning over 10 000 points of tracks.
async function pan() {
  const found = await page.evaluate(async () => {
    const { model, map } = window.seabearing;
    const s = [...model.stations.values()][0] ?? { station: 1, states: {}, newest: {}, tracks: new Map() };
    model.stations.set(s.station, s);
    const utc = new Date().toISOString();
    s.tracks = new Map(Array.from({ length: 25 }, (_, t) => {
      const path = Array.from({ length: 400 }, (_, n) => [Date.now(), 20 * n - 4000, 2000 * Math.sin(n / 40 + t) + 100 * t]);
      const report = { type: 'track', utc, station: s.station, session: 1, id: t, stage: 'running', range_observable: true, x_m: 0, y_m: 0, var_x_m2: 4e4, var_y_m2: 9e4, cov_xy_m2: 1e4, heading_deg: 90, cpa_range_m: 500 + 50 * t, sd_cpa_range_m: 20, cpa_azimuth_deg: 10 * t, cpa_time_s: 10, t_s: 0 };
      return [`1.${t}`, { report, path }];
    }));
    map.fit();
    map.draw();
    const draws = [];
    const draw = map.draw.bind(map);
    map.draw = () => { const from = performance.now(); draw(); draws.push(performance.now() - from); };
    const begun = performance.now();
    let frames = 0;
    await new Promise((done) => {
      const step = (at) => {
        frames += 1;
        map.move(30 * Math.sin(frames / 10), 20);
        if (at - begun < 3000) requestAnimationFrame(step); else done();
      };
      requestAnimationFrame(step);
    });
    delete map.draw;
    draws.sort((a, b) => a - b);
    return [draws[Math.floor(draws.length * 0.95)], frames / ((performance.now() - begun) / 1000)];
  });
  tell('pan with 10 000 track points: time of a frame, 95 of 100, ms', found[0]);
  tell('pan with 10 000 track points: frames a second', found[1]);
  tell('map after a pan: share of it that is not as drawn anew, %', await moved());
}

// What is moved must lie where it would be drawn: parts of the map that differ from a drawing anew, and, so that a map that
// stands still does not pass, from the map before.
async function moved() {
  return page.evaluate(() => {
    const { map } = window.seabearing;
    const look = () => { map.draw(); return map.front.getImageData(0, 0, map.canvas.width, map.canvas.height).data; };
    const apart = (a, b) => {
      let n = 0;
      for (let k = 0; k < a.length; k += 4) n += Math.abs(a[k] - b[k]) + Math.abs(a[k + 1] - b[k + 1]) + Math.abs(a[k + 2] - b[k + 2]) > 96;
      return (100 * n) / (a.length / 4);
    };
    map.fit();
    const before = look();
    const dots = window.devicePixelRatio || 1;
    map.move(60 / dots / map.scale, 41 / dots / map.scale);
    const after = look();
    map.dirty = true;
    map.movedAt = -Infinity;
    const anew = look();
    return apart(before, anew) > 3 ? apart(after, anew) : 100;
  });
}

// Moments all over the time slider, from asking to the picture.
async function replay() {
  const found = await page.evaluate(async () => {
    const { state, look } = window.seabearing;
    if (!state.span) return null;
    const took = [];
    for (let n = 0; n < 12; n += 1) {
      const [from, to] = state.span;
      const begun = performance.now();
      await look(from + (to - from) * ((n * 0.618) % 1));
      await new Promise(requestAnimationFrame);
      took.push(performance.now() - begun);
    }
    return Math.max(...took);
  });
  if (found !== null) tell('replay in the browser: longest to a moment, ms', found);
  await access('replay');
}
