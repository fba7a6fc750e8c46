"""Security of OPC UA by certificates (OPC 10000-2, -4, -6): the own certificate, and whom a server or client trusts.

Encryption, signatures and endpoints are asyncua's. Its server leaves three things open, which are closed here: it takes
a session without encryption whatever its endpoints say, it checks the certificate that a client names, not the one that
secures the connection, and it hands a session to any connection that guesses its number.
"""

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path

from asyncua import Client, Server, ua
from asyncua.common.utils import ServiceError
from asyncua.crypto import cert_gen
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.crypto.security_policies import SECURITY_POLICY_TYPE_MAP
from asyncua.crypto.uacrypto import CertProperties, der_from_x509, pem_from_key, x509_from_der
from asyncua.crypto.validator import CertificateValidator
from asyncua.crypto.validator import CertificateValidatorOptions as Checks
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.ua.uaerrors import UaError
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey
from cryptography.hazmat.primitives.hashes import SHA1
from cryptography.hazmat.primitives.serialization import load_der_private_key, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from anisoscope.base.atomic_write import write_bytes
from anisoscope.base.errors import AnisoscopeError, RecordError, UsageError
from anisoscope.base.regular_file import bounded_bytes

ENCRYPTING = (
    ua.SecurityPolicyType.Aes256Sha256RsaPss_SignAndEncrypt,
    ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt,
)
"""What a client takes, the first that the server offers."""
POLICIES = (
    *ENCRYPTING,
    ua.SecurityPolicyType.Aes256Sha256RsaPss_Sign,
    ua.SecurityPolicyType.Basic256Sha256_Sign,
)
"""What a server offers."""
REJECTED = "rejected"
MOST_REJECTED = 50
ENDS_SOON = timedelta(days=30)
DAYS, MOST_DAYS = 3 * 365, 36_500
SERVER, CLIENT = Checks.PEER_SERVER, Checks.PEER_CLIENT
_LEAST_BITS, _MOST_BITS = 2048, 4096
_ANONYMOUS = User()
_BROKEN = "http://www.w3.org/2001/04/xmlenc#rsa-1_5"
"""A way to encrypt passwords whose errors give them away (Bleichenbacher 1998)."""
_PEM = b"-----BEGIN "

Say = Callable[[str], None]
LogIn = Callable[[str, str, str], bool]
"""Whether a person may order jobs, by name, password and address."""


def _certificate_of(path: Path) -> x509.Certificate:
    """The certificate in a file, PEM or DER; a ValueError if it is none."""
    data = bounded_bytes(path)
    return x509.load_pem_x509_certificate(data) if _PEM in data else x509.load_der_x509_certificate(data)


def uris_of(certificate: x509.Certificate) -> list[str]:
    """Application URIs that a certificate is for; none where it does not say."""
    try:
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except (x509.ExtensionNotFound, ValueError):
        return []
    return names.get_values_for_type(x509.UniformResourceIdentifier)


def name_of(certificate: x509.Certificate) -> str:
    """The name of a certificate's owner and its thumbprint, as other programs of OPC UA show them."""
    try:
        found = [str(one.value) for one in certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)]
    except ValueError:
        found = []
    name = re.sub(r"[^\w.:-]+", " ", "".join(found[:1]))[:60].strip() or "nameless"
    return f"{name} [{certificate.fingerprint(SHA1()).hex().upper()}]"  # noqa: S303 - a name, as the standard has it


@dataclass(frozen=True)
class Identity:
    """The own certificate and its key."""

    certificate: x509.Certificate
    key: RSAPrivateKey
    uri: str


