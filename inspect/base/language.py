"""Languages of the operator's path: messages, page 1 of the report and decimal marks in English, German or Danish.

A record is written in English whatever the language is. Its sentences are translated where they are shown: a sentence
with numbers is found in the catalogue by its pattern, such as ``{share} of the area deviates``, and what stands in the
places of the pattern is translated in turn. A text without a translation stays English.
"""

import gettext
import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

NAMES = {"en": "English", "de": "Deutsch", "da": "Dansk"}
LANGUAGES = tuple(NAMES)
DOMAIN = "anisoscope"
AS_WRITTEN = frozenset(
    {"path", "file", "folder", "serial", "product", "name", "text", "lot", "port", "command"}
)
"""Places of a pattern whose content is a name, which is no language."""
LEAST = 4
"""Messages with fewer characters of their own are no patterns: they would be found in any text."""
_PLACE = re.compile(r"\{(\w+)\}")
_DECIMAL = re.compile(r"(?<![\w./])(\d+)\.(\d+)(?![\w/]*[./]\w)")
_EXTENT = re.compile(r" \([^()]*\)(?=;|$)")
_PARTS = ("; ", ". ", ": ", ", ")

_present = "en"
_asked: ContextVar[str | None] = ContextVar("_asked", default=None)


class _Pattern(NamedTuple):
    """A message with places for what changes, as an expression that finds it, and its translation."""

    expression: re.Pattern[str]
    translation: str
    lists: bool
    """Whether it holds the mark between the entries of a list."""


def language() -> str:
    """The present language, one of `LANGUAGES`: of the reader who is answered, else of the process."""
    return _asked.get() or _present


def use(name: str) -> None:
    """Set the language of what follows.

    Args:
        name: one of `LANGUAGES`.

    Raises:
        ValueError: another name.
    """
    global _present  # noqa: PLW0603 - one language a process, as one locale
    if name not in LANGUAGES:
        raise ValueError(f"no language {name!r}: {', '.join(LANGUAGES)}")
    _present = name


@contextmanager
def speaking(name: str) -> Iterator[None]:
    """Use a language for a while; errors as of `use`."""
    before = _present
    use(name)
    try:
        yield
    finally:
        use(before)


@contextmanager
def answering(name: str) -> Iterator[None]:
    """Use a language for one reader of a server; the process and its other readers keep theirs.

    Args:
        name: one of `LANGUAGES`.
    """
    before = _asked.set(name)
    try:
        yield
    finally:
        _asked.reset(before)


def of_browser(header: str) -> str | None:
    """The first of our languages that a browser prefers; None where it names none of them.

    Args:
        header: Accept-Language (RFC 9110, 12.5.4), such as ``da, en-GB;q=0.8``.
    """
    found = []
    for entry in header.split(","):
        name, _, weight = entry.partition(";")
        number = weight.strip().removeprefix("q=") or "1"
        short = name.strip().lower().partition("-")[0]
        if short in LANGUAGES and re.fullmatch(r"[01](\.\d*)?", number) and float(number) > 0.0:
            found.append((-float(number), short))
    return min(found, key=lambda one: one[0])[1] if found else None


def of_locale(environment: Mapping[str, str] | None = None) -> str:
    """The language of the locale: LC_ALL, else LC_MESSAGES, else LANG; English where that is none of ours.

    Args:
        environment: variables, by default those of the process.
    """
    known = os.environ if environment is None else environment
    name = next((known[key] for key in ("LC_ALL", "LC_MESSAGES", "LANG") if known.get(key)), "")
    short = re.split(r"[_.@-]", name)[0].lower()
    return short if short in LANGUAGES else "en"


def message(text: str, /, **places: object) -> str:
    """A message of ours in the present language.

    Args:
        text: the English message as the catalogue has it, with ``{places}``.
        places: what stands in them; numbers get the decimal mark of the language.
    """
    found = _catalogue(language()).get(text, text)
    return found.format(**{name: _in_place(name, str(value)) for name, value in places.items()})


def translated(text: str) -> str:
    """A finished English text, such as a reason of a record, in the present language.

    A text that the catalogue does not know is looked up by its parts; what remains unknown stays as it is, save the
    decimal marks of its numbers.
    """
    if language() == "en" or not text:
        return text
    found = _looked_up(text)
    return decimal(text) if found is None else found


def decimal(text: str) -> str:
    """A text whose numbers have the decimal mark of the present language."""
    return text if language() == "en" else _DECIMAL.sub(r"\1,\2", text)


