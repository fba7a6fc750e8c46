"""Cache of signatures, which depend on recipe and rig only and take longer than an inspection."""

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.cache import Cache
from anisoscope.base.progress import Advance, silent
from anisoscope.base.regular_file import MOST_PICTURE_BYTES, bounded_bytes
from anisoscope.diagnosis.cause_model import PLASTIC_CAUSES, CauseModel
from anisoscope.diagnosis.causes import TAILS, tail_cause
from anisoscope.diagnosis.cell_levels import SMEARS, CellLevels, SmearedLevels
from anisoscope.diagnosis.signatures import Signature, Signatures, signatures
from anisoscope.diagnosis.tangents import Tangents
from anisoscope.imaging.deviation_map import CellScatter
from anisoscope.prediction.expectation import part_uncertainty
from anisoscope.recipe.surface import SurfaceRecipe


def cached_signatures(
    recipe: SurfaceRecipe,
    light_angle_deg: float,
    advance: Advance = silent,
    causes: CauseModel = PLASTIC_CAUSES,
    wider: SurfaceRecipe | None = None,
) -> Signatures:
    """Cached signatures of a recipe; errors as for `signatures`.

    Args:
        recipe: the recipe.
        light_angle_deg: of the rig.
        advance: progress.
        causes: of the kind of part.
        wider: the same recipe with further tilts, whose signatures are wanted as well: all are computed in one.
    """
    recipe = recipe.deciding()

    def computed() -> Signatures:
        if wider is None or causes.signatures is not signatures:
            return causes.signatures(recipe, light_angle_deg, advance, None)
        known = cached_signatures(wider, light_angle_deg, advance, causes)
        return signatures(recipe, light_angle_deg, advance, known=known)

    return (
        Cache()
        .entry(
            "signatures",
            signature_key(recipe, light_angle_deg, causes),
            __name__,
            causes.signatures.__module__,
        )
        .result(
            computed,
            _packed,
            lambda content: _unpacked(content, recipe, causes),
        )
    )


def cached_changes(
    recipe: SurfaceRecipe, light_angle_deg: float, extents: Mapping[str, float], causes: CauseModel
) -> dict[str, FloatArray]:
    """Cached (P,) changes of ln L by causes of given extents, by name; errors as for `CauseModel.changes`.

    Args:
        recipe: with the poses.
        light_angle_deg: of the rig.
        extents: by name of the cause.
        causes: of the kind of part.
    """
    changes = causes.changes
    if changes is None:
        return {}
    key = {
        **signature_key(recipe.deciding(), light_angle_deg, causes),
        "extents": dict(sorted(extents.items())),
    }
    return (
        Cache()
        .entry("changes", key, __name__, changes.__module__)
        .result(lambda: changes(recipe, light_angle_deg, extents), _packed_changes, _unpacked_changes)
    )


def _packed_changes(found: dict[str, FloatArray]) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **found)  # type: ignore[arg-type]
    return buffer.getvalue()


def _unpacked_changes(content: bytes) -> dict[str, FloatArray]:
    with np.load(io.BytesIO(content), allow_pickle=False) as stored:
        return {name: stored[name] for name in stored.files}


def signature_key(
    recipe: SurfaceRecipe, light_angle_deg: float, causes: CauseModel = PLASTIC_CAUSES
) -> dict[str, Any]:
    """Every input of the signatures, for the cache key."""
    surface = recipe.surface.height_map
    return {
        "surface": recipe.surface.model_dump(mode="json", exclude={"height_map"}),  # its path varies
        "map": ""
        if surface is None
        else hashlib.sha256(bounded_bytes(surface, MOST_PICTURE_BYTES)).hexdigest(),
        "material": vars(recipe.material.material()),
        "poses": recipe.poses.model_dump(mode="json"),
        "cells": recipe.area is not None,
        "light_angle_deg": light_angle_deg,
        "causes": [(one.name, one.extents, one.doubt) for one in causes.causes(recipe)],
        "tails": TAILS,
        "light": recipe.light and recipe.light.model_dump(mode="json"),
        "turning": part_uncertainty(recipe).ridge_angle_deg > 0.0,
    }


def _packed(found: Signatures) -> bytes:
    every = (*found.found, *(() if found.tail is None else (found.tail,)))
    header = {
        "names": [one.cause.name for one in every],
        "doubts": [one.cause.doubt for one in every],
        "tail": found.tail is not None,
        "left_out": found.left_out,
        "share": found.share,
        "most": found.scatter and found.scatter.most,
    }
    arrays = {
        "header": np.frombuffer(json.dumps(header).encode(), dtype=np.uint8),
        "radiance": found.radiance,
    }
    if found.levels is not None:
        arrays |= _packed_levels("levels", (found.levels,))
    if found.scatter is not None:
        arrays["scatter"] = found.scatter.covariance
    for number, one in enumerate(every):
        arrays |= _packed_levels(f"levels{number}", one.levels or ())
        arrays |= {
            f"extents{number}": one.extents,
            f"change{number}": one.change,
            f"share{number}": one.share,
        }
        if one.forms is not None:
            arrays[f"forms{number}"] = one.forms
        if one.tangents is not None:
            arrays |= {f"tangents{number}": one.tangents.slope, f"at{number}": one.tangents.extents}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def _packed_levels(name: str, levels: tuple[SmearedLevels, ...]) -> dict[str, np.ndarray]:
    """Levels of several surfaces in two arrays; none for none."""
    if not levels:
        return {}
    each = [one for smeared in levels for one in smeared.each]
    return {
        name: np.stack([one.alone for one in each]),
        f"{name}-lines": np.stack([one.lines for one in each]),
    }


def _unpacked_levels(name: str, stored: Mapping[str, np.ndarray]) -> tuple[SmearedLevels, ...] | None:
    if name not in stored:
        return None
    each = tuple(map(CellLevels, stored[name], stored[f"{name}-lines"]))
    return tuple(SmearedLevels(each[k : k + len(SMEARS)]) for k in range(0, len(each), len(SMEARS)))


def _unpacked(content: bytes, recipe: SurfaceRecipe, model: CauseModel) -> Signatures:
    tail = tail_cause(recipe.material.material().tail)
    causes = {cause.name: cause for cause in (*model.causes(recipe), tail)}
    with np.load(io.BytesIO(content), allow_pickle=False) as stored:
        header = json.loads(bytes(stored["header"]))
        found = [
            Signature(
                replace(causes[name], doubt=doubt),
                stored[f"extents{n}"],
                stored[f"change{n}"],
                stored[f"share{n}"],
                Tangents(stored[f"at{n}"], stored[f"tangents{n}"]) if f"at{n}" in stored else None,
                _unpacked_levels(f"levels{n}", stored),
                stored.get(f"forms{n}"),
            )
            for n, (name, doubt) in enumerate(zip(header["names"], header["doubts"], strict=True))
        ]
        left_out = tuple((name, reason) for name, reason in header["left_out"])
        longer = found.pop() if header["tail"] else None
        poses = recipe.poses.poses()
        (of_good,) = _unpacked_levels("levels", stored) or (None,)
        scatter = CellScatter(stored["scatter"], header["most"]) if "scatter" in stored else None
        return Signatures(
            poses, stored["radiance"], header["share"], tuple(found), left_out, longer, of_good, scatter
        )
