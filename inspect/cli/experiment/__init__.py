"""``anisoscope experiment``."""
