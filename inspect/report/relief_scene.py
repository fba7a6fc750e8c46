"""Process of `anisoscope.report.surface_view` that draws a height map with VTK.

Where no usable OpenGL is found VTK ends its process with a signal, so this never runs in the main process: run
as ``python -m anisoscope.report.relief_scene MAP.npz PICTURE.png [SCENE.zip]``. Of VTK only what is used is imported:
what draws with it more conveniently takes longer to import than the map to draw.
"""

import io
import json
import sys
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray

WINDOW = 1100, 720
SAMPLES = 8  # of a pixel, for smooth edges
LABELS = {"title": 26, "labels": 22}  # points
STEP_UM = 2.0**-9  # a power of two: the last bits of every number are zeros, which pack well


def draw(source: Path, picture: Path, scene: Path | None = None) -> None:
    """Draw a map; files appear whole or not at all.

    Args:
        source: npz with z in µm, pixel (y, x) in µm, exaggeration, and maybe the colours rgb of the points.
        picture: PNG to write.
        scene: zip to write, for the viewer that turns.
    """
    import vtkmodules.vtkRenderingOpenGL2  # noqa: F401 - registers what draws
    from vtkmodules.vtkRenderingCore import (
        vtkActor,
        vtkLightKit,
        vtkPolyDataMapper,
        vtkRenderer,
        vtkRenderWindow,
    )

    with np.load(source) as data:
        z, (pixel_y, pixel_x), exaggeration = data["z"], data["pixel"], float(data["exaggeration"])
        colours = data.get("rgb")
    mapper, actor, renderer, window = vtkPolyDataMapper(), vtkActor(), vtkRenderer(), vtkRenderWindow()
    mesh = _mesh(z, (pixel_y, pixel_x), exaggeration, colours)
    mapper.SetInputDataObject(mesh)
    bar = None
    if colours is None:
        mapper.SetLookupTable(_viridis())
        mapper.SetScalarRange(*mesh.GetPointData().GetScalars().GetRange())
        mapper.UseLookupTableScalarRangeOff()
        mapper.InterpolateScalarsBeforeMappingOn()
        bar = _bar(mapper.GetLookupTable())
        renderer.AddViewProp(bar)
    actor.SetMapper(mapper)
    actor.GetProperty().SetSpecular(0.2 if colours is None else 0.0)
    actor.GetProperty().SetSpecularPower(100.0)
    actor.GetProperty().SetInterpolationToFlat()
    renderer.AddActor(actor)
    renderer.SetBackground(1.0, 1.0, 1.0)
    vtkLightKit().AddLightsToRenderer(renderer)
    window.SetOffScreenRendering(True)
    window.SetMultiSamples(SAMPLES)
    window.SetSize(*WINDOW)
    window.AddRenderer(renderer)
    extent = np.multiply(np.array(z.shape) - 1, (pixel_y, pixel_x))
    _look_at(renderer, extent, 1.0, lower=0.08)
    window.Render()
    _write(picture, _png(window))
    if scene is not None:
        if bar is not None:
            renderer.RemoveViewProp(bar)
        _look_at(renderer, extent, 1.0, lower=0.0)
        window.Render()
        _write(scene, _packed(window))
    window.Finalize()


def _look_at(renderer: Any, extent: FloatArray, distance: float, lower: float) -> None:  # noqa: ANN401
    """See the map from the front and above; ``lower`` leaves room for the colour bar, as a share of the extent.

    The camera goes closer instead of zooming: the viewer of the scene knows no angle of view.
    """
    reach = float(extent.max())
    centre = np.array([0.5 * extent[1], 0.5 * extent[0], 0.0])
    eye = centre + distance * reach * np.array([0.5, -1.6, 1.35])
    target = centre - [0.0, lower * reach, 0.0]
    camera = renderer.GetActiveCamera()
    camera.SetPosition(*eye)
    camera.SetFocalPoint(*target)
    camera.SetViewUp(0.0, 0.0, 1.0)
    renderer.ResetCameraClippingRange()


