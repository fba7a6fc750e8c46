(() => {
const floats = text => new Float32Array(bytes(text).buffer);

const SHARED = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp sampler2DArray;
const int INKS = ${DATA.inks.length}, LAYERS = ${DATA.halftone.length};
const float PI = 3.14159265358979;
uniform sampler2D tables;
uniform sampler2DArray dots, tones;
uniform mat3 turn, adapt;
uniform int lights, model, row, print;
uniform bool each_dot;
uniform vec4 light[3], lobe[INKS], extras;
uniform vec3 white, ground;
uniform float exposure;
out vec4 pixel;
float w[3 * LAYERS];
vec3 at(int y, int i, float share) {
  return mix(texelFetch(tables, ivec2(i, y), 0).rgb, texelFetch(tables, ivec2(i + 1, y), 0).rgb, share);
}
vec3 fetched(sampler2DArray from, vec2 uv, int layer) {
  ivec2 size = textureSize(from, 0).xy;
  ivec2 place = ivec2(floor(vec2(uv.x, 1.0 - uv.y) * vec2(size)));
  return texelFetch(from, ivec3(clamp(place, ivec2(0), size - 1), layer), 0).rgb;
}
vec3 smoothed(sampler2DArray from, vec2 uv, vec2 dx, vec2 dy, int layer) {
  dx *= 3.0; dy *= 3.0; // a few pixels wide, so that no dot stands out
  return textureGrad(from, vec3(uv.x, 1.0 - uv.y, layer), vec2(dx.x, -dx.y), vec2(dy.x, -dy.y)).rgb;
}
void cover(vec2 uv, vec2 dx, vec2 dy, bool outer) {
  for (int j = 0; j < LAYERS; j++) {
    vec3 c = vec3(0.0);
    if (outer && print > 1) c = vec3(print == 2 + 3 * j, print == 3 + 3 * j, print == 4 + 3 * j);
    else if (outer && each_dot) c = print == 0 ? fetched(dots, uv, j) : fetched(tones, uv, j);
    else if (outer) c = print == 0 ? smoothed(dots, uv, dx, dy, j) : smoothed(tones, uv, dx, dy, j);
    for (int k = 0; k < 3; k++) w[3 * j + k] = c[k];
  }
}
float hidden(float slant) { return 0.5 * (sqrt(1.0 + slant) - 1.0); }
vec3 shaded(vec3 n, vec3 t) {
  vec3 total = vec3(0.0), eye = vec3(0.0, 0.0, 1.0), b = cross(n, t);
  float cos_o = min(n.z, 1.0), bare = 1.0;
  for (int k = 0; k < INKS; k++) bare -= w[k];
  for (int j = 0; j < 3; j++) {
    if (j >= lights) break;
    vec3 l = light[j].xyz, h = (l + eye) / max(length(l + eye), 1e-6);
    float cos_i = min(dot(n, l), 1.0);
    if (cos_i <= 0.0 || cos_o <= 0.0) continue;
    float up = dot(n, h), x = 1.0 - clamp(dot(l, h), 0.0, 1.0);
    if (model == 0)
      x = max(0.0, 1.0 - 0.5 * (sqrt((1.0 + cos_i) * (1.0 + cos_o)) - sqrt((1.0 - cos_i) * (1.0 - cos_o))));
    float place = x * 255.0, share;
    int i = min(int(place), 254);
    share = place - float(i);
    for (int k = 0; k < INKS; k++) {
      if (w[k] == 0.0) continue;
      vec4 a = lobe[k];
      vec3 p = (a.z * t + a.w * b), q = (a.z * b - a.w * t);
      vec2 across = vec2(dot(p, h) / a.x, dot(q, h) / a.y);
      float spread = dot(across, across) + up * up;
      float value = light[j].w / (4.0 * PI * a.x * a.y * spread * spread);
      if (model == 0) value *= cos_i;
      else {
        vec2 si = vec2(dot(p, l) * a.x, dot(q, l) * a.y), so = vec2(p.z * a.x, q.z * a.y);
        value /= cos_o * (1.0 + hidden(dot(si, si) / (cos_i * cos_i)) + hidden(dot(so, so) / (cos_o * cos_o)));
      }
      total += value * w[k] * at(row + k, i, share);
    }
    float mirrored = max(2.0 * cos_i * cos_o - l.z, 0.0);
    float paper = extras.x * (extras.y + 2.0) / (2.0 * PI) * (mirrored > 0.0 ? pow(mirrored, extras.y) : 0.0)
      + extras.z / (4.0 * PI * (cos_i + cos_o)) + extras.w / PI * max(bare, 0.0);
    total += light[j].w * cos_i * paper * white;
  }
  return total;
}
vec4 shown(vec3 linear) {
  vec3 c = clamp(adapt * (exposure * linear), 0.0, 1.0);
  return vec4(mix(12.92 * c, 1.055 * pow(max(c, 0.0031308), vec3(1.0 / 2.4)) - 0.055, greaterThan(c, vec3(0.0031308))), 1.0);
}
`;
const FULL = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0), 0.0, 1.0); }`;
const SHAPES = SHARED + `
uniform int shape;
uniform vec2 half_size;
uniform vec4 view;
uniform float scale;
float around(vec3 p) { float u = 0.5 + atan(p.x, p.z) / PI; return u - floor(u); }
void main() {
  vec2 e = (gl_FragCoord.xy - view.xy - 0.5 * view.zw) / scale;
  vec3 start = vec3(e, 0.0) * turn, eye = vec3(0.0, 0.0, 1.0) * turn, n, t;
  vec2 uv = vec2(0.0);
  bool seen = false, outer = true;
  if (shape == 0) {
    float rest = 1.0 - dot(e, e);
    seen = rest > 0.0;
    n = vec3(e, sqrt(max(rest, 0.0))) * turn;
    t = vec3(n.z, 0.0, -n.x) / max(length(n.xz), 1e-6);
    uv = vec2(around(n), 0.5 + asin(clamp(n.y, -1.0, 1.0)) / PI);
  } else if (shape == 1) {
    float a = dot(eye.xz, eye.xz), b = dot(start.xz, eye.xz);
    float root = b * b - a * (dot(start.xz, start.xz) - half_size.x * half_size.x);
    float far = sqrt(max(root, 0.0));
    vec3 p = start + (far - b) / a * eye;
    outer = abs(p.y) <= half_size.y;
    if (!outer) p = start - (far + b) / a * eye;
    seen = root > 0.0 && a > 1e-9 && abs(p.y) <= half_size.y;
    vec3 m = vec3(p.x, 0.0, p.z) / half_size.x;
    n = outer ? m : -m;
    t = vec3(m.z, 0.0, -m.x);
    uv = vec2(around(m), 0.5 + 0.5 * p.y / half_size.y);
  } else {
    vec3 p = start - start.z / eye.z * eye;
    seen = abs(eye.z) > 1e-6 && abs(p.x) <= half_size.x && abs(p.y) <= half_size.y;
    outer = eye.z > 0.0;
    n = vec3(0.0, 0.0, outer ? 1.0 : -1.0);
    t = vec3(1.0, 0.0, 0.0);
    uv = 0.5 + 0.5 * p.xy / half_size;
  }
  vec2 dx = dFdx(uv), dy = dFdy(uv), turned = vec2(fract(uv.x + 0.5), uv.y);
  vec2 ex = dFdx(turned), ey = dFdy(turned);
  if (abs(ex.x) + abs(ey.x) < abs(dx.x) + abs(dy.x)) { dx = ex; dy = ey; }
  cover(uv, dx, dy, outer);
  pixel = seen ? shown(shaded(turn * n, turn * t)) : vec4(ground, 0.0);
}`;
const CORNERS = `#version 300 es
layout(location = 0) in vec3 place;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec3 tangent;
layout(location = 3) in vec2 texture_place;
uniform mat3 turn;
uniform vec4 view;
uniform float scale;
out vec3 n, t;
out vec2 uv;
void main() {
  vec3 p = turn * place;
  gl_Position = vec4(2.0 * scale * p.xy / view.zw, -0.5 * p.z, 1.0);
  n = turn * normal; t = turn * tangent; uv = texture_place;
}`;
const MESH = SHARED + `
in vec3 n, t;
in vec2 uv;
void main() {
  bool outer = gl_FrontFacing;
  vec3 m = normalize(n) * (outer ? 1.0 : -1.0), s = t - dot(t, m) * m;
  cover(fract(uv), dFdx(uv), dFdy(uv), outer);
  pixel = shown(shaded(m, s / max(length(s), 1e-6)));
}`;

const canvas = $("proof");
const gl = canvas.getContext("webgl2", {antialias: true, alpha: false});
if (!gl) {
  document.body.dataset.webgl = "missing";
  $("missing").hidden = false;
  $("app").hidden = true;
  return;
}
document.body.dataset.webgl = "there";

function texture(unit, kind) {
  const made = gl.createTexture();
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(kind, made);
  gl.texParameteri(kind, gl.TEXTURE_WRAP_S, gl.REPEAT);
  gl.texParameteri(kind, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
  gl.texParameteri(kind, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(kind, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  return made;
}

async function pictures(unit, uris) {
  const images = uris.map(uri => Object.assign(new Image(), {src: uri}));
  await Promise.all(images.map(image => image.decode()));
  const image = images[0], kind = gl.TEXTURE_2D_ARRAY;
  const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
  if (Math.max(image.naturalWidth, image.naturalHeight) > most)
    throw new Error(`the print has ${image.naturalWidth} × ${image.naturalHeight} dots, and this graphics driver takes ${most} a side: make the proof with fewer dots.`);
  texture(unit, kind);
  gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
  gl.pixelStorei(gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL, false);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  const size = [image.naturalWidth, image.naturalHeight];
  gl.texImage3D(kind, 0, gl.RGB8, ...size, images.length, 0, gl.RGB, gl.UNSIGNED_BYTE, null);
  images.forEach((one, layer) =>
    gl.texSubImage3D(kind, 0, 0, 0, layer, ...size, 1, gl.RGB, gl.UNSIGNED_BYTE, one));
  gl.generateMipmap(kind);
  // light adds up in coverage, so that averages of dots are what the eye sees of them
  gl.texParameteri(kind, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
  const fine = gl.getExtension("EXT_texture_filter_anisotropic");
  if (fine) gl.texParameterf(kind, fine.TEXTURE_MAX_ANISOTROPY_EXT, 8);
}

const rows = DATA.illuminants.length * DATA.models.length * DATA.inks.length;
texture(0, gl.TEXTURE_2D);
const table = floats(DATA.tables), wide = new Float32Array(rows * 256 * 4);
for (let i = 0; i < rows * 256; i++) wide.set(table.subarray(3 * i, 3 * i + 3), 4 * i);
gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, 256, rows, 0, gl.RGBA, gl.FLOAT, wide);

const shapes = linked(gl, FULL, SHAPES), empty = gl.createVertexArray();
let mesh = null, mesh_array = null, mesh_count = 0;
if (DATA.mesh) {
  mesh = linked(gl, CORNERS, MESH);
  mesh_array = gl.createVertexArray();
  gl.bindVertexArray(mesh_array);
  gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ARRAY_BUFFER, floats(DATA.mesh.vertices), gl.STATIC_DRAW);
  for (const [place, size, offset] of [[0, 3, 0], [1, 3, 12], [2, 3, 24], [3, 2, 36]]) {
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, gl.FLOAT, false, 44, offset);
  }
  const corners = new Uint32Array(bytes(DATA.mesh.triangles).buffer);
  mesh_count = corners.length;
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
  gl.bindVertexArray(null);
}

function turned(state) {
  const [sy, cy, sp, cp] = [Math.sin(rad(state.yaw)), Math.cos(rad(state.yaw)), Math.sin(rad(state.pitch)), Math.cos(rad(state.pitch))];
  return [cy, 0, sy, sp * sy, cp, -sp * cy, -cp * sy, sp, cp * cy];
}
function direction(azimuth, elevation) {
  const e = Math.cos(rad(elevation));
  return [e * Math.cos(rad(azimuth)), e * Math.sin(rad(azimuth)), Math.sin(rad(elevation))];
}
function lights(state) {
  const key = direction(state.azimuth, state.elevation), all = [[...key, Math.PI]];
  if (state.second) all.push([...direction(...DATA.second), 0.5 * Math.PI]);
  if (state.match && state.behind > 0) all.push([...key.map(v => -v), Math.PI * state.behind]);
  return all;
}
function lobes(state) {
  return DATA.inks.flatMap(ink => state.roughness === "file"
    ? [ink.alpha, ink.alpha_y, Math.cos(rad(ink.brush_deg)), Math.sin(rad(ink.brush_deg))] : [state.alpha, state.alpha, 1, 0]);
}

const kind_of = print => print === "halftone" ? 0 : print === "tones" ? 1 : 1 + Number(print.slice(5));
function half_size(shape) {
  const a = DATA.aspect, r = 2 * a / Math.PI;
  return shape === "cylinder" ? [r / Math.hypot(r, 1), 1 / Math.hypot(r, 1)] : [a / Math.hypot(a, 1), 1 / Math.hypot(a, 1)];
}

function draw(state, model, view, ground) {
  const used = state.shape === "mesh" ? mesh : shapes;
  const u = used.at, lamp = DATA.illuminants[state.illuminant], m = DATA.models.findIndex(one => one.key === model);
  gl.viewport(...view);
  gl.scissor(...view);
  gl.enable(gl.SCISSOR_TEST);
  gl.clearColor(...ground, 0);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.useProgram(used.made);
  ["tables", "dots", "tones"].forEach((name, unit) => gl.uniform1i(u(name), unit));
  gl.uniformMatrix3fv(u("turn"), true, turned(state));
  gl.uniformMatrix3fv(u("adapt"), true, state.adapt ? lamp.adapt : [1, 0, 0, 0, 1, 0, 0, 0, 1]);
  const all = lights(state);
  gl.uniform1i(u("lights"), all.length);
  gl.uniform4fv(u("light"), all.flat());
  gl.uniform4fv(u("lobe"), lobes(state));
  gl.uniform1i(u("model"), m);
  gl.uniform1i(u("row"), (state.illuminant * DATA.models.length + m) * DATA.inks.length);
  gl.uniform1i(u("print"), kind_of(state.print));
  gl.uniform1i(u("each_dot"), state.dots === "each" ? 1 : 0);
  gl.uniform4fv(u("extras"), state.match ? [state.phong, state.shininess, state.scattering, DATA.substrate] : [0, 0, 0, DATA.substrate]);
  gl.uniform3fv(u("white"), lamp.white);
  gl.uniform1f(u("exposure"), DATA.exposure * 2 ** state.exposure);
  gl.uniform4fv(u("view"), view);
  gl.uniform1f(u("scale"), 0.5 * DATA.fill * state.zoom * Math.min(view[2], view[3]));
  if (used === mesh) {
    gl.enable(gl.DEPTH_TEST);
    gl.bindVertexArray(mesh_array);
    gl.drawElements(gl.TRIANGLES, mesh_count, gl.UNSIGNED_INT, 0);
  } else {
    gl.disable(gl.DEPTH_TEST);
    gl.uniform1i(u("shape"), ["sphere", "cylinder", "plane"].indexOf(state.shape));
    gl.uniform2fv(u("half_size"), half_size(state.shape));
    gl.uniform3fv(u("ground"), ground);
    gl.bindVertexArray(empty);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}

const state = {...DATA.start};
let waiting = false;
function redraw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => { waiting = false; paint(); });
}
function ground() {
  return getComputedStyle(canvas).getPropertyValue("--stage").trim().match(/../g).map(v => parseInt(v, 16) / 255);
}
function paint() {
  const box = canvas.getBoundingClientRect(), ratio = Math.min(window.devicePixelRatio || 1, 2);
  const [w, h] = [Math.max(2, Math.round(box.width * ratio)), Math.max(2, Math.round(box.height * ratio))];
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  const behind = ground(), both = state.beside !== "none", half = Math.floor(w / 2);
  draw(state, state.model, [0, 0, both ? half : w, h], behind);
  if (both) draw(state, state.beside, [half, 0, w - half, h], behind);
  const name = key => DATA.models.find(one => one.key === key).label;
  $("left").textContent = name(state.model);
  $("right").textContent = both ? name(state.beside) : "";
  $("stage").classList.toggle("both", both);
  document.body.dataset.drawn = String(Number(document.body.dataset.drawn || 0) + 1);
}

const controls = [...document.querySelectorAll("[data-key]")];
function show(control) {
  const value = state[control.dataset.key], out = document.querySelector(`output[for="${control.id}"]`);
  if (control.type === "checkbox") control.checked = value; else control.value = value;
  if (out) out.textContent = (+value).toFixed(+(control.dataset.digits || 0)).replace("-", "−") + (control.dataset.unit || "");
}
function settle() {
  const preset = DATA.roughness.find(one => one.key === state.roughness);
  if (preset && preset.alpha !== null) state.alpha = preset.alpha;
  controls.forEach(show);
  $("alpha").disabled = state.roughness !== "own";
  document.querySelectorAll("[data-extra]").forEach(one => { one.disabled = !state.match; });
  $("plane-hint").hidden = state.shape !== "plane";
  if ($("photograph")) $("photograph").hidden = !state.photo;
  redraw();
}
function change(key, value) {
  const control = controls.find(one => one.dataset.key === key);
  const limit = v => control && control.type === "range" ? Math.min(+control.max, Math.max(+control.min, v)) : v;
  state[key] = key === "yaw" || key === "azimuth" ? ((value + 180) % 360 + 360) % 360 - 180 : limit(value);
  settle();
}
for (const control of controls) {
  control.addEventListener("input", () => {
    const key = control.dataset.key;
    state[key] = control.type === "checkbox" ? control.checked : control.type === "range" || key === "illuminant" ? +control.value : control.value;
    settle();
  });
}
$("reset").addEventListener("click", () => { Object.assign(state, DATA.start); settle(); });

const fingers = new Map();
let pinch = 0;
canvas.addEventListener("pointerdown", event => {
  canvas.focus({preventScroll: true});
  canvas.setPointerCapture(event.pointerId);
  fingers.set(event.pointerId, [event.clientX, event.clientY]);
  pinch = 0;
});
canvas.addEventListener("pointermove", event => {
  const before = fingers.get(event.pointerId);
  if (!before) return;
  const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
  fingers.set(event.pointerId, [event.clientX, event.clientY]);
  if (fingers.size > 1) {
    const [a, b] = [...fingers.values()], apart = Math.hypot(a[0] - b[0], a[1] - b[1]);
    if (pinch > 0 && apart > 0) change("zoom", state.zoom * apart / pinch);
    pinch = apart;
  } else if (event.shiftKey || (event.buttons & 2) || state.drag === "light") move_light(dx, dy);
  else { change("yaw", state.yaw + 0.4 * dx); change("pitch", state.pitch + 0.4 * dy); }
});
for (const end of ["pointerup", "pointercancel"])
  canvas.addEventListener(end, event => { fingers.delete(event.pointerId); pinch = 0; });
canvas.addEventListener("contextmenu", event => event.preventDefault());
canvas.addEventListener("wheel", event => { event.preventDefault(); change("zoom", state.zoom * Math.exp(-0.0012 * event.deltaY)); }, {passive: false});

function move_light(dx, dy) {
  // the light moves as a point on the half sphere above the picture, pushed by the hand
  let [x, y] = direction(state.azimuth, state.elevation);
  x += 0.006 * dx;
  y -= 0.006 * dy;
  const off = Math.min(Math.hypot(x, y), 0.9998);
  if (off > 1e-4) change("azimuth", Math.atan2(y, x) * 180 / Math.PI);
  change("elevation", Math.acos(off) * 180 / Math.PI);
}
const STEPS = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]};
canvas.addEventListener("keydown", event => {
  const step = STEPS[event.key];
  if (step && event.shiftKey) move_light(8 * step[0], 8 * step[1]);
  else if (step) { change("yaw", state.yaw + 5 * step[0]); change("pitch", state.pitch + 5 * step[1]); }
  else if (event.key === "+" || event.key === "=") change("zoom", state.zoom * 1.2);
  else if (event.key === "-") change("zoom", state.zoom / 1.2);
  else if (event.key === "0") $("reset").click();
  else return;
  event.preventDefault();
});
new ResizeObserver(redraw).observe(canvas);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
canvas.addEventListener("webglcontextlost", () => { $("missing").hidden = false; $("missing-why").textContent = "The graphics driver took the 3-D context away: reload the page."; });

