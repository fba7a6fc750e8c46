"""Signatures by the closed form, which are quick."""

import numpy as np
import pytest

from anisoscope.diagnosis.causes import all_causes, tail_cause
from anisoscope.diagnosis.signatures import Signature, Signatures
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.sensitivity import State
from anisoscope.sim.light import corrected
from anisoscope.sim.light.geometry import directions

LIGHT_DEG = 10.0


def direct_light(poses, state, angle_deg=10.0):
    """(P,) direct light of ideal ridges, pitch 100 µm."""
    sides = directions(poses, Convention(state.light_angle_deg))
    design = RidgeDesign(100.0, angle_deg)
    return corrected.radiance(*sides, design, state.material, bounces=1)


def closed_form(recipe, names):
    """Signatures of named causes in direct light, and of the tail of the lobe."""
    poses = recipe.poses.poses()
    nominal = State(recipe.material.material(), LIGHT_DEG)
    good = direct_light(poses, nominal)

    def seen(cause, extent):
        if cause.name == "ridge-angle":
            return direct_light(poses, nominal, 10.0 + extent)
        return direct_light(poses, cause.change(None, nominal, extent)[1])

    def signature(cause):
        change = np.log(np.array([seen(cause, extent) for extent in cause.extents]) / good)
        extents = np.array(cause.extents)
        return Signature(cause, extents, change, np.zeros(len(extents)))

    found = tuple(signature(cause) for cause in all_causes(10.0) if cause.name in names)
    return Signatures(poses, good, 0.0, found, (), signature(tail_cause()))


@pytest.fixture(scope="package")
def by_closed_form():
    """``by_closed_form(recipe, names)`` computes signatures."""
    return closed_form


@pytest.fixture(scope="package")
def shown_by():
    """``shown_by(poses, state, angle_deg)`` is the direct light of ideal ridges."""
    return direct_light
