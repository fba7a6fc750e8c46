"""World of the detection study that Mitsuba 3 renders: stored frames of good and bad parts, judged by ``inspect``.

``tools/render_mitsuba_parts.py`` made the frames. The renderer shares nothing with the prediction. Scatter between
pixels is that of its paths, 10 to 30 % in dim poses, so that cells of the contrast map count as deviating from a ln
ratio of 0.8 on; the means are good to 0.3 %.
"""

import json
import tarfile
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.decision.reference_parts import golden_path, write_golden
from anisoscope.inspection.replay import inspect_frames
from anisoscope.inspection.run import USUAL, Inspected, Methods
from anisoscope.kinds.parts import collecting
from anisoscope.kinds.registry import kind_of
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.record.schema import Particulars, Record
from anisoscope.report.inspection_page import Sections
from anisoscope.report.peers import LotMate
from anisoscope.rig.framefolder import read_counts
from anisoscope.study.statistics import rate

ARCHIVE = Path("tests/data/mitsuba/parts.tar.xz")
UPRIGHT, TILTED = (0.0,), (0.0, -10.0, 10.0)
GOOD = tuple(f"good-{n:02d}" for n in range(1, 13))
GOLDEN = ("good-13", "good-14", "good-15")
ALPHA, ALBEDO, RIDGE_ANGLE_DEG = 0.08, 0.1, 10.0
RESOLVED_ALPHA = 0.03
"""Roughness of the texture that the mesh resolves, and so do the maps; a design has it in the lobe."""
WHOLE_ALPHA = float(np.hypot(ALPHA, RESOLVED_ALPHA))
MAP_UM, NM_PER_COUNT, ZERO = 2.0, 10.0, 1000
CAUSES: dict[str, tuple[str, float | None]] = {
    "angle-1": ("ridge-angle", None),
    "angle-0.5": ("ridge-angle", None),
    "angle+0.5": ("ridge-angle", None),
    "angle+1": ("ridge-angle", None),
    "rough+20": ("roughness", None),
    "rough+60": ("roughness", None),
    "height-loss": ("incomplete-filling", 0.1),
    "wear-5": ("wear", 5.0),
    "wear-10": ("wear", 10.0),
    "burrs-2": ("burrs", 0.02),
    "burrs-10": ("burrs", 0.1),
    "scratches": ("scratches", 40.0),
}
"""By defective part: its cause, and its severity in the unit of the cause; None where the truth of the part says it."""
_ROWS = (
    ("design, upright", UPRIGHT, False, False),
    ("design, tilted", TILTED, False, False),
    ("3 golden parts, upright", UPRIGHT, False, True),
    ("3 golden parts, tilted", TILTED, False, True),
    ("own map, upright", UPRIGHT, True, False),
    ("own map, tilted", TILTED, True, False),
)


@dataclass(frozen=True)
class Parts:
    """Rendered parts, unpacked.

    Attributes:
        folder: one folder a part, ``rig.toml`` and ``parts.json``.
        truth: true values of every part by its name.
    """

    folder: Path
    truth: dict[str, dict[str, Any]]

    @classmethod
    def unpacked(cls, archive: Path, folder: Path) -> "Parts":
        """The parts of an archive, in a folder.

        Raises:
            UsageError: it cannot be read.
        """
        try:
            with tarfile.open(archive) as packed:
                packed.extractall(folder, filter="data")
            truth = json.loads((folder / "parts.json").read_text(encoding="utf-8"))
        except (OSError, tarfile.TarError, ValueError) as problem:
            raise UsageError(
                f"{archive}: no archive of rendered parts ({problem}): it lies in the repository as "
                "tests/data/mitsuba/parts.tar.xz, or tools/render_mitsuba_parts.py renders it"
            ) from problem
        return cls(folder, truth)

    def map_of(self, name: str, path: Path) -> Path:
        """Write the height map of a part, as a profilometer would."""
        height = (read_counts(self.folder / name / "map.png").astype(float) - ZERO) * NM_PER_COUNT / 1000.0
        write_height_map(HeightMap(height, MAP_UM, MAP_UM, {}), path)
        return path

    def severity(self, name: str) -> float:
        """True severity of the defect of a part, in the unit of its cause."""
        cause, severity = CAUSES[name]
        if severity is not None:
            return severity
        truth = self.truth[name]
        if cause == "ridge-angle":
            return float(truth["ridge_angle_deg"]) - RIDGE_ANGLE_DEG
        return float(np.mean(np.hypot(truth["alpha"], truth["texture"]))) / WHOLE_ALPHA - 1.0