def _mesh(
    z: FloatArray, pixel_um: tuple[float, float], exaggeration: float, colours: npt.NDArray[np.uint8] | None
) -> Any:  # noqa: ANN401 - VTK's classes have no usable types
    """Squares between measured points, row by row in strips; numbers in steps, so that the scene packs well."""
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkPolyData

    measured = np.isfinite(z)
    height = np.where(measured, z - np.nanmedian(z), 0.0)
    x, y = np.meshgrid(np.arange(z.shape[1]) * pixel_um[1], np.arange(z.shape[0]) * pixel_um[0])
    places = _in_steps(np.stack([x, y, height * exaggeration], axis=-1).reshape(-1, 3))
    number = np.arange(z.size).reshape(z.shape)
    points, mesh = vtkPoints(), vtkPolyData()
    points.SetData(numpy_to_vtk(places, deep=True))
    mesh.SetPoints(points)
    if measured.all():
        mesh.SetStrips(_cells(np.stack([number[:-1], number[1:]], axis=2).reshape(z.shape[0] - 1, -1)))
    else:
        corners = (np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, 1:], np.s_[1:, :-1])
        whole = np.logical_and.reduce([measured[corner] for corner in corners])
        mesh.SetPolys(_cells(np.stack([number[corner][whole] for corner in corners], axis=1)))
    shown = _in_steps(height.ravel()) if colours is None else np.ascontiguousarray(colours.reshape(-1, 3))
    scalars = numpy_to_vtk(shown, deep=True)
    scalars.SetName("height [µm]" if colours is None else "colour")
    mesh.GetPointData().SetScalars(scalars)
    return mesh


def _cells(points: npt.NDArray[np.intp]) -> Any:  # noqa: ANN401
    """Cells of equally many points, (cells, points)."""
    from vtkmodules.util.numpy_support import numpy_to_vtkIdTypeArray
    from vtkmodules.vtkCommonDataModel import vtkCellArray

    cells = vtkCellArray()
    starts = np.arange(len(points) + 1) * points.shape[1]
    cells.SetData(
        *(numpy_to_vtkIdTypeArray(np.ascontiguousarray(one), deep=True) for one in (starts, points.ravel()))
    )
    return cells


def _in_steps(values: FloatArray) -> npt.NDArray[np.float32]:
    return np.asarray(np.round(values / STEP_UM) * STEP_UM, dtype=np.float32)


def _viridis() -> Any:  # noqa: ANN401
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkLookupTable

    colours = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    table = vtkLookupTable()
    table.SetTable(numpy_to_vtk(np.insert(colours, 3, 255, axis=1), deep=True))
    return table


def _bar(table: Any) -> Any:  # noqa: ANN401
    """Colour bar of the still picture; the interactive scene has none, since the map next to it has one."""
    import vtkmodules.vtkRenderingFreeType  # noqa: F401 - registers what writes
    from vtkmodules.vtkRenderingAnnotation import vtkScalarBarActor

    bar = vtkScalarBarActor()
    bar.SetLookupTable(table)
    bar.SetMaximumNumberOfColors(256)
    bar.SetOrientationToHorizontal()
    bar.SetNumberOfLabels(3)
    bar.SetLabelFormat("%.1f")
    bar.SetTitle("height [µm]")
    bar.UnconstrainedFontSizeOn()
    for text, size in (
        (bar.GetTitleTextProperty(), LABELS["title"]),
        (bar.GetLabelTextProperty(), LABELS["labels"]),
    ):
        text.SetColor(0.0, 0.0, 0.0)
        text.SetFontSize(size)
        text.ItalicOff()
        text.BoldOff()
        text.ShadowOff()
    bar.SetWidth(0.6)
    bar.SetHeight(0.09)
    bar.SetPosition(0.2, 0.02)
    return bar


def _png(window: Any) -> bytes:  # noqa: ANN401
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkRenderingCore import vtkWindowToImageFilter

    grabbed = vtkWindowToImageFilter()
    grabbed.SetInput(window)
    grabbed.ShouldRerenderOff()
    grabbed.Update()
    image = grabbed.GetOutput()
    width, height, _ = image.GetDimensions()
    pixels = vtk_to_numpy(image.GetPointData().GetScalars()).reshape(height, width, -1)
    return cv2.imencode(".png", pixels[::-1, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 6])[1].tobytes()


def _packed(window: Any) -> bytes:  # noqa: ANN401
    """The scene as the offline viewer of trame-vtk reads it, without any server."""
    from trame_vtk.modules.vtk.protocols.local_rendering import (  # type: ignore[import-untyped]
        vtkWebLocalRendering,
    )
    from vtkmodules.vtkWebCore import vtkWebApplication

    application = vtkWebApplication()
    rendering: Any = vtkWebLocalRendering()
    rendering.coreServer = SimpleNamespace(getSharedObject=lambda _: application)
    view = application.GetObjectIdMap().GetGlobalId(window)
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
