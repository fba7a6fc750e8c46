"""The packages of the distribution, found in the folders that pyproject.toml maps: find: there knows no mapping."""

import tomllib
from pathlib import Path

from setuptools import find_packages, setup

ROOT = Path(__file__).parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
FOLDERS: dict[str, str] = PROJECT["tool"]["setuptools"]["package-dir"]

setup(
    packages=[
        *FOLDERS,
        *(f"{root}.{name}" for root, folder in FOLDERS.items() for name in find_packages(str(ROOT / folder))),
    ]
)
