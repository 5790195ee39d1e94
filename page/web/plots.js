// Plots of one station against time: bearings or azimuths, transients, azigram, presence, signal-to-noise ratio, levels, range.

import { KEY, cells, inWords, limits } from '/azigram.js';
import { clock, element } from '/words.js';

// The plots there are: their series, columns, unit, and the range of values that is always shown.
const PLOTS = [
  { name: 'Bearing', series: 'bearings', unit: '°', column: 1, sd: 2, range: [0, 360], ticks: 90, shade: (p) => (p[5] === 0 ? 1 : 0.5) },
  { name: 'Signal to noise', series: 'bearings', unit: 'dB', column: 4, range: [0, 20] },
  { name: 'Transients', series: 'transients', unit: '°', column: 1, sd: 2, range: [0, 360], ticks: 90 },
  { name: 'Azimuth', series: 'azimuths', unit: '°', column: 1, sd: 2, range: [0, 360], ticks: 90, shade: (p) => (p[4] ? 1 : 0.35) },
  { name: 'Azigram', series: 'azigrams', unit: 'Hz', limits, inWords, paint: cells, wide: true, above: KEY },
  { name: 'Presence, ln', series: 'azimuths', unit: '', column: 3, range: [-5, 5] },
  { name: 'Range', series: 'ranges', unit: 'm', column: 1, sd: 2, range: [0, 1000] },
  { name: 'Levels re full scale', series: 'levels', unit: 'dB', column: 1, columns: 4, range: [-90, 0], line: true, threshold: 0 },
];

export class Plots {
  constructor(parent) {
    this.parent = parent;
    this.shown = new Map();
  }

  // Draws what there is. `theme`: colours and the size of text.
  draw(series, from, to, theme) {
    const wanted = PLOTS.filter((p) => series[p.series]?.length);
    const wantedNames = wanted.map((p) => p.name).join();
    if (wantedNames !== this.names) {
      this.names = wantedNames;
      this.shown = new Map(wanted.map((plot) => {
        const canvas = element('canvas', { role: 'img' });
        const caption = element('figcaption', {});
        return [plot, { canvas, caption, figure: element('figure', { class: plot.wide ? 'wide' : false }, caption, element('div', {}, canvas)) }];
      }));
      this.parent.replaceChildren(...[...this.shown.values()].map((s) => s.figure));
      if (!wanted.length) this.parent.append(element('p', { class: 'empty' }, 'Nothing to plot yet.'));
    }
    for (const [plot, { canvas, caption }] of this.shown) drawPlot(plot, series[plot.series], canvas, caption, from, to, theme);
  }
}

function drawPlot(plot, points, canvas, caption, from, to, theme) {
  const [c, dots] = [canvas.getContext('2d'), window.devicePixelRatio || 1];
  const [w, h] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(w * dots) || canvas.height !== Math.round(h * dots)) {
    [canvas.width, canvas.height] = [Math.round(w * dots), Math.round(h * dots)];
  }
  const inside = points.filter((p) => p[0] >= from && p[0] <= to);
  const text = plot.inWords ? plot.inWords(inside.at(-1)) : newestInWords(plot, inside.at(-1));
  if (caption.textContent !== text) caption.textContent = text;
  canvas.setAttribute('aria-label', `${text}, ${inside.length} points from ${clock(from, true)} to ${clock(to, true)} UTC`);
  const columns = columnsOf(plot);
  const values = inside.flatMap((p) => columns.map((k) => p[k])).filter(Number.isFinite);
  let [low, high] = plot.range ?? plot.limits(inside);
  if (!plot.ticks && !plot.paint) for (const v of values) [low, high] = [Math.min(low, v), Math.max(high, v)];
  const size = theme.size * 0.62;
  const [left, bottom, top] = [size * 3.4, size * 1.5, 4 + size * (plot.above ?? 0)];
  const x = (ms) => left + ((ms - from) / (to - from || 1)) * (w - left - 6);
  const y = (v) => top + ((high - v) / (high - low || 1)) * (h - top - bottom);
  c.setTransform(dots, 0, 0, dots, 0, 0);
  c.clearRect(0, 0, w, h);
  c.font = `${size}px system-ui, sans-serif`;
  c.lineWidth = 1;
  c.strokeStyle = theme.colours.grid;
  c.fillStyle = theme.colours.quiet;
  const rough = (high - low) / 4;
  const power = 10 ** Math.floor(Math.log10(rough || 1));
  const tick = plot.ticks ?? [1, 2, 5, 10].map((k) => k * power).find((k) => k >= rough) ?? power;
  c.textAlign = 'right';
  // No more than there are, also where numbers are so great that a step more is none.
  for (let [n, v] = [0, Math.ceil(low / tick) * tick]; n < 20 && v <= high + 1e-9; [n, v] = [n + 1, v + tick]) {
    line(c, [[left, y(v)], [w - 6, y(v)]]);
    c.fillText(`${Math.round(v)}${plot.unit === '°' ? '°' : ''}`, left - 4, y(v) + size * 0.35);
  }
  c.textAlign = 'center';
  const step = [60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 28800].map((s) => s * 1000).find((s) => (to - from) / s <= w / (size * 5.5)) ?? 86400e3;
  for (let at = Math.ceil(from / step) * step; at <= to; at += step) {
    line(c, [[x(at), top], [x(at), h - bottom]]);
    c.fillText(clock(at).slice(0, 5), Math.min(w - size * 1.6, x(at)), h - 3);
  }
  if (plot.paint) return void plot.paint(c, inside, { x, y, from, to, left, right: w - 6, size }, theme);
  columns.forEach((k, n) => {
    c.strokeStyle = c.fillStyle = theme.colours[`c${(n + (plot.sd ? 0 : 1)) % 8}`];
    const good = inside.filter((p) => Number.isFinite(p[k]));
    if (plot.line) {
      c.lineWidth = 2;
      line(c, [...good].sort((a, b) => a[0] - b[0]).map((p) => [x(p[0]), y(p[k])]));
      return;
    }
    const bars = plot.sd && good.length < 400;
    for (const p of good) {
      c.globalAlpha = plot.shade?.(p) ?? 1;
      if (bars && Number.isFinite(p[plot.sd])) line(c, [[x(p[0]), y(p[k] - 1.96 * p[plot.sd])], [x(p[0]), y(p[k] + 1.96 * p[plot.sd])]]);
      c.fillRect(x(p[0]) - 1.5, y(p[k]) - 1.5, 3, 3);
    }
    c.globalAlpha = 1;
  });
}

const columnsOf = (plot) => Array.from({ length: plot.columns ?? 1 }, (_, n) => plot.column + n);

function newestInWords(plot, last) {
  const columns = columnsOf(plot);
  const newest = last ? columns.map((k) => (Number.isFinite(last[k]) ? `${last[k].toFixed(1)}` : 'none')).join(', ') : 'none at this time';
  const known = last && columns.some((k) => Number.isFinite(last[k]));
  return `${plot.name}: ${newest}${known && plot.unit ? `${plot.unit === '°' ? '' : ' '}${plot.unit}` : ''}`;
}

function line(c, points) {
  c.beginPath();
  points.forEach((p, n) => (n ? c.lineTo(...p) : c.moveTo(...p)));
  c.stroke();
}
