"""Predictions kept: every part of one recipe on one rig is expected to show the same.

The last few are kept in memory, which is what a batch needs. Those from a height map take longer than an inspection
and are kept on disk as well, in the folder of `diagnosis.remembering`; whatever is in it may be deleted at any time.
What counts is content: of the recipe, of the height map's file, and of the code that predicts, so that no prediction
outlives what it was made by. Recomputing an inspection never asks here.
"""

import contextlib
import hashlib
import io
import json
import threading
from collections import OrderedDict
from functools import partial
from importlib.metadata import version
from zipfile import BadZipFile

import numpy as np

from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.cache import cache_folder, sources_digest
from anisoscope.base.errors import AnisoscopeError, RecordError
from anisoscope.prediction.expectation import Component, Expectation, expectation, states_of
from anisoscope.prediction.second_order import Response
from anisoscope.profiles.heightmap import HeightMap
from anisoscope.recipe.recipe import Recipe
from anisoscope.sim.light.geometry import Convention

FORMAT = 2
KEPT = 4
_SOURCES = (
    "anisoscope.prediction.expectation",
    "anisoscope.prediction.recipe_models",
    "anisoscope.prediction.second_order",
    "anisoscope.prediction",
    "anisoscope.profiles",
    "anisoscope.sim.light",
)
DAMAGED = (OSError, KeyError, ValueError, TypeError, EOFError, BadZipFile, AnisoscopeError)
"""What reading a file that is missing or was cut off ends with."""
_memory: OrderedDict[str, Expectation] = OrderedDict()
_lock = threading.Lock()


def kept_expectation(recipe: Recipe, light_angle_deg: float) -> Expectation:
    """What the part should show, predicted once; arguments and errors as for `expectation.expectation`."""
    recipe = recipe.deciding()
    try:
        key = _key(recipe, light_angle_deg)
    except OSError:  # the height map cannot be read: whoever predicts says so
        return expectation(recipe, light_angle_deg)
    with _lock:
        if key in _memory:
            _memory.move_to_end(key)
            return _memory[key]
    predict = expectation if recipe.surface.height_map is None else partial(_by_disk, key)
    found = predict(recipe, light_angle_deg)
    with _lock:
        _memory[key] = found
        while len(_memory) > KEPT:
            _memory.popitem(last=False)
    return found


def forget() -> None:
    """Empty the memory; what lies on disk stays."""
    with _lock:
        _memory.clear()


def _by_disk(key: str, recipe: Recipe, light_angle_deg: float) -> Expectation:
    """Read a prediction, or make it and write it."""
    path = cache_folder() / "predictions" / f"{key}.npz"
    with contextlib.suppress(*DAMAGED):
        return _unpacked(path.read_bytes(), recipe, light_angle_deg)
    found = expectation(recipe, light_angle_deg)
    with contextlib.suppress(OSError, RecordError):  # no place to keep it: the next one predicts again
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, packed(found))
    return found


def _key(recipe: Recipe, light_angle_deg: float) -> str:
    surface = recipe.surface.height_map
    told = {
        "format": FORMAT,
        "software": [version("anisoscope"), np.__version__, _code()],
        "surface": recipe.surface.model_dump(mode="json", exclude={"height_map"}),
        "map": surface and [surface.name, hashlib.sha256(surface.read_bytes()).hexdigest()],
        "material": recipe.material.model_dump(mode="json"),
        "poses": recipe.poses.model_dump(mode="json"),
        "uncertainty": recipe.uncertainty.model_dump(mode="json"),
        "light": recipe.light and recipe.light.model_dump(mode="json"),
        "light_angle_deg": light_angle_deg,
    }
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:32]


def _code() -> str:
    """Hash of the sources that a prediction comes from."""
    return sources_digest(*_SOURCES)


def packed(found: Expectation) -> bytes:
    """A prediction as bytes, without loss."""
    told = {
        "model": found.model,
        "components": [(one.source, one.kind, one.shared) for one in found.components],
        "sources": None if found.response is None else found.response.sources,
        "origin": None if found.surface is None else found.surface.origin,
        "optics": found.optics,
    }
    arrays = {
        "told": np.frombuffer(json.dumps(told).encode(), dtype=np.uint8),
        "radiance": found.radiance,
        "per_degree": found.per_degree,
        "relative": np.array([one.relative for one in found.components]),
    }
    if found.response is not None:
        arrays |= {"slope": found.response.slope, "bend": found.response.bend}
    if found.surface is not None:
        pixels = [found.surface.pixel_x_um, found.surface.pixel_y_um]
        arrays |= {"height_um": found.surface.height_um, "pixels_um": np.array(pixels)}
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _unpacked(data: bytes, recipe: Recipe, light_angle_deg: float) -> Expectation:
    with np.load(io.BytesIO(data), allow_pickle=False) as kept:
        told = json.loads(bytes(kept["told"]))
        surface, response = None, None
        if "height_um" in kept:
            across, along = (float(size) for size in kept["pixels_um"])
            surface = HeightMap(kept["height_um"], across, along, told["origin"])
        if told["sources"] is not None:
            response = Response(tuple(told["sources"]), kept["slope"], kept["bend"])
        components = tuple(
            Component(source, kind, relative, shared)
            for (source, kind, shared), relative in zip(told["components"], kept["relative"], strict=True)
        )
        return Expectation(
            told["model"],
            recipe.poses.poses(),
            kept["radiance"],
            components,
            kept["per_degree"],
            surface,
            Convention(light_angle_deg, facet_azimuth_deg=recipe.poses.facet_azimuth_deg),
            response,
            told["optics"],
            states_of(recipe, light_angle_deg),
        )
