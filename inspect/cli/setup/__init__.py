"""``anisoscope init``, ``doctor`` and ``completion``, and the project file."""
