"""``anisoscope user``: accounts of the console."""

import getpass
import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import App, Parameter

from anisoscope.base.errors import UsageError
from anisoscope.base.language import message
from anisoscope.base.user_name import user_name
from anisoscope.cli.json_output import print_json
from anisoscope.cli.options import Json
from anisoscope.cli.rig.options import write_line

app = App(name="user", help="Accounts of the console: add, change, remove, list.")
File = Annotated[
    Path, Parameter(name="--users", help="File of users: their names, roles and password hashes.")
]
Name = Annotated[str, Parameter(help="Name of the account.")]
Why = Annotated[str, Parameter(name="--why", help="Reason, for the audit trail.")]
RoleName = Literal["operator", "engineer", "auditor", "administrator"]


@app.command
def add(
    name: Name,
    /,
    *,
    users: File,
    role: Annotated[RoleName, Parameter(name="--as", help="Role: what the account may do.")],
    why: Why = "",
) -> int:
    """Add an account, or give it another role and password; the password is read from the terminal or standard input.

    Examples:
        anisoscope user add anna --users users.json --as operator
    """
    from anisoscope.console.accounts import Accounts
    from anisoscope.console.trail import trail_of

    accounts = Accounts(users)
    if sys.stdin is not None and sys.stdin.isatty():
        password = getpass.getpass(f"{message('password')}: ")
        if getpass.getpass(f"{message('once more')}: ") != password:
            raise UsageError("the two passwords differ")
    else:
        password = "" if sys.stdin is None else sys.stdin.readline().rstrip("\r\n")
    trail, who = trail_of(users), user_name()
    accounts.put(name, role, password, lambda: trail.add(who, "account set", why, name=name, role=role))
    write_line(message("{name} may log in as {role}", name=name, role=role))
    return 0


@app.command
def remove(name: Name, /, *, users: File, why: Why = "") -> int:
    """Remove an account.

    Examples:
        anisoscope user remove anna --users users.json --why left
    """
    from anisoscope.console.accounts import Accounts
    from anisoscope.console.trail import trail_of

    accounts = Accounts(users)
    trail, who = trail_of(users), user_name()
    accounts.remove(name, lambda: trail.add(who, "account removed", why, name=name))
    return 0


@app.command
def lock(name: Name, /, *, users: File, why: Why = "") -> int:
    """Lock an account: logins with it are refused, and its sessions end.

    Examples:
        anisoscope user lock anna --users users.json --why "on leave"
    """
    return _set_lock(name, users, why, locked=True)


@app.command
def unlock(name: Name, /, *, users: File, why: Why = "") -> int:
    """Unlock an account.

    Examples:
        anisoscope user unlock anna --users users.json
    """
    return _set_lock(name, users, why, locked=False)


def _set_lock(name: str, users: Path, why: str, *, locked: bool) -> int:
    from anisoscope.console.accounts import Accounts
    from anisoscope.console.trail import trail_of

    trail, who = trail_of(users), user_name()
    record = lambda: trail.add(who, "account changed", why, name=name, locked=locked)  # noqa: E731
    Accounts(users).change(name, record, locked=locked)
    return 0


@app.command(name="list")
def list_(*, users: File, json_: Json = False) -> int:
    """List the accounts and their roles.

    Examples:
        anisoscope user list --users users.json
    """
    from anisoscope.console.accounts import Accounts
    from anisoscope.console.trail import trail_of

    accounts = Accounts(users).read().values()
    found = {one.name: one.role for one in accounts}
    shut = [one.name for one in accounts if one.locked]
    damaged = trail_of(users).damaged()
    if json_:
        print_json({"users": found, "locked": shut, "damaged_lines_of_the_trail": damaged})
    else:
        for name, role in found.items():
            print(f"{name:<24} {role}{', locked' * (name in shut)}")  # noqa: T201
    if damaged:
        write_line(f"the audit trail was changed: line {damaged[0]} is not as it was written")
    return 1 if damaged else 0
