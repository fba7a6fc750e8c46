"""Plates of square fields, each with ridges of one of several directions, and their height maps.

A plan is a grid of letters, first row at the top (greatest y), ``.`` for a flat field. Each letter is a class: the
azimuth toward which the large facets of its fields fall, counter-clockwise from +x, and where the fields show greys a
ridge angle of its own. Ridges start anew in every field, so that all fields of a class are equal where a field holds
whole ridges. On a plate that leaves a mould every field is an island: four planes rise from a narrow level land at its
border with the draft of the walls, and cut off what of the ridges is above them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.heightmap import HeightMap, sealed
from anisoscope.profiles.patterns import pattern_map

FLAT = "."
MOST_FIELDS = 512
LEAST_RIDGES = 2.0
LAND_SHARE = 0.002
"""Width of the land at the border of a drafted field, over the side of the field."""


@dataclass(frozen=True)
class Plan:
    """Fields of a plate.

    Attributes:
        rows: one text a row of fields, the first at the top; a letter of ``azimuths_deg`` or ``.`` a field.
        azimuths_deg: azimuth of the facets of every class, by its letter.
        module_mm: side of a field.
        ridge_angles_deg: ridge angles by class, for those that differ from the design of the plate.

    Raises:
        HeightMapError: rows of unequal length, an unknown letter, no field with ridges, or too many fields.
    """

    rows: tuple[str, ...]
    azimuths_deg: Mapping[str, float]
    module_mm: float
    ridge_angles_deg: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.rows or not self.rows[0]:
            raise HeightMapError("the plan has no fields")
        if not (np.isfinite(self.module_mm) and self.module_mm > 0.0):
            raise HeightMapError(f"the side of a field must be a positive number of mm, not {self.module_mm}")
        for number, row in enumerate(self.rows, 1):
            self._check_row(number, row)
        unknown = sorted(set(self.ridge_angles_deg) - set(self.azimuths_deg))
        if unknown:
            raise HeightMapError(f"a ridge angle is given for {unknown[0]!r}, which is no class of direction")
        if max(len(self.rows), len(self.rows[0])) > MOST_FIELDS:
            raise HeightMapError(f"a plan holds at most {MOST_FIELDS} × {MOST_FIELDS} fields")
        if not set("".join(self.rows)) - {FLAT}:
            raise HeightMapError("no field of the plan has ridges")

    def _check_row(self, number: int, row: str) -> None:
        if len(row) != len(self.rows[0]):
            raise HeightMapError(
                f"row {number} of the plan has {len(row)} fields, the first one {len(self.rows[0])}"
            )
        for letter in row:
            if letter != FLAT and letter not in self.azimuths_deg:
                known = ", ".join(self.azimuths_deg) or "none"
                raise HeightMapError(
                    f"row {number} of the plan holds {letter!r}, which is no class of direction (known: {known})"
                )

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of fields."""
        return len(self.rows), len(self.rows[0])

    @property
    def size_mm(self) -> tuple[float, float]:
        """(x, y) size."""
        rows, cols = self.shape
        return cols * self.module_mm, rows * self.module_mm

    @property
    def letters(self) -> tuple[str, ...]:
        """Classes that occur, in the order of ``azimuths_deg``."""
        used = {letter for row in self.rows for letter in row}
        return tuple(letter for letter in self.azimuths_deg if letter in used)

    def design_of(self, letter: str, design: RidgeDesign) -> RidgeDesign:
        """The ridges of a class: those of the plate, with the ridge angle of the class."""
        angle = self.ridge_angles_deg.get(letter)
        return design if angle is None else replace(design, ridge_angle_deg=angle)

    def classes(self) -> npt.NDArray[np.int64]:
        """(rows, cols) index of each field in `letters`, −1 for flat ones; first row at the top."""
        index = {letter: number for number, letter in enumerate(self.letters)}
        return np.array([[index.get(letter, -1) for letter in row] for row in self.rows])

    def centre_mm(self, row: int, col: int) -> tuple[float, float]:
        """(x, y) of the middle of a field, from the middle of the plate."""
        rows, cols = self.shape
        return (col - 0.5 * (cols - 1)) * self.module_mm, (0.5 * (rows - 1) - row) * self.module_mm

    def check_ridges(self, pitch_um: float) -> None:
        """Check that a field holds ridges enough.

        Raises:
            HeightMapError: less than two.
        """
        ridges = 1000.0 * self.module_mm / pitch_um
        if ridges < LEAST_RIDGES - 1e-9:
            raise HeightMapError(
                f"fields of {self.module_mm:g} mm hold {ridges:.1f} ridges of {pitch_um:g} µm, {LEAST_RIDGES:g} are "
                "needed: take larger fields or a smaller pitch"
            )

    def points(self, pixel_um: float) -> int:
        """Points along a field of the height map.

        Raises:
            HeightMapError: they are no whole number.
        """
        module_um = 1000.0 * self.module_mm
        steps = round(module_um / pixel_um) if pixel_um > 0.0 else 0
        if steps < 1 or abs(steps * pixel_um - module_um) > 1e-6 * module_um:
            raise HeightMapError(
                f"fields of {self.module_mm:g} mm are no whole number of pixels of {pixel_um:g} µm: take another pixel"
            )
        return steps

    def turned(self, quarters: int) -> "Plan":
        """The plan of the plate turned counter-clockwise by quarter turns: places and directions."""
        grid = np.rot90(np.array([list(row) for row in self.rows]), quarters)
        rows = tuple("".join(row) for row in grid.tolist())
        azimuths = {letter: _within(one + 90.0 * quarters) for letter, one in self.azimuths_deg.items()}
        return Plan(rows, azimuths, self.module_mm, self.ridge_angles_deg)


