"""The checks of the self test that look at markers and at the white tile."""

from datetime import UTC, datetime

import numpy as np
import numpy.typing as npt

from anisoscope.calibration.whitereference import read_reference
from anisoscope.commission.markers import Fix, edge_blur_px, modules_of
from anisoscope.commission.selftest import Bed, Check, judged, skipped
from anisoscope.commission.turning import fit_centre, wrapped
from anisoscope.errors import MeasurementError
from anisoscope.registration.placement import check_fixture

_BLOCKS = 8

MARKERS = (
    ("markers.residual", "misfit of the markers"),
    ("markers.angle", "fixture's angle off the stage's"),
    ("markers.centre", "rotation centre off the commissioned one"),
    ("markers.pixel", "pixel size off the rig file's"),
    ("markers.focus", "blur of marker edges over the commissioned"),
)


def check_markers(bed: Bed) -> list[Check]:
    """Markers: misfit, angle, rotation centre, pixel size, focus."""
    fixture, settings = bed.file.fixture, bed.settings
    why = "the white tile lies on the stage" if settings.tile else "the rig file describes no fixture"
    if settings.tile or fixture is None:
        return [skipped(*name, why) for name in MARKERS]
    check_fixture(fixture)
    seen = [(angle, fix, picture) for angle, fix, picture in bed.views if fix is not None]
    if len(seen) < len(bed.views):
        raise MeasurementError(
            f"the markers are seen in {len(seen)} of {len(bed.views)} pictures: check that the light is on, the lens "
            "clear and in focus, and the fixture that of the rig file"
        )
    fixes = [fix for _, fix, _ in seen]
    pixel = float(np.mean([fix.pixel_um for fix in fixes]))
    blur = float(
        np.median([edge_blur_px(image, fix, modules_of(fixture.dictionary)) for _, fix, image in seen])
    )
    return [
        judged(
            *MARKERS[0], max(fix.residual_px for fix in fixes), settings.residual_px, "px",
            "check focus, and that the markers stand where the rig file says",
        ),
        _angle(seen, bed),
        _centre(fixes, bed),
        judged(
            *MARKERS[3], abs(pixel / bed.file.camera.pixel_um - 1.0), settings.scale_share, "relative",
            "the magnification changed: check lens and working distance, or commission the rig",
            remark=f"{pixel:.4g} µm",
        ),
        _focus(blur, bed),
    ]  # fmt: skip


def _angle(seen: list[tuple[float, Fix, npt.NDArray[np.float32]]], bed: Bed) -> Check:
    off = wrapped(np.array([fix.angle_deg - angle for angle, fix, _ in seen]))
    other = wrapped(np.array([fix.angle_deg + angle for angle, fix, _ in seen]))
    advice = "seat the fixture again, or correct stage.zero_deg: `anisoscope rig commission`"
    if np.max(np.abs(other - other[0])) < 1.0 < np.max(np.abs(off - off[0])):
        advice = "the stage turns the other way than stage.turns says: `anisoscope rig commission`"
    return judged(*MARKERS[1], float(np.max(np.abs(off))), bed.settings.angle_deg, "°", advice)


def _centre(fixes: list[Fix], bed: Bed) -> Check:
    if bed.commissioned is None:
        return skipped(*MARKERS[2], "the rig was not commissioned")
    column, row = (bed.commissioned.number(f"camera.axis_{name}_px") for name in ("column", "row"))
    if column is None or row is None:
        return skipped(*MARKERS[2], "the commissioning did not find it")
    centre = fit_centre(fixes)
    off = float(np.hypot(centre.column_px - column, centre.row_px - row))
    advice = "camera or stage was moved: put it back, or commission the rig again"
    return judged(*MARKERS[2], off, bed.settings.centre_px, "px", advice)


def _focus(blur_px: float, bed: Bed) -> Check:
    before = None if bed.commissioned is None else bed.commissioned.blur_px
    if before is None:
        return skipped(*MARKERS[4], f"the rig was not commissioned; {blur_px:.2f} px rms")
    advice = "focus the lens, or clean it"
    return judged(
        *MARKERS[4], blur_px / before, bed.settings.blur_ratio, "1", advice, remark=f"{blur_px:.2f} px rms"
    )


WHITE = (
    ("white.age", "age of the white reference"),
    ("white.shading", "shading off the white reference's"),
    ("white.level", "light off the white reference's"),
)


def check_white(bed: Bed) -> list[Check]:
    """The white reference: of this camera, not too old, and with the tile on the stage still true."""
    calibration, settings = bed.file.calibration, bed.settings
    if calibration is None:
        return [skipped(*name, "the rig file names no white reference") for name in WHITE]
    white, serial = read_reference(calibration.flat), bed.rig.camera.info.serial
    advice = "take a new one with `anisoscope calibrate flat`"
    if white.camera != serial:
        raise MeasurementError(
            f"the white reference was taken with camera {white.camera}, this is {serial}: {advice}"
        )
    age = (datetime.now(UTC) - datetime.fromisoformat(white.taken_at)).total_seconds() / 86400.0
    found = [judged(*WHITE[0], age, settings.white_days, "days", advice)]
    if not settings.tile or bed.lit is None:
        return found + [
            skipped(*name, "the white tile does not lie on the stage (--tile)") for name in WHITE[1:]
        ]
    if white.signal.shape != bed.lit.shape:
        raise MeasurementError(f"the white reference and the camera differ in size: {advice}")
    ratio = bed.lit / (white.signal.astype(np.float64) * settings.exposure_s * settings.gain)
    level = float(np.median(ratio))
    blocks = [np.array_split(row, _BLOCKS, axis=1) for row in np.array_split(ratio, _BLOCKS)]
    shading = np.array([[float(np.median(block)) for block in row] for row in blocks]) / level
    return [
        *found,
        judged(*WHITE[1], float(np.max(np.abs(shading - 1.0))), settings.shading_share, "relative", advice),
        judged(
            *WHITE[2], abs(level - 1.0), settings.level_share, "relative", f"clean lens and tile; {advice}"
        ),
    ]
