"""``anisoscope profile``."""
