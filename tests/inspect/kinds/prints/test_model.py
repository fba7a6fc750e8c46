"""The model of a print against the reflectance model that the virtual rig uses, and against what its states mean."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import ModelError
from anisoscope.kinds.prints.model import NAMES, Scene, State, roughness_along
from anisoscope.parameters.geometry import Convention, Pose
from anisoscope.sim.light.geometry import directions, pose_grid, seating_rotation
from anisoscope.sim.light.ink.angles import half_vector
from anisoscope.sim.light.ink.distributions import density
from anisoscope.sim.light.ink.model import brdf
from anisoscope.sim.materials.inks import synthetic_ink

POSES = pose_grid((0.0, 90.0, 180.0), (0.0, 12.0, -20.0))
WEIGHTS = np.array([[0.5, 0.0, 0.1]] * 20 + [[0.0, 1.0, 0.3]] * 21) / np.array([10.0, 21.0, 8.3])


def scene(**changes):
    ink = replace(synthetic_ink("synthetic-red"), **changes)
    return Scene(ink, 0.9, 0.05, POSES, 10.0, WEIGHTS)


def by_the_book(ink, coverage=0.9, substrate=0.05, seat=(0.0, 0.0)):
    """Channels by `sim.light.ink.model.brdf`."""
    to_light, to_camera = directions(POSES, Convention(10.0))
    turn = seating_rotation(*seat)
    to_light, to_camera = to_light @ turn, to_camera @ turn
    mixed = coverage * brdf(ink, to_light, to_camera) @ WEIGHTS + (1.0 - coverage) * substrate / np.pi
    return to_light[:, 2:] * mixed


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"alpha": 0.3},
        {"alpha": 0.15, "alpha_y": 0.24, "brush_deg": 35.0},
        {"alpha": 0.15, "alpha_y": 0.24, "brush_deg": 35.0, "distribution": "beckmann"},
    ],
)
def test_it_is_the_reflectance_model(changes):
    one = scene(**changes)
    assert one.channels() == pytest.approx(by_the_book(one.ink), rel=1e-12)
    seated = one.channels(State(seat_x_deg=1.5, seat_y_deg=-2.0))
    assert seated == pytest.approx(by_the_book(one.ink, seat=(1.5, -2.0)), rel=1e-12)


def test_states_are_the_inks_that_they_say():
    one = scene()
    ink = one.ink
    rough = replace(ink, alpha=ink.alpha * 1.1)
    assert one.channels(State(alpha=np.log(1.1))) == pytest.approx(by_the_book(rough), rel=1e-12)
    brushed = replace(ink, alpha=ink.alpha / np.sqrt(1.2), alpha_y=ink.alpha * np.sqrt(1.2))
    assert one.channels(State(ratio=np.log(1.2))) == pytest.approx(by_the_book(brushed), rel=1e-12)
    diagonal = replace(brushed, brush_deg=45.0)
    assert one.channels(State(skew=np.log(1.2))) == pytest.approx(by_the_book(diagonal), rel=1e-12)
    assert one.channels(State(missing=0.1)) == pytest.approx(by_the_book(ink, coverage=0.81), rel=1e-12)
    other = replace(ink, distribution="beckmann")
    assert one.channels(State(lobe=1.0)) == pytest.approx(by_the_book(other), rel=1e-12)
    assert one.channels(State(substrate=0.05)) == pytest.approx(by_the_book(ink, substrate=0.1), rel=1e-12)
    moved = replace(ink, wavelengths_nm=tuple(nm + 10.0 for nm in ink.wavelengths_nm))
    inner = moved.nm[:-1]  # by a whole step of 10 nm
    shifted = one.spectra(State(shift_nm=10.0))[:, 1:]
    assert shifted == pytest.approx(one.spectra()[:, :-1], rel=1e-12)
    assert inner.size == shifted.shape[1]


def test_another_ink_mixes_by_its_share():
    one = replace(scene(), other=synthetic_ink("synthetic-blue"))
    wanted = 0.95 * by_the_book(one.ink) + 0.05 * by_the_book(one.other)
    assert one.channels(State(other=0.05)) == pytest.approx(wanted, rel=1e-12)


def test_a_lean_moves_the_peak_by_its_angle():
    """Half vectors turn about x with the tilt, as flakes do that lean toward −y: the lobe is that of tilt less lean."""
    tilts = np.array([-9.0, -1.0, 0.0, 4.0, 18.0])
    one = replace(scene(), poses=tuple(Pose(0.0, float(t)) for t in tilts), coverage=1.0)

    def lobe(tilt_deg):
        to_light, to_camera = directions(tuple(Pose(0.0, float(t)) for t in tilt_deg), Convention(10.0))
        return density(half_vector(to_light, to_camera), one.ink.alpha, one.ink.alpha)

    for lean in (1.0, -2.0):
        seen = one.channels(State(tilt_y_deg=-lean)) / one.channels()
        assert seen == pytest.approx(np.tile(lobe(tilts - lean) / lobe(tilts), (3, 1)).T, rel=1e-9)


def test_many_leans_at_once_are_those_one_by_one():
    good = replace(scene(alpha_y=0.25, brush_deg=20.0), lobe=0.2)
    tilts = np.array([[0.0, 0.0], [1.5, -2.0], [-6.0, 4.0]])
    alone = [good.channels(State(tilt_x_deg=x, tilt_y_deg=y)) for x, y in tilts]
    assert good.leaning(tilts) == pytest.approx(np.array(alone), rel=1e-12)


def test_a_lobe_that_has_ended_has_a_logarithm(recwarn):
    solid = replace(scene(), coverage=1.0, substrate=0.0)
    for lobe in (-2.0, 3.0):
        assert np.all(np.isfinite(solid.log_channels(State(alpha=-3.0, lobe=lobe))))
    assert not recwarn.list


def test_brushing_is_seen_on_the_flank_of_the_lobe():
    """In the mirror direction nothing is seen of it; light and camera 10° apart see a little of it at tilt 0."""
    change = np.abs(scene().log_channels(State(ratio=0.14)) - scene().log_channels()).reshape(3, 3, 3)
    assert 0.04 < change[0].max() < 0.06
    assert change[1].max() > 2.0 * change[0].max()
    mirror = replace(scene(), light_angle_deg=1e-3)
    assert np.abs(mirror.log_channels(State(ratio=0.14)) - mirror.log_channels())[:9].max() < 1e-6


def test_slopes_are_those_of_small_steps():
    one = scene()
    for name in NAMES:
        if name in ("shift_nm", "other"):  # linear between wavelengths; another ink is needed
            continue
        step = 1e-3
        change = one.log_channels(State(**{name: step})) - one.log_channels(State(**{name: -step}))
        assert one.slope(name) == pytest.approx(change / (2.0 * step), rel=1e-3, abs=1e-5), name


def test_roughness_along_a_direction():
    ink = replace(synthetic_ink("synthetic-red"), alpha=0.15, alpha_y=0.24, brush_deg=30.0)
    assert roughness_along(ink, State(), 30.0) == pytest.approx(0.15)
    assert roughness_along(ink, State(), 120.0) == pytest.approx(0.24)
    assert roughness_along(ink, State(alpha=0.1), 120.0) == pytest.approx(0.24 * np.exp(0.1))


def test_a_half_vector_below_the_print_is_refused():
    with pytest.raises(ModelError, match="below the print"):
        scene().channels(State(tilt_x_deg=100.0))
