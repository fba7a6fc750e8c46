"""``anisoscope research`` and ``optimise``."""
