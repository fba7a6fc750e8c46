"""``anisoscope fit``."""
