(() => {
// A dot is a grid of rectangles, each on a level. Its wave toward one point of the lamp is Σ exp(−4πi·h_z·z/λ)·X·Y with
// the integrals X and Y of exp(−2πi·ω·x) over columns and rows; the points of the square lamp add up in power.
const LEVELS = Float64Array.from(DATA.levels);
const NODES = DATA.nodes, WEIGHTS = DATA.weights, N = NODES.length;
const TILES = DATA.tiles.map(one => ({...one, x: Float64Array.from(one.x), y: Float64Array.from(one.y),
  from: Int32Array.from(bytes(one.of), level => 2 * level * N * (one.y.length - 1))})); // where a level begins in PHASED
const WIDEST = Math.max(...TILES.map(one => Math.max(one.x.length, one.y.length)));
const X = new Float64Array(2 * N * WIDEST), Y = new Float64Array(2 * N * WIDEST), ROW = new Float64Array(2 * WIDEST);
const PHASED = new Float64Array(LEVELS.length * Y.length); // Y times the wave of every level
// Every second line with half of its neighbours: enough while the wafer moves, and of the same white.
const FEWER = DATA.lines.length < 5 ? DATA.lines : DATA.lines.filter((_, k) => k % 2 === 0).map((one, half, all) => ({...one,
  rgb: one.rgb.map((own, c) => [-1, 1].reduce((sum, side) => {
    const other = DATA.lines[2 * half + side];
    return sum + (other ? (2 * half + side + 1 < DATA.lines.length ? 0.5 : 1) * other.rgb[c] : 0);
  }, own))}));

function integrals(into, edges, middle, spread) { // of exp(−2πi·ω·x) from edge to edge, for every point of the lamp
  const count = edges.length - 1;
  for (let q = 0; q < N; q++) {
    let w = middle + spread * NODES[q];
    if (Math.abs(w) < 1e-7) w = 1e-7;
    const turn = 2 * Math.PI * w;
    let c = Math.cos(turn * edges[0]), s = Math.sin(turn * edges[0]);
    for (let k = 0; k < count; k++) {
      const nextC = Math.cos(turn * edges[k + 1]), nextS = Math.sin(turn * edges[k + 1]), at = 2 * (q * count + k);
      into[at] = (nextS - s) / turn;
      into[at + 1] = (nextC - c) / turn;
      c = nextC; s = nextS;
    }
  }
}
function phased(count, cos, sin) {
  for (let level = 0, at = 0; level < LEVELS.length; level++)
    for (let k = 0; k < 2 * N * count; k += 2, at += 2) {
      PHASED[at] = Y[k] * cos[level] - Y[k + 1] * sin[level];
      PHASED[at + 1] = Y[k] * sin[level] + Y[k + 1] * cos[level];
    }
}
function power(tile) { // mean over the lamp of |wave|²
  const cols = tile.x.length - 1, rows = tile.y.length - 1, from = tile.from;
  let total = 0;
  for (let p = 0; p < N; p++) {
    for (let k = 0; k < cols; k++) {
      let re = 0, im = 0;
      for (let j = 0, at = k, place = 2 * p * rows; j < rows; j++, at += cols, place += 2) {
        re += PHASED[from[at] + place];
        im += PHASED[from[at] + place + 1];
      }
      ROW[2 * k] = re; ROW[2 * k + 1] = im;
    }
    for (let q = 0; q < N; q++) {
      let re = 0, im = 0;
      for (let k = 0, at = 2 * q * cols; k < 2 * cols; k += 2) {
        re += ROW[k] * X[at + k] - ROW[k + 1] * X[at + k + 1];
        im += ROW[k] * X[at + k + 1] + ROW[k + 1] * X[at + k];
      }
      total += WEIGHTS[p] * WEIGHTS[q] * (re * re + im * im);
    }
  }
  return total;
}
function palette(state, coarse) { // linear sRGB, or the line's radiance, of every tile, per unit irradiance across the beam
  const found = new Float32Array(4 * TILES.length), [l, v] = directionsOf(state);
  for (let t = 0; t < TILES.length; t++) found[4 * t + 3] = 1;
  if (l[2] <= 0.02 || v[2] <= 0.02) return found;
  const h = l.map((one, k) => 0.5 * (one + v[k])), gamma = (h[0] * h[0] + h[1] * h[1] + h[2] * h[2]) / h[2];
  const cos = new Float64Array(LEVELS.length), sin = new Float64Array(LEVELS.length);
  for (const line of coarse ? FEWER : DATA.lines) {
    const scale = gamma * gamma / (line.um * line.um * v[2]);
    for (let k = 0; k < LEVELS.length; k++) {
      const turn = -4 * Math.PI * h[2] * LEVELS[k] / line.um;
      cos[k] = Math.cos(turn); sin[k] = Math.sin(turn);
    }
    let edges = ["", ""]; // tiles of the same edges share their integrals
    for (let t = 0; t < TILES.length; t++) {
      const tile = TILES[t], spread = 0.5 * DATA.source / line.um;
      if (tile.keys[0] !== edges[0]) integrals(X, tile.x, 2 * h[tile.turned ? 1 : 0] / line.um, spread);
      if (tile.keys[1] !== edges[1]) {
        integrals(Y, tile.y, 2 * h[tile.turned ? 0 : 1] / line.um, spread);
        phased(tile.y.length - 1, cos, sin);
      }
      edges = tile.keys;
      const density = scale * power(tile) / DATA.area;
      for (let k = 0; k < 3; k++) found[4 * t + k] += line.rgb[k] * density;
    }
  }
  return found;
}
function text(light, number, place) {
  const bright = t => DATA.luminance.reduce((sum, one, k) => sum + one * light[4 * t + k], 0);
  const all = TILES.map((_, t) => bright(t)), low = Math.min(...all), high = Math.max(...all);
  return `dots from ${low.toPrecision(3)} to ${high.toPrecision(3)} per sr. ${place}: ${TILES[number].name}, ${bright(number).toPrecision(3)} per sr.`;
}
const first = palette(DATA.start);
DATA.white = Math.max(1e-9, ...TILES.map((_, t) => Math.max(first[4 * t], first[4 * t + 1], first[4 * t + 2])));
showFields({palette, text, channels: 3});
})();
