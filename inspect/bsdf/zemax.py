"""Zemax' tabular BSDF files (ASCII): scatter angles around the mirror direction.

For every rotation of the sample and every angle of incidence a table of azimuths (lines) and radial angles (columns),
both about the mirror direction: azimuth 0 points from it toward the normal, and counts counter-clockwise as seen from
outside. TIS is the directional albedo. The light stands at azimuth 180°; a sample rotation R turns the sample
counter-clockwise by R. Source: Zemax, "Tabular BSDF data file format". Isotropic surfaces are written as
PlaneSymmetrical, others as Asymmetrical4D with rotations.
"""

from pathlib import Path

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_text
from anisoscope.base.csv_table import read_text
from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.bsdf.file_format import BsdfFile
from anisoscope.bsdf.reflectance import Reflectance, above_horizon, albedo

INCIDENCE_DEG = np.arange(0.0, 86.0, 2.5)
COARSE_INCIDENCE_DEG = np.arange(0.0, 81.0, 10.0)
"""Of anisotropic surfaces, whose tables are long."""
ROTATION_DEG = np.arange(0.0, 361.0, 15.0)
AZIMUTH_DEG = np.arange(0.0, 361.0, 5.0)
RADIAL_DEG = np.concatenate([np.arange(0.0, 45.0, 1.0), np.arange(45.0, 171.0, 5.0)])
_HEAD = ("Source", "Symmetry", "SpectralContent", "ScatterType")
_AXES = ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")


def write_zemax(reflectance: Reflectance, path: Path, on_progress: Advance = silent) -> None:
    """Sample a reflectance of one channel and write it.

    Raises:
        UsageError: several wavelengths.
        RecordError: the file cannot be written.
    """
    if reflectance.channels != 1:
        raise UsageError(f"{reflectance.name}: a monochrome Zemax file holds one value for all light")
    rotations = np.zeros(1) if reflectance.isotropic else ROTATION_DEG
    azimuths = AZIMUTH_DEG[AZIMUTH_DEG <= 180.0] if reflectance.isotropic else AZIMUTH_DEG
    incidences = INCIDENCE_DEG if reflectance.isotropic else COARSE_INCIDENCE_DEG
    axes = (rotations, incidences, azimuths, RADIAL_DEG)
    lines = [
        f"# {reflectance.name}, by anisoscope; 1/sr",
        "# SampleRotation turns the sample counter-clockwise",
        "Source  Measured",
        f"Symmetry  {'PlaneSymmetrical' if reflectance.isotropic else 'Asymmetrical4D'}",
        "SpectralContent  Monochrome",
        "ScatterType  BRDF",
    ]
    for name, axis in zip(_AXES, axes, strict=True):
        lines += [f"{name}  {len(axis)}", "  ".join(f"{angle:g}" for angle in axis)]
    lines += ["", "Monochrome", "DataBegin"]
    azimuth, radial = (grid.ravel() for grid in np.meshgrid(azimuths, RADIAL_DEG, indexing="ij"))
    for number, turn in enumerate(rotations):
        on_progress("rotations", number, len(rotations))
        for incidence in incidences:
            light, camera = _directions(
                np.full(azimuth.size, incidence), azimuth, radial, np.full(azimuth.size, turn)
            )
            value = reflectance.evaluate(light, camera)[:, 0].reshape(len(azimuths), -1)
            tis = float(albedo(reflectance, incidence, 180.0 - turn, 4096)[0])
            lines.append(f"TIS  {tis:.6g}")
            lines += ["  ".join(f"{one:.4E}" for one in row) for row in value]
    on_progress("rotations", len(rotations), len(rotations))
    write_text(path, "\n".join([*lines, "DataEnd", ""]))


def is_zemax(head: bytes) -> bool:
    """Whether a file begins as a Zemax BSDF file does."""
    for line in head.decode("latin-1").splitlines():
        if line.strip() and not line.lstrip().startswith("#"):
            return line.split()[0].lower() == "source"
    return False


