"""The JSON Schema of `record.json`, and what changed in it.

Schema 1 only grows: this version reads every record of schema 1, whichever version wrote it, and an earlier version
refuses, by name, what it does not know. Fields that came later are optional, and their defaults stand for "not told":
``poses[].dropped``, ``area.learnt``, ``calibrations``, ``map_place``, ``optics``, ``print``,
``between_tilts``, ``diagnosis.tells``, ``print.map.learnt``, ``print.map.p_value``. ``print.lobe`` may be null.
"""

import json
from typing import Any

from anisoscope.record.schema import SCHEMA, Record

TITLE = f"anisoscope record, schema {SCHEMA}"
DIALECT = "https://json-schema.org/draft/2020-12/schema"


def record_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of the file, its seal included."""
    schema = Record.model_json_schema(by_alias=True, mode="validation")
    seal = {
        "type": "string",
        "pattern": "^[0-9a-f]{64}$",
        "description": "SHA-256 of the file's own bytes with 64 zeros in place of the seal",
    }
    schema["properties"]["seal"] = seal
    return {"$schema": DIALECT} | schema | {"title": TITLE}


def record_schema_text() -> str:
    """The schema as it lies in the documentation."""
    return json.dumps(record_schema(), indent=2, ensure_ascii=False) + "\n"
