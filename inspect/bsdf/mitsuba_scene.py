"""Scenes for Mitsuba 3: an exported ``.bsdf`` on a plate or a sphere, fields or dots of several, and a normal map.

All stand under a directional light of irradiance 1 per wavelength across its beam.
"""

from collections.abc import Sequence
from math import cos, radians, sin
from pathlib import Path
from typing import Literal
from xml.sax.saxutils import quoteattr

import numpy as np
import numpy.typing as npt

from anisoscope.base.atomic_write import write_text
from anisoscope.bsdf.textures import write_masks

Shape = Literal["plate", "sphere"]
_SCENE = """<?xml version="1.0" encoding="utf-8"?>
<!-- Written by anisoscope. Render with: mitsuba -m {variant} {name}
     Ridges run along the y axis of the shape's surface coordinates; irradiance 1 per wavelength across the beam. -->
<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="2"/></integrator>
    <sensor type="orthographic">
        <transform name="to_world">
            <scale x="{reach}" y="{reach}"/>
            <lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <sampler type="independent"><integer name="sample_count" value="16"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="{width}"/><integer name="height" value="{height}"/>
            <string name="pixel_format" value="luminance"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <emitter type="directional">
        <vector name="direction" value="{light}"/>
        <spectrum name="irradiance" value="1"/>
    </emitter>
    <shape type="{shape}">
        <transform name="to_world"><scale x="1" y="{aspect:.9g}"/></transform>
        {bsdf}
    </shape>
</scene>
"""
_MOST_PIXELS = 2048


def write_scene(path: Path, bsdf: Path, shape: Shape = "sphere", light_angle_deg: float = 10.0) -> None:
    """Write a scene that names an exported file; both in one folder need no other path.

    Args:
        path: the XML file.
        bsdf: the exported reflectance.
        shape: a square plate, or a sphere.
        light_angle_deg: between light and camera, the light toward +x.

    Raises:
        RecordError: it cannot be written.
    """
    same = path.resolve().parent == bsdf.resolve().parent
    shown = _measured(bsdf.name if same else str(bsdf.resolve()))
    _write(path, shown, light_angle_deg, "rectangle" if shape == "plate" else "sphere")


def write_classes_scene(
    path: Path,
    classes: npt.NDArray[np.integer],
    surfaces: Sequence[str | None],
    light_angle_deg: float = 10.0,
    pixels: int = 4,
) -> list[str]:
    """Write a scene of a plate of fields or dots, and the masks of its classes next to it.

    Args:
        path: the XML file.
        classes: (rows, cols) class of every field or dot, from 0, first row at the top.
        surfaces: ``.bsdf`` file of every class, in the folder of the scene; None reflects nothing.
        light_angle_deg: between light and camera, the light toward +x.
        pixels: of the picture along a field or dot.

    Returns:
        Names of the masks.

    Raises:
        RecordError: a file cannot be written.
    """
    masks = write_masks(path.parent, classes)
    shown = _measured(surfaces[0])
    for mask, surface in zip(masks, surfaces[1:], strict=True):
        weight = _bitmap("weight", mask)
        shown = f'<bsdf type="blendbsdf">{weight}\n        {shown}\n        {_measured(surface)}</bsdf>'
    _write(path, shown, light_angle_deg, "rectangle", (classes.shape[0], classes.shape[1]), pixels)
    return masks


def write_normals_scene(
    path: Path,
    normals: str,
    shape: tuple[int, int],
    plastic: dict[str, float],
    light_angle_deg: float = 10.0,
) -> None:
    """Write a scene of a plate with a normal map on Mitsuba's rough plastic.

    Args:
        path: the XML file.
        normals: file of the normal map in its folder.
        shape: (rows, cols) of it.
        plastic: alpha, albedo and index.
        light_angle_deg: between light and camera, the light toward +x.

    Raises:
        RecordError: it cannot be written.
    """
    shown = f"""<bsdf type="normalmap">{_bitmap("normalmap", normals)}
        <bsdf type="roughplastic">
            <string name="distribution" value="beckmann"/><float name="alpha" value="{plastic["alpha"]:.9g}"/>
            <float name="int_ior" value="{plastic["index"]:.9g}"/><float name="ext_ior" value="1"/>
            <boolean name="nonlinear" value="true"/>
            <spectrum name="diffuse_reflectance" value="{plastic["albedo"]:.9g}"/>
        </bsdf></bsdf>"""
    _write(path, shown, light_angle_deg, "rectangle", shape, 1)


def _measured(file: str | None) -> str:
    if file is None:
        return '<bsdf type="diffuse"><spectrum name="reflectance" value="0"/></bsdf>'
    return f'<bsdf type="measured"><string name="filename" value={quoteattr(file)}/></bsdf>'


def _bitmap(name: str, file: str) -> str:
    return (
        f'<texture name="{name}" type="bitmap"><string name="filename" value={quoteattr(file)}/>'
        '<boolean name="raw" value="true"/><string name="filter_type" value="nearest"/>'
        '<transform name="to_uv"><scale x="1" y="-1"/></transform></texture>'  # its first row is at the bottom
    )


def _write(
    path: Path,
    bsdf: str,
    light_angle_deg: float,
    shape: str,
    cells: tuple[int, int] | None = None,
    pixels: int = 1,
) -> None:
    angle = radians(light_angle_deg)
    rows, cols = (256, 256) if cells is None else (cells[0] * pixels, cells[1] * pixels)
    shrink = max(1, -(-max(rows, cols) // _MOST_PIXELS))
    write_text(
        path,
        _SCENE.format(
            name=path.name,
            variant="scalar_spectral",
            reach="1.1" if cells is None else "1",
            width=max(1, cols // shrink),
            height=max(1, rows // shrink),
            light=f"{-sin(angle):.9g}, 0, {-cos(angle):.9g}",
            shape=shape,
            aspect=rows / cols,
            bsdf=bsdf,
        ),
    )
