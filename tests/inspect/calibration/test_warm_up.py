"""A known lamp comes back from its frames: drift, time constant, and how long to wait."""

import math

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError, UsageError
from anisoscope.calibration.warm_up import fit_warmup
from anisoscope.sim.bench.bench import Bench
from anisoscope.sim.bench.benchfile import BenchFile
from anisoscope.sim.bench.camera import SimulatedCamera, SimulatedLight


def series(share=0.0, tau_s=60.0, per_minute=0.0, noise=0.0, seconds=300, step=2.0, seed=0):
    t = np.arange(0.0, seconds, step)
    level = 1000.0 * (1.0 + share * np.exp(-t / tau_s) + per_minute * t / 60.0)
    return t, level * (1.0 + noise * np.random.default_rng(seed).standard_normal(len(t)))


@pytest.mark.parametrize("share", [0.05, -0.03])
@pytest.mark.parametrize("tau_s", [20.0, 80.0])
@pytest.mark.parametrize("per_minute", [0.0, 0.002])
def test_without_noise_everything_comes_back(share, tau_s, per_minute):
    t, level = series(share, tau_s, per_minute)
    found = fit_warmup(t, level)
    end, last = t[-1], level[-1] / 1000.0
    drift = per_minute - 60.0 * share / tau_s * math.exp(-end / tau_s)
    assert found.time_constant_s == pytest.approx(tau_s, rel=1e-3)
    assert found.warmup_share == pytest.approx(share / last, rel=1e-3)
    assert found.steady_per_minute == pytest.approx(per_minute / last, abs=1e-6)
    assert found.drift_per_minute == pytest.approx(drift / last, abs=1e-6)
    assert found.noise_share < 1e-6


def test_the_wait_ends_where_the_warm_up_changes_by_what_is_allowed():
    t, level = series(0.1, 90.0, seconds=120)
    found = fit_warmup(t, level, allowed_per_minute=0.001)
    assert found.verdict == "cold"
    then = t[-1] + found.wait_s
    rate = 60.0 * 0.1 / 90.0 * math.exp(-then / 90.0) / (level[-1] / 1000.0)
    assert rate == pytest.approx(0.001, rel=0.01)
    assert "not warm yet" in found.sentence()
    assert f"wait {found.wait_s / 60:.1f} min" in found.sentence()


def test_uncertainties_are_as_large_as_the_errors():
    """Over many series, the errors of the drift scatter as their uncertainties say."""
    for settings in ({"per_minute": 0.001}, {"share": 0.05, "tau_s": 60.0, "per_minute": 0.001}):
        pulls = []
        for seed in range(80):
            t, level = series(**settings, noise=0.001, seed=seed)
            found = fit_warmup(t, level)
            share, tau = settings.get("share", 0.0), settings.get("tau_s", 1.0)
            truth = settings["per_minute"] - 60.0 * share / tau * math.exp(-t[-1] / tau)
            pulls.append((found.drift_per_minute - truth) / found.drift_uncertainty)
        assert abs(np.mean(pulls)) < 0.35
        assert 0.8 < np.std(pulls) < 1.35


def test_noise_alone_is_no_warm_up():
    invented = 0
    for seed in range(60):
        found = fit_warmup(*series(noise=0.0005, seed=seed))
        invented += found.time_constant_s is not None
        assert found.verdict == "warm"
    assert invented <= 3


def test_a_short_and_noisy_series_decides_nothing():
    found = [fit_warmup(*series(noise=0.003, seconds=30, seed=seed)) for seed in range(50)]
    undecided = [one for one in found if one.verdict == "undecided"]
    assert len(undecided) >= 42  # two standard uncertainties are exceeded one time in twenty
    assert "watch it for longer" in undecided[0].sentence()


def test_a_steady_drift_is_not_waited_for():
    found = fit_warmup(*series(per_minute=0.01, noise=0.0005))
    assert found.verdict == "cold"
    assert found.wait_s is None
    assert "does not settle" in found.sentence()


@pytest.mark.parametrize(
    ("t", "level", "error"),
    [
        (np.arange(5.0), np.ones(5), UsageError),
        (np.zeros(10), np.ones(10), UsageError),
        (np.arange(10.0), np.full(10, np.nan), UsageError),
        (np.arange(10.0), np.zeros(10), CalibrationError),
    ],
)
def test_what_is_no_series(t, level, error):
    with pytest.raises(error):
        fit_warmup(t, level)


def bench_with(**optics):
    return Bench(
        BenchFile.model_validate(
            {
                "schema": 1,
                "sample": {"kind": "white-tile"},
                "sensor": {"rows": 96, "cols": 96},
                "optics": {"lamp_noise": 0.0003, **optics},
            }
        )
    )


def watched(bench, frames=90):
    """Fit of frames two seconds apart after the lamp is switched on."""
    camera = SimulatedCamera(bench)
    camera.configure(0.008, 1.0)
    SimulatedLight(bench).on()
    levels = [float(camera.grab().mean()) - camera.info.black_level for _ in range(frames)]
    return fit_warmup(2.0 * np.arange(frames), levels)


def test_the_lamp_of_the_bench_warms_up_as_set():
    bench = bench_with(lamp_warmup_share=0.06, lamp_warmup_frames=15.0)
    found = watched(bench)
    assert found.time_constant_s == pytest.approx(30.0, rel=0.05)
    assert found.warmup_share == pytest.approx(0.06, rel=0.05)
    assert found.verdict == "warm"
    again = watched(bench)  # it is warm already
    assert abs(again.warmup_share) < 0.003


def test_a_lamp_in_the_dark_cools_down():
    bench = bench_with(lamp_warmup_share=0.06, lamp_warmup_frames=15.0)
    watched(bench)
    bench.light_on = False
    for _ in range(100):
        bench.photograph(0.001, 1.0)
    assert watched(bench).warmup_share == pytest.approx(0.06, rel=0.06)


def test_the_lamp_of_the_bench_drifts_as_set():
    # a share per frame, a frame every two seconds
    found = watched(bench_with(lamp_drift_per_frame=0.0002))
    assert found.drift_per_minute == pytest.approx(0.006 / (1.0 + 0.0002 * 89), rel=0.03)
    assert found.wait_s is None
