"""Name of the user: the login name, and one for a user without."""

import getpass
import os

import pytest

from anisoscope.base.user_name import user_name


def test_the_login_name_is_used():
    assert user_name() == getpass.getuser()


@pytest.mark.parametrize("problem", [KeyError("uid not found"), OSError("no name")])
def test_a_user_without_a_name_has_its_number(monkeypatch, problem):
    def nobody():
        raise problem

    monkeypatch.setattr(getpass, "getuser", nobody)
    assert user_name() in (f"uid{os.getuid()}" if hasattr(os, "getuid") else "", "user")
