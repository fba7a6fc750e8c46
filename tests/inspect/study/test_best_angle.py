"""The best ridge angle: agreement with the published experiment, and limits with closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import UsageError
from anisoscope.experiment.experiment import Setup, absolute_contrasts, findings
from anisoscope.parameters.material import Material
from anisoscope.parameters.workers import Workers
from anisoscope.study.best_angle import IMPERFECTIONS, best_angle, folded_mean
from anisoscope.study.convergence import Sampling

SMALL = Sampling(2, 40.0, 1.0, 2)


def study(*names, material=None):
    return best_angle(names, material or Material(), SMALL, Workers(), step_deg=1.0).imperfections


def test_published_angles_are_those_of_the_experiment():
    (found,) = study("roughness")
    for curve in found.curves[::3]:
        table = absolute_contrasts(Setup("corrected", Material(curve.severity, curve.severity)))
        assert curve.published == pytest.approx(table.mean(axis=(1, 2)), rel=1e-3)
        assert curve.findings == findings(table)


def test_isotropic_roughness_moves_the_best_angle_to_ten_degrees():
    (found,) = study("roughness")
    assert found.curves[0].best_published_deg == 5.0
    assert next(curve for curve in found.curves if curve.severity == 0.1).best_published_deg == 10.0
    assert 0.085 < found.turns_at < 0.1
    assert all(np.diff([curve.best_deg for curve in found.curves]) > 0)


@pytest.mark.soak
def test_without_an_imperfection_all_agree(monkeypatch):
    names = ("height-loss", "edge-radius", "seating", "noise", "bounces", "burrs")
    for name in names:
        kind = IMPERFECTIONS[name]
        monkeypatch.setitem(IMPERFECTIONS, name, replace(kind, severities=kind.severities[:1]))
    first = [found.curves[0] for found in study(*names)]
    for other in first[1:]:  # a map with pixels of 1 µm has its own small bias
        assert other.published == pytest.approx(first[0].published, rel=5e-3)


@pytest.mark.soak
def test_fewer_than_all_orders_of_reflection_stand_in_between():
    once, twice, all_ = study("bounces")[0].curves
    assert (
        np.abs(np.subtract(all_.published, twice.published)).max()
        < np.abs(np.subtract(twice.published, once.published)).max()
    )


def test_folded_mean_has_both_limits_and_agrees_with_draws():
    values = np.array([-0.3, 0.0, 0.2])
    assert folded_mean(values, 0.0) == pytest.approx(np.abs(values))
    assert folded_mean(values, 1e-6) == pytest.approx(np.abs(values), abs=1e-6)
    assert folded_mean(np.zeros(1), 2.0)[0] == pytest.approx(2.0 * np.sqrt(2.0 / np.pi))
    draws = np.abs(values + 0.2 * np.random.default_rng(1).standard_normal((200_000, 1)))
    assert folded_mean(values, 0.2) == pytest.approx(draws.mean(axis=0), rel=0.01)


def test_noise_levels_all_angles():
    (found,) = study("noise")
    spans = [max(curve.published) / min(curve.published) for curve in found.curves]
    assert spans == sorted(spans, reverse=True)


def test_unknown_imperfections_are_refused():
    with pytest.raises(UsageError, match="'dust' is no imperfection"):
        study("dust")
    assert all(list(one.severities) for one in IMPERFECTIONS.values())
