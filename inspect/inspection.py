"""One inspection from recipe to report: expect, photograph, linearise, register, measure, decide, record."""

import contextlib
import re
from collections import defaultdict
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from anisoscope.decision import Decision, cell_log_ratios, decide
from anisoscope.errors import (
    CalibrationError,
    CameraError,
    MeasurementError,
    RecordError,
    RigFileError,
    Saturated,
    UsageError,
)
from anisoscope.expectation import Expectation, expectation
from anisoscope.linear import RadianceImage, WhiteReference, check_size, linearise, stack
from anisoscope.measurement import Measured, View, check_light, measure
from anisoscope.progress import Advance, silent
from anisoscope.recipe import Recipe, read_recipe
from anisoscope.record import (
    AreaRecord,
    BudgetRecord,
    ContrastRecord,
    FrameRecord,
    InputFile,
    PoseRecord,
    Record,
    sha256_of,
    write_record,
)
from anisoscope.registration import Placement, check_fixture, locate
from anisoscope.report.inspection_page import Pictures, start_renderer, write_report
from anisoscope.rig.fixture import Fixture
from anisoscope.rig.frame import Frame
from anisoscope.rig.plan import Plan
from anisoscope.rig.plan import Pose as RigPose
from anisoscope.rig.rigfile import RigFile, read_rig
from anisoscope.rig.runner import FrameRecord as FrameFile
from anisoscope.rig.runner import open_rig, run_plan
from anisoscope.whitereference import read_reference

MAX_SATURATED_PICTURE = 0.02
SERIAL = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+#-]{0,63}")


@dataclass(frozen=True, eq=False)
class Inspected:
    """A finished inspection: its record, where it lies, and what the user should know besides."""

    record: Record
    folder: Path
    report: Path
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class _Setup:
    """All that is known before the first picture."""

    recipe_path: Path
    recipe: Recipe
    rig_path: Path
    rig: RigFile
    serial: str
    white: WhiteReference
    white_path: Path
    expected: Expectation


@dataclass(frozen=True, eq=False)
class _Taken:
    """The frames of one inspection and the devices that took them."""

    frames: tuple[FrameFile, ...]
    camera: str
    stage: str
    full_scale: int


def check_serial(serial: str) -> str:
    """A serial number that can name a folder.

    Raises:
        UsageError: it holds anything but letters, digits, blanks and ``. _ + # -``, or begins with a blank or a sign.
    """
    if not SERIAL.fullmatch(serial) or serial != serial.strip():
        raise UsageError(
            f"the serial number {serial[:64]!r} cannot be used: 1 to 64 letters, digits, blanks or . _ + # -, "
            "beginning with a letter or a digit"
        )
    return serial


def inspect_part(
    recipe_path: Path, rig_path: Path, serial: str, out: Path, on_progress: Advance = silent
) -> Inspected:
    """Photograph a part on a rig and judge it.

    Args:
        recipe_path: recipe file.
        rig_path: rig file.
        serial: serial number of the part.
        out: folder that receives the inspection folder.
        on_progress: called with what is being done, steps done and steps in all.

    Returns:
        The record, INVALID included.

    Raises:
        UsageError, RecipeError, RigFileError, HeightMapError, CalibrationError: before anything moves.
        RigError: hardware; the frames taken so far stay in the folder, no record is written. Without any frame
            the folder goes too.
        RecordError: the folder cannot be written.
    """
    check_serial(serial)
    recipe, rig = read_recipe(recipe_path), read_rig(rig_path)
    on_progress("prediction", 0, 1)
    white_path = _white_path(rig, rig_path)
    _fixture(rig, rig_path)
    setup = _Setup(
        recipe_path,
        recipe,
        rig_path,
        rig,
        serial,
        read_reference(white_path),
        white_path,
        expectation(recipe, rig.light.angle_deg),
    )
    folder = _make_folder(out, serial)
    with contextlib.ExitStack() as cleanup:
        cleanup.callback(_remove_if_empty, folder)
        renderer = start_renderer(setup.expected.surface)
        if renderer is not None:
            cleanup.callback(renderer.discard)
        taken = _photograph(setup, folder, on_progress)
        on_progress("measurement", 0, 1)
        record, pictures = _judge(setup, taken, folder)
        write_record(record, folder)
        on_progress("report", 0, 1)
        view = renderer.result() if renderer is not None else None
        report = write_report(record, pictures, folder, view)
    on_progress(record.verdict, 1, 1)
    lost = (f"no 3-D view in the report: {view.note}",) if view is not None and view.png is None else ()
    return Inspected(record, folder, report, lost)