def read_identity(certificate: Path, key: Path, say: Say) -> Identity:
    """The own certificate and key, PEM or DER.

    Args:
        certificate: file of the certificate.
        key: file of the private key, RSA, without a password.
        say: takes a line for the operator about what ends soon or others can read.

    Raises:
        UsageError: a file cannot be read, the key is another certificate's, or no client would accept the certificate.
    """
    try:
        own = _certificate_of(certificate)
    except (OSError, ValueError) as problem:
        why = problem.strerror if isinstance(problem, OSError) else "it is no certificate (PEM or DER)"
        raise UsageError(f"--certificate {certificate}: {why}") from None
    try:
        data = bounded_bytes(key)
        secret = (load_pem_private_key if _PEM in data else load_der_private_key)(data, None)
    except (OSError, ValueError, TypeError) as problem:
        why = (
            problem.strerror
            if isinstance(problem, OSError)
            else "it is no key without a password (PEM or DER)"
        )
        raise UsageError(f"--key {key}: {why}") from None
    if not isinstance(secret, RSAPrivateKey) or not _LEAST_BITS <= secret.key_size <= _MOST_BITS:
        raise UsageError(f"--key {key}: OPC UA takes RSA keys of {_LEAST_BITS} to {_MOST_BITS} bits")
    if secret.public_key() != own.public_key():
        raise UsageError(f"--key {key}: it is not the key of --certificate {certificate}")
    uris = uris_of(own)
    if not uris:
        raise UsageError(
            f"--certificate {certificate}: it names no application (a URI in subjectAltName); "
            "`anisoscope line certificate` makes one that does"
        )
    now, first, last = datetime.now(UTC), own.not_valid_before_utc, own.not_valid_after_utc
    if not first <= now <= last:
        raise UsageError(
            f"--certificate {certificate}: it is valid from {first:%Y-%m-%d} to {last:%Y-%m-%d} only"
        )
    if last - now < ENDS_SOON:
        say(f"{certificate}: it ends on {last:%Y-%m-%d}, and nothing can connect after that")
    if os.name == "posix" and key.stat().st_mode & 0o077:
        say(f"{key}: others can read this key: chmod 600 {key}")
    return Identity(own, secret, uris[0])


