// The map: stations, bearings with what they leave open, tracks with their ellipses and closest points, a coastline.

import { Plane, middle } from '/sphere.js';
import { when } from '/model.js';
import { bearing, clock, metres } from '/words.js';

// Two-sided 95 % of a normal deviation, and the same of an ellipse (squared, two degrees of freedom).
const [SIDES, ELLIPSE] = [1.96, 5.991];
// Bearings this much older than their station's newest record are no longer of now, ms; tracks are of the past.
const [STALE, PAST] = [60e3, 1800e3];
// Bearings of one instant, ms.
const INSTANT = 15e3;
// The drawing is made larger than the view by this share on every side, so that moving it within draws nothing anew.
const MARGIN = 0.25;
// While somebody moves the view, what comes meanwhile is drawn at most so often; moving has ended after so long, ms.
const [CALM, STILL] = [500, 250];
const STEPS = [30, 15, 10, 5, 2, 1, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001];

export class ChartMap {
  constructor(canvas, model, choose) {
    [this.canvas, this.model, this.choose] = [canvas, model, choose];
    [this.front, this.layer] = [canvas.getContext('2d', { alpha: false }), document.createElement('canvas')];
    this.context = this.front;
    // Metres of the plane in the middle of the view; pixels a metre.
    [this.x, this.y, this.scale] = [0, 0, 0.02];
    this.moved = false;
    this.coast = null;
    // What is in the layer: the view it was made for, and when.
    this.made = null;
    [this.pending, this.movedAt] = [true, -Infinity];
    this.colours = {};
    this.now = Date.now();
    this.listen();
  }

  // Something else is to be shown: the layer is made anew.
  set dirty(is) {
    this.pending = is;
    if (is && this.made) this.made.old = true;
  }

  get dirty() {
    return this.pending;
  }

  // The plane of the stations' places; a station without any stands in its middle, if no other has one.
  settle() {
    const numbers = this.model.numbers();
    this.order = new Map(numbers.map((n, k) => [n, k]));
    const known = numbers.map((n) => [n, this.model.place(n)]);
    const placed = known.filter(([, p]) => Number.isFinite(p.lat_deg) && Number.isFinite(p.lon_deg));
    const places = placed.map(([, p]) => [p.lat_deg, p.lon_deg]);
    const alone = places.length === 0 && this.model.chosen !== null;
    this.shown = alone ? [[this.model.chosen, [0, 0]]] : placed.map(([n], k) => [n, places[k]]);
    this.unplaced = alone;
    const key = JSON.stringify(this.shown);
    if (key === this.key) return;
    this.key = key;
    this.plane = new Plane(middle(this.shown.map(([, p]) => p)));
    this.at = new Map(this.shown.map(([n, p]) => [n, this.plane.xy(...p)]));
    // By how much a station's North is turned on the plane, radians.
    this.north = new Map(this.shown.map(([n, p]) => {
      const [[x0, y0], [x, y]] = [this.plane.xy(...p), this.plane.near(p, 0, 1000)];
      return [n, Math.atan2(x - x0, y - y0)];
    }));
    for (const s of this.model.stations.values()) s.tracks.forEach((t) => { t.drawn = null; });
    if (this.coast) this.coast.drawn = null;
    if (!this.moved) this.fit();
  }

  // Everything in view.
  fit() {
    const points = [...(this.at?.values() ?? [])];
    for (const [number, place] of this.shown ?? []) {
      for (const track of this.model.stations.get(number)?.tracks.values() ?? []) {
        const end = track.path.at(-1);
        if (end) points.push(this.plane.near(place, end[1], end[2]), this.plane.near(place, track.path[0][1], track.path[0][2]));
      }
    }
    const [w, h] = [this.canvas.clientWidth || 600, this.canvas.clientHeight || 400];
    const span = (k) => [Math.min(...points.map((p) => p[k])), Math.max(...points.map((p) => p[k]))];
    const [[west, east], [south, north]] = points.length ? [span(0), span(1)] : [[0, 0], [0, 0]];
    [this.x, this.y] = [(west + east) / 2, (south + north) / 2];
    this.scale = Math.min(w / Math.max((east - west) * 1.35, 3000), h / Math.max((north - south) * 1.35, 3000));
    this.moved = false;
    this.dirty = true;
  }

