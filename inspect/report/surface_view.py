"""All drawings of a height map, begun while the part is still being photographed.

They are a still picture in 3-D and a scene to turn, drawn in the background in a process of their own. What was drawn
is cached by the heights and by what draws them.

The scene is one document that stands in a sandboxed frame and asks nobody for anything. The viewer is the offline
page of trame-vtk. Its scripts, and the few lines here, are the only ones that the policy of the page names, by their
hashes; the map itself is a block of text that is never run. The viewer, a megabyte in every report, is packed by gzip
and unpacked by the browser.
"""

import base64
import gzip
import hashlib
import importlib.util
import io
import json
import os
import re
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cache import Cache, Entry
from anisoscope.base.language import language
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes, bounded_text
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.report import figures

TIMEOUT_S = 60.0
MAX_POINTS = 256
FIELD_UM = 600.0
DRAWS = DRAWN_BY = "anisoscope.report.relief_scene"
FLAT_BY = "anisoscope.report.figures"
DRAWN_WITH = ("anisoscope", "vtk", "trame-vtk")
NEEDS = "it needs EGL (Debian: apt-get install libegl1 libgl1-mesa-dri)"


@dataclass(frozen=True)
class Picture3D:
    """A PNG, or None; a note on its content or on its absence; and, on request, the zipped interactive scene."""

    png: bytes | None
    note: str
    scene: bytes | None = None


@dataclass(frozen=True)
class SceneScale:
    """Scale of the 3-D view: points drawn of a map, and magnification of its heights.

    Attributes:
        field_um: sides of the part that is drawn, from the first point on.
        most_points: along either side; larger maps are drawn with every n-th point.
        exaggeration: factor on the heights; None for one that makes the relief 8 % of the width.
        most_exaggeration: limit of that one.
    """

    field_um: float = FIELD_UM
    most_points: int = MAX_POINTS
    exaggeration: float | None = None
    most_exaggeration: float = 5.0


class Renderer:
    """Draws one height map in the background; ask for the ``result`` when it is needed.

    Args:
        height_um: (rows, cols), row index rising with +y; NaN where not measured.
        pixel_um: (y, x).
        interactive: also make the scene to turn.
        scene: how much of the map is drawn, and how large its heights.
        colours: (rows, cols, 3) of the points, red, green and blue; colours of the heights where not given.
    """

    def __init__(
        self,
        height_um: FloatArray,
        pixel_um: tuple[float, float],
        *,
        interactive: bool = False,
        scene: "SceneScale | None" = None,
        colours: npt.NDArray[np.uint8] | None = None,
    ) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="anisoscope-")
        self._process: subprocess.Popen[bytes] | None = None
        source, self._note = _reduced(height_um, pixel_um, scene or SceneScale(), colours)
        self._formats = ("png", "zip") if interactive else ("png",)
        self._entries = _entries(source, self._formats)
        self._cached = {kind: entry.read() for kind, entry in self._entries.items()}
        self._missing = importlib.util.find_spec("vtkmodules") is None
        if self._missing or None not in self._cached.values():
            return
        folder = Path(self._folder.name)
        (folder / "map.npz").write_bytes(source)
        environment = {**os.environ, "VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"}
        targets = [str(folder / f"map.{kind}") for kind in self._formats]
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", DRAWS, str(folder / "map.npz"), *targets],
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        except BaseException:
            self.discard()
            raise

    def result(self) -> Picture3D:
        """Wait for the picture, a minute at most."""
        try:
            if self._process is None:
                return self._result(self._cached, 0)
            code = self._process.wait(TIMEOUT_S)
            folder = Path(self._folder.name)
            found = {kind: _content(folder / f"map.{kind}") for kind in self._formats}
            for kind, content in found.items():
                if code == 0 and content is not None:
                    self._entries[kind].write(content)
            return self._result(found, code)
        except subprocess.TimeoutExpired:
            return Picture3D(None, f"the renderer did not finish in {TIMEOUT_S:g} s")
        finally:
            self.discard()

    def _result(self, found: dict[str, bytes | None], code: int) -> Picture3D:
        if found["png"] is None and self._missing:
            return Picture3D(None, "VTK is not installed (pip install 'anisoscope[view]')")
        if found["png"] is None:
            return Picture3D(None, f"the renderer ended with code {code}; {NEEDS}")
        scene = found.get("zip")
        still = " (a still picture: trame-vtk did not pack it)" if "zip" in found and scene is None else ""
        return Picture3D(found["png"], self._note + still, scene)

    def discard(self) -> None:
        """End the process if it still runs and forget its files."""
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()


