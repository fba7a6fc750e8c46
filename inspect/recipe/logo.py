"""The logo of a shop, which a recipe names for its reports: read, checked and embedded."""

import base64
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from anisoscope.base.errors import RecipeError
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.recipe.base import RecipeBase

LOGO = "logo"
"""Its role among the files of an inspection."""
LARGEST_KB = 200
_PNG = b"\x89PNG\r\n\x1a\n"


def logo_uri(recipe: RecipeBase) -> str | None:
    """The logo of a recipe as a data URI, or None where it names none.

    Raises:
        RecipeError: the file is missing, too large, or neither a PNG nor an SVG picture; the message names it.
    """
    path = recipe.report.logo
    if path is None:
        return None
    try:
        size = path.stat().st_size
        data = bounded_bytes(path) if size <= 1000 * LARGEST_KB else b""
    except OSError as error:
        raise RecipeError(f"report.logo: {path}: cannot be read: {error.strerror}") from error
    if not data and size:
        raise RecipeError(
            f"report.logo: {path} has {size / 1000:.0f} kB, and at most {LARGEST_KB} kB are embedded in every report: "
            "use a smaller picture"
        )
    kind = "png" if _is_png(data) else "svg+xml" if _is_svg(data) else None
    if kind is None:
        raise RecipeError(f"report.logo: {path} is neither a PNG nor an SVG picture, or is damaged")
    return f"data:image/{kind};base64," + base64.b64encode(data).decode("ascii")


def check_logo(recipe: RecipeBase, path: Path) -> None:
    """Check that the logo of a recipe can be embedded.

    Args:
        recipe: the recipe.
        path: of its file, for the message.

    Raises:
        RecipeError: as of `logo_uri`.
    """
    try:
        logo_uri(recipe)
    except RecipeError as error:
        raise RecipeError(f"{path}: {error}") from None


def with_logo(recipe: RecipeBase, path: Path | None) -> RecipeBase:
    """A recipe whose reports carry the logo in another file, such as the copy in an inspection folder."""
    if path is None:
        return recipe
    return recipe.model_copy(update={"report": recipe.report.model_copy(update={"logo": path})})


def _is_png(data: bytes) -> bool:
    if not data.startswith(_PNG):
        return False
    import cv2  # noqa: PLC0415 - slow to import

    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) is not None


def _is_svg(data: bytes) -> bool:
    try:
        return ET.fromstring(data).tag == "{http://www.w3.org/2000/svg}svg"  # noqa: S314 - expat limits entities
    except ET.ParseError:
        return False
