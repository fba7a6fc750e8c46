"""State of this installation: packages, kernels, cache, project, recipe, rig file and history."""

import os
import platform
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from anisoscope.base.errors import AnisoscopeError
from anisoscope.operations.project import Default, project_defaults
from anisoscope.operations.project_place import PROJECT_NAME, project_path

State = Literal["ok", "note", "missing"]
OPTIONAL = {
    "vtk": ("view", "3-D views, heights from STL and PLY"),
    "SurfaceTopography": ("formats", "height maps in further formats of instruments"),
    "OpenEXR": ("exr", "height maps as OpenEXR"),
    "fastapi": ("console", "the console in the browser"),
    "Authlib": ("openid", "logins by an OpenID provider"),
    "asyncua": ("line", "OPC UA, MQTT and Modbus/TCP to the controller of a line"),
    "pypylon": ("basler", "Basler cameras"),
    "harvesters": ("genicam", "cameras by their makers' GenTL producers"),
    "pymmcore": ("micromanager", "devices by Micro-Manager's adapters"),
    "bluesky": ("bluesky", "stage, camera and light in Bluesky"),
    "s3fs": ("archive", "an archive in an object store"),
    "imagecodecs": ("jpegxl", "frames packed as JPEG XL"),
    "rfc3161-client": ("timestamp", "time stamps of authorities"),
    "distributed": ("cluster", "sweeps on a Dask cluster"),
    "cupy-cuda12x": ("gpu", "waves on a graphics card"),
}
"""Packages that only some commands need: their extra, and what for."""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        what: name of the thing.
        state: ok; note: something optional, or not used yet; missing: commands will fail.
        text: what was found, or the remedy.
    """

    what: str
    state: State
    text: str


def findings(rig: Path | None, recipe: Path | None) -> Iterator[Finding]:
    """Everything that is looked at, with rig file and recipe, or those of the project."""
    yield Finding("python", "ok", f"{platform.python_version()} at {sys.executable}")
    yield from _packages()
    yield _kernels()
    yield _cache()
    try:
        project = project_defaults()
    except AnisoscopeError as error:
        yield Finding("project", "missing", str(error))
        project = {}
    else:
        yield _project()
    yield _recipe(recipe or _path(project, "recipe"))
    yield from _rig(rig or _path(project, "rig"))
    yield _history(project)


def _path(project: dict[str, Default], key: str) -> Path | None:
    return Path(project[key].value) if key in project else None


def _packages() -> Iterator[Finding]:
    from importlib.metadata import PackageNotFoundError, requires, version

    absent = []
    wanted = [text for text in requires("anisoscope") or [] if "extra ==" not in text]
    for text in wanted:
        name = text.partition(";")[0].split("<")[0].split(">")[0].split("=")[0].strip()
        try:
            version(name)
        except PackageNotFoundError:
            absent.append(name)
    if absent:
        yield Finding("packages", "missing", f"{', '.join(absent)}: pip install --force-reinstall anisoscope")
    else:
        yield Finding(
            "packages", "ok", f"anisoscope {version('anisoscope')}, and all {len(wanted)} that it needs"
        )
    for name, (extra, purpose) in OPTIONAL.items():
        try:
            yield Finding(name, "ok", version(name))
        except PackageNotFoundError:
            yield Finding(name, "note", f"not installed; {purpose}: pip install 'anisoscope[{extra}]'")


def _kernels() -> Finding:
    from importlib.util import find_spec

    spec = find_spec("anisoscope.sim.light")
    folders = list(spec.submodule_search_locations or ()) if spec else []
    count = sum(1 for folder in folders for _ in Path(folder).glob("__pycache__/*.nbi"))
    if count:
        return Finding("kernels", "ok", f"{count} kernels are compiled")
    return Finding("kernels", "note", "not compiled yet; the first prediction compiles them, up to a minute")


def _cache() -> Finding:
    from anisoscope.base.cache import Cache, cache_folder

    folder = cache_folder()
    existing = next((one for one in (folder, *folder.parents) if one.exists()), folder)
    if not existing.is_dir() or not os.access(existing, os.W_OK):
        return Finding(
            "cache", "missing", f"{folder} cannot be written; ANISOSCOPE_CACHE names another folder"
        )
    entries = Cache().stored()
    return Finding(
        "cache", "ok", f"{folder}: {len(entries)} results, {sum(e.size for e in entries) / 1e6:.0f} MB"
    )


def _project() -> Finding:
    path = project_path()
    if path is None:
        return Finding("project", "note", f"no {PROJECT_NAME} here or above; anisoscope init writes one")
    return Finding("project", "ok", str(path))


def _recipe(path: Path | None) -> Finding:
    from anisoscope.kinds.registry import kind_of

    if path is None:
        return Finding("recipe", "note", "none is named; --recipe FILE")
    try:
        kind = kind_of(path)
        kind.read_recipe(path)
    except AnisoscopeError as error:
        return Finding("recipe", "missing", str(error))
    return Finding("recipe", "ok", f"{path}: of {kind.one}")


def _rig(path: Path | None) -> Iterator[Finding]:
    from anisoscope.calibration.corrections import list_calibrations
    from anisoscope.rig.rigfile import read_rig

    if path is None:
        yield Finding("rig", "note", "none is named; --rig FILE")
        return
    try:
        file = read_rig(path)
        calibrations = list_calibrations(path)
    except AnisoscopeError as error:
        yield Finding("rig", "missing", str(error))
        return
    yield Finding("rig", "ok", f"{path}: {file.name}")
    parts = {"stage": file.stage, "tilt": file.tilt, "light": file.light}
    for name, part in parts.items():
        if part is not None:
            yield _driver(f"{name}s" if name == "light" else "stages", name, part.driver, part.port)
    yield _driver("cameras", "camera", file.camera.driver, None)
    for one in calibrations:
        good = one.state in {"valid", "no record"}
        state: State = "ok" if good else "missing" if one.needed or one.file is not None else "note"
        yield Finding(f"calibration: {one.kind}", state, one.advice or f"{one.file}: {one.state}")


def _driver(group: str, name: str, driver: str, port: str | None) -> Finding:
    """Whether a driver is installed, and whether its port is there."""
    from anisoscope.base.plugins import installed

    if driver not in installed(f"anisoscope.{group}"):
        return Finding(name, "missing", f"no driver {driver!r} is installed")
    if port is None or "://" in port or not port.startswith("/"):
        return Finding(name, "ok", " ".join(filter(None, (driver, port))) + "; anisoscope rig status asks it")
    if not Path(port).exists():
        return Finding(name, "missing", f"{driver}: there is no port {port}; anisoscope rig ports lists them")
    if not os.access(port, os.R_OK | os.W_OK):
        return Finding(name, "missing", f"{driver}: {port} cannot be opened by this user (group dialout)")
    return Finding(name, "ok", f"{driver} at {port}; anisoscope rig status asks it")


def _history(project: dict[str, Default]) -> Finding:
    from anisoscope.history.address import VARIABLE, parse_address
    from anisoscope.history.store import open_history

    place = os.environ.get(VARIABLE, "").strip()
    for key in ("history", "out"):
        if not place and key in project:
            place = project[key].value
    if place == "none":
        return Finding("history", "note", "inspections enter none")
    try:
        address = parse_address(place or Path("inspections"))
        if address.path is not None and not address.path.exists():
            return Finding("history", "note", f"{address}: not there yet; the first inspection makes it")
        with open_history(place or Path("inspections"), create=False):
            return Finding("history", "ok", str(address))
    except AnisoscopeError as error:
        return Finding("history", "missing", str(error))
