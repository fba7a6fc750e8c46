"""Plausibility checks that every imported height map must pass.

A file that is damaged, or written in another unit than it says, often still decodes into numbers. The
limits below are wider than any micro-ridged plastic part and any instrument that measures one, and narrower
than the factors of 1000 or 10⁶ by which unit mistakes go wrong. Nothing is corrected here: a check passes,
or it raises one line that names the file, the check, the value and the way out.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import HeightMapError
from anisoscope.parameters.height_map_file import Trust
from anisoscope.profiles.heightmap import HeightMap

PIXEL_LIMITS_UM = (0.01, 1000.0)
PROBE_PIXEL_UM, PROBE_RANGE_UM = 1e-5, 1e-6
"""Least pixel and range of heights of a scanning probe microscope: it resolves atoms."""
MAX_FIELD_UM = 0.5e6
MAX_HEIGHT_UM = 10_000.0
MIN_RANGE_UM = 1e-4
MAX_POINTS = 250_000_000
DEFLATE_LIMIT = 1032
PACKED_FREELY_BYTES = 2**26
PACKED_RATIO = 200
AXIS_TOLERANCE = 0.05


@dataclass
class Trusted:
    """Checks that the user overrides, and what each of them then let pass.

    Attributes:
        checks: names of the checks.
        passed: one text for each time that one of them would have refused the file.
    """

    checks: frozenset[str] = frozenset()
    passed: list[str] = field(default_factory=list)


_trusted: ContextVar[Trusted | None] = ContextVar("trusted", default=None)


@contextmanager
def trusting(checks: Sequence[Trust]) -> Iterator[Trusted]:
    """While a file is read, let the named checks pass it; what they let pass is listed in the value."""
    trusted = Trusted(frozenset(checks))
    token = _trusted.set(trusted)
    try:
        yield trusted
    finally:
        _trusted.reset(token)


def passes(check: Trust, text: str) -> bool:
    """Whether the user overrides a check; then the text is noted."""
    trusted = _trusted.get()
    if trusted is None or check not in trusted.checks:
        return False
    trusted.passed.append(text)
    return True


def refuse(name: str, check: str, value: object, advice: str) -> NoReturn:
    """Refuse a file in one line.

    Raises:
        HeightMapError: always.
    """
    line = f"{name}: {check}: {value}; {advice}"
    raise HeightMapError(" ".join(line.split()))


def check_claim(name: str, rows: int, cols: int, bytes_per_point: float, available: float) -> None:
    """Refuse a claimed size that the file cannot hold, before anything of that size is allocated.

    Args:
        name: name of the file.
        rows: claimed number of rows.
        cols: claimed number of columns.
        bytes_per_point: least number of bytes that a point takes in the file.
        available: bytes that the file can deliver at most.

    Raises:
        HeightMapError: fewer than 2 × 2 points, more than 250 million, or more than the file can hold.
    """
    if rows < 2 or cols < 2:
        refuse(name, "size", f"{rows} × {cols} points", "a height map needs at least 2 × 2 points")
    if rows * cols > MAX_POINTS:
        refuse(
            name,
            "size",
            f"{rows} × {cols} points",
            f"at most {MAX_POINTS // 10**6} million are read; crop the map",
        )
    needed = rows * cols * bytes_per_point
    if needed > available:
        refuse(
            name,
            "size against file",
            f"{rows} × {cols} points need {needed:.0f} bytes, the file can hold {max(available, 0):.0f}",
            "the file is truncated or its header is damaged; export it again",
        )


def check_pixel(
    name: str, pixel_um: Sequence[float], shape: tuple[int, int], least_um: float = PIXEL_LIMITS_UM[0]
) -> None:
    """Check the pixel size (y, x) in µm and the field that it spans.

    Raises:
        HeightMapError: a pixel below the least one or above 1000 µm, or a field beyond 0.5 m.
    """
    low, high = least_um, PIXEL_LIMITS_UM[1]
    for axis, pixel, count in zip("yx", pixel_um, shape, strict=True):
        found = f"pixel size along {axis} {pixel:.6g} µm, beyond {low:g} to {high:g} µm"
        if not low <= pixel <= high and not (0.0 < pixel < np.inf and passes("pixel-size", found)):
            refuse(
                name,
                f"pixel size along {axis}",
                f"{pixel:.6g} µm",
                f"plausible are {low:g} to {high:g} µm; check the unit in which the pixel size was given, or take it "
                "as it is with --trust pixel-size",
            )
        field_mm = f"field along {axis} {pixel * count * 1e-3:.6g} mm"
        if pixel * count > MAX_FIELD_UM and not passes("pixel-size", field_mm):
            refuse(
                name,
                f"field along {axis}",
                f"{pixel * count * 1e-3:.6g} mm",
                f"plausible are up to {MAX_FIELD_UM * 1e-3:g} mm; check the pixel size, or take it as it is with "
                "--trust pixel-size",
            )


def _range(height_um: npt.NDArray[np.floating]) -> tuple[float, float]:
    """Lowest and highest height, NaN if none was measured."""
    return float(np.fmin.reduce(height_um, axis=None)), float(np.fmax.reduce(height_um, axis=None))


def _check_range(name: str, lowest: float, highest: float) -> None:
    if np.isnan(highest):
        refuse(name, "measured points", "none", "every point is marked as missing; export the map again")
    largest = max(highest, -lowest)
    if largest > MAX_HEIGHT_UM:
        refuse(
            name,
            "largest height",
            f"{largest:.6g} µm",
            f"plausible are up to {MAX_HEIGHT_UM:g} µm; check the unit of the heights and the offset of z",
        )


def check_spread(name: str, lowest: float, highest: float, least_um: float = MIN_RANGE_UM) -> None:
    """Refuse heights of an imported map that differ, but by less than an instrument sees: 0.1 nm of one with light.

    Heights in m taken for µm differ by less. A flat map is none of these: what differs by less than that were it in
    m, such as the rounding of a levelled plane.

    Raises:
        HeightMapError: such heights, and the user does not trust them.
    """
    spread = highest - lowest
    if 1e-6 * least_um < spread < least_um and not passes(
        "heights", f"heights that differ by {spread:.3g} µm at most"
    ):
        refuse(
            name,
            "range of the heights",
            f"{spread:.3g} µm",
            f"plausible are {least_um:g} µm or more; check the unit of the heights, or take them as they are with "
            "--trust heights",
        )


def check_packing(name: str, entry: str, plain: float, packed: float) -> None:
    """Refuse an entry of an archive that unpacks to more than 64 MiB and 200 times its packed size.

    Measured heights pack to a half or a tenth; what packs to a thousandth is a bomb, or holds nothing.

    Raises:
        HeightMapError: such an entry.
    """
    if plain > PACKED_FREELY_BYTES and plain > PACKED_RATIO * packed:
        refuse(
            name,
            f"size of {entry}",
            f"{packed:.0f} bytes unpack to {plain:.0f}",
            f"more than {PACKED_RATIO} times is not read; the file is damaged, or crop the map",
        )


def check_heights(name: str, height_um: npt.NDArray[np.floating]) -> None:
    """Check the heights, (rows, cols) in µm, NaN where missing.

    Raises:
        HeightMapError: nothing was measured, or a height is beyond ±10 mm.
    """
    _check_range(name, *_range(height_um))


def check_map(surface: HeightMap, name: str) -> HeightMap:
    """Check pixel, field and heights of a map, and hand it back.

    Raises:
        HeightMapError: a check failed.
    """
    check_pixel(name, (surface.pixel_y_um, surface.pixel_x_um), surface.shape)
    check_heights(name, surface.height_um)
    return surface


def _corrected(origin: dict[str, Any], text: str) -> dict[str, Any]:
    return {**origin, "corrected": [*origin.get("corrected", []), text]}


def checked_map(
    name: str,
    height_um: FloatArray,
    pixel_um: tuple[float, float],
    origin: dict[str, Any],
    *,
    stage_height: bool = False,
    beyond_um: float = np.inf,
    layers: Mapping[str, npt.NDArray[Any]] | None = None,
    probe: bool = False,
) -> HeightMap:
    """A map of heights whose pixel, field and heights have been checked.

    Heights that are not finite become missing. Heights of a format that may count from a stage's zero are
    counted from the middle of their range, if they lie further off than any plausible height; ``corrected``
    says so. A mistaken unit stretches the range with the offset, so that it is still found.

    Args:
        name: name of the file.
        height_um: (rows, cols) heights in µm, NaN where missing; the array is taken over and sealed.
        pixel_um: pixel size (y, x) in µm.
        origin: provenance of the map.
        stage_height: the format states its units and may count z from a stage's zero.
        beyond_um: heights as far from zero as this mark points that were not measured.
        layers: of the map, (rows, cols) or (rows, cols, 3).
        probe: the format is one of scanning probe microscopes, whose pixels are smaller than those of light.

    Raises:
        HeightMapError: a check failed, or a layer does not fit the heights.
    """
    rows, cols = height_um.shape
    check_claim(name, rows, cols, 0, 0)
    check_pixel(name, pixel_um, (rows, cols), PROBE_PIXEL_UM if probe else PIXEL_LIMITS_UM[0])
    lowest, highest = _range(height_um)
    if max(-lowest, highest) >= beyond_um:
        if np.isinf(max(-lowest, highest)):
            endless = int(np.count_nonzero(np.isinf(height_um)))
            origin = _corrected(origin, f"{endless} infinite heights are missing points")
        height_um[np.abs(height_um) >= beyond_um] = np.nan
        lowest, highest = _range(height_um)
    if stage_height and max(-lowest, highest) > MAX_HEIGHT_UM and highest - lowest <= MAX_HEIGHT_UM:
        middle = 0.5 * (lowest + highest)
        height_um -= middle
        origin = _corrected(origin, f"heights counted from {middle:.6g} µm, the middle of their range")
        lowest, highest = lowest - middle, highest - middle
    _check_range(name, lowest, highest)
    check_spread(name, lowest, highest, PROBE_RANGE_UM if probe else MIN_RANGE_UM)
    height_um.flags.writeable = False
    try:
        return HeightMap(height_um, float(pixel_um[1]), float(pixel_um[0]), origin, layers or {})
    except HeightMapError as error:
        raise HeightMapError(f"{name}: {error}") from None


def equidistant_step(name: str, axis: str, positions_um: FloatArray) -> float:
    """Step of an axis given by its n positions in µm; they must rise evenly, within 5 % of a step.

    Raises:
        HeightMapError: the axis is not strictly rising, or its steps differ.
    """
    steps = np.diff(positions_um)
    if steps.size == 0:
        refuse(name, f"{axis} axis", "a single position", "a height map needs at least two along each axis")
    if not (np.isfinite(positions_um).all() and (steps > 0).all()):
        refuse(name, f"{axis} axis", "positions do not rise", "the points must lie on a regular grid")
    step = float((positions_um[-1] - positions_um[0]) / steps.size)
    worst = float(np.max(np.abs(positions_um - positions_um[0] - step * np.arange(positions_um.size))))
    if worst > AXIS_TOLERANCE * step:
        refuse(
            name,
            f"{axis} axis",
            f"a position is {worst:.4g} µm off a regular step of {step:.4g} µm",
            "resample the map to a regular grid",
        )
    return step
