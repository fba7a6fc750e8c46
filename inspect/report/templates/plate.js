(() => {
const FIELDS = new Uint16Array(bytes(DATA.fields).buffer);
const TRANSMITTANCE = new Float64Array(bytes(DATA.transmittance).buffer);
const FLAT = 0xffff;

// The reflectance of a class: rough plastic on every facet of its outline, with the visible shares of the profile.
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
function erfc(x) { // of x >= 0, within 1.5e-7 (Abramowitz and Stegun, 7.1.26)
  const t = 1 / (1 + 0.3275911 * x);
  return Math.exp(-x * x) * t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))));
}
function lambda(alphaTan) {
  const a = 1 / Math.max(alphaTan, 1e-9);
  return a > 6 ? 0 : Math.max(0, 0.5 * (Math.exp(-a * a) / (a * Math.sqrt(Math.PI)) - erfc(a)));
}
function fresnel(cosine, index) {
  const inside = Math.sqrt(Math.max(0, 1 - (1 - cosine * cosine) / (index * index)));
  const p = (index * cosine - inside) / (index * cosine + inside), s = (cosine - index * inside) / (cosine + index * inside);
  return 0.5 * (p * p + s * s);
}
function transmittance(cosine) {
  const place = Math.min(cosine, 1) * (TRANSMITTANCE.length - 1), low = Math.min(Math.floor(place), TRANSMITTANCE.length - 2);
  return TRANSMITTANCE[low] + (place - low) * (TRANSMITTANCE[low + 1] - TRANSMITTANCE[low]);
}
function brdf(light, camera) { // in the frame of a facet: along the ridges, across them, normal
  const half = light.map((one, k) => one + camera[k]), size = Math.hypot(...half), h = half.map(one => one / size);
  const slope = ((h[0] / DATA.along) ** 2 + (h[1] / DATA.across) ** 2) / (h[2] * h[2]);
  const density = h[2] > 1e-6 ? Math.exp(-slope) / (Math.PI * DATA.along * DATA.across * h[2] ** 4) : 0;
  const spread = d => Math.hypot(DATA.along * d[0], DATA.across * d[1]) / Math.max(d[2], 1e-9);
  const shadow = 1 / (1 + lambda(spread(light)) + lambda(spread(camera)));
  const lobe = fresnel(Math.min(1, dot(light, h)), DATA.index) * density * shadow / (4 * light[2] * camera[2]);
  return lobe + DATA.base * transmittance(light[2]) * transmittance(camera[2]);
}
function shares(x, z, tangent) { // visible share of every segment of the periodic outline
  if (tangent < 0) return shares(x.map(one => -one).reverse(), [...z].reverse(), -tangent).reverse();
  const count = x.length - 1, period = x[count] - x[0];
  const reach = 2 + Math.ceil(tangent * (Math.max(...z) - Math.min(...z)) / period);
  const sheared = x.map((one, k) => one - tangent * z[k]), found = new Array(count);
  let limit = Infinity;
  for (let n = reach; n >= 0; n--)
    for (let k = count - 1; k >= 0; k--) {
      limit = Math.min(limit, sheared[k + 1] + period * n);
      const length = sheared[k + 1] - sheared[k];
      found[k] = length > 1e-12 * period ? Math.min(1, Math.max(0, (limit - sheared[k]) / length)) : 0;
    }
  return found;
}
function radiance(one, toLight, toCamera) { // of a class in 1/sr, directions in the frame of the plate
  if (toLight[2] <= 1e-3 || toCamera[2] <= 1e-3) return 0;
  const c = Math.cos(rad(one.azimuth)), s = Math.sin(rad(one.azimuth));
  const into = v => [c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]];
  const light = into(toLight), camera = into(toCamera);
  const tl = light[0] / light[2], tc = camera[0] / camera[2];
  const lit = shares(one.x, one.z, tl), seen = shares(one.x, one.z, tc), same = (tl >= 0) === (tc >= 0);
  let total = 0;
  for (let k = 0; k < one.length.length; k++) {
    const up = -one.normal[2 * k], flat = one.normal[2 * k + 1], j = one.segment[k];
    const local = v => [v[1], -flat * v[0] - up * v[2], flat * v[2] - up * v[0]];
    const l = local(light), o = local(camera);
    if (l[2] <= 0 || o[2] <= 0) continue;
    const share = same ? Math.min(lit[j], seen[j]) : Math.max(0, lit[j] + seen[j] - 1);
    if (share > 0) total += brdf(l, o) * l[2] * o[2] * one.length[k] * share;
  }
  return one.share * total / ((one.x[one.x.length - 1] - one.x[0]) * camera[2]);
}

