"""How often wafers get which verdict with waves of their edges, by the whole decision; nothing here is the predictor's.

The world is written here: masks that are drawn wider by morphology, their Fourier coefficients by a matrix, a strip of
complex strength along every edge for each polarisation, and a lamp of points whose orders fall into the lens or not.
Parts vary as the demo's recipe says; pictures add 0.3 %. ANISOSCOPE_WRITE_DOCS=1 writes the table of
docs/evidence/wafers.md anew.
"""

import os
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import tomli_w
from scipy.stats import binomtest

from anisoscope.decision.decision import decide
from anisoscope.decision.reference_parts import GoldenPart
from anisoscope.kinds.wafers.kind import OPTICS, WaferSet
from anisoscope.kinds.wafers.recipe import WaferRecipe
from anisoscope.operations.demo import wafers as demo
from anisoscope.prediction.expectation import Component, expectation

PAGE = Path(__file__).parents[4] / "docs" / "evidence" / "wafers.md"
BEGIN, END = "<!-- table of verdicts: begin -->", "<!-- table of verdicts: end -->"
SEEDS = (3, 5)
DOTS, POINTS, NODES = 2, 128, 5
PICTURES = 0.003
GOLDEN, A_SET = (3, 20), 10  # golden wafers of a set, and wafers that are compared with it on the same rig
OF_THE_RIG = ("wavelength_nm", "bandwidth_nm", "lamp_half_angle_deg", "aperture_half_angle_deg")
TOLERANCE = 0.6

BOUND_UM = 0.208
"""Of 0.4 wavelengths at 130 nm and 520 nm (record 0028), in the widening that stands for the edges."""

TE, TM = -0.073 - 0.135j, -0.114 + 0.073j
"""The same of aluminium, from rigorous waves: field along the edges, across them (tile0 of edges.csv)."""


def alike(widening_um):
    """Edges that do the same to both polarisations, in any phase."""

    def drawn(rng):
        strength = widening_um * np.exp(2j * np.pi * rng.random())
        return [(strength, strength)]

    return drawn


def aluminium(_rng):
    """Light polarised along y, then along x: what edges along y, and along x, do to it."""
    return [(TE, TM), (TM, TE)]


@dataclass(frozen=True, eq=False)
class Case:
    """Wafers of each tile, how many may fail, what must find all, and how many are compared with golden ones."""

    edges: str
    title: str
    count: int
    golden: int = 0
    wrong: dict = field(default_factory=dict)
    most: int | None = None
    found: str = ""


EDGES = {"aluminium": aluminium, "at the bound": alike(BOUND_UM), "twice the bound": alike(2.0 * BOUND_UM)}
CASES = (
    Case("aluminium", "good", 25, 200, most=1),
    Case("aluminium", "10 nm too deep", 4, 20, {"over_etch_nm": 10.0}),
    Case("aluminium", "20 nm too deep", 4, 20, {"over_etch_nm": 20.0}, found="own golden"),
    Case("aluminium", "320 nm too wide", 4, 20, {"width_bias_nm": 320.0}),
    Case("aluminium", "640 nm too wide", 4, 20, {"width_bias_nm": 640.0}, found="golden"),
    Case("at the bound", "good", 10, most=1),
    Case("at the bound", "20 nm too deep", 3, 0, {"over_etch_nm": 20.0}, found="own golden"),
    Case("twice the bound", "good", 4),
)
VERDICTS = ("PASS", "INCONCLUSIVE", "FAIL")


