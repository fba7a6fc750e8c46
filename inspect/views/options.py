"""Options of the command line from parameter models: names, types, defaults, ranges and help are the model's.

An option is named as its field without the unit: ``pitch_um`` is ``--pitch``. A command takes what was given as
`Given`, and puts it over a default, or over what a recipe states::

    @with_options(plastic=Options(Material, PLASTIC))
    def command(*, recipe: Path | None = None, plastic: Given[Material]) -> int:
        material = plastic.over(Material())
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, make_dataclass, replace
from datetime import datetime
from types import NoneType, UnionType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    ClassVar,
    Generic,
    Literal,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

from cyclopts import Group, Parameter, Token

from anisoscope.base.errors import AnisoscopeError, UsageError
from anisoscope.base.quantity import Likely, read_number, unit_of

M = TypeVar("M")
F = TypeVar("F", bound=Callable[..., Any])
_UNIT = re.compile(r"_(deg|um|mm|nm|share|s)$")


def plain(name: str) -> str:
    """Option of a field: without its unit, with hyphens."""
    return "--" + _UNIT.sub("", name).replace("_", "-")


class Stated:
    """Fields of a parameter model that the command line states.

    No class above it is of another module: cyclopts parses the source of all of them for every page of help.
    """

    _model: ClassVar[type]
    option: ClassVar[Mapping[str, str]]
    lists: ClassVar[Mapping[str, Callable[[str, str], Any]]]

    @property
    def values(self) -> dict[str, Any]:
        """Field -> value, of the stated ones."""
        stated = {name: getattr(self, name) for name in self.option}
        return {name: value for name, value in stated.items() if value is not None}

    def __contains__(self, name: str) -> bool:
        return getattr(self, name) is not None

    def over(self, base: Any) -> Any:  # noqa: ANN401 - typed by `Given`
        """The model with the stated fields in place of those of ``base``.

        Raises:
            AnisoscopeError: as the model's own, naming the option where one alone is out of its range.
        """
        try:
            return replace(base, **self.values)
        except AnisoscopeError as problem:
            raise self._named(problem, base) from None

    def made(self) -> Any:  # noqa: ANN401
        """The model of the options, where these are `whole`; errors are the model's own.

        Raises:
            UsageError: a list that is none of numbers.
        """
        values = {name: getattr(self, name) for name in self.option}
        for name, reader in self.lists.items():
            text = values.pop(name)
            if text is not None:  # else that of the model
                values[name] = _read(reader, text, self.option[name])
        return self._model(**values)

    def refuse(self, names: Sequence[str], why: str) -> None:
        """Refuse stated fields.

        Raises:
            UsageError: "--option" and ``why``, for the first of the fields that is stated.
        """
        for name in names:
            if name in self:
                raise UsageError(f"{self.option[name]} {why}")

    def _named(self, problem: AnisoscopeError, base: Any) -> AnisoscopeError:  # noqa: ANN401
        for name, value in self.values.items():
            try:
                replace(base, **{name: value})
            except AnisoscopeError as own:
                return UsageError(f"{self.option[name]}: {own}")
        return problem


class Given(Stated, Generic[M]):
    """Annotation of a parameter of a command: the command gets what is `Stated` of the model."""

    if TYPE_CHECKING:

        def over(self, base: M) -> M: ...  # noqa: D102 - as of `Stated`
        def made(self) -> M: ...  # noqa: D102


@dataclass(frozen=True)
class Options:
    """Options of a parameter model in one command.

    Attributes:
        model: a frozen dataclass whose docstring has a section ``Attributes:``.
        group: panel of the help page; None for the usual one.
        names: field -> option, or several, where the rule of names does not hold.
        prefix: put before the names that follow the rule, such as "u-".
        help: field -> text in place of the model's.
        default: the model whose values are shown as defaults, or these by field; None shows those of the fields.
        without: field -> reason why this command has no option for it.
        readers: field -> function of the text and the option that makes its value.
        groups: field -> panel, where it is not ``group``.
        repeated: fields that hold several values, each stated by the option again.
        whole: the command takes the whole model (`Given.made`): what is not stated has its default, and a field without
            one must be stated; lists of numbers are texts until then.
        flags: fields that are true or false and have one option alone, which makes them true; True for all of them.
    """

    model: type
    group: Group | None = None
    names: Mapping[str, str | tuple[str, ...]] = field(default_factory=dict)
    prefix: str = ""
    help: Mapping[str, str] = field(default_factory=dict)
    default: object = None
    without: Mapping[str, str] = field(default_factory=dict)
    readers: Mapping[str, Callable[[str, str], Any]] = field(default_factory=dict)
    flags: bool | Sequence[str] = False
    groups: Mapping[str, Group] = field(default_factory=dict)
    repeated: Sequence[str] = ()
    whole: bool = False

    def option(self, name: str) -> str:
        """Option of a field."""
        own = self.names.get(name) or plain(name).replace("--", f"--{self.prefix}", 1)
        return own if isinstance(own, str) else own[0]


def with_options(**models: Options) -> Callable[[F], F]:
    """Decorator: parameters of a command that are models become their options.

    Args:
        models: parameter of the command, annotated as `Given` of a model -> its options.
    """

    def mark(command: F) -> F:
        for parameter, options in models.items():
            kind = options_class(options)
            panel: dict[str, Any] = {} if options.group is None else {"group": options.group}
            command.__annotations__[parameter] = Annotated[kind, Parameter(name="*", **panel)]
            if not any(one.default is MISSING for one in fields(kind)):
                command.__kwdefaults__ = (command.__kwdefaults__ or {}) | {parameter: kind()}
        vars(command)["options_of_models"] = models
        return command

    return mark


def options_class(options: Options) -> type:
    """A frozen dataclass whose fields are the options: `Given` of the model, or a part of other classes of options.

    Raises:
        TypeError: a field has the name of an attribute of `Given`, which it would hide.
    """
    assert is_dataclass(options.model)
    own = {"_model", "option", "lists", *(() if options.whole else ("values", "over", "made", "refuse"))}
    hidden = sorted(own & {one.name for one in fields(options.model) if one.name not in options.without})
    if hidden:
        raise TypeError(
            f"{options.model.__name__}: rename the fields {hidden}, which options have themselves"
        )
    texts = _texts(options.model)
    hints = get_type_hints(options.model, include_extras=True)
    stated: list[Any] = []
    lists = {}
    for one in fields(options.model):
        if one.name in options.without:
            continue
        default = _default(options.default, one.name, one.default)
        kind, likely = _taken_apart(hints[one.name])
        kind = str if kind is datetime else kind  # people write it in words, which the command reads
        reader = options.readers.get(one.name) or _reader(kind, one.name, likely)
        listed = get_origin(kind) is tuple and (float in get_args(kind) or one.name in options.readers)
        if options.whole and listed and one.name not in options.repeated:
            lists[one.name] = reader or _list_reader(unit_of(one.name))
            kind, reader = str, None
            default = default if default is MISSING else _shown(default) if default else None
        more: dict[str, Any] = {"group": options.groups[one.name]} if one.name in options.groups else {}
        if one.name in options.repeated:
            more |= {"consume_multiple": False, "allow_leading_hyphen": True}
        if not options.whole:
            more["show_default"] = False if default in (MISSING, None) else _shown(default)
        alone = options.flags if isinstance(options.flags, bool) else one.name in options.flags
        parameter = Parameter(
            name=options.names.get(one.name) or options.option(one.name),
            negative=()
            if alone or not (kind is bool or (one.name in options.repeated and default))
            else None,
            help=options.help.get(one.name, texts.get(one.name, "")),
            converter=None if reader is None else _converter(reader),
            n_tokens=None if reader is None else 1,
            **more,
        )
        optional = kind | None if not options.whole or default is None else kind
        stated.append(
            (one.name, Annotated[optional, parameter], field(default=default if options.whole else None))
        )
    space = {
        "_model": options.model,
        "option": {name: options.option(name) for name, _, _ in stated},
        "lists": lists,
        "__doc__": options.model.__doc__,
        "__module__": __name__,
    }
    return make_dataclass(
        f"{options.model.__name__}Options",
        stated,
        bases=(Stated,),
        frozen=True,
        kw_only=True,
        namespace=space,
    )


def _default(of: object, name: str, own: object) -> Any:  # noqa: ANN401
    if isinstance(of, Mapping):
        return of.get(name, own)
    return own if of is None else getattr(of, name)


def _texts(model: type) -> dict[str, str]:
    """Field -> sentence of the model's docstring, with a capital."""
    import docstring_parser  # noqa: PLC0415 - commands are loaded by name when they run

    parsed = [
        one for base in reversed(model.__mro__) for one in docstring_parser.parse(base.__doc__ or "").params
    ]
    found = {one.arg_name: " ".join((one.description or "").split()) for one in parsed}
    return {name: text[:1].upper() + text[1:] if text[:1].isascii() else text for name, text in found.items()}


