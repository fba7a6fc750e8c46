// Fields in rows and columns as they look under a far light, to a far eye: what pages of plates and wafers share.
const FIELDS = new Uint16Array(bytes(DATA.fields).buffer);
const FLAT = 0xffff;

// The part is turned about its normal, then tilted about the picture's horizontal axis; the eye is far above.
function frame(state) {
  const [cs, ss, ct, st] = [Math.cos(rad(state.stage)), Math.sin(rad(state.stage)), Math.cos(rad(state.tilt)), Math.sin(rad(state.tilt))];
  return [[cs, -ss, 0], [ct * ss, ct * cs, -st], [st * ss, st * cs, ct]];
}
function lightOf(state) {
  const e = Math.cos(rad(state.elevation));
  return [e * Math.cos(rad(state.azimuth)), e * Math.sin(rad(state.azimuth)), Math.sin(rad(state.elevation))];
}
// Directions to the light and to the eye in the frame of the part.
function directionsOf(state) {
  const turn = frame(state), into = v => [0, 1, 2].map(k => turn[0][k] * v[0] + turn[1][k] * v[1] + turn[2][k] * v[2]);
  return [into(lightOf(state)), into([0, 0, 1])];
}

// kind.palette(state, coarse): RGBA of every class, quicker where it is coarse; kind.text(palette, number, place): what is seen; kind.channels in use.
function showFields(kind) {
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
  return vec4(one == 65535u ? vec3(0.0) : texelFetch(light, ivec2(int(one), 0), 0).rgb, 1.0);
}
void main() {
  vec4 sum = vec4(0.0);
  for (int i = 0; i < samples; i++) for (int j = 0; j < samples; j++)
    sum += seen(floor(gl_FragCoord.xy) + (vec2(i, j) + 0.5) / float(samples));
  sum /= float(samples * samples);
  if (mode == 2) { pixel = sum; return; }
  if (sum.a <= 0.0) { pixel = vec4(ground, 1.0); return; }
  vec3 value = gain * sum.rgb / sum.a;
  value = mode == 0 ? (value - black) / (white - black) : value / white;
  value = clamp(value, 0.0, 1.0);
  if (mode == 1) value = mix(1.055 * pow(value, vec3(1.0 / 2.4)) - 0.055, 12.92 * value, lessThanEqual(value, vec3(0.0031308)));
  pixel = vec4(mix(ground, value, sum.a), 1.0);
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
function draw(state, light, w, h, mode, ground, samples) {
  const {scale, into} = projection(state, w, h);
  gl.viewport(0, 0, w, h);
  gl.useProgram(program);
  gl.activeTexture(gl.TEXTURE1);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, light.length / 4, 1, 0, gl.RGBA, gl.FLOAT, light);
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
  gl.uniform1i(u("samples"), samples);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
}

const state = {...DATA.start};
let waiting = false, speaking = 0, resting = 0, painted = 0, lasted = 0, shrunk = 1;
let known = {of: "", light: null}, slow = false;
function coloured(state, moving) { // the palette depends on where part and light are, not on zoom or exposure
  const of = [state.stage, state.tilt, state.azimuth, state.elevation].join(), coarse = moving && slow;
  if (known.of !== of || (known.coarse && !coarse)) {
    const begun = performance.now();
    known = {of, light: kind.palette(state, coarse), coarse};
    if (!coarse) slow = performance.now() - begun > 12;
  }
  return known.light;
}
function said(light) {
  return `Turned by ${state.stage}°, tilted by ${state.tilt}°, light at azimuth ${state.azimuth.toFixed(0)}° and elevation ${state.elevation.toFixed(0)}°: `
    + kind.text(light, FIELDS[(state.row - 1) * DATA.cols + state.col - 1], `Row ${state.row}, column ${state.col}`);
}
function redraw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => { waiting = false; paint(1); });
}
function paint(samples) { // while the part moves one sample a pixel, and larger pixels where that is slow; nine samples when it rests
  if (samples > 1) shrunk = lasted < 20 ? Math.max(1, shrunk - 1) : shrunk;
  else if (lasted > 40) shrunk = Math.min(4, shrunk + 1);
  const box = canvas.getBoundingClientRect(), ratio = Math.min(window.devicePixelRatio || 1, 2) / (samples > 1 ? 1 : shrunk);
  const [w, h] = [Math.max(2, Math.round(box.width * ratio)), Math.max(2, Math.round(box.height * ratio))];
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  const ground = getComputedStyle(canvas).getPropertyValue("--stage").trim().match(/../g).map(v => parseInt(v, 16) / 255);
  const light = coloured(state, samples === 1);
  draw(state, light, w, h, state.shown === "eye" ? 1 : 0, ground, samples);
  if (samples > 1) return;
  clearTimeout(resting);
  const now = performance.now(); // a slow machine must not paint in full between two steps of a drag
  resting = setTimeout(() => paint(3), Math.min(2000, Math.max(150, 2 * (now - painted))));
  lasted = now - painted > 1000 ? 0 : now - painted;
  painted = now;
  clearTimeout(speaking);
  speaking = setTimeout(() => { $("said").textContent = said(coloured(state)); }, 250); // not at every step of a drag
  document.body.dataset.drawn = String(Number(document.body.dataset.drawn || 0) + 1);
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
    draw(all, kind.palette(all), size, size, 2, [0, 0, 0], 1);
    gl.readPixels(0, 0, size, size, gl.RGBA, gl.FLOAT, found);
    for (let row = size - 1; row >= 0; row--)
      for (let col = 0; col < size; col++) {
        const at = 4 * (row * size + col);
        for (let k = 0; k < kind.channels; k++) shown.push(found[at + 3] > 0 ? +found[at + k].toPrecision(6) : -1);
      }
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
}
