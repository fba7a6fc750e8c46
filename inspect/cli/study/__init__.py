"""``anisoscope study`` and ``optimise``."""