def _reduced(
    height_um: FloatArray,
    pixel_um: tuple[float, float],
    scene: SceneScale,
    colours: npt.NDArray[np.uint8] | None = None,
) -> tuple[bytes, str]:
    """Reduced map as packed bytes, and the note on the reduction."""
    rows, cols = (
        max(2, min(n, round(scene.field_um / p))) for n, p in zip(height_um.shape, pixel_um, strict=True)
    )
    step = [max(1, -(-n // scene.most_points)) for n in (rows, cols)]
    chosen = np.s_[: rows : step[0], : cols : step[1]]
    part = height_um[chosen]
    width = max((n - 1) * p for n, p in zip((rows, cols), pixel_um, strict=True))
    rise = max(float(np.nanmax(part) - np.nanmin(part)), 1e-6)
    exaggeration = scene.exaggeration or float(np.clip(0.08 * width / rise, 1.0, scene.most_exaggeration))
    note = (
        f"{(cols - 1) * pixel_um[1]:.0f} × {(rows - 1) * pixel_um[0]:.0f} µm of the map in 3-D, "
        f"heights drawn {exaggeration:.3g} times as large"
    )
    stream = io.BytesIO()
    drawn = {} if colours is None else {"rgb": colours[chosen]}
    np.savez(
        stream,
        allow_pickle=False,
        z=part,
        pixel=np.multiply(pixel_um, step),
        exaggeration=exaggeration,
        **drawn,
    )
    return stream.getvalue(), note


def _entries(source: bytes, kinds: tuple[str, ...]) -> dict[str, Entry]:
    """Cache entries of the pictures of a map, by kind of file."""
    drawn = hashlib.sha256(source).hexdigest()
    return {
        kind: Cache().entry("height-map-pictures", [drawn, kind], DRAWN_BY, libraries=DRAWN_WITH)
        for kind in kinds
    }


def _content(path: Path) -> bytes | None:
    try:
        return bounded_bytes(path, MOST_PICTURE_BYTES)
    except OSError:
        return None


PROFILE_UM = 600.0


@dataclass(frozen=True)
class SurfacePictures(Picture3D):
    """The 3-D picture, and as data URIs the map seen from above and a profile across the ridges."""

    above: str = ""
    profile: str = ""


def flat_drawings(surface: HeightMap) -> tuple[str, str]:
    """The map seen from above, and its middle row, as data URIs; cached for the map and the language."""
    pixel = surface.pixel_y_um, surface.pixel_x_um

    def draw() -> tuple[str, str]:
        line = surface.height_um[surface.shape[0] // 2]
        count = min(line.size, round(PROFILE_UM / surface.pixel_x_um))
        return (
            figures.height_picture(surface.height_um, pixel),
            figures.profile_chart(np.arange(count) * surface.pixel_x_um, line[:count]),
        )

    heights = hashlib.sha256(np.ascontiguousarray(surface.height_um).data).hexdigest()
    key = [heights, surface.shape, *pixel, language()]
    entry = Cache().entry("height-map-drawings", key, FLAT_BY, libraries=("numpy", "matplotlib"))
    above, profile = entry.result(draw, lambda found: json.dumps(found).encode(), json.loads)
    return above, profile


class SurfaceView:
    """Drawing of a height map in the background: in 3-D in a process, flat in a thread.

    Args:
        surface: the height map, levelled.
        meanwhile: what else can be made ready before the verdict; runs in the thread.
    """

    def __init__(self, surface: HeightMap, meanwhile: Callable[[], object]) -> None:
        self._surface = surface
        self._flat: tuple[str, str] | None = None
        self._meanwhile = meanwhile
        self._relief = Renderer(surface.height_um, (surface.pixel_y_um, surface.pixel_x_um), interactive=True)
        # no daemon: Python's end would cut it off within native code, and that aborts the program
        self._thread = threading.Thread(target=self._draw, name="height map drawings")
        self._thread.start()

    def _draw(self) -> None:
        self._flat = flat_drawings(self._surface)
        self._meanwhile()

    def result(self) -> Picture3D:
        """Wait for all drawings."""
        view = self._relief.result()
        self._thread.join()
        above, profile = self._flat or ("", "")
        return SurfacePictures(view.png, view.note, view.scene, above, profile)

    def discard(self) -> None:
        """End the process if it still runs and forget its files; the thread ends by itself, before the program."""
        self._relief.discard()


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
const packed = document.getElementById("viewer-script");
const bytes = Uint8Array.from(atob(packed.textContent), sign => sign.charCodeAt(0));
const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
new Response(stream).text().then(source => {
  const script = document.createElement("script");
  script.type = packed.dataset.type;
  script.textContent = source;
  append(script);
});
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
_LONG_SCRIPT = 10_000


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
        state: the zipped scene, as `anisoscope.report.surface_view` makes it.
    """
    page = _page()
    if page is None:
        return None
    head, body, sources = page
    data = f'<script type="text/plain" id="state">{base64.b64encode(state).decode("ascii")}</script>\n'
    return Viewer(head + data + body, sources)


@cache
def _page() -> tuple[str, str, tuple[str, ...]] | None:
    """Viewer page before and after the place of the data, and the hashes of its scripts: the same in every report."""
    found = importlib.util.find_spec("trame_vtk")
    if found is None or found.origin is None:
        return None
    path = Path(found.origin).parent / "tools" / "static_viewer.html"
    try:
        text = bounded_text(path)
    except OSError:
        return None
    text = text.replace("</head>", _STYLE + "</head>", 1)
    before, opened, after = text.partition("<body>")
    place = f'\n<div class="content" tabindex="0" role="img" aria-label="{LABEL}"></div>\n'
    head, loader = before + opened + place, f"<script>{_LOADER}</script>"
    return head, _SCRIPT.sub(_packed, after) + loader, _sources(head + after + loader)


def _packed(script: re.Match[str]) -> str:
    """A long script as text that the loader unpacks; a short one as it is."""
    attributes, content = script.groups()
    if len(content) < _LONG_SCRIPT:
        return script[0]
    kind = re.search(r'type="([\w/]+)"', attributes)
    zipped = base64.b64encode(gzip.compress(content.encode(), 9, mtime=0)).decode("ascii")
    data = f'data-type="{kind[1] if kind else ""}"'
    return f'<script type="text/plain" id="viewer-script" {data}>{zipped}</script>'


def _sources(page: str) -> tuple[str, ...]:
    scripts = [content for _, content in _SCRIPT.findall(page)]
    digests = [hashlib.sha256(content.encode()).digest() for content in scripts]
    return tuple(f"'sha256-{base64.b64encode(digest).decode('ascii')}'" for digest in digests)
