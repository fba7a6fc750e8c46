"""Cuts of an insert: the program, read by another parser and run on a block, leaves the insert of the design."""

import csv

import numpy as np
import pytest
from gcodeparser import parse_gcode_lines

from anisoscope.base.errors import UsageError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.plates import Plan
from anisoscope.sim.design.solids import Body
from anisoscope.sim.design.toolpath import SCALLOP_UM, Tool, insert_path, write_gcode, write_passes

DRAFT, TIP = 10.0, 1.5
PLAN = Plan(("AB", "ĀA"), {"A": 0.0, "B": -90.0, "Ā": 131.0}, 0.1, {"B": 5.0, "Ā": 16.0})
DESIGN = RidgeDesign(50.0, 10.0, DRAFT, edge_radius_um=TIP)
TOOL = Tool(TIP, DRAFT)


@pytest.fixture(scope="module")
def path():
    return insert_path(Body(PLAN, DESIGN, 100.0), TOOL)


class Machine:
    """Three axes and subprograms: cuts are (N, 6) begin and end in mm."""

    def __init__(self):
        self.place, self.incremental, self.cuts = np.zeros(3), False, []

    def run(self, text):
        starts = {line[1:]: number for number, line in enumerate(text.splitlines()) if line.startswith("O")}
        words, returns, at = list(parse_gcode_lines(text)), [], 0
        while words[at].command != ("M", 30):
            word = words[at]
            at += 1
            if word.command == ("M", 98):
                returns.append(at)
                first = starts[f"{word.params['P']}"]
                at = next(k for k, one in enumerate(words) if one.line_index > first)
            elif word.command == ("M", 99):
                at = returns.pop()
            elif word.command in {("G", 90), ("G", 91)}:
                self.incremental = word.command[1] == 91
            elif word.command in {("G", 0), ("G", 1)}:
                self.move(word, rapid=word.command[1] == 0)
            else:
                assert word.command in {("G", 21), ("G", 94), ("M", 3), ("M", 5)}
        return np.array(self.cuts)

    def move(self, word, *, rapid):
        goal = self.place.copy()
        for number, axis in enumerate("XYZ"):
            if axis in word.params:
                goal[number] = word.params[axis] + (self.place[number] if self.incremental else 0.0)
        low, high = sorted((self.place[2], goal[2]))
        if rapid:  # below the surface it only lifts
            assert low > 0.0 or (np.array_equal(self.place[:2], goal[:2]) and high > 0.0)
        elif low == high:
            self.cuts.append([*self.place, *goal])
        self.place = goal


@pytest.fixture(scope="module")
def cuts(path, tmp_path_factory):
    file = tmp_path_factory.mktemp("path") / "insert.nc"
    write_gcode(path, file)
    assert file.read_text(encoding="ascii").count("M98") == 4
    machine = Machine()
    found = 1000.0 * machine.run(file.read_text())
    assert machine.place[2] == pytest.approx(1.0)
    return found


def left(cuts, places):
    """Height in µm that a cone with a round tip leaves at places (M, 2); 0 where nothing was cut."""
    height = np.zeros(len(places))
    lean = np.radians(TOOL.half_angle_deg)
    for x0, y0, z, x1, y1, _ in cuts:
        start, way = np.array([x0, y0]), np.array([x1 - x0, y1 - y0])
        share = np.clip((places - start) @ way / max(way @ way, 1e-12), 0.0, 1.0)
        off = np.hypot(*(places - start - share[:, None] * way).T)
        ball = TIP - np.sqrt(np.maximum(TIP**2 - off**2, 0.0))
        edge = TIP * np.cos(lean)
        cone = TIP * (1.0 - np.sin(lean)) + (off - edge) / np.tan(lean)
        height = np.minimum(height, z + np.where(off < edge, ball, cone))
    return height


def wanted(places):
    """The insert in µm: the mirrored negative of ridges that a drafted border cuts off."""
    found = np.empty(len(places))
    for number, (x, y) in enumerate(places):
        col, row = int((200.0 - x) // 100.0), 1 - int(y // 100.0)
        letter = PLAN.rows[row][col]
        u, v = (200.0 - x) % 100.0 - 50.0, y % 100.0 - 50.0
        turn = np.radians(PLAN.azimuths_deg[letter])
        ridge = PLAN.design_of(letter, DESIGN).profile(
            np.array([np.cos(turn) * u + np.sin(turn) * v + 50.0])
        )[0]
        border = max(0.0, 49.8 - max(abs(u), abs(v))) / np.tan(np.radians(DRAFT))
        found[number] = -min(ridge, border)
    return found


def test_the_cut_block_is_the_insert_and_no_deeper_anywhere(cuts):
    places = np.random.default_rng(1).uniform(0.0, 200.0, (1500, 2))
    due, cut = wanted(places), left(cuts, places)
    # files round to 10 nm, which is more along z on a steep wall
    assert np.min(cut - due) > -0.01 / np.sin(np.radians(DRAFT))
    assert np.quantile(cut - due, 0.02) > -0.01
    inside = np.abs(places % 100.0 - 50.0).max(axis=1) < 50.0 - 0.2 - 2.0 * TIP - 15.0 * np.tan(
        np.radians(DRAFT)
    )
    assert inside.sum() > 1000
    rest = (cut - due)[inside]  # more than a scallop on the walls, which are nearly upright
    assert np.quantile(rest, 0.95) < 1.2 * SCALLOP_UM
    assert rest.max() < 0.15
    assert rest.mean() < 0.5 * SCALLOP_UM


def test_tables_say_the_same_as_the_program(path, cuts, tmp_path):
    write_passes(path, tmp_path / "passes.csv", tmp_path / "fields.csv")
    with (tmp_path / "passes.csv").open(encoding="utf-8") as stream:
        passes = list(csv.DictReader(stream))
    with (tmp_path / "fields.csv").open(encoding="utf-8") as stream:
        fields = list(csv.DictReader(stream))
    assert len(fields) == 4
    found = []
    for field in fields:
        x, y = float(field["x_mm"]), float(field["y_mm"])
        for one in passes:
            if one["class"] == field["class"]:
                ends = [float(one[name]) for name in ("x_begin_mm", "y_begin_mm", "x_end_mm", "y_end_mm")]
                z = float(one["z_mm"])
                found.append([x + ends[0], y + ends[1], z, x + ends[2], y + ends[3], z])
    np.testing.assert_allclose(1000.0 * np.array(found), cuts, atol=0.02)
    length = np.hypot(cuts[:, 3] - cuts[:, 0], cuts[:, 4] - cuts[:, 1]).sum()
    assert path.length_m == pytest.approx(1e-6 * length, rel=1e-3)


@pytest.mark.parametrize(
    ("tool", "plan", "match"),
    [
        (Tool(TIP, 20.0), PLAN, "a half angle of 20° does not reach walls with a draft of 10°"),
        (Tool(0.0, 5.0), PLAN, "give --tool-radius"),
        (TOOL, Plan(("A.",), {"A": 0.0}, 0.1), "flat fields is not made"),
    ],
)
def test_what_the_tool_cannot_cut_is_refused(tool, plan, match):
    with pytest.raises(UsageError, match=match):
        insert_path(Body(plan, DESIGN, 100.0), tool)
