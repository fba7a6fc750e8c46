"""``anisoscope key``: keys that sign records and heads of the history, and the file of those that count."""

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tomli_w
from cyclopts import App, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.printable import check_printable
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.tables import print_lines

if TYPE_CHECKING:
    from anisoscope.base.signature import Signer, Trust

app = App(name="key", help="Make, show, trust, retire and revoke the keys that sign records.")
Address = Annotated[
    str | None,
    Parameter(help="The key: a file, or STORE:… of a package; by default the one that signs here."),
]
File = Annotated[Path, Parameter(help="Trust file (TOML).")]
Name = Annotated[str, Parameter(help="Key as `key show` prints it, ed25519:…")]


@app.command
def new(file: Annotated[Path, Parameter(help="File of the private key; a new one.")], /) -> int:
    """Make a private key (Ed25519) in a file that only you can read.

    Examples:
        anisoscope key new ~/.config/anisoscope/keys/rig-1-2027.pem
    """
    from anisoscope.base.signature import key_id, make_key

    made = make_key(file)
    print_lines(
        f'{file}: {key_id(made.public)}; name it in anisoscope.toml: signing_key = "{file.resolve()}"'
    )
    return 0


@app.command
def show(address: Address = None, /, *, json_: Json = False) -> int:
    """Show the public key that belongs to a private one: what others need in order to verify.

    Examples:
        anisoscope key show
    """
    import base64

    from anisoscope.base.signature import key_id

    public = _signer(address).public
    found = {"key": key_id(public), "public": base64.b64encode(public).decode()}
    if json_:
        print_json(found)
    else:
        for name, text in found.items():
            print_lines(f"{name}: {text}")
    return 0


@app.command
def trust(
    file: File,
    /,
    *,
    station: Annotated[str, Parameter(help="Station that signs with the key.")],
    public: Annotated[
        str | None,
        Parameter(help="Public key as `key show` prints it; by default that of the key that signs here."),
    ] = None,
) -> int:
    """Add a public key to a trust file. The earlier key of the station counts until now.

    Examples:
        anisoscope key trust keys.toml --station "rig 1"
        anisoscope key trust keys.toml --station "rig 2" --public MCowBQYDK2Vw…
    """
    import base64

    from anisoscope.base.signature import Trust, TrustedKey, key_id

    check_printable({"--station": station})
    text = public or base64.b64encode(_signer(None).public).decode()
    now = datetime.now(UTC).replace(microsecond=0)
    known = _read(file) if file.exists() else Trust()
    if any(one.public == text for one in known.keys):
        raise UsageError(f"{file}: has this key already")
    try:
        added = TrustedKey(station=station, public=text)
    except ValueError:
        raise UsageError(
            f"--public takes 44 letters and digits as `key show` prints them, not {text[:50]!r}"
        ) from None
    before = [
        one.model_copy(update={"until": now}) if one.station == station and one.until is None else one
        for one in known.keys
    ]
    _write(file, [*before, added])
    ended = sum(new != old for new, old in zip(before, known.keys, strict=True))
    until = (
        f"; its earlier key counts until {now:%Y-%m-%d %H:%M} UTC, and the new one is to sign from now on"
        if ended
        else ""
    )
    print_lines(f"{file}: {station} signs with {key_id(base64.b64decode(text))}{until}")
    return 0


@app.command
def revoke(
    file: File, key: Name, /, *, reason: Annotated[str, Parameter(help='Reason, such as "laptop stolen".')]
) -> int:
    """Let nothing count that a key has signed, whenever it was: a thief writes any date.

    Examples:
        anisoscope key revoke keys.toml ed25519:0123456789abcdef --reason "laptop stolen"
    """
    _change(file, key, {"revoked": reason})
    print_lines(f"{file}: {key} is revoked: {reason}")
    return 0


@app.command
def retire(file: File, key: Name, /) -> int:
    """Let a key count until now: what it signed before stays valid.

    Examples:
        anisoscope key retire keys.toml ed25519:0123456789abcdef
    """
    now = datetime.now(UTC).replace(microsecond=0)
    _change(file, key, {"until": now})
    print_lines(f"{file}: {key} counts until {now:%Y-%m-%d %H:%M} UTC")
    return 0


def _signer(address: str | None) -> "Signer":
    from anisoscope.base.signature import opened_key, signer_in_use

    if address is not None:
        return opened_key(address)
    found = signer_in_use()
    if found is None:
        raise UsageError(
            "no key signs here: name one, or signing_key in anisoscope.toml (`anisoscope init` makes both)"
        )
    return found


def _read(file: Path) -> "Trust":
    from anisoscope.base.signature import read_trust

    return read_trust(file)


def _change(file: Path, key: str, update: dict[str, Any]) -> None:
    import base64

    from anisoscope.base.signature import key_id

    known = _read(file)
    changed = [
        one.model_copy(update=update) if key_id(base64.b64decode(one.public)) == key else one
        for one in known.keys
    ]
    if changed == list(known.keys):
        raise UsageError(f"{file}: has no key {key[:40]!r}, or it is so already")
    _write(file, changed)


def _write(file: Path, keys: list[Any]) -> None:
    from anisoscope.base.atomic_write import write_text

    write_text(
        file, tomli_w.dumps({"schema": 1, "keys": [one.model_dump(exclude_none=True) for one in keys]})
    )
