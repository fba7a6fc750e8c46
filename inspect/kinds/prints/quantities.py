"""The quantities of a print that are judged: from the fit to numbers with limits, uncertainties and verdicts.

Where a quantity is the length of a vector (tilt, shift of chromaticity), its uncertainty is that along the direction in
which it is largest.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from anisoscope.base.arrays import FloatArray
from anisoscope.base.covariance import principal
from anisoscope.decision.decision import guarded
from anisoscope.kinds.prints.colour_map import PrintMap
from anisoscope.kinds.prints.expectation import PrintExpectation
from anisoscope.kinds.prints.lobe_fit import PARAMETERS, PrintFit
from anisoscope.kinds.prints.model import State, roughness_along
from anisoscope.kinds.prints.recipe import PrintRecipe
from anisoscope.kinds.prints.record import ColourRecord, QuantityRecord
from anisoscope.kinds.prints.sources import Source

_STEP = 1e-4
_Rows = tuple[tuple[str, str, float], ...]


class Quantity(QuantityRecord):
    """A judged quantity with the (name, kind, u) of every source that contributes to its uncertainty.

    The record holds the contributions in its budget.
    """

    contributions: _Rows = ()


class Judge:
    """The fitted quantities against their limits; ``origin`` is the state of the golden mean, if the fit is from it."""

    def __init__(
        self,
        expected: PrintExpectation,
        fit: PrintFit,
        recipe: PrintRecipe,
        sources: tuple[Source, ...],
        origin: State | None = None,
    ) -> None:
        self.expected, self.fit, self.recipe, self.sources = expected, fit, recipe, sources
        self.origin = origin
        self.ink, self.limits = expected.scene.ink, recipe.tolerances
        self.brightest = int(np.argmax(expected.channels.sum(axis=1)))

    def quantities(self) -> tuple[Quantity, ...]:
        """Roughness, its ratios, level, chromaticity, tilt."""
        known, rig, limits = self.recipe.print.of_ink(self.ink), self.recipe.uncertainty, self.limits
        found = []
        for name, azimuth in (("x", 0.0), ("y", 90.0)):
            nominal = roughness_along(self.ink, self.origin or State(), azimuth)

            def along(state: State, azimuth: float = azimuth) -> FloatArray:
                return np.log([roughness_along(self.ink, state, azimuth)])

            title = f"roughness along {name}"
            rough = (("roughness of the ink", known.alpha_share),)
            found.append(self._scalar(f"alpha {name}", title, along, nominal, limits.alpha_share, rough))
        found.append(self._ratio("ratio", "ln of roughness at 90° over 0°", 0.0, 90.0))
        found.append(self._ratio("skew", "ln of roughness at 135° over 45°", 45.0, 135.0))
        level = (("level of the ink", known.rho_share), ("colour of the ink", known.colour_share))
        gain = float(np.exp((self._level(self.origin or State()) - self._level(State()))[0]))
        found.append(self._scalar("gain", "level of the ink", self._level, gain, limits.gain_share, level))
        scale = self._chroma_scale()
        colour = (("colour of the ink", known.colour_share * scale),)
        found.append(
            self._length("chromaticity", "shift of u′v′", "", self._chroma, limits.chromaticity, colour)
        )
        seat = (("seating tilt", rig.seating_tilt_deg),)
        found.append(self._length("tilt", "tilt of the flakes", "°", self._tilt, limits.tilt_deg, seat))
        return tuple(found)

    def colour(self, colours: tuple[ColourRecord, ...]) -> Quantity:
        """The largest CIEDE2000 of a pose: the one that comes nearest to its limit, or beyond it by most."""
        coverage = self.recipe.decision.coverage
        worst = max(colours, key=lambda one: one.delta_e + coverage * one.u_delta_e)
        for one in colours:
            if one.delta_e - coverage * one.u_delta_e >= self.limits.delta_e:
                worst = max(colours, key=lambda one: one.delta_e - coverage * one.u_delta_e)
                break
        title = f"ΔE2000 at {worst.stage_deg:g}°, tilt {worst.tilt_deg:g}°"
        return self._size("delta_e", title, "", worst.delta_e, worst.u_delta_e, self.limits.delta_e)

    def curl(self, found: PrintMap) -> Quantity:
        """Change of the lean of the flakes across the region."""
        size, u = float(np.linalg.norm(found.record.curl_deg, 2)), found.record.u_curl_deg
        return self._size("curl", "change of tilt across the region", "°", size, u, self.limits.curl_deg)

    def _ratio(self, name: str, title: str, first: float, second: float) -> Quantity:
        def log_ratio(state: State) -> FloatArray:
            return np.log(
                [roughness_along(self.ink, state, second) / roughness_along(self.ink, state, first)]
            )

        nominal = float(log_ratio(self.origin or State())[0])
        one = self._scalar(name, title, log_ratio, nominal, self.limits.ln_ratio, ())
        return one.model_copy(update={"value": nominal + one.deviation})

    def _level(self, state: State) -> FloatArray:
        """Ln of Y of the brightest pose, as far as the level of the channels makes it."""
        return np.log(self.expected.eye.xyz(self._balanced(state))[[1]])

    def _chroma(self, state: State) -> FloatArray:
        return self.expected.eye.uv(self._balanced(state))

    def _balanced(self, state: State) -> FloatArray:
        change = np.exp([state.red, state.green, state.blue])
        return np.asarray(self.expected.channels[self.brightest] * change)

    def _chroma_scale(self) -> float:
        """Shift of u′v′ by a relative change of one channel, in the worst direction."""
        slopes = self._slopes(self._chroma)[:, [PARAMETERS.index(n) for n in ("red", "green", "blue")]]
        return float(np.linalg.norm(slopes, 2))

    @staticmethod
    def _tilt(state: State) -> FloatArray:
        return np.array([state.tilt_x_deg, state.tilt_y_deg])

    def _slopes(self, function: Callable[[State], FloatArray]) -> FloatArray:
        """(m, 9) derivative of a function of the state at the fit."""
        state, rows = self.fit.state, []
        for name in PARAMETERS:
            value = getattr(state, name)
            after, before = (function(replace(state, **{name: value + s})) for s in (_STEP, -_STEP))
            rows.append((after - before) / (2.0 * _STEP))
        return np.stack(rows, axis=-1)

    def _scalar(
        self,
        name: str,
        title: str,
        function: Callable[[State], FloatArray],
        nominal: float,
        limit: float,
        own: tuple[tuple[str, float], ...],
    ) -> Quantity:
        """A quantity whose logarithm, or which itself, is a function of the state."""
        off = float((function(self.fit.state) - function(State()))[0])
        relative = name not in ("ratio", "skew")
        share = float(np.expm1(off)) if relative else off
        # a change of the logarithm is one of the share times 1 + share
        slope = (1.0 + share) * self._slopes(function)[0] if relative else self._slopes(function)[0]
        u, rows = self._spread(slope, tuple((source, (1.0 + share) * size) for source, size in own))
        return self._guarded(name, title, "", nominal * (1.0 + share), nominal, share, u, limit, rows)

    def _length(
        self,
        name: str,
        title: str,
        unit: str,
        function: Callable[[State], FloatArray],
        limit: float,
        own: tuple[tuple[str, float], ...],
    ) -> Quantity:
        """The length of a vector that should be as of the good print."""
        off = function(self.fit.state) - function(State())
        size, slopes = float(np.linalg.norm(off)), self._slopes(function)
        widest = principal(slopes @ self.fit.covariance @ slopes.T)[1][-1]
        u, rows = self._spread(widest @ slopes, own)
        return self._size(name, title, unit, size, u, limit, rows)

    def _spread(self, slope: FloatArray, own: tuple[tuple[str, float], ...]) -> tuple[float, _Rows]:
        """Standard uncertainty of a number with (9,) derivatives, and what every source contributes."""
        per_channel = slope @ self.fit.gain
        rows = [(s.name, str(s.kind), float(np.linalg.norm(per_channel @ s.factor))) for s in self.sources]
        rows += [(name, "prediction", float(u)) for name, u in own if self.origin is None]
        return float(np.linalg.norm([row[2] for row in rows])), tuple(rows)

    def _size(
        self, name: str, title: str, unit: str, size: float, u: float, limit: float, rows: _Rows = ()
    ) -> Quantity:
        """A size that should be zero."""
        return self._guarded(name, title, unit, size, 0.0, size, u, limit, rows)

    def _guarded(
        self,
        name: str,
        title: str,
        unit: str,
        value: float,
        nominal: float,
        deviation: float,
        u: float,
        limit: float,
        rows: _Rows = (),
    ) -> Quantity:
        verdict, guard, conformance = guarded(deviation, u, limit, self.recipe.decision.coverage)
        return Quantity(
            name=name,
            title=title,
            unit=unit,
            value=value,
            nominal=nominal,
            deviation=deviation,
            u=u,
            limit=limit,
            guard=guard,
            conformance_probability=conformance,
            verdict=verdict,
            contributions=rows,
        )


def sentence(one: Quantity) -> str:
    """A quantity with its limit, such as ``roughness along x is off by +10.2 % (limit ±5 %, guard band 1.7 %)``."""
    if one.name in ("alpha x", "alpha y", "gain"):
        return (
            f"{one.title} is off by {100 * one.deviation:+.1f} % (limit ±{100 * one.limit:g} %, guard band "
            f"{100 * one.guard:.1f} %)"
        )
    if one.name in ("ratio", "skew"):
        return (
            f"{one.title} is off by {one.deviation:+.3f} (limit ±{one.limit:g}, guard band {one.guard:.3f})"
        )
    digits = 4 if one.name == "chromaticity" else 2
    if not one.unit:
        return (
            f"{one.title} is {one.value:.{digits}f} (limit {one.limit:g}, guard band {one.guard:.{digits}f})"
        )
    return (
        f"{one.title} is {one.value:.{digits}f}{one.unit} (limit {one.limit:g}{one.unit}, guard band "
        f"{one.guard:.{digits}f}{one.unit})"
    )
