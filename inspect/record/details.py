"""Kind-specific part of a record, with the interface that history, statistics and reports need."""

from collections.abc import Mapping
from typing import Annotated, Any, Protocol, cast

from pydantic import BaseModel, ConfigDict, Field

from anisoscope.base.errors import RecordError
from anisoscope.base.plugins import installed, load
from anisoscope.record.exclusion import ExclusionRecord

GROUP = "anisoscope.kinds"
"""Entry points of the kinds of parts."""


class Details(BaseModel):
    """Fields of a record that belong to one kind of part.

    History, statistics and reports use the methods without knowing the kind. ``exclusions`` are the limits of the named
    defects; none of a part that deviates. ``not_described`` says what does not describe the part, so that it was not
    judged by it; "" where all does.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)

    exclusions: Annotated[tuple[ExclusionRecord, ...], Field(exclude_if=lambda found: not found)] = ()
    not_described: Annotated[str, Field(exclude_if=lambda found: not found)] = ""

    def numbers(self) -> dict[str, float]:
        """Measured numbers by stable labels: ``NAME``, with ``u NAME``, ``deviation NAME``, ``tolerance NAME``.

        History, control charts and capability take their numbers from here.
        """
        return {}

    @property
    def area_share(self) -> float | None:
        """The share of the area that deviates, where the numbers do not hold it."""
        return None

    @property
    def near_limit(self) -> bool:
        """Whether a quantity lies on one side or the other of its limit by less than its guard band."""
        return False

    def compared(self) -> dict[str, float]:
        """Numbers by which a part is compared with others of its lot."""
        return {}

    @classmethod
    def of_schema_1(cls, record: dict[str, Any]) -> dict[str, Any] | None:
        """Move the details out of the fields of a record of schema 1, by their names."""
        return {name: record.pop(name) for name in tuple(record) if name in cls.model_fields}


class RecordedKind(Protocol):
    """Kind of part as records need it; `anisoscope.kinds.kind.Kind` is the whole."""

    name: str
    fallback: bool

    @property
    def details(self) -> type[Details]:
        """Its part of a record."""
        ...

    def recognises(self, table: Mapping[str, Any]) -> bool:
        """Whether a recipe without the key ``kind`` is of this kind."""
        ...


def recorded_kind(name: str) -> RecordedKind:
    """The kind of part of a name.

    Raises:
        RecordError: none is installed under this name, or it does not load.
    """
    found = load(GROUP, name, "kind of part", RecordError)
    if isinstance(found, type) or any(not hasattr(found, needed) for needed in _NEEDED):
        raise RecordError(
            f"the kind of part '{name}' does not load: {found!r} is not an object of a class of Kind"
        )
    return cast("RecordedKind", found)


_NEEDED = ("name", "fallback", "details", "recognises")


def kind_of_recipe(table: Mapping[str, Any]) -> str:
    """Name of the kind of a recipe: the one that it states, or else the one that recognises it.

    Args:
        table: the recipe as it is read from its file or stands in a record.

    Raises:
        RecordError: what it states is no text, or no kind of part is installed that would take it.
    """
    named = table.get("kind")
    if isinstance(named, str):
        return named
    if named is not None:
        raise RecordError(f'expected text, such as "ridges", found {named!r}')
    fallback, problems = None, []
    for name in installed(GROUP):
        try:
            kind = recorded_kind(name)
        except RecordError as problem:  # an error where a recipe names it; it must not spoil all others
            problems.append(str(problem))
            continue
        if kind.fallback:
            fallback = name
        elif kind.recognises(table):
            return name
    if fallback is None:
        why = "".join(f"; {problem}" for problem in problems)
        raise RecordError(f"no kind of part is installed that would take this recipe{why}")
    return fallback
