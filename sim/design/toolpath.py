"""Cuts of a mould insert: straight finishing passes of a cone with a round tip along the ridges, and G-code.

A pass runs along a ridge at one height: that of a ball of the radius of the tip which rests on the insert. The insert's
valleys become as round as the tip, which are the crests of the part, so that a design with crests of that radius is
what the tool leaves. Passes end where the ball would touch the drafted border of its field. The flanks of the cone
touch nothing where their half angle is not greater than the draft.

The machine has three axes, millimetres, and a control with subprograms (M98 P…, M99): one subprogram a class, in
increments, called at the middle of each of its fields. It is engraving with a spindle at constant feed; roughing, and
wear of the tip, are left to the machine's own programs.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.plates import FLAT, LAND_SHARE
from anisoscope.sim.design.solids import Body

SCALLOP_UM = 0.02
"""Height of what stays between two passes on a level floor."""
SAMPLES = 2000
"""Of the profile, a pitch."""
CLEARANCE_MM, SAFE_MM = 0.02, 1.0
"""Above the insert: between two passes, and at the beginning and end of the program."""
DIGITS = 5
"""Decimals of millimetres in files: ten nanometres."""
FIRST_PROGRAM = 1000
COMMENT = "(three axes, millimetres, subprograms, zero at the lower left corner of the upper face)"


@dataclass(frozen=True)
class Tool:
    """A cone with a round tip.

    Attributes:
        tip_um: radius of the tip.
        half_angle_deg: between flank and axis.
        feed_mm_min: of a cut.
        spindle_rpm: speed.
    """

    tip_um: float
    half_angle_deg: float
    feed_mm_min: float = 100.0
    spindle_rpm: float = 40000.0

    def check(self, design: RidgeDesign) -> None:
        """Check that the tool cuts such ridges.

        Raises:
            UsageError: no tip radius, or flanks that are less steep than the walls.
        """
        if self.tip_um <= 0.0:
            raise UsageError("a path needs the radius of the tool's tip: give --tool-radius")
        draft = float(np.degrees(design.draft_rad))
        if self.half_angle_deg > draft * (1.0 + 1e-9):
            raise UsageError(
                f"a tool with a half angle of {self.half_angle_deg:g}° does not reach walls with a draft of {draft:g}°"
                ": give a larger --draft, or a smaller --tool-half-angle"
            )

    @property
    def step_um(self) -> float:
        """Distance of two passes, at which `SCALLOP_UM` stays between them."""
        return float(np.sqrt(8.0 * self.tip_um * SCALLOP_UM))


def tip_heights(design: RidgeDesign, tip_um: float) -> tuple[FloatArray, FloatArray]:
    """Places (N,) within a pitch in µm, and heights (N,) of the tip that rests there on the insert, mirror undone."""
    step = design.pitch_um / SAMPLES
    place = step * np.arange(SAMPLES, dtype=np.float64)
    reach = int(np.ceil(tip_um / step))
    insert = -design.profile(place)
    off = np.clip(step * np.arange(-reach, reach + 1), -tip_um, tip_um)
    ball = np.sqrt(np.maximum(tip_um**2 - off**2, 0.0)) - tip_um
    around = np.pad(insert, reach, mode="wrap")
    windows = np.lib.stride_tricks.sliding_window_view(around, 2 * reach + 1)
    return place, np.asarray((windows + ball).max(axis=1))


def field_passes(design: RidgeDesign, side_um: float, azimuth_deg: float, tool: Tool) -> FloatArray:
    """(N, 5) passes of a field of the insert in µm about its middle: x and y of begin and end, and z of the tip.

    Every other pass runs backward.
    """
    place, tip = tip_heights(design, tool.tip_um)
    count = int(np.ceil(design.pitch_um / tool.step_um))
    deepest = float(place[int(np.argmin(tip))])
    inner, half = (0.5 - LAND_SHARE) * side_um, 0.5 * side_um
    turn, draft = np.radians(azimuth_deg), design.draft_rad
    cos, sin = round(float(np.cos(turn)), 15), round(float(np.sin(turn)), 15)
    reach = inner * (abs(cos) + abs(sin))
    step = design.pitch_um / count
    first = int(np.ceil((half - reach - deepest) / step))
    last = int(np.floor((half + reach - deepest) / step))
    found = list[tuple[float, ...]]()
    for across in (deepest + step * np.arange(first, last + 1)).tolist():
        z = float(np.interp(across % design.pitch_um, place, tip, period=design.pitch_um))
        centre = z + tool.tip_um
        off = max(0.0, (tool.tip_um - centre * np.sin(draft)) / np.cos(draft))  # from the foot of the border
        ends = _within((cos * (across - half), sin * (across - half)), (-sin, cos), inner - off)
        if ends is not None:
            (x0, y0), (x1, y1) = ends if len(found) % 2 == 0 else ends[::-1]
            found.append((-x0, y0, -x1, y1, z))  # the insert is mirrored
    return np.array(found).reshape(-1, 5)


def _within(
    point: tuple[float, float], along: tuple[float, float], half: float
) -> tuple[tuple[float, float], tuple[float, float]] | None:
    """Ends of a line within a square, or None."""
    low, high = -np.inf, np.inf
    for start, way in zip(point, along, strict=True):
        if abs(way) < 1e-12:
            if abs(start) > half:
                return None
            continue
        ends = sorted(((-half - start) / way, (half - start) / way))
        low, high = max(low, ends[0]), min(high, ends[1])
    if high <= low:
        return None
    first, last = ((point[0] + t * along[0], point[1] + t * along[1]) for t in (low, high))
    return first, last


@dataclass(frozen=True, eq=False)
class InsertPath:
    """Cuts of an insert.

    Attributes:
        body: the plate.
        tool: what cuts.
        passes: by class, (N, 5) as of `field_passes`.
    """

    body: Body
    tool: Tool
    passes: dict[str, FloatArray]

    def middles_mm(self, letter: str) -> FloatArray:
        """(F, 2) middles of the fields of a class on the insert, from its lower left corner, row by row."""
        fields = self.body.fields(letter)
        fields[:, 0] = self.body.plan.shape[1] - 1 - fields[:, 0]
        order = np.lexsort((np.where(fields[:, 1] % 2 == 0, fields[:, 0], -fields[:, 0]), fields[:, 1]))
        return np.asarray((fields[order] + 0.5) * self.body.plan.module_mm)

    @property
    def length_m(self) -> float:
        """Length of all cuts."""
        total = 0.0
        for letter, cuts in self.passes.items():
            total += len(self.body.fields(letter)) * float(np.hypot(*(cuts[:, 2:4] - cuts[:, :2]).T).sum())
        return 1e-6 * total


def insert_path(body: Body, tool: Tool) -> InsertPath:
    """Cuts of the insert of a plate.

    Raises:
        UsageError: the tool does not cut such ridges, or the plate has flat fields only.
    """
    if any(FLAT in row for row in body.plan.rows):
        raise UsageError(
            "a path for a plate with flat fields is not made: give all fields of the plan ridges"
        )
    passes = {}
    for letter in body.plan.letters:
        design = body.plan.design_of(letter, body.design)
        tool.check(design)
        passes[letter] = field_passes(design, body.side_um, body.plan.azimuths_deg[letter], tool)
    return InsertPath(body, tool, passes)


def write_passes(path: InsertPath, passes: Path, fields: Path) -> None:
    """Write the cuts as two tables in mm: passes of every class about the middle of a field, and middles of fields.

    Raises:
        HeightMapError: a file cannot be written.
    """
    lines = ["class,x_begin_mm,y_begin_mm,x_end_mm,y_end_mm,z_mm"]
    for letter, cuts in path.passes.items():
        lines += [
            f"{letter}," + ",".join(f"{one:.{DIGITS}f}" for one in row) for row in (1e-3 * cuts).tolist()
        ]
    _write(passes, lines)
    lines = ["class,x_mm,y_mm"]
    for letter in path.passes:
        lines += [f"{letter},{x:.{DIGITS}f},{y:.{DIGITS}f}" for x, y in path.middles_mm(letter).tolist()]
    _write(fields, lines)


def write_gcode(path: InsertPath, file: Path) -> None:
    """Write the cuts as a program for the machine of this module.

    Raises:
        HeightMapError: the file cannot be written.
    """
    tool = path.tool
    lines = [
        "%",
        "O0001",
        COMMENT,
        f"(cone with a half angle of {tool.half_angle_deg:g} deg, tip radius {1e-3 * tool.tip_um:g} mm)",
        "G21 G90 G94",
        f"S{tool.spindle_rpm:.0f} M3",
        f"G0 Z{SAFE_MM:.{DIGITS}f}",
    ]
    for number, letter in enumerate(path.passes, FIRST_PROGRAM):
        for x, y in path.middles_mm(letter).tolist():
            lines += [
                f"G0 X{x:.{DIGITS}f} Y{y:.{DIGITS}f}",
                f"G0 Z{CLEARANCE_MM:.{DIGITS}f}",
                f"M98 P{number}",
            ]
        lines.append(f"G0 Z{SAFE_MM:.{DIGITS}f}")
    lines += ["M5", "M30"]
    for number, cuts in enumerate(path.passes.values(), FIRST_PROGRAM):
        lines += [
            f"O{number}",
            f"(class {number - FIRST_PROGRAM + 1} of the tables)",
            "G91",
            *_moves(cuts, tool),
            "G90",
            "M99",
        ]
    _write(file, [*lines, "%"])


def _moves(cuts_um: FloatArray, tool: Tool) -> list[str]:
    """Increments of the passes of a field, from its middle at the clearance and back; rounding does not add up."""
    unit = 10**DIGITS
    whole = np.rint(1e-3 * cuts_um * unit).astype(np.int64).tolist()
    above = round(CLEARANCE_MM * unit)
    at, lines = [0, 0], list[str]()

    def go(kind: str, x: int, y: int) -> None:
        lines.append(f"{kind} X{(x - at[0]) / unit:.{DIGITS}f} Y{(y - at[1]) / unit:.{DIGITS}f}")
        at[:] = x, y

    for x0, y0, x1, y1, z in whole:
        go("G0", x0, y0)
        lines.append(f"G1 Z{(z - above) / unit:.{DIGITS}f} F{tool.feed_mm_min:g}")
        go("G1", x1, y1)
        lines.append(f"G0 Z{(above - z) / unit:.{DIGITS}f}")
    go("G0", 0, 0)
    return lines


def _write(path: Path, lines: list[str]) -> None:
    try:
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise HeightMapError(f"{path}: cannot be written ({error.strerror})") from None
