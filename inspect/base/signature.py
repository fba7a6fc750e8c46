"""Signatures with Ed25519 (RFC 8032), in envelopes after DSSE 1.0: what is signed stands in them, byte by byte.

The private key of a station is a file, or in a store that a package brings through the entry points
``anisoscope.key_stores``. Which public keys count, and since and until when, a trust file says.
"""

import base64
import binascii
import hashlib
import json
import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, cast

from pydantic import Field

from anisoscope.base.errors import ConfigError, UsageError
from anisoscope.base.json_file import parsed_json
from anisoscope.base.plugins import load
from anisoscope.base.regular_file import bounded_bytes
from anisoscope.base.toml_file import Part, read_toml_model

VARIABLE = "ANISOSCOPE_SIGNING_KEY"
_STORES = "anisoscope.key_stores"
_TYPE = "application/vnd.anisoscope.{}+json"
_MOST = 1 << 20
CLOCK_BACK = timedelta(minutes=10)
"""A clock that is set right goes back by less."""

_chosen: str | None = None


class Signer(Protocol):
    """Private key, wherever it is: what an entry point of ``anisoscope.key_stores`` makes of the rest of an address."""

    @property
    def public(self) -> bytes:
        """The public key, 32 bytes."""
        ...

    def sign(self, data: bytes) -> bytes:
        """Ed25519 signature of the data, 64 bytes."""
        ...


class KeyFile:
    """Private key in a PEM file (PKCS #8, not encrypted) that only its owner may read; ``path`` is the file.

    Raises:
        ConfigError: it is missing, no such key, or others may read it.
    """

    def __init__(self, path: Path) -> None:
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey  # noqa: PLC0415 - slow
        from cryptography.hazmat.primitives.serialization import load_pem_private_key  # noqa: PLC0415

        try:
            if os.name == "posix" and stat.S_IMODE(path.stat().st_mode) & 0o077:
                raise ConfigError(f"{path}: others may read this private key: chmod 600 {path}")
            key = load_pem_private_key(bounded_bytes(path), None)
        except OSError as error:
            raise ConfigError(
                f"the signing key {path} cannot be read: {error.strerror}: `anisoscope key new {path}` makes one"
            ) from error
        except (ValueError, TypeError) as error:
            raise ConfigError(f"{path}: holds no private key in PEM without a password") from error
        if not isinstance(key, Ed25519PrivateKey):
            raise ConfigError(f"{path}: this is no Ed25519 key: `anisoscope key new FILE` makes one")
        self._key, self.path = key, path

    @property
    def public(self) -> bytes:
        """The public key, 32 bytes."""
        return self._key.public_key().public_bytes_raw()

    def sign(self, data: bytes) -> bytes:
        """Ed25519 signature of the data, 64 bytes."""
        return self._key.sign(data)


def make_key(path: Path) -> KeyFile:
    """Make a private key in a new file that only its owner may read.

    Raises:
        UsageError: the file exists.
        ConfigError: it cannot be written.
    """
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey  # noqa: PLC0415
    from cryptography.hazmat.primitives.serialization import (  # noqa: PLC0415
        Encoding,
        NoEncryption,
        PrivateFormat,
    )

    content = Ed25519PrivateKey.generate().private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
    except FileExistsError:
        raise UsageError(f"{path} exists already: a key is never replaced; name another file") from None
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}") from error
    return KeyFile(path)


def use_key(address: str) -> None:
    """Set the key that signs from now on, unless the environment names one."""
    global _chosen  # noqa: PLW0603 - one key a process, as one language
    _chosen = address


def signer_in_use() -> Signer | None:
    """The key that signs, or None where none is named.

    Raises:
        ConfigError: it cannot be used.
    """
    address = os.environ.get(VARIABLE, "").strip() or _chosen
    return None if address is None or address == "none" else opened_key(address)


def opened_key(address: str) -> Signer:
    """The private key at an address: a file, or ``STORE:…`` of an entry point.

    Raises:
        ConfigError: it cannot be used.
    """
    store, separator, rest = address.partition(":")
    if not separator or len(store) == 1 or Path(address).exists():  # a drive of Windows
        return KeyFile(Path(address))
    if store == "file":
        return KeyFile(Path(rest))
    return cast("Signer", cast("Any", load(_STORES, store, "store of signing keys", ConfigError))(rest))


def key_id(public: bytes) -> str:
    """Short name of a public key: ``ed25519:`` and 16 digits of its SHA-256."""
    return f"ed25519:{hashlib.sha256(public).hexdigest()[:16]}"


