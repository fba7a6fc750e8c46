"use strict";
// The station page: it shows what the events say, and asks for changes. Nothing is kept here that the server does not know.
const me = root.dataset.me;
let now = {}, events = null, last = "", shown = 0, sounded = "", dismissed = sessionStorage.getItem("dismissed");

// The space bar stops wherever nothing is typed or pressed by it.
document.addEventListener("keydown", event => {
  if (event.code !== "Space" || event.repeat) return;
  const typed = event.target.matches("input[name=serial], input[name=lot]");
  const running = now.state === "running" || now.state === "stopping";
  if (running || !(typed || event.target.matches("button, input, a, summary"))) { event.preventDefault(); stop(); }
}, true);

function beep(verdict) {
  if (!navigator.userActivation.hasBeenActive) return;  // a page that only looks on
  try {
    const sound = new AudioContext(), tones = { PASS: [660, 880], FAIL: [220, 180, 220], INCONCLUSIVE: [440, 440], INVALID: [330, 220] };
    (tones[verdict] || [440]).forEach((pitch, k) => {
      const tone = sound.createOscillator(), loud = sound.createGain();
      tone.frequency.value = pitch; loud.gain.value = .2;
      tone.connect(loud).connect(sound.destination);
      tone.start(sound.currentTime + .25 * k); tone.stop(sound.currentTime + .25 * k + .2);
    });
  } catch { /* a browser without sound shows word and colour */ }
}

function list(target, texts) {
  target.replaceChildren(...texts.map(text => Object.assign(document.createElement("li"), { textContent: text })));
}

function showFrames(count) {
  if (count < shown) { shown = 0; $("frames").replaceChildren(); }
  while (shown < count) {
    const image = Object.assign(new Image(), { alt: `${words.frame} ${++shown}`, width: 160 });
    const path = `/api/v1/frames/${shown}.jpg?of=${encodeURIComponent(now.folder)}`;
    let tries = 0;  // its line in the journal may come a moment after its event
    image.onerror = () => { if (++tries < 20) setTimeout(() => { image.src = `${path}&try=${tries}`; }, 250); };
    image.src = path;
    const item = document.createElement("li"); item.append(image); $("frames").prepend(item);
  }
}

function showVerdict(found) {
  const dialog = $("verdict");
  if (!found || found.folder === dismissed) { if (dialog.open) dialog.close(); return; }
  dialog.className = found.verdict.toLowerCase();
  $("word").textContent = found.word;
  $("part").textContent = `${found.serial} · ${found.product}`;
  $("finding").textContent = found.finding;
  $("action").textContent = found.action ? `${words.next}: ${found.action}` : "";
  list($("reasons"), found.verdict === "PASS" ? [] : [...found.reasons, ...found.lines]);
  $("report").href = `/inspections/${encodeURIComponent(found.folder)}/report.html`;
  if (!dialog.open) { dialog.show(); $("next").focus(); }
  if (sounded !== found.folder) { sounded = found.folder; beep(found.verdict); }
}

function show(state) {
  const before = now.folder;
  now = state;
  if (state.folder !== before) { shown = 0; $("frames").replaceChildren(); }
  const running = state.state === "running" || state.state === "stopping";
  $("work").hidden = !running && !state.frames;
  document.querySelector(".live").hidden = running;
  $("advice").hidden = running;
  document.querySelector(".numbers").hidden = running;
  progress(state);
  showVerdict(state.state === "done" ? state.verdict : null);
  $("failure").hidden = !state.failure;
  $("failure").textContent = state.failure ? (state.failure.stopped ? `${words.stopped}: ` : "") + state.failure.text : "";
  if (state.checked) $("checks").replaceChildren(...state.checked.checks.map(one => {
    const item = document.createElement("li"), lamp = document.createElement("span");
    item.className = { PASS: "green", WARN: "yellow", FAIL: "red" }[one.outcome] || "grey";
    lamp.className = "lamp"; lamp.setAttribute("aria-hidden", "true");
    item.append(lamp, `${one.words}: ${words[one.outcome]}${one.remark ? "; " + one.remark : ""}`);
    return item;
  }));
  const mine = state.holder && state.holder.id === me, others = state.holder && !mine;
  if ($("holder")) {
    const asks = state.asking ? ` ${words.asks.replace("{name}", state.asking.id === me ? words.you : state.asking.name)}` : "";
    $("holder").textContent = (mine ? words.mine : others ? words.held.replace("{name}", state.holder.name) : words.free) + asks;
    $("take").hidden = !others; $("release").hidden = !mine;
    for (const button of [$("go"), $("check"), ...document.querySelectorAll("[data-resume]")]) button.disabled = running || Boolean(others);
  }
  showGuide(state);
  if (!running) look();
}