def _taken_apart(hint: Any) -> tuple[Any, Likely | None]:  # noqa: ANN401 - any annotation
    """Type of a field without None, and its likely range."""
    likely = None
    if get_origin(hint) is Annotated:
        hint, *marks = get_args(hint)
        likely = next((mark for mark in marks if isinstance(mark, Likely)), None)
    if get_origin(hint) in (Union, UnionType):
        kinds = [kind for kind in get_args(hint) if kind is not NoneType]
        hint = kinds[0] if len(kinds) == 1 else Union[tuple(kinds)]  # noqa: UP007 - made of a list
    return hint, likely


def _reader(kind: Any, name: str, likely: Likely | None) -> Callable[[str, str], Any] | None:  # noqa: ANN401
    """What makes a value of a text; None leaves it to the parser."""
    unit = unit_of(name)
    if kind is float:
        return lambda text, option: read_number(text, option, unit, likely)
    if get_origin(kind) is tuple and set(get_args(kind)) == {float}:
        count = len(get_args(kind))
        return lambda text, option: numbers(text, option, count, unit)
    if get_origin(kind) in (Union, UnionType):
        words = [word for one in get_args(kind) if get_origin(one) is Literal for word in get_args(one)]
        whole = float not in get_args(kind)
        return lambda text, option: text if text in words else _or_number(text, option, unit, words, whole)
    return None


