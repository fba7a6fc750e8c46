"""Cache of signatures: they depend on recipe and rig only, and take longer than an inspection."""

import hashlib
import io
import json
from dataclasses import replace
from typing import Any

import numpy as np

from anisoscope.base.cache import Cache
from anisoscope.base.progress import Advance, silent
from anisoscope.diagnosis.causes import all_causes
from anisoscope.diagnosis.signatures import Signature, Signatures, signatures
from anisoscope.diagnosis.tangents import Tangents
from anisoscope.diagnosis.wafers import wafer_causes
from anisoscope.recipe.surface import SurfaceRecipe


def remembered_signatures(
    recipe: SurfaceRecipe, light_angle_deg: float, advance: Advance = silent
) -> Signatures:
    """The signatures of a recipe, computed once; arguments and errors as for `signatures`."""
    recipe = recipe.deciding()
    return (
        Cache()
        .entry("signatures", signature_key(recipe, light_angle_deg), __name__)
        .result(
            lambda: signatures(recipe, light_angle_deg, advance),
            _packed,
            lambda content: _unpacked(content, recipe),
        )
    )


def signature_key(recipe: SurfaceRecipe, light_angle_deg: float) -> dict[str, Any]:
    """All that signatures are computed from."""
    surface = recipe.surface.height_map
    return {
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


def _unpacked(content: bytes, recipe: SurfaceRecipe) -> Signatures:
    design = recipe.surface.design
    known = (
        wafer_causes() if recipe.is_wafer else all_causes(None if design is None else design.ridge_angle_deg)
    )
    causes = {cause.name: cause for cause in known}
    with np.load(io.BytesIO(content), allow_pickle=False) as kept:
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
