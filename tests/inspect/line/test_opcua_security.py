"""Security of OPC UA: the server of a rig and the reader of a press, asyncua at the other end, and attacks."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import pytest
from asyncua import Client, ua
from asyncua.crypto import security_policies
from asyncua.crypto.uacrypto import CertProperties
from asyncua.ua.uaerrors import UaError
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID

from anisoscope.base.errors import UsageError
from anisoscope.console.access import log_in_of
from anisoscope.console.accounts import Accounts
from anisoscope.console.trail import trail_of
from anisoscope.inspection.work import WorkerHere
from anisoscope.line.jobs import Jobs
from anisoscope.line.opcua import VisionServer
from anisoscope.line.opcua_security import (
    CLIENT,
    MOST_REJECTED,
    Peers,
    make_identity,
    name_of,
    read_identity,
    read_security,
)
from anisoscope.line.press import PressReader
from anisoscope.sim.press_server import FIELDS, PressServer


def module_here(name):
    """A module of this folder."""
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    found = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(found)
    return found


CERTIFICATES, CONTROLLER = module_here("certificates"), module_here("controller")
certificate, der, write_pair = CERTIFICATES.certificate, CERTIFICATES.der, CERTIFICATES.write_pair
DAY, NOW = CERTIFICATES.DAY, CERTIFICATES.NOW
URI = "urn:plc:controller"
POLICY = {
    "Basic256Sha256": security_policies.SecurityPolicyBasic256Sha256,
    "Aes256_Sha256_RsaPss": security_policies.SecurityPolicyAes256Sha256RsaPss,
}
MODE = ua.MessageSecurityMode
CYCLE = dict.fromkeys(FIELDS, 30.5)


@pytest.fixture(scope="module")
def loop():
    made = CONTROLLER.Loop()
    yield made
    made.close()


@pytest.fixture(scope="module")
def keys():
    """Of the controller, and of somebody else."""
    return CERTIFICATES.new_key(), CERTIFICATES.new_key()


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    return make_identity(tmp_path_factory.mktemp("own"), "urn:rig-1:anisoscope", ["rig-1", "127.0.0.1"])


@pytest.fixture(scope="module")
def trusted(keys):
    return certificate(keys[0], URI, "plc")


class Served:
    """The server of a rig with its security, the folder of its peers, and what it said."""

    def __init__(self, place, recipes, own, folder):
        self.peers, self.lines = folder, []
        self.security = read_security(*own, folder, self.lines.append)
        jobs = Jobs(place, recipes, WorkerHere(place), dict, "S1")
        self.server = VisionServer(jobs, recipes, port=CONTROLLER.free_port(), security=self.security)
        self.address = self.server.address


@pytest.fixture(scope="module")
def served(place_of, own, trusted, loop, tmp_path_factory):
    folder = tmp_path_factory.mktemp("peers")
    (folder / "plc.der").write_bytes(der(trusted))
    made = Served(*place_of("secured"), own, folder)
    loop(made.server.__aenter__())
    yield made
    loop(made.server.__aexit__())


async def client_of(address, found, key, own, *, policy="Basic256Sha256", mode=MODE.SignAndEncrypt, uri=URI):
    """A client of asyncua that is secured, not yet connected."""
    client = Client(address, timeout=60)
    client.application_uri = uri
    secret = CERTIFICATES.Encoding.PEM, CERTIFICATES.PrivateFormat.PKCS8, CERTIFICATES.NoEncryption()
    await client.set_security(
        POLICY[policy],
        CertProperties(der(found), "der"),
        CertProperties(key.private_bytes(*secret), "pem"),
        None,
        CertProperties(own[0].read_bytes(), "der"),
        mode,
    )
    return client


async def states(client):
    """The state of the machine, read over a session."""
    async with client:
        namespace = await client.get_namespace_index("urn:anisoscope:line")
        system = client.get_node(ua.NodeId("VisionSystem", namespace))
        vision = await client.get_namespace_index(CONTROLLER.NAMESPACE)
        state = await system.get_child([f"{vision}:VisionStateMachine", "0:CurrentState"])
        return (await state.read_value()).Text


@pytest.mark.parametrize("policy", POLICY)
@pytest.mark.parametrize("mode", [MODE.Sign, MODE.SignAndEncrypt])
def test_a_trusted_client_signs_and_encrypts(served, trusted, keys, own, loop, policy, mode):
    async def read():
        return await states(await client_of(served.address, trusted, keys[0], own, policy=policy, mode=mode))

    assert loop(read()) == "Preoperational"


def test_no_endpoint_is_without_security_and_all_bear_the_uri_of_the_certificate(served, own, loop):
    found = loop(Client(served.address).connect_and_get_server_endpoints())
    ways = {(one.SecurityPolicyUri.rpartition("#")[2], one.SecurityMode) for one in found}
    assert ways == {(policy, mode) for policy in POLICY for mode in (MODE.Sign, MODE.SignAndEncrypt)}
    assert {one.Server.ApplicationUri for one in found} == {"urn:rig-1:anisoscope"}
    assert {one.ServerCertificate for one in found} == {own[0].read_bytes()}
    assert {token.TokenType for one in found for token in one.UserIdentityTokens} == {
        ua.UserTokenType.Anonymous
    }


async def plain_channel(address):
    """A client without security whose channel is open, as is needed to ask for endpoints."""
    client = Client(address, timeout=60)
    await client.connect_socket()
    await client.send_hello()
    await client.open_secure_channel()
    return client


def refused(loop, attempt):
    """The status that a client gets."""
    with pytest.raises(UaError) as found:
        loop(attempt)
    return found.value.code


def test_a_session_without_security_is_refused(served, loop):
    code = refused(loop, states(Client(served.address, timeout=60)))
    assert code == ua.StatusCodes.BadSecurityModeInsufficient
    assert served.lines[-1] == "refused 127.0.0.1: it neither signs nor encrypts"


def test_the_certificate_of_a_trusted_client_alone_opens_nothing(served, trusted, loop):
    async def attack():
        client = await plain_channel(served.address)
        try:
            asked = ua.CreateSessionParameters(
                ClientCertificate=der(trusted), ClientNonce=bytes(32), RequestedSessionTimeout=60_000.0
            )
            asked.ClientDescription.ApplicationUri = URI
            asked.ClientDescription.ApplicationType = ua.ApplicationType.Client
            await client.uaclient.create_session(asked)
            await client.uaclient.activate_session(
                ua.ActivateSessionParameters(
                    UserIdentityToken=ua.AnonymousIdentityToken(PolicyId="anonymous")
                )
            )
        finally:
            client.disconnect_socket()

    assert refused(loop, attack()) == ua.StatusCodes.BadSecurityChecksFailed
    assert served.lines[-1] == "refused 127.0.0.1: it names another certificate than its connection has"


def test_a_session_is_not_taken_over_by_another_connection(served, trusted, keys, own, loop):
    async def attack():
        async with await client_of(served.address, trusted, keys[0], own) as victim:
            thief = await plain_channel(served.address)
            try:
                thief.uaclient.session.restore_authentication_token(
                    victim.uaclient.session.authentication_token
                )
                with pytest.raises(UaError) as first:
                    await thief.uaclient.activate_session(
                        ua.ActivateSessionParameters(UserIdentityToken=ua.AnonymousIdentityToken())
                    )
                with pytest.raises(UaError) as second:
                    await thief.nodes.server_state.read_value()
            finally:
                thief.disconnect_socket()
            return first.value.code, second.value.code

    codes = ua.StatusCodes
    assert loop(attack()) == (codes.BadSessionIdInvalid, codes.BadUserAccessDenied)


def test_an_unknown_client_is_refused_by_name_until_its_certificate_is_moved(served, keys, own, loop):
    other = certificate(keys[1], URI, "laptop of ../../Müller")
    connect = lambda: client_of(served.address, other, keys[1], own)  # noqa: E731
    assert refused(loop, states(loop(connect()))) == ua.StatusCodes.BadCertificateUntrusted
    (kept,) = (served.peers / "rejected").iterdir()
    assert kept.read_bytes() == der(other)
    assert kept.name == f"{name_of(other)}.der"
    assert kept.name.startswith("laptop of .. .. Müller [")
    assert f"move {kept} to {served.peers}" in served.lines[-1]
    moved = kept.rename(served.peers / kept.name)
    assert loop(states(loop(connect()))) == "Preoperational"
    moved.unlink()
    assert refused(loop, states(loop(connect()))) == ua.StatusCodes.BadCertificateUntrusted


@pytest.mark.parametrize(
    ("changes", "uri", "code", "words"),
    [
        ({"last": NOW - DAY / 2}, URI, "BadCertificateTimeInvalid", "valid from"),
        ({"first": NOW + DAY}, URI, "BadCertificateTimeInvalid", "valid from"),
        ({}, "urn:another", "BadCertificateUriInvalid", "calls itself 'urn:another'"),
        ({"use": ExtendedKeyUsageOID.SERVER_AUTH}, URI, "BadCertificateUseNotAllowed", "not for a client"),
        ({"uri": ""}, URI, "BadCertificateInvalid", "lacks subjectAltName"),
    ],
)
def test_trusted_certificates_that_do_not_hold_are_refused(
    served, keys, own, loop, changes, uri, code, words
):
    found = certificate(keys[0], **{"uri": URI, "name": "plc", **changes})
    place = served.peers / "other.der"
    place.write_bytes(der(found))
    try:
        client = loop(client_of(served.address, found, keys[0], own, uri=uri))
        assert refused(loop, states(client)) == getattr(ua.StatusCodes, code)
    finally:
        place.unlink()
    assert served.lines[-1].startswith(f"refused 127.0.0.1: {name_of(found)}: ")
    assert words in served.lines[-1]


def test_a_password_is_not_taken_for_one_that_was_checked(served, trusted, keys, own, loop):
    async def log_in():
        client = await client_of(served.address, trusted, keys[0], own)
        await client.connect_socket()
        try:
            await client.send_hello()
            await client.open_secure_channel()
            made = await client.create_session()
            sign = client.security_policy.asymmetric_cryptography.signature
            asked = ua.ActivateSessionParameters()
            asked.ClientSignature.Signature = sign(own[0].read_bytes() + made.ServerNonce)
            asked.UserIdentityToken = ua.UserNameIdentityToken(UserName="admin", Password=b"admin")
            await client.uaclient.activate_session(asked)
        finally:
            client.disconnect_socket()

    assert refused(loop, log_in()) == ua.StatusCodes.BadIdentityTokenRejected


def test_the_server_is_no_directory_of_other_servers(served, loop):
    async def register():
        client = await plain_channel(served.address)
        try:
            server = ua.RegisteredServer(ServerUri="urn:x", ServerNames=[ua.LocalizedText("x")])
            await client.uaclient.register_server(server)
        finally:
            client.disconnect_socket()

    assert refused(loop, register()) == ua.StatusCodes.BadServiceUnsupported


def test_users_log_in_by_the_accounts_of_the_console(trusted, keys, own, loop, tmp_path):
    users, lines = tmp_path / "users.json", []
    with pytest.raises(UsageError, match="has no accounts"):
        log_in_of(users)
    accounts = Accounts(users)
    for name, role in (("anna", "operator"), ("ada", "auditor")):
        accounts.put(name, role, "correct horse")
    (tmp_path / "peers").mkdir()
    (tmp_path / "peers" / "plc.der").write_bytes(der(trusted))
    security = replace(read_security(*own, tmp_path / "peers", lines.append), log_in=log_in_of(users))
    server = security.server()

    async def begin():
        await server.init()
        server.set_endpoint(f"opc.tcp://127.0.0.1:{CONTROLLER.free_port()}/users")
        await server.start()

    async def read(name, password, mode):
        client = await client_of(server.endpoint.geturl(), trusted, keys[0], own, mode=mode)
        if name:
            client.set_user(name)
            client.set_password(password)
        async with client:
            return await client.nodes.server_state.read_value()

    loop(begin())
    try:
        for mode in (MODE.Sign, MODE.SignAndEncrypt):
            assert loop(read("anna", "correct horse", mode)) == ua.ServerState.Running
        for name, password in (("anna", "wrong horse"), ("ada", "correct horse")):
            assert refused(loop, read(name, password, MODE.Sign)) == ua.StatusCodes.BadUserAccessDenied
            assert lines[-1] == f"refused 127.0.0.1: {name!r} gave a wrong password, or may not operate"
        with pytest.raises(UaError):
            loop(read("", "", MODE.SignAndEncrypt))
    finally:
        loop(server.stop())
    trail = [(one["who"], one["what"]) for one in trail_of(users).lines()]
    assert trail == [("anna", "login"), ("anna", "login"), ("anna", "login refused"), ("ada", "login")]


def test_refused_certificates_are_kept_up_to_a_number_and_the_same_line_is_said_once(keys, tmp_path, loop):
    lines, client = [], ua.ApplicationDescription(ApplicationUri=URI)
    peers = Peers(tmp_path, lines.append)
    assert lines == [
        f"--peers {tmp_path}: trusts nothing yet; what is refused waits in {tmp_path / 'rejected'}"
    ]
    found = [der(certificate(keys[0], URI, f"plc {number}")) for number in range(MOST_REJECTED + 2)]
    for one in (*found, found[-1]):
        code, line = loop(peers.refusal(one, client, CLIENT))
        assert code == ua.StatusCodes.BadCertificateUntrusted
        peers.say(line)
    assert len(lines) == 1 + len(found)
    kept = [path.read_bytes() for path in (tmp_path / "rejected").iterdir()]
    assert sorted(kept) == sorted(found[-MOST_REJECTED:])


@pytest.mark.parametrize("given", [b"", None, b"no certificate"])
def test_what_is_no_certificate_is_refused(given, tmp_path, loop):
    peers = Peers(tmp_path, list)
    code, _ = loop(peers.refusal(given, ua.ApplicationDescription(), CLIENT))
    assert code == ua.StatusCodes.BadCertificateInvalid


def test_a_damaged_file_among_the_trusted_ones_and_a_folder_that_is_gone_are_named(trusted, tmp_path, loop):
    folder, lines = tmp_path / "peers", []
    folder.mkdir()
    (folder / "plc.crt").write_bytes(trusted.public_bytes(CERTIFICATES.Encoding.PEM))
    peers = Peers(folder, lines.append)
    (folder / "notes.txt").write_text("the controller of cell 3")
    client = ua.ApplicationDescription(ApplicationUri=URI, ApplicationType=ua.ApplicationType.Client)
    assert loop(peers.refusal(der(trusted), client, CLIENT)) is None
    assert lines == [f"{folder / 'notes.txt'}: it is no certificate (PEM or DER) and is passed over"]
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()
    assert loop(peers.refusal(der(trusted), client, CLIENT))[0] == ua.StatusCodes.BadCertificateUntrusted
    assert lines[1] == f"--peers {folder}: No such file or directory; nothing is trusted"


# The own certificate.


def test_the_certificate_that_is_made_is_one_of_an_application(own, tmp_path):
    lines = []
    found = read_identity(*own, lines.append)
    assert (found.uri, lines) == ("urn:rig-1:anisoscope", [])
    extension = found.certificate.extensions.get_extension_for_class
    names = extension(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["rig-1"]
    assert [str(one) for one in names.get_values_for_type(x509.IPAddress)] == ["127.0.0.1"]
    uses = extension(x509.KeyUsage).value
    assert all(getattr(uses, one) for one in CERTIFICATES.KEY_USES)
    assert {*extension(x509.ExtendedKeyUsage).value} == {
        ExtendedKeyUsageOID.SERVER_AUTH,
        ExtendedKeyUsageOID.CLIENT_AUTH,
    }
    days = (found.certificate.not_valid_after_utc - found.certificate.not_valid_before_utc).days
    assert (days, found.key.key_size, own[1].stat().st_mode & 0o777) == (1095, 2048, 0o600)
    with pytest.raises(UsageError, match="exists: give another --out"):
        make_identity(own[0].parent, "urn:x", ["x"])
    for changes, words in {
        ("urn:x", "größe", 9): "letters of ASCII",
        ("urn:x", "x", 0): "--days is from 1",
    }.items():
        with pytest.raises(UsageError, match=words):
            make_identity(tmp_path / "new", changes[0], [changes[1]], changes[2])
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="--out"):
        make_identity(tmp_path / "file" / "own", "urn:x", ["x"])


def test_own_certificates_that_nobody_would_take_are_refused(keys, trusted, tmp_path):
    own, secret = write_pair(tmp_path / "own", trusted, keys[0])
    other = write_pair(tmp_path / "other", trusted, keys[1])[1]
    expired = write_pair(tmp_path / "old", certificate(keys[0], URI, "plc", last=NOW - DAY / 2), keys[0])[0]
    nameless = write_pair(tmp_path / "nameless", certificate(keys[0], "", "plc"), keys[0])[0]
    elliptic = write_pair(tmp_path / "ec", trusted, ec.generate_private_key(ec.SECP256R1()))[1]
    for files, words in {
        (own, other): "it is not the key of --certificate",
        (own, elliptic): "takes RSA keys of 2048 to 4096 bits",
        (own, own): "it is no key without a password",
        (secret, secret): "it is no certificate",
        (expired, secret): r"it is valid from \S+ to \S+ only",
        (nameless, secret): "it names no application",
        (tmp_path / "none.der", secret): "No such file",
        (own, tmp_path / "none.pem"): "No such file",
    }.items():
        with pytest.raises(UsageError, match=words):
            read_identity(*files, list)
    for some in ((own, None, None), (None, secret, None), (None, None, tmp_path), (own, secret, None)):
        with pytest.raises(UsageError, match="--certificate, --key and --peers go together"):
            read_security(*some, list)
    with pytest.raises(UsageError, match="no such folder"):
        read_security(own, secret, tmp_path / "none", list)
    assert read_security(None, None, None, list) is None


def test_a_key_that_others_can_read_and_a_certificate_that_ends_soon_are_named(keys, tmp_path):
    own, secret = write_pair(tmp_path / "own", certificate(keys[0], URI, "plc", last=NOW + 20 * DAY), keys[0])
    secret.chmod(0o644)
    lines = []
    read_identity(own, secret, lines.append)
    assert lines == [
        f"{own}: it ends on {NOW + 20 * DAY:%Y-%m-%d}, and nothing can connect after that",
        f"{secret}: others can read this key: chmod 600 {secret}",
    ]


# The reader of a press.


class Lines:
    """What a reader said."""

    def __init__(self, loop):
        self.loop, self.queue = loop, CONTROLLER.asyncio.Queue()

    def say(self, text):
        self.loop.loop.call_soon_threadsafe(self.queue.put_nowait, text)

    def next(self):
        async def wait():
            async with CONTROLLER.asyncio.timeout(600):
                return await self.queue.get()

        return self.loop(wait())


def test_a_press_is_followed_encrypted_when_it_is_trusted_and_not_before(keys, own, loop, tmp_path):
    machine = write_pair(
        tmp_path / "machine",
        certificate(keys[1], "urn:press", "press 3", use=ExtendedKeyUsageOID.SERVER_AUTH),
        keys[1],
    )
    for one in ("ours", "theirs"):
        (tmp_path / one).mkdir()
    (tmp_path / "theirs" / "rig.der").write_bytes(own[0].read_bytes())
    lines, taken = Lines(loop), []
    security = read_security(*own, tmp_path / "ours", list)
    there = read_security(*machine, tmp_path / "theirs", list)

    async def begin():
        press = PressServer(CONTROLLER.free_port(), there.server())
        await press.__aenter__()
        return press

    press = loop(begin())
    reader = PressReader(press.address, taken.extend, lines.say, (), again_s=(0.01,), security=security)
    running = CONTROLLER.asyncio.run_coroutine_threadsafe(reader.run(1), loop.loop)
    try:
        line = lines.next()
        assert line.startswith(f"{press.address}: press 3 [")
        assert line.endswith("; trying again")
        (kept,) = (tmp_path / "ours" / "rejected").iterdir()
        kept.rename(tmp_path / "ours" / kept.name)
        while lines.next() != f"connected to {press.address}":
            pass
        (channel,) = [one for one in press._server.bserver.clients if one.processor.session is not None]
        assert channel.processor._connection.security_policy.Mode == MODE.SignAndEncrypt
        loop(press.cycle(CYCLE, "P-1"))
        running.result(600)
        assert [one.serial for one in taken] == ["P-1"]
    finally:
        running.cancel()
        loop(press.__aexit__())


# The commands.


def test_the_commands(anisoscope, tmp_path, keys, trusted):
    made = anisoscope("line", "certificate", "--out", tmp_path / "own", "--name", "rig-1")
    assert made.code == 0, made.err
    assert read_identity(tmp_path / "own" / "certificate.der", tmp_path / "own" / "key.pem", list).uri
    own, secret = write_pair(tmp_path / "plc", trusted, keys[1])
    some = ("--certificate", own, "--key", secret, "--peers", tmp_path)
    serve = ("line", "opcua", "--rig", tmp_path / "rig.toml", "--recipes", tmp_path)
    for command in (
        serve,
        ("history", "covariates", "--opcua", "opc.tcp://press", "--history", tmp_path / "h"),
    ):
        done = anisoscope(*command, *some)
        assert (done.code, done.err.count("\n")) == (64, 1), done.err
        assert "it is not the key of --certificate" in done.err
    good = ("--certificate", tmp_path / "own" / "certificate.der", "--key", tmp_path / "own" / "key.pem")
    done = anisoscope(*serve, "--users", tmp_path / "users.json")
    assert "--users goes with --certificate" in done.err
    done = anisoscope(*serve, *good, "--peers", tmp_path, "--open")
    assert "--open is for a server without --certificate" in done.err
    assert not (tmp_path / "h").exists()
    done = anisoscope("history", "covariates", "--key", secret)
    assert "belong to --opcua" in done.err
