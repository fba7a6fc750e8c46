"""A height map in 3-D, drawn by pyvista in a process of its own.

Where no usable OpenGL is found VTK ends its process with a signal, so this never runs in the main process: run
as ``python -m anisoscope.report.relief3d MAP.npz PICTURE.png``.
"""

import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

TIMEOUT_S = 60.0
MAX_POINTS = 256
FIELD_UM = 600.0


@dataclass(frozen=True)
class Picture3D:
    """A PNG, or None; and a note on what it shows, or on why there is none."""

    png: bytes | None
    note: str


class Renderer:
    """Draws one height map in the background; ask for the ``result`` when it is needed."""

    def __init__(self, height_um: npt.NDArray[np.float64], pixel_um: tuple[float, float]) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="anisoscope-")
        source = Path(self._folder.name) / "map.npz"
        self._target = Path(self._folder.name) / "map.png"
        rows, cols = (
            max(2, min(n, round(FIELD_UM / p))) for n, p in zip(height_um.shape, pixel_um, strict=True)
        )
        part = height_um[:rows, :cols]
        step = [max(1, -(-n // MAX_POINTS)) for n in part.shape]
        part = part[:: step[0], :: step[1]]
        width = max((n - 1) * p for n, p in zip((rows, cols), pixel_um, strict=True))
        rise = max(float(np.nanmax(part) - np.nanmin(part)), 1e-6)
        exaggeration = float(np.clip(0.08 * width / rise, 1.0, 5.0))
        self._note = (
            f"{(cols - 1) * pixel_um[1]:.0f} × {(rows - 1) * pixel_um[0]:.0f} µm of the map in 3-D, "
            f"heights drawn {exaggeration:.1f} times as large"
        )
        np.savez(source, z=part, pixel=np.multiply(pixel_um, step), exaggeration=exaggeration)
        environment = {
            **os.environ,
            "VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow",
            "PYVISTA_OFF_SCREEN": "true",
        }
        self._process = subprocess.Popen(
            [sys.executable, "-m", "anisoscope.report.relief3d", str(source), str(self._target)],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def result(self) -> Picture3D:
        """Wait for the picture, a minute at most."""
        try:
            code = self._process.wait(TIMEOUT_S)
            png = self._target.read_bytes() if code == 0 and self._target.is_file() else None
        except subprocess.TimeoutExpired:
            return Picture3D(None, f"the renderer did not finish in {TIMEOUT_S:g} s")
        finally:
            self.discard()
        if png is None:
            return Picture3D(
                None,
                f"the renderer ended with code {code}; it needs EGL (Debian: apt-get install libegl1 libgl1-mesa-dri)",
            )
        return Picture3D(png, self._note)

    def discard(self) -> None:
        """End the process if it still runs and forget its files."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        self._folder.cleanup()


def draw(source: Path, target: Path) -> None:
    """Draw the map of ``source`` (npz with z in µm, pixel and exaggeration) into the PNG ``target``."""
    import pyvista

    with np.load(source) as data:
        z, (pixel_y, pixel_x), exaggeration = data["z"], data["pixel"], float(data["exaggeration"])
    middle = float(np.nanmedian(z))
    x, y = np.meshgrid(np.arange(z.shape[1]) * pixel_x, np.arange(z.shape[0]) * pixel_y)
    grid = pyvista.StructuredGrid(x, y, np.nan_to_num(z - middle) * exaggeration)
    grid["height [µm]"] = (z - middle).ravel(order="F")
    plotter = pyvista.Plotter(off_screen=True, window_size=[1100, 720])
    plotter.background_color = pyvista.Color("white")
    plotter.add_mesh(
        grid,
        scalars="height [µm]",
        cmap="viridis",
        specular=0.2,
        nan_color="grey",
        scalar_bar_args={
            "color": "black",
            "n_labels": 3,
            "title_font_size": 26,
            "label_font_size": 22,
            "fmt": "%.1f",
            "width": 0.6,
            "height": 0.09,
            "position_x": 0.2,
            "position_y": 0.02,
        },
    )
    centre = np.array([0.5 * np.ptp(x), 0.5 * np.ptp(y), 0.0])
    reach = float(max(np.ptp(x), np.ptp(y)))
    eye = centre + reach * np.array([0.5, -1.6, 1.35])
    plotter.camera_position = [tuple(eye), tuple(centre - [0.0, 0.08 * reach, 0.0]), (0.0, 0.0, 1.0)]
    plotter.screenshot(str(target))
    plotter.deep_clean()


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