def _white_path(rig: RigFile, path: Path) -> Path:
    if rig.calibration is None:
        raise CalibrationError(
            f"{path} names no flat, so that radiances have no scale: take one with `anisoscope calibrate flat` "
            "and name it under [calibration] flat"
        )
    return rig.calibration.flat


def _fixture(rig: RigFile, path: Path) -> Fixture:
    if rig.fixture is None:
        raise RigFileError(f"{path} describes no [fixture]: the turned pictures are aligned by its markers")
    check_fixture(rig.fixture)
    return rig.fixture


def _make_folder(out: Path, serial: str) -> Path:
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    base = f"{serial.replace(' ', '_').replace('#', '')}-{stamp}"
    try:
        out.mkdir(parents=True, exist_ok=True)
        for number in range(1000):
            folder = out / (base if number == 0 else f"{base}-{number}")
            try:
                folder.mkdir()
            except FileExistsError:
                continue
            return folder.resolve()
    except OSError as error:
        raise RecordError(f"cannot make an inspection folder in {out}: {error.strerror}") from error
    raise RecordError(f"{out} already holds a thousand inspections named {base}")


def _remove_if_empty(folder: Path) -> None:
    """Leave no folder behind that holds nothing."""
    for path in (folder / "frames", folder):
        with contextlib.suppress(OSError):
            path.rmdir()


def _photograph(setup: _Setup, folder: Path, advance: Advance) -> _Taken:
    acquisition = setup.recipe.acquisition
    plan = Plan(
        poses=tuple(RigPose(pose.stage_deg, pose.tilt_deg) for pose in setup.expected.poses),
        exposure_s=acquisition.exposure_s,
        gain=acquisition.gain,
        frames_per_pose=acquisition.frames_per_pose,
        dark_frames=acquisition.dark_frames,
        settle_s=acquisition.settle_s,
        return_to_first=True,
    )
    with open_rig(setup.rig) as rig:
        info = rig.camera.info
        if setup.white.camera != info.serial:
            raise CalibrationError(
                f"the flat was taken with camera {setup.white.camera}, this is {info.serial}: "
                "take a new one with `anisoscope calibrate flat`"
            )
        check_size(setup.white, (info.rows, info.cols))
        frames = run_plan(plan, rig, folder, on_progress=lambda now: advance(now.text, now.done, now.total))
        return _Taken(tuple(frames), f"{info.model} {info.serial}", rig.stage.name, 2**info.bit_depth - 1)


def _judge(setup: _Setup, taken: _Taken, folder: Path) -> tuple[Record, Pictures]:
    """Measure and decide; what makes the measurement unfit becomes an INVALID record."""
    frames = [file.frame for file in taken.frames]
    try:
        views, closing = _views(setup, taken)
        measured = measure(views, closing, setup.recipe, setup.expected, setup.rig.camera.pixel_um)
        decision = decide(setup.expected, measured, setup.recipe)
    except (MeasurementError, CameraError) as error:
        first_of_pose = {frame.commanded_deg: frame for frame in reversed(frames) if frame.kind == "sample"}
        shown = tuple(
            (f"{angle:g}°", first_of_pose[angle].counts.astype("float32")) for angle in sorted(first_of_pose)
        )
        record = _record(setup, taken, folder, verdict="INVALID", reasons=(str(error),))
        return record, Pictures(raw=shown, surface=setup.expected.surface)
    pictures = Pictures(
        aligned=measured.aligned,
        size_mm=measured.grid.size_mm,
        ratios=cell_log_ratios(measured, setup.expected.poses),
        deviating=decision.deviating,
        surface=setup.expected.surface,
    )
    record = _record(
        setup,
        taken,
        folder,
        verdict=decision.verdict.value,
        reasons=decision.reasons,
        **_results(setup, views, measured, decision),
    )
    return record, pictures


def _views(setup: _Setup, taken: _Taken) -> tuple[list[View], View | None]:
    """Linear, located pictures in the order of the recipe, and the first pose as photographed at the end."""
    dark = stack(file.frame for file in taken.frames if file.frame.kind == "dark")
    groups: dict[tuple[float, float, bool], list[Frame]] = defaultdict(list)
    for file in taken.frames:
        if file.frame.kind == "sample":
            groups[file.frame.commanded_deg, file.frame.tilt_deg, file.again].append(file.frame)
    views: dict[bool, list[View]] = {False: [], True: []}
    for (_, _, again), group in groups.items():
        image = linearise(stack(group), dark, setup.white, taken.full_scale)
        views[again].append(_view(setup, group[0], image))
    return views[False], next(iter(views[True]), None)


