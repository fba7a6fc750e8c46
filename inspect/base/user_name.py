"""Name of the user of the operating system."""

import getpass
import os


def user_name() -> str:
    """Login name; ``uid1000`` where the system knows no name for the user, as in some containers."""
    try:
        return getpass.getuser()
    except (ImportError, KeyError, OSError):
        return f"uid{os.getuid()}" if hasattr(os, "getuid") else "user"
