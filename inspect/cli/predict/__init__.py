"""``anisoscope predict``."""
