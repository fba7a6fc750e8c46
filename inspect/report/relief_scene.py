"""Process of `anisoscope.report.surface_view` that draws a height map with pyvista.

Where no usable OpenGL is found VTK ends its process with a signal, so this never runs in the main process: run
as ``python -m anisoscope.report.relief_scene MAP.npz PICTURE.png [SCENE.zip]``.
"""

import io
import json
import sys
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray

if TYPE_CHECKING:
    import pyvista

STEP_UM = 2.0**-9  # a power of two: the last bits of every number are zeros, which pack well


def draw(source: Path, picture: Path, scene: Path | None = None) -> None:
    """Draw a map; files appear whole or not at all.

    Args:
        source: npz with z in µm, pixel (y, x) in µm, exaggeration, and maybe the colours rgb of the points.
        picture: PNG to write.
        scene: zip to write, for the viewer that turns.
    """
    import pyvista

    with np.load(source) as data:
        z, (pixel_y, pixel_x), exaggeration = data["z"], data["pixel"], float(data["exaggeration"])
        colours = data.get("rgb")
    mesh = _mesh(z, (pixel_y, pixel_x), exaggeration)
    limits = [float(value) for value in np.percentile(mesh["height [µm]"], [0.0, 100.0])]
    plotter: Any = pyvista.Plotter(off_screen=True, window_size=[1100, 720])
    plotter.background_color = pyvista.Color("white")
    if colours is None:
        plotter.add_mesh(
            mesh, scalars="height [µm]", cmap="viridis", clim=limits, specular=0.2, show_scalar_bar=False
        )
    else:
        mesh["colour"] = colours.reshape(-1, 3)
        plotter.add_mesh(mesh, scalars="colour", rgb=True, specular=0.0, show_scalar_bar=False)
    extent = np.multiply(np.array(z.shape) - 1, (pixel_y, pixel_x))
    if colours is None:
        _draw_bar(plotter)
    _look_at(plotter, extent, 1.0, lower=0.08)
    stream = io.BytesIO()
    plotter.screenshot(stream)
    _write(picture, stream.getvalue())
    if scene is not None:
        if colours is None:
            plotter.remove_scalar_bar()
        _look_at(plotter, extent, 0.8, lower=0.0)
        plotter.render()
        _write(scene, _packed(plotter))
    plotter.deep_clean()


def _look_at(plotter: "pyvista.Plotter", extent: FloatArray, distance: float, lower: float) -> None:
    """See the map from the front and above; ``lower`` leaves room for the colour bar, as a share of the extent.

    The camera goes closer instead of zooming: the viewer of the scene knows no angle of view.
    """
    reach = float(extent.max())
    centre = np.array([0.5 * extent[1], 0.5 * extent[0], 0.0])
    eye = centre + distance * reach * np.array([0.5, -1.6, 1.35])
    target = centre - [0.0, lower * reach, 0.0]
    plotter.camera_position = [tuple(eye), tuple(target), (0.0, 0.0, 1.0)]
    plotter.reset_camera_clipping_range()


def _mesh(z: FloatArray, pixel_um: tuple[float, float], exaggeration: float) -> "pyvista.PolyData":
    """Squares between measured points, row by row in strips; numbers in steps, so that the scene packs well."""
    import pyvista

    measured = np.isfinite(z)
    height = np.where(measured, z - np.nanmedian(z), 0.0)
    x, y = np.meshgrid(np.arange(z.shape[1]) * pixel_um[1], np.arange(z.shape[0]) * pixel_um[0])
    points = _in_steps(np.stack([x, y, height * exaggeration], axis=-1).reshape(-1, 3))
    number = np.arange(z.size).reshape(z.shape)
    if measured.all():
        strips = np.stack([number[:-1], number[1:]], axis=2).reshape(z.shape[0] - 1, -1)
        mesh = pyvista.PolyData(points, strips=np.insert(strips, 0, strips.shape[1], axis=1).ravel())
    else:
        corners = (np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, 1:], np.s_[1:, :-1])
        whole = np.logical_and.reduce([measured[corner] for corner in corners])
        squares = np.stack([number[corner][whole] for corner in corners], axis=1)
        mesh = pyvista.PolyData(points, np.insert(squares, 0, 4, axis=1).ravel())
    mesh["height [µm]"] = _in_steps(height.ravel())
    return mesh


def _in_steps(values: FloatArray) -> npt.NDArray[np.float32]:
    return np.asarray(np.round(values / STEP_UM) * STEP_UM, dtype=np.float32)


def _draw_bar(plotter: Any) -> None:  # noqa: ANN401 - wrapped methods of pyvista have no usable types
    """Colour bar of the still picture; the interactive scene has none, since the map next to it has one."""
    plotter.add_scalar_bar(
        "height [µm]",
        color="black",
        n_labels=3,
        title_font_size=26,
        label_font_size=22,
        fmt="%.1f",
        width=0.6,
        height=0.09,
        position_x=0.2,
        position_y=0.02,
    )


def _packed(plotter: "pyvista.Plotter") -> bytes:
    """The scene as the offline viewer of trame-vtk reads it, without any server."""
    from trame_vtk.modules.vtk.protocols.local_rendering import (  # type: ignore[import-untyped]
        vtkWebLocalRendering,
    )
    from vtkmodules.vtkWebCore import vtkWebApplication

    application = vtkWebApplication()
    rendering: Any = vtkWebLocalRendering()
    rendering.coreServer = SimpleNamespace(getSharedObject=lambda _: application)
    view = application.GetObjectIdMap().GetGlobalId(plotter.render_window)
    state = rendering.get_standalone_state(view)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=6) as archive:
        archive.writestr("index.json", json.dumps(state, allow_nan=False))
    return stream.getvalue()


def _write(path: Path, content: bytes) -> None:
    part = path.with_suffix(".part")
    part.write_bytes(content)
    part.replace(path)


if __name__ == "__main__":
    draw(Path(sys.argv[1]), Path(sys.argv[2]), Path(sys.argv[3]) if len(sys.argv) > 3 else None)
