"""Ink files: the parameters of one ink, in TOML with a schema version, or as a CSV table of its spectra."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Literal, Self

import tomli_w
from pydantic import Field, model_validator

from anisoscope.base.atomic_write import write_text
from anisoscope.base.csv_table import read_table
from anisoscope.base.errors import ConfigError, ModelError, UsageError
from anisoscope.base.toml_file import Part, Positive, read_toml_model
from anisoscope.sim.light.ink.distributions import Distribution
from anisoscope.sim.light.ink.ink import SPECTRALON, Ink, InkUncertainty, Scale

COLUMNS = ("wavelength_nm", "rho", "c")
SYNTHETIC = ("synthetic-red", "synthetic-green", "synthetic-blue")
"""The three that are taken where none are named."""
PACKAGED = (*SYNTHETIC, "synthetic-white")
Alpha = Annotated[float, Field(gt=0.0, le=1.0)]


class InkFileError(ConfigError):
    """An ink file that cannot be used."""


class BasePart(Part):
    """Light that adds to an ink's, at its wavelengths and in its scale: of paper (α = 1) or of gloss."""

    alpha: Alpha
    distribution: Distribution = "ggx"
    rho: tuple[float, ...]
    c: tuple[float, ...]


class InkFile(Part):
    """An ink: its roughness and its spectra; see `anisoscope.sim.light.ink.ink.Ink` for their meaning.

    ``alpha`` is an isotropic roughness; ``alpha_x`` and ``alpha_y`` stand in its place where the print is brushed, with
    ``brush_deg`` for the direction of x. ``convention`` is the scale of rho; ``white`` the reflectance of the white
    reference to which a "factor" refers. ``uncertainty`` says how well it is known; inspections take large ones for an
    ink without. Each ``base`` adds light.
    """

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: Annotated[str, Field(min_length=1)]
    source: str = ""
    convention: Scale
    white: Annotated[float, Field(gt=0.0, le=1.1)] = SPECTRALON
    distribution: Distribution = "ggx"
    alpha: Alpha | None = None
    alpha_x: Alpha | None = None
    alpha_y: Alpha | None = None
    brush_deg: float = 0.0
    wavelengths_nm: Annotated[tuple[Positive, ...], Field(min_length=2)]
    rho: tuple[float, ...]
    c: tuple[float, ...]
    uncertainty: InkUncertainty | None = None
    base: tuple[BasePart, ...] = ()

    @model_validator(mode="after")
    def _holds_an_ink(self) -> Self:
        pair = (self.alpha_x, self.alpha_y)
        if (self.alpha is None) == (pair == (None, None)) or (None in pair and pair != (None, None)):
            raise ValueError("write either alpha, or both alpha_x and alpha_y")
        try:
            self.ink()
        except ModelError as problem:
            raise ValueError(str(problem)) from None
        return self

    def ink(self) -> Ink:
        """The ink that the file holds.

        Raises:
            ModelError: numbers that no ink can have.
        """
        along = self.alpha if self.alpha_x is None else self.alpha_x
        assert along is not None
        nm, scale, white = self.wavelengths_nm, self.convention, self.white
        base = tuple(
            Ink("base", one.alpha, nm, one.rho, one.c, scale, white=white, distribution=one.distribution)
            for one in self.base
        )
        return Ink(
            self.name, along, nm, self.rho, self.c, scale, self.source, white, self.alpha_y, self.brush_deg,
            self.distribution, self.uncertainty, base,
        )  # fmt: skip


def read_ink(path: Path) -> Ink:
    """Read an ink file in TOML.

    Raises:
        InkFileError: the file is missing or wrong; the message names the key.
    """
    return read_toml_model(path, InkFile, error=InkFileError).ink()


def read_ink_table(
    path: Path,
    alpha: float,
    *,
    convention: Scale,
    white: float = SPECTRALON,
    name: str = "",
    source: str = "",
) -> Ink:
    """An ink from a CSV table ``wavelength_nm,rho,c``; what the table does not hold is given.

    Raises:
        UsageError: a line of the file cannot be used.
        InkFileError: numbers that no ink can have.
    """
    table = read_table(
        path, (COLUMNS,), not_negative=("rho",), above_zero=("wavelength_nm",), what="wavelengths"
    )
    nm, rho, c = (tuple(table.column(name).tolist()) for name in COLUMNS)
    try:
        return Ink(name or path.stem, alpha, nm, rho, c, convention, source or str(path.name), white)
    except ModelError as problem:
        raise InkFileError(f"{path}: {problem}") from None


def ink_text(ink: Ink, comment: Sequence[str] = ()) -> str:
    """An ink as the text of its file; spectra with seven significant digits."""
    content: dict[str, object] = {
        "schema": 1,
        "name": ink.name,
        "source": ink.source,
        "convention": ink.convention,
    }
    if ink.convention == "factor":
        content["white"] = ink.white
    if ink.distribution != "ggx":
        content["distribution"] = ink.distribution
    if ink.alpha_y is None:
        content["alpha"] = float(f"{ink.alpha:.7g}")
    else:
        content |= {"alpha_x": ink.alpha, "alpha_y": ink.alpha_y, "brush_deg": ink.brush_deg}
    content |= {key: _seven(getattr(ink, key)) for key in ("wavelengths_nm", "rho", "c")}
    if ink.base:
        content["base"] = [
            {
                "alpha": float(f"{one.alpha:.7g}"),
                "distribution": one.distribution,
                **{key: _seven(getattr(one, key)) for key in ("rho", "c")},
            }
            for one in ink.base
        ]
    if ink.uncertainty is not None:
        content["uncertainty"] = {
            name: value for name, value in asdict(ink.uncertainty).items() if value != ()
        }
    return "".join(f"# {line}\n" for line in comment) + tomli_w.dumps(content)


def _seven(values: Sequence[float]) -> list[float]:
    return [float(f"{value:.7g}") for value in values]


def write_ink(ink: Ink, path: Path, comment: Sequence[str] = ()) -> None:
    """Write an ink file, all or nothing.

    Raises:
        RecordError: the file cannot be written.
    """
    write_text(path, ink_text(ink, comment))


@cache
def synthetic_ink(name: str) -> Ink:
    """One of the synthetic inks of the package.

    Raises:
        UsageError: no such ink.
    """
    if name not in PACKAGED:
        raise UsageError(f"no ink is named {name!r}; known: {', '.join(PACKAGED)}, or a file *.toml")
    with as_file(files("anisoscope.sim.materials") / "data" / f"{name}.toml") as path:
        return read_ink(path)


def find_ink(text: str) -> Ink:
    """An ink by the name of a file, or of one that comes with the package.

    Raises:
        UsageError: neither.
        InkFileError: the file is wrong.
    """
    return synthetic_ink(text) if text in PACKAGED or not text.endswith(".toml") else read_ink(Path(text))


def with_roughness(ink: Ink, alpha: float) -> Ink:
    """The ink printed more or less evenly: another isotropic α.

    Raises:
        ModelError: no roughness.
    """
    return replace(ink, alpha=alpha, alpha_y=None)
