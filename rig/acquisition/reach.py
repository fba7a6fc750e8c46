"""Can a rig go where a plan wants it to? Asked before anything moves."""

from anisoscope.base.errors import RigError, RigFileError
from anisoscope.rig.acquisition.opening import Rig
from anisoscope.rig.acquisition.plan import Plan
from anisoscope.rig.rigfile import AxisPart
from anisoscope.rig.stage import RotationStage

TILT_TOLERANCE_DEG = 0.01


def check_plan(plan: Plan, rig: Rig) -> None:
    """Can the rig do what the plan asks for? Nothing moves.

    Raises:
        RigError: a tilt that the arm does not have.
        RigFileError: an angle that cannot be reached from below within the limits of its axis.
    """
    for pose in plan.poses:
        _check_reach(rig.file.stage, rig.stage, pose.stage_deg, "stage")
        if rig.tilt is not None and rig.file.tilt is not None:
            _check_reach(rig.file.tilt, rig.tilt, pose.tilt_deg, "tilt")
            continue
        arm_deg = rig.file.geometry.tilt_deg
        if abs(pose.tilt_deg - arm_deg) > TILT_TOLERANCE_DEG:
            raise RigError(
                f"a tilt of {pose.tilt_deg:g}° was asked for, but the camera arm of '{rig.file.name}' "
                f"is fixed at {arm_deg:g}°; ask for that, correct geometry.tilt_deg in the rig file, or "
                "describe the axis that tilts it under [tilt]"
            )


def _check_reach(part: AxisPart, axis: RotationStage, angle_deg: float, table: str) -> None:
    low, high = axis.limits_deg
    target = part.reading_deg(angle_deg)
    if target - part.approach_deg < low or target > high:
        what = "sample angle" if table == "stage" else "tilt"
        hint = ' (with turns = "ccw": at least stage.approach_deg)' if table == "stage" else ""
        raise RigFileError(
            f"a {what} of {angle_deg:g}° needs the {table} at {target:g}° and before at "
            f"{target - part.approach_deg:g}°, but it reaches {low:g}°…{high:g}°; choose {table}.zero_deg "
            f"in the rig file so that both fit{hint}"
        )
