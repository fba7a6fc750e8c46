"""Predictions of the command line in the cache of results: what was asked before is answered without a model.

The key holds all that the command was given, a file by the hash of its content. A prediction is packed without loss, so
that its output is the same to the last digit.
"""

import io
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from anisoscope.base.cache import LIBRARIES, Cache
from anisoscope.prediction.monte_carlo import Drawn
from anisoscope.prediction.predicted import Predicted
from anisoscope.prediction.sensitivity import Budget, Contribution
from anisoscope.sim.light.contrasts import contrasts
from anisoscope.sim.light.geometry import Convention, Pose

KIND = "printed-predictions"
READERS = ("SurfaceTopography",)
"""What reads height maps besides the readers of this package."""
_OF_A_PART = ("absolute", "matrix", "curvature")


def cached_predictions(
    given: dict[str, Any], module: str, compute: Callable[[], Sequence[Predicted]]
) -> tuple[Predicted, ...]:
    """Predictions from the cache, or computed and stored.

    Args:
        given: all that they are computed from, as JSON.
        module: name of the module that computes them, with all that it imports.
        compute: computes them.
    """
    entry = Cache().entry(KIND, given, module, __name__, libraries=(*LIBRARIES, *READERS))
    return entry.result(lambda: tuple(compute()), packed, unpacked)


def packed(found: Sequence[Predicted]) -> bytes:
    """Predictions as bytes, without loss."""
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    headers = []
    for number, one in enumerate(found):
        arrays[f"{number} radiance"] = one.radiance
        headers.append(
            {
                "model": one.model,
                "convention": asdict(one.convention),
                "poses": [(pose.stage_deg, pose.tilt_deg) for pose in one.poses],
                "k": one.k,
                "notes": one.notes,
                "budget": None if one.budget is None else _budget(one.budget, number, arrays),
                "drawn": one.drawn is not None,
            }
        )
        if one.drawn is not None:
            arrays[f"{number} drawn"] = one.drawn.radiance
    arrays["headers"] = np.frombuffer(json.dumps(headers).encode(), dtype=np.uint8)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _budget(budget: Budget, number: int, arrays: dict[str, "np.ndarray[Any, Any]"]) -> list[dict[str, Any]]:
    """What is no array of a budget; its arrays are added."""
    arrays[f"{number} budget"] = budget.radiance
    arrays[f"{number} per degree"] = budget.per_degree
    for at, part in enumerate(budget.contributions):
        known = {name: getattr(part, name) for name in _OF_A_PART}
        arrays |= {f"{number} {at} {name}": value for name, value in known.items() if value is not None}
    return [
        {
            "source": part.source,
            "correlation": part.correlation,
            "rectangular": part.rectangular,
            "kind": part.kind,
        }
        for part in budget.contributions
    ]


def unpacked(content: bytes) -> tuple[Predicted, ...]:
    """The predictions in bytes of `packed`."""
    with np.load(io.BytesIO(content), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    found = []
    for number, header in enumerate(json.loads(bytes(arrays["headers"]))):
        poses = tuple(Pose(*pose) for pose in header["poses"])
        radiance = arrays[f"{number} radiance"]
        one = Predicted(
            header["model"],
            Convention(**header["convention"]),
            poses,
            radiance,
            contrasts(poses, radiance),
            header["k"],
            header["notes"],
        )
        if header["budget"] is not None:
            parts = tuple(
                Contribution(
                    **{name: arrays.get(f"{number} {at} {name}") for name in _OF_A_PART},  # type: ignore[arg-type]
                    **part,
                )
                for at, part in enumerate(header["budget"])
            )
            budget = Budget(arrays[f"{number} budget"], parts, arrays[f"{number} per degree"])
            one = replace(one, budget=budget)
        if header["drawn"]:
            one = replace(one, drawn=Drawn(poses, arrays[f"{number} drawn"]))
        found.append(one)
    return tuple(found)
