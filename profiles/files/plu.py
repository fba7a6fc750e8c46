"""Read plu (and apx) files of Sensofar profilometers.

After date, time and comment (388 bytes) come the calibration, the configuration of the measurement and, from
byte 508 on, layers: rows, columns, float32 heights in µm, lowest and highest. Not measured is 1000001.
Positions as in SurfaceTopography (MIT licence), ``IO/PLU.py``; the number of columns that a layer repeats is
compared with that of the calibration, so that a shift of the data is noticed.
"""

from datetime import datetime
from pathlib import Path
from typing import Any

from anisoscope.parameters.height_map_file import FileScales
from anisoscope.profiles.files.checks import checked_map, refuse
from anisoscope.profiles.files.content import DAMAGED, Content, load_content, scaled
from anisoscope.profiles.files.format import Format
from anisoscope.profiles.files.units import stated_or_given_pixel
from anisoscope.profiles.heightmap import HeightMap

TOPOGRAPHY = 3
MISSING = 1_000_001.0
LAYER = 500
HARDWARE = {
    0: "PLu", 1: "PLu 2300 XGA", 2: "PLu 2300 XGA T5", 3: "PLu 2300 SXGA", 4: "PLu 3300", 5: "DCM 3D",
    6: "PLu neox", 7: "DCM 3D rev. 2", 8: "PLu Apex", 9: "S neox", 10: "DCM8", 11: "PLu Apex",
}  # fmt: skip
VERSIONS_WITH_HARDWARE = range(1, 0xFC)


def _origin(content: Content, layers: int) -> dict[str, Any]:
    origin: dict[str, Any] = {
        "format": "plu",
        "first_row": "top",
        "instrument": {"manufacturer": "Sensofar"},
    }
    version, hardware = content.numbers("<BB", 490)
    if version in VERSIONS_WITH_HARDWARE and hardware in HARDWARE:
        origin["instrument"]["model"] = HARDWARE[hardware]
    try:
        date = datetime.strptime(content.text(0, 128), "%a %b %d %H:%M:%S %Y")  # noqa: DTZ007 - no zone stored
        origin["date"] = date.isoformat()
    except ValueError:
        pass
    if (comment := content.text(132, 256)) not in ("", "(None)"):
        origin["comment"] = comment
    if layers > 1:
        origin["layers"] = f"the first of {layers}"
    return origin


def read_plu(path: Path | str, given: FileScales | None = None) -> HeightMap:
    """Read the first layer of a plu file.

    Returns:
        (rows, cols) heights in µm in the order of the file, first row at the top of the picture.

    Raises:
        HeightMapError: no topography, damaged, or implausible.
    """
    content = load_content(Path(path))
    name = content.name
    (kind,) = content.numbers("<I", 428)
    if kind != TOPOGRAPHY:
        refuse(name, "type of measurement", kind, "only topographies (3) are height maps")
    rows, cols, _count, _ratio, pixel_x, pixel_y = content.numbers("<IIIfff", 388)
    (layers,) = content.numbers("<B", 489)
    found = content.numbers("<II", LAYER)
    if layers < 1 or found != (rows, cols):
        refuse(name, "layer", f"{found[0]} × {found[1]} points where {rows} × {cols} are announced", DAMAGED)
    raw = content.grid("<f4", rows, cols, LAYER + 8)
    pixel = stated_or_given_pixel(name, (pixel_y, pixel_x), given.pixel_um if given else None)
    return checked_map(name, scaled(raw, 1.0, raw == MISSING), pixel, _origin(content, layers))


PLU = Format("plu", "Sensofar plu", (".plu", ".apx"), read_plu, place=7)
