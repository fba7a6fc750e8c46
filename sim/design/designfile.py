"""Files of designs: TOML for one reflectance, npz for a layout of dots; both with a schema version."""

import io
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tomli_w
from pydantic import Field, ValidationError, model_validator

from anisoscope.base.atomic_write import write_bytes, write_text
from anisoscope.base.errors import ConfigError, ModelError
from anisoscope.base.regular_file import regular_file
from anisoscope.base.toml_file import Part, Positive, one_line, read_toml_model
from anisoscope.sim.design.depths import Depths
from anisoscope.sim.design.layout import Layout
from anisoscope.sim.design.models import MixtureModel, Model


class DesignFile(Part):
    """One reflectance.

    Attributes:
        schema_version: of this file.
        name: what it is called.
        model: what its dots are made of.
        passes_nm: depth of every etch pass.
        wavelength_nm: that it was designed at.
        band_nm: that the depths were made for.
        coherence_um: Δc of the source.
        min_width_um: smallest feature.
        grid_um: all edges lie on it.
        figures: what was found: relative errors and the like.
    """

    schema_version: Literal[1] = 1
    name: str
    model: Model
    passes_nm: tuple[Positive, ...]
    wavelength_nm: Positive = 500.0
    band_nm: tuple[Positive, Positive]
    coherence_um: Positive = 16.0
    min_width_um: Positive = 2.0
    grid_um: Positive = 0.25
    figures: dict[str, float] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _is_feasible(self) -> "DesignFile":
        if not self.passes_nm and self.model.kind != "mirror":
            raise ValueError("steps without levels: give the depth of one etch pass at least in passes_nm")
        if self.model.finest_um < self.min_width_um - 1e-9:
            raise ValueError(
                f"steps of {self.model.finest_um:g} µm are narrower than min_width_um = {self.min_width_um:g}"
            )
        return self

    @property
    def depths(self) -> Depths:
        """The etch passes."""
        return Depths(self.passes_nm, self.band_nm)


def read_design(path: Path) -> DesignFile:
    """Read a design.

    Raises:
        ConfigError: missing, no TOML, or not what a design needs.
    """
    return read_toml_model(path, DesignFile, error=ConfigError)


def write_design(design: DesignFile, path: Path) -> None:
    """Write a design, all or nothing.

    Raises:
        RecordError: the file cannot be written.
    """
    data: dict[str, Any] = design.model_dump(mode="json")
    write_text(path, tomli_w.dumps(data))


class LayoutHeader(Part):
    """Metadata of a layout file."""

    format: Literal["anisoscope layout"] = "anisoscope layout"
    schema_version: Literal[1] = 1
    passes_nm: tuple[Positive, ...]
    grid_um: Positive
    names: tuple[str, ...]
    wavelength_nm: Positive
    coherence_um: Positive
    designs: tuple[DesignFile, ...] = ()


def write_layout(layout: Layout, path: Path, designs: tuple[DesignFile, ...] = ()) -> None:
    """Write a layout as npz, all or nothing: ``header`` (JSON), ``tiles``, ``tile_class``, ``index``.

    Raises:
        RecordError: the file cannot be written.
    """
    header = LayoutHeader(
        passes_nm=layout.passes_nm, grid_um=layout.grid_um, names=layout.names,
        wavelength_nm=layout.wavelength_nm, coherence_um=layout.coherence_um, designs=designs,
    )  # fmt: skip
    text = np.frombuffer(header.model_dump_json().encode(), dtype=np.uint8)
    packed = io.BytesIO()
    np.savez_compressed(
        packed, header=text, tiles=layout.tiles, tile_class=layout.tile_class, index=layout.index
    )
    write_bytes(path, packed.getvalue())


def read_layout(path: Path) -> tuple[Layout, tuple[DesignFile, ...]]:
    """Read a layout and the designs of its classes.

    Raises:
        ConfigError: missing, damaged, or not a layout.
    """
    try:
        with regular_file(path) as stream, np.load(stream, allow_pickle=False) as file:
            header = LayoutHeader.model_validate_json(bytes(file["header"]))
            tiles, tile_class, index = file["tiles"], file["tile_class"], file["index"]
    except ValidationError as problem:
        raise ConfigError(f"{path}: {one_line(problem, LayoutHeader)}") from None
    except FileNotFoundError:
        raise ConfigError(f"{path}: there is no such file") from None
    except (OSError, ValueError, KeyError, EOFError, TypeError, zipfile.BadZipFile, zlib.error) as problem:
        raise ConfigError(
            f"{path}: not a layout of dots ({problem}); make one with anisoscope design pattern or refine"
        ) from None
    try:
        layout = Layout(
            tiles, tile_class, index, header.passes_nm, header.grid_um, header.names, header.wavelength_nm,
            header.coherence_um,
        )  # fmt: skip
    except ConfigError as problem:
        raise ConfigError(f"{path}: {problem}") from None
    return layout, header.designs


def mixed(designs: Sequence[DesignFile], shares: Sequence[float], name: str | None = None) -> DesignFile:
    """A mixture of designs by shares of the area.

    Raises:
        ModelError: fewer than two designs, mixtures of mixtures, designs that are not etched alike, or shares that do
            not add up to 1.
    """
    if len(designs) < 2 or len(designs) != len(shares):
        raise ModelError(
            f"a mixture needs two designs or more and a share for each, not {len(designs)} and {len(shares)}"
        )
    models = []
    for design in designs:
        if isinstance(design.model, MixtureModel):
            raise ModelError(f"{design.name} is a mixture itself: give its parts instead")
        models.append(design.model)
    first = designs[0]
    for other in designs[1:]:
        same = ("passes_nm", "grid_um", "wavelength_nm", "coherence_um")
        off = [key for key in same if getattr(other, key) != getattr(first, key)]
        if off:
            raise ModelError(
                f"{first.name} and {other.name} differ in {', '.join(off)}: design them for one wafer"
            )
    try:
        model = MixtureModel(shares=tuple(shares), models=tuple(models))
    except ValidationError as problem:
        raise ModelError(one_line(problem, MixtureModel)) from None
    title = name or " + ".join(f"{share:g} {one.name}" for share, one in zip(shares, designs, strict=True))
    finest = min(design.min_width_um for design in designs)
    return first.model_copy(update={"name": title, "model": model, "min_width_um": finest, "figures": {}})
