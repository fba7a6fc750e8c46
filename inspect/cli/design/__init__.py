"""``anisoscope design``."""
