"""Cuts of an insert: the program, read by another parser and run on a block, leaves the insert of the design."""

import csv
from dataclasses import replace

import numpy as np
import pytest
from gcodeparser import parse_gcode_lines

from anisoscope.base.errors import UsageError
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.plates import Plan
from anisoscope.sim.design.solids import Body, write_body
from anisoscope.sim.design.toolpath import (
    CLEARANCE_MM,
    RAPID_MM_MIN,
    SCALLOP_UM,
    Tool,
    insert_path,
    write_gcode,
    write_passes,
)

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


def run(path, file):
    """Cuts (N, 6) in µm of the program of a path."""
    write_gcode(path, file)
    assert file.read_text(encoding="ascii").count("M98") == 4
    machine = Machine()
    found = 1000.0 * machine.run(file.read_text())
    assert machine.place[2] == pytest.approx(1.0)
    return found


@pytest.fixture(scope="module")
def cuts(path, tmp_path_factory):
    return run(path, tmp_path_factory.mktemp("path") / "insert.nc")


def left(cuts, places, tool):
    """Height in µm that a cone with a round tip leaves at places (M, 2); 0 where nothing was cut."""
    height = np.zeros(len(places))
    lean = np.radians(tool.half_angle_deg)
    for x0, y0, z, x1, y1, _ in cuts:
        start, way = np.array([x0, y0]), np.array([x1 - x0, y1 - y0])
        share = np.clip((places - start) @ way / max(way @ way, 1e-12), 0.0, 1.0)
        off = np.hypot(*(places - start - share[:, None] * way).T)
        ball = TIP - np.sqrt(np.maximum(TIP**2 - off**2, 0.0))
        edge = TIP * np.cos(lean)
        cone = TIP * (1.0 - np.sin(lean)) + (off - edge) / np.tan(lean)
        height = np.minimum(height, z + np.where(off < edge, ball, cone))
    return height


def on_insert(tmp_path, body, count=4000):
    """Points (M, 3) in µm on the STL of the insert, as another program reads it, and their normals."""
    import pyvista

    write_body(body, tmp_path / "insert.stl", "insert")
    mesh = pyvista.read(tmp_path / "insert.stl")
    corners = 1000.0 * np.asarray(mesh.points, np.float64)[mesh.faces.reshape(-1, 4)[:, 1:]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    upper = np.flatnonzero(normal[:, 2] > 1e-6 * area)
    rng = np.random.default_rng(1)
    one = rng.choice(upper, count, p=area[upper] / area[upper].sum())
    weight = rng.dirichlet([1.0, 1.0, 1.0], count)
    return np.einsum("nk,nkc->nc", weight, corners[one]), normal[one] / area[one, None]


@pytest.mark.parametrize(("half_angle", "foot"), [(DRAFT, 0.0), (4.0, 0.0), (4.0, 1.0)])
def test_the_cut_block_is_the_insert_and_no_deeper_anywhere(tmp_path, judged_figure, half_angle, foot):
    """Within .02 µm along the normal of the STL; corners of borders keep the radius of the tip."""
    tool, body = Tool(TIP, half_angle), Body(PLAN, replace(DESIGN, foot_radius_um=foot), 100.0)
    cuts = run(insert_path(body, tool), tmp_path / "insert.nc")
    points, normal = on_insert(tmp_path, body)
    off = (left(cuts, points[:, :2], tool) - points[:, 2]) * normal[:, 2]
    assert off.min() > -0.015  # chords of the STL, and what files round
    fields = points[:, :2] % 100.0 - 50.0
    inside = np.abs(fields).max(axis=1) < 50.0 - 0.2 - 2.0 * TIP - 15.0 * np.tan(np.radians(DRAFT))
    assert inside.sum() > 2000
    assert np.abs(off[inside]).max() < 0.02
    assert np.quantile(off[inside], 0.9) > 0.5 * SCALLOP_UM
    what = f"block cut by the G-code, tool of {half_angle:g}°, feet of {foot:g} µm"
    off = np.abs(off[inside]).max()
    judged_figure("Outline", what, "STL by VTK, G-code by another parser", f"{off:.3f} µm", "0.02 µm")


def test_time_is_that_of_feed_and_rapids(path, cuts, judged_figure):
    plunges = np.sum(CLEARANCE_MM - 1e-3 * cuts[:, 2])
    cutting = (1e3 * path.length_m + plunges) / TOOL.feed_mm_min
    assert cutting < path.minutes < cutting + 1.5 * (plunges + 2.0 * 1e3 * path.length_m) / RAPID_MM_MIN
    assert insert_path(path.body, replace(TOOL, feed_mm_min=200.0)).minutes == pytest.approx(
        path.minutes - 0.5 * cutting
    )
    judge = f"cuts and plunges alone: {cutting:.2f} min"
    judged_figure("Outline", "milling time of four fields", judge, f"{path.minutes:.2f} min", "stated")


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
        (Tool(2.0, 5.0), PLAN, "a tip of 2 µm does not leave crests of 1.5 µm"),
        (TOOL, Plan(("A.",), {"A": 0.0}, 0.1), "flat fields is not made"),
    ],
)
def test_what_the_tool_cannot_cut_is_refused(tool, plan, match):
    with pytest.raises(UsageError, match=match):
        insert_path(Body(plan, DESIGN, 100.0), tool)
