"""What a light is, and light channels: lamps of one controller and places of a filter wheel under one name."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from anisoscope.base.errors import RigError


@runtime_checkable
class Light(Protocol):
    """A light that can be switched. Every method may raise `RigError`."""

    def on(self) -> None:
        """Switch on; return when it is lit."""
        ...

    def off(self) -> None:
        """Switch off; return when it is dark."""
        ...

    def close(self) -> None:
        """Disconnect; closing twice is fine."""
        ...


@runtime_checkable
class LampController(Light, Protocol):
    """A light of several lamps (ring segments, colours), of which `on` switches the selected ones."""

    @property
    def lamps(self) -> tuple[str, ...]:
        """Names of its lamps."""
        ...

    def select(self, levels_percent: Mapping[str, int]) -> None:
        """Choose the lamps that `on` lights, and their levels; lamps that shine are switched by the next `on`."""
        ...


@runtime_checkable
class FilterWheel(Protocol):
    """A wheel of filters. Every method may raise `RigError`."""

    @property
    def places(self) -> int:
        """Number of filters; the first place is 1."""
        ...

    def place(self) -> int:
        """Read the place in the beam."""
        ...

    def go(self, place: int) -> None:
        """Turn a place into the beam; return on arrival."""
        ...

    def close(self) -> None:
        """Disconnect; closing twice is fine."""
        ...


@dataclass(frozen=True)
class Channel:
    """Switchable light channel.

    Attributes:
        levels_percent: level of every lamp that shines; empty for the only lamp of a light.
        filter: place of the wheel; None leaves it alone.
    """

    levels_percent: Mapping[str, int] = field(default_factory=dict)
    filter: int | None = None


class ChannelLight:
    """A light with channels; `on` lights the one that was selected.

    Args:
        light: the lamp, or the controller of several.
        wheel: the filter wheel, if there is one.
        channels: by name.

    Raises:
        RigError: a channel names a lamp or a place that is not there.
    """

    def __init__(self, light: Light, wheel: FilterWheel | None, channels: Mapping[str, Channel]) -> None:
        self._light, self._wheel, self._channels = light, wheel, dict(channels)
        self.name = str(getattr(light, "name", "light"))
        self.asks = bool(getattr(light, "asks", False))
        self.channel: str | None = None
        lamps = light.lamps if isinstance(light, LampController) else ()
        for name, channel in self._channels.items():
            for lamp in channel.levels_percent.keys() - set(lamps):
                there = f"its lamps are {', '.join(lamps)}" if lamps else "it has one lamp, without a name"
                raise RigError(f"light.channels.{name}.lamps: {self.name} has no lamp '{lamp}'; {there}")
            if channel.filter is not None and (wheel is None or not 1 <= channel.filter <= wheel.places):
                raise RigError(
                    f"light.channels.{name}.filter: the wheel has no place {channel.filter}; it has "
                    f"{0 if wheel is None else wheel.places}"
                )

    @property
    def channels(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(self._channels)

    def select(self, channel: str) -> None:
        """Choose what `on` lights.

        Raises:
            RigError: there is no such channel.
        """
        if channel not in self._channels:
            raise RigError(f"{self.name} has no channel '{channel}'; it has {', '.join(self._channels)}")
        self.channel = channel

    def on(self) -> None:
        """Turn the filter into the beam, and light the lamps of the selected channel, and no others.

        Raises:
            RigError: no channel was selected, or the lamp or the wheel is in trouble.
        """
        if self.channel is None:
            raise RigError(
                f"the light has the channels {', '.join(self._channels)}: choose one, by --channel, by "
                "acquisition.light_channel of the recipe, or by light.channel of the rig file"
            )
        channel = self._channels[self.channel]
        if channel.filter is not None and self._wheel is not None and self._wheel.place() != channel.filter:
            self._light.off()
            self._wheel.go(channel.filter)
        if isinstance(self._light, LampController):
            self._light.select(channel.levels_percent or dict.fromkeys(self._light.lamps, 100))
        self._light.on()

    def off(self) -> None:
        """Switch all lamps off; the wheel stays where it is."""
        self._light.off()

    def close(self) -> None:
        """Disconnect lamp and wheel."""
        try:
            self._light.close()
        finally:
            if self._wheel is not None:
                self._wheel.close()


def rest(light: Light) -> None:
    """Switch off a switchable light without an operator prompt, to make a rig safe.

    A light that a person must switch or cover says so by a true attribute ``asks``.

    Raises:
        RigError: it does not go off.
    """
    if not getattr(light, "asks", False):
        light.off()