function target(size) {
  const frame = gl.createFramebuffer(), colour = gl.createRenderbuffer(), depth = gl.createRenderbuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
  gl.bindRenderbuffer(gl.RENDERBUFFER, colour);
  gl.renderbufferStorage(gl.RENDERBUFFER, gl.RGBA8, size, size);
  gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, colour);
  gl.bindRenderbuffer(gl.RENDERBUFFER, depth);
  gl.renderbufferStorage(gl.RENDERBUFFER, gl.DEPTH_COMPONENT24, size, size);
  gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.RENDERBUFFER, depth);
  return () => {
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.deleteFramebuffer(frame); gl.deleteRenderbuffer(colour); gl.deleteRenderbuffer(depth);
  };
}
function pixels(asked, size) {
  const free = target(size), found = new Uint8Array(size * size * 4);
  draw({...DATA.start, ...asked}, asked.model, [0, 0, size, size], [0, 0, 0]);
  gl.readPixels(0, 0, size, size, gl.RGBA, gl.UNSIGNED_BYTE, found);
  free();
  let text = "";
  for (let r = size - 1; r >= 0; r--)
    for (let i = 0; i < size * 4; i++) text += found[r * size * 4 + i].toString(16).padStart(2, "0");
  return text;
}
function frame_time_us() {
  const size = 512, free = target(size), one = new Uint8Array(4);
  const run = count => {
    const begin = performance.now();
    for (let i = 0; i < count; i++) draw({...state, second: true}, state.model, [0, 0, size, size], [0, 0, 0]);
    gl.readPixels(256, 256, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, one);
    return 1000 * (performance.now() - begin);
  };
  run(2);
  let count = 4, spent = run(count);
  while (spent < 1e5 && count < 4096) { count *= 4; spent = run(count); }
  free();
  return spent / count;
}
function renderer() {
  const told = gl.getExtension("WEBGL_debug_renderer_info");
  return told ? gl.getParameter(told.UNMASKED_RENDERER_WEBGL) : gl.getParameter(gl.RENDERER);
}
$("time").addEventListener("click", () => {
  const us = frame_time_us();
  $("timed").textContent = `${us < 1000 ? us.toFixed(0) + " µs" : (us / 1000).toFixed(1) + " ms"} a frame of 512 × 512 pixels, two lights, on ${renderer()}`;
  redraw();
});
function selftest() {
  const cases = DATA.selftest.map(asked => ({...asked, pixels: pixels(asked, DATA.selftest_size)}));
  $("selftest").hidden = false;
  $("selftest").textContent = JSON.stringify({size: DATA.selftest_size, renderer: renderer(), cases});
}

Promise.all([pictures(1, DATA.halftone), pictures(2, DATA.tones)]).then(() => {
  settle();
  if (location.hash === "#selftest") selftest();
  document.body.dataset.ready = "yes";
}).catch(problem => {
  $("missing").hidden = false;
  $("missing-why").textContent = `The proof could not be drawn: ${problem.message}`;
});
})();