class Mask:
    """Fourier coefficients of the etched area of a tile at any width, and of its edges."""

    def __init__(self, height_um, pixel_um, reach=0.32):
        area = (height_um < 0.5 * height_um.min()).astype(np.float32)
        points = len(area)
        self.side, self.depth, self._pixel = points * pixel_um, -float(height_um.min()), pixel_um
        self.k = np.arange(-int(reach * self.side), int(reach * self.side) + 1)
        self._wave = np.exp(-2j * np.pi * np.outer(self.k, (np.arange(points) + 0.5) / points)) / points
        self._wave = self._wave.astype(np.complex64)
        box, after = np.sinc(self.k / points), np.exp(-1j * np.pi * self.k / points)
        self._box = np.outer(box, box)
        jump = [np.abs(area - np.roll(area, -1, axis)) for axis in (1, 0)]
        self.edges = (
            self._spectrum(jump[0]) * np.outer(box, after) / pixel_um,
            self._spectrum(jump[1]) * np.outer(after, box) / pixel_um,
        )
        self._drawn = {}
        for side, change in ((1.0, cv2.dilate), (-1.0, cv2.erode)):
            moved, self._drawn[side] = np.pad(area, 4, mode="wrap"), []
            for _ in range(4):
                self._drawn[side].append(self._spectrum(moved[4:-4, 4:-4]) * self._box)
                moved = change(moved, np.ones((3, 3), np.uint8))

    def _spectrum(self, picture):
        return self._wave @ picture @ self._wave.T

    def wider(self, by_um):
        """By a cubic through edges that moved by 0, 1, 2 and 3 pixels."""
        at = abs(by_um) / (2.0 * self._pixel)
        share = [np.prod([(at - j) / (i - j) for j in range(4) if j != i]) for i in range(4)]
        return sum(a * b for a, b in zip(share, self._drawn[1.0 if by_um > 0.0 else -1.0], strict=True))


def turned(axis, degrees):
    """Rotation about x (0), y (1) or z (2)."""
    found, (i, j) = np.eye(3), ((1, 2), (2, 0), (0, 1))[axis]
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    found[i, i] = found[j, j] = cosine
    found[i, j], found[j, i] = -sine, sine
    return found


