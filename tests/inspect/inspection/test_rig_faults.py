"""The first table of docs/faults.md is what inspections say to faults of the rig.

ANISOSCOPE_WRITE_DOCS=1 with -m soak writes it.

Every fault meets a good and a defective part, on the virtual rig that breaks as its bench file says, or in frames of a
sound inspection that are broken afterwards (``broken_frames``).
"""

import importlib.util
import os
import re
from dataclasses import dataclass
from pathlib import Path

import pytest

from anisoscope.base.errors import AnisoscopeError
from anisoscope.base.language import per_cent
from anisoscope.calibration.fixture import calibrate_fixture
from anisoscope.inspection.replay import inspect_frames
from anisoscope.parameters.taking import Taking

SPEC = importlib.util.spec_from_file_location("broken_frames", Path(__file__).with_name("broken_frames.py"))
BROKEN = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(BROKEN)

PAGE = Path(__file__).parents[3] / "docs" / "faults.md"
PARTS = {"good": 10.0, "defective": 8.0}
RECIPE = {
    "acquisition": {"frames_per_pose": 4, "dark_frames": 4},
    "decision": {"tolerance": 0.4, "alpha": 0.001, "deviation": "fail"},
}

LIVE = {
    "none": {},
    "glare of the lamp, .012 /sr": {"glare_radiance": 0.012},
    "glare that rises across the picture": {"glare_radiance": 0.012, "glare_slope": (0.8, 0.0)},
    "room light that comes after the dark frames": {"room_radiance": (0.0,) * 4 + (0.015,)},
    "dark frames 60 counts higher": {"black_in_dark": 60.0},
    "dark frames 60 counts lower": {"black_in_dark": -60.0},
    "lamp 10 % a pose down, back at the return": {"lamp": (1.0, 0.9, 0.8, 1.0)},
    "lamp 20 % down in all poses": {"lamp": (0.8,)},
    "lamp 20 % up in all poses": {"lamp": (1.2,)},
    "light rises by 10 % across the picture": {"lamp_slope": (0.05, 0.0)},
    "exposure 25 % short in the bright pose": {"exposure": (0.75, 1.0, 1.0, 0.75)},
    "exposure 25 % short at 90°": {"exposure": (1.0, 0.75, 1.0)},
    "gain 20 % up at 180°": {"gain": (1.0, 1.0, 1.2, 1.0)},
    "automatic gain": {"automatic_gain": True},
    "first frame of a pose shows the pose before": {"stale_pose": True},
    "every second frame is the buffer before": {"repeats_every": 2},
    "rows of zeros in every fourth frame": {"torn": "zero", "torn_every": 4},
    "rows shifted in every fourth frame": {"torn": "shifted", "torn_every": 4},
    "rows dropped in every fourth frame": {"torn": "dropped", "torn_every": 4},
    "clips at 1000 counts": {"plateau_counts": 1000},
    "stuck column through the part": {"stuck_columns": (260,)},
    "stuck pixel": {"stuck_pixels": ((250, 260),)},
    "camera mirrored": {"mirrored": True},
    "lens with 3 % barrel, not calibrated": {"barrel": 0.03},
    "part seated turned by 180°": {"seated_deg": 180.0},
    "part seated turned by 90°": {"seated_deg": 90.0},
    "part mirrored": {"upside_down": True},
    "part stays behind by 90° at the last pose": {"slips_at": 3, "slip_deg": -90.0},
    "part slips by 5° at 90°": {"slips_at": 2, "slip_deg": 5.0},
    "part slips by 180° at 90°": {"slips_at": 2, "slip_deg": 180.0},
    "part slips by 180° at the last pose": {"slips_at": 3, "slip_deg": 180.0},
    "one marker dirty": {"dirty_marker": 0},
    "one marker in shadow": {"shadowed_marker": 0},
}
"""Faults of the bench file by their names."""

QUICK = (
    ("live", "none"),
    ("frames", "pictures mirrored"),
    ("frames", "all frames of a pose alike bit for bit"),
    ("frames", "rows shifted in one frame of every pose"),
    ("frames", "plateau at 60 % of the peak"),
    ("frames", "a tenth of the stated exposure"),
    ("frames", "one marker dirty"),
    ("frames", "barrel, 1.2 % at the corners"),
)
"""Faults that no commit may let turn a verdict round."""

SEATED = {"part seated turned by 180°", "part mirrored", "part turned by 180° in its seat"}
"""Faults that the diagnosis finds."""

OPEN: set[tuple[str, str]] = set()
"""Faults that still turn a verdict round."""

MARKS = (
    "<!-- inspections: written by tests/inspect/inspection/test_rig_faults.py -->\n",
    "<!-- end of inspections -->",
)
HEAD = "| fault | by | good part | defective part | what it says |\n|---|---|---|---|---|\n"


@dataclass(frozen=True)
class Outcome:
    """Verdict, finding and action of an inspection; a refusal has no verdict."""

    verdict: str
    says: str
    action: str

    @property
    def sentence(self) -> str:
        """Reason of an INVALID one, else the first sentence of the finding and the action, in a cell of a table."""
        found = (
            self.says
            if self.verdict == "INVALID"
            else f"{self.says.split('. ')[0].rstrip('.')}. {self.action}"
        )
        return per_cent(re.sub(r" fixture-\d{8}-\w+", "", found).replace("|", "\\|"))


