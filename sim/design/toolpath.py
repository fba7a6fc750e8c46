"""Cuts of a mould insert: straight finishing passes of a cone with a round tip along the ridges, and G-code.

A pass runs along a ridge at one height: that of a ball of the radius of the tip which touches the outline of the ridges
(`anisoscope.parameters.ridge_outline`). The insert's valleys become as round as the tip, which are the crests of the
part, so that a design with crests of that radius is what the tool leaves. Passes are evenly spaced along facet and
wall, and around the insert's edges where the feet of the part are rounded; a flank of the cone that is as steep as the
wall cuts it from the valley. Passes end where the ball would touch the drafted border of its field, in whose corners it
leaves its radius.

The machine has three axes, millimetres, and a control with subprograms (M98 P…, M99): one subprogram a class, in
increments, called at the middle of each of its fields. It is engraving with a spindle at constant feed; roughing, and
wear of the tip, are left to the machine's own programs.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError, UsageError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.plates import FLAT, LAND_SHARE
from anisoscope.sim.design.solids import Body

SCALLOP_UM = 0.015
"""Height of what stays between two passes, along the normal of the surface."""
RAPID_MM_MIN = 1000.0
"""Speed of all that is no cut, for the time of the program."""
CLEARANCE_MM, SAFE_MM = 0.02, 1.0
"""Above the insert: between two passes, and at the beginning and end of the program."""
DIGITS = 6
"""Decimals of millimetres in files: nanometres."""
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
            UsageError: no tip radius, crests of another one, or flanks that are less steep than the walls.
        """
        if self.tip_um <= 0.0:
            raise UsageError("a path needs the radius of the tool's tip: give --tool-radius")
        if not np.isclose(self.tip_um, design.edge_radius_um):
            raise UsageError(
                f"a tip of {self.tip_um:g} µm does not leave crests of {design.edge_radius_um:g} µm: give both one "
                "radius"
            )
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


def tip_places(design: RidgeDesign, tool: Tool) -> tuple[FloatArray, FloatArray]:
    """Places (N,) in µm from an uncut crest, and heights (N,) of the tip on the insert, mirror undone, of a pitch."""
    arc, foot = design.crest_arc(), design.foot_arc()
    steep = np.degrees(design.draft_rad) <= tool.half_angle_deg * (1.0 + 1e-9)
    centres = [np.column_stack([arc.x_um, arc.z_um])]
    around = replace(foot, radius_um=foot.radius_um - tool.tip_um)
    for turn, period in ((foot.last_rad, 0.0), (foot.first_rad, design.pitch_um)):
        if period and steep:  # the flank cuts the wall
            continue
        end = np.column_stack(around.at(turn)) - [period, 0.0]
        count = int(np.ceil(float(np.hypot(*(end - centres[0])[0])) / tool.step_um))
        centres.append(centres[0] + (end - centres[0]) * np.arange(1.0, count + 1)[:, None] / max(count, 1))
    if design.foot_radius_um > 0.0:
        # scallops on a convex edge are those of a blunter tip
        blunt = replace(tool, tip_um=1.0 / (1.0 / tool.tip_um + 1.0 / design.foot_radius_um))
        length = float((foot.first_rad - foot.last_rad)[0]) * design.foot_radius_um
        turns = np.linspace(foot.last_rad[0], foot.first_rad[0], int(np.ceil(length / blunt.step_um)) + 1)
        centres.append(np.column_stack([one[0] for one in around.at(turns[None])])[1:])
    place, height = np.concatenate(centres).T
    order = np.argsort(place)
    return place[order], -height[order] - tool.tip_um


def field_passes(design: RidgeDesign, side_um: float, azimuth_deg: float, tool: Tool) -> FloatArray:
    """(N, 5) passes of a field of the insert in µm about its middle: x and y of begin and end, and z of the tip.

    Every other pass runs backward.
    """
    places, tips = tip_places(design, tool)
    inner, half = (0.5 - LAND_SHARE) * side_um, 0.5 * side_um
    turn, draft = np.radians(azimuth_deg), design.draft_rad
    cos, sin = round(float(np.cos(turn)), 15), round(float(np.sin(turn)), 15)
    reach = inner * (abs(cos) + abs(sin)) + design.pitch_um
    periods = np.arange(
        np.floor((half - reach) / design.pitch_um), np.ceil((half + reach) / design.pitch_um) + 1
    )
    found = list[tuple[float, ...]]()
    everywhere = (places + design.pitch_um * periods[:, None]).ravel()
    for across, z in zip(everywhere.tolist(), np.tile(tips, len(periods)).tolist(), strict=True):
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

    @property
    def minutes(self) -> float:
        """Time of the program: cuts and plunges at the feed, all else at `RAPID_MM_MIN`; without acceleration."""
        cut, rapid = 1e3 * self.length_m, 2.0 * (SAFE_MM + CLEARANCE_MM)
        for letter, cuts in self.passes.items():
            middles = self.middles_mm(letter)
            ways = (
                np.vstack([np.zeros(2), cuts[:, :2], np.zeros(2)]),
                np.vstack([np.zeros((1, 2)), cuts[:, 2:4]]),
            )
            between = np.hypot(*(ways[0][1:] - ways[1]).T).sum()
            down = np.sum(CLEARANCE_MM - 1e-3 * cuts[:, 4])
            cut += len(middles) * float(down)
            rapid += len(middles) * float(down + 1e-3 * between)
            rapid += float(np.hypot(*np.diff(middles, axis=0, prepend=0.0).T).sum()) + SAFE_MM
        return cut / self.tool.feed_mm_min + rapid / RAPID_MM_MIN


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
        f"(about {path.minutes:.0f} min at this feed)",
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