  // The canvas has another size: everything is in view again, or what somebody has moved into view still is.
  resized() {
    const [w, h] = [this.canvas.clientWidth, this.canvas.clientHeight];
    if (!w || !h) return;
    if (this.moved && this.span) this.scale = Math.min(w / this.span[0], h / this.span[1]);
    else this.fit();
    this.dirty = true;
  }

  zoom(factor, [px, py] = [this.canvas.clientWidth / 2, this.canvas.clientHeight / 2]) {
    const [x, y] = this.metres(px, py);
    this.scale = Math.min(10, Math.max(2e-5, this.scale * factor));
    const [nx, ny] = this.metres(px, py);
    this.move(x - nx, y - ny);
  }

  move(dx, dy) {
    const far = 2e7;
    this.x = Math.min(far, Math.max(-far, this.x + dx));
    this.y = Math.min(far, Math.max(-far, this.y + dy));
    this.span = [this.canvas.clientWidth / this.scale, this.canvas.clientHeight / this.scale];
    this.moved = this.pending = true;
    this.movedAt = performance.now();
  }

  metres(px, py) {
    return [this.x + (px - this.canvas.clientWidth / 2) / this.scale, this.y - (py - this.canvas.clientHeight / 2) / this.scale];
  }

  pixels([x, y]) {
    return [this.canvas.clientWidth / 2 + (x - this.x) * this.scale, this.canvas.clientHeight / 2 - (y - this.y) * this.scale];
  }

  listen() {
    const canvas = this.canvas;
    let from = null;
    canvas.addEventListener('pointerdown', (e) => { from = [e.clientX, e.clientY, 0]; canvas.setPointerCapture?.(e.pointerId); });
    canvas.addEventListener('pointermove', (e) => {
      if (!from) return;
      const [dx, dy] = [e.clientX - from[0], e.clientY - from[1]];
      this.move(-dx / this.scale, dy / this.scale);
      from = [e.clientX, e.clientY, from[2] + Math.hypot(dx, dy)];
    });
    canvas.addEventListener('pointerup', (e) => {
      if (from && from[2] < 4) this.pick(e.offsetX, e.offsetY);
      from = null;
    });
    canvas.addEventListener('pointercancel', () => { from = null; });
    canvas.addEventListener('wheel', (e) => { e.preventDefault(); this.zoom(Math.exp(-e.deltaY / 400), [e.offsetX, e.offsetY]); }, { passive: false });
    canvas.addEventListener('keydown', (e) => {
      const step = 60 / this.scale;
      const keys = { ArrowLeft: () => this.move(-step, 0), ArrowRight: () => this.move(step, 0), ArrowUp: () => this.move(0, step), ArrowDown: () => this.move(0, -step), '+': () => this.zoom(1.5), '=': () => this.zoom(1.5), '-': () => this.zoom(1 / 1.5), 0: () => this.fit() };
      if (keys[e.key]) { e.preventDefault(); keys[e.key](); }
    });
  }

  pick(px, py) {
    let best = [30, null];
    for (const [number, at] of this.at ?? []) {
      const [x, y] = this.pixels(at);
      const far = Math.hypot(x - px, y - py);
      if (far < best[0]) best = [far, number];
    }
    if (best[1] !== null) this.choose(best[1]);
  }

  // Colours of the theme.
  theme() {
    const style = getComputedStyle(document.documentElement);
    for (const name of ['sea', 'land', 'coast', 'text', 'quiet', 'grid', 'panel', 'bad', ...Array.from({ length: 8 }, (_, n) => `c${n}`)]) {
      this.colours[name] = style.getPropertyValue(`--${name}`).trim();
    }
    this.size = parseFloat(style.fontSize);
    this.dirty = true;
  }

  colour(number) {
    return this.colours[`c${Math.max(0, this.order?.get(number) ?? 0) % 8}`];
  }

