"""``anisoscope render``."""
