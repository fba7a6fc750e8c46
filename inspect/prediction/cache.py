"""Cache of predictions, keyed by recipe, rig geometry, optics and code version.

All parts of one recipe on one rig share a prediction. The last few predictions are held in memory, which serves a
batch. Those from a height map take longer than an inspection and are cached on disk as well. Recomputing an inspection
never uses this cache.
"""

import hashlib
import io
import json
import threading
from collections import OrderedDict
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np

from anisoscope.base.cache import Cache
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes
from anisoscope.parameters.geometry import Convention
from anisoscope.prediction.expectation import (
    PLASTIC,
    Component,
    Expectation,
    SurfaceOptics,
    expectation,
    part_uncertainty,
)
from anisoscope.prediction.lobe_doubt import LobeDoubt
from anisoscope.prediction.second_order import Response
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.surface import SurfaceRecipe

MAX_IN_MEMORY = 4
_memory: OrderedDict[str, Expectation] = OrderedDict()
_lock = threading.Lock()


def cached_expectation(
    recipe: SurfaceRecipe, light_angle_deg: float, optics: SurfaceOptics = PLASTIC
) -> Expectation:
    """Cached prediction of a recipe; arguments and errors as for `expectation.expectation`."""
    recipe = recipe.deciding()
    try:
        key_fields = prediction_key(recipe, light_angle_deg, optics)
    except OSError:  # the height map cannot be read: the prediction raises the proper error
        return expectation(recipe, light_angle_deg, optics)
    key = json.dumps(key_fields, sort_keys=True)
    with _lock:
        if key in _memory:
            _memory.move_to_end(key)
            return _memory[key]
    predict = expectation if recipe.surface.height_map is None else partial(_by_disk, key_fields)
    found = predict(recipe, light_angle_deg, optics)
    with _lock:
        _memory[key] = found
        while len(_memory) > MAX_IN_MEMORY:
            _memory.popitem(last=False)
    return found


def forget() -> None:
    """Empty the memory; entries on disk remain."""
    with _lock:
        _memory.clear()


def _by_disk(
    key_fields: dict[str, Any], recipe: SurfaceRecipe, light_angle_deg: float, optics: SurfaceOptics
) -> Expectation:
    """Read a prediction from disk, or compute and write it."""
    return (
        Cache()
        .entry("predictions", key_fields, __name__, type(optics).__module__)
        .result(
            lambda: expectation(recipe, light_angle_deg, optics),
            packed,
            lambda content: _unpacked(content, recipe, light_angle_deg, optics),
        )
    )


def prediction_key(recipe: SurfaceRecipe, light_angle_deg: float, optics: SurfaceOptics) -> dict[str, Any]:
    """Every input of a prediction, for the cache key."""
    surface = recipe.surface.height_map
    return {
        "surface": recipe.surface.model_dump(mode="json", exclude={"height_map"}),
        "map": surface
        and [surface.name, hashlib.sha256(bounded_bytes(surface, MOST_PICTURE_BYTES)).hexdigest()],
        "material": recipe.material.model_dump(mode="json"),
        "poses": recipe.poses.model_dump(mode="json"),
        "uncertainty": recipe.uncertainty.model_dump(mode="json"),
        "part": asdict(part_uncertainty(recipe)),
        "light": recipe.light and recipe.light.model_dump(mode="json"),
        "light_angle_deg": light_angle_deg,
        "optics": [type(optics).__module__, type(optics).__qualname__, repr(getattr(optics, "__dict__", {}))],
    }


def packed(found: Expectation) -> bytes:
    """Serialise a prediction without loss."""
    header = {
        "model": found.model,
        "components": [(one.source, one.kind, one.shared) for one in found.components],
        "sources": None if found.response is None else found.response.sources,
        "origin": None if found.surface is None else found.surface.origin,
        "optics": found.optics,
        "turn_deg": found.turn_deg,
        "tail_sources": None if found.lobes is None else found.lobes.responses[0].sources,
    }
    arrays = {
        "header": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8),
        "radiance": found.radiance,
        "per_degree": found.per_degree,
        "relative": np.array([one.relative for one in found.components]),
    }
    if found.response is not None:
        arrays |= {"slope": found.response.slope, "bend": found.response.bend}
    if found.lobes is not None:
        doubt = found.lobes
        arrays |= {
            "tails": doubt.tails,
            "tail_shifts": doubt.shifts,
            "tail": np.array([doubt.nominal, doubt.u]),
            "tail_slopes": np.array([one.slope for one in doubt.responses]),
            "tail_bends": np.array([one.bend for one in doubt.responses]),
        }
    if found.surface is not None:
        pixels = [found.surface.pixel_x_um, found.surface.pixel_y_um]
        arrays |= {"height_um": found.surface.height_um, "pixels_um": np.array(pixels)}
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _unpacked(
    data: bytes, recipe: SurfaceRecipe, light_angle_deg: float, optics: SurfaceOptics
) -> Expectation:
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        header = json.loads(bytes(arrays["header"]))
        surface, response, lobes = None, None, None
        if "height_um" in arrays:
            across, along = (float(size) for size in arrays["pixels_um"])
            surface = HeightMap(arrays["height_um"], across, along, header["origin"])
        if header["sources"] is not None:
            response = Response(tuple(header["sources"]), arrays["slope"], arrays["bend"])
        if header["tail_sources"] is not None:
            sources, (nominal, u) = tuple(header["tail_sources"]), arrays["tail"]
            responses = tuple(
                Response(sources, slope, bend)
                for slope, bend in zip(arrays["tail_slopes"], arrays["tail_bends"], strict=True)
            )
            lobes = LobeDoubt(arrays["tails"], arrays["tail_shifts"], responses, float(nominal), float(u))
        components = tuple(
            Component(source, kind, relative, shared)
            for (source, kind, shared), relative in zip(header["components"], arrays["relative"], strict=True)
        )
        return Expectation(
            header["model"],
            recipe.poses.poses(),
            arrays["radiance"],
            components,
            arrays["per_degree"],
            surface,
            Convention(light_angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg),
            response,
            header["optics"],
            optics.states(recipe, light_angle_deg),
            header["turn_deg"],
            lobes,
        )
