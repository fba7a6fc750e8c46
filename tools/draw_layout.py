"""Draw docs/pictures/layout.svg: the packages of the first level, floor above floor, from the imports of the code.

    python tools/draw_layout.py [--out FILE]

A floor is the longest chain of imports below a package. An arrow stands for an import; it is left out where a chain of
other arrows says the same (transitive reduction), so that every import is an arrow or a way along arrows. The layers of
a drawing, the order within them and the places of the boxes follow Sugiyama, Tagawa and Toda (1981).
"""

import argparse
import json
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import matplotlib as mpl

mpl.use("svg")
import house
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch
from matplotlib.path import Path as Curve

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "pictures" / "layout.svg"
# What a package is about, as (name, fill, line); the order is that of the key.
GROUPS = {
    "what is called": ("#dbe7f3", "#3c6a99"),
    "inspection of a part": ("#fbe3c8", "#a8681c"),
    "statistics and history": ("#e6ddf1", "#6c4f93"),
    "prediction and models": ("#d9ecd9", "#3f7f46"),
    "files, devices, ground": ("#e6e6e6", "#555555"),
}
MEMBERS = {
    "what is called": "__main__ cli api console study",
    "inspection of a part": "inspection kinds report commissioning live_view diagnosis decision calibration imaging",
    "statistics and history": "quality history",
    "prediction and models": "prediction fit ink experiment sim materials",
    "files, devices, ground": "recipe record profiles rig base",
}
SWEEPS = 24
BOX = (1.65, 0.5)  # width, height
GAP, RISE = 0.4, 1.0  # between neighbours, between floors


def downward(checkout: Path) -> dict[str, set[str]]:
    """Imports between packages of the first level, those left out that go against the contract."""
    graph = house.import_graph(checkout)
    wrong = set(house.upward_imports(graph, house.contract_layers(checkout)))
    kept = {
        module: {other for other in found if (module, other) not in wrong} for module, found in graph.items()
    }
    return house.packages_of(kept)


