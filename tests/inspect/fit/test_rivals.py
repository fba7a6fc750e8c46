"""Light that is not the model's: the rival that made it is found, or no interval is given; a good fit stays as it is.

The light is that of the path tracer, of closed forms written here, or of no surface at all.
"""

import json

import numpy as np
import pytest

from anisoscope.fit.fitting import fit, fit_or_rival
from anisoscope.fit.parameters import USUAL, checked_values
from anisoscope.fit.problem import Problem, Readings, Scene
from anisoscope.parameters.geometry import Convention
from anisoscope.parameters.ridges import RidgeDesign
from anisoscope.profiles.ideal import ridges
from anisoscope.sim.light.geometry import directions, pose_grid
from anisoscope.sim.pathtracer.plastic import Plastic
from anisoscope.sim.pathtracer.tracer import PathTracer

POSES = pose_grid((0.0, 45.0, 90.0, 180.0, 270.0), (-15.0, 0.0, 15.0))
CONVENTION, PITCH, POINTS = Convention(), 100.0, 2000
ALBEDO, U = 0.25, 0.004


def problem(value, u, place, free, kind="exposure", given=None):
    count = np.arange(len(value))
    gain = 1.0 / place.to_light[:, 2] if kind == "brdf" else None
    covariance = np.diag(np.full(len(value), 1.0) if u is None else u**2)
    readings = Readings(
        kind, count, count, value, covariance, u is not None, ("",) * len(value), "made", gain
    )
    return Problem(place, readings, checked_values({"albedo": ALBEDO} | (given or {})), free)


def traced(design, lobe="beckmann"):
    """Ridges lit once by the path tracer, on a mesh that shares nothing with the model's outline."""
    surface = ridges(design, (3, 2 * POINTS + 1), (PITCH, PITCH / POINTS))
    tracer = PathTracer(surface, Plastic(0.07, 0.11, ALBEDO, 1.5, lobe), pitch_um=PITCH)
    to_light, to_camera = directions(POSES, CONVENTION)
    value = np.array([tracer.direct(*one).mean() for one in zip(to_light, to_camera, strict=True)])
    value *= 1.0 + U * np.random.default_rng(5).standard_normal(len(value))
    place = Scene(to_light, to_camera, bounces=1, design=RidgeDesign(PITCH, 10.0))
    return problem(value, U * value, place, USUAL)


@pytest.mark.parametrize(
    ("design", "lobe", "model", "own"),
    [
        (RidgeDesign(PITCH, 11.0), "ggx", "a lobe with a tail", {"tail": 1.0}),
        (RidgeDesign(PITCH, 11.0, edge_radius_um=6.0), "beckmann", "rounded crests", {"edge_radius_um": 6.0}),
        (RidgeDesign(PITCH, 11.0, foot_radius_um=6.0), "beckmann", "rounded feet", {"foot_radius_um": 6.0}),
        (RidgeDesign(PITCH, 11.0, 30.0), "beckmann", "a wall of another draft", {"draft_deg": 30.0}),
    ],
)
def test_what_the_model_lacks_is_found_by_its_rival(judged_figure, design, lobe, model, own):
    asked = traced(design, lobe)
    found = fit_or_rival(asked)
    assert (found.tests[0].rejected, found.fits, found.misfit.model) == (True, True, model)
    one = {e.name: e for e in found.estimates}
    for name, truth in ({"ridge_angle_deg": 11.0} | own).items():
        assert abs(one[name].value - truth) < 3.0 * one[name].u, name
        assert one[name].low95 is not None
    alone = {e.name: e for e in fit(asked).estimates}["ridge_angle_deg"]
    assert alone.u > 0.2  # as the Birge ratio has it
    angle = one["ridge_angle_deg"]
    shown = f"rejected, {alone.value:.1f} ± {alone.u:.1f}°; {found.misfit.model}: {angle.value:.2f} ± {angle.u:.2f}°"
    judged_figure("Fits", f"ridges of 11°, light of {model}", "own path tracer", shown, "11°")


