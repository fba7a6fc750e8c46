(() => {
const TRANSMITTANCE = new Float64Array(bytes(DATA.transmittance).buffer);

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

function palette(state) {
  const [light, eye] = directionsOf(state);
  return Float32Array.from(DATA.classes.flatMap(one => { const value = radiance(one, light, eye); return [value, value, value, 1]; }));
}
function text(light, number, place) {
  let sum = 0, count = 0, low = Infinity, high = 0;
  for (const one of FIELDS) {
    if (one === FLAT) continue;
    sum += light[4 * one]; count++; low = Math.min(low, light[4 * one]); high = Math.max(high, light[4 * one]);
  }
  const one = DATA.classes[number];
  const field = number === FLAT ? "flat" : `class ${one.name}, facets toward ${String(one.azimuth).replace("-", "−")}°, ridge angle ${one.angle}°: ${light[4 * number].toPrecision(3)} per sr`;
  return `mean ${(sum / count).toPrecision(3)} per sr, fields from ${low.toPrecision(3)} to ${high.toPrecision(3)}. ${place}: ${field}.`;
}
showFields({palette, text, channels: 1});
})();
