"""A scene for Mitsuba 3 with an exported ``.bsdf``: a plate or a sphere under a directional light."""

from math import cos, radians, sin
from pathlib import Path
from typing import Literal
from xml.sax.saxutils import quoteattr

from anisoscope.base.atomic_write import write_text

Shape = Literal["plate", "sphere"]
_SCENE = """<?xml version="1.0" encoding="utf-8"?>
<!-- Written by anisoscope. Render with: mitsuba -m scalar_spectral {name}
     Ridges run along the y axis of the shape's surface coordinates; irradiance 1 per wavelength across the beam. -->
<scene version="3.0.0">
    <integrator type="path"><integer name="max_depth" value="2"/></integrator>
    <sensor type="orthographic">
        <transform name="to_world">
            <scale x="1.1" y="1.1"/>
            <lookat origin="{camera}" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <sampler type="independent"><integer name="sample_count" value="16"/></sampler>
        <film type="hdrfilm">
            <integer name="width" value="256"/><integer name="height" value="256"/>
            <string name="pixel_format" value="luminance"/>
            <rfilter type="box"/>
        </film>
    </sensor>
    <emitter type="directional">
        <vector name="direction" value="{light}"/>
        <spectrum name="irradiance" value="1"/>
    </emitter>
    <shape type="{shape}">
        <bsdf type="measured"><string name="filename" value={file}/></bsdf>
    </shape>
</scene>
"""


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
    angle = radians(light_angle_deg)
    same = path.resolve().parent == bsdf.resolve().parent
    write_text(
        path,
        _SCENE.format(
            name=path.name,
            camera="0, 0, 4",
            light=f"{-sin(angle):.9g}, 0, {-cos(angle):.9g}",
            shape="rectangle" if shape == "plate" else "sphere",
            file=quoteattr(bsdf.name if same else str(bsdf.resolve())),
        ),
    )
