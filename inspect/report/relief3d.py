"""A height map in 3-D, as a still picture and as a scene to turn, drawn in the background in a process of its own.

What was drawn is kept in the cache folder, under a hash of the heights and of what draws them.
"""

import contextlib
import hashlib
import io
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import numpy.typing as npt

TIMEOUT_S = 60.0
MAX_POINTS = 256
FIELD_UM = 600.0
DRAWS = "anisoscope.report.reliefscene"
NEEDS = "it needs EGL (Debian: apt-get install libegl1 libgl1-mesa-dri)"

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Picture3D:
    """A PNG, or None; a note on what it shows, or on why there is none; and the zipped scene to turn, if asked for."""

    png: bytes | None
    note: str
    scene: bytes | None = None


class Renderer:
    """Draws one height map in the background; ask for the ``result`` when it is needed.

    Args:
        height_um: (rows, cols), row index rising with +y; NaN where not measured.
        pixel_um: (y, x).
        interactive: also make the scene to turn.
    """

    def __init__(
        self, height_um: FloatArray, pixel_um: tuple[float, float], *, interactive: bool = False
    ) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="anisoscope-")
        self._process: subprocess.Popen[bytes] | None = None
        source, self._note = _reduced(height_um, pixel_um)
        self._wanted = ("png", "zip") if interactive else ("png",)
        self._kept = _kept_at(source)
        if all(path.is_file() for path in self._kept_files().values()):
            return
        folder = Path(self._folder.name)
        (folder / "map.npz").write_bytes(source)
        environment = {
            **os.environ,
            "VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow",
            "PYVISTA_OFF_SCREEN": "true",
        }
        targets = [str(folder / f"map.{kind}") for kind in self._wanted]
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

    def _kept_files(self) -> dict[str, Path]:
        return {kind: self._kept.with_suffix(f".{kind}") for kind in self._wanted}

    def result(self) -> Picture3D:
        """Wait for the picture, a minute at most."""
        try:
            if self._process is None:
                found = {kind: _content(path) for kind, path in self._kept_files().items()}
                return self._told(found, 0)
            code = self._process.wait(TIMEOUT_S)
            folder = Path(self._folder.name)
            found = {kind: _content(folder / f"map.{kind}") for kind in self._wanted}
            if code == 0:
                self._keep(found)
            return self._told(found, code)
        except subprocess.TimeoutExpired:
            return Picture3D(None, f"the renderer did not finish in {TIMEOUT_S:g} s")
        finally:
            self.discard()

    def _told(self, found: dict[str, bytes | None], code: int) -> Picture3D:
        if found["png"] is None:
            return Picture3D(None, f"the renderer ended with code {code}; {NEEDS}")
        scene = found.get("zip")
        still = " (a still picture: trame-vtk did not pack it)" if "zip" in found and scene is None else ""
        return Picture3D(found["png"], self._note + still, scene)

    def _keep(self, found: dict[str, bytes | None]) -> None:
        from anisoscope.atomicfile import write_bytes
        from anisoscope.errors import RecordError

        with contextlib.suppress(OSError, RecordError):  # no place to keep them: they are drawn again
            self._kept.parent.mkdir(parents=True, exist_ok=True)
            for kind, path in self._kept_files().items():
                content = found[kind]
                if content is not None:
                    write_bytes(path, content)

    def discard(self) -> None:
        """End the process if it still runs and forget its files."""
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()


def _reduced(height_um: FloatArray, pixel_um: tuple[float, float]) -> tuple[bytes, str]:
    """What is drawn of a map, packed, and what to say of it."""
    rows, cols = (max(2, min(n, round(FIELD_UM / p))) for n, p in zip(height_um.shape, pixel_um, strict=True))
    part = height_um[:rows, :cols]
    step = [max(1, -(-n // MAX_POINTS)) for n in part.shape]
    part = part[:: step[0], :: step[1]]
    width = max((n - 1) * p for n, p in zip((rows, cols), pixel_um, strict=True))
    rise = max(float(np.nanmax(part) - np.nanmin(part)), 1e-6)
    exaggeration = float(np.clip(0.08 * width / rise, 1.0, 5.0))
    note = (
        f"{(cols - 1) * pixel_um[1]:.0f} × {(rows - 1) * pixel_um[0]:.0f} µm of the map in 3-D, "
        f"heights drawn {exaggeration:.1f} times as large"
    )
    stream = io.BytesIO()
    np.savez(stream, z=part, pixel=np.multiply(pixel_um, step), exaggeration=exaggeration)
    return stream.getvalue(), note


def _kept_at(source: bytes) -> Path:
    """Where the pictures of a map are kept, without a suffix; what draws them belongs to the name."""
    from anisoscope.diagnosis.remembering import cache_folder

    digest = hashlib.sha256(source + Path(__file__).with_name("reliefscene.py").read_bytes())
    for name in ("vtk", "pyvista", "trame-vtk"):
        with contextlib.suppress(PackageNotFoundError):
            digest.update(version(name).encode())
    return cache_folder() / "relief3d" / digest.hexdigest()[:32]


def _content(path: Path) -> bytes | None:
    try:
        return path.read_bytes()
    except OSError:
        return None