  draw() {
    this.settle();
    const [canvas, dots] = [this.canvas, window.devicePixelRatio || 1];
    const [w, h] = [canvas.clientWidth, canvas.clientHeight];
    const [px, py] = [Math.round(w * dots), Math.round(h * dots)];
    if (canvas.width !== px || canvas.height !== py) [canvas.width, canvas.height] = [px, py];
    const waits = this.fits(w, h, dots);
    if (!waits) this.drawLayer(w, h, dots);
    const [c, made] = [this.front, this.made];
    this.context = c;
    c.setTransform(1, 0, 0, 1, 0, 0);
    const [dx, dy] = [(made.x - this.x) * this.scale * dots, (this.y - made.y) * this.scale * dots];
    c.drawImage(this.layer, Math.round(dx) - made.right, Math.round(dy) - made.down);
    c.setTransform(dots, 0, 0, dots, 0, 0);
    if (!this.unplaced && this.shown.length) this.drawGrid(w, h, 1, false);
    this.drawScale(w, h);
    // What came while the view was moved is drawn soon.
    this.pending = made.old;
  }

  // Whether the layer can be shown as it is: nothing else is to be seen, or that can wait until the moving has ended.
  fits(w, h, dots) {
    const made = this.made;
    if (!made || made.scale !== this.scale || made.size !== `${w} ${h} ${dots}` || made.key !== this.key) return false;
    const [dx, dy] = [Math.abs(made.x - this.x) * this.scale, Math.abs(made.y - this.y) * this.scale];
    if (dx > MARGIN * w - 1 || dy > MARGIN * h - 1) return false;
    const now = performance.now();
    return !made.old || (now - this.movedAt < STILL && now - made.at < CALM);
  }

  // Everything but the scale and the grid's numbers, larger than the view.
  drawLayer(w, h, dots) {
    const [right, down] = [Math.round(MARGIN * w * dots), Math.round(MARGIN * h * dots)];
    const [px, py] = [Math.round(w * dots) + 2 * right, Math.round(h * dots) + 2 * down];
    if (this.layer.width !== px || this.layer.height !== py) {
      [this.layer.width, this.layer.height] = [px, py];
      this.back = this.layer.getContext('2d', { alpha: false });
    }
    const c = this.context = this.back;
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.fillStyle = this.colours.sea;
    c.fillRect(0, 0, px, py);
    c.setTransform(dots, 0, 0, dots, right, down);
    this.inMetres(() => this.drawCoast());
    if (!this.unplaced && this.shown.length) this.drawGrid(w, h, 1 + 2 * MARGIN, true);
    for (const [number, place] of this.shown) this.drawStation(number, place);
    if (!this.unplaced) for (const track of this.model.networks.values()) this.drawNetwork(track);
    for (const [number] of this.shown) this.drawMark(number);
    this.made = { x: this.x, y: this.y, scale: this.scale, size: `${w} ${h} ${dots}`, key: this.key, right, down, at: performance.now(), old: false };
  }

  // Draws in metres of the plane.
  inMetres(draw) {
    const c = this.context;
    c.save();
    c.translate(this.canvas.clientWidth / 2 - this.x * this.scale, this.canvas.clientHeight / 2 + this.y * this.scale);
    c.scale(this.scale, -this.scale);
    draw();
    c.restore();
  }

  drawCoast() {
    const [c, coast] = [this.context, this.coast];
    if (!coast || !this.plane) return;
    if (!coast.drawn) {
      coast.drawn = { lines: new Path2D(), land: new Path2D() };
      for (const { ring, closed } of coast.rings) {
        const points = ring.map(([lon, lat]) => this.plane.xy(lat, lon));
        // What reaches around the globe cannot be filled on a plane.
        const near = closed && points.every(([x, y]) => Math.hypot(x, y) < 8e6);
        const path = near ? coast.drawn.land : coast.drawn.lines;
        points.forEach(([x, y], n) => (n ? path.lineTo(x, y) : path.moveTo(x, y)));
      }
    }
    c.fillStyle = this.colours.land;
    c.strokeStyle = this.colours.coast;
    c.lineWidth = 1.2 / this.scale;
    c.fill(coast.drawn.land, 'evenodd');
    c.stroke(coast.drawn.land);
    c.stroke(coast.drawn.lines);
  }

