"""Accounts of the console: names, roles and password hashes in a file that only its owner can read."""

import secrets
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, ValidationError

from anisoscope.base.atomic_write import write_text
from anisoscope.base.errors import ConfigError, RecordError, UsageError
from anisoscope.base.lock import locked
from anisoscope.base.regular_file import bounded_text

Role = Literal["operator", "engineer", "auditor", "administrator"]
ROLES: tuple[Role, ...] = get_args(Role)
LEAST_PASSWORD = 10


class Account(BaseModel):
    """One account; the password as an argon2id hash."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    role: Role
    password: str
    locked: bool = False


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    kind: Literal["anisoscope users"] = "anisoscope users"
    users: tuple[Account, ...] = ()


class Accounts:
    """Local accounts in a file that only its owner can read.

    Args:
        path: the file; it need not be there yet.

    Raises:
        ConfigError: it cannot be read, or is no file of accounts.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._known: tuple[tuple[int, ...], dict[str, Account]] = (), self.read()

    def read(self) -> dict[str, Account]:
        """All accounts by name, as the file has them now; errors as for the class."""
        try:
            text = bounded_text(self.path) if self.path.exists() else "{}"
            return {one.name: one for one in _File.model_validate_json(text).users}
        except (OSError, UnicodeError) as problem:
            why = problem.strerror if isinstance(problem, OSError) else "it is no UTF-8"
            raise ConfigError(f"{self.path}: cannot be read: {why}") from problem
        except ValidationError as problem:
            raise ConfigError(f"{self.path}: is no file of accounts of the console") from problem

    def now(self, name: str) -> Account | None:
        """An account as the file has it; read again where the file has changed. Errors as for the class."""
        try:
            state = self.path.stat()
        except OSError as problem:
            raise ConfigError(f"{self.path}: cannot be read: {problem.strerror}") from problem
        version = (state.st_mtime_ns, state.st_size, state.st_ino)
        if self._known[0] != version:
            self._known = version, self.read()
        return self._known[1].get(name)

    def put(self, name: str, role: Role, password: str, record: Callable[[], None] = lambda: None) -> None:
        """Add an account, or give it another role and password, and unlock it.

        Args:
            name: of the account.
            role: what it may do.
            password: as the user will type it.
            record: called when all is known to be valid, before anything changes; what it raises stops the change.

        Raises:
            UsageError: a name that is empty, long or has control characters; a short password; no such role.
            RecordError: the file cannot be written.
        """
        if not name.strip() or len(name) > 80 or not name.isprintable():
            raise UsageError("a name has 1 to 80 printable characters")
        if role not in ROLES:
            raise UsageError(f"there is no role '{role}'; choose one of {', '.join(ROLES)}")
        account = Account(name=name, role=role, password=_hash_of(password))
        self._change(name, lambda _: account, record)

    def change(
        self,
        name: str,
        record: Callable[[], None] = lambda: None,
        *,
        role: Role | None = None,
        password: str | None = None,
        locked: bool | None = None,
    ) -> None:
        """Give an account another role or password, or lock it; its sessions end.

        Args:
            name: of the account.
            record: as for `put`.
            role: what it may do; None leaves it.
            password: as the user will type it; None leaves it.
            locked: whether nobody may log in with it; None leaves it.

        Raises:
            UsageError: there is none of this name, or a short password.
            RecordError: the file cannot be written.
        """
        values = {
            "role": role,
            "password": None if password is None else _hash_of(password),
            "locked": locked,
        }
        update = {key: value for key, value in values.items() if value is not None}
        self._change(name, lambda found: self._there(name, found).model_copy(update=update), record)

    def remove(self, name: str, record: Callable[[], None] = lambda: None) -> None:
        """Remove an account.

        Args:
            name: of the account.
            record: called before anything changes; what it raises stops the change.

        Raises:
            UsageError: there is none of this name.
            RecordError: the file cannot be written.
        """

        def gone(found: Account | None) -> None:
            self._there(name, found)

        self._change(name, gone, record)

    def _there(self, name: str, account: Account | None) -> Account:
        if account is None:
            raise UsageError(f"{self.path} has no account '{name}'")
        return account

    def _change(
        self, name: str, change: Callable[[Account | None], Account | None], record: Callable[[], None]
    ) -> None:
        """Change an account as the file has it now, which others may change at the same time."""
        try:
            with locked(self.path.resolve().parent, waits=True):  # the file itself is replaced
                found = self.read()
                account = change(found.pop(name, None))
                record()
                users = (*found.values(), *(() if account is None else (account,)))
                self.path.touch(mode=0o600)
                write_text(self.path, _File(users=users).model_dump_json(indent=2))
                self.path.chmod(0o600)
        except OSError as problem:
            raise RecordError(f"{self.path}: cannot be written: {problem.strerror}") from problem

    def check(self, name: str, password: str) -> Account | None:
        """The account, if the password is right; an unknown name takes as long as a wrong password."""
        from argon2.exceptions import InvalidHashError, VerificationError

        found = self.read().get(name)
        try:
            _hasher().verify(_nobody() if found is None else found.password, password)
        except (VerificationError, InvalidHashError):
            return None
        return None if found is None or found.locked else found


def _hash_of(password: str) -> str:
    if not LEAST_PASSWORD <= len(password) <= 1000:
        raise UsageError(f"a password has at least {LEAST_PASSWORD} characters")
    return str(_hasher().hash(password))


def _hasher() -> Any:  # noqa: ANN401 - of the extra
    from argon2 import PasswordHasher

    return PasswordHasher()


_hash_of_none: list[str] = []


def _nobody() -> str:
    if not _hash_of_none:
        _hash_of_none.append(_hasher().hash(secrets.token_urlsafe()))
    return _hash_of_none[0]