// The part is turned about its normal, then tilted about the picture's horizontal axis; the eye is far above.
function frame(state) {
  const [cs, ss, ct, st] = [Math.cos(rad(state.stage)), Math.sin(rad(state.stage)), Math.cos(rad(state.tilt)), Math.sin(rad(state.tilt))];
  return [[cs, -ss, 0], [ct * ss, ct * cs, -st], [st * ss, st * cs, ct]];
}
function lightOf(state) {
  const e = Math.cos(rad(state.elevation));
  return [e * Math.cos(rad(state.azimuth)), e * Math.sin(rad(state.azimuth)), Math.sin(rad(state.elevation))];
}
function palette(state) {
  const turn = frame(state), into = v => [0, 1, 2].map(k => turn[0][k] * v[0] + turn[1][k] * v[1] + turn[2][k] * v[2]);
  const light = into(lightOf(state)), eye = into([0, 0, 1]);
  return Float32Array.from(DATA.classes, one => radiance(one, light, eye));
}

const canvas = $("plate");
const gl = canvas.getContext("webgl2", {antialias: false, alpha: false});
function missing(why) {
  document.body.dataset.webgl = "missing";
  $("missing").hidden = false;
  if (why) $("missing-why").textContent = why;
}
if (!gl) { missing(); $("app").hidden = true; return; }
document.body.dataset.webgl = "there";

