"""``anisoscope ink``."""
