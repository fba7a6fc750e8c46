"""A stage behind a port: how it is opened, and who closes the port."""

import contextlib
import logging
from collections.abc import Callable
from inspect import signature
from typing import Any, ClassVar, Self

from anisoscope.base.clock import Clock
from anisoscope.base.errors import NotConnected, RigError
from anisoscope.rig.stages.motion import StageBase
from anisoscope.rig.transport import TCP, Transport

_log = logging.getLogger(__name__)


class PortStage(StageBase):
    """Base of drivers on a port; a driver takes the transport first, then its options by name.

    Several stages may share an open transport. Only `open` makes a stage that closes it.

    Attributes:
        PORT: how the port is set, as `Transport` takes it.
    """

    PORT: ClassVar[dict[str, Any]]
    _transport: Transport
    _owns_transport = False

    @property
    def _clock(self) -> Clock:
        """Clock of the port; a simulated device may have another one."""
        return self._transport.clock

    @classmethod
    def open(cls, port: str, **options: Any) -> Self:  # noqa: ANN401 - the driver's own options
        """Open a port and connect to the stage behind it.

        Args:
            port: what `Transport` opens.
            options: those of the class, as in the table ``[stage.options]`` of a rig file; and those of `PORT`.

        Raises:
            TypeError: an option that the driver does not know; the port is not touched.
            NotConnected: no such port, it is in use, or no answer.
            ProtocolError, RigError: as for the class.
        """
        settings = {name: options.pop(name, usual) for name, usual in cls.PORT.items()}
        signature(cls).bind(None, **options)
        connect: Callable[..., Self] = cls
        transport = Transport(port, **settings)
        try:
            if transport.abandoned:
                _log.warning("%s: the process that had it open has ended; the axis is stopped first", port)
                transport.write(cls.stop_command(**options))
            stage = connect(transport, **options)
            if transport.abandoned:
                stage.stop()
        except NotConnected as problem:
            transport.close()
            if port.startswith(TCP):
                raise NotConnected(f"{problem}, and close other programs connected to it") from problem
            raise
        except BaseException:
            transport.close()
            raise
        stage._owns_transport = True  # noqa: SLF001 - of our own class
        return stage

    @classmethod
    def stop_command(cls, **options: Any) -> bytes:  # noqa: ANN401 - the driver's own options
        """Bytes that stop the axis whatever it does, before anything is known of it; empty where there are none."""
        del options
        return b""

    def _end_session(self) -> None:
        """Notify the device of the end of the connection."""

    def _disconnect(self) -> None:
        if self._owns_transport:
            with contextlib.suppress(RigError):
                self._end_session()
            with contextlib.suppress(RigError):
                self._transport.close()