  // The grid's lines for so many times the view, or its numbers at the edges.
  drawGrid(w, h, larger, lines) {
    const c = this.context;
    const [lat, lon] = this.plane.place(this.x, this.y);
    const seen = (h / 2 / this.scale / this.plane.radius) * (180 / Math.PI);
    const polar = Math.abs(lat) + 2 * seen > 84 || seen > 30;
    const across = polar ? 180 : Math.min(180, ((w / h) * seen) / Math.cos(((Math.abs(lat) + seen) * Math.PI) / 180));
    const [high, wide] = [Math.min(180, seen * larger), Math.min(180, across * larger)];
    const stepOf = (half) => STEPS.findLast((s) => (2 * half) / s <= 9) ?? 30;
    const [dLat, dLon] = [stepOf(seen), polar ? 30 : stepOf(across)];
    c.strokeStyle = this.colours.grid;
    c.fillStyle = this.colours.quiet;
    c.font = `${this.size * 0.6}px system-ui, sans-serif`;
    c.lineWidth = 1;
    const digits = (s) => (s >= 1 ? 0 : Math.ceil(-Math.log10(s)));
    const line = (points) => {
      c.beginPath();
      points.forEach((p, n) => (n ? c.lineTo(...this.pixels(this.plane.xy(...p))) : c.moveTo(...this.pixels(this.plane.xy(...p)))));
      c.stroke();
    };
    const parts = Array.from({ length: 33 }, (_, n) => n / 16 - 1);
    for (let n = Math.ceil(Math.max(-90, lat - high) / dLat); n * dLat <= Math.min(90, lat + high); n += 1) {
      if (lines) {
        line(parts.map((p) => [n * dLat, lon + p * wide]));
        continue;
      }
      const [, y] = this.pixels(this.plane.xy(n * dLat, lon));
      c.fillText(`${Math.abs(n * dLat).toFixed(digits(dLat))}°${n < 0 ? 'S' : n > 0 ? 'N' : ''}`, 4, y - 3);
    }
    for (let n = Math.ceil((lon - wide) / dLon); n * dLon < lon + wide; n += 1) {
      const at = ((((n * dLon + 180) % 360) + 360) % 360) - 180;
      if (lines) {
        line(parts.map((p) => [Math.min(90, Math.max(-90, lat + p * high)), at]));
        continue;
      }
      const [x] = this.pixels(this.plane.xy(lat, at));
      if (!polar) c.fillText(`${Math.abs(at).toFixed(digits(dLon))}°${at < 0 ? 'W' : 'E'}`, x + 3, h - 5);
    }
  }

  drawStation(number, place) {
    const s = this.model.stations.get(number);
    if (!s) return;
    const colour = this.colour(number);
    const newest = Date.parse(s.last_utc ?? s.last_received_utc ?? '');
    for (const track of s.tracks.values()) this.drawTrack(track, place, number, colour, when(track.report) < Math.max(newest, this.now) - PAST);
    // Old: its line is silent, it has ended, or it speaks of other things since.
    const old = (r) => when(r) < newest - STALE || Boolean(s.states.end) || this.now - newest > 5 * STALE;
    const drawn = new Map();
    for (const r of s.newest.bearing ?? []) drawn.set(r.band, [r, r.sd_azimuth_deg]);
    for (const r of s.newest.azimuth ?? []) if (r.detected) drawn.set(`${r.utc} ${r.weight}`, [r, r.sd_deg]);
    const last = Math.max(...[...drawn.values()].map(([r]) => when(r)));
    for (const [r, sd] of drawn.values()) if (!(when(r) < last - INSTANT)) this.drawFan(number, r.azimuth_deg, sd, colour, old(r));
    const range = s.newest.range?.at(-1);
    if (range?.detected && !old(range)) this.drawRing(number, range, colour);
  }

  // A bearing and the sector that holds 95 % of it. It ends where the drawing ends: a bearing says nothing of range.
  drawFan(number, azimuth, sd, colour, old) {
    if (!Number.isFinite(azimuth)) return;
    const [c, [x, y]] = [this.context, this.pixels(this.at.get(number))];
    const crowded = this.shown.length > 12 && number !== this.model.chosen;
    const length = (crowded ? 0.14 : 0.42) * Math.min(this.canvas.clientWidth, this.canvas.clientHeight);
    const turn = (azimuth * Math.PI) / 180 + this.north.get(number) - Math.PI / 2;
    c.save();
    c.strokeStyle = c.fillStyle = colour;
    if (Number.isFinite(sd)) {
      const half = Math.min(Math.PI, (SIDES * sd * Math.PI) / 180);
      c.globalAlpha = old ? 0.12 : 0.3;
      c.beginPath();
      c.moveTo(x, y);
      c.arc(x, y, length, turn - half, turn + half);
      c.fill();
    }
    c.globalAlpha = old ? 0.5 : 1;
    if (old) c.setLineDash([6, 6]);
    c.lineWidth = 2;
    c.beginPath();
    c.moveTo(x, y);
    c.lineTo(x + length * Math.cos(turn), y + length * Math.sin(turn));
    c.stroke();
    c.restore();
  }

