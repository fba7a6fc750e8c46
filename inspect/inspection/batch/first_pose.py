"""The part at the first pose of its recipe, where its code is read: photographed, or among frames that exist."""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from anisoscope.calibration.corrections import Calibrations, read_calibrations
from anisoscope.inspection.batch.codes import Code, one_code, read_codes
from anisoscope.inspection.batch.scan import Scan
from anisoscope.inspection.frame_table import Replay
from anisoscope.kinds.recipes import read_any_recipe
from anisoscope.parameters.inspecting import CodeKind
from anisoscope.recipe.base import RecipeBase
from anisoscope.rig.acquisition.opening import Rig, open_rig
from anisoscope.rig.acquisition.plan import Plan, Pose
from anisoscope.rig.acquisition.runner import check_plan, ways_to
from anisoscope.rig.frame import Frame
from anisoscope.rig.framefolder import FrameEntry
from anisoscope.rig.light import rest
from anisoscope.rig.rigfile import read_rig


@dataclass(frozen=True, eq=False)
class Look:
    """Reading of codes by the camera: kind, and exposure (None: the recipe's)."""

    kind: CodeKind = "any"
    exposure_s: float | None = None


def photograph_first_pose(
    recipe_path: Path,
    rig_path: Path,
    exposure_s: float | None = None,
    place_mm: tuple[float, float] | None = None,
) -> Frame:
    """Take one lit picture at the first pose of a recipe; stage and light are safe afterwards.

    Args:
        recipe_path: recipe file.
        rig_path: rig file.
        exposure_s: exposure; None for that of the recipe.
        place_mm: (x, y) of the part on its tray, in mm from the stage's axis.

    Raises:
        RecipeError, RigFileError, CalibrationError: one of the files.
        RigError: hardware.
    """
    recipe = read_any_recipe(recipe_path)
    first = recipe.poses.poses()[0]
    pose = Pose(first.stage_deg, first.tilt_deg)
    acquisition = recipe.acquisition
    file = read_rig(rig_path, channel=acquisition.light_channel)
    known = Calibrations() if file.calibration is None else read_calibrations(file.calibration)
    plan = Plan((pose,), exposure_s or acquisition.exposure_s, acquisition.gain, seat=known.seat(place_mm))
    with open_rig(file) as rig:
        check_plan(plan, rig)
        settings = rig.camera.configure(plan.exposure_s, plan.gain)
        reached_deg = _go(rig, plan)
        rig.light.on()
        counts = rig.camera.grab().copy()
        rest(rig.light)
        info = rig.camera.info
        return Frame(
            counts=counts,
            kind="sample",
            bit_depth=info.bit_depth,
            black_level=info.black_level,
            exposure_s=settings.exposure_s,
            gain=settings.gain,
            stage_deg=reached_deg,
            commanded_deg=pose.stage_deg,
            tilt_deg=pose.tilt_deg,
            captured_at=datetime.now(UTC).isoformat(timespec="milliseconds"),
            camera=f"{info.model} {info.serial}",
            filters=info.filters,
        )


def _go(rig: Rig, plan: Plan) -> float:
    """Home axes that are not homed, and go to the pose; the inspection approaches it again with full accuracy."""
    axes = rig.by_table
    for axis in rig.unhomed():
        axis.home()
    ways = ways_to(plan.poses[0], plan.seat, rig)
    reached = {
        table: axes[table].move_to(ways[table][-1])
        for table in rig.guard.order({table: way[1:] for table, way in ways.items()})
    }
    return rig.file.stage.place_near(reached["stage"], plan.poses[0].stage_deg)


def scan_of(replay: Replay, recipe: RecipeBase, kind: CodeKind) -> Scan:
    """Text of the only code in the frames at the first pose; of several exposures, the first that shows one.

    Args:
        replay: frames with their poses.
        recipe: the recipe, for its first pose.
        kind: look for this kind only.

    Raises:
        MeasurementError: no frame shows a code that can be read, or one shows several.
        RecordError: a frame is damaged.
        UsageError: a code that calls itself GS1, and is not.
    """
    first = recipe.poses.poses()[0]
    pose = Pose(first.stage_deg, first.tilt_deg)
    frames = [
        entry for entry, at in replay.entries if entry.kind == "sample" and at == pose and not entry.again
    ]
    exposures: dict[float, FrameEntry] = {}
    for entry in frames:
        exposures.setdefault(entry.exposure_s, entry)
    found: tuple[Code, ...] = ()
    for entry in exposures.values():
        found = read_codes(entry.load().grey, kind)
        if found:
            break
    return one_code(found, kind, str(frames[0].path)).scan