def test_a_model_that_holds_stays_as_it_is(judged_figure):
    asked = traced(RidgeDesign(PITCH, 11.0))
    found, alone = fit_or_rival(asked), fit(asked)
    assert found.estimates == alone.estimates
    assert (len(found.tests), found.misfit.birge_ratio) == (1, 1.0)
    angle = found.estimates[0]
    assert abs(angle.value - 11.0) < 3.0 * angle.u
    shown = f"{angle.value:.2f} ± {angle.u:.2f}°"
    judged_figure("Fits", "ridges of 11°, light of the model's own kind", "own path tracer", shown, "11°")


def matte(albedo, sigma_deg, count=60):
    """BRDFs of a flat surface after Oren and Nayar (1994), Eq. 30, in its angles."""
    rng = np.random.default_rng(7)
    theta, phi = rng.uniform(0.0, 1.2, (2, count)), rng.uniform(0.0, 2.0 * np.pi, (2, count))
    to_light, to_camera = (
        np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=-1)
        for t, p in zip(theta, phi, strict=True)
    )
    square = np.radians(sigma_deg) ** 2
    beside = np.maximum(np.cos(phi[0] - phi[1]), 0.0) * np.sin(theta.max(axis=0)) * np.tan(theta.min(axis=0))
    value = 1.0 - 0.5 * square / (square + 0.33) + 0.45 * square / (square + 0.09) * beside
    return albedo / np.pi * value, Scene(to_light, to_camera, design=RidgeDesign(PITCH, 0.0)), rng


FLAT, ALPHAS = {"ridge_angle_deg": 0.0}, ("alpha_along", "alpha_across")


@pytest.mark.parametrize(("sigma", "model"), [(0.0, "Lambert"), (25.0, "Oren-Nayar")])
def test_a_matte_surface_has_no_lobe(sigma, model):
    value, place, rng = matte(0.5, sigma)
    u = 0.01 * value
    found = fit_or_rival(problem(value + u * rng.standard_normal(len(u)), u, place, ALPHAS, "brdf", FLAT))
    assert model in found.misfit.model
    one = {e.name: e for e in found.estimates}
    assert abs(one["albedo"].value - 0.5) < 3.0 * one["albedo"].u < 0.02
    assert "alpha_along" not in one
    if sigma:
        assert abs(one["matte_deg"].value - sigma) < 3.0 * one["matte_deg"].u


def test_without_u_a_constant_that_is_nearer_is_taken(judged_figure):
    """A grey ball under lamps that are known to 8 % only, as photographs of one are."""
    value, place, rng = matte(0.5, 0.0)
    value *= 1.0 + 0.08 * rng.standard_normal(len(value))
    found = fit_or_rival(problem(value, None, place, ALPHAS, "brdf", FLAT))
    assert "Lambert" in found.misfit.model
    lobe = fit(problem(value, None, place, ALPHAS, "brdf", FLAT)).rms
    assert found.rms < 0.085 * 0.5 / np.pi < lobe
    shown = f"constant {found.rms * np.pi / 0.5:.1%} rms, lobe {lobe * np.pi / 0.5:.1%}: constant taken"
    judged_figure("Fits", "matte ball, lamps known to 8%", "Lambert in closed form", shown, "no lobe")


def test_values_of_no_model_have_no_interval_and_exit_code_3(anisoscope, tmp_path, judged_figure):
    rows = [f"{10 + 5 * n},0,{10 + 5 * n},180,{0.05 * (1 + n % 3)},0.0002" for n in range(9)]
    head = "theta_i_deg,phi_i_deg,theta_o_deg,phi_o_deg,value,u"
    (tmp_path / "t.csv").write_text("\n".join([head, *rows]) + "\n")
    done = anisoscope("fit", "brdf", tmp_path / "t.csv", "--ridge-angle", 0, "--fit", "--json")
    assert done.code == 3, done.err
    shown = json.loads(done.out)
    assert shown["rejected"]
    assert all(one["rejected"] for one in shown["tests"])
    assert {one["low95"] for one in shown["parameters"]} == {None}
    assert any("no interval is given" in one for one in shown["notes"])
    found = f"no interval, exit code {done.code}"
    judged_figure("Fits", "values of no model", "made up", found, "no interval")
