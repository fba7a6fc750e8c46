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
    """A PNG, or None and the reason why there is none."""

    png: bytes | None
    note: str


class Renderer:
    """Draws one height map in the background; ask for the ``result`` when it is needed."""

    def __init__(self, height_um: npt.NDArray[np.float64], pixel_um: tuple[float, float]) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="anisoscope-")
        source = Path(self._folder.name) / "map.npz"
        self._target = Path(self._folder.name) / "map.png"
        rows, cols = (max(2, min(n, round(FIELD_UM / p))) for n, p in zip(height_um.shape, pixel_um, strict=True))
        part = height_um[:rows, :cols]
        step = [max(1, -(-n // MAX_POINTS)) for n in part.shape]
        part = part[:: step[0], :: step[1]]
        np.savez(source, z=part, pixel=np.multiply(pixel_um, step))
        environment = {**os.environ, "VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow", "PYVISTA_OFF_SCREEN": "true"}
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
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
            return Picture3D(None, f"the 3-D renderer did not finish in {TIMEOUT_S:g} s")
        finally:
            png = self._target.read_bytes() if self._target.is_file() else None
            self._folder.cleanup()
        if code != 0 or png is None:
            return Picture3D(None, f"the 3-D renderer ended with code {code}: is there a usable EGL (Debian: libegl1)?")
        return Picture3D(png, "")


def draw(source: Path, target: Path) -> None:
    """Draw the map of ``source`` (npz with z in µm and pixel) into the PNG ``target``."""
    import pyvista

    with np.load(source) as data:
        z, (pixel_y, pixel_x) = data["z"], data["pixel"]
    middle = float(np.nanmedian(z))
    x, y = np.meshgrid(np.arange(z.shape[1]) * pixel_x, np.arange(z.shape[0]) * pixel_y)
    exaggeration = min(4.0, max(1.0, 0.12 * float(np.ptp(x)) / max(float(np.nanmax(z) - np.nanmin(z)), 1e-6)))
    grid = pyvista.StructuredGrid(x, y, np.nan_to_num(z - middle) * exaggeration)
    grid["height [µm]"] = (z - middle).ravel(order="F")
    plotter = pyvista.Plotter(off_screen=True, window_size=(1500, 900))
    plotter.set_background("white")
    plotter.add_mesh(
        grid,
        scalars="height [µm]",
        cmap="viridis",
        smooth_shading=True,
        specular=0.2,
        nan_color="lightgrey",
        scalar_bar_args={"color": "black", "n_labels": 5, "title_font_size": 26, "label_font_size": 22, "fmt": "%.1f"},
    )
    plotter.camera_position = "xy"
    plotter.camera.azimuth, plotter.camera.elevation = -25.0, -52.0
    plotter.reset_camera()
    plotter.camera.zoom(1.35)
    plotter.add_text(f"{np.ptp(x):.0f} × {np.ptp(y):.0f} µm, height × {exaggeration:.1f}", font_size=11, color="black")
    plotter.screenshot(str(target))
    plotter.close()


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]))
