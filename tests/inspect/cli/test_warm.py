"""Kernels are compiled by one command, so that no later one has to."""

import json
import os
import subprocess
import sys

import pytest

LATER = (
    "profile make ridges --size 300,600 --pitch 60 --out map.npz --overwrite",
    "profile ridges map.npz",
    "predict map.npz",
    "demo --out demo",
    "predict --ridge-angle 10",
    "render frame map.npz --out frame.png --panel 64",
    "profile make staircase --size 20 --pixel 0.1 --out steps.npz",
    "predict steps.npz --model wave --wavelengths 500",
    "ink show synthetic-red --png ink.png",
    "ink halftone frame.png --out dots.png --print-width 2",
    "design lobe --sigma 0.04 --out lobe.toml",
    "design refine lobe.toml --seconds 0.1 --out dot.npz",
)


@pytest.mark.soak
def test_after_warm_no_command_compiles(tmp_path):
    """About three minutes of processor time in an empty folder of compiled kernels."""

    def run(line):
        return subprocess.run(
            [sys.executable, "-Im", "anisoscope", *line.split()],
            cwd=tmp_path,
            env={
                **os.environ,
                "NUMBA_CACHE_DIR": str(tmp_path / "kernels"),
                "ANISOSCOPE_CACHE": str(tmp_path / "cache"),
            },
            capture_output=True,
            text=True,
            check=False,
        )

    assert run(LATER[0]).returncode == 0
    assert "compiling kernels" in run("profile ridges map.npz").stderr
    assert run("warm --json").returncode == 0
    sources = json.loads((tmp_path / "cache" / "sources.json").read_text())["files"]
    for line in LATER:
        found = run(line)
        assert found.returncode == 0, (line, found.stderr)
        assert "compiling kernels" not in found.stderr, line
    assert len(sources) > 500
    assert json.loads((tmp_path / "cache" / "sources.json").read_text())["files"] == sources
