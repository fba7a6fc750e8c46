"""Common part of the recipes of all kinds: name, poses, exposure, region, and limits of a measurement."""

from itertools import pairwise
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from anisoscope.base.errors import RecipeError
from anisoscope.base.quantity import Likely
from anisoscope.base.toml_file import LocalPath, NotNegative, Part, Positive, Share, length, read_toml_model
from anisoscope.recipe.poses import PosesPart
from anisoscope.rig.acquisition.plan import LEAST_STEP
from anisoscope.rig.fixture import Fixture


class AcquisitionPart(Part):
    """Exposure and repetition.

    ``brackets`` are further exposures of every pose, as multiples of ``exposure_s``, for parts whose dark poses drown
    in noise at the longest exposure that the bright ones allow. The number of frames is per exposure.
    ``light_channel`` is that of the rig file under which the part is photographed.
    """

    exposure_s: Positive
    brackets: Annotated[tuple[float, ...], Field(max_length=4)] = ()
    gain: Positive = 1.0
    frames_per_pose: Annotated[int, Field(ge=2, le=256)] = 4
    dark_frames: Annotated[int, Field(ge=2, le=256)] = 4
    settle_s: NotNegative = 0.1
    light_channel: str | None = None

    @model_validator(mode="after")
    def _brackets_rise(self) -> Self:
        for before, after in pairwise((1.0, *self.brackets)):
            if not after >= LEAST_STEP * before:
                raise ValueError(
                    f"brackets are multiples of exposure_s that rise by {LEAST_STEP:g} or more, such as [4.0, 16.0]: "
                    f"{after:g} follows {before:g}"
                )
        return self


Side = Annotated[Positive, length(Likely(1e-3, 1000.0, "regions", firm=True))]


class RegionPart(Part):
    """The inspected rectangle of the part, in mm.

    ``center_mm`` is (x, y) from the rotation axis at stage angle 0, ``size_mm`` (across the ridges, along them).
    """

    center_mm: tuple[float, float] = (0.0, 0.0)
    size_mm: tuple[Side, Side]


class DecisionBase(Part):
    """Decision rule for a part of any kind.

    ``alpha`` is the level of significance; ``deviation`` says what a significant deviation within the tolerance does;
    the guard band is ``coverage`` standard uncertainties wide. INCONCLUSIVE parts are measured up to ``remeasure``
    times more. ``unexcluded`` says what a defect of ``[defects]`` does that the measurement does not exclude: a part
    that would pass is "inconclusive", or passes with the defect named ("note").
    """

    alpha: Annotated[float, Field(gt=0.0, lt=0.5)] = 0.01
    deviation: Literal["warn", "fail"] = "warn"
    coverage: Positive = 1.645
    unexcluded: Literal["inconclusive", "note"] = "note"
    remeasure: Annotated[int, Field(ge=0, le=9)] = 1


class LotDecision(DecisionBase):
    """Decision rule of kinds whose parts judge each other.

    With ``compare_with_lot``, where the recipe has no golden parts, a part is compared with the other parts of its lot.
    """

    compare_with_lot: bool = False


class LimitsPart(Part):
    """Limits beyond which a measurement is INVALID.

    ``fixture_um`` is the distance of the point about which the fixture turns from the calibrated rotation centre: the
    fixture's markers place every picture, so that only a moved camera or stage is to be noticed. ``beyond_part_um`` is
    how far a corner of the region may reach beyond the part, ``part_turn_deg`` by how much the part may turn on its
    fixture between two poses.
    ``moved_um`` is how far the fixture's centre may stand from where it stood in the first pose, ``marker_off_um`` by
    how much a marker may be off the others before it is left out; 0.3 px are always allowed.

    The markers' white, black and greys are read in every picture. Against the reference of the fixture ``white_share``
    limits how much the white of a pose may differ from the other poses, ``level_share`` its distance from the reference
    (from ``level_note_share`` on a note says so), ``gradient_share`` that of one marker from the others,
    ``stray_share`` stray light relative to white, ``grey_share`` the deviation of a grey from a straight line through
    black and white, relative to white. Without a reference ``white_untaught_share`` takes the place of
    ``white_share``, and ``black_share`` limits the black of the markers relative to their white.

    Frames of one pose are compared before they are averaged: ``frame_level`` is how far the light of one may differ
    from the others', ``frame_difference`` the root mean square of its difference in any few rows as a share of their
    signal, and ``plateau_share`` the share of its pixels on one largest count below full scale.
    """

    saturated_share: Share = 0.001
    registration_px: Positive = 0.5
    angle_deg: Positive = 0.5
    scale_share: Share = 0.02
    drift: Positive = 0.02
    min_signal_share: Share = 0.01
    fixture_um: Positive = 250.0
    beyond_part_um: NotNegative = 0.0
    moved_um: Positive = 100.0
    marker_off_um: NotNegative = 3.0
    part_turn_deg: Positive = 2.0
    white_share: Share = 0.01
    white_untaught_share: Share = 0.03
    level_note_share: Share = 0.03
    level_share: Share = 0.1
    gradient_share: Share = 0.05
    stray_share: Share = 0.02
    grey_share: Share = 0.01
    black_share: Share = 0.1
    frame_level: Positive = 0.05
    frame_difference: Positive = 0.1
    plateau_share: Positive = 0.001