def read_zemax(path: Path) -> Reflectance:
    """Read a monochrome BRDF; directions that the file lacks are those at its ends.

    Raises:
        UsageError: it cannot be read, is damaged, or holds what is not read.
    """
    lines = [line.strip() for line in read_text(path).splitlines() if not line.lstrip().startswith("#")]
    words = [word for line in lines for word in line.split()]
    reader = _Words(words, path)
    head = {name: reader.after(name) for name in _HEAD}
    if head["SpectralContent"].lower() != "monochrome" or head["ScatterType"].lower() != "brdf":
        raise UsageError(
            f"{path}: read are monochrome BRDFs, not {head['SpectralContent']} {head['ScatterType']}"
        )
    axes = []
    for name in _AXES:
        count = reader.count(reader.after(name), name)
        axes.append(reader.numbers(count, name))
        if np.any(np.diff(axes[-1]) <= 0.0):
            raise UsageError(f"{path}: the angles of {name} must rise")
    reader.after("Monochrome")
    reader.after("DataBegin", value=False)
    table = np.empty(tuple(len(axis) for axis in axes))
    for rotation in range(table.shape[0]):
        for incidence in range(table.shape[1]):
            reader.after("TIS")
            table[rotation, incidence] = reader.numbers(table[0, 0].size, "the data").reshape(table.shape[2:])
    plane = head["Symmetry"].lower() == "planesymmetrical"

    def value(to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
        from scipy.interpolate import RegularGridInterpolator  # noqa: PLC0415 - slow to import

        place = _angles(to_light, to_camera, isotropic=len(axes[0]) == 1)
        if plane:
            place[:, 2] = np.where(place[:, 2] > 180.0, 360.0 - place[:, 2], place[:, 2])
        used = [n for n, axis in enumerate(axes) if len(axis) > 1]
        grid = tuple(axes[n] for n in used)
        inside = np.stack([np.clip(place[:, n], axes[n][0], axes[n][-1]) for n in used], axis=-1)
        return np.asarray(RegularGridInterpolator(grid, table.reshape([len(axis) for axis in grid]))(inside))

    return Reflectance(
        path.stem,
        lambda light, camera: above_horizon(light, camera, value),
        isotropic=plane and len(axes[0]) == 1,
    )


class _Words:
    """The words of a file, one after another."""

    def __init__(self, words: list[str], path: Path) -> None:
        self.words, self.path, self.at = words, path, 0

    def after(self, name: str, *, value: bool = True) -> str:
        """The word after a name that must come next; the name itself without ``value``."""
        found = self.words[self.at] if self.at < len(self.words) else "the end"
        if found.lower() != name.lower():
            raise UsageError(f"{self.path}: {name} expected, {found!r} found")
        self.at += 1
        if name == "Monochrome" or not value:
            return found
        self.at += 1
        return self.words[self.at - 1] if self.at <= len(self.words) else ""

    def count(self, word: str, name: str) -> int:
        """A number of angles."""
        if not word.isdecimal() or not 1 <= int(word) <= 100_000:
            raise UsageError(f"{self.path}: the number of angles of {name} is {word!r}")
        return int(word)

    def numbers(self, count: int, name: str) -> FloatArray:
        """The next numbers."""
        some = self.words[self.at : self.at + count]
        self.at += count
        try:
            found = np.array(some, dtype=np.float64)
        except ValueError:
            raise UsageError(f"{self.path}: {name} holds something that is no number") from None
        if len(found) != count or not np.isfinite(found).all():
            raise UsageError(f"{self.path}: {count} numbers of {name} expected, {len(found)} found")
        return found


def _directions(
    incidence_deg: FloatArray, azimuth_deg: FloatArray, radial_deg: FloatArray, rotation_deg: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(N, 3) unit vectors to light and camera in the frame of the sample."""
    tilt, azimuth, radial = (np.radians(a) for a in (incidence_deg, azimuth_deg, radial_deg))
    zero = np.zeros_like(tilt)
    mirror = np.stack([np.sin(tilt), zero, np.cos(tilt)], axis=-1)
    inward = np.stack([-np.cos(tilt), zero, np.sin(tilt)], axis=-1)
    aside = np.cross(mirror, inward)
    ring = np.cos(azimuth)[:, None] * inward + np.sin(azimuth)[:, None] * aside
    camera = np.cos(radial)[:, None] * mirror + np.sin(radial)[:, None] * ring
    light = np.stack([-np.sin(tilt), zero, np.cos(tilt)], axis=-1)
    return _turned(light, -rotation_deg), _turned(camera, -rotation_deg)


def _angles(to_light: FloatArray, to_camera: FloatArray, *, isotropic: bool) -> FloatArray:
    """(N, 4) rotation, incidence, azimuth and radial angle in degrees."""
    azimuth = np.degrees(np.arctan2(to_light[:, 1], to_light[:, 0]))
    rotation = np.mod(180.0 - azimuth, 360.0)
    light, camera = _turned(to_light, rotation), _turned(to_camera, rotation)
    tilt = np.arctan2(-light[:, 0], light[:, 2])
    along = np.sin(tilt) * camera[:, 0] + np.cos(tilt) * camera[:, 2]
    inward = -np.cos(tilt) * camera[:, 0] + np.sin(tilt) * camera[:, 2]
    aside = -camera[:, 1]
    ring = np.mod(np.degrees(np.arctan2(aside, inward)), 360.0)
    radial = np.degrees(np.arctan2(np.hypot(inward, aside), along))
    if isotropic:
        rotation = np.zeros_like(rotation)
    return np.stack([rotation, np.degrees(tilt), ring, radial], axis=-1)


def _turned(vectors: FloatArray, angle_deg: FloatArray) -> FloatArray:
    cos, sin = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    x, y, z = vectors.T
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)


ZEMAX = BsdfFile("zemax", "Zemax BSDF", is_zemax, read_zemax, 5)
