"""Signatures kept on disk: they depend on recipe and rig only, and take longer than an inspection.

What counts is content: of the recipe, of the height map's file, and of the code that computes them. The folder is
``$ANISOSCOPE_CACHE``, or the user's cache folder; whatever is in it may be deleted at any time.
"""

import contextlib
import hashlib
import io
import json
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.cache import cache_folder, sources_digest
from anisoscope.base.errors import RecordError
from anisoscope.base.progress import Advance, silent
from anisoscope.diagnosis.causes import all_causes
from anisoscope.diagnosis.signatures import Signature, Signatures, signatures
from anisoscope.diagnosis.tangents import Tangents
from anisoscope.diagnosis.wafers import wafer_causes
from anisoscope.recipe.recipe import Recipe

_FORMAT = 4
_SOURCES = ("anisoscope.diagnosis", "anisoscope.prediction", "anisoscope.profiles", "anisoscope.sim.light")


def remembered_signatures(recipe: Recipe, light_angle_deg: float, advance: Advance = silent) -> Signatures:
    """The signatures of a recipe, computed once; arguments and errors as for `signatures`."""
    recipe = recipe.deciding()
    path = cache_folder() / "signatures" / f"{_key(recipe, light_angle_deg)}.npz"
    with contextlib.suppress(
        OSError, KeyError, ValueError, EOFError, BadZipFile
    ):  # missing or damaged: computed again
        return _read(path, recipe)
    found = signatures(recipe, light_angle_deg, advance)
    with contextlib.suppress(OSError, RecordError):  # no place to keep them: the next one computes them again
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, _packed(found))
    return found


def _key(recipe: Recipe, light_angle_deg: float) -> str:
    surface = recipe.surface.height_map
    told = {
        "format": _FORMAT,
        "software": [version("anisoscope"), np.__version__, sources_digest(*_SOURCES)],
        "surface": recipe.surface.model_dump(mode="json", exclude={"height_map"}),  # every folder has a copy
        "map": "" if surface is None else hashlib.sha256(surface.read_bytes()).hexdigest(),
        "material": vars(recipe.material.material()),
        "poses": recipe.poses.model_dump(mode="json"),
        "cells": None if recipe.area is None else recipe.area.cell_deviation,
        "light_angle_deg": light_angle_deg,
        "causes": [
            (one.name, one.extents, one.doubt)
            for one in (wafer_causes() if recipe.is_wafer else all_causes())
        ],
        "light": recipe.light and recipe.light.model_dump(mode="json"),
    }
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:32]


def _packed(found: Signatures) -> bytes:
    told = {
        "names": [one.cause.name for one in found.found],
        "doubts": [one.cause.doubt for one in found.found],
        "left_out": found.left_out,
        "share": found.share,
    }
    arrays = {"told": np.frombuffer(json.dumps(told).encode(), dtype=np.uint8), "radiance": found.radiance}
    for number, one in enumerate(found.found):
        arrays |= {
            f"extents{number}": one.extents,
            f"change{number}": one.change,
            f"share{number}": one.share,
        }
        if one.tangents is not None:
            arrays |= {f"tangents{number}": one.tangents.slope, f"at{number}": one.tangents.extents}
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _read(path: Path, recipe: Recipe) -> Signatures:
    design = recipe.surface.design
    known = (
        wafer_causes() if recipe.is_wafer else all_causes(None if design is None else design.ridge_angle_deg)
    )
    causes = {cause.name: cause for cause in known}
    with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as kept:
        told = json.loads(bytes(kept["told"]))
        found = tuple(
            Signature(
                replace(causes[name], doubt=doubt),
                kept[f"extents{n}"],
                kept[f"change{n}"],
                kept[f"share{n}"],
                Tangents(kept[f"at{n}"], kept[f"tangents{n}"]) if f"at{n}" in kept else None,
            )
            for n, (name, doubt) in enumerate(zip(told["names"], told["doubts"], strict=True))
        )
        left_out = tuple((name, reason) for name, reason in told["left_out"])
        return Signatures(recipe.poses.poses(), kept["radiance"], told["share"], found, left_out)
