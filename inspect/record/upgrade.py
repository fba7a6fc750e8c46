"""Records of schema 1 as records of schema 2: what is of one kind of part moves into ``details``."""

from typing import Any

from anisoscope.record.details import kind_of_recipe, recorded_kind


def upgraded(content: dict[str, Any]) -> dict[str, Any]:
    """A parsed record of schema 1 as one of schema 2; other records as they are.

    What the older version did not tell stays untold, so that recomputing does not compare it.

    Raises:
        RecordError: the kind of part that it is of is not installed.
    """
    if content.get("schema", 1) != 1 or "kind" in content:
        return content
    found, recipe = dict(content), content.get("recipe")
    kind = kind_of_recipe(recipe if isinstance(recipe, dict) else {})
    details = recorded_kind(kind).details.of_schema_1(found)
    # schema 1 had the fields of all kinds side by side; those of other kinds are empty
    known = {name for name, value in found.items() if value not in (None, [])} | _MAY_BE_EMPTY
    return {name: value for name, value in found.items() if name in known} | {
        "schema": 2,
        "kind": kind,
        "details": details,
    }


_MAY_BE_EMPTY = frozenset(
    {
        "poses",
        "budget",
        "optics",
        "calibrations",
        "notes",
        "inputs",
        "frames",
        "files",
        "reasons",
        "d2",
        "dof",
        "p_value",
        "drift",
        "conformance_probability",
        "diagnosis",
    }
)
