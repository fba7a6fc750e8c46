"""``anisoscope history``, ``show``, ``compare``, ``export``."""
