"""The JSON Schema of `record.json`, and what changed in it.

Schema 2 has the fields of all kinds of parts side by side, the name of the ``kind``, and ``details``: what is of that
kind alone. Schema 1 had the details of all kinds among the fields; `upgrade.upgraded` reads it. A schema only grows:
this version reads every record of schema 1 and 2, whichever version wrote it, and an earlier version refuses, by name,
what it does not know. Fields that came later are optional, and their defaults stand for "not recorded".
"""

from contextlib import suppress
from typing import Any

from anisoscope.base.errors import RecordError
from anisoscope.base.plugins import installed
from anisoscope.record.details import GROUP, Details, recorded_kind
from anisoscope.record.schema import SCHEMA, Record

TITLE = f"anisoscope record, schema {SCHEMA}"
DIALECT = "https://json-schema.org/draft/2020-12/schema"


def record_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of the file, its seal included, with the details of the kinds that are installed."""
    schema = Record.model_json_schema(by_alias=True, mode="validation")
    schema["$defs"].pop(Details.__name__)
    kinds: dict[type[Details], list[str]] = {}
    for name in installed(GROUP):
        with suppress(RecordError):  # a kind that does not load is an error of what names it
            kinds.setdefault(recorded_kind(name).details, []).append(name)
    for details in kinds:
        own = details.model_json_schema(by_alias=True, mode="validation")
        schema["$defs"] |= own.pop("$defs", {}) | {details.__name__: own}
    alternatives = [{"$ref": f"#/$defs/{details.__name__}"} for details in kinds]
    schema["properties"]["details"] = {"anyOf": [*alternatives, {"type": "null"}], "default": None}
    schema["properties"]["details"]["description"] = "; ".join(
        f"{details.__name__}: {', '.join(names)}" for details, names in kinds.items()
    )
    seal = {
        "type": "string",
        "pattern": "^[0-9a-f]{64}$",
        "description": "SHA-256 of the file's own bytes with 64 zeros in place of the seal",
    }
    schema["properties"]["seal"] = seal
    schema["$defs"] = dict(sorted(schema["$defs"].items()))
    return {"$schema": DIALECT} | schema | {"title": TITLE}
