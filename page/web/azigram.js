// The azigram: where the sound comes from, time to the right, frequency upwards, direction as colour, faint where it is not agreed on.
//
// Colours are an ellipse in OKLab: North is light and South dark, East yellow and West blue, so that they are told apart with
// every common colour-vision deficiency; in shades of grey a dot marks the western half. The panel shows through where
// directions do not agree.

import { bearing } from '/words.js';

const MINUTE = 60e3;
// Lightness at East and West by theme, by how much it changes to North and South, and chroma.
const LIGHTNESS = { light: 0.6, dark: 0.7 };
const [SWING, GREEN_RED, YELLOW_BLUE] = [0.2, 0.09, 0.13];

const curve = (x) => (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);

// OKLab (B. Ottosson, 2020) to red, green and blue, 0 to 255.
function rgb(lightness, a, b) {
  const l = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const m = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const s = (lightness - 0.0894841775 * a - 1.291485548 * b) ** 3;
  return [
    4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
    -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
    -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
  ].map((x) => Math.round(255 * curve(Math.min(1, Math.max(0, x)))));
}

// Colour of a direction in degrees, as [red, green, blue].
export function colour(degrees, theme) {
  const [sin, cos] = [Math.sin((degrees * Math.PI) / 180), Math.cos((degrees * Math.PI) / 180)];
  return rgb(LIGHTNESS[theme] + SWING * cos, -GREEN_RED * cos, YELLOW_BLUE * sin);
}

// How much of its colour a cell has: none where chance agrees as well.
const clearness = (coherence) => Math.min(1, Math.max(0, (coherence - 0.28) / 0.5));

// Lowest and highest frequency of some azigrams.
export function limits(points) {
  const edges = points.flatMap((p) => [p[1][0], p[1].at(-1)]);
  return edges.length ? [Math.min(...edges), Math.max(...edges)] : [11, 24];
}

// Room for the key above the plot, in sizes of text.
export const KEY = 1.5;

// The clearest direction of the newest azigram.
export function inWords(last) {
  const best = last ? last[3].indexOf(Math.max(...last[3])) : -1;
  if (!Number.isFinite(last?.[2][best])) return 'Azigram: none at this time';
  const hz = (last[1][best] + last[1][best + 1]) / 2;
  return `Azigram: clearest ${bearing(last[2][best])} at ${hz.toFixed(1)} Hz, agreement ${last[3][best].toFixed(2)}`;
}

// Draws cells, and the key of their colours. `at`: where times and frequencies lie.
export function cells(c, points, at, theme) {
  const name = document.documentElement.dataset.theme === 'dark' ? 'dark' : 'light';
  // Of a long time not every minute comes; what comes stands for those beside it.
  const gaps = points.slice(1).map((p, n) => p[0] - points[n][0]).sort((a, b) => a - b);
  const half = Math.max(MINUTE, Math.min(gaps[gaps.length >> 1] ?? MINUTE, (at.to - at.from) / 100)) / 2;
  // On whole dots, so that no seams show between cells.
  const dots = window.devicePixelRatio || 1;
  const whole = (v) => Math.round(v * dots) / dots;
  for (const [ms, edges, azimuths, coherences] of points) {
    const [left, right] = [ms - half, ms + half].map((t) => whole(Math.min(at.right, Math.max(at.left, at.x(t)))));
    azimuths.forEach((degrees, n) => {
      if (!Number.isFinite(degrees)) return;
      const [top, bottom] = [whole(at.y(edges[n + 1])), whole(at.y(edges[n]))];
      c.fillStyle = `rgba(${colour(degrees, name).join()}, ${clearness(coherences[n])})`;
      c.fillRect(left, top, right - left, bottom - top);
      if (degrees > 180 && clearness(coherences[n]) > 0.3 && Math.min(right - left, bottom - top) >= 4) {
        c.fillStyle = theme.colours.text;
        c.fillRect((left + right) / 2 - 0.75, (top + bottom) / 2 - 0.75, 1.5, 1.5);
      }
    });
  }
  key(c, at, name, theme);
}

// All directions in a row, above the plot.
function key(c, { left, right, size }, name, theme) {
  const [wide, high, top] = [Math.min(size * 14, right - left), size * 1.1, 0.5];
  const from = right - wide;
  for (let x = 0; x < wide; x += 1) {
    c.fillStyle = `rgb(${colour((360 * x) / wide, name).join()})`;
    c.fillRect(from + x, top, 1, high);
  }
  c.textAlign = 'center';
  ['N', 'E', 'S', 'W', 'N'].forEach((letter, n) => {
    const x = from + Math.min(wide - size * 0.45, Math.max(size * 0.45, (wide * n) / 4));
    c.fillStyle = letter === 'S' ? '#ffffff' : '#000000';
    c.fillText(letter, x, top + high * 0.82);
  });
  c.strokeStyle = theme.colours.quiet;
  c.strokeRect(from, top, wide, high);
}