def numbers(text: str, option: str, count: int, unit: str = "") -> tuple[float, ...]:
    """As many numbers as there must be, separated by commas.

    Raises:
        ValueError: another count, or no numbers.
    """
    found = tuple(read_number(part, option, unit) for part in text.split(","))
    if len(found) != count:
        raise ValueError(f"{option} takes {count} numbers separated by commas, not {text!r}")
    return found


def parse_numbers(text: str, option: str, example: str = "0,90,180", unit: str = "") -> tuple[float, ...]:
    """Numbers of a comma-separated option, each in the unit of the option or with its own.

    Raises:
        UsageError: the text is not a list of finite numbers.
    """
    try:
        numbers = tuple(read_number(part, option, unit) if unit else float(part) for part in text.split(","))
    except ValueError:
        raise UsageError(
            f"{option} takes numbers separated by commas, such as {example}, not {text!r}"
        ) from None
    if not all(abs(number) < float("inf") for number in numbers):
        raise UsageError(f"{option} takes finite numbers, not {text!r}")
    return numbers


def _list_reader(unit: str) -> Callable[[str, str], tuple[float, ...]]:
    return lambda text, option: parse_numbers(text, option, unit=unit)


def _or_number(text: str, option: str, unit: str, words: Sequence[str], whole: bool) -> float:
    try:
        return int(text) if whole else read_number(text, option, unit)
    except ValueError:
        number = "a whole number" if whole else "a number"
        raise ValueError(f"{option} takes {', '.join(words)} or {number}, not {text!r}") from None


def quantity(name: str, likely: Likely | None = None) -> Parameter:
    """Parameter of an option that takes a number with or without the unit at the end of a field's name."""
    unit = unit_of(name)
    return Parameter(
        converter=_converter(
            lambda text, option: read_number(text, option or _UNIT.sub("", name), unit, likely)
        ),
        n_tokens=1,
    )


def _converter(reader: Callable[[str, str], Any]) -> Callable[[Any, Sequence[Token]], Any]:
    def convert(_kind: Any, tokens: Sequence[Token]) -> Any:  # noqa: ANN401 - as the parser calls it
        return _read(reader, tokens[0].value, tokens[0].keyword or "")

    return convert


def _read(reader: Callable[[str, str], Any], text: str, option: str) -> Any:  # noqa: ANN401
    try:
        return reader(text, option)
    except ValueError as problem:
        raise UsageError(str(problem)) from None


def _shown(default: Any) -> str:  # noqa: ANN401
    if isinstance(default, tuple):
        return ",".join(f"{one:g}" for one in default)
    return str(round(default, 12) if isinstance(default, float) else default)
