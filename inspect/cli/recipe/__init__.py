"""``anisoscope recipe`` and ``golden``."""
