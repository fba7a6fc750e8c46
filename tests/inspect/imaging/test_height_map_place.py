"""The recipe's height map in the pictures of an inspection: its place, what both show there, and what is only said."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.imaging.height_map_place import MapPlace, match_map, render
from anisoscope.imaging.pose_radiance import Measured
from anisoscope.imaging.registration.placement import Grid
from anisoscope.kinds import surface as surface_kind
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import Expectation
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.profiles.ideal import add_facet_roughness, ridges
from anisoscope.record.schema import DiagnosisRecord

PITCH_UM, STEP_UM = 100.0, 5.0
POSES = (Pose(0.0), Pose(90.0))
SIDE = 160


@pytest.fixture
def recipe(make_recipe):
    return make_recipe()


def surface(rough, seed=1):
    """A part of 1.2 mm × 1.2 mm."""
    plain = ridges(RidgeDesign(PITCH_UM, 10.0), (301, 601), (4.0, 2.0))
    return add_facet_roughness(plain, rough, rough, 12.0, np.random.default_rng(seed)) if rough else plain


def photographed(recipe, part, surface_known):
    """An expectation of a map, and the aligned pictures of a part."""
    shown = render(part, POSES, recipe.material.material(), Convention(10.0), STEP_UM, PITCH_UM)
    rows, cols = (np.array(shown[0].shape) - SIDE) // 2
    rng = np.random.default_rng(4)
    pictures = tuple(
        (
            one[rows : rows + SIDE, cols : cols + SIDE] * (1.0 + 0.01 * rng.standard_normal((SIDE, SIDE)))
        ).astype(np.float32)
        for one in shown
    )
    radiance = np.array([one.mean() for one in pictures])
    expected = Expectation("relief", POSES, radiance, (), np.zeros(2), surface_known, Convention(10.0))
    cells = np.ones((2, 32, 32))
    grid = Grid((0.0, 0.0), STEP_UM / 1000.0, (SIDE, SIDE))
    return expected, Measured(radiance, (), pictures, cells, np.zeros(2), grid, None)


def cut(part, rows, cols):
    return HeightMap(part.height_um[rows, cols], part.pixel_x_um, part.pixel_y_um)


def test_a_map_of_a_piece_of_the_part_is_found_and_both_agree_there(recipe):
    part = surface(0.05)
    expected, measured = photographed(recipe, part, cut(part, slice(60, 211), slice(130, 431)))
    found, note = match_map(recipe, expected, measured)
    assert (found.resolved, note) == (True, None)
    np.testing.assert_allclose([found.x_um, found.y_um], [(280 - 300) * 2.0, (135 - 150) * 4.0], atol=0.5 * 8)
    assert 0.2 < found.shared_share < 1.0
    np.testing.assert_allclose(found.measured, found.predicted, rtol=0.03)


def test_the_map_of_another_part_is_unresolved_without_a_note(recipe):
    other = cut(surface(0.05, seed=9), slice(60, 211), slice(130, 431))
    found, note = match_map(recipe, *photographed(recipe, surface(0.05), other))
    assert (found.resolved, found.x_um, found.y_um, found.measured) == (False, None, None, ())
    assert found.says.startswith("unresolved: only means are compared")
    assert note is None
    assert abs((found.phase_um + 20.0 * 2.0 + 50.0) % 100.0 - 50.0) < 5.0


def test_a_map_that_may_be_of_the_part_and_is_not_placed_has_a_note():
    unsure = MapPlace(3.0, 4.0, 3.0, 0.3, 1.2, resolved=False)
    assert unsure.note.startswith(
        "height map unresolved: only means are compared; the ridges' phase is about +3 µm"
    )
    assert replace(unsure, correlation=0.05).note is None


def test_without_a_map_nothing_is_said_and_a_small_one_is_not_matched(recipe):
    part = surface(0.05)
    expected, measured = photographed(recipe, part, cut(part, slice(0, 100), slice(0, 40)))
    found, note = match_map(recipe, expected, measured)
    assert found is None
    assert "smaller than one pitch): only means are compared" in note
    assert match_map(recipe, replace(expected, surface=None), measured) == (None, None)


@pytest.mark.parametrize("reflections", [True, pytest.param(False, marks=pytest.mark.soak)])
def test_a_whole_inspection_tells_where_the_recipes_map_lies(virtual_rig, tmp_path, monkeypatch, reflections):
    monkeypatch.setattr(
        surface_kind, "explain", lambda *_, **__: (DiagnosisRecord(says=""), None)
    )  # causes take longer than all the rest
    plain = ridges(RidgeDesign(PITCH_UM, 10.0), (301, 601), (4.0, 2.0))
    part = add_facet_roughness(plain, 0.08, 0.08, 20.0, np.random.default_rng(6))
    write_height_map(part, tmp_path / "part.x3p")
    known = cut(part, slice(59, 260), slice(80, 481))
    write_height_map(known, tmp_path / "known.x3p")
    rig = virtual_rig(
        recipe={
            "surface": {
                "design": None,
                "height_map": str(tmp_path / "known.x3p"),
                "reflections": "all" if reflections else "direct",
            }
        },
        bench={
            "sample": {
                "kind": "height-map",
                "file": str(tmp_path / "part.x3p"),
                "pitch_um": None,
                "ridge_angle_deg": None,
                "resolved_alpha": None,
                "reflections": reflections,
            }
        },
    )
    record = rig.inspect().record
    found = record.details.map_place
    assert (found.resolved, found.ratio > 2.0) == (True, True)
    np.testing.assert_allclose([found.x_um, found.y_um], [(280 - 300) * 2.0, (159 - 150) * 4.0], atol=2.0)
    assert abs(found.phase_um + 40.0) < 2.0
    # with reflections, an eighth of the light in the darkest pose
    np.testing.assert_allclose(found.measured, found.predicted, rtol=0.05)
    assert not any("height map" in note for note in record.notes)