  // The range that an ocean-bottom station tells, with 95 % of it.
  drawRing(number, r, colour) {
    const [c, at] = [this.context, this.pixels(this.at.get(number))];
    c.save();
    c.strokeStyle = colour;
    c.globalAlpha = 0.3;
    c.lineWidth = Math.max(1, 2 * SIDES * (r.sd_range_m ?? 0) * this.scale);
    c.beginPath();
    c.arc(at[0], at[1], r.range_m * this.scale, 0, 2 * Math.PI);
    c.stroke();
    c.restore();
  }

  drawTrack(track, place, number, colour, past) {
    const [c, r] = [this.context, track.report];
    if (!track.drawn) {
      track.drawn = new Path2D();
      track.path.forEach(([, x, y], n) => {
        const p = this.plane.near(place, x, y);
        if (n) track.drawn.lineTo(...p); else track.drawn.moveTo(...p);
      });
    }
    c.save();
    c.globalAlpha = past ? 0.45 : 1;
    c.strokeStyle = c.fillStyle = colour;
    this.inMetres(() => { c.lineWidth = 2.5 / this.scale; c.stroke(track.drawn); });
    const end = track.path.at(-1);
    if (end && r.range_observable) {
      this.drawEllipse(this.pixels(this.plane.near(place, end[1], end[2])), r, this.north.get(number));
      const turn = (r.cpa_azimuth_deg * Math.PI) / 180;
      if (Number.isFinite(r.cpa_range_m) && Number.isFinite(turn)) this.drawClosest(place, r, turn, !past && (number === this.model.chosen || this.shown.length < 5));
      const name = track.ais?.verdict === 'dark' ? 'dark' : track.ais?.verdict === 'vessel' ? track.ais.name || track.ais.mmsi : null;
      if (name && !past) {
        const [x, y] = this.pixels(this.plane.near(place, end[1], end[2]));
        this.label(String(name), x + 12, y + 16, 0.7);
      }
    }
    c.restore();
  }

  // What several stations tell together: a double line in no station's colour.
  drawNetwork(track) {
    const [c, r, end] = [this.context, track.report, track.path.at(-1)];
    if (!end) return;
    c.save();
    c.globalAlpha = when(r) < this.now - PAST ? 0.45 : 1;
    for (const [width, colour] of [[5, this.colours.text], [2, this.colours.panel]]) {
      c.strokeStyle = colour;
      c.lineWidth = width;
      c.beginPath();
      track.path.forEach(([, lat, lon], n) => (n ? c.lineTo(...this.pixels(this.plane.xy(lat, lon))) : c.moveTo(...this.pixels(this.plane.xy(lat, lon)))));
      c.stroke();
    }
    c.strokeStyle = c.fillStyle = this.colours.text;
    if (r.consistent === false) c.setLineDash([4, 4]);
    const place = [end[1], end[2]];
    const [[x0, y0], [x, y]] = [this.plane.xy(...place), this.plane.near(place, 0, 1000)];
    this.drawEllipse(this.pixels([x0, y0]), r, Math.atan2(x - x0, y - y0));
    c.restore();
  }

  drawEllipse([px, py], r, north) {
    const c = this.context;
    const [a, b, cov] = [r.var_x_m2, r.var_y_m2, r.cov_xy_m2];
    if (![a, b, cov].every(Number.isFinite)) return;
    const [half, diff] = [(a + b) / 2, Math.hypot((a - b) / 2, cov)];
    const axis = (v) => Math.max(3, Math.sqrt(Math.max(0, v) * ELLIPSE) * this.scale);
    c.lineWidth = 1.5;
    c.beginPath();
    c.ellipse(px, py, axis(half + diff), axis(half - diff), north - 0.5 * Math.atan2(2 * cov, a - b), 0, 2 * Math.PI);
    c.stroke();
    c.globalAlpha *= 0.2;
    c.fill();
    c.globalAlpha *= 5;
    if (Number.isFinite(r.heading_deg)) {
      const turn = (r.heading_deg * Math.PI) / 180 + north;
      c.lineWidth = 4;
      c.beginPath();
      c.moveTo(px, py);
      c.lineTo(px + 26 * Math.sin(turn), py - 26 * Math.cos(turn));
      c.stroke();
    }
  }

