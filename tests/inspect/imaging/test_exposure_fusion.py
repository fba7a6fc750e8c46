"""Brackets in inspections: bright and dark poses of one part, from frames of several exposures."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from anisoscope.base.errors import CalibrationError, CameraError, RecordError
from anisoscope.imaging.exposure_fusion import Exposed, noise_of, radiance_of
from anisoscope.imaging.linearisation import WhiteReference, linearise, stack
from anisoscope.inspection.integrity import verify
from anisoscope.inspection.recompute import recompute
from anisoscope.inspection.replay import inspect_frames
from anisoscope.inspection.run import resume_part
from anisoscope.record.schema import Record
from anisoscope.rig.frame import Frame, read_frame
from anisoscope.rig.framefolder import TABLE, write_frame_folder

GAIN, READ, BLACK, FULL = 0.2, 2.0, 64.0, 4095
RATES = np.repeat(10.0 ** np.arange(2.0, 6.01, 0.5), 400)[None, :].repeat(20, axis=0)  # counts per second
WHITE = WhiteReference(np.full(RATES.shape, 1e5, np.float32), 0.3, "7", "", 0.99, "")
TRUE = RATES * 0.3 / 1e5


def exposed(time_s, rng, frames=4, darks=4, correct=lambda sample: sample):
    """Frames of a scene of known rates on a linear 12-bit sensor."""

    def shoot(rate, kind):
        counts = rng.poisson(rate * time_s / GAIN) * GAIN + rng.normal(BLACK, READ, rate.shape)
        counts = np.clip(np.rint(counts), 0, FULL).astype(np.uint16)
        return Frame(counts, kind, 12, BLACK, time_s, 1.0, 0.0, 0.0, 0.0, "", "7")

    lit = stack(shoot(RATES, "sample") for _ in range(frames))
    return Exposed(lit, stack(shoot(0.0 * RATES, "dark") for _ in range(darks)), correct)


def test_one_exposure_goes_its_usual_way_to_the_bit(rng):
    one = exposed(0.01, rng)
    found, usual = radiance_of([one], WHITE, FULL, BLACK), linearise(one.raw, one.dark, WHITE, FULL)
    for name in ("value", "noise", "saturated"):
        np.testing.assert_array_equal(getattr(found, name), getattr(usual, name))
    assert (found.signal_share, found.flicker) == (usual.signal_share, usual.flicker)


def test_the_frames_tell_gain_and_read_noise_also_where_some_are_clipped(rng):
    found = noise_of([exposed(0.002, rng), exposed(0.02, rng)], FULL, BLACK)
    assert found.counts_per_electron == pytest.approx(GAIN, rel=0.02)
    assert found.read_noise_counts == pytest.approx(READ, rel=0.02)


def test_four_decades_become_one_picture_with_its_noise(rng):
    bracket = [exposed(time_s, rng) for time_s in (0.064, 0.002, 0.016)]  # in any order
    found = radiance_of(bracket, WHITE, FULL, BLACK)
    assert found.usable.all()
    assert not found.saturated.any()
    levels = np.unique(RATES)
    for level in levels:
        here = level == RATES
        error = (found.value - TRUE)[here]
        told = float(np.sqrt(np.mean(found.noise[here] ** 2)))
        assert abs(error.mean()) < 5.0 * told / np.sqrt(here.sum()), level
        assert error.std() == pytest.approx(told, rel=0.1), level
    alone = radiance_of(bracket[:1], WHITE, FULL, BLACK)
    assert alone.saturated[levels[-1] == RATES].all()
    short = radiance_of(bracket[1:2], WHITE, FULL, BLACK)
    dim = levels[0] == RATES
    assert found.noise[dim].mean() < 0.1 * short.noise[dim].mean()


def test_exposures_that_are_not_as_stated_are_refused_by_the_light(rng):
    bracket = [exposed(time_s, rng) for time_s in (0.002, 0.016)]
    bracket[1] = replace(bracket[1], raw=replace(bracket[1].raw, exposure_s=0.012))
    with pytest.raises(CameraError, match=r"0\.002 s and 0\.012 s the light grows (7\.9|8)\S* times, not 6"):
        radiance_of(bracket, WHITE, FULL, BLACK)


def test_what_is_clipped_at_all_exposures_carries_no_value(rng):
    found = radiance_of([exposed(0.016, rng), exposed(0.064, rng)], WHITE, FULL, BLACK)
    lost = RATES * 0.016 > 1.2 * FULL
    np.testing.assert_array_equal(found.saturated, lost)
    np.testing.assert_array_equal(np.isnan(found.value), lost)


def test_a_bent_response_is_straightened_before_exposures_are_merged(rng):
    """Without that the exposures disagree, and the picture has steps where one gives way to the next."""
    bend = 2e-5  # light = signal * (1 + bend * signal): 8 % at full scale

    def shot(time_s):
        one = exposed(time_s, rng)
        signal = one.raw.mean - one.dark.mean
        counted = (np.sqrt(1.0 + 4.0 * bend * np.maximum(signal, 0.0)) - 1.0) / (2.0 * bend)
        raw = stack_with(one.raw, one.dark.mean + counted)

        def straighten(sample):
            seen = sample.mean - one.dark.mean
            return stack_with(sample, one.dark.mean + seen * (1.0 + bend * seen))

        return Exposed(raw, one.dark, straighten)

    found = radiance_of([shot(0.002), shot(0.016)], WHITE, FULL, BLACK)
    bright = (RATES > 3e3) & (RATES * 0.002 < 0.8 * FULL)
    np.testing.assert_allclose(found.value[bright].mean(), TRUE[bright].mean(), rtol=2e-3)


def stack_with(made, mean):
    return replace(made, mean=mean.astype(np.float32))


@pytest.mark.parametrize(
    ("frames", "darks", "told"), [(1, 4, "there is 1 sample frame"), (4, 1, "there is 1 dark frame")]
)
def test_too_few_frames_tell_no_noise(rng, frames, darks, told):
    bracket = [exposed(0.002, rng, frames, darks), exposed(0.016, rng, frames, darks)]
    with pytest.raises(CalibrationError, match=told):
        radiance_of(bracket, WHITE, FULL, BLACK)


# A polished dark plate: at 0° it shines 80 times as bright as at 90°.
SHINY = {"alpha_along": 0.03, "alpha_across": 0.05, "albedo": 0.01, "index": 1.5}
SCENE = {"sample": {"material": SHINY}, "optics": {"stray_radiance": 0.0}}
SHORT_S, LONG_S = 0.0008, 0.02
IDEAL_SENSOR = {
    "bit_depth": 16,
    "full_well_e": 1e7,
    "gain_e_per_dn": 7.5,
    "read_noise_e": 0.0,
    "dark_current_e_s": 0.0,
    "prnu": 0.0,
    "dsnu_e": 0.0,
}


def recipe(**acquisition):
    return {
        "material": {**SHINY, "u_tail": 0.0},
        "acquisition": acquisition,
        "decision": {"tolerance": 3.0, "remeasure": 0},
        "uncertainty": {"stray_radiance": 0.00003},
    }


@pytest.fixture
def shiny(virtual_rig):
    """``shiny(name, sensor, exposure_s=…)`` lays out a rig with the polished plate."""
    return lambda name, sensor=None, **how: virtual_rig(
        name, recipe=recipe(**how), bench={**SCENE, "sensor": sensor or {}}
    )


def test_bright_and_dark_poses_are_right_with_brackets_and_invalid_without(shiny, undiagnosed):
    for name, time_s, told in (("long", LONG_S, "are saturated"), ("short", SHORT_S, "too much to tell")):
        record = shiny(name, exposure_s=time_s).inspect(methods=undiagnosed).record
        assert record.verdict == "INVALID"
        assert told in record.reasons[0]
    rig = shiny("bracket", exposure_s=SHORT_S, brackets=[5.0, 25.0])
    found = rig.inspect(methods=undiagnosed)
    record = found.record
    assert record.verdict != "INVALID", record.reasons
    truth = shiny("truth", IDEAL_SENSOR, exposure_s=0.01).inspect(methods=undiagnosed).record
    assert truth.poses, truth.reasons
    assert truth.poses[0].measured > 50.0 * truth.poses[1].measured
    for pose, true in zip(record.poses, truth.poses, strict=True):
        assert pose.measured == pytest.approx(true.measured, rel=5e-3)
    assert {frame.exposure_s for frame in record.frames} == {SHORT_S, 0.004, LONG_S}
    assert verify(found.folder).intact
    folder = frame_folder(rig, found)
    again = inspect_frames(folder, rig.recipe, "T-1", rig.out, rig_path=rig.rig, methods=undiagnosed)
    numbers = {"poses", "details", "budget", "drift"}
    assert numbers <= set(Record.model_fields)  # pydantic passes over a name that is no field
    assert again.record.model_dump(include=numbers) == record.model_dump(include=numbers)


def frame_folder(rig, inspected):
    frames = [read_frame(inspected.folder / entry.name) for entry in inspected.record.frames]
    folder = rig.out.parent / "frames"
    write_frame_folder(folder, frames, [entry.again for entry in inspected.record.frames])
    return folder


QUICK = {"acquisition": {"brackets": [2.0]}}


@pytest.mark.parametrize(
    "after", [pytest.param(3, marks=pytest.mark.soak), 10]
)  # of 2 × 2 dark frames and 4 × 2 × 2 at poses
def test_an_interrupted_bracket_goes_on(virtual_rig, monkeypatch, plain, after):
    rig = virtual_rig(recipe=QUICK)
    folder = rig.break_off(monkeypatch, after)
    found = resume_part(folder, methods=plain)
    assert found.record.verdict == "PASS", found.record.reasons
    again = [frame for frame in found.record.frames if frame.again]
    assert len(again) == (8 if after == 10 else 4)  # at the end, and on resuming once the first pose is kept
    assert recompute(folder).differences == ()


def test_a_table_with_too_few_frames_of_an_exposure(virtual_rig, plain):
    rig = virtual_rig(recipe=QUICK)
    folder = frame_folder(rig, rig.inspect())
    with (folder / TABLE).open(encoding="utf-8") as stream:
        lines = list(csv.DictReader(stream))
    longer = [line for line in lines if line["kind"] == "sample" and float(line["exposure_s"]) > 0.002]
    lines.remove(longer[0])
    with (folder / TABLE).open("w", encoding="utf-8", newline="") as stream:
        writer = csv.DictWriter(stream, lines[0])
        writer.writeheader()
        writer.writerows(lines)
    told = r"at 0°, tilt 0° have 2 exposures, which takes 2 or more frames of each; of 0\.003 s there is 1 sample"
    with pytest.raises(RecordError, match=told):
        inspect_frames(folder, rig.recipe, "T-1", rig.out, rig_path=rig.rig, methods=plain)