def _view(setup: _Setup, frame: Frame, image: RadianceImage) -> View:
    check_light(frame.commanded_deg, image, setup.recipe)
    share = float(image.saturated.mean())
    if share > MAX_SATURATED_PICTURE:
        raise Saturated(
            f"at {frame.commanded_deg:g}° {share:.1%} of the picture are saturated (limit "
            f"{MAX_SATURATED_PICTURE:.0%}): shorten acquisition.exposure_s in the recipe"
        )
    return View(frame.commanded_deg, frame.tilt_deg, image, _place(setup, image))


def _place(setup: _Setup, image: RadianceImage) -> Placement:
    """Where the fixture stands; a saturated pixel has no value, but it is surely bright."""
    brightest = image.value.max(initial=0.0, where=image.usable)
    picture = np.where(image.saturated, brightest, image.value)
    return locate(picture, _fixture(setup.rig, setup.rig_path), setup.rig.geometry.tilt_deg)


def _results(setup: _Setup, views: list[View], measured: Measured, decision: Decision) -> dict[str, Any]:
    area = decision.area
    kind = setup.recipe.decision.contrast
    return {
        "poses": tuple(
            PoseRecord(
                stage_deg=view.stage_deg,
                tilt_deg=view.tilt_deg,
                measured=float(seen),
                predicted=float(predicted),
                marker_angle_deg=view.placement.angle_deg,
                pixel_um=view.placement.pixel_um,
                residual_px=view.placement.residual_px,
                markers=view.placement.markers,
            )
            for view, seen, predicted in zip(views, measured.radiance, setup.expected.radiance, strict=True)
        ),
        "contrasts": tuple(
            ContrastRecord(
                from_deg=pair.from_deg,
                to_deg=pair.to_deg,
                tilt_deg=pair.tilt_deg,
                kind=kind,
                measured=pair.measured,
                predicted=pair.predicted,
                u=pair.u,
                tolerance=pair.tolerance,
                guard=pair.guard,
                conformance_probability=pair.conformance,
                verdict=pair.verdict.value,
            )
            for pair in decision.pairs
        ),
        "d2": decision.d2,
        "dof": decision.dof,
        "p_value": decision.p_value,
        "area": area
        and AreaRecord(
            share=area.share, u=area.u, max_share=area.max_share, cells=area.cells, verdict=area.verdict.value
        ),
        "budget": tuple(
            BudgetRecord(source=row.source, kind=row.kind, contributions=row.contributions)
            for row in decision.budget
        ),
        "drift": measured.drift,
    }


def _record(
    setup: _Setup,
    taken: _Taken,
    folder: Path,
    *,
    verdict: str,
    reasons: tuple[str, ...],
    **results: Any,  # noqa: ANN401
) -> Record:
    inputs = [setup.recipe_path, setup.rig_path, setup.white_path]
    if setup.recipe.surface.height_map is not None:
        inputs.append(setup.recipe.surface.height_map)
    convention = setup.expected.convention
    nothing: dict[str, Any] = dict.fromkeys(("d2", "dof", "p_value", "area", "drift"))
    nothing |= {"poses": (), "contrasts": (), "budget": ()}
    return Record.model_validate(
        {
            "software": f"anisoscope {version('anisoscope')}",
            "created_at": datetime.now(UTC).isoformat(timespec="seconds"),
            "serial": setup.serial,
            "product": setup.recipe.product,
            "verdict": verdict,
            "reasons": reasons,
            "model": setup.expected.model,
            "convention": vars(convention),
            "white_reference": {
                "taken_at": setup.white.taken_at,
                "reflectance": setup.white.reflectance,
                "camera": setup.white.camera,
                "sha256": setup.white.sha256,
            },
            "recipe": setup.recipe.model_dump(mode="json", by_alias=True),
            "rig": setup.rig.model_dump(mode="json", by_alias=True),
            "camera": taken.camera,
            "stage": taken.stage,
            "inputs": tuple(InputFile(name=path.name, sha256=sha256_of(path)) for path in inputs),
            "frames": tuple(_frame_record(file, folder) for file in taken.frames),
            **nothing,
            **results,
        }
    )


def _frame_record(file: FrameFile, folder: Path) -> FrameRecord:
    frame = file.frame
    return FrameRecord(
        name=str(file.path.relative_to(folder)),
        sha256=sha256_of(file.path),
        kind=frame.kind,
        stage_deg=frame.stage_deg,
        commanded_deg=frame.commanded_deg,
        exposure_s=frame.exposure_s,
        gain=frame.gain,
        captured_at=frame.captured_at,
    )
