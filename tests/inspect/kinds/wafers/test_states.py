"""States of a wafer against its predictor, moved by hand; what they hold against what the budget names."""

import numpy as np
import pytest

from anisoscope.base.significance import log_basis
from anisoscope.kinds.wafers.etched import WaferLight
from anisoscope.kinds.wafers.kind import OPTICS
from anisoscope.kinds.wafers.lighting import recipe_wafer, wafer_light
from anisoscope.kinds.wafers.recipe import WaferRecipe
from anisoscope.kinds.wafers.states import EDGES, edges_u_nm
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.prediction.expectation import expectation
from anisoscope.prediction.profile_likelihood import FARTHEST, nearest_anywhere
from anisoscope.prediction.sensitivity import SECOND_ORDER
from anisoscope.profiles.files.load import write_height_map
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.sim.light.geometry import directions, seating_rotation
from anisoscope.sim.light.wave.choice import edge_widening_um

SIDE_UM = 64.0


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wafer")
    cells = np.random.default_rng(2).integers(0, 2, (32, 32))
    height = np.kron(cells, np.ones((8, 8))) * -0.13
    write_height_map(HeightMap(height, SIDE_UM / 256, SIDE_UM / 256), folder / "tile.npz")
    return WaferRecipe.model_validate(
        {
            "schema": 1,
            "product": "wafer",
            "surface": {"height_map": str(folder / "tile.npz"), "pitch_um": SIDE_UM},
            "material": {"reflectance": 0.9, "albedo": 0.002, "u_albedo": 0.0006},
            "light": {
                "wavelength_nm": 520.0,
                "bandwidth_nm": 10.0,
                "lamp_half_angle_deg": 0.6,
                "aperture_half_angle_deg": 1.4,
            },
            "poses": {"angles_deg": [0.0, 90.0, 180.0], "tilts_deg": [0.0, 3.0]},
            "acquisition": {"exposure_s": 4e-5},
            "region": {"size_mm": [0.5, 0.5]},
            "uncertainty": {
                "seating_tilt_deg": 0.05,
                "light_angle_deg": 0.05,
                "tilt_deg": 0.02,
                "step_edges_nm": 0.0,
            },
        }
    )


@pytest.fixture(scope="module")
def expected(recipe):
    return expectation(recipe, 0.0, OPTICS)


def moved(states, **z):
    """State vector of a few inputs by the beginning of their names."""
    return np.array(
        [
            next((v for k, v in z.items() if source.startswith(k.replace("_", " "))), 0.0)
            for source in states.sources
        ]
    )


def test_states_hold_all_that_the_budget_names_but_errors_of_each_pose(expected):
    assert [component.source for component in expected.outside_states] == [
        "numerical error of the wave model"
    ]
    named = {
        c.source for c in expected.components if not c.source.endswith((SECOND_ORDER, "beyond the slope"))
    }
    assert named == {*expected.states.sources, "numerical error of the wave model"}


def test_a_state_is_the_predictor_of_a_wafer_and_a_lamp_and_a_seat_that_are_so(recipe, expected):
    states, part = expected.states, recipe.light
    z = moved(
        states,
        wavelength=1.0,
        aperture=-2.0,
        depth=1.5,
        width=-2.0,
        seating_tilt_about_x=2.0,
        light=1.0,
        zero=3.0,
    )
    wafer, _ = recipe_wafer(recipe, 0.0)
    told = wafer_light(part)
    light = WaferLight(
        told.wavelength_nm + part.u_wavelength_nm,
        told.bandwidth_nm,
        told.lamp_half_angle_deg,
        told.aperture_half_angle_deg * (1.0 - 2.0 * part.u_aperture_share),
    )
    made = wafer.with_widths(-2.0 * recipe.uncertainty.etch_width_nm).under(light)
    made = made.with_depths(1.5 * recipe.uncertainty.etch_depth_nm)
    poses = tuple(Pose(pose.stage_deg, pose.tilt_deg + 0.06) for pose in expected.poses)
    seat = seating_rotation(0.1, 0.0)
    to_light, to_camera = directions(poses, Convention(0.05))
    seen = made(to_light @ seat, to_camera @ seat, recipe.material.material())
    np.testing.assert_allclose(states.change(z), np.log(seen / expected.radiance), atol=1e-6)
    np.testing.assert_allclose(states.change(np.zeros((2, 3, z.size))), np.zeros((2, 3, 6)), atol=1e-12)


def test_tangents_are_those_of_the_states(expected):
    states = expected.states
    z = moved(states, depth=1.0, seating=0.5)
    tangent = states.tangent(z)
    assert tangent.shape == (6, z.size)
    step = 0.1 * np.eye(z.size)
    by_hand = (states.change(z + step) - states.change(z - step)) / 0.2
    np.testing.assert_allclose(tangent, by_hand.T, atol=0.03 * np.abs(by_hand).max())


def test_a_wafer_that_is_off_within_what_is_stated_is_as_far_as_that(expected):
    """Also by the depth, whose effect begins with its square, and to either side."""
    states, own = expected.states, 1e-6 * np.eye(6)
    for depth in (-2.0, 2.0):
        z = moved(states, depth=depth, seating_tilt_about_x=1.5, light=-1.0)
        found = nearest_anywhere(states, np.eye(6), states.change(z), own)[0]
        assert found <= z @ z + 1e-3
        assert found > 0.7 * z @ z