const VERTEX = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0), 0.0, 1.0); }`;
const FRAGMENT = `#version 300 es
precision highp float; precision highp int; precision highp usampler2D;
uniform usampler2D fields;
uniform sampler2D light;
uniform mat2 into;
uniform vec2 size, grid;
uniform vec3 ground;
uniform float scale, gain, black, white;
uniform int mode, samples;
out vec4 pixel;
vec4 seen(vec2 at) { // radiance and share of the plate at a place of the picture
  vec2 p = into * ((at - 0.5 * size) / scale) + 0.5 * grid;
  if (p.x < 0.0 || p.y < 0.0 || p.x >= grid.x || p.y >= grid.y) return vec4(0.0);
  uint one = texelFetch(fields, ivec2(p.x, grid.y - p.y), 0).r;
  return vec4(one == 65535u ? 0.0 : texelFetch(light, ivec2(int(one), 0), 0).r, 0.0, 0.0, 1.0);
}
void main() {
  vec4 sum = vec4(0.0);
  for (int i = 0; i < samples; i++) for (int j = 0; j < samples; j++)
    sum += seen(floor(gl_FragCoord.xy) + (vec2(i, j) + 0.5) / float(samples));
  sum /= float(samples * samples);
  if (mode == 2) { pixel = vec4(sum.r, sum.a, 0.0, 1.0); return; }
  if (sum.a <= 0.0) { pixel = vec4(ground, 1.0); return; }
  float value = gain * sum.r / sum.a;
  value = mode == 0 ? (value - black) / (white - black) : value / white;
  value = clamp(value, 0.0, 1.0);
  if (mode == 1) value = value <= 0.0031308 ? 12.92 * value : 1.055 * pow(value, 1.0 / 2.4) - 0.055;
  pixel = vec4(mix(ground, vec3(value), sum.a), 1.0);
}`;
const {made: program, at: u} = linked(gl, VERTEX, FRAGMENT);
function texture(unit) {
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  for (const [key, value] of [[gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
    [gl.TEXTURE_MIN_FILTER, gl.NEAREST], [gl.TEXTURE_MAG_FILTER, gl.NEAREST]]) gl.texParameteri(gl.TEXTURE_2D, key, value);
}
gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
texture(0);
gl.texImage2D(gl.TEXTURE_2D, 0, gl.R16UI, DATA.cols, DATA.rows, 0, gl.RED_INTEGER, gl.UNSIGNED_SHORT, FIELDS);
texture(1);
gl.bindVertexArray(gl.createVertexArray());

function projection(state, w, h) { // pixels a field along x, and from the picture to the plate
  const turn = frame(state), [a, b, c, d] = [turn[0][0], turn[0][1], turn[1][0], turn[1][1]], det = a * d - b * c;
  return {scale: 0.94 * state.zoom * Math.min(w, h) / Math.hypot(DATA.rows, DATA.cols), into: [d / det, -c / det, -b / det, a / det], turn};
}
function draw(state, light, w, h, mode, ground) {
  const {scale, into} = projection(state, w, h);
  gl.viewport(0, 0, w, h);
  gl.useProgram(program);
  gl.activeTexture(gl.TEXTURE1);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, light.length, 1, 0, gl.RED, gl.FLOAT, light);
  gl.uniform1i(u("fields"), 0);
  gl.uniform1i(u("light"), 1);
  gl.uniformMatrix2fv(u("into"), false, into);
  gl.uniform2f(u("size"), w, h);
  gl.uniform2f(u("grid"), DATA.cols, DATA.rows);
  gl.uniform3fv(u("ground"), ground);
  gl.uniform1f(u("scale"), scale);
  gl.uniform1f(u("gain"), 2 ** (state.exposure || 0));
  gl.uniform1f(u("black"), DATA.black);
  gl.uniform1f(u("white"), DATA.white);
  gl.uniform1i(u("mode"), mode);
  gl.uniform1i(u("samples"), mode === 2 ? 1 : 3);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
}

const state = {...DATA.start};
let waiting = false, speaking = 0;
function redraw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => { waiting = false; paint(); });
}
function paint() {
  const box = canvas.getBoundingClientRect(), ratio = Math.min(window.devicePixelRatio || 1, 2);
  const [w, h] = [Math.max(2, Math.round(box.width * ratio)), Math.max(2, Math.round(box.height * ratio))];
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  const ground = getComputedStyle(canvas).getPropertyValue("--stage").trim().match(/../g).map(v => parseInt(v, 16) / 255);
  const light = palette(state);
  draw(state, light, w, h, state.shown === "eye" ? 1 : 0, ground);
  clearTimeout(speaking);
  speaking = setTimeout(() => say(light), 250); // not at every step of a drag
  document.body.dataset.drawn = String(Number(document.body.dataset.drawn || 0) + 1);
}
function say(light) {
  let sum = 0, count = 0, low = Infinity, high = 0;
  for (const one of FIELDS) {
    if (one === FLAT) continue;
    sum += light[one]; count++; low = Math.min(low, light[one]); high = Math.max(high, light[one]);
  }
  const number = FIELDS[(state.row - 1) * DATA.cols + state.col - 1], one = DATA.classes[number];
  const field = number === FLAT ? "flat" : `class ${one.name}, facets toward ${one.azimuth}°, ridge angle ${one.angle}°: ${light[number].toPrecision(3)} per sr`;
  $("said").textContent = `Turned by ${state.stage}°, tilted by ${state.tilt}°, light at azimuth ${state.azimuth.toFixed(0)}° and elevation ${state.elevation.toFixed(0)}°: `
    + `mean ${(sum / count).toPrecision(3)} per sr, fields from ${low.toPrecision(3)} to ${high.toPrecision(3)}. Row ${state.row}, column ${state.col}: ${field}.`;
}

const controls = [...document.querySelectorAll("[data-key]")];
function settle() {
  for (const control of controls) {
    const value = state[control.dataset.key], out = document.querySelector(`output[for="${control.id}"]`);
    control.value = value;
    if (out) out.textContent = (+value).toFixed(+(control.dataset.digits || 0)).replace("-", "−") + (control.dataset.unit || "");
  }
  redraw();
}
function change(key, value) {
  const control = controls.find(one => one.dataset.key === key);
  state[key] = key === "stage" || key === "azimuth" ? ((value + 180) % 360 + 360) % 360 - 180 : Math.min(+control.max, Math.max(+control.min, value));
  settle();
}
for (const control of controls)
  control.addEventListener("input", () => {
    state[control.dataset.key] = control.type === "range" ? +control.value : control.value;
    settle();
  });
for (const button of document.querySelectorAll("[data-stage]"))
  button.addEventListener("click", () => { Object.assign(state, {...DATA.start, stage: +button.dataset.stage, row: state.row, col: state.col}); settle(); });
$("reset").addEventListener("click", () => { Object.assign(state, DATA.start); settle(); });

let hand = null;
canvas.addEventListener("pointerdown", event => {
  canvas.focus({preventScroll: true});
  canvas.setPointerCapture(event.pointerId);
  hand = [event.clientX, event.clientY, 0];
});
canvas.addEventListener("pointermove", event => {
  if (!hand) return;
  const [dx, dy] = [event.clientX - hand[0], event.clientY - hand[1]];
  hand = [event.clientX, event.clientY, hand[2] + Math.abs(dx) + Math.abs(dy)];
  if (event.shiftKey || (event.buttons & 2)) moveLight(dx, dy);
  else { change("stage", state.stage - 0.4 * dx); change("tilt", state.tilt + 0.4 * dy); }
});
for (const end of ["pointerup", "pointercancel"])
  canvas.addEventListener(end, event => {
    if (end === "pointerup" && hand && hand[2] < 3) pick(event);
    hand = null;
  });
function pick(event) {
  const box = canvas.getBoundingClientRect(), {scale, into} = projection(state, box.width, box.height);
  const x = (event.clientX - box.left - 0.5 * box.width) / scale, y = (box.top + 0.5 * box.height - event.clientY) / scale;
  const col = Math.ceil(into[0] * x + into[2] * y + 0.5 * DATA.cols), row = Math.ceil(0.5 * DATA.rows - into[1] * x - into[3] * y);
  if (col >= 1 && col <= DATA.cols && row >= 1 && row <= DATA.rows) { state.col = col; state.row = row; settle(); }
}
canvas.addEventListener("contextmenu", event => event.preventDefault());
canvas.addEventListener("wheel", event => { event.preventDefault(); change("zoom", state.zoom * Math.exp(-0.0012 * event.deltaY)); }, {passive: false});
function moveLight(dx, dy) { // as a point on the half sphere above the plate
  let [x, y] = lightOf(state);
  x += 0.006 * dx;
  y -= 0.006 * dy;
  const off = Math.min(Math.hypot(x, y), 0.9998);
  if (off > 1e-4) change("azimuth", Math.atan2(y, x) * 180 / Math.PI);
  change("elevation", Math.acos(off) * 180 / Math.PI);
}
const STEPS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]};
canvas.addEventListener("keydown", event => {
  const step = STEPS[event.key];
  if (step && event.shiftKey) moveLight(8 * step[0], 8 * step[1]);
  else if (step) { change("stage", state.stage - 5 * step[0]); change("tilt", state.tilt + 5 * step[1]); }
  else if (event.key === "+" || event.key === "=") change("zoom", state.zoom * 1.2);
  else if (event.key === "-") change("zoom", state.zoom / 1.2);
  else if (event.key === "0") $("reset").click();
  else return;
  event.preventDefault();
});
new ResizeObserver(redraw).observe(canvas);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
canvas.addEventListener("webglcontextlost", () => missing("The graphics driver took the 3-D context away: reload the page."));

function selftest() {
  if (!gl.getExtension("EXT_color_buffer_float")) return missing("The self-test needs pixels with floating-point numbers.");
  const size = DATA.selftest_size, buffer = gl.createFramebuffer(), colour = gl.createRenderbuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, buffer);
  gl.bindRenderbuffer(gl.RENDERBUFFER, colour);
  gl.renderbufferStorage(gl.RENDERBUFFER, gl.RGBA32F, size, size);
  gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, colour);
  const cases = DATA.selftest.map(asked => {
    const all = {...DATA.start, ...asked}, found = new Float32Array(4 * size * size), shown = [];
    draw(all, palette(all), size, size, 2, [0, 0, 0]);
    gl.readPixels(0, 0, size, size, gl.RGBA, gl.FLOAT, found);
    for (let row = size - 1; row >= 0; row--)
      for (let col = 0; col < size; col++) shown.push(found[4 * (row * size + col) + 1] > 0 ? +found[4 * (row * size + col)].toPrecision(6) : -1);
    return {...asked, pixels: shown};
  });
  gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  gl.deleteFramebuffer(buffer);
  gl.deleteRenderbuffer(colour);
  $("selftest").hidden = false;
  $("selftest").textContent = JSON.stringify({size, cases});
}
settle();
if (location.hash === "#selftest") selftest();
document.body.dataset.ready = "yes";
})();
