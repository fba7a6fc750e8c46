"""A simulated injection moulding machine: cycle data of every inspected shot, and the ridges that come out of it.

A deliberately small model. Four settings are kept by controllers that leave noise behind; the mould follows its set
temperature with a time constant of eight shots, is a little cooler with longer cycles and warmer with hotter melt; the
tool wears with every shot. Ridge height and edge radius follow linearly from the settings by `SENSITIVITIES`, and a
contrast ``ln 0-90`` from both by `CONTRAST`; each is measured with the noise of an inspection. One shot in 20 is
inspected.

The directions are those of moulding practice (hotter mould, hotter melt and more pressure fill ridges better and make
their edges sharper; wear rounds them); the sizes are assumptions of this model, not measurements of a machine.
"""

from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.atomic_write import write_text
from anisoscope.base.csv_style import csv_text, number_text
from anisoscope.base.errors import UsageError
from anisoscope.parameters.moulding import MouldingRun

SETTINGS = {
    "melt temperature": (230.0, 0.6),
    "mould temperature": (60.0, 0.25),
    "packing pressure": (500.0, 2.0),
    "cycle time": (30.0, 0.15),
    "tool shots": (20_000.0, 0.0),
}
"""Mean and standard deviation of noise from part to part: °C, °C, bar, s, shots."""
SENSITIVITIES = {
    "ridge height": {
        "melt temperature": 0.006,
        "mould temperature": 0.02,
        "packing pressure": 0.003,
        "cycle time": 0.03,
        "tool shots": -1.0e-7,
    },
    "edge radius": {
        "melt temperature": -0.004,
        "mould temperature": -0.015,
        "packing pressure": -0.002,
        "cycle time": -0.01,
        "tool shots": 2.0e-7,
    },
}
"""Change in µm per unit of the setting."""
NOMINAL = {"ridge height": 20.0, "edge radius": 1.5}
MEASURED = {"ridge height": 0.02, "edge radius": 0.02, "ln 0-90": 0.002}
"""Standard deviation of an inspection: µm, µm, 1."""
CONTRAST = {"ridge height": 0.03, "edge radius": -0.06}
"""Change of the contrast ln 0-90 per µm."""
EVERY, THERMAL_SHOTS, SECONDS = 20, 8.0, 30.0
COOLER, WARMER = -0.2, 0.03
"""Mould temperature per second of the cycle, and per degree of the melt."""


@dataclass(frozen=True)
class Change:
    """A change of one setting.

    Attributes:
        setting: one of `SETTINGS`.
        size: in its unit, at the end.
        onset: part, counted from 0, from which on it is there.
        ramp: parts over which it grows; 0 for a step.
    """

    setting: str
    size: float
    onset: int
    ramp: int = 0


@dataclass(frozen=True, eq=False)
class Moulded:
    """Cycle data of inspected parts, and what was measured on them.

    Attributes:
        seconds: (n,) when they were moulded, from the start.
        cycles: (n,) settings as the machine reports them, by name.
        measured: (n,) ridge height and edge radius in µm and the contrast, by name.
    """

    seconds: FloatArray
    cycles: dict[str, FloatArray] = field(repr=False)
    measured: dict[str, FloatArray] = field(repr=False)


def mould(parts: int, changes: tuple[Change, ...], rng: np.random.Generator) -> Moulded:
    """Mould and inspect parts, one shot in 20.

    Args:
        parts: that are inspected.
        changes: of settings.
        rng: of the controllers' noise and the inspection's.

    Raises:
        UsageError: there is no such setting.
    """
    offsets = {name: np.zeros(parts) for name in SETTINGS}
    for one in changes:
        if one.setting not in SETTINGS:
            raise UsageError(f"the press has {', '.join(SETTINGS)}, no {one.setting!r}")
        grown = np.arange(parts) - one.onset + 1.0
        offsets[one.setting] += one.size * np.clip(grown / max(one.ramp, 1), 0.0, 1.0)
    cycles = {
        name: mean + offsets[name] + noise * rng.standard_normal(parts)
        for name, (mean, noise) in SETTINGS.items()
    }
    cycles["tool shots"] += EVERY * np.arange(parts)
    wished = cycles["mould temperature"] + COOLER * (cycles["cycle time"] - SETTINGS["cycle time"][0])
    wished = wished + WARMER * (cycles["melt temperature"] - SETTINGS["melt temperature"][0])
    mould_c, now, follows = np.empty(parts), float(wished[0]), -np.expm1(-EVERY / THERMAL_SHOTS)
    for place, target in enumerate(wished.tolist()):
        now += follows * (target - now)
        mould_c[place] = now
    cycles["mould temperature"] = mould_c
    measured: dict[str, FloatArray] = {}
    for name, sensitivities in SENSITIVITIES.items():
        measured[name] = NOMINAL[name] + sum(
            (slope * (cycles[one] - SETTINGS[one][0]) for one, slope in sensitivities.items()),
            np.zeros(parts),
        )
    contrast = sum(
        (slope * (measured[name] - NOMINAL[name]) for name, slope in CONTRAST.items()), np.zeros(parts)
    )
    measured["ln 0-90"] = 0.12 + contrast
    measured = {name: one + MEASURED[name] * rng.standard_normal(parts) for name, one in measured.items()}
    seconds = EVERY * np.cumsum(cycles["cycle time"])
    return Moulded(seconds, cycles, measured)


def moulded(run: MouldingRun) -> Moulded:
    """Parts of a run; errors as for `mould`."""
    changes = () if run.setting is None else (Change(run.setting, run.change, run.onset - 1, run.ramp),)
    return mould(run.parts, changes, np.random.default_rng(run.seed))


def check_free(folder: Path) -> None:
    """Refuse a folder that has the files of `write_moulded`.

    Raises:
        UsageError: it has one.
    """
    taken = next((folder / one for one in ("parts.csv", "cycles.csv") if (folder / one).exists()), None)
    if taken is not None:
        raise UsageError(f"rig sim press: {taken} exists: give another --out")


def write_moulded(made: Moulded, folder: Path) -> dict[str, dict[str, float]]:
    """Write parts.csv (measured values and cycle data) and cycles.csv.

    Args:
        made: the parts.
        folder: is made where it is missing.

    Returns:
        Cycle data by serial number.
    """
    start = datetime(2026, 11, 1, 6, 0, tzinfo=UTC)
    times = [(start + timedelta(seconds=one)).isoformat(timespec="seconds") for one in made.seconds.tolist()]
    serials = [f"P-{number:04d}" for number in range(1, len(times) + 1)]
    folder.mkdir(parents=True, exist_ok=True)
    for name, columns in (("parts.csv", made.measured | made.cycles), ("cycles.csv", made.cycles)):
        rows = [
            [time, serial, *(number_text(f"{column[k]:.7g}") for column in columns.values())]
            for k, (time, serial) in enumerate(zip(times, serials, strict=True))
        ]
        write_text(folder / name, csv_text([["time", "serial", *columns], *rows]))
    return {
        serial: {name: float(column[k]) for name, column in made.cycles.items()}
        for k, serial in enumerate(serials)
    }
