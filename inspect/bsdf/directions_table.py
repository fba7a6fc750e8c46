"""Reflectance at single pairs of directions: tables of instruments, brought into the form that `fit brdf` reads.

Read are CSV files whose columns are named by a mapping, and ASTM E2387-style ASCII: lines of keywords,
``NUM_POINTS n``, ``VARS theta_i,phi_i,theta_s,phi_s,…`` with angles in radians, then numbers. A gridded reflectance is
sampled.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.csv_style import CsvReader, csv_text, number_text
from anisoscope.base.csv_table import read_text
from anisoscope.base.errors import UsageError
from anisoscope.base.regular_file import regular_file
from anisoscope.bsdf.formats import compared_directions
from anisoscope.bsdf.reflectance import WATCHED_DEG, Reflectance, above_horizon, hemisphere, physics_of

ANGLES = ("theta_i_deg", "phi_i_deg", "theta_o_deg", "phi_o_deg")
COLUMNS = (*ANGLES, "value")
OPTIONAL = ("u", "wavelength_nm")
Quantity = Literal["brdf", "radiance", "factor"]
STEEPEST_DEG = 89.0
_RADIANS = np.pi * 1.0001
_LARGEST = 1e6
_NEAR, _FEWEST = 12, 12
_DIFFERENCE = 0.4  # how much the difference of the directions counts against the half vector
_NODES, _MOST_LIGHTS = (
    4096,
    64,
)  # of a hemisphere; directions of light that are added up, those of most rows first
_BLOCK = 20_000  # pairs that are evaluated at once, which bounds the memory
_ASTM = {"theta_i": ANGLES[0], "phi_i": ANGLES[1], "theta_s": ANGLES[2], "phi_s": ANGLES[3],
         "theta_r": ANGLES[2], "phi_r": ANGLES[3]}  # fmt: skip
_COLOURS = {"r": 650.0, "g": 550.0, "b": 450.0}


@dataclass(frozen=True, eq=False)
class DirectionsTable:
    """N values of a BRDF.

    Attributes:
        columns: COLUMNS, and those of OPTIONAL that are known.
        rows: (N, columns) angles in degrees, θ in 0 to 90, values in 1/sr.
        remarks: what was done to the numbers.
    """

    columns: tuple[str, ...]
    rows: FloatArray
    remarks: tuple[str, ...] = ()

    def column(self, name: str) -> FloatArray:
        """(N,) numbers."""
        return np.asarray(self.rows[:, self.columns.index(name)])

    def csv(self) -> str:
        """The text of a CSV file."""
        return csv_text([self.columns, *([number_text(f"{x:.9g}") for x in row] for row in self.rows)])


def read_mapped(
    path: Path, mapping: Mapping[str, str], *, radians: bool = False, quantity: Quantity = "brdf"
) -> DirectionsTable:
    """Read a CSV file with a header.

    Args:
        path: the file.
        mapping: our columns to names of the header, or to a number that holds for all rows; ours by themselves are
            taken where the header has them.
        radians: angles are in radians.
        quantity: "brdf" in 1/sr; "radiance": BRDF × cos θi; "factor": π × BRDF, ratios to a perfect white.

    Raises:
        UsageError: a column that is missing, a line that cannot be used, or angles in another unit.
    """
    unknown = set(mapping) - {*COLUMNS, *OPTIONAL}
    if unknown:
        raise UsageError(f"--columns: {min(unknown)!r} is none of {', '.join((*COLUMNS, *OPTIONAL))}")
    reader = CsvReader(read_text(path), path)
    header = [name.strip() for name in next(reader, [])]
    sources: dict[str, int | float] = {}
    for name in (*COLUMNS, *OPTIONAL):
        text = mapping.get(name, name)
        if text in header:
            sources[name] = header.index(text)
        elif name in mapping and _is_number(text):
            sources[name] = float(text)
        elif name in COLUMNS or name in mapping:
            raise UsageError(
                f"{path}, line 1: no column {text!r} (there are {', '.join(header)}): name it with --columns "
                f"{name}=COLUMN, or give a number for all rows"
            )
    rows = []
    for fields in reader:
        if not any(field.strip() for field in fields):
            continue
        place = f"{path}, line {reader.line_num}"
        if len(fields) != len(header):
            raise UsageError(f"{place}: {len(header)} values expected, {len(fields)} found")
        row = [
            source if isinstance(source, float) else _number(reader.with_point(fields[source]), name, place)
            for name, source in sources.items()
        ]
        rows.append(row)
    if not rows:
        raise UsageError(f"{path}: no values follow the header")
    return _checked(path, tuple(sources), np.array(rows), radians=radians, quantity=quantity)


def is_astm(path: Path) -> bool:
    """Whether a text file declares its columns in a line ``VARS``."""
    try:
        with regular_file(path) as stream:
            return re.search(rb"^VARS\b", stream.read(16384), re.MULTILINE) is not None
    except OSError:
        return False


def read_astm(path: Path, *, radians: bool = True, quantity: Quantity = "brdf") -> DirectionsTable:
    """Read ASTM E2387-style ASCII; columns r, g, b become 650, 550 and 450 nm, a number its wavelength.

    Raises:
        UsageError: columns that are not known, another number of points, or a line that cannot be used.
    """
    lines = read_text(path).splitlines()
    at = next((n for n, line in enumerate(lines) if line.startswith("VARS")), None)
    if at is None:
        raise UsageError(f"{path}: no line VARS names the columns")
    names = [name.lower() for name in re.split(r"[,\s]+", lines[at][4:].strip()) if name]
    angles = [_ASTM.get(name) for name in names]
    if not set(ANGLES) <= set(angles):
        raise UsageError(
            f"{path}, line {at + 1}: VARS must name theta_i, phi_i, theta_s and phi_s, not {', '.join(names)}"
        )
    values = [n for n, name in enumerate(names) if _ASTM.get(name) is None]
    if not values:
        raise UsageError(f"{path}, line {at + 1}: VARS names no value")
    numbers, places = [], []
    for number, line in enumerate(lines[at + 1 :], at + 2):
        fields = [field for field in re.split(r"[,\s]+", line.strip()) if field]
        if not fields or line.lstrip().startswith("#"):
            continue
        if len(fields) != len(names):
            raise UsageError(f"{path}, line {number}: {len(names)} values expected, {len(fields)} found")
        numbers.append(
            [
                _number(field, name, f"{path}, line {number}")
                for field, name in zip(fields, names, strict=True)
            ]
        )
        places.append(number)
    stated = next((line.split()[1] for line in lines[:at] if re.match(r"NUM_POINTS\s+\d+", line)), None)
    if not numbers or (stated is not None and int(stated) != len(numbers)):
        raise UsageError(
            f"{path}: {len(numbers)} points, NUM_POINTS says {stated}: the file is cut off or damaged"
        )
    data = np.array(numbers)
    order = [angles.index(name) for name in ANGLES]
    nm = [_wavelength(names[n]) for n in values]
    parts, columns = [], COLUMNS if nm == [None] else (*COLUMNS, "wavelength_nm")
    if None in nm and len(nm) > 1:
        raise UsageError(
            f"{path}, line {at + 1}: of several values each must be a wavelength in nm, or R, G and B"
        )
    for n, wavelength in zip(values, nm, strict=True):
        tail = [] if wavelength is None else [np.full(len(data), wavelength)]
        parts.append(np.column_stack([data[:, order], data[:, n], *tail]))
    return _checked(path, columns, np.concatenate(parts), radians=radians, quantity=quantity)


def sampled(reflectance: Reflectance, count: int = 2000) -> DirectionsTable:
    """Values of a reflectance on ``count`` pairs: directions to 60° and half vectors to 30° from the normal."""
    light, camera = compared_directions(max(4096, 1 << (2 * count - 1).bit_length()))
    chosen = np.arange(count) * len(light) // count
    light, camera = light[chosen], camera[chosen]
    blocks_of = [slice(start, start + _BLOCK) for start in range(0, count, _BLOCK)]
    value = np.concatenate([reflectance.evaluate(light[one], camera[one]) for one in blocks_of])
    angles = np.column_stack([polar_degrees(light), polar_degrees(camera)])
    nm = reflectance.wavelengths_nm
    if not nm:
        return DirectionsTable(COLUMNS, np.column_stack([angles, value[:, 0]]))
    blocks = [np.column_stack([angles, value[:, n], np.full(len(angles), one)]) for n, one in enumerate(nm)]
    return DirectionsTable((*COLUMNS, "wavelength_nm"), np.concatenate(blocks))


def imported(reflectance: Reflectance, count: int) -> DirectionsTable:
    """The same of a file, with a remark where it sends back more light than falls in."""
    bright = _too_bright(*max(zip(physics_of(reflectance).albedo, WATCHED_DEG, strict=True)))
    return replace(sampled(reflectance, count), remarks=bright)


def hemispherical(table: DirectionsTable) -> tuple[float, float]:
    """Largest share of the light from one direction that the rows send back, and its inclination in degrees.

    A row stands for the part of the hemisphere that is nearest to it, within twice the usual distance of rows; nothing
    is added where there are none, so that few rows in a plane send little back.
    """
    from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import

    nodes, most = hemisphere(_NODES, 90.0), (0.0, 0.0)
    known = [
        n for n, name in enumerate(table.columns) if name in ("theta_i_deg", "phi_i_deg", "wavelength_nm")
    ]
    lights, group = np.unique(np.round(table.rows[:, known], 3), axis=0, return_inverse=True)
    counts = np.bincount(group.ravel())
    for number in np.argsort(counts)[::-1][:_MOST_LIGHTS]:
        rows = group.ravel() == number
        camera, value = _vectors(table.rows[rows][:, [2, 3]]), table.column("value")[rows]
        if len(camera) < 3:
            continue
        tree = cKDTree(camera)
        usual = float(np.median(np.asarray(tree.query(camera, 2)[0])[:, 1]))
        far, nearest = tree.query(nodes)
        share = 2.0 * np.pi * float(np.mean(np.where(far <= 2.0 * usual, value[nearest], 0.0) * nodes[:, 2]))
        most = max(most, (share, float(lights[number, 0])))
    return most


def _too_bright(share: float, light_deg: float) -> tuple[str, ...]:
    """What is said of a hemispherical reflectance above 1; 2 % are left to the quadrature."""
    if share <= 1.02:
        return ()
    text = (
        f"warning: the hemispherical reflectance is {share:.3g} for light at {light_deg:g}°, more than fell in: are "
        "the values BRDFs in 1/sr (--values-are)?"
    )
    return (text,)


def interpolated(table: DirectionsTable, name: str) -> Reflectance:
    """A reflectance through the rows of a table: planes of ln f fitted to the rows about each pair of directions.

    Places are those of the half vector (slopes) and of the half difference of both directions, which counts less.
    Each row stands for its exchanged pair too (Helmholtz reciprocity). A fitted value stays within those of its rows;
    beyond the table it is that of the nearest rows, and a note says how much of the hemisphere that is.

    Args:
        table: its rows, at one wavelength or several.
        name: of the surface.

    Raises:
        UsageError: fewer rows than a fit needs, or values of 0 or less.
    """
    from scipy.spatial import cKDTree  # noqa: PLC0415 - slow to import

    light, camera = (_vectors(table.rows[:, columns]) for columns in ([0, 1], [2, 3]))
    value = table.column("value")
    if np.any(value <= 0.0):
        raise UsageError(
            f"{name}: {np.count_nonzero(value <= 0.0)} values are 0 or less: a reflectance between rows needs positive "
            "ones; leave these rows out"
        )
    nm = table.column("wavelength_nm") if "wavelength_nm" in table.columns else np.zeros(len(value))
    known = np.unique(nm)
    fits = []
    for one in known:
        here = nm == one
        if np.count_nonzero(here) < _FEWEST:
            raise UsageError(
                f"{name}: {np.count_nonzero(here)} rows are too few: {_FEWEST} or more are needed"
            )
        both = np.concatenate([light[here], camera[here]]), np.concatenate([camera[here], light[here]])
        places = _places(*both)
        fits.append((cKDTree(places), places, np.log(np.tile(value[here], 2))))

    def evaluate(to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
        def found(some_light: FloatArray, some_camera: FloatArray) -> FloatArray:
            at = _places(some_light, some_camera)
            return np.stack([_fitted(at, *fit) for fit in fits], axis=-1)

        return above_horizon(to_light, to_camera, found)

    tree, places, _ = fits[0]
    reach = 2.0 * float(np.median(np.asarray(tree.query(places, _NEAR)[0])[:, -1]))
    beyond = float(np.mean(tree.query(_places(*compared_directions()))[0] > reach))
    note = f"{beyond:.0%} of the directions to 60° lie beyond the rows of the table, and have the values of the nearest"
    wavelengths = tuple(known.tolist()) if "wavelength_nm" in table.columns else ()
    return Reflectance(name, evaluate, wavelengths, notes=(note,) if beyond > 0.005 else ())


def _vectors(angles_deg: FloatArray) -> FloatArray:
    """(N, 3) unit vectors of (N, 2) θ and φ."""
    theta, phi = np.radians(angles_deg.T)
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def _places(light: FloatArray, camera: FloatArray) -> FloatArray:
    """(N, 4) slopes of the half vector, and the half difference of the directions, scaled by what it counts."""
    half = light + camera
    slopes = half[:, :2] / np.maximum(half[:, 2:], 1e-6)
    return np.concatenate([slopes, 0.5 * _DIFFERENCE * (light - camera)[:, :2]], axis=1)


def _fitted(at: FloatArray, tree: Any, places: FloatArray, value: FloatArray) -> FloatArray:  # noqa: ANN401
    """(N,) values at (N, 4) places, by planes through ln f of the nearest rows."""
    far, rows = tree.query(at, _NEAR)
    weight = np.exp(-2.0 * np.square(far / np.maximum(far[:, -1:], 1e-12)))
    design = np.concatenate([np.ones((*rows.shape, 1)), places[rows] - at[:, None]], axis=2)
    near = value[rows]
    normal = np.einsum("nki,nk,nkj->nij", design, weight, design)
    scale = np.einsum("nii->n", normal[:, 1:, 1:]) / 4.0
    normal[:, range(1, 5), range(1, 5)] += 1e-3 * scale[:, None] + 1e-12
    right = np.einsum("nki,nk,nk->ni", design, weight, near)
    level = np.linalg.solve(normal, right[..., None])[:, 0, 0]
    return np.asarray(np.exp(np.clip(level, near.min(axis=1), near.max(axis=1))))


def polar_degrees(vectors: FloatArray) -> FloatArray:
    """(N, 2) θ and φ in degrees of (N, 3) unit vectors."""
    theta = np.arctan2(np.hypot(vectors[:, 0], vectors[:, 1]), vectors[:, 2])
    return np.asarray(np.degrees(np.stack([theta, np.arctan2(vectors[:, 1], vectors[:, 0])], axis=-1)))


def _checked(
    path: Path, columns: tuple[str, ...], rows: FloatArray, *, radians: bool, quantity: Quantity
) -> DirectionsTable:
    """Angles in degrees, θ not negative, values as a BRDF; what cannot be is refused."""
    place = {name: n for n, name in enumerate(columns)}
    rows, remarks = _in_degrees(path, rows, [place[name] for name in ANGLES], radians=radians)
    if "wavelength_nm" in place and rows[:, place["wavelength_nm"]].max() < 20.0:
        raise UsageError(f"{path}: wavelength_nm looks like µm: give nm, 1000 times larger")
    factor = np.ones(len(rows))
    if quantity == "radiance":
        factor = 1.0 / np.cos(np.radians(rows[:, place[ANGLES[0]]]))
        remarks.append("values divided by cos θi")
    elif quantity == "factor":
        factor = np.full(len(rows), 1.0 / np.pi)
        remarks.append("values divided by π")
    for name in ("value", "u"):
        if name in place:
            rows[:, place[name]] *= factor
    largest = float(np.abs(rows[:, place["value"]]).max())
    if largest > _LARGEST:
        raise UsageError(f"{path}: a value of {largest:.3g}/sr is no reflectance: are these counts?")
    found = DirectionsTable(columns, rows)
    return replace(found, remarks=(*remarks, *_too_bright(*hemispherical(found))))


def _in_degrees(
    path: Path, rows: FloatArray, angles: list[int], *, radians: bool
) -> tuple[FloatArray, list[str]]:
    """Rows with angles in degrees and θ from 0 to STEEPEST_DEG, and what was done."""
    remarks = []
    largest = float(np.abs(rows[:, angles]).max())
    if radians:
        rows[:, angles] = np.degrees(rows[:, angles])
        remarks.append("angles converted from radians")
    elif 0.0 < largest <= _RADIANS and len(rows) > 1:
        raise UsageError(
            f"{path}: no angle exceeds {largest:.3g}: these look like radians: add --angle-unit rad"
        )
    for name, tilt, azimuth in ((ANGLES[0], angles[0], angles[1]), (ANGLES[2], angles[2], angles[3])):
        flipped = rows[:, tilt] < 0.0
        rows[flipped, azimuth] += 180.0
        rows[flipped, tilt] *= -1.0
        if flipped.any():
            remarks.append(f"{np.count_nonzero(flipped)} negative {name} stand at the azimuth + 180°")
        if np.any(rows[:, tilt] > 180.0):
            raise UsageError(
                f"{path}: {name} reaches {rows[:, tilt].max():g}°: angles from the normal are expected"
            )
    steep = np.any(rows[:, angles[::2]] > STEEPEST_DEG, axis=1)
    if steep.all():
        raise UsageError(f"{path}: no row lies within {STEEPEST_DEG:g}° of the normal")
    if steep.any():
        remarks.append(f"{np.count_nonzero(steep)} rows beyond {STEEPEST_DEG:g}° from the normal left out")
    return rows[~steep], remarks


def _wavelength(name: str) -> float | None:
    found = re.fullmatch(r"(\d+(?:\.\d+)?)(?:nm)?", name)
    return float(found[1]) if found else _COLOURS.get(name)


def _is_number(text: str) -> bool:
    try:
        return abs(float(text)) < float("inf")
    except ValueError:
        return False


def _number(text: str, name: str, place: str) -> float:
    if not _is_number(text):
        raise UsageError(f"{place}: {name} is not a number: {text!r}")
    return float(text)
