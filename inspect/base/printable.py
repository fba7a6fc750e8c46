"""Names that people read in reports, tables and terminals: serial number, lot, cavity, operator, station."""

from collections.abc import Mapping
from typing import Annotated

from pydantic import AfterValidator

from anisoscope.base.errors import UsageError

LONGEST = 200
"""Characters of a name at most."""


def printable(text: str) -> str:
    """A name, if all of it can be seen: a line break or a colour code would change the tables that it stands in.

    Raises:
        ValueError: it is too long, or holds a sign that cannot be seen.
    """
    if len(text) > LONGEST:
        raise ValueError(f"longer than {LONGEST} signs: {text[:24]!r}…")
    bad = next((sign for sign in text if not sign.isprintable()), None)
    if bad is not None:
        raise ValueError(f"{text[:64]!r} holds a sign that cannot be seen (U+{ord(bad):04X})")
    return text


Printable = Annotated[str, AfterValidator(printable)]
"""Type of a field for what comes from outside; records of the past are read as they are."""


def check_printable(names: Mapping[str, str | None]) -> None:
    """Check names by what they are.

    Raises:
        UsageError: one cannot be used; says which.
    """
    for what, text in names.items():
        try:
            printable(text or "")
        except ValueError as error:
            raise UsageError(f"{what}: {error}") from None