def _general_name(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def make_identity(folder: Path, uri: str, names: Sequence[str], days: int = DAYS) -> tuple[Path, Path]:
    """Make a self-signed certificate of an application (OPC 10000-6, 6.2.2) and its key, for server and client alike.

    Args:
        folder: receives ``certificate.der`` and ``key.pem``.
        uri: of the application.
        names: of the computer, and its addresses.
        days: how long it is valid.

    Returns:
        The files of certificate and key.

    Raises:
        UsageError: there are such files, they cannot be written, or a name or number of days that cannot be used.
    """
    place = folder / "certificate.der", folder / "key.pem"
    taken = next((one for one in place if one.exists()), None)
    if taken is not None:
        raise UsageError(f"{taken} exists: give another --out, or remove certificate and key")
    if not 1 <= days <= MOST_DAYS:
        raise UsageError(f"--days is from 1 to {MOST_DAYS}, not {days}")
    try:
        known = [x509.UniformResourceIdentifier(uri), *map(_general_name, dict.fromkeys(names))]
    except ValueError:
        raise UsageError(
            "--uri and --name take letters of ASCII only: in certificates names have no others"
        ) from None
    key = cert_gen.generate_private_key()
    uses = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    made = cert_gen.generate_self_signed_app_certificate(
        key, uri[:64], {"organizationName": "anisoscope"}, known, uses, days
    )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with os.fdopen(os.open(place[1], os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as stream:
            stream.write(pem_from_key(key))
        write_bytes(place[0], der_from_x509(made))
    except (OSError, RecordError) as problem:
        raise UsageError(f"--out {folder}: {getattr(problem, 'strerror', None) or problem}") from None
    return place


class Peers:
    """The programs that are trusted: those whose certificates are in a folder, as it is at the moment.

    Args:
        folder: of certificates, PEM or DER; its folder ``rejected`` receives those of others.
        say: takes a line for the operator; the same line is not given twice in a row.

    Raises:
        UsageError: there is no such folder.
    """

    def __init__(self, folder: Path, say: Say) -> None:
        if not folder.is_dir():
            raise UsageError(f"--peers {folder}: there is no such folder")
        self.folder, self._say, self._said = folder, say, ""
        if not self._trusted():
            say(f"--peers {folder}: trusts nothing yet; what is refused waits in {folder / REJECTED}")

    async def refusal(
        self, given: bytes | None, application: ua.ApplicationDescription, role: Checks
    ) -> tuple[int, str] | None:
        """Why a program is refused: the status code, and a line; None where it is trusted.

        Args:
            given: its certificate, DER.
            application: what it says of itself.
            role: what it is, `SERVER` or `CLIENT`.
        """
        try:
            found = x509_from_der(given)
            name = "" if found is None else name_of(found)
        except ValueError:
            found, name = None, ""
        if found is None:
            return ua.StatusCodes.BadCertificateInvalid, "a program without a certificate that can be read"
        if der_from_x509(found) not in self._trusted():
            return ua.StatusCodes.BadCertificateUntrusted, f"{name}: {self._reject(found, name)}"
        said = str(application.ApplicationUri)[:80]
        uris = ", ".join(uris_of(found)) or "no application"
        why = {
            ua.StatusCodes.BadCertificateTimeInvalid: "its certificate is valid from "
            f"{found.not_valid_before_utc:%Y-%m-%d} to {found.not_valid_after_utc:%Y-%m-%d} only",
            ua.StatusCodes.BadCertificateUriInvalid: f"it calls itself {said!r}, and its certificate is for {uris}",
            ua.StatusCodes.BadCertificateUseNotAllowed: "its certificate is not for a "
            f"{'server' if role is SERVER else 'client'}, or not for signing and encrypting",
        }
        try:
            await CertificateValidator(Checks.EXT_VALIDATION | role).validate(found, application)
        except ServiceError as refused:
            missing = "its certificate lacks subjectAltName, keyUsage or extendedKeyUsage"
            return refused.code, f"{name}: {why.get(refused.code, missing)}"
        except ValueError:
            return ua.StatusCodes.BadCertificateInvalid, f"{name}: its certificate cannot be read"
        return None

    def say(self, text: str) -> None:
        """Say a line, unless it was the last one."""
        if text != self._said:
            self._said = text
            self._say(text)

    def _trusted(self) -> set[bytes]:
        found: set[bytes] = set()
        try:
            files = [one for one in sorted(self.folder.iterdir()) if one.is_file() and one.name[0] != "."]
        except OSError as problem:
            self.say(f"--peers {self.folder}: {problem.strerror}; nothing is trusted")
            return found
        for path in files:
            try:
                found.add(der_from_x509(_certificate_of(path)))
            except (OSError, ValueError):
                self.say(f"{path}: it is no certificate (PEM or DER) and is passed over")
        return found

    def _reject(self, certificate: x509.Certificate, name: str) -> str:
        """Keep a certificate that is not trusted, with the last ones of others; say where."""
        folder = self.folder / REJECTED
        place = folder / f"{name.replace(':', '_')}.der"
        try:
            folder.mkdir(exist_ok=True)
            write_bytes(place, der_from_x509(certificate))
            by_age = sorted(folder.glob("*.der"), key=lambda one: one.stat().st_mtime_ns)
            for old in by_age[:-MOST_REJECTED]:
                old.unlink(missing_ok=True)
        except (OSError, RecordError) as problem:
            return f"its certificate is not trusted, and cannot be kept: {problem}"
        return f"its certificate is not trusted; to trust it, move {place} to {self.folder}"


@dataclass(frozen=True)
class Security:
    """The own certificate, who is trusted, and whether a name and password may order jobs; None asks for neither."""

    own: Identity
    peers: Peers
    log_in: LogIn | None = None

    async def secure(self, client: Client) -> None:
        """Let a client, before it connects, sign and encrypt with a server that is trusted.

        Raises:
            UaError: the server offers no encryption that is taken here, or is not trusted.
        """
        offered = {
            (one.SecurityPolicyUri, one.SecurityMode): one
            for one in await client.connect_and_get_server_endpoints()
        }
        ways = (SECURITY_POLICY_TYPE_MAP[one] for one in ENCRYPTING)
        policy, mode = next(
            ((policy, mode) for policy, mode, _ in ways if (policy.URI, mode) in offered), (None, None)
        )
        if policy is None:
            raise UaError("it offers neither Basic256Sha256 nor Aes256Sha256RsaPss with encryption")
        found = offered[policy.URI, mode]
        refused = await self.peers.refusal(found.ServerCertificate, found.Server, SERVER)
        if refused is not None:
            raise UaError(refused[1])
        client.application_uri = self.own.uri
        own = CertProperties(der_from_x509(self.own.certificate), "der")
        key = CertProperties(pem_from_key(self.own.key), "pem")
        server = CertProperties(der_from_x509(x509_from_der(found.ServerCertificate)), "der")
        await client.set_security(policy, own, key, None, server, mode)

    def server(self) -> Server:
        """A server, not yet initialised, that takes sessions of trusted clients only, signed or encrypted too."""
        server = _NamedServer(_GuardedServer(self.peers, self.log_in))
        server.uri = self.own.uri
        server.iserver.certificate, server.iserver.private_key = self.own.certificate, self.own.key
        server.set_security_policy(list(POLICIES))
        server.set_identity_tokens(
            [ua.AnonymousIdentityToken if self.log_in is None else ua.UserNameIdentityToken]
        )
        return server


def read_security(
    certificate: Path | None, key: Path | None, peers: Path | None, say: Say
) -> Security | None:
    """Security by the options ``--certificate``, ``--key`` and ``--peers``; None without any of them.

    Raises:
        UsageError: one of them is missing, or as `read_identity` and `Peers`.
    """
    if certificate is None and key is None and peers is None:
        return None
    if certificate is None or key is None or peers is None:
        raise UsageError("--certificate, --key and --peers go together: who this is, and who is trusted")
    return Security(read_identity(certificate, key, say), Peers(peers, say))


class _NamedServer(Server):  # type: ignore[misc]
    """A server that calls itself as its certificate does."""

    uri = ""

    async def init(self, shelf_file: Path | None = None) -> None:
        """Set the address space up."""
        await super().init(shelf_file)
        await self.set_application_uri(self.uri)


class _GuardedServer(InternalServer):  # type: ignore[misc]
    """Internal server of asyncua, with sessions that are bound to the certificate of their connection."""

    def __init__(self, peers: Peers, log_in: LogIn | None) -> None:
        super().__init__(user_manager=self)
        self._peers, self._log_in, self.asking = peers, log_in, ""

    def get_user(
        self,
        _server: object,
        username: str | None = None,
        password: str | None = None,
        certificate: object = None,  # noqa: ARG002 - as asyncua calls it
    ) -> User | None:
        """The user of a session, as asyncua asks its manager of users; None is refused."""
        if self._log_in is None or self._log_in(username or "", password or "", self.asking):
            return User(UserRole.User, username)
        return None

    def create_session(
        self, name: str, user: User = _ANONYMOUS, external: bool = False
    ) -> InternalSession:  # as asyncua has it
        return _GuardedSession(self._peers, self, name, user, external=external)

    def lookup_external_session(self, auth_token: ua.NodeId) -> None:
        """No session goes on over another connection: its client makes a new one."""

    def register_server(self, server: object, conf: object = None) -> None:  # noqa: ARG002 - as asyncua calls it
        """Refuse to list other servers: every program may ask for that, without security."""
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)


class _GuardedSession(InternalSession):  # type: ignore[misc]
    """A session of a trusted client, over the connection that its certificate secures."""

    def __init__(
        self,
        peers: Peers,
        server: "_GuardedServer",
        name: str,
        user: User,
        *,
        external: bool,
    ) -> None:
        super().__init__(
            server, server.aspace, server.subscription_service, name, user=user, external=external
        )
        self._peers, self._server, self._admitted = peers, server, b""
        self._from = name[0]  # an address and a port, whatever asyncua calls it

    async def create_session(
        self, params: ua.CreateSessionParameters, sockname: tuple[str, int] | None = None
    ) -> ua.CreateSessionResult:
        """Answer a client that wants a session, if its certificate is trusted."""
        given = params.ClientCertificate
        if not given:
            raise self._refused(ua.StatusCodes.BadSecurityModeInsufficient, "it neither signs nor encrypts")
        refused = await self._peers.refusal(given, params.ClientDescription, CLIENT)
        if refused is not None:
            raise self._refused(*refused)
        result = await super().create_session(params, sockname)
        self._admitted = der_from_x509(x509_from_der(given))
        return result

    def activate_session(
        self, params: ua.ActivateSessionParameters, peer_certificate: bytes | None
    ) -> ua.ActivateSessionResult:
        """Begin the session, if its connection is secured with the certificate that was trusted."""
        if not self._admitted or peer_certificate != self._admitted:
            code = ua.StatusCodes.BadSecurityChecksFailed
            raise self._refused(code, "it names another certificate than its connection has")
        token = params.UserIdentityToken
        if getattr(token, "EncryptionAlgorithm", None) == _BROKEN:
            raise self._refused(
                ua.StatusCodes.BadIdentityTokenInvalid, "its password is encrypted by RSA PKCS 1.5"
            )
        self._server.asking = self._from
        try:
            return super().activate_session(params, peer_certificate)
        except ServiceError as refused:
            if refused.code == ua.StatusCodes.BadUserAccessDenied:
                name = str(getattr(token, "UserName", ""))[:80]
                raise self._refused(
                    refused.code, f"{name!r} gave a wrong password, or may not operate"
                ) from None
            raise
        except AnisoscopeError as problem:
            raise self._refused(ua.StatusCodes.BadInternalError, " ".join(str(problem).split())) from None

    def _refused(self, code: int, why: str) -> ServiceError:
        self._peers.say(f"refused {self._from}: {why}")
        return ServiceError(code)