def cone(axis, half_deg):
    """(N, 3) directions that stand for equal shares of a lamp, on a spiral."""
    radius = np.sin(np.radians(half_deg)) * np.sqrt((np.arange(POINTS) + 0.5) / POINTS)
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(POINTS)
    across = np.cross(axis, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    along = np.cross(axis, across)
    off = radius[:, None] * (np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * along)
    return off + np.sqrt(1.0 - radius[:, None] ** 2) * axis


def radiance(mask, wafer, edges, light, camera):
    """Of one pose: Kirchhoff's efficiencies of the orders, times the share of the lamp that reaches the lens."""
    area, depth = mask.wider(1e-3 * wafer["width_bias_nm"]), mask.depth + 1e-3 * wafer["over_etch_nm"]
    lamp, lens = (wafer[f"{name}_half_angle_deg"] for name in ("lamp", "aperture"))
    points, total, middle = cone(light, lamp), 0.0, light + camera
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    for node, weight in zip(nodes, weights / weights.sum(), strict=True):
        um = 1e-3 * (wafer["wavelength_nm"] + node * wafer["bandwidth_nm"] / 2.3548)
        wide = 1.05 * (np.sin(np.radians(lamp)) + np.sin(np.radians(lens))) / um
        cut = [np.flatnonzero(np.abs(mask.k / mask.side - at / um) < wide) for at in middle[:2]]
        qx, qy = (mask.k[found] / mask.side for found in cut)
        near = np.ix_(cut[1], cut[0])
        step = np.exp(2j * np.pi * middle[2] / um * depth) - 1.0
        spike = np.outer(qy == 0.0, qx == 0.0)
        along, across = (0.5 * spectrum[near] for spectrum in mask.edges)
        waves = [spike + step * (area[near] + one[0] * along + one[1] * across) for one in edges]
        power = np.mean(np.abs(waves) ** 2, axis=0)
        x = um * qx[None, None, :] - points[:, 0, None, None]
        y = um * qy[None, :, None] - points[:, 1, None, None]
        z = np.sqrt(1.0 - x**2 - y**2)
        inside = x * camera[0] + y * camera[1] + z * camera[2] >= np.cos(np.radians(lens))
        total += weight * float(np.sum(power * inside.mean(axis=0)))
    slant = (1.0 + light @ camera) / (light[2] + camera[2])
    mirrored = total * slant**2 / camera[2] / (np.pi * np.sin(np.radians(lens)) ** 2)
    share = wafer["scatter"]
    return wafer["reflectance"] * ((1.0 - share) * mirrored + share / np.pi * light[2])


class World:
    """The demo's recipe with a tile of its own, and parts of it."""

    def __init__(self, folder, seed):
        self.seed, self.rng = seed, np.random.default_rng(seed)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(demo, "DOTS", DOTS)
            patch.setattr(demo, "TILE_UM", DOTS * demo.DOT_UM)
            demo.write_tile(folder, self.rng)
            table = demo.recipe()
        (folder / "recipe.toml").write_text(tomli_w.dumps(table))
        self.recipe = WaferRecipe.read(folder / "recipe.toml")
        table["decision"] |= {"tolerance": [TOLERANCE] * 4}
        (folder / "tolerance.toml").write_text(tomli_w.dumps(table))
        self.tolerance = WaferRecipe.read(folder / "tolerance.toml")
        self.expected = expectation(self.recipe, 0.0, OPTICS)
        with np.load(folder / "tile.npz") as file:
            height, pixel = file["height_um"], float(file["pixel_um"][1])
        self.mask = Mask(height, pixel)

    def seen(self, wafer, edges, seat=(0.0, 0.0), light_deg=0.0, tilt_deg=0.0):
        """Radiances of all poses; light and camera turn about the part, whose seat is off."""
        askew, found = turned(0, seat[0]) @ turned(1, seat[1]), []
        for pose in self.expected.poses:
            part = turned(2, -pose.stage_deg) @ turned(0, pose.tilt_deg + tilt_deg)
            camera, light = part @ [0.0, 0.0, 1.0], part @ turned(1, light_deg) @ [0.0, 0.0, 1.0]
            found.append(radiance(self.mask, wafer, edges, light @ askew, camera @ askew))
        return np.array(found)

    def rig(self):
        """Lamp and lens, light angle and zero of the tilt."""
        drawn, stated = demo.sample("good", self.rng)["wafer"], self.recipe.uncertainty
        angles = [u * self.rng.standard_normal() for u in (stated.light_angle_deg, stated.tilt_deg)]
        return {key: drawn[key] for key in OF_THE_RIG}, *angles

    def part(self, edges, rig=None, **wrong):
        """What a rig measures of a part; None: one of its own."""
        table = demo.sample("good", self.rng)
        lamp, light, tilt = rig or self.rig()
        wafer = table["wafer"] | lamp
        for key, value in wrong.items():
            wafer[key] += value
        found = self.seen(wafer, edges, table["seating_tilt_deg"], light, tilt)
        found *= np.exp(PICTURES * self.rng.standard_normal(len(found)))
        own = tuple(
            Component(source, "measurement", np.full(len(found), share), shared=False)
            for source, share in (("pictures", PICTURES), ("points of the lamp", 0.001))
        )
        return SimpleNamespace(radiance=found, components=own, cells=None, grid=None, mirroring=None)

    def golden(self, edges, rig, count):
        """Good wafers with these edges, on one rig."""
        poses = tuple((pose.stage_deg, pose.tilt_deg) for pose in self.expected.poses)
        rows = tuple(
            GoldenPart(
                serial=str(number),
                inspected_at="",
                log_radiance=tuple(np.log(self.part(edges, rig).radiance).tolist()),
                area_share=None,
                verdict="PASS",
            )
            for number in range(count)
        )
        return WaferSet(product="wafers", recipe_key="", poses=poses, parts=rows)

    def verdicts(self, case):
        """(by the prediction, with a tolerance besides) of every wafer of a case."""
        found = []
        for _ in range(case.count):
            part = self.part(EDGES[case.edges](self.rng), **case.wrong)
            first = decide(self.expected, part, self.recipe, exclude=False)
            with pytest.MonkeyPatch.context() as patch:  # the same distance is not sought twice
                known = first.d2, first.dof, first.p_value
                patch.setattr("anisoscope.decision.decision.from_prediction", lambda *_, known=known: known)
                found.append(
                    (first.verdict, decide(self.expected, part, self.tolerance, exclude=False).verdict)
                )
        return found

    def against_golden(self, case, count):
        """Decisions about wafers that are compared with good ones of the same edges and rig; drawn for themselves."""
        self.rng = np.random.default_rng([self.seed, CASES.index(case), count])
        found, edges = [], EDGES[case.edges](self.rng)
        for number in range(case.golden):
            if number % A_SET == 0:
                rig = self.rig()
                golden = self.golden(edges, rig, count)
            part = self.part(edges, rig, **case.wrong)
            found.append(decide(self.expected, part, self.recipe, golden, exclude=False))
        return found


def cell(found):
    """Counts of PASS, INCONCLUSIVE and FAIL, and the interval of FAIL in percent (95 %, Clopper and Pearson)."""
    if not found:
        return "–"
    counts = Counter(str(one) for one in found)
    assert set(counts) <= set(VERDICTS)
    ends = binomtest(counts["FAIL"], len(found)).proportion_ci(method="exact")
    return f"{' / '.join(str(counts[one]) for one in VERDICTS)} ({100 * ends.low:.0f} to {100 * ends.high:.0f} %)"


def tile_of(seed, folder):
    """Verdicts of all cases with one tile; what must hold of each tile is asserted."""
    world, found = World(folder, seed), {}
    nominal = {**demo.sample("good", world.rng)["wafer"], **demo.LIGHT}
    nominal |= {"over_etch_nm": 0.0, "width_bias_nm": 0.0, "reflectance": 0.9, "scatter": 0.001}
    assert world.seen(nominal, [(0.0, 0.0)]) == pytest.approx(world.expected.radiance, rel=0.004)
    for case in CASES:
        own, tolerated = zip(*world.verdicts(case), strict=True)
        golden = []
        for count in GOLDEN:
            decided = world.against_golden(case, count)
            golden.append([one.verdict for one in decided])
            if case.most is not None and decided:  # more than 7 of 200 at 0.01: one of 1,000 runs
                below = [sum(one.p_value < level for one in decided) for level in (0.001, 0.01)]
                print(f"{count} golden wafers: {below} of {len(decided)} good ones below 0.001 and 0.01")  # noqa: T201
                assert below[0] <= 2
                assert below[1] <= 7
        found[case] = own, tolerated, *golden
        cells = "; ".join(cell(one) for one in found[case])
        print(f"tile {seed}, {case.edges}, {case.title}: {cells}", flush=True)  # noqa: T201 - what the study found
        if case.most is not None:
            assert own.count("FAIL") <= case.most
        if "own" in case.found:
            assert set(own) == {"FAIL"}
        if "golden" in case.found:
            assert set(golden[-1]) <= {"FAIL"}
    return found


@pytest.mark.statistics
def test_verdicts_of_wafers_with_waves_of_their_edges(tmp_path):
    """Two tiles. At the level 0.001 more than one good wafer of 25 fails in one of 3,400 runs."""
    tiles = []
    for seed in SEEDS:
        (tmp_path / str(seed)).mkdir()
        tiles.append(tile_of(seed, tmp_path / str(seed)))
    lines = [
        "| edges | wafers | as predicted | with a tolerance of ±0.6 too | 3 golden wafers | 20 golden wafers |",
        "|---|---|---|---|---|---|",
    ]
    for case in CASES:
        together = [cell([*one, *other]) for one, other in zip(*(tile[case] for tile in tiles), strict=True)]
        lines.append(f"| {case.edges} | {case.title} | " + " | ".join(together) + " |")
    table = "\n".join(lines)
    print(table)  # noqa: T201 - what the study found
    if os.environ.get("ANISOSCOPE_WRITE_DOCS") == "1":
        text = PAGE.read_text(encoding="utf-8")
        before, after = text.partition(BEGIN)[0], text.partition(END)[2]
        PAGE.write_text(f"{before}{BEGIN}\n\n{table}\n\n{END}{after}", encoding="utf-8")
