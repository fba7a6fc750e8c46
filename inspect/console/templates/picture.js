"use strict";
// The live picture with its numbers, Stop, and the axes where they may be moved by hand.
const $ = id => document.getElementById(id);
const root = $("station"), words = JSON.parse(root.dataset.words);
const pause = ms => new Promise(done => setTimeout(done, ms));
let wanted = () => "/api/v1/live.jpg", looking = false;  // null where no picture is wanted

// A browser has six connections to one server for all its pages. One page at a time takes a picture, so that a stop
// finds a free one. Without locks (plain HTTP from another computer) every page asks on its own.
const alone = (name, work) => navigator.locks ? navigator.locks.request(`anisoscope ${name}`, work) : work();

// What was pressed is seen at once; who does not hear of the axes within a second goes to the emergency stop.
async function stop() {
  const late = setTimeout(() => complain(words.unconfirmed), 1000);
  $("stopping").textContent = words.stopping;
  const answer = await post("/api/v1/stop");
  clearTimeout(late);
  const left = answer ? Object.entries(answer).map(one => one.join(": ")) : [problem.textContent];
  if (left.length) complain([words.unconfirmed, ...left].join(" "));
  $("stopping").textContent = left.length ? "" : words.halted;
  setTimeout(() => { $("stopping").textContent = ""; }, 5000);
}
if ($("stop")) $("stop").addEventListener("click", stop);

function showNumbers(found) {
  const rounded = (value, digits) => value.toLocaleString(document.documentElement.lang, { minimumFractionDigits: digits, maximumFractionDigits: digits });
  const share = (value, digits) => value === null ? "–" : `${rounded(100 * value, digits)} %`;
  $("advice").textContent = found.advice.join(" · ") || words.good;
  $("focus").value = found.relative_focus || 0;
  $("focus-text").textContent = share(found.relative_focus, 0);
  $("mean").textContent = share(found.mean, 0);
  $("saturated").textContent = share(found.saturated_share, 2);
  $("ridges").textContent = found.ridge_deg === null ? words.undefined : words.angle.replace("{angle}", rounded(found.ridge_deg, 1));
  const bars = $("histogram"), top = Math.max(...found.histogram, 1e-9);
  while (bars.children.length < found.histogram.length) bars.append(document.createElement("div"));
  found.histogram.forEach((part, k) => { bars.children[k].style.height = `${100 * Math.sqrt(part / top)}%`; });
  $("lamps").replaceChildren(...found.lamps.map(one => {
    const item = document.createElement("li"), lamp = document.createElement("span");
    item.className = one.colour; lamp.className = "lamp"; lamp.setAttribute("aria-hidden", "true");
    item.append(lamp, one.words);
    return item;
  }));
  if ($("axes")) $("axes").textContent = found.axes;
}

async function look() {
  if (looking) return;
  looking = true;
  for (let path; !document.hidden && (path = wanted());) {
    try {
      const answer = await alone("picture", () => fetch(path));
      if (problem.textContent === words.away) complain("");
      if (!answer.ok) { $("advice").textContent = (await answer.json()).error; await pause(2000); continue; }
      const old = $("live").src;
      showNumbers(JSON.parse(answer.headers.get("X-Numbers")));
      $("live").src = URL.createObjectURL(await answer.blob());
      if (old) URL.revokeObjectURL(old);
    } catch { complain(words.away); await pause(2000); }
    await pause(50);
  }
  looking = false;
}
document.addEventListener("visibilitychange", look);
addEventListener("load", look);

if ($("axes")) {
  const step = (axis, sign) => ({ axis, sign }), jog = what => post("/api/v1/jog", what);
  const keys = {
    ArrowRight: step("stage", 1), ArrowLeft: step("stage", -1), ArrowUp: step("tilt", 1), ArrowDown: step("tilt", -1),
    PageUp: step("z", 1), PageDown: step("z", -1), d: step("x", 1), a: step("x", -1), w: step("y", 1), s: step("y", -1),
    "+": { size: "coarser" }, "-": { size: "finer" },
  };
  addEventListener("keydown", event => {
    if (!(event.key === " " || event.key in keys) || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    if (event.key !== " ") jog(keys[event.key]); else if (!event.repeat) stop();
  }, true);
  addEventListener("blur", stop);  // who looks elsewhere moves nothing
  root.addEventListener("click", event => {
    const { axis, sign, size } = event.target.dataset;
    if (axis) jog(step(axis, Number(sign))); else if (size) jog({ size });
  });
}