def thinned(graph: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """The same graph without arrows that a longer way says already (transitive reduction; no circles)."""
    reached: dict[str, set[str]] = {}
    for node in sorted(graph, key=house.floors(graph).__getitem__):
        reached[node] = set(graph[node]).union(*(reached[other] for other in graph[node]))
    return {
        node: {other for other in found if not any(other in reached[way] for way in found)}
        for node, found in graph.items()
    }


Node = tuple[str, str, int]
"""A box (name, "", floor), or where the arrow from a box to another crosses a floor (box, other, floor)."""


def places(
    arrows: Mapping[str, set[str]], floor: Mapping[str, int]
) -> tuple[dict[Node, float], list[list[Node]]]:
    """Place of every box and of every crossing along x, and the chain of nodes of every arrow."""
    rows: dict[int, list[Node]] = {level: [] for level in range(1, max(floor.values()) + 1)}
    for name in sorted(floor):
        rows[floor[name]].append((name, "", floor[name]))
    chains: list[list[Node]] = []
    for name in sorted(arrows):
        for other in sorted(arrows[name]):
            crossings = [(name, other, level) for level in range(floor[name] - 1, floor[other], -1)]
            for crossing in crossings:
                rows[crossing[2]].append(crossing)
            chains.append([(name, "", floor[name]), *crossings, (other, "", floor[other])])
    near: dict[Node, list[Node]] = {node: [] for row in rows.values() for node in row}
    for chain in chains:
        for one, other in pairwise(chain):
            near[one].append(other)
            near[other].append(one)
    _order(rows, near)
    x: dict[Node, float] = {}
    for row in rows.values():
        x.update(_spread(row, {node: place * (BOX[0] + GAP) for place, node in enumerate(row)}))
    for sweep in range(8 * SWEEPS):  # toward the mean of all neighbours, not nearer than the boxes allow
        for level in sorted(rows, reverse=sweep % 2 == 0):
            wanted = {node: _mean([x[other] for other in near[node]], x[node]) for node in rows[level]}
            x.update(_spread(rows[level], wanted))
    return x, chains


def _order(rows: dict[int, list[Node]], near: Mapping[Node, list[Node]]) -> None:
    """Order within every floor: by the mean place of the neighbours above, then of those below, and again."""
    x = {node: float(place) for row in rows.values() for place, node in enumerate(row)}
    for sweep in range(SWEEPS):
        side = 1 if sweep % 2 == 0 else -1
        for level in sorted(rows, reverse=side > 0):
            mean = {
                node: _mean([x[other] for other in near[node] if other[2] == level + side], x[node])
                for node in rows[level]
            }
            rows[level].sort(key=lambda node: (mean[node], node))
            x.update({node: float(place) for place, node in enumerate(rows[level])})


def _mean(values: list[float], otherwise: float) -> float:
    return sum(values) / len(values) if values else otherwise


def _width(node: Node) -> float:
    return 0.35 if node[1] else BOX[0] + GAP


def _spread(row: list[Node], wanted: dict[Node, float]) -> dict[Node, float]:
    """Places as near to the wanted ones as the widths allow, in the given order (pool adjacent violators)."""
    offsets, at = [], 0.0
    for before, node in zip([None, *row], row, strict=False):
        at += 0.0 if before is None else 0.5 * (_width(before) + _width(node))
        offsets.append(at)
    pools: list[tuple[float, int]] = []
    for node, offset in zip(row, offsets, strict=True):
        pools.append((wanted[node] - offset, 1))
        while len(pools) > 1 and pools[-2][0] > pools[-1][0]:
            (one, m), (other, n) = pools.pop(-2), pools.pop()
            pools.append(((one * m + other * n) / (m + n), m + n))
    starts = [start for start, count in pools for _ in range(count)]
    return {node: start + offset for node, start, offset in zip(row, starts, offsets, strict=True)}


def draw(arrows: Mapping[str, set[str]], floor: Mapping[str, int], out: Path) -> None:
    """Write the picture."""
    x, chains = places(arrows, floor)
    left, right = min(x.values()) - BOX[0], max(x.values()) + BOX[0]
    height = (max(floor.values()) + 0.6) * RISE
    plt.rcParams.update({"svg.hashsalt": "layout", "svg.fonttype": "none", "font.family": "sans-serif"})
    figure = plt.figure(figsize=(0.72 * (right - left), 0.72 * height))
    axes = figure.add_axes((0, 0, 1, 1), xlim=(left, right), ylim=(0.0, height), aspect="equal")
    axes.axis("off")
    for level in range(1, max(floor.values()) + 1, 2):
        axes.axhspan((level - 0.5) * RISE, (level + 0.5) * RISE, color="#f6f6f6", lw=0, zorder=0)
    for chain in chains:
        _arrow(axes, [(x[node], node[2] * RISE) for node in chain])
    for name, level in floor.items():
        _box(axes, name, x[name, "", level], level * RISE)
    _key(axes, left, right)
    content = json.dumps({name: sorted(arrows[name]) for name in sorted(arrows)})
    figure.savefig(
        out,
        metadata={"Date": None, "Creator": None, "Title": "Packages of anisoscope", "Description": content},
    )
    plt.close(figure)


def _arrow(axes: Axes, points: list[tuple[float, float]]) -> None:
    """A smooth way from the lower rim of a box through its crossings to the upper rim of another."""
    half = 0.5 * BOX[1]
    start, end = points[0], points[-1]
    way = [(start[0], start[1] - half), *points[1:-1], (end[0], end[1] + half + 0.02)]
    before, after = (way[0][0], way[0][1] + 1.0), (way[-1][0], way[-1][1] - 1.0)  # leaves and enters upright
    vertices, codes = [way[0]], [Curve.MOVETO]
    points = [before, *way, after]
    for a, b, c, d in zip(points, points[1:], points[2:], points[3:], strict=False):
        # Catmull and Rom: the direction at a point is that between its neighbours
        rise = (b[1] - c[1]) / 3.0
        first = (b[0] - rise * (c[0] - a[0]) / (c[1] - a[1]), b[1] - rise)
        second = (c[0] + rise * (d[0] - b[0]) / (d[1] - b[1]), c[1] + rise)
        vertices += [first, second, c]
        codes += [Curve.CURVE4] * 3
    axes.add_patch(
        FancyArrowPatch(
            path=Curve(vertices, codes),
            arrowstyle="-|>,head_width=2.2,head_length=4",
            color="#8a8a8a",
            lw=0.9,
            zorder=1,
        )
    )


def _box(axes: Axes, name: str, x: float, y: float) -> None:
    group = next((one for one, names in MEMBERS.items() if name in names.split()), "files, devices, ground")
    fill, line = GROUPS[group]
    corner = (x - 0.5 * BOX[0], y - 0.5 * BOX[1])
    axes.add_patch(
        FancyBboxPatch(corner, *BOX, "round,pad=0,rounding_size=0.1", fc=fill, ec=line, lw=1.0, zorder=2)
    )
    axes.text(x, y, name, ha="center", va="center_baseline", fontsize=10, zorder=3)


def _key(axes: Axes, left: float, right: float) -> None:
    """The groups, in the strip below the lowest floor."""
    step = (right - left) / len(GROUPS)
    for place, (name, (fill, line)) in enumerate(GROUPS.items()):
        x = left + 0.15 + place * step
        axes.add_patch(
            FancyBboxPatch((x, 0.12), 0.26, 0.2, "round,pad=0,rounding_size=0.05", fc=fill, ec=line, lw=0.8)
        )
        axes.text(x + 0.36, 0.22, name, va="center_baseline", fontsize=8)


def main() -> None:
    """Draw the packages of this checkout."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=PICTURE)
    graph = downward(ROOT)
    draw(thinned(graph), house.floors(graph), parser.parse_args().out)


if __name__ == "__main__":
    main()