def plan_of_modules(dark: npt.NDArray[np.bool_], module_mm: float, azimuths_deg: tuple[float, float]) -> Plan:
    """Plan of a code: light modules of the first direction (A), dark ones of the second (B).

    Args:
        dark: (rows, cols) first row at the top, quiet zone included.
        module_mm: side of a module.
        azimuths_deg: of light and dark modules.
    """
    rows = tuple("".join("B" if one else "A" for one in row) for row in dark)
    return Plan(rows, {"A": azimuths_deg[0], "B": azimuths_deg[1]}, module_mm)


def height_of_field(design: RidgeDesign, module_um: float, azimuth_deg: float, steps: int) -> FloatArray:
    """(steps, steps) heights of a field in µm, row index rising with y: a square of ridges turned about its middle."""
    place = (np.arange(steps) + 0.5) * module_um / steps - 0.5 * module_um
    turn = np.radians(azimuth_deg)
    cos, sin = round(float(np.cos(turn)), 15), round(float(np.sin(turn)), 15)
    return np.asarray(design.profile(np.add.outer(sin * place, cos * place) + 0.5 * module_um))


def _highest(module_um: float, steps: int, draft_rad: float) -> FloatArray:
    """(steps, steps) heights in µm that the draft of its border leaves to a field."""
    place = np.abs((np.arange(steps) + 0.5) * module_um / steps - 0.5 * module_um)
    inside = (0.5 - LAND_SHARE) * module_um - np.maximum.outer(place, place)
    return np.asarray(np.maximum(inside, 0.0) / np.tan(draft_rad))


def inner_share(design: RidgeDesign, module_um: float) -> float:
    """Share of a field that its drafted border leaves to the ridges, whose mean height is half of the greatest."""
    border = 0.5 * design.height_um * float(np.tan(design.draft_rad)) / module_um
    return (1.0 - 2.0 * border) ** 2


def plate_map(plan: Plan, design: RidgeDesign, pixel_um: float, *, drafted: bool = False) -> HeightMap:
    """Height map of a plate; row index rises with +y, flat fields at half the height of the ridges.

    Args:
        plan: its fields.
        design: their ridges; a class may have a ridge angle of its own.
        pixel_um: of the map.
        drafted: whether the borders of the fields have the draft of the walls of their ridges.

    Raises:
        HeightMapError: fields hold less than two ridges, or a side is no whole number of pixels.
    """
    plan.check_ridges(design.pitch_um)
    module_um, steps = 1000.0 * plan.module_mm, plan.points(pixel_um)
    designs = {letter: plan.design_of(letter, design) for letter in plan.letters}
    tiles = {
        letter: height_of_field(one, module_um, plan.azimuths_deg[letter], steps)
        for letter, one in designs.items()
    }
    tiles[FLAT], designs[FLAT] = np.full((steps, steps), 0.5 * design.height_um), design
    if drafted:
        tiles = {
            letter: np.minimum(one, _highest(module_um, steps, designs[letter].draft_rad))
            for letter, one in tiles.items()
        }
    height = np.empty((plan.shape[0] * steps, plan.shape[1] * steps))
    for number, row in enumerate(reversed(plan.rows)):
        for col, letter in enumerate(row):
            height[number * steps : (number + 1) * steps, col * steps : (col + 1) * steps] = tiles[letter]
    angles = {"ridge_angles_deg": dict(plan.ridge_angles_deg)} if plan.ridge_angles_deg else {}
    return pattern_map(
        sealed(height),
        pixel_um,
        ideal="plate",
        pitch_um=design.pitch_um,
        ridge_angle_deg=design.ridge_angle_deg,
        plan=list(plan.rows),
        facet_azimuths_deg=dict(plan.azimuths_deg),
        module_mm=plan.module_mm,
        **angles,
    )


def read_rows(lines: Sequence[str]) -> tuple[str, ...]:
    """Rows of a plan from lines of text: a letter a field, separated by commas, semicolons, blanks, or nothing."""
    return tuple(
        "".join(part for part in line if part not in ",; \t")
        for line in (one.strip() for one in lines)
        if line and not line.startswith("#")
    )


def _within(angle_deg: float) -> float:
    """Within (−180, 180]."""
    return 180.0 - (180.0 - angle_deg) % 360.0
