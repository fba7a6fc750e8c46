"use strict";
// What the page shows is brought up to date while it is seen; the server draws it once for all who look.
let { mark, away } = document.getElementById("fleet").dataset;

setInterval(async () => {
  const old = document.getElementById("shown");
  if (document.hidden || old.contains(document.activeElement)) return;
  const answer = await fetch(`/fleet/view${location.search}`, { headers: { "If-None-Match": mark } }).catch(() => null);
  complain(answer ? "" : away);
  if (!answer || answer.status !== 200) return;
  mark = answer.headers.get("ETag");
  old.replaceWith(new DOMParser().parseFromString(await answer.text(), "text/html").getElementById("shown"));
}, 5000);