class CommonUncertainty(Part):
    """Standard uncertainties of the rig that a single inspection cannot determine."""

    light_angle_deg: NotNegative = 0.1
    stage_deg: NotNegative = 0.05
    seating_tilt_deg: NotNegative = 0.1
    flat_share: NotNegative = 0.002
    scale_share: NotNegative = 0.02
    linearity_share: NotNegative = 0.001
    stray_radiance: NotNegative = 0.0003


class ReportPart(Part):
    """Lines of the report in the shop's own words; ``reviewer`` adds a line to be signed, ``logo`` is a PNG or SVG."""

    company: Annotated[str, Field(max_length=80)] = ""
    drawing: Annotated[str, Field(max_length=80)] = ""
    reviewer: Annotated[str, Field(max_length=80)] = ""
    logo: LocalPath | None = None


class RecipeBase(Part):
    """Common tables of the recipes of all kinds; a kind adds its own tables, and may narrow these."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    kind: str | None = None
    product: Annotated[str, Field(min_length=1, max_length=200)]
    version: Annotated[int, Field(ge=1)] = 1
    poses: PosesPart = PosesPart()
    acquisition: AcquisitionPart
    region: RegionPart
    decision: DecisionBase = DecisionBase()
    limits: LimitsPart = LimitsPart()
    uncertainty: CommonUncertainty = CommonUncertainty()
    actions: dict[str, Annotated[str, Field(min_length=1, max_length=300)]] = Field(default_factory=dict)
    """What to do next in the shop's own words, by cause or outcome."""
    report: ReportPart = ReportPart()

    steps: ClassVar[str] = "cells"
    """Unit of which the region is a whole number, in the plural."""
    margin_at_markers: ClassVar[bool] = False
    """The taught region keeps one step clear of the markers, where the edge of the part may be."""
    described_in: ClassVar[str] = "are its tables"
    """The tables that describe the expected part, with their verb."""

    @property
    def step_mm(self) -> float:
        """Increment of the size of a region."""
        return 0.1

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a recipe of this kind; ``${here}`` in it is the folder of the file.

        Raises:
            RecipeError: the file is missing or wrong; the message names file, key and what is expected.
        """
        found = cls.parsed(path)
        found.check_named(path)
        return found

    @classmethod
    def parsed(cls, path: Path) -> Self:
        """As `read`, without a look at what the recipe names."""
        return read_toml_model(
            path, cls, error=RecipeError, substitutions={"here": str(path.resolve().parent)}
        )

    def check_named(self, path: Path) -> None:
        """Check what the recipe names, such as files; nothing by default.

        Args:
            path: of the recipe, for the message.

        Raises:
            RecipeError: it cannot be used.
        """


def check_region(recipe: RecipeBase, fixture: Fixture | None, path: Path) -> None:
    """Check that the region keeps off the markers of the fixture.

    Args:
        recipe: the recipe.
        fixture: of the rig, or None.
        path: of the recipe's file, for the message.

    Raises:
        RecipeError: it covers markers.
    """
    turn = np.radians(recipe.poses.facet_azimuth_deg)
    axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    half = 0.5 * np.array(recipe.region.size_mm)
    covered = []
    for marker in () if fixture is None else fixture.markers:
        apart = np.array([marker.x_mm, marker.y_mm]) - recipe.region.center_mm
        side = 0.5 * fixture.marker_mm if fixture is not None else 0.0
        reach = side * np.abs(axes).sum(axis=1)
        # two rectangles are apart if they are so along a side of either
        along_region = np.abs(axes @ apart) < half + reach
        along_marker = np.abs(apart) < side + np.abs(axes.T) @ half
        if along_region.all() and along_marker.all():
            covered.append(str(marker.id))
    if covered:
        raise RecipeError(
            f"{path}: the region covers {'markers' if len(covered) > 1 else 'marker'} {', '.join(covered)} of the "
            "fixture: make region.size_mm smaller, or correct region.center_mm"
        )
