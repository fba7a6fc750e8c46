"use strict";
// What all pages share: changes are asked for as JSON with the token of the page, and a refusal is shown.
const token = document.querySelector("meta[name=token]").content;
const problem = document.getElementById("problem");

function complain(text) {
  problem.textContent = text;
  problem.hidden = !text;
}

async function post(path, content = {}) {
  let answer;
  try {
    answer = await fetch(path, {
      method: "POST", body: JSON.stringify(content), keepalive: true,
      headers: { "Content-Type": "application/json", "X-CSRF-Token": token },
    });
  } catch {
    complain(document.body.dataset.away || "no answer");
    return null;
  }
  const found = await answer.json().catch(() => ({}));
  complain(answer.ok ? "" : found.error || String(answer.status));
  return answer.ok ? found : null;
}

document.addEventListener("click", async event => {
  const button = event.target.closest("button[data-post]");
  if (button && await post(button.dataset.post) && button.dataset.then) location.href = button.dataset.then;
});

document.addEventListener("submit", async event => {
  const form = event.target;
  if (!form.dataset.post) return;
  event.preventDefault();
  const content = Object.fromEntries(new FormData(form));
  if (await post(form.dataset.post, content) && form.dataset.then) location.href = form.dataset.then;
});

document.getElementById("language")?.addEventListener("change", event => {
  document.cookie = `language=${event.target.value}; Path=/; Max-Age=31536000; SameSite=Lax`;
  location.reload();
});
