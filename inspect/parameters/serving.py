"""What a station serves: the console in the browser, and the handshake of a controller (`anisoscope.line.modbus`)."""

from dataclasses import dataclass
from pathlib import Path

from anisoscope.base.errors import UsageError


@dataclass(frozen=True)
class ConsoleSettings:
    """Address of the console, who may use it, and as what it is known.

    Attributes:
        users: file of users; without it one user, at this computer only.
        openid: with --users: file of an OpenID provider that logs people in too.
        host: address to listen at.
        port: TCP port; 0 takes any free one.
        station: station where the rig stands; the fleet page shows what it does.
        name: name by which other computers call this one; may be repeated.
        certificate: TLS certificate (PEM).
        key: its key (PEM).
        idle: with --users: minutes without a person's request until a session may only look and stop.

    Raises:
        UsageError: a certificate without its key, a provider without users, or no minutes.
    """

    users: Path | None = None
    openid: Path | None = None
    host: str = "127.0.0.1"
    port: int = 8040
    station: str | None = None
    name: tuple[str, ...] = ()
    certificate: Path | None = None
    key: Path | None = None
    idle: float = 30.0

    def __post_init__(self) -> None:
        if (self.certificate is None) != (self.key is None):
            raise UsageError("--certificate and --key go together")
        if not self.idle > 0.0:
            raise UsageError(f"--idle takes minutes, more than 0, not {self.idle:g}")
        if self.openid is not None and self.users is None:
            raise UsageError(
                "--openid goes with --users: who administers needs a way in when the provider is away"
            )

    @property
    def tls(self) -> tuple[Path, Path] | None:
        """Certificate and key."""
        return None if self.certificate is None or self.key is None else (self.certificate, self.key)


@dataclass(frozen=True)
class Addresses:
    """Addresses of inputs and outputs, counted from 0.

    Attributes:
        trigger: discrete input of the trigger, counted from 0.
        number: first of two holding registers with the number of the job, high word first.
        outputs: first of five coils: ready, busy, pass, fail, invalid.
        device: unit identifier of the controller.
    """

    trigger: int = 0
    number: int = 0
    outputs: int = 0
    device: int = 1
