"use strict";
// Guided work: a form, then a step at a time. What a step asks and has found comes with the state.
function showGuide(state) {
  if (!$("guided")) return;
  const guide = state.guide, running = state.state === "running" || state.state === "stopping";
  root[guide ? "before" : "after"]($("guided"));  // work at hand is in sight
  $("guides").hidden = Boolean(guide); $("guide").hidden = !guide;
  if (!guide) return;
  $("guide-title").textContent = `${guide.title} – ${Math.min(guide.at + 1, guide.of)}/${guide.of}`;
  $("guide-ask").textContent = guide.ask;
  $("guide-step").hidden = guide.at >= guide.of;
  const others = state.holder && state.holder.id !== me;
  $("guide-step").disabled = $("guide-end").disabled = running || Boolean(others);
  $("guide-results").replaceChildren(...guide.results.map(one => {
    const box = document.createElement("div"), table = document.createElement("table");
    box.className = one.good ? "good" : "bad";
    box.append(Object.assign(document.createElement("h4"), { textContent: `${one.step}: ${one.good ? words.PASS : words.FAIL}` }));
    for (const row of one.rows) {
      const line = table.insertRow();
      for (const cell of row) line.insertCell().textContent = cell;
    }
    box.append(table, ...one.notes.map(text => Object.assign(document.createElement("p"), { textContent: text })));
    return box;
  }).reverse());
}

for (const form of document.querySelectorAll("form[data-guide]")) form.addEventListener("submit", async event => {
  event.preventDefault();
  const { why, ...values } = Object.fromEntries(new FormData(form));
  await post("/api/v1/guides/begin", { key: form.dataset.guide, recipe: new FormData($("start")).get("recipe") || "", values, why });
});
ask("guide-step", "/api/v1/guides/step");
ask("guide-end", "/api/v1/guides/end");
follow();  // after all of it is there
