"""The folder of results that can be computed again, and the digest of the code that computes them."""

import hashlib
import os
from functools import cache
from importlib import import_module
from pathlib import Path

VARIABLE = "ANISOSCOPE_CACHE"


def cache_folder() -> Path:
    """Where results are kept that can be computed again."""
    from platformdirs import user_cache_path  # noqa: PLC0415

    return Path(os.environ[VARIABLE]) if VARIABLE in os.environ else user_cache_path("anisoscope")


@cache
def sources_digest(*modules: str) -> str:
    """Hash of the sources of modules and whole packages, so that nothing kept outlives what it was made by."""
    digest = hashlib.sha256()
    for name in modules:
        home = Path(str(import_module(name).__file__))
        for file in sorted(home.parent.rglob("*.py")) if home.name == "__init__.py" else (home,):
            digest.update(file.name.encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()