def outcome_of(inspect) -> Outcome:
    try:
        record = inspect().record
    except AnisoscopeError as refused:
        says, _, action = str(refused).partition(": ")
        return Outcome("refused", says, action)
    concluded = record.conclusion
    if record.verdict == "INVALID":
        return Outcome(record.verdict, record.reasons[0], concluded.action)
    return Outcome(record.verdict, concluded.finding, concluded.action)


@pytest.fixture(scope="module")
def laid_out(virtual_rigs, tmp_path_factory):
    """``laid_out(part, name, faults)``: a rig that knows its fixture, broken so."""
    reference = tmp_path_factory.mktemp("taught") / "fixture.json"
    calibrate_fixture(
        virtual_rigs("taught", bench={"sample": {"kind": "none"}}).rig,
        reference,
        Taking(0.0015, frames=4),
        angles=6,
    )

    def lay_out(part, name, faults):
        bench = {"sample": {"ridge_angle_deg": PARTS[part]}, "faults": faults}
        rig = {"calibration": {"fixture": str(reference)}}
        return virtual_rigs(f"{part} {name}".replace("/", "-"), recipe=RECIPE, bench=bench, rig=rig)

    return lay_out


@pytest.fixture(scope="module")
def sound(laid_out, undiagnosed):
    """Rig and frames of a finished inspection of a part on a sound rig, by the part."""
    found = {}

    def frames(part):
        if part not in found:
            rig = laid_out(part, "sound", {})
            found[part] = rig, BROKEN.frames_of(rig.inspect(methods=undiagnosed))
        return found[part]

    return frames


@pytest.fixture(scope="module")
def outcome(laid_out, sound, plain, undiagnosed, tmp_path_factory):
    """``outcome(by, fault, part)`` inspects a part while the rig has a fault.

    A diagnosis takes longer than all the rest; it is made where it may take a FAIL back.
    """

    def found(by, fault, part):
        first = inspected(by, fault, part, undiagnosed)
        if first.verdict != "FAIL" or (part == "defective" and fault not in SEATED):
            return first
        return inspected(by, fault, part, plain)

    def inspected(by, fault, part, methods):
        if by == "live":
            return outcome_of(lambda: laid_out(part, fault, LIVE[fault]).inspect(methods=methods))
        rig, frames = sound(part)
        folder = tmp_path_factory.mktemp("broken")
        BROKEN.write_frames(BROKEN.FAULTS[fault](frames), folder / "frames")
        return outcome_of(
            lambda: inspect_frames(
                folder / "frames",
                rig.recipe,
                "F-1",
                folder,
                rig_path=rig.rig,
                methods=methods,
                reuse="a fault of the rig is tried",
            )
        )

    return found


def all_faults():
    return [("live", name) for name in LIVE] + [("frames", name) for name in BROKEN.FAULTS]


def row(by, fault, good, defective):
    verdicts = " | ".join(
        f"**{one.verdict}**" if bad else one.verdict
        for one, bad in ((good, good.verdict == "FAIL"), (defective, defective.verdict == "PASS"))
    )
    return f"| {fault} | {by} | {verdicts} | {defective.sentence} |"


def wrong(good, defective):
    """A fault turns the verdict of a part round."""
    return good.verdict == "FAIL" or defective.verdict == "PASS"


@pytest.mark.parametrize(("by", "fault"), QUICK)
def test_a_fault_of_the_rig_turns_no_verdict_round(outcome, by, fault):
    good, defective = (outcome(by, fault, part) for part in PARTS)
    assert not wrong(good, defective)
    assert "refused" not in {good.verdict, defective.verdict} or "JPEG" in fault
    if fault == "none":
        assert (good.verdict, defective.verdict) == ("PASS", "FAIL")


@pytest.mark.soak
def test_a_sound_rig_is_never_at_fault(laid_out, undiagnosed):
    rig = laid_out("good", "again and again", {})
    verdicts = [rig.inspect(f"S-{number}", undiagnosed).record.verdict for number in range(200)]
    assert verdicts.count("INVALID") == 0
    assert verdicts.count("FAIL") == 0


def parts_of_page():
    """The page before its first table, the table, and the rest."""
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(MARKS[0])
    found, _, after = rest.partition(MARKS[1])
    return before + MARKS[0], found, MARKS[1] + after


def test_the_page_has_a_row_per_fault():
    _, found, _ = parts_of_page()
    rows = [line.split(" | ")[:2] for line in found.splitlines() if line.startswith("| ")]
    assert [(by, fault.removeprefix("| ")) for fault, by in rows[1:]] == all_faults()


@pytest.mark.soak
def test_the_page_of_rig_faults_is_true(outcome):
    table = [(by, fault, *(outcome(by, fault, part) for part in PARTS)) for by, fault in all_faults()]
    text = HEAD + "\n".join(row(*line) for line in table) + "\n"
    before, found, after = parts_of_page()
    if os.environ.get("ANISOSCOPE_WRITE_DOCS") == "1":
        PAGE.write_text(before + text + after, encoding="utf-8")
    elif found != text:
        pytest.fail(f"{PAGE.name} is out of date: run this test with -m soak and ANISOSCOPE_WRITE_DOCS=1")
    assert {line[:2] for line in table if wrong(*line[2:])} == OPEN