_PERCENT = re.compile(r"(?<=\d)(?<!=\d)(?<!=\d\d)%(?![0-9A-Fa-f]{2})")
"""Not those of addresses, such as ``A1%20B``, and of options, such as ``roughness=20%``."""


def per_cent(text: str, blank: str = " ") -> str:
    """A text with a blank between a number and %, as every reader sees it; records and files hold it without."""
    return _PERCENT.sub(f"{blank}%", text)


def shown(value: Any) -> Any:  # noqa: ANN401 - what templates show
    """A text with its `per_cent` where no line breaks; anything else, ready markup too, as it is."""
    return per_cent(value, "\N{NO-BREAK SPACE}") if type(value) is str else value


def _in_place(name: str, text: str) -> str:
    return text if name in AS_WRITTEN else translated(text)


def _looked_up(text: str) -> str | None:
    """The translation of a text as a whole, without its full stop or its extent, or part by part; None without any."""
    exact = _catalogue(language()).get(text)
    if exact is not None:
        return exact
    # a message with the mark of a list is no list
    found = _by_pattern(text, lists=True) or _list(text) or _by_pattern(text, lists=False)
    if found is not None:
        return found
    if text.endswith("."):
        found = _looked_up(text[:-1])
        return None if found is None else f"{found}."
    return _with_extent(text) or _by_parts(text)


def _by_pattern(text: str, *, lists: bool) -> str | None:
    """The translation of the first message whose pattern this is, of those with or without the mark of a list."""
    for pattern in _patterns(language()):
        match = pattern.expression.fullmatch(text) if pattern.lists is lists else None
        if match is not None:
            places = {name: _in_place(name, value) for name, value in match.groupdict().items()}
            filled = pattern.translation.format(**places)
            return filled if AS_WRITTEN & places.keys() else decimal(filled)
    return None


def _list(text: str) -> str | None:
    """A list of known texts, such as contrasts."""
    first, mark, rest = text.partition(_PARTS[0])
    if not mark:
        return None
    known = _looked_up(first)
    more = None if known is None else _looked_up(rest)
    return None if more is None else f"{known}{mark}{more}"


def _with_extent(text: str) -> str | None:
    """A finding whose extent follows in brackets, at its end or before a semicolon."""
    extent = _EXTENT.search(text)
    found = None if extent is None else _looked_up(text[: extent.start()] + text[extent.end() :])
    if extent is None or found is None:
        return None
    place = found.index(";") if ";" in found else len(found)
    return f"{found[:place]} ({translated(extent[0][2:-1])}){found[place:]}"


def _by_parts(text: str) -> str | None:
    for mark in _PARTS:
        first, found, rest = text.partition(mark)
        if found:
            parts = _looked_up(first), _looked_up(rest)
            if parts != (None, None):
                return mark.join(
                    decimal(old) if new is None else new
                    for old, new in zip((first, rest), parts, strict=True)
                )
    return None


@cache
def _catalogue(name: str) -> Mapping[str, str]:
    """Messages and their translations; none in English."""
    if name == "en":
        return {}
    path = files("anisoscope.base").joinpath("locale", name, "LC_MESSAGES", f"{DOMAIN}.mo")
    with path.open("rb") as file:
        known: Mapping[str, str] = gettext.GNUTranslations(file)._catalog  # type: ignore[attr-defined]  # noqa: SLF001
    return {text: translation for text, translation in known.items() if text}


@cache
def _patterns(name: str) -> tuple[_Pattern, ...]:
    """Messages with places, those with most text of their own first."""
    found = [
        (text, new) for text, new in _catalogue(name).items() if _PLACE.search(text) and _own(text) >= LEAST
    ]
    found.sort(key=lambda one: -_own(one[0]))
    return tuple(_Pattern(_expression(text), new, _PARTS[0] in _PLACE.sub("", text)) for text, new in found)


def _own(text: str) -> int:
    """Characters of a message outside its places, without blanks."""
    return len("".join(_PLACE.sub("", text).split()))


def _expression(text: str) -> re.Pattern[str]:
    """Expression that finds a message with any texts in its places; a place that comes twice holds the same."""
    parts = _PLACE.split(text)
    seen: set[str] = set()
    expression = ""
    for number, part in enumerate(parts):
        if number % 2 == 0:
            expression += re.escape(part)
        else:
            expression += f"(?P={part})" if part in seen else f"(?P<{part}>.+?)"
            seen.add(part)
    return re.compile(expression, re.DOTALL)
