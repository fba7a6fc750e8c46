"""The interactive 3-D view of a height map: one document that stands in a sandboxed frame and asks nobody for anything.

The viewer is the offline page of trame-vtk. Its scripts, and the few lines here, are the only ones that the policy of
the page names, by their hashes; the map itself is a block of text that is never run.
"""

import base64
import hashlib
import importlib.util
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

LABEL = (
    "Height map in three dimensions: drag or use the arrow keys to turn it, + and - to come closer or go back"
)

_STYLE = """<style>
.content { position: absolute; inset: 0; overflow: hidden; cursor: grab; }
.content:active { cursor: grabbing; }
.content:focus-visible { outline: 3px solid #1f6fb2; outline-offset: -3px; z-index: 1; }
</style>
"""
# The viewer's page would ask its makers for an icon, and tells the console what it reads: neither is let happen.
# Without WebGL nothing is drawn, and the still picture under the frame shows through. The wheel scrolls the page until
# somebody takes hold of the map.
_LOADER = """
"use strict";
console.log = () => {};
const append = document.head.appendChild.bind(document.head);
document.head.appendChild = node => node.rel === "icon" ? node : append(node);
const drawable = Boolean(document.createElement("canvas").getContext("webgl2"));
if (!drawable) document.documentElement.style.display = "none";
function loadDataSet() {
  if (!drawable) return;
  const base64Str = document.getElementById("state").textContent;
  OfflineLocalView.load(document.querySelector(".content"), { base64Str });
}
let held = false;
addEventListener("pointerdown", () => { held = true; }, true);
document.documentElement.addEventListener("mouseleave", () => { held = false; });
addEventListener("wheel", event => { if (!held) event.stopImmediatePropagation(); }, { capture: true, passive: true });
const TURNS = { ArrowLeft: [8, 0, 1], ArrowRight: [-8, 0, 1], ArrowUp: [0, -4, 1], ArrowDown: [0, 4, 1],
                "+": [0, 0, 1.15], "-": [0, 0, 1 / 1.15] };
addEventListener("keydown", event => {
  const turn = TURNS[event.key], renderer = window.renderWindow?.getRenderers()[0];
  if (!turn || !renderer) return;
  const camera = renderer.getActiveCamera();
  camera.azimuth(turn[0]);
  camera.elevation(turn[1]);
  camera.orthogonalizeViewUp();
  camera.dolly(turn[2]);
  renderer.resetCameraClippingRange();
  window.renderWindow.render();
  event.preventDefault();
});
"""
_SCRIPT = re.compile(r"<script([^>]*)>(.*?)</script>", re.DOTALL)


@dataclass(frozen=True)
class Viewer:
    """A document for the ``srcdoc`` of a frame, and the scripts that it runs, as sources of a policy."""

    document: str
    script_sources: tuple[str, ...]

    @property
    def srcdoc(self) -> str:
        """The document, escaped for an attribute in double quotes."""
        return self.document.replace("&", "&amp;").replace('"', "&quot;")


def viewer_of(state: bytes) -> Viewer | None:
    """The 3-D view of a scene, or None where trame-vtk is not installed.

    Args:
        state: the zipped scene, as `anisoscope.report.relief3d` makes it.
    """
    page = _page()
    if page is None:
        return None
    head, body = page
    data = f'<script type="text/plain" id="state">{base64.b64encode(state).decode("ascii")}</script>\n'
    return Viewer(head + data + body, _sources(head + body))


@cache
def _page() -> tuple[str, str] | None:
    """The viewer before and after the place of the data, which stays the same from report to report."""
    found = importlib.util.find_spec("trame_vtk")
    if found is None or found.origin is None:
        return None
    path = Path(found.origin).parent / "tools" / "static_viewer.html"
    try:
        text = path.read_text(encoding="utf-8")
    except OSError:
        return None
    text = text.replace("</head>", _STYLE + "</head>", 1)
    before, opened, after = text.partition("<body>")
    place = f'\n<div class="content" tabindex="0" role="img" aria-label="{LABEL}"></div>\n'
    return before + opened + place, f"<script>{_LOADER}</script>" + after


@cache
def _sources(page: str) -> tuple[str, ...]:
    scripts = [content for _, content in _SCRIPT.findall(page)]
    digests = [hashlib.sha256(content.encode()).digest() for content in scripts]
    return tuple(f"'sha256-{base64.b64encode(digest).decode('ascii')}'" for digest in digests)