  drawClosest(place, r, turn, told) {
    const c = this.context;
    const at = (range) => this.pixels(this.plane.near(place, range * Math.sin(turn), range * Math.cos(turn)));
    const [x, y] = at(r.cpa_range_m);
    const spread = SIDES * (r.sd_cpa_range_m ?? 0);
    c.lineWidth = 2;
    c.setLineDash([2, 4]);
    c.beginPath();
    c.moveTo(...at(Math.max(0, r.cpa_range_m - spread)));
    c.lineTo(...at(r.cpa_range_m + spread));
    c.stroke();
    c.setLineDash([]);
    c.beginPath();
    [[0, -7], [7, 0], [0, 7], [-7, 0]].forEach(([dx, dy], n) => (n ? c.lineTo(x + dx, y + dy) : c.moveTo(x + dx, y + dy)));
    c.closePath();
    c.fillStyle = this.colours.panel;
    c.fill();
    c.stroke();
    const ms = when(r) + (r.cpa_time_s - r.t_s) * 1000;
    if (told) this.label(`${metres(r.cpa_range_m)}${Number.isFinite(ms) ? ` ${clock(ms)}` : ''}`, x + 12, y + 5, 0.7);
  }

  drawMark(number) {
    const [c, [x, y]] = [this.context, this.pixels(this.at.get(number))];
    const chosen = number === this.model.chosen;
    c.beginPath();
    c.arc(x, y, chosen ? 9 : 6, 0, 2 * Math.PI);
    c.fillStyle = this.colour(number);
    c.fill();
    c.lineWidth = chosen ? 3 : 1.5;
    c.strokeStyle = this.colours.text;
    c.stroke();
    const name = this.model.place(number).name || (number === null ? '?' : String(number));
    if (this.shown.length <= 80 || chosen || this.scale > 0.02) this.label(name, x + 13, y - 9, chosen ? 1 : this.shown.length > 24 ? 0.65 : 0.8);
  }

  label(text, x, y, size) {
    const c = this.context;
    c.font = `600 ${this.size * size}px system-ui, sans-serif`;
    c.lineWidth = 4;
    c.lineJoin = 'round';
    c.strokeStyle = this.colours.sea;
    c.strokeText(text, x, y);
    c.fillStyle = this.colours.text;
    c.fillText(text, x, y);
  }

  drawScale(w, h) {
    const c = this.context;
    const most = 200 / this.scale;
    const power = 10 ** Math.floor(Math.log10(most));
    const length = [5, 2, 1].map((k) => k * power).find((l) => l <= most) ?? power;
    const [x, y] = [w - 20 - length * this.scale, h - 20];
    c.strokeStyle = this.colours.text;
    c.lineWidth = 3;
    c.beginPath();
    c.moveTo(x, y - 7);
    c.lineTo(x, y);
    c.lineTo(x + length * this.scale, y);
    c.lineTo(x + length * this.scale, y - 7);
    c.stroke();
    this.label(metres(length), x + 6, y - 8, 0.8);
    this.label('N ↑', w - 2.6 * this.size, 1.5 * this.size, 0.9);
  }

  // What the map shows, in words.
  words() {
    const [lat, lon] = this.plane && !this.unplaced ? this.plane.place(this.x, this.y) : [NaN, NaN];
    const at = Number.isFinite(lat) ? `around ${Math.abs(lat).toFixed(3)}° ${lat < 0 ? 'South' : 'North'}, ${Math.abs(lon).toFixed(3)}° ${lon < 0 ? 'West' : 'East'}` : '';
    if (!this.shown?.length) return 'No station has a position: give it with lat_deg and lon_deg in the stations file.';
    if (this.unplaced) return 'No station has a position; the chosen one stands in the middle, metres around it are true.';
    const lines = this.shown.flatMap(([n]) => (this.model.stations.get(n)?.newest.bearing ?? []).slice(-1).map((r) => `${n}: ${bearing(r.azimuth_deg)}`));
    return `${this.shown.length} stations ${at}. Sectors and ellipses hold 95 %.${lines.length && lines.length < 9 ? ` Newest bearings ${lines.join(', ')}.` : ''}`;
  }
}
