"""``anisoscope cache``."""