def signed(kind: str, statement: Mapping[str, Any], signer: Signer, now: datetime | None = None) -> str:
    """Envelope of a statement, JSON in one line; time and public key are added to what is signed.

    Args:
        kind: what the statement is about, such as "record"; a signature of one kind never passes for another.
        statement: what JSON takes.
        signer: the key.
        now: the time.
    """
    at = (now or datetime.now(UTC)).isoformat(timespec="milliseconds")
    whole = {**statement, "signed_at": at, "public": base64.b64encode(signer.public).decode()}
    payload = json.dumps(whole, ensure_ascii=False).encode()
    signature = signer.sign(_encoded(kind, payload))
    envelope = {
        "payloadType": _TYPE.format(kind),
        "payload": base64.b64encode(payload).decode(),
        "signatures": [{"keyid": key_id(signer.public), "sig": base64.b64encode(signature).decode()}],
    }
    return json.dumps(envelope)


def _encoded(kind: str, payload: bytes) -> bytes:
    """Signed bytes: DSSE's pre-authentication encoding."""
    name = _TYPE.format(kind).encode()
    return b"DSSEv1 %d %s %d %s" % (len(name), name, len(payload), payload)


@dataclass(frozen=True)
class Signed:
    """Content of an envelope, its signature checked with the key that it names.

    Attributes:
        content: the statement.
        public: the public key.
        signed_at: when it says that it was signed.
    """

    content: Mapping[str, Any]
    public: bytes
    signed_at: datetime

    @property
    def key(self) -> str:
        """Short name of the key."""
        return key_id(self.public)


def read_signed(kind: str, envelope: str | bytes) -> Signed:
    """Check the signature of an envelope; whether its key counts is another question (`Trust.distrust`).

    Raises:
        ValueError: it is no envelope of this kind, or its signature is wrong; the message is one line.
    """
    from cryptography.exceptions import InvalidSignature  # noqa: PLC0415
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey  # noqa: PLC0415

    try:
        if len(envelope) > _MOST:
            raise ValueError("too long")
        content = parsed_json(envelope)
        if content["payloadType"] != _TYPE.format(kind):
            raise ValueError(f"it is no signature of a {kind}")
        payload = base64.b64decode(content["payload"], validate=True)
        statement = parsed_json(payload)
        public = base64.b64decode(statement["public"], validate=True)
        signature = base64.b64decode(content["signatures"][0]["sig"], validate=True)
        signed_at = datetime.fromisoformat(statement["signed_at"])
        Ed25519PublicKey.from_public_bytes(public).verify(signature, _encoded(kind, payload))
    except InvalidSignature:
        raise ValueError("its signature is wrong") from None
    except (KeyError, IndexError, TypeError, AttributeError, binascii.Error) as error:
        raise ValueError(f"it is no signature: {type(error).__name__}") from None
    return Signed(statement, public, signed_at if signed_at.tzinfo else signed_at.replace(tzinfo=UTC))


def clock_set_back(before: Signed, after: Signed) -> str | None:
    """How far the clock of a key was set back between two statements that it signed, in words; None for ten minutes."""
    back = before.signed_at - after.signed_at
    if before.public != after.public or back <= CLOCK_BACK:
        return None
    return f"signed {back / timedelta(hours=1):.1f} h before the one before it: the clock of its station was set back"


class TrustedKey(Part):
    """A public key that counts.

    Attributes:
        station: whose it is.
        public: base64 of 32 bytes.
        since: signatures before this do not count.
        until: signatures after this do not count: the key was replaced.
        revoked: why nothing that it signed counts any more, such as "laptop stolen".
    """

    station: Annotated[str, Field(min_length=1)]
    public: Annotated[str, Field(pattern=r"^[A-Za-z0-9+/]{43}=$")]
    since: datetime | None = None
    until: datetime | None = None
    revoked: str | None = None


class Trust(Part):
    """Trust file (TOML): the public keys that count."""

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    keys: tuple[TrustedKey, ...] = ()

    def key(self, public: bytes) -> TrustedKey | None:
        """The entry of a public key, or None."""
        text = base64.b64encode(public).decode()
        return next((one for one in self.keys if one.public == text), None)

    def distrust(self, found: Signed) -> str | None:
        """Why a valid signature does not count, or None if it does.

        The station that the statement names has to be that of the key.
        """
        known = self.key(found.public)
        if known is None:
            return f"the key {found.key} is not among the trusted ones"
        name, station = f"the key {found.key} of {known.station}", found.content.get("station")
        if station is not None and station != known.station:
            return f"{name} signed for the station {station}"
        if known.revoked is not None:
            return f"{name} is revoked: {known.revoked}"
        if known.since is not None and found.signed_at < _utc(known.since):
            return f"{name} counts since {_utc(known.since):%Y-%m-%d %H:%M} UTC, and this was signed before"
        if known.until is not None and found.signed_at > _utc(known.until):
            return f"{name} counts until {_utc(known.until):%Y-%m-%d %H:%M} UTC, and this was signed later"
        return None

    def station(self, found: Signed) -> str:
        """Station and key of a signature."""
        known = self.key(found.public)
        return found.key if known is None else f"{known.station} ({found.key})"


def read_trust(path: Path) -> Trust:
    """Read a trust file.

    Raises:
        ConfigError: it cannot be read, or is none.
    """
    return read_toml_model(path, Trust, error=ConfigError)


def _utc(moment: datetime) -> datetime:
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
