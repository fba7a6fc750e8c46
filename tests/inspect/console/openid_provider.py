"""An OpenID provider by others (Django OAuth Toolkit) as a process: its argument is a folder; it prints its issuer.

People log in with the password "password"; what they belong to is the claim ``groups``. PKCE is required, and a client
``console`` with the secret ``secret`` may send browsers back to any port of this computer.
"""

import sys
from pathlib import Path
from socketserver import ThreadingMixIn
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer, make_server

import django
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from django.conf import settings

PEOPLE = {
    "anna": ["inspectors", "plant 1"],
    "otto": ["auditors", "inspectors"],
    "eve": ["sales"],
    "the operator": ["inspectors"],
    "The Operator": ["inspectors"],
    "the оperаtоr": ["inspectors"],
    "this computer": ["inspectors"],
}
LOGIN = (
    "<form method='post'>{% csrf_token %}{{ form }}<input type='hidden' name='next' value='{{ next }}'>"
    "<button>Log in</button></form>"
)


class Server(ThreadingMixIn, WSGIServer):
    """Answers several browsers, which open connections ahead."""

    daemon_threads = True


class Quiet(WSGIRequestHandler):
    """Logs nothing."""

    def log_message(self, *_):
        pass


def configure(folder):
    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    settings.configure(
        SECRET_KEY="of a test",
        ALLOWED_HOSTS=["localhost"],
        ROOT_URLCONF="openid_urls",
        USE_TZ=True,
        LOGIN_URL="/login/",
        DATABASES={"default": {"ENGINE": "django.db.backends.sqlite3", "NAME": folder / "provider.sqlite"}},
        INSTALLED_APPS=[f"django.contrib.{name}" for name in ("auth", "contenttypes", "sessions")]
        + ["oauth2_provider"],
        MIDDLEWARE=[
            "django.contrib.sessions.middleware.SessionMiddleware",
            "django.contrib.auth.middleware.AuthenticationMiddleware",
        ],
        TEMPLATES=[
            {
                "BACKEND": "django.template.backends.django.DjangoTemplates",
                "OPTIONS": {
                    "loaders": [("django.template.loaders.locmem.Loader", {"registration/login.html": LOGIN})]
                },
            }
        ],
        PASSWORD_HASHERS=["django.contrib.auth.hashers.MD5PasswordHasher"],
        OAUTH2_PROVIDER={
            "OIDC_ENABLED": True,
            "OIDC_RSA_PRIVATE_KEY": key.private_bytes(
                Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()
            ).decode(),
            "OAUTH2_VALIDATOR_CLASS": "openid_urls.Validator",
            "PKCE_REQUIRED": True,
            "SCOPES": {"openid": "who you are", "profile": "your name"},
        },
    )
    django.setup()


def fill():
    from django.contrib.auth.models import Group, User
    from django.core.management import call_command
    from oauth2_provider.models import Application

    call_command("migrate", verbosity=0)
    for name, groups in PEOPLE.items():
        person = User.objects.create_user(name, password="password")
        person.groups.set([Group.objects.get_or_create(name=group)[0] for group in groups])
    Application.objects.create(
        client_id="console",
        client_secret="secret",
        client_type="confidential",
        authorization_grant_type="authorization-code",
        redirect_uris="http://127.0.0.1/openid/return",
        algorithm="RS256",
        skip_authorization=True,
    )


def urls():
    """The module of the addresses, made once Django is set up."""
    from types import ModuleType

    from django.contrib.auth.views import LoginView
    from django.urls import include, path
    from oauth2_provider.oauth2_validators import OAuth2Validator

    class Validator(OAuth2Validator):
        oidc_claim_scope = None

        def get_additional_claims(self, request):
            groups = [group.name for group in request.user.groups.order_by("name")]
            return {"preferred_username": request.user.username, "groups": groups}

    found = ModuleType("openid_urls")
    found.urlpatterns = [path("o/", include("oauth2_provider.urls")), path("login/", LoginView.as_view())]
    found.Validator = Validator
    sys.modules["openid_urls"] = found


if __name__ == "__main__":
    configure(Path(sys.argv[1]))
    urls()
    fill()
    from django.core.wsgi import get_wsgi_application

    with make_server("127.0.0.1", 0, get_wsgi_application(), Server, Quiet) as server:
        print(f"http://localhost:{server.server_port}/o", flush=True)  # noqa: T201 - what the test reads
        server.serve_forever()