function progress(at) {
  const doing = at.doing || "";  // a computation ends at its next step
  $("doing").textContent = doing && now.state === "stopping" ? words.ending.replace("{doing}", doing) : doing;
  $("progress").max = Math.max(at.total, 1); $("progress").value = at.done;
  showFrames(at.frames);
}

// One page of a browser follows the events while it is seen and passes them to the others: see `alone`.
const others = new BroadcastChannel("anisoscope events");
let leave = null;
function take(event) {
  ({ id: last } = event);
  complain("");
  ({ state: show, progress })[event.kind](event.content);
}
others.onmessage = ({ data }) => {
  if (data.kind) take(data);
  else if (events && now.state) others.postMessage({ kind: "state", id: last, content: now });
};
function follow() {
  if (leave || document.hidden) return;
  const waiting = new AbortController();
  const led = () => new Promise(over => { leave = () => { events?.close(); events = null; over(); }; open(); });
  leave = () => waiting.abort();
  others.postMessage({});  // whoever follows the events tells the present state
  if (navigator.locks) navigator.locks.request("anisoscope events", { signal: waiting.signal }, led).catch(() => {});
  else led();
}
function open() {
  events = new EventSource(`/api/v1/events?after=${encodeURIComponent(last)}`);
  for (const kind of ["state", "progress"]) events.addEventListener(kind, ({ lastEventId, data }) => {
    const event = { kind, id: lastEventId, content: JSON.parse(data) };
    take(event);
    others.postMessage(event);
  });
  events.onerror = () => { complain(words.away); if (events?.readyState === 2) setTimeout(() => { if (events) open(); }, 1000); };
}
document.addEventListener("visibilitychange", () => {
  if (document.hidden && leave) { leave(); leave = null; }
  follow();
});

// The live picture: with the exposure of the recipe, while the rig is at rest.
wanted = () => {
  const recipe = new FormData($("start")).get("recipe");
  return now.state && now.state !== "running" && now.state !== "stopping" && recipe ? `/api/v1/live.jpg?recipe=${encodeURIComponent(recipe)}` : null;
};

$("start").addEventListener("submit", async event => {
  event.preventDefault();
  const fields = $("start").elements, asked = Object.fromEntries(new FormData($("start")));
  for (const name of ["x_mm", "y_mm"]) asked[name] = asked[name] ? asked[name].trim().replace(",", ".") : null;
  if (!await post("/api/v1/start", asked)) return;
  for (const name of ["serial", "x_mm", "y_mm"]) if (fields[name]) fields[name].value = "";  // these are of one part
});
// A rig that was never commissioned asks once before it moves.
const ask = (id, path, content) => { if ($(id)) $(id).addEventListener("click", event => {
  const data = event.currentTarget.dataset;
  if (data.question && !confirm(data.question)) return;
  delete data.question;
  post(path, content ? content() : {});
}); };
ask("take", "/api/v1/take");
ask("release", "/api/v1/release");
ask("check", "/api/v1/check", () => ({ name: new FormData($("start")).get("recipe") || "" }));
for (const button of document.querySelectorAll("[data-resume]"))
  button.addEventListener("click", async () => { if (await post("/api/v1/resume", { name: button.dataset.resume })) $("resumable").hidden = true; });
$("next").addEventListener("click", () => {
  sessionStorage.setItem("dismissed", dismissed = now.folder);
  $("verdict").close(); $("start").elements.serial.focus();
});
