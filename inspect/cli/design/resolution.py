"""``anisoscope design resolution``: how small a dot can be under a source."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from anisoscope.base.errors import UsageError
from anisoscope.cli.design.output import check_seed
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json, parse_numbers
from anisoscope.cli.tables import print_table

if TYPE_CHECKING:
    from anisoscope.sim.design.designfile import DesignFile
    from anisoscope.sim.design.resolution import Tradeoff

USUAL = "16:16,56:16,112:16,160:16,160:80"
MOST_RANDOM = 100


def resolution(
    design: Path,
    /,
    *,
    sizes: Annotated[
        str, Parameter(help="Dot and coherence length in µm, DOT:COHERENCE, comma-separated.")
    ] = USUAL,
    random_dots: Annotated[int, Parameter(help="Random dots of every pair, 1 to 100.")] = 8,
    seed: Annotated[int, Parameter(help="Seed of the dots.")] = 0,
    png: Annotated[
        Path | None, Parameter(help="Picture of expected and observed reflectance: *.png or *.svg.")
    ] = None,
    json_: Json = False,
) -> int:
    """Show how far random dots are from the expected reflectance: spatial against directional resolution.

    A dot averages n = (dot/coherence)² windows; its error falls as 1/√n.

    Args:
        design: Lobe or anti-mirror, *.toml.

    Examples:
        anisoscope design resolution wide.toml
        anisoscope design resolution wide.toml --sizes 16:16,160:16,160:80 --png resolution.png
    """
    import numpy as np

    from anisoscope.sim.design.designfile import read_design
    from anisoscope.sim.design.resolution import tradeoff

    check_seed(seed)
    if png is not None and png.suffix.lower() not in (".png", ".svg"):
        raise UsageError(f"--png {png}: a picture is named *.png or *.svg")
    if not 1 <= random_dots <= MOST_RANDOM:
        raise UsageError(f"--random-dots takes 1 to {MOST_RANDOM}, not {random_dots}")
    pairs = [_pair(part) for part in sizes.split(",")]
    chosen = read_design(design)
    found = tradeoff(chosen, pairs, random_dots, np.random.default_rng(seed))
    if png is not None:
        _draw(chosen, found, png)
    if json_:
        print_json({"design": chosen.name, "seed": seed, "random_dots": random_dots, "pairs": found})
        return 0
    print_table(
        f"{chosen.name}: random dots against the expectation, |h| ≤ 0.2",
        ["dot [µm]", "dpi", "Δc [µm]", "source at 500 nm [°]", "windows n", "relative error", "from dot to dot"],
        [
            [
                f"{one.dot_um:g}", f"{25400.0 / one.dot_um:.0f}", f"{one.coherence_um:g}", f"{one.source_deg:.2f}",
                f"{one.windows:.3g}", f"{one.error:.3f}", "–" if np.isnan(one.scatter) else f"± {one.scatter:.3f}",
            ]
            for one in found
        ],
    )  # fmt: skip
    if png is not None:
        sys.stdout.write(f"written: {png}\n")
    return 0


def _pair(text: str) -> tuple[float, float]:
    parts = text.split(":")
    if len(parts) != 2:
        raise UsageError(f"--sizes takes pairs DOT:COHERENCE in µm, such as 112:16, not {text!r}")
    return parse_numbers(parts[0], "--sizes", "112:16")[0], parse_numbers(parts[1], "--sizes", "112:16")[0]


def _draw(design: "DesignFile", found: "tuple[Tradeoff, ...]", path: Path) -> None:
    """Expected reflectance, one dot of each pair, and the error over n."""
    import io

    import numpy as np

    from anisoscope.base.atomic_write import write_bytes
    from anisoscope.report.figures import BLUE, MUTED, new_figure
    from anisoscope.sim.design.resolution import PICTURE, REACH, expected

    h = np.linspace(-REACH, REACH, PICTURE)
    panels = [(expected(design, found[0].coherence_um, h, found[0].dot_um), "expected")]
    panels += [(one.observed, f"Δd {one.dot_um:g}, Δc {one.coherence_um:g} µm") for one in found]
    with new_figure(2.1 * len(panels) + 3.2, 2.6) as (figure, axes):
        axes.remove()
        row = figure.subplots(1, len(panels) + 1, width_ratios=[1.0] * len(panels) + [1.4])
        for panel, (density, title) in zip(row, panels, strict=False):
            panel.imshow(
                density, origin="lower", cmap="gray", extent=(-REACH, REACH, -REACH, REACH),
                vmin=0.0, vmax=float(np.percentile(density, 99.7)),
            )  # fmt: skip
            panel.set_title(title, fontsize=8)
            panel.set_xlabel("h_x [1]")
        n = np.array([one.windows for one in found])
        last = row[-1]
        last.loglog(n, [one.error for one in found], "o", color=BLUE)
        line = np.array([n.min(), n.max()])
        last.loglog(line, found[-1].error * np.sqrt(n[-1] / line), "--", color=MUTED, linewidth=1.0)
        last.set_xlabel("windows n; dashed: 1/√n")
        last.set_ylabel("relative error [1]")
        last.grid()
        stream = io.BytesIO()
        kind = path.suffix.lower()[1:]
        figure.savefig(
            stream, format=kind, dpi=110, metadata={"Date": None} if kind == "svg" else {"Software": None}
        )
    write_bytes(path, stream.getvalue())