def test_a_part_that_is_nothing_of_the_kind_is_far_off_and_no_state_is_asked_for_that_the_tile_does_not_know(
    expected,
):
    """What no state explains drives the search to the ends: D² says so, not an error."""
    states, own = expected.states, 1e-6 * np.eye(6)
    for off in (np.array([2.0, -2.0, 2.0, -1.0, 1.0, 3.0]), np.array([0.0, 0.0, 0.0, 5.0, -5.0, 5.0])):
        assert nearest_anywhere(states, np.eye(6), off, own)[0] > 1e4
    for ends in (np.full(len(states.sources), FARTHEST), np.full(len(states.sources), -FARTHEST)):
        assert np.isfinite(states.change(ends)).all()


def test_wrong_etching_is_as_far_off_as_it_is_wrong_however_far(expected):
    """Twenty standard uncertainties of depth are 400, not what a bound of the search leaves."""
    states, own = expected.states, 1e-6 * np.eye(6)
    found = nearest_anywhere(states, np.eye(6), states.change(moved(states, depth=20.0)), own)[0]
    assert 0.7 * 400.0 < found <= 400.0 + 1e-2


def test_waves_of_the_edges_are_states_of_the_wafer(recipe, expected):
    """In phase they act as a widening to first order; bounded as by rigorous waves, unless the recipe states them."""
    free = recipe.model_copy(
        update={"uncertainty": recipe.uncertainty.model_copy(update={"step_edges_nm": None})}
    )
    found = expectation(free, 0.0, OPTICS)
    assert set(found.states.sources) == {*expected.states.sources, *EDGES}
    wafer, _ = recipe_wafer(free, 0.0)
    u_nm = edges_u_nm(free, wafer, 0.0)
    um, depth = 1e-3 * free.light.wavelength_nm, float(np.ptp(wafer.tile.levels_um))
    slant = np.tan(np.radians(max(abs(tilt) for tilt in free.poses.tilts_deg)))
    assert u_nm == pytest.approx(500.0 * edge_widening_um(depth, um, slant))
    in_phase = found.states.change(moved(found.states, **{EDGES[0].replace(" ", "_"): 0.05}))
    wider = found.states.change(moved(found.states, width=0.05 * u_nm / free.uncertainty.etch_width_nm))
    np.testing.assert_allclose(in_phase, wider, atol=0.1 * np.abs(wider).max())
    rows = {component.source for component in found.components}
    assert any(row.startswith(EDGES[1]) for row in rows)
    assert not any(component.source.startswith("edges") for component in expected.components)


@pytest.fixture(scope="module")
def of_two_passes(recipe, tmp_path_factory):
    """Recipes of a wafer of two passes, whose edges are not known, by the uncertainty of its seat."""
    folder = tmp_path_factory.mktemp("two-passes")
    cells = np.random.default_rng(3).integers(0, 2, (2, 32, 32))
    height = np.kron(-0.1073 * cells[0] - 0.1575 * cells[1], np.ones((8, 8)))
    write_height_map(HeightMap(height, SIDE_UM / 256, SIDE_UM / 256), folder / "tile.npz")
    surface = recipe.surface.model_copy(update={"height_map": folder / "tile.npz"})

    def of(seat_deg):
        rig = recipe.uncertainty.model_copy(update={"seating_tilt_deg": seat_deg, "step_edges_nm": None})
        return recipe.model_copy(update={"surface": surface, "uncertainty": rig})

    return of


def test_a_wafer_of_two_passes_is_no_farther_than_its_own_state(of_two_passes):
    """Every phase of the edges has a minimum of its own: the search finds one as deep as where the wafer is."""
    states, rng = expectation(of_two_passes(0.05), 0.0, OPTICS).states, np.random.default_rng(1)
    basis, own = log_basis(6), 2.5e-5 * np.eye(5)
    for _ in range(4):
        z, noise = rng.standard_normal(len(states.sources)), rng.standard_normal(5)
        seen = basis @ states.change(z) + 5e-3 * noise
        assert nearest_anywhere(states, basis, seen, own)[0] <= z @ z + noise @ noise + 0.01


def test_the_distance_falls_where_more_is_uncertain(of_two_passes):
    """Whatever is uncertain; and no state of a single input is nearer than the nearest one of all."""
    wide, basis, own = expectation(of_two_passes(0.08), 0.0, OPTICS).states, log_basis(6), 2.5e-5 * np.eye(5)
    rng = np.random.default_rng(2)
    seen = basis @ wide.change(1.5 * rng.standard_normal(len(wide.sources)))
    narrow = [
        expectation(of_two_passes(u), 0.0, OPTICS).states for u in (0.045, 0.05, 0.051, 0.055, 0.06, 0.07)
    ]
    found = [nearest_anywhere(states, basis, seen, own)[0] for states in (*narrow, wide)]
    assert found[0] > 1.0
    assert max(np.diff(found)) < 0.02 * found[0]
    alone = np.vstack([z * np.eye(len(wide.sources)) for z in np.linspace(-4.0, 4.0, 17)])
    rest = seen - wide.change(alone) @ basis.T
    each = np.sum(alone**2, axis=1) + np.sum(rest @ np.linalg.inv(own) * rest, axis=1)
    assert found[-1] <= each.min()
