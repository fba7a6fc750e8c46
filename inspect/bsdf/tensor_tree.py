"""Tensor trees in LBNL's XML: mean BRDFs over cells of a square, which are halved where the BRDF changes.

The square is a hemisphere by the equal-area map of Shirley and Chiu, so that cells of one size have equal projected
solid angles. A node is ``{ 2^n nodes }`` or ``{ 2^(n·k) values }``. Bit i of the number of a node is the half along
axis i; values run along the last axis first. Axes are x, y of the incident square and x, y of the outgoing one (rank
4). Isotropic surfaces have one incident axis, 0.5 − 0.5·sin θ, for light that travels toward azimuth 0 (rank 3); the
upper half of that axis is not used.

Sources: Ward, Kurt and Bonneel, "Reducing anisotropic BSDF measurement to common practice", 2014; the reader of
Radiance (src/common/bsdf_t.c) for the order of axes; Shirley and Chiu, "A low distortion map between disk and square",
1997.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from anisoscope.base.arrays import FloatArray
from anisoscope.base.errors import UsageError
from anisoscope.base.progress import Advance, silent
from anisoscope.bsdf.file_format import BsdfFile
from anisoscope.bsdf.klems import read_klems
from anisoscope.bsdf.lbnl_xml import WindowElement, is_xml, write_window_element
from anisoscope.bsdf.reflectance import Reflectance, above_horizon, refuse_huge

STRUCTURES = {"TensorTree3": 3, "TensorTree4": 4}
BASIS = "LBNL/Shirley-Chiu"
DEPTHS = {3: 8, 4: 6}
"""Times that a cell is halved at most, by rank."""
_FIRST = {3: 5, 4: 4}  # level of the even grid from which cells are halved
_DRAWS = {3: 8, 4: 4}  # directions in a cell
_ROOTS = {3: 1.2207440846057596, 4: 1.1673039782614187}  # of x⁴ = x + 1 and x⁵ = x + 1
_RELATIVE, _OF_PEAK = 0.05, 0.002  # a cell is halved where its halves differ by more
_PIECE = 1 << 15
_BYTES_A_VALUE = 100
_DEEPEST = 32

Integers = npt.NDArray[np.int64]


def write_tensor_tree(
    reflectance: Reflectance, path: Path, on_progress: Advance = silent, depth: int | None = None
) -> None:
    """Average a reflectance of one channel over cells and write it.

    Args:
        reflectance: what is written.
        path: the file.
        on_progress: called with what is being done, steps done and steps in all.
        depth: times that a cell is halved at most; `DEPTHS` by default.

    Raises:
        UsageError: several wavelengths, or a tree that would be huge.
        RecordError: the file cannot be written.
    """
    if reflectance.channels != 1:
        raise UsageError(f"{reflectance.name}: a tensor tree holds one value for all light")
    rank = 3 if reflectance.isotropic else 4
    deepest = DEPTHS[rank] if depth is None else depth
    first = min(_FIRST[rank], deepest)
    side = 2**first
    axes = [np.arange(side // 2 if rank == 3 and n == 0 else side) for n in range(rank)]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, rank)
    values = _means(reflectance, cells, first, rank)
    tree = {first: _keyed(cells, values)}
    peak = float(np.abs(values).max())
    for level in range(first, deepest):
        on_progress("levels", level - first, deepest - first)
        # A cell is looked at where its sisters differ: flat regions of a smooth function stay flat.
        cells = cells[_uneven(cells, values, peak)]
        refuse_huge(len(cells) * 2**rank * _BYTES_A_VALUE, str(path))
        halves = (2 * cells[:, None, :] + _corners(rank)[None]).reshape(-1, rank)
        values = _means(reflectance, halves, level + 1, rank)
        families = values.reshape(-1, 2**rank)
        spread = families.max(axis=1) - families.min(axis=1)
        split = spread > _RELATIVE * np.abs(families).mean(axis=1) + _OF_PEAK * peak
        cells, values = halves.reshape(-1, 2**rank, rank)[split].reshape(-1, rank), families[split].ravel()
        tree[level + 1] = _keyed(cells, values)
        if not split.any():
            break
    on_progress("levels", deepest - first, deepest - first)
    text = _text(tree, first, rank)
    write_window_element(path, reflectance.name, f"TensorTree{rank}", {"AngleBasis": BASIS}, text)


def read_tensor_tree(path: Path) -> Reflectance:
    """Read the luminance of a tensor tree: the reflection on the side of the surface normal.

    Raises:
        UsageError: no such file, another basis, or a tree that is damaged.
    """
    element = WindowElement(path)
    rank = STRUCTURES.get(element.structure)
    basis = element.text("AngleBasis")
    if rank is None or basis.lower() != BASIS.lower():
        raise UsageError(
            f"{path}: a tensor tree of rank 3 or 4 on {BASIS} is expected, not {element.structure!r} on {basis!r}"
        )
    tree = _parsed(element.text("ScatteringData"), rank, path)

    def value(to_light: FloatArray, to_camera: FloatArray) -> FloatArray:
        return tree.at(_position(to_light, to_camera, rank))

    return Reflectance(
        element.name, lambda light, camera: above_horizon(light, camera, value), isotropic=rank == 3
    )


def disk_of(square: FloatArray) -> FloatArray:
    """(…, 2) points of the unit disk of (…, 2) points of the unit square, by the map of Shirley and Chiu."""
    a, b = 2.0 * square[..., 0] - 1.0, 2.0 * square[..., 1] - 1.0
    wide = np.abs(a) > np.abs(b)
    safe_a, safe_b = np.where(a == 0.0, 1.0, a), np.where(b == 0.0, 1.0, b)
    radius = np.where(wide, a, b)
    turn = np.where(
        wide, 0.25 * np.pi * b / safe_a, 0.5 * np.pi - 0.25 * np.pi * np.where(b == 0.0, 0.0, a / safe_b)
    )
    return np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=-1)


def square_of(disk: FloatArray) -> FloatArray:
    """(…, 2) points of the unit square of (…, 2) points of the unit disk: the inverse of `disk_of`."""
    x, y = disk[..., 0], disk[..., 1]
    radius = np.hypot(x, y)
    turn = np.arctan2(y, x)
    turn = np.where(turn < -0.25 * np.pi, turn + 2.0 * np.pi, turn)  # −45° to 315°
    quarter = np.minimum(np.floor(turn / (0.5 * np.pi) + 0.5), 3.0)
    along = radius * (turn - 0.5 * np.pi * quarter) / (0.25 * np.pi)
    a = np.select([quarter == 0, quarter == 1, quarter == 2], [radius, -along, -radius], along)
    b = np.select([quarter == 0, quarter == 1, quarter == 2], [along, radius, -along], -radius)
    return np.stack([0.5 * (a + 1.0), 0.5 * (b + 1.0)], axis=-1)


def _position(to_light: FloatArray, to_camera: FloatArray, rank: int) -> FloatArray:
    """(N, rank) places in the tree of (N, 3) directions."""
    travels = -to_light[:, :2]
    if rank == 4:
        return np.concatenate([square_of(travels), square_of(to_camera[:, :2])], axis=1)
    turn = np.arctan2(travels[:, 1], travels[:, 0])
    cos, sin = np.cos(turn), np.sin(turn)
    x, y = to_camera[:, 0], to_camera[:, 1]
    out = np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)
    radius = np.minimum(np.hypot(travels[:, 0], travels[:, 1]), 1.0)
    first = np.minimum(0.5 - 0.5 * radius, 0.5 - 1e-9)
    return np.concatenate([first[:, None], square_of(out)], axis=1)


def _means(reflectance: Reflectance, cells: Integers, level: int, rank: int) -> FloatArray:
    """(C,) means over cells, in pieces."""
    count = np.arange(1, _DRAWS[rank] + 1)[:, None]
    draws = np.mod(0.5 + count * _ROOTS[rank] ** -np.arange(1.0, rank + 1.0), 1.0)  # additive recurrence
    step = max(1, _PIECE // _DRAWS[rank])
    found = [np.zeros(0)]
    for start in range(0, len(cells), step):
        place = (cells[start : start + step, None, :] + draws[None]) / 2.0**level
        place = place.reshape(-1, rank)
        if rank == 4:
            travels, out = disk_of(place[:, :2]), disk_of(place[:, 2:])
        else:
            radius = 1.0 - 2.0 * place[:, 0]
            travels, out = np.stack([radius, np.zeros_like(radius)], axis=-1), disk_of(place[:, 1:])
        values = reflectance.evaluate(_up(-travels), _up(out))[:, 0]
        found.append(values.reshape(-1, _DRAWS[rank]).mean(axis=1))
    return np.concatenate(found)


def _up(flat: FloatArray) -> FloatArray:
    """(N, 3) unit vectors of the upper hemisphere."""
    z = np.sqrt(np.maximum(1.0 - np.sum(flat**2, axis=1), 0.0))
    return np.column_stack([flat, z])


def _corners(rank: int) -> Integers:
    """(2^rank, rank) halves along every axis, in the order of nodes."""
    return np.asarray((np.arange(2**rank)[:, None] >> np.arange(rank)) & 1)


def _uneven(cells: Integers, values: FloatArray, peak: float) -> npt.NDArray[np.bool_]:
    """(C,) whether a cell and its sisters differ."""
    parent = np.unique(cells // 2, axis=0, return_inverse=True)[1].ravel()
    count = int(parent.max()) + 1 if len(cells) else 0
    low, high, total = np.full(count, np.inf), np.full(count, -np.inf), np.zeros(count)
    np.minimum.at(low, parent, values)
    np.maximum.at(high, parent, values)
    np.add.at(total, parent, np.abs(values))
    mean = total / np.maximum(np.bincount(parent, minlength=count), 1)
    return np.asarray((high - low > _RELATIVE * mean + _OF_PEAK * peak)[parent])


def _keyed(cells: Integers, values: FloatArray) -> dict[int, float]:
    """Values by the numbers of their cells: the bits of all axes, so that the halves of a cell follow each other."""
    rank = cells.shape[1]
    number = np.zeros(len(cells), dtype=np.int64)
    for bit in range(int(cells.max(initial=0)).bit_length()):
        for axis in range(rank):
            number |= (cells[:, axis] >> bit & 1) << (rank * bit + axis)
    return dict(zip(number.tolist(), values.tolist(), strict=True))


def _text(tree: dict[int, dict[int, float]], first: int, rank: int) -> str:
    many = 2**rank
    corners = [tuple(one) for one in _corners(rank).tolist()]
    grid = sorted(range(many), key=lambda n: corners[n])  # values run along the last axis first

    def node(cell: int, level: int) -> str:
        halves = range(cell * many, (cell + 1) * many)
        below = tree.get(level + 1, {})
        if level >= first and halves[0] not in below:
            return f"{{{max(tree[level][cell], 0.0):.5g}}}" if cell in tree[level] else "{0}"
        if level + 1 >= first:
            values = [below.get(half) for half in halves]
            following = tree.get(level + 2, {})
            if None not in values and not any(half * many in following for half in halves):
                return "{" + " ".join(f"{max(values[n] or 0.0, 0.0):.5g}" for n in grid) + "}"
        return "{\n" + "\n".join(node(half, level + 1) for half in halves) + "\n}"

    return node(0, 0)


@dataclass(frozen=True, eq=False)
class _Tree:
    """Nodes in the order of the file.

    Attributes:
        child: (M, 2^rank) numbers of the nodes below each, 0 in a leaf: the root is below none.
        start: (M,) place of the first value of a leaf.
        halvings: (M,) binary logarithm of the values of a leaf along an axis, −1 in a branch.
        values: of all leaves.
    """

    child: Integers
    start: Integers
    halvings: Integers
    values: FloatArray

    def at(self, place: FloatArray) -> FloatArray:
        """(N,) values at (N, rank) places in 0 to 1."""
        rest = np.clip(place, 0.0, np.nextafter(1.0, 0.0))
        rank = rest.shape[1]
        node = np.zeros(len(rest), dtype=np.int64)
        for _ in range(_DEEPEST):
            branch = self.halvings[node] < 0
            if not branch.any():
                break
            twice = 2.0 * rest[branch]
            upper = twice >= 1.0
            rest[branch] = twice - upper
            node[branch] = self.child[node[branch], upper @ (1 << np.arange(rank))]
        along = self.halvings[node]
        cell = np.floor(rest * (1 << along)[:, None]).astype(np.int64)
        index = np.zeros(len(rest), dtype=np.int64)
        for axis in range(rank):
            index = (index << along) + cell[:, axis]
        return np.asarray(self.values[self.start[node] + index])


def _parsed(text: str, rank: int, path: Path) -> _Tree:
    """The tree of a text.

    Raises:
        UsageError: it is none.
    """
    refuse_huge(_BYTES_A_VALUE * len(text) // 8, str(path))
    nodes = _Nodes(rank, path)
    for token in re.findall(r"[{}]|[^{}]+", text):
        if token == "{":
            nodes.open()
        elif token == "}":
            nodes.close()
        elif words := token.replace(",", " ").split():
            nodes.fill(words)
    return nodes.tree()


class _Nodes:
    """Nodes as they are read, one brace or leaf after another; every method may raise `UsageError`."""

    def __init__(self, rank: int, path: Path) -> None:
        self.rank, self.path, self.many = rank, path, 2**rank
        self.child: list[list[int]] = []
        self.start: list[int] = []
        self.halvings: list[int] = []
        self.parts: list[FloatArray] = []
        self.total = 0
        self.above: list[int] = []

    def open(self) -> None:
        """A node begins."""
        number = len(self.child)
        if (number and not self.above) or len(self.above) >= _DEEPEST:
            raise self._error("a brace opens after its end, or too deep")
        if self.above:
            self.child[self.above[-1]].append(number)
        self.child.append([])
        self.start.append(-1)
        self.halvings.append(-1)
        self.above.append(number)

    def close(self) -> None:
        """The node ends that began last."""
        if not self.above:
            raise self._error("a brace closes that none opened")
        number = self.above.pop()
        if self.start[number] < 0 and len(self.child[number]) != self.many:
            raise self._error(
                f"a node has {len(self.child[number])} nodes below it, {self.many} are expected"
            )

    def fill(self, words: list[str]) -> None:
        """The values of a leaf."""
        try:
            found = np.array(words, dtype=np.float64)
        except ValueError as problem:
            raise self._error(f"something is no number: {problem}") from None
        along = round(float(np.log2(found.size)) / self.rank)
        is_leaf = bool(self.above) and not self.child[self.above[-1]] and self.start[self.above[-1]] < 0
        if not is_leaf or 2 ** (self.rank * along) != found.size or not np.isfinite(found).all():
            raise self._error(f"a leaf holds {found.size} values, {self.many} to some power are expected")
        self.start[self.above[-1]], self.halvings[self.above[-1]] = self.total, along
        self.parts.append(found)
        self.total += found.size

    def tree(self) -> _Tree:
        """The whole tree."""
        if self.above or not self.child:
            raise self._error(f"it is cut off: {len(self.above)} braces are open at its end")
        table = np.zeros((len(self.child), self.many), dtype=np.int64)
        for number, below in enumerate(self.child):
            if below:
                table[number] = below
        return _Tree(table, np.array(self.start), np.array(self.halvings), np.concatenate(self.parts))

    def _error(self, reason: str) -> UsageError:
        return UsageError(f"{self.path}: ScatteringData is no tensor tree: {reason}")


def read_lbnl(path: Path) -> Reflectance:
    """Read LBNL's XML: a tensor tree or a Klems matrix; errors as for their readers."""
    tree = WindowElement(path).structure in STRUCTURES
    return read_tensor_tree(path) if tree else read_klems(path)


TENSOR_TREE = BsdfFile("tensor-tree", "tensor-tree XML", is_xml, read_lbnl, 3)