class Inspector:
    """Judges rendered parts by one recipe.

    Args:
        parts: the parts.
        out: folder of the inspections.
        tilts_deg: of the poses.
        own_map: every part is compared with its own height map instead of the design.
        lots: parts are compared with their lot, and one that may have a defect is INCONCLUSIVE, as in new recipes.
        methods: what varies, for tests.
    """

    def __init__(
        self,
        parts: Parts,
        out: Path,
        tilts_deg: Sequence[float],
        *,
        own_map: bool = False,
        lots: bool = False,
        methods: Methods = USUAL,
    ) -> None:
        self.parts, self.out, self.tilts_deg = parts, out, tilts_deg
        self.own_map, self.lots, self.methods = own_map, lots, methods
        self._mates: dict[str, LotMate] = {}
        out.mkdir(parents=True, exist_ok=True)
        self._recipe = out / "recipe.toml"
        if not own_map:
            self._write(
                self._recipe, {"design": {"ridge_angle_deg": RIDGE_ANGLE_DEG, "u_ridge_angle_deg": 0.1}}
            )

    def _write(self, path: Path, surface: dict[str, Any]) -> None:
        import tomli_w

        alpha = ALPHA if self.own_map else WHOLE_ALPHA
        table = {
            "schema": 1,
            "product": "ridges rendered by Mitsuba",
            "surface": {"pitch_um": 100.0, **surface},
            "material": {
                "alpha_along": alpha,
                "alpha_across": alpha,
                "u_tail": 0.0,
                "albedo": ALBEDO,
                "u_alpha_share": 0.05,
                "u_albedo": 0.003,
            },
            "poses": {"angles_deg": [0.0, 90.0, 180.0], "tilts_deg": list(self.tilts_deg)},
            "acquisition": {"exposure_s": 0.001, "frames_per_pose": 2, "dark_frames": 2},
            "region": {"size_mm": [2.4, 0.7]},
            "area": {"max_share": 0.02},
            "uncertainty": {"seating_tilt_deg": 0.1},
        }
        if self.lots:
            table["decision"] = {"compare_with_lot": True, "unexcluded": "inconclusive"}
        write_text(path, tomli_w.dumps(table))

    def lot(self, names: Sequence[str]) -> dict[str, Record]:
        """Records of the parts of a lot, each compared with all others of it."""
        for name in names:
            if name not in self._mates:
                alone = self._inspected(name)
                found = LotMate(name, alone.record.product, alone.record.verdict, {}, str(alone.folder))
                self._mates[name] = found
        return {
            name: self._inspected(name, "lot", [self._mates[one] for one in names if one != name]).record
            for name in names
        }

    def record(self, name: str) -> Record:
        """Record of the inspection of a part."""
        return self._inspected(name).record

    def _inspected(self, name: str, lot: str | None = None, mates: Sequence[LotMate] = ()) -> Inspected:
        recipe, serial = self._recipe, name.replace("+", "-plus-")
        if self.own_map:
            recipe = self.out / f"{serial}.toml"
            self._write(recipe, {"height_map": str(self.parts.map_of(name, self.out / f"{serial}.npz"))})
        rig = self.parts.folder / "rig.toml"
        folder = self.parts.folder / name
        return inspect_frames(
            folder,
            recipe,
            serial,
            self.out,
            rig_path=rig,
            particulars=Particulars(lot=lot),
            lot_mates=mates,
            methods=self.methods,
        )

    def learn(self, names: Sequence[str] = GOLDEN) -> "Inspector":
        """Collect golden parts as ``anisoscope golden add`` does."""
        kind = kind_of(self._recipe)
        read: Any = kind.read_recipe(self._recipe)
        known: Any = None
        for name in names:
            known = collecting(kind, read).add_reference(known, read, self.record(name))
        assert known is not None
        write_golden(golden_path(self._recipe), known)
        return self


def _one_line(record: Record, *_: object) -> str:
    """A report of one line: drawing takes longer than all the rest of an inspection."""
    return f"{record.verdict}\n"


QUIET = replace(USUAL, start_renderer=lambda _: None, sections=lambda *_: Sections(), page=_one_line)


def judged(archive: Path, advance: Advance = silent) -> list[dict[str, Any]]:
    """Verdicts on all rendered parts, one entry a reference and set of poses.

    Args:
        archive: of the parts.
        advance: progress.

    Raises:
        UsageError: the archive cannot be read.
    """
    found = []
    with tempfile.TemporaryDirectory() as folder:
        parts = Parts.unpacked(archive, Path(folder) / "parts")
        for number, (title, tilts, own_map, golden) in enumerate(_ROWS):
            inspector = Inspector(parts, Path(folder) / f"{number}", tilts, own_map=own_map, methods=QUIET)
            if golden:
                inspector.learn()
            advance(title, number, len(_ROWS))
            found.append({"where": title, **_row(parts, inspector.record, own_map=own_map)})
    advance("rendered parts", len(_ROWS), len(_ROWS))
    return found


def _row(parts: Parts, record: Callable[[str], Record], *, own_map: bool) -> dict[str, Any]:
    good = [record(name) for name in GOOD]
    passed = rate(np.array([one.verdict == "PASS" for one in good]))
    row: dict[str, Any] = {
        "good": len(good),
        "pass": passed.count,
        "pass_interval": [passed.low, passed.high],
        "p_values": sorted(float(one.p_value) for one in good if one.p_value is not None),
    }
    if own_map:  # a part is never far from its own map
        return row
    bad = {name: record(name) for name in CAUSES}
    row["bad"] = len(bad)
    row["fail"] = sorted(name for name, one in bad.items() if one.verdict == "FAIL")
    row["first"], row["tied"], row["held"], row["severities"] = [], [], [], 0
    for name, one in bad.items():
        causes = () if one.diagnosis is None else one.diagnosis.causes
        right = next((cause for cause in causes if cause.cause == CAUSES[name][0]), None)
        if right is None:
            continue
        if causes[0] is right:
            row["first"].append(name)
        if right.tie:
            row["tied"].append(name)
        if right.interval is not None:
            low, high = right.interval
            truth = parts.severity(name)
            row["severities"] += 1
            if not (low is not None and truth < low) and not (high is not None and truth > high):
                row["held"].append(name)
    return row
