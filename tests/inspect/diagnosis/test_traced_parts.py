"""Causes and severities of parts rendered by the path tracer, which shares nothing with the signatures.

Good parts scatter as the recipe states. The light of a class of parts is traced on drawn parts of it, and a polynomial
in what scatters is fitted to ln L, so that many parts can be drawn from few traced ones; its misfit is the tracer's own
noise. Every pose has 0.3 % of noise besides.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from anisoscope.diagnosis.evidence import Evidence, against, background_of, covariance_of, inputs_of
from anisoscope.diagnosis.ranking import diagnose
from anisoscope.diagnosis.separability import separability
from anisoscope.diagnosis.signatures import signatures
from anisoscope.kinds.ridges.recipe import RidgeRecipe
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.prediction.expectation import Component, expectation
from anisoscope.profiles.defects_contact import edge_wear
from anisoscope.profiles.ideal import ridges
from anisoscope.sim.light.geometry import directions, seating_rotation
from anisoscope.sim.pathtracer.plastic import Plastic
from anisoscope.sim.pathtracer.tracer import PathTracer

LIGHT, PITCH_UM, NOISE, STAGE_DEG = 10.0, 100.0, 0.003, 0.03
ALPHA, ALBEDO, ANGLE_DEG = 0.085, 0.1, 10.0
POINTS, ROWS, PATHS, BRIGHT = 400, 31, 16384, 0.25  # a pitch, along the ridges, paths of a bright pose
SCATTER = np.array([0.1, 0.05, 0.05, 0.03, 0.1, 0.1])
"""Ridge angle, ln of both roughnesses, albedo (relative) and seating about x and y of good parts, 1 σ."""


@dataclass(frozen=True)
class Kind:
    """A class of parts: the cause that is right, its severity, and what is changed on a good part."""

    cause: str
    severity: float
    angle: float = 0.0
    along: float = 1.0
    across: float = 1.0
    albedo: float = 1.0
    loss: float = 0.0
    wear_um: float = 0.0
    seat_y: float = 0.0


KINDS = {
    "angle+1": Kind("ridge-angle", 1.0, angle=1.0),
    "rough+30": Kind("roughness", 0.3, along=1.3, across=1.3),
    "loss-10": Kind("incomplete-filling", 0.1, loss=0.1),
    "wear-5": Kind("wear", 5.0, wear_um=5.0),
}


def recipe_of(tilts, reflections="all"):
    return RidgeRecipe.model_validate(
        {
            "schema": 1,
            "product": "traced ridges",
            "surface": {
                "pitch_um": PITCH_UM,
                "design": {"ridge_angle_deg": ANGLE_DEG, "u_ridge_angle_deg": 0.1},
                "reflections": reflections,
            },
            "material": {
                "alpha_along": ALPHA, "alpha_across": ALPHA, "albedo": ALBEDO, "u_alpha_share": 0.05, "u_albedo": 0.003,
                "u_tail": 0.0,
            },
            "poses": {"angles_deg": [0.0, 90.0, 180.0], "tilts_deg": tilts},
            "acquisition": {"exposure_s": 0.001},
            "region": {"size_mm": [2.4, 0.7]},
            "area": {"max_share": 0.02},
            "uncertainty": {"seating_tilt_deg": 0.1},
        }
    )  # fmt: skip


def surface_of(kind, angle_deg):
    """Ridges of a class, smooth: all roughness is in the lobe."""
    design = RidgeDesign(PITCH_UM, angle_deg, height_loss=kind.loss)
    found = ridges(design, (ROWS, 6 * POINTS + 1), (PITCH_UM, PITCH_UM / POINTS))
    return edge_wear(found, kind.wear_um) if kind.wear_um else found


def traced(kind, off, poses, seed, *, reflections=6):
    """(P,) ln L of a part of a class; ``off`` in units of `SCATTER`."""
    angle, along, across, albedo, *seat = off * SCATTER
    plastic = Plastic(
        ALPHA * kind.along * np.exp(along),
        ALPHA * kind.across * np.exp(across),
        ALBEDO * kind.albedo * (1.0 + albedo),
        1.5,
        "beckmann",
    )
    surface = surface_of(kind, ANGLE_DEG + kind.angle + angle)
    tracer = PathTracer(surface, plastic, pitch_um=PITCH_UM, reflections=reflections, seed=seed)
    turned = seating_rotation(seat[0], seat[1] + kind.seat_y)
    to_light, to_camera = (side @ turned for side in directions(poses, Convention(LIGHT)))
    inner = slice(POINTS, 5 * POINTS)
    found = []
    for light, camera in zip(to_light, to_camera, strict=True):
        direct = float(tracer.direct(light, camera)[:, inner].mean(dtype=np.float64))
        tracer.paths = int(PATHS * np.clip(BRIGHT / direct, 1.0, 16.0))  # dim poses have more to be traced
        indirect = tracer.indirect(light, camera).mean if reflections > 1 else 0.0
        found.append(np.log(direct + indirect))
    return np.array(found)


def terms(off):
    """(N, T) terms of the polynomial of (N, 6) parts: linear, and what turns the facets to second order."""
    turned = off[:, [0, 4, 5]]
    squares = np.stack([turned[:, i] * turned[:, j] for i, j in ((0, 0), (0, 2), (2, 2), (1, 1))], axis=1)
    return np.hstack([np.ones((len(off), 1)), off, squares])


def light_of(kind, poses, count, seed):
    """Polynomial of ln L of a class, from ``count`` traced parts: (T, P)."""
    off = np.random.default_rng(seed).standard_normal((count, len(SCATTER)))
    lines = np.array([traced(kind, row, poses, seed=n + 1) for n, row in enumerate(off)])
    return np.linalg.lstsq(terms(off), lines, rcond=None)[0]


def truth(kind, off):
    """Severity of a part: what belongs to an input of the prediction is how far that is off in all."""
    angle, along, across, albedo, *_ = off * SCATTER
    return {
        "ridge-angle": kind.angle + angle,
        "roughness": kind.along * np.exp(0.5 * (along + across)) - 1.0,
        "roughness-across": kind.across * np.exp(across) - 1.0,
        "colour": kind.albedo * (1.0 + albedo) - 1.0,
    }.get(kind.cause, kind.severity)


def drawn(light, kind, count, expected, rng):
    """(count, P) ln L as measured, and (count,) severities."""
    off = rng.standard_normal((count, len(SCATTER)))
    parts = terms(off) @ light
    return measured(parts, expected, rng), np.array([truth(kind, row) for row in off])


def measured(parts, expected, rng):
    """(N, P) ln L with the noise of the camera and the errors of the stage."""
    return parts + np.hypot(NOISE, STAGE_DEG * expected.per_degree) * rng.standard_normal(parts.shape)


class World:
    """What a campaign needs of a recipe."""

    def __init__(self, recipe, known):
        self.recipe, self.known = recipe, known
        self.expected = expectation(self.recipe, LIGHT)
        self.poses = self.expected.poses
        own = (
            Component("own", "measurement", np.full(len(self.poses), NOISE), shared=False),
            Component("stage", "measurement", STAGE_DEG * self.expected.per_degree, shared=False),
        )
        self.inputs = inputs_of(self.recipe, self.expected, own)
        scale = self.recipe.uncertainty.scale_share
        self.covariance = covariance_of(self.expected.components + own, scale, len(self.poses))
        self.background = background_of(self.recipe.area.max_share)

    def evidence(self, log_radiance, golden=None):
        """Evidence of a part without marks, the share of deviating cells that of good parts; its pitch is right."""
        found = Evidence(
            log_radiance - np.log(self.expected.radiance),
            self.covariance,
            0.002,
            0.001,
            *self.background,
            self.inputs,
            pitch=(0.0, 0.2),
        )
        if golden is None:
            return found
        return against(found, golden - np.log(self.expected.radiance), self.recipe.uncertainty.scale_share)

    def separable(self):
        """Least extent from which every cause is separable from the others."""
        rows = separability(
            self.known, self.covariance, with_map=True, u_background=self.background[1], inputs=self.inputs
        )
        return {row.cause: row.separation_extent for row in rows}


def counted(world, kind, parts, golden=None):
    """Shares of parts (ln L, severities) with the right cause first, among the ties, and within its interval."""
    first, tied, held = [], [], []
    for number, (row, severity) in enumerate(zip(*parts, strict=True)):
        found = diagnose(
            world.known, world.evidence(row, None if golden is None else golden[number % len(golden)])
        )
        right = next(one for one in found.causes if one.cause == kind.cause)
        low, high = right.interval
        first.append(found.causes[0].cause == kind.cause)
        tied.append(right.tie)
        held.append((low is None or low <= severity) and (high is None or severity <= high))
    return np.mean(first), np.mean(tied), np.mean(held)


GOOD = Kind("nothing", 0.0)
QUICK = {
    "angle+1": KINDS["angle+1"],
    "colour+40": Kind("colour", 0.4, albedo=1.4),
}


@pytest.fixture(scope="module")
def of_direct_light(by_closed_form):
    """Tilted poses, direct light alone on both sides."""
    recipe = recipe_of([0.0, -10.0, 10.0], "direct")
    names = ("ridge-angle", "roughness", "roughness-along", "roughness-across", "colour")
    return World(recipe, by_closed_form(recipe, (*names, "seating-x", "seating-y", "light-angle")))


@pytest.mark.parametrize("name", QUICK)
def test_traced_parts_have_the_right_cause_first_and_within_its_interval(of_direct_light, name):
    kind, rng = QUICK[name], np.random.default_rng(11)
    off = 0.5 * rng.standard_normal((2, len(SCATTER)))
    light = np.array([traced(kind, row, of_direct_light.poses, 1, reflections=1) for row in off])
    parts = measured(light, of_direct_light.expected, rng)
    assert counted(of_direct_light, kind, (parts, [truth(kind, row) for row in off])) == (1.0, 1.0, 1.0)


@pytest.fixture(scope="module")
def campaign():
    """Tilted poses with all reflections, and the light of every class."""
    recipe = recipe_of([0.0, -10.0, 10.0])
    world = World(recipe, signatures(recipe, LIGHT))
    return world, {
        name: light_of(kind, world.poses, TRACED, 1) for name, kind in {"good": GOOD, **KINDS}.items()
    }


TRACED, DRAWN, SETS = 16, 60, 20


@pytest.mark.statistics
@pytest.mark.parametrize("golden", [0, 3])
@pytest.mark.parametrize("name", KINDS)
def test_causes_of_many_traced_parts(campaign, name, golden):
    """At least four of five right causes first, 95 % among the ties, and severities within their intervals."""
    world, lights = campaign
    rng = np.random.default_rng([5, golden])
    sets = (
        [drawn(lights["good"], GOOD, golden, world.expected, rng)[0] for _ in range(SETS)] if golden else None
    )
    parts = drawn(lights[name], KINDS[name], DRAWN, world.expected, rng)
    first, tied, held = counted(world, KINDS[name], parts, sets)
    assert first >= 0.8
    assert tied >= 0.95
    assert held >= 0.845  # three standard deviations of 60 draws below 0.94
